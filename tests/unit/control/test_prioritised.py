"""Bounded effectors for several things that are wanted, the more important first: against linear programs."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from cosim.control.allocation._effectiveness import prioritise

LEVELS = ((0, 1), (2,), (3,))
CLOSE = 1e-8  # rows are of numbers around 1


def problem(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rows, wanted, start, limits; often with effectors that do nothing, do the same, or cannot move."""
    draw = np.random.default_rng(seed)
    count = int(draw.integers(1, 17))
    rows = draw.normal(size=(4, count))
    if draw.random() < 0.4:
        rows[:, draw.random(count) < 0.3] = 0.0
    if draw.random() < 0.3:
        rows = np.round(rows)
    if draw.random() < 0.2:
        rows[3] = 2.0 * rows[0]
    low, high = -draw.random(count), draw.random(count)
    if draw.random() < 0.3:
        high[draw.integers(0, count)] = low[0] if count == 1 else high[0]
    high = np.maximum(low, high)
    start = np.clip(0.3 * draw.normal(size=count), low, high)
    return rows, draw.normal(size=4) * draw.choice([0.1, 1.0, 5.0]), start, low, high


def solve(rows, wanted, start, low, high) -> np.ndarray:
    return np.array(prioritise(*listed(rows, wanted, start, low, high)))


def listed(rows, wanted, start, low, high):
    rows, wanted, start, low, high = (np.asarray(each).tolist() for each in (rows, wanted, start, low, high))
    return rows, wanted, LEVELS, start, low, high


@given(st.integers(0, 10**6))
@settings(max_examples=60)
def test_each_level_goes_as_far_as_a_linear_program_does_and_the_ones_before_stay(seed: int) -> None:
    rows, wanted, start, low, high = problem(seed)
    x = solve(rows, wanted, start, low, high)
    assert (x >= low).all()
    assert (x <= high).all()
    bounds = list(zip(low, high, strict=True))
    got = rows @ x
    for row in (2, 3):
        held = rows[:row]
        ends = [linprog(sign * rows[row], A_eq=held, b_eq=held @ x, bounds=bounds) for sign in (1.0, -1.0)]
        if any(end.status for end in ends):
            continue  # the program's own tolerance finds what is held out of reach
        assert got[row] == pytest.approx(np.clip(wanted[row], ends[0].fun, -ends[1].fun), abs=1e-7)
    # the first two together, along what is missing of them at the start
    missing = wanted[:2] - rows[:2] @ start
    along = linprog(
        np.append(np.zeros(len(x)), -1.0),
        A_eq=np.column_stack([rows[:2], -missing]), b_eq=rows[:2] @ start, bounds=[*bounds, (0.0, 1.0)],
    )  # fmt: skip
    reached = (got[:2] - rows[:2] @ start) @ missing / (missing @ missing)
    assert reached >= -along.fun - 1e-7


@given(st.integers(0, 10**6))
@settings(max_examples=60)
def test_two_rows_that_go_along_first_go_as_far_as_a_linear_program_does(seed: int) -> None:
    """Beyond what keeps the direction: whatever comes across it, and the least of that which such a distance leaves."""
    found = rows, wanted, start, low, high = problem(seed)
    arguments = listed(*found)
    x = np.array(prioritise(*arguments, True))
    assert (x >= low).all()
    assert (x <= high).all()
    missing = wanted[:2] - rows[:2] @ start
    size = float(np.linalg.norm(missing))
    along, across = missing / size @ rows[:2], np.array([missing[1], -missing[0]]) / size @ rows[:2]
    bounds = list(zip(low, high, strict=True))
    most = -linprog(-along, bounds=bounds).fun
    kept = linprog(-along, A_eq=[across], b_eq=[across @ start], bounds=bounds)
    if -kept.fun - along @ start >= size:  # the direction can be kept all the way
        assert rows[:2] @ x == pytest.approx(wanted[:2], abs=1e-7)
        return
    assert along @ x == pytest.approx(min(most, along @ start + size), abs=1e-7)
    assert along @ x >= along @ np.array(prioritise(*arguments)) - 1e-7
    ends = [linprog(sign * across, A_eq=[along], b_eq=[along @ x], bounds=bounds) for sign in (1.0, -1.0)]
    if not any(end.status for end in ends):
        assert across @ x == pytest.approx(np.clip(across @ start, ends[0].fun, -ends[1].fun), abs=1e-6)


@given(st.integers(0, 10**6), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
@settings(max_examples=60)
def test_what_is_wanted_of_a_lower_level_changes_nothing_above_it(seed: int, lift: float, yaw: float) -> None:
    rows, wanted, start, low, high = problem(seed)
    x = solve(rows, wanted, start, low, high)
    other = solve(rows, [*wanted[:3], yaw], start, low, high)
    assert rows[:3] @ other == pytest.approx(rows[:3] @ x, abs=CLOSE)
    other = solve(rows, [*wanted[:2], lift, yaw], start, low, high)
    assert rows[:2] @ other == pytest.approx(rows[:2] @ x, abs=CLOSE)


@given(st.integers(0, 10**6))
@settings(max_examples=30)
def test_within_the_limits_it_is_the_pseudo_inverse_beside_the_start(seed: int) -> None:
    draw = np.random.default_rng(seed)
    rows, start = draw.normal(size=(4, 7)), draw.normal(size=7)
    wanted = draw.normal(size=4)
    x = solve(rows, wanted, start, np.full(7, -1e6), np.full(7, 1e6))
    assert x == pytest.approx(start + np.linalg.pinv(rows) @ (wanted - rows @ start), abs=1e-8)
    assert rows @ x == pytest.approx(wanted, abs=1e-9)


def test_a_row_in_no_level_is_not_looked_at() -> None:
    x = prioritise([[1.0, 0.0], [0.0, 1.0]], [0.3, 0.4], ((0,),), [0.0, 0.0], [-1.0, -1.0], [1.0, 1.0])
    assert x == pytest.approx([0.3, 0.0])


EMPTY: list[list[float]] = [[0.0, 0.0, 0.0]] * 4


@pytest.mark.parametrize("along_first", [False, True])
@pytest.mark.parametrize(
    ("rows", "wanted", "exact"),
    [
        (EMPTY, [1.0] * 4, [0.1, 0.1, 0.1]),  # nothing does anything: all stays at its start
        ([[1.0, 1.0, 1.0]] * 4, [0.9] * 4, [0.3, 0.3, 0.3]),  # all rows the same
        ([[1.0, 1.0, 1.0]] * 4, [9.0] * 4, [1.0, 1.0, 1.0]),  # and more than there is
        ([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]], [1e100, 1e100, -1e100, 5.0], [1.0, 1.0, 0.0]),
    ],
)  # fmt: skip
def test_rows_that_are_not_independent(rows: list, wanted: list[float], exact: list[float], along_first: bool) -> None:
    x = prioritise(rows, wanted, LEVELS, [0.1] * 3, [0.0] * 3, [1.0] * 3, along_first)
    assert x == pytest.approx(exact, abs=1e-12)


def test_a_row_whose_square_is_zero_moves_nothing() -> None:
    """The other one of its level gets what is wanted of it; along what is missing of both it goes to its limit."""
    rows, wanted = [[1e-300, 0.0], [0.0, 1.0]], [1.0, 0.5]
    for along_first, exact in ((False, [0.1, 0.5]), (True, [0.1, 1.0])):
        x = prioritise(rows, wanted, ((0, 1),), [0.1] * 2, [0.0] * 2, [1.0] * 2, along_first)
        assert x == pytest.approx(exact, abs=1e-12)


def test_effectors_without_room_or_without_limits() -> None:
    rows = [[1.0, 1.0], [1.0, -1.0], [0.0, 1.0], [1.0, 0.0]]
    assert prioritise(rows, [1.0] * 4, LEVELS, [0.0, 0.0], [0.2, 0.3], [0.2, 0.3]) == [0.2, 0.3]
    assert prioritise(rows, [1.0] * 4, LEVELS, [0.0, 0.0], [-inf] * 2, [inf] * 2) == pytest.approx([1.0, 0.0])
    # one of them is out: the other gives what there is of the first level along what is missing, nothing more
    assert prioritise(rows[:1], [1.0], ((0,),), [0.0, 0.0], [0.0, -5.0], [0.0, 5.0]) == pytest.approx([0.0, 1.0])


GOOD: tuple[Any, ...] = ([[1.0, 0.0], [0.0, 1.0]], [0.3, 0.4], ((0,), (1,)), [0.0, 0.0], [-1.0, -1.0], [1.0, 1.0])


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (0, [[1.0, nan], [0.0, 1.0]], "rows: nan is not a finite number"),
        (0, [[1.0, 0.0], [0.0]], "rows: has 1 items, must have 2"),
        (0, [], "takes 1 to 6 rows of 1 to 48 effectors"),
        (0, [[1.0, 0.0]] * 7, "takes 1 to 6 rows of 1 to 48 effectors"),
        (1, [0.3, nan], "wanted: nan is not a finite number"),
        (1, [0.3, inf], "wanted: inf is not a finite number"),
        (2, ((0, 1, 2),), "levels: takes tuples of one row or two"),
        (2, ((0,), (0,)), "levels: row 0 is not there, or there twice"),
        (2, ((2,),), "levels: row 2 is not there, or there twice"),
        (3, [nan, 0.0], "start: nan is not a finite number"),
        (4, [nan, 0.0], "low: nan is not a number"),
        (5, [1.0, nan], "high: nan is not a number"),
        (5, [1.0, -2.0], "high: is below low"),
        (5, [1.0], "high: has 1 items, must have 2"),
    ],
)
def test_what_is_no_problem_is_refused(place: int, value: Any, message: str) -> None:
    assert prioritise(*GOOD) == pytest.approx([0.3, 0.4])
    with pytest.raises(ValueError, match=message):
        prioritise(*GOOD[:place], value, *GOOD[place + 1 :])


def test_what_is_no_number_is_refused() -> None:
    with pytest.raises(TypeError, match="rows: takes a list or a tuple"):
        prioritise(7, *GOOD[1:])
    with pytest.raises(TypeError):
        prioritise(GOOD[0], ["a", 0.0], *GOOD[2:])
