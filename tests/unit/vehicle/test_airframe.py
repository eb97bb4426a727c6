"""The airframe against Newton, Euler and an independent r x F."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import closing, contextmanager
from math import cos, nan, pi, radians, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cosim.base.errors import FlightError, InputError
from cosim.base.frames import jet_axis
from cosim.base.signals import ZERO3, Disturbance, State, Vector3
from cosim.results.setup import describe_integration
from cosim.spec.scenario import Environment, Initial, Scenario
from cosim.spec.vehicle import Vehicle, load_vehicle
from cosim.vehicle._properties import Properties
from cosim.vehicle.airframe import INTEGRATION_METHOD_NAMES, Airframe, standing_height
from cosim.vehicle.jsbsim_model import render
from cosim.vehicle.jsbsim_units import POUND_FORCE

STEP = 0.004
NO_AERO = {"aero": {"drag_area_m2": [0.0, 0.0, 0.0], "damping_n_m_s": [0.0, 0.0, 0.0]}}
OFF = [ZERO3] * 6
CALM = Disturbance()


@contextmanager
def airframe(
    overrides: dict[str, object] | None = None, environment: Environment | None = None, substeps: int = 4, seed: int = 1
) -> Iterator[tuple[Airframe, Vehicle]]:
    vehicle, folder = load_vehicle("hexjet", overrides)
    with closing(Airframe(vehicle, folder, environment or Environment(), STEP, substeps, seed)) as frame:
        frame.reset(Initial(), OFF, ZERO3)
        yield frame, vehicle


def normal_gravity(latitude_deg: float, height: float) -> float:
    """Somigliana's formula for WGS 84 with the free-air gradient, m/s^2: attraction less centrifugal acceleration."""
    s2 = sin(radians(latitude_deg)) ** 2
    return 9.7803253359 * (1 + 0.00193185265241 * s2) / sqrt(1 - 0.00669437999013 * s2) - 3.0877e-6 * height


def thrust(vehicle: Vehicle, newtons: list[float], left: float, right: float) -> list[Vector3]:
    forces = []
    for jet, newton in zip(vehicle.jets, newtons, strict=True):
        x, y, z = jet_axis(left if jet.servo == "left" else right)
        forces.append((newton * x, newton * y, newton * z))
    return forces


@pytest.mark.parametrize("seed", range(20))
def test_force_and_moment_are_r_cross_f(seed: int) -> None:
    """To 1e-9 relative, also with a payload that moves the centre of gravity."""
    rng = np.random.default_rng(seed)
    with airframe() as (frame, vehicle):
        newtons = rng.uniform(0.0, 20.0, 6).tolist()
        forces = thrust(vehicle, newtons, *rng.uniform(-0.5, 0.5, 2).tolist())
        payload = (float(rng.uniform(0.1, 1.0)), *rng.uniform(-0.2, 0.2, 3).tolist()) if seed % 2 else (0.0,) * 4
        frame.step(forces, Disturbance(payload=payload))
        cg = np.array(payload[1:]) * payload[0] / (vehicle.mass_kg + payload[0])
        arms = np.array([jet.position_m for jet in vehicle.jets]) - cg
        force, moment = frame.external_wrench()
        expected = np.cross(arms, forces).sum(axis=0)
        assert force == pytest.approx(np.sum(forces, axis=0), rel=1e-9, abs=1e-9)
        assert np.linalg.norm(np.array(moment) - expected) <= 1e-9 * np.linalg.norm(expected)


def test_the_papers_closed_forms_under_the_sign_table() -> None:
    """Printed: z up, roll positive for more thrust at +y, yaw opposite to r x F.  README.md has the table."""
    with airframe() as (frame, vehicle):
        lx, ly, lz = vehicle.jets[0].position_m
        assert lx > 0.0
        up = -lz  # the paper's L_z counts upwards
        f_left, f_right, a1, a2 = 7.0, 9.0, 0.2, -0.1
        newtons = [f_left if jet.servo == "left" else f_right for jet in vehicle.jets]
        frame.step(thrust(vehicle, newtons, a1, a2), CALM)
        (fx, fy, fz), (mx, my, mz) = frame.external_wrench()
        assert fx == pytest.approx(3 * (f_left * sin(a1) + f_right * sin(a2)), rel=1e-9)  # + printed row
        assert fy == 0.0
        assert -fz == pytest.approx(3 * (f_left * cos(a1) + f_right * cos(a2)), rel=1e-9)  # - printed row

        # the printed moments assume equal thrust for pitch and yaw, no tilt for roll
        frame.step(thrust(vehicle, newtons, 0.0, 0.0), CALM)
        mx = frame.external_wrench()[1][0]
        assert -mx == pytest.approx(3 * (f_right * ly - f_left * ly), rel=1e-9)
        frame.step(thrust(vehicle, [f_left] * 6, a1, a2), CALM)
        _, my, mz = frame.external_wrench()[1]
        assert -my == pytest.approx(3 * f_left * up * (sin(a1) + sin(a2)), rel=1e-9)
        assert -mz == pytest.approx(3 * f_left * ly * (sin(a2) - sin(a1)), rel=1e-9)


def test_jets_stand_where_the_paper_puts_them() -> None:
    vehicle, _ = load_vehicle("hexjet")
    lx, ly, lz = vehicle.jets[0].position_m
    signs = [(1, 1), (-1, -1), (1, -1), (-1, 1), (0, 1), (0, -1)]  # L_1 to L_6
    assert [jet.position_m for jet in vehicle.jets] == [(sx * lx, sy * ly, lz) for sx, sy in signs]
    assert [jet.servo for jet in vehicle.jets] == ["right", "left", "left", "right", "right", "left"]


def test_roll_inertia_follows_from_the_identified_gain() -> None:
    """433.1 rad/s^2 per unit of throttle = 6 L_y T / J_xx with the EDF's thrust at full throttle."""
    vehicle, _ = load_vehicle("hexjet")
    full = 0.2554 / (1 - 0.8748) * 9.80665
    gain = 6 * vehicle.jets[0].position_m[1] * full / vehicle.inertia_kg_m2[0]
    assert gain == pytest.approx(433.1, rel=1e-4)  # the paper's digits


def test_payload_adds_mass_and_moves_centre_and_inertia() -> None:
    m, place = 0.8, np.array([0.1, -0.05, 0.07])
    with airframe() as (frame, vehicle):
        own = (vehicle.mass_kg, (0.0, 0.0, 0.0), vehicle.inertia_kg_m2)
        for found, stated in zip(frame.mass_properties(), own, strict=True):
            assert found == pytest.approx(stated, rel=1e-12, abs=1e-15)
        state = frame.step(OFF, Disturbance(payload=(m, *place.tolist())))
        mass, cg, inertia = frame.mass_properties()
        total = vehicle.mass_kg + m
        assert (state.mass, mass) == pytest.approx((total, total), rel=1e-12)
        assert cg == pytest.approx(place * m / total, rel=1e-9)
        # two bodies about their common centre: reduced mass times the distance squared
        reduced = vehicle.mass_kg * m / total
        expected = np.array(vehicle.inertia_kg_m2) + reduced * (place @ place - place**2)
        assert inertia == pytest.approx(expected, rel=1e-6)  # JSBSim's constants for inches and slugs are rounded
        state = frame.step(OFF, CALM)
        assert frame.mass_properties()[0] == pytest.approx(vehicle.mass_kg, rel=1e-12)
        assert state.mass == vehicle.mass_kg


@pytest.mark.parametrize("name", ["hexjet", "quadrotor"])
def test_the_file_in_the_repository_is_the_vehicle(name: str) -> None:
    """The model as bare JSBSim reads it says what vehicle.toml says."""
    vehicle, folder = load_vehicle(name)
    stated = ET.parse(folder / vehicle.model).getroot()
    flown = ET.fromstring(render(vehicle, folder / vehicle.model))
    to_si = {"KG": 1.0, "KG*M2": 1.0, "M": 1.0, "IN": 0.0254, "SLUG*FT2": 1.3558179483314004}
    to_si["LBS"] = 14.593902937206364 / 32.174049
    compared = 0
    for old, new in zip(stated.iter(), flown.iter(), strict=True):
        if old.tag == "location":
            for a, b in zip(old, new, strict=True):
                assert float(a.text or "") == pytest.approx(float(b.text or "") * to_si[new.get("unit", "")], abs=1e-12)
                compared += 1
        elif old.tag not in "xyz" and old.text != new.text:
            a, b = (float(e.text or "") * to_si.get(e.get("unit", ""), 1.0) for e in (old, new))
            assert a == pytest.approx(b, rel=1e-12), old.tag
            compared += 1
        elif old.get("value") != new.get("value"):
            assert float(old.get("value", "")) == pytest.approx(float(new.get("value", "")), rel=1e-3), old.text
            compared += 1
    assert compared > 35


def test_free_fall() -> None:
    """z = g t^2 / 2 with the normal gravity of the place, no drag."""
    with airframe(NO_AERO) as (frame, _):
        place = Environment()
        state = frame.reset(Initial(altitude_m=100.0), OFF, ZERO3)
        steps = 500
        for _ in range(steps):
            state = frame.step(OFF, CALM)
        t = steps * STEP
        g = normal_gravity(place.latitude_deg, 100.0 - g_half(t))
        # 1e-5: J2 against the whole ellipsoid (2e-6), the gradient over the fall (6e-6)
        assert state.position[2] + 100.0 == pytest.approx(0.5 * g * t * t, rel=1e-5)
        assert state.velocity[2] == pytest.approx(g * t, rel=1e-5)
        # the Earth turns away below: a third of Omega g t^3 cos(latitude) to the east
        east = 7.292115e-5 * g * t**3 * cos(radians(place.latitude_deg)) / 3
        assert state.position[1] == pytest.approx(east, rel=0.02)


def g_half(t: float) -> float:
    """About the mean depth of the fall."""
    return 9.8 * t * t / 6


def test_hover_equilibrium() -> None:
    """Thrust equal to the weight at the place: nothing moves."""
    with airframe(NO_AERO) as (frame, vehicle):
        weight = vehicle.mass_kg * normal_gravity(Environment().latitude_deg, 30.0)
        forces = thrust(vehicle, [weight / 6] * 6, 0.0, 0.0)
        state = frame.reset(Initial(altitude_m=30.0), forces, ZERO3)
        for _ in range(500):
            state = frame.step(forces, CALM)
        # 2e-6 g of the gravity formulas over 2 s
        assert state.velocity == pytest.approx((0.0, 0.0, 0.0), abs=2e-4)
        assert state.altitude == pytest.approx(30.0, abs=2e-4)
        # the local vertical turns with the Earth, at 7.3e-5 rad/s
        assert state.euler == pytest.approx((0.0, 0.0, 0.0), abs=2 * 7.3e-5)


def test_torque_free_spin_follows_euler() -> None:
    """Against an independent integration of Euler's equations: half the step leaves a quarter of the error."""

    def error(substeps: int) -> float:
        with airframe(NO_AERO, substeps=substeps) as (frame, vehicle):
            frame.reset(Initial(rate_deg_s=(100.0, 20.0, -60.0), altitude_m=500.0), OFF, ZERO3)
            start = frame.inertial_rate()
            for _ in range(250):
                frame.step(OFF, CALM)
            J = np.array(vehicle.inertia_kg_m2)
            exact = solve_ivp(lambda _, w: -np.cross(w, J * w) / J, (0.0, 1.0), start, rtol=1e-11, atol=1e-11)
            return float(np.linalg.norm(np.array(frame.inertial_rate()) - exact.y[:, -1]))

    coarse, fine = error(4), error(8)
    assert coarse < 1e-5  # rad/s, of 2.1
    assert coarse / fine == pytest.approx(4.0, rel=0.1)


def moments(count: int) -> np.ndarray:
    """Of roll, one a step: steps, then noise that changes from one step to the next."""
    return np.concatenate([np.full(5, 0.05), np.zeros(3), 0.03 * np.random.default_rng(4).standard_normal(count - 8)])


@pytest.mark.parametrize("where", ["outside", "rotors", "jets"])
@pytest.mark.parametrize("substeps", [3, 4, 7])
def test_a_held_moment_turns_the_body_from_the_steps_beginning(substeps: int, where: str) -> None:
    """After every step p is the sum of the moments so far times step / J, exactly; the angle to second order."""
    small = STEP / substeps
    with airframe(NO_AERO, substeps=substeps) as (frame, vehicle):
        rate = angle = 0.0
        levers = [jet.position_m[1] for jet in vehicle.jets]
        course = moments(40)
        for moment in course.tolist():
            forces = [(0.0, 0.0, -moment / (6 * y)) for y in levers] if where == "jets" else OFF
            outside = Disturbance(moment=(-moment, 0.0, 0.0)) if where == "outside" else CALM
            state = frame.step(forces, outside, (-moment, 0.0, 0.0) if where == "rotors" else ZERO3)
            before = rate
            rate -= moment / vehicle.inertia_kg_m2[0] * STEP
            angle += 0.5 * (before + rate) * STEP
            # the Earth's rate seen by a body that turns: 7e-5 rad/s times the angle
            assert state.rate[0] == pytest.approx(rate, rel=1e-9, abs=1e-7)
            # within the step the rate follows in its third run: less than one change times a run squared, for good
            assert state.euler[0] == pytest.approx(angle, abs=1.5 * small**2 * 0.15 / vehicle.inertia_kg_m2[0])
        assert abs(angle) > 1e-3


def test_two_runs_leave_a_quarter_of_a_change_to_the_next_step() -> None:
    with airframe(NO_AERO, substeps=2) as (frame, vehicle):
        rate = old = 0.0
        for moment in moments(40).tolist():
            state = frame.step(OFF, Disturbance(moment=(moment, 0.0, 0.0)))
            rate += moment / vehicle.inertia_kg_m2[0] * STEP
            early = 0.25 * (moment - old) / vehicle.inertia_kg_m2[0] * STEP / 2
            old = moment
            assert state.rate[0] == pytest.approx(rate + early, rel=1e-9, abs=1e-7)


def test_with_one_run_a_step_a_moment_is_half_a_step_late() -> None:
    """A constant roll moment from rest: p = M / J (t - step / 2) from the second step on."""
    with airframe(NO_AERO, substeps=1) as (frame, vehicle):
        moment = 0.05
        for k in range(1, 26):
            state = frame.step(OFF, Disturbance(moment=(moment, 0.0, 0.0)))
            expected = moment / vehicle.inertia_kg_m2[0] * (k * STEP - STEP / 2) if k > 1 else 0.0
            assert state.rate[0] == pytest.approx(expected, rel=1e-9, abs=1e-7)


def test_what_is_read_back_after_a_step_is_what_was_given() -> None:
    """The change that the first run carries on top is gone by then; a force acts at the centre of gravity."""
    with airframe(NO_AERO) as (frame, vehicle):
        for newtons in (5.0, 9.0, 2.0):
            forces = thrust(vehicle, [newtons] * 6, 0.0, 0.0)
            state = frame.step(forces, Disturbance(force=(newtons, -2.0, 3.0), moment=(0.0, newtons, 0.0)))
            force, moment = frame.external_wrench()
            assert force == pytest.approx((newtons, -2.0, 3.0 - 6 * newtons), rel=1e-12)
            assert moment == pytest.approx((0.0, newtons, 0.0), rel=1e-12, abs=1e-12)
            assert state.specific_force == pytest.approx(np.array(force) / vehicle.mass_kg, rel=1e-9)


def test_drag_is_quadratic_in_the_wind() -> None:
    """One step in a steady side wind: a = rho CdA v^2 / 2 m, with the ISA density at sea level."""
    with airframe() as (frame, vehicle):
        speed = 8.0
        state = frame.reset(Initial(altitude_m=2.0), OFF, (0.0, speed, 0.0))
        state = frame.step(OFF, Disturbance(wind=(0.0, speed, 0.0)))
        rho = 1.225 * (1 - 2.25577e-5 * 2.0) ** 4.2559
        expected = 0.5 * rho * vehicle.aero.drag_area_m2[1] * speed**2 / vehicle.mass_kg
        assert state.wind == pytest.approx((0.0, speed, 0.0), abs=1e-12)
        # the vehicle has hardly begun to drift after 4 ms
        assert state.specific_force[1] == pytest.approx(expected, rel=2e-3)


def test_stands_still_on_its_legs() -> None:
    with airframe() as (frame, vehicle):
        state = frame.reset(Initial(on_ground=True), OFF, ZERO3)
        for _ in range(500):
            state = frame.step(OFF, CALM)
        assert state.on_ground
        assert not state.hull_contact
        assert state.altitude == pytest.approx(standing_height(vehicle), abs=1e-4)
        assert state.velocity == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
        assert state.euler == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)


def test_what_a_run_says_of_its_integration_is_what_jsbsim_does() -> None:
    """Its properties read back, in the air and once the vehicle stands; the runs by JSBSim's own clock."""
    said = describe_integration(Scenario(name="x", duration_s=1.0, step_s=STEP, substeps=7))
    with airframe(substeps=7) as (frame, _):

        def methods_now() -> list[str]:
            keys = ("rate/rotational", "rate/translational", "position/rotational", "position/translational")
            return [INTEGRATION_METHOD_NAMES[frame._fdm.get_property_value(f"simulation/integrator/{n}")] for n in keys]

        before = frame._fdm.get_sim_time()
        frame.step(OFF, CALM)
        assert methods_now() == [said.rates, said.velocities, said.attitude, said.position]
        assert frame._fdm.get_sim_time() - before == pytest.approx(said.runs * said.run_s, rel=1e-12)
        frame.reset(Initial(on_ground=True), OFF, ZERO3)
        for _ in range(50):
            frame.step(OFF, CALM)
        assert methods_now() == [said.on_ground, said.on_ground, said.attitude, said.position]


@pytest.mark.parametrize("name", ["hexjet", "hexjet-p220"])
@pytest.mark.parametrize("substeps", [1, 4])
def test_friction_holds_and_leaves_nothing_swinging(name: str, substeps: int) -> None:
    """Set down with a sideways speed it slides v^2 / 2 mu g and stops; pushed with less than friction it stays.
    With Adams and Bashforth's method the rates would go on swinging from run to run, and with the rectangular rule for
    one kind of rate and theirs for the other the vehicle would creep by centimetres."""
    vehicle, folder = load_vehicle(name)
    with closing(Airframe(vehicle, folder, Environment(), STEP, substeps, 1)) as frame:
        weight, off = vehicle.mass_kg * 9.80665, [ZERO3] * len(vehicle.jets)
        frame.reset(Initial(altitude_m=standing_height(vehicle), velocity_ned_m_s=(1.5, 0.0, 0.0)), off, ZERO3)
        states = [frame.step(off, CALM) for _ in range(600)]
        # its nose digs in and rocks back, so that the weight on the legs is not steady while it slides
        assert states[-1].position[0] == pytest.approx(1.5**2 / (2 * 0.6 * 9.79), rel=0.05)
        for state in states[-200:]:
            assert state.velocity == pytest.approx(ZERO3, abs=1e-6)
            assert state.rate == pytest.approx(ZERO3, abs=1e-5)
        frame.reset(Initial(on_ground=True), off, ZERO3)
        push = Disturbance(force=(0.3 * weight, 0.1 * weight, 0.0), moment=(0.0, 0.0, 0.02 * weight))
        states = [frame.step(off, push) for _ in range(600)]
        for state in states[-200:]:
            assert state.velocity == pytest.approx(ZERO3, abs=1e-6)
            assert state.rate == pytest.approx(ZERO3, abs=1e-5)
        assert np.hypot(*states[-1].position[:2]) < 0.01
        assert abs(states[-1].euler[2]) < 1e-3


def test_falls_over_onto_its_hull() -> None:
    with airframe() as (frame, _):
        state = frame.reset(Initial(altitude_m=1.0, attitude_deg=(170.0, 0.0, 0.0)), OFF, ZERO3)
        for _ in range(250):
            state = frame.step(OFF, CALM)
            if state.hull_contact:
                break
        assert state.hull_contact


@pytest.mark.parametrize(("latitude", "ground"), [(-70.3, -12.3), (0.0, 2500.1), (48.2, 433.7), (89.0, 0.1)])
def test_the_height_is_jsbsims_own_to_the_last_bit(latitude: float, ground: float) -> None:
    """What is asked for in its place, the height over the ellipsoid less the ground's, costs a fraction of it."""
    with airframe(environment=Environment(latitude_deg=latitude, ground_m=ground)) as (frame, _):
        frame.reset(Initial(altitude_m=25.0, velocity_ned_m_s=(30.0, 20.0, -5.0)), OFF, ZERO3)
        for _ in range(25):
            state = frame.step(OFF, CALM)
            assert state.altitude == frame._fdm.get_property_value("position/h-agl-ft") * 0.3048


def test_position_is_counted_from_the_ground_below_the_start() -> None:
    place = Environment(ground_m=1200.0)
    with airframe(environment=place) as (frame, _):
        state = frame.reset(Initial(altitude_m=25.0), OFF, ZERO3)
        assert state.altitude == pytest.approx(25.0, abs=1e-6)
        assert state.position == pytest.approx((0.0, 0.0, -25.0), abs=1e-6)
        assert frame.latitude_longitude_deg() == pytest.approx((place.latitude_deg, place.longitude_deg), abs=1e-9)


@pytest.mark.parametrize("angles", [(10.0, -20.0, 30.0), (0.0, 0.0, -170.0), (-5.0, 40.0, 179.0)])
def test_initial_attitude_velocity_and_rates(angles: Vector3) -> None:
    initial = Initial(attitude_deg=angles, velocity_ned_m_s=(1.0, -2.0, 0.5), rate_deg_s=(10.0, -5.0, 3.0))
    with airframe() as (frame, _):
        state = frame.reset(initial, OFF, ZERO3)
        assert state.euler == pytest.approx([radians(a) for a in angles], abs=1e-9)
        assert all(-pi <= a <= pi for a in state.euler)
        assert state.velocity == pytest.approx(initial.velocity_ned_m_s, abs=1e-9)
        assert state.rate == pytest.approx([radians(r) for r in initial.rate_deg_s], abs=1e-9)


def test_gust_rises_holds_and_falls() -> None:
    """JSBSim's one-minus-cosine: half its size halfway up."""
    with airframe() as (frame, _):
        start = Disturbance(gust=((3.0, 4.0, 0.0), 0.4, 0.4, 0.4))
        speeds = [float(np.linalg.norm(frame.step(OFF, start if k == 0 else CALM).wind)) for k in range(400)]
        assert speeds[49] == pytest.approx(2.5, abs=0.04)  # 0.2 s; it grows by 0.04 m/s a step there
        assert max(speeds) == pytest.approx(5.0, rel=1e-9)
        assert speeds[-1] == 0.0


def test_gust_keeps_its_size_in_turbulence() -> None:
    """The gust adds to what the same turbulence is without it; some versions of JSBSim enlarge it."""
    place = Environment(turbulence_wind_m_s=6.0, turbulence_severity=3, wind_ned_m_s=(3.0, 0.0, 0.0))
    winds = []
    for gust in (None, ((0.0, 8.0, 0.0), 0.2, 0.4, 0.2)):
        with airframe(environment=place) as (frame, _):
            frame.reset(Initial(), OFF, place.wind_ned_m_s)
            calm = Disturbance(wind=place.wind_ned_m_s)
            first = Disturbance(wind=place.wind_ned_m_s, gust=gust)
            winds.append([frame.step(OFF, first if k == 0 else calm).wind for k in range(100)])
    added = np.subtract(winds[1], winds[0])
    # the vehicle moves with the wind, which changes the turbulence a little
    assert added[:, 1].max() == pytest.approx(8.0, rel=0.05)
    assert np.abs(added[:, 0]).max() < 0.5


def test_turbulence_has_the_size_that_the_standard_states() -> None:
    """MIL-F-8785C below 300 m: the vertical gusts' deviation is a tenth of the mean wind at 6 m.
    At 30 m in 10 m/s the gusts last about 3 s: 100 of them in 5 minutes, so that 25 % is three standard errors."""
    mean_wind = 8.0
    place = Environment(turbulence_wind_m_s=mean_wind, turbulence_severity=3, wind_ned_m_s=(10.0, 0.0, 0.0))
    with airframe(NO_AERO, environment=place, substeps=1) as (frame, vehicle):
        weight = vehicle.mass_kg * normal_gravity(place.latitude_deg, 30.0)
        forces = thrust(vehicle, [weight / 6] * 6, 0.0, 0.0)
        frame.reset(Initial(altitude_m=30.0), forces, place.wind_ned_m_s)
        steady = Disturbance(wind=place.wind_ned_m_s)
        down = [frame.step(forces, steady).wind[2] for _ in range(75_000)]
    assert np.std(down) == pytest.approx(0.1 * mean_wind, rel=0.25)


def test_turbulence_follows_the_seed() -> None:
    place = Environment(turbulence_wind_m_s=8.0, turbulence_severity=4, wind_ned_m_s=(5.0, 0.0, 0.0))

    def winds(seed: int) -> list[Vector3]:
        with airframe(environment=place, seed=seed) as (frame, _):
            frame.reset(Initial(), OFF, place.wind_ned_m_s)
            return [frame.step(OFF, Disturbance(wind=place.wind_ned_m_s)).wind for _ in range(50)]

    assert winds(1) == winds(1)
    assert winds(1) != winds(2)
    assert float(np.std(winds(1), axis=0).min()) > 0.0


def test_a_model_that_cannot_be_read_is_refused(tmp_path) -> None:
    vehicle, folder = load_vehicle("hexjet")
    broken = tmp_path / "broken.xml"
    broken.write_text((folder / vehicle.model).read_text()[:500])
    with pytest.raises(InputError, match=r"broken\.xml: not valid XML"):
        render(vehicle, broken)
    with pytest.raises(InputError, match="No such file"):
        render(vehicle, tmp_path / "none.xml")


def fall(model: str | None, folder: Path, overrides: dict[str, object] | None = None) -> list[State]:
    """A push that turns and moves it, by the model of this text."""
    vehicle, _ = load_vehicle("hexjet", overrides)
    if model is not None:
        (folder / "own.xml").write_text(model)
    named = vehicle.model_copy(update={"model": None if model is None else "own.xml"})
    with closing(Airframe(named, folder, Environment(), STEP, 4, 1)) as frame:
        forces = [(0.3 * jet, 0.1, -9.0 + jet) for jet in range(6)]
        states = [frame.reset(Initial(altitude_m=10.0, attitude_deg=(5.0, 0.0, 20.0)), forces, ZERO3)]
        payload = Disturbance(payload=(0.5, 0.1, 0.0, 0.05))
        return states + [frame.step(forces, payload) for _ in range(50)]


def shipped_model() -> str:
    vehicle, folder = load_vehicle("hexjet")
    return (folder / vehicle.model).read_text()


@pytest.mark.parametrize("model", [None, "<fdm_config/>", "<fdm_config><aerodynamics/><mass_balance/></fdm_config>"])
def test_what_a_flight_needs_in_a_model_is_added(tmp_path: Path, model: str | None) -> None:
    assert fall(model, tmp_path) == fall(shipped_model(), tmp_path)


def test_places_in_a_model_are_from_its_centre_of_gravity(tmp_path: Path) -> None:
    """The same vehicle in a structural frame of its own: reference points a metre ahead, in inches."""
    moved = shipped_model().replace(
        '<location name="CG" unit="M"><x>0</x><y>0</y><z>0</z></location>',
        '<location name="CG" unit="IN"><x>100</x><y>0</y><z>-10</z></location>',
    )
    assert moved != shipped_model()
    moved = moved.replace('name="EYEPOINT" unit="M"><x>0</x>', 'name="EYEPOINT" unit="M"><x>-3</x>')
    assert fall(moved, tmp_path) == fall(shipped_model(), tmp_path)


def test_contacts_are_those_of_the_vehicle_in_its_order(tmp_path: Path) -> None:
    root = ET.fromstring(shipped_model())
    ground = root.find("ground_reactions")
    ground[:] = [*ground[5:], *ground[2:3]]
    assert fall(ET.tostring(root, encoding="unicode"), tmp_path) == fall(shipped_model(), tmp_path)


def test_an_aerodynamics_of_its_own_flies(tmp_path: Path) -> None:
    """Lift by a table over the angle of attack, from a file beside it: one second of it against the sum by hand."""
    part = (
        '<aerodynamics><axis name="Z"><function name="aero/force/own"><product><value>-2.0</value>'
        "<table><independentVar>aero/qbar-psf</independentVar><tableData>0 0\n100 100</tableData></table>"
        "</product></function></axis></aerodynamics>"
    )
    (tmp_path / "wing.xml").write_text(part)
    own = fall('<fdm_config><aerodynamics file="wing"/></fdm_config>', tmp_path)
    still = {"aero": {"drag_area_m2": [0.0, 0.0, 0.0], "damping_n_m_s": [0.0, 0.0, 0.0]}}
    none = fall(None, tmp_path, still)
    # q is 0.5 rho v^2, and the table gives as many pounds as it has pounds in a square foot
    expected = np.array([2.0 * 0.5 * 1.225 * np.dot(s.velocity, s.velocity) * 0.3048**2 / 6.025 for s in none[:-1]])
    lifted = np.cumsum(expected)[-1] * STEP
    assert none[-1].velocity[2] - own[-1].velocity[2] == pytest.approx(lifted, rel=0.05)
    assert fall(None, tmp_path)[-1] != own[-1]


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ("<config/>", "its root is config, not fdm_config"),
        ('<fdm_config><aerodynamics file="none"/></fdm_config>', r"aerodynamics file='none': .*none: no such file"),
        ("<fdm_config><propulsion><engine/></propulsion></fdm_config>", "engines are FMUs here"),
        (
            '<fdm_config><mass_balance><pointmass name="pilot"><weight>1</weight></pointmass></mass_balance></fdm_config>',
            "pointmass pilot: mass_kg in vehicle.toml is the whole vehicle's",
        ),
    ],
)
def test_what_a_model_cannot_have_is_one_line(tmp_path: Path, model: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        fall(model, tmp_path)


def test_properties_in_one_call_are_the_same_bits_one_by_one() -> None:
    names = ["position/geod-alt-ft", "velocities/p-rad_sec", "attitude/phi-rad", "inertia/mass-slugs"]
    with airframe() as (frame, _):
        groups = [(*[frame._property(name) for name in names[i : i + 3]], 0.3048) for i in range(2)]
        read = Properties(groups)
        frame.reset(Initial(attitude_deg=(3.0, 2.0, 40.0)), OFF, (1.0, -2.0, 0.0))
        for step in range(10):
            forces = [(0.1 * step, 0.2 if step > 5 else 0.0, -14.0 - jet - step / 3.0) for jet in range(6)]
            frame.step(forces, CALM)
            fx, fy, fz = [frame._property(f"external_reactions/jet1/{axis}").get_double_value() for axis in "xyz"]
            assert (fx * POUND_FORCE, fy * POUND_FORCE, fz * POUND_FORCE) == pytest.approx(forces[0], rel=1e-15)
        assert read.read() == tuple(tuple(node.get_double_value() * 0.3048 for node in group[:3]) for group in groups)


def test_equal_forces_are_written_as_others_are() -> None:
    def seen(forces: list[list[Vector3]]) -> list[State]:
        with airframe() as (frame, _):
            return [frame.step(each, CALM) for each in forces]

    rng = np.random.default_rng(1)
    numbers = [rng.uniform(-20.0, 20.0, (6, 3)).tolist() for _ in range(4)]
    alike = [[(x, y, z) for x, y, z in each] for each in numbers]
    for k, each in enumerate(alike):
        for jet in range(k, 6):  # from all by one object to two by one, and five of which room is for four
            each[jet] = each[jet % (k + 1)]
    apart = [[(x + 0.0, y, z) for x, y, z in each] for each in alike]
    assert all(a is not b for each in apart for a, b in itertools.combinations(each, 2))
    assert seen(alike) == seen(apart)
    five = [[(float(jet), 0.0, -15.0) for jet in range(6)] for _ in range(3)]
    five[1][5] = five[1][0]
    assert seen(five) == seen([[(x + 0.0, y, z) for x, y, z in each] for each in five])


def test_what_is_no_property_and_forces_of_the_wrong_kind_are_refused() -> None:
    with airframe() as (frame, _):
        with pytest.raises(TypeError, match="takes a list of 6 vectors"):
            frame.step(OFF[:5], CALM)
        with pytest.raises(TypeError, match="tuples of three floats"):
            frame.step([(0.0, 0.0)] * 6, CALM)
        with pytest.raises(AttributeError, match="get_double_value"):
            Properties([(1, 2, 3, 1.0)])


def test_a_state_that_is_not_finite_ends_the_flight() -> None:
    with airframe() as (frame, _), pytest.raises(FlightError, match="not finite"):
        frame.step([(nan, 0.0, -15.0)] * 6, CALM)
