"""What Betaflight is told of a vehicle: mixing, gains in its units, and what is refused before anything is started."""

from __future__ import annotations

import socket
from math import degrees
from pathlib import Path

import pytest
from command_tools import Hexjet

from cosim.base.errors import InputError
from cosim.base.geodesy import Geodesy
from cosim.spec.vehicle import Vehicle, load_vehicle
from hexjet_sitl.betaflight import (
    D_SCALE,
    I_SCALE,
    MAX_GAIN,
    P_SCALE,
    TILT_WEIGHT,
    Betaflight,
    find_program,
    make_gain_settings,
    make_mixer_settings,
)
from hexjet_sitl.lockstep import Setup

PLACE = Geodesy(0.0, 0.0)


def vehicle(name: str) -> Vehicle:
    return load_vehicle(name)[0]


def mix(lines: list[str]) -> list[list[float]]:
    return [[float(each) for each in line.split()[2:]] for line in lines if line[:5] == "mmix " and line[5].isdigit()]


def test_the_banks_are_mixed_as_the_allocator_does() -> None:
    """Roll by throttle, left up; the outputs behind the engines tilt both banks for pitch and against each other for yaw."""
    hexjet = vehicle("hexjet")
    rows = mix(make_mixer_settings(hexjet, 0.05))
    for jet, (throttle, roll, pitch, yaw) in zip(hexjet.jets, rows, strict=False):
        assert (throttle, roll, pitch, yaw) == (1.0, 1.0 if jet.servo == "left" else -1.0, 0.0, 0.0)
    # the jets stand above the centre of gravity: tilted forward they push the nose down, which is Betaflight's positive
    assert rows[6:] == [[1.0, 0.0, TILT_WEIGHT, TILT_WEIGHT], [1.0, 0.0, TILT_WEIGHT, -TILT_WEIGHT]]


def test_a_quadrotor_is_mixed_as_its_own() -> None:
    """Rows of its QUADX table: rear right, front right, rear left, front left have roll -+, pitch +-, yaw by rotation."""
    rows = {
        (x > 0.0, y > 0.0): row
        for (x, y, _), row in zip(
            [jet.position_m for jet in vehicle("quadrotor").jets],
            mix(make_mixer_settings(vehicle("quadrotor"), 0.05)),
            strict=True,
        )
    }
    assert {place: row[:3] for place, row in rows.items()} == {
        (False, True): [1.0, -1.0, 1.0],
        (True, True): [1.0, -1.0, -1.0],
        (False, False): [1.0, 1.0, 1.0],
        (True, False): [1.0, 1.0, -1.0],
    }
    turns = [row[3] for row in rows.values()]
    assert sorted(turns) == [-1.0, -1.0, 1.0, 1.0]


def test_gains_are_ours_in_its_units() -> None:
    """Each back again through its scales, its mixer and our tilt: within half of its unit."""
    hexjet = vehicle("hexjet")
    set_to = {
        line.split()[1]: float(line.split()[3]) for line in make_gain_settings(hexjet) if line.split()[3].isdigit()
    }
    gains, room = hexjet.control.rate, 1.0 - hexjet.control.allocation.throttle_min
    assert hexjet.servo is not None
    for axis, ours, worth in (
        ("roll", gains.roll, room / 1000.0),
        ("pitch", gains.pitch, hexjet.servo.range_rad / 500.0),
        ("yaw", gains.yaw, hexjet.servo.range_rad / 500.0),
    ):
        for key, scale in (("p", P_SCALE), ("i", I_SCALE), ("d", D_SCALE)):
            unit = degrees(1.0) * scale * worth * (2.5 if (key, axis) == ("i", "yaw") else 1.0)
            assert set_to[f"{key}_{axis}"] <= MAX_GAIN
            assert set_to[f"{key}_{axis}"] * unit == pytest.approx(getattr(ours, key), abs=0.5 * unit)
    assert set_to["angle_p_gain"] == round(10.0 * min(hexjet.control.attitude.gain_1_s[:2]))


def test_more_motors_than_it_has_are_refused(tmp_path: Path) -> None:
    hexjet = vehicle("hexjet")
    many = hexjet.model_copy(update={"jets": [*hexjet.jets, hexjet.jets[0]]})
    with pytest.raises(InputError, match="7 engines and 2 servos, and Betaflight has 8 motors"):
        Betaflight(Path("any"), tmp_path, many, 0.004, PLACE, Setup())


def test_the_program_is_named_where_its_version_is_asked_for(tmp_path: Path) -> None:
    one = Betaflight(tmp_path / "betaflight_4.6.0_SITL", tmp_path, load_vehicle("hexjet")[0], 0.004, PLACE, Setup())
    assert one.report().version == "program betaflight_4.6.0_SITL"
    one.close()


def test_a_busy_port_is_named(tmp_path: Path) -> None:
    """With the option by which this autopilot's command takes another."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as held:
        held.bind(("127.0.0.1", 0))
        port = held.getsockname()[1]
        one = Betaflight(tmp_path / "any", tmp_path, vehicle("hexjet"), 0.004, PLACE, Setup(port=port))
        with pytest.raises(InputError, match=rf"betaflight: port {port} is in use; .*\(port\)"):
            one.start()
        one.close()


def test_what_is_no_program_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = tmp_path / "text"
    text.write_text("no program")
    with pytest.raises(InputError, match=r"binary: .*text: is no program"):
        find_program(text)
    monkeypatch.setenv("BETAFLIGHT_SITL", str(tmp_path / "missing"))
    with pytest.raises(InputError, match=r"BETAFLIGHT_SITL: .*missing: no such file"):
        find_program(None)


def test_wrong_gains_are_one_line(hexjet: Hexjet) -> None:
    done = hexjet("sitl", "betaflight", "--gains", "mine")
    assert done.status == 2
    assert done.err == "hexjet: gains mine: must be designed, vehicle, stock, or a file of hexjet design (.toml)\n"


def test_a_file_for_a_board_has_mixer_and_gains_and_nothing_of_the_stand(hexjet: Hexjet) -> None:
    """Its receiver, switches and arming checks stay, and its gyro is filtered as late as the vehicle's."""
    done = hexjet("sitl", "params", "betaflight", "--target", "board")
    stand = hexjet("sitl", "params", "betaflight").out.splitlines()
    board = done.out.splitlines()
    assert done.status == 0
    assert board[0] == "# For a board that flies: mixer and gains; its receiver, switches and checks stay as they are."
    foreign = ("aux ", "feature ", "set small_angle", "set acc_", "set runaway_", "set angle_limit", "set rates_type")
    assert not [line for line in board if line.startswith(foreign)]
    assert [line for line in stand if line.startswith(foreign)]
    assert "set gyro_lpf1_static_hz = 18" in board  # 9 ms, first order
    assert set(make_gain_settings(vehicle("hexjet"))) < set(board)
    assert board[-1] == "save"
