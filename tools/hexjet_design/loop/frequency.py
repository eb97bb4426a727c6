"""Margins of a sampled loop from its response at rising frequencies, and where they are."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array, Complex


@dataclass(frozen=True)
class LoopMargins:
    """Margins of a stable loop at the plant's input: the change of one kind that makes it unstable.

    None where there is no such thing in the frequencies that were looked at.
    """

    gain_db: float | None  # smallest destabilising increase
    gain_down_db: float | None  # smallest destabilising reduction
    phase_deg: float | None  # smallest lag, up to 180 deg
    phase_lead_deg: float | None  # smallest lead, below 180 deg
    delay_s: float | None  # smallest destabilising extra delay
    delay_less_s: float | None  # smallest destabilising loss of delay
    peak_sensitivity: float | None
    crossover_hz: float | None  # highest frequency with gain 1


def loop_margins(loop: Complex, hertz: Array, step: float = 0.0, transport_s: float | None = None) -> LoopMargins:
    """Return the margins of a loop from its response, straight lines between its points.

    A factor ``k`` puts a pole on the limit where ``L = -1 / k``: at every crossing of the negative real axis, and at
    half the sampling rate, where the loop is real.  A turn by ``phi`` does where ``|L| = 1`` and the angle from L down
    to -1 is ``phi``; the same point is reached by the turn ``2 pi - phi`` the other way round.  Of the two the shorter
    is the margin and the other its mirror, so a loop with one crossover has a margin for lag or for lead, and a
    conditionally stable one may have both.  Further delay ``tau`` turns by ``omega tau``, without end, so every
    crossover limits it.  Delay taken away turns the other way, and cannot be more than there is.

    Parameters
    ----------
    loop, hertz
        ``L`` at rising frequencies, close enough for straight lines between them.
    step
        Control step of a sampled loop, s; at a last frequency of half its rate the loop counts as real.  0: none is.
    transport_s
        Transport delay in the loop, s: what can be taken away.  None: not known; counted is what turns by less than
        half a turn.
    """
    factors, angles, at = crossings(loop, 2.0 * pi * hertz, step)
    up, down = factors[factors > 1.0], factors[factors < 1.0]
    lead = 2.0 * pi - angles
    less = lead[lead < pi] / at[lead < pi] if transport_s is None else lead / at
    return LoopMargins(
        gain_db=_least(20.0 * np.log10(up)),
        gain_down_db=None if not len(down) else float(20.0 * np.log10(down.max())),
        phase_deg=_least(np.degrees(angles[angles <= pi])),
        phase_lead_deg=_least(np.degrees(lead[lead < pi])),
        delay_s=_least(angles / at),
        delay_less_s=_least(less[less <= (inf if transport_s is None else transport_s)]),
        peak_sensitivity=float(np.max(1.0 / np.abs(1.0 + loop))),
        crossover_hz=float(at.max() / (2.0 * pi)) if len(at) else None,
    )


class MarginPoint(NamedTuple):
    """Where a loop has a margin: frequency [Hz], and gain [dB] or phase [deg, -360 to 0] there."""

    hertz: float
    value: float


def margin_points(loop: Complex, hertz: Array) -> tuple[MarginPoint | None, MarginPoint | None]:
    """Find the points nearest to -1 in gain, on the negative real axis, and in phase, at gain 1.

    Straight lines between the points, as :func:`loop_margins` has them; None where there is no such place.
    """
    at, part = _passing(loop.imag)
    real = loop.real[at] + part * np.diff(loop.real)[at]
    places = (hertz[at] + part * np.diff(hertz)[at])[real < 0.0]
    gains = 20.0 * np.log10(-real[real < 0.0])
    _, angles, omega = crossings(loop, 2.0 * pi * hertz)
    phases = wrap_phase(np.degrees(angles) - 180.0)
    of_gain = int(np.argmin(np.abs(gains))) if len(gains) else None
    of_phase = int(np.argmin(np.abs(phases + 180.0))) if len(phases) else None
    return (
        None if of_gain is None else MarginPoint(float(places[of_gain]), float(gains[of_gain])),
        None if of_phase is None else MarginPoint(float(omega[of_phase] / (2.0 * pi)), float(phases[of_phase])),
    )


def wrap_phase(degrees: Array) -> Array:
    """Return the same angles between -360 and 0 degrees, so that -180 is in the middle."""
    wrapped: Array = -np.mod(-degrees, 360.0)
    return wrapped


def _least(values: Array) -> float | None:
    return float(values.min()) if len(values) else None


def crossings(loop: Complex, omega: Array, step: float = 0.0) -> tuple[Array, Array, Array]:
    """Find the crossings of the negative real axis and the unit circle by linear interpolation.

    The factors that put it on -1; then at every gain of 1 the angle [rad, 0 to 2 pi] down to -1, and ``omega`` there.
    A last point at half the sampling rate, ``omega step = pi``, is on the real axis itself.
    """
    sampled = bool(step) and len(omega) > 0 and omega[-1] * step >= pi * (1.0 - 1e-9)
    at, part = _passing(loop.imag[:-1] if sampled else loop.imag)
    real = loop.real[at] + part * np.diff(loop.real)[at]
    if sampled:
        real = np.append(real, loop.real[-1])
    size, phase = np.log(np.abs(loop)), np.unwrap(np.angle(loop))
    at, part = _passing(size)
    angle = phase[at] + part * np.diff(phase)[at] + pi
    return -1.0 / real[real < 0.0], angle % (2.0 * pi), omega[at] + part * np.diff(omega)[at]


def _passing(value: Array) -> tuple[NDArray[np.intp], Array]:
    """Find sign changes of ``value``: the point before, and the fraction of the way to the next."""
    below = value < 0.0
    at = np.flatnonzero(below[:-1] != below[1:])
    return at, value[at] / (value[at] - value[at + 1])
