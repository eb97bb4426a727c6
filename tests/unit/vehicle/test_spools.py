"""Spinning rotors, burnt fuel and the air at the intakes, against closed forms and independent integrations."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from math import cos, pi, radians, sin
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flights import Rows
from scipy.integrate import solve_ivp

import cosim.engine.isolated
from cosim import fly
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.frames import jet_axis
from cosim.base.signals import ZERO3, Ambient, Disturbance, EngineOutput, PerJet, Vector3
from cosim.engine import EngineBank
from cosim.simulation.build import build
from cosim.simulation.step import Simulation
from cosim.spec.scenario import Environment, Initial, Scenario
from cosim.spec.vehicle import Jet, Vehicle, load_vehicle
from cosim.vehicle.airframe import Airframe
from cosim.vehicle.effects.rotors import RotorDynamics
from cosim.vehicle.tank import Tank

STEP = 0.004
NO_AERO: dict[str, Any] = {"aero": {"drag_area_m2": [0.0, 0.0, 0.0], "damping_n_m_s": [0.0, 0.0, 0.0]}}
OFF = [ZERO3] * 6
CALM = Disturbance()
NO_GAINS = {"p": 0.0, "i": 0.0, "d": 0.0}
LOOSE = {"control": {"rate": dict.fromkeys(("roll", "pitch", "yaw"), NO_GAINS)}}
# slow enough for a turbine of 24 N on the scaled airframe; chosen by us, for these tests alone
GENTLE: dict[str, Any] = {
    "control": {
        "attitude": {"gain_1_s": [0.4, 2.0, 1.0]},
        "rate": {"roll": {"p": 0.004, "i": 0.0}},
        "altitude": {"position_1_s": 0.3, "velocity_1_s": 0.8, "integral_1_s2": 0.15},
    }
}


@contextmanager
def airframe(overrides: dict[str, Any], substeps: int = 4, spools: bool = True) -> Iterator[tuple[Airframe, Vehicle]]:
    vehicle, folder = load_vehicle("hexjet", overrides)
    with closing(Airframe(vehicle, folder, Environment(), STEP, substeps, 1, spools)) as frame:
        yield frame, vehicle


def scenario(**changes: Any) -> Scenario:
    base: dict[str, Any] = {
        "name": "test", "duration_s": 4.0, "sensor_noise": False, "controller": "baseline", "engine": "turbine-20",
    }  # fmt: skip
    return Scenario.from_table(base | changes, Scenario.load("hover").folder, "test")


def spinning(*spins: int) -> dict[str, Any]:
    return {str(place): {"spin": spin} for place, spin in enumerate(spins)}


def spools(spins: tuple[int, ...], inertia: float = 2e-5) -> RotorDynamics:
    sides = ("right", "left", "left", "right", "right", "left")
    jets = [Jet(position_m=ZERO3, servo=side, spin=spin) for side, spin in zip(sides, spins, strict=True)]
    engine = SimpleNamespace(name="made up", rotor_inertia=inertia, has_port=lambda port: True)
    return RotorDynamics(jets, [engine] * 6, STEP)


def test_the_impulse_on_the_airframe_is_the_momentum_that_the_spools_gain() -> None:
    """Whatever speeds and tilts do in between, to rounding."""
    rng = np.random.default_rng(3)
    some = spools((1, -1, 1, 1, -1, 1))
    some.reset(tuple(rng.uniform(0.0, 2e4, 6).tolist()))
    before = np.array(some.momentum)
    impulse = np.zeros(3)
    for _ in range(100):
        impulse += STEP * np.array(
            some.update(tuple(rng.uniform(0.0, 2e4, 6).tolist()), tuple(rng.uniform(-0.5, 0.5, 2)))
        )
    np.testing.assert_allclose(impulse, before - np.array(some.momentum), rtol=0.0, atol=1e-12)


def test_momentum_is_along_the_thrust_for_a_right_handed_rotor() -> None:
    some = spools((1, 0, 0, 0, 0, 0))  # jet 1, on the right bank
    some.reset((1e4,) * 6)
    assert some.momentum == pytest.approx((0.0, 0.0, -0.2), abs=1e-15)
    some.update((1e4,) * 6, (0.3, -0.2))
    assert some.momentum == pytest.approx(tuple(0.2 * e for e in jet_axis(-0.2)), abs=1e-15)


def test_turning_the_axes_takes_a_moment() -> None:
    """Both banks tilt at a constant rate: -dH/dt is tilt rate x e_y x H, as positive tilt turns about -y."""
    some = spools((1,) * 6)
    speeds, rate = (1e4,) * 6, 2.0
    some.reset(speeds)
    found = np.array([some.update(speeds, (rate * STEP * k, rate * STEP * k)) for k in range(1, 51)])
    middle = rate * STEP * (np.arange(50) + 0.5)  # where a central difference belongs
    axes = np.array([jet_axis(angle) for angle in middle])
    expected = rate * np.cross([0.0, 1.0, 0.0], 6 * 0.2 * axes)
    # the difference over a step is sin(x) / x of the derivative, x half the turn of a step
    np.testing.assert_allclose(found, expected * np.sinc(rate * STEP / 2 / pi), rtol=1e-9, atol=1e-9)


def test_the_logged_moment_is_the_change_and_the_gyroscopic_part() -> None:
    some = spools((1, 1, 1, 1, 1, 1))
    some.reset((1e4,) * 6)
    change = some.update((1.1e4,) * 6, (0.1, 0.2))
    rate: Vector3 = (0.3, -0.2, 0.5)
    expected = np.array(change) - np.cross(rate, some.momentum)
    assert some.moment(change, rate) == pytest.approx(tuple(expected), rel=1e-14)


def test_rotors_that_turn_alternately_cancel_exactly() -> None:
    some = spools((1, 1, -1, -1, 1, -1))  # on the right bank 1 -1 1, on the left 1 -1 -1: one left over on each
    some.reset((1e4,) * 6)
    assert some.momentum == (0.0, 0.0, 0.0)
    assert some.update((1.2e4,) * 6, (0.1, 0.1)) == (0.0, 0.0, 0.0)
    # tilted apart the banks' remainders no longer cancel
    some.update((1.2e4,) * 6, (0.1, -0.1))
    assert some.momentum == pytest.approx((-2 * 0.24 * sin(0.1), 0.0, 0.0), rel=1e-12)


def test_a_rotor_whose_speed_is_not_told_is_refused() -> None:
    engine = SimpleNamespace(name="silent", rotor_inertia=1e-5, has_port=lambda port: False)
    with pytest.raises(InputError, match=r"engine silent at station 2: .* no output spool_speed"):
        RotorDynamics([Jet(position_m=ZERO3), Jet(position_m=ZERO3, spin=1)], [engine] * 2, STEP)
    assert not RotorDynamics([Jet(position_m=ZERO3)], [engine], STEP).is_active


@pytest.mark.parametrize("momentum", [(0.0, 0.0, -0.5), (0.2, 0.0, -0.4)])
def test_a_free_gyroscope_follows_euler(momentum: Vector3) -> None:
    """Against an independent integration of J w' = -w x (J w + H): half the step leaves a quarter of the error."""

    def error(substeps: int) -> float:
        with airframe(NO_AERO, substeps) as (frame, vehicle):
            frame.reset(Initial(rate_deg_s=(60.0, 20.0, -30.0), altitude_m=500.0), OFF, ZERO3, momentum)
            start = frame.inertial_rate()
            for _ in range(250):
                frame.step(OFF, CALM)
            J, H = np.array(vehicle.inertia_kg_m2), np.array(momentum)
            exact = solve_ivp(lambda _, w: -np.cross(w, J * w + H) / J, (0.0, 1.0), start, rtol=1e-11, atol=1e-11)
            return float(np.linalg.norm(np.array(frame.inertial_rate()) - exact.y[:, -1]))

    coarse, fine = error(8), error(16)
    # 5/12 (w h)^2 of the angle w t is the rule's error in phase: 1e-4 at 10 rad/s of nutation, of 1.2 rad/s
    assert coarse < 3e-4  # rad/s
    assert coarse / fine == pytest.approx(4.0, rel=0.1)


def test_nutation_neither_grows_nor_dies() -> None:
    """A symmetric body with a rotor about z, rocked: p and q turn at ((C - A) r + H_z) / A for good.
    Closed form.  With the rectangular rule the swing would grow by a factor of 1.5 in these two seconds."""
    A, C, H = 0.05, 0.07, -1.0
    with airframe({**NO_AERO, "inertia_kg_m2": [A, A, C]}) as (frame, _):
        frame.reset(Initial(rate_deg_s=(10.0, 0.0, 0.0), altitude_m=500.0), OFF, ZERO3, (0.0, 0.0, H))
        (p0, q0, r0), rates = frame.inertial_rate(), []
        for _ in range(500):
            frame.step(OFF, CALM)
            rates.append(frame.inertial_rate())
    turning = ((C - A) * r0 + H) / A
    t = STEP * np.arange(1, 501)
    swing = np.hypot([p for p, _, _ in rates], [q for _, q, _ in rates])
    np.testing.assert_allclose(swing, np.hypot(p0, q0), rtol=1e-3)
    # one rad of phase in 5/12 (turning h)^2 of the angle, the error of the second-order rule
    phase = np.unwrap(np.arctan2([q for _, q, _ in rates], [p for p, _, _ in rates]))
    expected = np.arctan2(q0, p0) + turning * t
    np.testing.assert_allclose(phase, expected, atol=1.2 * 5 / 12 * (turning * 1e-3) ** 2 * 40.0)


def test_spinning_up_turns_the_airframe_the_other_way() -> None:
    """Six rotors alike: J_zz times the rate gained is the momentum that the spools have gained."""
    some = spools((1,) * 6)
    some.reset((1e4,) * 6)
    with airframe(NO_AERO) as (frame, vehicle):
        frame.reset(Initial(), OFF, ZERO3, some.momentum)
        for speed in np.linspace(1e4, 1.2e4, 51)[1:].tolist():
            moment = some.update((speed,) * 6, (0.0, 0.0))
            frame.set_momentum(some.momentum)
            frame.step(OFF, CALM, moment)
        state = frame.step(OFF, CALM, ZERO3)
    expected = 6 * 2e-5 * 2e3 / vehicle.inertia_kg_m2[2]
    # the Earth's rate seen by a body that turns: 7e-5 rad/s times the angle
    assert state.rate[2] == pytest.approx(expected, rel=1e-6)
    assert abs(state.rate[0]) + abs(state.rate[1]) < 1e-4


def test_an_airframe_without_spools_is_the_files_own() -> None:
    with airframe(NO_AERO, spools=False) as (plain, _), airframe(NO_AERO, spools=True) as (other, _):
        assert plain.sha256 != other.sha256
        states = []
        for frame in (plain, other):
            frame.reset(Initial(rate_deg_s=(60.0, 20.0, -30.0)), OFF, ZERO3)
            states.append([frame.step(OFF, CALM) for _ in range(50)])
    assert states[0] == states[1]


@pytest.mark.parametrize("spins", [(1, 1, 1, 1, 1, 1), (1, -1, -1, 1, -1, 1)], ids=["alike", "alternately"])
def test_angular_momentum_is_kept_through_a_burst_of_throttle(spins: tuple[int, ...]) -> None:
    """Rate gains at zero, collective up: J_zz r - sum s J w stays what it was, from the log alone."""
    flown = scenario(
        initial={"altitude_m": 100.0},
        command=[
            {"kind": "step", "signal": "collective", "start_s": 0.0, "amplitude": 0.37},
            {"kind": "step", "signal": "collective", "start_s": 0.4, "amplitude": 0.2},
        ],
        vehicle={**NO_AERO, **LOOSE, "jets": spinning(*spins)},
    )
    rows = Rows()
    with build(flown) as simulation:
        ending = simulation.run([rows])
        inertia, vehicle = simulation.engine.rotor_inertia, simulation.vehicle
    assert ending.outcome == "completed", ending.reason
    assert inertia > 0.0
    speeds = np.array([row.engines.spool_speed for row in rows.samples])
    rate = np.array([row.state.rate[2] for row in rows.samples])
    gained = inertia * (speeds[:-1] @ spins - speeds[0] @ spins)
    # the spools' speed is at the step's end, the airframe's rate at its beginning: a step of the acceleration
    slack = 1.1 * np.abs(np.diff(gained)).max() + 1e-6
    np.testing.assert_allclose(vehicle.inertia_kg_m2[2] * rate[1:], gained, atol=slack)
    assert abs(gained).max() == pytest.approx(0.0, abs=1e-12) if sum(spins) == 0 else abs(gained).max() > 0.05


def test_a_flying_vehicle_nutates_with_its_engines() -> None:
    """Six turbines alike, rocked once while they spool up: J w' = -H' - w x (J w + H), H from the log, by scipy."""
    flown = scenario(
        duration_s=0.6,
        initial={"altitude_m": 100.0, "rate_deg_s": [20.0, 0.0, 0.0]},
        command=[{"kind": "step", "signal": "collective", "start_s": 0.0, "amplitude": 0.8}],
        vehicle={**NO_AERO, **LOOSE, "jets": spinning(*(1,) * 6)},
    )
    rows = Rows()
    with build(flown) as simulation:
        simulation.run([rows])
        inertia, J = simulation.engine.rotor_inertia, np.array(simulation.vehicle.inertia_kg_m2)
    samples = rows.samples
    times = np.array([sample.time for sample in samples])
    momentum = -inertia * np.array([sum(sample.engines.spool_speed) for sample in samples])  # at the steps' ends

    def turning(t: float, w: np.ndarray) -> np.ndarray:
        H = float(np.interp(t, times + STEP, momentum))
        growing = float(np.interp(t, times[1:] + STEP / 2, np.diff(momentum) / STEP))
        return np.asarray((-np.cross(w, J * w + [0.0, 0.0, H]) - [0.0, 0.0, growing]) / J)

    exact = solve_ivp(turning, (0.0, times[-1]), samples[0].state.rate, t_eval=times, rtol=1e-8, max_step=0.01)
    found = np.array([sample.state.rate for sample in samples])
    # the air that rolling blows at the intakes damps it: up to a twentieth of the swing in this time
    np.testing.assert_allclose(found, exact.y.T, atol=0.05 * radians(20.0))
    assert np.abs(found[:, 1]).max() > radians(15.0)  # roll has gone over into pitch
    assert momentum[-1] < 1.05 * momentum[0]


def test_the_log_states_the_spools_moment() -> None:
    """Recomputed from the columns of speeds, tilts and rates."""
    push = {"kind": "moment", "start_s": 0.4, "duration_s": 0.2, "moment_n_m": [0.1, 0.1, 0.1]}
    vehicle = {**GENTLE, "jets": spinning(1, 1, -1, 1, 1, 1)}
    run = fly(scenario(duration_s=1.6, vehicle=vehicle, disturbance=[push]))
    log = run.log
    inertia = load_inertia()
    spins = {1: 1, 2: 1, 3: -1, 4: 1, 5: 1, 6: 1}
    momentum = np.zeros((len(log), 3))
    for jet, spin in spins.items():
        tilt = log["tilt_left_rad" if jet in (2, 3, 6) else "tilt_right_rad"]
        axis = np.stack([np.sin(tilt), 0.0 * tilt, -np.cos(tilt)], axis=1)
        momentum += (spin * inertia * log[f"spool_speed_{jet}_rad_s"])[:, None] * axis
    rates = np.stack([log[f"rate_{axis}_rad_s"] for axis in "pqr"], axis=1)
    expected = -np.diff(momentum, axis=0) / STEP - np.cross(rates, momentum)[1:]
    found = np.stack([log[f"spool_moment_{axis}_N_m"] for axis in "xyz"], axis=1)[1:]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9)
    assert np.abs(found[150:]).max() > 0.01


def load_inertia() -> float:
    from cosim.engine import load_engine

    return load_engine("turbine-20", {}, STEP).rotor_inertia


def test_engines_without_rotors_leave_the_moment_unknown() -> None:
    run = fly(scenario(engine="edf-as-flown", duration_s=0.2, vehicle={"jets": spinning(*(1,) * 6)}))
    for axis in "xyz":
        assert np.isnan(run.log[f"spool_moment_{axis}_N_m"]).all()
    assert np.isnan(run.log["fuel_kg"]).all()
    assert np.isnan(run.log["spool_speed_3_rad_s"]).all()


def test_a_tank_counts_what_is_burnt() -> None:
    tank = Tank(1.0, 0.5)
    assert not tank.burn((float("nan"), 0.0, -1.0))
    assert tank.burn((0.5, float("nan"), 0.25))
    assert tank.burnt == 0.375
    assert not tank.empty
    assert tank.burn((9.0,))
    assert tank.empty
    assert (tank.burnt, tank.remaining) == (1.0, 0.0)
    assert not tank.burn((9.0,))
    tank.reset()
    assert tank.remaining == 1.0


@pytest.mark.parametrize("payload", [(0.0, 0.0, 0.0, 0.0), (0.4, 0.05, -0.1, 0.02)])
def test_burnt_fuel_moves_mass_centre_of_gravity_and_inertia(payload: tuple[float, float, float, float]) -> None:
    """By the theorem of parallel axes, from the vehicle as built less a point mass."""
    fuel, place = 1.2, np.array([0.05, 0.02, 0.06])
    with airframe({"fuel": {"mass_kg": fuel, "position_m": place.tolist()}}) as (frame, vehicle):
        frame.reset(Initial(), OFF, ZERO3)
        before = frame.mass_properties()
        assert before[0] == pytest.approx(vehicle.mass_kg, rel=1e-12)
        assert before[2] == pytest.approx(vehicle.inertia_kg_m2, rel=1e-12)
        burnt = 0.7
        frame.burn(burnt)
        state = frame.step(OFF, Disturbance(payload=payload))
        mass, cg, inertia = frame.mass_properties()
    assert state.mass == pytest.approx(vehicle.mass_kg - burnt + payload[0], rel=1e-14)
    assert mass == pytest.approx(vehicle.mass_kg - burnt + payload[0], rel=1e-12)
    parts = [(-burnt, place), (payload[0], np.array(payload[1:]))]
    expected_cg = sum(m * r for m, r in parts) / mass
    np.testing.assert_allclose(cg, expected_cg, rtol=1e-9, atol=1e-12)
    moments = np.array(vehicle.inertia_kg_m2)
    for m, r in parts:
        moments += m * (r @ r - r * r)
    moments -= mass * (expected_cg @ expected_cg - expected_cg * expected_cg)
    np.testing.assert_allclose(inertia, moments, rtol=1e-9)


def test_mass_falls_by_what_the_engines_say_they_burn() -> None:
    """To 1e-9 kg: the sum of the logged flows times the step; the log's mass is that at the step's beginning."""
    vehicle = {**GENTLE, "fuel": {"mass_kg": 0.4, "position_m": [0.01, 0.0, 0.02]}}
    run = fly(scenario(duration_s=4.0, vehicle=vehicle))
    assert run.outcome == "completed", run.reason
    log = run.log
    flow = sum(log[f"fuel_flow_{jet}_kg_s"] for jet in range(1, 7))
    assert flow.min() > 1e-3
    burnt = np.concatenate([[0.0], np.cumsum(flow[:-1]) * STEP])
    np.testing.assert_allclose(log["mass_kg"], 5.525 - burnt, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(log["fuel_kg"], 0.4 - burnt, rtol=0.0, atol=1e-9)


def test_an_empty_tank_stops_every_engine() -> None:
    """The engines run down on their own equations, nothing more is burnt, and the vehicle comes down."""
    vehicle = {**GENTLE, "fuel": {"mass_kg": 0.004, "position_m": [0.0, 0.0, 0.0]}}
    run = fly(scenario(duration_s=6.0, initial={"altitude_m": 15.0}, vehicle=vehicle))
    log = run.log
    assert run.outcome in ("crashed", "diverged")
    dry = int(np.argmax(log["fuel_kg"] == 0.0))
    assert 100 < dry < 400
    assert log["mass_kg"][-1] == pytest.approx(5.525 - 0.004, abs=1e-9)
    for jet in range(1, 7):
        assert (log[f"fuel_flow_{jet}_kg_s"][dry + 1 :] == 0.0).all()
        speed = log[f"spool_speed_{jet}_rad_s"][dry:-1]  # the last row shows what acted in the one before
        assert (np.diff(speed) < 0.0).all()
        assert log[f"thrust_{jet}_N"][-1] < 0.3 * log[f"thrust_{jet}_N"][dry]
    assert log["velocity_down_m_s"][-1] > 3.0


def test_an_engine_without_a_shut_off_loses_its_thrust_with_the_fuel(monkeypatch: pytest.MonkeyPatch) -> None:
    class Thirsty(EngineBank):
        """The ducted fan, said to burn something."""

        def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
            return super().step(k, throttle, ambient)._replace(fuel_flow=(0.01,) * 6)

    monkeypatch.setattr(cosim.engine.isolated, "EngineBank", Thirsty)
    vehicle = {**NO_AERO, "fuel": {"mass_kg": 0.03, "position_m": [0.0, 0.0, 0.0]}}
    run = fly(scenario(duration_s=1.0, engine="edf-as-flown", vehicle=vehicle))
    log = run.log
    dry = int(np.argmax(log["fuel_kg"] <= 1e-12))
    assert dry == 125
    for jet in range(1, 7):
        assert (log[f"thrust_{jet}_N"][dry:] == 0.0).all()
        assert (log[f"fuel_flow_{jet}_kg_s"][dry:] == 0.0).all()
    # free fall from the first step on
    fallen = log["velocity_down_m_s"][dry + 1 : dry + 101] - log["velocity_down_m_s"][dry]
    np.testing.assert_allclose(fallen, 9.788 * STEP * np.arange(1, 101), rtol=1e-4)


def test_the_altitude_controller_counts_the_fuel() -> None:
    """What is fed forward follows the weight, so that nothing is left to the integral.
    Alone it would leave a height error of g m'/m over both gains, for a weight that falls at g m'."""
    vehicle = {**GENTLE, "fuel": {"mass_kg": 1.0, "position_m": [0.0, 0.0, 0.0]}}
    run = fly(scenario(duration_s=60.0, vehicle=vehicle))
    assert run.outcome == "completed", run.reason
    log = run.log
    rows = slice(-2500, None)
    flow = sum(log[f"fuel_flow_{jet}_kg_s"][rows].mean() for jet in range(1, 7))
    gains = GENTLE["control"]["altitude"]
    expected = GRAVITY * flow / 5.525 / gains["integral_1_s2"] / gains["position_1_s"]
    assert expected > 0.05
    # the chords of the engine's curve: a throttle that falls along them loses a little thrust on the way
    assert abs((log["altitude_m"][rows] - 30.0).mean()) < 0.15 * expected


def test_fuel_that_no_engine_reports_is_not_counted() -> None:
    """Engines without a flow, and a vehicle without a tank: the same collective, bit for bit."""
    tank = {"fuel": {"mass_kg": 1.0, "position_m": [0.0, 0.0, 0.0]}}
    flown = [fly(scenario(engine="edf-as-flown", duration_s=1.0, vehicle=each)).log for each in (tank, {})]
    assert (flown[0]["fuel_kg"] == 1.0).all()
    assert flown[0]["collective"].tobytes() == flown[1]["collective"].tobytes()


@pytest.mark.parametrize(
    ("fuel", "message"),
    [
        ({"mass_kg": 6.0, "position_m": [0.0, 0.0, 0.0]}, r"fuel\.mass_kg 6 is a part of mass_kg 5\.525"),
        ({"mass_kg": 2.0, "position_m": [0.4, 0.0, 0.0]}, r"fuel: 2 kg at \[0\.4, 0\.0, 0\.0\] leave an empty vehicle"),
        ({"mass_kg": -1.0, "position_m": [0.0, 0.0, 0.0]}, r"fuel\.mass_kg = -1\.0: .*greater than 0"),
        ({"mass_kg": 1.0}, r"fuel\.position_m is missing"),
    ],
)
def test_a_tank_that_cannot_be_is_refused(fuel: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_vehicle("hexjet", {"fuel": fuel})


class Listening(EngineBank):
    """The bank of ducted fans, told of the air and remembering it."""

    heard: list[Ambient]
    asks = True

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.wants_ambient = self.asks
        type(self).heard = []

    def reset(self, throttle: Any, ambient: Ambient | None = None) -> EngineOutput:
        self.heard.append(ambient)
        return super().reset(throttle, ambient)

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        self.heard.append(ambient)
        return super().step(k, throttle, ambient)


@pytest.fixture
def listening(monkeypatch: pytest.MonkeyPatch) -> type[Listening]:
    monkeypatch.setattr(cosim.engine.isolated, "EngineBank", Listening)
    return Listening


def in_air(**changes: Any) -> Simulation:
    return build(scenario(engine="edf-as-flown", **changes))


def standard(height: float) -> tuple[float, float]:
    """Pressure [Pa] and temperature [K] of the standard atmosphere below 11 km, from the geometric height [m]."""
    geopotential = 6356766.0 * height / (6356766.0 + height)
    temperature = 288.15 - 0.0065 * geopotential
    return 101325.0 * (temperature / 288.15) ** (9.80665 * 0.0289644 / (8.31432 * 0.0065)), temperature


@pytest.mark.parametrize(("ground", "height"), [(0.0, 10.0), (1500.0, 30.0), (0.0, 4000.0)])
def test_the_air_is_the_standard_atmospheres(listening: type[Listening], ground: float, height: float) -> None:
    """At the start and in flight, at the height over the sea.  JSBSim's gas constant differs in the sixth digit."""
    with in_air(initial={"altitude_m": height}, environment={"ground_m": ground}) as simulation:
        simulation.step()
    for heard in listening.heard:
        assert (heard.pressure, heard.temperature) == pytest.approx(standard(ground + height), rel=1e-5)
        assert heard.air_speed == pytest.approx((0.0,) * 6, abs=1e-9)


def test_a_leaning_and_rolling_vehicle_meets_the_air_with_each_intake(listening: type[Listening]) -> None:
    """Rolled by 30 deg in a wind from the right, and rolling: v . e + (omega x r) . e at each jet."""
    initial = {"attitude_deg": [30.0, 0.0, 0.0], "rate_deg_s": [40.0, 0.0, 0.0]}
    with in_air(initial=initial, environment={"wind_ned_m_s": [0.0, -6.0, 0.0]}) as simulation:
        jets = simulation.vehicle.jets
    # the thrust of a vehicle that leans to the right points up and to the right, into this wind
    expected = [6.0 * sin(radians(30.0)) - radians(40.0) * jet.position_m[1] for jet in jets]
    assert listening.heard[0].air_speed == pytest.approx(expected, rel=1e-6)


def test_every_rate_moves_every_tilted_intake(listening: type[Listening]) -> None:
    """(v + omega x r) . e in all its terms, against numpy, each bank at its own angle and jets off the plane."""
    initial = {"rate_deg_s": [40.0, -70.0, 110.0], "velocity_ned_m_s": [3.0, -2.0, 1.0]}
    jets = {str(index): {"position_m": {"2": 0.02 * (index - 2)}} for index in range(6)}
    with in_air(initial=initial, vehicle={**NO_AERO, "jets": jets}) as simulation:
        simulation.propulsion.tilt = (0.3, -0.2)
        state = simulation.state
        heard = simulation.propulsion.ambient(state, state.wind)
        for jet, speed in zip(simulation.vehicle.jets, heard.air_speed, strict=True):
            tilt = 0.3 if jet.servo == "left" else -0.2
            moving = np.array([3.0, -2.0, 1.0]) + np.cross(state.rate, jet.position_m)
            assert speed == pytest.approx(moving @ [sin(tilt), 0.0, -cos(tilt)], rel=1e-9)


def test_gusts_and_turbulence_are_in_the_air_speed(listening: type[Listening]) -> None:
    gust = {"kind": "gust", "start_s": 0.0, "velocity_ned_m_s": [0.0, 0.0, 4.0]}
    gust |= {"rise_s": 0.2, "hold_s": 1.0, "fall_s": 0.2}
    rows = Rows()
    with in_air(disturbance=[gust], duration_s=0.4, vehicle={**NO_AERO, **LOOSE}) as simulation:
        simulation.run([rows])
    for sample, heard in zip(rows.samples, listening.heard[1:], strict=True):
        # level to within what the gust does to it: air that sinks blows into upright intakes
        assert heard.air_speed == pytest.approx((sample.state.wind[2] - sample.state.velocity[2],) * 6, abs=1e-6)
    assert rows.samples[-1].state.wind[2] == pytest.approx(4.0, rel=1e-9)


def test_engines_that_ask_for_no_air_are_given_none(listening: type, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listening, "asks", False)
    assert fly(scenario(engine="edf-as-flown", duration_s=0.1)).outcome == "completed"
    assert listening.heard == [None] * (1 + 25)
