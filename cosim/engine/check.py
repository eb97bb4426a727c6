"""``hexjet fmu check``: is this FMU a sound engine, and how does it answer its throttle?"""

from __future__ import annotations

import time
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cosim.engine import _bank
from cosim.engine.archive import DAMAGE, Archive, Variable, unpack, validate
from cosim.engine.response import Hold, Response, ResponseError, settle, static_curve, step_response, window_for
from cosim.engine.slave import Slave, SlaveError
from cosim.engine.spec import find_archive, need_whole_steps
from cosim.errors import InputError

DEFAULT_STEP_S = 0.004
TRIAL_STEPS = 500
SAVED_AT = 37
TIMED_STEPS = 20_000


@dataclass
class CheckReport:
    """What was found; ``problems`` is empty for a sound engine, ``notes`` is worth knowing.

    Times are in s, thrusts in N.  A field is None where a problem before it kept it from being found.
    """

    path: str
    name: str
    fmi_version: str
    sha256: str
    step: float
    inputs: list[dict[str, Any]]
    outputs: list[dict[str, Any]]
    parameters: list[dict[str, Any]]
    throttle: list[float] | None = None  # of the static curve
    thrust: list[float] | None = None
    delay_samples_up: int | None = None  # communication steps
    delay_samples_down: int | None = None
    rise_time_up: float | None = None  # 10 to 90 %
    rise_time_down: float | None = None
    deterministic: bool | None = None
    reset_restores_start: bool | None = None
    state_restores: bool | None = None  # None also if the FMU does not claim it
    serialized_state_restores: bool | None = None
    microseconds_per_step: float | None = None
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Whether no problem was found."""
        return not self.problems

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and strings, for JSON."""
        return {"ok": self.ok, **asdict(self)}

    def lines(self) -> list[tuple[str, str]]:
        """What to tell a reader, label and text, problems left out."""
        rows = [
            ("file", self.path),
            ("model", f"{self.name}, FMI {self.fmi_version}, sha256 {self.sha256[:12]}"),
            *(("input", _variable_text(v)) for v in self.inputs),
            *(("output", _variable_text(v)) for v in self.outputs),
            *(("parameter", _variable_text(v)) for v in self.parameters),
            ("step", f"{self.step:g} s"),
        ]
        if self.throttle is not None and self.thrust is not None:
            shown = range(0, len(self.throttle), len(self.throttle) // 5)
            points = (f"{self.throttle[k]:g}: {round(self.thrust[k], 3) + 0.0:g}" for k in shown)
            rows.append(("static thrust [N]", ", ".join(points)))
        for way, delay, rise in (
            ("up", self.delay_samples_up, self.rise_time_up),
            ("down", self.delay_samples_down, self.rise_time_down),
        ):
            if delay is not None and rise is not None:
                text = f"delay {delay} samples ({delay * self.step:g} s), then 10 to 90 % in {rise:.4g} s"
                rows.append((f"throttle {way}", text))
        rows += [
            ("runs repeat", _verdict(self.deterministic)),
            ("reset", _verdict(self.reset_restores_start)),
            ("saved state", _verdict(self.state_restores)),
            ("serialized state", _verdict(self.serialized_state_restores)),
        ]
        if self.microseconds_per_step is not None:
            rows.append(("one step takes", f"{self.microseconds_per_step:.2f} us"))
        return [*rows, *(("note", note) for note in self.notes)]


def _variable_text(v: dict[str, Any]) -> str:
    unit = "" if v["unit"] in (None, "1") else f" {v['unit']}"
    start = "" if v["start"] is None else f" = {v['start']:g}{unit}"
    limits = "" if v["min"] is None and v["max"] is None else f", {_limit(v['min'])} to {_limit(v['max'])}"
    what = f": {v['description']}" if v["description"] else ""
    return f"{v['name']}{start or unit}{limits}{what}"


def _limit(value: float | None) -> str:
    return "any" if value is None else f"{value:g}"


def _verdict(found: bool | None) -> str:
    return {True: "good", False: "bad", None: "not tried"}[found]


def check_fmu(path_or_name: str, step: float | None = None) -> CheckReport:
    """Check an FMU by path or by its name in the library, at its own step size unless ``step`` [s] is given.

    Raises InputError if the file cannot be loaded as an engine at all: one line that says why.
    """
    archive, engine = find_archive(path_or_name)
    step = step or archive.internal_step or archive.preferred_step or DEFAULT_STEP_S
    need_whole_steps(archive, engine, step)
    report = CheckReport(
        path=str(archive.path),
        name=archive.model,
        fmi_version=archive.version,
        sha256=archive.sha256,
        step=step,
        inputs=_described(archive.inputs),
        outputs=_described(archive.outputs),
        parameters=_described(archive.parameters),
    )
    report.problems += _checksums(archive.path)
    if report.problems:
        return report
    report.problems += validate(archive.path)
    report.notes += _notes(archive)
    with unpack(archive) as folder:
        trial = _Trial(archive, Path(folder), step)
        for part in (_respond, _repeat, _reset, _restore, _serialize, _time):
            try:
                part(trial, report)
            except (SlaveError, ResponseError) as error:
                if str(error) not in report.problems:
                    report.problems.append(str(error))
    return report


def _described(variables: Iterable[Variable]) -> list[dict[str, Any]]:
    return [{key: value for key, value in asdict(v).items() if key != "reference"} for v in variables]


def _checksums(path: Path) -> list[str]:
    try:
        with zipfile.ZipFile(path) as fmu:
            damaged = fmu.testzip()
    except DAMAGE as error:
        raise InputError(f"{path}: {error}") from error
    return [f"{damaged} fails its checksum"] if damaged else []


def _notes(archive: Archive) -> list[str]:
    notes = []
    for variable, unit in ((archive.throttle, "1"), (archive.thrust, "N")):
        if variable.unit is None:
            notes.append(f"{variable.name} states no unit; it is taken to be in {unit}")
    if archive.throttle.min is None or archive.throttle.max is None:
        notes.append(f"{archive.throttle.name} states no range; it is taken to run from 0 to 1")
    if not archive.saves_state:
        notes.append("cannot save its state")
    if archive.once_per_process:
        notes.append("may be instantiated once per process: every engine gets a library of its own")
    return notes


class _Trial:
    """Fresh instances of one archive, and what it takes to step them."""

    def __init__(self, archive: Archive, folder: Path, step: float) -> None:
        self.archive, self.folder, self.step = archive, folder, step

    def run(self, use: Callable[[Slave, Hold], None]) -> None:
        """Hand a fresh, initialized instance to ``use`` and free it afterwards.

        Raises SlaveError if the FMU returns an error.
        """
        slave = Slave(self.archive, self.folder, "checked")
        try:
            slave.initialize((), 0.0)
            use(slave, self.hold(slave))
        except _bank.FailureError as failure:
            raise SlaveError(slave.explain(failure, "while it was stepped")) from failure
        finally:
            slave.close()

    def hold(self, slave: Slave, done: int = 0) -> Hold:
        """Stepping of an instance that has ``done`` steps behind it."""
        native = _bank.Bank([slave.row(done)], self.step)
        return lambda throttle, steps: native.hold(0, throttle, steps)


def _zigzag(hold: Hold, begin: int = 0, end: int = TRIAL_STEPS) -> list[float]:
    """Thrusts under a throttle that keeps changing within 0..1."""
    return [hold((k * 7 % 20) / 19, 1)[0] for k in range(begin, end)]


def _respond(trial: _Trial, report: CheckReport) -> None:
    def use(slave: Slave, hold: Hold) -> None:
        at_rest = settle(hold, 0.0, max(1, round(1.0 / trial.step)), trial.step)
        up = step_response(hold, at_rest, 1.0, trial.step)
        report.delay_samples_up, report.rise_time_up = up.delay, up.rise
        down: Response = step_response(hold, up.after, 0.0, trial.step)
        report.delay_samples_down, report.rise_time_down = down.delay, down.rise
        curve = static_curve(hold, window_for(max(up.delay, down.delay)), trial.step)
        report.throttle, report.thrust = list(curve.throttle), list(curve.thrust)
        if any(b <= a for a, b in zip(curve.thrust, curve.thrust[1:], strict=False)):
            report.problems.append("thrust does not rise with the throttle all the way from 0 to 1")

    trial.run(use)


def _repeat(trial: _Trial, report: CheckReport) -> None:
    runs: list[list[float]] = []

    def use(slave: Slave, hold: Hold) -> None:
        runs.append(_zigzag(hold))
        if len(runs) < 2 and not trial.archive.once_per_process:
            trial.run(use)  # the first instance still lives, as in a bank: they must not share anything

    while len(runs) < 2:
        trial.run(use)
    report.deterministic = runs[0] == runs[1]
    if not report.deterministic:
        report.problems.append("two runs with the same throttle differ")


def _reset(trial: _Trial, report: CheckReport) -> None:
    def use(slave: Slave, hold: Hold) -> None:
        first = _zigzag(hold)
        slave.call("reset")
        slave.initialize((), 0.0)
        report.reset_restores_start = _zigzag(trial.hold(slave)) == first
        if not report.reset_restores_start:
            report.problems.append("a run after a reset differs from the first")

    trial.run(use)


def _restore(trial: _Trial, report: CheckReport) -> None:
    if not trial.archive.saves_state:
        return

    def use(slave: Slave, hold: Hold) -> None:
        report.state_restores = _continues(trial, slave, hold, lambda state: state)
        if not report.state_restores:
            report.problems.append("a run from a restored state differs from the first")

    trial.run(use)


def _serialize(trial: _Trial, report: CheckReport) -> None:
    if not trial.archive.serializes_state:
        return

    def through_bytes(slave: Slave, state: Any) -> Any:
        return slave.call("deserializeFMUState", slave.call("serializeFMUState", state))

    def use(slave: Slave, hold: Hold) -> None:
        report.serialized_state_restores = _continues(trial, slave, hold, lambda state: through_bytes(slave, state))
        if not report.serialized_state_restores:
            report.problems.append("a run from a serialized state differs from the first")

    trial.run(use)


def _continues(trial: _Trial, slave: Slave, hold: Hold, copy: Callable[[Any], Any]) -> bool:
    """Save the state in mid-run, run on, go back to it, or to what ``copy`` makes of it, and see the same again."""
    _zigzag(hold, 0, SAVED_AT)
    saved = slave.call("getFMUState")
    first = _zigzag(hold, SAVED_AT)
    copied = copy(saved)
    slave.call("setFMUState", copied)
    second = _zigzag(trial.hold(slave, SAVED_AT), SAVED_AT)
    for state in {id(state): state for state in (saved, copied)}.values():
        slave.call("freeFMUState", state)
    return first == second


def _time(trial: _Trial, report: CheckReport) -> None:
    def use(slave: Slave, hold: Hold) -> None:
        begin = time.perf_counter()
        hold(0.5, TIMED_STEPS)
        report.microseconds_per_step = (time.perf_counter() - begin) / TIMED_STEPS * 1e6

    trial.run(use)
