"""Other autopilots' loops as responses, against the same loops written out line by line and closed step by step."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import pi
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from law_loop import LawLoop

from cosim.base.errors import InputError
from cosim.base.signals import Vector3
from cosim.cli.main import run
from cosim.engine import load_engine
from cosim.simulation.controllers.controller_file import Requirements
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import RateGains, Vehicle, load_vehicle
from hexjet_design.assessment import assess
from hexjet_design.design import _AxisInputs, _design_axes, _firmware_on_axis
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import Channel, channels
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.dynamics import make_lag_dynamics
from hexjet_design.loop.firmware import Firmware
from hexjet_design.loop.tuning import Tuning
from hexjet_design.tune import tune_digits
from hexjet_sitl.betaflight import compute_gain_units, make_gain_settings
from hexjet_sitl.firmware_parameters import find_loops as firmware_for

STEP = 0.004
GAINS = RateGains(p=0.0105, i=0.0133, d=0.00086, d_filter_s=1.0 / (2.0 * pi * 21.0), integral_limit=1.0)
ANGLE = 1.6


@cache
def place() -> tuple[Vehicle, Channel]:
    scenario = Scenario.load("hover")
    vehicle, _ = scenario.resolved_vehicle()
    actuator = Actuator.of("fan", make_lag_dynamics([0.0299], 25.0, STEP))
    return vehicle, channels(scenario, vehicle, load_engine("edf-as-flown", {}, STEP), actuator)["roll"]


def low_pass(state: float, value: float, hertz: float, period: float) -> float:
    """``pt1FilterApply`` with ``pt1FilterGain``; PX4's AlphaFilter and ArduPilot's calc_lowpass_alpha_dt are the same."""
    time = 1.0 / (2.0 * pi * hertz)
    return state + period / (time + period) * (value - state)


class Written:
    """A loop on roll alone, once a step of the flight."""

    def __init__(self, gains: RateGains) -> None:
        self.gains, self.hertz = gains, 1.0 / (2.0 * pi * gains.d_filter_s)
        self.reset()

    def reset(self) -> None:
        self.kept = dict.fromkeys(("i", "slope", "asked", "last"), 0.0)

    def update(self, setpoint: Vector3, measured: Vector3, applied: Vector3) -> Vector3:
        return (self.once(setpoint[0], measured[0]), 0.0, 0.0)

    def once(self, r: float, y: float) -> float:
        raise NotImplementedError


class Betaflight(Written):
    """32 of its loops in a step of the flight, the filters as gains of their own, which saves most of the time."""

    def reset(self) -> None:
        self.state = (0.0,) * 7
        share = [low_pass(0.0, 1.0, hertz, 125e-6) for hertz in (250.0, 500.0, 50.0 * 1.961459177, self.hertz)]
        self.first, self.second, self.level, self.slow = share

    def update(self, setpoint: Vector3, measured: Vector3, applied: Vector3) -> Vector3:
        g1, g2, a, b, c, total, slope = self.state
        first, second, level, slow, gains, t = self.first, self.second, self.level, self.slow, self.gains, 125e-6
        answer = None
        for _ in range(32):
            g1 += first * (measured[0] - g1)
            before = g2
            g2 += second * (g1 - g2)
            a += level * (setpoint[0] - a)
            b += level * (a - b)
            c += level * (b - c)
            total += gains.i * t * (c - g2)
            slope += slow * ((before - g2) / t - slope)
            if answer is None:  # what is given out is the first
                answer = gains.p * (c - g2) + total + gains.d * slope
        self.state = (g1, g2, a, b, c, total, slope)
        return (answer or 0.0, 0.0, 0.0)


class Px4(Written):
    def once(self, r: float, y: float) -> float:
        k, gains = self.kept, self.gains
        k["slope"] = low_pass(k["slope"], (y - k["last"]) / STEP, self.hertz, STEP)
        error = k["asked"] - y
        torque = gains.p * error + k["i"] - gains.d * k["slope"]
        k["i"] += gains.i * error * STEP
        k["asked"], k["last"] = r, y
        return torque


class ArduPilot(Written):
    def once(self, r: float, y: float) -> float:
        k, gains = self.kept, self.gains
        error = k["asked"] - y
        k["slope"] = low_pass(k["slope"], (error - k["last"]) / STEP, self.hertz, STEP)
        k["i"] += gains.i * error * STEP
        k["asked"], k["last"] = r, error
        return gains.p * error + k["i"] + gains.d * k["slope"]


def tuning(channel: Channel, firmware: Firmware, gains: RateGains = GAINS) -> Tuning:
    vehicle, _ = place()
    own = vehicle.control.predictor
    return Tuning("baseline", ANGLE, gains, own, channel.model("none"), firmware=firmware)


@pytest.mark.parametrize(("name", "written"), [("betaflight", Betaflight), ("px4", Px4), ("ardupilot", ArduPilot)])
def test_a_firmwares_loop_is_that_of_its_lines(name: str, written: type[Written]) -> None:
    _, channel = place()
    flown = LawLoop(channel, written(GAINS), ANGLE)
    exact = ClosedLoop(FrequencyGrid(channel, close=4000), tuning(channel, Firmware(name)))
    assert exact.unstable_poles == 0
    for what in ("step_error", "load_error", "step_peak", "overshoot"):
        assert getattr(flown, what) == pytest.approx(getattr(exact, what), rel=1e-7), what
    assert flown.peak_sensitivity == pytest.approx(exact.peak_sensitivity, rel=1e-3)
    ours = ClosedLoop(FrequencyGrid(channel, close=4000), replace(tuning(channel, Firmware(name)), firmware=None))
    assert abs(ours.step_error / exact.step_error - 1.0) > 1e-3  # its filters and delays are there


def test_an_estimators_angle_is_as_late_as_its_gyro() -> None:
    """The angle that PX4 and ArduPilot hold is the integral of what the gyro says, low-pass and all; Betaflight's is told."""
    _, channel = place()
    z = np.exp(2j * pi * np.array([0.5, 2.0, 8.0]) * STEP)
    rate, angle, _ = replace(channel, angle_from_gyro=True).responses(z)
    assert np.allclose(angle / rate, 0.5 * STEP * (z + 1.0) / (z - 1.0), rtol=1e-12)
    late = np.angle(channel.responses(z)[1] / angle) / np.angle(z) * STEP
    pole = channel.gyro_pole
    assert late[0] == pytest.approx(pole / (1.0 - pole) * STEP, rel=1e-2)
    assert [Firmware(name).estimates_attitude for name in ("betaflight", "px4", "ardupilot")] == [False, True, True]


def test_an_output_that_a_script_keeps_is_a_step_of_delay() -> None:
    assert firmware_for("ardupilot", "hexjet", ()).output_delay == 1
    assert (
        firmware_for("ardupilot", "quadrotor", ()).output_delay == firmware_for("px4", "hexjet", ()).output_delay == 0
    )


@pytest.mark.parametrize("pitch_takes", [9.0, 2.0, 0.0])
def test_where_pitch_does_not_take_rolls_attitude_gain_both_have_that_of_pitch(
    pitch_takes: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Roll would have 5; pitch takes up to a gain, or none at all; an autopilot with one for both has the smaller."""
    made: list[tuple[str, float | None]] = []

    def axis(channel: str, inputs: Any, roll: Any) -> Any:
        firmware = _firmware_on_axis(inputs.firmware, channel, roll) if channel != "roll" else inputs.firmware
        fixed = None if firmware is None else firmware.angle_gain
        gain = fixed or (min(pitch_takes, 4.0) if channel == "pitch" else 5.0)
        made.append((channel, fixed))
        tuning = SimpleNamespace(angle_gain=gain, gains=GAINS)
        fails = channel == "pitch" and (gain > pitch_takes or gain == 0.0)
        return SimpleNamespace(after=None if fails else SimpleNamespace(tuning=tuning))

    monkeypatch.setattr("hexjet_design.design._tune", axis)
    inputs = _AxisInputs(*[None] * 6, Firmware("betaflight", common_angle=True), print)  # type: ignore[arg-type]
    plants: Any = {name: name for name in ("roll", "pitch", "yaw", "altitude")}
    axes, used = _design_axes(plants, inputs, None)
    gains = {name: made.after and made.after.tuning.angle_gain for name, made in axes.items()}
    if pitch_takes == 9.0:
        assert (gains["roll"], gains["pitch"], len(made)) == (5.0, 5.0, 4)
    elif pitch_takes == 2.0:
        assert (gains["roll"], gains["pitch"], gains["yaw"]) == (2.0, 2.0, 5.0)
        assert used.firmware is not None
        assert used.firmware.angle_gain == 2.0
    else:
        assert (gains["roll"], gains["pitch"]) == (5.0, None)


def test_gains_are_whole_and_no_neighbour_is_better() -> None:
    """From a start beside it, in Betaflight's units; what is written into its console are those numbers."""
    vehicle, channel = place()
    firmware = Firmware("betaflight", units=compute_gain_units(vehicle))
    need = Requirements()
    found = tune_digits(channel, tuning(channel, firmware), need)
    assert found is not None
    whole = [
        value / unit
        for value, unit in zip((found.angle_gain, *values(found)), compute_gain_units(vehicle)["roll"], strict=True)
    ]
    assert whole == pytest.approx(np.round(whole), abs=1e-9)
    assert tune_digits(channel, found, need) == found
    told = {"rate": {"roll": found.gains.model_dump()}, "attitude": {"gain_1_s": [found.angle_gain] * 3}}
    flown, _ = load_vehicle("hexjet", {"control": told}, "here")
    lines = make_gain_settings(flown)
    for key, value in zip("pid", whole[1:], strict=True):
        assert f"set {key}_roll = {round(value)}" in lines
    assert f"set angle_p_gain = {round(whole[0])}" in lines
    state = assess(channel, found, need)
    assert state.margins is not None
    assert state.margins.delay_s is not None
    # the margin is where it says: less than it more of delay is stable, more is not
    late = state.margins.delay_s / STEP
    assert ClosedLoop(FrequencyGrid(channel.with_delay(25.0 + late - 0.05), close=4000), found).unstable_poles == 0
    assert ClosedLoop(FrequencyGrid(channel.with_delay(25.0 + late + 0.05), close=4000), found).unstable_poles == 2


def values(found: Tuning) -> tuple[float, float, float]:
    return found.gains.p, found.gains.i, found.gains.d


@pytest.mark.parametrize(
    ("told", "said"),
    [
        (["--for", "ardupilot", "--aircraft", "trijet"], "is flown by effectiveness"),
        (["--for", "px4", "--controller", "smith"], "no predictor of ours"),
        (["--for", "betaflight", "--start", "gains.toml"], "no predictor of ours"),
        (["--for", "inav"], "'inav': allowed: ardupilot, betaflight, px4"),
    ],
)
def test_what_no_autopilot_has_is_refused(told: list[str], said: str) -> None:
    with pytest.raises(InputError) as error:
        run(["design", *told])
    assert said in str(error.value)
