"""The predictors against exact answers and against other implementations (scipy)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import cont2discrete, lsim

from cosim.base.arrays import Array
from cosim.control.predictors.smith import (
    DelayedModel,
    FilteredSmithPredictor,
    SmithPredictor,
    rate_model,
    robustness_filter,
)
from cosim.control.predictors.state import DoubleIntegratorObserver, ModelObserver, Pair, StateModel, StatePredictor
from cosim.spec.vehicle import RateModel
from hexjet_paper.numbers import quadrotor_model, roll_model

STEP = 0.004


def commands(steps: int, seed: int = 3) -> list[float]:
    values: list[float] = np.random.default_rng(seed).standard_normal(steps).tolist()
    return values


def integrating(delay: float) -> RateModel:
    """433 / (s (0.039 s + 1)), zero-order hold by scipy: a pure integrator and one lag."""
    (numerator,), *_ = cont2discrete(([433.0], [0.039, 1.0, 0.0]), STEP)
    top = np.trim_zeros(numerator, "f")
    zeros, poles = [float(zero) for zero in np.roots(top)], [1.0, float(np.exp(-STEP / 0.039))]
    more = {"delay_samples": delay, "sample_time_s": STEP, "source": "test"}
    return RateModel(gain=float(top[0]), zeros=zeros, poles=poles, **more)


class Held:
    """A continuous plant ``x' = A x + B u`` under held commands that arrive late, by the matrix exponential."""

    def __init__(self, model: StateModel, delay: float) -> None:
        T = model.step
        l1, l2 = np.log(model._modes) / T
        self.A = np.array([[0.0, 1.0], [-l1 * l2, l1 + l2]])
        # the input column whose held response over one step is the model's B
        blocks = np.zeros((4, 4))
        blocks[:2, :2], blocks[:2, 2:] = self.A * T, np.eye(2) * T
        self.B = np.linalg.solve(expm(blocks)[:2, 2:], model.B)
        self.T, self.delay = T, delay

    def at(self, time: float, given: list[float]) -> Array:
        """State at ``time``: ``given[k]`` is commanded over ``[k T, k T + T)`` and acts ``delay`` samples later."""
        x = np.zeros(2)
        for k, u in enumerate(given):
            start, end = (k + self.delay) * self.T, (k + 1 + self.delay) * self.T
            for_s = min(end, time) - start
            if for_s <= 0.0:
                break
            blocks = np.zeros((3, 3))
            blocks[:2, :2], blocks[:2, 2] = self.A * for_s, self.B * for_s
            transition = expm(blocks)
            x = transition[:2, :2] @ x + transition[:2, 2] * u
        return x


class Knows:
    """An observer that is told the state: what a perfect one would say."""

    def __init__(self) -> None:
        self.state = (0.0, 0.0)

    def reset(self) -> None:
        self.state = (0.0, 0.0)

    def update(self, measured: float, late: float, push: Pair) -> tuple[Pair, float]:
        return self.state, 0.0


@pytest.mark.parametrize("delay", [0.0, 1.0, 5.0, 10.0, 25.0, 0.4, 10.37, 24.999])
@pytest.mark.parametrize("made", [roll_model, quadrotor_model], ids=["hexjet", "quadrotor"])
def test_a_perfect_model_and_the_full_state_give_the_future(made: Callable[[float], RateModel], delay: float) -> None:
    """What is predicted at t_k is the rate at t_k + delay, whole samples or not.
    1e-9 rad/s against rates of some 10 rad/s: rounding of a few hundred operations."""
    model = made(delay)
    state_model = StateModel(model)
    observer, plant = Knows(), Held(state_model, delay)
    predictor = StatePredictor(model, observer, state_model)
    given = commands(60)
    for k in range(1, 60):
        x, v = plant.at(k * plant.T, given[:k])
        observer.state = (float(x), float(v))
        predicted = predictor.update(float(x), given[k - 1])
        actual = plant.at((k + delay) * plant.T, given[:k])[0]
        assert predicted == pytest.approx(actual, abs=1e-9)


@pytest.mark.parametrize("disturbance", [False, True])
def test_a_model_observer_converges(disturbance: bool) -> None:
    """From a wrong start, and with a constant disturbance where it has a state for one, to what the plant does.
    The observer's poles are at exp(-20 T): after 300 steps an error is down by exp(-24), some 1e-10 with its powers
    of k; what remains is far below 1e-6 of a state of about 10."""
    model = roll_model(0.0)
    state_model = StateModel(model)
    observer = ModelObserver(state_model, 20.0, disturbance)
    x, d = np.array([2.0, -30.0]), 0.05 if disturbance else 0.0
    errors = []
    for u in commands(600):
        x = state_model.A @ x + state_model.B * (u + d)
        push = (float(state_model.B[0] * u), float(state_model.B[1] * u))
        (rate, _), estimate = observer.update(float(x[0]), u, push)
        errors.append(abs(rate - x[0]))
    assert errors[0] > 0.1
    assert max(errors[-100:]) < 1e-6
    assert estimate == pytest.approx(d, abs=1e-7)


def test_a_state_predictor_with_a_model_observer_is_exact_once_it_has_converged() -> None:
    """With the disturbance's estimate it also knows what a constant disturbance will do."""
    model, d = roll_model(7.0), 0.03
    state_model = StateModel(model)
    predictor = StatePredictor(model, ModelObserver(state_model, 30.0, True), state_model)
    given = commands(900)
    states = [np.zeros(2)]
    for k in range(900):
        late = given[k - 7] if k >= 7 else 0.0
        states.append(state_model.A @ states[-1] + state_model.B * (late + d))
    for k in range(1, 890):
        predicted = predictor.update(float(states[k][0]), given[k - 1])
    assert predicted == pytest.approx(states[889 + 7][0], abs=1e-6)


def test_the_double_integrator_observer_is_the_exact_discretisation() -> None:
    """Against the matrix exponential of the printed equation with measurement and command held over each step."""
    w, T = 150.0, 0.0025
    observer = DoubleIntegratorObserver(w, T)
    gain = np.array([2.0 * w, w * w])
    A = np.array([[0.0, 1.0], [0.0, 0.0]]) - np.outer(gain, [1.0, 0.0])
    assert np.linalg.eigvals(A) == pytest.approx([-w, -w], rel=1e-6)
    blocks = np.zeros((4, 4))
    blocks[:2, :2], blocks[:2, 2], blocks[:2, 3] = A * T, gain * T, np.array([0.0, 1.0]) * T
    transition = expm(blocks)
    x = np.zeros(2)
    for y, u in zip(commands(200, 1), commands(200, 2), strict=True):
        x = transition[:2, :2] @ x + transition[:2, 2] * y + transition[:2, 3] * u
        (rate, slope), _ = observer.update(y, u, (0.0, 0.0))
        # 1e-12 of values up to some 100: rounding
        assert (rate, slope) == pytest.approx(tuple(x), rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("delay", [0.0, 25.0, 10.37])
def test_with_a_filter_of_1_it_is_smiths_bit_for_bit(delay: float) -> None:
    filtered, smith = FilteredSmithPredictor(roll_model(delay), [1.0], [1.0]), SmithPredictor(roll_model(delay))
    for y, u in zip(commands(500, 1), commands(500, 2), strict=True):
        assert filtered.update(y, u) == smith.update(y, u)


@pytest.mark.parametrize("delay", [5.0, 25.0, 12.5])
@pytest.mark.parametrize("time_constant", [0.0, 0.05, 0.15])
def test_a_constant_disturbance_leaves_no_error_on_an_integrating_plant(delay: float, time_constant: float) -> None:
    """Closed form: at rest the command is minus the disturbance and the rate is 0.
    Smith's then says -K h T d; the filtered one says 0, for F(1) = 1 and F'(1) = h cancel ramp and constant.  The
    models' ramps grow to about 700 rad/s, of which 1e-9 is rounding."""
    model, d = integrating(delay), 0.02
    smith, filtered = SmithPredictor(model), FilteredSmithPredictor(model, *robustness_filter(model, time_constant))
    for _ in range(20_000):
        left, none = smith.update(0.0, -d), filtered.update(0.0, -d)
    assert left == pytest.approx(-433.0 * delay * STEP * d, rel=1e-6)
    assert none == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("model", [integrating(25.0), roll_model(25.0), quadrotor_model(10.0)])
def test_the_robustness_filter_does_what_it_says(model: RateModel) -> None:
    """F(1) = 1, and F(p) = p^h at the slowest pole; for p = 1 the slope of F there is h, by central difference."""
    numerator, denominator = robustness_filter(model, 0.1)

    def f(z: float) -> float:
        return float(np.polyval(numerator, z) / np.polyval(denominator, z))

    p, h = max(model.poles), model.delay_samples
    assert f(1.0) == pytest.approx(1.0, abs=1e-10)
    if p < 1.0:
        assert f(p) == pytest.approx(p**h, abs=1e-9)
    else:
        assert (f(1.0 + 1e-6) - f(1.0 - 1e-6)) / 2e-6 == pytest.approx(h, rel=1e-6)


@pytest.mark.parametrize("delay", [10.37, 0.25, 3.5, 25.0])
def test_a_fractional_delay_is_the_continuous_plant_s(delay: float) -> None:
    """Against scipy's simulation of the continuous plant on a grid of a hundredth of a step, the command held."""
    fine = 100
    given = commands(120)
    held = np.repeat(given, fine)
    late = np.concatenate([np.zeros(round(delay * fine)), held])[: len(held) + 1]
    late = np.append(late, np.zeros(len(held) + 1 - len(late)))
    time = np.arange(len(held) + 1) * STEP / fine
    _, output, _ = lsim(([433.0], [0.039, 1.0, 0.0]), late, time, interp=False)
    model = DelayedModel(integrating(delay))
    ours = [model.update(u) for u in given]
    # rates of some 10 rad/s; the two differ by the rounding of 12000 steps
    assert ours == pytest.approx(output[fine::fine].tolist(), abs=1e-7)


def test_a_fraction_of_nearly_nothing_is_nearly_whole() -> None:
    late, whole = DelayedModel(roll_model(5.0 + 1e-9)), DelayedModel(roll_model(5.0))
    for u in commands(200):
        assert late.update(u) == pytest.approx(whole.update(u), abs=1e-6)


def test_the_state_model_is_the_transfer_function() -> None:
    """``C (z I - A)^-1 B`` has the response of the difference equation, for a zero outside the circle too."""
    for made in (roll_model(0.0), quadrotor_model(0.0)):
        state, equation = StateModel(made), rate_model(made)
        x = np.zeros(2)
        for u in commands(300):
            x = state.A @ x + state.B * u
            assert x[0] == pytest.approx(equation.update(u), abs=1e-9)


@pytest.mark.parametrize("step", [1e-320, 1e-7, 1e4, float("inf"), float("nan")])
def test_a_step_whose_poles_are_no_numbers_is_refused(step: float) -> None:
    """In 1/s they would be infinite, or zero."""
    stated = integrating(20.5).model_dump()
    with pytest.raises(ValueError, match="sample_time_s"):
        RateModel.model_validate(stated | {"sample_time_s": step})
    assert RateModel.model_validate(stated | {"sample_time_s": 1e-6}).sample_time_s == 1e-6
