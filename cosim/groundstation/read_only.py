"""Publishing of flights that no ground station can change: scripted or recorded ones."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from cosim.base.protocols import EngineState
from cosim.base.signals import Sample
from cosim.control.autopilot.autopilot import Autopilot
from cosim.control.autopilot.estimation.position import Fix
from cosim.control.autopilot.modes import Home, LandedState, Mode
from cosim.control.autopilot.parameters import Parameters, table
from cosim.control.autopilot.requests import Answer, Result
from cosim.control.autopilot.status import Status
from cosim.groundstation.exchange import Exchange, FlightInfo
from cosim.groundstation.session_flight import MIN_PUBLISH_INTERVAL_S, forward_messages, make_flight_info, make_snapshot
from cosim.simulation.pacing import Pace
from cosim.simulation.step import Simulation


class ReadOnlyObserver:
    """Observer that publishes a scripted or recorded flight and refuses every request."""

    def __init__(self, exchange: Exchange, on_begin: Callable[[FlightInfo], None] = lambda info: None) -> None:
        self._exchange = exchange
        self._on_begin = on_begin

    def __call__(
        self, simulation: Simulation, pace: Pace, folder: Path | None, factor: float | None
    ) -> ReadOnlyObserver:
        self._simulation, self._pace = simulation, pace
        self._pilot = pilot = simulation.pilot if isinstance(simulation.pilot, Autopilot) else None
        parameters = pilot.parameters if pilot else _list_parameters(simulation)
        self._info = make_flight_info(simulation, 1, parameters, folder, factor)
        self._last_message, self._last = 0, -1.0
        self._on_begin(self._info)
        return self

    def observe(self, sample: Sample) -> None:
        """Publish the flight after a step, at most at the publishing rate."""
        now = time.monotonic()
        if now - self._last < MIN_PUBLISH_INTERVAL_S:
            return
        self._last = now
        exchange, simulation, pilot = self._exchange, self._simulation, self._pilot
        for waiting in exchange.take_requests(8):
            waiting.answer(Answer(False, Result.DENIED, "this flight follows its script"))
        if pilot is not None:
            self._last_message = forward_messages(pilot, exchange, self._last_message)
        status = scripted_status(simulation, sample) if pilot is None else pilot.status
        mission = tuple(pilot.mission.items) if pilot else ()
        exchange.publish(
            make_snapshot(simulation, self._info, sample, status, self._pace.report, exchange.clock(), None, mission)
        )


def scripted_status(simulation: Simulation, sample: Sample) -> Status:
    """Return an autopilot status for a flight without one: armed, with the script's commands as set-points."""
    measured, command = simulation.measured, sample.command
    return Status(
        k=simulation.k,
        mode=Mode.HOLD,
        armed=True,
        landed=LandedState.ON_GROUND if simulation.state.on_ground else LandedState.IN_AIR,
        engines=EngineState.FLY,
        ready=True,
        refusals=(),
        home=Home(0.0, 0.0, 0.0),
        fix=Fix(measured.position[:2], measured.velocity[:2], (0.0, 0.0)),
        target=None,
        track=None,
        altitude=command.altitude,
        yaw=command.attitude[2],
        mission_count=0,
        mission_current=0,
        mission_reached=-1,
        mission_done=False,
        failsafe="",
        remaining=None,
        sticks_fresh=False,
        link_lost=False,
    )


def _list_parameters(simulation: Simulation) -> Parameters:
    """Return the parameters of the vehicle's autopilot; empty if the vehicle has none."""
    control = simulation.vehicle.control
    if control.position is None or control.pilot is None:
        return Parameters([])
    own = simulation.controller_source
    controller = simulation.scenario.controller if own is None else own.label
    level = "" if own is None else own.level
    return Parameters(table(control, control.pilot, controller, None, level, simulation.vehicle.jets))
