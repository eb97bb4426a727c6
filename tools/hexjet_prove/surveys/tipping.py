"""How fast over the ground a vehicle may touch down before it tips over its legs: measured by flights.

The vehicle is set down level at hover thrust, on legs that catch (a coefficient of friction of 100), and its throttles
are closed.  A fan's thrust is gone at once, a turbine's carries most of the weight for seconds, in which little holds
the vehicle down.  With the ground's own friction the legs slide, and it tips later or never.
"""

from __future__ import annotations

from functools import cache
from math import acos, cos, inf, radians, sin
from typing import Any

from cosim.base.signals import Actuation
from cosim.control.predictors.registry import BASELINE
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle
from hexjet_prove.surveys.survey import Subject

# Chosen by us: directions of motion relative to the nose, each 45 degrees.
HEADINGS_DEG = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0)  # of motion, relative to the nose
MAX_TIPPING_S = 8.0  # a turbine idles after 3 to 5 s
TIPPED_ANGLE = radians(60.0)  # past any centre of gravity over legs


class _ClosedThrottles:
    """Built-in controller with closed throttles and servos held at their first command."""

    def __init__(self, controller: Any) -> None:
        self._controller = controller
        self._tilt: tuple[float, ...] | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._controller, name)

    def update(self, *arguments: Any) -> Actuation:
        """Return the actuation of one step."""
        demand = self._controller.update(*arguments)
        self._tilt = demand.tilt if self._tilt is None else self._tilt
        return Actuation((0.0,) * len(demand.throttle), self._tilt, demand.unallocated)


@cache
def tip_speed(aircraft: str, engine: str, above_m: float = 0.005) -> float:
    """Return the speed over the ground (m/s) from which a vehicle tips over legs that catch.

    The least of eight headings, in still air, at full weight; found by bisection to 0.02 m/s, infinite if 8 m/s does
    not tip it.  ``aircraft`` is a name or the path of a folder, ``engine`` a name or a file; ``above_m`` is the height
    of the lowest leg at the start; with legs that just touch (0) the speed is less.  Raises InputError.
    """
    subject = Subject(aircraft, load_vehicle(aircraft)[0], engine)
    contacts = [contact.model_dump() for contact in subject.vehicle.contacts]
    legs = [contact for contact in contacts if contact["kind"] == "leg"]
    friction = 100.0  # legs that hold under any load
    for leg in legs:
        leg |= {"friction_static": friction, "friction_dynamic": friction}
    height = max(leg["position_m"][2] for leg in legs) + above_m
    more = {"sensor_noise": False, "vehicle": {"contacts": contacts}}
    scenario = subject.scenario("tipping", BASELINE.name, height, MAX_TIPPING_S, **more)
    fastest_m_s = 8.0  # no faster speed is tried
    slowest = fastest_m_s
    resolution_m_s = 0.02  # resolution of the speed found
    for heading in HEADINGS_DEG:
        if not _tips(scenario, slowest, heading):
            continue
        stands, tips = 0.0, slowest
        while tips - stands > resolution_m_s:
            middle = 0.5 * (stands + tips)
            stands, tips = (stands, middle) if _tips(scenario, middle, heading) else (middle, tips)
        slowest = tips
    return slowest if slowest < fastest_m_s else inf


def _tips(scenario: Scenario, speed: float, heading_deg: float) -> bool:
    """Return whether the vehicle tips over when it is set down at a speed (m/s) in a heading (deg)."""
    heading = radians(heading_deg)
    velocity = (speed * cos(heading), speed * sin(heading), 0.0)
    with build(scenario.replace(initial={"velocity_ned_m_s": velocity})) as simulation:
        simulation.controller = _ClosedThrottles(simulation.controller)
        for _ in range(round(MAX_TIPPING_S / simulation.dt)):
            simulation.step()
            roll, pitch, _ = simulation.state.euler
            if acos(cos(roll) * cos(pitch)) > TIPPED_ANGLE:
                return True
    return False
