"""One flight of a session: its autopilot, its records, and the snapshots that it publishes."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from cosim.base.errors import FlightError, InputError
from cosim.base.geodesy import Geodesy
from cosim.base.protocols import EngineState
from cosim.base.signals import Sample
from cosim.control.autopilot.autopilot import Autopilot
from cosim.control.autopilot.modes import LandedState, Severity
from cosim.control.autopilot.parameters import Parameters
from cosim.control.autopilot.requests import Answer, MissionItem, Request, Result, SetParameter, Sticks
from cosim.control.autopilot.status import Status
from cosim.flight import record, write_run_page
from cosim.groundstation.exchange import Exchange, FlightInfo, Snapshot
from cosim.results.autopilot.autopilot_record import PilotRecord
from cosim.results.autopilot.request_log import RequestLog
from cosim.results.log.columns import log_columns, logged_vehicle
from cosim.results.run import AUTOPILOT, REQUESTS, Recording, Run
from cosim.simulation.ending import Ending
from cosim.simulation.pacing import Pace, PaceReport
from cosim.simulation.step import Simulation

# Shortest wall time between snapshots, half a step at 250 Hz; chosen by us. Faster flights publish fewer steps.
MIN_PUBLISH_INTERVAL_S = 2e-3
# Default limit of a flight's log: two hours at 250 Hz.
MAX_LOG_MB = 2000.0


@dataclass
class SessionFlight:
    """Flight of a session with autopilot, recordings and exchange."""

    simulation: Simulation
    pilot: Autopilot
    info: FlightInfo
    pace: Pace
    exchange: Exchange
    recording: Recording | None = None
    log: RequestLog | None = None
    pilot_record: PilotRecord | None = None
    sample: Sample | None = None
    last_message: int = 0  # last forwarded message's number

    def __post_init__(self) -> None:
        self.stick_owner = StickOwner(self.pilot.parameters, self.simulation.dt)

    def begin(self, log_mb: float | None = MAX_LOG_MB) -> LogLimit:
        """Begin the recording in the run's folder, with a log of at most ``log_mb`` MB.  Raises InputError."""
        assert self.info.folder is not None
        self.recording = record(self.simulation, self.info.folder, {REQUESTS: b""}, background=True)
        self.log = RequestLog(self.info.folder / REQUESTS)
        self.pilot_record = PilotRecord(self.pilot, self.info.folder / AUTOPILOT, self.simulation.dt)
        warn = partial(self.exchange.say, Severity.WARNING)
        self.log_limit = LogLimit(self.recording, log_mb, lambda text: warn(text, self.simulation.k))
        return self.log_limit

    def ask(self, sender: str, request: Request, k: int) -> Answer:
        """Pass a request to the autopilot and log it; sticks only from their owner.  Raises FlightError."""
        assert self.log is not None
        if isinstance(request, Sticks) and (holder := self.stick_owner.find_other_holder(sender, k)):
            if self.stick_owner.note_refusal():
                self.exchange.say(Severity.WARNING, f"sticks of {sender} not taken: {holder} flies", k)
            return Answer(False, Result.TEMPORARILY_REJECTED, f"sticks refused: {holder} flies")
        answer = self.pilot.handle(request, k)
        self.log.write(k, sender, request, answer)
        return answer

    def refuse(self, sender: str, request: Request, answer: Answer, k: int) -> None:
        """Log a request that was not passed to the autopilot.  Raises FlightError."""
        assert self.log is not None
        self.log.write(k, sender, request, answer, asked=False)

    def set_parameter(self, name: str, value: float) -> None:
        """Set a saved parameter.  Raises InputError if it is refused."""
        answer = self.ask("parameters", SetParameter(name, value), 0)
        if not answer.accepted:
            raise InputError(answer.text)

    def publish(self, sample: Sample | None, ending: Ending | None) -> None:
        exchange = self.exchange
        self.last_message = forward_messages(self.pilot, exchange, self.last_message)
        self.sample = sample or self.sample
        simulation, status = self.simulation, self.pilot.status
        if ending is not None:
            refusals = (f"the flight is over: {ending.reason}",)
            landed = LandedState.ON_GROUND if ending.outcome == "crashed" else status.landed
            status = status._replace(
                armed=False, ready=False, refusals=refusals, engines=EngineState.OFF, landed=landed
            )
        mission = tuple(self.pilot.mission.items)
        exchange.publish(
            make_snapshot(
                simulation, self.info, self.sample, status, self.pace.report, exchange.clock(), ending, mission
            )
        )

    def finish(self, ending: Ending, wall: float, report: bool) -> Run:
        """Finish the run's files and return the run; its scenario has the flown duration."""
        assert self.recording is not None
        self.close_record()
        steps, reason = self.simulation.k, ending.reason
        if self.log_limit.is_full and self.log_limit.rows < steps:
            steps = self.log_limit.rows
            reason = f"{reason}; the log ends at {steps * self.simulation.dt:g} s, where it had its size"
        self.recording.shorten_scenario(steps)
        run = self.recording.finish(ending.outcome, reason, wall, self.pace.report)
        return write_run_page(run) if report else run

    def close(self) -> None:
        if self.log is not None:
            self.log.close()
        self.close_record()
        self.simulation.close()

    def close_record(self) -> None:
        if self.pilot_record is not None:
            with suppress(FlightError):
                self.pilot_record.close()


class StickOwner:
    """Selects the owner of the sticks: the first sender until it falls silent, as in PX4."""

    def __init__(self, parameters: Parameters, step: float) -> None:
        self._parameters, self._step = parameters, step
        self._holder, self._last_step = "", 0
        self._is_announced = False

    def find_other_holder(self, sender: str, k: int) -> str:
        """Return the other sender that owns the sticks at step ``k``; empty if ``sender`` owns them now."""
        is_recent = (k - self._last_step) * self._step <= self._parameters["HJ_STICK_TIME"]
        if self._holder not in ("", sender) and is_recent:
            return self._holder
        self._is_announced = self._is_announced and self._holder == sender
        self._holder, self._last_step = sender, k
        return ""

    def note_refusal(self) -> bool:
        """Return whether this refusal is the first since the owner changed, to report it once."""
        was_announced, self._is_announced = self._is_announced, True
        return not was_announced


def estimate_hourly_mb(info: FlightInfo) -> float:
    """Return the size [MB] of the log of an hour's flight."""
    columns = log_columns(logged_vehicle(info.vehicle), info.columns)
    return 8.0 * len(columns) * 3600.0 / info.scenario.step_s / 1e6


class LogLimit:
    """Observer that passes samples to a recording until its log has ``limit_mb`` MB (None: no limit).

    ``say`` gets a text message for the ground, at ``warn_at`` of the size and at the end.
    """

    def __init__(
        self, recording: Recording, limit_mb: float | None, say: Callable[[str], None], warn_at: float = 0.8
    ) -> None:
        self.warn_at = warn_at
        self._recording, self._say = recording, say
        self._limit_mb = limit_mb
        self._most = None if limit_mb is None else max(1, int(limit_mb * 1e6 / (8 * recording.columns)))
        self.rows = 0  # rows recorded so far

    @property
    def is_full(self) -> bool:
        """Whether the log has reached its limit, so that nothing more is recorded."""
        return self._most is not None and self.rows >= self._most

    def observe(self, sample: Sample) -> None:
        """Record the sample unless the log is full."""
        if self.is_full:
            return
        self._recording.observe(sample)
        self.rows += 1
        if self._most is not None and self._limit_mb is not None:
            if self.rows == max(1, int(self.warn_at * self._most)):
                self._say(f"the log has {self.warn_at * self._limit_mb:g} MB, and ends at {self._limit_mb:g} MB")
            if self.is_full:
                self._say(f"the log has {self._limit_mb:g} MB and ends here, the flight goes on")


class Publisher:
    """Observer that publishes snapshots at a limited rate and reports late steps."""

    def __init__(self, flight: SessionFlight, warn_every_s: float = 10.0) -> None:
        self.warn_every_s = warn_every_s
        self._flight = flight
        self._last = self._warned = time.monotonic()
        self._missed = 0

    def observe(self, sample: Sample) -> None:
        now = time.monotonic()
        if now - self._last < MIN_PUBLISH_INTERVAL_S:
            return
        self._last = now
        self._flight.publish(sample, None)
        if now - self._warned >= self.warn_every_s:
            self._warned = now
            self._report_late_steps()

    def _report_late_steps(self) -> None:
        report = self._flight.pace.report
        missed = report.missed - self._missed
        self._missed = report.missed
        if missed:
            self._flight.exchange.say(
                Severity.WARNING,
                f"{missed} steps late in {self.warn_every_s:g} s, the latest by {1e3 * report.longest_delay:.1f} ms",
                self._flight.simulation.k,
            )


def make_snapshot(
    simulation: Simulation,
    info: FlightInfo,
    sample: Sample | None,
    status: Status,
    pace: PaceReport,
    published: float,
    ending: Ending | None = None,
    mission: tuple[MissionItem, ...] = (),
) -> Snapshot:
    k, state, measured = simulation.k, simulation.state, simulation.measured
    time = k * info.scenario.step_s
    diagnostics = simulation.controller.diagnostics
    return Snapshot(published, info, k, time, sample, state, measured, status, pace, ending, mission, diagnostics)


def forward_messages(pilot: Autopilot, exchange: Exchange, after: int) -> int:
    """Forward the autopilot's messages after number ``after``; return the last number."""
    messages = pilot.messages
    if messages and messages[-1].number > after:
        for message in messages:
            if message.number > after:
                exchange.say(message.severity, message.text, message.k)
        return messages[-1].number
    return after


def make_flight_info(
    simulation: Simulation, number: int, parameters: Parameters, folder: Path | None, factor: float | None
) -> FlightInfo:
    """Return a flight's constant data, known before its first step."""
    environment = simulation.scenario.environment
    geodesy = Geodesy(environment.latitude_deg, environment.longitude_deg, environment.ground_m)
    stations = tuple(simulation.stations)
    scenario, vehicle, columns = simulation.scenario, simulation.vehicle, simulation.columns
    return FlightInfo(number, scenario, vehicle, stations, geodesy, parameters, folder, factor, columns)
