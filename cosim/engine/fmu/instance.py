"""One FMU instance: loaded, instantiated and initialized here, then handed to the C loop for stepping."""

from __future__ import annotations

import ctypes
import importlib
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import cosim.engine._bank as _bank
from cosim.engine.fmu.air import STANDARD_AIR, Air
from cosim.engine.fmu.archive import Archive, find_library
from cosim.engine.fmu.container import to_one_line
from cosim.engine.fmu.port_kinds import BASE_INPUTS, INPUTS, OUTPUTS
from cosim.engine.fmu.slave import CallError, Slave
from cosim.engine.fmu.starting import Setting
from cosim.engine.fmu.variables import REALS, Variable

STATUS = {2: "discard", 3: "error", 4: "fatal", 5: "pending"}  # FMI status codes that are failures

# Messages by failure code of the C loop.
FAILURE_MESSAGES = {
    "set": "setting its inputs returned {status}",
    "step": "doStep returned {status}",
    "get": "getting its outputs returned {status}",
    "terminate": "it asked to end the simulation",
    "early": "it returned early from doStep and gets no further",
    "parts": "it does not reach the end of the step",
    "event": "it requested event handling, for which it has no mode",
    "nan": "{port} is not finite",
    "input": "{port} is not finite",
}

# Numbers of the C loop's value types by FMI type.
VALUE_TYPES = {
    "Real": 0, "Float64": 0, "Float32": 1, "Int8": 2, "UInt8": 3, "Int16": 4, "UInt16": 5, "Int32": 6, "Integer": 6,
    "UInt32": 7, "Int64": 8, "UInt64": 9,
}  # fmt: skip


class InstanceError(Exception):
    """Error of an FMU call: one line without the FMU's name, which the caller adds."""


class FmuInstance:
    """Instance of an FMU ``archive``, whose files are unpacked in ``folder``.

    Raises InstanceError if the library does not load or the FMU refuses to be instantiated.
    """

    def __init__(self, archive: Archive, folder: Path, name: str) -> None:
        self.archive = archive
        self._resources = folder / "resources"
        self._python = _contains_python(self._resources, archive.sha256)
        self.log = _bank.Log()
        self._stepping = False
        self._dead = False
        self._start_steps = 0  # communication steps of the warm-up
        self._inputs = _input_values(0.0, STANDARD_AIR)  # inputs as last set
        self.fmu: Slave | None = None
        try:
            fmu = Slave(folder / find_library(archive), archive.fmi)
        except OSError as error:
            reason = to_one_line(error).replace(f"{folder}{os.sep}", "")
            raise InstanceError(f"its shared library does not load: {reason}") from error
        try:
            with _isolate_modules(self._resources) if self._python else nullcontext():
                if not fmu.instantiate(name, archive.token, self._resources, self.log, archive.returns_early):
                    raise InstanceError(self._append_log("cannot be instantiated"))
        except BaseException:
            fmu.free_library()
            raise
        self.fmu = fmu

    @property
    def _slave(self) -> Slave:
        if self.fmu is None:
            raise InstanceError("was freed before")
        return self.fmu

    def initialize(
        self, settings: Sequence[Setting], throttle: float, air: Air = STANDARD_AIR, *, step: float
    ) -> float:
        """Set parameters and inputs, leave initialization mode at time 0, and return the thrust [N].

        Where the mapping file states a warm-up, it is made in steps of ``step`` seconds, and the thrust is that after
        it.  Raises InstanceError if the FMU returns an error on the way.
        """
        self._inputs = _input_values(throttle, air)
        self._start_steps = 0
        self._call(self._slave.set_up)
        self.write([*settings, *self.archive.starting.constants])
        self._call(self._slave.enter_initialization)
        self.write(
            [
                (self.archive.ports[name].variable, self.archive.ports[name].value(x))
                for name, x in (*self._inputs.items(), ("run", 1.0))
                if name in self.archive.ports
            ]
        )
        self._call(self._slave.call, "ExitInitializationMode")
        self._stepping = True
        self._warm_up(step)
        thrust = self.output("thrust")
        if not math.isfinite(thrust):
            raise InstanceError("thrust is not finite at the start")
        return thrust

    def _warm_up(self, step: float) -> None:
        """Step at zero throttle for the mapping's warm-up time, and count the steps."""
        count = round(self.archive.starting.warm_up_s / step)
        if not count:
            return
        try:
            _bank.Bank((self.make_row(),), step).hold(0, 0.0, count)
        except _bank.FailureError as failure:
            raise InstanceError(self.explain(failure, "while it was warmed up")) from failure
        self._start_steps = count

    def read(self, variable: Variable) -> float:
        """Return a variable's present value in the FMU's own unit."""
        kind = self._type_suffix(variable)
        values = self._slave.make_values(kind, len(variable.starts))
        self._call(self._slave.bind_values("Get", kind, [variable.reference], values))
        return float(values[variable.index])

    def _type_suffix(self, variable: Variable) -> str:
        """Return the type suffix of FMI's functions that get and set a variable."""
        if variable.type != "Enumeration":
            return variable.type
        return "Integer" if self.archive.fmi == 2 else "Int64"

    def output(self, name: str) -> float:
        """Return the engine's present value at one of its ports in SI units; ram drag is subtracted from thrust."""
        ports = self.archive.ports
        port = ports[name]
        value = port.scale * self.read(port.variable)
        value = value + port.offset if port.offset else value
        return value - self.output("ram_drag") if name == "thrust" and "ram_drag" in ports else value

    def set_run(self, on: bool) -> bool:
        """Set the engine's port ``run`` between steps; return False if it has none."""
        port = self.archive.ports.get("run")
        if port is None:
            return False
        self.write([(port.variable, port.value(float(on)))])
        return True

    def write(self, settings: Sequence[Setting]) -> None:
        """Set variables; the elements of an array that are not among them stay at their start values."""
        arrays: dict[tuple[str, int], tuple[Variable, list[float]]] = {}
        for variable, value in settings:
            # FMI 2.0 numbers value references separately for each type.
            _, values = arrays.setdefault((variable.type, variable.reference), (variable, list(variable.starts)))
            values[variable.index] = value
        for variable, values in arrays.values():
            kind: type = float if variable.type in REALS else bool if variable.type == "Boolean" else int
            array = self._slave.make_values(self._type_suffix(variable), [kind(value) for value in values])
            self._call(self._slave.bind_values("Set", self._type_suffix(variable), [variable.reference], array))

    def _call(self, call: Callable[..., None], *arguments: Any) -> None:
        """Call an FMU function.  Raises InstanceError if it is missing or returns worse than a warning."""
        try:
            call(*arguments)
        except CallError as error:
            self.record_failure(error.status)
            raise InstanceError(self._append_log(f"{error.function} returned {_status_name(error.status)}")) from error
        except OSError as error:
            raise InstanceError(str(error)) from error

    def record_failure(self, status: int) -> None:
        """Record an error status; after a fatal one no call is allowed."""
        self._stepping = False
        self._dead = self._dead or STATUS.get(status) == "fatal"

    def _append_log(self, text: str) -> str:
        messages = to_one_line(self.log.take())
        return f"{text}: {messages}" if messages else text

    def explain(self, failure: _bank.FailureError, moment: str) -> str:
        """Return a description of a failure in the C loop with its moment and the FMU's own log messages."""
        _, what, status, port = failure.args
        more = self._progress() if what == "step" and STATUS.get(status) == "discard" and self.archive.fmi == 2 else ""
        if what == "step" and STATUS.get(status) == "pending":
            more = ", which is for FMUs that step in the background; these are not supported"
        self.record_failure(status)
        text = FAILURE_MESSAGES[what].format(status=_status_name(status), port=port)
        return self._append_log(f"{text} {moment}{more}")

    def _progress(self) -> str:
        """Return how far a discarded FMI 2.0 step got, as text; empty if the FMU does not tell."""
        component, value = ctypes.c_void_p(self._slave.component), ctypes.c_double(math.nan)
        try:
            # Status kind 2 is fmi2LastSuccessfulTime.
            status = self._slave.function("GetRealStatus")(component, 2, ctypes.byref(value))
        except OSError:
            return ""
        reported = status <= 1 and math.isfinite(value.value)
        return f"; it came as far as its own time {value.value:g} s" if reported else ""

    def make_row(self, done: int = 0) -> _bank.Row:
        """Return the C loop's data of this instance, which has made ``done`` communication steps."""
        archive = self.archive
        sets, inputs = self._call_blocks("Set", INPUTS)
        gets, outputs = self._call_blocks("Get", (*OUTPUTS, "ram_drag"))
        return (
            archive.fmi,
            self._slave.component,
            self._function_address("DoStep"),
            self._start_steps + done,
            sets,
            gets,
            inputs,
            outputs,
            tuple(self._inputs[name] for name in BASE_INPUTS),
        )

    def _function_address(self, name: str) -> int:
        try:
            return ctypes.cast(self._slave.function(name), ctypes.c_void_p).value or 0
        except OSError as error:
            raise InstanceError(str(error)) from error

    def _call_blocks(
        self, way: Literal["Set", "Get"], names: Sequence[str]
    ) -> tuple[tuple[_bank.Block, ...], tuple[_bank.Place | None, ...]]:
        """Return one FMI call for each type of ports, the first port's first, and each port's place in the calls."""
        ports = {name: self.archive.ports[name] for name in names if name in self.archive.ports}
        types = list(dict.fromkeys(port.variable.type for port in ports.values()))
        blocks: list[_bank.Block] = []
        places: dict[str, _bank.Place] = {}
        for number, kind in enumerate(types):
            values: list[float] = []
            first_index: dict[int, int] = {}  # index of the first value per reference
            for name, port in ports.items():
                v = port.variable
                if v.type != kind:
                    continue
                if v.reference not in first_index:
                    first_index[v.reference] = len(values)
                    values += v.starts
                index = first_index[v.reference] + v.index
                if way == "Set":
                    values[index] = port.value(self._inputs[name])
                    places[name] = number, index, port.gain, port.bias, port.low, port.high
                else:
                    places[name] = number, index, port.scale, port.offset, -math.inf, math.inf
            function = self._function_address(f"{way}{kind}")
            # Of the inputs only the throttle, which is the first port, is set in each step.
            first = (1, len(ports[names[0]].variable.starts)) if number == 0 else (0, 0)
            blocks.append((function, VALUE_TYPES[kind], tuple(first_index), tuple(values), *first))
        return tuple(blocks), tuple(places.get(name) for name in names)

    def close(self) -> None:
        """Terminate and free the instance and close the library."""
        if self.fmu is None:
            return
        fmu, self.fmu = self.fmu, None
        if self._python:
            _remove_from_path(self._resources)
        if self._dead:
            return  # FMI forbids calls after a fatal error
        if self._stepping:
            fmu.terminate()
        fmu.free()


@lru_cache(maxsize=64)
def _contains_python(resources: Path, _sha256: str) -> bool:
    return any(resources.rglob("*.py"))


@contextmanager
def _isolate_modules(resources: Path) -> Iterator[None]:
    """Isolate the modules of an FMU that is written in Python and runs in this interpreter, as PythonFMU's do.

    It imports them by name from its resources, which it appends to the path.  Otherwise it would silently get the
    module of the same name of an FMU that was loaded before, even of a closed one.
    """
    folder = str(resources)
    sys.path.insert(0, folder)
    importlib.invalidate_caches()
    try:
        yield
    finally:
        _remove_from_path(resources)
        sys.path.append(folder)  # for modules that it imports later
        for name, module in list(sys.modules.items()):
            if str(getattr(module, "__file__", None) or "").startswith(folder + os.sep):
                del sys.modules[name]  # the instance keeps its own reference


def _remove_from_path(resources: Path) -> None:
    sys.path[:] = [entry for entry in sys.path if Path(entry) != resources]


def _input_values(throttle: float, air: Air) -> dict[str, float]:
    return dict(zip(BASE_INPUTS, (throttle, *air), strict=True)) | air.derive()


def _status_name(status: int) -> str:
    return STATUS.get(status, f"status {status}")
