"""A campaign's report: its statistics against closed forms and other implementations, and a page for every campaign."""

from __future__ import annotations

import html
import json
import re
from itertools import product
from math import comb, pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects
import pytest
from campaigns import DELAY, GAIN, MASS, NOISE, TURBULENCE, WIND, campaign, loop, study
from patience import PATIENCE
from scipy import stats
from scipy.stats import qmc
from watched import opened

from cosim import fly
from cosim.base.errors import InputError
from cosim.campaign.analysis.figures import distribution, group_medians
from cosim.campaign.analysis.page import make_page, write_campaign_report
from cosim.campaign.analysis.sensitivity import (
    first_order,
    joint,
    max_classes,
    noise_floor,
    rank_correlations,
    rank_effects,
    rank_interval,
)
from cosim.campaign.analysis.stability_map import MAX_POINTS, MIN_PER_CELL, map_tables
from cosim.campaign.analysis.statistics import (
    Pairs,
    Z,
    assign_classes,
    count_pairs,
    holm,
    mcnemar,
    median_difference,
    newcombe,
    proportion,
    wilson,
)
from cosim.campaign.analysis.summary import (
    campaign_summary,
    compare_controllers,
    comparison_lines,
    count_reasons,
    spread_table,
    strip_numbers,
    success_lines,
)
from cosim.campaign.analysis.table import KINDS, describe_criterion, metric, read_flight_table, short_names
from cosim.campaign.analysis.worst_cases import eccentricity, worst_flights, write_case
from cosim.campaign.store import Campaign
from cosim.campaign.study.plan import Flight, flights
from cosim.campaign.workers.flight_row import fly_one
from cosim.results.log.arrow import read_table, write_table
from cosim.results.log.digest import log_digest
from cosim.results.report.page import figure_json
from cosim.simulation.build import build
from cosim.spec.scenario import Range, Scenario

SIX = [
    {"key": DELAY, "range": [0, 20]},
    {"key": MASS, "range": [0.7, 1.3], "relative": "factor"},
    {"key": WIND, "normal": {"mean": 0.0, "sd": 3.0}},
    {"key": GAIN, "range": [0.5, 2.0], "scale": "log"},
    {"key": TURBULENCE, "range": [0, 6]},
    {"key": NOISE, "values": [True, False]},
]


# ---- shares


def test_wilsons_interval_is_scipys() -> None:
    hits, of = np.array([[k, n] for n in (1, 9, 400) for k in range(0, n + 1, max(1, n // 9))]).T
    ends = np.transpose(wilson(hits, of))
    theirs = [stats.binomtest(int(k), int(n)).proportion_ci(0.95, "wilson") for k, n in zip(hits, of, strict=True)]
    np.testing.assert_allclose(ends, theirs, atol=1e-12)


def test_the_exact_interval_leaves_a_fortieth_on_either_side() -> None:
    """Clopper and Pearson's ends are where the binomial's tails come to 0.025; without a success the lower one is 0."""
    low, high = proportion(7, 50).exact
    assert sum(comb(50, k) * low**k * (1.0 - low) ** (50 - k) for k in range(7, 51)) == pytest.approx(0.025, rel=1e-9)
    assert sum(comb(50, k) * high**k * (1.0 - high) ** (50 - k) for k in range(8)) == pytest.approx(0.025, rel=1e-9)
    assert proportion(0, 100).exact == (0.0, pytest.approx(1.0 - 0.025**0.01, rel=1e-9))
    nothing = proportion(0, 0)
    assert (nothing.value, nothing.wilson, nothing.exact) == (None, (0.0, 1.0), (0.0, 1.0))


# ---- pairs


def test_pairs_are_counted_by_who_succeeds() -> None:
    first, second = np.array([[1, 1, 0, 0, 1], [1, 0, 1, 0, 0]], dtype=bool)
    assert count_pairs(first, second) == Pairs(both=1, first=2, second=1, neither=1)
    assert count_pairs(first, second).difference == -0.2
    assert count_pairs(first[:0], second[:0]).difference is None


def test_mcnemars_test_is_a_toss_of_coins() -> None:
    """Of 8 draws that only one survives, one to seven: 2 (1 + 8) / 2^8."""
    assert mcnemar(Pairs(1, 7, 1, 12)) == pytest.approx(2 * (1 + 8) / 2**8, rel=1e-12)
    assert mcnemar(Pairs(100, 0, 6, 3)) == pytest.approx(2 / 2**6, rel=1e-12)
    assert mcnemar(Pairs(5, 0, 0, 5)) == 1.0


def test_newcombes_interval_of_a_published_table() -> None:
    """Airway hyper-responsiveness before and after transplantation, 1, 1, 7 and 12 children: -0.507 to -0.026.

    Fagerland, Lydersen and Laake, Statistics in Medicine 33 (2014) 2850-2875; three digits are printed.
    """
    assert newcombe(Pairs(both=1, first=7, second=1, neither=12)) == pytest.approx((-0.507, -0.026), abs=5e-4)
    assert newcombe(Pairs(0, 0, 0, 0)) is None


def test_newcombes_interval_holds_what_it_says() -> None:
    """Over all tables of 40 draws, weighted by how likely each is: 95 % and a little more or less, as published."""
    both, first, second = 0.55, 0.08, 0.22
    covered = total = 0.0
    for a, b, c in product(range(41), range(20), range(27)):
        d = 40 - a - b - c
        if d < 0:
            continue
        ways = comb(40, a) * comb(40 - a, b) * comb(40 - a - b, c)
        weight = ways * both**a * first**b * second**c * (1.0 - both - first - second) ** d
        if weight < 1e-7:
            continue  # 28,000 of them come to less than 0.003
        low, high = newcombe(Pairs(a, b, c, d)) or (0.0, 0.0)
        total += weight
        covered += weight * (low <= second - first <= high)
    assert total > 0.99
    assert 0.94 < covered / total < 0.98


def test_holms_correction_is_as_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.9]) == [1.0, 1.0]
    assert holm([]) == []


def test_the_median_difference_lies_between_order_statistics() -> None:
    """Of ten values the second and the ninth hold 97.9 %, the third and the eighth only 89 %."""
    found = median_difference(np.arange(10.0) ** 2)
    assert found is not None
    assert (found.median, found.interval) == (20.5, (1.0, 64.0))
    few = median_difference(np.arange(5.0))
    assert few is not None
    assert few.interval is None  # even the ends hold only 1 - 2 / 2^5 = 94 %
    assert median_difference(np.empty(0)) is None
    assert median_difference(np.zeros(9)) == (9, 0.0, (0.0, 0.0), 1.0)


# ---- what drives it


def ishigami(x: np.ndarray) -> np.ndarray:
    """sin x1 + 7 sin^2 x2 + 0.1 x3^4 sin x1; the fourth does nothing."""
    return np.asarray(np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0]))


# V1 = (1 + b pi^4 / 5)^2 / 2, V2 = a^2 / 8, V13 = 8 b^2 pi^8 / 225 (T. Ishigami and T. Homma, 1990)
V = np.array([0.5 * (1.0 + 0.1 * pi**4 / 5.0) ** 2, 49.0 / 8.0, 0.0, 0.0])
INDICES = V / (V.sum() + 8.0 * 0.01 * pi**8 / 225.0)


def in_classes(count: int) -> np.ndarray:
    """The indices that are left of these in so many classes of equal width: a mean over a width w of sin(n x) keeps
    sin(n w / 2) / (n w / 2) of it.
    """
    width = 2.0 * pi / count
    kept = np.array([np.sinc(width / 2.0 / pi), np.sinc(width / pi), 1.0, 1.0])
    return np.asarray(INDICES * kept**2)


def cube(points: np.ndarray) -> np.ndarray:
    return np.asarray(2.0 * pi * (points - 0.5))


def test_first_order_indices_of_ishigamis_function() -> None:
    """Within three deviations of what the classes keep, which is all but 1.3 % of the fastest term."""
    x = cube(qmc.LatinHypercube(4, rng=np.random.default_rng(3)).random(4096))
    result = ishigami(x)
    kept = in_classes(max_classes(4096))
    np.testing.assert_allclose(kept, INDICES, rtol=0.014)
    for side, index in zip(x.T, kept, strict=True):
        found, deviation = first_order(assign_classes(side, max_classes(4096)), result)
        assert abs(found - index) < 3.0 * deviation
        assert deviation < 0.015


def test_the_index_of_steps_is_exact() -> None:
    """A result that is the class's mean and nothing else has an index of 1; (n - 1) / (n - k) corrects any other."""
    numbered = np.repeat(np.arange(4), 25)
    assert first_order(numbered, 1.0 * numbered**2)[0] == 1.0
    result = numbered + np.tile([-1.0, 1.0, -1.0, 1.0, 0.0], 20)
    assert first_order(numbered, result)[0] == pytest.approx(1.0 - 0.8 / (1.25 + 0.8) * 99 / 96, rel=1e-12)


def test_the_interval_of_an_index_holds_what_it_says() -> None:
    """In 200 studies of 500 draws; 95 % +- three deviations of a share of 200, 4.6 %, and no less than 1 for no effect."""
    chance = np.random.default_rng(11)
    held = np.zeros(4)
    kept = in_classes(max_classes(500))
    for _ in range(200):
        x = cube(chance.random((500, 4)))
        result = ishigami(x)
        for key in range(4):
            found, deviation = first_order(assign_classes(x[:, key], max_classes(500)), result)
            held[key] += max(0.0, found - Z * deviation) <= kept[key] <= found + Z * deviation
    assert np.all(held / 200 > 0.95 - 0.046)


def test_a_key_that_does_nothing_is_below_the_floor_in_nineteen_of_twenty() -> None:
    """The floor is of the largest of all keys: of 100 studies about 5 have any key above it, hardly ever 13 or more."""
    chance = np.random.default_rng(2)
    above = 0
    for _ in range(100):
        keys = [assign_classes(chance.random(120), 10) for _ in range(3)] + [chance.integers(0, 2, 120)]
        result = (chance.random(120) < 0.1).astype(float)
        above += max(first_order(key, result)[0] for key in keys) > noise_floor(keys, result)
    assert 0 < above < 13


def test_keys_are_ranked_by_effects_of_any_shape() -> None:
    """The second key of Ishigami's function acts most although its rank correlation is 0; the others do not pass."""
    x = cube(np.random.default_rng(4).random((2000, 4)))
    found = rank_effects({f"x{key + 1}": x[:, key] for key in range(4)}, [], ishigami(x))
    assert found is not None
    assert [effect.key for effect in found.effects if effect.real] == ["x2", "x1"]
    second = found.effects[0]
    assert second.rank_interval is not None
    assert second.rank_interval[0] < 0.0 < second.rank_interval[1]
    assert found.explained == pytest.approx(INDICES[:2].sum(), abs=0.05)  # two deviations of 0.015 each, and classes


def test_choices_are_ranked_without_an_order() -> None:
    chance = np.random.default_rng(6)
    choice = chance.integers(0, 3, 600).astype(float)
    success = (chance.random(600) < np.array([0.2, 0.9, 0.2])[choice.astype(int)]).astype(float)
    found = rank_effects({"engine": choice, "mass": chance.random(600)}, ["engine"], success)
    assert found is not None
    assert [(effect.key, effect.real) for effect in found.effects] == [("engine", True), ("mass", False)]
    assert found.effects[0].rank is None
    assert found.effects[0].partial is None


def test_nothing_is_ranked_where_there_is_nothing_to_rank() -> None:
    assert rank_effects({"a": np.arange(100.0)}, [], np.ones(100)) is None
    assert rank_effects({"a": np.arange(29.0)}, [], np.arange(29.0)) is None
    assert rank_effects({}, [], np.arange(100.0)) is None
    constant = rank_effects({"a": np.zeros(100)}, [], np.arange(100.0))
    assert constant is not None
    assert (constant.effects[0].real, constant.effects[0].rank, constant.effects[0].partial) == (False, 0.0, 0.0)


def test_rank_correlations_are_scipys_and_hold_what_is_correlated() -> None:
    """A key that acts only through another has a rank correlation and no partial one."""
    chance = np.random.default_rng(8)
    cause = chance.normal(size=4000)
    shadow = cause + chance.normal(size=4000)
    result = np.exp(cause + 0.3 * chance.normal(size=4000))
    (rank, partial), (other, held) = rank_correlations([cause, shadow], result)
    assert rank == pytest.approx(stats.spearmanr(cause, result).statistic, abs=1e-12)
    assert other == pytest.approx(stats.spearmanr(shadow, result).statistic, abs=1e-12)
    assert other > 0.6
    assert abs(held) < 4.0 / sqrt(4000)  # four deviations of a correlation that is not there
    assert partial > 0.9
    # by the formula for three variables
    between = stats.spearmanr(cause, shadow).statistic
    expected = (rank - other * between) / sqrt((1.0 - other**2) * (1.0 - between**2))
    assert partial == pytest.approx(expected, abs=1e-9)


def test_the_interval_of_a_rank_correlation() -> None:
    """Of none, tanh(+-z / sqrt(n - 3)); of 1, itself."""
    assert rank_interval(0.0, 103) == pytest.approx((-np.tanh(Z / 10.0), np.tanh(Z / 10.0)))
    assert rank_interval(1.0, 103) == (1.0, 1.0)


def test_two_keys_that_act_only_together_explain_it_together() -> None:
    """A chequerboard: no key alone explains any of it, both together all."""
    x = np.random.default_rng(9).random((4000, 2))
    result = ((x[:, 0] > 0.5) ^ (x[:, 1] > 0.5)).astype(float)
    assert abs(first_order(assign_classes(x[:, 0], 20), result)[0]) < 0.02
    assert joint(x[:, 0], x[:, 1], result) > 0.8  # the classes do not end at the middle


def test_medians_of_groups_are_numpys() -> None:
    chance = np.random.default_rng(1)
    numbered = np.concatenate([np.arange(9), chance.integers(0, 9, 200)])
    values = chance.normal(size=209)
    expected = [np.median(values[numbered == each]) for each in range(9)]
    np.testing.assert_array_equal(group_medians(numbered, values), expected)


# ---- a campaign's rows


def test_a_flight_that_did_not_complete_has_no_metric(tmp_path: Path) -> None:
    def outcome(flight: Flight, chance: np.random.Generator) -> dict[str, Any]:
        lost = {"outcome": "crashed", "duration_s": 2.0} if flight.number % 4 == 0 else {}
        return {"roll.rmse_rad": 100.0 if lost else 0.01 * (1 + flight.number % 3)} | lost

    made = campaign(tmp_path, study(runs=50, success={}), outcome)
    flown = read_flight_table(made)
    assert np.isnan(flown.values["roll.rmse_rad"][::4]).all()
    summary = campaign_summary(made)
    assert summary["controllers"]["baseline"]["outcomes"]["crashed"] == 25
    for name, there in (("baseline", 25), ("smith", 50)):
        spread = summary["controllers"][name]["metrics"]["roll.rmse_rad"]
        assert (spread["flights"], spread["without"], spread["of"]) == (there, 0, 50)
    assert spread["p95"] <= 0.03
    titles, rows = spread_table(summary)
    assert titles == ["median", "", "baseline", "smith"]
    (rmse,) = [row for row in rows if row[:2] == ["roll RMSE", "deg"]]
    assert rmse[2].endswith(" (25 of 50)")
    assert float(rmse[3]) == pytest.approx(np.degrees(spread["median"]), rel=5e-3)
    assert "25 of 50" in write_campaign_report(made).read_text()
    # of 50 baseline flights 25 are lost: the curve ends at 50 %
    curve = distribution(flown, metric("roll.rmse_rad"))["data"][0]
    assert curve["y"][-1] == 50.0
    assert max(curve["x"]) == pytest.approx(np.degrees(0.03), rel=1e-3)  # four digits on the page


def test_a_flight_beyond_its_own_limits_is_missed_and_says_by_which(tmp_path: Path) -> None:
    def outcome(flight: Flight, chance: np.random.Generator) -> dict[str, Any]:
        away = flight.number % 5 == 0
        return {"beyond": "position.drift_m speed.max_m_s" if away else "", "success": not away}

    flown = read_flight_table(campaign(tmp_path, study(runs=50, success={}), outcome))
    assert np.count_nonzero(flown.kind == KINDS.index("missed")) == 20
    beyond = "beyond the flight's own limit"
    said = f"drift from the start {beyond} and largest ground speed {beyond}"
    assert count_reasons(flown, flown.rows_of(0), {}) == {said: 10}


def test_a_row_of_a_flight_beyond_its_limits_is_no_success() -> None:
    vary = [{"key": WIND, "range": [14.9, 15.0]}]
    away = study(scenario="hover", runs=1, controllers=["smith"], success={}, vary=vary)
    row = fly_one(away, flights(away)[0])
    assert (row["outcome"], row["success"]) == ("completed", False)
    assert row["beyond"] == "position.drift_m speed.max_m_s"
    assert row["position.drift_m"] > 100.0  # type: ignore[operator]


def test_a_campaign_from_before_there_were_limits_is_read(tmp_path: Path) -> None:
    made = campaign(tmp_path, study(runs=10, success={}))
    old = {name: values for name, values in made.columns.items() if not name.startswith(("beyond", "position"))}
    flown = read_flight_table(Campaign(made.folder, made.study, old, made.of))
    assert flown.beyond == [[] for _ in flown.reason]
    table = tmp_path / "part.parquet"
    write_table(table, {"flight": [1, 2]})
    assert read_table(table, ("flight", "beyond"), lacking=True) == {"flight": [1, 2], "beyond": [None, None]}
    with pytest.raises(InputError, match="beyond"):
        read_table(table, ("beyond",))


def test_the_summary_counts_every_flight(tmp_path: Path) -> None:
    made = campaign(tmp_path, study(runs=200))
    summary = json.loads(json.dumps(campaign_summary(made), allow_nan=False))
    hits = {}
    for name in ("baseline", "smith"):
        mine = np.array(made.columns["controller"]) == name
        hits[name] = int(np.sum(np.array(made.columns["success"])[mine]))
        found = summary["controllers"][name]
        assert found["flights"] == sum(found["outcomes"].values()) == int(np.sum(mine)) == 200
        assert (found["success"], found["outcomes"]["success"]) == (hits[name] / 200, hits[name])
        assert found["wilson_95"] == pytest.approx(proportion(hits[name], 200).wilson)
    (compared,) = summary["comparisons"]
    assert compared["draws"] == 200
    assert compared["both"] + compared["only_first"] == hits["baseline"]
    assert compared["both"] + compared["only_second"] == hits["smith"]
    alone = compared["only_first"] + compared["only_second"]
    assert compared["mcnemar_p"] == pytest.approx(stats.binomtest(compared["only_first"], alone).pvalue)
    first = summary["drives_success"]["baseline"]["keys"][0]
    assert (first["key"], first["above_noise"], summary["finished"]) == (DELAY, True, True)
    assert any(line.startswith("  baseline: ") and DELAY not in line for line in success_lines(summary))
    assert any("smith against baseline: +" in line for line in comparison_lines(summary))


def test_a_terminal_has_each_against_the_first_and_one_controller_with_its_spread(tmp_path: Path) -> None:
    five = ["baseline", "smith", "state", "filtered-smith", "state-disturbance"]
    lines = list(comparison_lines(campaign_summary(campaign(tmp_path / "five", study(runs=40, controllers=five)))))
    assert sum(" against baseline: " in line for line in lines) == 4
    said = "  6 more pairs are in the report; each p is corrected for all 10"
    assert [line for line in lines if "more pairs" in line] == [said]
    summary = campaign_summary(campaign(tmp_path / "one", study(runs=40, controllers=["smith"])))
    titles, rows = spread_table(summary)
    assert titles == ["metric", "", "median", "5 %", "95 %"]
    assert all(float(row[3]) <= float(row[2].split()[0]) <= float(row[4]) for row in rows)


def test_only_draws_that_both_have_flown_are_compared(tmp_path: Path) -> None:
    flown = read_flight_table(campaign(tmp_path, study(runs=40), finished=61))  # the last draw with one controller only
    (compared,) = compare_controllers(flown)
    assert compared.pairs.draws == 30


def test_metrics_are_compared_draw_by_draw(tmp_path: Path) -> None:
    """A predictor that takes 0.01 rad off, whatever the draw, differs by just that from row to row."""

    def outcome(flight: Flight, chance: np.random.Generator) -> dict[str, Any]:
        base = 0.05 + 0.01 * float(flight.values[DELAY])
        return {"roll.rmse_rad": base - 0.01 * (flight.controller == "smith")}

    (compared,) = compare_controllers(read_flight_table(campaign(tmp_path, study(runs=30, success={}), outcome)))
    found = compared.metrics["roll.rmse_rad"]
    assert found is not None
    assert (found.median, *(found.interval or ())) == pytest.approx((-0.01, -0.01, -0.01))
    assert found.draws == compared.completed == 30


def test_of_a_grid_nothing_is_called_a_probability(tmp_path: Path) -> None:
    vary = [{"key": DELAY, "range": [0, 20], "levels": 6}, {"key": MASS, "values": [4.0, 5.0, 6.0]}]
    made = campaign(tmp_path, study(design="grid", runs=None, vary=vary))
    summary = campaign_summary(made)
    assert summary["share_is"] == "share of the grid"
    assert summary["controllers"]["baseline"]["wilson_95"] is summary["comparisons"][0]["mcnemar_p"] is None
    write_campaign_report(made)
    text = plain_text(tmp_path)
    assert [word in text for word in ("not probabilities", "Wilson", "McNemar")] == [True, False, False]


@pytest.mark.parametrize(
    ("reason", "stripped"),
    [
        ("leaned past 60 deg at 3.212 s (roll -61.2 deg)", "leaned past … deg at … s"),
        ("engine 3 (edf.fmu): thrust is not finite at step 812", "engine …: thrust is not finite at step …"),
        ("", "no reason given"),
    ],
)
def test_reasons_are_told_without_their_numbers(reason: str, stripped: str) -> None:
    assert strip_numbers(reason) == stripped


def test_reasons_that_differ_in_numbers_are_one(tmp_path: Path) -> None:
    flown = read_flight_table(made := campaign(tmp_path, study(runs=100)))
    counted = count_reasons(flown, flown.rows_of(0), made.study.success)
    assert counted.total() == int(np.sum(flown.rows_of(0) & ~flown.success))
    assert {"leaned past … deg at … s", "roll overshoot above 60 %"} <= set(counted)


def test_names_are_short_and_tell_keys_apart() -> None:
    paths = ["vehicle.control.rate.roll.p", "vehicle.control.rate.pitch.p", "environment.wind_ned_m_s.1", "substeps"]
    assert short_names(paths) == ["roll.p", "pitch.p", "environment.wind_ned_m_s.1", "substeps"]
    alike = ["a.control.roll.p", "b.control.roll.p"]
    assert short_names(alike) == alike


def test_what_success_is_in_words() -> None:
    flies = "flies to its end within its limits"
    assert describe_criterion({}) == f"{flies}; nothing else is checked"
    limits = {"roll.rmse_rad": Range(max=pi / 180.0), "altitude.max_abs_error_m": Range(min=0.1, max=2.0)}
    assert (
        describe_criterion(limits) == f"{flies}, with roll RMSE at most 1 deg and altitude largest error 0.1 m to 2 m"
    )


# ---- figures and the map


def test_plotly_accepts_every_figure(tmp_path: Path) -> None:
    figures = make_page(campaign(tmp_path, study(runs=120, vary=SIX))).figures
    names = set(figures) - {"map-tables"}
    assert {"outcomes", "probability", "ranking-success", "key-0", "key-5", "metric-0"} <= names
    for name in names:
        plotly.graph_objects.Figure(figures[name])  # raises ValueError for a key or a value outside Plotly's schema
        plotly.graph_objects.Figure(json.loads(figure_json(figures[name])))


def test_the_map_counts_every_flight_once(tmp_path: Path) -> None:
    """Cells of two keys against a count by hand; those of too few flights have no metric."""
    flown = read_flight_table(campaign(tmp_path, study(runs=400, vary=SIX)))
    tables = map_tables(flown, range(6), (0, 1), "success")
    assert tables["pair"] == [0, 1]
    assert len(tables["cells"]) == 15
    for controller in range(2):
        for cells in tables["cells"].values():
            assert sum(cells[controller]["n"]) == 400
            assert sum(cells[controller]["k"]) == int(np.sum(flown.success & flown.rows_of(controller)))
    across, up = (np.array(tables["keys"][key]["edges"]) for key in (0, 1))
    cells = tables["cells"]["0,1"][1]
    x, y = (flown.keys[key].numbers for key in (0, 1))
    for row, column in product(range(up.size - 1), range(across.size - 1)):
        inside = (
            flown.rows_of(1) & (x >= across[column]) & (x < across[column + 1]) & (y >= up[row]) & (y <= up[row + 1])
        )
        place = row * (across.size - 1) + column
        # the edges on the page have six digits: a value may lie beyond one by as much
        assert abs(cells["n"][place] - int(np.sum(inside))) <= 1
        values = flown.values["roll.overshoot_percent"][inside]
        known = values[np.isfinite(values)]
        if cells["n"][place] == np.sum(inside):
            expected = pytest.approx(np.median(known), rel=1e-3) if known.size >= MIN_PER_CELL else None
            assert cells["m"][0][place] == expected


def test_the_cells_of_whole_numbers_hold_as_many_of_them(tmp_path: Path) -> None:
    flown = read_flight_table(campaign(tmp_path, study(runs=200)))
    edges = map_tables(flown, [0, 1], (0, 1), "success")["keys"][0]["edges"]
    width = round(edges[1] - edges[0])
    assert edges == [-0.5 + width * k for k in range(len(edges))]


def test_single_flights_are_a_sample_where_there_are_many(tmp_path: Path) -> None:
    flown = read_flight_table(campaign(tmp_path, study(runs=3000, controllers=["baseline"])))
    points = map_tables(flown, [0, 1], (0, 1), "success")["points"][0]
    assert points["shown"] == [MAX_POINTS, MAX_POINTS]
    assert (sum(points["of"]), points["kind"].count("success")) == (3000, MAX_POINTS)
    assert points == map_tables(flown, [0, 1], (0, 1), "success")["points"][0]


# ---- the worst


def test_the_worst_are_named(tmp_path: Path) -> None:
    made = campaign(tmp_path, study(runs=150, controllers=["baseline"]))
    flown = read_flight_table(made)
    cases = worst_flights(made.study, flown, 0)
    assert len({case.row for case in cases}) == len(cases)
    by_why = {case.why: case.row for case in reversed(cases)}  # the first of each
    lost = flown.kind >= KINDS.index("crashed")
    assert flown.duration[by_why["failed first"]] == flown.duration[lost].min()
    overshoot = flown.values["roll.overshoot_percent"]
    assert overshoot[by_why["success with the largest roll overshoot"]] == overshoot[flown.success].max()
    mild = by_why["fails nearest to the middle of the draws"]
    others = [case.row for case in cases if case.why == "failed first"]
    fails = np.setdiff1d(np.flatnonzero(~flown.success), others)
    assert eccentricity(flown)[mild] == eccentricity(flown)[fails].min()


def test_the_middle_of_the_draws(tmp_path: Path) -> None:
    """0 where every number is the median, nearly 1 where every one is extreme; choices have no middle."""
    vary = [{"key": MASS, "range": [4.0, 6.0], "levels": 101}, {"key": NOISE, "values": [True, False]}]
    of = study(design="grid", runs=None, controllers=["baseline"], vary=vary)
    flown = read_flight_table(campaign(tmp_path, of))
    far = eccentricity(flown)
    assert far[np.argmin(np.abs(flown.keys[0].numbers - 5.0))] == pytest.approx(0.0, abs=1e-12)
    assert far.max() == pytest.approx(1.0 - 1.0 / 101)  # the last of 101 levels, seen at the middle of its own share


def test_a_case_is_a_scenario_with_every_number_of_its_flight(tmp_path: Path) -> None:
    made = campaign(tmp_path, study(runs=60))
    assert write_case(made, 17) == ("cases/flight-000017.toml", "")
    flown, row = Scenario.load(tmp_path / "cases/flight-000017.toml"), made.row(17)
    stated = (flown.controller, flown.seed, flown.vehicle["mass_kg"], flown.environment.wind_ned_m_s[1], flown.expect)
    assert stated == (row["controller"], row["seed"], row[MASS], row[WIND], [])


def test_a_case_has_what_it_reads_beside_it(tmp_path: Path) -> None:
    made = campaign(tmp_path, study(scenario="manual", runs=2, vary=SIX[1:2], success={}), wins)
    link, refused = write_case(made, 1)
    assert (link, refused) == ("cases/flight-000001/scenario.toml", "")
    with build(Scenario.load(tmp_path / link)) as simulation:  # raises InputError for a recording that is not there
        assert simulation.vehicle.mass_kg == made.row(1)[MASS]
    assert len(list((tmp_path / link).parent.glob("*.csv"))) == 1


def test_a_case_flies_as_its_row_says(tmp_path: Path) -> None:
    """Bit for bit: the scenario file of a flight is that flight."""
    of = study(runs=2, settings={"duration_s": 0.8}, success={})
    flight = flights(of)[3]
    row = fly_one(of, flight)
    made = campaign(tmp_path, of, lambda flight, chance: row if flight.number == 3 else {})
    link, _ = write_case(made, 3)
    run = fly(Scenario.load(tmp_path / link))
    assert row["outcome"] == "completed"
    assert log_digest(run.log) == row["log_sha256"]


def test_a_draw_that_makes_no_scenario_is_named_and_has_no_file(tmp_path: Path) -> None:
    made = campaign(tmp_path, study(runs=40))
    made.columns[MASS][3] = -1.0
    link, refused = write_case(made, 3)
    assert link == ""
    assert "mass_kg" in refused
    assert not (tmp_path / "cases").exists()


# ---- pages


def plain_text(folder: Path) -> str:
    """What stands on a page, without scripts, figures and marks."""
    text = (folder / "report.html").read_text(encoding="utf-8")
    text = re.sub(r"<(script|style)\b.*?</\1>", " ", text, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", text)).split())


def crashed(flight: Flight, chance: np.random.Generator) -> dict[str, Any]:
    return {"outcome": "crashed", "reason": "the hull touched the ground at 3.2 s (upright)", "duration_s": 3.2}


def failed(flight: Flight, chance: np.random.Generator) -> dict[str, Any]:
    nothing = {"outcome": "failed", "reason": "the worker was lost 3 times", "duration_s": None, "inputs": None}
    return nothing if flight.number % 10 == 0 else loop(flight, chance)


def wins(flight: Flight, chance: np.random.Generator) -> dict[str, Any]:
    return {"roll.overshoot_percent": 10.0 + chance.random(), "roll.settling_time_s": None}


STATES: dict[str, tuple[dict[str, Any], dict[str, Any], list[str]]] = {
    "usual": ({"runs": 200, "vary": SIX}, {}, ["McNemar", "Wilson", "Latin hypercube", "First-order index"]),
    "grid": (
        {"design": "grid", "runs": None,
         "vary": [{"key": GAIN, "range": [0.5, 2.0], "levels": 5, "scale": "log"}, SIX[5], {"key": MASS, "values": [4.0, 5.0]}]},
        {}, ["Success over the grid", "5 levels, 0.5 to 2, evenly in the logarithm"],
    ),
    "no-success": ({"runs": 40}, {"outcome": crashed}, ["0.0 % succeed, 0 of 40", "the hull touched the ground at … s"]),
    "no-failure": ({"runs": 40, "success": {}}, {"outcome": wins}, ["100.0 % succeed", "Every flight was one."]),
    "failed": ({"runs": 50}, {"outcome": failed}, ["10 flights could not be flown to a verdict", "the worker was lost … times"]),
    "one-flight": ({"runs": 1, "controllers": ["smith"]}, {}, ["1 flights", "Too few flights"]),
    "one-key": ({"runs": 60, "vary": SIX[:1]}, {}, ["What drives it"]),
    "choice": ({"runs": 60, "vary": [SIX[5], {"key": "engine", "values": ["edf", "edf-as-flown"]}]}, {}, ["edf-as-flown"]),
    "unfinished": ({"runs": 100}, {"finished": 77}, ["77 of 200 flights", "not finished: 77 of 200 flights (38.5%)"]),
    "empty": ({"runs": 100}, {"finished": 0}, ["0 of 200 flights", "No flight is finished yet"]),
    "own-controller": ({"runs": 30, "controllers": None, "title": "<b>&"}, {}, ["<b>& "]),
    "correlated": (
        {"runs": 60, "design": "random", "correlate": [{"keys": [DELAY, MASS], "rank": 0.5}]},
        {}, ["mismatch.delay_samples with vehicle.mass_kg: 0.5", "Correlated keys share what they explain"],
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A page of every kind of campaign."""
    folder = tmp_path_factory.mktemp("campaigns")
    for name, (changes, how, _) in STATES.items():
        (folder / name).mkdir()
        write_campaign_report(campaign(folder / name, study(**changes), **how))
    return {name: folder / name for name in STATES}


@pytest.mark.parametrize("state", STATES)
def test_every_campaign_gets_a_page(state: str, pages: dict[str, Path]) -> None:
    text = (pages[state] / "report.html").read_text(encoding="utf-8")
    shown = plain_text(pages[state])
    assert [words for words in STATES[state][2] if words not in shown] == []
    assert not re.search(r"\b(nan|None|inf|NaN)\b", shown)
    assert set(re.findall(r'data-figure="([^"]+)"', text)) <= set(re.findall(r'id="figure-([^"]+)"', text))
    outside = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r'(src|href)="(https?:)?//', outside)
    assert all((pages[state] / link).is_file() for link in re.findall(r'href="(cases/[^"]+)"', text))


@pytest.mark.long
def test_a_large_campaign_makes_a_page_that_opens(tmp_path: Path) -> None:
    """20,000 flights of six keys: all of it stays below 1 MB."""
    made = campaign(tmp_path, study(runs=10_000, vary=SIX))
    write_campaign_report(made)
    assert (tmp_path / "report.html").stat().st_size < 1_000_000


# ---- in a browser


@pytest.mark.parametrize("state", ["grid", "no-success", "one-flight", "empty"])
def test_no_page_has_a_script_error(state: str, pages: dict[str, Path], browser: Any) -> None:
    with opened(browser, (pages[state] / "report.html").as_uri(), 400) as tab:
        tab.evaluate("document.querySelectorAll('details').forEach((each) => each.open = true)")
        assert tab.evaluate("document.documentElement.scrollWidth") <= 400  # nothing sticks out of a narrow window
        plots = tab.locator(".plot")
        for n in range(plots.count()):  # each is drawn when it comes into view
            plots.nth(n).scroll_into_view_if_needed()
            tab.wait_for_function("(n) => document.querySelectorAll('.plot')[n].data", arg=n, timeout=1e3 * PATIENCE)


MAP = "JSON.parse(JSON.stringify((({ data, layout }) => ({ data, layout }))(document.getElementById('map'))))"


def test_a_page_shows_what_is_chosen(pages: dict[str, Path], browser: Any) -> None:
    """Any two keys on the map, coloured by any metric; any result in the ranking; in a narrow window too."""
    with opened(browser, (pages["usual"] / "report.html").as_uri(), 1300) as tab:

        def choose(where: str, what: str) -> Any:
            tab.select_option(f"#map-{where}", label=what)
            figure = tab.evaluate(MAP)
            plotly.graph_objects.Figure(figure)  # raises ValueError for what Plotly does not know
            return figure

        begin = tab.evaluate(MAP)
        assert begin["layout"]["xaxis"]["title"]["text"] == "mismatch.delay_samples [samples]"
        assert begin["layout"]["yaxis"]["title"]["text"] == "vehicle.mass_kg [kg]"
        assert begin["layout"]["yaxis2"]["matches"] == "y"
        shares = np.array(begin["data"][2]["z"], dtype=float)
        tables = json.loads(tab.evaluate("document.getElementById('figure-map-tables').textContent"))
        pair = ",".join(map(str, sorted(tables["pair"])))
        counts = sorted(n for each in tables["cells"][pair] for n in each["n"] if n >= tables["least"])
        half = counts[(len(counts) - 1) // 2]
        low, high = (float(end[0]) for end in wilson(np.array([half / 2.0]), np.array([half])))
        told = f"{half} flights or fewer: with {half}, a share of 50 % has a 95 % interval from {100 * low:.0f} to "
        assert f"{told}{100 * high:.0f} %" in tab.inner_text("#map-note")

        choose("x", "environment.wind_ned_m_s.1")
        choose("y", "mismatch.delay_samples")
        turned = choose("x", "vehicle.mass_kg")
        assert turned["layout"]["yaxis"]["title"]["text"] == "mismatch.delay_samples [samples]"
        np.testing.assert_array_equal(np.array(turned["data"][2]["z"], dtype=float), shares.T)

        swapped = choose("x", "mismatch.delay_samples")  # taken by the other axis, which gives way
        assert swapped["layout"]["yaxis"]["title"]["text"] == "vehicle.mass_kg [kg]"
        logarithmic = choose("x", "mismatch.thrust_factor")
        assert logarithmic["layout"]["xaxis"]["type"] == "log"
        named = choose("y", "sensor_noise")
        assert named["layout"]["yaxis"]["ticktext"] == ["true", "false"]
        coloured = choose("colour", "roll overshoot")
        assert tab.inner_text("#map-legend").startswith("roll overshoot ")
        low, high = coloured["layout"]["coloraxis"]["cmin"], coloured["layout"]["coloraxis"]["cmax"]
        cells = [trace["z"] for trace in coloured["data"] if trace.get("coloraxis")]
        shown = [value for each in cells for row in each for value in row if value is not None]
        assert low < min(shown) < max(shown) < high  # medians of cells, within 96 % of the flights
        tab.set_checked("#map-points", not tab.is_checked("#map-points"))
        assert len(tab.evaluate(MAP)["data"]) != len(coloured["data"])

        folded = "document.querySelector('[data-figure=\"ranking-roll.rmse_rad\"]')"
        tab.locator("summary", has_text="What drives it: roll RMSE").click()
        tab.wait_for_function(f"{folded}.data", timeout=1e3 * PATIENCE)
        figure = json.loads(tab.evaluate("document.getElementById('figure-ranking-roll.rmse_rad').textContent"))
        assert tab.evaluate(f"{folded}.data.map((trace) => trace.x)") == [trace["x"] for trace in figure["data"]]

        tab.set_viewport_size({"width": 400, "height": 800})
        below = "document.getElementById('map').layout.yaxis2.domain[1] < document.getElementById('map').layout.yaxis.domain[0]"
        tab.wait_for_function(below)  # one controller above the other
        tab.wait_for_function("document.documentElement.scrollWidth <= 400")  # figures follow the window a little later
