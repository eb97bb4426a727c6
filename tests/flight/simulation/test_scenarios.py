"""Every shipped scenario flies and comes to what it expects; what is wrong in a scenario is said in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from long_cases import long_case

from cosim import fly
from cosim.base.errors import InputError
from cosim.spec.scenario import Scenario, scenario_names

SHIPPED = {"hover", "roll-doublet", "pitch-doublet", "yaw-doublet", "manual", "payload-drop", "gust", "climb-and-land"}
EXPECTED = [(name, entry.controller, entry.engine) for name in scenario_names() for entry in Scenario.load(name).expect]
# Of the vehicles with other layouts make test flies some scenarios each, of the jetwing, whose flights are longest, none;
# of the p220's second model two.
LONG = (
    *(f"octojet-{name}" for name in ("flame-out-inner", "flame-out-in-wind", "roll-doublet", "pitch-doublet", "waypoints", "climb-and-land")),
    *(f"quadjet-{name}" for name in ("pitch-doublet", "yaw-doublet", "hover-in-wind", "waypoints", "gust", "velocity")),
    *(f"trijet-{name}" for name in ("roll-doublet", "yaw-doublet", "climb-and-land", "hover-in-wind", "waypoints", "gust")),
    *(name for name in scenario_names() if name.startswith("jetwing-")),
    "full-scale-hover-in-wind",
)  # fmt: skip


def is_long(name: str, controller: str, engine: str) -> bool:
    return name in LONG or (engine == "p220-2025" and name not in ("full-scale-roll-doublet", "full-scale-gust"))


def test_the_scenarios_are_there_and_say_what_they_are() -> None:
    assert set(scenario_names()) >= SHIPPED
    for name in scenario_names():
        scenario = Scenario.load(name)
        assert scenario.name == name
        assert scenario.title
        assert scenario.description
        own = (scenario.controller, scenario.engine)
        assert own in [(entry.controller, entry.engine) for entry in scenario.expect], name


@pytest.mark.parametrize(
    ("name", "controller", "engine"), [long_case(case) if is_long(*case) else case for case in EXPECTED]
)
def test_scenario_comes_to_what_it_expects(name: str, controller: str, engine: str) -> None:
    """And keeps its limits, flown as it is."""
    scenario = Scenario.load(name)
    run = fly(scenario.replace(controller=controller, engine=engine))
    assert run.summary.complaints == [], f"{run.outcome}: {run.reason}"
    assert run.summary.expectations_met
    if (controller, engine) == (scenario.controller, scenario.engine):
        assert (run.summary.beyond, run.summary.verdict) == ([], "as planned")
        if name == "climb-and-land":
            log = run.log
            assert log["altitude_m"].max() == pytest.approx(5.0, abs=0.3)
            assert log["on_ground"][0] == log["on_ground"][-1] == 1.0
            assert not log["on_ground"][1500:3000].any()
            assert abs(log["velocity_down_m_s"][-250:]).max() < 0.01
            # the thrust goes away once it stands
            assert log["thrust_1_N"][-1] * 6 < 0.5 * 5.525 * 9.8


def test_a_classic_smith_predictor_leans_under_a_constant_moment() -> None:
    """The roll offset that a load off to the side leaves: K h T d over the attitude gain.

    The pole of the paper's model is 0.9999 and not 1, so the offset fades with its time constant of 40 s.
    """
    load = {"kind": "payload", "start_s": 1.0, "mass_kg": 0.5, "offset_m": [0.0, 0.01, 0.0]}
    run = fly(Scenario.load("payload-drop").replace(sensor_noise=False, disturbance=[load], duration_s=14.0, expect=[]))
    gain, delay, attitude_gain = 433.1, 25 * 0.004, 3.5
    carried = -run.log["torque_roll"][-500:].mean()
    # the load's moment about the common centre of gravity, per thrust at full throttle and lever
    assert carried == pytest.approx(0.5 * 9.8 * 0.01 / (6 * 0.15 * 20.005), rel=0.05)
    lean = gain * delay * np.exp(-0.025 * 12.0) * carried / attitude_gain
    assert run.log["roll_rad"][-500:].mean() == pytest.approx(lean, rel=0.05)


NAME, X = "name = 'x'\n", "name = 'x'\nduration_s = 1\n"
DOUBLET = "[[command]]\nkind = 'doublet'\nsignal = 'roll_deg'\nstart_s = 0\namplitude = 1\nwidth_ms = 2"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{NAME}duration_s = = 3\n", r"x\.toml: not valid TOML: .*line 2"),
        (NAME, r"x\.toml: is not a scenario, which has the key duration_s$"),
        (X + DOUBLET, r"command\.0\.width_s is missing; unknown key command\.0\.width_ms may be meant for it$"),
        (f"{X}command = 3", r"x\.toml: command = 3: must be a list$"),
        (
            f"{X}[command.0]\nkind = 'step'",
            r"x\.toml: command: there is no entry 0 to write over; a new list is \[\{\.\.\.\}\]$",
        ),
        (f"{NAME}duration_s = nan", r"x\.toml: duration_s = nan: .*(finite|greater)"),
        (f"{X}controler = 'smith'", r"unknown key 'controler'; did you mean 'controller'"),
        (
            f"{X}[[command]]\nkind = 'stp'",
            r"command\.0\.kind = 'stp': did you mean 'step'\? allowed: doublet, place, ramp, step, ",
        ),
    ],
)
def test_wrong_scenarios_are_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "x.toml").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        Scenario.load(tmp_path / "x.toml")
    assert "\n" not in str(caught.value)


def test_what_begins_after_the_end_is_told() -> None:
    doublet = Scenario.load("roll-doublet")
    assert doublet.after_the_end() == []
    late = doublet.replace(duration_s=0.5, fault=[{"kind": "flame_out", "start_s": 0.5, "jet": 1}])
    assert late.after_the_end() == [
        "command.0 begins at 1 s and the flight ends at 0.5 s",
        "fault.0 begins at 0.5 s and the flight ends at 0.5 s",
    ]


@pytest.mark.parametrize(("roll", "least"), [(0.0, 0.125), (30.0, 0.2)])
def test_a_start_with_the_legs_in_the_ground_is_refused(roll: float, least: float) -> None:
    """The springs threw it 1.4 m up."""
    low, high = (
        Scenario.load("hover", [f"initial.altitude_m={share * least}", f"initial.attitude_deg=[{roll},0,0]"])
        for share in (0.95, 1.3)
    )
    said = r"initial\.altitude_m = .*: hexjet would start .* m deep in the ground; at least"
    with pytest.raises(InputError, match=said):
        fly(low.replace(duration_s=0.1))
    fly(high.replace(duration_s=0.1))


def test_unknown_names_list_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "scenario.toml").touch()
    for name, said in (
        ("rol-doublet", r"unknown scenario 'rol-doublet'; did you mean 'roll-doublet', .*see: hexjet show"),
        (tmp_path / "none.toml", r"none\.toml: no such scenario file"),
        (tmp_path / "run", r"run is a run's folder; its scenario is .*run.scenario\.toml$"),
    ):
        with pytest.raises(InputError, match=said):
            Scenario.load(name)


def test_settings_write_over_the_file() -> None:
    settings = "vehicle.mass_kg=6.5 command.0.amplitude=5 engine=edf initial.velocity_ned_m_s=[1.0,0.0,0.0]"
    scenario = Scenario.load("roll-doublet", settings.split())
    assert (scenario.vehicle, scenario.engine) == ({"mass_kg": 6.5}, "edf")
    assert scenario.command[0].amplitude == 5.0  # type: ignore[union-attr]
    assert scenario.initial.velocity_ned_m_s == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("mass", "write it as KEY=VALUE"),
        ("command.7.amplitude=5", r"settings: command\.7: a number from 0 to 0 goes here"),
        ("title.x=5", r"settings: title is a value, not a table"),
        # what no float holds, and what Python reads no more
        (f"limits.drift_m=1{'0' * 5000}", r"limits\.drift_m = '?10+.*: must be a number"),
    ],
)
def test_wrong_settings_are_refused(setting: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Scenario.load("roll-doublet", [setting])
