"""Takes the documentation's pictures of every page in a real browser: ``make pictures``.

``python docs/page_pictures.py [NAME...]`` takes some of them.

Each page is made by the command that makes it for a user, with little to fly.  Needs playwright and Chromium, or the
browser that ``HEXJET_BROWSER`` names; without one it says so and takes none.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.measures.browser import find_browser
from cosim.base.errors import InputError
from cosim.cli.main import main as hexjet
from cosim.control.autopilot import requests as rq
from cosim.groundstation.exchange import Exchange
from cosim.groundstation.session import RecordOptions, Session
from cosim.groundstation.web.server import WebServer
from cosim.shelf.index import Shelf
from cosim.shelf.server import ShelfServer
from cosim.spec.scenario import Scenario

FOLDER = Path(__file__).parent / "pictures"
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SOON = 60.0  # s for what takes one
HIGH = 1600  # pixels of a picture, at most: what a page begins with


class Page(NamedTuple):
    """A page that a command writes: the commands, in the folder, and where it is."""

    commands: list[str]
    path: str
    at: float | None = None  # s of the flight that is shown


DOUBLET = ["fly roll-doublet --controller baseline --out baseline", "fly roll-doublet --controller smith --out smith"]
MODEL = "identify log smith --axis roll --out logged"
ROOT = Path(__file__).parents[1]
START = ROOT / "tests" / "designs" / "edf-as-flown.toml"  # a search anew takes minutes
VARIED = "--vary vehicle.mass_kg=5:6.5 --vary mismatch.delay_samples=0:20"
PAGES = {
    "flight": Page(["fly fault-flame-out --out fault"], "fault/report.html", 1.8),
    "comparison": Page([*DOUBLET, "compare baseline smith --out compared"], "compared/comparison.html", 4.4),
    "campaign": Page(
        [f"sweep roll-doublet {VARIED} --runs 24 --controller smith --controller baseline --out swept"],
        "swept/report.html",
    ),
    "search": Page(
        ["search roll-doublet --vary mismatch.delay_samples=0:60:5 --controller smith --tolerance 2 --out searched"],
        "searched/search.html",
    ),
    "faults": Page(["faults --kind flame-out --controller smith --out faults"], "faults/survival.html"),
    "identify": Page(["identify roll --engine edf-as-flown --out identified"], "identified/report.html"),
    "identify-log": Page([*DOUBLET, MODEL], "logged/report.html"),
    "validation": Page([*DOUBLET, MODEL, "validate logged baseline --out validated"], "validated/report.html"),
    "design": Page([f"design --start {START} --no-proof --out designed.toml"], "designed.html"),
    "margins": Page(
        ["margins hover --controller smith --axis roll --periods 3 --out measured"], "measured/report.html"
    ),
    "paper": Page(["paper --out paper"], "paper/report.html"),
    "engine-check": Page(["fmu check edf.fmu --out checked"], "checked/report.html"),
}


def write(page: Page, folder: Path, done: set[str]) -> Path:
    """Run the commands that ``done`` has not, in the folder; the page.  Raises InputError where one leaves none."""
    os.chdir(folder)
    shutil.copy(ROOT / "fmus" / "edf.fmu", folder)  # named without the place of this installation
    for command in page.commands:
        if command not in done:
            with suppress(SystemExit):  # some say with its status that a vehicle has failed, which their page shows
                hexjet(command.split())
            done.add(command)
    if not (folder / page.path).is_file():
        raise InputError(f"{page.commands[-1]}: has left no {page.path}")
    return folder / page.path


@contextmanager
def shelf(folder: Path) -> Iterator[str]:
    """The page of ``hexjet open`` over what is in a folder."""

    def none(_: object) -> Path:
        raise InputError("nothing is compared here")

    server = ShelfServer(Shelf(folder), 0, none)
    server.open()
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        yield server.url
    finally:
        server.close()
        thread.join()


@contextmanager
def live(folder: Path, flies: bool = True) -> Iterator[str]:
    """The page of ``hexjet gcs --web``, of a vehicle that takes off and goes somewhere in a wind, or stands."""
    exchange = Exchange()
    windy = Scenario.load("hover", ["environment.wind_ned_m_s=[2.0, 1.0, 0.0]"])
    scenario = windy.replace(name="gcs", engine="edf-as-flown", controller="smith")
    session = Session(scenario, exchange, factor=1.0, records=RecordOptions(folder, report=False))
    thread = threading.Thread(target=session.run)

    def until(true: Callable[[Any], bool], asked: Any) -> None:
        end = time.monotonic() + SOON
        while exchange.snapshot is None or not true(exchange.snapshot.status):
            if time.monotonic() > end:
                raise InputError(f"the vehicle has not come to where it can {type(asked).__name__}")
            time.sleep(0.05)
        exchange.ask(asked)

    with WebServer(exchange, 0) as server:
        thread.start()
        try:
            if flies:
                until(lambda status: status.ready, rq.Arm())
                until(lambda status: status.armed, rq.Takeoff(4.0))
                until(lambda status: status.landed.value == "in_air" and status.mode.value == "HOLD", rq.Goto(6.0, 4.0))
            yield server.url
        finally:
            session.stop("its picture is taken")
            thread.join()


def take(
    browser: Any,
    url: str,
    name: str,
    at: float | None = None,
    width: int = 1100,
    scheme: str = "light",
    high: int | None = None,
) -> None:
    """The beginning of a page, or the replay of a page and what is below it, at a time of the flight."""
    high = high or {"flight": 820, "comparison": 820, "phone": 760, "live": 800, "runs": 620}.get(name)
    context = browser.new_context(viewport={"width": width, "height": high or 1000}, color_scheme=scheme)
    tab = context.new_page()
    tab.goto(url)
    if at is not None:
        tab.wait_for_function("document.documentElement.dataset.replay")
        tab.evaluate("t => { hexjet.setTime(t); document.getElementById('replay-card').scrollIntoView(); }", at)
        tab.wait_for_function("t => document.querySelector('.stage canvas').dataset.time === t", arg=f"{at:.4f}")
        tab.wait_for_timeout(800)  # with smooth edges when it stands
    if name in ("live", "runs"):
        tab.wait_for_selector("#scene canvas[data-time]" if name == "live" else "[role=row]")
        tab.wait_for_timeout(4000 if name == "live" else 500)  # something of a track, a row's colours
    if high is None:
        height = min(HIGH, tab.evaluate("document.documentElement.scrollHeight"))
        tab.set_viewport_size({"width": width, "height": height})
        tab.wait_for_timeout(500)  # figures follow the size of the window
    tab.screenshot(path=FOLDER / f"page-{name}.png")
    context.close()


def main(names: list[str]) -> int:
    """Make the pages, and take them."""
    known = [*PAGES, "phone", "runs", "live"]
    if unknown := set(names) - set(known):
        print(f"{', '.join(sorted(unknown))}: no such page; there are {', '.join(known)}", file=sys.stderr)
        return 2
    found = find_browser()
    if found is None:
        print("no pictures of pages: install chromium, or name a browser in HEXJET_BROWSER", file=sys.stderr)
        return 0
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        folder, done, home = Path(name), set[str](), Path.cwd()
        browser = driver.chromium.launch(executable_path=found, args=FLAGS)
        for each in names or known:
            if each == "phone":
                page = PAGES["flight"]
                take(browser, write(page, folder, done).as_uri(), each, page.at, 390, "dark")
            elif each == "runs":
                write(PAGES["comparison"], folder, done)
                with shelf(folder) as url:
                    take(browser, url, each)
            elif each == "live":
                with live(folder / "gcs") as url:
                    take(browser, url, each, width=1280)
            else:
                take(browser, write(PAGES[each], folder, done).as_uri(), each, PAGES[each].at)
        browser.close()
        os.chdir(home)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
