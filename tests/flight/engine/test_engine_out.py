"""One engine out: what it costs in height at least, and with what the vehicle is held."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, radians
from typing import NamedTuple

import numpy as np
import pytest
from places import DESIGNS

from cosim import fly
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.engine import make_bank
from cosim.engine.wrappers import EngineChain
from cosim.simulation.build import build
from cosim.simulation.controllers.controller_file import read_controller
from cosim.simulation.engine_reference import make_engine_reference
from cosim.simulation.step import Simulation
from cosim.spec.scenario import FlameOut, Scenario
from cosim.spec.vehicle import load_vehicle
from hexjet_prove.surveys.faults import judge
from hexjet_prove.surveys.survey import held_formula, load_subject, measure_flight

STEP_S = 0.004
HOME = {
    "edf": "hexjet",
    "edf-as-flown": "hexjet",
    "turbojet": "hexjet",
    "turbine-20": "hexjet",
    "turbine-100": "hexjet-100",
    "p220": "hexjet-p220",
    "turbine-220": "hexjet-p220",
}
# What the monitor does: plan around the engine, shut its opposite off too, and that found at half the threshold.
PLANNED = {"shut_opposite": False, "threshold": 0.2, "catch": False}
OPPOSITE = {"shut_opposite": True, "threshold": 0.2, "catch": False}
SOONER = {"shut_opposite": True, "threshold": 0.1, "catch": True}


def flight(engine: str, jet: int, monitor: dict[str, object]) -> Scenario:
    """Return a calm hover at 30 m with the gains designed for the engine, one engine out after a second."""
    file = read_controller(DESIGNS / f"{engine}.toml")
    return (
        load_subject(HOME[engine], engine)
        .scenario(
            "engine-out",
            file.controller,
            30.0,
            11.0,
            vehicle=file.vehicle,
            controller_parameters=file.controller_parameters,
            step_s=STEP_S,
            fault=[{"kind": "flame_out", "start_s": 1.0, "jet": jet}],
        )
        .replace(vehicle={"control": {"monitor": monitor}})
    )


@dataclass(frozen=True)
class Courses:
    """Thrust of an engine from hover: at full throttle, without its fire, and shut off at once from least throttle [N]."""

    up: list[float]
    out: list[float]
    shut: list[float]


def measure_courses(simulation: Simulation, seconds: float = 4.0) -> Courses:
    """Step the engine of a built flight, all of whose engines are alike."""
    spec, limits = simulation.engine, simulation.vehicle.control.allocation
    count = len(simulation.vehicle.jets)
    hover, lowest, highest = (
        simulation.cascade.thrust_map.throttle((level,) * count)[0]
        for level in (simulation.cascade.allocator.hover, limits.throttle_min, limits.throttle_max)
    )

    def course(throttle: float, out: bool = False, shut: bool = False) -> list[float]:
        with make_bank([spec], STEP_S) as bank:
            engines = EngineChain(bank, [spec.flame_out], lambda _: make_engine_reference(spec, STEP_S).lag, STEP_S)
            engines.reset(hover)
            if out:
                engines.begin_fault(FlameOut(kind="flame_out", start_s=0.0, jet=[1]))
            if shut:
                engines.switch_engine(0, False)
            return [engines.step(k, (throttle,)).thrust[0] for k in range(round(seconds / STEP_S))]

    return Courses(course(highest), course(hover, out=True), course(lowest, shut=True))


def test_what_the_flame_out_costs_in_height_at_least() -> None:
    """The figure that the scenario's bound of the height rests on: level, and full throttle once it is found."""
    scenario = Scenario.load("fault-flame-out-full-scale")
    with build(scenario) as simulation:
        mass = simulation.vehicle.mass_kg
        courses = measure_courses(simulation)
    weight, found = mass * GRAVITY, round(0.076 / STEP_S)
    waiting = [weight / 6.0] * found
    thrust = [
        4.0 * u + a + b for u, a, b in zip(waiting + courses.up, courses.out, waiting + courses.out, strict=False)
    ]
    fallen = -np.cumsum(np.cumsum(np.array(thrust) - weight)) * STEP_S**2 / mass
    assert fallen[-1] < fallen.max() == pytest.approx(2.6, abs=0.05)
    assert scenario.limits.height_error_m == pytest.approx(4.0 * 2.6, rel=0.05)


class Fall(NamedTuple):
    """The least height that is lost, m; the fastest sinking; that at which a given height was fallen, 0: it was not."""

    lost_m: float
    sink_m_s: float
    touch_m_s: float


def least_fall(courses: Courses, mass: float, jets: int, after: int = 0, height: float = inf) -> Fall:
    """What no throttles avoid of a fall with one jet out and another, the opposite one, shut off with it.

    ``m v' = m g - sum T_i`` with the four others at full throttle from that instant on, or from step ``after``,
    before which no throttle moves, and nothing of their thrust lost to lean or to holding the attitude.
    """
    hover = mass * GRAVITY / jets
    up = [hover] * after + courses.up
    falling = [hover] * after + courses.shut
    sink = lost = fastest = touch = 0.0
    for k in range(len(courses.up)):
        thrust = courses.out[k] + falling[k] + (jets - 2) * up[k]
        before = sink
        sink += STEP_S * (GRAVITY - thrust / mass)
        if sink < 0.0:
            return Fall(lost, fastest, touch)
        above = lost < height
        lost += 0.5 * STEP_S * (before + sink)
        fastest = max(fastest, sink)
        touch = sink if above and lost >= height else touch
    raise ValueError("the engines were not followed for long enough to stop the fall")


def test_a_fall_under_engines_that_jump_is_the_closed_form() -> None:
    """Nothing for a tenth of a second, and then twice the weight: it stops in as much height as it fell freely."""
    vehicle, _ = load_vehicle("hexjet")
    n, count = 25, 500
    hover = vehicle.mass_kg * GRAVITY / 6.0
    courses = Courses(up=[0.0] * n + [3.0 * hover] * (count - n), out=[0.0] * count, shut=[0.0] * count)
    found = least_fall(courses, vehicle.mass_kg, 6, height=0.08)
    sink = GRAVITY * n * STEP_S
    assert found.touch_m_s == pytest.approx((2.0 * GRAVITY * (2.0 * sink**2 / 2.0 / GRAVITY - 0.08)) ** 0.5, rel=0.05)
    assert found.sink_m_s == pytest.approx(sink, rel=1e-9)
    assert found.lost_m == pytest.approx(sink**2 / (2.0 * GRAVITY) * 2.0, rel=0.01)


def flown(engine: str, jet: int, monitor: dict[str, object]) -> tuple[str, float]:
    """Return the verdict of a flight and the largest lean [deg] after the engine is out."""
    scenario = flight(engine, jet, monitor)
    run = fly(scenario.replace(require=[{"name": "held", "formula": held_formula(scenario.duration_s)}]))
    margin = next(each.margin for each in run.summary.requirements if each.name == "held")
    return judge(run.outcome, margin), measure_flight(run.log, 250)[0]


@pytest.mark.parametrize("engine", ["p220", "turbine-20", "turbine-100", "turbine-220"])
def test_a_vehicle_on_turbines_is_lost_with_one_engine_out(engine: str) -> None:
    assert flown(engine, 5, PLANNED)[0] == "lost"


@pytest.mark.parametrize(
    ("engine", "jets"), [("p220", (1, 5)), ("turbojet", (1, 5)), ("turbine-20", (5,)), ("turbine-100", (1, 5))]
)
def test_with_the_opposite_engine_shut_off_it_is_held(engine: str, jets: tuple[int, ...]) -> None:
    """By the gains of the healthy vehicle.  The smallest turbine is lost at its corners: docs/faults.md."""
    limit = load_vehicle(HOME[engine])[0].limits.tilt_deg
    for jet in jets:
        verdict, lean = flown(engine, jet, OPPOSITE)
        assert verdict == "held"
        assert lean < limit


def test_the_turbine_whose_thrust_comes_late_needs_it_found_sooner() -> None:
    assert flown("turbine-220", 5, OPPOSITE)[0] == "lost"
    assert flown("turbine-220", 5, SOONER)[0] != "lost"


@pytest.mark.parametrize(("engine", "means"), [("turbine-20", OPPOSITE), ("turbine-220", SOONER)])
def test_at_a_corner_it_is_the_height_hold_that_loses_the_slowest_turbines(
    engine: str, means: dict[str, object]
) -> None:
    """The same gains with the collective left at that of hover come back to level."""
    for jet in (1, 2, 3, 4):
        scenario = flight(engine, jet, means)
        with build(scenario) as simulation:
            hover = simulation.cascade.allocator.hover
        steady = [{"kind": "step", "signal": "collective", "start_s": 1.0, "amplitude": hover}]
        run = fly(scenario.replace(command=steady, duration_s=6.0))
        assert run.outcome == "completed", run.reason
        last = round(1.0 / STEP_S)
        assert max(abs(run.log[angle][-last:]).max() for angle in ("roll_rad", "pitch_rad")) < radians(5.0)
        assert run.log["velocity_down_m_s"][-1] > 1.0  # it pays with height
    if engine == "turbine-20":
        refused = fly(flight(engine, 1, means)).log["refused_roll"]
        assert not refused[round(1.3 / STEP_S) :].any()


def test_the_opposite_engine_goes_with_the_first_that_is_lost_and_with_no_other() -> None:
    scenario = flight("edf-as-flown", 3, OPPOSITE)
    later = {"kind": "flame_out", "start_s": 1.6, "jet": 5}
    log = fly(scenario.replace(duration_s=2.0, fault=[scenario.fault[0].model_dump(mode="json"), later])).log
    assert [log[f"health_{jet}"][-1] for jet in range(1, 7)] == [1.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    assert log["thrust_4_N"][-1] == 0.0
    assert not log["fault_jet_4"].any()  # nothing is wrong with it


def test_a_weak_engine_takes_none_along() -> None:
    weak = {"kind": "thrust_loss", "start_s": 1.0, "jet": 3, "share": 0.5}
    log = fly(flight("edf-as-flown", 3, OPPOSITE).replace(duration_s=1.4, fault=[weak])).log
    assert 0.0 < log["health_3"][-1] < 1.0
    assert log["health_4"][-1] == 1.0


def test_a_vehicle_without_opposite_jets_is_refused() -> None:
    with pytest.raises(InputError, match=r"hexjet: control\.monitor\.shut_opposite: no jet stands opposite jet 1"):
        build(
            Scenario(name="short", duration_s=1.0).replace(
                vehicle={"control": {"monitor": {"shut_opposite": True}}, "jets": {"0": {"position_m": {"0": 0.2}}}}
            )
        )
