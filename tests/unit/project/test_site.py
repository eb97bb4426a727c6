"""The documentation's site (docs/README.md is its contents): its reference has everything, and its links lead somewhere.

That Sphinx builds it without a warning is a long test of its own; test_pages.py runs the commands of pages.
"""

from __future__ import annotations

import os
import re
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from places import DOCS, ROOT

from cosim.cli import table
from cosim.results.log.columns import log_columns
from cosim.results.metrics import metric_names
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle


@pytest.fixture(scope="module")
def reference() -> dict[str, Any]:
    return runpy.run_path(str(DOCS / "reference.py"))


@pytest.fixture(scope="module")
def made(reference: dict[str, Any]) -> dict[str, str]:
    pages: dict[str, str] = reference["pages"]()
    return pages


def test_every_command_with_every_option(made: dict[str, str]) -> None:
    page = made["commands.md"]
    parts = dict(re.findall(r"^## hexjet ([\w -]+)\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL))
    assert list(parts) == table.list_names()
    for name, part in parts.items():
        for option in getattr(table.load(name), "rows", ()):
            assert f"`{option.label}".replace("|", "\\|") in part, (name, option.label)


@pytest.mark.parametrize("model", ["Scenario", "Vehicle", "Study", "MappingFile", "ControllerFile"])
def test_every_key_has_a_meaning(reference: dict[str, Any], model: str) -> None:
    """A new key: say what it means in a comment behind its field."""
    keys = list(reference["keys"](reference[model]))
    assert [f"{key.table} {key.name}" for key in keys if not key.meaning] == []
    assert {key.name for key in keys if not key.table} == set(reference[model].model_fields)


def test_no_key_of_a_file_is_missing(made: dict[str, str]) -> None:
    """What the program itself writes of a scenario and of a vehicle, down to the last table, is there."""

    def names(table: dict[str, Any]) -> Iterator[str]:
        for name, value in table.items():
            yield name
            for each in value if isinstance(value, list) else [value]:
                if isinstance(each, dict) and name not in ("identified", "metrics"):
                    yield from names(each)

    for page, written in (
        ("scenario.md", Scenario.load("roll-doublet").model_dump()),
        ("vehicle.md", load_vehicle("hexjet-p220")[0].model_dump()),
    ):
        missing = [name for name in names(written) if f"| `{name}` |" not in made[page]]
        assert not missing, page


def test_every_column_and_metric(made: dict[str, str]) -> None:
    for column in log_columns():
        assert f"| `{column.name}` | {column.unit or '-'} |" in made["columns.md"]
        assert column.meaning
    rows = re.findall(r"^\| `(\S+)` \| (\S+) \| (.*) \|$", made["metrics.md"], re.MULTILINE)
    assert {name for name, _, _ in rows} >= set(metric_names())
    assert [name for name, _, meaning in rows if not meaning.strip()] == []


def test_every_name_in_the_environment(reference: dict[str, Any]) -> None:
    """What the package, its build and its tests ask of the environment is in the table."""
    ours = [
        path for folder in ("cosim", "tools") for path in (ROOT / folder).rglob("*.py") if path.name != "_messages.py"
    ]
    sources = [*ours, ROOT / "setup.py", ROOT / "tests" / "conftest.py"]
    text = "\n".join(path.read_text(encoding="utf-8") for path in sources)
    asked = set(re.findall(r"environ(?:\.get\(|\[)\"([A-Z_]+)\"(?!\] = )", text)) | set(
        re.findall(r"\"(HEXJET_[A-Z]+|[A-Z0-9]+_SITL)\"", text)
    )
    assert asked <= set(reference["ENVIRONMENT"])
    assert {"HEXJET_PURE", "XDG_CACHE_HOME", "PX4_SITL"} <= asked


def pages() -> list[Path]:
    folders = [ROOT / name for name in ("docs", "aircraft", "benchmarks", "engines", "fmus", ".github")]
    return [*ROOT.glob("*.md"), *(page for folder in folders for page in folder.rglob("*.md"))]


def anchors(page: Path) -> set[str]:
    """Those of a page's headings, as GitHub and the site make them."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    found: set[str] = set()
    for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").lower()
        slug = "".join("-" if each == " " else each for each in plain if each.isalnum() or each in " -_")
        number = 0
        while (name := f"{slug}-{number}" if number else slug) in found:
            number += 1
        found.add(name)
    return found


def test_every_link_leads_somewhere() -> None:
    lost = []
    for page in pages():
        text = re.sub(r"^```.*?^```$|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            if re.match(r"[a-z]+:", link):
                continue
            path, _, anchor = link.partition("#")
            target = (page.parent / path).resolve() if path else page
            if not target.exists() or (anchor and anchor not in anchors(target)):
                lost.append(f"{page.relative_to(ROOT)}: {link}")
    assert not lost


@pytest.fixture(scope="module")
def website() -> Iterator[dict[str, Any]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS))
        yield runpy.run_path(str(DOCS / "website.py"))


def test_every_page_is_in_the_contents(website: dict[str, Any]) -> None:
    listed = [page for part in website["contents"]().values() for page in part]
    assert {page.relative_to(ROOT).as_posix() for page in website["sources"]()} == set(listed)


def test_the_front_page_has_the_doors_of_the_readme(website: dict[str, Any]) -> None:
    """Each in a box of its own with its commands, and nothing of the page is lost."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    front = website["_arrange_front_page"](readme)
    doors = re.findall(r"^````{container} door\n\*\*(.+?)\*\*(.*?)^````$", front, re.MULTILINE | re.DOTALL)
    assert [name for name, _ in doors] == re.findall(r"^\*\*(.+?)\.\*\*", readme, re.MULTILINE)
    assert len(doors) == 6
    assert all(re.search(r"^```\n\.venv/bin/hexjet ", text, re.MULTILINE) for _, text in doors)
    words = [re.sub(r"`{3,}(?:{container} doors?)?|\W", " ", text).split() for text in (front, readme)]
    assert words[0] == words[1]


def test_the_pages_that_open_in_place_are_made_and_shown(website: dict[str, Any], tmp_path: Path) -> None:
    """Each has commands that make it, and a picture on a page; a link to README.md leads to the front page."""
    from page_pictures import PAGES

    shown = {name for page in website["sources"]() for _, _, name in website["PICTURE"].findall(page.read_text())}
    assert set(website["LIVE"]) <= shown & set(PAGES)
    page = DOCS / "runs.md"
    text = website["_resolve_links"](page, "a ![b](pictures/page-flight.png) [c](../README.md#install)", tmp_path, True)
    assert text.split() == [
        *("a", "```{image}", "pictures/page-flight.png", ":alt:", "b", ":class:", "live"),
        *(":target:", "../live/flight.html", "```", "[c](../index.md#install)"),
    ]
    assert (tmp_path / "docs" / "pictures" / "page-flight.png").is_file()


@pytest.mark.long
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    """Long: every page, link and anchor; nothing on it asks another machine for anything."""
    pytest.importorskip("sphinx", reason="no sphinx: pip install '.[docs]'")
    import subprocess

    command = [sys.executable, str(DOCS / "website.py"), str(tmp_path / "site")]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"HEXJET_PURE": "1"})
    assert done.returncode == 0, done.stderr
    built = list((tmp_path / "site").rglob("*.html"))
    assert len(built) > 50
    asked = re.compile(r"<(?:script|img|link|iframe|source)[^>]*(?:src|href)=\"(?:https?:)?//[^\"]*\"")
    for page in built:
        found = [each for each in asked.findall(page.read_text(encoding="utf-8")) if "canonical" not in each]
        assert not found, page
    for name in ("flight", "comparison", "margins"):
        assert (tmp_path / "site" / "live" / f"{name}.html").stat().st_size > 100_000
    index = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
    assert index.count('class="door docutils container"') == 6
    texts = (tmp_path / "site" / "_static" / "texts.js").read_text(encoding="utf-8")
    assert '"docs/judging": "' in texts
    assert "<!-- measured" not in texts
    assert "texts.js" in (tmp_path / "site" / "search.html").read_text(encoding="utf-8")
    assert "texts.js" not in index
    theory = (tmp_path / "site" / "docs" / "theory.html").read_text(encoding="utf-8")
    assert theory.count("<math") > 20
    assert (tmp_path / "site" / "searchindex.js").stat().st_size > 100_000


@pytest.mark.long
def test_tables_sort_and_filter_and_results_have_their_context(browser: Any, tmp_path: Path) -> None:
    """Long: site.js in a browser, on a page with one table and one of a search."""
    script = f"<script src='{(DOCS / '_static' / 'site.js').as_uri()}' defer></script>"
    values = ["10 %", "-3", "lost", "1 200", "9.5", *map(str, range(20, 29))]
    rows = "".join(f"<tr><td>{value}</td><td>row {n}</td></tr>" for n, value in enumerate(values))
    head = "<thead><tr><th>value</th><th>name</th></tr></thead>"
    (tmp_path / "table.html").write_text(f"{script}<article><table>{head}<tbody>{rows}</tbody></table></article>")
    found = "<ul id='search-results'></ul><script>window.siteTexts = {'docs/a': 'The peak of |S| is here.'}</script>"
    (tmp_path / "search.html").write_text(f"<html data-content_root='./'>{script}{found}</html>")
    tab = browser.new_page()
    tab.goto((tmp_path / "table.html").as_uri())
    first = "[...document.querySelectorAll('tbody tr:not([hidden]) td:first-child')].map(each => each.textContent)"
    ordered = ["-3", "9.5", "10 %", *map(str, range(20, 29)), "1 200", "lost"]
    tab.click("button.sort >> nth=0")
    assert tab.evaluate(first) == ordered
    assert tab.get_attribute("th >> nth=0", "aria-sort") == "ascending"
    tab.click("button.sort >> nth=0")
    assert tab.evaluate(first) == ordered[::-1]
    tab.fill("input.filter", "200")
    assert tab.evaluate(first) == ["1 200"]
    tab.goto((tmp_path / "search.html").as_uri() + "?q=peak")
    tab.evaluate("document.getElementById('search-results').innerHTML = '<li><a href=docs/a.html#b>A</a></li>'")
    assert tab.wait_for_selector("p.context").text_content() == "The peak of |S| is here."
    assert tab.text_content("p.context mark") == "peak"
