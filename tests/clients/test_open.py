"""hexjet open in a real browser: found, sorted, chosen, tagged, compared and deleted by keyboard, with many runs."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from shelves import shelf

from cosim.shelf.index import Shelf
from cosim.shelf.server import ShelfServer


@pytest.mark.parametrize("runs", [300, 10_000])
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
        page.keyboard.press("/")
        page.keyboard.type("smith roll.rmse_rad<0.1 drift_m")  # no run says drift_m
        page.wait_for_selector("body[data-shown='0']")
        page.fill("#search", "filtered-smith roll.rmse_rad<0.1")
        page.wait_for_selector("body[data-shown='33']")
        page.select_option("#metric", "roll.rmse_rad")
        page.focus("#grid")
        page.wait_for_selector("#row0:has-text('run-00002')")
        for key in ("Home", " ", "ArrowDown", " ", "t"):
            page.keyboard.press(key)
        page.keyboard.type("kept")
        page.keyboard.press("Enter")
        page.wait_for_selector("#row1:has-text('kept')")
        page.keyboard.press("Escape")
        with context.expect_page() as opened:
            page.keyboard.press("c")
        assert opened.value.url.endswith("/run/comparison/comparison.html")
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
