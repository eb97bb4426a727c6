"""Rare failures of flights: a known truth, and the same rows however, wherever and how often they are flown."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from math import erfc, radians, sqrt
from pathlib import Path
from typing import Any

import campaign_tools as tools
import pytest
from campaign_tools import windy, without_chance

from cosim import fly
from cosim.base.errors import FlightError, InputError
from cosim.campaign import open_campaign
from cosim.campaign.study.plan import Flight
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import Row
from cosim.campaign.workers.local import LocalWorkers
from cosim.cli.main import run
from cosim.results.log.digest import log_digest
from cosim.spec.scenario import Scenario
from hexjet_prove.rare.estimate import Budget
from hexjet_prove.rare.folder import SavedRare, resolve_rare, run_rare
from hexjet_prove.rare.simulation import Plan

WIND, ROLL = "environment.wind_ned_m_s.1", "initial.attitude_deg.0"
KNOWN = 0.5 * erfc(2.5 / sqrt(2.0))  # of windy: 0.0062
SMALL = Plan(Budget(1e-3, 1600))


class Here:
    """Workers that fly one flight after the other, backwards, and stop after so many."""

    def __init__(self, fly: Callable[[Study, Flight], Row] = windy, most: int | None = None) -> None:
        self.act, self.most, self.flown = fly, most, 0

    def fly(self, study: Study, planned: Iterable[Flight]) -> Iterator[Row]:
        for flight in reversed(list(planned)):
            if self.flown == self.most:
                raise FlightError("stopped")
            self.flown += 1
            yield self.act(study, flight)


def known() -> Study:
    vary = [f"{WIND}=normal(0,1)", "vehicle.mass_kg=5.4:5.8"]
    return tools.study(vary=vary, controllers=["smith"], runs=1, design="random")


def tilted(limit_deg: float) -> Study:
    """A hover of 0.1 s that begins leaned: its largest error is where it begins, and so fails beyond a known lean."""
    study, _ = resolve_rare(
        "hover",
        budget=5000,
        vary=[f"{ROLL}=normal(0,1)"],
        settings=["duration_s=0.1"],
        controllers=["smith"],
        success=[f"roll.max_abs_error_rad<={radians(limit_deg)!r}"],
    )
    return study


def rows(saved: SavedRare) -> list[Row]:
    campaign = open_campaign(saved.folder)
    return [without_chance(campaign.row(number)) for number in range(len(campaign))]


def result(saved: SavedRare) -> dict[str, Any]:
    table: dict[str, Any] = json.loads((saved.folder / "rare.json").read_text())
    return {name: value for name, value in table.items() if name not in ("folder", "cases", "confirmed")}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> SavedRare:
    """A known truth, flown at one go."""
    return run_rare(known(), SMALL, tmp_path_factory.mktemp("rare") / "whole", Here())


def test_a_known_truth_is_in_the_interval_and_all_is_kept(whole: SavedRare) -> None:
    found = whole.result.estimate
    assert found.low < KNOWN < found.high < 5.0 * found.low
    assert whole.result.sentence == (
        f"hover with smith fails with a probability of {found.text} after {whole.result.flights:,} flights; seeds of "
        "wind and noise are part of what varies"
    )
    assert len(rows(whole)) == whole.result.flights <= 1600
    assert whole.result.searched.distance == pytest.approx(2.5, abs=0.02)
    assert whole.result.contradiction == ""
    nearest = whole.result.nearest
    assert nearest is not None
    assert nearest.distance == pytest.approx(2.5, abs=0.2)
    assert [shift.name for shift in whole.result.shifts] == [WIND, "vehicle.mass_kg"]
    assert whole.result.shifts[0].mean == pytest.approx(2.8, abs=0.2)  # of a normal number above 2.5: 2.82
    assert whole.result.deciders == {}  # nobody flew
    page = (whole.folder / "rare.html").read_text()
    assert found.text in page
    assert "What the failures have in common" in page
    for case in whole.cases:
        assert ", ".join(f"{key} = {value:.6g}" for key, value in case.values.items()) in page


def test_the_same_rows_whoever_flies(whole: SavedRare, tmp_path: Path) -> None:
    with LocalWorkers(2, fly=windy) as workers:
        other = run_rare(known(), SMALL, tmp_path / "other", workers)
    assert (rows(other), result(other)) == (rows(whole), result(whole))


def test_what_was_stopped_goes_on_to_the_same(whole: SavedRare, tmp_path: Path) -> None:
    """Twice, and the second time in the middle of a line of the journal; nothing is flown twice."""
    flown = []
    for most in (150, 700, None):
        workers = Here(most=most)
        if most is None:
            other = run_rare(known(), SMALL, tmp_path / "other", workers, resume=True)
        else:
            with pytest.raises(FlightError, match="stopped"):
                run_rare(known(), SMALL, tmp_path / "other", workers, resume=True)
            with open(tmp_path / "other" / "flights.jsonl", "a", encoding="utf-8") as file:
                file.write('{"controller": "smi')
        flown.append(workers.flown)
    assert sum(flown) == whole.result.flights
    assert (rows(other), result(other)) == (rows(whole), result(whole))


def test_true_flights_beyond_a_known_lean(tmp_path: Path) -> None:
    """Both sides of a normal number: 2 (1 - Phi(2.5758)) = 1 %.  The most likely failure flies again bit for bit."""
    plan = Plan(Budget(1e-2, 600, repeats=4), seeds_vary=False)
    with LocalWorkers(2) as workers:
        saved = run_rare(tilted(2.5758), plan, tmp_path / "tilted", workers)
    assert saved.result.estimate.low < 0.01 < saved.result.estimate.high
    assert "seeds of wind and noise are not part of what varies" in saved.result.sentence
    assert {row["seed"] for row in saved.result.rows} == {saved.result.rows[0]["seed"]}
    assert saved.result.deciders == {"roll.max_abs_error_rad": pytest.approx(1.0)}
    assert saved.confirmed
    first = saved.cases[0]
    assert 2.5758 - 1e-4 < first.distance < 2.7
    again = fly(Scenario.load(tmp_path / "tilted" / "cases" / first.name / "scenario.toml"))
    assert log_digest(again.log) == saved.result.rows[first.flight]["log_sha256"]


def test_a_folder_is_of_one_simulation(whole: SavedRare, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"already holds a campaign \(study.toml\); resume goes on with it"):
        run_rare(known(), SMALL, whole.folder, Here())
    with pytest.raises(InputError, match=r"holds another study; plan: flights is 1600 there and 1700 here"):
        run_rare(known(), Plan(Budget(1e-3, 1700)), whole.folder, Here(), resume=True)
    with pytest.raises(InputError, match=r"holds another study; study.toml: seed is 1 there and 4 here"):
        run_rare(known().changed(seed=4), SMALL, whole.folder, Here(), resume=True)
    with pytest.raises(
        InputError, match=r"holds another study; study.toml: controllers is \['smith'\] there and \[\] here"
    ):
        run_rare(known().changed(controllers=[]), SMALL, whole.folder, Here(), resume=True)
    (tmp_path / "rare.toml").touch()
    for resume in (False, True):
        with pytest.raises(InputError, match=r"is a search of version 0\.2\.0; its page shows it"):
            run_rare(known(), SMALL, tmp_path, Here(), resume=resume)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["hover", "--vary", "vehicle.mass_kg=5:6:3"], "has 3 levels, which only a grid has"),
        (["hover", "--vary", "vehicle.mass_kg=5:6", "--budget", "100"], "budget 100: 8 repeats of 7 levels"),
        (["hover", "--vary", "vehicle.mass_kg=5:6", "--resume"], "resume: give the folder of the simulation"),
    ],
)
def test_what_cannot_be_asked_is_one_line(arguments: list[str], message: str) -> None:
    with pytest.raises(InputError) as refused:
        run(["search", "--rare", *arguments])
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_failure_that_comes_out_otherwise_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rows that nobody flew: the cases are flown, and are not as the rows say; the status is 1."""
    monkeypatch.setattr("cosim.studies.choose_workers", lambda *_: nullcontext(Here()))
    varied = ["--vary", f"{WIND}=normal(0,1)", "--controller", "smith", "--set", "duration_s=0.1"]
    asked = ["hover", *varied, "--target", "1e-2", "--budget", "1200", "--out", str(tmp_path / "rare")]
    assert run(["search", "--rare", *asked]) == 1
    shown = capsys.readouterr().out
    assert shown.startswith("hover with smith fails with a probability of ")
    assert "failure-1: flight " in shown
    assert "flown again NOT the same" in shown
