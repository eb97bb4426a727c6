"""The worst case and the most likely failure by the machinery of campaigns, with margins that are known."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.errors import InputError
from cosim.campaign import open_campaign
from cosim.campaign.run import run_sampler
from cosim.campaign.study.plan import Flight, scenario_of
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import Row, failed_row
from hexjet_prove.search.probe import answer_all
from hexjet_prove.search.worst_case import WorstSearch, search_worst
from hexjet_prove.search.worst_folder import resolve_worst

GUST, WIND = "disturbance.0.velocity_ned_m_s.{}", "environment.wind_ned_m_s.{}"
KEYS = [*(GUST.format(axis) for axis in range(3)), *(WIND.format(axis) for axis in range(3))]
METRIC = "roll.max_abs_error_rad"
Values = Mapping[str, Any]


class Measured:
    """Workers that fly nothing: the metric is a function of the values and the seed, and may be 1 at most."""

    def __init__(self, metric: Callable[[Values, int], float], stop_after: int | None = None) -> None:
        self.metric = metric
        self.flown = 0
        self.left = stop_after

    def fly(self, study: Study, flights: Iterable[Flight]) -> Iterator[Row]:
        for flight in reversed(list(flights)):  # they may come in any order
            if self.left is not None and self.flown == self.left:
                raise KeyboardInterrupt
            self.flown += 1
            value = self.metric(flight.values, flight.seed)
            yield failed_row(study, flight, "flown to its end") | {
                "outcome": "completed", METRIC: value, "success": value <= 1.0
            }  # fmt: skip

    def close(self) -> None:
        pass


def searched(
    metric: Callable[[Values, int], float], vary: list[str], out: Path | None = None, stop_after: int | None = None,
    **options: Any,
) -> WorstSearch:  # fmt: skip
    study, plan = resolve_worst("gust", vary=vary, success=[f"{METRIC}<=1"], **options)
    workers: Any = Measured(metric, stop_after)
    if out is None:
        return answer_all(search_worst(plan, study), partial(workers.fly, study))
    return run_sampler(study, out, partial(search_worst, plan), workers, True, None, plan.table())[1]


def corner(values: Values, seed: int = 0) -> float:
    """Above 1 in one corner of six keys between 0 and 1 alone, where all are large: 1.25 times a product of all."""
    return 1.25 * float(np.prod([0.5 + 0.5 * values[key] for key in KEYS]))


def hidden(values: Values, seed: int = 0) -> float:
    """The same, but each key alone, from the middle, seems to be better the nearer it comes to that corner."""
    place = np.array([values[key] for key in KEYS])
    return 0.8 - 0.2 * float(np.mean(place)) + 1.6 * float(np.prod(place)) ** 1.5


@pytest.mark.parametrize("planted", [corner, hidden])
@pytest.mark.parametrize("asked", [{"within": "5"}, {"within": "ranges"}, {"likely": True}])
def test_a_search_finds_the_planted_failure_in_2000_flights(
    planted: Callable[[Values, int], float], asked: dict[str, Any]
) -> None:
    """It lies beyond 3 standard deviations, where as little is left as the counted draws say."""
    (case,) = searched(planted, [f"{key}=0:1" for key in KEYS], budget=2000, **asked).cases
    assert case.fails
    assert case.flights <= 2000
    assert planted(case.values, 0) > 1.0
    assert all(effect.alone > 0.0 for effect in case.effects)  # each key alone keeps
    shares = [effect.share for effect in case.effects]
    assert sum(shares) == pytest.approx(1.0)


def test_the_most_likely_failure_its_distance_and_the_keys_that_matter() -> None:
    """x / 2 + y >= 3 in standard deviations: 3 / sqrt(1.25) away, a fifth of the square by x, nothing by z."""
    vary = [f"{KEYS[0]}=normal(1,2,-20,20)", f"{KEYS[1]}=normal(0,0.5,-5,5)", f"{KEYS[2]}=normal(0,1,-9,9)"]
    result = searched(
        lambda values, seed: 1.0 + 0.1 * ((values[KEYS[0]] - 1.0) / 4.0 + values[KEYS[1]] / 0.5 - 3.0),
        vary, likely=True, budget=600,
    )  # fmt: skip
    (case,) = result.cases
    assert case.fails
    assert 3.0 / 1.25**0.5 <= case.distance < 3.0 / 1.25**0.5 + 0.03  # type: ignore[operator]
    x, y, z = case.effects
    assert (x.share, y.share, z.share) == pytest.approx((0.2, 0.8, 0.0), abs=0.1)
    assert x.middle == pytest.approx(1.0)
    assert x.value == case.values[KEYS[0]]
    assert x.without == pytest.approx(0.1 * (3.0 - 2.0 / 1.25**0.5 * 1.2), abs=0.02)
    assert z.without == pytest.approx(case.margin, abs=1e-9)
    assert y.alone == pytest.approx(x.without)
    (line,) = result.lines()
    assert f"{case.distance:.2f} standard deviations from the middle" in line
    assert f"no nearer failure found in the {case.since} flights after it, of {case.flights} flights" in line
    assert "lower bound" not in line
    assert json.loads(json.dumps(result.to_json(), allow_nan=False))["found"][0]["fails"] is True


def test_nothing_found_is_said_to_show_nothing() -> None:
    (line,) = searched(lambda values, seed: 0.5, [f"{KEYS[0]}=0:1", f"{KEYS[1]}=0:1"], likely=True, budget=50).lines()
    assert "no failure found within 6 standard deviations" in line
    assert "does not show that there is no failure" in line


def test_a_middle_that_fails_is_said_so() -> None:
    (case,) = (result := searched(lambda values, seed: 2.0, [f"{KEYS[0]}=0:1"], likely=True, budget=50)).cases
    assert (case.distance, case.flights) == (0.0, 1)
    assert "fails in the middle of everything" in result.lines()[0]


def test_margins_that_show_no_way_are_said_so() -> None:
    flat = searched(lambda values, seed: 0.5, [f"{KEYS[0]}=0:1"], budget=60)
    assert any("100 % of the flights have the same margin" in note for note in flat.notes)
    steep = searched(lambda values, seed: values[KEYS[0]], [f"{KEYS[0]}=0:1"], budget=60)
    assert not any("the same margin" in note for note in steep.notes)


def test_the_smallest_margin_of_all_seeds_counts() -> None:
    result = searched(
        lambda values, seed: values[KEYS[0]] * (1.5 if seed == 4 else 0.5), [f"{KEYS[0]}=0:1"],
        seeds=3, seed=3, budget=300, within="ranges",
    )  # fmt: skip
    (case,) = result.cases
    assert (case.seed, case.fails) == (4, True)
    assert case.flights <= 300
    assert "noise and turbulence are of the seeds 3, 4, 5 in every flight" in result.notes[0]


class Possible(Measured):
    """The same, of flights that can be made alone."""

    def fly(self, study: Study, flights: Iterable[Flight]) -> Iterator[Row]:
        for flight in flights:
            try:
                scenario_of(study, flight).resolved_vehicle()
            except InputError as error:
                self.flown += 1
                yield failed_row(study, flight, str(error))
            else:
                yield from super().fly(study, [flight])


def test_a_vehicle_that_no_body_is_does_not_fail() -> None:
    """About z more than about x and y together: the search leaves it out, and says so."""
    inertia = "vehicle.inertia_kg_m2.2"
    study, plan = resolve_worst(
        "gust", vary=[f"{inertia}=0.05:0.2"], success=[f"{METRIC}<=1"], within="ranges", budget=80
    )
    workers = Possible(lambda values, seed: 5.0 * values[inertia])
    result = answer_all(search_worst(plan, study), partial(workers.fly, study))
    (case,) = result.cases
    most = sum(study.base().resolved_vehicle()[0].inertia_kg_m2[:2])
    assert case.values[inertia] == pytest.approx(most, abs=2e-3)
    assert case.values[inertia] <= most
    assert not case.fails
    assert case.impossible > 0
    assert any("no body has one moment above the sum of the others" in note for note in result.notes)


def test_a_search_that_is_stopped_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    vary = [f"{key}=normal(0,1,-9,9)" for key in KEYS]
    options: dict[str, Any] = {"likely": True, "budget": 400}

    def metric(values: Values, seed: int) -> float:
        return 1.0 + 0.1 * (sum(values[key] for key in KEYS) / 6**0.5 - 3.0)

    whole = searched(metric, vary, **options)
    for stop in (1, 100, 250):
        with pytest.raises(KeyboardInterrupt):
            searched(metric, vary, tmp_path / "out", stop, **options)
    assert searched(metric, vary, tmp_path / "out", **options).to_json() == whole.to_json()
    # nothing twice, and nothing that the whole one had not flown
    assert open_campaign(tmp_path / "out").columns["flight"] == list(range(whole.flights))


def test_another_seed_of_the_study_searches_another_way(tmp_path: Path) -> None:
    text = (
        f'name = "s"\nscenario = "gust"\ndesign = "random"\nruns = 10\nseed = {{}}\nuntil = "50%@90%"\n'
        f'vary = ["{KEYS[0]}=normal(0,1,-9,9)", "{KEYS[1]}=normal(0,1,-9,9)"]\n'
    )
    plans = []
    for seed in (1, 2):
        (tmp_path / "s.toml").write_text(text.format(seed))
        study, plan = resolve_worst(str(tmp_path / "s.toml"))
        assert study.until is None
        plans.append(plan)
    assert [plan.seed for plan in plans] == [1, 2]


@pytest.mark.parametrize(
    ("vary", "options", "words"),
    [
        (f"{KEYS[0]}=normal(0,1)", {"within": "ranges"}, "has no bounds; state them, or give standard deviations"),
        (f"{KEYS[0]}=0:1", {"within": "ranges", "likely": True}, "says nothing of what is likely"),
        (f"{KEYS[0]}=0:1", {"within": "9"}, "at most 8 standard deviations"),
    ],
)
def test_wrong_input_is_one_line(vary: str, options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as raised:
        resolve_worst("gust", vary=[vary], **options)
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


def test_ranges_of_correlated_keys_are_refused() -> None:
    with pytest.raises(InputError, match="correlated keys have no ranges of their own"):
        resolve_worst(
            "gust",
            vary=[f"{key}=0:1" for key in islice(KEYS, 2)],
            within="ranges",
            correlate=[f"{KEYS[0]},{KEYS[1]}=0.5"],
        )
