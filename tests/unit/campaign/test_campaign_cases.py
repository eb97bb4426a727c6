"""Named cases of a study: settings written over its scenario, a value of the key ``case`` in every row."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from cosim.base.errors import InputError
from cosim.campaign.run import fly_again, run_campaign
from cosim.campaign.study.options import open_study
from cosim.campaign.study.plan import flights, scenario_of
from cosim.campaign.study.study import Study

LOSS = {"name": "jet-1-weak", "settings": {"fault": [{"kind": "thrust_loss", "share": 0.3, "start_s": 0.1, "jet": 1}]}}
OTHER = {"name": "turbojet", "settings": {"engine": "turbojet", "seed": 7}}


def study(*cases: dict[str, Any], **more: Any) -> Study:
    table = {"name": "cases", "scenario": "hover", "design": "grid", "controllers": ["baseline"]} | more
    return Study.from_table(table | {"settings": {"duration_s": 0.2}, "case": list(cases)}, Path(), "study")


def test_each_case_is_flown_with_every_point_of_the_grid() -> None:
    several = study({"name": "nominal"}, LOSS, OTHER, vary=["vehicle.mass_kg=5.4,5.6"])
    flown = flights(several)
    points = [(flight.values["case"], flight.values["vehicle.mass_kg"]) for flight in flown]
    assert points == [(case, mass) for case in ("nominal", "jet-1-weak", "turbojet") for mass in (5.4, 5.6)]
    scenarios = [scenario_of(several, flight) for flight in flown]
    assert [len(scenario.fault) for scenario in scenarios] == [0, 0, 1, 1, 0, 0]
    assert [scenario.engine for scenario in scenarios[::2]] == ["edf-as-flown", "edf-as-flown", "turbojet"]
    assert [scenario.seed for scenario in scenarios[4:]] == [7, 7]
    assert len({scenario.seed for scenario in scenarios}) == 5


def test_a_campaign_of_cases_goes_on_and_flies_again(tmp_path: Path) -> None:
    several = study({"name": "nominal"}, LOSS, OTHER)

    def stop(tally: object, done: int, of: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(several, tmp_path / "out", 1, progress=stop)
    campaign = run_campaign(several, tmp_path / "out", 1, resume=True)
    assert campaign.columns["case"] == ["nominal", "jet-1-weak", "turbojet"]
    assert len(set(campaign.columns["log_sha256"])) == 3
    assert all(fly_again(campaign, number, report=False).same for number in range(3))


def test_the_command_line_chooses_among_cases(tmp_path: Path) -> None:
    study({"name": "nominal"}, LOSS, OTHER).save(tmp_path / "mine.toml")
    chosen = open_study(tmp_path / "mine.toml", vary=["case=nominal,turbojet"])
    assert [flight.values["case"] for flight in flights(chosen)] == ["nominal", "turbojet"]


@pytest.mark.parametrize(
    ("cases", "more", "message"),
    [
        ([LOSS, LOSS], {}, "case: jet-1-weak is there twice"),
        ([{"name": "a", "settings": {"duration": 1}}], {}, "case 'a': unknown key 'duration'"),
        ([{"name": "a", "settings": {"require": []}}], {}, ""),
        ([{"name": "a", "settings": {"require": [{"name": "b", "formula": "roll_deg < 1"}]}}], {}, "case 'a': require"),
        ([{"name": "a", "autopilot": {"hover_s": 1.0}}], {}, "case 'a': autopilot: the study has no table [autopilot]"),
        ([LOSS, OTHER], {"vary": ["engine=edf,edf-as-flown"]}, "vary engine: a case sets it"),
        ([LOSS], {"vary": ["case=jet-2-weak,jet-1-weak"]}, "case = jet-2-weak: must be one of jet-1-weak"),
    ],
)
def test_a_wrong_case_is_one_line(cases: list[dict[str, Any]], more: dict[str, Any], message: str) -> None:
    if not message:
        assert study(*cases)
        return
    with pytest.raises(InputError, match=re.escape(message)):
        study(*cases, **more)
