"""Flights beside each other: the time base, what a difference is, logs of other tools, and what is refused."""

from __future__ import annotations

import json
import re
from math import nan, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flights import exported, record

from cosim.base.errors import InputError
from cosim.cli.main import run as run_command
from cosim.flight import write_run_page
from cosim.results.comparison import ComparedFlight, Signal, compare_with_first, list_input_differences, make_time_base
from cosim.results.log import readers
from cosim.results.log.arrow import write_table
from cosim.results.log.columns import COLUMNS
from cosim.results.log.readers import read_flight_log
from cosim.results.log.recorder import MemoryLog
from cosim.results.report.comparison import comparison_rows, describe_pair, write_comparison
from cosim.results.report.flight_figures import comparison_figures, subtract_first
from cosim.results.run import Run


def log(step: float, rows: int, **columns: Any) -> MemoryLog:
    times = step * np.arange(rows)
    made = {"time_s": times} | {name: np.broadcast_to(values, rows) for name, values in columns.items()}
    return MemoryLog([np.stack(list(made.values()))], tuple(made))


def only(first: MemoryLog, second: MemoryLog) -> Signal:
    return compare_with_first([ComparedFlight("A", first), ComparedFlight("B", second)])[0].signals[0]


def test_a_difference_is_known_by_its_size_its_root_mean_square_and_its_first_step() -> None:
    values = np.zeros(100)
    values[40:44] = (0.1, -0.3, 0.2, 0.0)
    signal = only(log(0.01, 100, altitude_m=5.0), log(0.01, 100, altitude_m=5.0 + values))
    assert (signal.same, signal.first_step) == (False, 40)
    assert signal.first_s == pytest.approx(0.4)
    assert (signal.largest, signal.largest_s) == (pytest.approx(0.3), pytest.approx(0.41))
    assert signal.rms == pytest.approx(np.sqrt(0.14 / 100))


def test_angles_differ_the_short_way_round_and_numbers_that_are_alone_are_counted() -> None:
    assert only(log(0.1, 9, yaw_rad=pi - 0.01), log(0.1, 9, yaw_rad=0.01 - pi)).largest == pytest.approx(0.02)
    signal = only(log(0.1, 3, altitude_m=[1.0, nan, nan]), log(0.1, 3, altitude_m=[1.0, 2.0, nan]))
    assert (signal.same, signal.first_step, signal.largest, signal.alone) == (False, 1, 0.0, 1)


@pytest.mark.parametrize(("left", "right", "same"), [(nan, -nan, True), (0.0, -0.0, False), (1.0, 1.0 + 1e-15, False)])
def test_the_same_is_the_same_to_the_last_bit(left: float, right: float, same: bool) -> None:
    (pair,) = compare_with_first(
        [ComparedFlight("A", log(0.1, 5, altitude_m=left)), ComparedFlight("B", log(0.1, 5, altitude_m=right))]
    )
    assert pair.same is same
    assert ("to the last bit: 5 steps" in describe_pair(pair)[0]) is same


@pytest.mark.parametrize("finer", [0, 1])
def test_where_steps_differ_the_longer_ones_are_held(finer: int) -> None:
    """A staircase of steps of 0.02 s, in steps of 0.004 s too, is the same; k * dt is rounded and does not matter."""
    coarse = np.arange(20.0)
    logs = [log(0.004, 100, altitude_m=np.repeat(coarse, 5)), log(0.02, 20, altitude_m=coarse)]
    first, second = logs[:: 1 - 2 * finer]
    (pair,) = compare_with_first([ComparedFlight("A", first), ComparedFlight("B", second)])
    assert (pair.steps, pair.steps_of, pair.held) == (100, "AB"[finer], "BA"[finer])
    assert pair.signals[0].same
    assert not pair.same  # the logs are not
    assert make_time_base(logs[0], logs[0]).held_log == 0


def test_a_shorter_flight_is_compared_as_far_as_it_goes() -> None:
    one, other = log(0.1, 50, altitude_m=1.0), log(0.1, 20, altitude_m=1.0)
    (pair,) = compare_with_first([ComparedFlight("A", one), ComparedFlight("B", other)])
    assert (pair.steps, pair.ends_s, pair.signals[0].same, pair.same) == (20, pytest.approx(1.9), True, False)
    late = MemoryLog([np.stack([100.0 + np.arange(3.0), np.zeros(3)])], ("time_s", "altitude_m"))
    (pair,) = compare_with_first([ComparedFlight("A", one), ComparedFlight("B", late)])
    assert describe_pair(pair) == ["A and B have no time in common."]


def flown(steps: int = 500, folder: Path | None = None) -> Run:
    return write_run_page(record(steps, folder))


def test_a_page_of_runs_and_a_log_of_another_tool(tmp_path: Path) -> None:
    times = [0.2 + 0.01 * k for k in range(100)]
    write_table(tmp_path / "x.parquet", {"t": times, "roll_rad": times, "note": ["a"] * 100, "on_ground": [True] * 100})
    other, remarks = read_flight_log(tmp_path / "x.parquet")
    assert other.columns == ("time_s", "roll_rad", "on_ground")
    assert remarks == ("t is taken for the time in seconds", "left out, being no numbers: note")
    runs = [ComparedFlight("A: a", flown().log, flown()), ComparedFlight("B: x", other, None, "x", remarks)]
    compared = compare_with_first(runs)
    assert compared[0].begins_s == pytest.approx(0.2)
    write_comparison(runs, compared, tmp_path / "page.html")
    page = " ".join((tmp_path / "page.html").read_text(encoding="utf-8").split())
    assert "B: x against A: a" in page
    assert 'data-figure="difference"' in page
    assert 'data-figure="track"' in page
    assert "t is taken for the time" in page


def test_the_least_is_marked_only_where_the_scenario_is_the_same() -> None:
    one, other = flown(600).summary, flown(300).summary
    marked = lambda rows: any(cell["best"] for row in rows for cell in row["cells"])  # noqa: E731
    assert marked(comparison_rows([one, other, None]))
    assert not marked(comparison_rows([one, other.model_copy(update={"scenario": "else"})]))
    lost = other.model_copy(update={"outcome": "diverged"})
    assert not marked(comparison_rows([one, lost]))
    assert not any(row["cells"][2]["best"] for row in comparison_rows([one, other, lost]))


def test_what_went_in_and_is_not_the_same_is_named(tmp_path: Path) -> None:
    run = flown(10)
    heavier = run.__class__(run.summary, run.log, None, run.scenario.replace(seed=7, vehicle={"mass_kg": 6.0}))
    assert ("seed", "1", "7") in list_input_differences(run, heavier)
    assert ("vehicle.mass_kg", "-", "6.0") in list_input_differences(run, heavier)
    assert list_input_differences(run, run) == []


def test_a_figure_of_logs_has_the_panels_that_there_are_and_the_times_of_each() -> None:
    times = np.array([2.0, 2.5, 4.0])
    logs = [MemoryLog([np.stack([times, gain * times])], ("time_s", "roll_rad"), COLUMNS[:2]) for gain in (1.0, 0.5)]
    flights = [ComparedFlight("A", logs[0]), ComparedFlight("B", logs[1])]
    less = subtract_first(flights)
    figures = comparison_figures(flights, less)
    assert set(figures) == {"first", "difference"}
    for name, drawn in (("first", [(0, "roll_rad"), (1, "roll_rad")]), ("difference", [(2, "roll_rad_less")])):
        (panel,) = figures[name]["panels"]
        assert [(signal["run"], signal["column"]) for signal in panel["signals"]] == drawn
    np.testing.assert_array_equal(less[1]["time_s"], times)
    np.testing.assert_array_equal(less[1]["roll_rad_less"], -0.5 * times)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("roll_rad\n1\n2\n", "no column of time; allowed: time_s, time, t, in seconds"),
        ("t,roll_rad\n0,1\n", "1 rows; at least two"),
        ("t,roll_rad\n0,1\n1,2\n1,3\n", "row 3: t must be a number and grow"),
        ("t,phi\n0,1\n1,2\n", "no column is called as one of a flight's log"),
        ("t,roll_rad,roll_rad\n0,1,1\n1,2,2\n", "two columns are called 'roll_rad'"),
        ("t,roll_rad\n0,1\n1,2,3\n", "x.csv: "),
    ],
)
def test_logs_that_cannot_be_compared(content: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(content)
    with pytest.raises(InputError, match=re.escape(said)):
        read_flight_log(tmp_path / "x.csv")


def test_where_nothing_reads_logs_a_line_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.results.log.readers.list_tools", lambda group: [])
    monkeypatch.setattr("cosim.results.log.readers._readers", readers._readers.__wrapped__)
    path = tmp_path / "x.ulg"
    path.write_bytes(b"ULog")
    assert not readers.is_flight_log(path)
    with pytest.raises(InputError, match=r"x\.ulg: no package that reads logs is installed: hexjet_identify is one$"):
        read_flight_log(path)


def test_the_command_compares_runs_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in "ab":
        flown(50, tmp_path / name)
    a, b = str(tmp_path / "a"), str(tmp_path / "b")
    assert run_command(["compare", a, b, "--json", "--out", str(tmp_path / "c")]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["differences"][0]["same"] is True
    assert data["differences"][0]["steps"] == 50
    assert data["runs"][1]["metrics"] == flown(50).summary.flat_metrics
    assert Path(data["page"]).is_file()
    assert run_command(["compare", a, b, "--no-page"]) == 0
    said = capsys.readouterr().out
    assert "B: b is the same as A: a to the last bit: 50 steps, all columns." in said
    for arguments, wrong in (
        ([a], "1 flight; allowed: 2 to 8"),
        ([a, b, "--flight", "1"], "none of these is a campaign"),
        ([a, b, "--no-page", "--signal", "rol*x"], r"signal that the flights share is called 'rol.x'"),
        ([a, str(tmp_path / "none")], "no flight; allowed"),
        ([a, b, "--out", str(tmp_path / "c")], "is there already"),
    ):
        with pytest.raises(InputError, match=wrong.replace("*", r"\*")):
            run_command(["compare", *arguments])


def test_a_log_of_another_controller_beside_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same flight as ULog and as run differs by what floats lose; moved in time it differs by its noise."""
    record(200, tmp_path / "run")
    exported(tmp_path / "run", tmp_path / "flight.ulg")
    names = [str(tmp_path / "flight.ulg"), str(tmp_path / "run"), "--no-page", "--json"]
    largest = []
    for more in ([], ["--shift", "A=0.4"]):
        assert run_command(["compare", *names, *more]) == 0
        (pair,) = json.loads(capsys.readouterr().out)["differences"]
        largest.append(max(signal["largest"] or 0.0 for signal in pair["signals"].values()))
    assert largest[0] < 1e-4  # of an altitude of 30 m, as float
    assert largest[1] > 1e-3
    for wrong in ("C=1", "A", "=1", "B=nan"):
        with pytest.raises(InputError, match=r"a number of seconds|must be LETTER=SECONDS"):
            run_command(["compare", *names, "--shift", wrong])
