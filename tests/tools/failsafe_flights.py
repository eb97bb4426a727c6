"""Flights in which a failsafe acts, to the ground."""

from __future__ import annotations

from typing import Any

from pilot_flights import Asked

from cosim.campaign import failsafe_survey as table
from cosim.campaign.fault_survey import step_of
from cosim.control.autopilot import requests as rq
from cosim.simulation.build import build
from cosim.simulation.with_autopilot import with_autopilot
from cosim.spec.vehicle import load_vehicle


class Flight(Asked):
    """A hover in still air over the ground, with an autopilot that is asked things."""

    def __init__(self, aircraft: str = "hexjet", height: float = 3.0, **changes: Any) -> None:
        vehicle = load_vehicle(aircraft)[0]
        engine = vehicle.engine or "edf-as-flown"
        scenario = table.scenario_of(aircraft, engine, "smith", step_of(aircraft), height, 0.0).replace(**changes)
        self.simulation = build(scenario)
        self.pilot = with_autopilot(self.simulation, airborne=not scenario.initial.on_ground)
        self.ok(rq.SetParameter("SYS_FAILURE_EN", 1.0))

    def fly(self, seconds: float, until: Any = None) -> float:
        """Step on; the thrust of the last step, N."""
        thrust = 0.0
        for _ in range(round(seconds / self.simulation.dt)):
            thrust = sum(self.simulation.step().engines.thrust)
            assert self.simulation.judge.look(self.simulation.state, 0.0) is None
            if until is not None and until():
                return thrust
        assert until is None, f"not within {seconds} s: {self.pilot.status}"
        return thrust
