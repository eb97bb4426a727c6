"""How fast a page is in a real browser: until it is there, frame by frame while it is scrolled, and while it replays.

Frames are counted by ``requestAnimationFrame``, which the browser calls once for each picture that it draws and at
most as often as the screen shows one: 60 times a second without a screen.  What other programs take from them is told
by the processor time of a frame beside it: of the page's own thread, and of the process that draws for it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmarks.timing import Spread
from cosim import FlightError

PACKAGE = "playwright"
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
WINDOW = {"width": 1200, "height": 900}  # pixels
SCROLL_PIXELS = 20  # a frame: 1200 pixels a second
LATE_FRAMES = 1.5  # a longer interval has a frame missing
SCREEN_HZ = 60.0
WAIT_MS = 600_000.0

_FRAMES = """([seconds, by]) => new Promise((done) => {
  const most = document.documentElement.scrollHeight - innerHeight, times = [];
  let n = 0;
  const frame = (now) => {
    times.push(now);
    if (by) { const way = (++n * by) % (2 * most || 1); scrollTo(0, Math.min(way, 2 * most - way)); }
    if (now - times[0] < 1e3 * seconds) requestAnimationFrame(frame); else done(times);
  };
  requestAnimationFrame(frame);
})"""
_OPENED = """() => Math.max(performance.getEntriesByType("navigation")[0].domContentLoadedEventEnd,
  ...performance.getEntriesByName("first-contentful-paint").map((paint) => paint.startTime))"""
_RENDERER = """() => { const gl = document.createElement("canvas").getContext("webgl2"); if (!gl) return "";
  const more = gl.getExtension("WEBGL_debug_renderer_info");
  return String(gl.getParameter(more ? more.UNMASKED_RENDERER_WEBGL : gl.RENDERER)); }"""
_DRAWN = "document.documentElement.dataset.drawn === 'all' && document.documentElement.dataset.replay"


@dataclass(frozen=True)
class Frames:
    """Rate and cost of the frames that a page draws while something moves.

    Frames a second, % of them late; ms of processor time a frame, of the page's thread and of the process that draws.
    """

    rate: Spread
    late: Spread
    page_ms: Spread
    drawing_ms: Spread


@dataclass(frozen=True)
class PageTimes:
    """Times of opening, scrolling and replaying a page.

    Seconds from asking for it until it is laid out and painted, processor time of its thread until then; frames while
    it is scrolled and, where it has a replay that runs, while that runs in sight.
    """

    open_s: Spread
    open_cpu_s: Spread
    scrolled: Frames
    replayed: Frames | None


class Look:
    """Measures pages in one browser, and keeps what it measured of each."""

    def __init__(self, browser: Any) -> None:
        self._browser = browser
        self._found: dict[Path, list[dict[str, float]]] = {}
        self.version = str(browser.version)
        self.renderer = ""

    def at(self, page: Path, seconds: float) -> None:
        """Open a page, scroll it for ``seconds``, and replay it for as long."""
        with self._browser.new_context(viewport=WINDOW) as context:
            tab = context.new_page()
            spent = _ProcessorTime(self._browser, context, tab)
            tab.goto(page.as_uri(), wait_until="domcontentloaded")
            times = {"open_cpu": 1e-3 * spent.page_ms()}
            tab.wait_for_function("performance.getEntriesByName('first-contentful-paint').length", timeout=WAIT_MS)
            times["open"] = 1e-3 * tab.evaluate(_OPENED)
            has = tab.evaluate("Boolean(document.getElementById('replay'))")
            if has:
                tab.wait_for_function(_DRAWN, timeout=WAIT_MS)
            times |= _measure_frames("scroll", tab, spent, seconds, SCROLL_PIXELS)
            if has and tab.evaluate("document.documentElement.dataset.replay === 'ready'"):
                self.renderer = tab.evaluate(_RENDERER)
                tab.evaluate("hexjet.setTime(0); document.querySelector('.stage').scrollIntoView()")
                tab.keyboard.press("k")
                times |= _measure_frames("replay", tab, spent, seconds, 0)
        self._found.setdefault(page, []).append(times)

    def seen(self, page: Path) -> PageTimes:
        """Return the spread of all measurements of a page."""
        looks = self._found[page]
        all_of = {name: Spread.of([look[name] for look in looks]) for name in looks[0]}
        scrolled, replayed = (
            Frames(*(all_of[f"{action} {name}"] for name in ("rate", "late", "page", "drawing")))
            if f"{action} rate" in all_of
            else None
            for action in ("scroll", "replay")
        )
        assert scrolled is not None
        return PageTimes(all_of["open"], all_of["open_cpu"], scrolled, replayed)


class _ProcessorTime:
    """Processor time [ms] as the browser reports it."""

    def __init__(self, browser: Any, context: Any, tab: Any) -> None:
        self._whole, self._tools = browser.new_browser_cdp_session(), context.new_cdp_session(tab)
        self._tools.send("Performance.enable", {"timeDomain": "threadTicks"})

    def page_ms(self) -> float:
        metrics = {metric["name"]: metric["value"] for metric in self._tools.send("Performance.getMetrics")["metrics"]}
        return 1e3 * float(metrics["TaskDuration"])

    def drawing_ms(self) -> float:
        processes = self._whole.send("SystemInfo.getProcessInfo")["processInfo"]
        return 1e3 * sum(float(process["cpuTime"]) for process in processes if process["type"] == "GPU")


def _measure_frames(action: str, tab: Any, spent: _ProcessorTime, seconds: float, by: int) -> dict[str, float]:
    page, drawing = spent.page_ms(), spent.drawing_ms()
    times = [1e-3 * time for time in tab.evaluate(_FRAMES, [seconds, by])]
    gaps = [b - a for a, b in pairwise(times)]
    if not gaps:
        raise FlightError("the browser has drawn nothing")
    late = sum(gap > LATE_FRAMES / SCREEN_HZ for gap in gaps)
    return {
        f"{action} rate": len(gaps) / sum(gaps),
        f"{action} late": 100.0 * late / len(gaps),
        f"{action} page": (spent.page_ms() - page) / len(gaps),
        f"{action} drawing": (spent.drawing_ms() - drawing) / len(gaps),
    }


def find_browser() -> str | None:
    """Return the browser that ``HEXJET_BROWSER`` names, else an installed one; None if there is none."""
    return os.environ.get("HEXJET_BROWSER") or next(filter(None, map(shutil.which, NAMES)), None)


@contextmanager
def looking() -> Iterator[Look | str]:
    """Yield a :class:`Look` in a browser; if there is no browser, the reason."""
    name = find_browser()
    if name is None:
        yield "no browser: install chromium, or name one in HEXJET_BROWSER"
        return
    try:
        playwright = import_module(f"{PACKAGE}.sync_api")
    except ImportError as error:
        yield f"{error}; it comes with: pip install {PACKAGE}"
        return
    with playwright.sync_playwright() as driver:
        try:
            browser = driver.chromium.launch(executable_path=name, args=["--no-sandbox"])
        except playwright.Error as error:
            yield f"{name}: {str(error).strip().splitlines()[0]}"
            return
        yield Look(browser)
        browser.close()
