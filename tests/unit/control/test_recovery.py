"""The catch after a lost engine: against the poles that it is to place, and what it leaves to the usual loops."""

from __future__ import annotations

from math import cos

import numpy as np
import pytest

from cosim.base.constants import GRAVITY
from cosim.control.allocation.thrust_map import StaticCurve, ThrustMap
from cosim.control.phases.recovery import Recovery
from cosim.spec.vehicle import EngineLead, load_vehicle

STEP = 0.001  # s; the answer is that of continuous time, from which steps of h are off by about h a
W, ZETA = 1.3, 0.66
LEAD = EngineLead(natural_rad_s=W, damping=ZETA, pole_rad_s=8.0)
USED = (0.0, 0.0, 1.0, 1.0, 1.0, 1.0)  # of hexjet-p220 without its front right engine and the one across


def falling_with_its_own_poles(order: int, pole: float, start: list[float], times: np.ndarray) -> np.ndarray:
    """x(t) of ``(s + pole)^order x = 0`` from x and its derivatives at 0: ``e^(-pole t)`` times a polynomial."""
    coefficients = np.zeros(order)
    for k in range(order):
        # the k-th derivative of e^(pole t) x at 0, over k!
        total, binomial = 0.0, 1.0
        for j in range(k + 1):
            total += binomial * pole ** (k - j) * start[j]
            binomial *= (k - j) / (j + 1)
        coefficients[k] = total / np.prod(range(1, k + 1))
    return np.exp(-pole * times) * np.polynomial.polynomial.polyval(times, coefficients)


@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_roll_and_sinking_come_to_rest_with_the_poles_that_are_stated(delay: float) -> None:
    """Engines as stated, never at their limits: from where the delay ends on every state is that of (s + a)^n."""
    vehicle, _ = load_vehicle("hexjet-p220")
    curve = StaticCurve("straight", (0.0, 1.0), (0.0, 1e6))
    catch = Recovery(vehicle, ThrustMap(curve, [curve] * 6), LEAD, delay, STEP)
    mass, inertia, weight = vehicle.mass_kg, vehicle.inertia_kg_m2[0], vehicle.mass_kg * GRAVITY
    lever = abs(vehicle.jets[0].position_m[1])
    n = round(delay / STEP)
    lean, rate, climb = 0.1, 0.5, -1.0
    moment = slope = force_slope = 0.0
    force = weight
    line = [(0.0, weight)] * n
    leans, climbs, states = [], [], []
    for _ in range(n + 3000):
        left = 0.25 * force + 0.25 * moment / lever
        right = 0.25 * force - 0.25 * moment / lever
        thrust = (0.0, 0.0, left, right, right, left)
        if not leans:
            catch.reset(thrust, USED, weight)
        catch.observe(thrust, USED)
        roll, collective = catch.update(lean, rate, climb, 0.0, 1.0, mass)
        catch.record_command(roll, collective)
        line.append((roll * 6e6 * lever, collective * 6e6))
        asked, lifted = line.pop(0)
        leans.append(lean)
        climbs.append(climb)
        states.append((rate, moment, slope, force, force_slope))
        lean, rate, moment, slope = (
            lean + STEP * rate,
            rate + STEP * moment / inertia,
            moment + STEP * slope,
            slope + STEP * (W * W * (asked - moment) - 2.0 * ZETA * W * slope),
        )
        climb, force, force_slope = (
            climb + STEP * (force / mass - GRAVITY),
            force + STEP * force_slope,
            force_slope + STEP * (W * W * (lifted - force) - 2.0 * ZETA * W * force_slope),
        )
    times = STEP * np.arange(3000)
    rate, moment, slope, force, force_slope = states[n]
    expected = falling_with_its_own_poles(
        4, 4.0 / (1.15 + delay), [leans[n], rate, moment / inertia, slope / inertia], times
    )
    # the slope of the reports comes 0.02 s late, which a pole of 3 rad/s sees as a few hundredths
    assert np.abs(np.array(leans[n:]) - expected).max() < 0.06 * np.abs(expected).max()
    expected = falling_with_its_own_poles(
        3, 3.0 / (0.9 + delay), [climbs[n], force / mass - GRAVITY, force_slope / mass], times
    )
    assert np.abs(np.array(climbs[n:]) - expected).max() < 0.06 * np.abs(expected).max()


def test_it_is_caught_when_nothing_is_left_to_do_and_not_before() -> None:
    vehicle, _ = load_vehicle("hexjet-p220")
    curve = StaticCurve("straight", (0.0, 1.0), (0.0, 200.0))
    catch = Recovery(vehicle, ThrustMap(curve, [curve] * 6), LEAD, 0.0, 0.004)
    weight = vehicle.mass_kg * GRAVITY
    for given, lean, rate, off, caught in (
        (1.0, 0.0, 0.0, 0.0, True),
        (0.9, 0.0, 0.0, 0.0, False),
        (1.1, 0.0, 0.0, 0.0, False),
        (1.0, 0.2, 0.0, 0.0, False),
        (1.0, 0.0, 0.3, 0.0, False),
        (1.0, 0.0, 0.0, -1.0, False),
    ):
        catch.reset((0.0, 0.0, *[0.25 * given * weight] * 4), USED, weight)
        catch.update(lean, rate, off, 0.0, cos(lean), vehicle.mass_kg)
        assert catch.is_complete is caught, (given, lean, rate, off)


def test_lift_never_asks_for_less_than_roll_can_be_had_beside() -> None:
    vehicle, _ = load_vehicle("hexjet-p220")
    curve = StaticCurve("straight", (0.0, 1.0), (10.0, 210.0))
    catch = Recovery(vehicle, ThrustMap(curve, [curve] * 6), LEAD, 0.0, 0.004)
    catch.reset((0.0, 0.0, *[150.0] * 4), USED, 600.0)
    _, collective = catch.update(0.0, 0.0, 50.0, 0.0, 1.0, vehicle.mass_kg)
    assert collective == catch.least_collective == pytest.approx((0.7 * 600.0 - 60.0) / 1200.0)


def test_an_engine_of_another_form_is_refused() -> None:
    vehicle, _ = load_vehicle("hexjet-p220")
    curve = StaticCurve("straight", (0.0, 1.0), (0.0, 200.0))
    with pytest.raises(ValueError, match="second order"):
        Recovery(vehicle, ThrustMap(curve, [curve] * 6), EngineLead(natural_rad_s=2.0, pole_rad_s=8.0), 0.0, 0.004)
