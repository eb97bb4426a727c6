"""What every engine of the library must be: valid, described, the same in both FMI versions, restorable, clean in memory."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from engine_tools import Array, Driven, archive, driven
from fmpy.validation import validate_fmu
from places import TOOLS

from cosim.base.storage.paths import data_folder
from cosim.engine import library, list_engine_names

pytestmark = pytest.mark.usefixtures("built_engines")

ENGINES = list_engine_names()
FMUS = [(name, fmi) for name in ENGINES for fmi in (2, 3)]
# a start that fits into a short test
QUICK = {
    name: {"ignition_time": 0.2, "spooling_time": 2.0} for name in ENGINES if name.startswith(("turbine-", "jetcat-"))
}
STANDARD = {
    "throttle": ("input", "1"),
    "run": ("input", "1"),
    "ambient_pressure": ("input", "Pa"),
    "ambient_temperature": ("input", "K"),
    "air_speed": ("input", "m/s"),
    "thrust": ("output", "N"),
    "spool_speed": ("output", "rpm"),
    "exhaust_temperature": ("output", "K"),
    "fuel_flow": ("output", "kg/s"),
}
OUTPUTS = [name for name, (causality, _) in STANDARD.items() if causality == "output"]


def step_of(name: str) -> float:
    return library.read_engine(data_folder("engines") / name).internal_step


def run_wildly(engine: Driven, steps: range, step: float, seed: int = 5) -> Array:
    """Every output after each step, under inputs that jump anywhere in their range, shut down in between."""
    random = np.random.default_rng(seed)
    levels = {name: random.uniform(0.0, 1.0, 4000) for name in STANDARD if STANDARD[name][0] == "input"}
    ranges = {
        "throttle": (-0.3, 1.3),  # beyond its range too: it is limited where it enters
        "ambient_pressure": (60e3, 105e3),
        "ambient_temperature": (230.0, 320.0),
        "air_speed": (-40.0, 90.0),
    }
    outputs = [name for name in OUTPUTS if name in engine.reference]
    rows = []
    for k in steps:
        for name, (low, high) in ranges.items():
            if name in engine.reference and k % 25 == 0:
                engine.set(name, low + (high - low) * float(levels[name][k // 25]))
        if "run" in engine.reference:
            engine.set("run", 0.0 if 350 <= k % 2000 < 420 else 1.0)
        engine.fmu.doStep(k * step, step)
        rows.append([engine.get(name) for name in outputs])
    return np.array(rows)


@pytest.mark.parametrize(("name", "fmi"), FMUS)
def test_fmpy_finds_nothing_to_say_against_the_archives(name: str, fmi: int) -> None:
    assert validate_fmu(str(archive(name, fmi))) == []


@pytest.mark.parametrize(("name", "fmi"), FMUS)
def test_the_standard_ports_are_described_with_unit_and_range(name: str, fmi: int) -> None:
    description = fmpy.read_model_description(str(archive(name, fmi)))
    variables = {v.name: v for v in description.modelVariables}
    units = {u.name: u.baseUnit for u in description.unitDefinitions}
    engine = library.read_engine(data_folder("engines") / name)
    for port, variable in engine.ports.items():
        assert port == variable or (port, variable) == ("start", "throttle_start")
    for port in set(STANDARD) & set(variables):
        assert port in engine.ports
        v = variables[port]
        assert (v.causality, v.unit) == STANDARD[port]
        assert v.unit in units
        assert v.min is not None
        # full thrust of the first-order engines is a matter of their parameters, which know no bound
        assert v.max is not None or (port == "thrust" and "gain" in variables)
    assert (float(variables["throttle"].min), float(variables["throttle"].max)) == (0.0, 1.0)
    assert variables["delay_samples"].causality == "parameter"
    assert engine.ledger["delay"] == "delay_samples"


@pytest.mark.parametrize("name", ENGINES)
def test_both_versions_agree_bit_for_bit_and_keep_to_their_ranges(name: str, tmp_path: Path) -> None:
    runs = []
    for fmi in (2, 3):
        with driven(archive(name, fmi), tmp_path / str(fmi)) as engine:
            engine.start(throttle_start=0.4, **QUICK.get(name, {}))
            runs.append(run_wildly(engine, range(3000), step_of(name)))
            limits = {v.name: (v.min, v.max) for v in engine.description.modelVariables}
    assert runs[0].tobytes() == runs[1].tobytes()
    outputs = [port for port in OUTPUTS if port in limits]
    for values, port in zip(runs[0].T, outputs, strict=True):
        low, high = limits[port]
        assert float(low) <= values.min()
        assert high is None or values.max() <= float(high)
        assert np.ptp(values) > 0.0  # the inputs moved it


@pytest.mark.parametrize(("name", "fmi"), FMUS)
@pytest.mark.parametrize("saved_at", [10, 400, 1111])
def test_save_restore_continue_is_bit_identical(name: str, fmi: int, saved_at: int, tmp_path: Path) -> None:
    """In every phase of a turbine: running, shut down, cranking, spooling up."""
    step = step_of(name)
    with driven(archive(name, fmi), tmp_path) as engine:
        engine.start(throttle_start=0.6, **QUICK.get(name, {}))
        run_wildly(engine, range(saved_at), step)
        fmu: Any = engine.fmu
        saved = fmu.getFMUstate() if fmi == 2 else fmu.getFMUState()
        bytes_ = fmu.serializeFMUstate(saved) if fmi == 2 else fmu.serializeFMUState(saved)
        rest = range(saved_at, saved_at + 607)  # no multiple of a delay, or the delay line would stand as before
        first = run_wildly(engine, rest, step)
        (fmu.setFMUstate if fmi == 2 else fmu.setFMUState)(saved)
        assert run_wildly(engine, rest, step).tobytes() == first.tobytes()
        copy = fmu.deSerializeFMUstate(bytes_) if fmi == 2 else fmu.deserializeFMUState(bytes_)
        (fmu.setFMUstate if fmi == 2 else fmu.setFMUState)(copy)
        assert run_wildly(engine, rest, step).tobytes() == first.tobytes()
        for state in (saved, copy):
            (fmu.freeFMUstate if fmi == 2 else fmu.freeFMUState)(state)


@pytest.mark.parametrize("name", ENGINES)
def test_the_delay_shifts_the_answer_by_whole_samples(name: str, tmp_path: Path) -> None:
    step, throttle = step_of(name), np.repeat([0.2, 0.9, 0.4, 0.6], 200)
    thrusts = []
    for samples in (0, 15):
        with driven(archive(name, 3), tmp_path / str(samples)) as engine:
            engine.start(delay_samples=samples, throttle_start=0.2)
            thrusts.append(engine.run(throttle, step=step))
    start = thrusts[0][:15]
    assert thrusts[1][15:].tobytes() == thrusts[0][:-15].tobytes()
    # still at its start, to the rounding of a balance
    np.testing.assert_allclose(thrusts[1][:15], start[0], rtol=1e-9)


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("throttle", [0.0, 0.37, 1.0])
def test_it_starts_in_equilibrium(name: str, throttle: float, tmp_path: Path) -> None:
    with driven(archive(name, 3), tmp_path) as engine:
        engine.start(throttle_start=throttle)
        start = engine.get("thrust")
        thrust = engine.run(np.full(1000, throttle), step=step_of(name))
    # a balance is found to rounding; of a slow mode near idle that is multiplied by its gain at rest
    np.testing.assert_allclose(thrust, start, rtol=1e-9, atol=1e-12)


HEADERS = Path(fmpy.__file__).parent / "c-code"
DRIVER = TOOLS / "fmu_driver.c"


def compiled(target: Path, sources: list[Path], *options: str) -> Path:
    compiler = shutil.which("cc")
    assert compiler is not None
    command = [compiler, "-std=c11", "-D_GNU_SOURCE", "-g", f"-I{HEADERS}", *options, *map(str, sources)]
    done = subprocess.run([*command, "-lm", "-ldl", "-o", str(target)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return target


def arguments(name: str, fmi: int, library: Path) -> list[str]:
    description = fmpy.read_model_description(str(archive(name, fmi)))
    reference = {v.name: str(v.valueReference) for v in description.modelVariables}
    token = description.guid if fmi == 2 else description.instantiationToken
    inputs = [reference.get(port, "0") for port in ("throttle", "run", "cold_start", "ignition_time")]
    found = [reference[port] for port in OUTPUTS if port in reference]
    return [str(library), token, repr(step_of(name)), *inputs, *found]


@pytest.fixture(scope="module", params=[2, 3], ids=["fmi2", "fmi3"])
def driver(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[int, Path]:
    fmi = request.param
    target = tmp_path_factory.mktemp("driver") / f"driver{fmi}"
    return fmi, compiled(target, [DRIVER], f"-DFMI={fmi}", "-O1", "-Wall", "-Wextra", "-Werror")


@pytest.mark.long  # the sanitizers below look for the same
@pytest.mark.parametrize("name", ENGINES)
def test_valgrind_finds_nothing(name: str, driver: tuple[int, Path], tmp_path: Path) -> None:
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        pytest.skip("valgrind is not installed; the sanitizers' test below does the same")
    fmi, program = driver
    fmpy.extract(str(archive(name, fmi)), str(tmp_path))
    (library,) = (tmp_path / "binaries").rglob("*.so")
    command = [str(program), *arguments(name, fmi, library)]
    options = ["--error-exitcode=1", "--leak-check=full", "--show-leak-kinds=all", "--errors-for-leak-kinds=all", "-q"]
    done = subprocess.run([valgrind, *options, *command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    # and it was the whole flight
    assert done.stdout == subprocess.run(command, capture_output=True, text=True, check=True).stdout != ""


# one engine for each C source: the others are the same code with other numbers
@pytest.mark.parametrize("name", ["edf-as-flown", "fitted", "p220", "p220-2025", "turbine-100"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_sanitizers_find_nothing(name: str, fmi: int, tmp_path: Path) -> None:
    fmpy.extract(str(archive(name, fmi)), str(tmp_path))
    sources = tmp_path / "sources"
    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer", "-O1"]
    library = compiled(tmp_path / "engine.so", sorted(sources.glob("*.c")), *checks, "-fPIC", "-shared", f"-I{sources}")
    program = compiled(tmp_path / "driver", [DRIVER], *checks, f"-DFMI={fmi}")
    done = subprocess.run([str(program), *arguments(name, fmi, library)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(done.stdout.splitlines()) == len(arguments(name, fmi, library)) - 7


@pytest.mark.parametrize("name", ["edf", "fitted", "p220", "p220-2025", "turbine-220"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_sources_compile_without_a_warning(name: str, fmi: int, tmp_path: Path) -> None:
    fmpy.extract(str(archive(name, fmi)), str(tmp_path))
    sources = tmp_path / "sources"
    strict = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
    compiled(tmp_path / "x.so", sorted(sources.glob("*.c")), *strict, "-fPIC", "-shared", f"-I{sources}")
