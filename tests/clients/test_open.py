"""hexjet open in a real browser: found, sorted, chosen, tagged, compared and deleted by keyboard, with many runs."""

from __future__ import annotations

import http.server
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from patience import PATIENCE
from shelves import shelf

from cosim.flight import fly
from cosim.shelf.index import Shelf
from cosim.shelf.server import ShelfServer
from cosim.spec.scenario import Scenario


@pytest.mark.parametrize("runs", [300, pytest.param(10_000, marks=pytest.mark.long)])
def test_by_keyboard(runs: int, tmp_path: Path, browser: Any) -> None:
    folder, compared = shelf(tmp_path / "runs", runs), []

    def compare(folders: Sequence[Path]) -> Path:
        compared.append([path.name for path in folders])
        page = folder / "comparison" / "comparison.html"
        page.parent.mkdir()
        page.write_text("<title>compared</title>")
        return page

    server = ShelfServer(Shelf(folder), 0, compare)
    server.open()
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    context = browser.new_context(viewport={"width": 1200, "height": 700}, color_scheme="dark")
    page = context.new_page()
    complaints: list[str] = []
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: complaints.append(request.url) if "127.0.0.1" not in request.url else None)
    try:
        page.goto(server.url)
        page.wait_for_selector(f"body[data-shown='{runs}']")
        assert page.locator("[role=row]").count() < 80  # those in sight alone
        page.set_viewport_size(
            {"width": 390, "height": 700}
        )  # a phone: some lines a run, and nothing beside the screen
        page.wait_for_selector("body.slim")
        first = page.locator("#row0").inner_text()
        assert all(word in first for word in ("run-", "2026-01-", "roll.rmse_deg", "as planned"))
        assert page.evaluate("document.getElementById('grid').scrollWidth <= 390")
        page.set_viewport_size({"width": 1200, "height": 700})
        page.wait_for_selector("body:not(.slim)")
        page.keyboard.press("/")
        page.keyboard.type("smith roll.rmse_rad<0.1 drift_m")  # no run says drift_m
        page.wait_for_selector("body[data-shown='0']")
        page.fill("#search", "filtered-smith roll.rmse_rad<0.1")
        page.wait_for_selector("body[data-shown='33']")
        page.fill("#search", "filtered-smith roll.rmse_deg<5.8")  # shown in degrees, asked for in either unit
        page.wait_for_selector("body[data-shown='34']")
        page.fill("#search", "filtered-smith roll.rmse_rad<0.1")
        page.wait_for_selector("body[data-shown='33']")
        page.select_option("#metric", "roll.rmse_rad")
        page.focus("#grid")
        page.wait_for_selector("#row0:has-text('run-00002')")
        assert "0.11459" in page.locator("#row0").inner_text()  # 0.002 rad
        for key in ("Home", " ", "ArrowDown", " ", "t"):
            page.keyboard.press(key)
        page.keyboard.type("kept")
        page.keyboard.press("Enter")
        page.wait_for_selector("#row1:has-text('kept')")
        page.keyboard.press("Escape")
        with context.expect_page() as opened:
            page.keyboard.press("c")
        assert opened.value.url.endswith("/comparison/comparison.html")
        assert opened.value.frame_locator("iframe").locator("title").text_content() == "compared"
        assert compared == [["run-00002", "run-00005"]]
        page.bring_to_front()
        page.focus("#grid")
        page.keyboard.press("Delete")
        page.wait_for_selector("dialog[open]")
        page.keyboard.press("Enter")  # Cancel has the focus
        page.wait_for_selector("dialog[open]", state="detached")
        assert (folder / "run-00002").exists()
        page.keyboard.press("Delete")
        page.wait_for_selector("dialog[open]")
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        page.wait_for_selector("body[data-shown='31']")
        assert not (folder / "run-00002").exists()
        assert not (folder / "run-00005").exists()
        assert complaints == []
    finally:
        context.close()
        server.close()
        thread.join()


@contextmanager
def served(folder: Path) -> Iterator[ShelfServer]:
    server = ShelfServer(Shelf(folder), 0, lambda folders: folders[0])
    server.open()
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.close()
        thread.join()


@pytest.fixture
def elsewhere() -> Iterator[tuple[str, list[str]]]:
    """The address of another server, and what it was sent; a browser may connect ahead of need and send nothing."""
    heard: list[str] = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def parse_request(self) -> bool:
            good = super().parse_request()
            heard.append(self.requestline)
            return good

        def log_message(self, *_: Any) -> None: ...

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/", heard
        server.shutdown()
        thread.join()


def theirs(folder: Path, calls: Sequence[str], address: str) -> Path:
    """A run's page of somebody else, that tries to call somebody."""
    page = folder / "theirs" / "report.html"
    page.parent.mkdir(parents=True)
    script = f"const AT = '{address}';" + "".join(f"try {{ {CALLS[call]} }} catch (e) {{}}" for call in calls)
    page.write_text(f"<!doctype html><title>theirs</title><body><script>{script}</script></body>", encoding="utf-8")
    return page


# What a page could try to call somebody with, whose address is AT.  Two things are missing that no server can keep a
# page from: WebRTC, and that a browser looks a host up and connects to it before it finds that the page may not.
CALLS = {
    "image": "new Image().src = AT + 'image';",
    "fetch": "fetch(AT + 'fetch', { mode: 'no-cors' });",
    "beacon": "navigator.sendBeacon(AT + 'beacon', 'x');",
    "socket": "new WebSocket(AT.replace('http', 'ws'));",
    "events": "new EventSource(AT + 'events');",
    "script": "document.head.append(Object.assign(document.createElement('script'), { src: AT + 'script' }));",
    "style": "document.head.append(Object.assign(document.createElement('link'), { rel: 'stylesheet', href: AT + 'style' }));",
    "import": "document.head.append(Object.assign(document.createElement('style'), { textContent: `@import url(${AT}import);` }));",
    "prefetch": "document.head.append(Object.assign(document.createElement('link'), { rel: 'prefetch', href: AT + 'prefetch' }));",
    "module": "import(AT + 'module').catch(() => 0);",
    "worker": "new Worker(URL.createObjectURL(new Blob([`fetch('${AT}worker')`])));",
    "frame": "document.body.append(Object.assign(document.createElement('iframe'), { src: AT + 'frame' }));",
    "object": "document.body.append(Object.assign(document.createElement('object'), { data: AT + 'object' }));",
    "form": "const f = Object.assign(document.createElement('form'), { action: AT + 'form', method: 'post' }); document.body.append(f); f.submit();",
    "window": "window.open(AT + 'window');",
    "top": "top.location = AT + 'top';",
    "self": "location = AT + 'self';",
    "refresh": "document.head.append(Object.assign(document.createElement('meta'), { httpEquiv: 'refresh', content: `0;url=${AT}refresh` }));",
    "link": "const a = Object.assign(document.createElement('a'), { href: AT + 'link', target: '_top' }); document.body.append(a); a.click();",
    "blank": "const a = Object.assign(document.createElement('a'), { href: AT + 'blank', target: '_blank' }); document.body.append(a); a.click();",
    "download": "const a = Object.assign(document.createElement('a'), { href: AT + 'download', download: 'x' }); document.body.append(a); a.click();",
    "ping": "const a = Object.assign(document.createElement('a'), { href: '#x', ping: AT + 'ping' }); document.body.append(a); a.click();",
}  # fmt: skip


def test_a_page_that_nobody_keeps_in_is_heard(tmp_path: Path, browser: Any, elsewhere: tuple[str, list[str]]) -> None:
    address, heard = elsewhere
    with browser.new_context() as context:
        page = context.new_page()
        page.goto(theirs(tmp_path, ["image"], address).as_uri())
        until = time.monotonic() + PATIENCE
        while not heard and time.monotonic() < until:
            page.wait_for_timeout(50)
    assert heard == ["GET /image HTTP/1.1"]


LEAVING = ("form", "window", "top", "self", "refresh", "link", "blank", "download")  # after which a page may be no more


@pytest.mark.parametrize("calls", [[call for call in CALLS if call not in LEAVING], *([call] for call in LEAVING)])
def test_a_foreign_page_calls_nobody(
    calls: list[str], tmp_path: Path, browser: Any, elsewhere: tuple[str, list[str]]
) -> None:
    address, heard = elsewhere
    theirs(tmp_path / "runs", calls, address)
    with served(tmp_path / "runs") as server, browser.new_context() as context:
        page = context.new_page()
        page.goto(f"http://127.0.0.1:{server.port}/run/{server._key}/theirs/report.html")
        page.wait_for_timeout(1000)
        assert heard == []
        assert len(context.pages) == 1


def test_our_own_pages_work_in_their_frame(tmp_path: Path, browser: Any) -> None:
    """Alone, and with what draws them in a folder for all."""
    short = Scenario.load("hover").replace(duration_s=1.0, expect=[])
    fly(short, tmp_path / "runs" / "one")
    complaints: list[str] = []
    with served(tmp_path / "runs") as server, browser.new_context() as context:
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(f"http://127.0.0.1:{server.port}/run/{server._key}/one/report.html")
        frame = page.frame_locator("iframe")
        frame.locator("canvas").first.wait_for()
        assert complaints == []
