"""Allocation around engines that are lost, weak or stuck, checked by r x F on the geometry of the aircraft."""

from __future__ import annotations

import itertools
from math import cos, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.signals import ZERO3, Actuation, JetHealth
from cosim.control.allocation.allocation import RotorAllocator, TiltAllocator
from cosim.control.allocation.reallocation import command_to_torque, plan
from cosim.spec.vehicle import load_vehicle

HEXJET = load_vehicle("hexjet")[0]
QUADROTOR = load_vehicle("quadrotor")[0]
JETS, LIMITS = HEXJET.jets, HEXJET.control.allocation
HOVER = 0.4515
LOST, WELL = JetHealth(gain=0.0), JetHealth()
RANGE = HEXJET.servo.range_rad


def allocator(hover: float = HOVER, idle: float = 0.0) -> TiltAllocator:
    return TiltAllocator(JETS, LIMITS, RANGE, hover, idle)


@pytest.fixture
def tool() -> TiltAllocator:
    return allocator()


def without(*lost: int) -> list[JetHealth]:
    return [LOST if jet in lost else WELL for jet in range(1, 7)]


def wrench(shares: list[float], tilt: tuple[float, float]) -> np.ndarray:
    """Force and moment, body, in shares: the sum of every jet's thrust and of r x F."""
    total = np.zeros(6)
    for jet, thrust in zip(JETS, shares, strict=True):
        angle = tilt[0] if jet.servo == "left" else tilt[1]
        force = thrust * np.array([sin(angle), 0.0, -cos(angle)])
        total += np.concatenate([force, np.cross(jet.position_m, force)])
    return total


def delivered(given: Actuation, health: list[JetHealth], idle: float) -> list[float]:
    return [each.gain * (idle + u) + each.fixed for each, u in zip(health, given.throttle, strict=True)]


def one_ill(draw: st.DrawFn) -> list[JetHealth]:
    health = [WELL] * 6
    ill = draw(
        st.one_of(
            st.just(LOST),
            st.builds(lambda gain: JetHealth(gain=gain), st.floats(0.2, 0.99)),
            st.builds(lambda fixed: JetHealth(0.0, fixed, fixed), st.floats(0.05, 0.9)),
        )
    )
    health[draw(st.integers(0, 5))] = ill
    return health


ill_health = st.composite(one_ill)()
commands = st.tuples(st.floats(0.0, 1.0), st.floats(-0.6, 0.6), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
# none, or one that the linear programs, which are solved to 1e-7, can tell from none
idle_shares = st.just(0.0) | st.floats(1e-4, 0.08)


@settings(max_examples=80)
@given(ill_health, st.lists(commands, min_size=1, max_size=4), st.floats(0.35, 0.5), idle_shares)
def test_what_is_achieved_is_what_healthy_jets_would_give(health: list, asked: list, hover: float, idle: float) -> None:
    """Achieved, which is requested minus refused, and no throttle outside its limits."""
    tool = allocator(hover, idle)
    assert tool.replan(health)
    for collective, roll, pitch, yaw in asked:
        out = tool.allocate(collective, (roll, pitch, yaw))
        for u, each in zip(out.throttle, health, strict=True):
            assert LIMITS.throttle_min <= u <= LIMITS.throttle_max if each.gain > 0.0 else u == each.command
        assert max(map(abs, out.tilt)) <= RANGE + 1e-12
        c, r = collective - out.unallocated.collective, roll - out.unallocated.roll
        ideal = [idle + c + (r if jet.servo == "left" else -r) for jet in JETS]
        got, want = wrench(delivered(out, health, idle), out.tilt), wrench(ideal, out.tilt)
        # with the banks tilted apart, one bank's pitch moment no longer cancels the other's to second order
        apart = abs(cos(out.tilt[0]) - cos(out.tilt[1]))
        assert got[[0, 1, 2, 3, 5]] == pytest.approx(want[[0, 1, 2, 3, 5]], abs=1e-9)
        assert abs(got[4] - want[4]) <= 1e-9 + apart * 3 * 0.13


@settings(max_examples=30)
@given(ill_health, st.floats(0.4, 0.5), st.floats(-0.02, 0.02), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_small_commands_about_hover_are_refused_nothing(
    health: list[JetHealth], collective: float, roll: float, pitch: float, yaw: float
) -> None:
    """Exactly nothing: the integrals stop on any refusal."""
    tool = allocator(0.45)
    assert tool.replan(health)
    assert tool.allocate(collective, (roll, pitch, yaw)).unallocated == (0.0, 0.0, 0.0, 0.0)


def test_planning_for_healthy_engines_changes_nothing() -> None:
    usual, planned = allocator(), allocator()
    assert planned.replan([WELL] * 6)
    for roll in (-0.1, 0.0, 0.05):
        want, got = usual.allocate(0.5, (roll, 0.1, -0.05)), planned.allocate(0.5, (roll, 0.1, -0.05))
        ours, theirs = (wrench(delivered(each, [WELL] * 6, 0.0), each.tilt) for each in (got, want))
        assert ours == pytest.approx(theirs, abs=1e-9)
        assert got.tilt == pytest.approx(want.tilt, abs=1e-12)


def test_a_reset_forgets_the_plan(tool: TiltAllocator) -> None:
    before = tool.allocate(0.5, (0.05, 0.1, -0.05))
    assert tool.replan(without(3))
    assert tool.allocate(0.5, (0.05, 0.1, -0.05)) != before
    tool.reset()
    assert tool.allocate(0.5, (0.05, 0.1, -0.05)) == before


def test_roll_is_kept_before_collective(tool: TiltAllocator) -> None:
    assert tool.replan(without(5))
    # one bank of two jets: full thrust there and the least roll for it
    out = tool.allocate(0.95, (0.2, 0.0, 0.0))
    assert out.unallocated.roll == 0.0
    assert out.unallocated.collective > 0.2


@pytest.mark.parametrize(
    ("lost", "thrust"),
    [
        # the two others on its side at full thrust, the other side the same
        ((5,), 4.0),
        # rear right is balanced by front left over rear left, which gives at least its least throttle
        ((1,), 2 * (1.0 + 0.95)),
        ((5, 6), 4.0),
        ((1, 2), 4.0),
        # front right and middle left gone: rear right has to be balanced by front left
        ((1, 6), 3.0),
        ((1, 4), 2.0),
    ],
)
def test_asked_for_everything_it_gives_what_the_engines_left_can(
    tool: TiltAllocator, lost: tuple[int, ...], thrust: float
) -> None:
    """The engines that the plan keeps for roll lift too where roll does not ask for them: to the last of the thrust.
    It gave 15 % more than hover with jets 1 and 2 lost, where 48 % are there: a fall of 10 m was not stopped."""
    assert tool.replan(without(*lost))
    out = tool.allocate(1.0, (0.0, 0.0, 0.0))
    assert (1.0 - out.unallocated.collective) / HOVER == pytest.approx(thrust / (6 * HOVER), abs=1e-7)
    assert wrench(delivered(out, without(*lost), 0.0), out.tilt)[3:] == pytest.approx([0, 0, 0], abs=1e-9)


def test_what_roll_asks_for_is_taken_from_the_rest_of_the_collective(tool: TiltAllocator) -> None:
    """Jets 5 and 6 alone turn it without 1 and 2: the half of their difference is what they do not lift."""
    assert tool.replan(without(1, 2))
    level, rolling = (tool.allocate(1.0, (roll, 0.0, 0.0)) for roll in (0.0, 0.05))
    assert level.throttle == pytest.approx((0.0, 0.0, 1.0, 1.0, 1.0, 1.0), abs=1e-9)
    assert rolling.unallocated.roll == 0.0
    # a roll of 0.05 is 0.3 on three jets a side, here on one: 0.15 each way about their mean
    assert rolling.throttle[5] - rolling.throttle[4] == pytest.approx(0.3, abs=1e-9)
    assert max(rolling.throttle) == pytest.approx(1.0, abs=1e-12)
    assert rolling.unallocated.collective - level.unallocated.collective == pytest.approx(0.3 / 6.0, abs=1e-9)


def test_what_lifts_beyond_the_plan_comes_no_faster_than_the_engines_do() -> None:
    """Up by ``lift`` each time, down at once: without the bound turbines lost their roll while all of them sped up."""
    tool = TiltAllocator(JETS, LIMITS, RANGE, HOVER, lift=0.01)
    assert tool.replan(without(1, 2))
    throttles = [tool.allocate(1.0, ZERO3).throttle for _ in range(80)]
    steps = [b[4] - a[4] for a, b in itertools.pairwise(throttles)]
    assert steps[:40] == pytest.approx([0.01] * 40, abs=1e-12)
    assert throttles[-1][2:] == pytest.approx((1.0,) * 4, abs=1e-12)
    plain = tool.allocate(HOVER, ZERO3)
    assert plain.unallocated.collective == 0.0
    assert tool.allocate(1.0, ZERO3).throttle == throttles[0]


def test_a_stuck_jet_is_balanced_by_the_others() -> None:
    health = [WELL, WELL, JetHealth(0.0, 0.7, 0.7), WELL, WELL, WELL]
    tool = allocator()
    assert tool.replan(health)
    out = tool.allocate(HOVER, (0.0, 0.0, 0.0))
    assert out.throttle[2] == 0.7
    assert wrench(delivered(out, health, 0.0), out.tilt) == pytest.approx([0, 0, -6 * HOVER, 0, 0, 0], abs=1e-9)


def test_a_jet_that_runs_away_on_a_light_vehicle_leaves_room_for_less() -> None:
    """0.875 of the 1.125 that its side gives in hover: the reserve for height is given up before the plan is."""
    tool = allocator(hover=0.375)
    assert tool.replan([JetHealth(0.0, 0.875, 0.875), *[WELL] * 5])
    assert tool.allocate(0.375, (0.0, 0.0, 0.0)).unallocated == (0.0, 0.0, 0.0, 0.0)


def test_two_lost_on_one_side_keep_the_vehicle_level_and_cannot_hold_it() -> None:
    """Jets 1 and 4: the middle one is all that is left on the right, so that twice its thrust is all there is."""
    health = without(1, 4)
    tool = allocator()
    assert tool.replan(health)
    out = tool.allocate(HOVER, (0.0, 0.0, 0.0))
    assert out.unallocated.collective == pytest.approx(HOVER - 2.0 / 6.0, abs=1e-9)
    assert wrench(delivered(out, health, 0.0), out.tilt)[3:] == pytest.approx([0, 0, 0], abs=1e-9)


@pytest.mark.parametrize("lost", [(1, 3), (2, 4), (1, 4, 5)])
def test_what_has_no_balance_is_not_planned(tool: TiltAllocator, lost: tuple[int, ...]) -> None:
    before = tool.allocate(HOVER, (0.01, 0.0, 0.0))
    assert not tool.replan(without(*lost))
    assert tool.allocate(HOVER, (0.01, 0.0, 0.0)) == before


def test_no_corner_of_the_plan_leaves_the_limits() -> None:
    for lost in range(1, 7):
        found = plan(JETS, LIMITS, HOVER, 0.0, without(lost))
        assert min(-found.roll_range[0], found.roll_range[1]) > 0.1
        assert found.pitch == (0.0, 0.0, 0.0, 0.0)


def test_a_quadrotor_without_a_rotor_has_no_level_hover() -> None:
    tool = RotorAllocator(QUADROTOR.jets, QUADROTOR.control.allocation, 0.5)
    assert not tool.replan([LOST, WELL, WELL, WELL])


def test_the_inverse_gives_back_what_the_allocation_was_told() -> None:
    class Banks:
        left, pitch_sign = (True, True, False, False), -1.0

    wanted = [[0.25, 0.25, -0.25, -0.25, 0.0, 0.0], [0.0] * 4 + [-0.5, -0.5], [0.0] * 4 + [0.5, -0.5]]
    assert command_to_torque(4, Banks()) == wanted
