"""Measures how fast a flight's page is in a real browser and writes it into docs/flight-page.md.

    python docs/page_speed.py

Counted is the processor time of the page's own thread, as Chromium tells it, which other load of the machine hardly
changes; the clock on the wall is beside it.
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from page_pictures import BROWSERS, FLAGS

from cosim import Scenario, fly
from cosim.results.report.marks import table, write_marks

PAGE = Path(__file__).parent / "flight-page.md"
FLIGHT_S, ROUNDS, FRAMES, BY = 20.0, 5, 120, 40  # a scroll goes so many pixels a frame
SCROLL = """([frames, by]) => new Promise((done) => {
  let n = 0;
  const most = document.documentElement.scrollHeight - innerHeight;
  const step = () => { scrollTo(0, (++n * by) % most); if (n < frames) requestAnimationFrame(step); else done(); };
  requestAnimationFrame(step);
})"""
READY = "performance.getEntriesByType('navigation')[0].domContentLoadedEventEnd"


def measure(browser: Any, page: Path) -> dict[str, float]:
    """One opening of a page: ms until the document is ready and until the replay stands, ms a frame of a scroll."""
    context = browser.new_context(viewport={"width": 1200, "height": 900})
    tab = context.new_page()
    tools = context.new_cdp_session(tab)
    tools.send("Performance.enable", {"timeDomain": "threadTicks"})

    def spent() -> float:
        told = {each["name"]: each["value"] for each in tools.send("Performance.getMetrics")["metrics"]}
        return 1e3 * float(told["TaskDuration"])

    tab.goto(page.as_uri(), wait_until="domcontentloaded")
    found = {"ready": spent()}
    tab.wait_for_function("document.documentElement.dataset.replay")
    found |= {"replay": spent(), "wall": float(tab.evaluate(READY))}
    tab.wait_for_function("document.documentElement.dataset.drawn === 'all'")
    before = spent()
    tab.evaluate(SCROLL, [FRAMES, BY])
    found["frame"] = (spent() - before) / FRAMES
    context.close()
    return found


def main() -> int:
    """Fly, open the page several times, and write the medians."""
    found = os.environ.get("HEXJET_BROWSER") or next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        print("nothing measured: install chromium, or name a browser in HEXJET_BROWSER", file=sys.stderr)
        return 1
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        scenario = Scenario.load("roll-doublet").replace(duration_s=FLIGHT_S, controller="smith", expect=[])
        run = fly(scenario, Path(name) / "run")
        if run.outcome != "completed":
            print(f"nothing measured: the flight ended early: {run.reason}", file=sys.stderr)
            return 1
        page = Path(name) / "run" / "report.html"
        size, browser = page.stat().st_size, driver.chromium.launch(executable_path=found, args=FLAGS)
        rounds = [measure(browser, page) for _ in range(ROUNDS)]
        version = browser.version
        browser.close()
    mid = {key: median(each[key] for each in rounds) for key in rounds[0]}
    rows = [
        ["size", f"{1e-6 * size:.2f} MB"],
        ["processor time until the document is ready", f"{mid['ready']:.0f} ms"],
        ["processor time until the replay stands", f"{mid['replay']:.0f} ms"],
        ["processor time of a frame while it is scrolled", f"{mid['frame']:.1f} ms"],
        ["document ready, by the clock on the wall", f"{mid['wall']:.0f} ms"],
    ]
    load = f", load average {os.getloadavg()[0]:.0f}" if hasattr(os, "getloadavg") else ""
    machine = (
        f"A flight of {FLIGHT_S:.0f} s, opened {ROUNDS} times, medians; Chromium {version.partition('.')[0]} without a "
        f"graphics card, {platform.system()} on {platform.machine()}, {os.cpu_count()} processors{load}.\n"
    )
    write_marks(PAGE, {"page speed": machine + "\n" + table(("quantity", "measured"), rows, 1)})
    return 0


if __name__ == "__main__":
    sys.exit(main())
