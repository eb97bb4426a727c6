"""Flights of the autopilot, asked as a ground station asks."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from math import hypot
from typing import Any, Self

from cosim.base.signals import Sample
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.autopilot import Autopilot
from cosim.control.autopilot.modes import Mode
from cosim.simulation.autopilot_setup import attach_autopilot
from cosim.simulation.build import build
from cosim.simulation.ending import Ending
from cosim.simulation.step import Simulation
from cosim.spec.scenario import Scenario


class Asked:
    """A simulation with an autopilot that is asked things."""

    simulation: Simulation
    pilot: Autopilot

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.simulation.close()

    def ask(self, request: Any) -> rq.Answer:
        return self.pilot.handle(request, self.simulation.k)

    def ok(self, *requests: Any) -> None:
        for request in requests:
            answer = self.ask(request)
            assert answer.accepted, (request, answer)


class Flight(Asked):
    """A flight of an autopilot, step by step."""

    def __init__(self, airborne: bool = False, **changes: Any) -> None:
        base: dict[str, Any] = {
            "name": "test",
            "duration_s": 400.0,
            "engine": "edf-as-flown",
            "controller": "smith",
            "initial": {"on_ground": not airborne, "altitude_m": 10.0},
        }
        scenario = Scenario.from_table(base | changes, Scenario.load("hover").folder, "test")
        self.simulation = build(scenario)
        self.pilot = attach_autopilot(self.simulation, airborne)
        self.samples: list[Sample] = []
        self.ending: Ending | None = None

    @property
    def now(self) -> float:
        return self.simulation.k * self.simulation.dt

    def fly(self, seconds: float, until: Callable[[], bool] | None = None, every: Any = None) -> None:
        """Step on; ``every``: a request repeated ten times a second, as a ground station does with sticks."""
        simulation = self.simulation
        for n in range(round(seconds / simulation.dt)):
            if every is not None and n % round(0.1 / simulation.dt) == 0:
                self.ok(every)
            self.samples.append(simulation.step())
            self.ending = simulation.termination.check(simulation.state, self.now)
            if self.ending or (until and until()):
                return
        assert until is None, f"not within {seconds} s: {self.pilot.status}"

    def take_off(self, height: float) -> None:
        self.fly(1.1)
        self.ok(rq.Arm(), rq.Takeoff(height))
        self.fly(40.0, lambda: self.pilot.mode is Mode.HOLD)

    def away(self, north: float, east: float) -> float:
        """Distance of the true position from a place, m."""
        x, y, _ = self.simulation.state.position
        return hypot(x - north, y - east)

    def descent(self, since: int) -> float:
        """The fastest sinking in the step before a leg touches, m/s."""
        states = [sample.state for sample in self.samples[since:]]
        touches = [a.velocity[2] for a, b in itertools.pairwise(states) if b.on_ground and not a.on_ground]
        return max(touches, default=0.0)
