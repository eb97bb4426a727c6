"""From the table [uncertainty] of an engine to the verdict of a campaign, without a number typed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from campaign_tools import without_chance
from uncertain_engines import fan

from cosim.campaign.run import fly_again, run_campaign
from cosim.campaign.store import Campaign
from cosim.campaign.study.options import open_study
from cosim.campaign.study.study import Study
from hexjet_prove.surveys.failsafes import Conditions, failsafes
from hexjet_prove.surveys.faults import survival

DESIGN = str(Path(__file__).parents[2] / "designs" / "edf.toml")


def study(file: Path, runs: int, duration: float) -> Study:
    settings = [f"engine={file}", "controller=baseline", f"duration_s={duration}", "engine_unchecked=true"]
    return open_study("roll-doublet", vary=["engine"], settings=settings, runs=runs)


def rows(campaign: Campaign) -> list[dict[str, Any]]:
    return sorted(
        (without_chance(campaign.row(number)) for number in range(campaign.of)), key=lambda row: row["flight"]
    )


def test_a_wider_table_changes_the_verdict(tmp_path: Path) -> None:
    """Two mapping files that differ in the deviation of the delay alone, 1 and 10 samples."""
    (tmp_path / "sure").mkdir()
    (tmp_path / "unsure").mkdir()
    outcomes = {}
    for name, deviation in (("sure", 1.0), ("unsure", 10.0)):
        file = fan(tmp_path / name, [deviation, 0.001, 0.005])
        flown = run_campaign(study(file, 5, 6.0), tmp_path / name / "flown", workers=1)
        outcomes[name] = flown.columns["outcome"]
        assert flown.columns["mismatch.engine_parameters.delay_samples"]
    assert outcomes["sure"] == ["completed"] * 5
    assert "diverged" in outcomes["unsure"]


def test_the_same_flights_on_any_number_of_workers_resumed_and_again(tmp_path: Path) -> None:
    file = fan(tmp_path, [3.0, 0.006, 0.02], [1.0, 0.002, 0.01])
    alone = run_campaign(study(file, 4, 0.4), tmp_path / "alone", workers=1)

    def stop(tally: object, done: int, of: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(study(file, 4, 0.4), tmp_path / "resumed", 2, progress=stop)
    fan(tmp_path, [9.0, 0.006, 0.02])  # the folder has a table of its own
    resumed = run_campaign(None, tmp_path / "resumed", workers=2, resume=True)
    assert rows(resumed) == rows(alone)
    assert len({row["mismatch.stations.3.gain"] for row in rows(alone)}) == 4
    again = fly_again(alone, 2, tmp_path / "again")
    assert again.same


def test_surveys_draw_the_engine_for_each_case_the_same_for_every_controller(tmp_path: Path) -> None:
    file = str(fan(tmp_path, [3.0, 0.006, 0.02], [1.0, 0.002, 0.01]))
    chosen: dict[str, Any] = {"controllers": ("baseline", DESIGN), "kinds": ("none", "gyro bias"), "workers": 1}
    drawn = survival("hexjet", file, **chosen)
    assert drawn.engine_note.startswith("the engine of each flight is drawn by the engine's [uncertainty]")
    assert "; --nominal-engine flies it as it is stated" in drawn.to_dict()["engine_note"]
    engines = [tuple(scenario.mismatch.engine_parameters.values()) for scenario in drawn.scenarios]
    assert engines[::2] == engines[1::2]
    assert len(set(engines)) == len(engines) / 2 == 4
    assert all(len(scenario.mismatch.stations) == 6 for scenario in drawn.scenarios)
    part = survival("hexjet", file, **chosen | {"kinds": ("gyro bias",)})
    assert part.rows == [row for row in drawn.rows if row.kind.startswith("gyro bias")]
    nominal = survival("hexjet", file, **chosen | {"kinds": ("none",)}, nominal_engine=True)
    assert "is not drawn" in nominal.engine_note
    assert not nominal.scenarios[0].mismatch.engine_parameters
    conditions = Conditions((3.0,), (0.0,), airborne=True)
    (survey,) = failsafes(["hexjet"], file, "baseline", ["barometer"], conditions, workers=1)
    assert survey.to_dict()["engine_note"] == drawn.engine_note
    assert survey.flights[0].scenario.mismatch.engine_parameters
