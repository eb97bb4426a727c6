"""One FMU instance: loaded, instantiated and initialized through FMPy, then handed to the C loop for stepping."""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cosim.engine import _bank
from cosim.engine.archive import REALS, Archive, Variable, one_line

STATUS = {2: "discard", 3: "error", 4: "fatal", 5: "pending"}
FATAL = 4

FUNCTIONS = {
    2: ("fmi2SetReal", "fmi2DoStep", "fmi2GetReal"),
    3: ("fmi3SetFloat64", "fmi3DoStep", "fmi3GetFloat64"),
}

# What failed, in the words of the C loop -> in ours.
FAULTS = {
    "set": "setting the throttle returned {status}",
    "step": "doStep returned {status}",
    "get": "getting the thrust returned {status}",
    "terminate": "it asked to end the simulation",
    "early": "it returned early from doStep",
    "event": "it asked for event handling",
    "nan": "thrust is not finite",
    "throttle": "throttle is not finite",
}

Setting = tuple[Variable, float]
Row = tuple[int, int, int, int, int, int, int, int]


class SlaveError(Exception):
    """An FMU refused: one line without its name, which the caller knows."""


class Slave:
    """An instance of ``archive``, whose unpacked files are in ``folder``.

    Raises SlaveError if the library does not load or the FMU refuses to be instantiated.
    """

    def __init__(self, archive: Archive, folder: Path, name: str) -> None:
        self.archive = archive
        self.log = _bank.Log()
        self._stepping = False
        self._dead = False
        self.fmu: Any = _load(archive, folder, name)
        try:
            self._instantiate(folder)
        except BaseException:
            self.fmu.freeLibrary()
            self.fmu = None
            raise

    def _instantiate(self, folder: Path) -> None:
        # FMPy's own instantiate() would print the FMU's messages; this way the C loop's log gets them
        fmu = self.fmu
        name, token, resources = fmu.instanceName.encode(), self.archive.token.encode(), folder / "resources"
        if self.archive.fmi == 2:
            from fmpy.fmi2 import fmi2CoSimulation  # type: ignore[import-untyped]

            self._callbacks = _callbacks2(self.log)
            fmu.component = fmu.fmi2Instantiate(
                instanceName=name,
                fmuType=fmi2CoSimulation,
                guid=token,
                resourceLocation=resources.as_uri().encode(),
                callbacks=ctypes.byref(self._callbacks),
                visible=False,
                loggingOn=True,
            )
        else:
            from fmpy.fmi3 import fmi3IntermediateUpdateCallback, fmi3LogMessageCallback  # type: ignore[import-untyped]

            self._callbacks = fmi3LogMessageCallback(_bank.LOGGER3), fmi3IntermediateUpdateCallback()
            fmu.component = fmu.fmi3InstantiateCoSimulation(
                instanceName=name,
                instantiationToken=token,
                resourcePath=f"{resources}{os.sep}".encode(),
                visible=False,
                loggingOn=True,
                eventModeUsed=False,
                earlyReturnAllowed=False,
                requiredIntermediateVariables=None,
                nRequiredIntermediateVariables=0,
                instanceEnvironment=self.log.address,
                logMessage=self._callbacks[0],
                intermediateUpdate=self._callbacks[1],
            )
        if not fmu.component:
            raise SlaveError(self._with_log("cannot be instantiated"))

    def initialize(self, settings: Sequence[Setting], throttle: float) -> float:
        """Set parameters and throttle, leave initialization mode at time 0, and return the thrust [N] there.

        Raises SlaveError if the FMU returns an error on the way.
        """
        reference = self.archive.throttle.reference
        if self.archive.fmi == 2:
            self.call("setupExperiment", startTime=0.0)
        for variable, value in settings:
            self._set(variable, value)
        self.call("enterInitializationMode")
        self.call("setReal" if self.archive.fmi == 2 else "setFloat64", [reference], [throttle])
        self.call("exitInitializationMode")
        self._stepping = True
        thrust = self.call("getReal" if self.archive.fmi == 2 else "getFloat64", [self.archive.thrust.reference])[0]
        if not math.isfinite(thrust):
            raise SlaveError("thrust is not finite at the start")
        return float(thrust)

    def _set(self, variable: Variable, value: float) -> None:
        fitting = value if variable.type in REALS else bool(value) if variable.type == "Boolean" else int(value)
        self.call(f"set{variable.type}", [variable.reference], [fitting])

    def call(self, name: str, *args: Any, **kwargs: Any) -> Any:
        """Call one of FMPy's wrappers.  Raises SlaveError if it returns worse than a warning."""
        from fmpy.fmi1 import FMICallException  # type: ignore[import-untyped]

        try:
            return getattr(self.fmu, name)(*args, **kwargs)
        except FMICallException as error:
            self.failed(error.status)
            raise SlaveError(self._with_log(f"{error.function} returned {_status(error.status)}")) from error

    def failed(self, status: int) -> None:
        """Remember that the FMU is in its error state, where little may be called, or beyond all calls."""
        self._stepping = False
        self._dead = self._dead or status == FATAL

    def _with_log(self, text: str) -> str:
        said = one_line(self.log.take())
        return f"{text}: {said}" if said else text

    def explain(self, failure: _bank.FailureError, moment: str) -> str:
        """What went wrong in the C loop and when, with what the FMU itself said about it."""
        _, what, status = failure.args
        self.failed(status)
        return self._with_log(f"{FAULTS[what].format(status=_status(status))} {moment}")

    def row(self, done: int = 0) -> Row:
        """What the C loop needs to step this instance, which has ``done`` communication steps behind it."""
        fmi, throttle, thrust = self.archive.fmi, self.archive.throttle.reference, self.archive.thrust.reference
        names = FUNCTIONS[fmi]
        setter, step, getter = (ctypes.cast(getattr(self.fmu.dll, name), ctypes.c_void_p).value or 0 for name in names)
        return fmi, self.fmu.component, setter, step, getter, throttle, thrust, done

    def close(self) -> None:
        """Terminate and free the instance, and let go of the library."""
        if self.fmu is None:
            return
        fmu, self.fmu = self.fmu, None
        if self._dead:
            return  # after a fatal error nothing may be called any more, not even to free it
        version = self.archive.fmi
        if self._stepping:
            getattr(fmu.dll, f"fmi{version}Terminate")(fmu.component)
        fmu.freeInstance()


def _load(archive: Archive, folder: Path, name: str) -> Any:
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    kind = FMU2Slave if archive.fmi == 2 else FMU3Slave
    here = Path.cwd()
    try:
        return kind(
            guid=archive.token,
            unzipDirectory=str(folder),
            modelIdentifier=archive.identifier,
            instanceName=name,
        )
    except Exception as error:  # FMPy raises bare exceptions here
        reason = one_line(error).replace(f"{folder}{os.sep}", "")
        raise SlaveError(f"its shared library does not load: {reason}") from error
    finally:
        os.chdir(here)  # FMPy changes it, and leaves it changed when loading fails


def _callbacks2(log: _bank.Log) -> Any:
    from fmpy import calloc, free  # type: ignore[import-untyped]
    from fmpy.fmi2 import (
        fmi2CallbackAllocateMemoryTYPE,
        fmi2CallbackFreeMemoryTYPE,
        fmi2CallbackFunctions,
        fmi2CallbackLoggerTYPE,
    )

    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(_bank.LOGGER2)
    callbacks.allocateMemory = ctypes.cast(calloc, fmi2CallbackAllocateMemoryTYPE)
    callbacks.freeMemory = ctypes.cast(free, fmi2CallbackFreeMemoryTYPE)
    callbacks.componentEnvironment = log.address
    return callbacks


def _status(status: int) -> str:
    return STATUS.get(status, f"status {status}")
