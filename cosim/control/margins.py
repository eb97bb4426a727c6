"""Margins of a loop: from its response at rising frequencies, or exactly from a fraction and a delay."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, floor, inf, isfinite, log10, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.base.arrays import Array, Complex
from cosim.base.errors import InputError
from cosim.control.predictors.linear import companion


@dataclass(frozen=True)
class LoopMargins:
    """Margins of a stable loop broken at the plant's input: the smallest change of each kind that makes it unstable.

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
    """Return the margins of a loop from its frequency response, interpolated linearly between its points.

    A factor ``k`` puts a pole on the limit where ``L = -1 / k``: at every crossing of the negative real axis, and at
    half the sampling rate, where the loop is real.  A turn by ``phi`` does where ``|L| = 1`` and the angle from L down
    to -1 is ``phi``; the same point is reached by the turn ``2 pi - phi`` the other way round.  Of the two the shorter
    is the margin and the other its mirror, so a loop with one crossover has a margin for lag or for lead, and a
    conditionally stable one may have both.  Further delay ``tau`` turns by ``omega tau``, without end, so every
    crossover limits it.  Delay taken away turns the other way, and cannot be more than there is.

    >>> hertz = np.geomspace(0.01, 100.0, 5000)
    >>> print(f"{loop_margins(4.0 / (2j * np.pi * hertz), hertz).phase_deg:.4g} deg")  # an integrator
    90 deg

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
    factors, _, angles, at = crossings(loop, 2.0 * pi * hertz, step)
    up, down = factors[factors > 1.0], factors[factors < 1.0]
    lead = 2.0 * pi - angles
    less = lead[lead < pi] / at[lead < pi] if transport_s is None else lead / at
    return LoopMargins(
        gain_db=_minimum_or_none(20.0 * np.log10(up)),
        gain_down_db=None if not len(down) else float(20.0 * np.log10(down.max())),
        phase_deg=_minimum_or_none(np.degrees(angles[angles <= pi])),
        phase_lead_deg=_minimum_or_none(np.degrees(lead[lead < pi])),
        delay_s=_minimum_or_none(angles / at),
        delay_less_s=_minimum_or_none(less[less <= (inf if transport_s is None else transport_s)]),
        peak_sensitivity=float(np.max(1.0 / np.abs(1.0 + loop))),
        crossover_hz=float(at.max() / (2.0 * pi)) if len(at) else None,
    )


def _minimum_or_none(values: Array) -> float | None:
    return float(values.min()) if len(values) else None


def crossings(loop: Complex, omega: Array, step: float = 0.0) -> tuple[Array, Array, Array, Array]:
    """Return where a loop's response crosses the negative real axis and the unit circle, interpolated linearly.

    The factors that put it on -1 and ``omega`` there; then at every gain of 1 the angle [rad, 0 to 2 pi] down to -1,
    and ``omega`` there.  A last point at half the sampling rate, ``omega step = pi``, is on the real axis itself.

    >>> omega = np.geomspace(0.1, 100.0, 2000)
    >>> _, at, _, _ = crossings(4.0 / (1j * omega) * np.exp(-0.1j * omega), omega)
    >>> print(f"{at[0]:.3f} rad/s")  # pi / 2 over the delay
    15.708 rad/s
    """
    sampled = bool(step) and len(omega) > 0 and omega[-1] * step >= pi * (1.0 - 1e-9)
    at, part = _sign_changes(loop.imag[:-1] if sampled else loop.imag)
    real, of_axis = (values[at] + part * np.diff(values)[at] for values in (loop.real, omega))
    if sampled:
        real, of_axis = np.append(real, loop.real[-1]), np.append(of_axis, omega[-1])
    size = np.log(np.maximum(np.abs(loop), np.finfo(float).tiny))
    phase = np.unwrap(np.angle(loop))
    at, part = _sign_changes(size)
    angle = phase[at] + part * np.diff(phase)[at] + pi
    return -1.0 / real[real < 0.0], of_axis[real < 0.0], angle % (2.0 * pi), omega[at] + part * np.diff(omega)[at]


def _sign_changes(value: Array) -> tuple[NDArray[np.intp], Array]:
    """Return where ``value`` changes its sign: the point before, and the fraction of the interval after it."""
    below = value < 0.0
    at = np.flatnonzero(below[:-1] != below[1:])
    return at, value[at] / (value[at] - value[at + 1])


def delayed_margins(
    numerator: ArrayLike,
    denominator: ArrayLike,
    dt: float = 0.0,
    delay: float = 0.0,
    rounds: int = 10,
    negligible: float = 1e-6,
) -> LoopMargins:
    """Return the margins of ``N(s) / D(s) exp(-s delay)``, or of ``N(z) / D(z)`` behind a delay, without a Pade form.

    The response is known at every frequency, so it is looked at more and more closely where the loop crosses the
    negative real axis and the unit circle, and about the peak of ``|S|``.  That the closed loop is stable is asked
    first: the angle of ``D + N exp(-s delay)`` along the imaginary axis counts its zeros in the right half plane (A. V.
    Mikhailov's criterion, with a delay too), along the unit circle those outside.  Gains are in dB, phases in deg,
    delays in s, the crossover in Hz; a field that is None is no margin: that change loses no loop.

    >>> found = delayed_margins([4.0], [1.0, 0.0], delay=0.1)
    >>> print(f"{found.delay_s:.6f} s, {found.gain_db:.4f} dB, {found.phase_deg:.4f} deg")
    0.292699 s, 11.8812 dB, 67.0817 deg

    Parameters
    ----------
    numerator, denominator : array_like, one dimension
        Coefficients, highest power first.
    dt : float
        Sample time, s: the fraction is one of z.  0: of s.  :func:`sample_delayed` makes one of the other.
    delay : float
        Delay in the loop, s; of a sampled loop, of whole steps.
    rounds : int
        Times that it is looked at more closely, eight times each.
    negligible : float
        A factor down below this is none: there the loop has a pole on the limit itself.

    Raises
    ------
    InputError
        For a closed loop that is not stable, a fraction that is not proper, and coefficients whose digits do not tell
        the loop at its crossover: of z, with poles that are slow against ``dt``.
    """
    n, d = proper_fraction(numerator, denominator, dt, delay)
    if dt and abs(delay / dt - round(delay / dt)) > 1e-9:
        raise InputError(f"delay: {delay:g} s is not whole steps of {dt:g} s; sample_delayed has the exact loop")

    def evaluate(omega: Array) -> tuple[Complex, Complex, Complex, Array]:
        """Return s or z, numerator and denominator at ``omega``, and the rounding error of the denominator."""
        variable: Complex = np.asarray(np.exp(1j * omega * dt) if dt else 1j * omega)
        rounding: Array = np.finfo(float).eps * np.polyval(np.abs(d), np.abs(variable))
        below: Complex = np.asarray(np.polyval(d, variable), np.complex128)
        above: Complex = np.asarray(np.polyval(n, variable) * np.exp(-1j * omega * delay), np.complex128)
        return variable, above, np.where(below == 0.0, rounding, below), rounding

    omega = _choose_frequencies(n, d, dt, delay)
    for _ in range(rounds):
        _, above, below, _ = evaluate(omega)
        loop = above / below
        size = np.abs(loop)
        change = np.diff(loop.imag < 0.0) & (loop.real[1:] < 0.0) & (size[1:] < 1.0 / negligible)
        change |= np.diff(size < 1.0)
        peak = int(np.argmin(np.abs(1.0 + loop)))
        change[max(peak - 1, 0) : peak + 1] = True
        at = np.flatnonzero(change)
        if len(at) > 100_000:
            raise InputError("the closed loop is at the limit along a range of frequencies, it has no margins")
        omega = np.union1d(omega, omega[at, None] + np.diff(omega)[at, None] * np.linspace(0.0, 1.0, 9)[1:-1])
    variable, above, below, rounding = evaluate(omega)
    # Margins depend on the loop where its gain may be between a tenth and ten.
    matters = (np.abs(above) < 10.0 * (np.abs(below) + rounding)) & (np.abs(above) > 0.1 * (np.abs(below) - rounding))
    if np.any(rounding[matters] > 1e-4 * np.abs(below[matters])):
        raise InputError("denominator: its digits do not tell the loop at its crossover; take a larger dt, or s")
    # With a delay, a loop whose gain does not fall goes round a circle at ever higher frequencies.
    radius = float(abs(n[0] / d[0])) if len(n) == len(d) and delay and not dt else 0.0
    # There D + N e^(-s delay) turns with 1 + N / D e^(-s delay), which has no zero to the right.
    closed = (above + below) / (1.0 + n[0] / d[0] * np.exp(-1j * omega * delay) if radius else 1.0)
    turns = np.unwrap(np.angle(closed / variable ** (len(d) - 1) if dt else closed))
    unstable = (0.0 if dt else 0.5 * (len(d) - 1)) - float(turns[-1] - turns[0]) / pi
    if radius >= 1.0 or unstable > 0.25:
        count = "without end" if radius >= 1.0 else ceil(unstable - 0.25)
        raise InputError(f"the closed loop is not stable, it has no margins: poles outside the limit: {count}")
    found = loop_margins(above / below, omega / (2.0 * pi), dt, delay)
    if found.gain_down_db is not None and found.gain_down_db < 20.0 * log10(negligible):
        found = replace(found, gain_down_db=None)
    if not radius:
        return found
    gain = min(inf if found.gain_db is None else found.gain_db, -20.0 * log10(radius))
    return replace(found, gain_db=gain, peak_sensitivity=max(found.peak_sensitivity or 1.0, 1.0 / (1.0 - radius)))


def proper_fraction(numerator: ArrayLike, denominator: ArrayLike, dt: float, delay: float) -> tuple[Array, Array]:
    """Return the coefficients of a plant without leading zeros, highest power first.

    >>> proper_fraction([0.0, 1.0], [0.0, 1.0, 2.0], dt=0.01, delay=0.0)
    (array([1.]), array([1., 2.]))

    Parameters
    ----------
    numerator, denominator : array_like, one dimension
        Coefficients, highest power first.
    dt, delay : float
        Step and delay, s, of at least 0.

    Raises
    ------
    InputError
        For what is no proper fraction, and a step or a delay that is none.
    """
    for name, value in (("dt", dt), ("delay", delay)):
        if not (isfinite(value) and value >= 0.0):
            raise InputError(f"{name}: {value:g} s; at least 0")
    found = []
    for name, given in (("numerator", numerator), ("denominator", denominator)):
        coefficients = np.atleast_1d(np.asarray(given, np.float64))
        if coefficients.ndim != 1 or not np.isfinite(coefficients).all() or not coefficients.any():
            raise InputError(f"{name}: one row of finite coefficients, not all 0, highest power first")
        found.append(np.trim_zeros(coefficients, "f"))
    n, d = found
    if len(n) > len(d):
        raise InputError(f"numerator: of degree {len(n) - 1}, above the denominator's {len(d) - 1}")
    return n, d


def _choose_frequencies(n: Array, d: Array, dt: float, delay: float, most: float = 1e7) -> Array:
    """Return frequencies [rad/s] that resolve the response: by decades, near each pole and zero, along the delay.

    Raises InputError where the delay would need more than ``most``, which are some hundred MB.
    """
    roots = np.concatenate([np.roots(n), np.roots(d)]).astype(complex)
    roots = roots[roots != 0.0]
    corners, resonances = np.abs(roots), np.abs(roots.imag)
    if dt:
        s = np.log(roots) / dt
        corners, resonances, delay = np.array([1e-5, pi]) / dt, np.abs(s.imag), delay + dt * len(d)
    else:
        for ends, power in ((0, len(d) - len(n)), (-1, 0)):
            of_n, of_d = (np.trim_zeros(each, "b")[ends] for each in (n, d))
            power = power or _count_zeros_at_0(d) - _count_zeros_at_0(n)
            if power:
                corners = np.append(corners, abs(of_n / of_d) ** (1.0 / power))
        corners = np.append(corners, 1.0 / delay if delay else [] if len(corners) else 1.0)
    low, high = 1e-4 * corners.min(), pi / dt if dt else 1e4 * corners.max()
    away = np.geomspace(1e-8, 0.5, 80)
    parts = [
        np.geomspace(low, high, 200 * ceil(np.log10(high / low))),
        *(each * (1.0 + side * away) for each in resonances if each for side in (-1.0, 1.0)),
    ]
    if delay:
        last = high if dt else 10.0 * corners.max() + 4.0 * pi / delay
        if last * delay / (2.0 * pi) * 24 > most:
            raise InputError(
                f"delay: {delay:g} s turns the loop too often below {last:.3g} rad/s; leave fast poles out"
            )
        parts.append(np.arange(1.0, last * delay / (2.0 * pi) * 24) / 24 * 2.0 * pi / delay)
    omega = np.setdiff1d(np.concatenate(parts), resonances)
    return np.append(omega[(omega >= low) & (omega < high)], high)


def _count_zeros_at_0(polynomial: Array) -> int:
    return len(polynomial) - len(np.trim_zeros(polynomial, "b"))


def sample_delayed(numerator: ArrayLike, denominator: ArrayLike, dt: float, delay: float = 0.0) -> tuple[Array, Array]:
    """Return ``N(z), D(z)`` of ``N(s) / D(s) exp(-s delay)`` behind a hold, sampled every ``dt``, exactly.

    A delay of ``n + f`` steps has the command of ``n + 1`` steps ago act over the first ``f`` of a step and that of
    ``n`` steps ago over the rest, the modified z-transform (E. I. Jury, 1958):

        x_k+1 = e^(A dt) x_k + e^(A (1 - f) dt) B(f dt) u_k-n-1 + B((1 - f) dt) u_k-n,  B(t) = int_0^t e^(A s) ds B

    Both are coefficients, highest power first; a whole step of the delay is a pole at 0.

    An integrator a step and a half late: half of a command acts in the second step and half in the third.

    >>> numerator, denominator = sample_delayed([1.0], [1.0, 0.0], dt=1.0, delay=1.5)
    >>> print(numerator.round(9), denominator)
    [0.5 0.5] [ 1. -1.  0.  0.]

    Parameters
    ----------
    numerator, denominator : array_like, one dimension
        Coefficients of s, highest power first.
    dt, delay : float
        Step above 0 and delay from 0 on, s; any delay, also between steps.

    Raises
    ------
    InputError
        For what is no proper fraction, or a step that is not above 0.
    """
    from scipy.linalg import expm

    n, d = proper_fraction(numerator, denominator, dt, delay)
    if not dt:
        raise InputError("dt: 0 s; above 0")
    order = len(d) - 1
    n, d = np.pad(n, (len(d) - len(n), 0)) / d[0], d / d[0]
    direct, C = n[0], np.zeros(0)
    # The command is one more state that stays what it is: its column of the exponential is B(t).
    A = np.zeros((order + 1, order + 1))
    if order:
        A[:order, :order], A[:order, order], C = companion(n[1:] - direct * d[1:], d)
    steps = floor(delay / dt + 1e-9)
    f = delay / dt - steps if delay / dt - steps >= 1e-9 else 0.0
    whole, first, rest = (expm(A * dt * part)[:order] for part in (1.0, f, 1.0 - f))
    F = whole[:, :order]
    poles = np.atleast_1d(np.poly(F)) if order else np.ones(1)
    # The numerators from their values on a circle: a difference of two polynomials would lose their digits.
    z = 2.0 * np.exp(2j * pi * np.arange(order + 1) / (order + 1))

    def compute_numerator(B: Array, direct: float) -> Array:
        values = [C @ np.linalg.solve(point * np.eye(order) - F, B) + direct for point in z]
        powers = np.fft.fft(np.array(values) * np.polyval(poles, z)).real / (order + 1)
        return np.append(direct, (powers / 2.0 ** np.arange(order + 1))[:order][::-1])

    now = compute_numerator(rest[:, order], 0.0 if f else direct)
    if not f:
        return np.trim_zeros(now, "f"), np.pad(poles, (0, steps))
    late = compute_numerator(rest[:, :order] @ first[:, order], direct)
    return np.trim_zeros(np.append(now, 0.0) + np.append(0.0, late), "f"), np.pad(poles, (0, steps + 1))
