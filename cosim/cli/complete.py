"""Names that a shell completes: those of the library, and folders of runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

_LIBRARY_KINDS = {  # kinds of names that complete an option
    "aircraft": ("aircraft",), "controller": ("controllers",), "engine": ("engines",), "from": ("aircraft",),
    "scenario": ("scenarios",), "name": ("scenarios", "studies", "engines", "aircraft", "controllers"),
}  # fmt: skip
_RUN_ARGUMENTS = ("folder", "log", "flights", "name", "run")  # arguments that name a run


def make_completer(argument: str, names: tuple[str, ...]) -> Callable[[Any], list[str]] | None:
    """Return a function that lists completions for an option of these names or for an argument, or None."""
    kinds = _LIBRARY_KINDS.get(names[0][2:] if names else argument)
    is_run = not names and argument in _RUN_ARGUMENTS
    if kinds is None and not is_run:
        return None

    def list_completions(context: Any) -> list[str]:
        from cosim.api.listing import catalogue

        before, equals, begun = context.incomplete.rpartition("=")  # such as 2=turbojet
        found = [entry["name"] for kind in kinds or () for entry in catalogue(kind)]
        words = [f"{before}{equals}{name}" for name in sorted(found) if name.startswith(begun)]
        runs = Path("runs")
        folders = [path for path in runs.iterdir() if path.is_dir()] if is_run and runs.is_dir() else []
        folders.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        return words + [str(path) for path in folders if str(path).startswith(context.incomplete)]

    return list_completions
