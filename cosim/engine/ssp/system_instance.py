"""Stepping of a system of FMUs: its components in order, each with the latest outputs of those before it.

To the C loop it is an instance of FMI 2.0 whose functions are here.  A connection that closes a loop passes its
source's value at the beginning of the step; every other one the value at the end of the step.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import CFUNCTYPE, POINTER, byref, c_bool, c_double, c_int, c_size_t, c_uint, c_void_p
from math import floor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from cosim.engine.fmu.archive import Archive, System
from cosim.engine.fmu.instance import STATUS, FmuInstance, InstanceError
from cosim.engine.fmu.variables import INTEGERS, Variable

_OK, _WARNING, _ERROR = 0, 1, 3
_DOUBLES = ("Real", "Float64")
_DO_STEP = CFUNCTYPE(c_int, c_void_p, c_double, c_double, c_int)
_REALS = CFUNCTYPE(c_int, c_void_p, POINTER(c_uint), c_size_t, POINTER(c_double))
_FLOATS = CFUNCTYPE(c_int, c_void_p, POINTER(c_uint), c_size_t, POINTER(c_double), c_size_t)
_STEP_OUTPUTS = POINTER(c_bool), POINTER(c_bool), POINTER(c_bool), POINTER(c_double)
_DO_STEP_3 = CFUNCTYPE(c_int, c_void_p, c_double, c_double, c_bool, *_STEP_OUTPUTS)
_ONE = CFUNCTYPE(c_int, c_void_p)


def make_instance(archive: Archive, folder: Path, name: str) -> FmuInstance:
    """Instantiate an archive, FMU or system, whose unpacked files are in ``folder``; raise InstanceError on failure."""
    return (
        FmuInstance(archive, folder, name)
        if archive.system is None
        else SystemInstance(archive, archive.system, folder, name)
    )


class SystemInstance(FmuInstance):
    """As :class:`FmuInstance`, for a system; errors of a component name the component and its file."""

    def __init__(self, archive: Archive, system: System, folder: Path, name: str) -> None:
        self.fmu: Any = None
        super().__init__(archive, folder, name, lambda: _SystemSlave(system, folder, name))

    def _instantiate(self) -> None:
        """Do nothing: the components were instantiated when they were loaded."""

    def _with_log(self, text: str) -> str:
        problem, self.fmu.problem = self.fmu.problem, ""
        return f"{text}: {problem}" if problem else text


class _SystemSlave:
    """A system with the interface of FMPy's FMI 2.0 instances, for :class:`FmuInstance`."""

    def __init__(self, system: System, folder: Path, name: str) -> None:
        self._system, self.problem = system, ""
        self.component = 1  # placeholder, which is not read
        self._components: list[FmuInstance] = []
        self.dll = SimpleNamespace(
            fmi2DoStep=_DO_STEP(self._guarded_step),
            fmi2SetReal=_REALS(self._guarded_set),
            fmi2GetReal=_REALS(self._guarded_get),
            fmi2Terminate=_ONE(lambda component: _OK),  # closing a component terminates it
        )
        try:
            for number, fmu in enumerate(system.components):
                with self._of(number):
                    self._components.append(FmuInstance(fmu.archive, folder / str(number), f"{name}.{fmu.name}"))
        except BaseException:
            self.freeLibrary()
            raise
        self._join()

    def _join(self) -> None:
        """Prepare one call for each component's outputs after its step, and one for its inputs before it."""
        read: list[dict[str, Variable]] = [{} for _ in self._components]
        for feed in self._system.feeds:
            read[feed.source].setdefault(feed.output.name, feed.output)
        self._outputs = [
            _Values(component, list(variables.values()))
            for component, variables in zip(self._components, read, strict=True)
        ]
        places = [list(variables) for variables in read]
        self._given: list[list[float]] = [[] for _ in self._components]  # last outputs of each component
        self._feeds = []
        for number, component in enumerate(self._components):
            feeds = [feed for feed in self._system.feeds if feed.component == number]
            rows = [
                (feed.source, places[feed.source].index(feed.output.name), feed.factor, feed.offset) for feed in feeds
            ]
            self._feeds.append((_Values(component, [feed.variable for feed in feeds]), rows))
        self._steppers = [_Stepper(component) for component in self._components]
        self._targets = [
            [(target, _Values(self._components[target.component], [target.variable])) for target in targets]
            for targets in self._system.targets
        ]

    def _of(self, number: int) -> _ComponentErrors:
        fmu = self._system.components[number]
        return _ComponentErrors(f"component {fmu.name} ({fmu.file})")

    def setupExperiment(self, startTime: float = 0.0, **_: Any) -> None:
        for number, (component, fmu) in enumerate(zip(self._components, self._system.components, strict=True)):
            with self._of(number):
                if fmu.archive.fmi == 2:
                    component.call("setupExperiment", startTime=startTime)
                component.write([(v, _whole(v, value)) for v, value in fmu.settings])

    def enterInitializationMode(self) -> None:
        for number, component in enumerate(self._components):
            with self._of(number):
                component.call("enterInitializationMode")

    def exitInitializationMode(self) -> None:
        """Leave initialization mode after two passes over the connections, the second for those that run backwards."""
        for _ in range(2):
            for number in range(len(self._components)):
                if all(self._given[source] for source, *_ in self._feeds[number][1]):
                    self._feed(number)
                with self._of(number):
                    self._given[number] = self._outputs[number].get()
        for number, component in enumerate(self._components):
            with self._of(number):
                component.call("exitInitializationMode")
                component._stepping = True
        self._read_outputs()

    def _read_outputs(self) -> None:
        """Read the present outputs of all components."""
        for number, outputs in enumerate(self._outputs):
            with self._of(number):
                self._given[number] = outputs.get()

    def reset(self) -> None:
        self._given = [[] for _ in self._components]
        for number, component in enumerate(self._components):
            with self._of(number):
                component.call("reset")
                component._stepping = False

    def _feed(self, number: int) -> None:
        inputs, rows = self._feeds[number]
        if rows:
            given = self._given
            with self._of(number):
                inputs.set([factor * given[source][at] + offset for source, at, factor, offset in rows])

    def doStep(self, time: float, step: float) -> None:
        """Step all components once; raise InstanceError with the component's name on failure."""
        for number, stepper in enumerate(self._steppers):
            self._feed(number)  # inputs from components that are stepped later are one step old
            with self._of(number):
                stepper.step(time, step)
                self._given[number] = self._outputs[number].get()

    def setReal(self, references: Sequence[int], values: Sequence[float]) -> None:
        for reference, value in zip(references, values, strict=True):
            for target, one in self._targets[reference]:
                with self._of(target.component):
                    one.set([target.factor * value + target.offset])

    def getReal(self, references: Sequence[int]) -> list[float]:
        values = []
        for reference in references:
            target, one = self._targets[reference][0]
            with self._of(target.component):
                values.append(target.factor * one.get()[0] + target.offset)
        return values

    def _call_each(self, function: str, arguments: Sequence[Any]) -> list[Any]:
        """Call a function of each component with its own argument."""
        pairs = zip(self._components, arguments, strict=True)
        return [component.call(function, argument) for component, argument in pairs]

    def getFMUState(self) -> list[Any]:
        return [component.call("getFMUState") for component in self._components]

    def setFMUState(self, states: Sequence[Any]) -> None:
        self._call_each("setFMUState", states)
        self._read_outputs()

    def freeFMUState(self, states: Sequence[Any]) -> None:
        self._call_each("freeFMUState", states)

    def serializeFMUState(self, states: Sequence[Any]) -> list[Any]:
        return self._call_each("serializeFMUState", states)

    def deserializeFMUState(self, data: Sequence[Any]) -> list[Any]:
        return self._call_each("deserializeFMUState", data)

    def freeInstance(self) -> None:
        while self._components:
            self._components.pop().close()

    def freeLibrary(self) -> None:
        self.freeInstance()

    def _guarded_step(self, component: int, time: float, step: float, prior: int) -> int:
        return self._guarded(lambda: self.doStep(time, step))

    def _guarded_set(self, component: int, references: Any, count: int, values: Any) -> int:
        return self._guarded(lambda: self.setReal(references[:count], values[:count]))

    def _guarded_get(self, component: int, references: Any, count: int, values: Any) -> int:
        def read() -> None:
            for i, value in enumerate(self.getReal(references[:count])):
                values[i] = value

        return self._guarded(read)

    def _guarded(self, action: Any) -> int:
        """Run an action called from C; store an exception's text and return FMI's error status in its target."""
        try:
            action()
        except Exception as error:
            self.problem = str(error)
            return _ERROR
        return _OK


class _ComponentErrors:
    """Context that adds a component's name to the InstanceErrors raised in it."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, InstanceError) and not str(error).startswith("component "):
            raise InstanceError(f"{self._name}: {error}") from error


class _Values:
    """Variables of one component that are read or set together: in one call what is in double precision."""

    def __init__(self, component: FmuInstance, variables: Sequence[Variable]) -> None:
        self._component, self._variables = component, list(variables)
        self._fast = all(v.type in _DOUBLES and not v.is_array for v in variables)
        count = self._count = len(variables)
        self._references = (c_uint * count)(*(v.reference for v in variables))
        self._numbers = (c_double * count)()
        self._instance = c_void_p(component.fmu.component)
        kind = "Real" if component.archive.fmi == 2 else "Float64"
        self._names = [f"fmi{component.archive.fmi}{way}{kind}" for way in ("Get", "Set")]
        prototype = _REALS if component.archive.fmi == 2 else _FLOATS
        self._get, self._set = (prototype(component._address(name)) for name in self._names)
        self._more = () if component.archive.fmi == 2 else (count,)

    def get(self) -> list[float]:
        """Return the variables' values; raise InstanceError on failure."""
        if not self._fast:
            return [self._component.read(v) for v in self._variables]
        if self._count:
            status = self._get(self._instance, self._references, self._count, self._numbers, *self._more)
            _need_good(self._component, self._names[0], status)
        return list(self._numbers)

    def set(self, values: Sequence[float]) -> None:
        """Set the variables to values; raise InstanceError on failure."""
        if not self._fast:
            self._component.write([(v, _whole(v, value)) for v, value in zip(self._variables, values, strict=True)])
            return
        self._numbers[:] = list(values)
        status = self._set(self._instance, self._references, self._count, self._numbers, *self._more)
        _need_good(self._component, self._names[1], status)


class _Stepper:
    """The FMI function that steps one component, with its arguments."""

    def __init__(self, component: FmuInstance) -> None:
        self._component, self._instance = component, c_void_p(component.fmu.component)
        prototype = _DO_STEP if component.archive.fmi == 2 else _DO_STEP_3
        self._call = prototype(component._address(f"fmi{component.archive.fmi}DoStep"))
        self._event, self._terminate, self._early = (c_bool() for _ in range(3))
        self._last = c_double()
        outputs = (self._event, self._terminate, self._early, self._last)
        self._more = () if component.archive.fmi == 2 else tuple(byref(output) for output in outputs)

    def step(self, time: float, step: float) -> None:
        """Step the component from ``time`` by ``step`` seconds; raise InstanceError on failure."""
        _need_good(self._component, "doStep", self._call(self._instance, time, step, 0, *self._more))
        if self._terminate.value:
            raise InstanceError("it asked to end the simulation")
        if self._early.value:
            raise InstanceError("it returned early from doStep, which a component may not")


def _need_good(component: FmuInstance, function: str, status: int) -> None:
    if status > _WARNING:
        component.record_failure(status)
        raise InstanceError(component._with_log(f"{function} returned {STATUS.get(status, f'status {status}')}"))


def _whole(variable: Variable, value: float) -> float:
    return float(floor(value + 0.5)) if variable.type in INTEGERS else value
