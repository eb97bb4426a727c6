"""Whether code is run that nobody trusts yet: on a terminal the user is asked."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

from cosim.cli.console import echo, hide_progress_bars


def trust_prompt() -> Callable[[Sequence[str]], bool] | None:
    """Return a function that asks the user whether to run code of folders; None without a terminal."""
    return _ask_for_trust if all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr)) else None


def _ask_for_trust(folders: Sequence[str]) -> bool:
    with hide_progress_bars():
        echo("Code that you have not flown before, or that has changed:", err=True)
        for folder in folders:
            echo(f"  {folder}", err=True)
        echo("Run what is in there, with your rights, and remember it? [y/N]: ", err=True, nl=False)
        return sys.stdin.readline().strip().lower() in ("y", "yes")
