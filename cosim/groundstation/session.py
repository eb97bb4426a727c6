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
from cosim.control.autopilot.modes import LandedState, Severity
from cosim.control.autopilot.parameters import Caution
from cosim.control.autopilot.requests import (
    Answer,
    MissionClear,
    MissionUpload,
    Result,
    SetParameter,
)
from cosim.flight import reserve_folder
from cosim.groundstation.exchange import Exchange, Restart, SessionInfo, Shutdown, Waiting
from cosim.groundstation.log_limit import LIMIT_MB
from cosim.groundstation.parameter_guard import (
    Judge,
    ParameterGuard,
    ParameterWriter,
    kept_lines,
    refusal,
    tell,
    warn_of,
)
from cosim.groundstation.parameter_store import vehicle_key
from cosim.groundstation.session_flight import Publisher, SessionFlight, pass_on, session_info
from cosim.results.autopilot.request_log import REQUESTS
from cosim.results.run import Run, claim_folder
from cosim.simulation.build import build
from cosim.simulation.ending import Ending
from cosim.simulation.pacing import Pace
from cosim.simulation.with_autopilot import with_autopilot
from cosim.spec.scenario import Scenario

LONGEST_S = 86_400.0  # of one flight that has no planned end: a day
# Chosen by us: a request costs some 10 us, a new predictor 3 ms, a step has 4 ms of which stepping takes a tenth.
_MOST_A_STEP = 8  # requests
_REQUEST_TIME = 0.5e-3  # s of a step after which the next request waits for the next step
_SWITCH = 0.5e-3  # s after which a thread that computes gives way; Python's 5 ms are longer than a step
_OVER_EVERY = 0.02  # s between two looks at what is asked after the end of a flight


@dataclass(frozen=True)
class RecordOptions:
    """Where and how the flights of a session are recorded.

    ``out``: the first run's folder, or None for new ones in ``runs/``; a restart goes to the next of ``OUT-2``,
    ``OUT-3``... that is free.  ``log_mb``: of each flight's log at most, None without a limit.
    """

    out: Path | None = None
    report: bool = True
    log_mb: float | None = LIMIT_MB


class Session:
    """Flights on request, each recorded in a folder of its own.

    ``factor``: of real time, None as fast as it goes.  ``parameters``: a TOML file that parameters are read from, and
    written to whenever one is changed.  ``duration`` [s of flight] ends the session; without it :meth:`stop` does.
    ``begun`` is called when a flight's folder is there, ``over`` when a flight is done with.
    Raises InputError for a scenario that cannot be flown, and for a file of parameters that cannot be used.
    """

    def __init__(
        self,
        scenario: Scenario,
        exchange: Exchange,
        *,
        factor: float | None = 1.0,
        parameters: Path | None = None,
        duration: float | None = None,
        records: RecordOptions = RecordOptions(),
        begun: Callable[[SessionInfo], None] = lambda facts: None,
        over: Callable[[], None] = lambda: None,
    ) -> None:
        self.scenario = waiting_scenario(scenario, duration)
        self.exchange = exchange
        self.factor = factor
        self.duration = duration
        self.runs: list[Run] = []
        self._records = records
        self._begun, self._over = begun, over
        self._parameters = ParameterWriter(
            parameters, vehicle_key(scenario), lambda text: exchange.say(Severity.WARNING, text)
        )
        self._guard = ParameterGuard()
        self._stopping = ""
        self._restart = False
        self._numbered = 1  # of the last folder beside ``out``
        self._next: SessionFlight | None = self._build()  # what is wrong with the input is said before any link opens

    @property
    def facts(self) -> SessionInfo:
        """Constant data of the flight that is about to begin."""
        assert self._next is not None
        return self._next.facts

    @property
    def parameters(self) -> Path | None:
        """File in which parameters are saved; None: they last for the session alone."""
        return self._parameters.path

    def set_judge(self, judge: Judge) -> None:
        """Set the judge of parameter changes that tune a loop; without one every change is taken."""
        self._guard.judge = judge

    def kept_lines(self) -> list[str]:
        """Return lines on the saved parameters: which differ from the defaults, and what they make worse."""
        return kept_lines(self._guard.judge, self.facts.parameters, self._parameters.values)

    def stop(self, why: str) -> None:
        """End the session after the present step; from any thread, and from a signal handler."""
        self._stopping = self._stopping or why

    def run(self) -> list[Run]:
        """Fly until stopped, and return the runs, each with its files in place."""
        try:
            return self._fly_on()
        finally:
            self._parameters.close()
            self._guard.close()

    def _fly_on(self) -> list[Run]:
        while True:
            flight = self._next or self._build()
            self._next = None
            try:
                ending = self._fly(flight)
                over = ending.outcome != "completed"
                if over:
                    self._linger(flight, ending)
            finally:
                self._over()
                flight.close()
            if not self._restart:
                return self.runs
            self._restart = False

    # --- one flight ----------------------------------------------------------------------------------------------

    def _build(self) -> SessionFlight:
        """Build a flight without beginning it: nothing but its folder is written yet."""
        number = len(self.runs) + 1
        simulation = build(self.scenario)
        try:
            pilot = with_autopilot(simulation)
            facts = session_info(simulation, number, pilot.parameters, self._folder(number), self.factor)
        except BaseException:
            simulation.close()
            raise
        return SessionFlight(simulation, pilot, facts, Pace(simulation.dt, self.factor), self.exchange)

    def _folder(self, number: int) -> Path:
        """Return the run's folder; the first is claimed now, so that an error is reported before anybody connects."""
        if self._records.out is None:
            return reserve_folder(Path("runs"), f"gcs-{self.scenario.aircraft_name}")
        if number == 1:
            claim_folder(self._records.out)
            return self._records.out
        # a folder that holds another run already is left alone: a vehicle that is asked to reboot must come back
        self._numbered = max(number, self._numbered + 1)
        while (folder := self._records.out.with_name(f"{self._records.out.name}-{self._numbered}")).exists():
            self._numbered += 1
        return folder

    def _fly(self, flight: SessionFlight) -> Ending:
        simulation, exchange = flight.simulation, self.exchange
        recording = flight.begin(self._records.log_mb)
        assert flight.pilot_record is not None
        # meant for the flight before
        while flight.facts.number > 1 and (late := [*self._guard.take_remaining(), *exchange.take(1)]):
            for waiting in late:
                waiting.answer(Answer(False, Result.TEMPORARILY_REJECTED, "a new flight begins"))
        self._parameters.restore(flight.set_parameter)
        self._begun(flight.facts)
        exchange.say(Severity.INFO, f"flight {flight.facts.number}: {flight.facts.vehicle.name}")
        parameters = flight.pilot.parameters
        tell(exchange.say, self._guard.judge, parameters, parameters.changed())
        flight.publish(None, None)
        self._guard.prepare()  # when every file is open: while a library loads the process may be in another folder
        with steady():
            begin = time.perf_counter()
            try:
                observers: list[Observer] = [recording, flight.pilot_record, Publisher(flight)]
                observers += simulation.plugins.observers
                ending = simulation.run(observers, flight.pace, lambda k: self._between(flight, k))
                simulation.plugins.close()
            except FlightError as error:  # a log cannot be written: the disk is full, say
                ending = Ending("failed", str(error))
            wall = time.perf_counter() - begin
        flight.last_message = pass_on(flight.pilot, exchange, flight.last_message)
        if ending.outcome == "completed":
            exchange.say(Severity.INFO, f"flight over: {ending.reason}", simulation.k)
        else:
            exchange.say(Severity.CRITICAL, f"{ending.outcome}: {ending.reason}"[:200], simulation.k)
            exchange.say(Severity.NOTICE, "the flight is over; reboot the vehicle for a new one", simulation.k)
        flight.publish(None, ending)
        self.runs.append(flight.finish(ending, wall, self._records.report))
        return ending

    def _between(self, flight: SessionFlight, k: int) -> Ending | None:
        """Handle requests between two steps, within bounds; return an ending if one is requested."""
        if self._stopping:
            flies = flight.pilot.armed and flight.pilot.status.landed is not LandedState.ON_GROUND
            return Ending("completed", f"{self._stopping}{' in the air' if flies else ''}")
        until = 0.0
        for _ in range(_MOST_A_STEP):
            taken = self.exchange.take(1)
            if not taken:
                break
            until = until or time.perf_counter() + _REQUEST_TIME
            for waiting in taken:
                if not self._guard.hold_back(waiting):
                    waiting.answer(self._serve(flight, waiting, k))
            if time.perf_counter() > until:
                break
        for waiting, cautions in self._guard.take_verdicts(flight.pilot.parameters, self.exchange.clock()):
            waiting.answer(self._serve_judged(flight, waiting, cautions, k))
        if self._restart:
            return Ending("completed", "a restart was asked for")
        return None

    def _serve(self, flight: SessionFlight, waiting: Waiting, k: int) -> Answer:
        """Execute a request and return the answer."""
        request = waiting.request
        if isinstance(request, (Restart, Shutdown)):
            return self._refuse_or_leave(flight, request, waiting.sender)
        try:
            answer = flight.ask(waiting.sender, request, k)
        except FlightError as error:
            waiting.answer(Answer(False, Result.FAILED, str(error)))
            raise
        if isinstance(request, SetParameter) and answer.accepted:
            self._parameters.keep(flight.pilot.parameters.changed())
        elif isinstance(request, (MissionUpload, MissionClear)):
            flight.publish(None, None)  # who has the answer may read the mission back
        return answer

    def _serve_judged(self, flight: SessionFlight, waiting: Waiting, cautions: list[Caution] | None, k: int) -> Answer:
        """Make a parameter change that has its verdict, and warn of it; or refuse it, which is recorded too."""
        request, pilot = waiting.request, flight.pilot
        assert isinstance(request, SetParameter)
        in_air = pilot.armed and pilot.status.landed is not LandedState.ON_GROUND
        if why := refusal(request, cautions, in_air, pilot.parameters.values):
            self.exchange.say(Severity.ERROR, why, k)
            answer = Answer(False, Result.TEMPORARILY_REJECTED, why)
            flight.refuse(waiting.sender, request, answer, k)
            return answer
        answer = self._serve(flight, waiting, k)
        if answer.accepted:
            warn_of(self.exchange.say, request, cautions, k)
        return answer

    def _refuse_or_leave(self, flight: SessionFlight, request: Restart | Shutdown, sender: str) -> Answer:
        if flight.pilot.armed:
            what = "restart" if isinstance(request, Restart) else "shutdown"
            return Answer(False, Result.TEMPORARILY_REJECTED, f"{what} refused: it is armed")
        self._leave(request, sender)
        return Answer(True, Result.ACCEPTED, "")

    def _leave(self, request: Restart | Shutdown, sender: str) -> None:
        if isinstance(request, Restart):
            self._restart = True
        else:
            self.stop(f"shut down by {sender}")

    def _linger(self, flight: SessionFlight, ending: Ending) -> None:
        """Answer requests after a flight has ended by itself, until there is a restart or the session ends."""
        exchange = self.exchange
        patience = None
        if self.duration is not None:
            left = max(0.0, self.duration - flight.simulation.k * flight.simulation.dt)
            patience = time.monotonic() + (left / self.factor if self.factor else 0.0)
        while not (self._restart or self._stopping) and (patience is None or time.monotonic() < patience):
            for waiting in [w for w in exchange.take(_MOST_A_STEP) if not self._guard.hold_back(w)]:
                answer = Answer(False, Result.FAILED, f"the flight is over: {ending.reason}")
                if isinstance(waiting.request, (Restart, Shutdown)):
                    self._leave(waiting.request, waiting.sender)
                    answer = Answer(True, Result.ACCEPTED, "")
                elif isinstance(waiting.request, SetParameter):
                    answer = self._keep_for_next(flight, waiting.request, [])
                waiting.answer(answer)
            for waiting, cautions in self._guard.take_verdicts(flight.pilot.parameters, exchange.clock()):
                assert isinstance(waiting.request, SetParameter)
                waiting.answer(self._keep_for_next(flight, waiting.request, cautions))
            flight.publish(None, ending)
            time.sleep(_OVER_EVERY)

    def _keep_for_next(self, flight: SessionFlight, request: SetParameter, cautions: list[Caution] | None) -> Answer:
        """Set a parameter for the next flight, as this one is over."""
        if why := refusal(request, cautions, False, {}):
            return Answer(False, Result.TEMPORARILY_REJECTED, why)
        answer = flight.pilot.handle(request, flight.simulation.k)
        if answer.accepted:
            self._parameters.keep(flight.pilot.parameters.changed())
            value = flight.pilot.parameters[request.name]
            self.exchange.say(Severity.NOTICE, f"{request.name} {value:g} from the next flight on")
            warn_of(self.exchange.say, request, cautions, flight.simulation.k)
        return answer


def waiting_scenario(scenario: Scenario, duration: float | None) -> Scenario:
    """Return the scenario with its vehicle on the ground, and an autopilot in place of its commands."""
    watched = scenario.resolved_vehicle()[0].control.monitor
    heading = scenario.initial.attitude_deg[2]
    still = (0.0, 0.0, 0.0)
    return scenario.replace(
        command=[],
        expect=[],
        requests=REQUESTS,
        monitor=scenario.monitored if watched is None else True,
        duration_s=round(LONGEST_S / scenario.step_s) * scenario.step_s if duration is None else duration,
        initial={
            "on_ground": True,
            "engines": "idle" if scenario.engine_start == "in flight" else "off",
            "attitude_deg": (0.0, 0.0, heading),
            "velocity_ned_m_s": still,
            "rate_deg_s": still,
        },
    )


def parse_place(text: str) -> dict[str, float]:
    """Parse ``LAT,LON`` in degrees to fields of a scenario's environment.  Raises InputError for anything else."""
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"--place {text}: must be LAT,LON in degrees, such as 22.35,113.59") from error
    return {"latitude_deg": latitude, "longitude_deg": longitude}


@contextmanager
def steady() -> Iterator[None]:
    """Keep a paced flight steady: no long collections of garbage, and threads that give way soon."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH)
    gc.collect()
    gc.freeze()  # what is there now stays, and need not be looked at again
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)


@contextmanager
def stop_on_signals(session: Session) -> Iterator[None]:
    """End the session properly on Ctrl-C and SIGTERM; a second one ends the process as usual."""
    kept: dict[int, Any] = {}

    def stop(number: int, frame: object) -> None:
        session.stop(f"stopped by {signal.Signals(number).name}")
        for caught, handler in kept.items():
            signal.signal(caught, handler)

    for number in (signal.SIGINT, signal.SIGTERM):
        kept[number] = signal.signal(number, stop)
    try:
        yield
    finally:
        for caught, handler in kept.items():
            signal.signal(caught, handler)
