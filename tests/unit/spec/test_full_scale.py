"""The scaled-up aircraft: the law, the budget in the README, and JSBSim's reading of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from math import exp, log, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loads import acted
from places import DESIGNS
from scipy.spatial.transform import Rotation

from cosim import fly
from cosim.api.call.choices import load_scenario
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.frames import jet_axis
from cosim.base.signals import ZERO3, State
from cosim.base.storage.paths import data_folder
from cosim.base.storage.toml import read_toml
from cosim.cli.main import run
from cosim.results.expectations import check_expected, find_expectation
from cosim.simulation.build import build
from cosim.spec.scaling import _VEHICLE_EXPONENTS, length_scale, scale_vehicle
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, load_vehicle
from cosim.vehicle.airframe import standing_height
from cosim.vehicle.effects.intakes import IntakeDrag

BASE, _ = load_vehicle("hexjet")
SIZES = {"hexjet-100": 100.0, "hexjet-p220": 220.0}  # N an engine
STATED = BASE.model_dump(mode="json", exclude_none=True)

# Numbers that are the same at every size, each for a reason.
SAME = {
    "shut_opposite", "catch",  # choices
    "mass_kg",  # given
    "spin", "range_rad", "friction_static", "friction_dynamic", "tilt_deg", "lean_rad", "stick_lean_rad",  # no unit
    "filter_s", "noise_rad_s", "bias_rad_s", "latency_samples", "noise_rad", "bias_rad",  # electronics
    "position_noise_m", "velocity_noise_m_s", "period_samples", "noise_m", "bias_m", "noise_m_s2", "bias_m_s2", "ahrs_time_constant_s",
    "bias_sigma_rad_s", "bias_sigma_m_s2", "resolution_rad_s", "resolution_m_s2",
    "integral_limit", "integral_limit_m_s2", "acceleration_m_s2",  # commands without a unit, accelerations
    "throttle_min", "throttle_max",
    "endurance_s",  # what is in the battery or tank
    "threshold", "confirm_s", "stuck_s", "lag_factor", "delay_spread_s",  # the engines' and their monitor's
}  # fmt: skip

# Keys of a vehicle without a law: names; given; the model's; left out; electronics; of vehicles that are not scaled.
WITHOUT_LAW = {"name", "title", "engine", "mass_kg", "step_s", "model", "identified", "sensors", "hinges", "surfaces"}


@pytest.fixture(params=list(SIZES))
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def numbers(table: Any, law: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every number's path, and its exponent where the law has one."""
    if isinstance(table, dict):
        for key, each in table.items():
            yield from numbers(each, law.get(key) if isinstance(law, dict) else law, (*path, key))
    elif isinstance(table, list):
        for each in table:
            yield from numbers(each, law, path)
    elif isinstance(table, (int, float)):
        yield path, law


def test_every_number_of_a_vehicle_has_its_law() -> None:
    """A new key of vehicle.toml must be given an exponent, or stay the same for a reason."""
    assert set(Vehicle.model_fields) - set(_VEHICLE_EXPONENTS) == WITHOUT_LAW
    for path, law in numbers({key: each for key, each in STATED.items() if key != "identified"}, _VEHICLE_EXPONENTS):
        if law is None:
            assert path[-1] in SAME, f"{'.'.join(path)}: neither in cosim/spec/scaling.py nor among those that stay"


def test_the_law_by_hand() -> None:
    """L = 2 and 4, where the powers are exact or roots of two."""
    for scale in (2.0, 4.0):
        root = sqrt(scale)
        found = Vehicle.model_validate(scale_vehicle(STATED, STATED["mass_kg"] * scale**3))
        assert length_scale(scale**3, 1.0) == pytest.approx(scale, rel=1e-15)

        def same(a: Any, b: Any) -> None:
            assert a == pytest.approx(b, rel=1e-14)  # a cube root and a power: a few roundings

        for new, old in zip(found.jets, BASE.jets, strict=True):
            same(new.position_m, [scale * x for x in old.position_m])
        same(found.inertia_kg_m2, [scale**5 * j for j in BASE.inertia_kg_m2])
        same(found.aero.drag_area_m2, [scale**2 * a for a in BASE.aero.drag_area_m2])
        # a rate dies out as slowly as everything else happens: damping / inertia is one over a time
        same(
            [d / j for d, j in zip(found.aero.damping_n_m_s, found.inertia_kg_m2, strict=True)],
            [d / j / root for d, j in zip(BASE.aero.damping_n_m_s, BASE.inertia_kg_m2, strict=True)],
        )
        # sinking by a length, swinging with a time
        same(standing_sink(found), scale * standing_sink(BASE))
        for new, old in zip(found.contacts, BASE.contacts, strict=True):
            same(new.damping_n_s_m / new.spring_n_m * root, old.damping_n_s_m / old.spring_n_m * scale)
        # loops: command times effectiveness, which falls with L, is 1/s, 1/s^2, 1
        for axis in ("roll", "pitch"):
            new_gains, old_gains = getattr(found.control.rate, axis), getattr(BASE.control.rate, axis)
            same(new_gains.p / scale, old_gains.p / root)
            same(new_gains.i / scale, old_gains.i / scale)
            same(new_gains.d / scale, old_gains.d)
            assert new_gains.integral_limit == old_gains.integral_limit
        same(found.control.attitude.gain_1_s, [g / root for g in BASE.control.attitude.gain_1_s])
        same(found.limits.touchdown_m_s, BASE.limits.touchdown_m_s * root)
        assert found.limits.tilt_deg == BASE.limits.tilt_deg
        assert found.sensors == BASE.sensors
        assert found.identified == {}


def standing_sink(vehicle: Vehicle) -> float:
    """How far the legs give way under the weight, m."""
    return max(contact.position_m[2] for contact in vehicle.contacts) - standing_height(vehicle)


def test_the_same_mass_is_the_same_aircraft() -> None:
    assert scale_vehicle(STATED, STATED["mass_kg"]) == STATED | {"identified": {}}


def test_thrust_to_weight_is_the_papers(name: str) -> None:
    vehicle, _ = load_vehicle(name)
    ratio = 6 * SIZES[name] / (vehicle.mass_kg * 9.80665)
    assert ratio == pytest.approx(12.0 / 5.525, rel=2e-4)  # the mass is stated to four digits


def test_ten_minutes_of_hover_are_in_the_tank() -> None:
    """The data sheet's straight line from 9 N, 0.104 kg/min to 220 N, 0.58 kg/min, over the falling mass, in closed form."""
    for name, (t0, f0, t1, f1), minutes in (
        ("hexjet-p220", (9.0, 0.104, 220.0, 0.58), 10.0),
        ("hexjet-100", (2.0, 0.064, 100.0, 0.312), 10.0),
    ):
        vehicle, _ = load_vehicle(name)
        slope = (f1 - f0) / (t1 - t0)
        a, b = 6 * (f0 - slope * t0), slope * 9.80665  # dm/dt = -a - b m
        left = (vehicle.mass_kg + a / b) * exp(-b * minutes) - a / b
        assert 0.05 < 1.0 - (vehicle.mass_kg - left) / vehicle.fuel.mass_kg < 0.10
        empty = (log(vehicle.mass_kg + a / b) - log(vehicle.mass_kg - vehicle.fuel.mass_kg + a / b)) / b
        assert minutes < empty < 1.1 * minutes


def test_intakes_are_level_with_the_centre_of_gravity(name: str) -> None:
    """Upright, air that is swallowed has no moment about it; the exhausts are clear of the ground."""
    vehicle, _ = load_vehicle(name)
    feet = max(contact.position_m[2] for contact in vehicle.contacts)
    for jet, by_law in zip(vehicle.jets, BASE.jets, strict=True):
        assert jet.position_m[2] - vehicle.airflow.intake_m == pytest.approx(0.0, abs=1e-12)
        assert jet.position_m[2] - vehicle.airflow.exhaust_m < feet - 0.1
        # the other two coordinates are the law's
        scale = length_scale(vehicle.mass_kg, BASE.mass_kg)
        assert jet.position_m[:2] == pytest.approx([scale * x for x in by_law.position_m[:2]], rel=1e-14)


def test_rotors_cancel() -> None:
    """All together, and one left over in a bank."""
    for name in SIZES:
        vehicle, _ = load_vehicle(name)
        assert sum(jet.spin for jet in vehicle.jets) == 0
        for side in ("left", "right"):
            assert abs(sum(jet.spin for jet in vehicle.jets if jet.servo == side)) == 1


def test_hover_is_below_half_thrust() -> None:
    """46 % of full thrust, in shares of what the throttle can add to idle."""
    scenario = Scenario.load("hover").replace(aircraft="hexjet-p220", engine="p220", controller="baseline", expect=[])
    with build(scenario) as simulation:
        curve = simulation.engine.curve
        thrust = simulation.vehicle.mass_kg * GRAVITY / 6
        assert thrust / curve.thrust[-1] == pytest.approx(0.46, abs=0.005)
        share = (thrust - curve.thrust[0]) / (curve.thrust[-1] - curve.thrust[0])
        assert simulation.cascade.allocator.hover == pytest.approx(share, rel=1e-3)  # linear between the curve's points


def momentum_theorem(vehicle: Vehicle, thrust: Any, tilt: tuple, state: State) -> tuple[np.ndarray, np.ndarray]:
    """What six streams have in force and in moment about the centre of gravity, from what flows in and out.
    Out of all that the stream takes along, the part across the axis; along it, it is the engine's business."""
    flow = vehicle.airflow
    body = Rotation.from_quat([*state.attitude[1:], state.attitude[0]]).inv()
    through_air = body.apply(np.array(state.velocity) - np.array(state.wind))
    force, moment = np.zeros(3), np.zeros(3)
    for jet, newton in zip(vehicle.jets, thrust, strict=True):
        e = np.array(jet_axis(tilt[0] if jet.servo == "left" else tilt[1]))
        across = np.eye(3) - np.outer(e, e)
        kg_s = flow.kg_s * (newton / flow.at_thrust_n) ** flow.exponent
        inlet = np.array(jet.position_m) + flow.intake_m * e
        outlet = np.array(jet.position_m) + flow.exhaust_m * e
        for where, velocity in ((inlet, through_air), (outlet, np.cross(state.rate, outlet))):
            push = -kg_s * across @ velocity
            force += push
            moment += np.cross(where, push)
    return force, moment


def test_intake_drag_is_the_momentum_of_the_air() -> None:
    """In JSBSim, in a flight with wind and rates: external force and moment less those of the thrusts alone."""
    flown: dict[str, Any] = {"aircraft": "hexjet-p220", "engine": "p220", "controller": "baseline", "expect": []}
    flown["environment"] = {"wind_ned_m_s": [2.0, -6.0, 1.0]}
    moving = {"rate_deg_s": [30.0, -20.0, 10.0], "velocity_ned_m_s": [3.0, 1.0, 0.5]}
    flown["initial"] = moving | {"attitude_deg": [5.0, 8.0, 40.0]}
    # the reaction of the banks has a test of its own
    flown["vehicle"] = {"servo": {"bank_inertia_kg_m2": 0.0}, "jets": {str(jet): {"spin": 0} for jet in range(6)}}
    flown["vehicle"]["fuel"] = {"position_m": [0.0, 0.0, 0.0]}
    with build(Scenario.load("hover").replace(**flown)) as simulation:
        for _ in range(20):
            state = simulation.state
            sample = simulation.step()
            force, moment = simulation.airframe.external_wrench()
            newtons, tilt = sample.engines.thrust, sample.tilt
            axes = [jet_axis(tilt[0] if jet.servo == "left" else tilt[1]) for jet in simulation.vehicle.jets]
            thrusts = np.array(newtons)[:, None] * np.array(axes)
            arms = [jet.position_m for jet in simulation.vehicle.jets]
            drag, turn = momentum_theorem(simulation.vehicle, newtons, tilt, state)
            assert np.linalg.norm(drag) > 5.0  # N: there is something to compare
            assert np.array(force) - thrusts.sum(axis=0) == pytest.approx(drag, rel=1e-6, abs=1e-6)
            assert np.array(moment) - np.cross(arms, thrusts).sum(axis=0) == pytest.approx(turn, rel=1e-6, abs=1e-6)


def test_still_air_drags_nothing() -> None:
    with build(
        Scenario.load("hover").replace(aircraft="hexjet-p220", engine="p220", controller="baseline")
    ) as simulation:
        (streams,) = [effect for effect in simulation.propulsion.effects if isinstance(effect, IntakeDrag)]
        forces = [(0.0, 0.0, -100.0)] * 6
        assert acted(streams, forces, (0.1, -0.1), (100.0,) * 6) == (forces, ZERO3)
        # an engine without thrust swallows nothing
        moving = (0.0, 10.0, 0.0)
        assert acted(streams, forces, thrust=(0.0,) * 6, velocity=moving) == (forces, ZERO3)
        # six at full thrust, 10 m/s to the right: 27 N to the left, above the centre of gravity, so the vehicle rolls left
        pushed, (roll, _, _) = acted(streams, [ZERO3] * 6, thrust=(220.0,) * 6, velocity=moving)
        assert sum(y for _, y, _ in pushed) == pytest.approx(-6 * 0.45 * 10.0, rel=1e-12)
        assert roll == pytest.approx(-6 * 0.45 * 10.0 * 0.1535, rel=1e-12)
    with build(Scenario.load("hover")) as simulation:
        assert not any(isinstance(effect, IntakeDrag) for effect in simulation.propulsion.effects)


@pytest.mark.parametrize(
    ("table", "complaint"),
    [
        ('[scaled]\nbase = "hexjt"\nmass_kg = 1.0', r"scaled.base: unknown aircraft 'hexjt'; did you mean 'hexjet'"),
        ('[scaled]\nbase = "hexjet-p220"\nmass_kg = 1.0', r"hexjet-p220 is a scaled copy itself"),
        ('scaled = 3', r"scaled = 3: must be a table with base and mass_kg"),
    ],
)  # fmt: skip
def test_a_wrong_copy_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, table: str, complaint: str) -> None:
    for known in ("hexjet", "hexjet-p220"):
        (tmp_path / known).symlink_to(data_folder("aircraft") / known)
    (tmp_path / "wrong").mkdir()
    (tmp_path / "wrong" / "vehicle.toml").write_text(f'name = "wrong"\ntitle = "x"\n{table}\n', encoding="utf-8")
    monkeypatch.setattr("cosim.spec.vehicle.files.data_folder", lambda kind: tmp_path)
    monkeypatch.setattr("cosim.spec.vehicle.files.names_in", lambda *_: ["hexjet", "hexjet-p220", "wrong"])
    with pytest.raises(InputError, match=complaint):
        load_vehicle("wrong")


def test_a_copy_may_state_its_own(name: str) -> None:
    """What the file says stands, entry by entry of a list, and the rest is the law's."""
    vehicle, folder = load_vehicle(name)
    own = read_toml(folder / "vehicle.toml")
    assert vehicle.servo.lag_s == own["servo"]["lag_s"]
    assert vehicle.servo.range_rad == BASE.servo.range_rad
    assert [jet.servo for jet in vehicle.jets] == [jet.servo for jet in BASE.jets]
    assert (folder / vehicle.model).resolve() == (data_folder("aircraft") / "hexjet" / BASE.model).resolve()


def test_an_aircraft_is_named_on_the_command_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """With the engine it is made for; what the scenario expects of another aircraft is not asked of it."""
    arguments = ["fly", "hover", "--aircraft", "hexjet-p220", "--controller", "baseline", "--json"]
    assert run([*arguments, "--out", str(tmp_path / "run")]) == 0
    summary = json.loads(capfd.readouterr().out)
    assert (summary["aircraft"], summary["engine"]) == ("hexjet-p220", "p220")
    assert summary["expectations_met"] is None
    assert Scenario.load(tmp_path / "run" / "scenario.toml").aircraft == "hexjet-p220"
    with pytest.raises(InputError, match=r"unknown aircraft 'hexjet-p22'; did you mean 'hexjet-p220'"):
        load_scenario("hover", None, (), None, (), None, "hexjet-p22")
    assert load_scenario("hover", None, ("turbojet",), None, (), None, "hexjet-p220").engine == "turbojet"


def test_an_expectation_is_of_one_aircraft() -> None:
    """Of the scenario's where it does not say, also after another aircraft was written over the scenario."""
    hover = Scenario.load("hover")
    assert [entry.aircraft for entry in hover.expect] == ["hexjet"]
    assert find_expectation(hover) == hover.expect[0]
    assert find_expectation(hover.replace(aircraft="hexjet-p220")) is None
    assert find_expectation(hover.replace(aircraft="hexjet-p220").replace(aircraft="hexjet")) == hover.expect[0]
    own = {"controller": "smith", "engine": "edf-as-flown", "metrics": {}}
    other = hover.replace(aircraft="hexjet-p220", expect=[own])
    assert find_expectation(other) == other.expect[0]
    with pytest.raises(InputError, match=r"expect\.0\.aircraft: unknown 'hexjt'; did you mean 'hexjet'"):
        check_expected(hover.replace(expect=[own | {"aircraft": "hexjt"}]))


@pytest.mark.parametrize(("aircraft", "engine"), [("hexjet-p220", "p220"), ("hexjet-100", "turbine-100")])
def test_the_shipped_gains_are_what_the_design_wrote(aircraft: str, engine: str) -> None:
    """Gains, leads, predictor and model, to the last digit; which keep the margins, tests/hexjet_design/flight/test_design.py shows."""
    vehicle, _ = load_vehicle(aircraft)
    written, _ = load_vehicle(aircraft, read_toml(DESIGNS / f"{engine}.toml")["vehicle"])
    ours, theirs = vehicle.control.model_dump(), written.control.model_dump()
    for control in (ours, theirs):
        control["lead"] = {axis: lead for axis, lead in control["lead"].items() if lead}
    assert ours == theirs
    assert set(ours["lead"]) == {"roll", "altitude"}
    assert written.identified == vehicle.identified
    need = read_toml(DESIGNS / f"{engine}.toml")["design"]["requirements"]
    assert (need["max_sensitivity"], need["delay_tolerance"], need["gain_tolerance"]) == (1.7, 0.3, 0.3)


def test_the_faster_engine_is_lost_late_and_the_slower_is_not() -> None:
    """100 ms of ECU, in hover, with the gains that the vehicle ships."""
    outcomes = {}
    for engine in ("p220", "p220-2025"):
        late = {"engine": engine, "engine_parameters": {"delay_samples": 25}, "expect": []}
        outcomes[engine] = fly(Scenario.load("full-scale-hover").replace(**late)).outcome
    assert outcomes["p220"] == "completed" != outcomes["p220-2025"]
