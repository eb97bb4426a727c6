"""Check of an FMU as an engine (``hexjet engine check``): short flights in a process of its own, and what it answers.

The archive is read here, where nothing of it is executed; the engine is flown as an isolated one is in a flight
(``cosim.engine.isolated``).  A flight asks the same of an engine that is not of the library before it takes off.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from time import monotonic
from typing import Any

from cosim.base.errors import EngineError, InputError
from cosim.base.trust import need_trust
from cosim.engine.check_report import CheckReport
from cosim.engine.fmu.air import STANDARD_AIR
from cosim.engine.fmu.archive import Archive, validate
from cosim.engine.fmu.container import DAMAGE_ERRORS, Zip, note_unusual_names, read_bytes
from cosim.engine.fmu.description import is_harmless_violation
from cosim.engine.fmu.port_kinds import KINDS
from cosim.engine.fmu.ports import normalise_name
from cosim.engine.fmu.starting import Setting
from cosim.engine.fmu.unpacked import unpack
from cosim.engine.fmu.variables import ConstantValue, Port, Variable
from cosim.engine.isolated import LIMITS, EngineHost, IsolatedBank, measure_in
from cosim.engine.load import load_unchecked
from cosim.engine.measure import EngineMeasurement
from cosim.engine.response import (
    REST_TOLERANCE,
    Response,
    ResponseError,
    find_crossing,
    find_curve_problems,
    measure_step_response,
    note_flat_ends,
    settle,
    settling_window,
)
from cosim.engine.source import EngineSource, check_whole_steps, find_source, resolve_parameters
from cosim.engine.spec import EngineSpec

# Wall time of a check, after which its remaining tests are left out.
MAX_CHECK_S = 120.0
# Number of steps of each flight that are compared with the first flight.
MAX_COMPARED_STEPS = 500
# Attributes of a variable that reports have.
VARIABLE_ATTRIBUTES = ("name", "type", "unit", "min", "max", "start", "description")


def check_fmu(
    engine: str,
    step: float | None = None,
    parameters: Mapping[str, ConstantValue] | None = None,
    time_limit_s: float = MAX_CHECK_S,
) -> CheckReport:
    """Check an FMU by path, by mapping file, or by its name in the library.

    ``step`` [s] is the control step it would be flown with: unless given, that of the Hex-Jet, for an engine of the
    library its own.  Whatever the FMU does, it does in another process.

    Raises InputError if the file cannot be used as an engine at all: one line that says why.
    """
    return check_and_measure(engine, step, parameters or {}, time_limit_s)[0]


def check_and_measure(
    engine: str | EngineSource,
    step: float | None,
    parameters: Mapping[str, ConstantValue],
    time_limit_s: float = MAX_CHECK_S,
    default_step_s: float = 0.004,
) -> tuple[CheckReport, EngineMeasurement | None]:
    """Return the report of :func:`check_fmu`, and the measurements that a flight needs or None."""
    source = find_source(engine)
    need_trust(source.code, f"engine {source.path.name}")
    archive = source.archive
    step = step or (source.engine.internal_step if source.engine else default_step_s)
    check_whole_steps(archive, source.engine, step)
    values, settings = resolve_parameters(source, parameters)
    unpack(archive).close()
    report = CheckReport(
        path=str(source.path),
        name=archive.model,
        fmi_version=archive.version,
        sha256=archive.sha256,
        step=step,
        ports=[_describe_port(name, port, source) for name, port in archive.ports.items()],
        inputs=_describe_variables(archive.inputs),
        outputs=_describe_variables(archive.outputs),
        parameters=[
            {**described, "value": _effective_value(v, values.get(v.name, v.start))}
            for v, described in zip(archive.parameters, _describe_variables(archive.parameters), strict=True)
        ],
        problems=_library_checksums(archive.path),
        notes=_list_notes(archive, source.engine is not None),
    )
    if report.problems:
        return report, None
    check = _EngineCheck(source, {v.name: value for v, value in settings}, settings, report, time_limit_s)
    check.run_tests()
    return report, check.measured


class _EngineCheck:
    """Check of one engine by short flights, whose results fill a report."""

    def __init__(
        self,
        source: EngineSource,
        parameters: Mapping[str, float],
        settings: tuple[Setting, ...],
        report: CheckReport,
        time_limit_s: float,
    ) -> None:
        self._source, self._parameters, self._settings = source, parameters, settings
        self._report, self._step = report, report.step
        self._time_limit_s, self._deadline = time_limit_s, monotonic() + time_limit_s
        self._host: EngineHost | None = None
        self._spec: EngineSpec | None = None
        self._thrusts: list[float] = []
        self.measured: EngineMeasurement | None = None

    def run_tests(self) -> None:
        """Run all tests; the first three must pass for the others."""
        asked: Mapping[str, Callable[[], object]] = {
            "loads": self._test_loading,
            "responds": self._test_response,
            "runs": self._test_running,
            "repeats": self._test_repeating,
            "runs six at once": self._test_running_together,
            "resets": self._test_reset,
        }
        try:
            for question, ask in asked.items():
                self._report.answers[question] = True
                try:
                    ask()
                except (EngineError, ResponseError, InputError) as error:
                    self._fail(question, str(error))
                    if question in ("loads", "responds", "runs") or monotonic() > self._deadline:
                        break
        finally:
            if self._host is not None:
                self._host.end()

    def _fail(self, question: str, problem: str) -> None:
        """Record in the report that a question is answered by no, and the problem."""
        report = self._report
        if monotonic() > self._deadline:
            problem = f"takes too long: was not done within {self._time_limit_s:.3g} s; {problem}"
        report.answers[question] = False
        if "is not finite" in problem:
            report.answers["is finite"] = False
        if problem not in report.problems:
            report.problems.append(problem)

    @property
    def host(self) -> EngineHost:
        """Process that runs the engine, a new one after a failure."""
        if self._host is not None and not self._host.is_sound:
            self._host.end()
            self._host = None
        if self._host is None:
            self._host = EngineHost([self._source.archive], self._deadline)
        return self._host

    def _make_bank(self, count: int = 1, host: EngineHost | None = None) -> IsolatedBank:
        assert self._spec is not None
        return IsolatedBank([self._spec] * count, self._step, host=host or self.host)

    def _test_loading(self) -> None:
        """Test that the description is valid, the library loads and an instance can be made."""
        archive, report = self._source.archive, self._report
        # An archive with harmless violations was validated when it was loaded.
        complaints = [] if archive.harmless_violations else validate(read_bytes(archive.path))
        report.notes += note_unusual_names(archive.path)
        report.notes += [text for text in complaints if is_harmless_violation(text)]
        for text in complaints:
            if not is_harmless_violation(text):
                self._fail("loads", text)
        self.host.call(("load", archive), LIMITS.start_s, "when it was loaded")

    def _test_response(self) -> None:
        """Test that the engine responds: measure static curve and response, and record opening and closing."""
        archive, report = self._source.archive, self._report
        measured = self.measured = measure_in(self.host, archive, self._settings, self._step, STANDARD_AIR, True)
        report.throttle, report.thrust = list(measured.curve.throttle), list(measured.curve.thrust)
        rest = archive.starting.rest_n
        report.notes += note_flat_ends(measured.curve, measured.ripple, rest)
        if measured.ripple > REST_TOLERANCE:
            report.notes.append(f"its thrust ripples at rest; it counts as steady within {measured.ripple:g} of itself")
        for problem in find_curve_problems(measured.curve, measured.ripple, rest):
            self._fail("responds", problem)
        self._spec = load_unchecked(self._source, self._parameters, self._step, lambda *_: measured)
        self._record_responses(measured, rest)

    def _record_responses(
        self, measured: EngineMeasurement, rest: float, max_points: int = 2000, min_wrong_way: float = 0.02
    ) -> None:
        """Record the responses for the report, at most ``max_points`` each, and note a change the wrong way."""
        report, step, ripple, span = self._report, self._step, measured.ripple, abs(measured.curve.thrust[-1])
        course: list[float] = []

        def hold(throttle: float, steps: int) -> list[float]:
            thrusts = bank.follow(0, [throttle] * steps)
            course.extend(thrusts)
            return thrusts

        with self._make_bank() as bank:
            bank.reset(0.0)
            before = settle(hold, 0.0, settling_window(round(1.0 / step)), step, ripple, rest, span)
            for way, throttle in (("up", 1.0), ("down", 0.0)):
                course[:] = [before]
                response = measure_step_response(hold, before, throttle, step, ripple, rest)
                before = response.after
                shown = course[: _count_drawn_points(course, response)]
                every = max(1, len(shown) // max_points)
                setattr(report, f"delay_samples_{way}", response.delay)
                setattr(report, f"rise_time_{way}", response.rise)
                setattr(report, f"tenth_{way}", find_crossing(course, 0.1, response.before, response.after) * step)
                setattr(report, f"course_{way}", shown[::every])
                setattr(report, f"course_step_{way}", every * step)
                change = response.after - response.before
                back = max(((response.before - thrust) / change for thrust in course), default=0.0)
                if back > min_wrong_way + rest / abs(change):
                    share = f"{100.0 * back:.0f} % of the change"
                    report.notes.append(f"throttle {way}: thrust first goes the wrong way, by {share}")
        up, down = report.delay_samples_up or 0, report.delay_samples_down or 0
        # A throttle step may fall anywhere in the FMU's own communication step.
        if abs(up - down) > 2 and rest == 0.0:
            report.notes.append(
                f"its dead time differs, {up} samples up and {down} down: it may sample its throttle itself, every "
                f"{abs(up - down) * step:.2g} s or more, or have to be started first"
            )

    def _fly_zigzag(self, bank: IsolatedBank, steps: int, count: int = 1, throttle_0: float = 0.25) -> list[float]:
        """Fly with a varying throttle, and return the first engine's thrusts; the other engines are steps ahead."""
        bank.reset(throttle_0)
        throttles = ([zigzag_throttle(k + 3 * engine) for engine in range(count)] for k in range(steps))
        return [bank.step(k, tuple(throttle)).thrust[0] for k, throttle in enumerate(throttles)]

    def _test_running(self, run_s: float = 20.0) -> None:
        """Test that the engine runs for ``run_s`` of simulated time under a varying throttle."""
        with self._make_bank() as bank:
            self._thrusts = self._fly_zigzag(bank, max(MAX_COMPARED_STEPS, round(run_s / self._step)))
        self._report.answers["is finite"] = True

    def _test_repeating(self) -> None:
        """Test that thrusts repeat in another process with other addresses, process number and time."""
        host = EngineHost([self._source.archive], self._deadline)
        try:
            with self._make_bank(host=host) as bank:
                if self._fly_zigzag(bank, len(self._thrusts)) != self._thrusts:
                    self._fail("repeats", "two processes with the same throttle differ")
        finally:
            host.end()

    def _test_running_together(self, engines: int = 6) -> None:
        with self._make_bank(engines) as bank:
            if self._fly_zigzag(bank, MAX_COMPARED_STEPS, engines) != self._thrusts[:MAX_COMPARED_STEPS]:
                self._fail("runs six at once", "six of it at once do not answer as one alone: they are not independent")

    def _test_reset(self) -> None:
        """Test that thrusts repeat in one process after a reset."""
        with self._make_bank() as bank:
            for _ in range(2):
                if self._fly_zigzag(bank, MAX_COMPARED_STEPS) != self._thrusts[:MAX_COMPARED_STEPS]:
                    self._fail("resets", "a run after a reset differs from the first")


def zigzag_throttle(k: int) -> float:
    """Return a throttle sequence that visits 20 values from 0 to 1 in an order that is neither up nor down."""
    return (k * 7 % 20) / 19


def _count_drawn_points(course: Sequence[float], response: Response) -> int:
    """Return how many points of a response to draw: slightly more than until 0.1 % from its end."""
    far = 1e-3 * abs(response.after - response.before)
    last = max(k for k, thrust in enumerate(course) if abs(thrust - response.after) > far)
    return min(len(course), last + max(10, last // 4))


def _describe_variables(variables: Iterable[Variable]) -> list[dict[str, Any]]:
    return [{key: getattr(v, key) for key in VARIABLE_ATTRIBUTES} for v in variables]


def _effective_value(variable: Variable, value: float | None) -> float | str | None:
    """Return a parameter's value in effect, that of an enumeration as the item's name."""
    return {float(item): name for name, item in variable.items}.get(value, value) if value is not None else None


def _describe_port(name: str, port: Port, source: EngineSource) -> dict[str, Any]:
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
        "unit": v.unit if name in ("throttle", "run", "start") else _port_unit(name, source) or v.unit,
        "from": port.value(0.0) if is_lever else None,
        "to": port.value(1.0) if is_lever else None,
        "scale": port.scale,
        "offset": port.offset,
        "si": KINDS[name].quantity.si,
        "found": origin,
    }


def _port_unit(name: str, source: EngineSource) -> str | None:
    mapped = None if source.engine else getattr(source.mapping.units, name, None)
    return str(mapped) if mapped else None


def _library_checksums(path: Path) -> list[str]:
    try:
        with Zip(path) as fmu:
            damaged = fmu.testzip()
    except DAMAGE_ERRORS as error:
        raise InputError(f"{path}: {error}") from error
    return [f"{damaged} fails its checksum"] if damaged else []


def note_harmless_violations(archive: Archive, max_lines: int = 10) -> list[str]:
    """Return notes on violations of FMI in an archive's description that have no effect on stepping.

    ``max_lines``: lines that are shown of the same kind, because a tool repeats a violation in every variable.
    """
    shown = archive.harmless_violations[:max_lines]
    lines = [f"blemish in its description, of no effect on stepping: {text}" for text in shown]
    rest = len(archive.harmless_violations) - len(shown)
    return [*lines, f"and {rest} more blemishes like these"] if rest else lines


def _list_notes(archive: Archive, library: bool) -> list[str]:
    notes = [*note_harmless_violations(archive), *archive.port_notes]
    if archive.once_per_process:
        notes.append("may be instantiated once per process: every engine gets a library of its own")
    if not library and "fuel_flow" not in archive.ports:
        notes.append("reports no fuel flow: the tank of a vehicle stays full with it")
    return notes
