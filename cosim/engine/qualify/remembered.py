"""What was found out about foreign engines and outlives the process that found it, in the user's cache.

Files there may be deleted at any time; one that cannot be read counts as none.
"""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from cosim.base.storage.user import cache_folder


def write(place: Path, text: str) -> None:
    """Whole or not at all; a folder that cannot be written to is none."""
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=place.parent)
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
        os.replace(name, place)
    except OSError:
        pass  # it is found out again next time


def misbehaves(sha256: str) -> str:
    """Why an archive should have a process of its own, as a check found out; empty where none did."""
    try:
        return _place(sha256).read_text(encoding="utf-8").strip()[:300]
    except (OSError, ValueError):
        return ""


def remember_misbehaviour(sha256: str, why: str) -> None:
    """What a check found; an archive that did nothing of the kind in a whole check is clean again."""
    if why:
        write(_place(sha256), why)
        return
    with suppress(OSError):
        _place(sha256).unlink(missing_ok=True)


def _place(sha256: str) -> Path:
    return cache_folder() / "apart" / f"{sha256}.txt"
