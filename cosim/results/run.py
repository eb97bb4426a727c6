"""A run and its folder: begun before the first step, finished after the last, opened again later.

``summary.json``, ``scenario.toml`` with the files it names, ``flight.parquet`` and ``report.html``.  While the flight
lasts its rows are in ``flight.arrows``; that file goes only when everything made from it is in place, so that a run
which was killed is finished by :func:`open_run`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from html import escape
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from platform import python_version
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from cosim.base.errors import FlightError, InputError
from cosim.base.outcomes import Outcome, RunVerdict
from cosim.base.protocols import Column
from cosim.base.storage.files import locked, write_whole
from cosim.base.storage.toml import Vector, toml_text
from cosim.results.arrow import (
    ParquetLog,
    StreamSink,
    read_note,
    stream_to_parquet,
)
from cosim.results.columns import COLUMNS
from cosim.results.limits import (
    Yardstick,
    beyond,
    exceedance,
    flight_limits,
)
from cosim.results.metrics import (
    AltitudeMetrics,
    AxisMetrics,
    EffortMetrics,
    Metrics,
    PositionMetrics,
    Reach,
    Record,
    SpeedMetrics,
    check_expectations,
    flatten,
    flight_metrics,
)
from cosim.results.recorder import (
    BackgroundSink,
    KeepingSink,
    Log,
    MemorySink,
    Recorder,
)
from cosim.results.verdict import describe_end, judge, read_verdict
from cosim.simulation.pacing import PaceReport
from cosim.simulation.plugins import OwnMetric, unmeasured
from cosim.spec.controller_name import SHORT, controller_words
from cosim.spec.scenario import Expectation, Scenario

SUMMARY, SCENARIO, LOG, STREAM, REPORT = (
    "summary.json",
    "scenario.toml",
    "flight.parquet",
    "flight.arrows",
    "report.html",
)
TELEMETRY = "telemetry.tlog"
AUTOPILOT = "autopilot.jsonl"
RUN_FILES = (SUMMARY, SCENARIO, LOG, STREAM, REPORT, TELEMETRY, AUTOPILOT)
_TITLED = ("aircraft", "engine", "controller", "design", "models")  # changes that a title states as what flies
_LISTED = 3  # further changes in a title
_AS_STATED = "Of the scenario as its file states it, not of this flight:"
_WIDTH = 120  # characters of a table or list on one line of the summary
PACKAGES = ("hexjet-cosim", "jsbsim", "fmpy", "numpy", "scipy", "pyarrow")


class DelayRow(Record):
    """One element of the chain from an axis's command to its measured rate, and the samples of delay that it owns."""

    element: str
    owner: str
    kind: str
    samples: float | None  # None where it is not known
    axis: str = "roll"  # of runs written before there were others


class StationEngine(Record):
    """The engine at one station; ``curve`` as ``Setup.engine_curve``, empty if it is that one."""

    engine: str
    sha256: str  # of its archive
    curve: tuple[tuple[float, float], ...] = ()
    file: str = ""  # the name of its archive or mapping file; empty: of the library, or an older run
    apart: str = ""  # what it was found to do to its process, for which the flight's engines had one of their own


class Integration(Record):
    """How the airframe is integrated: JSBSim's runs, and its methods by name."""

    runs: int  # in a control step
    run_s: float  # the time that each covers
    rates: str  # angular acceleration to body rate
    velocities: str
    attitude: str
    position: str
    on_ground: str  # of rates and velocities instead, while anything touches the ground

    @property
    def methods(self) -> str:
        """In words."""
        air = [f"rates {self.rates}", f"velocities {self.velocities}"]
        if self.rates == self.velocities:
            air = [f"rates and velocities {self.rates}"]
        if self.on_ground != self.rates or self.on_ground != self.velocities:
            air[-1] += f" ({self.on_ground} while anything touches the ground)"
        return ", ".join([*air, f"attitude {self.attitude}", f"position {self.position}"])


class OwnController(Record):
    """A controller from outside, as it flew."""

    name: str
    level: str  # predictor, rate, attitude or controller
    sha256: (
        str  # of its files, or its text; as in controller_sha256 of the scenario; empty: nothing was to be had of it
    )
    files: dict[str, str]  # SHA-256 by name
    version: str = ""  # of the package that it is in
    parameters: dict[str, float]
    again: bool = True  # False: an object of a program, which no file can make again
    repeatable: bool | None = None  # asked again with the same inputs it answered the same; None: not asked


class ParametersRecord(Record):
    """A file whose numbers flew: a controller of hexjet design, or identified models."""

    kind: str  # design or models
    file: str  # its name in the run's folder
    sha256: str
    controller: str = ""  # that a design is for
    changed: tuple[str, ...] = ()  # keys with another value in the flight than in the file


class PluginRecord(Record):
    """A metric, an observer, sensors or a wind of the user's, as it flew."""

    key: str  # of the scenario
    name: str
    sha256: str
    files: dict[str, str]  # SHA-256 by name
    version: str = ""  # of the package that it is in


class Setup(BaseModel):
    """What is known of a run before its first step."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    scenario: str
    title: str = ""
    description: str = ""
    aircraft: str
    engine: str
    controller: str
    own_controller: OwnController | None = None  # None: a built-in one
    parameter_files: list[ParametersRecord] = []
    changed: list[str] = []  # what was written over the scenario's own file, key = value
    brought: list[PluginRecord] = []  # what else is the user's
    seed: int
    sensors: str = ""  # the profile over the aircraft's sensors, with its file's hash; empty: none, or not known
    step_s: float
    integration: Integration | None = None  # None: of a run from before it was written down
    planned_s: float  # how long the flight is meant to be
    started: str = ""  # UTC, ISO 8601
    engine_curve: list[tuple[float, float]] = []  # throttle, thrust of one engine at rest [N]
    stations: list[StationEngine] = []  # jet 1 first
    jets_m: list[Vector] = []  # engine stations, body
    delay_ledger: list[DelayRow] = []
    reach: Reach | None = None  # of throttles and tilts
    yardstick: Yardstick | None = None  # what its limits are made from; None: it has none
    expectation: Expectation | None = None  # what this controller with this engine must come to
    notes: list[
        str
    ] = []  # what is to be known of it: models that are not the vehicle's, what is stated and does nothing
    by_hand: int = 0  # steps whose command, throttles or tilts a program gave: the scenario alone does not repeat them
    versions: dict[str, str] = {}
    blas_kernels: dict[str, str] = {}  # of OpenBLAS, by the package that brought it; empty: not known
    sha256: dict[str, str] = {}  # of the aircraft model and of every FMU

    @property
    def controller_shown(self) -> str:
        """The controller for people: a design, models or a custom controller by file and first letters of the hash."""
        own = "" if self.own_controller is None else self.own_controller.sha256
        return controller_words(self.controller, own, self.parameter_files)

    @property
    def engine_shown(self) -> str:
        """The engine for people, one that is not of the library with its file and the first letters of its hash."""
        files = {station.file: station.sha256 for station in self.stations if station.engine == self.engine}
        return self.engine + "".join(f" ({name} {value[:SHORT]})" for name, value in files.items() if name)

    def retitled(self) -> Self:
        """Return the same under a title of what flies, where it is not what the scenario's file states.

        The description is kept, marked as the scenario's.
        """
        if not self.changed:
            return self
        texts = [text for text in self.changed if text.partition(" = ")[0] not in _TITLED]
        listed = [*texts[:_LISTED], *([f"{len(texts) - _LISTED} more changes"] if len(texts) > _LISTED else [])]
        title = f"{self.scenario}: {self.aircraft}, {self.engine_shown}, {self.controller_shown}"
        title += f", with {', '.join(listed)}" if listed else ""
        story = f"{_AS_STATED} {self.description.strip()}" if self.description.strip() else ""
        return self.model_copy(update={"title": title, "description": story})


class Pacing(Record):
    """How well a paced flight kept in step with the clock."""

    factor: float | None  # asked for; None: as fast as it goes
    missed_deadlines: int  # steps that were not done when the next one was due
    worst_s: float  # how late the latest of them was
    stalls: int  # after which the schedule was moved, rather than caught up with
    lost_s: float  # by which it was moved, in all


class Summary(Setup):
    """What ``summary.json`` says."""

    outcome: Outcome
    reason: str
    verdict: RunVerdict | None = None  # None: flown before there were any
    steps: int
    duration_s: float  # flown
    wall_s: float | None = None  # spent on the steps; None if the process did not live to say so
    realtime_factor: float | None = None
    step_us: float | None = None
    pacing: Pacing | None = None  # None: nothing was paced
    metrics: dict[str, AxisMetrics]
    altitude: AltitudeMetrics
    touchdown_m_s: float | None = None
    position: PositionMetrics = PositionMetrics()
    speed: SpeedMetrics = SpeedMetrics()
    effort: EffortMetrics = EffortMetrics()
    fuel_burnt_kg: float | None = None
    own_metrics: dict[str, float | None] = {}  # of the user's, each with "own." before its name
    own_metrics_failed: list[str] = []  # a line for each that could not say anything
    limits: dict[str, float] = {}  # the most that a metric may be, by its name
    beyond: list[str] = []  # the metrics that are above that
    expectations_met: bool | None = None  # None: nothing is expected
    complaints: list[str] = []  # a line for each expectation that is not met

    @property
    def flat_metrics(self) -> dict[str, float | None]:
        """Every metric under the name that an expectation uses, such as ``roll.rmse_rad``."""
        return (
            flatten(
                Metrics(
                    axes=self.metrics,
                    altitude=self.altitude,
                    touchdown_m_s=self.touchdown_m_s,
                    position=self.position,
                    speed=self.speed,
                    effort=self.effort,
                    fuel_burnt_kg=self.fuel_burnt_kg,
                )
            )
            | self.own_metrics
        )

    @model_validator(mode="before")
    @classmethod
    def _word_verdict(cls, data: Any) -> Any:
        """Word the verdict of an older run as it is worded today."""
        if isinstance(data, dict) and isinstance(data.get("verdict"), str):
            return data | {"verdict": read_verdict(data["verdict"], data.get("expectations_met"))}
        return data

    @property
    def as_planned(self) -> bool:
        """Whether it completed within its limits and met what its scenario expects; False if nothing is expected."""
        return self.succeeded and self.expectations_met is True

    @property
    def succeeded(self) -> bool:
        """Whether it completed, and nothing that was checked failed: its exit status is 0."""
        return self.outcome == "completed" and not self.beyond and self.expectations_met is not False

    @property
    def ending(self) -> str:
        """How it ended and its verdict, in words."""
        return describe_end(self.outcome, self.reason, self.verdict)

    @property
    def exceeded(self) -> list[str]:
        """What is beyond its limit, in words and with both figures."""
        return [exceedance(name, self.limits, self.flat_metrics) for name in self.beyond]


@dataclass(frozen=True, repr=False)
class Run:
    """A finished run.

    Attributes
    ----------
    summary : Summary
        What ``summary.json`` says: outcome, verdict, metrics, delay ledger, versions.
    log : Log
        ``log["roll_rad"]`` is a column: one float64 a control step, in the unit that its name says.
    folder : Path or None
        None if it was flown without one.
    flown : Scenario or None
        The resolved scenario, kept by the process that flew it.
    """

    summary: Summary
    log: Log
    folder: Path | None = None
    flown: Scenario | None = None  # kept by the process that flew it

    @property
    def scenario(self) -> Scenario:
        """The resolved scenario, from the run's folder if need be.  Raises InputError if it cannot be read."""
        if self.flown is not None:
            return self.flown
        assert self.folder is not None
        return Scenario.read(self.folder / SCENARIO)

    def _repr_html_(self) -> str:
        """Return a table for notebooks: outcome, what flew, and the metrics."""
        summary = self.summary
        said = f"{summary.scenario}: {summary.ending}"
        flown = f"{summary.aircraft}, engine {summary.engine_shown}, controller {summary.controller_shown}, "
        flown += f"seed {summary.seed}"
        flown += f"; {summary.by_hand} steps by hand" if summary.by_hand else ""
        own = summary.own_controller
        flown += "; an object of a program, which no file makes again" if own is not None and not own.again else ""
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{value:.6g}</td></tr>"
            for name, value in summary.flat_metrics.items()
            if value is not None
        )
        return f"<p><b>{escape(said)}</b><br>{escape(flown)}</p><table>{rows}</table>"

    def __repr__(self) -> str:
        where = "" if self.folder is None else f", {self.folder}"
        return f"<Run {self.summary.scenario}: {self.outcome}, {len(self.log)} steps{where}>"

    @property
    def outcome(self) -> Outcome:
        """How the flight ended."""
        return self.summary.outcome

    @property
    def reason(self) -> str:
        """Why it ended, in words."""
        return self.summary.reason

    @property
    def metrics(self) -> dict[str, AxisMetrics]:
        """Of roll, pitch and yaw, by name."""
        return self.summary.metrics


class Recording:
    """A run that is being flown: an observer, and at the end :meth:`finish`."""

    def __init__(
        self,
        setup: Setup,
        scenario: Scenario,
        sink: KeepingSink | StreamSink,
        background: bool = False,
        columns: Sequence[Column] = COLUMNS,
        metrics: Sequence[OwnMetric] = (),
    ) -> None:
        self._metrics = metrics
        self._setup = setup
        self._scenario = scenario
        self._sink = sink
        self._behind = BackgroundSink(sink) if background else None
        self._recorder = Recorder(setup.step_s, self._behind or sink, columns)
        self.observe = self._recorder.observe
        self.columns = len(columns)

    def restate(self, scenario: Scenario) -> None:
        """Take the scenario as it was flown in the end, with what came by command.  Raises FlightError."""
        self._scenario = scenario
        if isinstance(self._sink, StreamSink):
            self._scenario = scenario.seen_from(self._sink.path.parent)
            write_whole(self._sink.path.with_name(SCENARIO), scenario_toml(scenario), FlightError)

    def repeats(self, same: bool | None) -> None:
        """Note whether a controller outside this process answers the same again; None: not asked."""
        own = self._setup.own_controller
        if own is not None and same is not None:
            changed = own.model_copy(update={"repeatable": same})
            self._setup = self._setup.model_copy(update={"own_controller": changed})

    def shorten(self, steps: int) -> None:
        """End the scenario of a flight without a planned end after the steps that it flew.  Raises FlightError."""
        if steps:
            duration = steps * self._setup.step_s
            self._setup = self._setup.model_copy(update={"planned_s": duration})
            self.restate(self._scenario.replace(duration_s=duration))

    def stepped(self, steps: int, by_hand: int) -> None:
        """Note the steps so far and how many commands of them a program gave: nothing is expected of the flight."""
        changed = {"planned_s": steps * self._setup.step_s, "by_hand": by_hand, "expectation": None}
        self._setup = self._setup.model_copy(update=changed)

    def finish(
        self,
        outcome: Outcome,
        reason: str,
        wall_s: float | None = None,
        pace: PaceReport | None = None,
    ) -> Run:
        """Put the run's files into place; ``wall_s`` is the time spent on the steps.

        A log that could not be written to its end makes the run ``failed``.  Raises FlightError if the files cannot be
        written; what was recorded stays and :func:`open_run` takes it up again.
        """
        if not isinstance(self._sink, StreamSink):
            self._recorder.flush()
            log = self._sink.log()
            return Run(
                summarize(self._setup, log, outcome, reason, wall_s, pace, self._metrics), log, None, self._scenario
            )
        try:
            self._recorder.flush()
            if self._behind is not None:
                self._behind.settle()
            self._sink.end()
        except FlightError as error:
            outcome, reason = "failed", str(error)
        folder = self._sink.path.parent
        try:
            summary, log = _settle(folder, self._setup, outcome, reason, wall_s, pace, self._metrics)
        finally:
            self._sink.close()
        self._sink.path.unlink()
        return Run(summary, log, folder, self._scenario)


def begin_run(
    setup: Setup,
    scenario: Scenario,
    folder: Path | None = None,
    files: Mapping[str, Path | bytes] | None = None,
    background: bool = False,
    sink: KeepingSink | None = None,
    columns: Sequence[Column] = COLUMNS,
    metrics: Sequence[OwnMetric] = (),
) -> Recording:
    """Begin a run, in ``folder`` or in memory, where ``sink`` may keep less than all.

    ``scenario`` is resolved: what is written to ``scenario.toml`` flies as it is.  ``files``, or contents, are put
    beside it under their keys.  ``background``: a thread writes the rows.  ``columns``: of the log.  ``metrics``: of
    the user's, beside the built-in ones.  Raises InputError
    if the folder already holds a run or cannot be written to.
    """
    if folder is None:
        sink = sink or MemorySink()
        sink.begin(columns)
        return Recording(setup, scenario, sink, columns=columns, metrics=metrics)
    claim_folder(folder, files or {})
    scenario = scenario.seen_from(folder)
    stream = StreamSink(folder / STREAM, setup.model_dump_json(), columns)
    try:
        for name, source in (files or {}).items():
            write_whole(folder / name, source if isinstance(source, bytes) else source.read_bytes(), FlightError)
        write_whole(folder / SCENARIO, scenario_toml(scenario), FlightError)
    except (OSError, FlightError) as error:
        stream.close()
        stream.path.unlink(missing_ok=True)
        raise InputError(str(error)) from error
    return Recording(setup, scenario, stream, background, columns, metrics)


def claim_folder(folder: Path, files: Mapping[str, Path | bytes] | None = None) -> None:
    """Make a run's folder if need be.  Raises InputError if it already holds a run or cannot be written to."""
    try:
        _refuse_if_used(folder, files or {})
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}") from error
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder}: cannot be written to")


def open_run(folder: Path | str) -> Run:
    """Open a finished run, or finish one that was killed with everything it had written.

    Parameters
    ----------
    folder : Path or str
        Where it was flown into.

    Returns
    -------
    Run
        As :func:`cosim.fly` gave it back.

    Raises
    ------
    InputError
        If there is no run, if it is still being flown, or if its files cannot be read.
    """
    folder = Path(folder)
    if (folder / STREAM).is_file():
        _recover(folder)
    for name in (SUMMARY, LOG):
        if not (folder / name).is_file():
            raise InputError(f"{folder}: no run here ({name} is missing)")
    path = folder / SUMMARY
    try:
        summary = Summary.model_validate_json(path.read_text(encoding="utf-8"))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{path}: not a run's summary: {key + ': ' if key else ''}{first['msg']}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    return Run(summary, ParquetLog(folder / LOG), folder)


def finish_killed(scenario: Path) -> None:
    """Finish the run that a scenario file belongs to if that run was killed, so that its scenario ends where it did.

    Raises InputError while the run is being flown.
    """
    if scenario.name == SCENARIO and (scenario.parent / STREAM).is_file():
        _recover(scenario.parent)


def summarize(
    setup: Setup,
    log: Log,
    outcome: Outcome,
    reason: str,
    wall_s: float | None,
    pace: PaceReport | None = None,
    own: Sequence[OwnMetric] = (),
) -> Summary:
    """Return the summary of a flight from its log; ``own`` are the user's metrics, beside the built-in ones."""
    metrics = flight_metrics(log, setup.step_s, setup.reach)
    said, failed = _own(own, log, setup.step_s)
    flat = flatten(metrics) | said
    steps = len(log)
    duration = steps * setup.step_s
    limits = flight_limits(setup.yardstick, log, setup.step_s) if setup.yardstick is not None and steps else {}
    above = beyond(limits, flat)
    complaints = _complaints(setup.expectation, outcome, flat)
    met = None if setup.expectation is None else not complaints
    return Summary(
        **dict(setup),
        outcome=outcome,
        reason=reason,
        verdict=judge(outcome, above, met),
        steps=steps,
        duration_s=duration,
        wall_s=wall_s,
        realtime_factor=duration / wall_s if wall_s else None,
        step_us=1e6 * wall_s / steps if wall_s is not None and steps else None,
        pacing=None
        if pace is None
        else Pacing(
            factor=pace.factor,
            missed_deadlines=pace.missed,
            worst_s=pace.worst,
            stalls=pace.stalls,
            lost_s=pace.lost,
        ),
        metrics=metrics.axes,
        altitude=metrics.altitude,
        touchdown_m_s=metrics.touchdown_m_s,
        position=metrics.position,
        speed=metrics.speed,
        effort=metrics.effort,
        fuel_burnt_kg=metrics.fuel_burnt_kg,
        own_metrics=said,
        own_metrics_failed=failed,
        limits=limits,
        beyond=above,
        expectations_met=met,
        complaints=complaints,
    )


def _own(metrics: Sequence[OwnMetric], log: Log, step_s: float) -> tuple[dict[str, float | None], list[str]]:
    """Return the values of the user's metrics, and a line for each that failed; without a step all are None."""
    values: dict[str, float | None] = {name: None for metric in metrics for name in metric.names}
    failed = []
    for each in metrics if len(log) else ():
        try:
            values |= each.of(log, step_s)
        except (FlightError, InputError) as error:
            failed.append(str(error))
    return values, failed


def versions() -> dict[str, str]:
    """Return the versions that a run depends on, by name: Python and the packages that make its numbers."""
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    versions = {"python": python_version()}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:  # the clone itself, not installed
            continue
    return versions


def now() -> str:
    """Return the time of day, UTC, for :attr:`Setup.started`."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _complaints(expectation: Expectation | None, outcome: Outcome, flat: Mapping[str, float | None]) -> list[str]:
    if expectation is None:
        return []
    wrong = (
        [] if outcome in expectation.outcome else [f"outcome = {outcome}, expected {' or '.join(expectation.outcome)}"]
    )
    return wrong + check_expectations(flat, expectation.metrics)


def _settle(
    folder: Path,
    setup: Setup,
    outcome: Outcome,
    reason: str,
    wall_s: float | None,
    pace: PaceReport | None = None,
    own: Sequence[OwnMetric] = (),
) -> tuple[Summary, ParquetLog]:
    """Make Parquet and summary of a stream, and leave the stream."""
    try:
        stream_to_parquet(folder / STREAM, folder / LOG)
        log = ParquetLog(folder / LOG)
        summary = summarize(setup, log, outcome, reason, wall_s, pace, own)
        write_whole(folder / SUMMARY, _json(summary).encode(), FlightError)
    except FlightError as error:
        raise FlightError(
            f"{error}; what was flown is kept in {folder / STREAM}: hexjet report {folder} finishes it"
        ) from error
    return summary, log


def _recover(folder: Path) -> None:
    """Finish a run whose process did not."""
    stream = folder / STREAM
    with locked(stream, f"{folder}: a run is still being recorded here; wait until it ends"):
        if not (folder / SUMMARY).is_file():
            note = read_note(stream)
            if note is None:
                raise InputError(f"{stream}: torn before its first row; nothing of this run can be recovered")
            try:
                setup = Setup.model_validate_json(note)
            except ValidationError as error:
                raise InputError(f"{stream}: not a stream of this program") from error
            own = [unmeasured(block.name) for block in setup.brought if block.key == "metrics"]
            summary, log = _settle(folder, setup, "failed", "interrupted", None, own=own)
            _shorten(folder, summary, len(log))
        elif not (folder / LOG).is_file():
            stream_to_parquet(stream, folder / LOG)
        stream.unlink()


def _shorten(folder: Path, summary: Summary, steps: int) -> None:
    """Let the scenario of a flight that had no planned end, being flown by request, end where its log ends."""
    scenario = Scenario.read(folder / SCENARIO)
    if scenario.requests is not None and steps:
        flown = {"planned_s": steps * scenario.step_s}
        write_whole(folder / SCENARIO, scenario_toml(scenario.replace(duration_s=flown["planned_s"])), FlightError)
        write_whole(folder / SUMMARY, _json(summary.model_copy(update=flown)).encode(), FlightError)


def _refuse_if_used(folder: Path, files: Mapping[str, Path | bytes]) -> None:
    for name in files:
        if name in RUN_FILES or Path(name).name != name:
            raise InputError(f"scenario: a file named {name!r} cannot be copied into a run's folder")
    held = [name for name in (*RUN_FILES, *files) if (folder / name).exists()]
    if held:
        raise InputError(f"{folder}: already holds a run ({held[0]}); choose another folder or remove it")


def scenario_toml(scenario: Scenario) -> bytes:
    return toml_text(scenario.model_dump(mode="json", exclude_none=True)).encode()


def _json(summary: Summary) -> str:
    """Return the summary as JSON, main entries first; a table or list is one line, a long one a line an entry."""
    data = summary.model_dump(mode="json")
    first: tuple[str, ...] = (
        "outcome",
        "reason",
        "verdict",
        "beyond",
        "limits",
        "complaints",
        "metrics",
        "altitude",
        "touchdown_m_s",
    )
    first += ("position", "speed", "effort", "fuel_burnt_kg")
    lines = []
    for key, value in ({name: data[name] for name in first} | data).items():
        text = json.dumps(value, allow_nan=False)
        if isinstance(value, dict) and len(text) > _WIDTH:
            inner = (f"    {json.dumps(name)}: {json.dumps(part, allow_nan=False)}" for name, part in value.items())
            text = "{\n" + ",\n".join(inner) + "\n  }"
        elif isinstance(value, list) and len(text) > _WIDTH:
            text = "[\n" + ",\n".join(f"    {json.dumps(part, allow_nan=False)}" for part in value) + "\n  ]"
        lines.append(f"  {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"
