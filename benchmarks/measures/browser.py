"""The browser that pictures and tests of pages take."""

import os
import shutil

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def find_browser() -> str | None:
    """Return the browser that ``HEXJET_BROWSER`` names, else an installed one; None if there is none."""
    return os.environ.get("HEXJET_BROWSER") or next(filter(None, map(shutil.which, NAMES)), None)
