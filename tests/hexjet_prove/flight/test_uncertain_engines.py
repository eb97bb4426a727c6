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
from cosim.campaign.study.plan import flights, scenario_of
from cosim.campaign.study.study import Study
from hexjet_prove.surveys.failsafes import Conditions, plan_failsafes
from hexjet_prove.surveys.faults import plan_faults

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
    plan = plan_faults("hexjet", file, ("baseline", DESIGN), ("none", "gyro bias"))
    assert plan.engine_note.startswith("the engine of each flight is drawn by the engine's [uncertainty]")
    assert "; nominal_engine flies it as it is stated" in plan.engine_note
    scenarios = [scenario_of(plan.study, flight) for flight in flights(plan.study)]
    engines = [tuple(scenario.mismatch.engine_parameters.values()) for scenario in scenarios]
    assert engines[::2] == engines[1::2]
    assert len(set(engines)) == len(engines) / 2 == 4
    assert all(len(scenario.mismatch.stations) == 6 for scenario in scenarios)
    part = plan_faults("hexjet", file, ("baseline", DESIGN), ("gyro bias",))
    assert part.study.case == [case for case in plan.study.case if case.name.startswith("gyro")]
    nominal = plan_faults("hexjet", file, ("baseline",), ("none",), nominal_engine=True)
    assert "is not drawn" in nominal.engine_note
    assert not scenario_of(nominal.study, flights(nominal.study)[0]).mismatch.engine_parameters
    failing = plan_failsafes("hexjet", file, "baseline", ["barometer"], Conditions((3.0,), (0.0,), airborne=True))
    assert failing.engine_note == plan.engine_note
    assert scenario_of(failing.study, flights(failing.study)[0]).mismatch.engine_parameters
