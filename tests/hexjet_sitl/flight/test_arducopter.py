"""The commands of the page with a stand-in for ArduCopter that is as unkind as the program: it flies, or it is lost."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arducopter_standin import DEFAULTS, PLACE_S, TITLE, Radio, begin_log, installed
from command_tools import Hexjet
from patience import FLIGHT_PATIENCE, PATIENCE

from cosim import fly
from cosim.base.errors import FlightError, InputError
from cosim.base.geodesy import Geodesy
from cosim.results.run import Run, open_run
from cosim.spec.scenario import Scenario
from hexjet_identify.logs.dataflash import read_notes
from hexjet_sitl.ardupilot import START_TIMING, ArduPilot, Transmitter, TransmitterChannel, parse_channel
from hexjet_sitl.lockstep import SensorFrame, Setup, StickPositions
from hexjet_sitl.parameters import ardupilot_sticks
from hexjet_sitl.prepare import prepare
from hexjet_sitl.run import fly_autopilot

QUADROTOR = Scenario.load("hover").replace(aircraft="quadrotor", step_s=0.0025)
DOUBLET = ["--aircraft", "quadrotor", "--set", "step_s=0.0025", "--scenario", "roll-doublet", "--set", "duration_s=7"]

STAND_S = 32.0  # of which the stand-in needs 25 to be ready; the program itself takes longer to have a place
SHORTER = (
    "from dataclasses import replace; from hexjet_sitl import ardupilot; "
    f"ardupilot.ArduPilot.timing = replace(ardupilot.START_TIMING, before_s={STAND_S}); "
)


@pytest.fixture(autouse=True)
def shorter_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ArduPilot, "timing", replace(START_TIMING, before_s=STAND_S))


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return installed(tmp_path_factory.mktemp("sitl"))


@pytest.fixture(scope="module")
def flown(program: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, str, str]:
    """The doublet, with a switch raised in flight: the run, what the program printed, and what the command did."""
    folder = tmp_path_factory.mktemp("runs") / "doublet"
    command = [
        sys.executable, "-c", SHORTER + "from cosim.cli.main import main; main()",
        "sitl", "ardupilot", "--binary", str(program), *DOUBLET, "--out", str(folder), "--timeout", str(PATIENCE),
        "--instance", "217", "--param", "CC_TYPE=3", "--param", "RC8_OPTION=109", "--channel", "8=2000@0.5",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=FLIGHT_PATIENCE, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return open_run(folder), (folder / "ardupilot" / "ardupilot.log").read_text(), done.stderr


def test_a_doublet_is_flown_as_planned(flown: tuple[Run, str, str]) -> None:
    """Leans as far as asked, holds its heading, and does not fall when the stand lets it go."""
    run, _, _ = flown
    assert run.summary.succeeded, run.reason
    lean, asked = np.degrees(run.log["roll_rad"]), np.degrees(run.log["roll_setpoint_rad"])
    for side in (10.0, -10.0):
        held = lean[np.flatnonzero(np.isclose(asked, side))[-200:]]
        assert np.mean(held) == pytest.approx(side, abs=0.3)
    assert run.metrics["yaw"].max_abs_error_rad < np.radians(2.0)
    assert np.abs(run.log["altitude_m"] - run.log["altitude_m"][0]).max() < 0.15
    books = json.loads((run.folder / "lockstep.json").read_text()) if run.folder else {}
    assert (books["frames"], books["answers"]) == (round((STAND_S + 7.0) / 0.0025),) * 2
    assert (books["channels"], books["parameters"]["CC_TYPE"]) == (["8=2000@0.5"], 3.0)


def test_what_the_program_was_started_with(flown: tuple[Run, str, str]) -> None:
    """At no pace of its own, without a port that waits or is open, with parameters that it knows."""
    _, said, told = flown
    assert "speedup 100" in said
    assert "0 sockets" in said
    assert "Ignored unknown param" not in said
    assert "ArduPilot listens for sticks at UDP port 7671 on every network interface" in told


def test_a_switch_is_raised_when_it_is_stated(flown: tuple[Run, str, str]) -> None:
    _, said, _ = flown
    switched = [line for line in said.splitlines() if line.startswith("Custom controller")]
    assert switched[0].startswith("Custom controller is OFF at 0.0")
    assert 0.5 <= float(switched[1].removeprefix("Custom controller is ON at ")) - STAND_S < 0.53


def test_it_flies_again_without_the_program(flown: tuple[Run, str, str], tmp_path: Path) -> None:
    run, _, _ = flown
    assert run.folder is not None
    again = fly(run.folder / "scenario.toml", tmp_path, report=False)
    assert all(again.log[name].tobytes() == run.log[name].tobytes() for name in again.log.columns)


def test_a_parameter_that_it_does_not_have_fails_the_flight_and_the_run_is_kept(program: Path, hexjet: Hexjet) -> None:
    """It says nothing of it itself; its log, which it begins when it is armed, has the names that it does have."""
    Path("run/ardupilot/logs").mkdir(parents=True)
    Path("run/ardupilot/logs/00000001.BIN").write_bytes(b"of another flight")
    done = hexjet(
        "sitl", "ardupilot", "--binary", str(program), "--set", "duration_s=0.2", "--out", "run", "--timeout",
        str(PATIENCE), "--instance", "218", "--param", "ATC_RAT_RLL_PP=0.2",
    )  # fmt: skip
    assert done.status == 1, done.out + done.err
    assert (
        "failed, ardupilot: parameter ATC_RAT_RLL_PP: this ArduCopter has none of that name; did you mean "
        "ATC_RAT_RLL_P? (parameters, defaults; run/ardupilot/logs)"
    ) in " ".join(done.out.split())
    run = open_run(Path("run"))
    assert (len(run.log), run.outcome) == (50, "failed")


def test_tilting_banks_are_flown_by_the_script(program: Path, tmp_path: Path) -> None:
    """Nose up and to the right at the same time, the banks level about roll: the Hex-Jet with engines that are not late."""
    pitch, yaw = (Scenario.load(f"{axis}-doublet") for axis in ("pitch", "yaw"))
    scenario = pitch.replace(engine="edf", command=[*pitch.command, *yaw.command], duration_s=4.0)
    prepared = prepare("ardupilot", scenario, tmp_path, program, Setup(220, PATIENCE))
    run = fly_autopilot(scenario, prepared, tmp_path, page=False).run
    assert run.outcome == "completed", run.reason
    for axis, degrees, off in (("pitch", 10.0, 0.5), ("yaw", 20.0, 1.5), ("roll", 0.0, 0.5)):
        assert np.degrees(run.log[f"{axis}_rad"][-25:]).mean() == pytest.approx(degrees, abs=off), axis
    assert np.abs(run.log["altitude_m"] - run.log["altitude_m"][0]).max() < 0.3


def test_it_holds_its_place_by_itself_once_the_switch_is_raised(program: Path, tmp_path: Path) -> None:
    """In Loiter, in the wind, which would carry it away by then; one that has no place yet says so and does not."""
    scenario = QUADROTOR.replace(engine="motor", duration_s=5.0, environment={"wind_ned_m_s": [0.0, 3.0, 0.0]})
    early = tmp_path / "early" / "arducopter"
    early.parent.mkdir()
    early.write_text(program.read_text().replace(f"PLACE_S = {PLACE_S}", "PLACE_S = 25.0"))
    early.chmod(0o755)
    for name, holds in ((early, True), (program, False)):
        folder = tmp_path / f"run-{holds}"
        prepared = prepare("ardupilot", scenario, folder, name, Setup(221, PATIENCE, hold_from_s=0.5))
        run = fly_autopilot(scenario, prepared, folder, page=False).run
        away = np.hypot(run.log["north_m"], run.log["east_m"])
        said = (folder / "ardupilot" / "ardupilot.log").read_text()
        assert ("requires position" not in said, bool(away[-1] < 1.0)) == (holds, holds), (said, away[-1], run.reason)
        assert not holds or np.abs(run.log["altitude_m"] - 10.0).max() < 0.3
    assert START_TIMING.before_s > PLACE_S + 10.0


def test_hands_off_it_stands_where_it_is_until_a_station_takes_it(program: Path, tmp_path: Path) -> None:
    """Nobody arms or disarms it, the throttle is closed; home is where it stands, which a vehicle in the air has not."""
    scenario = Scenario.load("climb-and-land").replace(aircraft="quadrotor", engine="motor", step_s=0.0025, command=[])
    scenario = scenario.replace(duration_s=1.0, expect=[])
    made = prepare("ardupilot", scenario, tmp_path, program, Setup(222, PATIENCE, hands_off=True))
    run = fly_autopilot(scenario, made, tmp_path, page=False).run
    assert run.outcome == "completed", run.reason
    assert np.abs(run.log["altitude_m"] - run.log["altitude_m"][0]).max() < 1e-3
    assert "rming motors" not in (tmp_path / "ardupilot" / "ardupilot.log").read_text()
    with pytest.raises(InputError, match="scenario hover begins in the air; a ground station takes a vehicle that st"):
        prepare("ardupilot", QUADROTOR, tmp_path, program, Setup(hands_off=True))


@pytest.mark.parametrize("kept", ["nothing", "no version", "half"])
def test_a_flight_whose_log_does_not_list_all_names_says_that_nobody_checked_them(kept: str, tmp_path: Path) -> None:
    vehicle, _ = QUADROTOR.resolved_vehicle()
    ours = ArduPilot(
        Path("/bin/true"),
        tmp_path,
        vehicle,
        0.0025,
        Geodesy(22.35, 113.59),
        Setup(219, parameters={"NO_SUCH": 1.0}, defaults=tmp_path),
    )
    with suppress(FlightError):
        ours.start()
    ours.close()
    ours.counts.answers = 1
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        begin_log(DEFAULTS, 20.0)
    log = tmp_path / "logs" / "00000001.BIN"
    whole = log.read_bytes()
    with pytest.raises(FlightError, match="NO_SUCH: this ArduCopter has none of that name"):
        ours.check_parameters()
    if kept == "nothing":
        log.unlink()
    else:
        log.write_bytes(whole[: -20 if kept == "no version" else len(whole) // 2])
    said = f"the names of its parameters were not checked: no log in {tmp_path / 'logs'} has all of them"
    assert ours.check_parameters() == said


def test_the_names_of_a_log_are_those_that_the_autopilots_own_reader_finds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pymavlink import DFReader

    monkeypatch.chdir(tmp_path)
    begin_log(DEFAULTS, 20.0)
    theirs = DFReader.DFReader_binary("logs/00000001.BIN")
    named = {}
    while (message := theirs.recv_match(type="PARM")) is not None:
        named[message.Name] = message.Value
    theirs.data_map.close()
    theirs.filehandle.close()
    ours = read_notes(Path("logs/00000001.BIN"))
    assert ours.parameters == named == pytest.approx(DEFAULTS)
    assert ours.version == f"stand-in for {TITLE}"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--channel", "3=2000"], "hexjet: channels 3=2000: must be a channel"),
        (["--gains", "nowhere.toml"], "nowhere.toml"),
        (["--set", "controller=baseline.toml"], "the autopilot flies in the place of the controller"),
        (["--defaults", "binary.parm"], "hexjet: binary.parm: is no text file"),
        (["--binary", "/nope"], "hexjet: binary: /nope: no such file"),
        (["--gains", "fast"], "hexjet: gains fast: must be vehicle, stock, or a file of hexjet design (.toml)"),
        (["--param", "FOO=nan"], "hexjet: parameters FOO=nan: write it as NAME=NUMBER, with a finite number"),
    ],
)
def test_what_cannot_be_flown_is_one_line(given: list[str], said: str, program: Path, hexjet: Hexjet) -> None:
    """Nothing is said of ports where nothing was started."""
    Path("binary.parm").write_bytes(b"\xff\xfe\x00")
    done = hexjet("sitl", "ardupilot", "--binary", str(program), "--aircraft", "quadrotor", "--set", "step_s=0.0025",
                  "--out", "run", *given)  # fmt: skip
    assert done.status == 2, done.out + done.err
    assert done.err.count("\n") == 1, done.err
    assert said in done.err


def heard(pulses: list[int], stated: dict[str, float]) -> Radio:
    """The stand-in's receiver, with what it was sent."""
    kept = Radio.__new__(Radio)
    kept.pulses = pulses
    kept._parameters = {f"RC3_{key}": value for key, value in (("MIN", 1000), ("MAX", 2000), ("DZ", 0))} | stated
    return kept


@pytest.mark.parametrize("hover", [0.2, 0.35, 0.5, 0.6])
def test_the_throttle_that_is_meant_is_what_comes_out_of_its_stick(hover: float) -> None:
    """Bent by it, enlarged for a lean, between its least and most: the stick undoes that, to its steps of a thousandth."""
    stated = {"MOT_THST_HOVER": hover, "MOT_SPIN_MIN": 0.1, "MOT_SPIN_MAX": 0.9}
    ours = Transmitter(stated, [], 0.0025)
    for throttle in np.linspace(0.15, 0.85, 29):
        for roll in (0.0, 1.0):
            sticks = StickPositions(roll=roll, throttle=float(throttle), armed=True)
            frame = SensorFrame(
                50.0, *[(0.0, 0.0, 0.0)] * 2, (1.0, 0.0, 0.0, 0.0), *[(0.0, 0.0, 0.0)] * 2, 10.0, sticks
            )
            share = heard(ours.compute_pulses(frame), {}).throttle(hover) / np.cos(
                np.radians(roll * START_TIMING.lean_deg)
            )
            assert 0.1 + 0.8 * share == pytest.approx(throttle, abs=0.002)


def test_a_gnss_that_is_out_is_taken_away_by_a_switch() -> None:
    """Of ArduPilot's own (RC16_OPTION 65), with which it has no fix, where a frozen one would be a good one."""
    assert ardupilot_sticks()["RC16_OPTION"] == 65
    frame = SensorFrame(
        70.0, *[(0.0, 0.0, 0.0)] * 2, (1.0, 0.0, 0.0, 0.0), *[(0.0, 0.0, 0.0)] * 2, 10.0, StickPositions()
    )
    ours = Transmitter({}, [], 0.0025)
    assert ours.compute_pulses(frame)[15] == 1000
    assert ours.compute_pulses(frame._replace(silent=("gnss",)))[15] == 2000
    assert ours.compute_pulses(frame._replace(silent=("barometer",)))[15] == 1000


@pytest.mark.parametrize(
    ("text", "channel"),
    [
        ("8=2000", TransmitterChannel(8, 2000, None)),
        ("15=1100@0", TransmitterChannel(15, 1100, 0.0)),
        ("9=1500@2.5", TransmitterChannel(9, 1500, 2.5)),
    ],
)
def test_a_transmitter_channel_is_parsed(text: str, channel: TransmitterChannel) -> None:
    assert parse_channel(text, "channels") == channel


@pytest.mark.parametrize(
    "text", ["3=2000", "7=1000", "16=2000", "17=2000", "8=200", "8", "8=2000@-1", "8=high", "0=2000"]
)
def test_what_is_no_channel_is_refused_with_those_that_are(text: str) -> None:
    with pytest.raises(InputError, match=rf"^channels {text}: must be .*; allowed channels: 6, 8, 9, 10, .*, 15$"):
        parse_channel(text, "channels")
