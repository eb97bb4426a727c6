"""Check of an FMU as an engine (``hexjet fmu check``): its soundness and its response to the throttle.

The archive is read here, where nothing of it is executed; the FMU is run in a process of its own
(``cosim.engine.qualify.supervisor``), part by part (``cosim.engine.qualify.trial``).  A flight asks the same of an
engine that is not of the library before it loads it.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from cosim.base.errors import InputError
from cosim.base.storage.files import write_if_possible
from cosim.base.storage.user import cache_folder
from cosim.base.trust import need_trust
from cosim.engine.fmu.air import STANDARD_AIR, Air
from cosim.engine.fmu.archive import Archive
from cosim.engine.fmu.container import DAMAGE, Zip
from cosim.engine.fmu.mapping import ConstantValue
from cosim.engine.fmu.port_kinds import KINDS
from cosim.engine.fmu.ports import normalise_name
from cosim.engine.fmu.unpacked import unpack
from cosim.engine.fmu.variables import Port, Variable
from cosim.engine.load import load_unchecked
from cosim.engine.measure import EngineMeasurement, measure_once
from cosim.engine.qualify.report import CheckReport
from cosim.engine.qualify.supervisor import READ, STARTED, ChildResult, Limits, run_in_child
from cosim.engine.response import NO_CHANGE, Response, find_curve_problems
from cosim.engine.spec import EngineSource, EngineSpec, check_whole_steps, find_source, resolve_parameters

DEFAULT_STEP_S = 0.004  # of the Hex-Jet's control loop
LIMITS = Limits()
# A trial makes some 100,000 steps: an FMU that prints a line in each would fill a log with megabytes in every minute.
MOST_PRINTED = 2**20  # bytes
MOST_BLEMISHES = 10  # most lines shown, because a tool repeats a violation in every variable

PARTS = (
    "validate", "load", "start", "run", "repeat", "measure", "respond", "together", "reset", "time", "grow",
)  # fmt: skip
NEEDED = ("load", "start", "run", "measure")  # parts whose failure ends the check
DESCRIBED = ("name", "type", "unit", "min", "max", "start", "description")


# ---- the check


def make_limits(seconds: float) -> Limits:
    """Return limits for a check of at most ``seconds``, within which a single call to the FMU must return too."""
    return replace(LIMITS, seconds=seconds, silence=min(LIMITS.silence, seconds))


def check_fmu(
    name_or_path: str,
    step: float | None = None,
    parameters: Mapping[str, ConstantValue] | None = None,
    limits: Limits | None = None,
) -> CheckReport:
    """Check an FMU by path, by mapping file, or by its name in the library.

    ``step`` [s] is the control step it would be flown with: unless given, that of the Hex-Jet, for an engine of the
    library its own.  Whatever the FMU does, it does in another process.

    Raises InputError if the file cannot be used as an engine at all: one line that says why.
    """
    return _check(name_or_path, step, parameters or {}, limits or LIMITS)[0]


def _check(
    name_or_path: str,
    step: float | None,
    parameters: Mapping[str, ConstantValue],
    limits: Limits,
    parts: Sequence[str] = PARTS,
    air: Air = STANDARD_AIR,
) -> tuple[CheckReport, EngineMeasurement | None]:
    source = find_source(name_or_path)
    need_trust(source.code, f"engine {source.path.name}")
    archive = source.archive
    step = step or (source.engine.internal_step if source.engine else DEFAULT_STEP_S)
    check_whole_steps(archive, source.engine, step)
    values, settings = resolve_parameters(source, parameters)
    unpack(archive).close()
    report = CheckReport(
        path=str(source.path),
        name=archive.model,
        fmi_version=archive.version,
        sha256=archive.sha256,
        step=step,
        ports=[_described_port(name, port, source) for name, port in archive.ports.items()],
        inputs=_described(archive.inputs),
        outputs=_described(archive.outputs),
        parameters=[
            {**described, "value": _value(v, values.get(v.name, v.start))}
            for v, described in zip(archive.parameters, _described(archive.parameters), strict=True)
        ],
        problems=_checksums(archive.path),
        notes=_notes(archive, source.engine is not None),
    )
    if report.problems:
        return report, None
    # the child runs in a folder of its own
    name = name_or_path if source.engine else str(Path(name_or_path).absolute())
    task = {"name": name, "parameters": {v.name: value for v, value in settings}, "step": step, "air": list(air)}
    measured = _TrialRunner(task, limits, report).all(parts)
    if source.engine is None and (report.apart or (tuple(parts) == PARTS and report.ok)):
        record_misbehaviour(archive.sha256, report.apart or "")
    return report, measured


class _TrialRunner:
    """Runner of a trial's parts in child processes, a new one after each crash."""

    def __init__(self, task: Mapping[str, Any], limits: Limits, report: CheckReport) -> None:
        self._task, self._limits, self._report = task, limits, report
        self._seconds_left = limits.seconds
        self._printed_bytes = 0
        self._findings: dict[str, Any] = {}

    def all(self, parts: Sequence[str]) -> EngineMeasurement | None:
        """Run the parts, fill in the report, and return the measurement for flights."""
        while parts:
            apart = self._run(parts)
            begun_parts = [message["part"] for message in apart.messages if "part" in message]
            is_over = any(message.get("over") for message in apart.messages)
            last = begun_parts[-1] if begun_parts else parts[0]
            if is_over or not apart.has_crashed or last in NEEDED:
                break
            parts = parts[parts.index(last) + 1 :]  # a crash in one part need not hide what the others have to say
        measured = self._fill_report()
        if self._findings.get("own"):
            self._note_misbehaviour(self._findings["own"])
        if "digest" in self._findings and self._seconds_left > 0.0 and not self._report.problems:
            self._repeat_run()
        if self._printed_bytes > MOST_PRINTED:
            self._add_problems([f"prints too much: {self._printed_bytes / 2**20:.0f} MB while it was tried"])
        elif self._printed_bytes:
            self._report.notes.append(
                f"prints to standard output or standard error ({self._printed_bytes} bytes in the trial)"
            )
        if self._printed_bytes:
            self._note_misbehaviour("prints to standard output or standard error")
        return measured

    def _note_misbehaviour(self, what: str) -> None:
        """Record the first misbehaviour, for flights: the worst comes first."""
        self._report.apart = self._report.apart or what

    def _run(self, parts: Sequence[str]) -> ChildResult:
        limits = replace(self._limits, seconds=max(0.1, self._seconds_left))
        apart = run_in_child({**self._task, "parts": list(parts)}, limits)
        self._seconds_left -= apart.seconds
        for message in apart.messages:
            findings = message.get("found", {})
            notes = self._report.notes
            notes += [note for note in findings.get("notes", []) if note not in notes]
            self._findings |= findings
            self._add_problems(message.get("problems", []))
        if apart.problem is not None:
            self._add_problems([apart.problem])
            if (apart.has_crashed or apart.has_hung) and apart.moment not in (STARTED, READ):
                self._note_misbehaviour(apart.problem)
        if apart.has_left_processes:
            self._add_problems(["leaves processes behind"])
            self._note_misbehaviour("leaves processes behind")
        self._printed_bytes += apart.printed_bytes
        return apart

    def _repeat_run(self) -> None:
        """Repeat the run in another process, where addresses, process number and time of day differ."""
        digest = self._findings.pop("digest")
        if self._run(["run"]).problem is None:
            self._report.processes_agree = self._findings.get("digest") == digest
            if not self._report.processes_agree:
                self._add_problems(["two processes with the same throttle differ"])

    def _add_problems(self, problems: Iterable[str]) -> None:
        for problem in problems:
            if problem not in self._report.problems:
                self._report.problems.append(problem)

    def _fill_report(self) -> EngineMeasurement | None:
        findings, report = self._findings, self._report
        for part in fields(CheckReport):
            if part.name in findings and part.name != "notes":
                setattr(report, part.name, findings[part.name])
        for way in ("up", "down"):
            if way in findings:
                response = Response(**findings[way])
                setattr(report, f"delay_samples_{way}", response.delay)
                setattr(report, f"rise_time_{way}", response.rise)
        if "measured" not in findings:
            return None
        measured = make_measurement_adapter().validate_python(findings["measured"])
        if measured.quiet > NO_CHANGE:
            report.notes.append(
                f"its thrust trembles at rest; it is taken to stand still to {measured.quiet:g} of itself"
            )
        return measured


@cache
def make_measurement_adapter() -> TypeAdapter[EngineMeasurement]:
    """Return what turns a measurement into JSON and back, for transmission and caching."""
    return TypeAdapter(EngineMeasurement)


def _described(variables: Iterable[Variable]) -> list[dict[str, Any]]:
    return [{key: getattr(v, key) for key in DESCRIBED} for v in variables]


def _value(variable: Variable, value: float | None) -> float | str | None:
    """Return a parameter's value in effect; an item of an enumeration by its name."""
    return {float(item): name for name, item in variable.items}.get(value, value) if value is not None else None


def _described_port(name: str, port: Port, source: EngineSource) -> dict[str, Any]:
    v = port.variable
    mapped = source.engine.ports if source.engine else source.mapping.ports.model_dump(exclude_none=True)
    if name in mapped:
        origin = "in engine.toml" if source.engine else "in the mapping file"
    elif normalise_name(v.name) in {normalise_name(name), normalise_name(KINDS[name].library_name)}:
        origin = "by its name"
    else:
        origin = "by its unit" if name == "thrust" else "as the only one"
    is_lever = KINDS[name].causality == "input" and name in ("throttle",)
    return {
        "port": name,
        "name": v.name,
        "unit": v.unit if name in ("throttle", "run", "start") else _unit(name, source) or v.unit,
        "from": port.value(0.0) if is_lever else None,
        "to": port.value(1.0) if is_lever else None,
        "scale": port.scale,
        "offset": port.offset,
        "si": KINDS[name].quantity.si,
        "found": origin,
    }


def _unit(name: str, source: EngineSource) -> str | None:
    mapped = None if source.engine else getattr(source.mapping.units, name, None)
    return str(mapped) if mapped else None


def _checksums(path: Path) -> list[str]:
    try:
        with Zip(path) as fmu:
            damaged = fmu.testzip()
    except DAMAGE as error:
        raise InputError(f"{path}: {error}") from error
    return [f"{damaged} fails its checksum"] if damaged else []


def note_harmless_violations(archive: Archive) -> list[str]:
    """Return notes on violations of FMI in an archive's description that have no effect on stepping."""
    shown = archive.harmless_violations[:MOST_BLEMISHES]
    lines = [f"blemish in its description, of no effect on stepping: {text}" for text in shown]
    rest = len(archive.harmless_violations) - len(shown)
    return [*lines, f"and {rest} more blemishes like these"] if rest else lines


def _notes(archive: Archive, library: bool) -> list[str]:
    notes = [*note_harmless_violations(archive), *archive.port_notes]
    if archive.once_per_process:
        notes.append("may be instantiated once per process: every engine gets a library of its own")
    if not library and "fuel_flow" not in archive.ports:
        notes.append("reports no fuel flow: the tank of a vehicle stays full with it")
    return notes


# ---- before a flight


def load_engine(
    name_or_path: str,
    parameters: Mapping[str, float],
    step: float,
    *,
    unchecked: bool = False,
    measured: EngineMeasurement | None = None,
    air: Air = STANDARD_AIR,
    isolated: bool = False,
) -> EngineSpec:
    """Find, validate and measure an engine that will be stepped by ``step`` seconds.

    As :func:`cosim.engine.load.load_unchecked`, but an engine that is not of the library is tried in another process
    before this one loads it, and refused if ``hexjet fmu check`` finds it unfit; ``unchecked`` leaves that out.  One
    that was found to crash, hang, print or bring a run time of its own asks for a process of its own, unless its
    mapping file says ``isolated = false``.  This process loads none that asks for one, nor any where ``isolated``
    is set.
    An archive is code, which the user has to trust.

    Raises InputError: one line that names the engine, what is wrong, and what is allowed.
    """
    source = find_source(name_or_path)
    need_trust(source.code, f"engine {source.path.name}")
    is_harmless = source.engine is not None or source.mapping.isolated is False
    isolated = isolated or bool(
        source.mapping.isolated or (not is_harmless and read_misbehaviour(source.archive.sha256))
    )
    measure_foreign: Callable[[str, Mapping[str, float], float, Air], EngineMeasurement] | None
    if unchecked or source.engine is not None:
        measure_foreign = measure_unchecked if isolated else None
    else:
        measure_foreign = partial(measure_in_child, isolated=isolated)
    spec = load_unchecked(
        name_or_path, parameters, step, measured=measured, air=air, measure_foreign=measure_foreign, source=source
    )
    spec = replace(spec, isolated=True) if isolated else spec
    misbehaviour = "" if is_harmless else read_misbehaviour(source.archive.sha256)  # known only now that it is measured
    return replace(spec, isolated=True, misbehaviour=misbehaviour) if misbehaviour else spec


_fit_engines: set[tuple[str, str, float]] = set()  # checked in this process: sha256 of the archive, mapping, step


def measure_in_child(
    name_or_path: str, parameters: Mapping[str, float], step: float, air: Air = STANDARD_AIR, isolated: bool = False
) -> EngineMeasurement:
    """Check a user's FMU in another process, and return its static curve and response.

    The result is cached by archive, mapping file, parameters, step and air, and a fit FMU is not checked again: in
    another ``air`` than the standard one at sea level it is only measured.  A process that flies it again, with other
    parameters or in another air, measures it itself, or in another process where ``isolated`` is set.

    Raises InputError if it is unfit: one line with the first problem.  InstanceError, ResponseError if it fails here.
    """
    source = find_source(name_or_path)
    key = source.archive.sha256, source.mapping.model_dump_json(), step
    is_fit = key in _fit_engines
    path = _cache_path(source, parameters, step, air)
    cached = _read_cached(path)
    if cached is None and is_fit and (isolated or not read_misbehaviour(source.archive.sha256)):
        measure = measure_unchecked if isolated else _measure_here
        measured = measure(name_or_path, parameters, step, air)
        _need_no_problems(source, find_curve_problems(measured.curve, measured.quiet, source.archive.starting.rest_n))
        return measured
    measured = cached or _check_and_measure(name_or_path, source, parameters, step, air)
    if cached is None:
        write_if_possible(path, make_measurement_adapter().dump_json(measured).decode())
    _fit_engines.add(key)
    return measured


_unjudged_measurements: dict[Path, EngineMeasurement] = {}  # measured in this process's children without being judged


def measure_unchecked(
    name_or_path: str, parameters: Mapping[str, float], step: float, air: Air = STANDARD_AIR
) -> EngineMeasurement:
    """Measure as :func:`measure_in_child` in another process, without a verdict on the engine.

    Raises InputError if it cannot be measured at all.
    """
    source = find_source(name_or_path)
    path = _cache_path(source, parameters, step, air)
    result = _unjudged_measurements.get(path) or _read_cached(path)
    if result is None:
        report, measured = _check(name_or_path, step, parameters, LIMITS, ("measure",), air)
        if measured is None:
            raise InputError(f"{source.path}: {report.problems[0]}")
        result = measured
    _unjudged_measurements[path] = result
    return result


def _measure_here(name_or_path: str, parameters: Mapping[str, float], step: float, air: Air) -> EngineMeasurement:
    source = find_source(name_or_path)
    _, settings = resolve_parameters(source, parameters)
    return measure_once(source.archive, settings, source.archive.start, step, air)


def _check_and_measure(
    name_or_path: str, source: EngineSource, parameters: Mapping[str, float], step: float, air: Air
) -> EngineMeasurement:
    parts: Sequence[str] = PARTS
    if air != STANDARD_AIR:
        measure_in_child(name_or_path, parameters, step)
        parts = ("measure",)
    report, measured = _check(name_or_path, step, parameters, LIMITS, parts, air)
    _need_no_problems(source, report.problems)
    assert measured is not None
    return measured


def _need_no_problems(source: EngineSource, problems: Sequence[str]) -> None:
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise InputError(
            f"{source.path}: is not fit to fly: {problems[0]}{more}; hexjet fmu check says all, "
            "--unchecked-engine flies it all the same"
        )


def _cache_path(source: EngineSource, parameters: Mapping[str, float], step: float, air: Air) -> Path:
    """Return the path of an engine's cached measurement; its name is a hash of everything that it depends on."""
    key = {
        "archive": source.archive.sha256,
        "mapping": source.mapping.model_dump(mode="json"),
        "parameters": dict(sorted(parameters.items())),
        "step": step,
        "air": air,
        "python": sys.version,
        "code": _code(),
    }
    name = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
    return cache_folder() / "engines" / f"{name}.json"


@cache
def _code() -> str:
    """Return a hash of this package's modules, so that results of older versions are not used."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*")):
        if path.suffix in (".py", ".c"):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _read_cached(path: Path) -> EngineMeasurement | None:
    """Return a cached measurement, or None if there is none that can be read."""
    try:
        measured = make_measurement_adapter().validate_json(path.read_bytes())
        sane = len(measured.curve.throttle) == len(measured.curve.thrust) > 1 and measured.response.delay >= 0
        return measured if sane else None
    except (OSError, ValueError):
        return None


# ---- what a check found, in the user's cache: a file may be deleted at any time, and counts as missing if unreadable


def read_misbehaviour(sha256: str) -> str:
    """Return why an archive needs a process of its own according to its last check, else an empty string."""
    try:
        return _record_path(sha256).read_text(encoding="utf-8").strip()[:300]
    except (OSError, ValueError):
        return ""


def record_misbehaviour(sha256: str, why: str) -> None:
    """Record why an archive needs a process of its own; an empty ``why`` after a complete check removes the record."""
    if why:
        write_if_possible(_record_path(sha256), why)
        return
    with suppress(OSError):
        _record_path(sha256).unlink(missing_ok=True)


def _record_path(sha256: str) -> Path:
    return cache_folder() / "apart" / f"{sha256}.txt"
