"""The normal space of a study: its coordinates have the distributions that the study states, exactly."""

from __future__ import annotations

from math import erf, exp, log, pi, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import uncertain_engines as engines

from cosim.base.errors import InputError
from cosim.campaign.study.distributions import parse_vary
from cosim.campaign.study.draws import Draws
from cosim.campaign.study.normal_space import NormalSpace, draw_seed
from cosim.campaign.study.options import open_study
from cosim.campaign.study.study import Study

MASS, DELAY, NOISE = "vehicle.mass_kg", "engine_parameters.delay_samples", "vehicle.sensors.gyro.noise_rad_s"
WIND, EAST = "environment.wind_ned_m_s.0", "environment.wind_ned_m_s.1"
COORDINATES = [-6.0, -3.0, -1.0, 0.0, 0.5, 2.0, 4.7, 6.0]


def study(vary: list[str], **options: Any) -> Study:
    return open_study("hover", vary=vary, **{"design": "random", "runs": 4, "nominal_engine": True} | options)


def share_below(z: float) -> float:
    return 0.5 * (1.0 + erf(z / sqrt(2.0)))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        (f"{WIND}=normal(5.5,0.01)", lambda u: 5.5 + 0.01 * u),
        (f"{MASS}=lognormal(5.5,0.01,0.1,100)", lambda u: 5.5 * exp(0.01 * u)),
        (f"{MASS}=5:6", lambda u: 5.0 + share_below(u)),
        (f"{MASS}=log(5:6)", lambda u: 5.0 * exp(share_below(u) * log(1.2))),
        (f"{DELAY}=10:19", lambda u: min(10 + int(10 * share_below(u)), 19)),
        (f"{DELAY}=3,7", lambda u: 3 if u < 0.0 else 7),
    ],
)
def test_a_coordinate_is_mapped_by_the_inverse_of_its_distribution(text: str, value: Any) -> None:
    space = NormalSpace(study([text]))
    assert (space.dimension, space.names) == (1, [parse_vary(text).key])
    points = np.array(COORDINATES)[:, None] + 1e-9
    mapped = [next(iter(row.values())) for row in space.values(points)]
    assert mapped == pytest.approx([value(u) for u in points[:, 0]], rel=1e-8)


@pytest.mark.parametrize("text", [f"{MASS}=normal(5.5,0.2,5.2,5.6)", f"{MASS}=triangular(5,5.2,6)"])
def test_bounded_distributions_keep_their_quantiles(text: str) -> None:
    """A truncated normal's and a triangular's quantiles, by their distribution functions in closed form."""
    space = NormalSpace(study([text]))
    below, above = (share_below((bound - 5.5) / 0.2) for bound in (5.2, 5.6))
    for u in (-3.0, -0.3, 0.0, 1.0, 3.0):
        mass = space.draw(np.array([u]), 1).values[MASS]
        assert isinstance(mass, float)
        if "normal" in text:
            quantile = (share_below((mass - 5.5) / 0.2) - below) / (above - below)
        else:
            quantile = (mass - 5.0) ** 2 / 0.2 if mass < 5.2 else 1.0 - (6.0 - mass) ** 2 / 0.8
        assert quantile == pytest.approx(share_below(u), rel=1e-9)


def test_correlated_keys_have_the_correlation_of_the_studys_draws() -> None:
    """The copula's normal variables: with u = (u1, u2), the second is r u1 + sqrt(1 - r^2) u2, r = 2 sin(pi rank / 6)."""
    made = study([f"{WIND}=normal(5.5,0.01)", f"{EAST}=normal(0.1,0.001)"], correlate=[f"{WIND},{EAST}=0.5"])
    normal = 2.0 * sin(pi * 0.5 / 6.0)
    values = NormalSpace(made).draw(np.array([1.5, -0.7]), 3).values
    assert values[WIND] == pytest.approx(5.5 + 0.01 * 1.5, rel=1e-12)
    assert values[EAST] == pytest.approx(0.1 + 0.001 * (normal * 1.5 - sqrt(1.0 - normal**2) * 0.7), rel=1e-12)


def test_a_random_study_draws_the_same_values_at_the_same_quantiles(tmp_path: Path) -> None:
    """Every kind of key at once, an uncertain engine among them: the study's own draws, by the normal of their points."""
    from scipy.special import ndtri

    fan = engines.fan(tmp_path, [2.0, 0.01, 0.02], [0.5, 0.0, 0.004])
    made = study([f"{MASS}=5:6", "engine", f"{NOISE}=log(0.01:0.1)"], settings=[f"engine={fan}"])
    space, campaign = NormalSpace(made), Draws(made)
    assert space.dimension == 2 + made.engine_draw().sides
    points = ndtri(np.delete(campaign._points(0, 4), 1, axis=1))  # the place of the engine itself has no number
    for row, draw in zip(space.values(points), campaign, strict=True):
        assert list(row) == list(draw.values)
        assert row == pytest.approx(draw.values, rel=1e-9)


def test_seeds_differ_and_are_exact_in_a_double() -> None:
    seeds = {draw_seed(np.random.default_rng(number)) for number in range(50)}
    assert len(seeds) == 50
    assert max(seeds) < 2**53


def test_a_grid_has_no_probability() -> None:
    with pytest.raises(InputError, match="a grid states levels and no probability"):
        NormalSpace(study([f"{MASS}=5:6:3"], design="grid", runs=None))


def test_a_coordinate_of_an_uncertain_engine_has_the_name_of_the_key_that_it_moves(tmp_path: Path) -> None:
    file = engines.fan(tmp_path, [3.0, 0.006, 0.02], [2.0, 0.002, 0.01])
    space = NormalSpace(study([], settings=[f"engine={file}", "controller=baseline"], nominal_engine=False))
    assert len(set(space.names)) == space.dimension == 3 + 3 * 6
    middle, *moved = space.values(np.vstack([np.zeros(space.dimension), np.eye(space.dimension)]))
    for name, values in zip(space.names, moved, strict=True):
        assert values[name] != middle[name]
        others = {key for key in values if values[key] != middle[key] and key != name}
        assert not (name.startswith("mismatch.stations") and others)  # a spread moves its own alone
