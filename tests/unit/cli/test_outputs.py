"""``--out`` names a file or a folder as its ending says, in every command."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from cosim import InputError, fly
from cosim.cli.main import cli
from cosim.cli.outputs import Out
from cosim.results.export import log_path


def commands(command: click.Command, names: tuple[str, ...], context: click.Context) -> Iterator[tuple[str, Out]]:
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from commands(below, (*names, name), context)
    for parameter in command.params:
        if "--out" in parameter.opts:
            yield " ".join(names), parameter.type


OUTS = dict(commands(cli, (), click.Context(cli)))


@pytest.mark.unit
@pytest.mark.parametrize("name", sorted(set(OUTS) - {"design"}))
def test_every_out_refuses_the_ending_of_a_file_that_it_does_not_write(name: str, tmp_path: Path) -> None:
    kind = OUTS[name]
    assert isinstance(kind, Out)
    assert kind.convert(str(tmp_path / "v1.2"), None, None) == tmp_path / "v1.2"
    with pytest.raises(InputError, match=r"--out .*x\.png: names a file by its ending"):
        kind.convert(str(tmp_path / "x.png"), None, None)
    held = tmp_path / "old.png"
    held.mkdir()
    assert kind.convert(str(held), None, None) == held  # a folder that is there stays one
    for ending in kind.endings:
        assert kind.is_file(kind.convert(str(tmp_path / f"x{ending}"), None, None))


@pytest.mark.unit
def test_a_comparison_is_the_file_that_is_named(tmp_path: Path) -> None:
    from cosim import Scenario

    flown = fly(Scenario.load("hover", ["duration_s=0.1"]), tmp_path / "run", report=False).folder
    page = tmp_path / "new" / "cmp.html"
    assert cli.main(["compare", str(flown), str(flown), "--out", str(page)], standalone_mode=False) == 0
    assert page.is_file()


@pytest.mark.unit
def test_an_exported_log_goes_into_a_folder_or_is_the_file(tmp_path: Path) -> None:
    assert log_path("csv", tmp_path) == tmp_path / "flight.csv"
    assert log_path("ulog", tmp_path / "a.ulg") == tmp_path / "a.ulg"
    with pytest.raises(InputError, match=r"--out .*a\.csv: --to mcap writes \.mcap"):
        log_path("mcap", tmp_path / "a.csv")
