"""Every command of ``hexjet``: in which group of the help it stands, and where it is declared."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

from cosim.base.errors import InputError, nearest
from cosim.base.removed import describe_removed

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from cosim.cli.declare import Command

# The entry point NAME adds hexjet NAME, and GROUP.NAME adds hexjet GROUP NAME.
ENTRY_POINT_GROUP = "hexjet.commands"
HELP_GROUPS = {
    "Fly": {
        "fly": "fly a scenario and leave a run's folder",
        "replay": "fly a recorded flight again, and judge a model by it",
    },
    "Look": {
        "show": "list what can be flown, or show one of them, or a run",
        "open": "look through runs in the browser",
        "compare": "lay flights over each other",
    },
    "Design": {
        "new": "begin a project: vehicle, engine, flight, study, notebook",
        "aircraft": "begin an aircraft of your own, and check one",
        "engine": "check an engine's FMU, map its ports, fit one to a bench log",
        "identify": "fit a model to a chirp or a log",
        "design": "design predictor and gains for an engine",
        "margins": "measure gain, phase and delay margins in flight",
    },
    "Prove": {
        "sweep": "fly a scenario many times with what varies drawn",
        "batch": "fly many at once on arrays, beside JSBSim",
        "search": "find the smallest change that breaks, or a rare failure",
        "prove": "show or refute a claim, on one page",
        "faults": "fly every single fault, or every failsafe",
        "paper": "reproduce the paper",
    },
    "Connect": {
        "gcs": "wait on the ground for a ground station",
        "sitl": "let an external autopilot fly the vehicle",
        "export": "write a log, a controller or the vehicle for other tools",
    },
}
# Commands for this project's developers, which the help leaves out.
HIDDEN = frozenset(("benchmark", "engine build"))
OTHERS_TITLE = "Of other packages"
DESCRIPTIONS = {name: line for commands in HELP_GROUPS.values() for name, line in commands.items()}
# Commands of this package, each declared under its name in cosim/cli/commands.py, with _ between its words.
NATIVE = frozenset((
    "aircraft check", "aircraft new", "compare", "engine build", "engine check", "engine identify", "engine map",
    "export", "fly", "gcs", "identify", "new", "open", "show", "sweep",
))  # fmt: skip
_COLLECTIONS = frozenset(("aircraft", "engine", "export", "identify", "sitl"))  # first words of two-word commands


@cache
def added() -> Mapping[str, tuple[EntryPoint, ...]]:
    """Return the entry points of commands that installed packages add, by the command's words."""
    from importlib.metadata import entry_points

    found: dict[str, tuple[EntryPoint, ...]] = {}
    for entry in entry_points(group=ENTRY_POINT_GROUP):
        name = entry.name.replace(".", " ")
        found[name] = (*found.get(name, ()), entry)
    return found


def is_installed(entry: EntryPoint) -> bool:
    """Return whether the package of an entry point is installed; a wheel leaves out some tools."""
    from importlib.util import find_spec

    try:
        return find_spec(entry.module.partition(".")[0]) is not None
    except ModuleNotFoundError:
        return False


def list_names(collection: str = "") -> list[str]:
    """Return the names of all commands, or of those whose first word is ``collection``."""
    names = {*NATIVE, *(name for name, entries in added().items() if is_installed(entries[0]))}
    return sorted(name for name in names if not collection or name.startswith(f"{collection} "))


def is_collection(name: str) -> bool:
    """Return whether ``name`` is the first word of two-word commands."""
    return name in _COLLECTIONS or any(each.startswith(f"{name} ") for each in added())


def find(words: list[str]) -> tuple[str, list[str]]:
    """Return the name of a command line's command, and the words after it.  Raises InputError if there is none."""
    first = words[0]
    if first in NATIVE and first not in _COLLECTIONS:
        return first, words[1:]
    for count in (2, 1):
        name = " ".join(words[:count])
        if (removed := describe_removed(f"hexjet {name}")) is not None:
            raise InputError(f"{name}: {removed}")
        if len(words) >= count and (name in NATIVE or name in added()):
            return name, words[count:]
    if is_collection(first):
        inner = [name.partition(" ")[2] for name in list_names(first) if name not in HIDDEN]
        if not inner:
            # Loading one of these commands reports which package is missing.
            return next(name for name in added() if name.startswith(f"{first} ")), words[1:]
        raise InputError(f"No such command {words[1]!r}; {nearest(words[1], inner)} (hexjet {first} --help)")
    names = {name.partition(" ")[0] for name in set(list_names()) - HIDDEN}
    raise InputError(f"No such command {first!r}; {nearest(first, names)} (hexjet --help)")


def load(name: str) -> Command:
    """Return a command by its name.  Raises InputError if an installed package's command cannot be loaded."""
    if name in NATIVE:
        command: Command = getattr(import_module("cosim.cli.commands"), name.replace(" ", "_"))
        return command
    entry, *others = added()[name]
    packages = [each.dist.name if each.dist else "an installed package" for each in (entry, *others)]
    if others:
        raise InputError(f"{name}: {' and '.join(packages)} both add it; uninstall all but one")
    try:
        loaded: Any = entry.load()
    except Exception as error:
        # Another package's module may raise any exception.
        if isinstance(error, ModuleNotFoundError) and error.name == entry.module.partition(".")[0]:
            reason = f"needs {error.name!r}, which is not installed; the sources of {packages[0]} have it"
            raise InputError(f"{name}: {reason}") from None
        text = f"{entry.value} of {packages[0]} cannot be loaded: {type(error).__name__}: {error}"
        raise InputError(f"{name}: {text.partition(chr(10))[0]}") from None
    if not hasattr(loaded, "run"):
        raise InputError(f"{name}: {entry.value} of {packages[0]} is no cosim.commands.Command")
    return loaded  # type: ignore[no-any-return]
