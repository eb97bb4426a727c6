"""Commands and disturbances against their own words, and what is wrong with them in one line."""

from __future__ import annotations

from math import pi, radians
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import chirp

from cosim.base.errors import InputError
from cosim.base.signals import ZERO3, Disturbance
from cosim.simulation.script.command_script import CommandScript, make_doublet, make_pulse, make_sweep, read_columns
from cosim.simulation.script.disturbance_script import DisturbanceScript
from cosim.spec.scenario import Scenario

STEP = 0.004


def scenario(folder: Path | None = None, **changes: object) -> Scenario:
    return Scenario.from_table({"name": "test", "duration_s": 10.0} | changes, folder or Path(), "test")


def roll(commander: CommandScript, steps: int) -> list[float]:
    return [commander.at(k).attitude[0] for k in range(steps)]


def test_nothing_commanded_is_level_at_the_initial_heading_and_height() -> None:
    command = CommandScript(scenario(initial={"attitude_deg": [5.0, -3.0, 90.0]}), 12.0).at(0)
    assert command.attitude == (0.0, 0.0, pi / 2)
    assert (command.altitude, command.rate, command.collective) == (12.0, None, None)


def test_doublet_begins_turns_and_ends_on_its_steps() -> None:
    entry = {"kind": "doublet", "signal": "roll_deg", "start_s": 0.2, "amplitude": 15.0, "width_s": 0.5}
    values = roll(CommandScript(scenario(command=[entry]), 0.0), 400)
    up = radians(15.0)
    assert values == [0.0] * 50 + [up] * 125 + [-up] * 125 + [0.0] * 100


def test_ramps_and_steps_set_their_own_signals() -> None:
    ramp = {"kind": "ramp", "signal": "altitude_m", "start_s": 0.04, "amplitude": 2.0, "duration_s": 0.04}
    step = {"kind": "step", "signal": "collective", "start_s": 0.008, "amplitude": 0.4}
    commander = CommandScript(scenario(command=[ramp, step]), 1.0)
    heights = [commander.at(k).altitude for k in range(25)]
    assert heights == pytest.approx([1.0] * 10 + [1.0 + 0.2 * n for n in range(10)] + [3.0] * 5)
    assert [commander.at(k).collective for k in range(4)] == [None, None, 0.4, 0.4]


def test_commands_of_one_signal_add_up() -> None:
    entries = [
        {"kind": "step", "signal": "roll_deg", "start_s": 0.0, "amplitude": 10.0},
        {"kind": "step", "signal": "roll_deg", "start_s": 0.004, "amplitude": -4.0},
    ]
    assert roll(CommandScript(scenario(command=entries), 0.0), 2) == pytest.approx([radians(10.0), radians(6.0)])


def test_a_rate_command_replaces_the_attitude_loop() -> None:
    entry = {"kind": "step", "signal": "rate_q_deg_s", "start_s": 0.0, "amplitude": 20.0}
    assert CommandScript(scenario(command=[entry]), 0.0).at(0).rate == (0.0, radians(20.0), 0.0)


def test_sweep_is_a_logarithmic_chirp() -> None:
    """Against scipy's."""
    n = 2500
    wave = make_sweep(STEP, 10, n, 2.0, 0.3, 4.0)
    t = np.arange(n) * STEP
    expected = 2.0 * chirp(t, 0.3, n * STEP, 4.0, method="logarithmic", phi=-90)
    assert [wave(k) for k in range(10, 10 + n)] == pytest.approx(expected, abs=1e-9)
    assert wave(9) == wave(10 + n) == 0.0


def test_sweep_of_one_frequency_is_a_sine() -> None:
    wave = make_sweep(STEP, 0, 1000, 1.0, 2.0, 2.0)
    assert [wave(k) for k in range(1000)] == pytest.approx(np.sin(4 * pi * STEP * np.arange(1000)), abs=1e-12)


def test_pulse_and_doublet_edges() -> None:
    assert [make_pulse(2, 4, 1.5)(k) for k in range(6)] == [0.0, 0.0, 1.5, 1.5, 0.0, 0.0]
    assert [make_pulse(2, None, 1.5)(k) for k in (1, 2, 10**6)] == [0.0, 1.5, 1.5]
    assert [make_doublet(1, 2, 1.0)(k) for k in range(6)] == [0.0, 1.0, 1.0, -1.0, -1.0, 0.0]


def test_table_holds_or_interpolates(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time_s,roll_deg,altitude_m\n0.0,0,0\n0.008,10,1\n0.016,0,1\n")
    entry = {"kind": "table", "file": "t.csv", "start_s": 0.004}
    linear = CommandScript(scenario(tmp_path, command=[entry]), 5.0)
    assert np.degrees(roll(linear, 7)) == pytest.approx([0.0, 0.0, 5.0, 10.0, 5.0, 0.0, 0.0], abs=1e-6)
    assert [linear.at(k).altitude for k in (0, 3, 6)] == pytest.approx([5.0, 6.0, 6.0])
    held = CommandScript(scenario(tmp_path, command=[entry | {"interpolate": "hold"}]), 0.0)
    assert np.degrees(roll(held, 7)) == pytest.approx([0.0, 0.0, 0.0, 10.0, 10.0, 0.0, 0.0])


def test_sticks_scale_and_integrate(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text("time_s,roll,pitch,yaw,throttle\n0,0.5,0.5,1,-1\n0.4,0.5,0.5,1,-1\n")
    entry = {"kind": "sticks", "file": "s.csv", "tilt_deg": 20.0, "yaw_rate_deg_s": 90.0, "climb_m_s": 2.0}
    commander = CommandScript(scenario(tmp_path, command=[entry]), 10.0)
    command = commander.at(100)
    assert np.degrees(command.attitude[:2]) == pytest.approx([10.0, -10.0])  # stick forward: nose down
    assert np.degrees(command.attitude[2]) == pytest.approx(36.0)  # 90 deg/s for 0.4 s
    assert command.altitude == pytest.approx(10.0 - 0.8)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,roll_deg\n0,1\n", "line 1: the first column must be time_s"),
        ("time_s,rol_deg\n0,1\n", "line 1: unknown column 'rol_deg'; did you mean 'roll_deg'"),
        ("time_s,roll_deg,roll_deg\n0,1,1\n", "line 1: a column stands twice"),
        ("time_s,roll_deg\n0,1\n0,2\n", "line 3: time_s does not grow"),
        ("time_s,roll_deg\n0,nan\n", "line 2: 'nan' is not a finite number"),
        ("time_s,roll_deg\n0,1,2\n", "line 2: 3 cells, the header has 2"),
        ("time_s,roll_deg\n-1,1\n", "line 2: time_s starts below 0"),
        ("time_s,roll_deg\n", "no rows of data"),
    ],
)
def test_wrong_tables_name_file_and_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "wrong.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"wrong\.csv: {message}"):
        read_columns(path, ("roll_deg", "pitch_deg"), "command.0.file")


def test_missing_table_and_wild_sticks(tmp_path: Path) -> None:
    entry = {"kind": "sticks", "file": "s.csv"}
    with pytest.raises(InputError, match=r"command\.0\.file: .*s\.csv: No such file"):
        CommandScript(scenario(tmp_path, command=[entry]), 0.0)
    (tmp_path / "s.csv").write_text("time_s,roll\n0,1.5\n")
    with pytest.raises(InputError, match=r"column roll holds 1\.5; sticks go from -1 to 1"):
        CommandScript(scenario(tmp_path, command=[entry]), 0.0)


def test_times_off_the_grid_are_refused() -> None:
    entry = {"kind": "step", "signal": "roll_deg", "start_s": 0.0055, "amplitude": 1.0}
    with pytest.raises(InputError, match=r"command\.0\.start_s = 0\.0055 s is not a whole number of 0\.004 s steps"):
        CommandScript(scenario(command=[entry]), 0.0)


def test_calm_air_is_one_shared_object() -> None:
    disturber = DisturbanceScript(scenario())
    assert disturber.at(0) == Disturbance()
    assert disturber.at(0) is disturber.at(2000)


def test_forces_moments_and_winds_add_up_while_they_last() -> None:
    entries = [
        {"kind": "force", "start_s": 0.004, "duration_s": 0.008, "force_n": [1.0, 2.0, 3.0]},
        {"kind": "force", "start_s": 0.008, "duration_s": 0.008, "force_n": [1.0, 0.0, 0.0]},
        {"kind": "moment", "start_s": 0.0, "duration_s": 0.004, "moment_n_m": [0.0, 0.5, 0.0]},
        {"kind": "wind", "start_s": 0.008, "velocity_ned_m_s": [0.0, 4.0, 0.0]},
    ]
    disturber = DisturbanceScript(scenario(disturbance=entries, environment={"wind_ned_m_s": [1.0, 0.0, 0.0]}))
    assert [disturber.at(k).force for k in range(5)] == [ZERO3, (1, 2, 3), (2, 2, 3), (1, 0, 0), ZERO3]
    assert [disturber.at(k).moment for k in range(2)] == [(0.0, 0.5, 0.0), ZERO3]
    assert [disturber.at(k).wind for k in (0, 2, 2000)] == [(1, 0, 0), (1, 4, 0), (1, 4, 0)]


def test_payloads_share_one_centre() -> None:
    entries = [
        {"kind": "payload", "start_s": 0.0, "mass_kg": 1.0, "offset_m": [0.1, 0.0, 0.0]},
        {"kind": "payload", "start_s": 0.004, "duration_s": 0.004, "mass_kg": 3.0, "offset_m": [-0.1, 0.2, 0.0]},
    ]
    disturber = DisturbanceScript(scenario(disturbance=entries))
    assert disturber.at(0).payload == (1.0, 0.1, 0.0, 0.0)
    assert disturber.at(1).payload == pytest.approx((4.0, -0.05, 0.15, 0.0))
    assert disturber.at(2).payload == disturber.at(0).payload


def test_torque_commands_by_axis_and_shape() -> None:
    yaw = {"kind": "torque_command", "axis": "yaw", "start_s": 0.0, "duration_s": 0.004, "amplitude": 0.3}
    roll = yaw | {"axis": "roll", "shape": "doublet", "duration_s": 0.016, "amplitude": 0.1}
    disturber = DisturbanceScript(scenario(disturbance=[yaw, roll]))
    torques = [disturber.at(k).torque_command for k in range(5)]
    assert torques == [(0.1, 0.0, 0.3), (0.1, 0.0, 0.0), (-0.1, 0.0, 0.0), (-0.1, 0.0, 0.0), ZERO3]
    with pytest.raises(InputError, match=r"even number of 0\.004 s steps"):
        DisturbanceScript(scenario(disturbance=[roll | {"duration_s": 0.012}]))


def test_a_gust_is_announced_once() -> None:
    entry = {"kind": "gust", "start_s": 0.008, "velocity_ned_m_s": [0, 8, 0]}
    entry |= {"rise_s": 1.0, "hold_s": 0.0, "fall_s": 1.0}
    disturber = DisturbanceScript(scenario(disturbance=[entry]))
    assert [disturber.at(k).gust for k in range(4)] == [None, None, ((0.0, 8.0, 0.0), 1.0, 0.0, 1.0), None]
    with pytest.raises(InputError, match="a gust needs a velocity"):
        DisturbanceScript(scenario(disturbance=[entry | {"velocity_ned_m_s": [0, 0, 0]}]))
    with pytest.raises(InputError, match="a start_s of its own"):
        DisturbanceScript(scenario(disturbance=[entry, entry]))
