"""docs/theory.md: every formula stands by a function that exists, and the two give the same numbers.

The formulas are computed here from the page's symbols alone.
"""

from __future__ import annotations

import re
from math import comb, log, pi, sin, sqrt

import numpy as np
import pytest
from places import DOCS, ROOT
from stated_figures import defined, stated

from cosim.campaign.analysis import statistics
from cosim.campaign.analysis.sensitivity import first_order
from cosim.campaign.study.study import Correlation
from cosim.control.lead import lead_polynomials
from cosim.control.predictors.smith import (
    DelayedModel,
    DiscreteModel,
    FilteredSmithPredictor,
    SmithPredictor,
    rate_model,
    robustness_filter,
)
from cosim.control.predictors.state import StateModel, StatePredictor
from cosim.control.rate import RateAxis
from cosim.loops import pid_response
from cosim.spec.vehicle import EngineLead, RateGains, RateModel

PAGE = (DOCS / "theory.md").read_text(encoding="utf-8")
STEP = 0.004
INPUT = np.random.default_rng(3).normal(size=60)


def model(delay: float, poles: tuple[float, ...] = (0.97, 0.9), zeros: tuple[float, ...] = (0.5,)) -> RateModel:
    return RateModel(
        gain=0.02, zeros=list(zeros), poles=list(poles), delay_samples=delay, sample_time_s=STEP, source="a test"
    )


def filtered(numerator: list[float], denominator: list[float], values: np.ndarray) -> np.ndarray:
    """A transfer function of z, highest power first and of equal length, as its difference equation."""
    over = [0.0] * (len(denominator) - len(numerator)) + numerator
    given: list[float] = []
    for k in range(len(values)):
        total = sum(b * values[k - i] for i, b in enumerate(over) if k >= i)
        given.append(total - sum(a * given[k - i] for i, a in enumerate(denominator) if 0 < i <= k))
    return np.array(given)


def late(values: np.ndarray, samples: int) -> np.ndarray:
    return np.concatenate((np.zeros(samples), values))[: len(values)]


def now(stated_model: RateModel) -> np.ndarray:
    """``G_n u``, with the input of the step before."""
    over = stated_model.gain * np.poly(stated_model.zeros)
    return filtered(list(over), list(np.poly(stated_model.poles)), INPUT)


def test_every_formula_names_a_function_that_exists() -> None:
    formulas = re.findall(r"^\$\$$", PAGE, re.MULTILINE)
    named = re.findall(r"`((?:cosim|tools)/[\w/]+\.py):([\w.]+)`", PAGE)
    assert len(formulas) % 2 == 0
    assert len(formulas) // 2 >= 20
    assert [f"{file}:{name}" for file, name in named if name not in defined(ROOT / file)] == []
    parts = re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:]
    assert all("`cosim/" in part or "`tools/" in part for part in parts if "$$" in part)


def told(values: np.ndarray) -> np.ndarray:
    """A predictor is told at ``k`` what was applied over the step before, ``u_k-1``."""
    return late(values, 1)


def test_the_plant() -> None:
    stated_model = model(0.0)
    block = rate_model(stated_model)
    assert isinstance(block, DiscreteModel)
    np.testing.assert_allclose([block.update(u) for u in told(INPUT)], now(stated_model), rtol=0, atol=1e-15)


@pytest.mark.parametrize("pole", [0.9, 1.0])
def test_a_fraction_of_a_sample(pole: float) -> None:
    """``c (s + (1 - s) / z) / (z - p)`` behind the whole samples."""
    f = 0.3
    s = 1.0 - f if pole == 1.0 else (pole ** (1.0 - f) - 1.0) / (pole - 1.0)
    block = DelayedModel(model(4.0 + f, (pole,), ()))
    wanted = late(filtered([0.02 * s, 0.02 * (1.0 - s)], [1.0, -pole, 0.0], INPUT), 4)
    np.testing.assert_allclose([block.update(u) for u in told(INPUT)], wanted, rtol=0, atol=1e-15)


def test_smith_and_the_filtered_one() -> None:
    stated_model = model(7.0)
    y = np.random.default_rng(4).normal(size=len(INPUT))
    then = late(now(stated_model), 7)
    smith = SmithPredictor(stated_model)
    given = [smith.update(*pair) for pair in zip(y, told(INPUT), strict=True)]
    np.testing.assert_allclose(given, y + now(stated_model) - then, rtol=0, atol=1e-14)
    over, under = robustness_filter(stated_model, 0.05)
    block = FilteredSmithPredictor(stated_model, over, under)
    given = [block.update(*pair) for pair in zip(y, told(INPUT), strict=True)]
    np.testing.assert_allclose(given, now(stated_model) + filtered(over, under, y - then), rtol=0, atol=1e-13)


def test_the_filters_conditions() -> None:
    def answer(z: float, poles: tuple[float, float]) -> float:
        over, under = robustness_filter(model(7.5, poles), 0.05)
        assert over[2] == 0.0
        np.testing.assert_allclose(np.roots(under), np.exp(-STEP / 0.05), rtol=1e-6)
        return float(np.polyval(over, z) / np.polyval(under, z))

    assert answer(1.0, (0.97, 0.9)) == pytest.approx(1.0, abs=1e-12)
    assert answer(0.97, (0.97, 0.9)) == pytest.approx(0.97**7.5, abs=1e-12)
    assert answer(1.0, (1.0, 0.9)) == pytest.approx(1.0, abs=1e-12)
    slope = (answer(1.0 + 1e-5, (1.0, 0.9)) - answer(1.0 - 1e-5, (1.0, 0.9))) / 2e-5
    assert slope == pytest.approx(7.5, rel=1e-6)


def test_the_state_predictor() -> None:
    """``A^h x_k`` and what is under way, from an observer that knows the state."""
    stated_model = model(5.0)
    space = StateModel(stated_model)
    logs = [log(pole) / STEP for pole in stated_model.poles]
    rates = np.array([[0.0, 1.0], [-logs[0] * logs[1], logs[0] + logs[1]]])
    series = term = np.eye(2)
    for n in range(1, 30):
        term = term @ rates * (STEP / n)
        series = series + term
    np.testing.assert_allclose(space.A, series, rtol=0, atol=1e-12)

    class Knows:
        def reset(self) -> None:
            """Nothing to forget."""

        def update(self, measured: float, late: float, push: object) -> tuple[tuple[float, float], float]:
            return (measured, 0.3), 0.0

    block = StatePredictor(stated_model, Knows(), space)
    given = [block.update(1.0, u) for u in told(INPUT)]
    power = np.linalg.matrix_power
    k = 40
    wanted = power(space.A, 5) @ [1.0, 0.3] + sum(power(space.A, j - 1) @ space.B * INPUT[k - j] for j in range(1, 6))
    assert given[k] == pytest.approx(wanted[0], abs=1e-13)


def test_the_loops() -> None:
    gains = RateGains(p=0.3, i=0.8, d=0.01, d_filter_s=0.02, integral_limit=100.0)
    z = np.exp(1j * np.linspace(0.1, 3.0, 7))
    s = STEP / (0.02 + STEP)
    error, slope = pid_response(gains, STEP, z)
    np.testing.assert_allclose(error, 0.3 + 0.8 * STEP / (1.0 - 1.0 / z), rtol=1e-12)
    np.testing.assert_allclose(slope, 0.01 * s * (1.0 - 1.0 / z) / (STEP * (1.0 - (1.0 - s) / z)), rtol=1e-12)
    from cosim.control.predictors.smith import NoPredictor

    axis = RateAxis(gains, NoPredictor(), STEP)
    axis.update(0.0, 0.0, 0.0)
    given = [axis.update(0.0, y, 0.0) for y in INPUT]
    feedback = filtered([0.01 * s / STEP, -0.01 * s / STEP], [1.0, -(1.0 - s)], INPUT)
    np.testing.assert_allclose(given, -0.3 * INPUT - 0.8 * STEP * np.cumsum(INPUT) - feedback, rtol=0, atol=1e-12)
    over, under = lead_polynomials(EngineLead(natural_rad_s=1.3, damping=0.7, pole_rad_s=5.0), STEP)
    root = 1.3 * (-0.7 + 1j * sqrt(1.0 - 0.49))
    np.testing.assert_allclose(np.polyval(over, np.exp(root * STEP)), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.polyval(under, np.exp(-5.0 * STEP)), 0.0, atol=1e-12)
    assert np.polyval(over, 1.0) == pytest.approx(np.polyval(under, 1.0), rel=1e-9)


def test_the_statistics() -> None:
    z = 1.959963984540054  # of 97.5 %
    (low,), (high,) = statistics.wilson(np.array([7]), np.array([40]))
    for end in (low, high):  # the interval's own definition
        assert (end - 7 / 40) ** 2 == pytest.approx(z**2 * end * (1.0 - end) / 40, rel=1e-12)
    pairs = statistics.Pairs(20, 3, 9, 8)
    tail = 2.0 * sum(comb(12, i) for i in range(4)) / 2.0**12
    assert statistics.mcnemar(pairs) == pytest.approx(tail, rel=1e-12)
    found = statistics.newcombe(pairs)
    assert found is not None
    first, second, n = (20 + 3) / 40, (20 + 9) / 40, 40
    (l1, l2), (u1, u2) = statistics.wilson(np.array([23, 29]), np.array([n, n]))
    product = 20 * 8 - 3 * 9
    phi = max(product - n / 2, 0.0) / sqrt(23 * 17 * 29 * 11)
    below, above = second - l2, u1 - first
    further, nearer = u2 - second, first - l1
    assert found[0] == pytest.approx(second - first - sqrt(below**2 - 2 * phi * below * above + above**2), abs=1e-12)
    assert found[1] == pytest.approx(
        second - first + sqrt(further**2 - 2 * phi * further * nearer + nearer**2), abs=1e-12
    )
    assert statistics.holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert Correlation(keys=("a", "b"), rank=0.4).normal == pytest.approx(2.0 * sin(pi * 0.4 / 6.0))
    stated("docs/theory.md", "in $n$ flights the interval of {} % ", 100.0 * statistics.LEVEL)
    stated("docs/theory.md", "($z = \\Phi^{-1}({})$)", 0.5 + statistics.LEVEL / 2.0)
    stated("docs/theory.md", "exact one, which holds at least {} % at every probability", 100.0 * statistics.LEVEL)


def test_the_first_order_index() -> None:
    numbered = np.repeat(np.arange(4), 10)
    y = INPUT[:40] + numbered
    means = np.array([y[numbered == c].mean() for c in range(4)])
    within, total = np.mean((y - means[numbered]) ** 2), np.mean((y - y.mean()) ** 2)
    assert first_order(numbered, y)[0] == pytest.approx(1.0 - (within / (40 - 4)) / (total / (40 - 1)), rel=1e-12)
