"""Axes that hinges give, alone or beside thrust: their channels against closed forms, and what is designed on them."""

from __future__ import annotations

from functools import lru_cache
from math import exp
from pathlib import Path

import control
import numpy as np
import pytest
from long_cases import long_after, long_case
from places import ROOT

from cosim import fly
from cosim.base.arrays import Array
from cosim.base.constants import GRAVITY
from cosim.base.signals import AXES
from cosim.engine import EngineSpec, load_engine, make_bank
from cosim.simulation.axis_chain import compute_axis_fractions, compute_hinge_reactions, list_hinged_parts
from cosim.simulation.build import build
from cosim.simulation.controllers.allocators import make_effectiveness
from cosim.simulation.controllers.controller_file import Requirements, apply_controller, read_controller
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, engine_of, load_vehicle
from hexjet_design.assessment import assess, shipped_tuning
from hexjet_design.design import _AxisInputs, _scenario, _tune, axis_requirements, identify_hover, make_dynamics
from hexjet_design.loop.actuator import SERVO, Actuator
from hexjet_design.loop.channel import Channel, channels, engine_lead
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid, steps_by_response
from hexjet_design.loop.dynamics import make_lag_dynamics
from hexjet_design.tune import tune_digits

T, UP = 0.004, (0.0, 0.0, -1.0)


@lru_cache
def plants(aircraft: str) -> tuple[Vehicle, EngineSpec, dict[str, Channel]]:
    """The vehicle, its engine and its channels in hover."""
    scenario, vehicle = _scenario(engine_of(aircraft), aircraft, ())
    spec = load_engine(scenario.engine, scenario.engine_parameters, scenario.step_s)
    engine = Actuator.of(spec.name, make_dynamics(identify_hover(scenario, vehicle, spec, None)))
    return vehicle, spec, channels(scenario, vehicle, spec, engine)


def test_a_nozzles_channel_is_servo_inertia_and_gyro() -> None:
    """python-control's L of the quadjet's yaw, which nozzles alone give: held, sampled and closed as it is flown."""
    vehicle, spec, of = plants("quadjet")
    channel, hinge = of["yaw"], vehicle.hinges[0]
    assert channel.actuator.name == SERVO
    assert not channel.actuator.dynamics.unsure
    tuning = shipped_tuning(channel, vehicle, spec)
    gains, closed = tuning.gains, ClosedLoop(FrequencyGrid(channel), tuning)
    at, z = closed.points.z, control.tf([1.0, 0.0], [1.0], T)
    servo, gyro = exp(-T / hinge.lag_s), exp(-T / vehicle.sensors.gyro.filter_s)
    fall = channel.damping_1_s * T
    # factor by factor: one polynomial of as many poles near 1 loses its digits there
    rate = ((1.0 - servo) / (z - servo))(at) * (T * (1.0 - exp(-fall)) / fall * z / (z - exp(-fall)))(at)
    measured = ((1.0 - gyro) * z / (z - gyro))(at) + tuning.angle_gain * (T / 2.0 * (z + 1.0) / (z - 1.0))(at)
    loop = (gains.p + gains.i * T * z / (z - 1.0))(at) * rate * measured
    assert gains.d == 0.0
    assert np.abs(closed.open_loop / loop - 1.0).max() < 1e-9
    points = control.frd(loop, closed.points.theta / T, smooth=True)
    _, phase, *_ = control.stability_margins(points)
    told = assess(channel, tuning, Requirements(min_bandwidth_hz=0.0)).margins
    assert told is not None
    assert told.phase_deg == pytest.approx(phase, abs=0.05)


def test_the_room_of_an_axis_is_what_its_servos_follow() -> None:
    """Of the quadjet: the weight on its arm turned by the angle at which a lag sets out at the limit of the rate."""
    vehicle, _, of = plants("quadjet")
    hinge = vehicle.hinges[0]
    turn = min(0.26, hinge.rate_limit_rad_s * hinge.lag_s)
    alone = vehicle.mass_kg * GRAVITY * 0.2 / vehicle.inertia_kg_m2[0] * turn
    share = sum(compute_axis_fractions(vehicle, make_effectiveness(*_hover("quadjet")), 0).servos)
    assert of["roll"].room == pytest.approx(alone / share, rel=1e-4)


def _hover(aircraft: str) -> tuple[Scenario, Vehicle, EngineSpec]:
    scenario, vehicle = _scenario(engine_of(aircraft), aircraft, ())
    return scenario, vehicle, load_engine(scenario.engine, scenario.engine_parameters, scenario.step_s)


def test_what_turns_pushes_back_as_newton_has_it() -> None:
    """The trijet's turbojets about y: J + m d x h of each, over the body's tensor."""
    vehicle, _, _ = plants("trijet")
    hinge = vehicle.hinges[0]
    assert hinge.centre_m is None or hinge.centre_m == hinge.position_m
    moment = -hinge.inertia_kg_m2 * np.array(hinge.axis)
    assert compute_hinge_reactions(vehicle, T)[0] == pytest.approx(
        np.linalg.solve(np.array(vehicle.tensor), moment), rel=1e-6
    )


def leads(aircraft: str, index: int) -> Array:
    """Of each hinge, by Euler: the spools' momentum on its tilted axis, over the body's tensor, in s of its move's rate."""
    vehicle, spec, _ = plants(aircraft)
    scenario, _, _ = _hover(aircraft)
    allocator = make_effectiveness(scenario, vehicle, spec)
    thrusts = allocator.solve_hover((0.0, 0.0, 0.0))[0]
    rows = []
    for hinge, move in zip(vehicle.hinges, allocator.unit_changes(index)[0][len(vehicle.jets) :], strict=False):
        moment = np.zeros(3)
        for jet in hinge.carries:
            throttle = np.interp(thrusts[jet - 1], spec.rising_curve.thrust, spec.rising_curve.throttle)
            with make_bank([spec], T) as bank:
                momentum = vehicle.jets[jet - 1].spin * spec.rotor_inertia * bank.reset(float(throttle)).spool_speed[0]
            moment -= momentum * np.cross(hinge.axis, UP)
        rows.append(move * np.linalg.solve(np.array(vehicle.tensor), moment)[index])
    return np.array(rows)


def test_rotors_that_hinges_turn_lead_by_their_momentum() -> None:
    """The trijet's tilts against each other balance the vanes' push; its spools turn against each other too."""
    vehicle, spec, _ = plants("trijet")
    allocator = make_effectiveness(*_hover("trijet"))
    for index, samples in ((0, 6.4453), (1, 0.0), (2, 0.9649)):  # of the delay ledger
        parts = list_hinged_parts(vehicle, allocator, index, spec, T)
        tilts = next(part for part in parts if part.servos[:1] == (vehicle.hinges[0],))
        assert tilts.lead_s == pytest.approx(leads("trijet", index).sum(), rel=1e-4, abs=1e-9)
        # the ledger has each station's own engine, and the fan's share of the thrusts is another one
        assert sum(part.lead_s for part in parts) == pytest.approx(samples * T, rel=2e-3, abs=1e-4 * T)
    quadjet, spec, _ = plants("quadjet")  # what its hinges turn is a nozzle, and no spool
    parts = list_hinged_parts(quadjet, make_effectiveness(*_hover("quadjet")), 0, spec, T)
    assert max(abs(part.lead_s) for part in parts) < 1e-9


def test_rotors_that_thrust_speeds_up_lead_by_what_the_ledger_has() -> None:
    """A quadrotor's yaw by turbojets of 24 N with spools of their own; its other axes have none of it."""
    table = {"name": "x", "duration_s": 1.0, "aircraft": "quadrotor", "engine": "turbine-20", "controller": "baseline"}
    scenario = Scenario.from_table({**table, "step_s": T, "vehicle": {"mass_kg": 6.0}}, Path(), "x")
    with build(scenario) as simulation:
        vehicle, engine, ledger = simulation.vehicle, simulation.engine, simulation.ledger
    of = channels(scenario, vehicle, engine, Actuator.of("engine", make_lag_dynamics([0.2], 0.0, T)))
    (row,) = [row for row in ledger if row.kind == "lead"]
    assert (row.axis, row.samples) == ("yaw", pytest.approx(-29.7, abs=0.05))
    assert of["yaw"].shape == pytest.approx((1.0 - row.samples, row.samples, 0.0), rel=1e-9)
    for axis in ("roll", "pitch", "altitude"):
        assert of[axis].shape == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(("aircraft", "axis"), [("trijet", "roll"), ("trijet", "yaw"), ("jetwing", "pitch")])
def test_a_channel_by_hinges_of_several_lags_is_their_sum(aircraft: str, axis: str) -> None:
    """Servo by servo, each with its share, its reaction and the spools that it turns, to rounding; and in time as well."""
    vehicle, spec, of = plants(aircraft)
    channel, index = of[axis], AXES.index(axis)
    scenario, _, _ = _hover(aircraft)
    moves, effects = (
        np.array(column[len(vehicle.jets) :])
        for column in make_effectiveness(scenario, vehicle, spec).unit_changes(index)
    )
    lead, kick = leads(aircraft, index), compute_hinge_reactions(vehicle, T)[:, index]
    grid = FrequencyGrid(channel)
    back, whole, shares = 1.0 / grid.z, np.zeros(len(grid.z), complex), 0.0
    for k, hinge in enumerate(vehicle.hinges):
        pole = exp(-T / hinge.lag_s)
        answer = (1.0 - pole) / (grid.z - pole)
        own = moves[k] * effects[k] + lead[k] * (1.0 - back) / T + moves[k] * kick[k] * ((1.0 - back) / T) ** 2
        whole, shares = whole + own * answer, shares + moves[k] * effects[k]
    fall = channel.damping_1_s * T
    gained = (1.0 - exp(-fall)) / fall if fall else 1.0
    rate = whole / shares * T * gained * grid.z / (grid.z - exp(-fall)) * grid.measuring
    assert np.abs(grid.rate / rate - 1.0).max() < 1e-4  # the spools' speed is read around hover, by a small step
    tuning = shipped_tuning(channel, vehicle, spec)
    closed = ClosedLoop(grid, tuning)
    by_response = steps_by_response(channel, tuning, len(closed.steps.angle))
    assert closed.steps.angle == pytest.approx(by_response.angle, abs=1e-6)
    assert closed.steps.command == pytest.approx(by_response.command, abs=1e-6)


def test_slower_servos_are_the_same_hinges_with_longer_lags() -> None:
    """And a delay comes on top of that; both of what they turn is kept."""
    vehicle, spec, of = plants("trijet")
    slow = vehicle.model_copy(
        update={"hinges": [hinge.model_copy(update={"lag_s": 1.3 * hinge.lag_s}) for hinge in vehicle.hinges]}
    )
    scenario, _, _ = _hover("trijet")
    z = np.exp(1j * np.geomspace(1e-3, 3.0, 50))
    (there, _, _) = channels(scenario, slow, spec, of["altitude"].actuator)["roll"].responses(z)
    (longer, _, _) = of["roll"].with_lags(1.3).responses(z)
    assert np.abs(longer / there - 1.0).max() < 1e-9
    (late, _, _) = of["roll"].with_delay(2.0).with_lags(1.3).responses(z)
    assert np.abs(late / (there / z**2) - 1.0).max() < 1e-9


def test_what_is_given_beside_is_carried() -> None:
    """The trijet's pitch: servo 86 %, with a notch of the reaction, and thrust 14 %; of that at each frequency as much."""
    vehicle, spec, of = plants("trijet")
    channel = of["pitch"]
    assert channel.is_by_servo
    scenario, _, _ = _hover("trijet")
    moves, effects = make_effectiveness(scenario, vehicle, spec).unit_changes(1)
    jets = len(vehicle.jets)
    by_thrust = sum(m * e for m, e in zip(moves[:jets], effects[:jets], strict=True))
    engine = of["altitude"].actuator.dynamics
    kick = sum(m * k for m, k in zip(moves[jets:], compute_hinge_reactions(vehicle, T)[:, 1], strict=True))
    hertz = np.array([0.3, 0.5, 2.0, 4.0, 10.0])
    s = 2j * np.pi * hertz
    hold = np.exp(-s * T / 2)  # of both the same to the share that counts here
    turned = (1.0 - np.exp(-s * T)) / T
    servo = (1.0 + kick / (1.0 - by_thrust) * turned**2) / (1.0 + s * channel.actuator.dynamics.lag_s)
    whole = (1.0 - by_thrust) * servo + by_thrust * engine.hold_response(hertz) / hold
    carried = channel.actuator.dynamics.uncertainty(hertz)
    assert carried == pytest.approx(np.abs(whole / servo - 1.0), rel=0.05, abs=0.005)


@pytest.mark.parametrize(
    ("aircraft", "axis"), [long_case(("quadjet", "roll")), ("trijet", "pitch"), long_case(("jetwing", "yaw"))]
)
def test_an_axis_by_hinges_is_designed(aircraft: str, axis: str) -> None:
    """Also where thrusts give a part of it: every requirement is kept with what they add."""
    vehicle, spec, of = plants(aircraft)
    need = Requirements()
    found = _tune(of[axis], _AxisInputs(vehicle, spec, ("baseline",), need, "", True, None, lambda text: None), None)
    assert list(found.candidates) == ["baseline"]  # no lead: no engine answers
    assert found.after is not None
    assert found.after.stable
    assert found.after.peak_sensitivity is not None
    assert found.after.peak_sensitivity <= need.max_sensitivity
    assert found.after.tolerated is not None
    assert found.after.tolerated >= 1.0
    assert all(found.checks.values())


DESIGNED = ("trijet", "quadjet", "jetwing")


@pytest.mark.parametrize("axis", ["pitch", "roll", "yaw", "altitude"])
@pytest.mark.parametrize("aircraft", long_after(1, DESIGNED))
def test_a_design_beside_its_vehicle_is_what_todays_command_makes(aircraft: str, axis: str) -> None:
    """Engine, airframe and requirements of today: the search's last stage begun at the file stops there."""
    _, spec, of = plants(aircraft)
    path = ROOT / "aircraft" / aircraft / "design.toml"
    file = read_controller(path, aircraft)
    assert file.design.engine_sha256 == spec.identity
    designed, _ = load_vehicle(aircraft, file.vehicle)
    stands = shipped_tuning(of[axis], designed, spec)
    if stands.lead is not None:
        lead = engine_lead(of[axis])
        assert lead is not None
        assert stands.lead.natural_rad_s == pytest.approx(lead.natural_rad_s, rel=1e-5)
    need = axis_requirements(axis, file.design.requirements)
    again = tune_digits(of[axis], stands, need)
    assert again is not None
    assert again.angle_gain == pytest.approx(stands.angle_gain, rel=1e-9)
    assert again.gains.model_dump() == pytest.approx(stands.gains.model_dump(), rel=1e-9)
    told, record = assess(of[axis], again, need), file.design.axes[axis]
    assert told.peak_sensitivity == pytest.approx(record.peak_sensitivity, rel=1e-4)
    assert told.overshoot == pytest.approx(record.overshoot, abs=1e-4)
    assert told.settling_s == pytest.approx(record.settling_s, rel=1e-4)


@pytest.mark.long
@pytest.mark.parametrize("aircraft", DESIGNED)
def test_a_doublet_with_the_design_is_what_it_promises(aircraft: str) -> None:
    """Flown with noise and the engines themselves: overshoot and settling of roll.  Long."""
    path = ROOT / "aircraft" / aircraft / "design.toml"
    promised = read_controller(path, aircraft).design.axes["roll"]
    run = fly(apply_controller(f"{aircraft}-roll-doublet", path, ["expect=[]"]), report=False)
    assert run.outcome == "completed"
    roll = run.metrics["roll"]
    assert roll.overshoot_percent is not None
    assert promised.overshoot is not None
    assert promised.settling_s is not None
    # a tenth more, for noise and what is not linear, as a design's own proof allows
    assert roll.overshoot_percent <= 100.0 * promised.overshoot + 10.0
    assert roll.settling_time_s == pytest.approx(promised.settling_s, rel=0.25)
