"""The report: every figure is one that Plotly accepts, nothing is lost in drawing, and every run gets a page."""

from __future__ import annotations

import html
import itertools
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from html.parser import HTMLParser
from math import atan2, cos, nan, sin
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects
import pytest
from comparisons import compare_report
from flights import STEP, record, scenario, setup
from packed_columns import unpack

from cosim.base.errors import FlightError
from cosim.base.signals import Command, Sample
from cosim.flight import write_run_page
from cosim.results.comparison import ComparedFlight
from cosim.results.log.columns import NAMES
from cosim.results.log.recorder import MemoryLog
from cosim.results.metrics import Reach, flight_metrics
from cosim.results.report import signals_data
from cosim.results.report.flight import verdict, write_report
from cosim.results.report.flight_figures import comparison_figures, run_figures
from cosim.results.report.log_reader import Reader, choose_rows
from cosim.results.report.page import ASSETS, SCRIPTS, STYLES, THREE, deflate, figure_json
from cosim.results.report.panels import ATTITUDE, jet_rows, make_rest_columns
from cosim.results.report.plot import BLUE
from cosim.results.report.three_views import three_views
from cosim.results.report.time_plot import stack_panels
from cosim.results.run import Run
from cosim.results.setup import describe_integration
from cosim.results.summary import DelayRow, EngineUncertainty, UncertainParameter
from cosim.spec.vehicle import load_vehicle

Change = Callable[[Sample], Sample]


def flown(steps: int = 2000, outcome: str = "completed", reason: str = "", **more: Any) -> Run:
    return write_run_page(record(steps, outcome=outcome, reason=reason, **more))


def turning(sample: Sample) -> Sample:
    """Asked for more and more roll."""
    return sample._replace(command=sample.command._replace(attitude=(sample.time, 0.0, 0.0)))


def swung(by: float) -> Change:
    """Rolling by so much more."""
    return lambda s: s._replace(state=s.state._replace(euler=(by * s.state.euler[0], 0.0, 0.0)))


@pytest.fixture(scope="module")
def run() -> Run:
    return flown()


class Page(HTMLParser):
    """The text of a page, its elements, and the figures in it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path, self.text = path, ""
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.figures: dict[str, Any] = {}
        self.data: dict[str, str] = {}  # columns and libraries, deflated
        self._open: list[tuple[str, dict[str, str | None]]] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._open.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop()[0] != tag:
            pass

    def handle_data(self, data: str) -> None:
        tag, attrs = self._open[-1] if self._open else ("", {})
        if tag == "script" and attrs.get("type") == "application/json":
            self.figures[str(attrs["id"]).removeprefix("figure-")] = json.loads(data)
        elif tag == "script" and attrs.get("type") == "text/plain":
            self.data[str(attrs["id"])] = data
        elif tag not in ("script", "style"):
            self.text += " " + " ".join(data.split())

    @property
    def places(self) -> set[str]:
        return {str(attrs["data-figure"]) for _, attrs in self.elements if "data-figure" in attrs}


def page_of(run: Run, tmp_path: Path) -> Page:
    write_report(run, tmp_path / "report.html")
    return Page(tmp_path / "report.html")


def signals(figure: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The signals of strips, by panel and label."""
    return {f"{p['title']}, {each['label']}": each for p in figure["panels"] for each in p["signals"]}


def test_every_strip_names_columns_that_are_there(run: Run) -> None:
    figures = run_figures(run.log, run.summary)
    assert {"first", "attitude", "rate", "answer", "thrust", "tilt", "height", "effort", "track"} < set(figures)
    there = {*run.log.columns, *make_rest_columns(run.log, run.summary)}
    for name, figure in figures.items():
        assert figure["panels"], name
        assert {each["column"] for each in signals(figure).values()} <= there
    json.loads(figure_json(figures))


def test_the_bands_of_saturation_are_the_steps_that_the_metric_counts(run: Run, monkeypatch: Any) -> None:
    reach = Reach(throttle=((0.0, 0.46),) * 6)  # within what the doublet asks for
    end = len(run.log) * STEP

    def bands() -> list[tuple[float, float]]:
        said, _ = signals_data.run_data(signals_data.FlightData(run.log, "one", BLUE, step_s=STEP, reach=reach))
        return [(start, end if stop is None else stop) for start, stop in said["saturated"]]

    share = flight_metrics(run.log, STEP, reach).effort.saturated_percent
    assert 0.0 < share < 100.0
    all_of_them = bands()
    assert 100.0 * sum(stop - start for start, stop in all_of_them) / end == pytest.approx(share)
    # where there are too many to tell apart the longest gaps remain
    gaps = [after[0] - before[1] for before, after in itertools.pairwise(all_of_them)]
    assert len(gaps) > 1
    monkeypatch.setattr(signals_data, "MAX_INTERVALS", 2)
    widest = int(np.argmax(gaps))
    assert bands() == [(all_of_them[0][0], all_of_them[widest][1]), (all_of_them[widest + 1][0], all_of_them[-1][1])]
    said, _ = signals_data.run_data(signals_data.FlightData(run.log, "one", BLUE, step_s=STEP))
    assert said["saturated"] == []


def test_what_draws_pages_is_written_once_beside_the_folders_of_runs(run: Run, tmp_path: Path) -> None:
    pages = [tmp_path / name / "report.html" for name in ("one", "two")]
    for page in pages:
        page.parent.mkdir()
        write_report(run, page, shared_assets=True)
    (place,) = tmp_path.glob("assets-*")
    drawing = {Path(name).name for name in (*STYLES, *SCRIPTS, THREE)}
    licences = {"uPlot-LICENSE.txt", "three-LICENSE.txt"}
    assert {path.name for path in place.iterdir()} == drawing | licences
    names = {f"../{place.name}/{name}" for name in drawing}
    for page in map(Page, pages):
        named = {attrs.get(key) for _, attrs in page.elements for key in ("href", "src", "data-src")}
        assert named & names == names
        write_report(run, tmp_path / "whole.html")
        saved = (tmp_path / "whole.html").stat().st_size - page.path.stat().st_size
        assert saved > 0.5 * sum(len(deflate(ASSETS / name)) for name in (*SCRIPTS, THREE))
    # what is there stays; what is not is written again
    gone, kept = place / Path(THREE).name, place / "strips.js"
    kept_at = kept.stat().st_mtime_ns
    gone.unlink()
    write_report(run, pages[0], shared_assets=True)
    assert gone.read_bytes() == (ASSETS / THREE).read_bytes()
    assert kept.stat().st_mtime_ns == kept_at
    # a file where the folder should be
    (tmp_path / "off").mkdir()
    (tmp_path / "off" / place.name).touch()
    (tmp_path / "off" / "run").mkdir()
    with pytest.raises(FlightError, match=place.name):
        write_report(run, tmp_path / "off" / "run" / "report.html", shared_assets=True)


def test_angles_are_drawn_in_degrees_and_nothing_else_is_changed(run: Run) -> None:
    figures = run_figures(run.log, run.summary)
    attitude = signals(figures["first"]) | signals(figures["attitude"])
    for label, column in (("Roll, true", "roll_rad"), ("Yaw, set-point", "yaw_setpoint_rad")):
        assert attitude[label]["column"] == column
        assert attitude[label]["scale"] == pytest.approx(180.0 / np.pi, rel=1e-15)
    assert signals(figures["rate"])["Roll rate, predicted"]["column"] == "rate_p_predicted_rad_s"
    climb = signals(figures["height"])["Climb rate, true"]
    assert (climb["column"], climb["scale"]) == ("velocity_down_m_s", -1.0)
    assert signals(figures["height"])["Altitude, true"]["scale"] == 1.0


def test_thrust_is_drawn_where_the_jet_sits(run: Run) -> None:
    figure = run_figures(run.log, run.summary)["thrust"]
    assert [panel["title"] for panel in figure["panels"]] == [f"Jet {jet}" for jet in (3, 1, 6, 5, 2, 4)]
    assert figure["shared"]  # one scale
    resting = make_rest_columns(run.log, run.summary)
    for panel, jet in zip(figure["panels"], (3, 1, 6, 5, 2, 4), strict=True):
        told, delivered = panel["signals"]
        # the curve of the made-up engine is a line through 0 with 20 N per unit of throttle
        np.testing.assert_allclose(resting[told["column"]](), 20.0 * run.log[f"throttle_{jet}"], rtol=1e-12)
        assert delivered["column"] == f"thrust_{jet}_N"


def test_a_wing_is_drawn_with_what_turns_its_surfaces_and_thrust_where_it_points() -> None:
    vehicle, _ = load_vehicle("jetwing")
    panels = signals_data.describe_shape(vehicle)["panels"]
    assert {panel["column"] for panel in panels} == {
        None, "deflection_aileron", "deflection_elevator", "deflection_rudder"
    }  # fmt: skip
    drawing = ET.fromstring(three_views(vehicle))
    spec = "{http://www.w3.org/2000/svg}"
    assert len([each for each in drawing.iter(f"{spec}polygon") if each.get("class") == "panel"]) == 3 * len(panels)

    def leans(thrust: ET.Element) -> float:
        x, y = (float(thrust.attrib[f"{a}2"]) - float(thrust.attrib[f"{a}1"]) for a in "xy")
        return atan2(x, -y)

    # canted by 0.3 rad to the right: seen so from the front, where right is on the left
    canted = vehicle.model_copy(
        update={"jets": [jet.model_copy(update={"axis": (0.0, sin(0.3), -cos(0.3))}) for jet in vehicle.jets]}
    )
    lines = [each for each in ET.fromstring(three_views(canted)).iter(f"{spec}line") if each.get("class") == "thrust"]
    assert [leans(line) for line in lines[-4:]] == pytest.approx([-0.3] * 4, abs=0.01)


def test_jets_are_placed_by_the_vehicle() -> None:
    assert jet_rows([]) == ((3, 1), (6, 5), (2, 4))
    assert jet_rows([(1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 0.0)]) == ((1, 2), (4, 3))


def test_without_a_static_curve_only_what_was_delivered_is_drawn(tmp_path: Path) -> None:
    run = flown(50, engine_curve=[])
    thrust = run_figures(run.log, run.summary)["thrust"]
    assert [each["label"] for panel in thrust["panels"] for each in panel["signals"]] == ["delivered"] * 6
    assert "its thrust at rest is not known" in page_of(run, tmp_path).text


def test_the_page_shows_how_well_the_engine_is_known(tmp_path: Path) -> None:
    assert "How well the engine is known" not in page_of(flown(50), tmp_path).text
    row = UncertainParameter(name="lag", nominal=0.4, low=0.31, high=0.49, spread=0.02, flown=0.45)
    known = EngineUncertainty(source="bench.csv: 6 steps", parameters=[row])
    text = page_of(flown(50, engine_uncertainty=known), tmp_path).text
    assert "source: bench.csv: 6 steps" in text
    assert " lag 0.45 0.4 0.31 to 0.49 0.02 " in " ".join(text.split())


def test_disturbances_are_shaded_and_what_is_not_there_is_left_out(run: Run, tmp_path: Path) -> None:
    figures = run_figures(run.log, run.summary)
    ((start, end),) = Reader(run.log, STEP).upsets()
    # on for 6 < t < 7: from the row at 6.004 s to the one that begins at 7 s
    assert (start, end) == (pytest.approx(6.004), pytest.approx(7.0))
    panels = [(panel["title"], panel["unit"]) for panel in figures["outside"]["panels"]]
    assert panels == [("Moment", "N m"), ("Wind", "m/s")]
    assert not any(label.endswith("refused") for label in signals(figures["effort"]))
    calm = flown(100, change=lambda s: s._replace(state=s.state._replace(wind=(0.0, 0.0, 0.0))))
    assert "outside" not in run_figures(calm.log, calm.summary)
    text = page_of(calm, tmp_path).text
    assert "Nothing came from outside" in text
    assert "From outside" not in text  # no card of its own


def test_thinning_keeps_every_peak() -> None:
    random = np.random.default_rng(4)
    values = random.normal(size=900_001)
    peaks = random.choice(values.size, size=40, replace=False)
    values[peaks] = 50.0 + np.arange(40)
    rows = choose_rows(values)
    assert rows.size <= 4000
    assert rows[0] == 0
    assert rows[-1] == values.size - 1
    assert np.all(np.diff(rows) > 0)
    length = np.diff(rows).max()
    for peak in peaks:  # it is drawn, unless a greater one stands in the same stretch
        near = values[max(0, peak - length) : peak + length + 1]
        assert peak in rows or near.max() > values[peak]
    assert values[rows].max() == values.max()
    assert values[rows].min() == values.min()


@pytest.mark.parametrize("size", [3999, 4000, 4001, 4003, 7999, 8001, 12_345])
def test_thinning_of_any_length(size: int) -> None:
    values = np.sin(np.arange(size) * 0.1)
    rows = choose_rows(values)
    if size <= 4000:
        assert rows is None
    else:
        assert rows.size <= 4000
        assert rows.max() == size - 1


def test_thinning_keeps_gaps() -> None:
    values = np.ones(10_000)
    values[3000:6000] = nan
    rows = choose_rows(values)
    assert rows is not None
    assert np.isnan(values[rows]).any()
    assert np.isfinite(values[rows]).sum() > 1000
    assert choose_rows(np.full(10_000, nan)) is not None


def test_a_long_flight_is_drawn_with_its_times() -> None:
    table = np.zeros((len(NAMES), 20_000))
    table[NAMES.index("roll_rad"), 12_345] = 1.0
    figure = stack_panels(Reader(MemoryLog([table]), STEP), ATTITUDE)
    trace = next(trace for trace in figure["data"] if trace["hovertemplate"].startswith("Roll, true"))
    assert trace["x"][np.argmax(trace["y"])] == pytest.approx(12_345 * STEP)
    assert len(trace["y"]) <= 4000
    plotly.graph_objects.Figure(figure)


@pytest.mark.parametrize("rows", [1, 2, 3, 1000])
@pytest.mark.parametrize("kind", ["smooth", "noise", "flags", "constant", "huge", "gaps", "spike", "far", "tiny"])
def test_a_packed_column_is_what_it_was_to_half_a_step(kind: str, rows: int) -> None:
    rng, k = np.random.default_rng(1), np.arange(rows, dtype=float)
    values = {
        "smooth": np.sin(0.01 * k),
        "noise": rng.normal(size=rows),
        "flags": (k % 7 == 0).astype(float),
        "constant": np.full(rows, 0.1),
        "huge": 1e30 * rng.normal(size=rows),
        "gaps": np.where(k % 5 == 1, nan, rng.normal(size=rows)),
        "spike": np.where(k == rows // 2, 1e12, 1e-3 * rng.normal(size=rows)),
        "far": 1e9 + 1e-3 * rng.normal(size=rows),
        "tiny": 1e-200 * rng.normal(size=rows),
    }[kind]
    column = signals_data.pack(values)
    again = unpack(column, rows)
    assert np.array_equal(np.isnan(again), np.isnan(values))
    assert np.nanmax(np.abs(again - values)) <= 0.5 * column.step * (1.0 + 1e-6)
    if kind in ("flags", "constant"):
        assert np.array_equal(again, values)
    elif kind in ("smooth", "noise") and rows > 3:
        first, last = np.percentile(values, (1.0, 99.0))
        rough = np.percentile(np.abs(np.diff(values, 2)), 25.0)
        assert column.step <= max(2.0**-16 * (last - first), rough / 32.0)


def test_a_column_without_a_number_is_not_carried() -> None:
    assert signals_data.pack(np.full(5, nan)) is None


def test_the_extremes_of_a_group_come_in_their_order() -> None:
    values = np.array([3.0, 9.0, -1.0, 4.0, 2.0, 2.0, 2.0, 2.0, nan, 5.0, nan, 4.0, nan, nan, nan, nan, 7.0, 8.0])
    expected = [9.0, -1.0, 2.0, 2.0, 5.0, 4.0, nan, nan, 7.0, 8.0]
    assert np.array_equal(signals_data.extremes(values, 4), expected, equal_nan=True)


@pytest.mark.parametrize(("steps", "group"), [(1, 1), (150_000, 1), (150_001, 4), (300_000, 4), (900_000, 12)])
def test_a_page_has_at_most_so_many_rows(steps: int, group: int) -> None:
    assert signals_data.group_length(steps) == group
    assert 2 * -(-steps // group) <= 150_000 + 1 or group == 1


def test_a_long_flight_says_what_its_page_leaves_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """No peak is lost, every instant is right to less than a group, and a flight within the bound is whole."""
    rng = np.random.default_rng(7)
    values = np.cumsum(rng.normal(size=1003))
    log = MemoryLog([values[None]], ("roll_rad",))
    whole, _ = signals_data.run_data(signals_data.FlightData(log, "Mine", "#2f7de1", step_s=0.004))
    assert (whole["rows"], whole["step"], whole["group"], whole["thinned"]) == (1003, 0.004, 1, "")
    monkeypatch.setattr(signals_data, "MAX_ROWS", 300)
    said, data = signals_data.run_data(signals_data.FlightData(log, "Mine", "#2f7de1", step_s=0.004))
    (column,) = said["columns"]
    about = {key: column[key] for key in signals_data.Packed._fields if key != "data"}
    drawn = unpack(signals_data.Packed(**about, data=data["roll_rad"]), said["rows"])
    assert said["group"] == 8
    assert said["rows"] == drawn.size == 252
    assert said["step"] == pytest.approx(0.016)
    assert "each 8 of the 1,003 steps" in said["thinned"]
    assert "less than 0.032 s" in said["thinned"]
    tolerance = 0.5 * column["step"]
    assert abs(drawn.max() - values.max()) <= tolerance
    assert abs(drawn.min() - values.min()) <= tolerance
    for row, value in enumerate(drawn):
        near = values[8 * (row // 2) : 8 * (row // 2) + 8]
        assert np.min(np.abs(near - value)) <= tolerance
    assert signals_data.quantisation_step(np.array([0.0, 2.0, 5.0]), 0.0, 5.0) == 1.0


def test_the_page_is_whole_and_needs_nothing_else(run: Run, tmp_path: Path) -> None:
    page = page_of(run, tmp_path)
    told = page.figures["flight-data"]
    assert page.places == set(told["figures"]) == set(run_figures(run.log, run.summary))
    loading = ("script", "link", "img", "iframe")
    assert not [attrs for tag, attrs in page.elements if tag in loading and {"src", "href"} & set(attrs)]
    style = re.search(r"<style>(.*?)</style>", (tmp_path / "report.html").read_text(), re.DOTALL)
    assert "url(" not in style[1]
    assert "@import" not in style[1]
    (said,) = told["runs"]
    for about in said["columns"]:
        text = page.data.get(f"data-0-{about['data']}", "")
        column = signals_data.Packed(*(about[key] for key in signals_data.Packed._fields[:-1]), text)
        values = unpack(column, said["rows"])
        if about["name"] in run.log.columns:
            exact = run.log[about["name"]]
            assert np.nanmax(np.abs(values - exact)) <= 0.5 * about["step"] * (1.0 + 1e-9), about["name"]
            assert np.array_equal(np.isnan(values), np.isnan(exact)), about["name"]
    names = {about["name"] for about in said["columns"]}
    assert {*run.log.columns, "time_s"} - names - {*said["empty"]} == {"time_s"}
    assert len(said["vehicle"]["jets"]) == 6
    assert {turn["column"] for jet in said["vehicle"]["jets"] for turn in jet["turns"]} <= {*run.log.columns}
    assert (tmp_path / "report.html").stat().st_size < 1.5e6


def test_the_page_says_what_there_is_to_say(run: Run, tmp_path: Path) -> None:
    text = page_of(run, tmp_path).text
    summary = run.summary
    for word in ("Roll doublet", "hexjet", "edf-as-flown", "smith", "as planned", "roll overshoot"):
        assert word in text, word
    assert summary.metrics["roll"].overshoot_percent is not None
    assert f"{summary.metrics['roll'].overshoot_percent:.1f}" in text
    assert f"{np.degrees(summary.metrics['roll'].rmse_rad or nan):.2f}" in text
    assert "transport delay engine edf-as-flown transport 25.00 100.00" in text
    assert "roll 104.0 ms (26.00 samples)" in text
    for name, value in (summary.versions | summary.sha256).items():
        assert name in text
        assert value in text
    assert "flown in memory" in text


def test_the_page_says_how_the_airframe_was_integrated(run: Run, tmp_path: Path) -> None:
    """Where the step is; a run from before it was written down says nothing of it."""
    assert "integration" not in page_of(run, tmp_path).text
    text = page_of(flown(10, integration=describe_integration(scenario(substeps=5))), tmp_path).text
    assert "steps of 4 ms, 5 JSBSim runs each" in text
    assert (
        "rates and velocities Adams-Bashforth 2 (rectangular rule while anything touches the ground), "
        "attitude Buss 2, position Adams-Bashforth 3"
    ) in text


def test_a_run_in_a_folder_says_how_to_fly_it_again(tmp_path: Path) -> None:
    folder = tmp_path / "my runs"
    flown(10, folder=folder)
    assert f"hexjet fly '{folder}/scenario.toml'" in Page(folder / "report.html").text


def test_what_is_expected_and_not_met_is_plain_to_see(tmp_path: Path) -> None:
    run = flown(change=swung(2.0))
    text = page_of(run, tmp_path).text
    assert "Not as expected: roll.overshoot_percent = " in text
    assert re.search(r"roll overshoot expected [\d.]+ % ≤ 35 % -[\d.]+ % -\d+ % – broken", " ".join(text.split()))


def test_a_delay_that_nobody_states_has_no_sum(tmp_path: Path) -> None:
    rows = [*setup().delay_ledger, DelayRow(element="spool lag", owner="engine", kind="lag", samples=None)]
    text = page_of(flown(10, delay_ledger=rows), tmp_path).text
    assert "spool lag engine lag not stated" in text
    assert "roll not known" in text


@pytest.mark.parametrize("rows", [0, 1, 2])
@pytest.mark.parametrize("outcome", ["crashed", "diverged", "failed"])
def test_every_flight_gets_a_page(tmp_path: Path, rows: int, outcome: str) -> None:
    reason = "engine 3 (edf.fmu): thrust is not finite at step 0 (0.000 s)"
    page = page_of(flown(rows, outcome, reason), tmp_path)
    assert outcome in page.text
    assert reason in page.text
    assert bool(page.figures) == bool(rows)
    assert ("nothing to draw" in page.text) == (rows == 0)


def test_values_that_are_no_numbers_are_gaps(tmp_path: Path) -> None:
    def spoil(sample: Sample) -> Sample:
        if sample.k < 100:
            return sample._replace(command=Command((0.0, 0.0, 0.0), 30.0, rate=(0.0, 0.0, 0.0), collective=0.4))
        odd = sample.engines._replace(thrust=(nan, float("inf"), 1.0, 1.0, 1.0, 1.0))
        return sample._replace(engines=odd) if sample.k > 200 else sample

    run = flown(300, "failed", "engine 1", change=spoil)
    page = page_of(run, tmp_path)
    (said,) = page.figures["flight-data"]["runs"]
    about = next(each for each in said["columns"] if each["name"] == "roll_setpoint_rad")
    column = signals_data.Packed(
        *(about[key] for key in signals_data.Packed._fields[:-1]), page.data["data-0-roll_setpoint_rad"]
    )
    setpoint = unpack(column, said["rows"])
    assert np.isnan(setpoint[:100]).all()
    assert np.isfinite(setpoint[100:]).all()


def test_text_of_a_scenario_cannot_become_markup(tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script><img src=x onerror=alert(1)> & \"quoted\" 'too'"
    told = {"title": evil, "description": evil, "engine": evil, "versions": {evil: evil}, "sha256": {evil: evil}}
    row = DelayRow(element=evil, owner=evil, kind=evil, samples=1.0)
    run = flown(20, "failed", evil, delay_ledger=[row], **told)
    compare_report([run, flown(20)], tmp_path / "compare.html")
    for page in (page_of(run, tmp_path), Page(tmp_path / "compare.html")):
        assert not [tag for tag, attrs in page.elements if tag == "img" or "onerror" in attrs]
        own = len(SCRIPTS) + 1
        assert [tag for tag, _ in page.elements].count("script") == len(page.figures) + len(page.data) + own
        assert evil.split("<")[0] in page.text
    assert html.escape("<img src=x") in (tmp_path / "report.html").read_text()
    assert "<" not in figure_json({"data": [{"name": evil}]})


def test_a_page_that_cannot_be_written(run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FlightError, match="file"):
        write_report(run, tmp_path / "file" / "report.html")


def test_verdicts(run: Run) -> None:
    words = verdict(run.summary)
    assert words.startswith("Flew all 8.00 s. Roll: 25 % overshoot, settled within 0.85 s, ")
    assert "Pitch" not in words
    lost = flown(1500, "diverged", "leaned past 90 deg", change=turning)
    assert verdict(lost.summary).startswith("Diverged after 6.00 s of 8 s: leaned past 90 deg.")
    still = flown(100, change=lambda s: s._replace(command=Command((0.0, 0.0, 0.0), 30.0)))
    assert "Largest attitude error" in verdict(still.summary)
    assert verdict(flown(0, "failed", "nothing").summary) == "Failed after 0.00 s of 8 s: nothing."


def test_runs_are_laid_over_each_other(tmp_path: Path) -> None:
    ringing = flown(folder=tmp_path / "a", controller="baseline", change=swung(1.5))
    calm = flown(folder=tmp_path / "b")
    path = tmp_path / "comparison.html"
    compare_report([ringing, calm], path)
    page = Page(path)
    told = page.figures.pop("flight-data")
    assert page.places == set(told["figures"])
    assert not page.figures  # no figure that is thinned out
    assert [said["label"] for said in told["runs"]] == ["baseline", "smith", "smith less baseline"]
    roll = told["figures"]["first"]["panels"][0]["signals"]
    assert [(signal["run"], signal["column"], signal["label"]) for signal in roll] == [
        (0, "roll_rad", "baseline"),
        (1, "roll_rad", "smith"),
        (0, "roll_setpoint_rad", "set-point"),
    ]
    (apart,) = told["figures"]["difference"]["panels"][0]["signals"]
    assert (apart["run"], apart["column"]) == (2, "roll_rad_less")
    assert apart["column"] in {column["name"] for column in told["runs"][2]["columns"]}
    links = [attrs["href"] for tag, attrs in page.elements if tag == "a"]
    assert links == ["a/report.html", "b/report.html"]
    assert all((tmp_path / str(link)).is_file() for link in links)
    cells = [attrs for tag, attrs in page.elements if tag == "span" and attrs.get("class") == "best"]
    assert cells
    values = [f"{run.metrics['roll'].overshoot_percent:.1f}" for run in (ringing, calm)]
    assert f"Overshoot {values[0]} {values[1]} %" in page.text


def test_the_set_point_is_that_of_the_longest_run(run: Run) -> None:
    flights = [ComparedFlight("abc"[n], each.log, each) for n, each in enumerate((flown(500), run, flown(100)))]
    figures = comparison_figures(flights, {})
    last = figures["attitude"]["panels"][0]["signals"][3:]
    assert [(signal["run"], signal["label"]) for signal in last] == [(1, "set-point")]


def test_one_run_can_be_compared_with_nothing(run: Run, tmp_path: Path) -> None:
    compare_report([run], tmp_path / "one.html")
    assert "smith" in Page(tmp_path / "one.html").text
