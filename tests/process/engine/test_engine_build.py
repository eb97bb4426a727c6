"""From an engine's folder to its archives: reproducible, self-contained, quiet, and clear about what is wrong."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest
from engine_tools import STEP, archive, driven, rewrite, throttles
from fmpy.validation import validate_fmu

from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.engine import EngineBank, build_engines, check_fmu, library, list_engine_names, load_engine
from cosim.engine.library import BuildError, archives, build_all, read_engine

pytestmark = pytest.mark.usefixtures("built_engines")


@pytest.fixture
def engines(tmp_path: Path) -> Path:
    """A copy of the engines' sources, to be changed at will."""
    return Path(shutil.copytree(data_folder("engines"), tmp_path / "engines"))


def test_the_same_input_gives_the_same_bytes_and_no_words(
    engines: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Built elsewhere, in another folder, it is the archive in ``fmus/``."""
    for path in build_all(engines, tmp_path / "fmus", ["edf"]):
        assert path.read_bytes() == (data_folder("fmus") / path.name).read_bytes()
    assert capfd.readouterr() == ("", "")


def test_what_is_up_to_date_is_left_alone_and_what_is_not_is_built(
    engines: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmus = Path(shutil.copytree(data_folder("fmus"), tmp_path / "fmus"))
    compiled: list[str] = []
    monkeypatch.setattr(archives, "compile_sources", lambda folder, label: compiled.append(label))
    built = build_all(engines, fmus)
    names = library.list_engines(data_folder("engines"))
    assert sorted(path.name for path in built) == sorted(f"{n}{s}.fmu" for n in names for s in ("", "-fmi2"))
    assert compiled == []
    source = engines / "delayed_lag.c"
    source.write_text(source.read_text() + "\n")
    build_all(engines, fmus, ["turbojet"])
    rewrite(archive("edf", 3), fmus / "edf.fmu", lambda contents: contents.pop("modelDescription.xml") and None)
    (fmus / "edf-fmi2.fmu").write_bytes(b"half an archive")
    source.write_text(source.read_text()[:-1])
    build_all(engines, fmus, ["edf"])
    assert compiled == ["turbojet.fmu", "turbojet-fmi2.fmu", "edf.fmu", "edf-fmi2.fmu"]


def test_the_token_is_that_of_the_content(engines: Path) -> None:
    def token(fmi: int) -> str:
        return library.hash_build_inputs(read_engine(engines / "edf"), engines / "fmi", fmi)

    described = fmpy.read_model_description(str(archive("edf", 3)))
    assert described.instantiationToken == token(3) != token(2)
    before = token(3)
    path = engines / "fmi" / "slave.c"
    path.write_text(path.read_text().replace("1e-9", "1e-8"))
    assert token(3) != before


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_sources_inside_are_enough_to_compile_it_elsewhere(fmi: int, tmp_path: Path) -> None:
    def strip(contents: dict[str, bytes]) -> None:
        for name in [name for name in contents if name.startswith("binaries/")]:
            del contents[name]

    stripped = rewrite(archive("turbojet", fmi), tmp_path / "stripped.fmu", strip)
    folder = tmp_path / "unpacked"
    fmpy.extract(str(stripped), str(folder))
    assert not (folder / "binaries").exists()
    assert not list((folder / "sources").glob("fmi*.h"))  # the importer's own headers are to be used
    library.compile_sources(folder, "turbojet")
    runs = []
    for place in (folder, tmp_path / "shipped"):
        with driven(archive("turbojet", fmi), place) as engine:
            engine.start()
            runs.append(engine.run(throttles()["random"]))
    assert runs[0].tobytes() == runs[1].tobytes()


def test_nothing_but_fmi_functions_is_exported(tmp_path: Path) -> None:
    """Or two FMUs in one process could be bound to each other's functions."""
    for fmi in (2, 3):
        fmpy.extract(str(archive("edf", fmi)), str(tmp_path / str(fmi)))
        (library,) = (tmp_path / str(fmi) / "binaries").rglob("edf.so")
        told = subprocess.run(["nm", "-D", "--defined-only", library], capture_output=True, text=True, check=True)
        names = [line.split()[-1] for line in told.stdout.splitlines()]
        assert names
        assert [name for name in names if not name.startswith(f"fmi{fmi}")] == []


def test_it_builds_without_the_package_around_it(tmp_path: Path) -> None:
    """As the package's own build does: loaded by path, with the standard library and FMPy alone."""
    program = f"""
import importlib.util, json, sys
from pathlib import Path
spec = importlib.util.spec_from_file_location("engine_build", {str(Path(library.__file__))!r})
module = sys.modules["engine_build"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
paths = module.build_all(Path({str(data_folder("engines"))!r}), Path({str(data_folder("fmus"))!r}))
print(json.dumps([len(paths), "cosim" in sys.modules, "pydantic" in sys.modules]))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert json.loads(done.stdout) == [2 * len(list_engine_names()), False, False]


def test_an_unknown_engine_is_refused(engines: Path, tmp_path: Path) -> None:
    allowed = "edf, edf-as-flown, fitted, jetcat-p300, motor, p220, p220-2025, turbine-100, "
    with pytest.raises(BuildError, match=f"unknown engine 'rocket'; allowed: {allowed}"):
        build_all(engines, tmp_path, ["rocket"])
    with pytest.raises(InputError, match="unknown engine 'rocket'"):
        build_engines(["rocket"])


@pytest.fixture
def bare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that has make and nothing else."""
    tool = shutil.which("make")
    assert tool is not None
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "make").symlink_to(tool)
    for name in ("CC", "CXX"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))


@pytest.mark.parametrize(
    ("cmake", "said"), [(True, r"no C compiler found \(on Debian"), (False, "cmake is not found")], ids=["cc", "cmake"]
)
def test_a_build_needs_a_compiler_and_cmake(
    engines: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bare: None, cmake: bool, said: str
) -> None:
    if not cmake:
        monkeypatch.setitem(sys.modules, "cmake", None)
    with pytest.raises(BuildError, match=rf"^edf\.fmu: cannot be compiled: {said}"):
        build_all(engines, tmp_path / "fmus", ["edf"])
    assert list((tmp_path / "fmus").iterdir()) == []


def test_a_fault_in_the_c_source_is_quoted(engines: Path, tmp_path: Path) -> None:
    source = engines / "delayed_lag.c"
    source.write_text(source.read_text().replace("v->thrust = v->newton", "v->thrust = w->newton"))
    said = r"^edf\.fmu: cannot be compiled: .*delayed_lag\.c:\d+:\d+: error: .w. undeclared"
    with pytest.raises(BuildError, match=said):
        build_all(engines, tmp_path / "fmus", ["edf"])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("title = ", "titel = ", "unknown key titel; allowed: description, flame_out, internal_step_s, ledger, ports,"),
        ("electric = true", "electric = false", "flame_out.electric = False: allowed: true"),
        ("electric = true", "thrust_left = 0.4", "flame_out.exponent is missing"),
        ("title", "title title", "not valid TOML: "),
        ("internal_step_s = 0.004", "internal_step_s = nan", "internal_step_s = nan: must be a finite number"),
        ("../delayed_lag.c", "missing.c", "sources: there is no file "),
        ('thrust = "thrust"', 'thrust = "force"', "thrust = 'force': must name an output (allowed: thrust)"),
        ('causality = "input"', 'causality = "in"', "variables.throttle.causality = 'in': allowed: input, output,"),
        ('unit = "N"', 'unit = "lbf"', "variables.thrust.unit = 'lbf': allowed: 1, N, K, "),
        ('unit = "N"', 'unit = "kg"', "variables.thrust.unit = 'kg': the port thrust is in N"),
        ("[ledger]", "[rotor]\ninertia_kg_m2 = -1e-4\n[ledger]", "rotor.inertia_kg_m2 = -0.0001: must not be below 0"),
        ("max = 0.999999", "max = 0.0", "variables.pole: min = 0 is not below max = 0"),
        ("start = 0.8748", "start = 1.5", "variables.pole.start = 1.5 is outside min and max"),
        ("start = 0.2554", "", "variables.gain: inputs and parameters have a start, outputs have none"),
        ("min = 0\n", "", "variables.delay_samples: an integer needs min and max"),
        ("[variables.gain]", "[variables.Gain]", "variables.Gain: a variable's name is a C identifier in lower case"),
    ],
)
def test_a_wrong_engine_toml_gets_one_line(engines: Path, old: str, new: str, words: str) -> None:
    path = engines / "edf" / "engine.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(BuildError) as caught:
        read_engine(path.parent)
    assert str(caught.value).startswith(f"{path}: {words}")
    assert "\n" not in str(caught.value)


def variable(name: str, causality: str, unit: str, *lines: str) -> str:
    more = "\n".join(lines)
    return f'[variables.{name}]\ncausality = "{causality}"\nunit = "{unit}"\ndescription = "{name}"\n{more}\n'


SPOOL_TOML = f"""
title = "Spool"
description = "A spool with inertia, exhaust temperature, fuel flow and an ambient pressure"
sources = ["spool.c"]
internal_step_s = 0.002
[ports]
throttle = "lever"
thrust = "net_thrust"
{variable("lever", "input", "1", "min = 0.0", "max = 1.0", "start = 0.0")}
{variable("ambient_pressure", "input", "Pa", "min = 0.0", "start = 101325.0")}
{variable("net_thrust", "output", "N")}
{variable("spool_speed", "output", "rpm")}
{variable("exhaust_temperature", "output", "K")}
{variable("fuel_flow", "output", "kg/s")}
{variable("idle", "parameter", "rpm", "min = 1000.0", "start = 30000.0")}
"""

SPOOL_C = """
#include "engine.h"
typedef struct { double speed; } State;
const size_t engine_state_size = sizeof(State);
static void outputs(Variables *v, const State *s)
{
    v->spool_speed = s->speed;
    v->net_thrust = 2e-8 * s->speed * s->speed * v->ambient_pressure / 101325.0;
    v->exhaust_temperature = 600.0 + 4e-3 * s->speed;
    v->fuel_flow = 1e-7 * s->speed;
}
void engine_start(Variables *v, void *state)
{
    State *s = state;
    s->speed = v->idle;
    outputs(v, s);
}
void engine_step(Variables *v, void *state)
{
    State *s = state;
    const double wanted = v->idle + 80000.0 * limit(v->lever, 0.0, 1.0);
    s->speed += ENGINE_STEP * (wanted - s->speed) * s->speed / 30000.0;
    outputs(v, s);
}
"""


def test_an_engine_of_another_kind_is_a_new_folder(engines: Path, tmp_path: Path) -> None:
    folder = engines / "spool"
    folder.mkdir()
    (folder / "engine.toml").write_text(SPOOL_TOML)
    (folder / "spool.c").write_text(SPOOL_C)
    for path in build_all(engines, tmp_path / "fmus", ["spool"]):
        assert validate_fmu(str(path)) == []
        units = {u.name: u.baseUnit for u in fmpy.read_model_description(str(path)).unitDefinitions}
        assert units["rpm"].factor == pytest.approx(math.pi / 30.0, rel=1e-15)
        with driven(path, tmp_path / path.stem) as engine:
            engine.start()
            engine.set("ambient_pressure", 80000.0)
            speed = 30000.0
            for k in range(300):
                engine.set("lever", 0.6)
                engine.fmu.doStep(k * 0.004, 0.004)
                for _ in range(2):  # two internal steps in each communication step
                    speed += 0.002 * (30000.0 + 80000.0 * 0.6 - speed) * speed / 30000.0
            assert engine.get("spool_speed") == pytest.approx(speed, rel=1e-13)
            assert engine.get("net_thrust") == pytest.approx(2e-8 * speed**2 * 80000.0 / 101325.0, rel=1e-13)

        # as an engine of a user, its ports go by their plain names
        def rename(contents: dict[str, bytes]) -> None:
            text = contents["modelDescription.xml"]
            text = text.replace(b'name="lever"', b'name="throttle"').replace(b'name="net_thrust"', b'name="thrust"')
            contents["modelDescription.xml"] = text

        mine = rewrite(path, tmp_path / f"my-{path.name}", rename)
        spec = load_engine(str(mine), {"idle": 20000.0}, STEP)
        assert (spec.start, spec.pole, spec.delay_samples) == (None, None, None)
        np.testing.assert_allclose(
            spec.curve.thrust, [2e-8 * (20000.0 + 80000.0 * u) ** 2 for u in spec.curve.throttle], rtol=1e-8
        )
        with EngineBank(spec, 6, STEP) as bank:
            assert bank.reset(0.5).thrust == pytest.approx([2e-8 * 60000.0**2] * 6, rel=1e-8)
        assert check_fmu(str(mine)).ok
