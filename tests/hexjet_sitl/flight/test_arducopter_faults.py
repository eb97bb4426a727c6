"""What once kept ArduCopter from flying, put back: the stand-in does not let it pass either."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arducopter_standin import installed
from patience import PATIENCE

from cosim.base.errors import FlightError
from cosim.results.run import Run
from cosim.spec.scenario import Scenario
from hexjet_sitl import ardupilot
from hexjet_sitl.lockstep import Setup
from hexjet_sitl.prepare import prepare
from hexjet_sitl.run import fly_autopilot

HOVER = Scenario.load("hover").replace(aircraft="quadrotor", engine="motor", step_s=0.0025, duration_s=0.1)
DOUBLET = Scenario.load("roll-doublet").replace(aircraft="quadrotor", engine="motor", step_s=0.0025, duration_s=3.0)


@pytest.fixture(autouse=True)
def shorter_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stand-in is ready after 25 s."""
    monkeypatch.setattr(ardupilot.ArduPilot, "timing", replace(ardupilot.START_TIMING, before_s=32.0))


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return installed(tmp_path_factory.mktemp("sitl"))


def flown(program: Path, folder: Path, scenario: Scenario, instance: int, **parameters: float) -> Run:
    setup = Setup(instance, PATIENCE, parameters=parameters)
    autopilot = prepare("ardupilot", scenario, folder, program, setup)
    return fly_autopilot(scenario, autopilot, folder, page=False).run


def test_serial_ports_as_they_ship_wait_for_a_station(
    program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ardupilot, "_SERIALS", (1, 2, 5, 6, 7, 8))
    monkeypatch.setattr(ardupilot, "_START_S", 1.5)
    with pytest.raises(FlightError, match=r"ardupilot sent nothing to port 11132 within 1\.5 s"):
        flown(program, tmp_path, HOVER, 213)
    assert "Waiting for connection" in (tmp_path / "ardupilot" / "ardupilot.log").read_text()


def test_a_rate_looked_at_in_its_first_packets_is_not_what_it_is_set_to(
    program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ardupilot, "_RATE_SETTLING", 2)
    assert "asks for 11" in (flown(program, tmp_path, HOVER, 214).reason or "")


@pytest.mark.long
def test_armed_too_late_it_holds_its_motors(program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    timing = replace(ardupilot.ArduPilot.timing, arming_s=1.5, throttle_s=1.0)
    monkeypatch.setattr(ardupilot.ArduPilot, "timing", timing)
    assert "ardupilot was not armed within 32 s" in (flown(program, tmp_path, HOVER, 215).reason or "")


@pytest.mark.long
def test_the_other_frames_rotors_make_the_heading_run_away(program: Path, tmp_path: Path) -> None:
    """X in the place of X reversed: front right, rear left, front left, rear right."""
    functions = {f"SERVO{n}_FUNCTION": 32 + motor for n, motor in enumerate((1, 2, 3, 4), 1)}
    run = flown(program, tmp_path, DOUBLET, 216, FRAME_TYPE=1, **functions)
    assert np.abs(run.log["rate_r_rad_s"]).max() > 5.0


@pytest.mark.long
def test_ranges_of_its_own_sticks_ask_for_another_lean(program: Path, tmp_path: Path) -> None:
    run = flown(program, tmp_path, DOUBLET, 216, RC1_MIN=1100, RC1_MAX=1900, RC1_DZ=20)
    asked, lean = run.log["roll_setpoint_rad"], run.log["roll_rad"]
    held = np.flatnonzero(asked > 0.1)[-200:]
    assert np.mean(lean[held]) / np.mean(asked[held]) == pytest.approx(
        30.0 / 10.0 * (500.0 / 3.0 - 20.0) / 380.0, abs=0.03
    )


LATE = {
    f"ATC_{name}": value
    for axis in ("RLL", "PIT")
    for name, value in (
        (f"ANG_{axis}_P", 2.67), (f"RAT_{axis}_P", 0.0183), (f"RAT_{axis}_I", 0.109), (f"RAT_{axis}_D", 0.00093),
        (f"RAT_{axis}_FLTD", 31.1),
    )
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("title", ["ArduCopter V4.6.3", "ArduCopter V4.8.0-dev"])
def test_shaping_and_feed_forward_as_shipped_are_not_what_was_designed(title: str, tmp_path: Path) -> None:
    """Engines 0.1 s late, gains designed for them, flown alike by both releases; shaped and fed forward they overshoot
    in the older one, and settle late or never in the newer."""
    program = installed(tmp_path, title)
    late = DOUBLET.replace(engine_parameters={"delay_samples": 40.0}, duration_s=6.0)
    ours = flown(program, tmp_path / "ours", late, 216, **LATE).metrics["roll"]
    shipped = flown(program, tmp_path / "theirs", late, 216, **LATE, ATC_RATE_FF_ENAB=1.0, ATC_INPUT_TC=0.15)
    assert ours.overshoot_percent is not None
    assert ours.overshoot_percent < 15.0
    assert ours.settling_time_s is not None
    theirs = shipped.metrics["roll"]
    worse = (theirs.overshoot_percent or 0.0) > 2.0 * ours.overshoot_percent
    assert worse or theirs.settling_time_s is None or theirs.settling_time_s > 1.3 * ours.settling_time_s, theirs
