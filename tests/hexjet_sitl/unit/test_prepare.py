"""What an autopilot is made with: from its name and set-up, for a command and for a campaign alike."""

from __future__ import annotations

import ast
import shutil
from pathlib import Path

import pytest
from command_tools import Hexjet
from places import DESIGNS, TOOLS

from cosim.base.errors import InputError
from cosim.base.storage.toml import parse_numbers, validate
from cosim.simulation.controllers.controller_file import apply_controller
from cosim.spec.scenario import Scenario
from hexjet_sitl import ardupilot, betaflight, px4
from hexjet_sitl import prepare as preparation
from hexjet_sitl.firmware_parameters import TARGET_NOTES, write_parameters
from hexjet_sitl.lockstep import Autopilot, Setup
from hexjet_sitl.parameters import (
    ardupilot_parameters,
    ardupilot_script,
    ardupilot_sticks,
    parameter_file,
    px4_target,
    read_parameters,
)
from hexjet_sitl.prepare import find_program, require_program
from hexjet_sitl.study import AutopilotTable

PROGRAM = Path("/bin/true").resolve()  # is never started here
HOVER = Scenario.load("hover")
QUAD = HOVER.replace(aircraft="quadrotor", engine="motor", step_s=0.0025)


def prepare(name: str, scenario: Scenario, folder: Path, program: Path | None, setup: Setup) -> Autopilot:
    """As it would fly, and closed."""
    made = preparation.prepare(name, scenario, folder, program, setup)
    made.close()
    return made


def test_betaflights_console_has_gains_then_what_is_stated(tmp_path: Path) -> None:
    vehicle, _ = HOVER.resolved_vehicle()
    setup = Setup(instance=3, lines=["set p_roll = 12"])
    own = prepare("betaflight", HOVER, tmp_path, PROGRAM, setup)
    console = [*betaflight.make_gain_settings(vehicle), "set p_roll = 12"]
    assert own.details["gains"] == "vehicle"
    assert own.details["console"][-len(console) :] == console
    assert own.endpoint == f"UDP port {betaflight.PORT + 3 * betaflight.PORT_SPACING}"
    stock = prepare("betaflight", HOVER, tmp_path, PROGRAM, Setup(gains="stock", port=2000))
    assert not set(betaflight.make_gain_settings(vehicle)) & set(stock.details["console"])
    assert stock.endpoint == "UDP port 2000"


def test_px4s_parameters_are_the_vehicles_then_what_is_stated(tmp_path: Path) -> None:
    vehicle, _ = HOVER.resolved_vehicle()
    made = prepare("px4", HOVER, tmp_path, None, Setup(instance=2, parameters={"MC_ROLL_P": 1.25}))
    told = dict(made.details["parameters"])
    assert told.pop("MPC_THR_HOVER") == pytest.approx(0.451, abs=0.001)
    assert told == px4_target(vehicle, HOVER.step_s, "sitl") | {"MC_ROLL_P": 1.25}
    stock = prepare("px4", HOVER, tmp_path, None, Setup(gains="stock")).details["parameters"]
    tuned = ("MC_", "IMU_GYRO", "IMU_DGYRO")
    assert {name for name in told if not name.startswith(tuned)} == set(stock) - {"MPC_THR_HOVER"}
    assert made.endpoint == f"TCP port {px4.PORT + 2}"


def test_what_is_printed_for_px4_is_what_it_flies_with(tmp_path: Path, hexjet: Hexjet) -> None:
    """The throttle of hover too, which is the engines'; of a design's file it is that of the engine that it is for."""
    made = prepare("px4", HOVER, tmp_path, None, Setup())
    done = hexjet("sitl", "params", "px4")
    assert done.out == parameter_file("px4", made.details["parameters"], TARGET_NOTES["px4"]["sitl"])
    controller = tmp_path / "mine.toml"
    shutil.copy2(DESIGNS / "edf-as-flown.toml", controller)
    heavy = HOVER.replace(engine="edf-as-flown", vehicle={"mass_kg": 7.0, "servo": {"range_rad": 0.2}})
    files = write_parameters("px4", heavy, controller)
    assert [path.name for path in files.values()] == ["mine.board.params", "mine.stand.params"]
    board, told = (
        {line.split("\t")[2]: float(line.split("\t")[3]) for line in path.read_text().splitlines() if line[0] != "#"}
        for path in files.values()
    )
    flown = apply_controller(heavy, controller)
    assert told["MPC_THR_HOVER"] > 1.05 * made.details["parameters"]["MPC_THR_HOVER"]
    assert told == pytest.approx(prepare("px4", flown, tmp_path, None, Setup()).details["parameters"])
    stand_alone = ("RC", "COM_", "MAN_", "MPC_THR_CURVE", "MPC_MAN", "SDLOG", "IMU_INTEG", "EKF2", "SENS")
    assert not [name for name in board if name.startswith(stand_alone)]
    assert {name for name in told if not name.startswith(stand_alone)} == set(board)
    assert board["IMU_GYRO_CUTOFF"] > 0.0
    assert {name for name, value in board.items() if value != told[name]} == {"IMU_GYRO_CUTOFF"}


def test_ardupilots_parameters_are_a_file_where_it_is_started_here(tmp_path: Path) -> None:
    vehicle, _ = QUAD.resolved_vehicle()
    by_hand = prepare("ardupilot", QUAD, tmp_path, None, Setup(instance=1))
    assert by_hand.details["defaults"] == "None"
    assert by_hand.endpoint == f"UDP port {ardupilot.PORT + ardupilot.PORT_SPACING}"
    assert not (tmp_path / "ardupilot").exists()
    file = tmp_path / "ardupilot" / "hexjet.parm"
    prepare("ardupilot", QUAD, tmp_path, PROGRAM, Setup())
    assert file.read_text() == parameter_file("ardupilot", ardupilot_parameters(vehicle, 0.0025))
    own = prepare("ardupilot", QUAD, tmp_path, PROGRAM, Setup(parameters={"CC_TYPE": 3.0}, channels=["8=2000@2"]))
    assert own.details["parameters"] == ardupilot_parameters(vehicle, 0.0025) | {"CC_TYPE": 3.0}
    assert read_parameters(file) == pytest.approx(own.details["parameters"])
    assert own.details["channels"] == ["8=2000@2"]


@pytest.mark.parametrize(
    ("title", "old", "remark"),
    [
        ("ArduCopter V4.6.0-dev", True, ""),
        ("ArduCopter V4.6.3", True, ""),
        ("ArduCopter V4.8.0-dev", False, ""),
        ("ArduCopter V4.7.0-beta1", False, "ArduCopter V4.7.0-beta1 was not flown here; 4.6 and 4.8 were"),
        ("ArduCopter V4.5.7", True, "ArduCopter V4.5.7 was not flown here; 4.6 and 4.8 were"),
        ("nothing", False, "arducopter: states no version of ArduCopter: its parameters are named as of 4.8"),
    ],
)
def test_ardupilots_parameters_have_the_names_of_its_release(
    title: str, old: bool, remark: str, tmp_path: Path
) -> None:
    """The program has its release among its texts; a lean was hundredths of a degree until 4.6, a check what is checked."""
    program = tmp_path / "arducopter"
    program.write_bytes(b"\x7fELF\x00Init %s\x00" + title.encode() + b" (fa6c811d)\x00\xff")
    made = prepare("ardupilot", QUAD, tmp_path, program, Setup())
    told = made.details["parameters"]
    names = {"ANGLE_MAX": 3000.0, "ARMING_CHECK": 0.0, "SIM_GPS_LAG_MS": 0.0, "ATC_ACCEL_R_MAX": 0.0}
    today = {"ATC_ANGLE_MAX": 30.0, "ARMING_SKIPCHK": -1.0, "SIM_GPS1_LAG_MS": 0.0, "ATC_ACC_R_MAX": 0.0}
    assert {name: told.get(name) for name in (*names, *today)} == (
        names | dict.fromkeys(today) if old else dict.fromkeys(names) | today
    )
    assert (len(told), told["ATC_RATE_FF_ENAB"], "-0" in str(told)) == (len(ardupilot_parameters(
        QUAD.resolved_vehicle()[0], 0.0025)), 0, False)  # fmt: skip
    assert made.remark.removeprefix(f"{tmp_path}/") == remark


def test_as_it_ships_ardupilot_keeps_its_gains_and_flies_our_frame_and_sticks(tmp_path: Path) -> None:
    stock = prepare("ardupilot", QUAD, tmp_path, PROGRAM, Setup(gains="stock", parameters={"ATC_INPUT_TC": 0.2}))
    told = stock.details["parameters"]
    assert [name for name in told if name.startswith(("ATC_", "INS_", "MOT_THST"))] == ["ATC_ANGLE_MAX", "ATC_INPUT_TC"]
    assert ardupilot_sticks().items() <= told.items()
    assert (told["FRAME_TYPE"], told["MOT_SPIN_MAX"]) == (18, 1.0)


def test_a_script_is_written_for_tilting_banks_where_it_is_started_here(tmp_path: Path) -> None:
    prepare("ardupilot", HOVER, tmp_path, PROGRAM, Setup())
    script = ardupilot_script(HOVER.resolved_vehicle()[0])
    assert (tmp_path / "ardupilot" / "scripts" / "hexjet.lua").read_text() == script
    prepare("ardupilot", QUAD, tmp_path / "other", PROGRAM, Setup())
    assert not (tmp_path / "other" / "ardupilot" / "scripts").exists()


def test_a_file_of_ones_own_flies_with_the_sticks_that_are_sent(tmp_path: Path) -> None:
    """Ranges that it does not state are those of the pulses; what it states, and what is stated over it, holds."""
    file = tmp_path / "mine.parm"
    file.write_text("# mine\nFRAME_CLASS,7\nRC1_DZ 5\nMOT_SPIN_MIN, 0.1 @READONLY\n")
    made = prepare("ardupilot", HOVER, tmp_path, PROGRAM, Setup(defaults=file, parameters={"MOT_SPIN_MIN": 0.2}))
    told = read_parameters(tmp_path / "ardupilot" / "hexjet.parm")
    assert told == ardupilot_sticks() | {"FRAME_CLASS": 7.0, "RC1_DZ": 5.0, "MOT_SPIN_MIN": 0.2}
    assert made.details["defaults"] == str(file)
    file.write_text("FRAME_CLASS,quad\n")
    with pytest.raises(InputError, match=r"mine\.parm: line 1: 'FRAME_CLASS,quad': must be a name and a number"):
        prepare("ardupilot", HOVER, tmp_path, PROGRAM, Setup(defaults=file))


@pytest.mark.parametrize("name", ["MC-ROLLRATE-P", "MC ROLLRATE_P", "MC_YAW_P;id", "P\nid", "mc_yaw_p", "1P", "A" * 17])
def test_a_name_that_no_parameter_can_have_is_refused_wherever_it_is_taken(
    name: str, tmp_path: Path, hexjet: Hexjet
) -> None:
    """By a command, a study and a file: an autopilot passes over such a name, and a script that has it runs it."""
    study = {"name": "px4", "parameters": {name: 3.0}}
    for said in (lambda: Setup(parameters={name: 3.0}), lambda: validate(AutopilotTable, study, "study.toml")):
        with pytest.raises(InputError, match=r"is no name of one; allowed: a capital letter, .* sixteen characters"):
            said()
    for autopilot in ("px4", "ardupilot"):
        done = hexjet("sitl", autopilot, "--binary", str(PROGRAM), "--param", f"{name}=3")
        assert (done.status, len(done.err.strip().splitlines())) == (2, 1), done.err
        assert f"parameter {name!r}: is no name of one" in done.err
    file = tmp_path / "mine.parm"
    file.write_text(f"{name},3\n")
    with pytest.raises(InputError, match=r"mine\.parm: line 1: .* must be a name and a number"):
        read_parameters(file)


def test_ardupilot_has_one_height_and_so_no_bias_of_gnss_in_it(tmp_path: Path) -> None:
    fault = {"kind": "sensor_bias", "sensor": "gnss", "start_s": 1.0, "velocity_bias": [0.0, 0.0, 0.5]}
    for bias, is_told in (([3.0, 0.0, 0.0], True), ([0.0, 0.0, 3.0], False)):
        scenario = QUAD.replace(fault=[fault | {"bias": bias}])
        if is_told:
            prepare("ardupilot", scenario, tmp_path, PROGRAM, Setup())
        else:
            with pytest.raises(InputError, match=r"ardupilot: fault\.0\.bias: .* one height, the barometer's; allowed"):
                prepare("ardupilot", scenario, tmp_path, PROGRAM, Setup())


def test_a_line_for_the_console_is_one_line() -> None:
    for lines in (["set p_roll = 12\nset p_pitch = 1"], ["set p_roll = 12\x00"]):
        with pytest.raises(InputError, match=r"line 'set p_roll = 12.*: has control characters; allowed: one line"):
            Setup(lines=lines)
        with pytest.raises(InputError, match="has control characters"):
            validate(AutopilotTable, {"name": "betaflight", "lines": lines}, "study.toml")


@pytest.mark.parametrize(
    ("name", "sensor", "kind", "said"),
    [
        ("px4", "attitude", "sensor_dropout", r"px4: fault\.1: sensor_dropout of attitude: it estimates its attitude"),
        ("px4", "attitude", "sensor_bias", r"px4: fault\.1: sensor_bias of attitude: it estimates its attitude"),
        ("betaflight", "gnss", "sensor_dropout", r"betaflight: fault\.1: sensor_dropout of gnss: .* no position"),
        ("ardupilot", "attitude", "sensor_bias", r"ardupilot: fault\.1: sensor_bias of attitude: it estimates its att"),
        (
            "ardupilot",
            "barometer",
            "sensor_dropout",
            r"ardupilot: fault\.1: sensor_dropout of barometer: .* last height",
        ),
        ("ardupilot", "attitude", "sensor_dropout", r"ardupilot: fault\.1: sensor_dropout of attitude: it estimates"),
    ],
)
def test_a_sensors_fault_that_does_not_reach_an_autopilot_is_refused(
    name: str, sensor: str, kind: str, said: str, tmp_path: Path
) -> None:
    amount = {"bias": [0.1, 0.0, 0.0]} if kind == "sensor_bias" else {}
    faults = [
        {"kind": "sensor_dropout", "sensor": "gyro", "start_s": 1.0},
        {"kind": kind, "sensor": sensor, "start_s": 1.0, **amount},
    ]
    with pytest.raises(InputError, match=said):
        prepare(name, HOVER.replace(fault=faults), tmp_path, PROGRAM, Setup())
    prepare(name, HOVER.replace(fault=faults[:1]), tmp_path, PROGRAM, Setup())


@pytest.mark.parametrize("line", ["ATC_RAT_RLL_P nan", "ATC_RAT_RLL_P,-inf", ",3", "3 4"])
def test_a_line_without_a_name_or_a_finite_number_is_refused(line: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.parm"
    file.write_text(f"# mine\n{line}\n")
    with pytest.raises(InputError, match=rf"mine\.parm: line 2: '{line}': must be a name and a number"):
        read_parameters(file)


def test_a_file_that_is_no_text_is_called_that(tmp_path: Path) -> None:
    file = tmp_path / "mine.parm"
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"mine\.parm: is no text file \(byte 0\)$"):
        read_parameters(file)


@pytest.mark.parametrize("text", ["FOO=nan", "FOO=inf", "=3", " =3", "FOO", "FOO="])
def test_what_is_no_name_with_a_finite_number_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=f"^parameters {text}: write it as NAME=NUMBER, with a finite number$"):
        parse_numbers([text], "parameters")


def test_the_stand_in_for_px4_has_nothing_of_the_project_in_it() -> None:
    tree = ast.parse((TOOLS / "px4_program.py").read_text(encoding="utf-8"))
    imported = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    imported += [name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names]
    assert "pymavlink.dialects.v20" in imported
    assert not [name for name in imported if name.split(".")[0] == "cosim"]


@pytest.mark.parametrize("name", ["px4", "betaflight"])
def test_the_rate_loop_from_outside_left_in_a_line_that_says_what_to_use(name: str, hexjet: Hexjet) -> None:
    done = hexjet("sitl", name, "--rates", "smith")
    assert (done.status, len(done.err.strip().splitlines())) == (2, 1)
    assert "a rate loop from outside left in version 0.3.0; use hexjet export controller --for" in done.err


def test_who_may_be_started_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PX4_SITL", raising=False)
    monkeypatch.setenv("PATH", "/nowhere")
    assert find_program("px4", None) is None
    with pytest.raises(InputError, match=r"px4: no program is named; allowed: .*, PX4_SITL, or px4 on the path"):
        require_program("px4", None)
    monkeypatch.setenv("PX4_SITL", str(PROGRAM))
    assert require_program("px4", None) == PROGRAM


@pytest.mark.parametrize(("name", "program"), [("px4", "px4"), ("ardupilot", "arducopter")])
def test_a_program_is_found_on_the_path_behind_what_is_named(
    name: str, program: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / program).symlink_to(PROGRAM)
    variable = f"{name.upper()}_SITL"
    monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    # Of a link the program itself is taken: PX4's package has one in /usr/bin, and its files beside the program.
    assert find_program(name, None) == require_program(name, None) == PROGRAM
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setenv(variable, str(tmp_path / program))
    assert find_program(name, None) == PROGRAM
    monkeypatch.delenv(variable)
    assert find_program(name, tmp_path / program) == PROGRAM


@pytest.mark.parametrize("name", ["px4", "ardupilot", "betaflight"])
def test_a_design_in_the_place_of_the_controller_is_refused_and_not_left_out(name: str, tmp_path: Path) -> None:
    """The autopilot flies in the controller's place, so that its gains would not be flown."""
    with pytest.raises(InputError, match=rf"controller = gains\.toml: {name} flies in .* as gains gains\.toml"):
        prepare(name, QUAD.replace(controller="gains.toml"), tmp_path, PROGRAM, Setup())
