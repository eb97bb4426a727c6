"""The limit of performance: the least error after a load that any stabilising linear controller leaves on a channel.

The controller measures rate and angle.  With ``q = 1 / z`` and ``H`` from command to rate, every loop that it can make
is stable and is made by two finite responses ``t`` and ``y`` (the affine parametrisation of D. C. Youla, H. A. Jabr and
J. J. Bongiorno, IEEE Trans. Automatic Control 21 (1976) 319-338, here for a plant that can be inverted behind its
delay of ``N`` steps):

    H = q^N b(q) / a(q),  G = H T/2 (1 + q) / (1 - q)          to the angle; T the step
    T_i = q^(N + l) t                                          complementary sensitivity at the plant's input
    angle / set-point = q^(N + s) (1 + q) / 2 y,  angle / load = G (1 - T_i)
    command / set-point = a / b (1 - q) / T y,  command / gyro noise = -a / b (t - q^(m + s - l) (1 + q) / 2 y)

``l`` and ``m`` are the steps by which rate and angle are measured late, ``s = max(l - m, 0)``; zeros of ``b`` on or
outside the unit circle stay in ``t`` and ``y``.  At rest both are 1, and where the rate has a pole at 1 the ramp that
``T_i`` follows is exact too.  The set-point enters where the angle is measured (one degree of freedom).

Errors in time, noise, and the sensitivity at each frequency are convex in ``t`` and ``y`` (S. Boyd and C. Barratt,
Linear Controller Design: Limits of Performance, 1991), which are cubic splines in time.  A coarser spline can only miss
the least from above.  So that the optimum is no fragile one, an error ``|e| <= E`` of the delay may be held too:

    |S| + 2 M w |T_i| <= 2 M,   w = max |1 - exp(-j theta e)|   sufficient for a peak below 2 M at every such delay

which is a little pessimistic: what it finds is then at most too high.  Clarabel solves it (Goulart and Chen, 2024).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.closed_loop import ClosedLoop, window_s
from hexjet_design.loop.optimal import CIRCLE_TOLERANCE, polynomial, split_zeros
from hexjet_design.loop.programme import MAX_PEAK_FACTOR, UNIFORM_DELAYS, Bounds, InvertedPlant, Programme, need_solver

RELAXATION = 0.1  # share by which each bound is relaxed
PRICE_WORDS = {  # words for relaxing each bound
    "peak_sensitivity": "more peak sensitivity",
    "noise": "more noise",
    "step_error": "more step error",
    "delay_error": "less tolerance of the delay",
}


@dataclass(frozen=True)
class Limit:
    """Smallest error after a load, and the closed loop that achieves it, computed exactly."""

    bounds: Bounds
    # Integrated absolute angle error after a unit step of load, rad s per unit of the command.
    load_error: float
    step_error: float
    noise: float
    peak_sensitivity: float
    complementary: Array  # impulse response of T, per sample
    setpoint: Array  # response to the set-point, per sample
    window_s: float  # s over which errors are integrated


@dataclass(frozen=True)
class AxisLimit:
    """A closed loop compared with the best linear controller within the same bounds."""

    load_error: float  # of the designed loop
    least: Limit
    tolerant: Limit | None  # limit with the loop's delay tolerance
    prices: Mapping[str, float] = field(default_factory=dict)  # price of each bound; empty: not asked

    @property
    def times(self) -> float:
        """Ratio of the loop's load error to the least possible one."""
        return self.load_error / self.least.load_error

    @property
    def times_tolerant(self) -> float | None:
        """Least ratio of the load error to that of the best loop with the same delay tolerance, None if unknown."""
        return None if self.tolerant is None else self.load_error / self.tolerant.load_error

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers, for JSON."""
        bounds = (self.tolerant or self.least).bounds
        return {
            "load_error": self.load_error,
            "least": self.least.load_error,
            "times": self.times,
            "least_as_tolerant": None if self.tolerant is None else self.tolerant.load_error,
            "times_as_tolerant": self.times_tolerant,
            "prices": dict(self.prices),
            "delay_error_samples": bounds.delay_error,
            "peak_sensitivity": bounds.peak_sensitivity,
            "noise": bounds.noise,
            "step_error": bounds.step_error,
        }

    def describe(self) -> str:
        """Return the comparison in words."""
        text = (
            f"its error after a load is {self.times:.2f} times the least that any linear controller leaves with the "
            "same peak sensitivity, noise and step error"
        )
        if self.tolerant is not None:
            text += (
                f", and {self.times_tolerant:.2f} times where its tolerance of the delay, "
                f"{self.tolerant.bounds.delay_error:g} samples either way, is kept too"
            )
        if not self.prices:
            return text
        parts = ", ".join(f"{PRICE_WORDS[name]} by {100.0 * price:.1f} %" for name, price in self.prices.items())
        return f"{text}; that least falls with {100.0 * RELAXATION:.0f} % {parts}"


def axis_limit(closed: ClosedLoop, load_error: float, priced: bool = False) -> AxisLimit:
    """Compare a closed loop of this load error with the limit; ``priced``: with the price of each bound.

    Raises InputError as :func:`find_limit`.
    """
    channel, bounds = closed.points.channel, loop_bounds(closed)
    least = find_limit(channel, bounds)
    error = _delay_error(closed)
    tolerant = find_limit(channel, bounds._replace(delay_error=error)) if error else None
    return AxisLimit(load_error, least, tolerant, bound_prices(channel, tolerant or least) if priced else {})


def bound_prices(channel: Channel, limit: Limit) -> dict[str, float]:
    """Return the relative drop of the smallest load error if one bound is relaxed by RELAXATION, by bound.

    A bound that costs nothing was not in the way; a tolerance of the delay is relaxed where there is less of it.
    """
    bounds = limit.bounds
    prices = {}
    for name in PRICE_WORDS:
        value = getattr(bounds, name)
        if value:
            relaxed = value * (1.0 - RELAXATION if name == "delay_error" else 1.0 + RELAXATION)
            found = find_limit(channel, bounds._replace(**{name: relaxed}), limit.window_s)
            prices[name] = max(0.0, 1.0 - found.load_error / limit.load_error)
    return prices


def loop_bounds(closed: ClosedLoop) -> Bounds:
    """Return the bounds that a closed loop of the nominal channel keeps, without its delay tolerance."""
    peak = float(np.max(np.abs(closed.inner / closed.characteristic)))
    return Bounds(peak, closed.noise, closed.step_error)


def _delay_error(closed: ClosedLoop) -> float:
    """Return the largest delay error, samples, with a peak below MAX_PEAK_FACTOR times the present one."""
    theta, open_loop = closed.points.theta, closed.open_loop
    allowed, most = MAX_PEAK_FACTOR * loop_bounds(closed).peak_sensitivity, closed.points.channel.transport_samples

    def peak_at_delay_error(error: float) -> float:
        return float(np.abs(1.0 / (1.0 + open_loop * np.exp(-1j * theta * error))).max())

    more = tolerated_error(peak_at_delay_error, allowed, most)
    return min(more, tolerated_error(lambda error: peak_at_delay_error(-error), allowed, most))


def tolerated_error(peak_at_delay_error: Callable[[float], float | None], allowed: float, most: float) -> float:
    """Return the largest error, in quarters and up to ``most``, up to which the peak is at most ``allowed``.

    ``peak_at`` gives the peak sensitivity with an error of the delay in samples; None where that is unstable.
    """
    error = 0.0
    resolution = 0.25  # samples: resolution of the tolerance
    while error + resolution <= most:
        peak = peak_at_delay_error(error + resolution)
        if peak is None or peak > allowed:
            break
        error += resolution
    return error


def find_limit(channel: Channel, bounds: Bounds, window: float | None = None) -> Limit:
    """Return the least load error within ``bounds``, integrated over ``window`` s, by default that of a design.

    Raises InputError where Clarabel is not installed, the channel has no such limit (a delay of no whole steps,
    measurements that are held), or no linear controller keeps the bounds.
    """
    need_solver()
    plant = Plant(channel, round((window or window_s(channel)) / channel.step))
    solution = Programme(plant, bounds).solve()
    return plant.evaluate(bounds, *solution)


class Plant(InvertedPlant):
    """A channel as polynomials in ``q``, and its time responses."""

    def __init__(self, channel: Channel, samples: int) -> None:
        self.channel, self.name, self.samples, self.step = channel, channel.name, samples, channel.step
        if channel.rate_hold != 1:
            raise InputError(f"{channel.name}: no limit is computed where measurements are held")
        self.rate_late, self.angle_late = (
            (0, 0) if channel.identified else (channel.rate_latency, channel.angle_latency)
        )
        model = replace(channel, rate_filter_s=0.0, rate_latency=0).model("limit")
        if model.delay_samples != int(model.delay_samples):
            raise InputError(f"{channel.name}: a limit needs a delay of whole steps, not {model.delay_samples:g}")
        zeros, poles = model.all_zeros, model.all_poles
        self.late = int(model.delay_samples) + channel.added_delay + len(poles) - len(zeros)
        self.denominator = polynomial(poles)
        kept, inside = split_zeros(zeros)
        self.kept = kept / kept.sum()
        self.inverted = model.gain * float(kept.sum()) * inside
        self.is_double = any(abs(pole - 1.0) < CIRCLE_TOLERANCE for pole in poles)
        self.shift = max(self.rate_late - self.angle_late, 0)
        self.length = samples - self.late - max(self.rate_late, self.shift)
        if self.length < 8 * self.late:
            raise InputError(f"{channel.name}: {samples} samples are too few for a limit; its delay is {self.late}")

    def angle_of_setpoint(self, y: Array) -> Array:
        return np.asarray(lfilter([0.5, 0.5], [1.0, -1.0], self.delayed(y, self.late + self.shift), axis=0))

    def angle_of_load(self, acts: Array, late: int = 0) -> Array:
        """Return the angle after a unit step of load that comes through the response ``acts``, ``late`` samples late.

        Both integrals are taken first and one by one: with the poles in one recursion rounding grows to 5 % in 20 s.
        """
        numerator = 0.5 * self.step * np.convolve(np.convolve(self.inverted, self.kept), [1.0, 1.0])
        integrals = self.delayed(acts, late + self.late).cumsum(0).cumsum(0)
        return np.asarray(lfilter(numerator, self.denominator, integrals, axis=0))

    def noise_responses(self, t: Array, y: Array) -> tuple[Array, Array, Array]:
        t, y = (np.concatenate([each, np.zeros((UNIFORM_DELAYS * self.late, *each.shape[1:]))]) for each in (t, y))
        late = self.angle_late + self.shift - self.rate_late
        of_rate = self.channel.rate_noise
        by_y = self.to_command(lfilter(np.r_[np.zeros(late), 0.5, 0.5], [1.0], y, axis=0))
        of_angle = lfilter([1.0, -1.0], [1.0], self.to_command(y), axis=0) / self.step
        return of_rate * self.to_command(t), -of_rate * by_y, self.channel.angle_noise * np.asarray(of_angle)

    def evaluate(self, bounds: Bounds, t: Array, y: Array) -> Limit:
        """Return the loop that ``t`` and ``y`` make, from every sample and a fine grid of frequencies."""
        by_t, by_y, of_angle = self.noise_responses(t, y)
        acts = self.delayed(np.ones(1), 0) - self.delayed(t, self.late + self.rate_late)
        load, sensitivity = self.angle_of_load(acts), np.fft.rfft(acts, 1 << 17)
        return Limit(
            bounds,
            float(np.abs(load).sum()) * self.step,
            float(np.abs(1.0 - self.angle_of_setpoint(y)).sum()) * self.step,
            float(np.sqrt(np.square(by_t + by_y).sum() + np.square(of_angle).sum())),
            float(np.abs(sensitivity).max()),
            t,
            y,
            self.samples * self.step,
        )
