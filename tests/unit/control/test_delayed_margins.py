"""Margins and discretisation of a fraction behind a delay: closed forms, and the loop moved to its limit."""

from __future__ import annotations

import subprocess
import sys
from math import asin, degrees, log10, pi, sin, sqrt

import control
import numpy as np
import pytest

from cosim.base.errors import InputError
from cosim.loops import delayed_margins, sample_delayed


@pytest.mark.parametrize(("k", "delay"), [(4.0, 0.1), (0.02, 30.0), (300.0, 1e-3)])
def test_an_integrator_with_a_delay_has_its_closed_form(k: float, delay: float) -> None:
    found = delayed_margins([k], [1.0, 0.0], delay=delay)
    assert found.gain_db == pytest.approx(20.0 * log10(pi / (2.0 * k * delay)), abs=1e-9)
    assert found.phase_deg == pytest.approx(90.0 - degrees(k * delay), abs=1e-9)
    assert found.delay_s == pytest.approx((0.5 * pi - k * delay) / k, rel=1e-12)
    assert found.crossover_hz == pytest.approx(k / (2.0 * pi), rel=1e-12)
    assert (found.gain_down_db, found.phase_lead_deg, found.delay_less_s) == (None, None, None)


def test_a_sampled_integrator_some_steps_late_has_its_closed_form() -> None:
    """``c z^-m / (z - 1)``: gain 1 at 2 asin(c / 2), angle -(1/2 + m) theta - 90 deg, -180 deg at pi / (1 + 2 m)."""
    c, m, dt = 0.08, 4, 0.01
    theta = 2.0 * asin(0.5 * c)
    for found in (delayed_margins([c], [1.0, -1.0], dt, m * dt), delayed_margins([c], [1.0, -1.0, *[0.0] * m], dt)):
        assert found.crossover_hz == pytest.approx(theta / (2.0 * pi * dt), rel=1e-10)
        assert found.phase_deg == pytest.approx(90.0 - degrees((m + 0.5) * theta), abs=1e-8)
        assert found.gain_db == pytest.approx(20.0 * log10(2.0 * sin(0.5 * pi / (1.0 + 2.0 * m)) / c), abs=1e-8)


def test_what_has_margins_both_ways_none_down_or_a_gain_without_end() -> None:
    """``2 s / (s^2 - s + 1)`` is crossed at ``(1 - w^2)^2 = 3 w^2``, 60 deg from -1 either way; half the gain loses it.
    A pole on the limit itself is no margin down.  ``(s / 2 + 1) / (s + 3) e^-s`` keeps a half at every angle."""
    both = delayed_margins([2.0, 0.0], [1.0, -1.0, 1.0])
    assert (both.phase_deg, both.phase_lead_deg) == (pytest.approx(60.0), pytest.approx(60.0))
    assert (both.gain_db, both.gain_down_db) == (None, pytest.approx(20.0 * log10(0.5), abs=1e-9))
    assert both.delay_s == pytest.approx(pi / 3.0 / sqrt(0.5 * (5.0 + sqrt(21.0))), rel=1e-10)
    sampled = sample_delayed([0.5, 1.0], [1.0, 0.0, 0.0], 0.001)
    for found in (delayed_margins([1.0, 1.0], [1.0, 0.0, 1.0]), delayed_margins(*sampled, 0.001)):
        assert found.gain_down_db is None
    assert delayed_margins([0.2], [1.0, 0.5], 0.004).gain_db == pytest.approx(20.0 * log10(2.5), abs=1e-9)
    late = delayed_margins([0.5, 1.0], [1.0, 3.0], delay=1.0)
    assert (late.gain_db, late.peak_sensitivity) == (pytest.approx(20.0 * log10(2.0)), pytest.approx(2.0))


@pytest.mark.parametrize("delay", [0.0, 0.3])
@pytest.mark.parametrize("denominator", [[1.0, 3.0, 2.0, 0.0], [1.0, 0.1, 4.0, 0.0], [0.02, 0.3, 1.0]])
def test_a_loop_is_stable_up_to_its_margins_and_not_beyond(denominator: list[float], delay: float) -> None:
    found = delayed_margins([0.3], denominator, delay=delay)
    for part in (1.0 - 1e-6, 1.0 + 1e-6):
        gain = 0.3 if found.gain_db is None else 0.3 * part * 10.0 ** (found.gain_db / 20.0)
        later = 0.0 if found.delay_s is None else part * found.delay_s
        for k, tau in {(gain, delay), (0.3, delay + later)} - {(0.3, delay)}:
            if part < 1.0:
                delayed_margins([k], denominator, delay=tau)
            else:
                with pytest.raises(InputError, match="poles outside the limit: 2"):
                    delayed_margins([k], denominator, delay=tau)


def test_the_discretisation_is_python_control_s_and_between_steps_the_integral_of_the_hold() -> None:
    numerator, denominator = sample_delayed([2.0], [1.0, 3.0, 2.0, 0.0], 0.05)
    theirs = control.c2d(control.tf([2.0], [1.0, 3.0, 2.0, 0.0]), 0.05)
    np.testing.assert_allclose(numerator, theirs.num[0][0], rtol=1e-9)
    np.testing.assert_allclose(denominator, theirs.den[0][0], rtol=1e-12)
    # a lag that hears a command 0.3 of a step late: 1 - e^-0.7 in the first sample, the rest of it decays
    numerator, denominator = sample_delayed([1.0], [1.0, 1.0], 1.0, 2.3)
    np.testing.assert_allclose(denominator, [1.0, -np.exp(-1.0), 0.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(numerator, [1.0 - np.exp(-0.7), np.exp(-0.7) - np.exp(-1.0)], rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (([1.0, 0.0, 0.0], [1.0, 1.0]), "numerator: of degree 2, above the denominator's 1"),
        (([1.0], [0.0]), "denominator: one row of finite coefficients, not all 0"),
        (([0.1], [1.0, -1.0], 0.01, 0.015), "delay: 0.015 s is not whole steps of 0.01 s; sample_delayed"),
        (([1.0], [1.0, 0.0], 0.0, -0.1), "delay: -0.1 s; at least 0"),
        (([1.0], np.poly([-1e9, -1.0]), 0.0, 1.0), "delay: 1 s turns the loop too often below 1e.10 rad/s"),
        (([1.0], [1.0, 0.0], 0.004, 0.1), "at the limit along a range of frequencies"),
        (([20.0], [1.0, 0.0], 0.0, 0.1), "not stable, it has no margins: poles outside the limit: 2"),
        (([1.1, 1.0], [1.0, 3.0], 0.0, 1.0), "not stable, it has no margins: poles outside the limit: without end"),
        ((*sample_delayed([1.0], np.poly([-1.0] * 4), 1e-5), 1e-5), "its digits do not tell the loop"),
    ],
)
def test_what_has_no_margins_is_a_line(arguments: tuple[list[float], ...], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        delayed_margins(*arguments)


def test_loops_and_limits_are_light() -> None:
    program = (
        "import sys; from cosim.loops import delayed_margins, sample_delayed; "
        "from hexjet_design.load_limit import least_load_error; "
        "delayed_margins(*sample_delayed([1.0], [1.0, 0.0], 0.1, 0.25), 0.1); "
        "print({'jsbsim', 'pyarrow', 'fmpy', 'plotly'} & sys.modules.keys())"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.strip() == "set()"
