"""How far the controller that flew is from the best that any linear controller could do, axis by axis."""

from __future__ import annotations

from collections.abc import Callable

from cosim.base.errors import FlightError, InputError
from cosim.base.signals import AXES
from cosim.control.predictors.registry import PREDICTORS
from cosim.design.loop.limit import AxisLimit, need_solver
from cosim.design.measured.computed import find_loop_limit, find_tunings, make_plants
from cosim.design.tune import fine_loop
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario


def flown_limits(scenario: Scenario, say: Callable[[str], None] = lambda text: None) -> dict[str, AxisLimit] | str:
    """Return each axis of the nominal vehicle beside the limit of performance, by axis; or why there is none.

    An axis whose loop has no such limit is left out.
    """
    chosen = PREDICTORS.get(scenario.controller)
    if chosen is None or chosen.response is None:
        return "the controller is not one whose linear loop is known"
    try:
        need_solver()
        with build(scenario) as simulation:
            vehicle, spec = simulation.vehicle, simulation.engine
        plants = make_plants(scenario, vehicle, spec)
    except (InputError, FlightError) as error:
        return str(error)
    if isinstance(plants, str):
        return plants
    tunings = find_tunings(plants, scenario, vehicle, AXES)
    limits: dict[str, AxisLimit] = {}
    reasons: list[str] = []
    for axis in AXES:
        say(f"limit of {axis}")
        closed = fine_loop(plants.channels[axis], tunings[axis])
        if closed.unstable_poles:
            return f"{axis}: the linear loop of the nominal vehicle is not stable"
        limit = find_loop_limit(closed)
        if isinstance(limit, AxisLimit):
            limits[axis] = limit
        else:
            reasons.append(limit)
    return limits or "; ".join(dict.fromkeys(reasons))
