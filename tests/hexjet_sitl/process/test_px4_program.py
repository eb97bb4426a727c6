"""hexjet sitl px4 with a stand-in that is as unkind as PX4: it waits, goes deaf, ramps, bends, and has its own signs."""

from __future__ import annotations

import json
import socket
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from autopilot_standins import free_instance
from command_tools import Done, Hexjet
from px4_program import DEFAULTS, installed, ulog

from cosim.results.events import list_events
from cosim.results.run import open_run
from cosim.spec.scenario import Scenario
from hexjet_sitl.parameters import px4_parameters, px4_torque_scale

# What `hexjet design --for px4 --engine edf-as-flown` came to.
IN_ITS_LOOP = """controller = "baseline"
[vehicle.control.attitude]
gain_1_s = [1.87, 5.14, 5.9]
[vehicle.control.rate]
roll = { p = 0.0119, i = 0.013, d = 0.00076, d_filter_s = 0.00639, integral_limit = 0.1 }
pitch = { p = 0.217, i = 1.83, d = 0.00432, d_filter_s = 0.00639, integral_limit = 0.2 }
yaw = { p = 0.189, i = 1.78, d = 0.00361, d_filter_s = 0.00639, integral_limit = 0.2 }
[vehicle.control.altitude]
position_1_s = 0.707
velocity_1_s = 1.37
integral_1_s2 = 0.198
[design]
aircraft = "hexjet"
engine = "edf-as-flown"
family = "edf-as-flown"
engine_sha256 = ""
step_s = 0.004
substeps = 4
model = "as the page has it"
requirements = {}
axes = {}
"""
DESIGN = Path(__file__).parents[2] / "designs" / "edf-as-flown.toml"


def flown(hexjet: Hexjet, *arguments: str) -> Done:
    """As it would be typed, into a folder that is named as seen from here."""
    program = installed(Path("px4_sitl_default").absolute())
    instance = str(free_instance(range(100, 250), 4560, 1, socket.SOCK_STREAM))
    return hexjet("sitl", "px4", "--binary", str(program), "--instance", instance, "--out", "run", "--timeout", "60",
                  *arguments)  # fmt: skip


def seen() -> dict[str, Any]:
    told: dict[str, Any] = json.loads(Path("run/px4/seen.json").read_text())
    return told


def books() -> dict[str, Any]:
    told: dict[str, Any] = json.loads(Path("run/lockstep.json").read_text())
    return told


def errors(column: str) -> np.ndarray:
    return np.asarray(open_run(Path("run")).log[column])


@pytest.mark.parametrize(
    ("arguments", "jets", "height"),
    [
        (("--aircraft", "quadrotor"), 4, 0.05),
        (("--scenario", "full-scale-hover"), 6, 1.0),
        pytest.param(("--scenario", "octojet-hover"), 8, 1.0, marks=pytest.mark.long),
        pytest.param(("--aircraft", "hexjet-100"), 6, 1.0, marks=pytest.mark.long),
    ],
    ids=["quadrotor", "full-scale", "octojet", "hexjet-100"],
)
def test_it_hovers_with_jets_above_and_below_and_at_other_rates(
    arguments: tuple[str, ...], jets: int, height: float, hexjet: Hexjet
) -> None:
    """The page's own command, and every vehicle that stands on jets below its centre of gravity; the quadrotor's hover
    throttle is a third, which is not what mid-stick is to PX4 as it ships."""
    done = flown(hexjet, *arguments, "--set", "duration_s=3")
    assert done.status == 0, done.out + done.err
    counts = books()
    assert (counts["repeated"], counts["foreign"], counts["frames"] - counts["boot"] - counts["answers"]) == (0, 0, 0)
    assert seen()["values"]["CA_ROTOR_COUNT"] == jets
    for angle in ("roll_rad", "pitch_rad"):
        assert np.abs(errors(angle)).max() < np.radians(3.0)
    assert np.ptp(errors("altitude_m")) < height


def test_nothing_is_stale_and_nothing_jumps_when_the_flight_begins(hexjet: Hexjet) -> None:
    """Compass and barometer are heard through all of the stand; force and turn there are what they are in the air; and
    the throttle is free when it is needed."""
    bias = "vehicle.sensors.gyro.bias_rad_s=[0.01,-0.02,0.015]"
    done = flown(hexjet, "--set", "duration_s=4", "--set", bias)
    assert done.status == 0, done.out + done.err
    told = seen()
    assert told["stale"] == {"mag": 0, "baro": 0}
    assert told["heard"]["baro"] > 1500
    stood, flew = (np.array(told["force"][name]) for name in ("stood", "flew"))
    assert stood == pytest.approx(flew, abs=0.01)
    assert told["gyro_bias"] == pytest.approx((0.01, -0.02, 0.015), abs=2e-4)
    assert np.abs(errors("altitude_m") - 10.0).max() < 0.1
    assert "none of that name" not in done.err


def test_the_yaw_stick_turns_it_as_far_and_as_fast_as_it_is_asked(hexjet: Hexjet) -> None:
    """By two degrees, which a dead zone takes whole: the pilot's loop is first order, and a bend makes it slower."""
    amplitude, start = 2.0, 1.0
    done = flown(hexjet, "--scenario", "yaw-doublet", "--set", "expect=[]", "--set", f"command.0.amplitude={amplitude}",
                 "--set", "duration_s=4")  # fmt: skip
    assert done.status == 0, done.out + done.err
    turned = np.degrees(errors("yaw_rad")) / amplitude
    gain = Scenario.load("hover").resolved_vehicle()[0].control.attitude.gain_1_s[2]
    after = round((start + 2.0 / gain) / 0.004)  # two time constants: 0.86, less what its own loops are late
    assert 0.7 < turned[after] < 0.9
    assert turned[-1] == pytest.approx(1.0, abs=0.1)
    # of first order, with no low-pass before it: with that of PX4 it is 1.5 here
    half, one, two = (turned[round((start + parts / gain) / 0.004)] for parts in (0.5, 1.0, 2.0))
    assert (two - one) / (one - half) == pytest.approx(0.97, abs=0.25)


def test_the_gains_of_a_design_are_flown_and_named(hexjet: Hexjet) -> None:
    """Named beside them are version, parameters and messages of its own log."""
    done = flown(hexjet, "--gains", str(DESIGN), "--set", "duration_s=0.5")
    assert done.status == 0, done.out + done.err
    told = books()
    assert told["gains"] == str(DESIGN)
    assert f"gains of {DESIGN}" in done.out.replace("\n", "")
    from cosim.simulation.controllers.controller_file import apply_controller

    vehicle, _ = apply_controller("hover", DESIGN, (), None).resolved_vehicle()
    own, _ = Scenario.load("hover").resolved_vehicle()
    assert told["parameters"]["MC_ROLLRATE_P"] == vehicle.control.rate.roll.p / px4_torque_scale(vehicle)[0]
    assert told["parameters"]["MC_ROLLRATE_P"] != px4_parameters(own)["MC_ROLLRATE_P"]
    assert seen()["values"]["MC_ROLLRATE_P"] == float(np.float32(told["parameters"]["MC_ROLLRATE_P"]))
    # what its own log says
    assert told["version"] == "1.17.0-rc (0123abcd)"
    values = DEFAULTS | seen()["values"]
    text = "".join(f"{name}={float(np.float32(value)):.9g}\n" for name, value in sorted(values.items()))
    assert (told["parameters_flown"], told["parameters_sha256"]) == (len(values), sha256(text.encode()).hexdigest())
    said = [event for event in list_events(open_run(Path("run"))) if event.kind == "pilot"]
    assert [(event.time_s, event.text) for event in said] == [
        (0.0, "version 1.17.0-rc (0123abcd)"),
        (0.0, "Armed by RC"),
        (0.2, "Takeoff detected"),
    ]
    page = Path("run/report.html").read_text(encoding="utf-8")
    assert "Takeoff detected" in page


def test_it_flies_what_the_page_says_that_px4_flew(hexjet: Hexjet) -> None:
    """The doublet with the engines 0.1 s late and designed gains: 15 %, settled in 2.34 s (PX4's main of August 2026)."""
    overshoot, settling = 15.0, 2.34
    Path("gains.toml").write_text(IN_ITS_LOOP)
    done = flown(hexjet, "--scenario", "roll-doublet", "--gains", "gains.toml", "--set", "expect=[]")
    assert open_run(Path("run")).summary.outcome == "completed", done.out + done.err
    roll = open_run(Path("run")).summary.metrics["roll"]
    assert roll.overshoot_percent == pytest.approx(overshoot, abs=6.0)  # points: the estimator's level
    assert roll.settling_time_s == pytest.approx(settling, abs=0.15)


def test_it_holds_its_place_by_itself_once_the_switch_is_raised(hexjet: Hexjet) -> None:
    """In the wind, which would carry it away by then: 3 m/s push it 6 m aside in Stabilized."""
    wind = ("--set", "environment.wind_ned_m_s=[0,3,0]", "--set", "duration_s=6")
    done = flown(hexjet, "--hold", "0.5", "--set", 'engine="edf"', *wind)
    assert done.status == 0, done.out + done.err
    assert books()["hold_from_s"] == 0.5
    assert open_run(Path("run")).scenario.limits.oscillation_rad is False  # the lean is its own
    assert books()["parameters"]["MPC_THR_HOVER"] == pytest.approx(0.451, abs=0.001)  # PX4's own is 0.5
    away = np.hypot(errors("north_m"), errors("east_m"))
    assert away[-1] < 1.0
    assert np.abs(errors("altitude_m") - 10.0).max() < 0.3


def test_a_lost_gnss_is_lost_to_px4(hexjet: Hexjet) -> None:
    """What repeats is not sent on as a fix: it says that it is blind, 5 s after the last one, and chases no frozen place."""
    Path("lost.toml").write_text(
        'name = "lost"\nduration_s = 7\n[initial]\naltitude_m = 10\n'
        '[[fault]]\nkind = "sensor_dropout"\nsensor = "gnss"\nstart_s = 1\n'
    )
    done = flown(hexjet, "--scenario", "lost.toml", "--hold", "0.5", "--set", 'engine="edf"')
    assert open_run(Path("run")).summary.outcome == "completed", done.out + done.err
    said = [event for event in list_events(open_run(Path("run"))) if "blind land" in event.text]
    assert [event.time_s for event in said] == [pytest.approx(6.0, abs=0.2)]


def test_a_px4_behind_a_link_starts_with_its_files(hexjet: Hexjet) -> None:
    """As PX4's own package is laid out: /usr/bin/px4 is a link, and what it reads stands beside the program."""
    program = installed(Path("opt/px4").absolute())
    Path("px4").symlink_to(program)
    instance = str(free_instance(range(100, 250), 4560, 1, socket.SOCK_STREAM))
    done = hexjet("sitl", "px4", "--binary", "px4", "--instance", instance, "--out", "run", "--timeout", "60",
                  "--set", "duration_s=0.5")  # fmt: skip
    assert done.status == 0, done.out + done.err


def test_a_px4_that_reads_a_file_in_the_place_of_its_environment_is_refused(hexjet: Hexjet) -> None:
    """By the one line that the file has, whatever is stated: no name of a parameter is in it."""
    program = installed(Path("older").absolute())
    script = program.read_text().splitlines()
    older = """param() { [ "$2" != MAN_DEADZONE ] || echo "ERROR [param] Parameter $2 not found."; }; . px4-rc.params"""
    program.write_text("\n".join([script[0], older, script[1], ""]))
    instance = str(free_instance(range(100, 250), 4560, 1, socket.SOCK_STREAM))
    done = hexjet("sitl", "px4", "--binary", str(program), "--instance", instance, "--out", "run", "--param",
                  "MC_ROLL_P=5")  # fmt: skip
    assert done.status == 2
    assert "parameter MAN_DEADZONE: this PX4 has none of that name" in done.err
    assert done.err.strip().endswith("the first PX4 that is flown is 1.17")
    assert Path("run/px4/px4-rc.params").read_text() == "param set MAN_DEADZONE 0\n"


def test_what_is_not_to_be_had_is_one_line(hexjet: Hexjet) -> None:
    """A parameter's name that it does not have, by its own words; a design where no gains are taken from; no file."""
    done = flown(hexjet, "--param", "MC_ROLRATE_P=0.1", "--param", "MC_ROLL_P=5")
    assert done.status == 2
    assert done.err.strip() == (
        "hexjet: px4: parameter MC_ROLRATE_P: this PX4 has none of that name; did you mean MC_ROLLRATE_P? (parameters; "
        "run/px4/px4.log); the first PX4 that is flown is 1.17"
    )
    assert not Path("run/scenario.toml").exists()
    for given, said in (
        (
            ["--set", f"controller={DESIGN}"],
            "in the place of the controller; the gains of a design go into it by gains",
        ),
        (["--set", "controller=smith"], "controller=smith: the autopilot flies in the place of the controller"),
        (["--gains", "mine"], "gains mine: must be vehicle, stock, or a file of hexjet design (.toml)"),
        (["--gains", "nowhere.toml"], "nowhere.toml"),
    ):
        done = hexjet("sitl", "px4", "--binary", "/bin/true", *given)
        assert (done.status, said in done.err, len(done.err.strip().splitlines())) == (2, True, 1), done.err


def test_an_estimator_at_another_pace_is_one_that_does_not_answer(hexjet: Hexjet) -> None:
    """As PX4: the stand-in waits for it too, so that the tests above say something."""
    done = flown(hexjet, "--aircraft", "quadrotor", "--param", "IMU_INTEG_RATE=250", "--timeout", "0.5")
    assert done.status == 1
    assert "px4 did not answer within 0.5 s, before the flight" in done.out


def test_one_that_is_not_armed_says_what_it_needs(hexjet: Hexjet) -> None:
    """It logs nothing, and the log of a flight before in the same folder is not taken for its own."""
    earlier = Path("run/px4/log/2026-11-26/08_00_00.ulg")
    earlier.parent.mkdir(parents=True)
    earlier.write_bytes(b"".join(ulog(DEFAULTS, [(1, "Takeoff detected")])))
    done = flown(hexjet, "--param", "RC_MAP_ARM_SW=7", "--param", "SDLOG_MODE=-1")
    assert done.status == 1
    said = "px4 was not armed within 30 s; one that you start needs the parameters of hexjet sitl params px4"
    assert said in " ".join(done.out.split())
    assert (books()["version"], books()["parameters_flown"]) == ("", len(books()["parameters"]))
    assert not Path("run/autopilot.jsonl").exists()
