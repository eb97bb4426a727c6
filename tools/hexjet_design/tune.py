"""Search for the tuning of one channel: the best response that the requirements allow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import inf, log

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.control.predictors.registry import PREDICTORS
from cosim.simulation.controllers.controller_file import Requirements
from cosim.spec.vehicle import EngineLead, RateModel
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.criteria import FINE_POINTS, excess, fine_loop, is_acceptable, objective
from hexjet_design.loop.tuning import Tuning

UNSTABLE = 1e3  # objective of unstable loops
PENALTY = 100.0  # cost per relative excess, logarithmic
MAX_GENERATIONS = 40  # of the global search
MAX_EVALUATIONS = 200  # of a simplex search
# Largest relative excess over the requirements of a tuning at which a further search may begin.
MAX_EXCESS = 0.02
ROUNDING_POINTS = 1500  # frequencies to round numbers
MIN_DROP = 1e-6  # of the cost, to change a digit
MAX_PASSES = 1000  # rounds over all numbers
# The search keeps requirements by this relative margin, for what lies between its frequencies.
SEARCH_MARGIN = 0.004
PREDICTOR = "predictor."  # prefix of a predictor's parameters


Digits = tuple[int, int]  # digits 100 to 999, power of ten


@dataclass(frozen=True)
class TuningResult:
    """Best tuning of a search; ``objective`` is infinite if infeasible."""

    tuning: Tuning
    objective: float
    evaluations: int


class TuningBounds:
    """Logarithmic search ranges of ``K tau``, ``p k tau``, ``i / p tau``, ``d / (p tau)`` and the predictor.

    ``tau`` is the channel's time scale (mostly its delay at low frequency) and ``k`` its gain there, so one box fits
    every vehicle.  With a lead its poles come last, over the engine's, and ``tau`` is what they leave.
    """

    def __init__(
        self,
        channel: Channel,
        controller: str,
        model: RateModel,
        fixed: Tuning,
        predictor: bool,
        lead: EngineLead | None = None,
    ) -> None:
        self._channel, self._model, self._fixed = channel, model, fixed
        self._lead = lead
        tau = channel.time_scale_s
        ends = [(0.05, 3.0), (0.1, 6.0), (0.003, 1.0), (0.003, 3.0)]
        self._spec = PREDICTORS[controller]
        self._own = self._spec.parameters if predictor else ()
        ends += [knob.search for knob in self._own]
        if lead is not None:
            most = 0.5 / channel.step / lead.natural_rad_s
            # A lead over ten times the engine's poles, or over two steps, adds noise but no phase.
            ends.append((1.0, max(1.1, min(10.0, most))))
        if channel.name == "altitude":
            ends[3] = (0.0, 0.0)  # its controller has no derivative
        self._tau, self._gain, self._size = tau, channel.gain_at_time_scale, len(ends)
        self.free = [k for k, (low, high) in enumerate(ends) if high > low]
        self.low = np.array([log(ends[k][0]) for k in self.free])
        self.high = np.array([log(ends[k][1]) for k in self.free])

    def tuning(self, x: Array) -> Tuning:
        """Return the tuning at a point ``x`` of the bounds."""
        value = np.zeros(self._size)
        value[self.free] = np.exp(np.clip(x, self.low, self.high))
        tau, lead = self._tau, self._lead
        if lead is not None:
            lead = lead.model_copy(update={"pole_rad_s": float(value[-1]) * lead.natural_rad_s})
            # A zero of the engine may be worth more than the remaining lag.
            tau = max(tau + lead_delay(lead), (0.5 + self._channel.transport_samples) * self._channel.step)
            tau = max(tau, 1.0 / lead.pole_rad_s)
        k, p, i, d = value[:4] * np.array([1.0 / tau, 1.0 / (self._gain * tau), 1.0 / tau, tau])
        firmware = self._fixed.firmware
        predictor_values = {
            knob.name: float(x) * knob.scale(tau) for knob, x in zip(self._own, value[4:], strict=False)
        }
        predictor = self._spec.tuned(self._fixed.predictor, predictor_values)
        smooth = _choose_filter_s(float(d), self._channel.step) if d else self._fixed.gains.d_filter_s
        if firmware is not None:
            smooth, k = firmware.smooth(smooth), firmware.angle_gain or k
        gains = self._fixed.gains.model_copy(
            update={"p": float(p), "i": float(p * i), "d": float(p * d), "d_filter_s": smooth}
        )
        return Tuning(self._spec.name, float(k), gains, predictor, self._model, lead, firmware)


def lead_delay(lead: EngineLead) -> float:
    """Return the delay at low frequency that a lead adds, s, which is negative."""
    if lead.damping is None:
        return 1.0 / lead.pole_rad_s - 1.0 / lead.natural_rad_s
    return 2.0 / lead.pole_rad_s - 2.0 * lead.damping / lead.natural_rad_s


def tune(
    channel: Channel,
    controller: str,
    model: RateModel,
    fixed: Tuning,
    need: Requirements,
    predictor: bool = True,
    lead: EngineLead | None = None,
) -> TuningResult:
    """Find the tuning with the least objective that keeps the requirements.

    Deterministic: differential evolution from a Sobol sequence with a fixed seed, then Nelder and Mead's simplex, with
    what is missed added to the objective.  ``fixed`` holds what is not searched: without ``predictor``, its tuning too.
    With ``lead`` there is one, whose own poles are searched.
    """
    from scipy.optimize import differential_evolution

    bounds = TuningBounds(channel, controller, model, fixed, predictor, lead)
    points = FrequencyGrid(channel)
    count = 0
    feasible: tuple[float, Array | None] = (inf, None)  # best point that met all requirements

    def cost(x: Array) -> float:
        nonlocal count, feasible
        count += 1
        try:
            closed = ClosedLoop(points, bounds.tuning(x))
            if closed.unstable_poles:
                return UNSTABLE + float(np.sum(x))  # slope towards smaller gains
            out = float(np.sum(np.maximum(x - bounds.high, 0.0) + np.maximum(bounds.low - x, 0.0)))
            value, missed = objective(closed), excess(closed, need, SEARCH_MARGIN) + out
        except (InputError, ValueError, ArithmeticError):
            # A predictor with an unstable response is not feasible.
            return UNSTABLE + float(np.sum(x))
        if not missed and value < feasible[0]:
            feasible = (value, x.copy())
        return value + PENALTY * missed

    searched = differential_evolution(
        cost,
        list(zip(bounds.low, bounds.high, strict=True)),
        popsize=6,
        maxiter=MAX_GENERATIONS,
        init="sobol",
        # A fixed seed makes designs repeatable.
        rng=np.random.default_rng(1),
        polish=False,
        tol=1e-4,
    )
    x = _descend(cost, searched.x, float(searched.fun))
    fine = FrequencyGrid(channel, close=FINE_POINTS)
    for point in (x, feasible[1]):
        if point is not None:
            closed = ClosedLoop(fine, bounds.tuning(point))
            if is_acceptable(closed, need):
                return TuningResult(closed.tuning, objective(closed), count)
    return TuningResult(bounds.tuning(x), inf, count)


def _descend(cost: Callable[[Array], float], x: Array, value: float) -> Array:
    """Return the best point of Nelder and Mead's simplex from ``x``, whose cost is ``value``."""
    from scipy.optimize import minimize

    # A simplex that collapsed at a bound is restarted.
    for size in (0.1, 0.03):
        simplex = np.vstack([x, x + size * np.eye(len(x))])
        options = {"maxfev": MAX_EVALUATIONS, "xatol": 1e-3, "fatol": 1e-4, "initial_simplex": simplex}
        optimum = minimize(cost, x, method="Nelder-Mead", options=options)
        if optimum.fun < value:
            x, value = optimum.x, float(optimum.fun)
    return x


def _cost(closed: ClosedLoop, need: Requirements) -> float:
    """Return a loop's objective with a penalty for missed requirements."""
    return objective(closed) + PENALTY * excess(closed, need, SEARCH_MARGIN) if not closed.unstable_poles else UNSTABLE


def tune_digits(
    channel: Channel, start: Tuning, need: Requirements, predictor: bool = True, level: bool = False
) -> Tuning | None:
    """Find the tuning of three-digit numbers near ``start`` that no change of a last digit improves.

    More digits are not meant, and where the optimum is flat a search does not tell them from its own error: what is
    written down is where this descent stops, and from there it stops at once.  None where no such tuning near
    ``start`` keeps the requirements.  At a ``level`` of a schedule only what follows the level is changed.
    """
    points = FrequencyGrid(channel, close=ROUNDING_POINTS)
    firmware = start.firmware
    if firmware is not None and firmware.units is not None:
        return _tune_integers(channel, start, need)

    def cost(values: Mapping[str, Digits]) -> float:
        return _cost(ClosedLoop(points, _apply_digits(start, values, channel.step, level)), need)

    values = {name: digits(value) for name, value in _search_values(start, predictor and not level).items()}
    best = cost(values)
    for _ in range(MAX_PASSES):
        moved = False
        for name in values:
            for way in (1, -1):
                trial = {**values, name: _next_digits(values[name], way)}
                if (value := cost(trial)) < best - MIN_DROP:
                    values, best, moved = trial, value, True
        if not moved:
            break
    tuning = _apply_digits(start, values, channel.step, level)
    return tuning if is_acceptable(fine_loop(channel, tuning), need) else None


def _tune_integers(channel: Channel, start: Tuning, need: Requirements) -> Tuning | None:
    """Improve the integer gains of an autopilot as :func:`tune_digits`, by steps of one in one or two of them.

    They are coarse for a slow vehicle, so the nearest ones may miss what was searched: what is missed comes first.
    """
    points, firmware = FrequencyGrid(channel, close=ROUNDING_POINTS), start.firmware
    assert firmware is not None
    names = [name for name in ("angle_gain", "p", "i", "d") if not (name == "angle_gain" and firmware.angle_gain)]
    units = {name: firmware.unit(name) or 1.0 for name in names}
    gains = start.gains
    gain_values = {"angle_gain": start.angle_gain, "p": gains.p, "i": gains.i, "d": gains.d}

    def tuning_at(values: Mapping[str, int]) -> Tuning:
        scaled = {name: values[name] * units[name] for name in names}
        angle = scaled.pop("angle_gain", start.angle_gain)
        return replace(start, angle_gain=angle, gains=gains.model_copy(update=scaled))

    def cost(values: Mapping[str, int]) -> float:
        return _cost(ClosedLoop(points, tuning_at(values)), need)

    values = {name: min(max(1, round(gain_values[name] / units[name])), firmware.max_gain) for name in names}
    ways = [{name: way} for name in names for way in (1, -1)]
    ways += [{a: x, b: y} for k, a in enumerate(names) for b in names[k + 1 :] for x in (1, -1) for y in (1, -1)]
    best = cost(values)
    for _ in range(MAX_PASSES):
        moved = False
        for way in ways:
            trial = {**values, **{name: values[name] + by for name, by in way.items()}}
            if all(1 <= trial[name] <= firmware.max_gain for name in way) and (value := cost(trial)) < best - MIN_DROP:
                values, best, moved = trial, value, True
        if not moved:
            break
    tuning = tuning_at(values)
    return tuning if is_acceptable(fine_loop(channel, tuning), need) else None


def tune_near(
    channel: Channel, start: Tuning, need: Requirements, predictor: bool = True, level: bool = False
) -> Tuning | None:
    """Find the three-digit tuning by a simplex from ``start``, or rounded ``start`` if not worse.

    So a second call finds what the first one did.  None where nothing near ``start`` keeps the requirements.
    """
    points = FrequencyGrid(channel)
    names = list(_search_values(start, predictor and not level))

    def tuning_at(x: Array) -> Tuning:
        value = dict(zip(names, np.exp(x), strict=True))
        return _apply_values(start, {name: float(number) for name, number in value.items()}, channel.step, level)

    def cost(x: Array) -> float:
        return _cost(ClosedLoop(points, tuning_at(x)), need)

    x = np.log([_search_values(start, True)[name] for name in names])
    x = _descend(cost, x, cost(x))
    there = tune_digits(channel, tuning_at(x), need, predictor, level)
    # Far from the requirements, rounding digit by digit would take long.
    fine = FrequencyGrid(channel, close=FINE_POINTS)
    here = (
        tune_digits(channel, start, need, predictor, level)
        if excess(ClosedLoop(fine, start), need) < MAX_EXCESS
        else None
    )
    if here is None or there is None:
        return here or there
    # Improvement of the objective below which a restart is useless: a search from its own answer gains this much.
    negligible = 0.003
    return there if objective(ClosedLoop(fine, there)) < objective(ClosedLoop(fine, here)) - negligible else here


def digits(value: float) -> Digits:
    """Round a positive number to three digits: 100 to 999 and a power of ten."""
    mantissa, _, power = f"{value:.2e}".partition("e")
    return int(mantissa.replace(".", "")), int(power) - 2


def _to_float(number: Digits) -> float:
    return float(f"{number[0]}e{number[1]}")


def _next_digits(number: Digits, way: int) -> Digits:
    """Return the next number of three digits, up or down."""
    figures, power = number[0] + way, number[1]
    if figures == 1000:
        return 100, power + 1
    return (999, power - 1) if figures == 99 else (figures, power)


def _search_values(tuning: Tuning, predictor: bool) -> dict[str, float]:
    """Return the numbers that are searched on a channel, by name; a part that is 0 is absent and stays so."""
    gains = tuning.gains
    values = {"angle_gain": tuning.angle_gain, "p": gains.p, "i": gains.i, "d": gains.d}
    if tuning.firmware is not None and tuning.firmware.angle_gain is not None:
        del values["angle_gain"]  # another axis has chosen it already
    if predictor:
        parameters = PREDICTORS[tuning.controller].own(tuning.predictor)
        values |= {PREDICTOR + name: value for name, value in parameters.items()}
    if tuning.lead is not None:
        values["pole_rad_s"] = tuning.lead.pole_rad_s
    return {name: value for name, value in values.items() if value > 0.0}


def _apply_digits(start: Tuning, values: Mapping[str, Digits], step: float, level: bool) -> Tuning:
    """Return ``start`` with searched numbers replaced by three-digit ones."""
    tuning = _apply_values(start, {name: _to_float(number) for name, number in values.items()}, step, level)
    smooth = _to_float(digits(tuning.gains.d_filter_s))
    if tuning.firmware is not None:
        smooth = tuning.firmware.smooth(smooth)
    return tuning if level else replace(tuning, gains=tuning.gains.model_copy(update={"d_filter_s": smooth}))


def _apply_values(start: Tuning, value: Mapping[str, float], step: float, level: bool) -> Tuning:
    """Return ``start`` with searched numbers replaced."""
    gains: dict[str, float] = {name: value[name] for name in ("p", "i", "d") if name in value}
    if "d" in gains and not level:
        gains["d_filter_s"] = _choose_filter_s(gains["d"] / gains["p"], step)
        if start.firmware is not None:
            gains["d_filter_s"] = start.firmware.smooth(gains["d_filter_s"])
    predictor_values = {
        name.removeprefix(PREDICTOR): value_of for name, value_of in value.items() if name.startswith(PREDICTOR)
    }
    predictor, lead = PREDICTORS[start.controller].tuned(start.predictor, predictor_values), start.lead
    if lead is not None and "pole_rad_s" in value:
        lead = lead.model_copy(update={"pole_rad_s": value["pole_rad_s"]})
    return replace(
        start,
        angle_gain=value.get("angle_gain", start.angle_gain),
        gains=start.gains.model_copy(update=gains),
        predictor=predictor,
        lead=lead,
    )


def _choose_filter_s(leads_by: float, step: float) -> float:
    """Return the derivative's filter, s: a tenth of what the derivative leads by, but at least a step."""
    return max(step, 0.1 * leads_by)
