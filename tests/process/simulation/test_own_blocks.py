"""Metrics, winds, sensors and observers of the user's: exact where they can be, recorded, refused in one line."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_tools import Hexjet, install
from places import of_page

from cosim import InputError, Scenario, fly
from cosim.base.frames import conjugate, jet_axis, rotate
from cosim.campaign.run import run_campaign
from cosim.campaign.study.options import open_study
from cosim.campaign.study.plan import flights
from cosim.campaign.workers.flight_row import fly_one
from cosim.results.report.comparison import comparison_rows
from cosim.simulation.build import build
from cosim.simulation.plugins import WindTable, find_block
from hexjet_prove.search.search import describe_flight

SHORT = Scenario.load("roll-doublet").replace(duration_s=0.2, expect=[])
STEADY = (2.0, -3.0, 0.5)


@pytest.fixture
def mine(tmp_path: Path) -> str:
    return str(of_page("blocks", tmp_path / "mine.py"))


def bits(run: Any) -> dict[str, bytes]:
    return {name: run.log[name].tobytes() for name in run.log.columns}


def test_a_wind_that_is_the_same_everywhere_is_the_environments_to_the_last_bit(tmp_path: Path) -> None:
    (tmp_path / "steady.csv").write_text("time_s,north_m_s,east_m_s,down_m_s\n0,2,-3,0.5\n", encoding="utf-8")
    (tmp_path / "field.py").write_text(
        "class Steady:\n    def velocity(self, time, north, east, height):\n        return (2.0, -3.0, 0.5)\n"
    )
    base = Scenario.load("full-scale-hover").replace(duration_s=0.2, expect=[])  # its engines feel the air
    ours = bits(fly(base.replace(environment={"wind_ned_m_s": STEADY})))
    assert ours != bits(fly(base))
    for name in ("steady.csv", "field.py:Steady"):
        assert bits(fly(base.replace(wind=str(tmp_path / name)))) == ours


def test_each_engine_feels_the_wind_at_its_own_place(mine: str) -> None:
    """The air into each intake is that of the field there, and so is the drag: against the law, jet by jet."""
    scenario = Scenario.load("full-scale-hover").replace(duration_s=1.0, expect=[], wind=f"{mine}:Shear")
    with build(scenario) as simulation:
        for _ in range(3):
            simulation.step()
        state, propulsion, jets = simulation.state, simulation.propulsion, simulation.vehicle.jets
        simulation.step()
        air = np.array(propulsion.ambient(state, state.wind).air_speed)

        def blows(height: float, east: float) -> np.ndarray:
            return np.array([0.2 * height, 0.0, 0.5 * east])

        for speed, jet in zip(air, jets, strict=True):
            _, east, down = np.add(state.position, rotate(state.attitude, jet.position_m))
            height = state.altitude - (down - state.position[2])
            # state.wind is the field at the centre of gravity, a step ago: what was added there counts
            there = state.wind + blows(height, east) - blows(state.altitude, state.position[1])
            through = rotate(conjugate(state.attitude), tuple((state.velocity - there).tolist()))
            turning = np.cross(state.rate, jet.position_m)
            axis = jet_axis(propulsion.tilt[jet.servo == "right"])
            assert speed == pytest.approx(np.dot(through + turning, axis), abs=1e-9)
        left, right = (air[[jet.servo == side for jet in jets]].mean() for side in ("left", "right"))
        assert abs(left - right) > 0.1


def test_a_table_is_straight_between_its_rows_and_held_at_its_ends(tmp_path: Path) -> None:
    path = tmp_path / "gusts.csv"
    path.write_text("time_s,north_m_s,east_m_s,down_m_s\n1,0,2,0\n3,4,0,-1\n", encoding="utf-8")
    table = WindTable.read(path)
    found = {time: table.velocity(time, 0.0, 0.0, 0.0) for time in (0.0, 1.0, 2.0, 3.0, 9.0)}
    assert found == {0.0: (0, 2, 0), 1.0: (0, 2, 0), 2.0: (2, 1, -0.5), 3.0: (4, 0, -1), 9.0: (4, 0, -1)}


HEAD = "time_s,north_m_s,east_m_s,down_m_s\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,north\n", "line 1: the first column must be time_s"),
        ("time_s,north_m_s\n", "line 1: must be time_s,north_m_s,east_m_s,down_m_s"),
        (HEAD, "no rows of data"),
        (f"{HEAD}0,1,2\n", "line 2: 3 cells, the header has 4"),
        (f"{HEAD}0,1,2,nan\n", "line 2: 'nan' is not a finite number"),
        (f"{HEAD}1,0,0,0\n1,0,0,0\n", "line 3: time_s does not grow"),
    ],
)
def test_a_table_that_does_not_do_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "w.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(message)):
        build(SHORT.replace(wind=str(tmp_path / "w.csv")))


def test_sensors_change_what_is_measured_and_no_other_noise(mine: str) -> None:
    run, plain = (fly(SHORT.replace(controller="baseline", sensors=name)) for name in (f"{mine}:Drifting", None))
    drift = run.log["barometer_drift_m"]
    assert drift.std() > 0.0
    # row 1 is measured before anything could follow from the drift: the gyro's noise is what it was
    assert run.log["rate_p_measured_rad_s"][:2].tolist() == plain.log["rate_p_measured_rad_s"][:2].tolist()
    assert bits(fly(SHORT.replace(controller="baseline", sensors=f"{mine}:Drifting"))) == bits(run)


def test_an_observer_sees_every_step_and_changes_none(mine: str, capsys: pytest.CaptureFixture[str]) -> None:
    run = fly(SHORT.replace(observers=[f"{mine}:Highest"]))
    assert bits(run) == bits(fly(SHORT))
    assert capsys.readouterr().out == f"highest at {run.log['altitude_m'].max():.2f} m\n"


def test_a_metric_is_in_summary_expectations_and_comparison(mine: str) -> None:
    expect = [{"controller": "smith", "engine": "edf-as-flown", "metrics": {"own.swing_rad": {"max": -1.0}}}]
    run = fly(SHORT.replace(metrics=[f"{mine}:Swing"], expect=expect))
    roll = np.abs(run.log["roll_rad"])
    assert run.summary.own_metrics == {"own.swing_rad": roll.max(), "own.swing_at_s": run.log["time_s"][roll.argmax()]}
    assert run.summary.verdict == "not as expected"
    assert run.summary.complaints == [f"own.swing_rad = {roll.max():.6g}, expected at most -1"]
    assert "Own swing" in [row["title"] for row in comparison_rows([run.summary])]
    expect[0]["metrics"] = {"own.swing": {"max": 1.0}}
    with pytest.raises(InputError, match=r"unknown 'own\.swing'; did you mean 'own\.swing_rad'"):
        fly(SHORT.replace(metrics=[f"{mine}:Swing"], expect=expect))


def test_a_campaign_has_it_in_every_row_and_counts_by_it(mine: str, tmp_path: Path) -> None:
    settings = ["duration_s=0.2", f"metrics={json.dumps([mine + ':Swing'])}"]
    study = open_study("roll-doublet", vary=["vehicle.mass_kg=5,6"], settings=settings, success=["own.swing_rad<=1e-9"])
    campaign = run_campaign(study, tmp_path / "campaign", workers=1)
    Path(mine).unlink()  # it has a copy
    row = fly_one(campaign.study, flights(campaign.study)[1])
    there = campaign.columns
    assert there["own.swing_rad"][1] == row["own.swing_rad"] > 0.0
    assert not any(there["success"])
    assert "own.swing_rad = " in describe_flight(study, row)
    assert re.fullmatch("metrics mine.py:Swing [0-9a-f]{64}", str(row["brought_sha256"]))


def test_a_metric_that_fails_says_so_and_the_flight_stands(tmp_path: Path) -> None:
    given = {"raises": "log['nothing']", "two": "{'two': 1.0, 'three': 2.0}", "good": "float('inf')"}
    text = "\n".join(f"def {name}(log, step_s):\n    return {value}\n" for name, value in given.items())
    (tmp_path / "bad.py").write_text(text)
    run = fly(SHORT.replace(metrics=[f"{tmp_path / 'bad.py'}:{name}" for name in given]))
    assert run.outcome == "completed"
    assert run.summary.own_metrics == {"own.raises": None, "own.two": None, "own.good": None}
    first, second = run.summary.own_metrics_failed
    assert first.startswith("metric bad.py:raises: ")
    assert second == "metric bad.py:two: gave two, three: must be two"


def test_a_run_has_the_files_and_flies_them_again_or_says_what_is_another(mine: str, tmp_path: Path) -> None:
    lists = {"metrics": [f"{mine}:Swing"], "observers": [f"{mine}:Highest"]}
    run = fly(SHORT.replace(**lists, sensors=f"{mine}:Drifting", wind=f"{mine}:Shear"), tmp_path / "run", report=False)
    Path(mine).unlink()
    assert [each.key for each in run.summary.brought] == ["metrics", "observers", "sensors", "wind"]
    again = fly(tmp_path / "run" / "scenario.toml")
    assert bits(again) == bits(run)
    assert again.summary.own_metrics == run.summary.own_metrics
    copy = tmp_path / "run" / "mine.py"
    copy.write_text(copy.read_text(encoding="utf-8") + "# edited\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"metric mine\.py:Swing is not the one that was flown"):
        fly(tmp_path / "run" / "scenario.toml")


WRONG = """
class Wind:
    def velocity(self, time, north, east, height):
        return (0.0, 1.0 / (0.0 if time > 0.01 else 1.0), 0.0)

class Blind:
    def observe(self, sample):
        raise ValueError("no")

class Nothing:
    def reset(self, state, measured):
        return measured
    def sample(self, state, measured):
        return None

class Nan(Nothing):
    def sample(self, state, measured):
        return measured._replace(altitude=float("nan"))
"""


@pytest.mark.parametrize(
    ("key", "name", "reason"),
    [
        ("wind", "Wind", "wind wrong.py:Wind: velocity raised ZeroDivisionError"),
        ("sensors", "Nothing", "sensors wrong.py:Nothing: sample gave NoneType: must be a Measured"),
        ("sensors", "Nan", "sensors wrong.py:Nan: altitude = nan: must be finite"),
        ("observers", "Blind", "observer wrong.py:Blind: observe raised ValueError: no"),
    ],
)
def test_what_goes_wrong_in_flight_ends_it_and_is_named(tmp_path: Path, key: str, name: str, reason: str) -> None:
    (tmp_path / "wrong.py").write_text(WRONG, encoding="utf-8")
    given = f"{tmp_path / 'wrong.py'}:{name}"
    run = fly(SHORT.replace(**{key: [given] if key == "observers" else given}))
    assert run.outcome == "failed"
    assert reason in run.reason


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"metrics": ["nobody"]},
            "metric nobody: must be FILE.py:Name, package.module:Name or an entry point of hexjet.metrics",
        ),
        ({"wind": "nobody"}, "wind nobody: must be FILE.csv, FILE.py:Name"),
        ({"wind": "none.csv"}, "no such file"),
        ({"metrics": ["cosim.nothing:x"]}, "cosim.nothing cannot be imported"),
        ({"observers": ["cosim.results.metrics:wrap"]}, "observer cosim.results.metrics:wrap: must be a class"),
        ({"sensors": "fractions:Fraction"}, "has no reset(state, measured)"),
        ({"metrics": ["cosim.results.metrics:wrap"]}, "must take (log, step_s)"),
    ],
)
def test_wrong_names_are_one_line(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        build(SHORT.replace(**changes))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_the_command_takes_them_from_here(mine: str, hexjet: Hexjet) -> None:
    asked = "--set duration_s=0.1 --metric mine.py:Swing --wind mine.py:Shear --out run --json"
    told = json.loads(hexjet("fly", "roll-doublet", *asked.split()).told)
    assert list(told["own_metrics"]) == ["own.swing_rad", "own.swing_at_s"]
    assert "did you mean" in hexjet("fly", "roll-doublet", "--metric", "mine.py:Swings").refusal


@pytest.mark.parametrize(
    "text", ["[hexjet.winds]\nshear = mine:Shear\n", "[hexjet.plugins]\nwind.shear = mine:Shear\n"]
)
def test_an_entry_point_brings_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mine: str, text: str) -> None:
    place = install(tmp_path, "my-blocks", "1.2", text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.syspath_prepend(place)
    found = find_block("wind", "shear", tmp_path)
    assert (found.version, list(found.files), found.is_copied) == ("my-blocks 1.2", ["mine.py"], False)
