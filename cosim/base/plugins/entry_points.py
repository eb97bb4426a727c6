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

PLUGIN_GROUP = "hexjet.plugins"  # entry points of all kinds of plug-ins
API_GROUP = "hexjet.api"  # entry points added to the Python API
HOOK_GROUP = "hexjet.hooks"  # entry points that cosim calls itself
KIND_GROUPS = {  # groups of one kind of plug-in each
    "predictor": "hexjet.predictors",
    "controller": "hexjet.controllers",
    "metric": "hexjet.metrics",
    "observer": "hexjet.observers",
    "sensors": "hexjet.sensors",
    "wind": "hexjet.winds",
}


def find_entries(kind: str) -> dict[str, EntryPoint]:
    """Return the importable entry points of a kind of plug-in, by the name that users write.

    Raises InputError where two have one name: which of them flies would depend on the order of installation.
    """
    found: dict[str, EntryPoint] = {}
    for entry in [*list_tools(PLUGIN_GROUP), *list_tools(KIND_GROUPS[kind])]:
        if entry.group != PLUGIN_GROUP or entry.name.startswith(f"{kind}."):
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
    """Return the member of ``cosim`` or ``cosim.api`` that an installed tool provides.

    Raises ImportError where no installed package has it.
    """
    member = _load_installed_member(API_GROUP, name)
    if member is None:
        raise ImportError(f"cosim.{name}: none of the tools that are installed has it", name=f"cosim.{name}")
    return member


def load_hook(name: str) -> Any | None:
    """Return the function that an installed tool provides for ``cosim`` to call, or None."""
    return _load_installed_member(HOOK_GROUP, name)


def _load_installed_member(group: str, name: str) -> Any | None:
    return next((each.load() for each in list_tools(group, name=name)), None)


def entry_name(entry: EntryPoint) -> str:
    """Return the name that users write for an entry point."""
    return entry.name.partition(".")[2] if entry.group == PLUGIN_GROUP else entry.name


def describe_entry(entry: EntryPoint) -> str:
    """Return an entry point's name and group for messages."""
    return f"entry point {entry.name!r} of {entry.group}"


def load_entry(entry: EntryPoint) -> tuple[Any, str]:
    """Return the object that an entry point names, and its package's name and version.

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
