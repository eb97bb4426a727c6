"""Figures of pages in a browser: what is drawn where, what the pointer reads, what a legend hides, zoom, files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from watched import opened

from cosim.results.report.page import render

RED = "#ff0000"
MAP = [[1.0, 4.0], [None, 9.0]]  # nothing is known of one cell, and one is beyond the scale
FIGURES = {
    "lines": {
        "data": [
            {"type": "scatter", "mode": "lines", "name": "rise", "x": np.array([1.0, 10.0, 100.0]),
             "y": np.array([0.0, 1.0, 2.0]), "line": {"color": RED}},
            {"type": "scatter", "mode": "markers", "name": "points", "x": [1.0, 100.0], "y": [2.0, 0.0],
             "error_y": {"array": [1.0, 0.5], "symmetric": True}, "marker": {"symbol": "diamond"}},
        ],
        "layout": {"height": 300, "hovermode": "x unified", "xaxis": {"type": "log", "title": {"text": "f [Hz]"}}},
    },
    "linked": {
        "data": [{"type": "scatter", "name": "other", "x": [1.0, 100.0], "y": [0.0, 1.0]}],
        "layout": {"height": 300, "xaxis": {"type": "log", "title": {"text": "f [Hz]"}}},
    },
    "bars": {
        "data": [
            {"type": "bar", "orientation": "h", "name": name, "y": ["one", "two"], "x": x, "marker": {"color": RED},
             "hovertemplate": "%{y}: %{x:.4~g} %<extra></extra>"}
            for name, x in (("first", [30.0, 40.0]), ("second", [70.0, 60.0]))
        ],
        "layout": {"height": 200, "barmode": "stack", "hovermode": "closest", "yaxis": {"autorange": "reversed"},
                   "xaxis": {"range": [0, 100]}},
    },
    "keys": {
        "data": [{"type": "bar", "orientation": "h", "name": "moved", "x": [1.0, 2.0],
                  "y": ["mmmmmmmm.WWWWWWWWWW.gyro.noise_rad_s", "vehicle.mass_kg"]}],
        "layout": {"height": 200, "yaxis": {"automargin": True, "autorange": "reversed"}},
    },
    "map": {
        "data": [{"type": "heatmap", "x": [0.0, 1.0, 2.0], "y": [0.0, 1.0, 2.0], "z": MAP, "zmin": 1.0, "zmax": 4.0,
                  "colorscale": [[0.0, "#000000"], [0.5, "#808080"], [1.0, "#ffffff"]],
                  "hovertemplate": "%{z:.2f}<extra></extra>"}],
        "layout": {"height": 300, "hovermode": "closest"},
    },
}  # fmt: skip


@pytest.fixture
def page(tmp_path: Path, browser: Any) -> Iterator[Any]:
    template = tmp_path / "own.html"
    places = "".join(f'<div class="plot" data-figure="{name}"></div>' for name in FIGURES)
    template.write_text('{% extends "base.html" %}{% block content %}' + places + "{% endblock %}")
    render(template, tmp_path / "page.html", FIGURES)
    with opened(browser, (tmp_path / "page.html").as_uri(), 900, 2800, color_scheme="dark") as tab:
        tab.wait_for_function("[...document.querySelectorAll('.plot')].every((place) => place.querySelector('svg'))")
        yield tab


def count(tab: Any, figure: str, what: str) -> int:
    return int(tab.locator(f'[data-figure="{figure}"] svg {what}').count())


def box(tab: Any, figure: str) -> dict[str, float]:
    held: dict[str, float] = tab.locator(f'[data-figure="{figure}"] svg').bounding_box()
    return held


def labels(tab: Any, figure: str) -> list[str]:
    texts: list[str] = tab.locator(f'[data-figure="{figure}"] svg text').all_text_contents()
    return texts


def test_a_line_goes_through_its_points_on_a_logarithmic_axis(page: Any) -> None:
    d = page.locator(f'[data-figure="lines"] path[stroke="{RED}"]').get_attribute("d")
    first, middle, last = ([float(value) for value in point.split()] for point in d[1:].split("L"))
    assert middle == pytest.approx([(first[0] + last[0]) / 2, (first[1] + last[1]) / 2], abs=0.2)
    assert first[1] > last[1]
    assert {"1", "10", "100", "f [Hz]"} <= set(labels(page, "lines"))


@pytest.mark.parametrize("width", [1200, 360])
def test_a_long_name_beside_its_bar_is_within_the_figure(page: Any, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 800})
    page.evaluate("window.dispatchEvent(new Event('resize'))")
    figure = page.locator('[data-figure="keys"] svg')
    page.wait_for_function(f"document.querySelector('[data-figure=\"keys\"] svg').clientWidth < {width}")
    (name,) = [text for text in labels(page, "keys") if text.endswith("gyro.noise_rad_s")]
    text = figure.locator("text", has_text=name)
    text.wait_for()
    assert text.bounding_box()["x"] >= figure.bounding_box()["x"]
    assert name.startswith("mmmmmmmm.W" if width == 1200 else "…")


def test_the_pointer_reads_every_line_at_its_place(page: Any) -> None:
    place = box(page, "lines")
    page.mouse.move(place["x"] + place["width"] - 30, place["y"] + 100)
    assert page.locator('[data-figure="lines"] .figure-said').inner_text().splitlines() == [
        "f [Hz] 100", "rise: 2", "points: 0",
    ]  # fmt: skip


def test_a_point_near_the_pointer_says_its_name_and_both_values(page: Any) -> None:
    place = box(page, "linked")
    page.mouse.move(place["x"] + place["width"] - 14, place["y"] + 22)
    assert page.locator('[data-figure="linked"] .figure-said').inner_text() == "other: 100, 1"


def test_a_legend_hides_and_shows_what_it_names(page: Any) -> None:
    name = page.locator('[data-figure="lines"] .figure-legend button', has_text="rise")
    assert count(page, "lines", f'path[stroke="{RED}"]') == 1
    name.click()
    assert name.get_attribute("aria-pressed") == "false"
    assert count(page, "lines", f'path[stroke="{RED}"]') == 0
    name.click()
    assert count(page, "lines", f'path[stroke="{RED}"]') == 1


def test_what_is_zoomed_in_one_figure_is_zoomed_in_those_over_the_same_quantity(page: Any) -> None:
    before = labels(page, "linked"), labels(page, "bars")
    place = box(page, "lines")
    page.mouse.move(place["x"] + 300, place["y"] + 100)
    page.mouse.down()
    page.mouse.move(place["x"] + 420, place["y"] + 103, steps=3)
    page.mouse.up()
    assert "1" not in labels(page, "lines")
    assert labels(page, "linked") != before[0]
    assert labels(page, "bars") == before[1]
    page.mouse.dblclick(place["x"] + 300, place["y"] + 100)
    assert labels(page, "linked") == before[0]


def test_bars_stand_on_each_other_and_say_what_they_are(page: Any) -> None:
    bars = page.locator(f'[data-figure="bars"] rect[fill="{RED}"]')
    at = [[float(bars.nth(n).get_attribute(name)) for name in ("x", "width")] for n in range(4)]
    ends = [x + width for x, width in at]
    assert [at[2][0], at[3][0]] == pytest.approx(ends[:2], abs=0.01)  # the second begins where the first ends
    assert ends[2] == pytest.approx(ends[3], abs=0.01)  # each hundred in all
    place = box(page, "bars")
    page.mouse.move(place["x"] + at[1][0] + 20, place["y"] + float(bars.nth(1).get_attribute("y")) + 5)
    assert page.locator('[data-figure="bars"] .figure-said').inner_text() == "two: 40 %"


def test_a_map_has_the_colours_of_its_scale_and_gaps_where_nothing_is_known(page: Any) -> None:
    cells = page.locator('[data-figure="map"] g[shape-rendering] rect')
    assert [cells.nth(n).get_attribute("fill") for n in range(cells.count())] == [
        "rgb(0,0,0)", "rgb(255,255,255)", "rgb(255,255,255)",
    ]  # fmt: skip


def test_a_figure_is_saved_with_its_numbers(page: Any, tmp_path: Path) -> None:
    menu = page.locator('[data-figure="lines"] .figure-menu')
    for ending, begin in (("csv", b"name,x,y,value\nrise,1,0,\n"), ("svg", b"<svg xmlns"), ("png", b"\x89PNG")):
        menu.locator("summary").click()
        with page.expect_download() as kept:
            menu.locator("button", has_text=ending.upper()).click()
        kept.value.save_as(tmp_path / f"lines.{ending}")
        assert kept.value.suggested_filename == f"lines.{ending}"
        assert (tmp_path / f"lines.{ending}").read_bytes().startswith(begin)


def test_colours_are_the_pages_and_a_narrow_window_is_filled(page: Any) -> None:
    def colour(of: str) -> str:
        return str(page.evaluate(f"getComputedStyle(document.querySelector('[data-figure=lines] {of}')).fill"))

    assert colour("text") == "rgb(228, 233, 238)"  # of the dark style
    page.set_viewport_size({"width": 400, "height": 800})
    page.wait_for_function("document.querySelector('[data-figure=lines] svg').clientWidth < 400")
    assert page.evaluate("document.documentElement.scrollWidth") <= 400


def test_a_figure_is_drawn_when_it_comes_into_view_or_on_paper(page: Any, tmp_path: Path) -> None:
    page.set_viewport_size({"width": 900, "height": 100})
    page.reload()
    names = list(FIGURES)
    drawn = "[...document.querySelectorAll('.plot')].filter((place) => place.querySelector('svg')).map((place) => place.dataset.figure)"
    page.wait_for_function(f"{drawn}.length > 0")
    assert names[-1] not in page.evaluate(drawn)
    page.locator(f'[data-figure="{names[-1]}"]').scroll_into_view_if_needed()
    page.wait_for_selector(f'[data-figure="{names[-1]}"] svg')
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate(drawn) == names
    page.evaluate("dispatchEvent(new Event('afterprint'))")
