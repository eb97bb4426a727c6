"""The lead on a slow engine: its transfer function, a P220-like engine behind it, saturation, a flight."""

from __future__ import annotations

from math import exp, pi, radians
from typing import Any

import control
import numpy as np
import pytest
from lead_tools import STEP, answered, axis
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter

from cosim import Scenario, fly
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.signals import Command, Measured, Unallocated
from cosim.control.altitude import AltitudeController
from cosim.control.lead import Lead, lead_polynomials
from cosim.control.rate import RateAxis
from cosim.spec.vehicle import EngineLead, RateGains, load_vehicle

P220 = EngineLead(natural_rad_s=1.294, damping=0.66, pole_rad_s=6.0)
APART = EngineLead(natural_rad_s=2.0, damping=1.4, pole_rad_s=9.0)  # two real poles
SINGLE = EngineLead(natural_rad_s=3.04, pole_rad_s=15.0)
ALL = (P220, APART, SINGLE)


def engine(lead: EngineLead) -> tuple[Any, Any, Any, Any]:
    """What the lead divides out, held and sampled by scipy: w^2 / (s^2 + 2 zeta w s + w^2), or w / (s + w)."""
    w, zeta = lead.natural_rad_s, lead.damping
    if zeta is None:
        system = (np.array([[-w]]), np.array([[w]]), np.array([[1.0]]), np.array([[0.0]]))
    else:
        a, b = np.array([[0.0, 1.0], [-w * w, -2.0 * zeta * w]]), np.array([[0.0], [w * w]])
        system = (a, b, np.array([[1.0, 0.0]]), np.array([[0.0]]))
    A, B, C, _, _ = cont2discrete(system, STEP)
    return A, B[:, 0], C[0], lead


def thrusts(made: tuple[Any, Any, Any, Any], commands: NDArray[np.float64]) -> NDArray[np.float64]:
    A, B, C, _ = made
    x = np.zeros(len(A))
    found = []
    for u in commands:
        x = A @ x + B * u
        found.append(C @ x)
    return np.array(found)


@pytest.mark.parametrize("lead", ALL)
def test_the_block_is_its_polynomials(lead: EngineLead) -> None:
    wanted = np.random.default_rng(1).standard_normal(500)
    over, under = lead_polynomials(lead, STEP)
    # both are sums of some ten terms that cancel to about (w T)^2 of them
    np.testing.assert_allclose(answered(lead, wanted), lfilter(over, under, wanted), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("lead", ALL)
def test_it_is_the_continuous_lead(lead: EngineLead) -> None:
    """C(s) as python-control has it; matched poles and zeros are off by (w T)^2 / 12 in the middle of the band."""
    w, zeta, a = lead.natural_rad_s, lead.damping, lead.pole_rad_s
    s = control.tf("s")
    exact = (a / w) * (s + w) / (s + a)
    if zeta is not None:
        exact = (a / w) ** 2 * (s * s + 2 * zeta * w * s + w * w) / (s + a) ** 2
    over, under = lead_polynomials(lead, STEP)
    for hertz in (0.0, 0.05, 0.2, 0.5, 1.0, 2.0):
        z = np.exp(2j * pi * hertz * STEP)
        ours = np.polyval(over, z) / np.polyval(under, z)
        # half a step of difference in phase, where a zero at minus infinity is left out, is (w T) / 2 at these
        assert ours == pytest.approx(exact(2j * pi * hertz), rel=0.5 * 2.0 * pi * 2.0 * STEP)
    assert np.polyval(over, 1.0) / np.polyval(under, 1.0) == pytest.approx(1.0, rel=1e-10)
    assert np.abs(np.roots(under)) == pytest.approx(exp(-a * STEP), abs=1e-7)


@pytest.mark.parametrize("lead", ALL)
def test_the_engine_behind_it_keeps_nothing_of_its_lags(lead: EngineLead) -> None:
    """C(z) G(z) is k b(z) / (z - e^(-aT))^n, b the sampled engine's own numerator: exact, by scipy's sampling."""
    A, B, C, _ = made = engine(lead)
    own = np.real(np.poly(A))
    b = np.real(np.poly(A - np.outer(B, C))) - own
    p, n = exp(-lead.pole_rad_s * STEP), len(A)
    faster = np.real(np.poly([p] * n))
    wanted = np.repeat([1.0, -0.4, 0.7], 400)
    # b is of degree n - 1; the thrust of a step's end comes one step before the usual sampled system's
    expected = lfilter(np.append(b[1:], 0.0) * (1.0 - p) ** n / b.sum(), faster, wanted)
    np.testing.assert_allclose(thrusts(made, answered(lead, wanted)), expected, atol=1e-8)


def test_a_step_of_a_p220_takes_as_long_as_the_moved_poles_take() -> None:
    """1 - (1 + a t) e^(-a t); the sampled command is held, which makes it half a step late."""
    wanted = np.ones(700)
    t = np.arange(1, 701) * STEP
    a = P220.pole_rad_s
    led = thrusts(engine(P220), answered(P220, wanted))
    assert np.abs(led - (1.0 - (1.0 + a * t) * np.exp(-a * t))).max() < 0.5 * STEP * a / np.e * 1.1
    alone = thrusts(engine(P220), wanted)
    # (1 + x) e^-x = 0.1 at x = 3.8897; without the lead it takes 1.9 s
    assert t[np.argmax(led > 0.9)] == pytest.approx(3.8897 / a, abs=STEP)
    assert t[np.argmax(alone > 0.9)] > 1.9
    # what it costs: at first (a / w)^2 of what is wanted
    assert answered(P220, wanted)[0] == pytest.approx((a / P220.natural_rad_s) ** 2, rel=a * STEP)


@pytest.mark.parametrize("limit", [1.5, 4.0])
def test_what_is_refused_is_taken_back(limit: float) -> None:
    """Saturated, the lead is the feedback of the thrust and its slope that it would be with an observer in its place.
    Then nothing winds up: the thrust comes as fast as the limit lets it, and stays."""
    A, B, C, _ = engine(P220)
    lead = Lead(P220, STEP)
    K = np.asarray(control.acker(A, B[:, None], [exp(-P220.pole_rad_s * STEP)] * 2)).ravel()
    ahead = 1.0 / (C @ np.linalg.solve(np.eye(2) - A + np.outer(B, K), B))
    x = np.zeros(2)
    refused = 0.0
    course = []
    for k in range(1500):
        wanted = 1.0 if k < 750 else 0.0
        asked = lead.update(wanted, refused)
        by_state = ahead * wanted - K @ x
        given = float(np.clip(by_state, -limit, limit))
        assert asked == pytest.approx(by_state, abs=1e-6 * ahead)
        refused = asked - float(np.clip(asked, -limit, limit))
        x = A @ x + B * given
        course.append(C @ x)
    assert max(course) < 1.01
    assert abs(course[740] - 1.0) < 1e-3
    assert abs(course[-1]) < 1e-3


def test_the_rate_axis_sends_its_answer_through_the_lead() -> None:
    plain, led, lead = axis(None, p=0.3, i=0.2, d=0.01), axis(Lead(P220, STEP), p=0.3, i=0.2, d=0.01), Lead(P220, STEP)
    rng = np.random.default_rng(4)
    for setpoint, rate in rng.standard_normal((60, 2)):
        assert led.update(setpoint, rate, 0.0) == lead.update(plain.update(setpoint, rate, 0.0), 0.0)
    led.reset()
    assert led.update(0.0, 0.0, 0.0) == 0.0


def test_the_predictor_reads_what_comes_behind_the_lead() -> None:
    told = []

    class Listening:
        def reset(self) -> None:
            told.clear()

        def update(self, measured: float, applied: float) -> float:
            told.append(applied)
            return measured

    gains = RateGains(p=0.3, i=0.0, d=0.0, d_filter_s=0.02, integral_limit=10.0)
    led = RateAxis(gains, Listening(), STEP, Lead(P220, STEP))
    first = led.update(1.0, 0.0, 0.0)
    assert first == pytest.approx(0.3 * (6.0 / 1.294) ** 2, rel=6.0 * STEP)
    led.update(1.0, 0.0, 0.75 * first)
    assert told == [0.0, first - 0.75 * first]


def test_height_control_finds_the_engines_settled() -> None:
    gains = load_vehicle("hexjet")[0].control.altitude
    hover = Measured((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -5.0), (0.0, 0.0, 0.0), 5.0)
    command = Command((0.0, 0.0, 0.0), 5.0)

    def throttle_for(thrust: float) -> float:
        return thrust / 120.0

    led = AltitudeController(gains, 5.0, throttle_for, STEP, Lead(P220, STEP))
    plain = AltitudeController(gains, 5.0, throttle_for, STEP)
    for _ in range(5):
        assert led.update(command, hover, Unallocated()) == pytest.approx(5.0 * GRAVITY / 120.0, rel=1e-9)
        plain.update(command, hover, Unallocated())
    # a step of the height: at first (a / w)^2 of what comes to it
    higher = Command((0.0, 0.0, 0.0), 5.1)
    more = plain.update(higher, hover, Unallocated()) - 5.0 * GRAVITY / 120.0
    led_more = led.update(higher, hover, Unallocated()) - 5.0 * GRAVITY / 120.0
    assert led_more == pytest.approx(more * lead_polynomials(P220, STEP)[0][0], rel=1e-6)


def test_it_flies_and_false_takes_it_away() -> None:
    """The shipped full-scale vehicle: without its lead the same gains are lost on engines this slow."""
    doublet = Scenario.load("full-scale-roll-doublet").replace(expect=[])
    led = fly(doublet)
    assert led.outcome == "completed"
    assert led.metrics["roll"].overshoot_percent < 20.0
    assert led.metrics["roll"].final_error_rad < radians(0.5)
    assert led.metrics["roll"].oscillation_rad < radians(0.2)
    without = fly(doublet.replace(vehicle={"control": {"lead": {"roll": False}}}))
    assert without.outcome == "diverged"


def test_a_wrong_lead_is_refused() -> None:
    for lead, said in (
        ({"natural_rad_s": 0.0, "pole_rad_s": 3.0}, "natural_rad_s"),
        ({"natural_rad_s": 1.0}, "pole_rad_s"),
        ({"natural_rad_s": 1.0, "pole_rad_s": 3.0, "zeta": 1.0}, "zeta"),
    ):
        with pytest.raises(InputError, match=said):
            load_vehicle("hexjet", {"control": {"lead": {"roll": lead}}})
