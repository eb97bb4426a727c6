"""Where a controller breaks: on boundaries that are known, against the linear theory of the roll channel, and in files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim import fly
from cosim.base.errors import InputError
from cosim.campaign import open_campaign, run_campaign
from cosim.campaign.analysis.page import write_campaign_report
from cosim.campaign.study.plan import Flight
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import Row, failed_row, fly_one
from cosim.campaign.workers.local import LocalWorkers
from cosim.cli.main import main
from cosim.engine import load_engine
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle
from hexjet_design.assessment import shipped_tuning
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import channels
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.dynamics import make_lag_dynamics
from hexjet_prove.search.folder import resolve_search, run_search
from hexjet_prove.search.line_search import scan_outward
from hexjet_prove.search.page import describe_resolution, together_lines
from hexjet_prove.search.probe import Point, Prober, answer_all
from hexjet_prove.search.search import Edge, SearchResult, search

Values = Mapping[str, Any]
X, Y, Z = "disturbance.0.velocity_ned_m_s.0", "disturbance.0.velocity_ned_m_s.2", "environment.wind_ned_m_s.2"
DELAY = "mismatch.delay_samples"


class Rule:
    """Workers that fly nothing: a flight breaks where ``breaks(values, controller, seed)`` says so."""

    def __init__(self, breaks: Callable[[Values, str, int], bool]) -> None:
        self.breaks = breaks
        self.flown: list[Flight] = []
        self.calls = 0

    def fly(self, study: Study, flights: Iterable[Flight]) -> Iterator[Row]:
        asked = list(flights)
        self.calls += bool(asked)
        for flight in reversed(asked):  # they may come in any order
            self.flown.append(flight)
            broken = self.breaks(flight.values, flight.controller, flight.seed)
            outcome = "diverged" if broken else "completed"
            yield failed_row(study, flight, "as the rule says") | {"outcome": outcome, "success": not broken}

    def close(self) -> None:
        pass

    def __enter__(self) -> Rule:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass


def found(rule: Rule, vary: list[str], **options: Any) -> SearchResult:
    """A search by rule; the gust's scenario has 8 m/s along y, and 0 along x and z."""
    study, plan = resolve_search("gust", vary=vary, **options)
    return answer_all(search(plan, study), partial(rule.fly, study))


def by_side(result: SearchResult) -> dict[str, Edge]:
    return {edge.side: edge for edge in result.edges}


@settings(max_examples=60, deadline=None)
@given(st.floats(0.01, 9.9), st.floats(1e-3, 1.0))
def test_the_edge_is_between_two_values_as_near_as_asked(edge: float, tolerance: float) -> None:
    rule = Rule(lambda values, controller, seed: values[X] >= edge)
    up = by_side(found(rule, [f"{X}=-10:10"], tolerance=[str(tolerance)]))["up"]
    assert up.holds is not None
    assert up.breaks is not None
    assert up.holds < edge <= up.breaks  # type: ignore[operator]
    assert float(up.breaks) - float(up.holds) <= tolerance * (1.0 + 1e-9)
    assert up.deviation == pytest.approx(float(up.breaks) / 10.0)


@pytest.mark.parametrize("edge", range(1, 61))
def test_whole_numbers_are_found_exactly(edge: int) -> None:
    rule = Rule(lambda values, controller, seed: values[DELAY] >= edge)
    (up,) = found(rule, [f"{DELAY}=0:60:7"]).edges
    assert (up.holds, up.breaks, up.side) == (edge - 1, edge, "up")
    assert all(isinstance(flight.values[DELAY], int) for flight in rule.flown)


@pytest.mark.parametrize(
    ("vary", "said"),
    [
        # 16 whole numbers in 6 steps of 2.5: places are 2 or 3 apart, and a gap of 3 is what may hide something
        (f"{DELAY}=0:15:7", f"{DELAY} from 0 within 0 to 15 samples: scanned in steps of 3, "),
        (f"{X}=-10:10:9", f"{X} from 0 within -10 to 10 m/s: scanned in steps of 2.5, "),
        (f"{DELAY}=5:15:3", f"{DELAY} from 5, the end nearest to the scenario's 0, within 5 to 15 samples: "),
    ],
)
def test_how_closely_a_key_is_looked_at_is_told(vary: str, said: str) -> None:
    _, plan = resolve_search("gust", vary=[vary])
    (span,) = plan.spans
    values = sorted(float(span.value_at(side * place)) for side in span.sides for place in span.positions(side))
    assert max(b - a for a, b in pairwise(values)) == pytest.approx(float(span.step_text))
    assert describe_resolution(span).startswith(said)


def test_both_ways_from_the_scenario_and_to_the_ends() -> None:
    rule = Rule(lambda values, controller, seed: values[X] <= -7.3)
    edges = by_side(found(rule, [f"{X}=-10:20"]))
    assert edges["up"].breaks is None
    assert (edges["up"].end, edges["up"].bands) == (20.0, ((0.0, 20.0, False),))
    assert edges["down"].breaks is not None
    assert -7.3 - 0.15 <= float(edges["down"].breaks) <= -7.3  # a 200th of the range


def test_islands_are_seen_where_they_are_wider_than_a_step() -> None:
    """It breaks, comes back, and breaks for good; the first edge counts."""

    def breaks(values: Values, controller: str, seed: int) -> bool:
        return 3.1 <= values[X] < 4.7 or values[X] >= 8.0

    up = by_side(found(Rule(breaks), [f"{X}=0:10:11"], tolerance=["0.01"]))["up"]
    assert up.comes_back
    assert up.breaks == pytest.approx(3.1, abs=0.01)
    assert [band[2] for band in up.bands] == [False, True, False, True]

    def narrow(values: Values, controller: str, seed: int) -> bool:
        return 3.1 <= values[X] < 3.2 or values[X] >= 8.0

    missed = by_side(found(Rule(narrow), [f"{X}=0:10:11"]))["up"]
    assert missed.breaks == pytest.approx(8.0, abs=0.05)
    seen = by_side(found(Rule(narrow), [f"{X}=0:10:101"], tolerance=["0.01"]))["up"]
    assert seen.breaks == pytest.approx(3.1, abs=0.01)


def test_a_start_that_breaks_and_where_it_holds_again() -> None:
    rule = Rule(lambda values, controller, seed: abs(values[X]) < 2.0)
    edges = by_side(found(rule, [f"{X}=-1:10:12"], tolerance=["0.1"]))
    assert all(edge.start_breaks and edge.breaks == 0.0 and edge.deviation == 0.0 for edge in edges.values())
    assert edges["down"].holds is None
    assert edges["up"].holds == pytest.approx(2.0, abs=0.1)
    assert not edges["down"].comes_back


def test_a_logarithmic_range_is_scanned_by_factors() -> None:
    rule = Rule(lambda values, controller, seed: values["vehicle.mass_kg"] >= 77.0)
    (up, _) = found(rule, ["vehicle.mass_kg=log(0.5:500)"], tolerance=["vehicle.mass_kg=0.5"]).edges
    assert up.holds is not None
    assert up.breaks is not None
    assert float(up.breaks) - 0.5 <= float(up.holds) < 77.0 <= float(up.breaks)
    masses = sorted({float(flight.values["vehicle.mass_kg"]) for flight in rule.flown})
    steps = [b / a for a, b in pairwise(masses)]
    assert max(steps) == pytest.approx((500.0 / 0.5) ** (1.0 / 20.0), rel=1e-6)


def test_controllers_sides_and_levels_go_side_by_side() -> None:
    """One round of the scan and one for each halving, however many edges there are."""
    edge = {"smith": 3.0, "state": 7.0}
    rule = Rule(lambda values, controller, seed: abs(values[X]) >= edge[controller])
    result = found(rule, [f"{X}=-8:8:17"], controllers=["smith", "state"], tolerance=["0.125"])
    assert {(e.controller, e.side, e.breaks) for e in result.edges} == {
        ("smith", "up", 3.0),
        ("smith", "down", -3.0),
        ("state", "up", 7.0),
        ("state", "down", -7.0),
    }
    assert rule.calls == 1 + 3  # steps of 1 halved to 1/8
    points = [(f.controller, f.values[X]) for f in rule.flown]
    assert len(points) == len(set(points)) == result.flights


def test_a_point_breaks_with_any_seed_or_with_a_share_of_them() -> None:
    """Of five seeds the n-th breaks from n on."""
    rule = Rule(lambda values, controller, seed: values[X] >= seed)
    for share, edge, words in ((0.0, 1.0, "any"), (0.6, 3.0, "at least 3"), (1.0, 5.0, "all")):
        result = found(rule, [f"{X}=0:8:9"], seeds=5, share=share, seed=1, tolerance=["0.01"])
        (up,) = result.edges
        assert up.breaks == pytest.approx(edge, abs=0.01)
        assert words in result.criterion
        assert (up.flown, up.broken) == (5, max(1, round(share * 5)))


def test_a_curve_over_a_second_key() -> None:
    rule = Rule(lambda values, controller, seed: values[X] >= 2.0 + values[Y] ** 2)
    result = found(rule, [f"{X}=0:10:11"], over=f"{Y}=0:3:4", tolerance=["0.01"])
    assert [edge.level for edge in result.edges] == [0.0, 1.0, 2.0, 3.0]
    assert [edge.breaks and float(edge.breaks) for edge in result.edges[:3]] == pytest.approx([2, 3, 6], abs=0.01)
    assert result.edges[3].breaks is None


def test_a_walk_asks_for_nothing_twice() -> None:
    asked: list[float] = []

    def look(places: Any) -> list[bool]:
        asked.extend(places)
        return [place > 0.55 for place in places]

    walk = scan_outward([0.0, 0.25, 0.5, 0.75, 1.0], lambda a, b: None if b - a < 0.02 else 0.5 * (a + b), at_once=2)
    scan = answer_all(walk, look)
    assert scan.change is not None
    assert scan.change[0] <= 0.55 < scan.change[1]
    assert len(asked) == len(set(asked))
    assert 1.0 not in asked or asked.index(1.0) < 4  # nothing beyond the chunk with the first change


def test_several_keys_are_searched_each_alone_and_the_answer_names_what_searches_them_together() -> None:
    rule = Rule(lambda values, controller, seed: values[X] >= 5.0 or values[X] + values[Y] >= 6.0)
    result = found(rule, [f"{X}=0:10", f"{Y}=0:4"])
    assert [(edge.key, edge.breaks is None) for edge in result.edges] == [(X, False), (Y, True)]
    assert all(flight.values[X] == 0.0 or flight.values[Y] == 0.0 for flight in rule.flown)
    assert together_lines(result) == [
        "each key was searched alone; hexjet search --likely searches all of them together"
    ]
    assert together_lines(found(Rule(lambda values, controller, seed: False), [f"{X}=0:10"])) == []


def test_flights_that_are_known_cost_nothing_and_count_once() -> None:
    study, plan = resolve_search("gust", vary=[f"{X}=0:10"], seeds=2)
    rule = Rule(lambda values, controller, seed: False)
    prober = Prober(study, plan.seeds, plan.share)

    def evaluate(points: list[Point]) -> list[bool]:
        return answer_all(prober.evaluate(points), partial(rule.fly, study))

    one, two, three = (plan.point("smith", {X: value}) for value in (1.0, 2.0, 3.0))
    for _ in range(3):
        assert evaluate([one, two, one]) == [False, False, False]
    assert len(rule.flown) == prober.flights == 4
    assert evaluate([one, three]) == [False, False]
    assert len(rule.flown) == prober.flights == 6


def test_the_same_search_goes_the_same_way() -> None:
    def once() -> list[tuple[Any, ...]]:
        rule = Rule(lambda values, controller, seed: values[X] * values[Y] >= 8.0)
        found(rule, [f"{X}=-10:10", f"{Y}=-4:4"])
        return sorted(tuple(sorted(flight.values.items())) for flight in rule.flown)

    assert once() == once()


def first_unstable(controller: str) -> int:
    """The samples of unknown engine delay with which the linear roll channel has a pole outside the unit circle.

    The channel is the aircraft's own: allocation, engine lag and delay, inertia, damping, gyro; the poles are counted by
    the argument principle.
    """
    scenario = Scenario.load("roll-doublet")
    vehicle, _ = load_vehicle("hexjet")
    engine = load_engine("edf-as-flown", {}, scenario.step_s)
    assert engine.lag is not None
    channel = channels(
        scenario, vehicle, engine, Actuator.of("engine", make_lag_dynamics([engine.lag], 25.0, scenario.step_s))
    )["roll"]
    tuning = replace(shipped_tuning(channel, vehicle, engine), controller=controller)
    return next(
        later
        for later in range(60)
        if ClosedLoop(FrequencyGrid(channel.with_delay(25.0 + later), close=2000), tuning).unstable_poles
    )


RINGS = ("limits.settling_s=false", "limits.oscillation_rad=false")  # success alone says how much is left


def test_the_delay_margin_of_the_linear_roll_channel_to_the_sample() -> None:
    """A doublet of 0.5 deg without noise, small enough for nothing to be limited, and what is left of it after 20 s.

    It begins with a swing of 0.02 rad.  One sample of delay changes the growth at the edge by at least a factor of 1.2
    every 5 s, so that one sample before the edge less than that is left, and one sample behind it more.
    """
    command = '[{kind="doublet", signal="roll_deg", start_s=0.4, amplitude=0.5, width_s=0.4}]'
    controllers = ["smith", "filtered-smith"]
    study, plan = resolve_search(
        "roll-doublet",
        vary=[f"{DELAY}=8:26:4"],
        success=["roll.oscillation_rad<=0.02"],
        settings=["sensor_noise=false", "duration_s=20.0", f"command={command}", *RINGS],
        controllers=controllers,
    )
    with LocalWorkers(2) as workers:
        result = answer_all(search(plan, study), partial(workers.fly, study))
    assert {edge.controller: edge.breaks for edge in result.edges} == {
        name: first_unstable(name) for name in controllers
    }
    assert all(edge.holds == edge.breaks - 1 for edge in result.edges)  # type: ignore[operator]


class Here(Rule):
    """Workers that fly, in this process, until ``most`` are flown."""

    def __init__(self, most: int = 10**6) -> None:
        super().__init__(lambda values, controller, seed: False)
        self._most = most

    def fly(self, study: Study, flights: Iterable[Flight]) -> Iterator[Row]:
        for flight in flights:
            if len(self.flown) >= self._most:
                raise KeyboardInterrupt
            self.flown.append(flight)
            yield fly_one(study, flight)


GUST = {
    "vary": [f"{X}=0:400:5"],
    "settings": [
        "duration_s=5.0",
        "engine_parameters.delay_samples=25",
        "limits.drift_m=false",
        "limits.speed_m_s=false",
    ],
    "seeds": 2,
}


def test_what_is_left_behind_flies_again_and_what_was_stopped_goes_on(tmp_path: Path) -> None:
    study, plan = resolve_search("gust", **GUST)
    stopped = Here(most=7)
    with pytest.raises(KeyboardInterrupt):
        run_search(study, plan, tmp_path / "run", stopped)
    journal = tmp_path / "run" / "flights.jsonl"
    with open(journal, "a", encoding="utf-8") as file:
        file.write('{"controller": "smith", "se')  # killed while it wrote
    again = Here()
    searched = run_search(study, plan, tmp_path / "run", again, resume=True)
    whole = run_search(study, plan, tmp_path / "whole", Here())
    assert len(stopped.flown) + len(again.flown) == searched.result.flights == whole.result.flights
    assert len(open_campaign(tmp_path / "run")) == searched.result.flights
    assert searched.result.edges == whole.result.edges

    (edge,) = searched.result.edges
    assert edge.breaks is not None
    assert searched.confirmed
    data = json.loads((tmp_path / "run" / "search.json").read_text())
    assert data["alone"][0]["breaks"] == edge.breaks
    assert {case.breaks for case in searched.cases} == {True, False}
    # what breaks may be beyond a limit before it is lost
    assert all(case.outcome == "completed" for case in searched.cases if not case.breaks)
    for case in searched.cases:
        run = fly(Scenario.load(tmp_path / "run" / "cases" / case.name / "scenario.toml"))
        assert run.outcome == case.outcome
        assert run.summary.seed == case.seed
    page = (tmp_path / "run" / "search.html").read_text()
    assert all(f"cases/{case.name}/report.html" in page for case in searched.cases)
    assert " and breaks at " in page[: page.index("</header>")]


def test_what_cannot_be_flown_breaks_and_says_so(tmp_path: Path) -> None:
    """Too heavy to hover: found as an edge, with the reason in the words of the one who refuses to fly it."""
    study, plan = resolve_search(
        "hover", vary=["vehicle.mass_kg=5.525:20:2"], settings=["duration_s=0.1"], tolerance=["5"]
    )
    searched = run_search(study, plan, tmp_path / "run", Here())
    (edge,) = searched.result.edges
    assert edge.outcome == "failed"
    assert edge.reason.startswith("not flown: ")
    assert "would hover at throttle" in edge.reason
    assert searched.confirmed
    assert [case.breaks for case in searched.cases] == [True, False]


def test_another_search_is_left_alone(tmp_path: Path) -> None:
    study, plan = resolve_search("gust", vary=[f"{X}=0:4:2"])
    rule = Here(most=0)
    with pytest.raises(KeyboardInterrupt):
        run_search(study, plan, tmp_path, rule)
    before = sorted(path.name for path in tmp_path.rglob("*"))
    with pytest.raises(InputError, match="already holds a campaign"):
        run_search(study, plan, tmp_path, rule)
    other = resolve_search("gust", vary=[f"{X}=0:5:2"])
    with pytest.raises(InputError, match=r"holds another study; .*[54]\.0"):
        run_search(*other, tmp_path, rule, resume=True)
    with pytest.raises(InputError, match=r"holds another study; plan: seeds is"):
        run_search(study, replace(plan, seeds=(1, 2)), tmp_path, rule, resume=True)
    assert sorted(path.name for path in tmp_path.rglob("*")) == before
    with pytest.raises(InputError, match="holds flights of hexjet search, which goes on with them"):
        run_campaign(None, tmp_path, rule, resume=True)
    with pytest.raises(InputError, match=r"has the flights of hexjet search; its page is .*search\.html"):
        write_campaign_report(open_campaign(tmp_path))


def test_the_command_line_prints_the_search_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    varied = ["--vary", f"{X}=0:200:3", "--set", "duration_s=4.2"]
    line = ["search", "gust", *varied, "--workers", "1", "--tolerance", "90"]
    with pytest.raises(SystemExit) as end:
        main([*line, "--out", str(tmp_path / "run"), "--json"])
    assert end.value.code == 0
    data = json.loads(capsys.readouterr().out)
    assert data["criterion"] == "the flight breaks if it does not end completed within its limits"
    assert [case["breaks"] for case in data["cases"]] == [True, False]
    with pytest.raises(SystemExit) as end:
        main([*line, "--out", str(tmp_path / "run"), "--resume"])
    assert end.value.code == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "breaks at" in shown
    assert "what lasts for less than a step may be missed" in shown


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"vary": []}, "nothing varies; vary KEY=LO:HI says what does"),
        ({"vary": ["vehicle.mass=1:2"]}, "did you mean vehicle.mass_kg?"),
        ({"vary": ["monitor=true,false"]}, "a search needs a range of numbers"),
        ({"vary": [f"{X}=0:1", f"{X}=0:2"]}, "is there twice"),
        ({"vary": [f"{X}=0:1"], "over": f"{Y}=0:1"}, "say at how many values"),
        ({"vary": [f"{X}=0:1", f"{Z}=0:1"], "over": f"{Y}=0:1:3"}, "goes with one vary"),
        ({"vary": [f"{X}=0:1"], "tolerance": ["0"]}, "must be above 0"),
        ({"vary": [f"{X}=0:1", f"{Y}=0:1"], "tolerance": ["0.1"]}, "write it as KEY=X"),
    ],
)
def test_wrong_input_is_one_line(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=r"\A[^\n]+\Z") as error:
        resolve_search("gust", **options)
    assert words in str(error.value)
