"""A sampled loop from its response on the unit circle: predictors, rate PID, margins, poles outside the circle.

Nothing here knows a vehicle.  ``z`` are points on the upper half of the unit circle; ``y`` is the measured rate, ``u``
the command, ``y^`` the predicted rate, ``T`` the control step:

    y^ = P_y y + P_u u
    C_e = p + i T / (1 - z^-1),  D = d s (1 - z^-1) / (T (1 - (1 - s) z^-1)),  s = T / (T_f + T)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from cosim.base.arrays import Array, Complex
from cosim.base.errors import InputError
from cosim.base.protocols import Predictor
from cosim.control.predictors.linear import Pair, PairResponse
from cosim.spec.vehicle import RateGains, RateModel

Response = Callable[[Complex], Complex]

_TAPS = 20_000
_ENDED = 1e-13  # an impulse response that stays below this has ended


class Margins(BaseModel):
    """The margins of an open loop; of several crossings, those of the one with the smallest margin.

    ``cutoff`` is the first frequency [Hz] at which the gain falls below 1, ``gain_margin`` in dB, ``phase_margin`` in
    deg; None where there is no crossing.
    """

    model_config = ConfigDict(frozen=True, defer_build=True)

    cutoff: float | None
    gain_margin: float | None
    phase_margin: float | None


def grid(points: int = 3000, lowest: float = 1e-4) -> Complex:
    """Return points of the upper half of the unit circle, dense at low frequency; ``lowest`` in rad per sample."""
    angles = np.union1d(np.geomspace(lowest, pi, points // 2), np.linspace(pi / points, pi, points // 2))
    return np.asarray(np.exp(1j * angles))


def impulse_response(predictor: Callable[[], Predictor], model: RateModel) -> PairResponse:
    """Return ``P_y`` and ``P_u`` as a function of z, from the impulse responses of the predictor, which must end.

    Those of a state predictor do, being finite sums over past commands and a fast observer; so the transform is exact.
    Raises InputError for one whose response does not end.
    """
    of_rate = _impulse(predictor(), model, (1.0, 0.0))
    of_command = _impulse(predictor(), model, (0.0, 1.0))
    # the predictor is told the command of the step before: its first answer to it belongs to u / z
    return lambda z: (_transform(of_rate, z), _transform(of_command, z) / z)


def _impulse(predictor: Predictor, model: RateModel, unit: tuple[float, float]) -> Array:
    values = [predictor.update(*unit)]
    wait = int(model.delay_samples) + 2  # nothing may come before that
    ended = 0
    while ended <= wait:
        values.append(predictor.update(0.0, 0.0))
        ended = ended + 1 if abs(values[-1]) < _ENDED else 0
        if len(values) > _TAPS:
            raise InputError(f"{type(predictor).__name__}: its impulse response does not end; it must be stable alone")
    return np.array(values)


def _transform(taps: Array, z: Complex) -> Complex:
    """Compute ``sum_k h_k z^-k``: by powers for a few points, by Horner's rule for many."""
    inverse = 1.0 / z
    if z.size < 8:
        return np.asarray(inverse[:, None] ** np.arange(len(taps)) @ taps)
    total = np.zeros_like(z)
    for tap in taps[::-1]:
        total = total * inverse + tap
    return total


def pid_response(gains: RateGains, step: float, z: Complex) -> Pair:
    """Return ``C_e`` (set-point and feedback) and ``D`` (feedback alone) of the rate PID at ``z``; ``step`` in s."""
    weight = step / (gains.d_filter_s + step)
    difference = 1.0 - 1.0 / z
    of_slope = gains.d * weight * difference / (step * (1.0 - (1.0 - weight) / z))
    return np.asarray(gains.p + gains.i * step / difference), np.asarray(of_slope)


@dataclass(frozen=True)
class LoopMargins:
    """Margins of a stable loop broken at the plant's input: the change of one kind that puts a pole on the limit.

    None where there is no such thing in the frequencies that were looked at.
    """

    gain_db: float | None  # least factor up
    gain_down_db: float | None  # least factor down
    phase_deg: float | None  # least lag, up to half a turn
    phase_lead_deg: float | None  # least lead, below half a turn
    delay_s: float | None  # least further delay
    delay_less_s: float | None  # least delay taken away, of what there is
    peak_sensitivity: float | None
    crossover_hz: float | None  # the highest frequency with gain 1


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
    """Where a loop has a margin: the frequency [Hz] and, there, its gain [dB] or phase [deg, -360 to 0]."""

    hertz: float
    value: float


def margin_points(loop: Complex, hertz: Array) -> tuple[MarginPoint | None, MarginPoint | None]:
    """Find where a loop is nearest to -1 in gain, on the negative real axis, and in phase, where its gain is 1.

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
    """Find where a loop's response meets the negative real axis and the unit circle, by lines between its points.

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
    """Find where ``value`` changes its sign: the point before, and the fraction of the way to the next."""
    below = value < 0.0
    at = np.flatnonzero(below[:-1] != below[1:])
    return at, value[at] / (value[at] - value[at + 1])


def zeros_outside(values: Complex) -> int:
    """Count the zeros outside the unit circle of a function that is analytic there and constant at infinity.

    ``values`` along the upper half circle, closely spaced: the function's turns about 0 count its zeros.
    """
    turn = np.unwrap(np.angle(values))
    return -round(float(turn[-1] - turn[0]) / pi)


def margins(response: Response, step: float, low: float = 0.05, points: int = 4000) -> Margins:
    """Return the margins of a sampled open loop from its response on the unit circle.

    ``step`` is the sample time [s]; from ``low`` Hz to half the sample rate, at ``points`` frequencies.
    """
    frequencies = np.geomspace(low, 0.5 / step * (1.0 - 1e-9), points)
    values = response(np.exp(2j * pi * frequencies * step))

    def at(frequency: float) -> complex:
        return complex(response(np.exp(np.array([2j * pi * frequency * step])))[0])

    gains, falls, phases = [], [], []
    size = np.abs(values) - 1.0
    for k in np.flatnonzero(np.sign(size[:-1]) != np.sign(size[1:])):
        crossing = _bisect(lambda f: abs(at(f)) - 1.0, frequencies[k], frequencies[k + 1])
        phases.append(wrap_degrees(float(np.degrees(np.angle(at(crossing)))) + 180.0))
        if size[k] > 0.0:
            falls.append(crossing)
    turns = (np.sign(values.imag[:-1]) != np.sign(values.imag[1:])) & (values.real[:-1] < 0.0)
    for k in np.flatnonzero(turns):
        crossing = _bisect(lambda f: at(f).imag, frequencies[k], frequencies[k + 1])
        gains.append(-20.0 * float(np.log10(abs(at(crossing)))))
    last = complex(response(np.array([-1.0 + 0.0j]))[0]).real  # at half the sampling rate the loop is real
    if last < 0.0:
        gains.append(-20.0 * float(np.log10(-last)))
    return Margins(
        cutoff=falls[0] if falls else None,
        gain_margin=min(gains, key=abs, default=None),
        phase_margin=min(phases, key=abs, default=None),
    )


def _bisect(function: Callable[[float], float], low: float, high: float) -> float:
    sign = function(low)
    for _ in range(40):
        middle = 0.5 * (low + high)
        if (function(middle) > 0.0) == (sign > 0.0):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def wrap_degrees(degrees: float) -> float:
    """Return the same angle between -180 and 180 degrees."""
    return (degrees + 180.0) % 360.0 - 180.0
