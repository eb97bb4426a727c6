"""Commands of other packages, by the entry points ``hexjet.commands``."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner
from places import ROOT

import cosim
import cosim.api
from cosim.base.errors import InputError
from cosim.cli.added import ADDED
from cosim.cli.main import cli

POINTS = f"""[{ADDED}]
added = added_commands:greet
absent = module_that_nobody_has.command:run
broken = added_commands:nothing
number = added_commands:NUMBER
fly = added_commands:greet
identify.added = added_commands:greet
"""
SOURCE = """import click
NUMBER = 1
@click.command()
def greet():
    "Greet whoever calls."
    click.echo("hello")
"""


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install a package with commands of its own."""
    (tmp_path / "added_commands.py").write_text(SOURCE)
    folder = tmp_path / "added_commands-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: added-commands\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text(POINTS)
    monkeypatch.syspath_prepend(tmp_path)


def test_it_is_listed_and_runs() -> None:
    listed = CliRunner().invoke(cli, ["--help"])
    assert listed.exit_code == 0
    assert "Greet whoever calls." in listed.output
    done = CliRunner().invoke(cli, ["added"])
    assert (done.exit_code, done.output) == (0, "hello\n")
    listed = CliRunner().invoke(cli, ["identify", "--help"])
    assert "Greet whoever calls." in listed.output
    done = CliRunner().invoke(cli, ["identify", "added"])
    assert (done.exit_code, done.output) == (0, "hello\n")


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("absent", "needs 'module_that_nobody_has', which is not installed; the sources of added-commands have it"),
        ("broken", "added_commands:nothing of added-commands cannot be loaded: AttributeError: "),
        ("number", "added_commands:NUMBER of added-commands is no command of click"),
    ],
)
def test_one_that_cannot_be_loaded_says_so(name: str, reason: str) -> None:
    with pytest.raises(InputError) as error:
        cli.main([name, "--full", "more"], standalone_mode=False)
    assert str(error.value).startswith(f"{name}: {reason}")
    assert "\n" not in str(error.value)


def test_the_help_leaves_out_what_is_not_installed_and_nothing_else() -> None:
    listed = CliRunner().invoke(cli, ["--help"]).output
    names = [line.split()[0] for line in listed.splitlines() if line.startswith("  ") and line.strip()]
    assert "absent" not in names
    assert {"added", "broken", "number"} <= set(names)


def test_two_packages_with_one_name_are_refused_by_their_names(tmp_path: Path) -> None:
    other = tmp_path / "other_commands-2.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: other-commands\nVersion: 2.0\n")
    (other / "entry_points.txt").write_text(f"[{ADDED}]\nadded = added_commands:greet\n")
    with pytest.raises(InputError) as error:
        cli.main(["added"], standalone_mode=False)
    packages = str(error.value).removeprefix("added: ").removesuffix(" both add it; uninstall all but one")
    assert sorted(packages.split(" and ")) == ["added-commands", "other-commands"]


def test_none_takes_the_place_of_ours() -> None:
    assert "SCENARIO" in CliRunner().invoke(cli, ["fly", "--help"]).output


def test_the_paper_is_imported_for_its_own_command_alone() -> None:
    script = """import sys
from cosim.cli.main import cli
def call(*words):
    cli.main(words, standalone_mode=False)
    return sorted(name for name in sys.modules if name.partition(".")[0] == "hexjet_paper")
assert call("list", "engines") == []
assert call("--help") == [], call("--help")
assert call("paper", "--help") == ["hexjet_paper", "hexjet_paper.command"], call("paper", "--help")
"""
    subprocess.run([sys.executable, "-P", "-c", script], check=True, stdout=subprocess.DEVNULL)


def test_a_name_that_is_taken_is_said_once() -> None:
    said = "hexjet: note: fly of added-commands is not reached: hexjet has that command\n"
    assert CliRunner().invoke(cli, ["--help"]).stderr == said


@pytest.mark.parametrize("at_a_terminal", [True, False])
def test_it_is_said_where_it_is_used_at_a_terminal(at_a_terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    with CliRunner().isolation() as (_, err, _):
        monkeypatch.setattr(sys.stderr, "isatty", lambda: at_a_terminal)
        cli.main(["fly", "--help"], standalone_mode=False)
        sys.stderr.flush()
        assert (b"fly of added-commands is not reached" in err.getvalue()) == at_a_terminal


def test_names_that_tools_add_are_those_that_are_typed() -> None:
    entries = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    own = {
        name
        for name in cosim.__all__
        if name not in {*cosim._WHERE, *cosim._ROOMS, "EngineError", "FlightError", "InputError"}
    }
    own |= {name for name in cosim.api.__all__ if name not in cosim.api._WHERE}
    assert own == {name for name in entries["hexjet.api"] if "." not in name}
    for name in own:
        assert getattr(cosim if name in cosim.__all__ else cosim.api, name).__module__.startswith("hexjet_")
