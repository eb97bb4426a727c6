"""Results of checks of users' engines in the user's cache.

Files there may be deleted at any time; an unreadable one counts as missing.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from cosim.base.storage.files import write_whole
from cosim.base.storage.user import cache_folder


def write_if_possible(path: Path, text: str) -> None:
    """Write a file atomically; do nothing if the folder cannot be written to."""
    with suppress(OSError):  # the next process checks the engine again
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text)


def read_misbehaviour(sha256: str) -> str:
    """Return why an archive needs a process of its own according to its last check, else an empty string."""
    try:
        return _record_path(sha256).read_text(encoding="utf-8").strip()[:300]
    except (OSError, ValueError):
        return ""


def record_misbehaviour(sha256: str, why: str) -> None:
    """Record why an archive needs a process of its own; an empty ``why`` after a complete check removes the record."""
    if why:
        write_if_possible(_record_path(sha256), why)
        return
    with suppress(OSError):
        _record_path(sha256).unlink(missing_ok=True)


def _record_path(sha256: str) -> Path:
    return cache_folder() / "apart" / f"{sha256}.txt"
