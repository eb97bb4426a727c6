"""How far the controller that flew is from the best that any linear controller could do, axis by axis."""

from __future__ import annotations

from collections.abc import Callable

from cosim.base.errors import FlightError, InputError
from cosim.base.signals import AXES
from cosim.control.predictors.registry import PREDICTORS
from cosim.simulation.build import build
from cosim.simulation.controllers.controller_file import LAW
from cosim.spec.scenario import Scenario
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.criteria import fine_loop
from hexjet_design.loop.limit import AxisLimit
from hexjet_design.loop.programme import need_solver
from hexjet_design.loop.tuning import Tuning
from hexjet_design.measured.computed import find_loop_limit, find_tunings, make_plants


def flown_limits(scenario: Scenario, say: Callable[[str], None] = lambda text: None) -> dict[str, AxisLimit | str]:
    """Compare each axis of the nominal vehicle with the limit of performance, or say why not."""
    loops = _find_loops(scenario)
    if isinstance(loops, str):
        return dict.fromkeys(AXES, loops)
    limits: dict[str, AxisLimit | str] = {}
    for axis, (channel, tuning) in loops.items():
        say(f"limit of {axis}")
        closed = fine_loop(channel, tuning)
        unstable = "the linear loop of the nominal vehicle is not stable"
        limits[axis] = unstable if closed.unstable_poles else find_loop_limit(closed)
    return limits


def _find_loops(scenario: Scenario) -> dict[str, tuple[Channel, Tuning]] | str:
    """Return channel and tuning of each axis, or the reason why they are unknown."""
    chosen = PREDICTORS.get(scenario.controller)
    if scenario.controller != LAW and (chosen is None or chosen.response is None):
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
    return {axis: (plants.channels[axis], tunings[axis]) for axis in AXES}
