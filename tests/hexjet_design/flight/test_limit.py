"""The limit of performance: realised as a controller and run in the plant's own difference equations, and bounds kept."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import law_loop
import numpy as np
import pytest
from command_tools import Hexjet
from law_loop import LawLoop
from places import ROOT
from scipy.signal import lfilter

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.signals import Vector3
from cosim.engine import load_engine
from cosim.loops import delayed_margins, sample_delayed
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle.rate_model import RateModel
from hexjet_design.assessment import shipped_tuning
from hexjet_design.load_limit import least_load_error
from hexjet_design.loop import programme as programmes
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.limit import AxisLimit, Limit, Plant, bound_prices, find_limit
from hexjet_design.loop.programme import Bounds, Programme
from hexjet_design.measured.computed import find_loop_limit

pytest.importorskip("clarabel", reason="Clarabel is not installed")

# peak sensitivity, noise and step error of docs/laws.md's laws, and their load error
LAWS = {
    "pid": (Bounds(1.7052, 1.6885e-4, 0.63071), 37.03),
    "pid-smith": (Bounds(1.7050, 5.2588e-4, 0.43806), 88.21),
    "indi": (Bounds(1.7053, 1.28744e-3, 0.63192), 12.99),
}


@cache
def roll() -> Channel:
    """The roll axis of the Hex-Jet with engines that answer 25 steps late."""
    channel: Channel = law_loop.roll()
    return channel


@cache
def least(name: str) -> Limit:
    return find_limit(roll(), LAWS[name][0])


class Realised:
    """The controller that a limit is of: two finite filters behind a model of the channel that runs beside it."""

    def __init__(self, channel: Channel, found: Limit) -> None:
        self.channel = channel
        model, (weights, self.pole) = channel.actuator.model, channel.rate_dynamics
        self.lag, self.late = model.poles[0], int(model.delay_samples)
        self.push = channel.gain * channel.step * weights[0]
        self.gain = model.gain
        pad = np.zeros(8)
        t, y = np.r_[found.complementary, pad], np.r_[found.setpoint, pad]
        inverse = np.convolve([1.0, -self.lag], [1.0, -self.pole])
        of_t, of_y = (lfilter(inverse, [self.gain * self.push], each) for each in (t, y))
        shift = max(channel.rate_latency - channel.angle_latency, 0)
        self.of_angle = lfilter([1.0, -1.0], [channel.step], of_y)
        smooth = channel.gyro_pole
        together = of_t - lfilter(
            np.r_[np.zeros(channel.angle_latency + shift - channel.rate_latency), 0.5, 0.5], [1.0], of_y
        )
        self.of_gyro = lfilter([1.0, -smooth], [1.0 - smooth], together)
        self.of_angle = np.r_[np.zeros(shift), self.of_angle][: len(self.of_gyro)]
        self.reset()

    def reset(self) -> None:
        self.angle_errors, self.gyro_errors = np.zeros(len(self.of_gyro)), np.zeros(len(self.of_gyro))
        self.sent, self.force, self.rate = [0.0] * self.late, 0.0, 0.0
        self.gyro = [0.0] * (self.channel.rate_latency + 1)
        self.angle = [0.0] * (self.channel.angle_latency + 1)

    def update(self, setpoint: Vector3, gyro: Vector3, acting: Vector3) -> Vector3:
        self.angle_errors = np.r_[setpoint[0] + self.angle[-1], self.angle_errors[:-1]]
        self.gyro_errors = np.r_[gyro[0] - self.gyro[-1], self.gyro_errors[:-1]]
        command = float(self.of_angle @ self.angle_errors - self.of_gyro @ self.gyro_errors)
        self.sent.append(command)
        smooth, last = self.channel.gyro_pole, self.rate
        self.force = self.lag * self.force + self.gain * self.sent.pop(0)
        self.rate = self.pole * self.rate + self.push * self.force
        self.gyro = [smooth * self.gyro[0] + (1.0 - smooth) * self.rate, *self.gyro[:-1]]
        self.angle = [self.angle[0] + 0.5 * self.channel.step * (last + self.rate), *self.angle[:-1]]
        return (command, 0.0, 0.0)


def check(channel: Channel, found: Limit) -> None:
    """What the programme says is what the controller does."""
    loop = LawLoop(channel, Realised(channel, found), 1.0)
    assert loop.load_error == pytest.approx(found.load_error, rel=1e-5)
    assert loop.step_error == pytest.approx(found.step_error, rel=1e-5)
    assert loop.noise == pytest.approx(found.noise, rel=1e-5)
    assert loop.peak_sensitivity == pytest.approx(found.peak_sensitivity, rel=1e-4)


@pytest.mark.parametrize("name", ["pid", "indi"])
def test_the_limit_is_a_controller_that_does_what_is_said(name: str) -> None:
    check(roll(), least(name))


@pytest.mark.long
def test_sensors_that_are_late_by_different_steps() -> None:
    for rate, angle in ((3, 1), (0, 2)):
        late = replace(roll(), rate_latency=rate, angle_latency=angle)
        check(late, find_limit(late, Bounds(1.8, 1e-3, 0.7)))


@pytest.mark.parametrize("name", LAWS)
def test_no_law_is_below_it_and_its_bounds_are_kept(name: str) -> None:
    found, (bounds, error) = least(name), LAWS[name]
    assert found.load_error < error
    assert found.step_error <= 1.001 * bounds.step_error
    assert found.noise <= 1.001 * bounds.noise
    assert found.peak_sensitivity <= 1.001 * bounds.peak_sensitivity


@pytest.mark.long
def test_a_finer_spline_changes_little(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programmes, "KNOTS_PER_DELAY", 2.0 * programmes.KNOTS_PER_DELAY)
    finer = find_limit(roll(), LAWS["pid"][0])
    assert 0.97 * least("pid").load_error < finer.load_error < 1.001 * least("pid").load_error


@pytest.mark.long
def test_a_tolerance_of_the_delay_costs_and_is_there() -> None:
    bounds = LAWS["pid-smith"][0]._replace(delay_error=9.5)
    found = find_limit(roll(), bounds)
    assert found.load_error > find_limit(roll(), bounds._replace(delay_error=8.5)).load_error
    assert found.load_error > 1.2 * least("pid-smith").load_error
    assert LAWS["pid-smith"][1] > 5.2 * found.load_error
    loop = LawLoop(roll(), Realised(roll(), found), 1.0)
    for error in (-9.5, -5.0, 5.0, 9.5):
        assert (loop.with_delay(error) or np.inf) <= 2.0 * bounds.peak_sensitivity * 1.001


def designed() -> Channel:
    """The roll axis of tests/designs/turbojet.toml, with a pole near 1; its third pole is the filter of the gyro."""
    written = tomllib.loads((ROOT / "tests" / "designs" / "turbojet.toml").read_text(encoding="utf-8"))
    model = RateModel(**written["vehicle"]["identified"]["turbojet"]["roll"])
    rate = {"gain": model.gain / (1.0 - model.poles[2]), "zeros": [0.0], "poles": model.poles[:2]}
    return replace(roll(), identified=model.model_copy(update=rate))


def test_the_error_after_a_load_has_no_rounding_of_its_integrals() -> None:
    plant = Plant(designed(), 5500)
    model, apart, late = designed().model("exact"), 40, plant.late + plant.rate_late
    t = np.bincount([0, apart], [1.0 + late / apart, -late / apart], plant.length)
    acts = np.bincount([0, late, late + apart], [1.0, -t[0], -t[apart]], plant.samples).astype(np.longdouble)
    angle = 0.5 * plant.step * model.gain * np.cumsum(np.cumsum(acts + np.r_[0.0, acts[:-1]]))
    for pole in model.poles:
        angle = np.asarray(lfilter([np.longdouble(1.0)], [np.longdouble(1.0), -np.longdouble(pole)], angle))
    error = float(np.abs(angle[: -plant.late]).sum()) * plant.step
    assert plant.evaluate(LAWS["pid"][0], t, t).load_error == pytest.approx(error, rel=1e-9)


@pytest.mark.long
def test_the_limit_of_a_design_with_slow_poles_is_found() -> None:
    assert find_limit(designed(), Bounds(1.69317, 0.012733, 0.54721)).load_error == pytest.approx(6.2026, rel=1e-3)


@pytest.mark.parametrize(
    ("channel", "bounds", "reason"),
    [
        ({}, Bounds(1.7, 1e-3, 0.1), "no controller has a step error below the delay itself"),
        ({}, Bounds(1.05, 1e-6, 0.3), "no linear controller was found with a peak sensitivity of at most 1.05"),
        ({"rate_hold": 2}, Bounds(1.7, 1e-3, 0.6), "where measurements are held"),
    ],
)
def test_what_has_no_limit_is_a_line(channel: dict[str, float], bounds: Bounds, reason: str) -> None:
    with pytest.raises(InputError, match=reason) as refused:
        find_limit(replace(roll(), **channel), bounds)  # type: ignore[arg-type]
    assert "\n" not in str(refused.value)


def test_without_the_solver_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programmes, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install clarabel"):
        find_limit(roll(), LAWS["pid"][0])


def test_a_rate_with_a_pole_at_one_is_followed_without_a_slope() -> None:
    free = replace(roll(), damping_1_s=0.0)
    found = find_limit(free, Bounds(1.9, 1e-3, 0.8))
    t: Array = found.complementary
    late = 26 + np.arange(len(t))
    assert float(t.sum()) == pytest.approx(1.0, abs=1e-6)
    assert float((late * t).sum()) == pytest.approx(0.0, abs=1e-4)
    check(free, found)


@pytest.mark.long
def test_what_a_bound_costs_is_what_the_least_falls_by_without_a_tenth_of_it() -> None:
    found = least("pid")
    prices = bound_prices(roll(), found)
    assert list(prices) == ["peak_sensitivity", "noise", "step_error"]
    looser = find_limit(roll(), found.bounds._replace(noise=1.1 * found.bounds.noise))
    assert prices["noise"] == pytest.approx(1.0 - looser.load_error / found.load_error)
    assert min(prices["peak_sensitivity"], prices["noise"]) > 0.02
    said = AxisLimit(2.0 * found.load_error, found, None, prices).describe()
    assert said.startswith("its error after a load is 2.00 times the least")
    assert f"; that least falls with 10 % more peak sensitivity by {100.0 * prices['peak_sensitivity']:.1f} %, " in said


def test_margins_end_with_the_limit_and_the_tolerance_of_the_delay_beside_it(hexjet: Hexjet, tmp_path: Path) -> None:
    axes = ("--axis", "roll", "--axis", "pitch")
    short = ("--period", "4", "--periods", "3", "--out", str(tmp_path / "margins"), "--json")
    done = hexjet("margins", "--limit", *axes, *short)
    assert done.status == 0, done.err
    roll = json.loads(done.out)["axes"]["roll"]["limit"]
    assert roll["times"] > roll["times_as_tolerant"] > 1.0
    assert roll["delay_error_samples"] > 0.0
    page = (tmp_path / "margins" / "report.html").read_text(encoding="utf-8")
    assert "times the least that any linear controller leaves" in page
    assert f"its tolerance of the delay, {roll['delay_error_samples']:g} samples either way" in page


def test_a_loop_without_a_limit_says_why_in_margins() -> None:
    scenario = Scenario.load("roll-doublet")
    vehicle, _ = scenario.resolved_vehicle()
    tuning = shipped_tuning(roll(), vehicle, load_engine(scenario.engine, {}, scenario.step_s))
    loop = ClosedLoop(FrequencyGrid(replace(roll(), rate_hold=2), close=100), tuning)
    assert find_loop_limit(loop) == "roll: no limit is computed where measurements are held"
    with pytest.raises(InputError, match="is not known: the solver stopped before it was found"):
        Programme(Plant(roll(), 1000), LAWS["pid"][0]).solve(exact=1e-15)


@pytest.mark.parametrize(
    ("plant", "late", "error"),
    [
        (([2.0], [1.0]), 2, 0.04),  # a gain: the load is there for the delay, 2 * 2 * 0.01
        (([0.5], [1.0, -1.0]), 1, 0.015),  # an integrator, 2 steps late: 0.5, then 1.0 before a command acts
    ],
)
def test_the_limit_of_a_fraction_is_what_a_load_does_before_any_command(
    plant: tuple[list[float], list[float]], late: int, error: float
) -> None:
    found = least_load_error(*plant, dt=0.01, delay=0.01 * late, peak=20.0, window=0.3)
    assert found.load_error == pytest.approx(error, rel=1e-3)


def test_the_limit_of_a_fraction_is_below_a_controller_that_keeps_the_same_and_goes_with_the_gain() -> None:
    """A PI of an integrator with a delay, run step by step; a plant of thrice the gain has thrice the error."""
    dt, late, p, i = 0.01, 6, 4.0, 4.0
    n, d = sample_delayed([1.0], [1.0, 0.0], dt, late * dt)
    margins = delayed_margins(np.convolve(n, [p + i * dt, -p]), np.convolve(d, [1.0, -1.0]), dt)
    load, noise = (np.zeros(4000) for _ in range(2))
    for response, pushed, measured in ((load, 1.0, 0.0), (noise, 0.0, 1.0)):
        y, integral, sent = 0.0, 0.0, [0.0] * late
        for k in range(len(response)):
            heard = y + (measured if k == 0 else 0.0)
            integral += i * dt * heard
            sent.append(-p * heard - integral)
            response[k] = sent[-1] if measured else y
            y += dt * (sent.pop(0) + pushed)
    error, gain = float(np.abs(load).sum()) * dt, float(np.linalg.norm(noise))
    peak = margins.peak_sensitivity or 0.0
    one, three = (least_load_error(scale * n, d, dt, 0.0, peak, gain / scale, window=1.5) for scale in (1, 3))
    assert 0.3 * error < one.load_error < error
    assert one.noise <= 1.001 * gain
    assert one.peak_sensitivity <= 1.001 * peak
    assert three.load_error == pytest.approx(3.0 * one.load_error, rel=1e-4)


@pytest.mark.parametrize(
    ("plant", "reason"),
    [
        (([1.0], [1.0, -1.1], 0.01), "a pole on or outside the unit circle"),
        (([1.0, 0.0], [1.0, -0.9], 0.01), "answers in the step of the command"),
        (([1.0], [1.0, -0.9], 0.01, 0.015), "is not whole steps of 0.01 s; sample_delayed"),
        (([1.0], [1.0, -0.99999], 0.01, 0.01), "steps; 18, nine times the delay, to 20000"),
        (([1.0], [1.0, -0.9], 0.01, 0.01, 0.9), "peak: 0.9 and noise: inf; above 1 and above 0"),
        (([1.0], [1.0, -0.9], 0.01, 0.05, 1.7, 1e-3), "no linear controller was found with a peak sensitivity"),
    ],
)
def test_a_fraction_without_a_limit_is_a_line(plant: tuple[list[float], ...], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        least_load_error(*plant)  # type: ignore[arg-type]
