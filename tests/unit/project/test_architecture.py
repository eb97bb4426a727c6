"""The rules that make the architecture, read from the imports."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from places import ROOT, TESTS

from cosim.base.compiled import MODULES

PACKAGE = ROOT / "cosim"
TOOLS = ROOT / "tools"
BENCHMARKS = ROOT / "benchmarks"

# A file above this many lines is divided by meaning, except those here.
MOST_LINES = 500
LONGER = {
    # one class: an airframe's properties in JSBSim are set and read together, in the order of a control step
    "vehicle/airframe.py"
}

# A foreign library has one home: a module, or a folder with one duty.
HOMES = {
    "jsbsim": ["vehicle/executive.py"],
    "fmpy": ["engine/"],
    "cmaes": ["tools/hexjet_prove/search/minimise.py"],
    "osqp": ["tools/hexjet_laws/mpc.py"],
    "pymavlink": ["groundstation/mavlink/"],
    "plotly": ["results/report/page.py"],
    "pyarrow": ["results/log/arrow.py"],
    "websockets": ["groundstation/web/", "shelf/server.py"],
    "distributed": ["campaign/workers/cluster.py"],
    "gymnasium": ["tools/hexjet_gym/"],
    "pandas": ["results/log/tables.py"],
    "pyulog": ["tools/hexjet_identify/logs/ulog.py"],
    "nptdms": ["tools/hexjet_identify/logs/tdms.py"],
    "jax": ["tools/hexjet_batch/with_jax.py"],
    "mcap": ["tools/hexjet_identify/logs/table_columns.py", "tools/hexjet_export/logs/mcap_file.py"],
    "mcap_protobuf": ["tools/hexjet_export/logs/mcap_file.py", "tools/hexjet_export/logs/scene.py"],
    "foxglove_schemas_protobuf": ["tools/hexjet_export/logs/mcap_file.py", "tools/hexjet_export/logs/scene.py"],
}

# Blocks get values and return values: no files, clocks, environment or global randomness.
BLOCKS = [
    "control/", "engine/wrappers.py", "vehicle/propulsion.py", "vehicle/sensors.py", "vehicle/servo.py", "simulation/ending.py", "base/frames.py",
    "base/signals.py", "base/protocols/",
]  # fmt: skip
OUTSIDE_WORLD = {
    "builtins", "ctypes", "datetime", "fileinput", "glob", "importlib", "io", "logging", "os", "pathlib", "random",
    "secrets", "shutil", "socket", "subprocess", "sys", "tempfile", "threading", "time", "tomllib", "uuid",
}  # fmt: skip
READS_THE_OUTSIDE_WORLD = {"open", "print", "input", "exec", "eval", "__import__"}
OUR_FILE_READERS = {
    "cosim.base.storage.toml", "cosim.base.storage.paths", "cosim.cli.main", "cosim.results.report.flight",
    "cosim.results.report.page", "cosim.results.log.recorder", "cosim.simulation.step", "cosim.simulation.build",
    "cosim.results.log.arrow", "cosim.base.storage.files",
}  # fmt: skip

# What somebody else may have made is read by read_file, read_text and read_json of base/storage/files.py: regular files
# of a limited size.  These read what the package or a process of its own has made.
READS_BY_ITSELF = [
    "base/", "engine/", "campaign/installed.py",
    "groundstation/mavlink/wire/generate.py", "groundstation/web/server.py", "tools/hexjet_identify/engine_file.py", "tools/hexjet_identify/logs/",
    "results/report/page.py", "shelf/server.py", "simulation/controllers/process.py", "spec/new_aircraft.py",
    "spec/new_project.py", "spec/vehicle/sensor_profile.py", "tools/hexjet_sitl/",
]  # fmt: skip

# An engine is a file before it flies and none while it flies: loading reads, stepping does not.
ENGINE_STEPS = ["engine/bank.py", "engine/response.py", "engine/fmu/instance.py", "engine/spec.py"]
CLOCKS_AND_CHANCE = {"datetime", "random", "secrets", "time", "uuid"}
C_FILES_CLOCKS_AND_CHANCE = (
    r"\b(f?open|fread|fwrite|getenv|s?rand|random|time|clock|clock_gettime|s?printf|puts|system)\s*\("
)

# What a user would wait for, although a flight does not need it before its first step.
# Where options may stand in texts beside declared commands: for programs of others, and where a call's words are read.
HAS_OPTIONS = [
    "base/removed.py", "base/trust.py", "campaign/workers/cluster.py", "cli/", "tools/hexjet_export/command.py",
    "tools/hexjet_export/controller/measure.py", "tools/hexjet_identify/commands/", "tools/hexjet_prove/command/",
    "tools/hexjet_sitl/ardupilot.py", "tools/hexjet_sitl/command.py", "tools/hexjet_sitl/firmware_parameters.py",
    "tools/hexjet_sitl/prepare.py",
]  # fmt: skip
HEAVY = [
    "scipy", "plotly", "pyarrow", "jinja2", "matplotlib", "control", "pymavlink", "pyulog", "hypothesis", "fmpy",
    "websockets", "distributed", "gymnasium", "pandas", "mcap", "foxglove_schemas_protobuf",
]  # fmt: skip


def modules() -> list[Path]:
    """Every module of what is installed, as it is in the clone."""
    ours = (path for path in PACKAGE.rglob("*.py") if "data" not in path.relative_to(PACKAGE).parts)
    return sorted([*ours, *TOOLS.rglob("*.py")])


def place(path: Path) -> str:
    return path.relative_to(ROOT).as_posix().removeprefix("cosim/")


def is_in(path: Path, places: list[str]) -> bool:
    return any(place(path) == each or (each.endswith("/") and place(path).startswith(each)) for each in places)


@cache
def nodes(path: Path) -> list[ast.AST]:
    """Everything in a module's text."""
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


@cache
def imported(path: Path) -> list[tuple[str, int]]:
    """The full dotted names that a module imports anywhere in its text, and the lines."""
    return list(_imports(path))


def _imports(path: Path) -> Iterator[tuple[str, int]]:
    package = path.relative_to(ROOT).parent.parts
    for node in nodes(path):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            start = ".".join([*above, *([node.module] if node.module else [])])
            yield from ((f"{start}.{alias.name}", node.lineno) for alias in node.names)


def importers(*wanted: str) -> list[str]:
    """Where any of these modules, or anything inside them, is imported: ``place:line name``."""
    return [
        f"{place(path)}:{line} {name}"
        for path in modules()
        for name, line in imported(path)
        if any(name == each or name.startswith(f"{each}.") for each in wanted)
    ]


def test_the_package_is_found() -> None:
    """The rules below say nothing if there is nothing to read."""
    assert {"vehicle/airframe.py", "simulation/step.py", "cli/main.py", "control/rate.py"} <= {
        place(path) for path in modules()
    }


def test_a_folder_holds_some_twelve_files() -> None:
    """A room that grows past that is divided by duty."""
    made = {"__init__.py", "_messages.py"}  # what hands names on, what the build makes
    counted = Counter(path.parent for path in modules() if path.name not in made)
    assert counted
    assert not {str(folder): number for folder, number in counted.items() if number > 14}


def test_laws_and_effects_are_compiled() -> None:
    """What is not runs slower than the others, and nothing else tells."""
    found = {
        place(path)
        for path in modules()
        if path.parent in (PACKAGE / "control" / "phases", PACKAGE / "vehicle" / "effects")
        for node in nodes(path)
        if isinstance(node, ast.ClassDef) and {"FlightLaw", "Effect"} & {ast.unparse(base) for base in node.bases}
    }
    assert {"control/phases/wing.py", "vehicle/effects/banks.py"} <= found <= set(MODULES)


def test_a_file_has_at_most_500_lines() -> None:
    """Files that the build makes are not counted; an exception that is no longer needed goes."""
    counted = {
        place(path): len(path.read_text(encoding="utf-8").splitlines())
        for path in [*modules(), *BENCHMARKS.rglob("*.py")]
        if path.name != "_messages.py"
    }
    assert {name for name, lines in counted.items() if lines > MOST_LINES} == LONGER


@pytest.mark.parametrize("block", BLOCKS)
def test_every_block_exists(block: str) -> None:
    assert any(is_in(path, [block]) for path in modules())


@pytest.mark.parametrize(("library", "home"), HOMES.items())
def test_a_foreign_library_has_one_home(library: str, home: list[str]) -> None:
    strangers = [where for where in importers(library) if not is_in(PACKAGE / where.split(":")[0], home)]
    assert not strangers


def test_blocks_import_nothing_of_the_outside_world() -> None:
    blocks = [path for path in modules() if is_in(path, BLOCKS)]
    found = [
        f"{place(path)}:{line} {name}"
        for path in blocks
        for name, line in imported(path)
        if name.split(".")[0] in OUTSIDE_WORLD or any(f"{name}.".startswith(f"{each}.") for each in OUR_FILE_READERS)
    ]
    assert not found


def test_files_of_others_are_read_by_one_reader() -> None:
    found = [
        f"{place(path)}:{node.lineno} {node.attr}"
        for path in modules()
        if path.is_relative_to(PACKAGE) and not is_in(path, READS_BY_ITSELF)
        for node in nodes(path)
        if (isinstance(node, ast.Attribute) and node.attr in ("read_bytes", "read_text"))
        or (isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and (node.value.id, node.attr) == ("json", "loads"))
    ]  # fmt: skip
    assert not found


def test_blocks_call_nothing_that_reads_or_writes_the_outside_world() -> None:
    found = [
        f"{place(path)}:{node.lineno} {node.func.id}"
        for path in modules()
        if is_in(path, BLOCKS)
        for node in nodes(path)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in READS_THE_OUTSIDE_WORLD
    ]
    assert not found


def test_blocks_have_no_global_state() -> None:
    """No ``global``, and no use of numpy's or the standard library's shared random generator."""
    found = []
    for path in modules():
        if not is_in(path, BLOCKS):
            continue
        for node in nodes(path):
            if isinstance(node, ast.Global):
                found.append(f"{place(path)}:{node.lineno} global {', '.join(node.names)}")
            shared = isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("np.random", "numpy.random")
            if shared and node.attr not in ("Generator", "default_rng", "PCG64", "SeedSequence"):
                found.append(f"{place(path)}:{node.lineno} {ast.unparse(node)}")
    assert not found


@pytest.mark.parametrize("module", ENGINE_STEPS)
def test_engines_know_no_clock_and_no_chance(module: str) -> None:
    assert not [name for name, _ in imported(PACKAGE / module) if name.split(".")[0] in CLOCKS_AND_CHANCE]


def test_stepping_the_engines_reads_no_file() -> None:
    """Neither ``EngineBank.step`` nor the C loop behind it."""
    tree = ast.parse((PACKAGE / "engine" / "bank.py").read_text(encoding="utf-8"))
    (bank,) = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "EngineBank")
    (step,) = (node for node in bank.body if isinstance(node, ast.FunctionDef) and node.name == "step")
    names = {node.id for node in ast.walk(step) if isinstance(node, ast.Name)}
    assert not names & {"Path", "TemporaryDirectory", "open", "unpack", "os"}
    loop = (PACKAGE / "engine" / "_bank.c").read_text(encoding="utf-8")
    assert not re.findall(C_FILES_CLOCKS_AND_CHANCE, loop)


def test_nothing_imports_the_command_line() -> None:
    entry_points = ["__main__.py", "cli/"]
    assert not [
        where for where in importers("cosim.cli.main") if not is_in(PACKAGE / where.split(":")[0], entry_points)
    ]


def test_texts_name_arguments_and_no_options() -> None:
    """An option stands in a whole command, ``hexjet ...``, or in a piece of one, which begins with a blank."""
    found = []
    for path in modules():
        parts = {id(part) for node in nodes(path) if isinstance(node, ast.JoinedStr) for part in node.values}
        commands = [each for each in nodes(path) if isinstance(each, ast.Call) and ast.unparse(each.func) == "Command"]
        parts |= {id(part) for command in commands for part in ast.walk(command)}
        for node in [] if is_in(path, HAS_OPTIONS) else nodes(path):
            if isinstance(node, ast.JoinedStr) and id(node) not in parts:
                text = "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts:
                text = node.value
            else:
                continue
            option = re.search(r"(?<![\w-])--[a-z{]", text)
            if option and not re.search(r"hexjet |fgfs |^ $", text[: option.start()]):
                found.append(f"{place(path)}:{node.lineno} {text}")
    assert not found


def test_the_simulation_knows_no_output() -> None:
    """It calls observers; which ones there are is the business of whoever starts a flight."""
    outputs = importers(
        "cosim.results.report.flight",
        "cosim.results.report.page",
        "cosim.results.log.recorder",
        "cosim.results.log.arrow",
        "cosim.results.log.digest",
        "cosim.results.metrics",
        "cosim.cli.main",
        "cosim.groundstation.mavlink",
    )
    assert outputs
    assert not [where for where in outputs if where.startswith("simulation/")]


def test_the_protocols_know_the_records_and_nothing_above() -> None:
    files = [path for path in modules() if place(path).startswith("base/protocols/")]
    ours = {name.rpartition(".")[0] for path in files for name, _ in imported(path) if name.startswith("cosim")}
    assert ours - {name for name in ours if name.startswith("cosim.base.protocols")} == {"cosim.base.signals"}


def test_the_product_imports_no_test_tools() -> None:
    assert not importers("hypothesis", "pytest", "psutil", "matplotlib", "playwright")


def test_python_control_is_the_second_opinion_of_tests() -> None:
    """Nothing of the package computes with what its tests check it by."""
    assert not importers("control")


@pytest.mark.parametrize("module", ["cosim", "cosim.cli.main", "cosim.stepper"])
def test_an_import_stays_light(module: str) -> None:
    """Heavy libraries come in where they are needed, so that the command answers at once."""
    script = f"import sys, {module}; print(*sys.modules.keys() & {HEAVY!r})"
    answer = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    assert answer.stdout.split() == []


@pytest.mark.parametrize("script", ["from cosim import fly", "from cosim.cli.main import run; run(['--help'])"])
def test_what_only_names_a_flight_loads_no_model(script: str) -> None:
    """A name, or the list of commands, is there before pydantic and numpy would be."""
    seen = f"import sys; {script}; print(*sys.modules.keys() & {{'numpy', 'pydantic'}}, file=sys.stderr)"
    answer = subprocess.run([sys.executable, "-c", seen], capture_output=True, text=True, check=True, cwd=ROOT)
    assert answer.stderr.split() == []


def test_the_library_leaves_the_garbage_collector_alone() -> None:
    """Whoever imports the package has settings of his own; the command's process is the command's."""
    calls = [
        place(path)
        for path in modules()
        for node in nodes(path)
        if isinstance(node, ast.Attribute) and node.attr in ("set_threshold", "disable", "freeze")
        and isinstance(node.value, ast.Name) and node.value.id == "gc"
    ]  # fmt: skip
    assert set(calls) == {"campaign/workers/local.py", "cli/start.py", "groundstation/session.py"}


def test_a_test_has_a_folder_by_what_it_needs() -> None:
    """No test file beside the folders, no two of one name, and none that takes from another: what is shared is a tool."""
    paths = sorted(TESTS.rglob("test_*.py"))
    kinds = {"unit", "flight", "process", "clients"}
    assert all(kinds & set(path.relative_to(TESTS).parts[:2]) for path in paths)
    assert len({path.name for path in paths}) == len(paths)
    taken = re.compile(r"^\s*(?:from|import) test_", re.MULTILINE)
    # a script that a test starts imports the test that it belongs to
    assert [path.name for path in paths if taken.search(path.read_text(encoding="utf-8"))] == ["test_reproduce.py"]
