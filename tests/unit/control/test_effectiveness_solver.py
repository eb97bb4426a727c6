"""The wrench, its change and Newton's method in C: against the layout in Python, differences, and another optimiser."""

from __future__ import annotations

from math import nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from cosim.base.layout import UP, HingeAxis, Layout, Station
from cosim.base.signals import Vector3
from cosim.control.allocation._effectiveness import Solver, prioritise

ELEVON = (0.0, 0.004, -0.01, 0.003, -0.006, 0.001)  # force and moment per unit and Pa
WEIGHT, EXACT = 60.0, 1e-10
LEVELS: list[tuple[int, ...]] = [(0, 1), (2,), (3,)]


def unit(draw: np.random.Generator, about: Vector3 = (0.0, 0.0, 0.0), spread: float = 1.0) -> Vector3:
    axis = np.array(about) + spread * draw.normal(size=3)
    x, y, z = (axis / np.linalg.norm(axis)).tolist()
    return (x, y, z)


def place(draw: np.random.Generator) -> Vector3:
    x, y, z = draw.uniform(-0.4, 0.4, 3).tolist()
    return (x, y, z)


class Drawn:
    """A vehicle of any stations, hinges in chains and one surface; every mover of the range -1 to 1."""

    def __init__(self, seed: int) -> None:
        self.draw = draw = np.random.default_rng(seed)
        self.jets = jets = int(draw.integers(3, 7))
        stations = [Station(place(draw), unit(draw, UP, 0.2), float(draw.normal() * 0.02)) for _ in range(jets)]
        turns = []
        for _ in range(int(draw.integers(1, 5))):
            jet = draw.permutation(jets).tolist()
            effect = float(draw.choice([1.0, 0.7]))
            turns.append(HingeAxis(place(draw), unit(draw), tuple(jet[:2]), tuple(jet[2:3]), effect))
        self.layout = Layout(stations, turns)
        self.count = jets + len(turns) + 1
        # by their ranges: N, and rad
        self.scales = [*draw.uniform(10.0, 30.0, jets).tolist(), *draw.uniform(0.5, 2.0, self.count - jets).tolist()]
        self.norms = draw.uniform(0.01, 0.5, 6).tolist()
        fx, fy, fz, mx, my, mz = ELEVON
        jets_on_chains = [
            (each.position, each.axis, each.twist, [(n, e, jet in turns[n].carries) for n, e in chain])
            for jet, (each, chain) in enumerate(zip(stations, self.layout.chains, strict=True))
        ]
        hinges = [(turn.point, turn.axis, -1.0, 1.0, 0.02, 0.1) for turn in turns]
        surfaces = [((mx, my, -fz, mz, fx, fy), -1.0, 1.0, 0.02, 0.1)]
        self.solver = Solver(jets_on_chains, hinges, surfaces, self.scales, self.norms, WEIGHT, EXACT)
        self.movers = len(turns) + 1

    def at(self) -> list[float]:
        thrusts: list[float] = self.draw.uniform(5.0, 20.0, self.jets).tolist()
        return [*thrusts, *self.draw.uniform(-0.6, 0.6, self.movers).tolist()]

    def wrench(self, at: Any, pressure: float) -> np.ndarray:
        """As :class:`cosim.base.layout.Layout` has it, which moves the vehicle."""
        values = np.asarray(at).tolist()
        jets, angles = values[: self.jets], values[self.jets : -1]
        (fx, fy, fz), (mx, my, mz) = self.layout.wrench(jets, angles)
        ax, ay, az, bx, by, bz = (pressure * values[-1] * each for each in ELEVON)
        return np.array([mx + bx, my + by, -fz - az, mz + bz, fx + ax, fy + ay])

    def solve(self, wanted: Any, last: list[float], **changed: Any) -> tuple[np.ndarray, np.ndarray]:
        asked: dict[str, Any] = {"wanted": np.asarray(wanted).tolist(), "lift": WEIGHT, "pressure": 100.0, "passes": 60}
        asked |= {"rated": False, "hurried": False, "last": last, "ends": [(0.0, 40.0)] * self.jets, "levels": LEVELS}
        asked |= {"preferred": [WEIGHT / self.jets] * self.jets, "reach": [(-1.0, 1.0)] * self.movers}
        asked |= {"stand": [0.0] * self.movers}
        found, missing = self.solver.solve(*(asked | changed).values())
        return np.array(found), np.array(missing)


@given(st.integers(0, 10**6), st.sampled_from([0.0, 300.0]))
@settings(max_examples=60)
def test_the_wrench_is_that_of_the_layout_and_its_change_that_of_small_steps(seed: int, pressure: float) -> None:
    drawn = Drawn(seed)
    at = drawn.at()
    total, rows = drawn.solver.linear(at, pressure)
    assert total == pytest.approx(drawn.wrench(at, pressure), rel=1e-13, abs=1e-12)
    for j, scale in enumerate(drawn.scales):
        small = 1e-6
        more, less = np.array(at), np.array(at)
        more[j] += small
        less[j] -= small
        slope = (drawn.wrench(more, pressure) - drawn.wrench(less, pressure)) / (2.0 * small)
        assert [row[j] for row in rows] == pytest.approx(slope * scale * np.array(drawn.norms), rel=1e-6, abs=1e-5)


@given(st.integers(0, 10**6))
@settings(max_examples=40)
def test_where_no_limit_is_met_it_is_the_nearest_solution_as_another_optimiser_finds_it(seed: int) -> None:
    """Lagrange's conditions of the least squared distance, scaled, to where effectors are left."""
    drawn = Drawn(seed)
    near = np.array([WEIGHT / drawn.jets] * drawn.jets + [0.0] * drawn.movers)
    away = np.array([0.3] * drawn.jets + [0.01] * drawn.movers) * drawn.draw.normal(size=drawn.count)
    wanted = drawn.wrench(near + away, 100.0)
    free = {"ends": [(-1e3, 1e3)] * drawn.jets, "lift": WEIGHT}
    found, missing = drawn.solve(wanted, near.tolist(), **free)
    scales = np.array(drawn.scales)
    given, rows = drawn.solver.linear(found.tolist(), 100.0)
    held, distance = np.array(rows[:4]), (found - near) / scales
    # on the way, level by level, no hinge may go further than a line stands for
    targets = ((wanted - given) * drawn.norms)[:4] + held @ distance
    corners = [np.linalg.pinv(held[:count]) @ targets[:count] * scales for count in (2, 3, 4)]
    if max(np.abs(corner[drawn.jets :]).max() for corner in corners) > 0.09:
        return
    assert np.abs(missing[:4] * drawn.norms[:4]).max() <= EXACT
    multipliers = np.linalg.lstsq(held.T, distance, rcond=None)[0]
    assert held.T @ multipliers == pytest.approx(distance, abs=1e-6)
    other = minimize(
        lambda x: float(((x - near / scales) ** 2).sum()), found / scales, method="SLSQP",
        constraints={"type": "eq", "fun": lambda x: (drawn.wrench(x * scales, 100.0) - wanted)[:4] * drawn.norms[:4]},
        options={"ftol": 1e-14, "maxiter": 200},
    )  # fmt: skip
    if other.success:
        assert other.fun == pytest.approx(float(distance @ distance), rel=1e-5, abs=1e-9)


@given(st.integers(0, 10**6))
@settings(max_examples=40)
def test_what_is_out_of_reach_leaves_all_within_limits_and_rates_and_says_what_is_missing(seed: int) -> None:
    drawn = Drawn(seed)
    last = drawn.at()
    ends = [(2.0, 25.0)] * drawn.jets
    ends[0] = (0.0, 0.0)  # an engine is out
    hurry = bool(drawn.draw.random() < 0.5)
    wanted = 1e4 * drawn.draw.normal(size=6)
    found, missing = drawn.solve(wanted, last, ends=ends, rated=True, hurried=hurry, passes=6)
    low, high = np.array(ends).T
    assert (found[: drawn.jets] >= low - 1e-12).all()
    assert (found[: drawn.jets] <= high + 1e-12).all()
    went = np.abs(found - last)[drawn.jets :]
    assert went.max() <= (0.12 if hurry else 0.02) + 1e-12
    assert missing == pytest.approx(wanted - drawn.wrench(found, 100.0), rel=1e-12, abs=1e-9)


def test_what_is_asked_twice_is_answered_alike() -> None:
    """No state of its own: the same bits from another object, and from the same one later."""
    first, second = Drawn(7), Drawn(7)
    last = first.at()
    wanted = first.wrench(last, 100.0) + 1.0
    answers = [drawn.solve(wanted, last)[0].tobytes() for drawn in (first, second, first)]
    assert len(set(answers)) == 1


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("wanted", [nan] * 6, "wanted: nan is not a finite number"),
        ("wanted", [1.0] * 5, "wanted: has 5 items, must have 6"),
        ("lift", nan, "lift: nan is not a finite number"),
        ("last", [nan] * 7, "last: "),
        ("levels", [(6,)], "levels: row 6 is not there"),
        ("levels", [(0,)] * 2, "levels: row 0 is not there, or there twice"),
        ("preferred", [], "preferred: has 0 items"),
    ],
)
def test_what_is_no_number_is_refused(name: str, value: Any, message: str) -> None:
    drawn = Drawn(3)
    with pytest.raises(ValueError, match=message):
        drawn.solve(**({"wanted": [0.0] * 6, "last": drawn.at()} | {name: value}))


def test_a_vehicle_that_is_none_is_refused() -> None:
    station: tuple[Any, ...] = ((0.0, 0.0, 0.0), UP, 0.0, [])
    hinge: tuple[Any, ...] = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), -1.0, 1.0, 0.1, 0.0)
    rest = [1.0] * 6, WEIGHT, EXACT
    cases: list[tuple[str, tuple[Any, ...]]] = [
        ("takes 1 to 16 jets", ([], [], [], [], *rest)),
        ("takes 1 to 16 jets", ([station] * 17, [], [], [1.0] * 17, *rest)),
        ("32 hinges and surfaces at most", ([station], [hinge] * 33, [], [1.0] * 34, *rest)),
        ("scales: must be greater than 0", ([station], [], [], [0.0], *rest)),
        ("must be above", ([station], [(*hinge[:2], 1.0, 1.0, 0.1, 0.0)], [], [1.0] * 2, *rest)),
        ("there is no hinge 0", ([(*station[:3], [(0, 1.0, True)])], [], [], [1.0], *rest)),
        ("carries by another angle", ([(*station[:3], [(0, 0.5, True)])], [hinge], [], [1.0] * 2, *rest)),
        ("place: nan is not a finite number", ([((nan, 0.0, 0.0), UP, 0.0, [])], [], [], [1.0], *rest)),
    ]
    for message, case in cases:
        with pytest.raises(ValueError, match=message):
            Solver(*case)


def test_a_number_that_changes_the_list_it_stands_in_is_refused() -> None:
    """Reading it would run its code while the list is gone through."""
    rows: list[Any] = [[1.0, 0.0, 0.0]]

    class Number:
        def __float__(self) -> float:
            rows[0].clear()
            return 1.0

        __index__ = None

    rows[0][0] = Number()
    with pytest.raises(TypeError, match="rows: takes numbers, not Number"):
        prioritise(rows, [1.0], [(0,)], [0.0] * 3, [0.0] * 3, [1.0] * 3)
    assert len(rows[0]) == 3
    with pytest.raises(TypeError, match="levels: rows are whole numbers"):
        prioritise([[1.0, 0.0, 0.0]], [1.0], [(Number(),)], [0.0] * 3, [0.0] * 3, [1.0] * 3)
    assert prioritise([[np.float64(1.0), 1, True]], [1], [(0,)], [0.0] * 3, [0.0] * 3, [1.0] * 3)
