"""The three ways in which something can go wrong, and whose business each is; and how a line says what is allowed."""

from __future__ import annotations

import errno
import importlib
import sys
import warnings
from collections.abc import Iterable
from pathlib import Path

# System errors that mean a lack of disk, memory or file descriptors, not wrong input.
RESOURCE_ERRNOS = (errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EMFILE, errno.ENFILE)
STDOUT_NAME = "standard output"  # name of standard output in errors


class InputError(ValueError):
    """Raised for wrong input of the user, with one line on what, where and what is allowed (exit status 2)."""


class NotIdentifiedError(InputError):
    """Raised for a sweep or log that identifies no model, with one line on reason and remedy (exit status 1)."""


class FlightError(RuntimeError):
    """Raised if a flight fails: the run ends as ``failed`` and its log is kept (exit status 1)."""


class Notice(UserWarning):
    """Warning in one line, issued once, that an input was ignored or reinterpreted."""


def notify(text: str, category: type[Warning] = Notice) -> None:
    """Issue a warning of one line, attributed to the program's line that called this package."""
    package, frame, level = str(Path(__file__).parents[1]), sys._getframe().f_back, 2
    while frame is not None and frame.f_code.co_filename.startswith(package):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, stacklevel=level)


class EngineError(FlightError):
    """Raised if an engine returns an error or a value that is not finite; names engine, step and time."""


_IMPORT_MACHINERY = ("<frozen importlib", str(Path(importlib.__file__).parent))  # places left out of tracebacks


def describe_error(error: Exception) -> str:
    """Describe an error in one line, with the file and line that raised it if the exception has them."""
    import traceback

    frames = [
        frame for frame in traceback.extract_tb(error.__traceback__) if not frame.filename.startswith(_IMPORT_MACHINERY)
    ]
    place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if len(frames) > 1 else ""
    return ": ".join([type(error).__name__, *str(error).splitlines()[:1]]) + place


def nearest(name: str, allowed: Iterable[str], see: str = "") -> str:
    """Return a clause ``did you mean ...? allowed: ...``; of more than 60 names only similar ones.

    ``see``: what lists them all, to which the clause refers where there are more than 20.

    >>> nearest("hoover", ["hover", "roll-doublet"])
    "did you mean 'hover'? allowed: hover, roll-doublet"
    """
    import difflib

    names = sorted(allowed)
    if see and len(names) > 20:
        return similar(name, names, see)
    hint = "".join(f"did you mean {each!r}? " for each in difflib.get_close_matches(name, names, n=1))
    listed = names if len(names) <= 60 else [*difflib.get_close_matches(name, names, 6, 0.3), "..."]
    return f"{hint}allowed: {', '.join(listed)}"


def similar(name: str, allowed: Iterable[str], see: str = "hexjet show") -> str:
    """Return a clause ``did you mean ...? see: hexjet show``, for too many allowed names to list."""
    import difflib

    names = sorted(allowed)
    found = dict.fromkeys([*difflib.get_close_matches(name, names), *(each for each in names if f".{name}" in each)])
    close = ", ".join(map(repr, list(found)[:3]))
    return f"{f'did you mean {close}? ' if close else ''}see: {see}"
