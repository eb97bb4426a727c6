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
