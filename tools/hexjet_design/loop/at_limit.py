"""The law at the limit of performance, designed for requirements: the answer to a load by a convex programme.

:func:`hexjet_design.loop.low_order.reduce_order` has the least load error within a peak sensitivity, a noise and an
error of the delay, with the loop of the controller's model.  A design asks for more than that: tolerances of delay and
gain at once, a step that does not saturate, a bandwidth, and for the loop with the engine, which may be off its model.
So the programme's bounds are drawn closer by what that loop misses, until it keeps everything:

1. The answer to a set-point: its three lags are as short as a step of the stated size leaves room for; longer ones
   where the noise of a short one costs more after a load than it gains.
2. The programme's bounds, drawn closer; its condition for an error of the delay is sufficient, not necessary.
3. The weights that are free are moved by a simplex, for what the loop itself asks: a third less error after a load.

Where nothing keeps the requirements, each is relaxed by itself, to see which would have to be, and by how much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, floor, inf, pi, sqrt

import numpy as np
from scipy.optimize import minimize

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.laws import low_frequency_delay
from cosim.simulation.controllers.controller_file import Requirements
from cosim.spec.vehicle import RateModel
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.criteria import CORNER_FACTOR, OVERSHOOT_ROOM, excesses, fine_loop, is_acceptable, objective
from hexjet_design.loop.low_order import COARSE_POINTS, START_POLES, free_weights, reduce_order
from hexjet_design.loop.optimal import LAGS, PredictorBases, Target, filter_response, polynomial
from hexjet_design.loop.programme import Bounds, need_solver
from hexjet_design.loop.tuning import Tuning, round_gain

Pairs = Sequence[tuple[float, float]]

# The search keeps requirements by this relative margin, for what lies between its frequencies.
SEARCH_MARGIN = 0.004
# Factors on the START poles at which searches begin, because an engine may be slow.
SLOWER_POLES = (1.0, 0.7, 0.5, 0.35)
LONGER_LAGS = (1.0, 1.3, 1.7, 2.4, 3.5)  # factors on the shortest lag
WEIGHT_STEP, LOG_LAG_STEP = 0.02, 0.2  # initial size of the simplex
MAX_EVALUATIONS = 300  # of the simplex search
PENALTY, UNSTABLE = 100.0, 1e3  # cost per excess; of an unstable loop
RELAXATIONS = (1.1, 1.25, 1.5, 2.0, 3.0, 5.0, 10.0)  # factors on a missed requirement
# Requirement in words, its keys, and whether a larger value is less strict.
RELAXABLE = (
    ("a peak sensitivity of {max_sensitivity:.3g}", ("max_sensitivity",), True),
    (
        "tolerances of {delay_tolerance:.2g} of the delay and {gain_tolerance:.2g} of the gain",
        ("delay_tolerance", "gain_tolerance"),
        False,
    ),
    ("noise of {noise_share:.3g} of the room", ("noise_share",), True),
    ("a bandwidth of {min_bandwidth_hz:.2g} Hz", ("min_bandwidth_hz",), False),
)
CUTOFF_PER_LAG = sqrt(10.0 ** (0.3 / LAGS) - 1.0)  # rad/s at -3 dB, times lag


@dataclass(frozen=True)
class LimitTuning:
    """Law with the smallest objective that meets the requirements, or why there is none."""

    tuning: Tuning | None
    objective: float  # infinite: not feasible
    why_not: str = ""


class _Search:
    """Search of the law on one channel for given requirements."""

    def __init__(self, channel: Channel, model: RateModel, fixed: Tuning, need: Requirements) -> None:
        self.channel, self.model, self.fixed, self.need = channel, model, fixed, need
        self.points = FrequencyGrid(channel, close=1500)
        # A fractional delay is rounded for the law.
        self.believed = model.model_copy(update={"delay_samples": float(round(model.delay_samples))})
        self.delay = low_frequency_delay(model)
        self.corners = [FrequencyGrid(corner, close=100) for corner in _late_corners(channel, need)]

    def missed(self, closed: ClosedLoop, flown: bool = True) -> dict[str, float]:
        """Return the relative excess over each missed requirement.

        ``flown``: with what a proof flies, the overshoot of a step at a corner of the tolerances.
        """
        if closed.unstable_poles:
            return {"tolerances": 1.0}
        parts = excesses(closed, self.need, SEARCH_MARGIN)
        spare = 0.1  # overshoot kept free for noise
        if flown:
            allowed = CORNER_FACTOR * (OVERSHOOT_ROOM + closed.overshoot) * (1.0 - spare)
            worst = max((ClosedLoop(corner, closed.tuning).overshoot for corner in self.corners), default=0.0)
            parts["corners"] = min(worst / allowed - 1.0, 10.0)
        return {name: part for name, part in parts.items() if part > 0.0}

    def tuning(self, target: Target, bases: PredictorBases | None = None) -> Tuning:
        """Return the law with this target, whose parameters are rounded as in a file."""
        values = {name: round_gain(value) for name, value in target.to_values(self.delay).items()}
        return Tuning.of_law(values, self.model, self.fixed, bases)

    def lags(self) -> list[float]:
        """Return lags of the response to a set-point, s, between the bounds by the step's size and the bandwidth."""
        need = self.need
        longest = CUTOFF_PER_LAG / (2.0 * pi * need.min_bandwidth_hz) if need.min_bandwidth_hz else inf
        low, high = self.channel.step, 50.0 * self.delay
        for _ in range(30):
            middle = sqrt(low * high)
            low, high = (low, middle) if self._first_command(middle) * need.step_rad <= self._room else (middle, high)
        return [lag for lag in (factor * high for factor in LONGER_LAGS) if lag <= longest]

    @property
    def _room(self) -> float:
        """Largest allowed command, less the margin."""
        return self.channel.room * (1.0 - SEARCH_MARGIN)

    def _first_command(self, lag: float) -> float:
        """Return the largest command after a unit step of the set-point for a lag: ``a / (b T)`` of the response.

        Zeros that cannot be inverted stay in the answer, as much as is 1 at rest.
        """
        model, step = self.believed, self.channel.step
        impulse = np.zeros(round(12.0 * lag / step) + 8)
        impulse[0] = 1.0
        pole = float(np.exp(-step / lag))
        answer = filter_response([(1.0 - pole) ** LAGS], polynomial([pole] * LAGS), impulse)
        kept = polynomial([zero for zero in model.all_zeros if abs(zero) >= 1.0])
        inside = polynomial([zero for zero in model.all_zeros if abs(zero) < 1.0])
        command: Array = filter_response(polynomial(model.all_poles), inside, answer)
        return float(np.abs(command).max()) / (abs(model.gain * float(kept.sum())) * step)

    def meet_requirements(self, lag: float, pairs: Pairs) -> Tuning | None:
        """Return the law that keeps the requirements with this lag and these poles, or None."""
        need, noise = self.need, self.need.noise_share * self.channel.room
        free_step = 100.0  # s, so large that it bounds nothing
        bounds = Bounds(need.max_sensitivity * (1.0 - SEARCH_MARGIN), noise * (1.0 - SEARCH_MARGIN), free_step)
        wide = need.delay_samples(self.channel.transport_samples)
        first_error = 0.3  # fraction of the tolerance, tried first
        for _ in range(12):
            try:
                low = reduce_order(self.channel, self.believed, bounds, lag, pairs, rounds=0, frequencies=COARSE_POINTS)
                tuning = self.tuning(low.target)
            except InputError:
                return None
            missed = self.missed(ClosedLoop(self.points, tuning), flown=False)
            if not missed:
                return tuning
            error = bounds.delay_error
            if "tolerances" in missed:
                error = min(max(first_error * wide, error * (1.0 + missed["tolerances"]) + 0.25), 2.0 * wide)
            peak = bounds.peak_sensitivity / (1.0 + min(missed.get("peak sensitivity", 0.0), 1.0))
            closer = Bounds(peak, bounds.noise / (1.0 + missed.get("noise", 0.0)), free_step, error)
            if closer == bounds:  # only the lag misses its requirement
                return None
            bounds = closer
        return None

    def find_start(self) -> Tuning | None:
        """Return the law of the least objective among those with weights of the convex programme, or None."""
        best: tuple[float, Tuning] | None = None
        for slower in SLOWER_POLES:
            pairs = [(slower * natural, damping) for natural, damping in START_POLES]
            for lag in self.lags():
                tuning = self.meet_requirements(lag, pairs)
                if tuning is not None:
                    value = objective(ClosedLoop(self.points, tuning))
                    if best is not None and value >= best[0]:
                        break
                    best = (value, tuning)
            if best is not None:
                return best[1]
        return None

    def move_weights(self, start: Tuning) -> Tuning:
        """Return the law of the least objective over its lag and its free weights."""
        assert start.law is not None
        target = Target.of(start.law, self.delay)
        bases, points = PredictorBases.of(self.model, target), FrequencyGrid(self.channel)
        weights = np.array(target.weights)
        free = float(np.linalg.norm(weights)) * free_weights(self.model, target)

        def tuning_at(x: Array) -> Tuning:
            moved = tuple((weights + free @ x[1:]).tolist())
            return self.tuning(replace(target, lag_s=target.lag_s * exp(x[0]), weights=moved), bases)

        def cost(x: Array) -> float:
            try:
                closed = ClosedLoop(points, tuning_at(x))
                if closed.unstable_poles:
                    return UNSTABLE
                return objective(closed) + PENALTY * sum(self.missed(closed).values())
            except (InputError, ArithmeticError):
                return UNSTABLE

        size = 1 + free.shape[1]
        simplex = np.vstack([np.zeros(size), np.diag([LOG_LAG_STEP, *[WEIGHT_STEP] * (size - 1)])])
        options = {"maxfev": MAX_EVALUATIONS, "xatol": 1e-4, "fatol": 1e-4, "initial_simplex": simplex}
        found = minimize(cost, np.zeros(size), method="Nelder-Mead", options=options)
        return tuning_at(found.x)


def _late_corners(channel: Channel, need: Requirements) -> list[Channel]:
    """Return the channel at those corners of its tolerances that have a longer delay, as a proof flies them."""
    if not (need.delay_tolerance or need.gain_tolerance):
        return []
    late = channel.with_delay(channel.actuator_delay + floor(need.delay_samples(channel.transport_samples)))
    corners = []
    for gain in (1.0 - need.gain_tolerance, 1.0 + need.gain_tolerance):
        known = late.identified
        other = None if known is None else known.model_copy(update={"gain": gain * known.gain})
        corners.append(replace(late, gain=gain * late.gain, identified=other))
    return corners


def tune_at_limit(channel: Channel, model: RateModel, fixed: Tuning, need: Requirements) -> LimitTuning:
    """Find the law at the limit for the requirements of a channel, or the requirement that prevents it.

    ``model`` is what it believes of the channel, with the delay that the controller adds, ``fixed`` what the law leaves
    as it is.  Raises InputError where the solver is not installed.
    """
    need_solver()
    search = _Search(channel, model, fixed, need)
    start = search.find_start()
    if start is None:
        return LimitTuning(None, inf, _explain_failure(search))
    tuning = search.move_weights(start)
    closed = fine_loop(channel, tuning)
    if not is_acceptable(closed, need):
        return LimitTuning(None, inf, "a requirement is missed between the frequencies that were searched at")
    return LimitTuning(tuning, objective(closed))


def _explain_failure(search: _Search) -> str:
    """Return the single requirement that would have to be relaxed, and to what."""
    ways = []
    for text, names, grows in RELAXABLE:
        for factor in RELAXATIONS:
            changed = {name: getattr(search.need, name) * (factor if grows else 1.0 / factor) for name in names}
            relaxed = search.need.model_copy(update=changed)
            if _Search(search.channel, search.model, search.fixed, relaxed).find_start() is not None:
                ways.append(text.format(**changed))
                break
    return f"it would take {', or '.join(ways)}" if ways else "none of them alone is what stands in the way"
