"""What packages of others add: the entry points of a group, as their metadata states them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from cosim.base.errors import InputError


def installed(group: str) -> Iterator[tuple[str, Any]]:
    """Name and object of every entry point of ``group`` that can be imported from here.

    Raises InputError for one that cannot.
    """
    from importlib.metadata import entry_points

    for entry in entry_points(group=group):
        try:
            yield entry.name, entry.load()
        except Exception as error:  # whatever the module of somebody else does
            reason = ": ".join([type(error).__name__, *str(error).splitlines()[:1]])
            where = f"entry point {entry.name!r} of {group}"
            raise InputError(f"{where}: {entry.value} cannot be loaded: {reason}") from error
