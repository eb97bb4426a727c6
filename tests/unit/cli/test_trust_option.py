"""The option --trust is at every command that may run the user's code, and at none that does not."""

from __future__ import annotations

from collections.abc import Iterator

import click

from cosim.cli.main import cli
from cosim.cli.trust import RUN_NONE


def leaves(command: click.Command, name: str = "") -> Iterator[tuple[str, click.Command]]:
    if not isinstance(command, click.Group):
        yield name, command
        return
    context = click.Context(command)
    for inner in command.list_commands(context):
        found = command.get_command(context, inner)
        assert found is not None
        yield from leaves(found, f"{name} {inner}".strip())


def test_every_command_has_it_or_runs_none() -> None:
    commands = dict(leaves(cli))
    assert set(RUN_NONE) <= set(commands)
    having = {name for name, command in commands.items() if any("--trust" in option.opts for option in command.params)}
    assert having == set(commands) - set(RUN_NONE)
    assert dict(leaves(cli)).keys() == commands.keys()  # asked for again, it is there once
    assert all(sum("--trust" in option.opts for option in command.params) <= 1 for command in commands.values())
