"""The work of others: what is carried is listed with its licence, and goes nowhere without it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from places import ROOT

from cosim.results.report import page as pages

VENDOR = pages.ASSETS / "vendor"
NOTICE = (ROOT / "NOTICE").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
MADE_WITH = {"README.md", "three.entry.mjs"}  # of ours
FLIGHTS = pages.Flights("a", [({"title": "one"}, {"t": ""})], {})
FIGURES = {"one": {"data": [], "layout": {}}}


def texts(*parts: str) -> list[str]:
    """The permission notices of these parts, as they came with them."""
    return [(pages.ASSETS / pages.licence_file(part)).read_text(encoding="utf-8").strip() for part in parts]


def test_every_file_of_others_is_in_the_notice_with_its_version() -> None:
    files = {path.name for path in VENDOR.iterdir()} - MADE_WITH
    assert len(files) == 5
    assert {name for name in files if name not in NOTICE} == set()
    for row in re.findall(r"^\| \[(.+?)\]\(.+?\) \| ([0-9.]+)", (VENDOR / "README.md").read_text(), re.M):
        assert f"{row[0]} {row[1]}" in NOTICE


def test_every_script_of_others_has_a_licence_that_goes_with_it() -> None:
    scripts = {f"vendor/{path.name}" for path in VENDOR.glob("*.js")}
    assert scripts == set(pages.NOTICES)
    parts = {part for parts in pages.NOTICES.values() for part in parts}
    assert {pages.licence_file(part) for part in parts} == {
        f"vendor/{path.name}" for path in VENDOR.glob("*-LICENSE.txt")
    }
    for text in texts(*sorted(parts)):
        assert "opyright" in text
        assert "Permission " in text


def test_every_dependency_is_in_the_notice() -> None:
    names = {
        "fmpy": "FMPy", "jinja2": "Jinja2", "jsbsim": "JSBSim", "numpy": "NumPy", "pyarrow": "PyArrow", "pydantic": "Pydantic",
        "scipy": "SciPy", "rich": "Rich",
    }  # fmt: skip
    needed = [re.match(r"[\w-]+", entry)[0] for entry in PROJECT["dependencies"]]
    assert [name for name in needed if names.get(name, name) not in NOTICE] == []
    assert "JSBSim (LGPL-2.1-or-later)" in NOTICE
    assert "pymavlink (LGPL-3.0-or-later)" in NOTICE


def test_notice_and_licences_go_into_the_packages() -> None:
    held = {path.relative_to(ROOT).as_posix() for name in PROJECT["license-files"] for path in ROOT.glob(name)}
    assert {"LICENSE", "NOTICE"} <= held
    assert {f"cosim/results/report/assets/{pages.licence_file(part)}" for part in ("uPlot", "three")} <= held
    assert "NOTICE" in (ROOT / "MANIFEST.in").read_text().splitlines()[0].split()


@pytest.mark.parametrize(
    ("flights", "figures", "parts"),
    [(FLIGHTS, {}, ("uPlot", "three")), (None, FIGURES, ()), (FLIGHTS, FIGURES, ("uPlot", "three")), (None, {}, ())],
)
def test_a_page_has_the_notices_of_its_parts(
    flights: pages.Flights | None, figures: dict[str, object], parts: tuple[str, ...], tmp_path: Path
) -> None:
    template = tmp_path / "own.html"
    template.write_text('{% extends "base.html" %}{% block content %}<p>all</p>{% endblock %}')
    pages.render(template, tmp_path / "page.html", figures, flights, heading="a", title="a", subtitle="")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    comments = re.findall(r"<!--(.*?)-->", page.partition("</main>")[2].partition("<script")[0], re.S)
    assert len(comments) == bool(parts)
    for part, text in zip(parts, texts(*parts), strict=True):
        assert f"{part}: {text}" in comments[0]
    others = {"uPlot", "three"} - set(parts)
    assert not any(text in page for text in texts(*others))


def test_what_pages_share_has_the_licences_beside_it(tmp_path: Path) -> None:
    held = {path.name for path in pages.shared_assets(tmp_path).iterdir()}
    assert held == {Path(name).name for name in (*pages.STYLES, *pages.SCRIPTS, pages.THREE)} | {
        "uPlot-LICENSE.txt",
        "three-LICENSE.txt",
    }
