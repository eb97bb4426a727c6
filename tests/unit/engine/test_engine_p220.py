"""The P220 after L'Erario et al.: its equation by scipy, its equilibria and poles, its bounds."""

from __future__ import annotations

from collections.abc import Callable
from math import log
from pathlib import Path

import numpy as np
import pytest
from engine_tools import STEP, Array, archive, bang_bang, driven, integrated

pytestmark = pytest.mark.usefixtures("built_engines")

# kerosene, in the order K_T K_TT K_D K_DD K_TD B_U B_T B_D B_UU c
COEFFICIENTS = (0.237755, -0.012799, -0.860374, 0.023606, 0.008599, 1.139026, 0.019914, -0.050257, 0.000302, -0.692913)
K_T, K_TT, K_D, K_DD, K_TD, B_U, B_T, B_D, B_UU, C = COEFFICIENTS


def rates(percent: float) -> Callable[[float, Array], list[float]]:
    v = percent + B_UU * percent**2

    def f(_: float, x: Array) -> list[float]:
        T, D = x
        return [D, K_T * T + K_TT * T**2 + K_D * D + K_DD * D**2 + K_TD * T * D + (B_U + B_T * T + B_D * D) * v + C]

    return f


def equilibria(percent: float) -> tuple[float, float]:
    """Both thrusts [N] at which nothing moves, the lower one first."""
    v = percent + B_UU * percent**2
    low, high = np.sort(np.roots([K_TT, K_T + B_T * v, B_U * v + C]).real)
    return float(low), float(high)


def poles(percent: float, thrust: float) -> Array:
    v = percent + B_UU * percent**2
    return np.roots([1.0, -(K_D + K_TD * thrust + B_D * v), -(K_T + 2.0 * K_TT * thrust + B_T * v)])


def test_full_throttle_is_220_newtons(tmp_path: Path) -> None:
    with driven(archive("p220", 3), tmp_path) as engine:
        engine.start(throttle_start=1.0)
        thrust = engine.run(np.ones(10))
        # the data sheet's 220 N, which the identified model meets to 0.25 N; its own equilibrium to rounding
        assert thrust[-1] == pytest.approx(220.0, abs=0.3)
        assert thrust == pytest.approx(equilibria(100.0)[1], rel=1e-13)
        assert engine.get("spool_speed") == pytest.approx(117000.0, rel=1e-3)
        assert engine.get("fuel_flow") == pytest.approx(0.58 / 60.0, rel=2e-3)


@pytest.mark.parametrize("idle_percent", [0.0, 3.0])
def test_it_is_the_equation_integrated_by_another_method(idle_percent: float, tmp_path: Path) -> None:
    throttles = np.random.default_rng(3).uniform(0.0, 1.0, 40)
    throttles[10:16], throttles[16:30] = 1.0, 0.0
    held = 125  # samples, half a second
    with driven(archive("p220", 3), tmp_path) as engine:
        engine.start(throttle_start=0.3, idle_percent=idle_percent)
        thrust = engine.run(np.repeat(throttles, held))
    percents = idle_percent + (100.0 - idle_percent) * throttles
    state = np.array([equilibria(idle_percent + (100.0 - idle_percent) * 0.3)[1], 0.0])
    np.testing.assert_allclose(thrust, integrated(map(rates, percents), state, held), rtol=1e-6)
    assert np.ptp(thrust) > 150.0


def test_the_linearised_model_is_the_answer_to_a_small_step(tmp_path: Path) -> None:
    """About 46 % throttle, where the Hex-Jet hovers: a second-order step response, written down."""
    u, step = 0.46, 1e-5
    T = equilibria(100.0 * u)[1]
    with driven(archive("p220", 3), tmp_path) as engine:
        engine.start(throttle_start=u)
        thrust = engine.run(np.full(1500, u + step)) - T
    pole = poles(100.0 * u, T)[0]
    k = np.arange(1, 1501) * STEP
    gain = (equilibria(100.0 * (u + step))[1] - T) / step
    sigma, omega = pole.real, abs(pole.imag)
    closed = gain * step * (1.0 - np.exp(sigma * k) * (np.cos(omega * k) - sigma / omega * np.sin(omega * k)))
    # what is left is of second order in the step
    np.testing.assert_allclose(thrust, closed, atol=1e-4 * gain * step)


def test_no_throttle_makes_the_thrust_leave_its_bounds(tmp_path: Path) -> None:
    """Bang-bang at random: nothing is worse than the chop from full to idle, which stays above the lower equilibrium."""
    with driven(archive("p220", 3), tmp_path / "a") as engine:
        engine.start(throttle_start=1.0)
        chopped = engine.run(np.zeros(2500))
    assert equilibria(0.0)[0] < chopped.min() == pytest.approx(5.866, abs=1e-3)
    throttle = bang_bang(seed=11)
    with driven(archive("p220", 3), tmp_path / "b") as engine:
        engine.start(throttle_start=1.0)
        thrust = engine.run(throttle)
    assert chopped.min() - 1e-9 <= thrust.min()
    assert thrust.max() <= equilibria(100.0)[1] + 1e-9


def test_speed_and_fuel_follow_the_thrust(tmp_path: Path) -> None:
    """The ends are the data sheet's; between them the speed is that measured by Momin et al., to 3 % of it.
    The comparison is with the cubic that the same laboratory uses for this engine: T = 2.749e-4 n^3 - 0.03007 n^2 +
    1.958 n - 33.08, n in 1000 rpm."""
    with driven(archive("p220", 3), tmp_path) as engine:
        for throttle in np.linspace(0.0, 1.0, 21):
            engine.fmu.reset()
            engine.start(throttle_start=float(throttle))
            thrust, speed, fuel = (engine.get(name) for name in ("thrust", "spool_speed", "fuel_flow"))
            assert fuel == pytest.approx((0.104 + (thrust - 9.0) / 211.0 * (0.58 - 0.104)) / 60.0, rel=1e-13)
            share = (thrust - 9.0) / 211.0
            ends = 35.0**3.205, 117.0**3.205
            assert log(speed / 1e3) == pytest.approx(log(ends[0] + share * (ends[1] - ends[0])) / 3.205, rel=1e-13)
            n = speed / 1e3
            assert 2.749e-4 * n**3 - 0.03007 * n**2 + 1.958 * n - 33.08 == pytest.approx(thrust, abs=6.0)
        engine.fmu.reset()
        engine.start(throttle_start=1.0)
        thrust = engine.run(np.zeros(2000))
        # the dip below the published idle is the model's: the rotor is not taken below its idle speed
        assert thrust[-1] < 9.0
        assert engine.get("spool_speed") == pytest.approx(35000.0, rel=1e-12)
