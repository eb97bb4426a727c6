"""What packages of others add, as their metadata state it: entry points of one group, the kind before the name.

[project.entry-points."hexjet.plugins"]
"controller.my-controller" = "my_package.my_module:MyController"
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any

from cosim.base.errors import InputError, describe_error
from cosim.base.plugins.execute import import_trusted
from cosim.base.trust import CodeRefusedError

GROUP = "hexjet.plugins"  # entry points of all kinds of plug-ins
API = "hexjet.api"  # entry points added to the Python API
HOOKS = "hexjet.hooks"  # entry points called at given moments
GROUPS = {  # further groups, of one kind each
    "predictor": "hexjet.predictors",
    "controller": "hexjet.controllers",
    "metric": "hexjet.metrics",
    "observer": "hexjet.observers",
    "sensors": "hexjet.sensors",
    "wind": "hexjet.winds",
}


def find_entries(kind: str) -> dict[str, EntryPoint]:
    """Return the entry points of a kind that can be imported from here, by the names that a user has for them.

    Raises InputError where two have one name: which of them flies would depend on the order of installation.
    """
    found: dict[str, EntryPoint] = {}
    for entry in [*list_tools(GROUP), *list_tools(GROUPS[kind])]:
        if entry.group != GROUP or entry.name.startswith(f"{kind}."):
            first = found.setdefault(entry_name(entry), entry)
            if first.value != entry.value:  # the same object may be in both groups
                raise InputError(
                    f"{kind} {entry_name(entry)!r}: there is one of this name already: "
                    f"{describe_entry(first)} is {first.value}, {describe_entry(entry)} is {entry.value}"
                )
    return found


def list_tools(group: str, **which: Any) -> list[EntryPoint]:
    """Return the installed entry points of a group, or of one ``name`` in it."""
    return [each for each in entry_points(group=group, **which) if find_spec(each.module.partition(".")[0])]


def load_tool_member(name: str) -> Any:
    """Return the function or the result of a tool that ``cosim`` and ``cosim.api`` name.

    Raises ImportError where no installed package has it.
    """
    member = _load_member(API, name)
    if member is None:
        raise ImportError(f"cosim.{name}: none of the tools that are installed has it", name=f"cosim.{name}")
    return member


def load_hook(name: str) -> Any | None:
    """Return the function that a tool provides for a part of ``cosim``, or None if it is not installed."""
    return _load_member(HOOKS, name)


def _load_member(group: str, name: str) -> Any | None:
    return next((each.load() for each in list_tools(group, name=name)), None)


def entry_name(entry: EntryPoint) -> str:
    """Return the name that a user has for an entry point."""
    return entry.name.partition(".")[2] if entry.group == GROUP else entry.name


def describe_entry(entry: EntryPoint) -> str:
    """Return what messages call an entry point."""
    return f"entry point {entry.name!r} of {entry.group}"


def load_entry(entry: EntryPoint) -> tuple[Any, str]:
    """Return what an entry point names, and name and version of its package.

    Raises InputError for one that cannot be loaded, CodeRefusedError where it is not trusted.
    """
    where = describe_entry(entry)
    try:
        import_trusted(entry.module, where, entry_name(entry))
        member = entry.load()
    except CodeRefusedError:
        raise
    except Exception as error:  # a plug-in's code may raise anything
        raise InputError(f"{where}: {entry.value} cannot be loaded: {describe_error(error)}") from error
    package = None if entry.dist is None else entry.dist.metadata  # each access reads metadata from disk
    return member, "" if package is None else f"{package['Name']} {package['Version']}"
