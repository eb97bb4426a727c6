"""Linear dynamics of an engine around hover, where lags in a row do not describe it.

A real turbojet's thrust is no chain of lags: the published model of the P220 has a pair of poles that swings a little,
a spool with a speed governor has a zero as well, and a governor that samples puts half a step between what it reads and
what it does.  So two poles, whatever their damping, a zero, a further lag and a quick zero are fitted to the swept
response, and a delay of whole samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, inf, log

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.identify.sweep import FrequencyResponse, point_weights, separate_equal
from cosim.spec.vehicle import RateModel

# Terms besides two poles. The quick zero remains if a fractional delay is rounded up: (1 + s t) leads by t.
FORMS: tuple[tuple[str, ...], ...] = ((), ("zero",), ("zero", "lag"), ("zero", "lag", "quick"))
# Forms with a zero in the right half plane, where thrust first goes the wrong way; tried if no other form fits.
WRONG_WAY_FORMS: tuple[tuple[str, ...], ...] = (("right",), ("right", "lag"))
MAX_DELAY_CHANGE = 5  # samples, from the best free delay
# A design takes larger misfits into account; smaller ones change a peak sensitivity of 1.7 by less than 3 %.
MIN_CARRIED_MISFIT = 0.01


@dataclass(frozen=True)
class Dynamics:
    """``prod (1 - s / zero) / prod (1 - s / pole)`` with hold and delay; static gain 1."""

    poles: tuple[complex, ...]  # rad/s
    zeros: tuple[complex, ...]
    delay_samples: float
    step: float
    misfit: float = 0.0  # rms of |ln(model / response)|
    # (Hz, x): the engine may respond with (1 + d) times this at that frequency, |d| <= x; () where the model fits.
    unsure: tuple[tuple[float, float], ...] = ()

    @property
    def lag_s(self) -> float:
        """Delay at low frequency without the transport delay, s."""
        return float(sum((-1.0 / p).real for p in self.poles) - sum((-1.0 / z).real for z in self.zeros))

    def slower(self, factor: float) -> Dynamics:
        """Return dynamics slowed by a factor; 0 gives a lag that is negligible in a step."""
        if factor == 0.0:
            return make_lag_dynamics([0.0], self.delay_samples, self.step)
        return replace(self, poles=tuple(p / factor for p in self.poles), zeros=tuple(z / factor for z in self.zeros))

    def hold_response(self, hertz: Array) -> Complex:
        """Return the frequency response behind the hold, with gain 1 at rest."""
        s = 2j * np.pi * hertz
        value = (1.0 - np.exp(-s * self.step)) / (s * self.step) * np.exp(-s * self.delay_samples * self.step)
        for pole in self.poles:
            value = value / (1.0 - s / pole)
        for zero in self.zeros:
            value = value * (1.0 - s / zero)
        return np.asarray(value)

    def uncertainty(self, hertz: Array) -> Array | None:
        """Return the relative uncertainty of the response, by straight lines between the points of the sweep.

        Outside the swept band it is that of the band's end.  None where the engine follows.
        """
        if not self.unsure:
            return None
        at, misfit = np.array(self.unsure).T
        return np.asarray(np.interp(np.log(np.maximum(hertz, 1e-9)), np.log(at), misfit))

    def unsure_words(self) -> str:
        """Describe the engine's possible deviation from these dynamics; "" if there is none."""
        if not self.unsure:
            return ""
        at, most = max(self.unsure, key=lambda point: point[1])
        return f"what was measured, up to {100.0 * most:.2g} % at {at:.2g} Hz"

    def describe(self) -> str:
        """Describe the lags, poles and zeros in words."""
        descriptions = [f"lag {-1e3 / p.real:.4g} ms" for p in self.poles if not p.imag]
        descriptions += [
            f"two poles at {abs(p):.4g} rad/s with damping {-p.real / abs(p):.2f}" for p in self.poles if p.imag > 0.0
        ]
        descriptions += [f"zero at {z.real:.4g} rad/s" for z in self.zeros if z.real < 0.0]
        descriptions += [
            f"zero in the right half plane at {z.real:.4g} rad/s (thrust first goes the wrong way)"
            for z in self.zeros
            if z.real > 0.0
        ]
        return ", ".join(descriptions)

    def discrete(self, source: str) -> RateModel:
        """Return the transfer function in z behind a zero-order hold."""
        from scipy.signal import cont2discrete, zpk2ss

        gain = np.prod([-p for p in self.poles]) / np.prod([-z for z in self.zeros] or [1.0])
        ss = zpk2ss(list(self.zeros), list(self.poles), float(np.real(gain)))
        A, B, C, _, _ = cont2discrete(ss, self.step)
        denominator = np.real(np.poly(A))
        numerator = np.real(np.poly(A - B @ C)) - denominator  # C adj(zI - A) B
        numerator = numerator[1:]
        zeros = np.roots(numerator)
        real, pairs = _sample_poles(self.poles, self.step)
        return RateModel(
            gain=float(numerator[0]),
            zeros=sorted(float(z.real) for z in zeros if not z.imag),
            zero_pairs=[(float(z.real), float(z.imag)) for z in zeros if z.imag > 0.0],
            poles=sorted(real, reverse=True),
            pole_pairs=pairs,
            delay_samples=self.delay_samples,
            sample_time_s=self.step,
            source=source,
        )


def _sample_poles(poles: Sequence[complex], step: float) -> tuple[list[float], list[tuple[float, float]]]:
    """Return the sampled poles: distinct real ones, and the upper one of each pair.

    A pair that is over within a step, or that swings so little in one that rounding leaves nothing of it, is two real
    ones; one that turns by more than half a circle in a step has its other half above the axis.
    """
    real, pairs = [p.real for p in poles if not p.imag], []
    # A smaller imaginary part counts as real, and a smaller pole in z as settled within the step.
    negligible = 1e-9
    fastest = 25.0  # rad per step: decays to 1e-11 in a step
    for pole in poles:
        z = complex(np.exp(pole * step))
        if pole.imag > 0.0 and abs(z.imag) > negligible * abs(z) and abs(z) > negligible:
            pairs.append((z.real, abs(z.imag)))
        elif pole.imag > 0.0:
            real += [-min(abs(pole), fastest / step)] * 2
    return [exp(-decay * step) for decay in separate_equal([-p for p in real])], pairs


def make_lag_dynamics(constants: Sequence[float], delay: float, step: float) -> Dynamics:
    """Return lags [s] in series behind ``delay`` [samples]; lags below a fifth of a step are raised to that."""
    return Dynamics(tuple(complex(-1.0 / max(lag, 0.2 * step)) for lag in constants), (), delay, step)


def fit_dynamics(response: FrequencyResponse, delay: float, lag: float) -> Dynamics:
    """Fit the smallest form that follows an engine's response, or the closest one.

    ``delay`` [samples] and ``lag`` [s] are where the search begins.
    """
    best: Dynamics | None = None
    good = 0.001  # misfit at which no larger form is tried
    for form in FORMS:
        fit = _fit_form(response, form, delay, lag)
        if best is None or (fit.misfit < 0.7 * best.misfit and _is_realisable(fit)):
            best = fit
        if best.misfit <= good:
            break
    assert best is not None
    poor = 0.02  # misfit above which to try these forms
    for form in WRONG_WAY_FORMS if best.misfit > poor else ():
        fit = _fit_form(response, form, delay, lag)
        if fit.misfit < 0.7 * best.misfit and _is_realisable(fit):
            best = fit
    return best


def with_misfit(dynamics: Dynamics, response: FrequencyResponse) -> Dynamics:
    """Add the model's misfit to the response as an uncertainty, if large enough to matter.

    Each point has the largest of its own misfit and its neighbours', because the response between points is not known.
    """
    if dynamics.misfit < MIN_CARRIED_MISFIT:
        return dynamics
    use = point_weights(response) > 0.0
    hertz, ratio = response.hertz[use], response.value[use] / dynamics.hold_response(response.hertz[use])
    off = np.abs(ratio / np.exp(np.mean(np.log(np.abs(ratio)))) - 1.0)
    wide = np.maximum(off, np.maximum(np.append(off[1:], off[-1]), np.append(off[0], off[:-1])))
    return replace(dynamics, unsure=tuple((float(f), float(misfit)) for f, misfit in zip(hertz, wide, strict=True)))


def bounds(hertz: Array, off: Array) -> tuple[tuple[float, float], ...]:
    """Return bounds on a model's error, as :attr:`Dynamics.unsure`, without losing a mode between two points.

    The band in 80 parts, and at each end of a part the largest of the parts on both its sides.
    """
    # Bands of a sweep, 5.9 % wide each over two decades, about as a mode with damping 0.03 is.
    bands = 80
    ends = np.geomspace(hertz[0], hertz[-1], bands + 1)
    part = np.clip(np.searchsorted(ends, hertz, side="right") - 1, 0, bands - 1)
    most = np.zeros(bands)
    np.maximum.at(most, part, off)
    widest = np.maximum(np.append(most, most[-1]), np.append(most[0], most))
    return tuple((float(f), float(x)) for f, x in zip(ends, widest, strict=True))


def _is_realisable(dynamics: Dynamics) -> bool:
    """Return whether a predictor can run the dynamics: each pair of complex zeros needs a pair of complex poles."""
    model = dynamics.discrete("")
    return len(model.zero_pairs) <= len(model.pole_pairs)


class _FormFit:
    """Fit of a form's parameters to a frequency response.

    They are ``ln gain, ln natural frequency, ln damping, delay [samples]`` and the logarithms of the times of zero,
    further lag and quick zero, of which a form without them leaves the last ones alone.
    """

    def __init__(self, response: FrequencyResponse, form: Sequence[str]) -> None:
        weight = np.sqrt(point_weights(response))
        # Of the sampling rate: above it a sampled lag differs by 3 % or more from the continuous one with hold.
        max_hertz_samples = 0.1
        use = (weight > 0.0) & (response.hertz * response.step <= max_hertz_samples)
        use = use if use.any() else weight > 0.0
        hertz, self._value, self._weight = response.hertz[use], response.value[use], weight[use]
        # A hold is half a step late and slightly weak; at an engine's frequencies it has no other effect.
        self._s = 1j * (2.0 * np.pi * hertz)
        self._hold = (1.0 - np.exp(-self._s * response.step)) / (self._s * response.step)
        self._form, self._step, self._quick = form, response.step, 0.5 * response.step
        self._low = np.array([-60.0, log(1e-3), log(0.05), 0.0, log(1e-4), log(1e-4), log(0.01 * self._quick)])
        self._high = np.array([60.0, log(1e3), log(20.0), 1000.0, log(20.0), log(20.0), log(10.0 * self._quick)])
        more = [k for k, name in ((4, "zero"), (4, "right"), (5, "lag"), (6, "quick")) if name in form]
        self._free = [0, 1, 2, 3, *more]

    def dynamics(self, x: Array) -> Dynamics:
        """Return the dynamics at a point, with their misfit."""
        misfit = float(np.sqrt(np.mean(np.abs(self._log_error(x)) ** 2)))
        return Dynamics(*self._poles_and_zeros(x), float(x[3]), self._step, misfit)

    def search(self, delay: float, lag: float) -> Array:
        """Find the best point with a free delay from several starts around ``delay`` [samples] and ``lag`` [s]."""
        best: tuple[float, Array] = (inf, np.zeros(7))
        gain, form = log(float(np.abs(self._value[0]))), self._form
        starts = [
            (damping, zero, last)
            for damping in (0.6, 1.5)
            for zero in ((0.1, 1.0) if {"zero", "right"} & set(form) else (0.1,))
            for last in ((0.1, 1.0) if "lag" in form else (0.1,))
        ]
        for damping, zero, last in starts:
            times = [log(zero * lag), log(last * lag), log(self._quick)]
            start = np.array([gain, log(2.0 / lag), log(damping), delay, *times])
            solution = self._solve(np.clip(start, self._low + 1e-6, self._high - 1e-6), self._free)
            if solution[0] < best[0]:
                best = solution
        return best[1]

    def round_delay(self, best: Array) -> Array:
        """Find the best point near ``best`` whose delay is a whole number of samples."""
        chosen: tuple[float, Array] = (inf, best)
        others = [k for k in self._free if k != 3]
        for samples in sorted({max(0, round(best[3]) + k) for k in range(-MAX_DELAY_CHANGE, MAX_DELAY_CHANGE + 1)}):
            fixed = best.copy()
            fixed[3] = samples
            solution = self._solve(fixed, others)
            if solution[0] < chosen[0]:
                chosen = solution
        return chosen[1]

    def _poles_and_zeros(self, x: Array) -> tuple[tuple[complex, ...], tuple[complex, ...]]:
        natural, damping, form = exp(x[1]), exp(x[2]), self._form
        root = np.sqrt(complex(damping * damping - 1.0))
        poles = [natural * (-damping + root), natural * (-damping - root)]
        poles = [complex(p.real, p.imag if abs(p.imag) > 1e-9 * abs(p) else 0.0) for p in poles]
        zeros = [complex(-exp(-x[4]))] if "zero" in form else [complex(exp(-x[4]))] if "right" in form else []
        if "quick" in form:
            zeros.append(complex(-exp(-x[6])))
        if "lag" in form:
            poles.append(complex(-exp(-x[5])))
        return tuple(poles), tuple(zeros)

    def _log_error(self, x: Array) -> Complex:
        poles, zeros = self._poles_and_zeros(x)
        model = self._hold * exp(x[0]) * np.exp(-self._s * x[3] * self._step)
        for p in poles:
            model = model / (1.0 - self._s / p)
        for z in zeros:
            model = model * (1.0 - self._s / z)
        return np.asarray(np.log(model / self._value))

    def _weighted_residuals(self, x: Array) -> Array:
        off = self._log_error(x)
        return np.concatenate([self._weight * off.real, self._weight * off.imag])

    def _solve(self, start: Array, free: list[int]) -> tuple[float, Array]:
        """Return cost and solution of the least squares from ``start`` over the entries ``free``, the others fixed."""
        from scipy.optimize import least_squares

        def insert_free(part: Array) -> Array:
            x = start.copy()
            x[free] = part
            return x

        bounds = self._low[free], self._high[free]
        solution = least_squares(lambda part: self._weighted_residuals(insert_free(part)), start[free], bounds=bounds)
        return float(solution.cost), insert_free(solution.x)


def _fit_form(response: FrequencyResponse, form: Sequence[str], delay: float, lag: float) -> Dynamics:
    search = _FormFit(response, form)
    return search.dynamics(search.round_delay(search.search(delay, lag)))
