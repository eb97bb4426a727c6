"""Takes the documentation's pictures of pages in a real browser, from flights: ``make pictures``.

Needs playwright and Chromium, or the browser that ``HEXJET_BROWSER`` names; without one it says so and takes none.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from cosim import Run, Scenario, fly
from cosim.results.report.comparison import compare_report

FOLDER = Path(__file__).parent / "pictures"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
READY = "document.documentElement.dataset.replay"


def take(browser: Any, page: Path, name: str, at: float, width: int, height: int, scheme: str) -> None:
    """The replay of a page and what is below it, at a time of the flight."""
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    tab = context.new_page()
    tab.goto(page.as_uri())
    tab.wait_for_function(READY)
    tab.evaluate("t => { hexjet.setTime(t); document.getElementById('replay-card').scrollIntoView(); }", at)
    tab.wait_for_function("t => document.querySelector('.stage canvas').dataset.time === t", arg=f"{at:.4f}")
    tab.screenshot(path=FOLDER / f"{name}.png")
    context.close()


def main() -> None:
    """Fly, write the pages, and take them."""
    found = os.environ.get("HEXJET_BROWSER") or next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        print("no pictures of pages: install chromium, or name a browser in HEXJET_BROWSER", file=sys.stderr)
        return
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        folder = Path(name)
        doublet = Scenario.load("roll-doublet")
        runs: list[Run] = [
            fly(doublet.replace(controller=each, expect=[]), folder / each) for each in ("baseline", "smith")
        ]
        fly(Scenario.load("fault-flame-out"), folder / "fault")
        compare_report(runs, folder / "comparison.html")
        browser = driver.chromium.launch(executable_path=found, args=FLAGS)
        take(browser, folder / "fault" / "report.html", "page-flight", 1.8, 1100, 820, "light")
        take(browser, folder / "fault" / "report.html", "page-phone", 1.8, 390, 760, "dark")
        take(browser, folder / "comparison.html", "page-comparison", 4.4, 1100, 820, "light")
        browser.close()


if __name__ == "__main__":
    main()
