"""Names that a shell completes, and how it learns to."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem, get_completion_class

from cosim.cli.console import echo

Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]
SHELLS = ("bash", "zsh", "fish")


def _names(*kinds: str) -> Complete:
    """Return what completes the names of these kinds, and files beside them."""

    def complete(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
        from cosim.api.show import catalogue

        before, equals, begun = incomplete.rpartition("=")  # of N=NAME
        names = sorted(entry["name"] for kind in kinds for entry in catalogue(kind))
        items = [CompletionItem(f"{before}{equals}{name}") for name in names if name.startswith(begun)]
        return [CompletionItem(incomplete, type="file"), *items]

    return complete


def _runs(beside: str) -> Complete:
    """Return what completes the folders in ``runs``, by which a run is named, the newest first; ``beside``: others."""

    def complete(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
        runs = Path("runs")
        folders = [path for path in runs.iterdir() if path.is_dir()] if runs.is_dir() else []
        folders.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        items = [CompletionItem(str(path)) for path in folders if str(path).startswith(incomplete)]
        return [CompletionItem(incomplete, type=beside), *items]

    return complete


def _either(*ways: Complete) -> Complete:
    """Return what completes by all of these."""
    return lambda *asked: [item for way in ways for item in way(*asked)]


_COMPLETES: dict[str, Complete] = {
    "--aircraft": _names("aircraft"),
    "--controller": _names("controllers"),
    "--engine": _names("engines"),
    "--from": _names("aircraft"),
    "--scenario": _names("scenarios"),
    "scenario": _names("scenarios"),
    "engine": _names("engines"),
    "engines": _names("engines"),
    "aircraft": _names("aircraft"),
    "folder": _runs("dir"),
    "log": _runs("file"),
    "names": _runs("dir"),
    "name": _either(_names("scenarios", "studies", "engines", "aircraft", "controllers"), _runs("dir")),
}


def complete_by(field: str, names: tuple[str, ...]) -> dict[str, Any]:
    """Return what completes an option of these names, or an argument that is the field, for click; or nothing."""
    found = _COMPLETES.get(names[0] if names else field)
    return {} if found is None else {"shell_complete": found}


def install(context: click.Context, parameter: click.Parameter, shell: str | None) -> None:
    """Write what a shell needs to complete the command, say where, and end.  Raises OSError."""
    if shell is None:
        return
    kind = get_completion_class(shell)
    assert kind is not None  # it is one of SHELLS
    home = Path.home()
    data = Path(os.environ.get("XDG_DATA_HOME", "") or home / ".local" / "share")
    path, also = {
        "bash": (data / "bash-completion" / "completions" / "hexjet", "a new bash has it, where bash-completion is"),
        "zsh": (
            home / ".zfunc" / "_hexjet",
            "in ~/.zshrc: fpath=(~/.zfunc $fpath); autoload -U compinit; compinit",
        ),
        "fish": (home / ".config" / "fish" / "completions" / "hexjet.fish", "a new fish has it"),
    }[shell]
    path.parent.mkdir(parents=True, exist_ok=True)
    script = kind(context.command, {}, "hexjet", "_HEXJET_COMPLETE").source()
    path.write_text(script, encoding="utf-8")
    echo(f"{path}: {also}")
    context.exit()
