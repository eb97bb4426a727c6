"""What travels: the source distribution and the wheel made from it, and the command in an environment of its own."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import tarfile
import time
import tomllib
import zipfile
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from places import ROOT, script

from cosim.base.compiled import MODULES, PURE_VARIABLE, SHARED
from cosim.cli.table import NATIVE

UNCOMPILED = bool(os.environ.get(PURE_VARIABLE))
COMPILED = (
    () if UNCOMPILED else ("base/frames.py", "vehicle/tank.py")
)  # a few stand for all: `make setup` compiles those
METADATA = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PACKAGES = {"cosim": ROOT / "cosim", **{path.name: path for path in (ROOT / "tools").glob("hexjet_*")}}
DATA = ("aircraft", "engines", "scenarios", "studies")
ENGINES = sorted(path.parent.name for path in (ROOT / "engines").glob("*/engine.toml"))
SCENARIOS = sorted(path.stem for path in (ROOT / "scenarios").glob("*.toml"))
STUDIES = sorted(path.stem for path in (ROOT / "studies").glob("*.toml"))
NOT_SOURCE = shutil.ignore_patterns(
    ".git", ".venv", ".*_cache", ".hypothesis", "__pycache__", "build", "dist", "runs", "*.egg-info", "*.so", "*.fmu"
)


def run(*command: str | Path, cwd: Path) -> str:
    """Run a command away from the clone's environment and return what it printed; a failure shows all it said."""
    inherited = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "PIP_"))}
    done = subprocess.run(
        [*map(str, command)], cwd=cwd, env=inherited, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    assert done.returncode == 0, f"{' '.join(map(str, command))}: status {done.returncode}\n{done.stdout}{done.stderr}"
    return done.stdout


def build(kind: str, source: Path, target: Path) -> Path:
    """Ask the build backend for an ``sdist`` or a ``wheel`` of ``source``: offline, with what is installed here."""
    target.mkdir()
    run(
        sys.executable, "-c", f"from setuptools import build_meta; build_meta.build_{kind}({str(target)!r})", cwd=source
    )
    (archive,) = target.iterdir()
    return archive


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sdist")
    shutil.copytree(ROOT, folder / "clone", ignore=NOT_SOURCE)
    return build("sdist", folder / "clone", folder / "dist")


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    source = folder / sdist.name.removesuffix(".tar.gz")
    compiled = source / "cosim" / "base/compiled.py"
    stated = compiled.read_text(encoding="utf-8").splitlines(keepends=True)
    left = [line for line in stated if line.strip(' ",\n') not in set(MODULES) - set(COMPILED)]
    assert len(stated) - len(left) == len(MODULES) - len(COMPILED)
    compiled.write_text("".join(left), encoding="utf-8")
    return build("wheel", source, folder / "dist")


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The programs' folder of an environment that has the wheel, and sees the libraries of this one."""
    folder = tmp_path_factory.mktemp("environment")
    run(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder)
    python = folder / "bin" / "python"
    run(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index", wheel, cwd=folder)
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('platlib'))", cwd=folder).strip())
    # a path in a .pth is not searched for further .pth files: the clone, installed editable here, stays out of sight
    (site / "libraries.pth").write_text("".join(f"{sysconfig.get_path(name)}\n" for name in ("purelib", "platlib")))
    return folder / "bin"


def source_files(name: str) -> set[str]:
    files = (path for path in (ROOT / name).rglob("*") if path.is_file())
    return {path.relative_to(ROOT).as_posix() for path in files if path.suffix != ".pyc" and path.name[0] != "."}


def test_the_source_distribution_is_the_whole_project(sdist: Path) -> None:
    prefix = f"hexjet_cosim-{METADATA['version']}/"
    with tarfile.open(sdist) as archive:
        names = {name.removeprefix(prefix) for name in archive.getnames()}
    top = {
        "LICENSE", "NOTICE", "Makefile", "README.md", "pyproject.toml", "requirements.lock", "requirements-dev.lock",
        "setup.py", ".ci/run",
    }  # fmt: skip
    wanted = top.union(*(source_files(name) for name in (*DATA, "tests", "docs", "benchmarks")))
    assert wanted - names == set()
    assert not [name for name in names if name.endswith((".so", ".fmu", ".pyc"))]


@pytest.mark.long
def test_the_wheel_carries_everything_a_flight_needs(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert ENGINES
    assert SCENARIOS
    fmus = {f"cosim/data/fmus/{name}{version}.fmu" for name in ENGINES for version in ("", "-fmi2")}
    data = {f"cosim/data/{name}" for folder in DATA for name in source_files(folder)}
    code = {path.relative_to(folder.parent).as_posix() for folder in PACKAGES.values() for path in folder.rglob("*.py")}
    templates = {
        path.relative_to(folder.parent).as_posix()
        for pattern in ("**/templates/*", "groundstation/web/static/**/*")
        for folder in PACKAGES.values()
        for path in folder.glob(pattern)
        if path.is_file()
    }
    assert templates
    assert (
        fmus
        | data
        | code
        | templates
        | {"cosim/py.typed", "hexjet_prove/proof/evidence.toml"}
        | {"hexjet_paper/py.typed", "hexjet_paper/calibration.toml", "hexjet_sitl/lockstep_clock.c"}
    ) - names == set()
    # and nothing else of the data than what is in the clone
    assert {name for name in names if name.startswith("cosim/data/")} == fmus | data
    binaries = [name for name in names if name.endswith((".so", ".pyd"))]
    wanted = [
        "base/_turning",
        "control/allocation/_effectiveness",
        "vehicle/_noise",
        "vehicle/_properties",
        "results/_rows",
        "engine/_bank",
        *(name.removesuffix(".py") for name in COMPILED),
    ]
    assert [name for name in names if name.endswith(SHARED)] == [f"cosim/{SHARED}"] * bool(COMPILED)
    assert len(binaries) == len(wanted) + bool(COMPILED)
    for extension in wanted:
        assert len([name for name in binaries if name.startswith(f"cosim/{extension}.")]) == 1
    # what is not of the limited API must not be offered to every Python
    assert all(".abi3." in name for name in binaries) == ("-abi3-" in wheel.name)
    outside = {name.split("/")[0] for name in names} - {*PACKAGES, f"hexjet_cosim-{METADATA['version']}.dist-info"}
    assert outside == set()


@pytest.mark.long
def test_the_wheel_states_licence_and_version(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        folder = f"hexjet_cosim-{METADATA['version']}.dist-info"
        metadata = archive.read(f"{folder}/METADATA").decode()
        licence, notice = (archive.read(f"{folder}/licenses/{name}").decode() for name in ("LICENSE", "NOTICE"))
    assert f"\nVersion: {METADATA['version']}\n" in metadata
    assert "\nLicense-Expression: MIT\n" in metadata
    assert licence == (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert notice == (ROOT / "NOTICE").read_text(encoding="utf-8")


@pytest.mark.long
def test_the_archives_in_the_wheel_hold_their_sources_and_a_binary(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archives = [name for name in archive.namelist() if name.endswith(".fmu")]
        for name in archives:
            with archive.open(name) as stream, zipfile.ZipFile(stream) as fmu:
                files = fmu.namelist()
                assert fmu.testzip() is None
            assert "modelDescription.xml" in files
            assert any(file.startswith("binaries/") for file in files)
            assert any(file.startswith("sources/") and file.endswith(".c") for file in files)


@pytest.mark.long
def test_the_installed_command_lists_what_is_shipped(installed: Path, tmp_path: Path) -> None:
    words = run(installed / "hexjet", "show", cwd=tmp_path).split()
    assert set(SCENARIOS) <= set(words)
    assert set(STUDIES) <= set(words)
    assert set(ENGINES) <= set(words)


HELPS = """from cosim.cli import table
for name in table.list_names():
    print("hexjet", name, table.load(name).help().count(chr(10)))
"""


@pytest.mark.long
def test_the_installed_command_has_a_help_as_all_its_commands_have(installed: Path, tmp_path: Path) -> None:
    listed = run(installed / "hexjet", "--help", cwd=tmp_path)
    assert listed == run(installed / "hexjet", "-h", cwd=tmp_path)
    # without a word it is status 2, with the same help
    alone = subprocess.run([installed / "hexjet"], cwd=tmp_path, capture_output=True, text=True)
    assert (alone.returncode, alone.stderr) == (2, listed)
    helps = run(installed / "python", "-c", HELPS, cwd=tmp_path).splitlines()
    assert {f"hexjet {name}" for name in (*NATIVE, "paper", "sitl px4")} <= {line.rpartition(" ")[0] for line in helps}
    assert min(int(line.rpartition(" ")[2]) for line in helps) > 2


# What is added to commands of the README that fly for long, take a port that others may have, or open a browser
SHORTER = {
    "design": "--no-proof",
    "sweep": "--runs 1",
    "prove": "--claim 50%@50% --budget 5 --search 0 --no-limit",
    "gcs": "--duration 0.5 --parameters none --web 0",
    "open": "--no-browser",
}


@pytest.mark.long
def test_the_installed_command_runs_the_commands_of_the_readme(installed: Path, tmp_path: Path) -> None:
    """Each as it is written, one after the other, but that some fly less; what they come to is not asked."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    lines = re.findall(r"^\.venv/bin/hexjet ([^#\n]+)", readme, re.MULTILINE)
    names = [line.split()[0] for line in lines]
    assert {*SHORTER, "show", "fly", "engine", "aircraft", "paper"} == set(names)
    for name, line in zip(names, lines, strict=True):
        command = [installed / "hexjet", *line.split(), *SHORTER.get(name, "").split()]
        with (tmp_path / "printed").open("w+") as printed:
            running = subprocess.Popen(
                command, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.STDOUT
            )
            if name == "paper":
                # It takes minutes: by then it has begun.
                while running.poll() is None and not (tmp_path / "runs" / "paper" / "parts").exists():
                    time.sleep(0.1)
                running.send_signal(signal.SIGINT)
            status = running.wait()
            printed.seek(0)
            said = f"{line}: {printed.read()}"
        assert status in ((130,) if name == "paper" else (0, 1)), said
        assert "Traceback" not in said


@pytest.mark.long
def test_the_installed_package_is_not_the_clone(installed: Path, tmp_path: Path) -> None:
    script = "import cosim, cosim.base.storage.paths as p; print(cosim.__file__); print(p.data_folder('fmus'))"
    for line in run(installed / "python", "-c", script, cwd=tmp_path).splitlines():
        assert Path(line).resolve().is_relative_to(installed.parent.resolve())


@pytest.mark.long
@pytest.mark.skipif(UNCOMPILED, reason=f"{PURE_VARIABLE} is set")
def test_the_installed_package_flies_what_was_compiled(installed: Path, tmp_path: Path) -> None:
    file = run(installed / "python", "-c", "import cosim.base.frames as f; print(f.__file__)", cwd=tmp_path)
    assert file.rstrip().endswith((".so", ".pyd"))


@pytest.mark.long
def test_the_installed_command_flies_and_reports(installed: Path, tmp_path: Path) -> None:
    """A short flight needs all of it: scenario, aircraft, FMUs, extension and the report's template."""
    printed = run(
        installed / "hexjet", "fly", "hover", "--set", "duration_s=0.2", "--out", "flight", "--json", cwd=tmp_path
    )
    summary = json.loads(printed)
    assert (summary["outcome"], summary["steps"]) == ("completed", 50)
    left = {path.name for path in (tmp_path / "flight").iterdir()}
    assert {"summary.json", "scenario.toml", "flight.parquet", "report.html"} <= left


@pytest.mark.long
def test_an_aircraft_from_an_empty_folder_as_its_page_has_it(installed: Path, tmp_path: Path) -> None:
    """The commands of docs/own-aircraft.md, each as it is written, one after the other."""
    page = (ROOT / "docs" / "own-aircraft.md").read_text(encoding="utf-8")
    commands = page.split("```sh\n")[1].split("```")[0].splitlines()
    assert len(commands) == 10
    for command in commands:
        name, *arguments = command.split()
        run(installed / name, *arguments, cwd=tmp_path)
    assert (tmp_path / "runs" / "check-mine-001" / "aircraft.svg").is_file()
    assert list(tmp_path.glob("runs/gcs-mine-*"))


# asked for where the rest can do without: at the build, on a cluster, by one law
OPTIONAL = {
    "clarabel", "cmake", "cmaes", "distributed", "gymnasium", "nptdms", "osqp", "pandas", "plotly", "pyulog",
    "setuptools", "jax", "foxglove_schemas_protobuf", "google", "mcap", "mcap_protobuf",
}  # fmt: skip


@pytest.fixture(scope="module")
def packages() -> Any:
    """docs/packages.py."""
    return script("packages")


def test_the_package_imports_what_it_asks_for(packages: Any) -> None:
    """And asks for nothing that it never imports."""
    found = set()
    for path in (path for folder in PACKAGES.values() for path in folder.rglob("*.py")):
        if path.name == "_messages.py":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {each.name.split(".")[0] for each in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.split(".")[0])
    foreign = {name for name in found if name not in sys.stdlib_module_names and name not in PACKAGES}
    asked = packages.list_required(METADATA["dependencies"])
    assert foreign - OPTIONAL <= {name.replace("-", "_") for name in packages.list_all_required(asked)}
    # the messages that the build makes import one
    assert {name.replace("-", "_") for name in asked} <= foreign | {"fastcrc"}


def test_nothing_imports_cmake_but_what_compiles() -> None:
    """docs/versions.md: it may be uninstalled; what compiles says so then (`test_a_build_needs_a_compiler_and_cmake`)."""
    (builder,) = [
        (path, found[0])
        for folder in (ROOT / "cosim", *map(Path, import_module("fmpy").__path__))
        for path in folder.rglob("*.py")
        if (found := re.findall(r"^( *)(?:import|from) cmake\b", path.read_text(encoding="utf-8"), re.MULTILINE))
    ]
    assert builder == (
        ROOT / "cosim" / "engine" / "library" / "archives.py",
        8 * " ",
    )  # within the function that compiles


def test_a_flight_needs_nothing_but_the_core(tmp_path: Path) -> None:
    """Flown and reported, and the ground station's messages read, where everything else is out of sight."""
    hidden = ("control", "matplotlib", "distributed", "dask", "psutil", "hypothesis")
    code = f"""
import sys
sys.modules.update(dict.fromkeys({hidden!r}))
import cosim.groundstation.session, hexjet_design.design, hexjet_paper.reproduce, cosim.campaign.run
from cosim.cli.main import main
main(["fly", "hover", "--set", "duration_s=0.1", "--out", "flight"])
"""
    run(sys.executable, "-c", code, cwd=tmp_path)
    assert (tmp_path / "flight" / "report.html").is_file()
