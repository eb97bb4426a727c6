"""The command line in tests: what a command came to."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Done(NamedTuple):
    """What a command came to, and what it wrote to standard output and standard error."""

    status: int
    out: str
    err: str


Hexjet = Callable[..., Done]
