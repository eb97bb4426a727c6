"""Fitting a model to a frequency response: ``k / ((s + a) (T1 s + 1) ...) e^(-delay s)`` behind a zero-order hold.

One pole and no further lag is an engine; a slow pole, nearly an integrator, and one lag is the rate response of an
axis.  The model is compared with the response as a computer sees it, held and sampled, a delay of a fraction of a
sample included (modified z-transform), so that pole, gain and delay of a difference equation come out exactly.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import exp, log, prod

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.errors import InputError
from cosim.identify.sweep.response import FrequencyResponse
from cosim.spec.vehicle import RateModel

MIN_COHERENCE = 0.6  # limit of Tischler and Remple
MAX_DELAY_ROUNDING = 0.05  # samples to the nearest whole delay


@dataclass(frozen=True)
class Model:
    """``gain / ((s + rate) prod(lag s + 1)) e^(-delay s)``, sampled every ``step`` seconds with hold."""

    gain: float  # output per unit of command and s
    rate: float  # 1/s, slow pole; 0: an integrator
    lags: tuple[float, ...]  # s, of each lag
    delay_samples: float
    step: float  # s, sample time

    @property
    def poles_1_s(self) -> tuple[float, ...]:
        """Decay rates of the poles [1/s]."""
        return (self.rate, *(1.0 / lag for lag in self.lags))

    @property
    def poles(self) -> tuple[float, ...]:
        """Poles of the sampled model in z."""
        return tuple(exp(-pole * self.step) for pole in self.poles_1_s)

    def modes(self) -> list[tuple[float, float]]:
        """Return ``(c, pole in 1/s)`` of ``sum c / (z - p)``: the model behind a hold, sampled, without its delay."""
        poles = separate_equal(self.poles_1_s)
        modes = []
        for i, pole in enumerate(poles):
            between = prod(other - pole for j, other in enumerate(poles) if j != i)
            residue = self.gain / prod(self.lags) / between
            gains = -np.expm1(-pole * self.step) / pole if pole * self.step > 1e-12 else self.step
            modes.append((float(residue * gains), pole))
        return modes

    def response(self, hertz: Array) -> Complex:
        """Return the frequency response of the model behind a hold, sampled, with its delay."""
        z = np.exp(2j * np.pi * hertz * self.step)
        samples = int(self.delay_samples)
        fraction = self.delay_samples - samples
        total = np.zeros(len(hertz), complex)
        for c, pole in self.modes():
            weight = _input_fraction(pole * self.step, fraction)
            total += c * (weight + (1.0 - weight) / z) / (z - exp(-pole * self.step))
        return np.asarray(total * z**-samples)

    def discrete(self, source: str) -> RateModel:
        """Return the form that a predictor reads: gain, zeros and poles in z, and the delay in samples."""
        poles = self.poles
        numerator = np.zeros(len(poles))
        for i, (c, _) in enumerate(self.modes()):
            numerator += c * np.poly([pole for j, pole in enumerate(poles) if j != i])
        zeros = sorted(np.real(np.roots(numerator)).tolist()) if len(poles) > 1 else []
        return RateModel(
            gain=float(numerator[0]),
            zeros=zeros,
            poles=sorted(poles, reverse=True),
            delay_samples=self.delay_samples,
            sample_time_s=self.step,
            source=source,
        )


def separate_equal(poles: Iterable[float]) -> list[float]:
    """Separate equal poles slightly, because partial fractions need distinct ones."""
    separated = list(poles)
    for i in range(1, len(separated)):
        while any(abs(separated[i] - other) <= 1e-6 * separated[i] for other in separated[:i]):
            separated[i] *= 1.0 + 1e-5
    return separated


def _input_fraction(decay: float, fraction: float) -> float:
    """Return the weight of the present held input in the next state, for a delay of ``fraction`` samples."""
    if decay < 1e-9:
        return 1.0 - fraction
    return float(np.expm1(-decay * (1.0 - fraction)) / np.expm1(-decay))


@dataclass(frozen=True)
class Fit:
    """A model with 95 % intervals and its misfit to the response."""

    label: str
    model: Model
    bounds: Mapping[str, tuple[float, float]]  # by value name; held values are left out
    fixed: tuple[str, ...]
    misfit: float  # rms of |ln(model / response)|
    worst_db: float
    worst_deg: float
    # Half width of the 95 % interval [samples] of delay and lags together, which are known better than either alone.
    all_delay_half: float = 0.0

    @property
    def values(self) -> dict[str, float]:
        """Continuous-time parameters by name."""
        natural = [self.model.gain, self.model.rate, *self.model.lags, self.model.delay_samples]
        return dict(zip(names(len(self.model.lags)), natural, strict=True))


def names(lags: int) -> list[str]:
    """Return parameter names in order: ``gain``, ``rate_1_s``, ``lag_s`` (``lag_2_s``, ...), ``delay_samples``."""
    return ["gain", "rate_1_s", *(f"lag_{i + 1}_s" if i else "lag_s" for i in range(lags)), "delay_samples"]


def point_weights(response: FrequencyResponse) -> Array:
    """Weigh each point by ``(1.58 (1 - exp(-coherence)))^2`` (Tischler and Remple), by 0 below MIN_COHERENCE."""
    weight = (1.58 * (1.0 - np.exp(-response.coherence))) ** 2
    return np.asarray(np.where(response.coherence >= MIN_COHERENCE, weight, 0.0))


def fit(response: FrequencyResponse, lags: int, label: str, hold: Mapping[str, float] | None = None) -> Fit:
    """Fit log magnitude and phase by least squares weighted by coherence, with the values in ``hold`` fixed.

    1 dB weighs as 6.6 deg, which is what the complex logarithm gives.  The bounds are those of the linearised problem
    with the misfit taken for independent errors: where the form itself does not fit, they say how well the numbers are
    pinned down, not that the form is right.  Raises InputError for an unknown name in ``hold`` or too few points.
    """
    hold = dict(hold or {})
    names_known = names(lags)
    for name in hold:
        if name not in names_known:
            raise InputError(f"hold {name}: not a parameter of this form; allowed: {', '.join(names_known)}")
    weight = point_weights(response)
    use = weight > 0.0
    if int(use.sum()) < len(names_known):
        raise InputError(
            f"only {int(use.sum())} points of the response count, too few for {len(names_known)} parameters; "
            "widen the band or sweep longer"
        )
    problem = _FitProblem(response.hertz[use], response.value[use], np.sqrt(weight[use]), response.step, lags, hold)
    return problem.solve(label)


def _is_logarithmic(name: str) -> bool:
    """Return whether the logarithm of a parameter is fitted, and not the parameter."""
    return name == "gain" or name.startswith("lag")


class _FitProblem:
    """Least-squares problem with the unknowns ``ln |gain|, rate, ln lag ..., delay`` that are not held.

    ``unambiguous``: largest delay over that after which the phases of the two closest points repeat.
    """

    def __init__(
        self,
        hertz: Array,
        value: Complex,
        weight: Array,
        step: float,
        lags: int,
        hold: Mapping[str, float],
        longest_delay_s: float = 10.0,
        unambiguous: float = 0.75,
    ) -> None:
        self.unambiguous = unambiguous
        self.longest_delay_s = longest_delay_s
        self.hertz, self.value, self.weight, self.step, self.lags = hertz, value, weight, step, lags
        self.names = names(lags)
        self.free = [i for i, name in enumerate(self.names) if name not in hold]
        self.sign = 1.0
        fastest = 0.5 / step
        # A delay of one over the frequency spacing has the same phases as none, so that longer delays are ambiguous.
        longest = min(self.longest_delay_s, self.unambiguous / float(np.diff(hertz).min())) / step
        self.low = np.array([-60.0, 0.0, *[log(1e-3 * step)] * lags, 0.0])
        self.high = np.array([60.0, 20.0 * fastest, *[log(1e3)] * lags, longest])
        self.full = np.zeros(len(self.names))
        for name, fixed in hold.items():
            i = self.names.index(name)
            if _is_logarithmic(name) and not fixed > 0.0:
                raise InputError(f"hold {name}={fixed:g}: must be above 0")
            self.full[i] = log(fixed) if _is_logarithmic(name) else fixed
            if not self.low[i] <= self.full[i] <= self.high[i]:
                raise InputError(f"hold {name}={fixed:g}: out of range")

    def model(self, x: Array) -> Model:
        """Return the model with the unknowns ``x``, and the other parameters as held."""
        full = self.full.copy()
        full[self.free] = x
        return Model(
            self.sign * exp(full[0]),
            float(full[1]),
            tuple(exp(value) for value in full[2:-1]),
            float(full[-1]),
            self.step,
        )

    def error(self, model: Model) -> Complex:
        """Return ln(model / response), with the phase between -pi and pi."""
        return np.asarray(np.log(model.response(self.hertz) / self.value))

    def residuals(self, x: Array) -> Array:
        """Return the weighted errors of log magnitude, then those of phase [rad], at the unknowns ``x``."""
        error = self.error(self.model(x))
        return np.concatenate([self.weight * error.real, self.weight * error.imag])

    def find_start(self) -> Array:
        """Return start values: fit the magnitude, which needs no delay and no sign, then both to the phase."""
        from scipy.optimize import least_squares

        low_hz, high_hz = float(self.hertz[0]), float(self.hertz[-1])
        middle = 2.0 * np.pi * np.sqrt(low_hz * high_hz)
        x = self.full.copy()
        guess = [middle if self.lags == 0 else 0.1 * middle, *(-log(middle * 2.0**i) for i in range(self.lags))]
        for i, value in enumerate(guess, start=1):
            x[i] = value if i in self.free else x[i]
        flat = np.log(np.abs(self.value)) - np.log(np.abs(self.model(x[self.free]).response(self.hertz)))
        if 0 in self.free:
            x[0] += float(np.average(flat, weights=self.weight))
        shape = [i for i in self.free if i != len(x) - 1]

        def magnitude_error(part: Array) -> Array:
            x[shape] = part
            return np.asarray(self.weight * self.error(self.model(x[self.free])).real)

        if shape:
            x[shape] = least_squares(
                magnitude_error, x[shape], bounds=(self.low[shape], self.high[shape]), x_scale="jac"
            ).x  # fmt: skip
        self._fit_phase(x)
        return np.asarray(np.clip(x[self.free], self.low[self.free], self.high[self.free]))

    def _fit_phase(self, x: Array) -> None:
        """Set the sign, and the delay in ``x``, to those with the least phase error over whole delays."""
        last = len(x) - 1
        delays = np.arange(0.0, self.high[last] + 1.0) if last in self.free else x[last:]
        undelayed = x.copy()
        undelayed[last] = 0.0
        keep = self.full[last]
        self.full[last] = 0.0
        base = self.error(self.model(undelayed[self.free]))
        self.full[last] = keep
        turn = -2j * np.pi * self.hertz[None, :] * self.step * delays[:, None]
        best = None
        for sign in (1.0, -1.0):
            off = np.angle(sign * np.exp(1j * base.imag[None, :] + turn))
            cost = (self.weight * off) ** 2 @ np.ones(len(self.hertz))
            i = int(np.argmin(cost))
            if best is None or cost[i] < best[0]:
                best = (float(cost[i]), sign, float(delays[i]))
        assert best is not None
        self.sign, x[last] = best[1], best[2]

    def _interval(self, name: str, value: float, wide: float, max_exponent: float = 300.0) -> tuple[float, float]:
        """Return the 95 % interval in the parameter's unit; pole rates and delays are at least 0."""
        low, high = value - wide, value + wide
        if not _is_logarithmic(name):
            return max(low, 0.0), high
        scale = self.sign if name == "gain" else 1.0
        first, last = sorted((scale * exp(max(low, -max_exponent)), scale * exp(min(high, max_exponent))))
        return first, last

    def solve(self, label: str) -> Fit:
        """Fit the free parameters by least squares; return the fit, named ``label``, with 95 % intervals."""
        from scipy.optimize import least_squares
        from scipy.special import stdtrit

        x = self.find_start()
        if self.free:
            bounds = (self.low[self.free], self.high[self.free])
            solution = least_squares(
                self.residuals, x, bounds=bounds, x_scale="jac", xtol=1e-13, ftol=1e-13, gtol=1e-13, max_nfev=400
            )
            x = solution.x
            jacobian = solution.jac
        error = self.error(self.model(x))
        model = self.model(x)
        spread: dict[str, tuple[float, float]] = {}
        together = 0.0
        if self.free:
            freedom = 2 * len(self.hertz) - len(self.free)
            variance = float(np.sum(self.residuals(x) ** 2)) / freedom
            covariance = variance * np.linalg.pinv(jacobian.T @ jacobian)
            wide_by = float(stdtrit(freedom, 0.975))
            half = wide_by * np.sqrt(np.maximum(np.diag(covariance), 0.0))
            lags = dict(zip(self.names[2:-1], model.lags, strict=True))
            slope = [lags[name] / self.step if name in lags else float(name == "delay_samples") for name in self.names]
            turn = np.array(slope)[self.free]
            together = wide_by * float(np.sqrt(max(float(turn @ covariance @ turn), 0.0)))
            for i, value, wide in zip(self.free, x, half, strict=True):
                spread[self.names[i]] = self._interval(self.names[i], float(value), float(wide))
        return Fit(
            label,
            model,
            spread,
            tuple(name for i, name in enumerate(self.names) if i not in self.free),
            float(np.sqrt(np.mean(np.abs(error) ** 2))),
            float(np.abs(error.real).max() * 20.0 / log(10.0)),
            float(np.degrees(np.abs(error.imag).max())),
            together,
        )
