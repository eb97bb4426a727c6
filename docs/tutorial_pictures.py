"""Takes the tutorial's pictures where its commands were run: ``python docs/tutorial_pictures.py FOLDER``.

Needs playwright and Chromium, as ``page_pictures.py``, which it goes with.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from page_pictures import FLAGS, FOLDER, Page, take

from benchmarks.measures.browser import find_browser

PAGES = {
    "tutorial-comparison": Page([], "runs/compared/comparison.html", 4.6, 1280, 830),
    "tutorial-verdict": Page([], "runs/verdict/report.html", height=820),
}


def main(folder: Path) -> int:
    """Take the tutorial's pictures, and keep the drawing of the vehicle."""
    found = find_browser()
    if found is None:
        print("no pictures of pages: install chromium, or name a browser in HEXJET_BROWSER", file=sys.stderr)
        return 0
    from playwright.sync_api import sync_playwright

    shutil.copy(folder / "runs" / "check-my-vehicle-001" / "aircraft.svg", FOLDER / "tutorial-aircraft.svg")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=found, args=FLAGS)
        for name, page in PAGES.items():
            take(browser, (folder / page.path).resolve().as_uri(), name, page)
        browser.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
