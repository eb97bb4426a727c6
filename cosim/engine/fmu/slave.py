"""An FMU's shared library and the calls to its one instance, of FMI 2.0 or 3.0 for co-simulation.

FMPy has classes for them.  They look for all of some 70 functions, convert every argument in each call, and bring
numpy, which takes a third of a second in every process of engines.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Sequence
from ctypes import byref, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint32, c_void_p
from functools import partial
from pathlib import Path
from typing import Any

import cosim.engine._bank as _bank

# C types of FMI's getters and setters; a Boolean is a C int in FMI 2.0.
_C_TYPES: dict[str, Any] = {
    "Real": c_double, "Float64": c_double, "Float32": ctypes.c_float, "Integer": c_int, "Boolean": c_bool,
    "Int8": ctypes.c_int8, "UInt8": ctypes.c_uint8, "Int16": ctypes.c_int16, "UInt16": ctypes.c_uint16,
    "Int32": ctypes.c_int32, "UInt32": c_uint32, "Int64": ctypes.c_int64, "UInt64": ctypes.c_uint64,
}  # fmt: skip
_REQUIRED = ("EnterInitializationMode", "ExitInitializationMode", "DoStep", "Terminate", "FreeInstance")  # functions


class _Callbacks(ctypes.Structure):
    """Callbacks that an FMI 2.0 FMU may call."""

    _fields_ = [(name, c_void_p) for name in ("logger", "allocate", "free", "step_finished", "environment")]


class CallError(Exception):
    """Error of an FMU's function that returned a status worse than a warning."""

    def __init__(self, function: str, status: int) -> None:
        super().__init__(f"{function} returned {status}")
        self.function, self.status = function, status


class Slave:
    """Shared library of an FMU, and from :meth:`instantiate` to :meth:`free` its instance.

    Raises OSError where it does not load or lacks a function.
    """

    component = 0  # address of the FMI component

    def __init__(self, library: Path, fmi: int) -> None:
        self._prefix, self.fmi = f"fmi{fmi}", fmi
        here = os.getcwd()
        os.chdir(library.parent)  # so that libraries beside it are found
        try:
            self.dll = ctypes.CDLL(str(library))
        finally:
            os.chdir(here)
        try:
            for name in (*_REQUIRED, "SetupExperiment" if fmi == 2 else "InstantiateCoSimulation"):
                self.function(name)
        except OSError:
            self.free_library()
            raise

    def function(self, name: str) -> Any:
        """Return a function of the FMU by its name without prefix.  Raises OSError if missing."""
        try:
            return self.dll[self._prefix + name]
        except AttributeError:
            raise OSError(f"it has no function {self._prefix}{name}") from None

    def instantiate(self, name: str, token: str, resources: Path, log: _bank.Log, returns_early: bool = False) -> bool:
        """Create the instance, with messages to ``log``; return False if it refuses."""
        if self.fmi == 2:
            libc = ctypes.CDLL(None)
            allocate, free = (ctypes.cast(each, c_void_p).value for each in (libc.calloc, libc.free))
            self._callbacks = _Callbacks(_bank.LOGGER2, allocate, free, None, log.address)
            make, where, kind = self.function("Instantiate"), resources.as_uri(), (c_int(1),)
            more: tuple[Any, ...] = (byref(self._callbacks), c_int(0), c_int(1))
            arguments = (*kind, c_char_p(token.encode()), c_char_p(where.encode()), *more)
        else:
            make, where = self.function("InstantiateCoSimulation"), f"{resources}{os.sep}"
            flags = (c_bool(False), c_bool(True), c_bool(False), c_bool(returns_early))
            more = (*flags, None, c_size_t(0), c_void_p(log.address), c_void_p(_bank.LOGGER3), None)
            arguments = (c_char_p(token.encode()), c_char_p(where.encode()), *more)
        make.restype = c_void_p
        self.component = make(c_char_p(name.encode()), *arguments) or 0
        return bool(self.component)

    def bind(self, name: str, *arguments: Any) -> Callable[[], None]:
        """Return a call of a function with C arguments that are made once.  It raises CallError."""
        function = self._prefix + name
        call = partial(self.function(name), c_void_p(self.component), *arguments)

        def call_checked() -> None:
            status = call()
            if status > 1:  # neither OK nor Warning
                raise CallError(function, status)

        return call_checked

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function with C arguments.  Raises CallError."""
        self.bind(name, *arguments)()

    def set_up(self) -> None:
        """Set up a simulation that begins at time 0, before anything is set."""
        if self.fmi == 2:
            self.call("SetupExperiment", c_int(0), c_double(0.0), c_double(0.0), c_int(0), c_double(0.0))

    def enter_initialization(self) -> None:
        none = (c_bool(False), c_double(0.0), c_double(0.0), c_bool(False), c_double(0.0))
        self.call("EnterInitializationMode", *(() if self.fmi == 2 else none))

    def make_values(self, kind: str, values: int | Sequence[float]) -> Any:
        """Return a C array for an FMI type, of a size or with values."""
        c_type: Any = c_int if kind == "Boolean" and self.fmi == 2 else _C_TYPES[kind]
        return (c_type * values)() if isinstance(values, int) else (c_type * len(values))(*values)

    def bind_values(self, way: str, kind: str, references: Sequence[int], values: Any) -> Callable[[], None]:
        """Return a call that sets or gets (``way``: ``Set`` or ``Get``) variables of one type from or to an array."""
        count = len(references)
        arguments = ((c_uint32 * count)(*references), c_size_t(count), values)
        return self.bind(f"{way}{kind}", *arguments, *(() if self.fmi == 2 else (c_size_t(len(values)),)))

    def bind_step(self, now: c_double, step: float) -> Callable[[], None]:
        """Return a call that advances the instance by ``step`` s from the time ``now`` at the call."""
        if self.fmi == 2:
            return self.bind("DoStep", now, c_double(step), c_int(1))
        results = [*(byref(c_bool()) for _ in range(3)), byref(c_double())]
        return self.bind("DoStep", now, c_double(step), c_bool(True), *results)

    def terminate(self) -> None:
        """End the simulation, whatever status the FMU returns."""
        self.function("Terminate")(c_void_p(self.component))

    def free(self) -> None:
        """Free the instance and close the library."""
        if self.component:
            self.function("FreeInstance")(c_void_p(self.component))
        self.free_library()

    def free_library(self) -> None:
        """Close the library without freeing the instance."""
        ctypes.CDLL(None).dlclose(c_void_p(self.dll._handle))
