"""A flight with a stand-in in the place of PX4 and of ArduPilot: a run like any other, and the same again without it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any

from autopilot_standins import ArduPilotStandIn
from patience import PATIENCE

from cosim import fly
from cosim.base.geodesy import Geodesy
from cosim.spec.scenario import Scenario
from hexjet_sitl.ardupilot import ArduPilot
from hexjet_sitl.lockstep import Autopilot, Setup, StartTiming
from hexjet_sitl.run import AutopilotRun, fly_autopilot

HOVER = Scenario.load("hover").replace(duration_s=1.0, engine="edf")
VEHICLE = HOVER.resolved_vehicle()[0]
PLACE = Geodesy(22.35, 113.59)
START_TIMING = StartTiming(before_s=2.0, arming_s=1.5, throttle_s=0.5, lean_deg=35.0, turn_deg_s=150.0)


def fly_it(autopilot: Autopilot, folder: Path, scenario: Scenario = HOVER) -> AutopilotRun:
    autopilot.timing = START_TIMING  # type: ignore[misc]
    return fly_autopilot(scenario, autopilot, folder)


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
