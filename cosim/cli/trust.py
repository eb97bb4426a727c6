"""What commands have in common about code: the ones that fly ask whether it is trusted, the ones that look run none."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import click

from cosim.base.trust import trust_everything, without_code
from cosim.cli.console import echo, without_bars

R = TypeVar("R")
RUN_NONE = (  # commands that run nothing of what a file or a folder of the user's names
    "aircraft new", "bench", "fmu build", "fmu map", "list", "open", "paper", "report", "show",
    "sitl params",
)  # fmt: skip
_HELP = "Run code though you never flew what is in its folder, Python, FMUs and programs, and remember it."


def display_only(command: Callable[..., R]) -> Callable[..., R]:
    """Return a command that runs no user code of what it displays, trusted or not."""

    @functools.wraps(command)
    def display(*arguments: Any, **options: Any) -> R:
        with without_code():
            return command(*arguments, **options)

    return display


def with_trust(command: click.Command, name: str) -> click.Command:
    """Return a command with the option ``--trust``, where it may run code; of a group, every such command."""
    if isinstance(command, click.Group):
        for inner in command.commands.values():
            with_trust(inner, f"{name} {inner.name}")
    elif name not in RUN_NONE and not any("--trust" in parameter.opts for parameter in command.params):
        option = click.Option(["--trust"], is_flag=True, expose_value=False, is_eager=True, help=_HELP, callback=_trust)
        command.params.append(option)
    return command


def _trust(context: click.Context, parameter: click.Parameter, is_set: bool) -> None:
    if is_set:
        trust_everything()


def trust_prompt() -> Callable[[Sequence[str]], bool] | None:
    """Return what asks the user whether folders are run; None where nobody is at a terminal."""
    return _ask_for_trust if all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr)) else None


def _ask_for_trust(folders: Sequence[str]) -> bool:
    with without_bars():
        echo("Code that you have not flown before, or that has changed:", err=True)
        for folder in folders:
            echo(f"  {folder}", err=True)
        return click.confirm("Run what is in there, with your rights, and remember it?", err=True)
