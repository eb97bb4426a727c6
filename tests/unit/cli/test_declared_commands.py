"""Commands and their options: every one is declared, helped, completed and known by the names that it had."""

from __future__ import annotations

import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from command_tools import Hexjet
from places import ROOT, TESTS

import cosim
import cosim.api
from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.cli import main as command_line
from cosim.cli import table
from cosim.cli.declare import Command
from cosim.cli.main import describe, run
from cosim.results.export import log_path

ALL = {name: table.load(name) for name in table.list_names()}
DECLARED = {name: each for name, each in ALL.items() if isinstance(each, Command)}
POINTS = f"""[{table.ENTRY_POINT_GROUP}]
added = added_commands:greet
absent = module_that_nobody_has.command:run
broken = added_commands:nothing
number = added_commands:NUMBER
fly = added_commands:greet
identify.added = added_commands:greet
"""
SOURCE = '''from cosim.commands import Command
NUMBER = 1
def say_hello(name: str = "you", *, times: int = 1) -> list[str]:
    """Greet whoever calls.

    Parameters
    ----------
    name : str
        Who is greeted.
    times : int
        How often.
    """
    return times * [f"hello {name}"]
greet = Command("added", "added_commands:say_hello", "", data=None, runs_code=False, show=lambda lines: print(*lines))
'''


SET = "--set KEY=VALUE sets keys of the scenario: did you mean"


def test_every_command_has_a_group_and_its_line_fits_eighty_columns() -> None:
    assert len(table.DESCRIPTIONS) == sum(map(len, table.HELP_GROUPS.values()))
    assert set(table.DESCRIPTIONS) == {name.partition(" ")[0] for name in ALL} - table.HIDDEN
    listed = describe(80)
    assert max(map(len, listed.splitlines())) <= 80
    for name in table.DESCRIPTIONS:
        assert f"\n  {name} " in listed, name


@pytest.mark.parametrize(("words", "status"), [(["--help"], 0), (["-h"], 0), ([], 2)])
def test_the_help_leaves_out_what_developers_use(words: list[str], status: int, hexjet: Hexjet) -> None:
    done = hexjet(*words)
    assert done.status == status
    assert "\n  fly " in done.out + done.err
    assert "benchmark" not in done.out + done.err
    assert hexjet("--version").out.startswith("hexjet, version ")


@pytest.mark.parametrize("name", ["", *ALL, "engine", "sitl", "identify", "export"])
def test_no_line_of_a_help_is_longer_than_eighty_columns_or_speaks_sphinx(name: str) -> None:
    shown = table.load(name).help(80) if name in ALL else describe(80)
    if name in ("engine", "identify", "sitl", "export"):
        shown = command_line.describe_collection(name, 80)
    for line in shown.splitlines():
        assert len(line) <= 80
        assert ":class:" not in line
        assert "``" not in line


@pytest.mark.parametrize("name", DECLARED)
def test_every_option_has_a_text_and_the_name_that_python_has(name: str) -> None:
    command = DECLARED[name]
    names = [each for option in command.rows for each in option.names]
    assert len(names) == len(set(names))
    for option in command.rows:
        assert option.text, option.argument
        if option.names and option in command.declared:
            assert f"--{option.argument.replace('_', '-')}" in option.names
    assert f"hexjet {name} {command.example}" in command.help(80).partition("\nOutput:\n")[2]
    command.read(shlex.split(command.example.partition(" > ")[0]))
    assert bool("--trust" in names) == command.runs_code


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["fyl"], "No such command 'fyl'; did you mean 'fly'? allowed: aircraft, "),
        (["engine", "chek"], "No such command 'chek'; did you mean 'check'? allowed: check, from-bench, identify, "),
        (["fmu", "survey"], "fmu survey: the table of many engines left in version 0.3.0; use hexjet engine check"),
        (["list", "engines"], "list: an old name left in version 0.3.0; use hexjet show"),
        (["identify", "engine", "edf"], "identify engine: an old name left in version 0.3.0; use hexjet engine id"),
        (["search", "hover", "--target", "1e-6"], "--target: goes with --rare"),
        (["search", "hover", "--rare", "--worst"], "--worst: goes without --rare"),
        (["faults", "--autopilot", "--controller", "a", "--controller", "b"], "controllers: a, b; allowed: one"),
        (["--hlp"], "No such option '--hlp'"),
        (["fly", "hover", "--duration", "5"], f"No such option '--duration'; {SET} 'duration_s'?"),
        (["fly", "hover", "--mass", "5"], f"No such option '--mass'; {SET} 'vehicle.mass_kg'?"),
        (["fly", "hover", "--delay", "5"], f"No such option '--delay'; {SET} added_delay_samples (on the roll"),
        (["show", "hover", "--kind", "engine"], "--kind: 'engine': did you mean 'engines'? allowed: aircraft, "),
        (["show", "engine"], "nothing is called 'engine'; did you mean 'engines'"),
        (["show", "--page"], "page: goes with the folder of a run or a campaign"),
        (["fly", "hover", "--sed", "5"], "No such option '--sed'; did you mean '--seed'?"),
        (["fly", "hover", "--seed"], "Parameter --seed requires an argument."),
        (["fly", "hover", "gust"], "gust: one argument too many"),
        (["engine", "check", "edf", "--step", "0"], "--step: 0; allowed: above 0"),
        (["compare", "a", "b", "--shift", "B"], "--shift B: must be LETTER=SECONDS"),
        (["open", "--port", "1"], "--port: the server of hexjet open left in version 0.3.0"),
        (["--install-completion", "tcsh"], "--install-completion: 'tcsh': "),
    ],
)
def test_a_wrong_word_is_answered_with_the_nearest(words: list[str], line: str, hexjet: Hexjet) -> None:
    done = hexjet(*words)
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith(f"hexjet: {line}")


@pytest.mark.parametrize(
    ("command", "before", "now", "value"),
    [
        ("compare a b", "--shift=B=2", "--shift", "B=2"),
        ("sweep a", "--design", "--sampling", "grid"),
        ("sweep a", "--settings", "--set", "a=1"),
        ("sweep a", "--keys", "--keys", "*"),
        ("fly a", "--realtime-factor", "--rtf", "2"),
        ("engine check a", "--step-s", "--step", "0.004"),
    ],
)
def test_an_option_is_known_by_the_names_that_it_had(command: str, before: str, now: str, value: str) -> None:
    name, words = table.find(command.split())
    is_whole = "=" in before or before == now
    first = DECLARED[name].read([*words, before, *([] if is_whole else [value])])
    assert first == DECLARED[name].read([*words, now, value])
    assert len(first) == 2
    assert before == now or f"{before} " not in DECLARED[name].help(80)


def complete(capsys: pytest.CaptureFixture[str], *words: str) -> list[str]:
    """The words that a shell is told."""
    with pytest.raises(SystemExit):
        run(["__complete", *words])
    return [line.partition("\t")[0] for line in capsys.readouterr().out.splitlines()]


def test_names_are_completed(capsys: pytest.CaptureFixture[str]) -> None:
    assert "roll-doublet" in complete(capsys, "fly", "roll-d")
    assert "turbojet" in complete(capsys, "fly", "hover", "--engine", "turboj")
    assert "2=turbojet" in complete(capsys, "fly", "hover", "--engine", "2=turboj")
    assert complete(capsys, "fly", "hover", "--aircraft", "octo")[-1] == "octojet"
    assert "smith" in complete(capsys, "fly", "hover", "--controller", "smi")
    assert "mass-and-delay-map" not in complete(capsys, "fly", "zzz")


def test_completion_is_installed_by_one_option(tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_DATA_HOME", raising=False)
    assert run(["--install-completion", "bash"]) == 0
    path = Path(capsys.readouterr().out.partition(": ")[0])
    assert path.is_relative_to(tmp_path)
    assert "--sampling" in path.read_text()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["fly", "x.fmu"], "x.fmu: not UTF-8 text (byte 4); a TOML file is needed"),
        (["sweep", "m.toml"], "m.toml: is not a scenario, which has the key duration_s"),
        (["prove", "vehicle.toml"], "vehicle.toml: is not a scenario, which has the key duration_s"),
        (["fly", "hover", "--model", "m.toml"], "m.toml: is not a file of identified models, which has the key identi"),
        (["engine", "check", "vehicle.toml"], "vehicle.toml: is not the mapping file of an engine, which has the key"),
        (["replay", "m.toml"], "m.toml: is TOML, and no log; allowed: "),
        (["aircraft", "check", "./below"], "below/vehicle.toml: is not an aircraft, which has the key jets or scaled"),
        (["aircraft", "new", "y", "--from", "quadjt"], "base: 'quadjt': must be one that is shipped; did you mean '"),
    ],
)
def test_a_file_of_another_kind_is_told_what_was_expected(
    words: list[str], line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for path in (Path("m.toml"), Path("below/vehicle.toml")):
        path.parent.mkdir(exist_ok=True)
        path.write_text('fmu = "x.fmu"\n')
    Path("x.fmu").write_bytes(b"PK\x03\x04\xff")
    Path("vehicle.toml").write_text((data_folder("aircraft") / "hexjet" / "vehicle.toml").read_text())
    with pytest.raises(InputError) as error:
        run(words)
    assert str(error.value).removeprefix(f"{tmp_path}/").startswith(line)


@pytest.mark.parametrize("name", [name for name, each in DECLARED.items() if "out" in each.all_parameters])
def test_every_out_refuses_the_ending_of_a_file_that_it_does_not_write(name: str, tmp_path: Path) -> None:
    command = DECLARED[name]
    (tmp_path / "old.png").mkdir()  # a folder that is there stays one
    for allowed in ("v1.2", "old.png", *(f"x{ending}" for ending in command.writes)):
        command.check_out(str(tmp_path / allowed))
    with pytest.raises(InputError, match=r"--out .*x\.png: names a file by its ending"):
        command.check_out(str(tmp_path / "x.png"))


def test_an_exported_log_goes_into_a_folder_or_is_the_file(tmp_path: Path) -> None:
    assert log_path("csv", tmp_path) == tmp_path / "flight.csv"
    assert log_path("ulog", tmp_path / "a.ulg") == tmp_path / "a.ulg"
    with pytest.raises(InputError, match=r"out: .*a\.csv: mcap writes \.mcap"):
        log_path("mcap", tmp_path / "a.csv")


def test_a_comparison_is_the_file_that_is_named(tmp_path: Path) -> None:
    flown, page = str(sorted((TESTS / "older").iterdir())[0] / "run"), tmp_path / "new" / "cmp.html"
    assert run(["compare", flown, flown, "--out", str(page)]) == 0
    assert page.is_file()


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Install a package with commands of its own."""
    (tmp_path / "added_commands.py").write_text(SOURCE)
    folder = tmp_path / "added_commands-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: added-commands\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text(POINTS)
    monkeypatch.syspath_prepend(tmp_path)
    table.added.cache_clear()
    yield
    table.added.cache_clear()


@pytest.mark.usefixtures("package")
def test_it_is_listed_and_runs(hexjet: Hexjet) -> None:
    listed = hexjet("--help")
    names = [line.split()[0] for line in listed.out.splitlines() if line.startswith("  ") and line.strip()]
    assert "Greet whoever calls." in listed.out
    assert listed.err == "hexjet: note: fly of added-commands is not reached: hexjet has that command\n"
    assert "absent" not in names  # what is not installed, and nothing else
    assert {"added", "broken", "number"} <= set(names)
    assert hexjet("added") == (0, "hello you\n", "")
    assert hexjet("added", "me", "--times", "2") == (0, "hello me hello me\n", "")
    assert "Greet whoever calls." in hexjet("identify", "--help").out
    assert hexjet("identify", "added") == (0, "hello you\n", "")
    assert "SCENARIO" in hexjet("fly", "--help").out


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("absent", "needs 'module_that_nobody_has', which is not installed; the sources of added-commands have it"),
        ("broken", "added_commands:nothing of added-commands cannot be loaded: AttributeError: "),
        ("number", "added_commands:NUMBER of added-commands is no cosim.commands.Command"),
    ],
)
def test_one_that_cannot_be_loaded_says_so(name: str, reason: str) -> None:
    with pytest.raises(InputError) as error:
        run([name, "--full", "more"])
    assert str(error.value).startswith(f"{name}: {reason}")


@pytest.mark.usefixtures("package")
def test_two_packages_with_one_name_are_refused_by_their_names(tmp_path: Path) -> None:
    other = tmp_path / "other_commands-2.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: other-commands\nVersion: 2.0\n")
    (other / "entry_points.txt").write_text(f"[{table.ENTRY_POINT_GROUP}]\nadded = added_commands:greet\n")
    with pytest.raises(InputError) as error:
        run(["added"])
    packages = str(error.value).removeprefix("added: ").removesuffix(" both add it; uninstall all but one")
    assert sorted(packages.split(" and ")) == ["added-commands", "other-commands"]


def test_a_help_imports_nothing_for_other_commands() -> None:
    script = """import sys
from cosim.cli.main import run
def call(*words):
    run(list(words))
    return sorted(name for name in sys.modules if name.partition(".")[0] in ("hexjet_paper", "cyclopts", "rich"))
assert call("--help") == [], call("--help")
assert call("fly", "--help") == [], call("fly", "--help")
run(["show", "engines"])
def tools():
    return {name.partition(".")[0] for name in sys.modules if name.startswith("hexjet_")}
assert not tools()
for name in ("design", "prove", "identify log", "export vehicle"):
    before = tools()
    call(*name.split(), "--help")
    assert tools() - before == {f"hexjet_{name.partition(' ')[0]}"}, (name, tools())
"""
    subprocess.run([sys.executable, "-P", "-c", script], check=True, stdout=subprocess.DEVNULL)


def test_names_that_tools_add_are_those_that_are_typed() -> None:
    entries = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    own = {
        name
        for name in cosim.__all__
        if name not in {*cosim._LAZY_MODULES, *cosim._CALLABLE_PACKAGES, "EngineError", "FlightError", "InputError"}
    }
    own |= {name for name in cosim.api.__all__ if name not in cosim.api._LAZY_MODULES}
    assert own == {name for name in entries["hexjet.api"] if "." not in name}
    for name in own:
        assert getattr(cosim if name in cosim.__all__ else cosim.api, name).__module__.startswith("hexjet_")
