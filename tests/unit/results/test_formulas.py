"""Formulas over signals: by hand, against their definition row by row, and against rtamt where that is installed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, isnan, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.results.requirements import formula as fm
from cosim.results.requirements.grammar import parse_formula
from cosim.results.requirements.units import UNITS, factor_between, unit_of

STEP = 0.5


class Rows:
    """Signals that are given row by row, and events by their rows."""

    def __init__(self, signals: Mapping[str, Sequence[float]], events: Mapping[str, Sequence[int]] = {}) -> None:
        self.rows, self.step_s = len(next(iter(signals.values()))), STEP
        self.margins: dict[fm.Formula, Array] = {}
        self._signals, self._events = signals, events

    def signal(self, name: str) -> Array:
        return np.array(self._signals[name], dtype=float)

    def event_rows(self, name: str) -> Sequence[int]:
        return self._events[name]


def margin(text: str, events: Mapping[str, Sequence[int]] = {}, **signals: Sequence[float]) -> float:
    return float(parse_formula(text).formula.margins(Rows(signals, events))[0])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a < 3", 2.0),
        ("a <= 3", 2.0),
        ("a > 3", -2.0),
        ("3 >= a", 2.0),
        ("0 < a < 3", 1.0),
        ("not a < 3", -2.0),
        ("a + b < 12", 1.0),
        ("a - 2 * b < 0", 19.0),
        ("-a < 0", 1.0),
        ("abs(a - b) < 10", 1.0),
        ("always(a < 6)", 1.0),
        ("always(a < 5 and b > 6)", 0.0),
        ("eventually(a > 4)", 1.0),
        ("always(a < 4 or b < 7)", 0.0),
        ("for(1 s, a < 6)", 3.0),
        ("within(1 s, a > 2)", 1.0),
        ("for(1.4 s, a < 6)", 3.0),  # the row at 1.5 s is later
        ("after(1.5 s, a < 9)", 5.0),
        ("after(1.1 s, a < 9)", 5.0),  # the first row that is not earlier
        ("until(a < 4, b < 8)", 1.0),  # b is 7 in the third row, and a 2 at most before it
        ("until(a < 4, b < 8, 0.5 s)", -1.0),
        ("always(a > 3 implies within(1 s, b > 9))", -2.0),
        ('after("up", always(a > 1))', 3.0),
        ('after("both", b < 9)', -1.0),
        ('until(a < 3, "up")', 0.0),
        ('until(a < 3, "never")', -inf),
    ],
)
def test_margins_of_formulas_are_as_by_hand(text: str, expected: float) -> None:
    events = {"up": [3], "both": [0, 1], "never": []}
    # 0, 0.5, 1, 1.5 and 2 s
    assert margin(text, events, a=[1, 2, 3, 4, 5], b=[10, 9, 7, 8, 6]) == pytest.approx(expected, abs=1e-12)


def test_words_bind_as_they_are_read() -> None:
    """Not before and, and before or, or before implies, which goes to the right."""
    for text, bracketed in (
        ("not a < 1 and a < 2", "(not (a < 1)) and (a < 2)"),
        ("a < 1 or a < 2 and a < 3", "(a < 1) or ((a < 2) and (a < 3))"),
        ("a < 1 implies a < 2 implies a < 3", "(a < 1) implies ((a < 2) implies (a < 3))"),
        ("a < 1 or a < 2 implies a < 3", "((a < 1) or (a < 2)) implies (a < 3)"),
        ("a - 1 - 2 < 3", "((a - 1) - 2) < 3"),
    ):
        for value in (0.5, 1.5, 2.5, 3.5, 4.5, 6.5):
            assert margin(text, a=[value]) == margin(bracketed, a=[value])


def test_unknown_rows_are_left_out() -> None:
    """A set-point that is not there is not assessed; beside another part only what is sure counts."""
    assert margin("always(a < 3)", a=[1, nan, 2]) == 1.0
    assert isnan(margin("always(a < 3)", a=[nan, nan]))
    assert margin("a < 3 and b < 3", a=[5], b=[nan]) == -2.0
    assert isnan(margin("a < 3 and b < 3", a=[1], b=[nan]))
    assert margin("a < 3 or b < 3", a=[1], b=[nan]) == 2.0
    assert isnan(margin("a < 3 or b < 3", a=[5], b=[nan]))
    assert isnan(margin("not a < 3", a=[nan]))
    assert margin("within(0.5 s, a < 3)", a=[nan, 1, 0]) == 2.0
    assert isnan(margin("for(0.5 s, a < 3)", a=[nan, nan, 9]))
    assert isnan(margin("after(5 s, a < 3)", a=[1, 2]))
    assert isnan(margin('after("never", a < 3)', {"never": []}, a=[1, 2]))


def test_units_of_names_and_numbers() -> None:
    assert [unit_of(name) for name in ("roll_deg", "rate_p_rad_s", "thrust_1_N", "throttle_1", "x_m_s2", "a.b_percent")] == [
        "deg", "rad/s", "N", "1", "m/s^2", "%",
    ]  # fmt: skip
    assert margin("roll_deg < 30", roll_rad=[np.radians(20.0)]) == pytest.approx(10.0, abs=1e-12)
    assert margin("roll_rad < 30 deg", roll_rad=[0.5]) == pytest.approx(np.radians(30.0) - 0.5, abs=1e-15)
    assert margin("height_m < 2 km", height_m=[500.0]) == 1500.0
    assert margin("throttle_1 < 90 %", throttle_1=[0.5]) == pytest.approx(0.4)
    assert margin("rate_p_deg_s + 1 rad/s > 0", rate_p_rad_s=[0.0]) == pytest.approx(180.0 / np.pi)
    assert parse_formula("always(roll_deg < 30 and pitch_deg < 20)")[1:] == ("deg", 20.0)
    assert all(factor_between(unit, si) == factor for unit, (si, factor) in UNITS.items())


def test_parts_in_several_units_are_shares_of_their_limits() -> None:
    parsed = parse_formula("always(abs(roll_deg) < 40 and altitude_m > 10)")
    assert parsed[1:] == ("1", 1.0)
    rows = Rows({"roll_rad": [0.0, np.radians(10.0)], "altitude_m": [13.0, 14.0]})
    assert parsed.formula.margins(rows)[0] == pytest.approx(0.3)
    with pytest.raises(InputError, match=r"'altitude_m > 0' has another unit than the rest .* make two requirements"):
        parse_formula("roll_deg < 3 and altitude_m > 0")


@pytest.mark.parametrize(
    ("text", "tolerance"),
    [
        ("abs(altitude_m - 10) < 0.442", 0.442),
        ("always(-abs(altitude_m - 10 m) > -44.2 cm)", 0.442),
        ("yaw_deg - 90 < 2", 2.0),
        ("2 * (altitude_m - 10) < 1", 1.0),
        ("99.5 < altitude_m < 100.5", 0.5),
        ("always(altitude_m > 99.5) and always(altitude_m < 100.5)", 0.5),
        ("always(0 < altitude_m < 1) and after(2 s, 99 < altitude_m < 101)", 0.5),
        ("-30 < roll_deg < 20", 25.0),
        ("altitude_m < altitude_setpoint_m + 0.5", 0.5),
        ("altitude_m > 99.5", 99.5),
        ("altitude_m - 10 > 0", 0.0),
        ("roll_deg < pitch_deg", 0.0),
    ],
)
def test_the_tolerance_is_what_the_limit_allows_and_no_offset(text: str, tolerance: float) -> None:
    assert parse_formula(text).tolerance == pytest.approx(tolerance, abs=1e-12)


def test_a_band_beside_another_unit_is_a_share_of_its_half() -> None:
    parsed = parse_formula("99.5 < altitude_m < 100.5 and abs(roll_deg) < 30")
    rows = Rows({"roll_rad": [0.0], "altitude_m": [100.4]})
    assert parsed.formula.margins(rows)[0] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the end at character 1: there must be a signal, a number, [(]"),
        ("always(a < 3", r"the end at character 13: there must be '\)'"),
        ("always(roll_deg)", "'roll_deg' at character 8: is a quantity .* compare it"),
        ("allways(a < 3)", "unknown word 'allways' at character 1; did you mean 'always'[?]"),
        ("roll_deg < 3 degr", "unknown unit 'degr' at character 14; did you mean 'deg'[?]"),
        ("roll_deg < 3 m", "'roll_deg < 3 m' at character 1: m is not a unit of what is in deg"),
        ("a < 3 and 4 < 5", "'4 < 5' at character 11: compares two numbers"),
        ("within(2, a < 3)", "'2' at character 8: there must be a time such as 2 s"),
        ("after(a < 3, a < 4)", 'an event such as "gust ends"'),
        ('"gust ends" and a < 3', 'an event stands first in after'),
        ("a < 3 $", "'[$]' at character 7"),
        ("a < b a", "'a' at character 7: there must be and, or, implies"),
        ("(a < 3) + 1 < 2", "'[(]a < 3[)] [+]' at character 1: is true or false"),
        ("a * 2 < 3", "only a number without a unit multiplies"),
        ("(" * 50 + "a" + ")" * 50 + " < 3", "at most 40 parts"),
        ("not " * 90 + "a < 3", "at most 40 parts"),
        ("-" * 90 + "a < 3", "at most 40 parts"),
        ("a < 1 implies " * 90 + "a < 3", "at most 40 parts"),
        ("a < 1e999", "a finite number"),
        ("a < 3" + " and a < 3" * 300, "at most 2000"),
        ("always(a, 3 s)", "is a quantity"),
    ],
)  # fmt: skip
def test_errors_say_where_and_what_is_allowed(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_formula(text)


NUMBERS = st.sampled_from([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])
ATOMS = st.builds(
    lambda name, limit, is_upper: fm.Comparison(
        *((fm.Signal(name), fm.Number(limit, None)) if is_upper else (fm.Number(limit, None), fm.Signal(name))),
        "1",
        name,
    ),
    st.sampled_from(["a", "b"]),
    NUMBERS,
    st.booleans(),
)
SECONDS = st.sampled_from([0.0, 0.5, 1.0, 1.5, 3.0, 40.0])
FORMULAS: st.SearchStrategy[fm.Formula] = st.recursive(
    ATOMS,
    lambda part: st.one_of(
        st.builds(fm.Not, part),
        st.builds(fm.AllOrAny, st.lists(part, min_size=2, max_size=3).map(tuple), st.booleans()),
        st.builds(fm.Throughout, part, st.booleans(), st.one_of(st.just(inf), SECONDS)),
        st.builds(fm.Until, part, part, st.one_of(st.just(inf), SECONDS)),
        st.builds(fm.After, SECONDS, part),
        st.builds(fm.AfterEvent, st.sampled_from(["once", "often", "never"]), part),
    ),
    max_leaves=6,
)  # fmt: skip
EVENTS = {"once": [2], "often": [0, 3, 4], "never": []}


def defined(of: fm.Formula, rows: Rows, row: int) -> float:
    """Return the margin in one row by the definition, all rows of a span looked at; NaN: unknown."""
    match of:
        case fm.Comparison():
            return float(of.greater.values(rows)[row] - of.less.values(rows)[row])
        case fm.Not():
            return -defined(of.of, rows, row)
        case fm.AllOrAny():
            margins = [defined(part, rows, row) for part in of.parts]
            known = [value for value in margins if not isnan(value)]
            sure = [value for value in known if (value > 0.0 if of.either else value < 0.0)]
            if len(known) < len(margins) and not sure:
                return nan
            return max(known) if of.either else min(known)
        case fm.Throughout():
            known = [
                value for value in (defined(of.of, rows, k) for k in span(of.seconds, rows, row)) if not isnan(value)
            ]
            return nan if not known else max(known) if of.once else min(known)
        case fm.Until():
            best = -inf
            for end in span(of.seconds, rows, row):
                then = defined(of.then, rows, end)
                before = [defined(of.of, rows, k) for k in range(row, end)]
                best = max(best, -inf if isnan(then) else min([then, *(v for v in before if not isnan(v))]))
            return best
        case fm.After():
            later = row + round(of.seconds / STEP)
            return defined(of.of, rows, later) if later < rows.rows else nan
        case fm.AfterEvent():
            margins = [defined(of.of, rows, k) for k in rows.event_rows(of.event) if row <= k < rows.rows]
            return min((value for value in margins if not isnan(value)), default=nan)
    raise AssertionError


def span(seconds: float, rows: Rows, row: int) -> range:
    return range(row, rows.rows if seconds == inf else min(rows.rows, row + round(seconds / STEP) + 1))


@settings(max_examples=400)
@given(FORMULAS, st.data())
def test_margins_are_those_of_the_definition(formula: fm.Formula, data: st.DataObject) -> None:
    """And the comparison and the row that decide have the margin of the whole."""
    values = st.lists(st.one_of(NUMBERS, st.just(nan)), min_size=6, max_size=6)
    rows = Rows({"a": data.draw(values), "b": data.draw(values)}, EVENTS)
    margins = formula.margins(rows)
    expected = [defined(formula, rows, row) for row in range(rows.rows)]
    np.testing.assert_array_equal(margins, expected)
    for row, value in enumerate(expected):
        if np.isfinite(value):
            comparison, at, sign = formula.find_decisive_comparison(rows, row)
            assert sign * comparison.margins(rows)[at] == value


def rtamt_text(of: fm.Formula) -> str:
    """Return a formula in rtamt's language, whose times are rows here."""
    match of:
        case fm.Comparison():
            upper = isinstance(of.greater, fm.Number)
            signal, number = (of.less, of.greater) if upper else (of.greater, of.less)
            assert isinstance(signal, fm.Signal)
            assert isinstance(number, fm.Number)
            return f"({signal.name} {'<' if upper else '>'} ({number.value}))".replace("(-", "(0 - ")
        case fm.Not():
            return f"(not {rtamt_text(of.of)})"
        case fm.AllOrAny():
            return "(" + (" or " if of.either else " and ").join(map(rtamt_text, of.parts)) + ")"
        case fm.Throughout():
            return f"({'eventually' if of.once else 'always'}{bounds(of.seconds)} {rtamt_text(of.of)})"
        case fm.Until():
            return f"({rtamt_text(of.of)} until{bounds(of.seconds)} {rtamt_text(of.then)})"
    raise AssertionError


def bounds(seconds: float) -> str:
    return "" if seconds == inf else f"[0:{round(seconds / STEP)}]"


SHARED: st.SearchStrategy[fm.Formula] = st.recursive(
    ATOMS,
    lambda part: st.one_of(
        st.builds(fm.Not, part),
        st.builds(lambda left, right, either: fm.AllOrAny((left, right), either), part, part, st.booleans()),
        st.builds(fm.Throughout, part, st.booleans(), st.one_of(st.just(inf), SECONDS)),
        st.builds(fm.Until, part, part, SECONDS.filter(bool)),
    ),
    max_leaves=6,
)


@settings(max_examples=150)
@given(SHARED, st.lists(st.tuples(NUMBERS, NUMBERS), min_size=8, max_size=8))
def test_margins_are_those_of_rtamt(formula: fm.Formula, values: list[tuple[float, float]]) -> None:
    rtamt: Any = pytest.importorskip("rtamt", reason="rtamt is not installed: pip install rtamt")
    specification = rtamt.StlDiscreteTimeSpecification()
    for name in ("a", "b"):
        specification.declare_var(name, "float")
    specification.spec = rtamt_text(formula)
    specification.parse()
    a, b = zip(*values, strict=True)
    theirs = specification.evaluate({"time": list(range(len(a))), "a": list(a), "b": list(b)})
    margins = formula.margins(Rows({"a": a, "b": b}))
    assert [value for _, value in theirs] == margins.tolist()
