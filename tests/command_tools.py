"""The command line in tests: what a command came to."""

from __future__ import annotations

from collections.abc import Callable


class Done:
    """Exit status, standard output and standard error of a command."""

    def __init__(self, status: int, out: str, err: str) -> None:
        self.status, self.out, self.err = status, out, err


Hexjet = Callable[..., Done]
