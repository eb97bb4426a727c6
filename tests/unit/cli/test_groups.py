"""``hexjet --help`` in groups, and nearest names."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.cli.groups import GROUPS
from cosim.cli.main import cli, main


def test_every_command_has_a_group_and_its_line_fits_eighty_columns() -> None:
    names = [name for commands in GROUPS.values() for name in commands]
    assert len(names) == len(set(names))
    assert set(names) == set(cli.list_commands(click.Context(cli)))
    listed = CliRunner(env={"COLUMNS": "80"}).invoke(cli, ["--help"]).output
    assert "..." not in listed.partition("Fly:")[2]
    assert max(map(len, listed.splitlines())) <= 80
    for name in names:
        assert f"\n  {name} " in listed, name


@pytest.mark.parametrize(("words", "status"), [(["--help"], 0), (["-h"], 0), ([], 2)])
def test_the_help_stands_where_a_group_has_no_command(
    words: list[str], status: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wheel has no benchmarks, and so no command in the last group."""
    monkeypatch.setitem(sys.modules, "benchmarks", None)
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == status
    listed = "".join(capsys.readouterr())
    assert "\n  fly " in listed
    assert "Develop" not in listed


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["fyl"], "No such command 'fyl'; did you mean 'fly'? allowed: aircraft, "),
        (
            ["fly", "hover", "--duration", "5"],
            "No such option '--duration'; it is a key of the scenario: --set duration_s=...",
        ),
        (
            ["fly", "hover", "--mass", "5"],
            "No such option '--mass'; it is a key of the scenario: --set vehicle.mass_kg=...",
        ),
        (["show", "hover", "--kind", "engine"], "'--kind': 'engine': did you mean 'engines'? allowed: aircraft, "),
        (["list", "engine"], "'[KIND]': 'engine': did you mean 'engines'? allowed: aircraft, "),
        (["fly", "hover", "--sed", "5"], "No such option '--sed'. (Did you mean one of: '--seed', "),
    ],
)
def test_a_wrong_name_says_the_nearest(words: list[str], line: str, capsys: pytest.CaptureFixture[Any]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert line in capsys.readouterr().err


def test_names_are_completed() -> None:
    from click.shell_completion import ShellComplete

    def completed(*words: str, of: str) -> list[str]:
        return [
            item.value for item in ShellComplete(cli, {}, "hexjet", "_HEXJET_COMPLETE").get_completions([*words], of)
        ]

    assert "roll-doublet" in completed("fly", of="roll-d")
    assert "turbojet" in completed("fly", "hover", "--engine", of="turboj")
    assert completed("fly", "hover", "--aircraft", of="octo")[-1] == "octojet"
    assert "smith" in completed("fly", "hover", "--controller", of="smi")
    assert "mass-and-delay-map" not in completed("fly", of="zzz")


def test_completion_is_installed_by_one_option(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_DATA_HOME", raising=False)
    done = CliRunner().invoke(cli, ["--install-completion", "bash"])
    path = tmp_path / ".local/share/bash-completion/completions/hexjet"
    assert done.exit_code == 0
    assert str(path) in done.output
    assert "_HEXJET_COMPLETE=bash_complete" in path.read_text()
    assert isinstance(cli, click.Group)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["fly", "x.fmu"], "x.fmu: not UTF-8 text (byte 4); a TOML file is needed"),
        (["sweep", "m.toml"], "m.toml: is not a scenario, which has the key duration_s"),
        (["prove", "vehicle.toml"], "vehicle.toml: is not a scenario, which has the key duration_s"),
        (["fly", "hover", "--model", "m.toml"], "m.toml: is not a file of identified models, which has the key identi"),
        (["fmu", "check", "vehicle.toml"], "vehicle.toml: is not the mapping file of an engine, which has the key fmu"),
        (["replay", "m.toml"], "m.toml: is TOML, and no log; allowed: "),
        (["aircraft", "check", "./below"], "below/vehicle.toml: is not an aircraft, which has the key jets or scaled"),
        (
            ["aircraft", "new", "y", "--from", "quadjt"],
            "base (--from) quadjt: must be one that is shipped; did you mean '",
        ),
    ],
)
def test_a_file_of_another_kind_is_answered_with_what_was_expected(
    words: list[str], line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for path in (Path("m.toml"), Path("below/vehicle.toml")):
        path.parent.mkdir(exist_ok=True)
        path.write_text('fmu = "x.fmu"\n')
    Path("x.fmu").write_bytes(b"PK\x03\x04\xff")
    Path("vehicle.toml").write_text((data_folder("aircraft") / "hexjet" / "vehicle.toml").read_text())
    with pytest.raises(InputError) as error:
        cli.main(words, standalone_mode=False)
    assert str(error.value).removeprefix(f"{tmp_path}/").startswith(line)


def leaves(command: click.Command, name: str) -> list[tuple[str, click.Command]]:
    """A command and those below it."""
    context = click.Context(command)
    inner = command.list_commands(context) if isinstance(command, click.Group) else ()
    below = [(each, command.get_command(context, each) or cli) for each in inner]
    return [(name, command), *(each for inner, found in below for each in leaves(found, f"{name} {inner}"))]


ALL = leaves(cli, "hexjet")


def test_no_line_of_a_help_is_cut_or_longer_than_eighty_columns() -> None:
    for name, command in ALL:
        context = click.Context(command, info_name=name, terminal_width=80)
        for line in command.get_help(context).splitlines():
            assert len(line) <= 80, name
            assert not line.endswith("...") or line.startswith("Usage: "), name


@pytest.mark.parametrize(
    ("command", "before", "now", "value"),
    [
        ("identify bench", "--range", "--throttle-range", "1000 2000"),
        ("identify log", "--from", "--begin", "3"),
        ("replay", "--to", "--end", "3"),
        ("sitl px4", "--timeout", "--time-limit", "3"),
        ("gcs", "--params", "--parameters", "none"),
        ("sweep", "--design", "--sampling", "grid"),
        ("export vehicle", "--as", "--to", "ssp"),
        ("failsafes", "--wind", "--wind-speed", "5"),
    ],
)
def test_an_option_is_known_by_the_name_that_it_had(command: str, before: str, now: str, value: str) -> None:
    found = dict(ALL)[f"hexjet {command}"]
    words = [] if command in ("gcs", "failsafes", "export vehicle", "sitl px4") else ["a"]
    parsed = [found.make_context("x", [*words, name, *value.split()]).params for name in (before, now)]
    assert parsed[0] == parsed[1]
    assert before not in " ".join(option for each in found.params for option in each.opts).split()
