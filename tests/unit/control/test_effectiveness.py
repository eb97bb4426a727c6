"""Allocation by effectiveness: what it says it gives is given, within limits and by priority, for any layout."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.layout import UP, HingeAxis, Layout, Station
from cosim.base.signals import JetHealth
from cosim.control.allocation.effectiveness import AllocationModel, EffectivenessAllocator, Effector

MASS = 5.0
TENSOR = ((0.05, -0.004, 0.002), (-0.004, 0.06, 0.001), (0.002, 0.001, 0.09))
LOW, SPAN = 0.5, 25.0
SAID = 1e-9
HINGE = Effector(-0.5, 0.5, 0.0, 0.04, 1.0)


def allocator(draw: np.random.Generator, hinges: bool = True) -> EffectivenessAllocator:
    """Four jets or more around the centre, some on hinges of any axis, leant a little."""
    count = int(draw.integers(4, 17))
    stations = []
    for n in range(count):
        angle = 2.0 * np.pi * n / count
        lean = draw.normal(size=3) * 0.15
        axis = np.array(UP) + lean
        place = (0.4 * np.cos(angle), 0.4 * np.sin(angle), float(draw.uniform(-0.1, 0.1)))
        stations.append(Station(place, tuple(axis / np.linalg.norm(axis)), float((-1) ** n * 0.03)))
    turns = []
    for _ in range(int(draw.integers(0, 5)) if hinges else 0):
        axis = draw.normal(size=3)
        moved = [int(jet) for jet in range(count) if draw.random() < 0.4]
        half = len(moved) // 2
        point, axis = draw.uniform(-0.3, 0.3, 3), axis / np.linalg.norm(axis)
        carried, deflected = tuple(moved[:half]), tuple(moved[half:])
        turns.append(HingeAxis(tuple(point.tolist()), tuple(axis.tolist()), carried, deflected, 0.8))
    layout = Layout(stations, turns)
    mass = 0.45 * count * (LOW + SPAN) / GRAVITY * 0.8
    limits, movers = [(0.05, 0.95)] * count, [HINGE] * len(turns)
    model = AllocationModel("any", layout, mass, TENSOR, LOW, SPAN, limits, [1.0] * count, movers)
    return EffectivenessAllocator(model)


def hovers(seed: int, hinges: bool = True) -> tuple[EffectivenessAllocator, np.random.Generator] | None:
    draw = np.random.default_rng(seed)
    try:
        return allocator(draw, hinges), draw
    except InputError:
        return None  # leant jets that no throttles balance


@given(st.integers(0, 10**6))
@settings(max_examples=40)
def test_the_solvers_pitch_arms_are_those_of_the_layout(seed: int) -> None:
    made = hovers(seed)
    if made is None:
        return
    block, draw = made
    layout = block._layout
    angles = draw.uniform(-0.5, 0.5, len(layout.turns)).tolist()
    axes, positions = layout.axes(angles), layout.positions(angles)
    arms = [z * axes[group][0] - x * axes[group][2] for group, (x, _, z) in zip(layout.groups, positions, strict=True)]
    assert block._solver.pitch_arms(angles) == pytest.approx(arms, abs=1e-15)


@given(st.integers(0, 10**6))
@settings(max_examples=40)
def test_what_it_gives_is_what_it_says(seed: int) -> None:
    made = hovers(seed)
    if made is None:
        return
    block, draw = made
    layout, last = block._layout, np.array(block.rest[: len(block._effectors)])
    jets = len(layout.stations)
    for _ in range(4):
        collective = block.hover + draw.normal() * 0.2
        torque = draw.normal(size=3) * draw.choice([1.0, 20.0, 200.0])
        done = block.allocate(collective, tuple(torque))
        angles = np.array(done.tilt[: len(block._effectors)])
        shares = np.array(done.throttle)
        assert shares.min() >= 0.05
        assert shares.max() <= 0.95
        assert (np.abs(angles) <= 0.5).all()
        assert (np.abs(angles - last) <= 0.04 + 1e-12).all()
        last = angles
        force, moment = layout.wrench((LOW + SPAN * shares).tolist(), angles.tolist())
        left = done.unallocated
        turned = np.linalg.solve(TENSOR, moment)
        weight = jets * SPAN
        reach = weight * sqrt(0.09 / block._mass)
        given_up = torque - (left.roll, left.pitch, left.yaw)
        assert np.abs(np.array(TENSOR) @ (turned - given_up)).max() <= SAID * reach
        assert -force[2] == pytest.approx(jets * (LOW + SPAN * (collective - left.collective)), abs=SAID * weight)


@given(st.integers(0, 10**6), st.floats(0.0, 1.0), st.floats(-100.0, 100.0))
@settings(max_examples=30)
def test_roll_and_pitch_before_lift_before_yaw(seed: int, lift: float, yaw: float) -> None:
    """Of jets that do not turn the problem is linear, and the priority exact."""
    made = hovers(seed, hinges=False)
    if made is None:
        return
    block, draw = made
    roll, pitch, _ = draw.normal(size=3) * 60.0
    tensor = np.array(TENSOR)

    def moments(collective: float, turn: float) -> tuple[np.ndarray, float]:
        # the moments asked for about roll and pitch are the same whatever is asked for about yaw
        asked = np.linalg.solve(tensor, (roll * 0.05, pitch * 0.06, turn * 0.09))
        done = block.allocate(collective, tuple(asked))
        force, moment = block._layout.wrench([LOW + SPAN * share for share in done.throttle], [])
        return np.array(moment[:2]), force[2]

    first, lifted = moments(block.hover, 0.0)
    assert moments(block.hover, yaw)[0] == pytest.approx(first, abs=1e-6)
    assert moments(block.hover, yaw)[1] == pytest.approx(lifted, abs=1e-6)
    assert moments(lift, yaw)[0] == pytest.approx(first, abs=1e-6)


def square() -> EffectivenessAllocator:
    places = [(0.3, 0.3, 0.0), (-0.3, -0.3, 0.0), (0.3, -0.3, 0.0), (-0.3, 0.3, 0.0)] * 2
    stations = [Station(place, UP, 0.03 * (-1) ** (n // 2)) for n, place in enumerate(places)]
    layout = Layout(stations)
    model = AllocationModel("square", layout, MASS, TENSOR, LOW, SPAN, [(0.05, 0.95)] * 8, [1.0] * 8, [])
    return EffectivenessAllocator(model)


def test_what_fits_is_refused_exactly_nothing_and_hover_is_even() -> None:
    block = square()
    assert block.trim(block.hover) == pytest.approx([block.hover] * 8, abs=1e-12)
    assert block.allocate(block.hover, (3.0, -2.0, 1.0)).unallocated == (0.0, 0.0, 0.0, 0.0)


def test_without_a_jet_the_others_give_the_same() -> None:
    block = square()
    health = [JetHealth()] * 8
    health[2] = JetHealth(0.0)
    assert block.replan(health)
    assert block.is_balanced
    done = block.allocate(block.hover, (2.0, 1.0, 0.0))
    assert done.unallocated == (0.0, 0.0, 0.0, 0.0)
    thrusts = [0.0 if n == 2 else LOW + SPAN * share for n, share in enumerate(done.throttle)]
    force, moment = block._layout.wrench(thrusts, [])
    assert -force[2] == pytest.approx(MASS * GRAVITY, rel=1e-9)
    assert np.linalg.solve(TENSOR, moment) == pytest.approx([2.0, 1.0, 0.0], abs=1e-8)
    block.reset()
    assert block.allocate(block.hover, (0.0, 0.0, 0.0)).throttle == pytest.approx([block.hover] * 8, abs=1e-12)


def test_a_surface_gives_more_the_faster_the_air() -> None:
    """Pitch by an elevator as soon as there is air, by its effect times the pressure, and jets give the rest."""
    places = [(0.3, 0.3, 0.0), (-0.3, -0.3, 0.0), (0.3, -0.3, 0.0), (-0.3, 0.3, 0.0)]
    layout = Layout([Station(place, UP, 0.03 * (-1) ** (n // 2)) for n, place in enumerate(places)])
    elevator = Effector(-1.0, 1.0, 0.0, 1.0, 1e-3, (0.0, 0.0, 0.0, 0.0, -0.01, 0.0))
    tensor = ((0.05, 0.0, 0.0), (0.0, 0.06, 0.0), (0.0, 0.0, 0.09))
    model = AllocationModel("w", layout, 5.0, tensor, LOW, SPAN, [(0.05, 0.95)] * 4, [1.0] * 4, [elevator])
    block = EffectivenessAllocator(model)
    assert block.allocate(block.hover, (0.0, 1.0, 0.0)).tilt == (0.0,)
    block.pressure = 200.0
    done = block.allocate(block.hover, (0.0, 1.0, 0.0))
    of_jets = block._layout.wrench([LOW + SPAN * share for share in done.throttle], [])[1][1]
    of_surface = -0.01 * 200.0 * done.tilt[0]
    assert of_surface == pytest.approx(0.06, rel=0.01)  # the cheaper of the two gives nearly all
    assert of_jets + of_surface == pytest.approx(0.06, abs=1e-9)


def test_a_layout_that_nothing_balances_is_refused_with_what_is_missing() -> None:
    stations = [Station((0.3 + 0.1 * n, 0.0, 0.0), UP) for n in range(4)]
    effectors = AllocationModel("nose", Layout(stations), MASS, TENSOR, LOW, SPAN, [(0.0, 1.0)] * 4, [1.0] * 4, [])
    with pytest.raises(InputError, match=r"in hover they leave 47 N of lift that nothing balances"):
        EffectivenessAllocator(effectors)
