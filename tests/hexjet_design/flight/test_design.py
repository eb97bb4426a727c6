"""hexjet design: the channel against the ledger and a flight, the loop against a second way to it, the files."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from math import ceil, exp, floor, isfinite, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import DESIGNS
from state_space import Body, Loop, first_order
from stored_designs import LINEAR, small_step, stored

from cosim import fly, open_run
from cosim.base.errors import InputError
from cosim.base.storage.toml import read_toml, toml_text
from cosim.campaign.study.model_notes import design_warnings
from cosim.campaign.study.options import open_study
from cosim.cli.main import main
from cosim.control.predictors.linear import model_response, observer_response
from cosim.control.predictors.registry import PREDICTORS
from cosim.control.predictors.state import ModalPredictor, Modes, modal_observer
from cosim.engine import load_engine
from cosim.loops import grid, impulse_response
from cosim.simulation.build import build
from cosim.simulation.controllers.controller_file import (
    NO_PROOF,
    Requirements,
    apply_controller,
    list_differences,
    read_controller,
)
from cosim.simulation.delay_ledger import sum_samples
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import PredictorTuning, RateModel, load_vehicle
from hexjet_design import limits
from hexjet_design import tune as search
from hexjet_design.assessment import margins
from hexjet_design.controller_table import make_controller_table
from hexjet_design.design import Design, design
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import Channel, channels, remove_instant_dynamics
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.dynamics import make_lag_dynamics
from hexjet_design.loop.tuning import Tuning, candidates

TUNING = PredictorTuning(filter_s=0.1, observer_rad_s=40.0, model_observer_rad_s=30.0, disturbance_observer_rad_s=12.0)


def model(poles: list[float], zeros: list[float], delay: float, gain: float = 0.07) -> RateModel:
    return RateModel(gain=gain, zeros=zeros, poles=poles, delay_samples=delay, sample_time_s=0.004, source="test")


def parts(engine: str, **changes: Any) -> tuple[Scenario, Any, Any, dict[str, Channel]]:
    """The channels of the scaled Hex-Jet, the engine's dynamics from its stated numbers."""
    scenario = Scenario.from_table({"name": "x", "duration_s": 1.0, "engine": engine, **changes}, Path(), "x")
    vehicle, _ = load_vehicle(scenario.aircraft, scenario.vehicle)
    spec = load_engine(engine, scenario.engine_parameters, scenario.step_s)
    pole, delay, _ = LINEAR[engine]
    dynamics = Actuator.of(engine, make_lag_dynamics([-scenario.step_s / np.log(pole)], float(delay), scenario.step_s))
    return scenario, vehicle, spec, channels(scenario, vehicle, spec, dynamics)


def tuning(controller: str, channel: Channel, k: float = 2.0, p: float = 0.015, i: float = 0.015) -> Tuning:
    _, vehicle, _, _ = parts("edf")
    gains = vehicle.control.rate.roll.model_copy(update={"p": p, "i": i, "d": 0.0005})
    return Tuning(controller, k, gains, TUNING, channel.model("test"))


# ---- predictors of any order


MODELS = [
    model([0.9999, 0.9024], [-1.4538], 25.0),
    model([0.9999, 0.9024], [-1.4538], 25.4),
    model([0.9999, 0.988, 0.64], [-0.3333, 0.0], 25.0),
    model([0.9999, 0.996, 0.988, 0.64], [-0.3333, 0.0], 7.3),
    model([0.9999, 0.64], [-0.3333], 6.0).model_copy(
        update={"zeros": [-0.3333, 0.0], "pole_pairs": [(0.9966, 0.0039)]}
    ),
    model([1.0, 0.99], [-0.5], 3.0),
    model([0.98, 0.98], [-0.5], 3.0),
]


@pytest.mark.parametrize("disturbance", [False, True])
@pytest.mark.parametrize("each", MODELS, ids=lambda each: f"{len(each.poles)} poles {each.delay_samples:g}")
def test_an_observers_closed_form_is_what_the_predictor_that_flies_does(each: RateModel, disturbance: bool) -> None:
    """The transform of the flying block's impulse response; equal poles are moved apart by 1e-5, and show it."""
    name = "state-disturbance" if disturbance else "state-model"
    z = grid(300)
    flown = impulse_response(lambda: PREDICTORS[name].predictor(each, TUNING), each)(z)
    bandwidth = TUNING.disturbance_observer_rad_s if disturbance else TUNING.model_observer_rad_s
    closed = observer_response(each, bandwidth, disturbance)(z)
    for one, other in zip(flown, closed, strict=True):
        near = 2e-4 if len(set(each.poles)) < len(each.poles) else 2e-7
        assert np.abs(one - other).max() < near * np.abs(one).max()


@pytest.mark.parametrize("disturbance", [False, True])
def test_a_modal_predictor_is_the_two_pole_predictor_where_there_are_two_poles(disturbance: bool) -> None:
    name = "state-disturbance" if disturbance else "state-model"
    bandwidth = TUNING.disturbance_observer_rad_s if disturbance else TUNING.model_observer_rad_s
    rng = np.random.default_rng(1)
    for each in MODELS[:2]:
        one, other = PREDICTORS[name].predictor(each, TUNING), ModalPredictor(each, bandwidth, disturbance)
        for y, u in rng.standard_normal((200, 2)):
            assert one.update(y, u) == pytest.approx(other.update(y, u), rel=1e-8, abs=1e-8)


@pytest.mark.parametrize("each", MODELS[2:5])
def test_a_modal_predictor_tells_the_rate_of_the_delay_to_come(each: RateModel) -> None:
    """Plant and model alike, a constant load that only the disturbance observer learns of."""
    from cosim.control.predictors.smith import DelayedModel, rate_model

    predictor = ModalPredictor(each, 40.0, disturbance=True)
    plant, ahead = DelayedModel(each), rate_model(each)
    load = 0.3
    for k in range(3000):
        u = np.sin(0.05 * k) + 0.2 * np.sin(0.31 * k)
        # the load enters with the command; what the model alone would give without its delay is what is to come
        measured, wanted = plant.update(u + load), ahead.update(u + load)
        predicted = predictor.update(measured, u)
    assert predicted == pytest.approx(wanted, abs=1e-6 * abs(wanted) + 1e-6)


# ---- the channel


def test_a_lag_that_is_over_within_a_step_is_no_state_of_a_predictor() -> None:
    """With a pole of 3e-11 the observer's own poles are anywhere, by rounding; without it they are where they are asked."""
    poles, zeros = [0.9999, 0.907, 0.839, 0.641, 2.8e-11], [-0.14, 0.13, 0.0, 0.0]

    def farthest(poles: list[float], zeros: list[float]) -> float:
        modes = Modes(model(poles, zeros, 0.0, 0.01))
        F, gain = modal_observer(modes, 43.0, 0.004, disturbance=False)
        seen = np.eye(len(gain)) - np.outer(gain, modes.residues)
        return float(np.abs(np.linalg.eigvals(seen @ F)).max())

    fewer, left, delay = remove_instant_dynamics(poles, zeros)
    assert (fewer, left, delay) == (poles[:4], [-0.14, 0.13, 0.0], 0)
    # a fourfold pole moves with the fourth root of the rounding
    assert farthest(fewer, left) == pytest.approx(exp(-43.0 * 0.004), abs=1e-2)
    assert remove_instant_dynamics([0.9, 1e-12], [0.5]) == ([0.9], [0.5], 1)
    assert remove_instant_dynamics([0.9, 0.0], [0.0]) == ([0.9, 0.0], [0.0], 0)  # a delay that is meant stays


def test_the_roll_channel_is_the_ledger() -> None:
    """Gain of the paper's G(z), 433 rad/s^2, and the delay at low frequency that the ledger adds up to."""
    scenario, _, _, found = parts("edf-as-flown")
    roll = found["roll"]
    assert roll.gain == pytest.approx(433.1, rel=1e-3)
    theta = 1e-3
    z = np.array([np.exp(1j * theta)])
    # with the damped integration taken as ideal, as the ledger takes it; behind a hold an integrator is half a step late
    damped = (z - exp(-roll.damping_1_s * roll.step)) / (z - 1.0)
    phase = float(np.angle(roll.responses(z)[0] * damped)[0]) + pi / 2.0
    with build(scenario) as simulation:
        total = sum_samples(simulation.ledger)
    assert -phase / theta == pytest.approx(total, abs=0.02)  # lags bend the phase by their cube


@pytest.mark.parametrize("engine", ["edf", "edf-as-flown", "turbojet"])
def test_the_model_of_a_predictor_is_the_channel_exactly(engine: str) -> None:
    z = grid(300)
    for axis, channel in parts(engine)[3].items():
        if axis != "altitude":
            own = channel.model("x")
            exact = model_response(own, z) * z**-own.delay_samples
            assert np.abs(exact / channel.responses(z)[0] - 1.0).max() < 1e-9


@pytest.mark.parametrize(("axis", "least"), [("roll", 0.3), ("pitch", 0.5), ("yaw", 0.5)])
def test_the_channel_is_what_a_sweep_in_flight_finds(axis: str, least: float) -> None:
    """Composed from engine and airframe, against six degrees of freedom: 2 % or 1 deg where the sweep is coherent.

    The rest is the sweep's own: its points stand for groups of frequencies, and pitch and yaw move the vehicle.
    """
    from cosim.identify.sweep import identify_axis

    settings = ["sensor_noise=false"]
    found = identify_axis(axis, "hexjet", "edf-as-flown", settings=settings, from_hz=least, to_hz=4.0)
    channel = parts("edf-as-flown")[3][axis]
    response = found.response
    z = np.exp(2j * pi * response.hertz * response.step)
    off = np.log(channel.responses(z)[0] / response.value)[response.coherence > 0.95]
    assert len(off) > 10
    assert np.abs(off.real).max() < 0.02
    assert np.degrees(np.abs(off.imag).max()) < 1.0


# ---- the loop


@pytest.mark.parametrize("controller", candidates())
def test_the_loop_agrees_with_state_space(controller: str) -> None:
    """Sensitivity of the closed loop at 500 frequencies, from two realisations that share nothing; and its poles."""
    _, _, _, found = parts("edf-as-flown")
    roll = found["roll"]
    chosen = tuning(controller, roll)
    points = FrequencyGrid(roll, close=2000)
    closed = ClosedLoop(points, chosen)
    second = by_hand("edf-as-flown", roll, chosen)
    assert second.stable == (closed.unstable_poles == 0)
    mine = np.abs(closed.inner / closed.characteristic)
    theirs = second.sensitivity(500)
    at = np.interp(np.geomspace(1e-3, pi, 500), points.theta, mine)
    assert np.abs(at - theirs).max() < 5e-3  # of interpolation between 2000 points
    largest = [np.abs(np.linalg.eigvals(each.A)).max() for each in (closed.space, second)]
    assert largest[0] == pytest.approx(largest[1], abs=1e-7)  # of the second-order rule for the damped rate


def by_hand(engine: str, roll: Channel, chosen: Tuning, gain: float = 1.0, later: int = 0) -> Loop:
    pole, delay, _ = LINEAR[engine]
    body = Body(roll.gain * gain, roll.damping_1_s, roll.step, roll.substeps, roll.rate_filter_s)
    return Loop(
        first_order(pole, delay + later),
        body,
        chosen.controller,
        chosen.model.model_dump(),
        chosen.gains.model_dump(),
        chosen.angle_gain,
        chosen.predictor.model_dump(),
    )


@pytest.mark.parametrize("controller", ["baseline", "smith", "filtered-smith", "state-disturbance"])
def test_margins_put_the_loop_on_the_edge(controller: str) -> None:
    """A per cent either side of a margin one realisation of the loop is stable and the other is not: gain up and down,
    and delay to the sample."""
    roll = parts("edf-as-flown")[3]["roll"]
    chosen = tuning(controller, roll)
    closed = ClosedLoop(FrequencyGrid(roll, close=4000), chosen)
    found = margins(closed)
    assert found.gain_db is not None
    assert found.delay_s is not None
    edge = 10.0 ** (found.gain_db / 20.0)
    assert by_hand("edf-as-flown", roll, chosen, 0.99 * edge).stable
    assert not by_hand("edf-as-flown", roll, chosen, 1.01 * edge).stable
    # the integral of the rate loop and the attitude loop make it conditionally stable
    assert found.gain_down_db is not None
    least = 10.0 ** (found.gain_down_db / 20.0)
    assert least < 1.0
    assert by_hand("edf-as-flown", roll, chosen, 1.01 * least).stable
    assert not by_hand("edf-as-flown", roll, chosen, 0.99 * least).stable
    samples = found.delay_s / roll.step
    assert by_hand("edf-as-flown", roll, chosen, later=floor(samples)).stable
    assert not by_hand("edf-as-flown", roll, chosen, later=ceil(samples)).stable


@pytest.mark.parametrize("controller", ["baseline", "smith", "filtered-smith", "state-disturbance"])
def test_what_is_tolerated_is_where_eigenvalues_reach_the_circle(controller: str) -> None:
    """No pair of a gain and a whole delay in the box that is claimed is unstable, and a little beyond it one is."""
    roll = parts("edf-as-flown")[3]["roll"]
    chosen = (
        tuning(controller, roll, k=1.7, p=0.012)
        if controller == "baseline"
        else tuning(controller, roll, k=3.0, p=0.03)
    )
    closed = ClosedLoop(FrequencyGrid(roll, close=4000), chosen)
    assert closed.unstable_poles == 0
    factor = closed.compute_tolerance(10.0, 0.3)
    inside = [by_hand("edf-as-flown", roll, chosen, g, d).stable for g, d in box(0.97 * factor)]
    assert all(inside)
    beyond = [by_hand("edf-as-flown", roll, chosen, g, d).stable for g, d in box(1.25 * factor)]
    assert not all(beyond)


def box(factor: float) -> Iterator[tuple[float, int]]:
    wide = 10.0 * factor
    for later in range(-min(25, floor(wide)), floor(wide) + 1):
        for gain in (1.0 - 0.3 * factor, 1.0, 1.0 + 0.3 * factor):
            yield max(gain, 0.0), later


def stepped(roll: Channel, chosen: Tuning, set_point: float, load: float, duration: float) -> np.ndarray[Any, Any]:
    """The roll angle [rad] of the flying blocks stepped in time on the engine edf, with steps of both at the start."""
    from cosim.control.rate import RateAxis

    rate_axis = RateAxis(
        chosen.gains, PREDICTORS[chosen.controller].predictor(chosen.model, chosen.predictor), roll.step
    )
    thrust = old = rate = gyro = angle = earlier = 0.0
    pole, step, m = 0.8748, roll.step, roll.substeps
    course = []
    for _ in range(round(duration / step)):
        course.append(angle)
        u = rate_axis.update(chosen.angle_gain * (set_point - angle), gyro, 0.0)
        thrust = pole * thrust + (1.0 - pole) * (u + load)
        before = rate
        for run in range(m):
            felt = old if run == 0 else thrust + 0.5 * (thrust - old) if run == 1 else thrust
            now = roll.gain * felt - roll.damping_1_s * rate
            rate += step / m * (1.5 * now - 0.5 * earlier)
            earlier = now
        old = thrust
        angle += 0.5 * step * (before + rate)
        gyro += (1.0 - roll.gyro_pole) * (rate - gyro)
    return np.array(course)


@pytest.mark.parametrize("controller", candidates())
def test_the_time_response_is_the_blocks_response(controller: str) -> None:
    """Angle after steps of set-point and load, in state space, against the flying blocks stepped in time."""
    roll = parts("edf")[3]["roll"]
    chosen = tuning(controller, roll, k=4.0, p=0.03)
    found = ClosedLoop(FrequencyGrid(roll), chosen).space.steps(2000)
    by_blocks = stepped(roll, chosen, 1.0, 0.0, 8.0)
    # the channel has a damped rate's exact decay, the blocks JSBSim's second-order rule for it
    assert np.abs(by_blocks - found.angle).max() < 2e-6
    loaded = stepped(roll, chosen, 0.0, 0.01, 8.0)  # less than the integral's limit
    assert np.abs(loaded - 0.01 * found.load).max() < 2e-6 * np.abs(found.load).max()


@pytest.mark.parametrize("delay", [25.0, 25.4])
@pytest.mark.parametrize("controller", candidates())
def test_the_time_response_is_that_of_a_second_realisation(controller: str, delay: float) -> None:
    """A whole response identified, also with a delay that is not whole: its step by blocks that fly it."""
    from cosim.control.predictors.smith import DelayedModel
    from cosim.control.rate import RateAxis

    believed = model([0.9999, 0.9024], [-1.4538], delay)
    roll = replace(parts("edf-as-flown")[3]["roll"], identified=believed, added_delay=0)
    chosen = replace(tuning(controller, roll, k=1.5, p=0.01), model=believed)
    blocks = RateAxis(chosen.gains, PREDICTORS[controller].predictor(believed, chosen.predictor), roll.step)
    for set_point, load in ((1.0, 0.0), (0.0, 0.01)):
        plant, rate, angle, course = DelayedModel(believed), 0.0, 0.0, []
        blocks.reset()
        u = None
        for _ in range(1000):
            before, rate = rate, plant.update(u + load) if u is not None else 0.0
            angle += 0.5 * roll.step * (before + rate)
            course.append(angle)
            u = blocks.update(chosen.angle_gain * (set_point - angle), rate, 0.0)
        steps = ClosedLoop(FrequencyGrid(roll), chosen).space.steps(1000)
        found = steps.angle if set_point else 0.01 * steps.load
        assert np.abs(course - found).max() < 1e-8 * np.abs(found).max()


@pytest.mark.parametrize("controller", ["baseline", "filtered-smith", "state-disturbance"])
def test_what_is_told_of_a_step_is_what_python_control_says(controller: str) -> None:
    """Overshoot and settling of the second realisation's closed loop by ``control.step_info``, and both integrals."""
    import control

    roll = parts("edf-as-flown")[3]["roll"]
    chosen = tuning(controller, roll, k=1.7, p=0.012)
    closed = ClosedLoop(FrequencyGrid(roll), chosen)
    second = by_hand("edf-as-flown", roll, chosen)
    time = np.arange(len(closed.steps.angle)) * roll.step
    answer = control.forced_response(second.closed(roll.step), time, np.ones(len(time)))
    told = control.step_info(answer.outputs, time, yfinal=1.0, SettlingTimeThreshold=0.05)
    assert closed.overshoot == pytest.approx(told["Overshoot"] / 100.0, abs=1e-6)
    assert closed.settling_s == pytest.approx(told["SettlingTime"], abs=1.01 * roll.step)
    assert closed.step_error == pytest.approx(np.abs(1.0 - answer.outputs).sum() * roll.step, rel=1e-6)


def test_a_step_that_does_not_settle_says_so() -> None:
    roll = parts("edf-as-flown")[3]["roll"]
    closed = ClosedLoop(FrequencyGrid(roll), tuning("baseline", roll, k=1.0, p=0.0166))
    assert not closed.unstable_poles
    assert np.isnan(ClosedLoop(FrequencyGrid(roll), tuning("baseline", roll, k=0.05, p=0.01)).settling_s)


@pytest.mark.parametrize(
    ("controller", "stays"), [("baseline", False), ("state-disturbance", False), ("state-model", True)]
)
def test_a_load_that_no_integral_removes_is_told(controller: str, stays: bool) -> None:
    """An observer that knows of no disturbance takes a load for a rate: the angle does not come back."""
    roll = parts("edf")[3]["roll"]
    chosen = tuning(controller, roll, k=4.0, p=0.03, i=0.1)
    chosen = replace(chosen, predictor=TUNING.model_copy(update={"disturbance_observer_rad_s": 30.0}))
    closed = ClosedLoop(FrequencyGrid(roll), chosen)
    assert not closed.unstable_poles
    by_blocks = 100.0 * stepped(roll, chosen, 0.0, 0.01, 20.0)
    assert bool(closed.load_left) == stays
    assert closed.load_left == pytest.approx(by_blocks[-1] if stays else 0.0, rel=1e-3)


# ---- the search


@pytest.fixture(scope="module")
def quick() -> Iterator[None]:
    """A short search: its result is worse, and must keep the requirements all the same."""
    kept = search.MAX_GENERATIONS, search.MAX_EVALUATIONS
    search.MAX_GENERATIONS, search.MAX_EVALUATIONS = 4, 40
    yield
    search.MAX_GENERATIONS, search.MAX_EVALUATIONS = kept


@lru_cache
def short(*settings: str, engine: str = "edf-as-flown", controller: str = "smith", least: float = 0.16) -> Design:
    """With one number less to search than the filtered predictor, whose search the stored designs repeat."""
    return design(engine, controller=controller, settings=settings, need=Requirements(min_bandwidth_hz=least))


@pytest.mark.long
@pytest.mark.usefixtures("quick")
def test_a_later_engine_gets_a_model_as_much_later_and_a_slower_loop() -> None:
    """15 samples more; a loop whose bandwidth is bound by the delay loses about as much as the delay gains."""
    one, other = short(), short("engine_parameters.delay_samples=40")
    assert one.ok
    assert other.ok
    first, second = one.axes["roll"].after, other.axes["roll"].after
    assert first is not None
    assert second is not None
    assert second.tuning.model.delay_samples - first.tuning.model.delay_samples == pytest.approx(15.0, abs=1e-9)
    assert second.tuning.model.poles == pytest.approx(first.tuning.model.poles, abs=1e-9)
    assert second.bandwidth_hz < 0.9 * first.bandwidth_hz  # type: ignore[operator]
    assert second.step_error > 1.1 * first.step_error  # type: ignore[operator]
    table = make_controller_table(other)
    assert table["vehicle"]["identified"]["edf-as-flown"]["roll"]["delay_samples"] == pytest.approx(40.0)


@pytest.mark.usefixtures("quick")
def test_a_design_keeps_what_it_states_and_is_the_same_again() -> None:
    found = short()
    again = short.__wrapped__()
    assert make_controller_table(found) == make_controller_table(again)
    own = found.scenario.model_copy(update={"aircraft": "/a/gryphon", "engine": "/a/mine/engine.toml"})
    own_design = replace(found, scenario=own, engine=replace(found.engine, library=False))
    for folder, path in ((Path("/a"), ""), (Path("/a/designs"), "../"), (None, "/a/")):
        made = make_controller_table(own_design, folder)["design"]
        assert (made["aircraft_path"], made["engine_path"]) == (f"{path}gryphon", f"{path}mine/engine.toml")
    assert not {"aircraft_path", "engine_path"} & make_controller_table(found, Path("/a"))["design"].keys()
    for axis, each in found.axes.items():
        after = each.after
        assert after is not None
        assert after.peak_sensitivity is not None
        assert after.peak_sensitivity <= 1.7
        assert after.tolerated is not None
        assert after.tolerated >= 1.0
        assert after.noise is not None
        assert after.noise <= each.channel.room / 12.0
        assert all(each.checks.values()), axis


@pytest.mark.long
@pytest.mark.usefixtures("quick")
def test_where_there_is_no_design_it_says_which_delay_would_allow_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """2 Hz with 0.1 s of delay is beyond every candidate; with what it names it is not."""
    monkeypatch.setattr(limits, "BISECTIONS", 2)
    found = short(least=2.0)
    assert not found.ok
    assert "roll" in found.reason
    assert re.search(r"; nearest comes [\w +-]+, which misses .*[\w ]+ by [\d.e+]+ %", found.reason), found.reason
    allowed = found.allowing["delay_s"]
    assert 0.0 < allowed < 0.1
    with pytest.raises(InputError, match="no acceptable design"):
        make_controller_table(found)
    samples = round(allowed / 0.004)
    assert short(f"engine_parameters.delay_samples={samples}", least=2.0).axes["roll"].after is not None


def test_of_candidates_that_miss_the_requirements_the_nearest_stable_one_is_named() -> None:
    """Gains whose peak sensitivity is too high; a thousand times as much gain is unstable."""
    channel = parts("edf")[3]["roll"]
    own, wild = tuning("smith", channel), tuning("smith", channel, p=15.0)
    tried = {name: search.TuningResult(one, float("inf"), 1) for name, one in (("wild", wild), ("smith", own))}
    peak = limits.fine_loop(channel, own).peak_sensitivity
    asked = Requirements(max_sensitivity=0.5 * peak + 0.5, min_bandwidth_hz=0.0, noise_share=1.0)
    words = limits.describe_nearest(channel, tried, asked)
    assert words.startswith("nearest comes smith, which misses peak sensitivity by ")
    assert f"{100.0 * (peak / asked.max_sensitivity - 1.0):.2g} %" in words
    assert limits.describe_nearest(channel, {"wild": tried["wild"]}, asked) == ""


def test_an_engine_that_does_not_lift_is_refused() -> None:
    with pytest.raises(InputError, match="would hover at"):
        design("turbojet", settings=["vehicle.mass_kg=12.0"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"engine": "edf", "controller": "pid"}, "controller pid"),
        ({"engine": "nothing"}, "unknown engine"),
        ({"engine": "edf", "aircraft": "nothing"}, "unknown aircraft"),
        ({"engine": "edf", "settings": ["mass=1"]}, "unknown key 'mass'"),
        ({"engine": "edf", "settings": ["stations.3.engine='turbojet'"]}, "one engine at all stations"),
    ],
)
def test_wrong_input_is_refused(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        design(**arguments)


# ---- the file


@pytest.mark.parametrize("engine", [*LINEAR, "p220", "p220-2025", "turbine-20", "turbine-100", "turbine-220"])
def test_a_stored_design_keeps_its_margins_in_state_space(engine: str) -> None:
    """What ``hexjet design`` wrote, with nothing of it: sensitivity, and 30 % of delay and gain, every whole sample."""
    file = stored(engine)
    made, control = file["design"], file["vehicle"]["control"]
    vehicle, _ = load_vehicle(made["aircraft"])
    if engine in LINEAR:
        pole, delay, full = LINEAR[engine]
        alone = first_order(pole, delay)
    else:
        alone, full = small_step(engine, made["aircraft"])
        delay = alone.delay
    jets, inertia = vehicle.jets, vehicle.inertia_kg_m2[0]
    gain = sum(abs(jet.position_m[1]) for jet in jets) * full / inertia
    body = Body(
        gain, vehicle.aero.damping_n_m_s[0] / inertia, made["step_s"], made["substeps"], vehicle.sensors.gyro.filter_s
    )
    identified = file["vehicle"].get("identified", {}).get(engine, {}).get("roll")

    def loop(factor: float = 1.0, later: int = 0) -> Loop:
        return Loop(
            replace(alone, delay=delay + later),
            replace(body, gain=gain * factor),
            file["controller"],
            identified,
            control["rate"]["roll"],
            control["attitude"]["gain_1_s"][0],
            control["predictor"],
            control.get("lead", {}).get("roll") or None,
        )

    peak = loop().sensitivity(1500).max()
    near = 2e-3
    assert peak <= 1.7 + near
    assert peak == pytest.approx(made["axes"]["roll"]["peak_sensitivity"], abs=near)
    wide = floor(max(1.0, 0.3 * (delay + 0.25)))
    unstable = [
        (factor, later)
        for later in range(-min(wide, delay), wide + 1)
        for factor in (0.7, 0.85, 1.0, 1.15, 1.3)
        if not loop(factor, later).stable
    ]
    assert not unstable


def test_a_file_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    file = read_controller(DESIGNS / "turbojet.toml")
    scenario = apply_controller("roll-doublet", DESIGNS / "turbojet.toml", ["vehicle.mass_kg=5.6", 'engine="turbojet"'])
    assert scenario.controller == file.controller
    assert scenario.vehicle["control"] == file.vehicle["control"]
    assert scenario.vehicle["mass_kg"] == 5.6
    assert not scenario.expect


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('aircraft = "hexjet"', 'aircraft = "quadrotor"'), "designed for aircraft 'quadrotor'"),
        (("step_s = 0.004", "step_s = 0.002"), "designed for steps of 0.002 s"),
        (('controller = "', 'controller = "x'), "did you mean"),
        (("[vehicle.control.attitude]", "[vehicle.control.attitud]"), "unknown key 'control.attitud'"),
        (("[design]", "[designed]"), "design.aircraft is missing"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    text = (DESIGNS / "edf-as-flown.toml").read_text(encoding="utf-8")
    assert change[0] in text
    path = tmp_path / "wrong.toml"
    path.write_text(text.replace(*change, 1), encoding="utf-8")
    with pytest.raises(InputError, match=said):
        apply_controller(Scenario.load("roll-doublet"), path)


def test_a_file_for_another_engine_is_told(tmp_path: Path) -> None:
    path = DESIGNS / "edf-as-flown.toml"
    other = apply_controller("roll-doublet", path, ['engine="edf"'])
    assert "designed for engine edf-as-flown" in list_differences(other, path)[0]
    shutil.copy(load_engine("edf", {}, other.step_s).path, tmp_path / "own.fmu")
    table = {"name": "own", "duration_s": 1.0, "engine": "own.fmu", "engine_unchecked": True}
    own = Scenario.from_table(table, tmp_path, "own")  # whose engine is seen from its folder
    assert "designed for engine edf-as-flown" in list_differences(own, path)[0]
    later = apply_controller("roll-doublet", path, ["engine_parameters.delay_samples=30"])
    assert any("engine parameters" in text or "designed for engine" in text for text in list_differences(later, path))
    heavier = apply_controller(
        "roll-doublet", path, ["vehicle.mass_kg=6.0", "vehicle.control.attitude.gain_1_s=[1,1,1]"]
    )
    assert list_differences(heavier, path) == ["designed for hexjet with no changes, flown with {'mass_kg': 6.0}"]


def test_a_file_whose_proof_failed_later_is_told(tmp_path: Path) -> None:
    table = read_toml(DESIGNS / "edf-as-flown.toml")
    table["design"]["proof"] = {"flights": 4, "lean_deg": 20.0, "failed": "doublet to 20 deg: diverged"}
    path = tmp_path / "older.toml"
    path.write_text(toml_text(table), encoding="utf-8")
    flown = apply_controller("roll-doublet", path)
    assert list_differences(flown, path) == ["its proof failed: doublet to 20 deg: diverged"]
    assert list_differences(flown, path, noted=False) == []


def test_a_file_without_a_proof_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A run keeps it, as the flight again does, and a study says it before it flies: nobody else would know."""
    table = read_toml(DESIGNS / "edf-as-flown.toml")
    del table["design"]["proof"]
    path = tmp_path / "unproved.toml"
    path.write_text(toml_text(table), encoding="utf-8")
    short = apply_controller("roll-doublet", path, ["duration_s=0.1"])
    assert list_differences(short, path) == [NO_PROOF]
    assert list_differences(short, path, noted=False) == []
    assert NO_PROOF.startswith("has no proof flights: made without one")
    note = f"unproved.toml: {NO_PROOF}"
    arguments = ["fly", "roll-doublet", "--controller", str(path), "--set", "duration_s=0.1", "--out"]
    with pytest.raises(SystemExit):
        main([*arguments, str(tmp_path / "run")])
    assert note in " ".join(capsys.readouterr().out.split())
    run = open_run(tmp_path / "run")
    assert note in run.summary.notes
    assert note in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert fly(tmp_path / "run" / "scenario.toml").summary.notes == run.summary.notes
    assert design_warnings(
        open_study("roll-doublet", controllers=[str(path)], vary=["environment.ground_m=0:10"], runs=2)
    ) == [note]


def test_a_run_keeps_what_its_design_is_not_for(tmp_path: Path) -> None:
    """On standard error it would be gone with the terminal: summary and page have it, and so has the flight again."""
    short = apply_controller("roll-doublet", DESIGNS / "edf.toml", ["duration_s=0.1"])
    run = fly(short, tmp_path / "run")
    (note,) = (text for text in run.summary.notes if text.startswith("edf.toml: "))
    assert note.startswith("edf.toml: designed for engine edf (")
    assert ", flown with edf-as-flown (" in note
    assert note in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert fly(tmp_path / "run" / "scenario.toml").summary.notes == run.summary.notes
    fits = apply_controller("roll-doublet", DESIGNS / "edf-as-flown.toml", ["duration_s=0.1"])
    assert not [text for text in fly(fits).summary.notes if "edf-as-flown.toml: " in text]


@pytest.mark.usefixtures("quick")
def test_the_command_writes_file_and_page(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "made.toml"
    with pytest.raises(SystemExit) as end:
        main(["design", "--engine", "edf", "--controller", "baseline", "--out", str(out), "--json"])
    said = json.loads(capfd.readouterr().out)
    assert not end.value.code
    assert said["ok"]
    assert said["controller"] == "baseline"
    assert isfinite(said["axes"]["roll"]["after"]["peak_sensitivity"])
    assert said["file"]["vehicle"] == tomllib.loads(out.read_text(encoding="utf-8"))["vehicle"]
    page = (tmp_path / "made.html").read_text(encoding="utf-8")
    assert "Nyquist" in page
    assert page.index("Controller: baseline") < page.index("the linear loops</h2>") < page.index("Evidence</h2>")
    assert 'id="figure-nyquist_roll"' in page


@pytest.mark.parametrize(("place", "said"), [("file", ": is a file; "), ("file/made.toml", ": cannot be written to: ")])
def test_where_nothing_can_be_written_nothing_is_searched(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, place: str, said: str
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr("hexjet_design.design.design", None)
    with pytest.raises(SystemExit) as end:
        main(["design", "--engine", "edf", "--out", str(tmp_path / place)])
    assert end.value.code == 2
    told = capfd.readouterr().err
    assert said in told
    assert told.count("\n") == 1
