"""Commands that live outside this package: entry points of the group ``hexjet.commands``.

``NAME = "module:command"`` adds ``hexjet NAME``, and ``GROUP.NAME = "module:command"`` adds ``hexjet GROUP NAME``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from cosim.base.errors import InputError
from cosim.cli.console import echo

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint, EntryPoints

ADDED = "hexjet.commands"


def find_added(ctx: click.Context) -> EntryPoints:
    """Return the commands of installed packages, whose metadata are read once a call, and only if they are needed."""
    if ADDED not in ctx.meta:
        from importlib.metadata import entry_points

        ctx.meta[ADDED] = entry_points(group=ADDED)
    added: EntryPoints = ctx.meta[ADDED]
    return added


def is_here(ctx: click.Context, name: str) -> bool:
    """Return whether a command of a package is there; a wheel leaves out some of the sources.  Nothing is imported."""
    from importlib.util import find_spec

    entries = tuple(find_added(ctx).select(name=name))
    return any(find_spec(entry.module.partition(".")[0]) is not None for entry in entries)


def note_taken_names(ctx: click.Context, *names: str) -> None:
    """Say once which installed packages add a command of a name that is taken: theirs is not reached."""
    noted: set[str] = ctx.meta.setdefault(f"{ADDED}.noted", set())
    for entry in find_added(ctx):
        if entry.name in names and entry.name not in noted:
            noted.add(entry.name)
            echo(f"hexjet: note: {entry.name} of {_package(entry)} is not reached: hexjet has that command", err=True)


def load_added(ctx: click.Context, name: str) -> click.Command | None:
    """Return the command that an installed package adds, None if there is none; one that cannot be loaded says so."""
    entries = tuple(find_added(ctx).select(name=name))
    return _load(entries) if entries else None


def _load(entries: Sequence[EntryPoint]) -> click.Command:
    entry, *others = entries
    if others:
        return _unavailable(entry.name, f"{' and '.join(map(_package, entries))} both add it; uninstall all but one")
    try:
        command = entry.load()
        if isinstance(command, click.Command):
            return command
        return _unavailable(entry.name, f"{entry.value} of {_package(entry)} is no command of click")
    except Exception as error:  # whatever the module of somebody else does
        package = _package(entry)
        if isinstance(error, ModuleNotFoundError) and error.name == entry.module.partition(".")[0]:
            reason = f"needs {error.name!r}, which is not installed; the sources of {package} have it"
            return _unavailable(entry.name, reason, hidden=True)
        reason = f"{entry.value} of {package} cannot be loaded: {type(error).__name__}: {error}"
        return _unavailable(entry.name, reason.partition("\n")[0])


def _package(entry: EntryPoint) -> str:
    """Return the name of the package that has an entry point."""
    return entry.dist.name if entry.dist else "an installed package"


def _unavailable(name: str, reason: str, hidden: bool = False) -> click.Command:
    """Return a command that says why it cannot run; ``hidden``: which the help leaves out."""

    def complain() -> None:
        raise InputError(f"{name.replace('.', ' ')}: {reason}")

    anything = {"ignore_unknown_options": True, "allow_extra_args": True}
    return click.Command(name, context_settings=anything, callback=complain, help=f"Not here: {reason}.", hidden=hidden)
