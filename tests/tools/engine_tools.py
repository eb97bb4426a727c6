"""What the engine tests share: the paper's equations, FMPy's own stepping, and archives that are broken on purpose."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from cosim.base.arrays import Array
from cosim.base.storage.paths import data_folder
from cosim.engine import library

STEP = 0.004
NEWTON_PER_KGF = 9.80665
# gain, pole, delay of G(z) = gain / (z - pole) z^-delay as the paper prints them; the third is the EDF with 25 samples
PAPER = {"turbojet": (0.01866, 0.9879, 25), "edf": (0.2554, 0.8748, 0), "edf-as-flown": (0.2554, 0.8748, 25)}
BOTH = [(name, fmi) for name in PAPER for fmi in (2, 3)]


def bang_bang(seed: int, steps: int = 40_000) -> Array:
    """Throttles at random, held for 300 steps or so: nothing, everything, and anything between them; ``steps`` and more."""
    random = np.random.default_rng(seed)
    throttle: list[float] = []
    while len(throttle) < steps:
        throttle += [random.choice([0.0, 1.0, random.uniform()])] * int(random.exponential(300.0) + 1.0)
    return np.array(throttle)


def integrated(equations: Iterable[Callable[..., Any]], state: Array, held: int) -> Array:
    """The first of what ``equations`` move from ``state``, one after the other for ``held`` steps, by scipy."""
    at, found = np.arange(1, held + 1) * STEP, []
    for rates in equations:
        done = solve_ivp(rates, (0.0, at[-1]), state, "DOP853", at, rtol=1e-12, atol=1e-10, max_step=0.1)
        found.append(done.y[0])
        state = done.y[:, -1]
    return np.concatenate(found)


def paper_thrust(name: str, throttle: Array) -> Array:
    """Thrust [N] after each step from rest, by scipy's filter: the paper's transfer function and nothing of ours."""
    gain, pole, delay = PAPER[name]
    # lfilter's output at k is y[k+1], because G(z) is strictly proper by the one sample between u[k] and y[k+1]
    return np.asarray(lfilter([0.0] * delay + [gain], [1.0, -pole], throttle)) * NEWTON_PER_KGF


def archive(name: str, fmi: int) -> Path:
    return library.archive_path(data_folder("fmus"), name, fmi)


def throttles() -> dict[str, Array]:
    random = np.random.default_rng(20240607)
    return {"step": np.ones(600), "ramp": np.linspace(0.0, 1.0, 600), "random": random.uniform(0.0, 1.0, 600)}


class Driven:
    """One instance driven by FMPy's own wrappers, with the two versions behind the same names."""

    def __init__(self, path: Path, folder: Path, name: str = "driven", logging: bool = True) -> None:
        self.description = fmpy.read_model_description(str(path))
        self.fmi = 2 if self.description.fmiVersion == "2.0" else 3
        self.reference = {v.name: v.valueReference for v in self.description.modelVariables}
        self.integers = {v.name for v in self.description.modelVariables if v.type in ("Integer", "Int32")}
        self.messages: list[str] = []
        if not (folder / "modelDescription.xml").exists():
            fmpy.extract(str(path), str(folder))
        kind = FMU2Slave if self.fmi == 2 else FMU3Slave
        self.fmu: Any = kind(
            guid=self.description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.instantiate(logging)

    def instantiate(self, logging: bool = True) -> None:
        if self.fmi == 2:
            self.fmu.instantiate(callbacks=self._callbacks2(), loggingOn=logging)
        else:
            self.fmu.instantiate(loggingOn=logging, logMessage=lambda env, status, category, text: self._log(text))

    def _log(self, text: bytes) -> None:
        self.messages.append(text.decode())

    def _callbacks2(self) -> Any:
        from fmpy import fmi2

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda env, name, status, category, text: self._log(text))
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
        return callbacks

    def set(self, name: str, value: float) -> None:
        whole = name in self.integers
        kind = ("Integer" if whole else "Real") if self.fmi == 2 else ("Int32" if whole else "Float64")
        getattr(self.fmu, f"set{kind}")([self.reference[name]], [int(value) if whole else value])

    def get(self, name: str) -> float:
        getter = self.fmu.getReal if self.fmi == 2 else self.fmu.getFloat64
        return float(getter([self.reference[name]])[0])

    def start(self, start_time: float = 0.0, stop_time: float | None = None, **parameters: float) -> None:
        if self.fmi == 2:
            self.fmu.setupExperiment(startTime=start_time, stopTime=stop_time)
        for name, value in parameters.items():
            self.set(name, value)
        if self.fmi == 2:
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start_time, stopTime=stop_time)
        self.fmu.exitInitializationMode()

    def run(self, throttle: Array, first: int = 0, step: float = STEP) -> Array:
        thrusts = []
        for k, u in enumerate(throttle, start=first):
            self.set("throttle", float(u))
            self.fmu.doStep(k * step, step)
            thrusts.append(self.get("thrust"))
        return np.array(thrusts)


@contextmanager
def driven(path: Path, folder: Path, **options: Any) -> Iterator[Driven]:
    it = Driven(path, folder, **options)
    try:
        yield it
    finally:
        it.fmu.freeInstance()


def rewrite(source: Path, target: Path, change: Callable[[dict[str, bytes]], None]) -> Path:
    """A copy of an archive after ``change`` has had its way with the contents."""
    with zipfile.ZipFile(source) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    change(contents)
    with zipfile.ZipFile(target, "w") as archive:
        for name, data in contents.items():
            archive.writestr(name, data)
    return target


def edit_description(source: Path, target: Path, old: str, new: str) -> Path:
    def change(contents: dict[str, bytes]) -> None:
        text = contents["modelDescription.xml"].decode()
        assert old in text
        contents["modelDescription.xml"] = text.replace(old, new).encode()

    return rewrite(source, target, change)


FAULT_THROTTLE = 0.512  # not a point of the static curve, so measuring the engine does not trip it
_FAULT_NAMES = "nan error terminate early event fatal discard infinite get set warning pending"
FAULTS = {name: number for number, name in enumerate(_FAULT_NAMES.split(), 1)}

_FAULTY_TOML = """
title = "Faulty"
description = "An EDF that fails on demand"
sources = ["../../engines/delayed_lag.c", "honest2.h", "honest3.h"]
internal_step_s = 0.004
[ports]
throttle = "throttle"
thrust = "thrust"
"""

_FAULTY_VARIABLE = """
[variables.fault]
causality = "parameter"
type = "integer"
min = 0
max = 100
start = 0
description = "What goes wrong"
"""

# The honest adapter is included under other names, and the two functions that matter are wrapped.
_FAULTY_C = """
#include <math.h>
#include "fmi{N}Functions.h"
#include "slave.h"
#undef fmi{N}DoStep
#undef fmi{N}{GET}
#undef fmi{N}{SET}
#define fmi{N}DoStep honest_step
#define fmi{N}{GET} honest_get
#define fmi{N}{SET} honest_set
#include "honest{N}.h"
#undef fmi{N}DoStep
#undef fmi{N}{GET}
#undef fmi{N}{SET}

static int fault(Slave *s)
{{
    double fault = 0.0, throttle = 0.0;
    slave_get(s, 8, INTEGER, &fault);
    slave_get(s, 1, REAL, &throttle);
    return throttle == 0.512 ? (int)fault : 0;
}}
"""

_FAULTY_3 = """
fmi3Status fmi3DoStep(fmi3Instance s, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    fmi3Status status = honest_step(s, t, h, no, event, terminate, early, last);
    switch (fault(s)) {
    case 2: slave_fail(s, "compressor surge"); slave_fail(s, "flame out"); return fmi3Error;
    case 3: *terminate = fmi3True; break;
    case 4: *early = fmi3True; *last = t; break;
    case 5: *event = fmi3True; break;
    case 6: return fmi3Fatal;
    case 7: return fmi3Discard;
    case 11: return fmi3Warning;
    }
    return status;
}
fmi3Status fmi3GetFloat64(fmi3Instance s, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], size_t m)
{
    fmi3Status status = honest_get(s, r, n, v, m);
    if (fault(s) == 1) v[0] = NAN;
    if (fault(s) == 8) v[0] = INFINITY;
    return fault(s) == 9 ? fmi3Error : status;
}
fmi3Status fmi3SetFloat64(fmi3Instance s, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[], size_t m)
{
    fmi3Status status = honest_set(s, r, n, v, m);
    return fault(s) == 10 ? fmi3Error : status;
}
"""

_FAULTY_2 = """
fmi2Status fmi2DoStep(fmi2Component s, fmi2Real t, fmi2Real h, fmi2Boolean no)
{
    fmi2Status status = honest_step(s, t, h, no);
    switch (fault(s)) {
    case 2: slave_fail(s, "compressor surge"); slave_fail(s, "flame out"); return fmi2Error;
    case 6: return fmi2Fatal;
    case 7: return fmi2Discard;
    case 11: return fmi2Warning;
    case 12: return fmi2Pending;
    }
    return status;
}
fmi2Status fmi2GetReal(fmi2Component s, const fmi2ValueReference r[], size_t n, fmi2Real v[])
{
    fmi2Status status = honest_get(s, r, n, v);
    if (fault(s) == 1) v[0] = NAN;
    if (fault(s) == 8) v[0] = INFINITY;
    return fault(s) == 9 ? fmi2Error : status;
}
fmi2Status fmi2SetReal(fmi2Component s, const fmi2ValueReference r[], size_t n, const fmi2Real v[])
{
    fmi2Status status = honest_set(s, r, n, v);
    return fault(s) == 10 ? fmi2Error : status;
}
"""


def build_faulty(root: Path) -> Mapping[int, Path]:
    """Build the engine that fails on demand, FMI version -> archive; its start parameter has no name that is known."""
    engines, adapter, fmus = root / "engines", root / "adapter", root / "fmus"
    shutil.copytree(data_folder("engines") / "fmi", adapter)
    folder = engines / "faulty"
    folder.mkdir(parents=True)
    shutil.copy(data_folder("engines") / "delayed_lag.c", engines / "delayed_lag.c")
    variables = (data_folder("engines") / "edf" / "engine.toml").read_text().partition("[variables.throttle]")
    text = _FAULTY_TOML + variables[1] + variables[2] + _FAULTY_VARIABLE
    source = engines / "delayed_lag.c"
    source.write_text(source.read_text().replace("throttle_start", "throttle_before"))
    (folder / "engine.toml").write_text(text.replace("throttle_start", "throttle_before"))
    for fmi, wrappers, kind in ((2, _FAULTY_2, "Real"), (3, _FAULTY_3, "Float64")):
        shutil.copy(adapter / f"fmi{fmi}.c", folder / f"honest{fmi}.h")
        head = _FAULTY_C.format(N=fmi, GET=f"Get{kind}", SET=f"Set{kind}")
        (adapter / f"fmi{fmi}.c").write_text(head + wrappers)
    built = library.build_all(engines, fmus, adapter=adapter)
    return {3: built[0], 2: built[1]}
