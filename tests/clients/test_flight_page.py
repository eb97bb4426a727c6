"""The page of a flight in a real browser: the replay, strips with every sample, keys, a phone, no request, no error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparisons import compare_report
from flights import STEP, record
from patience import PATIENCE
from watched import opened

from cosim.flight import write_run_page
from cosim.results.log.recorder import MemoryLog
from cosim.results.report.flight import write_report
from cosim.results.report.flight_figures import strips
from cosim.results.report.log_reader import Reader
from cosim.results.report.page import Flights, render
from cosim.results.report.panels import Panel, Trace
from cosim.results.report.signals_data import NOISE_BITS, FlightData, extremes, quantisation_step, run_data
from cosim.results.run import Run

HOUR = 900_000  # steps
SOON = 1000 * PATIENCE  # ms


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    run = write_run_page(record(2000))
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_report(run, path)
    return run, path


@contextmanager
def replay(browser: Any, path: Path, **more: Any) -> Iterator[Any]:
    """The page, ready, which loads nothing beside itself."""
    with opened(browser, path.as_uri(), own=(path.as_uri(),), **more) as page:
        page.wait_for_function("document.documentElement.dataset.replay", timeout=SOON)
        yield page


def shown(page: Any, time: float) -> bytes:
    """The picture at a time."""
    page.evaluate("t => hexjet.setTime(t)", time)
    page.wait_for_function(
        "t => document.querySelector('.stage canvas').dataset.time === t", arg=f"{time:.4f}", timeout=SOON
    )
    picture: bytes = page.locator(".stage canvas").screenshot()
    return picture


def test_the_picture_moves_as_the_log_says(browser: Any, flown: tuple[Run, Path]) -> None:
    run, path = flown
    with replay(browser, path) as page:
        assert page.evaluate("document.documentElement.dataset.replay") == "ready"
        pictures = set()
        for k in (0, 700, 1990):
            pictures.add(shown(page, k * STEP))
            pose = page.evaluate("hexjet.pose(0)")
            log = run.log
            place = [log[name][k] for name in ("north_m", "east_m", "down_m")]
            assert pose["place"] == pytest.approx(place, abs=1e-3)
            roll, pitch, yaw = (0.5 * log[f"{axis}_rad"][k] for axis in ("roll", "pitch", "yaw"))
            # yaw, then pitch, then roll: the product of three turns, w first
            z, y, x = ((np.cos(a), np.eye(3)[i] * np.sin(a)) for a, i in ((yaw, 2), (pitch, 1), (roll, 0)))
            q = product(product(z, y), x)
            assert pose["quaternion"] == pytest.approx([q[0], *q[1]], abs=1e-4)
        assert len(pictures) == 3
        # the thrust of the bank that a servo tilts turns with it
        turns = page.evaluate("hexjet.flights[0].vehicle.jets.map((jet) => jet.turns.length)")
        assert turns == [1] * 6


@pytest.mark.long
def test_two_flights_in_one_scene_and_what_one_is_less_the_other(
    browser: Any, flown: tuple[Run, Path], tmp_path: Path
) -> None:
    first = flown[0]
    second = record(
        1000, change=lambda s: s._replace(state=s.state._replace(euler=(0.5 * s.state.euler[0], *s.state.euler[1:])))
    )
    path = tmp_path / "comparison.html"
    compare_report([first, second], path)
    with replay(browser, path) as page:
        k = int(np.argmax(np.abs(second.log["roll_rad"])))
        shown(page, k * STEP)
        rolls = [2.0 * page.evaluate(f"hexjet.pose({n}).quaternion")[1] for n in (0, 1)]
        assert rolls[1] == pytest.approx(0.5 * rolls[0], rel=1e-2) != 0.0
        page.locator('[data-figure="difference"]').scroll_into_view_if_needed()
        strip = "document.querySelector('[data-figure=difference] .strip').panel"
        page.wait_for_function(f"{strip}.chart", timeout=SOON)
        wanted = np.degrees(second.log["roll_rad"][k] - first.log["roll_rad"][k])
        said = "parseFloat(document.querySelector('[data-figure=difference] .strip b').textContent)"
        page.wait_for_function(f"Math.abs({said} - {wanted}) < 1e-3 * Math.abs({wanted})", timeout=SOON)
        lines = page.evaluate(f"hexjet.files.csvOf({strip})").splitlines()
        assert len(lines) == 1 + len(second.log)  # as far as both flew


def product(a: tuple[Any, Any], b: tuple[Any, Any]) -> tuple[Any, Any]:
    """Of two quaternions, each a scalar and a vector."""
    return a[0] * b[0] - a[1] @ b[1], a[0] * b[1] + b[0] * a[1] + np.cross(a[1], b[1])


def test_the_keyboard_is_enough(browser: Any, flown: tuple[Run, Path]) -> None:
    run, path = flown
    with replay(browser, path) as page:
        press, state = page.keyboard.press, lambda name: page.evaluate(f"hexjet.state.{name}")
        press("ArrowRight")
        press("ArrowRight")
        assert state("t") == pytest.approx(2 * STEP)
        press("a")
        press("Shift+ArrowRight")
        press("b")
        assert state("marks") == pytest.approx([2 * STEP, 1.0 + 2 * STEP])
        assert "B − A 1.000 s" in page.locator(".marks").inner_text()
        press("+")
        assert state("to") - state("from") == pytest.approx(0.5 * state("end"))
        press("0")
        assert state("to") == pytest.approx((len(run.log) - 1) * STEP)
        press("Home")
        press("k")
        page.wait_for_function("hexjet.state.t > 0.05", timeout=SOON)
        press("k")
        assert not state("playing")
        press("End")
        assert state("t") == pytest.approx(state("end"))
        # any column, found by words
        page.focus("#signal-search")
        page.fill("#signal-search", "rate p measured")
        press("Enter")
        page.wait_for_function("[...hexjet.panels].some((p) => p.free && p.signals.length === 1)", timeout=SOON)
        assert page.evaluate("[...hexjet.panels].find((p) => p.free).signals[0].column") == "rate_p_measured_rad_s"


def test_what_is_seen_goes_out_with_every_sample(browser: Any, flown: tuple[Run, Path]) -> None:
    run, path = flown
    with replay(browser, path) as page:
        page.locator('[data-figure="first"]').scroll_into_view_if_needed()
        page.wait_for_function("document.querySelector('[data-figure=first] .strip').panel.chart", timeout=SOON)
        # thrust about the first step, 25 samples late, until one zooms
        window = "(({ from, to }) => [from, to])(document.querySelector('[data-figure=answer] .strip').panel.view)"
        assert page.evaluate(window) == pytest.approx([0.9, 1.25])
        page.evaluate("hexjet.setView(1, 2)")
        assert page.evaluate(window) == [1, 2]
        lines = page.evaluate(
            "hexjet.files.csvOf(document.querySelector('[data-figure=first] .strip').panel)"
        ).splitlines()
        assert lines[0] == "time_s,roll_measured_rad,roll_rad,roll_setpoint_rad"
        assert len(lines) == 1 + 251
        row = [float(cell) for cell in lines[1].split(",")]
        assert row[:3] == pytest.approx([1.0, run.log["roll_measured_rad"][250], run.log["roll_rad"][250]], abs=1e-4)
        svg = page.evaluate("hexjet.files.svgOf(document.querySelector('[data-figure=first] .strip').panel)")
        assert svg.count("<path") == 3
        # a sine of 2 at 25 Hz
        tops = page.evaluate(
            """() => { const y = Float64Array.from({ length: 4096 }, (_, i) => 2 * Math.sin(2 * Math.PI * 25 * i / 1024));
                 const [f, a] = hexjet.amplitudes(y, 1 / 1024, 1); const n = a.indexOf(Math.max(...a)); return [f[n], a[n]]; }"""
        )
        assert tops == pytest.approx([25.0, 2.0], rel=1e-6)
        page.locator("[data-figure=first] .strip-spectrum").first.click()
        page.wait_for_function("document.querySelector('[data-figure=first] .strip').panel.mode === 'spectrum'")
        for kind in ("spectrum", "cross"):
            page.evaluate("k => document.querySelector('[data-figure=first] .strip').panel.turn(k)", kind)
            page.wait_for_function("document.querySelector('[data-figure=first] .strip').panel.chart", timeout=SOON)


def test_a_name_is_pulled_to_another_panel_and_taken_off_it(browser: Any, flown: tuple[Run, Path]) -> None:
    with replay(browser, flown[1]) as page:
        page.locator('[data-figure="attitude"]').scroll_into_view_if_needed()
        strips = page.locator("[data-figure=attitude] .strip")
        page.wait_for_function(
            "document.querySelectorAll('[data-figure=attitude] .strip')[1].panel.chart", timeout=SOON
        )
        strips.nth(0).locator(".chip-line").nth(1).hover()
        page.mouse.down()
        strips.nth(1).locator(".strip-body").hover()
        page.mouse.move(600, 400, steps=3)
        strips.nth(1).locator(".strip-body").hover()
        assert strips.nth(1).get_attribute("class") == "strip strip-target"
        page.mouse.up()
        named = "[...document.querySelectorAll('[data-figure=attitude] .strip')].map((s) => s.panel.signals.map((each) => each.column))"
        assert page.evaluate(named)[1][3:] == ["pitch_rad"]
        assert page.evaluate(named)[0][1] == "pitch_rad"  # it stays where it was, and a pull is no press
        assert strips.nth(0).locator('[aria-pressed="false"]').count() == 1  # the spectrum's
        page.wait_for_function(
            "document.querySelectorAll('[data-figure=attitude] .strip')[1].panel.lines.length === 4", timeout=SOON
        )
        axes = page.evaluate(
            "document.querySelector('[data-figure=attitude] .strip').panel.chart.axes.map((a) => [a.label, a._values[1]])"
        )
        assert axes[0][1].endswith(" s")
        assert axes[1][0] == "deg"
        strips.nth(1).locator(".chip-off").click()
        assert page.evaluate(named)[1][3:] == []


@pytest.mark.long
def test_all_strips_are_drawn_for_paper(browser: Any, flown: tuple[Run, Path]) -> None:
    with replay(browser, flown[1], color_scheme="dark") as page:
        page.wait_for_function("document.documentElement.dataset.drawn === 'all'", timeout=SOON)
        assert page.evaluate("window.scrollY") == 0
        drawn = "[...hexjet.panels].filter((panel) => panel.signals.length && panel.lines.length)"
        assert page.evaluate(f"{drawn}.length") > 10
        assert page.evaluate(f"{drawn}.every((panel) => panel.chart)")
        labels = f"{drawn}.filter((p) => p.mode === 'time').map((p) => p.chart.axes[1]._values.filter(Boolean).length)"
        assert min(page.evaluate(labels)) >= 3
        widths = f"[...new Set({drawn}.map((panel) => panel.chart.width))]"
        before = page.evaluate(widths)
        ink = f"{drawn}[0].chart.axes[0].stroke()"
        dark = page.evaluate(ink)
        page.evaluate("dispatchEvent(new Event('beforeprint'))")
        assert page.evaluate(widths) == [690]
        assert page.evaluate(ink) == "#444" != dark
        page.evaluate("dispatchEvent(new Event('afterprint'))")
        assert page.evaluate(widths) == before
        assert page.evaluate(ink) == dark


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_in_daylight_and_at_night(browser: Any, flown: tuple[Run, Path], scheme: str) -> None:
    with replay(browser, flown[1], width=390, color_scheme=scheme) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        ink = page.evaluate("getComputedStyle(document.body).color")
        assert (ink == "rgb(228, 233, 238)") == (scheme == "dark")
        stage = page.locator(".stage canvas").bounding_box()
        assert stage["width"] <= 390
        assert page.locator("[data-figure=first] .strip-body").bounding_box()["y"] < stage["y"] < 844 - stage["height"]


def test_without_webgl_it_says_so_and_the_strips_remain(browser: Any, flown: tuple[Run, Path]) -> None:
    none = """const real = HTMLCanvasElement.prototype.getContext;
        HTMLCanvasElement.prototype.getContext = function (kind, ...more) { return kind.startsWith("webgl") ? null : real.call(this, kind, ...more); };"""
    with replay(browser, flown[1], script=none) as page:
        assert "no WebGL" in page.locator(".no-webgl").inner_text()
        page.locator('[data-figure="first"]').scroll_into_view_if_needed()
        page.wait_for_selector('[data-figure="first"] .u-over', timeout=SOON)


@pytest.mark.long
def test_the_last_samples_of_an_hour(browser: Any, tmp_path: Path) -> None:
    names = ("roll_rad", "pitch_rad", "yaw_rad", "north_m", "east_m", "down_m")
    k = np.arange(HOUR)
    rng = np.random.default_rng(3)
    table = np.zeros((len(names), HOUR))
    table[0] = 0.1 * np.sin(0.001 * k) + 1e-3 * rng.normal(size=HOUR)
    table[0, 123_456] = 7.0  # a peak that no thinning may lose
    log = MemoryLog([table], names)
    said = run_data(
        FlightData(log, "hour", "#2f7de1", step_s=STEP, jets_m=[(0.1, 0.1, 0.0), (-0.1, 0.1, 0.0), (0.0, -0.1, 0.0)])
    )
    figure = strips(Reader(log, STEP), [Panel("Roll", "rad", [Trace("roll_rad", "true")])])
    path = tmp_path / "hour.html"
    template = tmp_path / "hour.page"
    template.write_text(
        '{% extends "base.html" %}{% block content %}<div class="strips" data-figure="roll"></div>'
        '<div id="replay"></div>{% endblock %}'
    )
    render(template, path, {}, Flights("hour", [said], {"roll": figure}))
    with replay(browser, path) as page:
        panel = "document.querySelector('.strip').panel"
        page.wait_for_function(f"{panel}.chart", timeout=SOON)
        # the whole hour: no more points than pixels, and the peak is there
        count, top = page.evaluate(f"[{panel}.data[0].length, Math.max(...{panel}.data[1])]")
        assert count < 3000
        assert top == pytest.approx(7.0, abs=1e-3)
        carried, apart = extremes(table[0], 12), 6 * STEP  # of an hour the page has two of each twelve samples
        end = (carried.size - 1) * apart
        page.evaluate("([a, b]) => hexjet.setView(a, b)", [end - 9 * apart, end])
        x, y = page.evaluate(f"{panel}.data.map((list) => [...list])")
        assert np.diff(x) == pytest.approx(apart)
        assert x[-1] == pytest.approx(end)
        half = 0.5 * quantisation_step(carried, carried.min(), carried.max())  # of what is carried, not of every sample
        assert half < 2.0 ** -(NOISE_BITS + 1) * np.diff(carried, 2).std()
        assert y == pytest.approx(carried[-len(y) :], abs=half)
        assert 10 <= len(y) <= 12
