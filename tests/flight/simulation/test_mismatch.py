"""What flies is not what the controller was made for, and the controller does not know."""

from __future__ import annotations

from math import exp
from typing import Any

import numpy as np
import pytest

from cosim import fly
from cosim.base.errors import InputError
from cosim.base.signals import EngineOutput
from cosim.engine.rundown import MODELLED
from cosim.engine.wrappers import EngineChain
from cosim.results.run import Run
from cosim.simulation.build import build
from cosim.simulation.engines import flown_engines, load_engines
from cosim.simulation.script.mismatch import apply_mismatch, compute_engine_mismatch
from cosim.spec.scenario import Mismatch, Scenario
from cosim.spec.vehicle import load_vehicle

NAN6 = (float("nan"),) * 6
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # of the axes, in the order of moments and products


def doublet(**changes: Any) -> Scenario:
    """The start of the roll doublet without noise."""
    return Scenario.load("roll-doublet").replace(duration_s=2.0, sensor_noise=False, expect=[], **changes)


def same(one: Run, other: Run) -> bool:
    """Whether two logs are the same to the last bit."""
    return all(one.log[name].tobytes() == other.log[name].tobytes() for name in one.log.columns)


def test_common_and_single_factors_multiply_and_without_a_mismatch_nothing_is_made_anew() -> None:
    factors = compute_engine_mismatch(Mismatch(thrust_factor=0.5, thrust_factor_3=4.0), 6)
    assert factors == ((0.5, 0.5, 2.0, 0.5, 0.5, 0.5), 0)
    vehicle, _ = load_vehicle("hexjet")
    assert apply_mismatch(vehicle, Mismatch()) is vehicle
    assert compute_engine_mismatch(Mismatch(), 6) == (None, 0)


class Recorded:
    """Engines whose thrust is their throttle."""

    wants_ambient = False

    def __init__(self) -> None:
        self.given: list[tuple[float, ...]] = []

    def reset(self, throttle: Any, ambient: Any = None) -> EngineOutput:
        return EngineOutput(tuple(throttle), NAN6, NAN6, NAN6)

    def step(self, k: int, throttle: tuple[float, ...], ambient: Any = None) -> EngineOutput:
        self.given.append(throttle)
        return self.reset(throttle)


def test_engines_answer_later_and_with_another_thrust() -> None:
    bank: Any = Recorded()
    factors = (0.5, 2.0, 1.0, 1.0, 1.0, 4.0)
    engines = EngineChain(bank, [MODELLED] * 6, lambda jet: 0.1, 0.004, factors, 2)
    assert engines.reset((0.5,) * 6).thrust == tuple(0.5 * each for each in factors)
    thrusts = [engines.step(k, (0.125 * k,) * 6).thrust for k in range(4)]
    assert bank.given == [(0.5,) * 6, (0.5,) * 6, (0.0,) * 6, (0.125,) * 6]
    assert thrusts[3] == tuple(0.125 * each for each in factors)
    engines.reset((0.25,) * 6)  # a flight before leaves nothing in the line
    assert engines.step(0, (0.0,) * 6).thrust[2] == 0.25


def test_delay_unknown_to_the_predictor_is_the_engines_own_to_the_last_bit() -> None:
    added, own = fly(doublet(mismatch={"delay_samples": 7})), fly(doublet(engine_parameters={"delay_samples": 32}))
    assert same(added, own)
    assert not same(added, fly(doublet()))
    rows, stated = (
        {row.element: row.samples or 0.0 for row in run.summary.delay_ledger if row.axis == "roll"}
        for run in (added, own)
    )
    assert rows["engines later than known"] == 7.0
    assert sum(rows.values()) == sum(stated.values())


def test_twice_the_mass_with_twice_of_every_force_flies_alike() -> None:
    """Newton: mass, moments of inertia, thrust and air forces by one factor leave every acceleration as it is."""
    stated, _ = load_vehicle("hexjet")
    drag, damping = ([2.0 * each for each in sides] for sides in (stated.aero.drag_area_m2, stated.aero.damping_n_m_s))
    twice = {"inertia_kg_m2": [2.0 * each for each in stated.inertia_kg_m2]}
    twice |= {"aero": {"drag_area_m2": drag, "damping_n_m_s": damping}}  # type: ignore[dict-item]
    heavy = fly(doublet(mismatch={"mass_factor": 2.0, "thrust_factor": 2.0}, vehicle=twice))
    light = fly(doublet())
    for name in ("roll_rad", "rate_p_rad_s", "altitude_m", "throttle_1"):
        # rounding alone; the doublet's amplitude is 0.17 rad
        assert np.max(np.abs(heavy.log[name] - light.log[name])) < 1e-9, name
    assert np.allclose(heavy.log["mass_kg"], 2.0 * stated.mass_kg, rtol=1e-12)
    assert not same(light, fly(doublet(mismatch={"mass_factor": 1.01})))


def test_more_inertia_is_less_gain_and_unknown_to_the_controller() -> None:
    """As the vehicle that states so much: nothing of the Hex-Jet's controller is made from its inertia."""
    stated, _ = load_vehicle("hexjet")
    twice = {"inertia_kg_m2": [2.0 * each for each in stated.inertia_kg_m2]}
    slow = fly(doublet(mismatch={"inertia_factor": 2.0}))
    assert same(slow, fly(doublet(vehicle=twice)))
    assert not same(slow, fly(doublet()))
    with build(doublet(mismatch={"inertia_factor": 2.0})) as simulation:
        assert simulation.vehicle == stated


@pytest.mark.parametrize("name", ["hexjet", "hexjet-p220", "trijet"])
def test_every_draw_of_stretch_and_shear_is_a_body(name: str) -> None:
    """The vehicle's own checks accept what is drawn, with its fuel; alike in all directions it is the one factor."""
    stated, _ = load_vehicle(name)
    for stretch, shear in np.random.default_rng(1).normal(0.0, 0.3, (100, 2, 3)).clip(-2.0, 2.0).tolist():
        drawn = apply_mismatch(stated, Mismatch(stretch=stretch, shear=shear))
        assert type(stated).model_validate(drawn.model_dump()) == drawn != stated
    alike = apply_mismatch(load_vehicle("hexjet")[0], Mismatch(stretch=(0.1, 0.1, 0.1))).inertia_kg_m2
    factor = apply_mismatch(load_vehicle("hexjet")[0], Mismatch(inertia_factor=exp(0.2))).inertia_kg_m2
    assert alike == pytest.approx(factor, rel=1e-12)


def test_stretch_and_shear_move_each_part_of_the_mass() -> None:
    """A body of points about its centre, each moved by the matrix that the six numbers are."""
    points, stated = np.random.default_rng(2).normal(size=(20, 3)) * 0.1, load_vehicle("quadrotor")[0]
    points -= points.mean(axis=0)

    def made_of(points: Any) -> dict[str, Any]:
        xx, yy, zz, xy, xz, yz = (float(np.sum(points[:, i] * points[:, j])) for i, j in PAIRS)
        return {"inertia_kg_m2": (yy + zz, xx + zz, xx + yy), "products_kg_m2": (xy, xz, yz)}

    upper = np.array([[exp(0.2), 0.1, -0.2], [0.0, exp(-0.3), 0.3], [0.0, 0.0, exp(0.1)]])
    before = stated.model_copy(update=made_of(points))
    after = apply_mismatch(before, Mismatch(stretch=(0.2, -0.3, 0.1), shear=(0.1, -0.2, 0.3)))
    for name, values in made_of(points @ upper.T).items():
        assert getattr(after, name) == pytest.approx(values, rel=1e-12)


def test_controller_is_made_from_what_is_known() -> None:
    changed = doublet(mismatch={"mass_factor": 1.3, "thrust_factor": 0.8, "centre_m": [0.01, 0.02, 0.03]})
    with build(doublet()) as known, build(changed) as other:
        assert other.cascade.allocator.hover == known.cascade.allocator.hover
        assert other.vehicle == known.vehicle
        assert [row.owner for row in other.ledger] == [row.owner for row in known.ledger]


def test_moment_about_the_true_centre_of_gravity() -> None:
    """The sum of r x F over the jets, each r from where the centre of gravity is."""
    centre = (0.01, -0.02, 0.03)
    with build(doublet(mismatch={"centre_m": centre})) as simulation:
        sample = simulation.step()
        _, moment = simulation.airframe.external_wrench()
        places = np.array([jet.position_m for jet in simulation.vehicle.jets]) - centre
    assert np.abs(sample.tilt).max() < 1e-12
    forces = [(0.0, 0.0, -thrust) for thrust in sample.engines.thrust[: len(places)]]
    # N m, of 1.1 about roll: JSBSim's inches and pounds
    assert moment == pytest.approx(np.cross(places, forces).sum(axis=0), abs=1e-9)
    assert abs(moment[0]) > 1.0


def test_a_payload_is_mass_centre_and_inertia() -> None:
    """A point mass at (0, y, 0), once as JSBSim's own and once by the theorem of parallel axes."""
    stated, _ = load_vehicle("hexjet")
    whole, mass, y = stated.mass_kg, 0.4, 0.02
    steiner = whole * mass / (whole + mass) * y * y
    x_x, y_y, z_z = stated.inertia_kg_m2
    entry = {"kind": "payload", "start_s": 0.0, "mass_kg": mass, "offset_m": [0.0, y, 0.0]}
    drag = {"aero": {"drag_area_m2": [0.0, 0.0, 0.0]}}  # its place would be another
    carried = fly(doublet(disturbance=[entry], vehicle=drag))
    moved = {"mass_factor": 1.0 + mass / whole, "centre_m": [0.0, y * mass / (whole + mass), 0.0]}
    heavier = {"inertia_kg_m2": [x_x + steiner, y_y, z_z + steiner]}
    flown = fly(doublet(mismatch=moved, vehicle=heavier | drag))
    rate = carried.log["rate_p_rad_s"]
    assert np.ptp(rate) > 0.5
    # the mismatch is there from before the first step, and the payload from its beginning
    difference = flown.log["rate_p_rad_s"] - rate
    assert abs(difference[1]) < 1e-12
    assert np.max(np.abs(difference)) < 1e-9


def test_a_payload_stays_at_its_place_on_the_vehicle() -> None:
    entry = {"kind": "payload", "start_s": 0.0, "mass_kg": 1.0, "offset_m": [0.1, 0.2, 0.3]}
    with build(doublet(mismatch={"centre_m": [0.1, 0.2, 0.3]}, disturbance=[entry])) as simulation:
        simulation.step()
        mass, centre, _ = simulation.airframe.mass_properties()
    assert mass == pytest.approx(6.525, rel=1e-9)
    assert centre == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_a_resolved_flight_flies_again(tmp_path: Any) -> None:
    first = fly(doublet(mismatch={"mass_factor": 1.2, "thrust_factor_2": 0.9, "delay_samples": 2}), tmp_path / "run")
    again = fly(Scenario.load(tmp_path / "run" / "scenario.toml"))
    assert same(first, again)


P220 = {"aircraft": "hexjet-p220", "engine": "p220"}
QUADROTOR = {"aircraft": "quadrotor", "engine": "motor", "step_s": 0.0025}


@pytest.mark.parametrize(
    ("mismatch", "changes", "words"),
    [
        ({"mass_factor": 0.0}, {}, "mismatch.mass_factor = 0.0: should be greater than 0"),
        ({"thrust_factor_5": 0.5}, QUADROTOR, "has jets 1 to 4"),
        ({"mass_factor": 0.1}, P220, "of fuel in them"),
        ({"inertia_factor": 0.01}, P220, "that no body has"),
        ({"stretch": [3.0, 0.0, 0.0]}, {}, "mismatch.stretch.0 = 3.0: should be less than or equal to 2"),
        ({"engine_parameters": {"gian": 1.0}}, {}, "gian: no such parameter; did you mean 'gain'"),
        ({"stations": {"7": {"gain": 1.0}}}, {}, "mismatch.stations.7: hexjet has stations 1 to 6"),
        ({"stations": {"2": {"pole": 2.0}}}, {}, "pole = 2: must be a number from 0 to 0.999999"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(mismatch: dict[str, Any], changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as error:
        build(Scenario.load("hover").replace(expect=[], controller="baseline", mismatch=mismatch, **changes)).close()
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_parameter_that_is_not_known_flies_as_the_mismatch_of_its_effect() -> None:
    """A delay behind the same commands is the same to the last bit, whoever adds it."""
    later = fly(doublet(controller="baseline", mismatch={"engine_parameters": {"delay_samples": 35}}))
    assert same(later, fly(doublet(controller="baseline", mismatch={"delay_samples": 10})))
    assert not same(later, fly(doublet(controller="baseline")))


def test_parameters_of_a_station_that_are_not_known() -> None:
    unknown = {"engine_parameters": {"gain": 0.3, "pole": 0.9}, "stations": {"2": {"gain": 0.2}}}
    scenario = doublet(mismatch=unknown, stations={"3": {"engine": "edf"}, "4": {"parameters": {"gain": 0.25}}})
    vehicle, _ = scenario.resolved_vehicle()
    _, *stated = load_engines(scenario, vehicle)
    flown = flown_engines(scenario, vehicle, stated)
    assert [spec.parameters["gain"] for spec in stated] == [0.2554, 0.2554, 0.2554, 0.25, 0.2554, 0.2554]
    assert [spec.parameters["gain"] for spec in flown] == [0.3, 0.2, 0.2554, 0.3, 0.3, 0.3]
    assert [spec.parameters["pole"] for spec in flown] == [0.9, 0.9, 0.8748, 0.9, 0.9, 0.9]
    with build(scenario) as simulation:
        assert [spec.parameters for spec in simulation.stations] == [spec.parameters for spec in stated]
    assert flown_engines(doublet(), vehicle, stated) is stated
