"""Every page that is made here as axe judges it in a real browser: nothing serious and nothing critical, by day and night.

None asks anything of another machine, complains, or is wider than a phone.
"""

from __future__ import annotations

import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from flights import record
from long_cases import long_case
from patience import PATIENCE
from places import script
from shelves import shelf
from watched import opened

from cosim.flight import write_run_page
from cosim.results.report.flight import write_report
from cosim.shelf.index import write_index

WRONG = ("serious", "critical")
PHONE = 390  # pixels


@pytest.fixture(scope="module")
def axe() -> str:
    """axe-core, as its package brings it."""
    package = pytest.importorskip("axe_playwright_python.base", reason="no axe: pip install axe-playwright-python")
    text: str = package.AXE_SCRIPT
    return text


@pytest.fixture(scope="module")
def pages() -> ModuleType:
    """What makes the documentation's pictures: it knows every page and how it is made."""
    return script("page_pictures")


def complaints(page: Any, axe: str) -> list[str]:
    """What axe finds, a line each."""
    if not page.evaluate("Boolean(window.axe)"):
        page.evaluate(axe)
    found = page.evaluate("() => axe.run({ resultTypes: ['violations'] })")
    assert len(found["passes"]) > 10  # it has looked
    return [
        f"{wrong['id']}: {node['html'][:160]}"
        for wrong in found["violations"]
        if wrong["impact"] in WRONG
        for node in wrong["nodes"]
    ]


@pytest.mark.parametrize("scheme", ["light", long_case("dark")])
def test_a_flight(browser: Any, axe: str, scheme: str, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(write_run_page(record(200)), path)
    with opened(browser, path.as_uri(), color_scheme=scheme) as page:
        page.wait_for_function("document.documentElement.dataset.replay", timeout=1000 * PATIENCE)
        assert complaints(page, axe) == []


# whether the page is dimmed at any moment from now on
WATCH = """() => {
  window.wasStale = document.body.classList.contains("stale");
  new MutationObserver(() => { window.wasStale ||= document.body.classList.contains("stale"); })
    .observe(document.body, { attributes: true, attributeFilter: ["class"] });
}"""
ALL = ("flight", "strips", "engines", "events", "parameters")


@pytest.mark.parametrize(
    ("scheme", "names"),
    [("dark", ALL[:1]), long_case(("light", ALL)), long_case(("dark", ALL[1:]))],
    ids=("short", "light", "dark"),
)
def test_a_flight_while_it_flies(
    browser: Any, axe: str, pages: ModuleType, scheme: str, names: tuple[str, ...], tmp_path: Path
) -> None:
    with pages.live(tmp_path / "run", False) as url, opened(browser, url, color_scheme=scheme, bypass_csp=True) as page:
        page.locator("#scene canvas[data-time]").wait_for(timeout=1000 * PATIENCE)
        for name in names:
            page.click(f"#tab-{name}")
            page.wait_for_timeout(300)  # for a frame of it
            assert live_complaints(page, axe) == [], name


def live_complaints(page: Any, axe: str) -> list[str]:
    """What axe finds while the page hears of its flight: one that waits, as on a busy machine, is dimmed on purpose."""
    end = time.monotonic() + PATIENCE
    while True:
        page.locator("body:not(.stale)").wait_for(timeout=1000 * PATIENCE)
        page.evaluate(WATCH)
        found = complaints(page, axe)
        if not page.evaluate("window.wasStale") or time.monotonic() > end:
            return found


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_runs(browser: Any, axe: str, scheme: str, tmp_path: Path) -> None:
    index = write_index(shelf(tmp_path / "runs", 5))
    with opened(browser, index.as_uri(), color_scheme=scheme) as page:
        page.locator("#runs tbody tr").first.wait_for(timeout=1000 * PATIENCE)
        assert complaints(page, axe) == []


@pytest.mark.long
def test_the_pages_of_all_commands(
    browser: Any, axe: str, pages: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done: set[str] = set()
    for name, made in pages.PAGES.items():
        path = pages.write(made, tmp_path, done)
        for scheme in ("light", "dark"):
            with opened(browser, path.as_uri(), color_scheme=scheme) as page:
                assert complaints(page, axe) == [], f"{name}, {scheme}"
        with opened(browser, path.as_uri(), PHONE) as page:
            assert page.evaluate("document.documentElement.scrollWidth") <= PHONE, name
