"""A flight with a stand-in in the place of PX4 and of ArduPilot: a run like any other, and the same again without it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any

from autopilot_standins import ArduPilotStandIn, Px4StandIn
from patience import PATIENCE

from cosim import fly
from cosim.base.geodesy import Geodesy
from cosim.spec.scenario import Scenario
from hexjet_sitl.ardupilot import ArduPilot
from hexjet_sitl.lockstep import Autopilot, Setup, StartTiming
from hexjet_sitl.px4 import Px4
from hexjet_sitl.run import AutopilotRun, fly_autopilot

HOVER = Scenario.load("hover").replace(duration_s=1.0, engine="edf")
VEHICLE = HOVER.resolved_vehicle()[0]
PLACE = Geodesy(22.35, 113.59)
START_TIMING = StartTiming(before_s=2.0, arming_s=1.5, throttle_s=0.5, lean_deg=35.0, turn_deg_s=150.0)


def fly_it(autopilot: Autopilot, folder: Path, scenario: Scenario = HOVER) -> AutopilotRun:
    autopilot.timing = START_TIMING  # type: ignore[misc]
    return fly_autopilot(scenario, autopilot, folder)


def same_again(flown: AutopilotRun, folder: Path) -> None:
    assert flown.run.folder is not None
    again = fly(flown.run.folder / "scenario.toml", folder, report=False)
    assert again.outcome == flown.run.outcome
    assert again.log.columns == flown.run.log.columns
    assert all(again.log[name].tobytes() == flown.run.log[name].tobytes() for name in again.log.columns)


def test_px4_flies_by_the_sticks(tmp_path: Path) -> None:
    """The throttle stick comes back as throttle, so that the pilot's height loop closes over the stand-in."""

    def controls(told: dict[str, Any]) -> Sequence[float]:
        rates, sticks = told["HIL_SENSOR"], told["RC_CHANNELS"]
        throttle = (sticks.chan3_raw - 1000) / 1000
        roll, pitch = -0.02 * rates.xgyro, 0.2 * rates.ygyro  # forward pushes the nose down
        return (
            [throttle + (-roll if jet.servo == "right" else roll) for jet in VEHICLE.jets] + [pitch, pitch] + [0.0] * 8
        )

    ours = Px4(None, tmp_path / "px4", VEHICLE, HOVER.step_s, PLACE, Setup(31_007, PATIENCE))
    theirs = Px4StandIn(4560 + 31_007, controls=controls)
    flown = fly_it(ours, tmp_path / "run")
    theirs.thread.join(PATIENCE)
    assert flown.run.summary.succeeded, flown.run.reason
    assert flown.counts.answers == flown.counts.frames - flown.counts.boot == 750 - 10
    assert abs(flown.run.log["altitude_m"][-1] - 10.0) < 0.1
    assert theirs.seen["HIL_STATE_QUATERNION"] == 375
    books = json.loads((tmp_path / "run" / "lockstep.json").read_text())
    assert (books["autopilot"], books["steps"], books["repeated"]) == ("px4", 250, 0)
    same_again(flown, tmp_path / "again")


def test_ardupilot_that_hangs_ends_the_flight_and_keeps_the_run(tmp_path: Path) -> None:
    """Named with step and time; the record flies again as far as it goes."""
    ours = ArduPilot(None, tmp_path / "ardupilot", VEHICLE, HOVER.step_s, PLACE, Setup(3307, PATIENCE))
    packets = count()

    def pulses(told: dict[str, Any]) -> Sequence[int]:
        if next(packets) == 600:  # nothing comes after it: only that is waited for by the clock
            ours.limit = 0.5
        return [1450] * 6 + [1500] * 10

    theirs = ArduPilotStandIn(9002 + 33_070, hang=600, pulses=pulses)
    flown = fly_it(ours, tmp_path / "run")
    theirs.close()
    assert flown.run.outcome == "failed"
    assert "ardupilot did not answer within 0.5 s at step 100 (0.400 s)" in flown.run.reason
    assert len(flown.run.log) == 100
    again = fly(tmp_path / "run" / "scenario.toml", tmp_path / "again", report=False)
    assert "the record ends after 100 steps" in again.reason
    assert again.log["pitch_rad"].tobytes() == flown.run.log["pitch_rad"].tobytes()


def test_one_that_is_not_armed_does_not_fly(tmp_path: Path) -> None:
    ours = ArduPilot(None, tmp_path / "ardupilot", VEHICLE, HOVER.step_s, PLACE, Setup(3308, PATIENCE))
    theirs = ArduPilotStandIn(9002 + 33_080, pulses=lambda told: [1000] * 16)
    flown = fly_it(ours, tmp_path / "run")
    theirs.close()
    assert (flown.run.outcome, flown.run.reason) == ("failed", "ardupilot was not armed within 2 s, before the flight")
