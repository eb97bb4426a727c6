"""Takes the documentation's pictures of every page in a real browser: ``make pictures``.

``python docs/page_pictures.py [NAME...]`` takes some of them.  ``make screens``, ``--all FOLDER [NAME...]``, takes
every page that a command draws, its first screen and the whole, in light and dark, 1400 and 390 pixels wide, for eyes;
it says where the first curve is and which page is wider than its screen or complains, with status 1.

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
from cosim.shelf.index import write_index
from cosim.spec.scenario import Scenario

FOLDER = Path(__file__).parent / "pictures"
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WAIT_S = 60.0  # limit of every wait


class Page(NamedTuple):
    """Page that commands write: the commands, its path, and how its picture is taken."""

    commands: list[str]
    path: str
    at: float | None = None  # shown time of the flight [s]
    width: int = 1100
    height: int | None = None  # of the picture; None: the page's
    scheme: str = "light"


DOUBLET = ["fly roll-doublet --controller baseline --out baseline", "fly roll-doublet --controller smith --out smith"]
MODEL = "identify log smith --axis roll --out logged"
ROOT = Path(__file__).parents[1]
START = ROOT / "tests" / "designs" / "edf-as-flown.toml"  # else a search takes minutes
VARIED = "--vary vehicle.mass_kg=5:6.5 --vary mismatch.delay_samples=0:20"
FAULT = ["fly fault-flame-out --out fault"]
PAGES = {
    "flight": Page(FAULT, "fault/report.html", 1.8, 1280, 830),
    "phone": Page(FAULT, "fault/report.html", 1.8, 390, 844, "dark"),
    "comparison": Page([*DOUBLET, "compare baseline smith --out compared"], "compared/comparison.html", 4.4, 1280, 830),
    "campaign": Page(
        [f"sweep roll-doublet {VARIED} --runs 24 --controller smith --controller baseline --out swept"],
        "swept/report.html",
    ),
    "search": Page(
        ["search roll-doublet --vary mismatch.delay_samples=0:60:5 --controller smith --tolerance 2 --out searched"],
        "searched/search.html",
    ),
    "identify": Page(["identify roll --engine edf-as-flown --out identified"], "identified/report.html"),
    "identify-log": Page([*DOUBLET, MODEL], "logged/report.html"),
    "validation": Page([*DOUBLET, MODEL, "replay baseline --model logged --out validated"], "validated/report.html"),
    "design": Page([f"design --start {START} --no-proof --out designed.toml"], "designed.html"),
    "margins": Page(
        ["margins hover --controller smith --axis roll --periods 3 --out measured"], "measured/report.html"
    ),
    "paper": Page(["paper --out paper"], "paper/report.html"),
    "engine-check": Page(["engine check edf.fmu --out checked"], "checked/report.html"),
}
MORE = {  # reviewed, not in the documentation
    "replay": Page([DOUBLET[1], "replay smith --draws 8 --out replayed"], "replayed/report.html"),
    "worst": Page(
        [f"search roll-doublet {VARIED} --controller smith --worst --budget 40 --out worst"], "worst/search.html"
    ),
    "rare": Page(
        [
            "search --rare hover --vary vehicle.mass_kg=5:7.5 --controller smith --target 0.1 --budget 1200 "
            "--set duration_s=0.4 --out rare"
        ],
        "rare/rare.html",
    ),
    "proof": Page(
        ["prove roll-doublet-claim --claim 80%@90% --budget 20 --search 30 --out proved"], "proved/proof.html"
    ),
    "phases": Page(["fly climb-and-land --out landed"], "landed/report.html"),
    "bench": Page(
        [DOUBLET[1], "engine from-bench smith/flight.parquet --command throttle_1 --output thrust_1_N --out benched"],
        "benched/report.html",
    ),
    "batch": Page(["batch check roll-doublet --out batched"], "batched/report.html"),
}
SERVED = {"runs": Page([], "", height=620), "live": Page([], "", width=1280, height=800)}  # made by no command
SIZES, SCHEMES = ((1400, 900), (390, 844)), ("light", "dark")
MAX_HEIGHT = 12_000  # pixels that a browser can take


def write(page: Page, folder: Path, done: set[str]) -> Path:
    """Run the commands of a page that are not in ``done``; return the page.  Raises InputError without one."""
    os.chdir(folder)
    shutil.copy(ROOT / "fmus" / "edf.fmu", folder)  # so that commands name no path
    for command in page.commands:
        if command not in done:
            with suppress(SystemExit):  # status 1: the vehicle has failed
                hexjet(command.split())
            done.add(command)
    if not (folder / page.path).is_file():
        raise InputError(f"{page.commands[-1]}: has left no {page.path}")
    return folder / page.path


@contextmanager
def live(folder: Path, flies: bool = True) -> Iterator[str]:
    """Yield the address of ``hexjet gcs --web`` with a vehicle that flies in a wind, or stands."""
    exchange = Exchange()
    windy = Scenario.load("hover", ["environment.wind_ned_m_s=[2.0, 1.0, 0.0]"])
    scenario = windy.replace(name="gcs", engine="edf-as-flown", controller="smith")
    session = Session(scenario, exchange, factor=1.0, records=RecordOptions(folder, report=False))
    thread = threading.Thread(target=session.run)

    def until(true: Callable[[Any], bool], asked: Any) -> None:
        end = time.monotonic() + WAIT_S
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


def take(browser: Any, url: str, name: str, page: Page) -> None:
    """Take a picture of a page's beginning, at a time of its flight."""
    viewport = {"width": page.width, "height": page.height or 1000}
    tab = browser.new_page(viewport=viewport, color_scheme=page.scheme)
    tab.goto(url)
    if page.at is not None:
        tab.wait_for_function("document.documentElement.dataset.replay")
        tab.evaluate("t => hexjet.setTime(t)", page.at)
        tab.wait_for_function("t => document.querySelector('.stage canvas').dataset.time === t", arg=f"{page.at:.4f}")
        tab.wait_for_timeout(800)  # edges are smooth once it stands still
    if name in ("live", "runs"):
        tab.wait_for_selector("#scene canvas[data-time]" if name == "live" else "#runs tbody tr")
        tab.wait_for_timeout(4000 if name == "live" else 500)  # until a track and colours are seen
    if page.height is None:
        height = min(1600, tab.evaluate("document.documentElement.scrollHeight"))  # the page's beginning
        tab.set_viewport_size(viewport | {"height": height})
        tab.wait_for_timeout(500)  # figures follow the size of the window
    tab.screenshot(path=FOLDER / f"page-{name}.png")
    tab.close()


def take_whole(browser: Any, url: str, name: str, folder: Path) -> list[str]:
    """Take a page in every width and colour scheme; return a line on each thing that is wrong with it."""
    wrong: list[str] = []
    for width, height in SIZES:
        touch = width < 800
        for scheme in SCHEMES:
            context = browser.new_context(
                viewport={"width": width, "height": height}, color_scheme=scheme, has_touch=touch, is_mobile=touch
            )
            tab, where = context.new_page(), f"{name}, {width}, {scheme}"
            tab.on("pageerror", lambda error, where=where: wrong.append(f"{where}: {error}"))
            tab.goto(url)
            if tab.query_selector("#replay"):
                tab.wait_for_function("document.documentElement.dataset.replay")
            tab.wait_for_timeout(4000 if name == "live" else 1500)
            curve = tab.query_selector(".u-over, .plot, .stage canvas")
            box = curve and curve.bounding_box()  # none where it is not shown
            print(f"{where}: first curve at {box['y']:.0f} pixels" if box else f"{where}: no curve")
            shown = tab.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
            if shown[0] > width:
                wrong.append(f"{where}: {shown[0]} pixels wide")
            tab.screenshot(path=folder / f"{name}-{width}-{scheme}-first.png")
            tab.set_viewport_size({"width": width, "height": min(MAX_HEIGHT, shown[1])})
            tab.wait_for_timeout(1500)  # figures are drawn once seen
            tab.screenshot(path=folder / f"{name}-{width}-{scheme}.png")
            context.close()
    return wrong


@contextmanager
def address(name: str, folder: Path, done: set[str]) -> Iterator[str]:
    """Yield a page's address; it is made by commands, or served as long as it is looked at."""
    if name == "runs":
        write(PAGES["comparison"], folder, done)
        yield write_index(folder).as_uri()
    elif name == "live":
        with live(folder / "gcs") as url:
            yield url
    else:
        yield write((PAGES | MORE)[name], folder, done).as_uri()


def review(browser: Any, names: list[str], out: Path) -> int:
    """Take whole pages into a folder, and print what is wrong with them."""
    out.mkdir(parents=True, exist_ok=True)
    home, done, wrong = Path.cwd(), set[str](), list[str]()
    with tempfile.TemporaryDirectory() as name:
        for each in names:
            with address(each, Path(name), done) as url:
                wrong += take_whole(browser, url, each, out)
        os.chdir(home)
    print("\n".join(wrong or ["no page is wider than its screen, none complains"]))
    return 1 if wrong else 0


def main(arguments: list[str]) -> int:
    """Make the pages, and take their pictures."""
    out = Path(arguments[1]).absolute() if arguments[:1] == ["--all"] and arguments[1:] else None
    names = arguments if out is None else arguments[2:]
    known = [*PAGES, *([] if out is None else MORE), *SERVED]
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
        if out is not None:
            return review(browser, names or known, out)
        for each in names or known:
            with address(each, folder, done) as url:
                take(browser, url, each, (PAGES | SERVED)[each])
        browser.close()
        os.chdir(home)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
