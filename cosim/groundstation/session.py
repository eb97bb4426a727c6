"""Sessions of a vehicle that waits for a ground station: flights one after the other, flown by requests.

The flight runs in the calling thread, paced by the clock; links and the local page run in threads of their own and
meet it in an :class:`cosim.groundstation.exchange.Exchange`.  Nothing that they do can hold up a step for longer
than Python takes to change threads.
"""

from __future__ import annotations

import gc
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.base.errors import FlightError, InputError
from cosim.base.protocols import Observer
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.modes import LandedState, Severity
from cosim.control.autopilot.parameters import Caution
from cosim.flight import reserve_folder
from cosim.groundstation.exchange import Exchange, FlightInfo, PendingRequest, Restart, Shutdown
from cosim.groundstation.parameter_guard import (
    ParameterGuard,
    ParameterWriter,
    StabilityChecker,
    describe_saved,
    find_refusal,
    report_cautions,
    report_saved,
)
from cosim.groundstation.parameter_store import make_vehicle_key
from cosim.groundstation.session_flight import MAX_LOG_MB, Publisher, SessionFlight, forward_messages, make_flight_info
from cosim.results.run import REQUESTS, Run, claim_folder
from cosim.simulation.autopilot_setup import attach_autopilot
from cosim.simulation.build import build
from cosim.simulation.ending import Ending
from cosim.simulation.pacing import Pace
from cosim.spec.scenario import Scenario

# Chosen by us: a request takes about 10 us, a new predictor 3 ms, and stepping takes a tenth of a step's 4 ms.
_MAX_REQUESTS_PER_STEP = 8


@dataclass(frozen=True)
class RecordOptions:
    """Folder, log size and report of the flights of a session.

    ``out``: the first run's folder, or None for new ones in ``runs/``; a restart goes to the next of ``OUT-2``,
    ``OUT-3``... that is free.  ``log_mb``: of each flight's log at most, None without a limit.
    """

    out: Path | None = None
    report: bool = True
    log_mb: float | None = MAX_LOG_MB


class Session:
    """Session of flights on request, each recorded in its own folder.

    ``factor``: of real time, None as fast as it goes.  ``parameter_file``: a TOML file that parameters are read
    from, and written to whenever one is changed.  ``duration`` [s of flight] ends the session; without it :meth:`stop`
    does.  ``on_begin`` is called when a flight's folder is there, ``on_end`` when a flight is done with.
    Raises InputError for a scenario that cannot be flown, and for a file of parameters that cannot be used.
    """

    def __init__(
        self,
        scenario: Scenario,
        exchange: Exchange,
        *,
        factor: float | None = 1.0,
        parameter_file: Path | None = None,
        duration: float | None = None,
        records: RecordOptions = RecordOptions(),
        on_begin: Callable[[FlightInfo], None] = lambda info: None,
        on_end: Callable[[], None] = lambda: None,
    ) -> None:
        self.scenario = make_ground_scenario(scenario, duration)
        self.exchange = exchange
        self.factor = factor
        self.duration = duration
        self.runs: list[Run] = []
        self._records = records
        self._on_begin, self._on_end = on_begin, on_end
        self._parameters = ParameterWriter(
            parameter_file, make_vehicle_key(scenario), lambda text: exchange.say(Severity.WARNING, text)
        )
        self._guard = ParameterGuard()
        self._stopping = ""
        self._restart = False
        self._folder_number = 1  # suffix of the last folder
        # The first flight is built here, so that wrong input is reported before a link opens.
        self._next: SessionFlight | None = self._build_flight()

    @property
    def info(self) -> FlightInfo:
        """Constant data of the flight that is about to begin."""
        assert self._next is not None
        return self._next.info

    @property
    def parameter_file(self) -> Path | None:
        """File of the saved parameters; None: they are kept for the session only."""
        return self._parameters.path

    def set_stability_checker(self, checker: StabilityChecker) -> None:
        """Set the checker of parameter changes; without one all changes are accepted."""
        self._guard.checker = checker

    def describe_saved(self) -> list[str]:
        """Describe the saved parameters: changes from the defaults and their effect on stability."""
        return describe_saved(self._guard.checker, self.info.parameters, self._parameters.values)

    def stop(self, why: str) -> None:
        """End the session after the present step; may be called from any thread or signal handler."""
        self._stopping = self._stopping or why

    def run(self) -> list[Run]:
        """Fly until stopped, and return the runs, each with its files in place."""
        try:
            return self._fly_all()
        finally:
            self._parameters.close()
            self._guard.close()

    def _fly_all(self) -> list[Run]:
        while True:
            flight = self._next or self._build_flight()
            self._next = None
            try:
                ending = self._fly(flight)
                if ending.outcome != "completed":
                    self._serve_after_end(flight, ending)
            finally:
                self._on_end()
                flight.close()
            if not self._restart:
                return self.runs
            self._restart = False

    def _build_flight(self) -> SessionFlight:
        """Build the next flight and claim its folder."""
        number = len(self.runs) + 1
        simulation = build(self.scenario)
        try:
            pilot = attach_autopilot(simulation)
            info = make_flight_info(simulation, number, pilot.parameters, self._claim_run_folder(number), self.factor)
        except BaseException:
            simulation.close()
            raise
        return SessionFlight(simulation, pilot, info, Pace(simulation.dt, self.factor), self.exchange)

    def _claim_run_folder(self, number: int) -> Path:
        """Return a run's folder; the first is created at once, so that errors are reported before links open."""
        if self._records.out is None:
            return reserve_folder(Path("runs"), f"gcs-{self.scenario.aircraft_name}")
        if number == 1:
            claim_folder(self._records.out)
            return self._records.out
        # Existing folders are skipped, because a vehicle must be able to reboot.
        self._folder_number = max(number, self._folder_number + 1)
        while (folder := self._records.out.with_name(f"{self._records.out.name}-{self._folder_number}")).exists():
            self._folder_number += 1
        return folder

    def _fly(self, flight: SessionFlight) -> Ending:
        simulation, exchange = flight.simulation, self.exchange
        recording = flight.begin(self._records.log_mb)
        assert flight.pilot_record is not None
        # Refuse queued requests, which were meant for the previous flight.
        while flight.info.number > 1 and (late := [*self._guard.take_remaining(), *exchange.take_requests(1)]):
            for waiting in late:
                waiting.answer(rq.Answer(False, rq.Result.TEMPORARILY_REJECTED, "a new flight begins"))
        self._parameters.restore(flight.set_parameter)
        self._on_begin(flight.info)
        exchange.say(Severity.INFO, f"flight {flight.info.number}: {flight.info.vehicle.name}")
        parameters = flight.pilot.parameters
        report_saved(exchange.say, self._guard.checker, parameters, parameters.changed())
        flight.publish(None, None)
        # Prepare after every file was opened, because loading a library may change the current folder.
        self._guard.prepare()
        with steady_timing():
            started = time.perf_counter()
            try:
                observers: list[Observer] = [recording, flight.pilot_record, Publisher(flight)]
                observers += simulation.plugins.observers
                ending = simulation.run(observers, flight.pace, lambda k: self._handle_requests(flight, k))
                simulation.plugins.close()
            except FlightError as error:  # for example a full disk
                ending = Ending("failed", str(error))
            wall = time.perf_counter() - started
        flight.last_message = forward_messages(flight.pilot, exchange, flight.last_message)
        if ending.outcome == "completed":
            exchange.say(Severity.INFO, f"flight over: {ending.reason}", simulation.k)
        else:
            exchange.say(Severity.CRITICAL, f"{ending.outcome}: {ending.reason}"[:200], simulation.k)
            exchange.say(Severity.NOTICE, "the flight is over; reboot the vehicle for a new one", simulation.k)
        flight.publish(None, ending)
        self.runs.append(flight.finish(ending, wall, self._records.report))
        return ending

    def _handle_requests(self, flight: SessionFlight, k: int, request_s: float = 0.5e-3) -> Ending | None:
        """Handle a limited number of requests between steps; return the flight's ending if one was requested."""
        if self._stopping:
            in_air = flight.pilot.armed and flight.pilot.status.landed is not LandedState.ON_GROUND
            return Ending("completed", f"{self._stopping}{' in the air' if in_air else ''}")
        until = 0.0
        for _ in range(_MAX_REQUESTS_PER_STEP):
            taken = self.exchange.take_requests(1)
            if not taken:
                break
            until = until or time.perf_counter() + request_s
            for waiting in taken:
                if not self._guard.defer(waiting):
                    waiting.answer(self._execute(flight, waiting, k))
            if time.perf_counter() > until:
                break
        for waiting, cautions in self._guard.take_verdicts(flight.pilot.parameters, self.exchange.clock()):
            waiting.answer(self._execute_checked(flight, waiting, cautions, k))
        return Ending("completed", "a restart was requested") if self._restart else None

    def _execute(self, flight: SessionFlight, waiting: PendingRequest, k: int) -> rq.Answer:
        request = waiting.request
        if isinstance(request, (Restart, Shutdown)):
            return self._end_or_restart(request, waiting.sender, flight.pilot.armed)
        try:
            answer = flight.ask(waiting.sender, request, k)
        except FlightError as error:
            waiting.answer(rq.Answer(False, rq.Result.FAILED, str(error)))
            raise
        if isinstance(request, rq.SetParameter) and answer.accepted:
            self._parameters.save(flight.pilot.parameters.changed())
        elif isinstance(request, (rq.MissionUpload, rq.MissionClear)):
            # Publish at once, because a client may read the mission back right after the answer.
            flight.publish(None, None)
        return answer

    def _execute_checked(
        self, flight: SessionFlight, waiting: PendingRequest, cautions: list[Caution] | None, k: int
    ) -> rq.Answer:
        """Make a parameter change after its check and report its cautions, or refuse and record it."""
        request, pilot = waiting.request, flight.pilot
        assert isinstance(request, rq.SetParameter)
        in_air = pilot.armed and pilot.status.landed is not LandedState.ON_GROUND
        if why := find_refusal(request, cautions, in_air, pilot.parameters.values):
            self.exchange.say(Severity.ERROR, why, k)
            answer = rq.Answer(False, rq.Result.TEMPORARILY_REJECTED, why)
            flight.refuse(waiting.sender, request, answer, k)
            return answer
        answer = self._execute(flight, waiting, k)
        if answer.accepted:
            report_cautions(self.exchange.say, request, cautions, k)
        return answer

    def _end_or_restart(self, request: Restart | Shutdown, sender: str, is_armed: bool) -> rq.Answer:
        if is_armed:
            what = "restart" if isinstance(request, Restart) else "shutdown"
            return rq.Answer(False, rq.Result.TEMPORARILY_REJECTED, f"{what} refused: it is armed")
        if isinstance(request, Restart):
            self._restart = True
        else:
            self.stop(f"shut down by {sender}")
        return rq.Answer(True, rq.Result.ACCEPTED, "")

    def _serve_after_end(self, flight: SessionFlight, ending: Ending, poll_s: float = 0.02) -> None:
        """Answer requests after the end of a flight, until a restart or the session's end."""
        exchange = self.exchange
        deadline = None
        if self.duration is not None:
            left = max(0.0, self.duration - flight.simulation.k * flight.simulation.dt)
            deadline = time.monotonic() + (left / self.factor if self.factor else 0.0)
        while not (self._restart or self._stopping) and (deadline is None or time.monotonic() < deadline):
            for waiting in [w for w in exchange.take_requests(_MAX_REQUESTS_PER_STEP) if not self._guard.defer(w)]:
                answer = rq.Answer(False, rq.Result.FAILED, f"the flight is over: {ending.reason}")
                if isinstance(waiting.request, (Restart, Shutdown)):
                    answer = self._end_or_restart(waiting.request, waiting.sender, is_armed=False)
                elif isinstance(waiting.request, rq.SetParameter):
                    answer = self._set_for_next_flight(flight, waiting.request, [])
                waiting.answer(answer)
            for waiting, cautions in self._guard.take_verdicts(flight.pilot.parameters, exchange.clock()):
                assert isinstance(waiting.request, rq.SetParameter)
                waiting.answer(self._set_for_next_flight(flight, waiting.request, cautions))
            flight.publish(None, ending)
            time.sleep(poll_s)

    def _set_for_next_flight(
        self, flight: SessionFlight, request: rq.SetParameter, cautions: list[Caution] | None
    ) -> rq.Answer:
        """Set a parameter for the next flight after the end of this one."""
        if why := find_refusal(request, cautions, False, {}):
            return rq.Answer(False, rq.Result.TEMPORARILY_REJECTED, why)
        answer = flight.pilot.handle(request, flight.simulation.k)
        if answer.accepted:
            self._parameters.save(flight.pilot.parameters.changed())
            value = flight.pilot.parameters[request.name]
            self.exchange.say(Severity.NOTICE, f"{request.name} {value:g} from the next flight on")
            report_cautions(self.exchange.say, request, cautions, flight.simulation.k)
        return answer


def make_ground_scenario(scenario: Scenario, duration: float | None, longest_s: float = 86_400.0) -> Scenario:
    """Return the scenario with the vehicle on the ground and an autopilot in place of commands.

    ``longest_s``: of a flight without a planned end, a day.
    """
    watched = scenario.resolved_vehicle()[0].control.monitor
    heading = scenario.initial.attitude_deg[2]
    still = (0.0, 0.0, 0.0)
    return scenario.replace(
        command=[],
        expect=[],
        requests=REQUESTS,
        monitor=scenario.monitored if watched is None else True,
        duration_s=round(longest_s / scenario.step_s) * scenario.step_s if duration is None else duration,
        initial={
            "on_ground": True,
            "engines": "off",
            "attitude_deg": (0.0, 0.0, heading),
            "velocity_ned_m_s": still,
            "rate_deg_s": still,
        },
    )


def parse_place(text: str) -> dict[str, float]:
    """Parse ``LAT,LON`` [deg] into keys of a scenario's environment.  Raises InputError."""
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"place {text}: must be LAT,LON in degrees, such as 22.35,113.59") from error
    return {"latitude_deg": latitude, "longitude_deg": longitude}


@contextmanager
def steady_timing(switch_s: float = 0.5e-3) -> Iterator[None]:
    """Avoid pauses of a paced flight: no long garbage collections, short thread switch interval.

    ``switch_s``: after which a busy thread is switched; Python's 5 ms are longer than a step.
    """
    previous = sys.getswitchinterval()
    sys.setswitchinterval(switch_s)
    gc.collect()
    gc.freeze()  # existing objects are not searched
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(previous)


@contextmanager
def stop_on_signals(session: Session) -> Iterator[None]:
    """End the session in order on Ctrl-C or SIGTERM; a second signal ends the process at once."""
    previous: dict[int, Any] = {}

    def restore_handlers() -> None:
        for caught, handler in previous.items():
            signal.signal(caught, handler)

    def request_stop(number: int, frame: object) -> None:
        session.stop(f"stopped by {signal.Signals(number).name}")
        restore_handlers()

    for number in (signal.SIGINT, signal.SIGTERM):
        previous[number] = signal.signal(number, request_stop)
    try:
        yield
    finally:
        restore_handlers()
