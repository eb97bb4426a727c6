"""A run and its folder: begun before the first step, finished after the last, opened again later.

``summary.json``, ``scenario.toml`` with the files it names, ``flight.parquet`` and ``report.html``.  While the flight
lasts its rows are in ``flight.arrows``; that file goes only when everything made from it is in place, so that a run
which was killed is finished by :func:`open_run`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from cosim.base.errors import FlightError, InputError, nearest
from cosim.base.outcomes import Outcome, Verdict
from cosim.base.protocols import Column
from cosim.base.removed import WRITTEN_BEFORE, is_written_before
from cosim.base.storage.files import lock_file, read_file, read_text, write_whole
from cosim.base.storage.toml import toml_text
from cosim.base.trust import remember_written
from cosim.results.log.arrow import ParquetLog, StreamSink, read_note, stream_to_parquet
from cosim.results.log.columns import COLUMNS
from cosim.results.log.recorder import BackgroundSink, KeepingSink, Log, MemorySink, Recorder
from cosim.results.metrics import Metrics
from cosim.results.summary import Setup, Summary, summarize, summary_json
from cosim.simulation.pacing import PaceReport
from cosim.simulation.plugins import CustomMetric, make_unavailable_metric
from cosim.spec.scenario import Scenario

SUMMARY, SCENARIO, LOG, STREAM, REPORT = (  # files in a run's folder
    "summary.json",
    "scenario.toml",
    "flight.parquet",
    "flight.arrows",
    "report.html",
)
TELEMETRY = "telemetry.tlog"  # recorded MAVLink frames
AUTOPILOT = "autopilot.jsonl"  # states and messages of the autopilot
REQUESTS = "requests.jsonl"  # requests to the autopilot
RUN_FILES = (SUMMARY, SCENARIO, LOG, STREAM, REPORT, TELEMETRY, AUTOPILOT)  # all files of a run


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
    flown: Scenario | None = None  # only in the process that flew it

    @property
    def scenario(self) -> Scenario:
        """Resolved scenario, read from the run's folder if needed.  Raises InputError."""
        if self.flown is not None:
            return self.flown
        assert self.folder is not None
        return Scenario.read(self.folder / SCENARIO)

    def _repr_html_(self) -> str:
        """Return a table for notebooks: outcome, what flew, and the metrics."""
        summary = self.summary
        heading = f"{summary.scenario}: {summary.ending}"
        configuration = f"{summary.aircraft}, engine {summary.engine_shown}, controller {summary.controller_shown}, "
        configuration += f"seed {summary.seed}"
        configuration += f"; {summary.by_hand} steps by hand" if summary.by_hand else ""
        user = summary.own_controller
        configuration += (
            "; an object of a program, which no file makes again" if user is not None and not user.again else ""
        )
        notes = "".join(f"<br>note: {escape(note)}" for note in summary.notes)
        return f"<p><b>{escape(heading)}</b><br>{escape(configuration)}{notes}</p>{summary.metric_table()}"

    def __repr__(self) -> str:
        where = "" if self.folder is None else f", {self.folder}"
        return f"<Run {self.summary.scenario}: {self.outcome}, {len(self.log)} steps{where}>"

    @property
    def outcome(self) -> Outcome:
        """How the flight ended."""
        return self.summary.outcome

    @property
    def reason(self) -> str:
        """Reason for the end of the flight, in words."""
        return self.summary.reason

    @property
    def verdict(self) -> Verdict | None:
        """Verdict on the flight, such as ``as planned``; None if the folder does not say."""
        return self.summary.verdict

    @property
    def metrics(self) -> dict[str, Any]:
        """Metrics by name: of roll, pitch, yaw, ``altitude``, ``position``, ``speed`` and the whole flight."""
        return _MetricsByName(self.summary)

    @property
    def files(self) -> dict[str, Path]:
        """Files in the run's folder by kind; ``report`` is the page.  Empty without a folder."""
        paths = [] if self.folder is None else [self.folder / name for name in RUN_FILES]
        return {path.stem: path for path in paths if path.is_file()}

    @property
    def report(self) -> Path | None:
        """Path of the run's HTML page, or None."""
        return self.files.get("report")

    def to_dict(self) -> dict[str, Any]:
        """Return the summary as numbers, texts, lists and tables, SI, which the command prints as JSON."""
        return self.summary.model_dump(mode="json")

    def table(self, *names: str) -> Any:
        """Return the log as a ``pandas.DataFrame``, one row a control step, the time [s] as its index.

        >>> fly("hover", settings={"duration_s": 0.2}).table()["altitude_m"].shape
        (50,)

        Parameters
        ----------
        *names : str
            The columns; all of them where none is named.
        """
        return self.log.table(*names)


class _MetricsByName(dict[str, Any]):
    """Metrics by name: of the axes, which iteration lists, and of the whole flight."""

    def __init__(self, summary: Summary) -> None:
        super().__init__(summary.metrics)
        self._summary = summary

    def __missing__(self, name: str) -> Any:
        others = Metrics.model_fields.keys() - {"axes"}
        if name not in others:
            raise KeyError(f"no metric {name!r}; {nearest(name, {*self, *others})}")
        return getattr(self._summary, name)


class Recording:
    """A run that is being flown: an observer, and at the end :meth:`finish`."""

    def __init__(
        self,
        setup: Setup,
        scenario: Scenario,
        sink: KeepingSink | StreamSink,
        background: bool = False,
        columns: Sequence[Column] = COLUMNS,
        metrics: Sequence[CustomMetric] = (),
    ) -> None:
        self._metrics = metrics
        self._setup = setup
        self._scenario = scenario
        self._sink = sink
        self._behind = BackgroundSink(sink) if background else None
        self._recorder = Recorder(setup.step_s, self._behind or sink, columns)
        self.observe = self._recorder.observe
        self.columns = len(columns)

    def replace_scenario(self, scenario: Scenario) -> None:
        """Replace the scenario by the one flown, with commanded faults.  Raises FlightError."""
        self._scenario = scenario
        if isinstance(self._sink, StreamSink):
            self._scenario = scenario.seen_from(self._sink.path.parent)
            write_whole(self._sink.path.with_name(SCENARIO), scenario_toml(scenario), FlightError)

    def note_repeatable(self, same: bool | None) -> None:
        """Record whether an external controller repeats its answers; None: not checked."""
        custom = self._setup.own_controller
        if custom is not None and same is not None:
            changed = custom.model_copy(update={"repeatable": same})
            self._setup = self._setup.model_copy(update={"own_controller": changed})

    def shorten_scenario(self, steps: int) -> None:
        """End the scenario of an open-ended flight at the last flown step.  Raises FlightError."""
        if steps:
            duration = steps * self._setup.step_s
            self._setup = self._setup.model_copy(update={"planned_s": duration})
            self.replace_scenario(self._scenario.replace(duration_s=duration))

    def note_steps(self, steps: int, by_hand: int) -> None:
        """Record the steps and how many a program commanded, which makes expectations void."""
        changed: dict[str, object] = {
            "planned_s": steps * self._setup.step_s,
            "by_hand": by_hand,
            "expectation": None,
            "requires": [],
        }
        self._setup = self._setup.model_copy(update=changed)

    def finish(self, outcome: Outcome, reason: str, wall_s: float | None = None, pace: PaceReport | None = None) -> Run:
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
            summary, log = _convert_to_parquet(folder, self._setup, outcome, reason, wall_s, pace, self._metrics)
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
    metrics: Sequence[CustomMetric] = (),
) -> Recording:
    """Begin a run in ``folder`` or in memory, where ``sink`` may keep a part.

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
            write_whole(folder / name, source if isinstance(source, bytes) else read_file(source), FlightError)
        write_whole(folder / SCENARIO, scenario_toml(scenario), FlightError)
        remember_written(folder)
    except (OSError, FlightError, InputError) as error:
        stream.close()
        stream.path.unlink(missing_ok=True)
        raise InputError(str(error)) from error
    return Recording(setup, scenario, stream, background, columns, metrics)


def claim_folder(folder: Path, files: Mapping[str, Path | bytes] | None = None) -> None:
    """Make a run's folder if needed.  Raises InputError if it holds a run or is not writable."""
    try:
        _refuse_if_used(folder, files or {})
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}") from error
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder}: cannot be written to")


def open_run(folder: Path | str) -> Run:
    """Return the run of a folder as :func:`cosim.fly` does; of a killed run, what it had written.

    >>> open_run(fly("hover", "runs/one", settings={"duration_s": 0.2}).folder).summary.steps
    50

    Parameters
    ----------
    folder : Path or str
        Where it was flown into.

    Raises
    ------
    InputError
        If there is no run, if it is still being flown, or if its files cannot be read.
    """
    folder = Path(folder)
    if (folder / STREAM).is_file():
        _recover_run(folder)
    for name in (SUMMARY, LOG):
        if not (folder / name).is_file():
            raise InputError(f"{folder}: no run here ({name} is missing)")
    path = folder / SUMMARY
    try:
        summary = Summary.model_validate_json(read_text(path))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{path}: not a run's summary: {key + ': ' if key else ''}{first['msg']}") from error
    if is_written_before(summary.versions.get("hexjet-cosim")):
        raise InputError(f"{folder}: {WRITTEN_BEFORE}")
    return Run(summary, ParquetLog(folder / LOG), folder)


def recover_killed_run(scenario: Path) -> None:
    """Write log and summary of a run whose process was killed, given its scenario file.

    Raises InputError while the run is being flown.
    """
    if scenario.name == SCENARIO and (scenario.parent / STREAM).is_file():
        _recover_run(scenario.parent)


def _convert_to_parquet(
    folder: Path,
    setup: Setup,
    outcome: Outcome,
    reason: str,
    wall_s: float | None,
    pace: PaceReport | None = None,
    custom: Sequence[CustomMetric] = (),
) -> tuple[Summary, ParquetLog]:
    """Write the log and the summary of a stream, and keep the stream."""
    try:
        stream_to_parquet(folder / STREAM, folder / LOG)
        log = ParquetLog(folder / LOG)
        with log.keep_open():
            summary = summarize(setup, log, outcome, reason, wall_s, pace, custom)
        write_whole(folder / SUMMARY, summary_json(summary).encode(), FlightError)
    except FlightError as error:
        raise FlightError(
            f"{error}; what was flown is kept in {folder / STREAM}: hexjet show {folder} --page finishes it"
        ) from error
    return summary, log


def _recover_run(folder: Path) -> None:
    """Finish a run whose process was killed."""
    stream = folder / STREAM
    with lock_file(stream, f"{folder}: a run is still being recorded here; wait until it ends"):
        if not (folder / SUMMARY).is_file():
            note = read_note(stream)
            if note is None:
                raise InputError(f"{stream}: torn before its first row; nothing of this run can be recovered")
            try:
                setup = Setup.model_validate_json(note)
            except ValidationError as error:
                raise InputError(f"{stream}: not a stream of this program") from error
            custom = [make_unavailable_metric(block.name) for block in setup.brought if block.key == "metrics"]
            summary, log = _convert_to_parquet(folder, setup, "failed", "interrupted", None, custom=custom)
            _shorten_scenario(folder, summary, len(log))
        elif not (folder / LOG).is_file():
            stream_to_parquet(stream, folder / LOG)
        stream.unlink()


def _shorten_scenario(folder: Path, summary: Summary, steps: int) -> None:
    """End an open-ended scenario where its log ends."""
    scenario = Scenario.read(folder / SCENARIO)
    if scenario.requests is not None and steps:
        shortened = {"planned_s": steps * scenario.step_s}
        write_whole(folder / SCENARIO, scenario_toml(scenario.replace(duration_s=shortened["planned_s"])), FlightError)
        write_whole(folder / SUMMARY, summary_json(summary.model_copy(update=shortened)).encode(), FlightError)


def _refuse_if_used(folder: Path, files: Mapping[str, Path | bytes]) -> None:
    for name in files:
        if name in RUN_FILES or Path(name).name != name:
            raise InputError(f"scenario: a file named {name!r} cannot be copied into a run's folder")
    existing = [name for name in (*RUN_FILES, *files) if (folder / name).exists()]
    if existing:
        raise InputError(f"{folder}: already holds a run ({existing[0]}); choose another folder or remove it")


def scenario_toml(scenario: Scenario) -> bytes:
    """Return a scenario as the text of a TOML file."""
    return toml_text(scenario.model_dump(mode="json", exclude_none=True)).encode()
