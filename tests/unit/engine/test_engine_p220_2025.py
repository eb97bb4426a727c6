"""The jet of 220 N as identified in 2025: its equation by scipy, published responses, equilibria and poles, its bounds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from engine_tools import STEP, Array, archive, bang_bang, driven, integrated
from places import DATA

pytestmark = pytest.mark.usefixtures("built_engines")

# The authors' own responses, of this model and of the one they learned, where they are at hand.
RESPONSES = DATA / "p220" / "iit-2025-responses.csv"

# Gorbani et al. (2025): c0 to c12, then mean and scale of thrust [N] and throttle [percent]
C = (
    -0.464730485, -8.13171858, -6.19539230, 0.661113140, 1.67673231, -0.483287064,
    8.77996617, -1.01096376, -0.586442286, 0.519093322, -0.423782666, -1.45705257, -0.00783052261,
)  # fmt: skip
M_T, S_T, M_U, S_U = 108.309, 65.793, 47.333, 31.483


def drive(percent: float) -> float:
    w = (percent - M_U) / S_U
    return w + C[12] * w**2


def control_gain(T: float, D: float) -> float:
    """What the drive is multiplied by, in scales of thrust."""
    a, d = (T - M_T) / S_T, D / S_T
    return float(np.dot(C[6:12], [1.0, a, d, a * d, a**2, d**2]))


def rates(percent: float) -> Callable[[float, Array], list[float]]:
    v = drive(percent)

    def f(_: float, x: Array) -> list[float]:
        a, d = (x[0] - M_T) / S_T, x[1] / S_T
        terms = np.array([1.0, a, d, a * d, a**2, d**2])
        return [x[1], S_T * float(terms @ np.array(C[:6]) + v * (terms @ np.array(C[6:12])))]

    return f


def equilibria(percent: float) -> tuple[float, float]:
    """Both thrusts [N] at which nothing moves, the lower one first."""
    v = drive(percent)
    low, high = np.sort(np.roots([C[4] + C[10] * v, C[1] + C[7] * v, C[0] + C[6] * v]).real)
    return M_T + S_T * float(low), M_T + S_T * float(high)


def jacobian(percent: float, T: float) -> tuple[float, float, float]:
    """dT''/dT, dT''/dT', dT''/du [N/s^2 per percent], by central differences of what is above."""
    h = 1e-4
    up = [rates(percent)(0.0, np.array(x))[1] for x in ([T + h, 0.0], [T, h])]
    down = [rates(percent)(0.0, np.array(x))[1] for x in ([T - h, 0.0], [T, -h])]
    more, less = (rates(percent + s * h)(0.0, np.array([T, 0.0]))[1] for s in (1.0, -1.0))
    return (up[0] - down[0]) / 2 / h, (up[1] - down[1]) / 2 / h, (more - less) / 2 / h


def test_it_is_the_equation_integrated_by_another_method(tmp_path: Path) -> None:
    throttles = np.random.default_rng(3).uniform(0.0, 1.0, 40)
    throttles[10:16], throttles[16:30] = 1.0, 0.0
    held = 125  # samples, half a second
    with driven(archive("p220-2025", 3), tmp_path) as engine:
        engine.start(throttle_start=0.3)
        thrust = engine.run(np.repeat(throttles, held))
    state = np.array([equilibria(30.0)[0], 0.0])
    np.testing.assert_allclose(thrust, integrated(map(rates, 100.0 * throttles), state, held), rtol=1e-7)
    assert np.ptp(thrust) > 150.0


def published() -> Array:
    if not RESPONSES.is_file():
        pytest.skip(f"the published responses are not at hand: {RESPONSES.name}")
    return np.loadtxt(RESPONSES, delimiter=",", skiprows=1)


def test_it_is_the_authors_own_integration(tmp_path: Path) -> None:
    """Steps of 10 % from 30 to 90 %, steps over the whole range, a chirp: 150 s, throttle held over 20 ms."""
    _, percent, _, theirs = published().T
    with driven(archive("p220-2025", 3), tmp_path) as engine:
        engine.start(throttle_start=percent[0] / 100.0)
        thrust = engine.run(np.repeat(percent / 100.0, 5))
    # a row is the thrust when its throttle is set; the file has four decimals and steps of 5 ms
    np.testing.assert_allclose(thrust[4:-1:5], theirs[1:], atol=1e-3)


@pytest.mark.parametrize(
    ("before", "after", "seconds", "thrust"),
    # rows of those responses: throttle in percent, time since it moved, thrust in N
    [(30.0, 30.0, 1.0, 68.2489), (30.0, 90.0, 8.0, 202.4753), (90.0, 50.0, 8.0, 110.5545)],
)
def test_it_is_the_authors_thrust(before: float, after: float, seconds: float, thrust: float, tmp_path: Path) -> None:
    with driven(archive("p220-2025", 3), tmp_path) as engine:
        engine.start(throttle_start=before / 100.0)
        assert engine.run(np.full(round(seconds / STEP), after / 100.0))[-1] == pytest.approx(thrust, abs=1e-3)


def test_warm_air_costs_the_turbine_what_the_laboratory_found(tmp_path: Path) -> None:
    """The laboratory's correction, 0.62 % a degree at 21.3 degC, beside turbine-220, which was made without it."""
    thrust = []
    for kelvin in (293.4, 294.4, 295.4):
        with driven(archive("turbine-220", 3), tmp_path) as engine:
            engine.set("ambient_temperature", kelvin)
            engine.start(throttle_start=1.0)
            thrust.append(engine.get("thrust"))
    percent = 50.0 * (thrust[0] - thrust[2]) / thrust[1]
    assert percent == pytest.approx(0.62, rel=0.1)


def test_the_linearised_model_is_the_answer_to_a_small_step(tmp_path: Path) -> None:
    """About 46 % throttle: a step response of two real poles, written down."""
    u, step = 0.46, 1e-5
    T = equilibria(100.0 * u)[0]
    with driven(archive("p220-2025", 3), tmp_path) as engine:
        engine.start(throttle_start=u)
        thrust = engine.run(np.full(1500, u + step)) - T
    stiffness, damping, _ = jacobian(100.0 * u, T)
    fast, slow = np.sort(np.roots([1.0, -damping, -stiffness]).real)
    t = np.arange(1, 1501) * STEP
    gain = (equilibria(100.0 * (u + step))[0] - T) / step
    closed = gain * step * (1.0 - (fast * np.exp(slow * t) - slow * np.exp(fast * t)) / (fast - slow))
    # what is left is of second order in the step
    np.testing.assert_allclose(thrust, closed, atol=1e-4 * gain * step)


def test_no_throttle_makes_the_thrust_leave_its_bounds(tmp_path: Path) -> None:
    """Bang-bang at random, and the chop: between 15 and 223 N, and more throttle always means a larger T''."""
    with driven(archive("p220-2025", 3), tmp_path / "a") as engine:
        engine.start(throttle_start=1.0)
        chopped = engine.run(np.zeros(2500))
    assert chopped.min() == pytest.approx(15.466, abs=1e-3)
    assert chopped[-1] == pytest.approx(equilibria(0.0)[0], rel=1e-9)
    throttle = bang_bang(seed=11)
    with driven(archive("p220-2025", 3), tmp_path / "b") as engine:
        engine.start(throttle_start=1.0)
        thrust = engine.run(throttle)
    assert thrust.min() > 15.0
    assert thrust.max() < 223.0
    rate = np.gradient(thrust, STEP)
    assert np.abs(rate).max() > 100.0
    assert min(control_gain(T, D) for T, D in zip(thrust[::10], rate[::10], strict=True)) > 0.5
