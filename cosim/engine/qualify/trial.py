"""Parts of ``hexjet fmu check`` that run the FMU: in the child process, each on new instances."""

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import cosim.engine._bank as _bank
from cosim.base.errors import FlightError, InputError
from cosim.base.signals import EngineOutput
from cosim.engine.bank import EngineBank
from cosim.engine.fmu.air import STANDARD_AIR, Air
from cosim.engine.fmu.archive import find_library, validate
from cosim.engine.fmu.container import note_unusual_names, read_bytes
from cosim.engine.fmu.description import is_harmless_violation, read_description
from cosim.engine.fmu.instance import FmuInstance, InstanceError
from cosim.engine.fmu.unpacked import hash_files, unpack
from cosim.engine.load import load_unchecked
from cosim.engine.measure import EngineMeasurement, measure
from cosim.engine.qualify.check import NEEDED, make_measurement_adapter
from cosim.engine.qualify.process_state import (
    count_threads,
    describe_changes,
    list_mapped_libraries,
    measure_resident_bytes,
    read_process_state,
)
from cosim.engine.qualify.supervisor import READ
from cosim.engine.response import (
    NO_CHANGE,
    Hold,
    Response,
    ResponseError,
    find_crossing,
    find_curve_problems,
    measure_step_response,
    note_flat_ends,
    settle,
    settling_window,
)
from cosim.engine.spec import EngineSource, EngineSpec, find_source, resolve_parameters

Say = Callable[[dict[str, Any]], None]
Findings = tuple[dict[str, Any], list[str]]  # entries of the report, and problems

RUN_S = 20.0  # s of simulated time under a changing throttle
TRIAL_STEPS = 500
CHUNK = 250  # steps between two progress messages
ENGINES = 6  # engines of a Hex-Jet
TIMED_STEPS = 20_000
GROWTH_STEPS = 10_000  # steps between two readings of memory, of which there are three
WRONG_WAY = 0.02  # of the change of thrust, chosen by us: less is what a solver or a sample leaves
UNEVEN = 2  # samples between the dead times up and down; a step of the throttle meets the FMU's own step anywhere
LEAST_LEAK = 16.0  # bytes a step: the smallest block that malloc hands out, so that a leak in every step is more
RUNTIMES = re.compile(r"lib(?:python3|jvm|mono|coreclr|julia|mwmclmcr|mwmcr|octave|R\.so|node)[^/]*")
MOST_POINTS = 2000  # points of a step response that are drawn

FEATURES = {
    "canHandleVariableCommunicationStepSize": "variable step",
    "canGetAndSetFMUstate": "saved state",
    "canSerializeFMUstate": "serialized state",
    "hasEventMode": "event mode",
    "mightReturnEarlyFromDoStep": "early return",
    "providesIntermediateUpdate": "intermediate update",
    "providesDirectionalDerivative": "directional derivatives",
    "canInterpolateInputs": "interpolated inputs",
    "canRunAsynchronuously": "asynchronous steps",
    "needsExecutionTool": "needs its tool on this machine",
    "canBeInstantiatedOnlyOncePerProcess": "one instance per process",
}
INTERFACES = {"modelExchange": "model exchange", "scheduledExecution": "scheduled execution"}


class TrialTask(NamedTuple):
    """Order to the child process: the engine and the parts to run."""

    name: str  # of the library, or an absolute path
    parameters: Mapping[str, float]
    step: float  # s
    parts: Sequence[str]
    air: Sequence[float] = STANDARD_AIR  # in which its thrust is measured


class Trial:
    """One engine, unpacked, and the ways to run it.  ``say`` sends a message to the parent process."""

    def __init__(self, source: EngineSource, task: TrialTask, folder: Path, say: Say) -> None:
        self.archive, self.task, self.folder, self.say, self.step = source.archive, task, folder, say, task.step
        self.measured: EngineMeasurement | None = None
        _, self.settings = resolve_parameters(source, task.parameters)

    @contextmanager
    def instance(self, throttle: float = 0.0) -> Iterator[FmuInstance]:
        """Yield a new instance, initialized at a throttle and freed afterwards; report before each of these."""
        self.say({"at": "when it was instantiated"})
        instance = FmuInstance(self.archive, self.folder, "checked")
        try:
            self.initialize(instance, throttle)
            yield instance
        except (_bank.FailureError, InstanceError) as error:
            text = (
                instance.explain(error, "while it was stepped") if isinstance(error, _bank.FailureError) else str(error)
            )
            self.say({"problems": [text]})  # report it now, because freeing a failed instance may crash the process
            raise InstanceError(text) from error
        finally:
            self.say({"at": "when it was terminated and freed"})
            instance.close()

    def initialize(self, instance: FmuInstance, throttle: float = 0.0) -> None:
        """Set the parameters that the user gave and bring an instance into step mode."""
        self.say({"at": "when it was initialized"})
        instance.initialize(self.settings, throttle, step=self.step)

    def make_native_bank(self, instance: FmuInstance) -> _bank.Bank:
        """Return a C loop around a new instance."""
        return _bank.Bank((instance.make_row(),), self.step, EngineOutput)

    def make_hold(self, instance: FmuInstance) -> Hold:
        """Return a function that steps a new instance at a constant throttle and reports progress."""
        native = self.make_native_bank(instance)
        count = 0

        def make_hold(throttle: float, steps: int) -> list[float]:
            nonlocal count
            thrusts: list[float] = []
            while len(thrusts) < steps:
                now = min(CHUNK, steps - len(thrusts))
                self.report_step(count)
                thrusts += native.hold(0, throttle, now)
                count += now
            return thrusts

        return make_hold

    def report_step(self, k: int) -> None:
        """Report that stepping has come to step ``k``."""
        self.say({"at": f"while it was stepped, {k * self.step:g} s after its start or later"})

    def run_zigzag(self, instance: FmuInstance, steps: int = TRIAL_STEPS) -> list[float]:
        """Return the thrusts of a new instance under a throttle that keeps changing within 0..1."""
        native = self.make_native_bank(instance)
        thrusts: list[float] = []
        for k in range(steps):
            if k % CHUNK == 0:
                self.report_step(k)
            try:
                thrusts += native.hold(0, zigzag_throttle(k), 1)
            except _bank.FailureError as failure:
                raise InstanceError(instance.explain(failure, f"at step {k} ({k * self.step:g} s)")) from failure
        return thrusts


def zigzag_throttle(k: int) -> float:
    """Return a throttle sequence that visits 20 values from 0 to 1 in an order that is neither up nor down."""
    return (k * 7 % 20) / 19


def run_task(order: Mapping[str, Any], say: Say) -> None:
    """Do the parts that a task asks for; say ``part`` before each, ``found`` and ``problems`` after it."""
    task = TrialTask(**order)
    say({"at": READ})
    source = find_source(task.name)
    with unpack(source.archive) as folder:
        trial = Trial(source, task, folder, say)
        before = hash_files(trial.folder)
        for part in task.parts:
            say({"part": part})
            is_over = False
            try:
                findings, problems = PARTS[part](trial)
            except (InstanceError, ResponseError, InputError, FlightError) as error:
                findings, problems, is_over = {}, [str(error)], part in NEEDED
            say({"of": part, "found": findings, "problems": problems, "over": is_over})
            if is_over:
                break
        after = hash_files(trial.folder)
        # Files that it adds are allowed: an FMU written in Python leaves compiled modules.
        if any(after.get(name) != digest for name, digest in before.items()):
            say({"of": "files", "found": {}, "problems": ["changes or deletes files of its own archive"]})


# ---- the parts


def _validate(trial: Trial) -> Findings:
    trial.say({"at": "while its description was validated"})
    notes = note_unusual_names(trial.archive.path)
    data = read_bytes(trial.archive.path)
    # an archive with harmless violations was validated when it was read
    complaints = [] if trial.archive.harmless_violations else validate(data)
    remarks = [text for text in complaints if is_harmless_violation(text)]
    features = _features(read_description(data)[0])
    return {"features": features, "notes": notes + remarks}, [text for text in complaints if text not in remarks]


def _features(description: Any) -> list[str]:
    """Return the names of the FMI features that an FMU offers or uses."""
    stated = description.coSimulation
    kinds = Counter(v.type for v in description.modelVariables)
    features = [
        *(words for key, words in FEATURES.items() if getattr(stated, key, False)),
        *(words for key, words in INTERFACES.items() if getattr(description, key) is not None),
        *(["sources"] if description.buildConfigurations else []),
        *(["arrays"] if any(v.dimensions for v in description.modelVariables) else []),
        *(f"{kinds[kind]} of type {kind}" for kind in ("Binary", "Clock", "String") if kinds[kind]),
    ]
    if stated.fixedInternalStepSize is not None:
        features.append(f"internal step {float(stated.fixedInternalStepSize):g} s")
    return [*features, f"{len(description.modelVariables)} variables"]


def _load(trial: Trial) -> Findings:
    """Load and unload the library."""
    before = read_process_state()
    _load_library(trial, trial.folder / find_library(trial.archive))
    return {}, describe_changes(before)


def _load_library(trial: Trial, library: Path) -> None:
    import fmpy  # type: ignore[import-untyped]

    here = Path.cwd()
    trial.say({"at": "when its shared library was loaded"})
    os.chdir(library.parent)  # as FMPy does, for libraries that lie beside it
    try:
        handle = ctypes.CDLL(str(library))._handle
    except OSError as error:
        reason = str(error).replace(f"{library.parent}{os.sep}", "")
        raise InstanceError(f"its shared library does not load: {reason}") from error
    finally:
        os.chdir(here)
    trial.say({"at": "when its shared library was unloaded"})
    fmpy.freeLibrary(handle)


def _start(trial: Trial) -> Findings:
    """Run one instance for one step, and find run times and threads that it adds to its process."""
    import fmpy.fmi2  # type: ignore[import-untyped]
    import fmpy.fmi3  # type: ignore[import-untyped] # noqa: F401 - these start threads of numpy

    before, threads, libraries = read_process_state(), count_threads(), list_mapped_libraries()
    with trial.instance() as instance:
        trial.run_zigzag(instance, 1)
        runtimes = sorted({match[0] for name in list_mapped_libraries() - libraries if (match := RUNTIMES.match(name))})
        more = count_threads() - threads
    own = f"brings a run time of its own ({', '.join(runtimes)})" if runtimes else ""
    if more > 0 and not own:
        own = f"starts {more} thread{'s' if more > 1 else ''} of its own"
    return ({"own": own} if own else {}), describe_changes(before)


def _run(trial: Trial) -> Findings:
    before = read_process_state()
    with trial.instance() as instance:
        thrusts = trial.run_zigzag(instance, max(TRIAL_STEPS, round(RUN_S / trial.step)))
    digest = hashlib.sha256(struct.pack(f"<{len(thrusts)}d", *thrusts)).hexdigest()
    return {"digest": digest}, describe_changes(before)


def _measure(trial: Trial) -> Findings:
    """Measure static curve and response as a flight does, so that it need not measure them again."""
    trial.say({"at": "while its thrust was measured"})
    measurement = trial.measured = measure(
        trial.archive,
        trial.settings,
        trial.archive.start,
        trial.step,
        lambda: trial.say({"at": "while its thrust was measured"}),
        Air(*trial.task.air),
    )
    curve = measurement.curve._asdict()
    measured = make_measurement_adapter().dump_python(measurement, mode="json")
    problems = find_curve_problems(measurement.curve, measurement.quiet, trial.archive.starting.rest_n)
    notes = note_flat_ends(measurement.curve, measurement.quiet, trial.archive.starting.rest_n)
    return {**curve, "up": measurement.response._asdict(), "measured": measured, "notes": notes}, problems


def _respond(trial: Trial) -> Findings:
    """Record the response to opening and to closing the throttle."""
    with trial.instance() as instance:
        courses: dict[str, Any] = {}
        notes: list[str] = []
        hold = trial.make_hold(instance)
        quiet, span = (m.quiet, abs(m.curve.thrust[-1])) if (m := trial.measured) else (NO_CHANGE, 0.0)
        rest = trial.archive.starting.rest_n
        before = settle(hold, 0.0, settling_window(round(1.0 / trial.step)), trial.step, quiet, rest, span)
        for way, throttle in (("up", 1.0), ("down", 0.0)):
            course = [before]

            def recorded(throttle: float, steps: int, course: list[float] = course) -> list[float]:
                thrusts = list(hold(throttle, steps))
                course.extend(thrusts)
                return thrusts

            response: Response = measure_step_response(recorded, before, throttle, trial.step, quiet, rest)
            before = response.after
            shown = course[: _drawn(course, response)]
            every = max(1, len(shown) // MOST_POINTS)
            courses |= {way: response._asdict(), f"course_{way}": shown[::every]}
            courses[f"course_step_{way}"] = every * trial.step
            courses[f"tenth_{way}"] = find_crossing(course, 0.1, response.before, response.after) * trial.step
            change = response.after - response.before
            back = max(((response.before - thrust) / change for thrust in course), default=0.0)
            if back > WRONG_WAY + rest / abs(change):
                notes.append(f"throttle {way}: thrust first goes the wrong way, by {100.0 * back:.0f} % of the change")
    up, down = courses["up"]["delay"], courses["down"]["delay"]
    if abs(up - down) > UNEVEN and rest == 0.0:
        notes.append(
            f"its dead time differs, {up} samples up and {down} down: it may sample its throttle itself, every "
            f"{abs(up - down) * trial.step:.2g} s or more, or have to be started first"
        )
    return courses | {"notes": notes}, []


def _drawn(course: Sequence[float], response: Response) -> int:
    """Return how many points of a course to draw: a little more than it takes to come within 0.1 % of the end."""
    far = 1e-3 * abs(response.after - response.before)
    last = max(k for k, thrust in enumerate(course) if abs(thrust - response.after) > far)
    return min(len(course), last + max(10, last // 4))


def _repeat(trial: Trial) -> Findings:
    """Compare two runs, the first instance alive during the second: they must not share any state."""
    with trial.instance() as instance:
        first = trial.run_zigzag(instance)
        if not trial.archive.once_per_process:
            with trial.instance() as other:
                second = trial.run_zigzag(other)
    if trial.archive.once_per_process:
        with trial.instance() as other:
            second = trial.run_zigzag(other)
    return _finding("deterministic", first == second, "two runs with the same throttle differ")


def _finding(key: str, is_good: bool, problem: str) -> Findings:
    return {key: is_good}, [] if is_good else [problem]


def _together(trial: Trial) -> Findings:
    """Compare one of six engines stepped at once, as in a vehicle, with one stepped alone."""
    trial.say({"at": "while several of it were instantiated"})
    memory = measure_resident_bytes()
    spec = _spec(trial)
    runs = []
    for count in (ENGINES, 1):
        with EngineBank(spec, count, trial.step) as bank:
            begin = measure_resident_bytes()
            for _ in range(2):  # twice, as two flights of the same bank
                trial.say({"at": f"while {count} of it were started"})
                bank.reset(0.25)
                trial.say({"at": f"while {count} of it were stepped"})
                runs.append([bank.step(k, _shifted(k, count)).thrust[-1] for k in range(TRIAL_STEPS)])
        trial.say({"at": f"when {count} of it were freed"})
        if count == ENGINES:
            memory = begin - memory
    problem = "six of it at once do not answer as one alone: they are not independent"
    findings, problems = _finding("independent", all(run == runs[0] for run in runs), problem)
    return findings | {"bytes_per_instance": max(0.0, memory) / ENGINES}, problems


def _shifted(k: int, count: int) -> tuple[float, ...]:
    """Return throttles at step ``k``: the zigzag for the last engine, shifted more and more for those before it."""
    return tuple(zigzag_throttle(k + 3 * (count - 1 - i)) for i in range(count))


def _spec(trial: Trial) -> EngineSpec:
    trial.say({"at": "while its thrust was measured"})
    task = trial.task
    return load_unchecked(task.name, task.parameters, task.step, measured=trial.measured)


def _reset(trial: Trial) -> Findings:
    with trial.instance() as instance:
        first = trial.run_zigzag(instance)
        trial.say({"at": "when it was reset"})
        instance.call("reset")
        trial.initialize(instance)
        is_equal = trial.run_zigzag(instance) == first
    return _finding("reset_restores_start", is_equal, "a run after a reset differs from the first")


def _time(trial: Trial) -> Findings:
    with trial.instance() as instance:
        hold = trial.make_hold(instance)
        begin = time.perf_counter()
        hold(0.5, TIMED_STEPS)
        microseconds = (time.perf_counter() - begin) / TIMED_STEPS * 1e6
    return {"microseconds_per_step": microseconds}, []


def _grow(trial: Trial) -> Findings:
    """Measure the growth of resident memory [bytes per step] over many steps."""
    with trial.instance() as instance:
        hold = trial.make_hold(instance)
        resident = []
        for _ in range(3):
            for _ in range(GROWTH_STEPS // CHUNK):
                hold(0.5, CHUNK)
            resident.append(measure_resident_bytes())
    per_step = min(b - a for a, b in pairwise(resident)) / GROWTH_STEPS
    leaks = per_step >= LEAST_LEAK
    problems = [f"takes {per_step:.0f} bytes more memory in every step"] if leaks else []
    return {"bytes_per_step": max(0.0, per_step)}, problems


PARTS: Mapping[str, Callable[[Trial], Findings]] = {
    "validate": _validate,
    "load": _load,
    "start": _start,
    "run": _run,
    "measure": _measure,
    "respond": _respond,
    "repeat": _repeat,
    "together": _together,
    "reset": _reset,
    "time": _time,
    "grow": _grow,
}
