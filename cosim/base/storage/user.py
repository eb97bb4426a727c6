"""Folders of this user's, outside of any project: what can be made again, and what was settled."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def cache_folder() -> Path:
    """Return the user's cache folder, for files that can be regenerated."""
    return _choose_folder(os.environ.get("XDG_CACHE_HOME"), "Library/Caches", ".cache")


def settings_folder() -> Path:
    """Return the folder of the user's settings, such as the list of trusted folders."""
    return _choose_folder(os.environ.get("XDG_CONFIG_HOME"), "Library/Application Support", ".config")


def _choose_folder(stated: str | None, on_a_mac: str, elsewhere: str) -> Path:
    if stated and Path(stated).is_absolute():
        return Path(stated) / "hexjet"
    return Path.home() / (on_a_mac if sys.platform == "darwin" else elsewhere) / "hexjet"
