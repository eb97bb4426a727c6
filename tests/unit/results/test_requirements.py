"""Requirements of a flight: margins of limits and ranges, lost flights, what is refused, and docs/metrics.md."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import campaigns
import numpy as np
import pytest
from comparisons import compare_report
from places import DOCS

from cosim import Scenario, fly
from cosim.base.errors import InputError
from cosim.base.outcomes import Verdict
from cosim.campaign.analysis.page import write_campaign_report
from cosim.campaign.analysis.summary import unmet_criteria
from cosim.campaign.analysis.table import read_flight_table
from cosim.campaign.study.plan import Flight, flights
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import MARGIN_OF, fly_one, kinds
from cosim.results import requirements as rs
from cosim.results.contacts import CONTACTS
from cosim.results.expectations import check_expected
from cosim.results.limits import find_exceeded
from cosim.results.log.columns import COLUMNS, NAMES
from cosim.results.log.recorder import MemoryLog
from cosim.results.metrics import check_expectations
from cosim.results.report.flight import write_report
from cosim.results.report.requirements import by_margin, compared_margins, margins_over_time
from cosim.results.requirements.signals import event_times
from cosim.results.requirements.stated import note_first_row
from cosim.results.run import Run, open_run
from cosim.spec.scenario import Range
from hexjet_prove.proof.requirements import proven_requirements
from hexjet_prove.search.search import describe_flight
from hexjet_prove.surveys.faults import judge
from hexjet_prove.surveys.survey import held_formula

PAGE = (DOCS / "metrics.md").read_text(encoding="utf-8")
STEP = 0.1
LEVEL = {"name": "level", "formula": "always(abs(roll_deg) < 30)"}


def flight(metrics: Mapping | None = None, times: Mapping | None = None, **columns: Any) -> rs.FlightSignals:
    """Return a flight of which some columns are given and all others are 0."""
    rows = len(next(iter(columns.values())))
    table = np.zeros((len(NAMES), rows))
    for name, values in columns.items():
        table[NAMES.index(name)] = values
    return rs.FlightSignals(MemoryLog([table], NAMES, COLUMNS), STEP, metrics or {}, times or {})


def test_a_margin_has_its_instant_and_its_comparison() -> None:
    requirement = rs.Requirement(name="level", formula="always(abs(roll_deg) < 30 and pitch_deg > -10)")
    assessed = requirement.assess(flight(roll_rad=np.radians([0, -20, 5]), pitch_rad=np.radians([0, 0, -7])))
    assert (assessed.margin, assessed.kept) == (pytest.approx(3.0), True)
    assert assessed.decided_at_s == pytest.approx(0.2)
    assert assessed.decided_by == "pitch_deg > -10"
    np.testing.assert_allclose(assessed.margin_over_time, [10.0, 10.0, 3.0])
    assert requirement.divisor == 10.0


def test_a_margin_over_time_turns_with_not() -> None:
    assessed = rs.Requirement(name="a", formula="not eventually(altitude_m > 5)").assess(flight(altitude_m=[1, 4, 2]))
    assert assessed.margin == 1.0
    np.testing.assert_array_equal(assessed.margin_over_time, [4.0, 1.0, 3.0])


def test_derived_signals_are_what_they_say() -> None:
    signals = flight(
        roll_setpoint_rad=[3.0], roll_rad=[-3.0], pitch_rad=[0.5], altitude_setpoint_m=[2.0], altitude_m=[5.0],
        on_ground=[1.0], north_m=[3.0], east_m=[4.0], north_setpoint_m=[0.0], velocity_north_m_s=[3.0],
        velocity_east_m_s=[4.0], velocity_down_m_s=[2.0], rate_p_setpoint_rad_s=[1.0],
    )  # fmt: skip
    expected = {
        "roll_error_rad": 6.0 - 2.0 * np.pi,
        "altitude_error_m": 0.0,
        "place_error_m": 5.0,
        "drift_m": 0.0,
        "speed_m_s": 5.0,
        "climb_m_s": -2.0,
        "rate_p_error_rad_s": 1.0,
        "lean_rad": np.arccos(np.cos(-3.0) * np.cos(0.5)),
    }
    assert {name: signals.signal(name)[0] for name in expected} == pytest.approx(expected)


def test_events_are_those_of_the_log_and_of_the_scenario() -> None:
    ground = np.concatenate([np.ones(10), np.zeros(10), np.ones(10)])
    signals = flight(times={"gust ends": [0.31, 9.0]}, on_ground=ground)
    assert [list(signals.event_rows(name)) for name in (*CONTACTS, "gust ends")] == [[10], [20], [4]]
    scenario = Scenario.load("gust")
    gust = next(entry for entry in scenario.disturbance if entry.kind == "gust")
    assert event_times(scenario)["gust ends"][0] == gust.start_s + gust.rise_s + gust.hold_s + gust.fall_s
    assert event_times(Scenario.load("roll-doublet")) == {"doublet begins": [1.0], "doublet ends": [7.0]}


def test_what_was_never_tested_is_not_kept() -> None:
    requirement = rs.Requirement(name="a", formula='after("touches the ground", altitude_m < 1)')
    assessed = requirement.assess(flight(altitude_m=[9.0, 9.0]))
    assert (assessed.margin, assessed.kept, assessed.note) == (None, False, "never tested in this flight")
    assert rs.RequirementResult.of(assessed).scaled == -1.0
    late = rs.Requirement(name="b", formula='until(altitude_m > 3, "touches the ground")').assess(
        flight(altitude_m=[9.0])
    )
    assert (late.margin, late.kept) == (None, False)


def test_a_lost_flight_keeps_nothing_the_less_the_earlier() -> None:
    requirement = rs.Requirement(name="level", formula=LEVEL["formula"])
    ends = [(end, requirement.assess(flight(roll_rad=[0.1]), rs.FailedFlight(end, 10.0))) for end in (0.0, 5.0, 10.0)]
    assert [assessed.margin for _, assessed in ends] == [-60.0, -45.0, -30.0]
    assert [assessed.kept for _, assessed in ends] == [False] * 3
    assert [assessed.decided_at_s for _, assessed in ends] == [0.0, 5.0, 10.0]
    worse = requirement.assess(flight(roll_rad=np.radians([0.0, 100.0])), rs.FailedFlight(9.0, 10.0))
    assert (worse.margin, worse.decided_at_s) == (pytest.approx(-70.0), STEP)
    assert rs.smallest_margin([rs.RequirementResult.of(ends[0][1])], rs.FailedFlight(5.0, 10.0)) == (-2.0, "level")
    assert rs.smallest_margin([], rs.FailedFlight(5.0, 10.0)) == (-1.5, "flown")
    assert rs.smallest_margin([], None) == (None, "")


@pytest.mark.parametrize("value", [None, 0.0, 0.4999, 0.5, np.nextafter(0.5, 1.0), 3.0])
@pytest.mark.parametrize("name", ["roll.rmse_rad", "roll.settling_time_s"])
def test_limits_and_ranges_say_what_they_said(name: str, value: float | None) -> None:
    """To the last bit: a requirement made of one is kept where the limit or the range is."""
    values, signals = {name: value}, flight({name: value}, roll_rad=[0.0])
    for allowed in (Range(max=0.5), Range(min=0.5), Range(min=0.1, max=0.5)):
        (result,) = (r.assess(signals) for r in rs.range_requirements({name: allowed}, "expect"))
        assert result.kept is not bool(check_expectations(values, {name: allowed}))
    (limited,) = (r.assess(signals) for r in rs.flight_requirements({name: 0.5}, {}, []))
    assert limited.kept is not bool(find_exceeded({name: 0.5}, values))


@pytest.fixture(scope="module")
def flown() -> Run:
    """A flight with limits, ranges and requirements of every kind."""
    scenario = Scenario.load("roll-doublet").replace(
        require=[
            LEVEL,
            {"name": "lean", "formula": "always(lean_deg < 12)", "reason": "so that one is broken"},
            {"name": "late", "formula": 'after("doublet ends", for(0.5 s, abs(roll_deg) < 15))'},
        ]
    )
    return fly(scenario)


def test_a_flight_has_all_its_requirements(flown: Run) -> None:
    summary = flown.summary
    sources = {result.source for result in summary.requirements}
    assert sources == {"require", "limits", "expect"}
    by_name = {result.name: result for result in summary.requirements if result.source == "require"}
    level = 30.0 - np.degrees(np.max(np.abs(flown.log["roll_rad"])))
    assert by_name["level"].margin == pytest.approx(level)
    assert by_name["level"].decided_at_s == pytest.approx(np.argmax(np.abs(flown.log["roll_rad"])) * summary.step_s)
    assert (by_name["lean"].kept, by_name["late"].kept) == (False, True)
    assert summary.margin == pytest.approx(by_name["lean"].margin / 12.0)
    assert (summary.decided_by, summary.requirements_kept, summary.verdict) == ("lean", False, "requirement broken")
    assert not summary.succeeded
    assert len(summary.broken) == 1
    assert re.match(r"lean: broken by \d\.\d+ deg at 4\.\d\d s: always\(lean_deg < 12\)$", summary.broken[0])


def test_limits_of_a_flight_are_kept_where_they_are_not_exceeded(flown: Run) -> None:
    limits = {result.name: result for result in flown.summary.requirements if result.source == "limits"}
    assert limits.keys() == flown.summary.limits.keys()
    assert [name for name, result in limits.items() if not result.kept] == flown.summary.beyond
    flat = flown.summary.flat_metrics
    for name, result in limits.items():
        if result.margin is not None:
            assert result.margin == flown.summary.limits[name] - (flat[name] or 0.0)
    assert limits["speed.max_m_s"].decided_at_s is not None


def test_a_run_says_them_again(flown: Run, tmp_path: Path) -> None:
    run = fly(flown.scenario.replace(duration_s=7.6), out=tmp_path / "run", report=False)
    again = open_run(tmp_path / "run")
    assert again.summary == run.summary
    assert Scenario.load(tmp_path / "run" / "scenario.toml").require == flown.scenario.require
    signals = rs.FlightSignals(again.log, STEP / 25.0, again.summary.flat_metrics, again.summary.event_times_s)
    for result in again.summary.requirements:
        if result.source == "require":
            assert result.requirement.assess(signals).margin == result.margin


def test_a_scenario_without_them_is_as_before() -> None:
    scenario = Scenario.load("roll-doublet")
    assert "require" not in scenario.replace(require=[]).model_dump_json()


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        ("always(roll_deg < 3", "require level: the end at character 20"),
        ('after("gust ends", roll_deg < 3)', "unknown event 'gust ends'; did you mean 'doublet ends'"),
        ("after(20 s, roll_deg < 3)", "speaks of 20 s, and the flight ends at 12 s"),
        ('after("doublet ends", for(6 s, roll_deg < 3))', "speaks of 13 s"),
        ("always(roll_deg > 0)", "compares with no number but 0: state its scale, in deg"),
    ],
)
def test_what_nothing_could_keep_is_refused(formula: str, message: str) -> None:
    table = {"name": "mine", "duration_s": 12.0, "require": [{"name": "level", "formula": formula}]}
    doublet = {"kind": "doublet", "signal": "roll_deg", "start_s": 1.0, "amplitude": 10.0, "width_s": 3.0}
    with pytest.raises(InputError, match=message):
        check_expected(Scenario.from_table(table | {"command": [doublet]}, Path(), "mine.toml"))
    with pytest.raises(InputError, match=message):
        study(settings={}, require=table["require"])


def test_a_flight_that_was_shortened_does_not_keep_what_comes_later() -> None:
    require = [{"name": "late", "formula": 'after("doublet begins", for(2 s, abs(roll_deg) < 45))'}]
    run = fly(Scenario.load("roll-doublet").replace(require=require, duration_s=2.5))
    (late,) = (result for result in run.summary.requirements if result.source == "require")
    assert (late.margin, late.kept, late.note) == (None, False, "the flight ends at 2.5 s, before 3 s")
    assert not run.summary.succeeded


def test_unknown_signals_are_refused_with_the_nearest() -> None:
    scenario = Scenario.load("roll-doublet").replace(require=[{"name": "a", "formula": "always(rol_deg < 3)"}])
    with pytest.raises(InputError, match="require a: unknown signal 'rol_deg'; did you mean 'roll_deg'"):
        fly(scenario)
    with pytest.raises(InputError, match="require: level is there twice"):
        Scenario.load("roll-doublet").replace(require=[LEVEL, LEVEL])


def study(**changes: Any) -> Study:
    table = {
        "name": "mine", "scenario": "roll-doublet", "settings": {"duration_s": 3.0}, "design": "random", "runs": 2,
        "vary": [{"key": "mismatch.thrust_factor", "range": [0.95, 1.05]}], "require": [LEVEL],
        "success": {"roll.rmse_rad": {"max": 0.2}},
    }  # fmt: skip
    return Study.from_table(table | changes, Path(), "mine.toml")


def test_a_row_has_the_margins() -> None:
    mine = study()
    row = fly_one(mine, flights(mine)[0])
    assert list(row) == list(kinds(mine))
    assert row["margin_roll.rmse_rad"] == 0.2 - row["roll.rmse_rad"]
    assert isinstance(row["margin_level"], float)
    assert isinstance(row["margin"], float)
    assert (row["margin"] >= 0.0) is row["success"]
    broken = study(require=[{"name": "flat", "formula": "always(abs(roll_deg) < 1)"}])
    row = fly_one(broken, flights(broken)[0])
    assert (row["success"], row["decided_by"]) == (False, "flat")
    assert row["margin"] == row[MARGIN_OF + "flat"]  # its limit is 1 deg


def test_a_study_refuses_what_its_flights_would() -> None:
    with pytest.raises(InputError, match="require bad: unknown event 'gust ends'"):
        study(require=[{"name": "bad", "formula": 'after("gust ends", roll_deg < 3)'}])


def test_a_formula_that_looks_at_the_first_row_alone_is_noted() -> None:
    formulas = ("abs(roll_deg) < 30", "always(abs(roll_deg) < 30)", "roll.overshoot_percent < 50")
    entries = [{"name": f"r{number}", "formula": formula} for number, formula in enumerate(formulas)]
    (line,) = note_first_row(Scenario.load("roll-doublet").replace(require=entries))
    assert line == f"require r0: {formulas[0]} is judged in the first row alone; always({formulas[0]}) in all"


def test_the_page_of_a_flight_begins_with_the_smallest_margin(flown: Run, tmp_path: Path) -> None:
    write_report(flown, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Smallest margin: -" in page[: page.index("</header>")]
    table = page[page.index("<h2>Requirements and metrics</h2>") : page.index("<h2>What happened</h2>")]
    assert page.index('data-figure="first"') < page.index('id="replay-card"') < page.index("<h2>Delay in the loop</h2>")
    rows = re.findall(r"<tr><td class=\"wraps\"><span title=\"(\S+)\"", table)
    assert rows[0] == "lean"
    # Limits of metrics of which more is expected are left out.
    assert len(rows) == len(by_margin(flown.summary)) == len(flown.summary.requirements) - 3
    assert table.count(">broken<") == 1
    assert "requirement broken</span>" in page
    assert re.search(r'data-figure="margins"', page)
    events = page[page.index("<h2>What happened</h2>") :]
    assert "lean: broken by" in events[: events.index("</table>")]


def test_margins_over_time_meet_the_margin_where_it_is_decided(flown: Run) -> None:
    margins = margins_over_time(flown.log, flown.summary)
    assert {"margin_level", "margin_lean", "margin_late", "margin_speed.max_m_s"} <= {m.column.name for m in margins}
    for margin in margins:
        row = round(margin.result.decided_at_s / flown.summary.step_s)
        assert margin.values()[row] == margin.result.margin
    scaled = [margin.result.scaled or 0.0 for margin in margins]
    assert scaled == sorted(scaled)


def test_a_comparison_has_margins_side_by_side(flown: Run, tmp_path: Path) -> None:
    other = fly(flown.scenario.replace(require=[LEVEL], controller="state"))
    (late, lean, level) = compared_margins([flown.summary, other.summary, None])
    assert [row["name"] for row in (late, lean, level)] == ["late", "lean", "level"]
    assert [kind for _, kind in lean["cells"]] == ["unmet", "", ""]
    assert [bool(text) for text, _ in level["cells"]] == [True, True, False]
    compare_report([flown, other], tmp_path / "both.html")
    assert "<h2>Margins of requirements</h2>" in (tmp_path / "both.html").read_text(encoding="utf-8")


def test_a_campaign_says_which_requirement_was_broken(tmp_path: Path) -> None:
    margins = iter([3.0, -2.0, None, 5.0])
    mine = study(runs=4)

    def outcome(_: Flight, __: Any) -> dict[str, Any]:
        margin = next(margins)
        kept = margin is not None and margin >= 0.0
        return {"margin": None if margin is None else margin / 30.0, "margin_level": margin, "success": kept,
                "roll.rmse_rad": 0.1}  # fmt: skip

    made = campaigns.campaign(tmp_path, mine, outcome)
    table = read_flight_table(made)
    assert [list(names) for names in table.broken] == [[], ["level"], ["level"], []]
    assert unmet_criteria(table, 1, mine.success) == ["requirement level broken"]
    assert table.metrics[0].name == "margin"
    assert describe_flight(mine, made.row(1)).startswith("completed, requirement level broken")
    flown, level, rmse = proven_requirements(made)
    assert (flown.label, level.label, rmse.label) == ("R1", "R2", "R3")
    assert (level.says, level.broken, level.told) == ("level: always(abs(roll_deg) < 30)", 2, 4)
    write_campaign_report(made)
    assert "requirement level broken" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("degrees", "outcome", "verdict", "margin"),
    [
        ([9.0, 4.0, -4.5], "completed", Verdict.HELD, 0.5),  # the first row is more than a second before the end
        ([0.0, 0.0, 5.5], "completed", Verdict.AIRBORNE, -0.5),
        ([0.0, np.nan, np.nan], "completed", Verdict.AIRBORNE, None),  # rates are commanded: nobody asks for an angle
        ([0.0, 0.0], "diverged", Verdict.LOST, -6.667),
    ],
)
def test_a_surveys_verdict_is_a_requirement(
    degrees: list[float], outcome: str, verdict: Verdict, margin: float | None
) -> None:
    table = np.zeros((len(NAMES), len(degrees)))
    table[NAMES.index("yaw_setpoint_rad")] = np.radians(degrees)
    flown = rs.FlightSignals(MemoryLog([table], NAMES, COLUMNS), 0.5, {}, {})
    lost = None if outcome == "completed" else rs.FailedFlight(0.5 * len(degrees), 1.5)
    held = rs.Requirement(name="held", formula=held_formula(1.5)).assess(flown, lost)
    assert held.margin == (margin if margin is None else pytest.approx(margin, abs=1e-3))
    assert judge(outcome, held.margin) is verdict
