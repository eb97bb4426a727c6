"""What a layout attains and what it cannot exceed: closed forms, and no wrench outside of the hull."""

from __future__ import annotations

from itertools import pairwise
from math import cos, inf, pi, sin, sqrt, tan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.layout import HingeAxis, Layout, Station
from cosim.control.allocation.attainable import Hull
from cosim.control.allocation.authority import Range, Reach, compute_reach
from cosim.spec.vehicle import load_vehicle

WEIGHT = 10.0
UP = (0.0, 0.0, -1.0)


def layout(seed: int) -> Layout:
    """Three jets: two on a common hinge, one of which and the third on nozzles of their own, all askew."""
    rng = np.random.default_rng(seed)

    def unit() -> tuple[float, float, float]:
        x, y, z = rng.normal(size=3)
        size = sqrt(x * x + y * y + z * z)
        return (x / size, y / size, z / size)

    def place() -> tuple[float, float, float]:
        x, y, z = rng.uniform(-1.0, 1.0, 3)
        return (x, y, z)

    stations = [Station(place(), unit(), rng.uniform(-0.1, 0.1)) for _ in range(3)]
    turns = [HingeAxis(place(), unit(), carries=(0, 1)), HingeAxis(place(), unit(), deflects=(1,), effect=0.6)]
    last = {"carries": (2,)} if seed % 2 else {"deflects": (2,), "effect": -1.0}
    return Layout(stations, [*turns, HingeAxis(place(), unit(), deflects=(2,)), HingeAxis(place(), unit(), **last)])


@pytest.mark.parametrize("seed", range(8))
def test_the_change_by_each_hinge_is_that_of_finite_differences(seed: int) -> None:
    # with odd seeds a hinge that deflects stands between the body and one that carries
    made, rng = layout(seed), np.random.default_rng(seed)
    thrust, angles = rng.uniform(1.0, 3.0, 3), rng.uniform(-1.0, 1.0, 4)
    reach = Reach(made, [0.0] * 3, [3.0] * 3, [(-1.0, 1.0)] * 4, [0.0] * 4, WEIGHT)
    _, turns = reach._linearise_wrench(thrust, angles)
    small = 1e-5 * np.eye(4)
    for hinge in range(4):
        ends = [made.wrench(thrust.tolist(), (angles + sign * small[hinge]).tolist()) for sign in (1.0, -1.0)]
        above, below = (np.concatenate(end) for end in ends)
        assert turns[:, hinge] == pytest.approx((above - below) / 2e-5, abs=1e-8)


@given(seed=st.integers(0, 10**6))
def test_no_thrusts_and_angles_give_more_than_the_hull(seed: int) -> None:
    made, rng = layout(seed), np.random.default_rng(seed)
    if seed % 2:  # the last hinge carries what the one before it deflects: their order has to be the other way
        made = Layout(made.stations, (made.turns[0], made.turns[1], made.turns[3], made.turns[2]))
    low, high = rng.uniform(-1.0, 0.0, 4), rng.uniform(0.1, 1.0, 4)
    least, most = np.array([0.5, 0.0, 1.0]), np.array([2.0, 1.0, 3.0])
    hull = Hull.of(made, least, most, low, high)
    directions = rng.normal(size=(20, 6))
    sets = [directions @ hull.columns[:, row > 0.0] for row in hull._sets]
    bound = sum(each.max(axis=1) for each in sets)
    attained = np.full(20, -inf)
    for _ in range(40):
        thrust, angles = rng.uniform(least, most), rng.uniform(low, high)
        for ends in (thrust, np.where(thrust < thrust.mean(), least, most)):
            wrench = np.concatenate(made.wrench(ends.tolist(), angles.tolist()))
            attained = np.maximum(attained, directions @ wrench)
    assert (attained <= bound + 1e-12 * np.abs(bound)).all()


def banks(most: float, reach: float) -> Reach:
    """Two jets at y = -0.5 and 0.5 that tilt about y, up to ``reach``."""
    stations = [Station((0.0, y, 0.0), UP) for y in (-0.5, 0.5)]
    turns = [HingeAxis(station.position, (0.0, -1.0, 0.0), deflects=(n,)) for n, station in enumerate(stations)]
    return Reach(Layout(stations, turns), [0.0] * 2, [most] * 2, [(-reach, reach)] * 2, [0.0] * 2, WEIGHT)


@pytest.mark.parametrize(
    ("most", "reach", "exact"),
    [(50.0, 0.3, 0.5 * WEIGHT * tan(0.3)), (6.0, 0.9, sqrt(6.0**2 - (WEIGHT / 2.0) ** 2))],
    ids=["the range ends it", "the thrust ends it"],
)
def test_both_bounds_meet_at_the_closed_form(most: float, reach: float, exact: float) -> None:
    """Tilted by ``a`` one ahead and one back, T cos a = W / 2 each: the yaw is 2 T sin a times half a metre."""
    for sign in (1.0, -1.0):
        found = banks(most, reach).moment((0.0, 0.0, sign))
        assert found.is_exact
        assert found.lower == pytest.approx(exact, rel=1e-6)
        assert found.upper >= exact * (1.0 - 1e-9)


def test_a_range_that_is_not_convex_is_told_closer_by_cutting_it() -> None:
    """One jet on a hinge with a range to one side: pushing ahead at half the thrust is T sin a = T cos a tan a, a line
    of the hull between upright and the range's end, which nothing attains with the lift of T."""
    stations = [Station((0.0, 0.0, 0.0), UP, 1.0)]
    made = Layout(stations, [HingeAxis((0.0, 0.0, 0.0), (0.0, -1.0, 0.0), deflects=(0,))])
    # all of the thrust turned into a moment about x by the twist: of a fixed thrust only the angle is free
    low, high = np.array([0.0]), np.array([1.2])
    thrust = np.array([2.0])
    hull = Hull.of(made, thrust, thrust, low, high)
    assert hull is not None
    reach = Reach(made, [2.0], [2.0], [(0.0, 1.2)], [0.0], 2.0 * cos(0.6))
    about = reach._make_moment_objective(np.array([1.0, 0.0, 0.0]))
    goal, rows, values = about.goal, about.rows[:1], about.values[:1]
    found = reach._bounds(type(about)(goal, rows, values), 12)
    assert found.lower == pytest.approx(2.0 * sin(0.6), rel=1e-6)  # the twist's share of the thrust ahead
    assert found.is_exact


def test_a_balance_that_is_not_there_is_certain_and_one_that_was_not_found_is_not() -> None:
    quadrotor, _ = load_vehicle("quadrotor")
    fallen = compute_reach(quadrotor, [0.0] * 4, [quadrotor.mass_kg * 9.8] * 4).authority([2])
    assert fallen.cannot_hover
    assert fallen.moment is None
    assert fallen.moment_range(0) == Range(0.0, 0.0)


def test_what_has_no_bound_is_at_least_what_a_search_attains() -> None:
    """A nozzle further out than what carries the engine: its lever turns with the thrust, and no hull is known."""
    stations = [Station((0.0, y, 0.0), UP) for y in (-0.5, 0.5)]
    turns = [HingeAxis(station.position, (0.0, -1.0, 0.0), deflects=(n,)) for n, station in enumerate(stations)]
    turns += [HingeAxis(station.position, (0.0, -1.0, 0.0), carries=(n,)) for n, station in enumerate(stations)]
    reach = Reach(Layout(stations, turns), [0.0] * 2, [50.0] * 2, [(-0.15, 0.15)] * 4, [0.0] * 4, WEIGHT)
    assert not reach.is_bounded
    found = reach.moment((0.0, 0.0, 1.0))
    assert found.upper == inf
    assert found.describe() == f"at least {0.5 * WEIGHT * tan(0.3):.3g}"


def test_a_gimballed_vehicle_does_as_much_without_any_engine_that_symmetry_makes_alike() -> None:
    """The quadjet is its own mirror image in x and in y; all that differs is the order of its gimbals' axes."""
    vehicle, _ = load_vehicle("quadjet")
    reach = compute_reach(vehicle, [7.0] * 4, [100.0] * 4)
    first, second = reach.authority([1]), reach.authority([2])
    for axis in range(3):
        one, other = first.moment_range(axis), second.moment_range(axis)
        assert one.is_exact
        assert other.is_exact
        assert one.lower > 0.0
        assert max(one.lower, other.lower) <= min(one.upper, other.upper)


def test_the_section_of_a_gimballed_vehicle_has_no_notch() -> None:
    """Attained and not exceeded are within the width of a line everywhere, so that what is drawn is the set's edge."""
    vehicle, _ = load_vehicle("quadjet")
    reach = compute_reach(vehicle, [7.0] * 4, [100.0] * 4)
    angles = [2.0 * pi * n / 8 for n in range(8)]
    found = reach.section([(cos(angle), sin(angle), 0.0) for angle in angles])
    for size in found:
        assert size.upper - size.lower <= 0.01 * size.upper
    for one, other in pairwise([found[1], found[3], found[5], found[7]]):
        assert one.lower == pytest.approx(other.lower, rel=1e-3)
