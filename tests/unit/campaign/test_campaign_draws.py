"""The draws of a study: exact where the design or the distribution has a closed form, and the same ever after."""

from __future__ import annotations

from collections import Counter
from itertools import product
from math import erf, log, pi, sin, sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import pearsonr, qmc, spearmanr

from cosim.campaign.study.distributions import Vary, parse_vary
from cosim.campaign.study.draws import BLOCK, MIN_QUANTILE, Draws, flight_seed, inverse, latin_hypercube, reorder_points
from cosim.campaign.study.key import Key
from cosim.campaign.study.options import open_study
from cosim.campaign.study.study import Study
from cosim.campaign.study.values import levels

STORED = [
    (5863379305646526, 5.360553678634377, 20),
    (6751284013644074, 5.988351960532979, 13),
]  # seed, mass, delay of draws 0 and 1500
DESIGNS = ("latin-hypercube", "random", "sobol")
MASS, DELAY, GAIN = "vehicle.mass_kg", "engine_parameters.delay_samples", "engine_parameters.gain"
FLOAT = Key("x", "float", 2.0)
WHOLE = Key("n", "int", 20)
STEPS = Key("t_s", "float", 1.0, grid=0.004)


def study(vary: list[str], **options: Any) -> Study:
    return open_study("hover", vary=vary, **options)


def column(made: Study, key: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([draw.values[key] for draw in Draws(made)], dtype=np.float64)


def bent(text: str, shares: Any, key: Key = FLOAT) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array(inverse(parse_vary(text), key)(np.asarray(shares, dtype=np.float64)), dtype=np.float64)


def normal(z: float) -> float:
    return 0.5 * (1.0 + erf(z / sqrt(2.0)))


def test_a_grid_is_every_combination_the_last_key_fastest() -> None:
    made = study([f"{MASS}=5:6:3", "substeps=1:4:4", "engine=edf,edf-as-flown"], repeats=2)
    points = [(d.values[MASS], d.values["substeps"], d.values["engine"]) for d in Draws(made)]
    once = list(product([5.0, 5.5, 6.0], [1, 2, 3, 4], ["edf", "edf-as-flown"]))
    assert points == once * 2
    assert len({draw.seed for draw in Draws(made)}) == made.draws == 48


def test_levels_hit_both_ends_and_read_as_a_person_would_write_them() -> None:
    assert levels(parse_vary("x=0:1:11"), FLOAT) == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
    assert levels(parse_vary("x=log(0.001:1:4)"), FLOAT) == [0.001, 0.01, 0.1, 1.0]
    assert levels(parse_vary("x*=0.7:1.3:3"), FLOAT) == [1.4, 2.0, 2.6]
    assert levels(parse_vary("n*=0.7:1.3:5"), WHOLE) == [14, 17, 20, 23, 26]
    assert levels(parse_vary("n=17.5:32.4:3"), WHOLE) == [18, 25, 32]
    assert levels(parse_vary("t_s=0.1:0.2:4"), STEPS) == [0.1, 0.132, 0.168, 0.2]
    assert levels(parse_vary("n+=-5,0,5"), WHOLE) == [15, 20, 25]


@pytest.mark.parametrize("correlate", [[], [f"{MASS},{GAIN}=-0.7"]])
def test_a_latin_hypercube_has_one_point_in_every_stratum(correlate: list[str]) -> None:
    made = study([f"{MASS}=5:6", f"{GAIN}*=0.7:1.3", f"{DELAY}=11:30"], runs=200, correlate=correlate)
    nominal = made.key(GAIN).nominal
    assert isinstance(nominal, float)
    for values in (column(made, MASS) - 5.0, (column(made, GAIN) / nominal - 0.7) / 0.6):
        assert sorted(np.floor(values * 200.0).astype(int)) == list(range(200))
    # 20 whole numbers in 200 strata: ten each, those at the ends too
    assert Counter(column(made, DELAY)) == dict.fromkeys(range(11, 31), 10)


def test_values_are_shared_out_evenly_in_a_latin_hypercube() -> None:
    made = study(["engine=edf,edf-as-flown,motor", f"{MASS}=5:6"], runs=30)
    assert Counter(draw.values["engine"] for draw in Draws(made)) == {"edf": 10, "edf-as-flown": 10, "motor": 10}


def test_sobol_fills_every_dyadic_box() -> None:
    """A net in base 2: each box of volume 2^-m holds as many of 2^n points as its share, exactly.
    In one dimension of any scrambled Sobol sequence; in two of its first two dimensions, a (0, m, 2)-net."""
    made = study([f"{MASS}=0.001:1.001", f"{GAIN}=1:2"], design="sobol", runs=256)
    x, y = column(made, MASS) - 0.001, column(made, GAIN) - 1.0
    assert sorted(np.floor(x * 256.0)) == list(range(256))
    for power in range(9):
        boxes = Counter(zip(np.floor(x * 2**power), np.floor(y * 2 ** (8 - power)), strict=True))
        assert set(boxes.values()) == {1}
        assert len(boxes) == 256


@pytest.mark.parametrize("design", DESIGNS)
def test_any_draw_can_be_had_alone_and_from_the_study_alone(design: str) -> None:
    made = study(
        [f"{MASS}=5:6", f"{DELAY}=11:30"], runs=2 * BLOCK + 5, design=design, correlate=[f"{MASS},{DELAY}=0.5"]
    )
    whole = list(Draws(made))
    assert [draw.number for draw in whole] == list(range(made.draws))
    for number in (2 * BLOCK + 4, 3, BLOCK, BLOCK - 1):
        assert Draws(made)[number] == whole[number]
    backwards = Draws(made)
    assert [backwards[number] for number in (2 * BLOCK, 0, -1)] == [whole[2 * BLOCK], whole[0], whole[-1]]
    assert backwards[BLOCK - 2 : BLOCK + 2] == whole[BLOCK - 2 : BLOCK + 2]
    with pytest.raises(IndexError):
        backwards[made.draws]


@pytest.mark.parametrize("design", ["random", "sobol"])
def test_a_longer_study_begins_with_the_shorter_one(design: str) -> None:
    vary = [f"{MASS}=5:6", f"{DELAY}=11:30"]
    short, long = (study(vary, design=design, runs=runs, correlate=[f"{MASS},{DELAY}=0.5"]) for runs in (1030, 3000))
    assert list(Draws(short)) == Draws(long)[:1030]


def test_a_million_draws_wait_until_they_are_asked_for() -> None:
    made = Draws(study([f"{MASS}=5:6"], design="random", runs=10_000_000))
    assert len(made) == 10_000_000
    assert made[9_999_999].number == 9_999_999


def test_random_points_are_independent() -> None:
    """Rank correlation of independent columns: zero within four standard deviations, 4 / sqrt(n)."""
    made = study([f"{MASS}=5:6", f"{GAIN}=1:2"], design="random", runs=4096)
    x, y = column(made, MASS), column(made, GAIN)
    assert abs(spearmanr(x, y).statistic) < 4.0 / 64.0
    assert abs(spearmanr(x[1:], x[:-1]).statistic) < 4.0 / 64.0
    # Kolmogorov's distance to the uniform: above 1.95 / sqrt(n) once in a thousand
    assert np.max(np.abs(np.sort(x - 5.0) - (np.arange(4096) + 0.5) / 4096)) < 1.95 / 64.0


def test_another_seed_is_another_study() -> None:
    for design in DESIGNS:
        first, second = (study([f"{MASS}=5:6"], design=design, runs=8, seed=seed) for seed in (1, 2))
        assert not set(column(first, MASS)) & set(column(second, MASS))


def test_a_flights_seed_depends_on_the_study_seed_and_the_number_alone() -> None:
    studies = [
        study([f"{MASS}=5:6"], runs=20, seed=4),
        study([f"{DELAY}=11:30", f"{GAIN}*=0.9:1.1"], runs=40, design="random", seed=4),
        study(["engine=edf,motor", "substeps=1:10:10"], seed=4),
    ]
    for made in studies:
        assert [draw.seed for draw in Draws(made)[:20]] == [flight_seed(4, number) for number in range(20)]
    seeds = [flight_seed(seed, number) for seed in range(20) for number in range(500)]
    assert len(set(seeds)) == len(seeds)
    assert max(seeds) < 2**53
    assert max(seeds) > 2**52


def test_the_first_draws_are_those_of_ever() -> None:
    """A campaign that is taken up in another year goes on with the same draws (numpy keeps these streams)."""
    made = study([f"{MASS}=5:6", f"{DELAY}=11:30"], design="random", runs=1600, seed=6)
    assert [(draw.seed, *draw.values.values()) for draw in (Draws(made)[0], Draws(made)[1500])] == STORED


SHARES = (np.arange(400) + 0.5) / 400.0


def truncated(cdf: Any, low: float, high: float) -> Any:
    return lambda x: (cdf(x) - cdf(low)) / (cdf(high) - cdf(low))


@pytest.mark.parametrize(
    ("text", "cdf"),
    [
        ("x=-3:5", lambda x: (x + 3.0) / 8.0),
        ("x=log(0.01:10)", lambda x: log(x / 0.01) / log(1000.0)),
        ("x*=0.7:1.3", lambda x: (x / 2.0 - 0.7) / 0.6),
        ("x+=-0.5:1", lambda x: (x - 1.5) / 1.5),
        ("x*=log(0.5:2)", lambda x: log(x) / log(4.0)),
        ("x=normal(1,0.5)", lambda x: normal((x - 1.0) / 0.5)),
        ("x=normal(1,0.5,0.2,1.4)", truncated(lambda x: normal((x - 1.0) / 0.5), 0.2, 1.4)),
        ("x=normal(1,0.5,2.5,)", lambda x: 1.0 - erfc_ratio((x - 1.0) / 0.5, 3.0)),
        ("x*=normal(1,0.1)", lambda x: normal((x / 2.0 - 1.0) / 0.1)),
        ("x=lognormal(2,0.3)", lambda x: normal(log(x / 2.0) / 0.3)),
        ("x=lognormal(2,0.3,1.5,3)", truncated(lambda x: normal(log(x / 2.0) / 0.3), 1.5, 3.0)),
        ("x=triangular(1,2,5)", lambda x: (x - 1.0) ** 2 / 4.0 if x < 2.0 else 1.0 - (5.0 - x) ** 2 / 12.0),
        ("x=triangular(1,1,5)", lambda x: 1.0 - (5.0 - x) ** 2 / 16.0),
    ],
)
def test_the_inverse_undoes_the_distribution(text: str, cdf: Any) -> None:
    values = bent(text, SHARES)
    assert np.all(np.diff(values) > 0.0)
    assert [cdf(x) for x in values] == pytest.approx(SHARES, abs=1e-12)  # a few roundings of numbers below 1


def erfc_ratio(z: float, from_z: float) -> float:
    """Of a normal distribution beyond ``from_z``, the share beyond ``z``."""
    from math import erfc

    return erfc(z / sqrt(2.0)) / erfc(from_z / sqrt(2.0))


def test_a_negative_nominal_value_turns_a_factor_round() -> None:
    values = bent("x*=0.5:2", [MIN_QUANTILE, 0.5, 1.0 - 2.0**-53], Key("x", "float", -0.08))
    assert values == pytest.approx([-0.04, -0.1, -0.16])


def test_whole_numbers_take_the_probability_of_the_half_steps_around_them() -> None:
    """n strata: a count differs from n p by less than 2, one for each end."""
    runs = 1000
    made = study([f"{DELAY}=normal(25,3,18,40)"], runs=runs)
    counts = Counter(column(made, DELAY))
    within = normal((40.5 - 25.0) / 3.0) - normal((17.5 - 25.0) / 3.0)
    assert set(counts) <= set(range(18, 41))
    for number in range(18, 41):
        share = (normal((number + 0.5 - 25.0) / 3.0) - normal((number - 0.5 - 25.0) / 3.0)) / within
        assert abs(counts[number] - runs * share) < 2.0


def test_times_are_drawn_in_whole_control_steps() -> None:
    values = bent("t_s=0.0995:0.1085", (np.arange(30) + 0.5) / 30.0, STEPS)
    assert Counter(values) == {0.1: 10, 0.104: 10, 0.108: 10}


@pytest.mark.parametrize(("design", "bound"), [("latin-hypercube", 0.01), ("sobol", 0.01), ("random", 0.045)])
@pytest.mark.parametrize("rank", [-0.9, -0.3, 0.6])
def test_the_rank_correlation_is_the_one_asked_for(design: str, bound: float, rank: float) -> None:
    """Whatever the distributions.  Random draws scatter by at most 1.1 / sqrt(n), here 0.011 to four of which is held."""
    vary = [f"{MASS}=log(1:10)", f"{GAIN}=triangular(1,1,2)", "environment.wind_ned_m_s.0=-3:3"]
    made = study(vary, runs=9216, design=design, correlate=[f"{MASS},{GAIN}={rank}"])
    mass, gain, wind = (column(made, vary.key) for vary in made.vary)
    assert spearmanr(mass, gain).statistic == pytest.approx(rank, abs=bound)
    assert abs(spearmanr(mass, wind).statistic) < 0.045
    assert abs(spearmanr(gain, wind).statistic) < 0.045


def test_three_keys_are_correlated_together() -> None:
    vary = [f"{MASS}=5:6", f"{GAIN}=1:2", "environment.wind_ned_m_s.0=-3:3"]
    pairs = {(0, 1): 0.8, (1, 2): 0.5, (0, 2): 0.1}
    keys = [parse_vary(text).key for text in vary]
    made = study(vary, runs=2048, correlate=[f"{keys[a]},{keys[b]}={rank}" for (a, b), rank in pairs.items()])
    columns = [column(made, key) for key in keys]
    for (a, b), rank in pairs.items():
        assert spearmanr(columns[a], columns[b]).statistic == pytest.approx(rank, abs=0.02)


def test_normal_keys_have_the_correlation_of_the_closed_form() -> None:
    """Pearson's 2 sin(pi rank / 6), of normal variables; 4 standard deviations of (1 - r^2) / sqrt(n)."""
    vary = [f"{MASS}=normal(50,1,1,)", f"{GAIN}=normal(5,0.1,1,9)"]
    made = study(vary, runs=8192, design="random", correlate=[f"{MASS},{GAIN}=0.6"])
    wanted = 2.0 * sin(pi * 0.1)
    found = pearsonr(column(made, MASS), column(made, GAIN)).statistic
    assert found == pytest.approx(wanted, abs=4.0 * (1.0 - wanted**2) / sqrt(8192))


def test_a_few_runs_in_a_line_are_rearranged_all_the_same() -> None:
    """Scores that are correlated by chance to the full have no inverse."""
    points = np.array([[0.1, 0.2], [0.5, 0.4], [0.9, 0.8]])
    found = reorder_points(points, np.array([[1.0, -0.9], [-0.9, 1.0]]))
    assert sorted(found[:, 1]) == [0.2, 0.4, 0.8]
    assert list(found[:, 0]) == [0.1, 0.5, 0.9]


NUMBER = st.floats(-1e6, 1e6, allow_subnormal=False)
SHARE = st.sampled_from([MIN_QUANTILE, 1e-9, 0.25, 0.5, 1.0 - 2.0**-53]) | st.floats(MIN_QUANTILE, 1.0 - 2.0**-53)


@st.composite
def bounded(draw: st.DrawFn) -> Vary:
    """Anything that has bounds."""
    low = draw(NUMBER)
    high = draw(st.floats(low, 2e6, exclude_min=True).filter(lambda each: each - low > 1e-9 * (1.0 + abs(low))))
    middle = min(max(low + draw(st.floats(0.0, 1.0)) * (high - low), low), high)
    form = draw(st.sampled_from(["range", "log", "normal", "lognormal", "triangular"]))
    table: dict[str, Any] = {"key": "x", "relative": draw(st.sampled_from(["", "factor", "offset"]))}
    if form == "log":
        table |= {"range": (abs(high) + 0.1, 2.0 * abs(high) + 1.0), "scale": "log"}
    elif form == "range":
        table |= {"range": (low, high)}
    elif form == "triangular":
        table |= {"triangular": {"min": low, "mode": middle, "max": high}}
    elif form == "normal":
        table |= {"normal": {"mean": middle, "sd": draw(st.floats(0.1, 3.0)) * (high - low), "min": low, "max": high}}
    else:
        median = 0.1 + abs(middle)
        spread = draw(st.floats(1.1, 100.0))
        table |= {"lognormal": {"median": median, "sigma": 0.5, "min": median / spread, "max": median * spread}}
    return Vary.model_validate(table)


@pytest.mark.parametrize(("draws_of", "sides"), [(1, 1), (7, 3), (200, 12)])
def test_a_latin_hypercube_is_that_of_scipy(draws_of: int, sides: int) -> None:
    theirs = qmc.LatinHypercube(sides, rng=np.random.default_rng(5)).random(draws_of)
    ours = latin_hypercube(np.random.default_rng(5), draws_of, sides)
    assert ours.tobytes() == np.ascontiguousarray(theirs).tobytes()


@settings(max_examples=80)
@given(bounded(), st.lists(SHARE, min_size=1, max_size=5), st.sampled_from([-3.5, 2.0]))
def test_no_bound_is_ever_passed(vary: Vary, shares: list[float], nominal: float) -> None:
    ends = [{"": end, "factor": end * nominal, "offset": end + nominal}[vary.relative] for end in vary.support]
    for value in inverse(vary, Key("x", "float", nominal))(np.array(shares)):
        assert min(ends) <= value <= max(ends)


@settings(max_examples=60)
@given(
    st.integers(-50, 50), st.integers(1, 60), st.floats(0.0, 0.49), st.floats(0.0, 0.49), st.lists(SHARE, min_size=1)
)
def test_whole_numbers_lie_within_the_bounds(
    first: int, count: int, before: float, behind: float, shares: list[float]
) -> None:
    vary = Vary(key="n", range=(first - before, first + count + behind))
    for value in inverse(vary, WHOLE)(np.array(shares)):
        assert isinstance(value, int)
        assert first <= value <= first + count
