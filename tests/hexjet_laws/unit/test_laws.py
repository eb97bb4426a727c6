"""The laws of the literature: their algebra against small exact cases, their loops against the stated peak sensitivity."""

from __future__ import annotations

import importlib
import sys
import tomllib
from dataclasses import replace
from functools import cache
from math import cos, exp, pi, radians, sin
from typing import Any

import law_loop
import numpy as np
import pytest
from law_loop import LawLoop
from optimal_block import Behind
from places import ROOT
from scipy.linalg import expm
from scipy.optimize import lsq_linear

from cosim import InputError, Scenario, fly
from cosim.base.protocols import Parameter
from cosim.base.signals import Unallocated, Vector3
from cosim.control.belief import Belief
from cosim.control.laws.axis import Actuators, Axis
from cosim.control.predictors.linear import model_response
from cosim.control.rate import RateController
from cosim.engine import EngineSpec, load_engine
from cosim.simulation.build import build
from cosim.simulation.controllers.models import make_predictors, make_scenario_belief
from cosim.spec.vehicle import Vehicle
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import Channel, channels
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.dynamics import make_lag_dynamics
from hexjet_design.loop.optimal import ModelForm, Optimal, Target, fit_weights
from hexjet_design.loop.tuning import Tuning
from hexjet_laws.adrc import AdrcAxis
from hexjet_laws.indi import DAMPING, IndiAxis, SecondOrder
from hexjet_laws.lqg import KalmanFilter, add_delay, discrete_model, regulator
from hexjet_laws.mpc import MpcAxis
from hexjet_laws.px4 import MAX_INTEGRATED_ERROR, LowPass, Px4Axis

STEP = 0.004
DOUBLET = {"kind": "doublet", "signal": "roll_deg", "start_s": 0.04, "amplitude": 10.0, "width_s": 0.3}
ROLL = Scenario.load("roll-doublet").replace(duration_s=0.6, command=[DOUBLET], expect=[])
with (ROOT / "pyproject.toml").open("rb") as file:
    ENTRIES: dict[str, str] = tomllib.load(file)["project"]["entry-points"]["hexjet.plugins"]
LAWS = {name.removeprefix("controller."): value for name, value in ENTRIES.items()}


class BuiltIn:
    """The built-in rate loop as one from outside."""

    def __init__(self, rate: RateController) -> None:
        self._rate = rate

    def reset(self) -> None:
        self._rate.reset()

    def update(self, setpoint: Vector3, measured: Vector3, applied: Vector3) -> Vector3:
        return self._rate.update(setpoint, measured, Unallocated())


@cache
def place() -> tuple[Vehicle, EngineSpec, Belief, Channel]:
    belief = make_scenario_belief(ROLL, {})
    vehicle, engine = belief.vehicle, load_engine("edf-as-flown", {}, STEP)
    # the fan's pole is the paper's 0.8748 and its delay 25 samples: engines/edf/README.md
    actuator = Actuator.of("fan", make_lag_dynamics([-STEP / np.log(0.8748)], 25.0, STEP))
    return vehicle, engine, belief, channels(ROLL, vehicle, engine, actuator)["roll"]


@cache
def roll() -> Axis:
    belief = place()[2]
    return Axis(belief, "roll", belief.models["roll"])


def law(name: str) -> Any:
    module, _, made = LAWS[name].partition(":")
    block = getattr(importlib.import_module(module), made)()
    own = {each.name: each.default for each in block.parameters}
    block.prepare(replace(place()[2], parameters=own))
    return block


@pytest.mark.parametrize("name", ["smith", "state-disturbance"])
def test_a_loop_of_the_built_in_law_is_that_of_its_responses(name: str) -> None:
    vehicle, engine, _, channel = place()
    gains, attitude = vehicle.control.rate, vehicle.control.attitude.gain_1_s[0]
    scenario = ROLL.replace(controller=name)
    rate = RateController((gains.roll, gains.pitch, gains.yaw), make_predictors(scenario, vehicle, engine), STEP)
    found = LawLoop(channel, BuiltIn(rate), attitude)
    model = vehicle.identified["edf-as-flown"]["roll"]
    exact = ClosedLoop(
        FrequencyGrid(channel, close=4000), Tuning(name, attitude, gains.roll, vehicle.control.predictor, model)
    )
    for what in ("step_error", "load_error", "step_peak", "overshoot"):
        assert getattr(found, what) == pytest.approx(getattr(exact, what), rel=1e-8)
    # the one looks at 65536 points in a row and 7 s, the other at 4000 that are closest at low frequency
    assert found.peak_sensitivity == pytest.approx(exact.peak_sensitivity, rel=1e-3)
    assert found.noise == pytest.approx(exact.noise, rel=5e-3)
    # a delay of the plant alone, once from L and once flown
    later = LawLoop(channel.with_delay(33), BuiltIn(rate), attitude)
    assert found.with_delay(8.0) == pytest.approx(later.peak_sensitivity, rel=2e-3)
    less, more = found.delay_margins
    assert less < -25.0
    assert found.with_delay(more + 0.01) is None
    assert LawLoop(channel.with_delay(25 + int(more)), BuiltIn(rate), attitude, 20.0).peak_sensitivity > 10.0
    with pytest.raises(ArithmeticError):
        LawLoop(channel.with_delay(25 + int(more) + 2), BuiltIn(rate), attitude, 120.0)


def test_gain_margins_are_where_the_loop_runs_away() -> None:
    channel, block = place()[3], law("pid")
    attitude = place()[0].control.attitude.gain_1_s[0]
    _, high = LawLoop(channel, block, attitude, 15.0).gain_margins
    assert LawLoop(replace(channel, gain=0.98 * high * channel.gain), block, attitude, 15.0).peak_sensitivity > 20.0
    with pytest.raises(ArithmeticError):
        LawLoop(replace(channel, gain=1.03 * high * channel.gain), block, attitude, 60.0)


def test_an_axis_is_an_integrator_with_a_delay() -> None:
    axis = roll()
    w = 0.3  # rad/s, fast against the slow pole's 0.025 rad/s, slow against everything else
    z = np.exp(1j * w * STEP * np.ones(1))
    answer = complex((model_response(axis.model, z) * z**-25)[0])
    slow = complex(
        (STEP * np.exp(-0.5j * w * STEP) / (z - axis.slow_pole) * np.exp(1j * w * STEP))[0]
    )  # the integrator
    rest = answer / slow / axis.gain
    assert abs(rest) == pytest.approx(1.0, abs=1e-3)
    assert -np.angle(rest) / w == pytest.approx(axis.delay, rel=1e-3)


@pytest.mark.parametrize("name", LAWS)
def test_every_law_has_the_stated_peak_sensitivity(name: str) -> None:
    if name == "mpc":
        pytest.importorskip("osqp")
    vehicle, _, _, channel = place()
    attitude, block = vehicle.control.attitude.gain_1_s[0], law(name)
    assert LawLoop(channel, block, attitude, 20.0).peak_sensitivity == pytest.approx(1.7, rel=0.01)


@pytest.mark.parametrize("name", LAWS)
def test_every_law_flies_a_doublet(name: str) -> None:
    """And those twice, to the same bits, whose answers come out of solvers."""
    if name == "mpc":
        pytest.importorskip("osqp")
    scenario = ROLL.replace(controller=LAWS[name])
    run = fly(scenario)
    assert run.outcome == "completed"
    assert max(run.log["roll_rad"]) > radians(1.0)
    if name in ("lqg", "mpc"):
        assert run.log["torque_roll"].tobytes() == fly(scenario).log["torque_roll"].tobytes()


def test_a_vehicle_without_a_model_is_refused() -> None:
    with pytest.raises(InputError, match=r"Adrc: needs a model of how this engine turns hexjet.*hexjet identify"):
        build(ROLL.replace(controller=LAWS["adrc"], engine="turbojet"))


def test_without_its_solver_mpc_says_which(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "osqp", None)
    with pytest.raises(InputError, match=r"^mpc needs the package osqp: pip install osqp$"):
        law("mpc")


def test_other_axes_keep_the_vehicles_pid() -> None:
    vehicle, engine, _, _ = place()
    gains = vehicle.control.rate
    rate = RateController(
        (gains.roll, gains.pitch, gains.yaw),
        make_predictors(ROLL.replace(controller="baseline"), vehicle, engine),
        STEP,
    )
    mine = law("lqg")
    mine.reset()
    asked = (0.0, 0.0, 0.0)
    for k in range(20):
        setpoint, measured = (0.1, 0.2 * sin(k), -0.1), (0.0, 0.1 * cos(k), 0.02 * k)
        asked = mine.update(setpoint, measured, asked)
        assert asked[1:] == BuiltIn(rate).update(setpoint, measured, asked)[1:]


def integrator(gain: float, samples: int, push: float, steps: int, block: Any) -> tuple[list[float], list[float]]:
    """Rates, and what the law predicts, of an integrator with a delay and a constant disturbance of its input."""
    sent, rate, applied = [0.0] * samples, 0.0, 0.0
    rates, said = [], []
    for k in range(steps):
        rates.append(rate)
        applied = block.update(0.5 if k > 10 else 0.0, rate, applied)
        said.append(block.predicted)
        sent.append(applied)
        rate += STEP * gain * (sent.pop(0) + push)
    return rates, said


def test_adrc_sees_what_its_own_plant_will_be() -> None:
    block = AdrcAxis(400.0, Actuators(30, 0.0), 5.0, 40.0, STEP)
    one, two = block.correct
    moves = (np.eye(2) - np.outer([one, two], [1.0, 0.0])) @ np.array([[1.0, STEP], [0.0, 1.0]])
    assert np.linalg.eigvals(moves) == pytest.approx([exp(-40.0 * STEP)] * 2, rel=1e-6)
    rates, said = integrator(400.0, 30, 0.002, 1200, block)
    assert block.disturbance == pytest.approx(400.0 * 0.002, rel=1e-6)
    assert said[400:-30] == pytest.approx(rates[430:], abs=1e-6)
    assert rates[-1] == pytest.approx(0.5, abs=1e-3)


def test_indi_filters_exactly_and_sees_what_its_own_plant_will_be() -> None:
    natural, block = 30.0, SecondOrder(30.0, STEP)
    A = np.array([[0.0, 1.0], [-(natural**2), -2.0 * DAMPING * natural]])
    state, values = np.zeros(2), np.random.default_rng(1).normal(size=50)
    for value in values:
        block.update(float(value))
        state = np.array([value, 0.0]) + expm(A * STEP) @ (state - [value, 0.0])
        assert [block.value, block.slope] == pytest.approx(list(state), rel=1e-9, abs=1e-12)
    rates, said = integrator(400.0, 30, 0.002, 1500, IndiAxis(400.0, Actuators(30, 0.0), 5.0, 30.0, STEP))
    assert said[700:-30] == pytest.approx(rates[730:], abs=1e-4)
    assert rates[-1] == pytest.approx(0.5, abs=1e-3)


def test_lqg_is_the_regulator_of_the_state_to_come() -> None:
    A, B, C, samples = discrete_model(roll())
    rho = 1e-4
    small, _ = regulator(A, B, C, rho)
    whole, forward = regulator(*add_delay(A, B, samples), np.append(C, np.zeros(samples)), rho)
    ahead = np.linalg.matrix_power(A, samples)
    wanted = [*(small @ ahead), *(small @ np.linalg.matrix_power(A, samples - 1 - i) @ B for i in range(samples))]
    assert whole == pytest.approx(wanted, rel=1e-6)
    late, entering = add_delay(A, B, samples)
    at_rest = np.linalg.solve(np.eye(len(late)) - late + np.outer(entering, whole), entering * forward)
    assert C @ at_rest[: len(A)] == pytest.approx(1.0)
    # one integrator, x' = x + b u: P = (1 + sqrt(1 + 4 rho / b^2)) / 2, K = b P / (rho + b^2 P), N = K
    b = 0.3
    P = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * rho / b**2))
    gain, forward = regulator(np.ones((1, 1)), np.array([b]), np.ones(1), rho)
    assert [*gain, forward] == pytest.approx([b * P / (rho + b * b * P)] * 2)


def test_a_filter_of_a_pure_disturbance_is_that_of_a_random_walk() -> None:
    # x' = u + d with d a walk: y_k = d_k-1, a walk seen late; its variance p solves p^2 = w p + w, one step ahead
    walk = 0.04
    found = KalmanFilter(np.zeros((1, 1)), np.ones(1), np.ones(1), walk)
    p = 0.5 * (walk + np.sqrt(walk**2 + 4.0 * walk))
    assert found.gain[1] == pytest.approx(p / (p + 1.0))
    for _ in range(300):
        found.update(0.5, 0.0)
    assert found.state == pytest.approx([0.5, 0.5])


def test_mpc_solves_its_programme_without_limits_and_within_them() -> None:
    pytest.importorskip("osqp")
    axis, room = roll(), 0.01
    block = MpcAxis(axis, 20.0, 20.0, room)
    root = np.linalg.cholesky(block.hessian).T
    rng = np.random.default_rng(2)
    for scale, disturbance in ((0.1, 0.0), (30.0, 0.001), (100.0, -0.004)):
        gradient = scale * block.hessian @ rng.normal(size=len(block.hessian)) * 0.001
        exact = lsq_linear(
            root, -np.linalg.solve(root.T, gradient), (disturbance - room, disturbance + room), tol=1e-14
        )
        assert block.solve_bounded(gradient, disturbance) == pytest.approx(exact.x, abs=1e-6)
    # the plan of the first step: the model, step by step, and the same sum of squares
    A, B, C, _ = discrete_model(axis)
    horizon = round(2.0 * axis.delay / STEP)

    def cost(plan: Any) -> float:
        x, total = np.zeros(len(A)), 0.0
        blocks = np.repeat(plan, [1, 1, 1, 2, 2, 3, 4, 6, 8, 1000])[:horizon] if len(plan) == 10 else plan
        for u in blocks:
            x = A @ x + B * u
            total += float(C @ x - 0.001) ** 2
        weight = axis.gain**2 / (20.0**4 * STEP**2)
        return total + weight * float(np.square(np.diff(plan, prepend=0.0)).sum())

    wide = MpcAxis(axis, 20.0, 20.0, 1e3)
    first = wide.update(0.001, 0.0, 0.0)
    best = wide._solution @ (-0.001 * wide._gradient[1])
    assert first == best[0]
    assert all(cost(best) < cost(best + 1e-6 * move) for move in (*np.eye(10), *-np.eye(10)))


def test_px4_adds_up_its_parts() -> None:
    block = Px4Axis(0.02, 0.5, 0.0, 0.003, 1e-9, 3.0, 0.1, STEP)  # the reference model stands still
    first = block.update(0.2, 0.05, 0.0)
    assert first == pytest.approx(0.02 * 0.15 + 0.003 * 0.2)
    factor = 1.0 - (0.15 / MAX_INTEGRATED_ERROR) ** 2
    second = block.update(0.2, 0.05, first)
    assert second == pytest.approx(first + factor * 0.5 * STEP * 0.15)
    refused = block.update(0.2, 0.05, second - 0.001)
    assert refused == pytest.approx(second + factor * 0.5 * STEP * 0.15)
    assert block.update(0.2, 0.05, refused) == refused  # what could not be given is not asked for more
    # a set-point that grows: its rate is fed forward through the model, behind the attitude loop's gain
    quick = Px4Axis(1.0, 0.0, 0.0, 0.0, 1e4, 3.0, 0.1, STEP)
    for k in range(5):
        asked = quick.update(3.0 * 0.1 * k * STEP, 0.0, 0.0)
    assert asked == pytest.approx(3.0 * 0.1 * 4 * STEP + 0.1)


def test_px4_filters_acceleration_at_its_corner() -> None:
    block, hertz = LowPass(30.0, STEP), 30.0
    values = [block.update(sin(2.0 * pi * hertz * k * STEP)) for k in range(500)]
    assert max(values[250:]) == pytest.approx(np.sqrt(0.5), rel=0.02)
    block.reset()
    assert [block.update(1.0) for _ in range(200)][-1] == pytest.approx(1.0)


def test_parameters_are_numbers_with_a_meaning_and_above_0_but_for_weights() -> None:
    for name in LAWS:
        module, _, made = LAWS[name].partition(":")
        parameters: tuple[Parameter, ...] = getattr(importlib.import_module(module), made).parameters
        assert parameters[0].name == ("response" if name == "optimal" else "angle")
        assert all(each.meaning and each.least <= each.default <= each.most for each in parameters)
        assert all(each.least >= 0.0 for each in parameters if not each.name.startswith("weight_"))


def optimal_target(delay: float) -> Target:
    return Target.of({each.name: each.default for each in Optimal.parameters}, delay)


@pytest.mark.parametrize("damping", [None, 0.0, 0.4, 8.0])
def test_optimal_makes_the_loop_that_its_target_says(damping: float | None) -> None:
    """``S = 1 - q^N t`` at every frequency, whether the rate fades slowly or not, and no load leaves a lean."""
    channel = replace(place()[3], rate_filter_s=0.0, rate_latency=0, angle_latency=0)
    channel = channel if damping is None else replace(channel, damping_1_s=damping)
    target = optimal_target(roll().delay)
    block = Behind(channel, target)
    found = LawLoop(channel, block, block.attitude, 20.0)
    form, basis = ModelForm.of(channel.model("exact"), target), target.basis(STEP)
    t = np.convolve(form.kept, basis @ fit_weights(form, basis, np.sqrt(STEP) * np.array(target.weights)))
    late = np.r_[np.zeros(form.late), t][: found.samples]
    assert np.abs(found.sensitivity - (1.0 - np.fft.rfft(late, 2 * (len(found.theta) - 1)))).max() < 1e-6
    assert abs(found.load_left) < 1e-6 * np.abs(np.cumsum(found._load.angle)).max()
    # the answer to a set-point: three lags behind the delay
    steps = np.arange(found.samples) - form.late
    pole = target.lag(STEP)
    lags = np.where(steps < 0, 0.0, (1.0 - pole) ** 3 * (steps + 1) * (steps + 2) / 2.0 * pole ** np.maximum(steps, 0))
    rate = np.convolve(lags, form.kept)[: found.samples]
    assert np.diff(found.angle, prepend=0.0) == pytest.approx(0.5 * (rate + np.r_[0.0, rate[:-1]]), abs=1e-9)


def test_limits_do_not_wind_optimal_up() -> None:
    """A step that asks for several times what there is comes back with little overshoot: it is told what was applied."""
    channel = replace(place()[3], rate_filter_s=0.0, rate_latency=0, angle_latency=0)
    free = Behind(channel, optimal_target(roll().delay))
    most = LawLoop(channel, free, free.attitude).step_peak
    bound = Behind(channel, optimal_target(roll().delay), 0.3 * most)
    turned = np.cumsum(law_loop.run(channel, free, free.attitude, 1000, setpoint=1e-3).angle)
    assert turned[-1] == pytest.approx(1e-3, rel=1e-3)
    angle = integrated(channel, bound, bound.attitude)
    assert max(angle) < 1.15
    assert angle[-1] == pytest.approx(1.0, abs=0.01)


def integrated(channel: Channel, block: Any, gain: float) -> list[float]:
    """The angle after a lasting set-point of 1 rad, on a channel of one lag and no damping of its own sensors."""
    (now, before, earlier), pole = channel.rate_dynamics
    body, late = channel.actuator.model, int(channel.actuator.model.delay_samples)
    sent, force, past, rate, angle = [0.0] * late, 0.0, (0.0, 0.0), 0.0, 0.0
    angles, asked = [], (0.0, 0.0, 0.0)
    block.reset()
    for _ in range(1500):
        angles.append(angle)
        asked = block.update((gain * (1.0 - angle), 0.0, 0.0), (rate, 0.0, 0.0), asked)
        sent.append(asked[0])
        force_now = force
        force = body.poles[0] * force + body.gain * sent.pop(0)
        last = rate
        rate = pole * rate + channel.gain * STEP * (now * force + before * past[0] + earlier * past[1])
        past = (force, force_now)
        angle += 0.5 * STEP * (last + rate)
    return angles
