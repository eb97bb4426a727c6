"""One engine out in hover: the bound against exact answers and six degrees of freedom, the verdicts, the command."""

from __future__ import annotations

import json
from dataclasses import replace
from math import acos, cos, degrees, inf, radians
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from command_tools import Hexjet
from failsafe_flights import Flight as Hover
from places import DESIGNS, DOCS
from stated_figures import stated

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.frames import to_euler
from cosim.base.signals import Disturbance
from cosim.campaign.surveys.engine_out import (
    MEANS,
    NOT_A_JET,
    OPPOSITE,
    PAGES,
    PLANNED,
    SOONER,
    TABLES,
    _fly,
    _scenario,
    engine_out,
    find_obstacle,
    rows,
    write_pages,
)
from cosim.campaign.surveys.lean_bound import (
    STEP_S,
    RollAxis,
    ThrustCourses,
    find_opposite,
    make_roll_axis,
    measure_courses,
)
from cosim.campaign.surveys.survey import load_subject
from cosim.control.autopilot import requests as rq
from cosim.engine import EngineBank, list_engine_names, load_engine
from cosim.flight import fly
from cosim.results.report.marks import page_parts
from cosim.simulation.build import build
from cosim.simulation.controllers.controller_file import read_controller
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle
from cosim.vehicle.servo import TiltServo

HOME = {
    "edf": "hexjet",
    "edf-as-flown": "hexjet",
    "turbojet": "hexjet",
    "turbine-20": "hexjet",
    "turbine-100": "hexjet-100",
    "p220": "hexjet-p220",
    "turbine-220": "hexjet-p220",
}


def flight(engine: str, jet: int, means: Any) -> Scenario:
    return _scenario(load_subject(HOME[engine], engine), read_controller(DESIGNS / f"{engine}.toml"), jet, means)


# ---- the bound


def test_the_bound_of_engines_that_jump_after_a_delay_is_the_double_integrators() -> None:
    """Thrust gone at once, the others at their ends n steps later: a t1^2 / 2 + (a t1)^2 / (2 b), to a step of dt."""
    vehicle, _ = load_vehicle("hexjet")
    still = vehicle.aero.model_copy(update={"damping_n_m_s": (0.0, 0.0, 0.0)})
    vehicle = vehicle.model_copy(update={"aero": still})
    n, hover, count = 25, 9.0, 500
    late = SimpleNamespace(
        up=[hover] * n + [20.0] * (count - n), down=[hover] * n + [1.0] * (count - n), out=[0.0] * count
    )
    found = RollAxis(vehicle, late, hover).least_lean(5)  # type: ignore[arg-type]
    lever, inertia = 0.15, vehicle.inertia_kg_m2[0]
    a = hover * lever / inertia
    b = (2.0 * 20.0 - 3.0 * 1.0) * lever / inertia
    t1 = n * STEP_S
    exact = a * t1**2 / 2.0 + (a * t1) ** 2 / (2.0 * b)
    assert found.lean_deg == pytest.approx(degrees(exact), rel=0.01)
    assert found.time_s == pytest.approx(t1 + a * t1 / b, abs=STEP_S)
    # half the lean with twice the inertia, and each station the same: only its lever counts
    assert replace(RollAxis(vehicle, late, hover), inertia=2.0).least_lean(1).lean_deg == pytest.approx(  # type: ignore[arg-type]
        found.lean_deg / 2.0, rel=1e-9
    )
    assert [RollAxis(vehicle, late, hover).least_lean(jet).lean_deg for jet in range(1, 7)] == pytest.approx(  # type: ignore[arg-type]
        [found.lean_deg] * 6
    )


def test_the_bound_with_idle_in_place_of_the_allocations_least_is_the_pages() -> None:
    """The allocation does not go down to idle; verdicts are the same either way: both are past 80 deg."""
    scenario = flight("p220", 5, PLANNED)
    bounds = []
    least_throttle = scenario.resolved_vehicle()[0].control.allocation.throttle_min
    for least in (0.0, least_throttle):
        with build(scenario.replace(vehicle={"control": {"allocation": {"throttle_min": least}}})) as simulation:
            bounds.append(make_roll_axis(simulation).least_lean(5).lean_deg)
    assert 80.0 < bounds[0] < bounds[1]
    sentence = (
        "{} % of the range of thrust), below which nothing here asks an engine to go; with the engine's idle in its "
        "place the bound of `p220` is {} deg and not {}"
    )
    stated("docs/tables/faults.md", sentence, 100.0 * least_throttle, *bounds)


@pytest.mark.parametrize("engine", [name for name in list_engine_names() if name not in NOT_A_JET])
def test_no_throttles_take_an_engine_out_of_the_strip_of_its_two_extremes(engine: str) -> None:
    """What the bound rests on: full and least throttle are the fastest up and down, whatever else is tried."""
    spec = load_engine(engine, {}, STEP_S)
    hover, count = 0.45, 300
    courses = ThrustCourses(spec, hover, 0.05, 1.0, count)
    rng = np.random.default_rng(5)
    slack = 1e-6 * spec.curve.thrust[-1]
    for hold in (1, 10, 40):
        for _ in range(4):
            levels = rng.choice([0.05, 0.3, 0.6, 1.0], count // hold + 1) if hold > 1 else rng.uniform(0.05, 1.0, count)
            with EngineBank(spec, 1, STEP_S) as bank:
                bank.reset(hover)
                course = [bank.step(k, (float(levels[k // hold]),)).thrust[0] for k in range(count)]
            assert (np.array(course) <= np.array(courses.up) + slack).all()
            assert (np.array(course) >= np.array(courses.down) - slack).all()


def test_what_the_flame_out_costs_in_height_at_least() -> None:
    """The figure that the scenario's bound of the height rests on: level, and full throttle once it is found."""
    scenario = Scenario.load("fault-flame-out-full-scale")
    with build(scenario) as simulation:
        mass = simulation.vehicle.mass_kg
        courses = measure_courses(simulation, simulation.cascade.allocator.hover, seconds=4.0)
    weight, found = mass * GRAVITY, round(0.076 / STEP_S)
    waiting = [weight / 6.0] * found
    thrust = [
        4.0 * u + a + b for u, a, b in zip(waiting + courses.up, courses.out, waiting + courses.out, strict=False)
    ]
    fallen = -np.cumsum(np.cumsum(np.array(thrust) - weight)) * STEP_S**2 / mass
    assert fallen[-1] < fallen.max() == pytest.approx(2.6, abs=0.05)
    assert "No throttles lose less than 2.6 m" in (scenario.folder / "fault-flame-out-full-scale.toml").read_text()
    assert scenario.limits.height_error_m == pytest.approx(4.0 * 2.6, rel=0.05)


@pytest.mark.parametrize("engine", ["edf-as-flown", "turbojet"])
def test_flown_open_loop_in_six_degrees_of_freedom_the_best_throttles_reach_the_bound(engine: str) -> None:
    """And no better: the middle jet out, full throttle beside it and least across, until the vehicle stops rolling."""
    scenario = flight(engine, 5, PLANNED).replace(sensor_noise=False, fault=[], monitor=False)
    with build(scenario) as simulation:
        found = make_roll_axis(simulation)
        bound = found.least_lean(5)
        rolls = [0.0]
        for k in range(400):
            thrust = [
                found.courses.out[k]
                if jet == 5
                else (found.courses.up if each.position_m[1] > 0.0 else found.courses.down)[k]
                for jet, each in enumerate(simulation.vehicle.jets, 1)
            ]
            forces = simulation.propulsion.forces_at_rest(tuple(thrust), (0.0, 0.0))[0]
            state = simulation.airframe.step(forces, Disturbance())
            rolls.append(to_euler(state.attitude)[0])
            if state.rate[0] < 0.0:
                break
    assert max(rolls) == pytest.approx(radians(bound.lean_deg), rel=0.02)
    assert len(rolls) * STEP_S == pytest.approx(bound.time_s, abs=3 * STEP_S)


# Found by differential evolution on a rigid body with these engines: least peak lean over 1.4 s, rates below the limit of
# 668 deg/s; tilt commands of the left and the right bank over the range, 0.1 s each.
SPIN = (
    (0.91, -0.92), (1.0, -0.61), (0.99, -0.52), (0.87, 0.19), (0.4, 0.15), (0.19, 0.62), (-0.85, -0.83),
    (-0.61, -0.37), (-0.18, -0.93), (0.85, -0.81), (-0.11, -0.89), (0.95, -0.72), (0.87, -0.79), (0.12, 0.84),
)  # fmt: skip


def test_a_vehicle_that_spins_leans_less_than_the_bound_with_tilts() -> None:
    """So that bound holds for a heading that is kept, as the page says; flown open loop in six degrees of freedom."""
    scenario = flight("p220", 5, PLANNED).replace(sensor_noise=False, fault=[], monitor=False)
    with build(scenario) as simulation:
        vehicle, found = simulation.vehicle, make_roll_axis(simulation)
        assert vehicle.servo is not None
        servos = [TiltServo(vehicle.servo, STEP_S) for _ in "lr"]
        lean, spin = 0.0, 0.0
        for k in range(350):
            left, right = (
                servo.update(share * vehicle.servo.range_rad)
                for servo, share in zip(servos, SPIN[k // 25], strict=True)
            )
            thrust = [
                found.courses.out[k]
                if jet == 5
                else (found.courses.up if each.position_m[1] > 0.0 else found.courses.down)[k]
                for jet, each in enumerate(vehicle.jets, 1)
            ]
            state = simulation.airframe.step(
                simulation.propulsion.forces_at_rest(tuple(thrust), (left, right))[0], Disturbance()
            )
            _, x, y, _ = state.attitude
            lean, spin = max(lean, degrees(acos(1.0 - 2.0 * (x * x + y * y)))), max(spin, degrees(state.rate[2]))
    assert spin > 200.0
    assert 20.0 < lean < found.least_lean(5, tilting=True).lean_deg - 5.0


class Fall(NamedTuple):
    """The least height that is lost, m; the fastest sinking; that at which a given height was fallen, 0: it was not."""

    lost_m: float
    sink_m_s: float
    touch_m_s: float


def least_fall(axis: RollAxis, after: int = 0, height: float = inf) -> Fall:
    """What no throttles avoid of a fall with one jet out and another, the opposite one, shut off with it.

    ``m v' = m g - sum T_i`` with the four others at full throttle from that instant on, or from step ``after``,
    before which no throttle moves, and nothing of their thrust lost to lean or to holding the attitude.
    """
    courses = axis.courses
    up = [axis.hover] * after + courses.up
    falling = [axis.hover] * after + courses.shut(0)
    sink = lost = fastest = touch = 0.0
    for k in range(len(courses.up)):
        thrust = courses.out[k] + falling[k] + (len(axis.vehicle.jets) - 2) * up[k]
        before = sink
        sink += STEP_S * (GRAVITY - thrust / axis.vehicle.mass_kg)
        if sink < 0.0:
            return Fall(lost, fastest, touch)
        above = lost < height
        lost += 0.5 * STEP_S * (before + sink)
        fastest = max(fastest, sink)
        touch = sink if above and lost >= height else touch
    raise ValueError("the engines were not followed for long enough to stop the fall")


def test_the_least_fall_is_what_the_failsafes_page_says() -> None:
    """Told at once, level, all four at full throttle; then as late as the monitor tells; then as it is flown."""
    page, height = "docs/failsafes.md", 3.0
    lost, legs, noticed, touch, leaning = [], [], [], [], []
    for aircraft, jet in (("hexjet-p220", 1), ("hexjet-100", 2)):
        vehicle, _ = load_vehicle(aircraft)
        scenario = Scenario.load("hover").replace(aircraft=aircraft, engine=vehicle.engine, controller="baseline")
        with build(scenario) as one:
            turning = make_roll_axis(one, 4.0)
        legs.append(height - max(each.position_m[2] for each in vehicle.contacts if each.kind == "leg"))
        lost.append(least_fall(turning).lost_m)
        with Hover(aircraft, height) as flight:
            flight.fly(5.0)
            flight.ok(rq.InjectFault("flame_out", (jet,)))
            begin = flight.simulation.k
            flight.fly(1.0, lambda: flight.pilot.failsafe)
            after = flight.simulation.k - begin
            before = state = flight.simulation.state
            while not state.on_ground:
                flight.simulation.step()
                before, state = state, flight.simulation.state
        late = least_fall(turning, after, legs[-1])
        assert lost[-1] < late.lost_m
        assert legs[-1] < late.lost_m
        assert late.touch_m_s < before.velocity[2]
        noticed.append(after * STEP_S)
        touch.append(late.touch_m_s)
        leaning.append(degrees(acos(cos(before.euler[0]) * cos(before.euler[1]))))
    stated(page, "no throttles lose less than {} m on hexjet-p220 and {} m on hexjet-100", *lost)
    stated(page, "From {} m the legs of hexjet-p220 have {} m to fall, those of hexjet-100 {} m.", height, *legs)
    stated(page, "after {} s on hexjet-p220 and after {} s on hexjet-100", *noticed)
    stated(page, "the first touches with {} m/s and the second with {} m/s", *touch)
    stated(page, "leaning by {} to {} deg", *leaning)


def test_a_fall_under_engines_that_jump_is_the_closed_form() -> None:
    """Nothing for a tenth of a second, and then twice the weight: it stops in as much height as it fell freely."""
    vehicle, _ = load_vehicle("hexjet")
    n, count = 25, 500
    hover = vehicle.mass_kg * GRAVITY / 6.0
    courses = SimpleNamespace(
        up=[0.0] * n + [3.0 * hover] * (count - n), out=[0.0] * count, shut=lambda at: [0.0] * count
    )
    found = least_fall(RollAxis(vehicle, courses, hover), height=0.08)  # type: ignore[arg-type]
    sink = GRAVITY * n * STEP_S
    assert found.touch_m_s == pytest.approx((2.0 * GRAVITY * (2.0 * sink**2 / 2.0 / GRAVITY - 0.08)) ** 0.5, rel=0.05)
    assert found.sink_m_s == pytest.approx(sink, rel=1e-9)
    assert found.lost_m == pytest.approx(sink**2 / (2.0 * GRAVITY) * 2.0, rel=0.01)


def test_tilts_and_an_earlier_shut_off_can_only_help() -> None:
    with build(flight("turbine-20", 2, OPPOSITE)) as simulation:
        found = make_roll_axis(simulation)
    plain = found.least_lean(2)
    assert found.least_lean(2, tilting=True).lean_deg < plain.lean_deg < found.least_lean(2, after=10).lean_deg
    leans = [found.least_lean(2, shut_at=at).lean_deg for at in (0, 10, 20, 30)]
    assert leans == sorted(leans)
    assert leans[-1] < plain.lean_deg
    assert find_opposite(simulation.vehicle, 2) == 1


# ---- the verdicts


@pytest.mark.parametrize("engine", ["p220", "turbine-20", "turbine-100", "turbine-220"])
def test_no_throttles_save_a_vehicle_on_turbines_from_one_flame_out(engine: str) -> None:
    """The bound is past the lean at which a flight is lost, and the flight is."""
    found = _fly((flight(engine, 5, PLANNED), 5, PLANNED))
    assert found.throttles_deg > found.limit_deg
    assert found.verdict == "lost"


@pytest.mark.parametrize(
    ("engine", "jets"), [("p220", (1, 5)), ("turbojet", (1, 5)), ("turbine-20", (5,)), ("turbine-100", (1, 5))]
)
def test_with_the_opposite_engine_shut_off_it_is_held(engine: str, jets: tuple[int, ...]) -> None:
    """By the gains of the healthy vehicle; and no flight leans less than the bound.

    The smallest turbine is lost at its corners, whose bounds would allow it: docs/faults.md.
    """
    for jet in jets:
        found = _fly((flight(engine, jet, OPPOSITE), jet, OPPOSITE))
        assert found.verdict == "held"
        assert found.throttles_deg < found.lean_deg < found.limit_deg
        assert found.bound_deg < found.throttles_deg


def test_the_turbine_whose_thrust_comes_late_needs_it_found_sooner() -> None:
    assert _fly((flight("turbine-220", 5, OPPOSITE), 5, OPPOSITE)).verdict == "lost"
    sooner = _fly((flight("turbine-220", 5, SOONER), 5, SOONER))
    assert sooner.verdict != "lost"
    assert sooner.throttles_deg < sooner.lean_deg


@pytest.mark.parametrize(("engine", "means"), [("turbine-20", OPPOSITE), ("turbine-220", SOONER)])
def test_at_a_corner_it_is_the_height_hold_that_loses_the_slowest_turbines(engine: str, means: Any) -> None:
    """The same gains with the collective left at that of hover come back to level: docs/faults.md, docs/full-scale.md."""
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
    for page in PAGES:
        words = " ".join((DOCS / page).read_text(encoding="utf-8").split())
        assert "With the collective left at that of hover" in words
        assert "but for the first instants refuses it none" in words or page != "faults.md"


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


def test_what_cannot_be_flown_says_why() -> None:
    assert find_obstacle(load_subject("hexjet-p220", "edf")) == "cannot lift it: 120 N at most for 608 N of weight"
    assert find_obstacle(load_subject("hexjet", "p220")) == "cannot stay down: 90 N at idle for 54 N of weight"
    assert find_obstacle(load_subject("hexjet", "turbine-100")) == "too strong: it would hover at 7 % of its range"
    assert all(find_obstacle(load_subject(aircraft, engine)) == "" for engine, aircraft in HOME.items())


# ---- the command and the pages


def test_the_command_flies_a_pair_and_says_what_each_verdict_rests_on(hexjet: Hexjet) -> None:
    pair = ("--engine-out", "--aircraft", "hexjet", "--engine", "edf", "--workers", "1")
    done = hexjet("faults", *pair, "--designs", str(DESIGNS), "--out", "out", "--json")
    assert done.status == 0
    told = json.loads(done.out)
    assert [(each["jet"], each["means"]) for each in told["flights"]] == [(j, m) for j in range(1, 7) for m in MEANS]
    assert all(each["verdict"] == "held" and 0.0 < each["margin_deg"] < 5.0 for each in told["flights"])
    assert told["levers"][0]["at_once_deg"] == 0.0
    assert len(Path("out/engine-out.csv").read_text(encoding="utf-8").splitlines()) == 1 + 6 * len(MEANS)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--designs", "x"), "--designs goes with --engine-out"),
        (("--docs", "."), "faults.md: "),
        (("--docs", ".", "--kind", "none"), "--kind"),
        (("--engine-out", "--aircraft", "hexjt"), "unknown aircraft 'hexjt'"),
        (("--engine-out", "--engine", "rocket"), "unknown engine 'rocket'"),
        (("--engine-out", "--aircraft", "quadrotor"), "aircraft quadrotor: it has no tilting banks"),
        (("--engine-out", "--docs", ".", "--engine", "edf"), "--docs: the pages hold every aircraft and engine"),
        (("--engine-out", "--docs", "."), "faults.md: "),
        (("--engine-out", "--limits"), "--limits: does not go with --engine-out"),
        (("--docs", ".", "--engine", "edf"), "--engine: the page holds every fault"),
        (("--engine-out", "--out", __file__), "test_engine_out.py: is a file"),
        (("--engine-out", "--designs", __file__), "test_engine_out.py' is a file"),
        (("--kind", "none", "--out", __file__), "test_engine_out.py: is a file"),
    ],
)
def test_wrong_input_is_one_line(hexjet: Hexjet, arguments: tuple[str, ...], words: str) -> None:
    done = hexjet("faults", *arguments)
    assert done.status == 2
    assert words in done.err
    assert "Traceback" not in done.err


def test_the_pages_have_every_engine_at_every_station(tmp_path: Path) -> None:
    """docs/faults.md and docs/full-scale.md: each engine flown with each means, or why it is not."""
    told = ""
    for page, aircraft in PAGES.items():
        parts = page_parts(DOCS / page)
        for name in aircraft:
            flown = [line for line in parts["engine-out"].splitlines() if line.startswith(f"| {name} |")]
            left = [line for line in parts["engine-out-left"].splitlines() if line.startswith(f"| {name} |")]
            engines = {line.split(" | ")[1] for line in (*flown, *left)}
            assert engines == {each for each in list_engine_names() if each not in NOT_A_JET}, (page, name)
            assert len(flown) == len(MEANS) * (len(engines) - len(left))
            for line in flown:
                assert line.count("°") >= 8, line  # six stations, two bounds
        told += parts["engine-out"]
    assert "lost: " in told
    assert "held: " in told


MIDDLE = ["lost"] * 4 + ["held"] * 2  # held where a middle engine is out


def test_what_the_pages_text_says() -> None:
    """docs/faults.md and docs/full-scale.md, beside their tables."""
    text = (DOCS / "faults.md").read_text(encoding="utf-8")
    law = load_engine("p220", {}, STEP_S).flame_out
    assert law is not None
    for key, value in (("thrust_left", law.thrust_left), ("run_down_s", law.half_speed_s), ("exponent", law.exponent)):
        assert f"{key} = {value:.2f} " in text
    assert f"relight_s = {law.relight_s:.1f} " in text
    left = [100.0 * law.thrust_left * (1.0 + t / law.half_speed_s) ** -law.exponent for t in (0.0, 0.1, 0.25)]
    assert "{:.0f} % are left at once, {:.0f} % after 0.1 s, {:.0f} % after 0.25 s".format(*left) in text
    throttles = {}
    for page in PAGES:
        for line in page_parts(DOCS / page)["engine-out-levers"].splitlines()[2:]:
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            throttles[cells[1]] = cells
    slow = ("turbine-20", "turbine-100", "p220", "turbine-220")
    assert all(float(throttles[name][2].removeprefix("over ").rstrip("°")) > 80.0 for name in slow)
    assert all(float(throttles[name][2].rstrip("°")) < 80.0 for name in ("turbojet", "p220-2025"))
    verdicts: dict[tuple[str, str], list[str]] = {}
    for page in PAGES:
        for line in page_parts(DOCS / page)["engine-out"].splitlines()[2:]:
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            verdicts[cells[1], cells[2]] = [cell.partition(":")[0] for cell in cells[3:9]]
    for name in HOME:
        planned = {"edf": ["held"] * 6, "edf-as-flown": ["held"] * 6, "turbojet": MIDDLE}.get(name, ["lost"] * 6)
        assert verdicts[name, PLANNED] == planned, name
        opposite = {"turbine-220": ["lost"] * 6, "turbine-20": MIDDLE}.get(name, ["held"] * 6)
        assert verdicts[name, OPPOSITE] == opposite, name
    assert verdicts["turbine-20", SOONER] == MIDDLE
    assert verdicts["turbine-220", SOONER][:4] == ["lost"] * 4
    assert "lost" not in verdicts["turbine-220", SOONER][4:]
    for name in ("p220", "p220-2025", "turbine-100"):
        assert verdicts[name, SOONER] == ["held"] * 6
    assert verdicts["p220-2025", PLANNED] == ["held"] * 6
    # "half the mass, or a rolling inertia half as large again, would not be enough either", at full scale
    for name in ("turbine-100", "p220", "turbine-220"):
        assert float(throttles[name][5].removeprefix("over ").rstrip("°")) > 80.0
        assert float(throttles[name][6]) > 1.5


def test_the_pages_are_written_between_their_marks(tmp_path: Path) -> None:
    for page in PAGES:
        marks = "".join(f"<!-- measured: {name} -->\n<!-- end -->\n" for name in TABLES)
        (tmp_path / page).write_text(f"# Before\n{marks}after\n", encoding="utf-8")
    found = engine_out(("hexjet",), ("edf", "p220"), DESIGNS, 1)
    write_pages(found, tmp_path)
    text = (tmp_path / "faults.md").read_text(encoding="utf-8")
    assert text.startswith("# Before\n")
    assert text.endswith("after\n")
    assert "| hexjet | edf | planned around | held: " in text
    assert "| hexjet | p220 | cannot stay down: " in text
    assert len(rows(found, ("hexjet",))["engine-out"]) == len(MEANS)
