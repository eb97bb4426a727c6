"""The airframe's error on the project's own flights, by method and by number of runs in a control step.

A flight is flown once.  What acted on the airframe in each of its control steps is then held again, step by step, on
the airframe with other methods and on an integration of its own (:mod:`benchmarks.accuracy.exact`): the same inputs at
the same times, so that what differs is the method alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.accuracy.exact import NO_PAYLOAD, Air, Array, Motion, StepInputs, integrate, start
from cosim import Scenario, fly, load_vehicle
from cosim.base.frames import from_euler, jet_axis, rotate
from cosim.base.signals import Disturbance, Quaternion, Sample, State, Vector3
from cosim.results.log.recorder import Log
from cosim.simulation.build import build
from cosim.simulation.step import Simulation
from cosim.spec.scenario import Environment, Initial
from cosim.spec.vehicle import Vehicle
from cosim.vehicle.airframe import ADAMS_BASHFORTH_2, ADAMS_BASHFORTH_3, BUSS_2, RECTANGULAR, Airframe
from cosim.vehicle.jsbsim_units import FOOT


@dataclass(frozen=True)
class Scheme:
    """Integration methods of JSBSim by its numbers, and the part of a change that the first run makes up."""

    title: str
    rates: tuple[float, float] = (ADAMS_BASHFORTH_2, ADAMS_BASHFORTH_2)  # rotational, translational
    attitude: float = BUSS_2
    make_up: float = 0.5
    at_once: bool = True  # masses and rotors act in their own run


SCHEMES = {
    "flown": Scheme("as flown"),
    "late": Scheme("without what the first run makes up", make_up=0.0),
    "masses": Scheme("masses and rotors left to JSBSim", at_once=False),
    "third": Scheme("rates of third order", (ADAMS_BASHFORTH_3, ADAMS_BASHFORTH_3)),
    "jsbsim": Scheme("JSBSim's own choice", (RECTANGULAR, ADAMS_BASHFORTH_2), RECTANGULAR, 0.0, False),
}
FLOWN_RUNS = 4


@dataclass(frozen=True)
class Course:
    """What acted on a vehicle in each step of a flight, and where the flight began."""

    title: str
    vehicle: Vehicle
    folder: Any
    step: float
    initial: Initial
    inputs: list[StepInputs]


class _Inputs:
    """Observer that keeps what the airframe was given in each step of a flight."""

    def __init__(self, simulation: Simulation, momentum: Vector3) -> None:
        self.inputs: list[StepInputs] = []
        self._frame, self._propulsion, self._momentum = simulation.airframe, simulation.propulsion, momentum

    def observe(self, sample: Sample) -> None:
        frame = self._frame
        twist = np.subtract(frame._twisted, sample.disturbance.moment).tolist()
        self.inputs.append(
            StepInputs(
                tuple(frame._forces),
                sample.disturbance,
                moment=(twist[0], twist[1], twist[2]),
                momentum=self._propulsion.momentum if any(self._propulsion.momentum) else self._momentum,
                burnt=frame._burnt,
            )
        )


def course(title: str, name: str, changes: dict[str, Any], momentum: Vector3 = (0.0, 0.0, 0.0)) -> Course:
    """Fly a scenario without gusts and return what acted; ``momentum``: of rotors that engines do not have.

    ``momentum``: of rotors that the engines do not have.
    """
    scenario = Scenario.load(name).replace(**changes, expect=[])
    with build(scenario) as simulation:
        inputs = _Inputs(simulation, momentum)
        ending = simulation.run([inputs])
    step_inputs = inputs.inputs if ending.outcome == "completed" else inputs.inputs[:-1]
    vehicle, folder = load_vehicle(scenario.aircraft, scenario.vehicle)
    return Course(title, vehicle, folder, scenario.step_s, scenario.initial, step_inputs)


PICKED_UP = {"kind": "payload", "start_s": 2.0, "mass_kg": 0.5, "offset_m": [0.05, -0.02, 0.10]}
WIND = {"kind": "wind", "start_s": 2.0, "velocity_ned_m_s": [-4.0, 3.0, 0.0]}
OFF_CENTRE = {"fuel": {"mass_kg": 18.0, "position_m": [0.2, 0.1, 0.1]}}
AXES: tuple[Vector3, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def to_matrix(attitude: Quaternion) -> Array:
    """Return a rotation, body to NED, as a matrix."""
    return np.array([rotate(attitude, axis) for axis in AXES]).T


def to_motion(state: State, position: tuple[float, float, float]) -> Motion:
    """Return the airframe's state as the independent integration has it."""
    return Motion(to_matrix(state.attitude), np.array(state.rate), np.array(state.velocity), np.array(position))


def fly_again(course: Course, scheme: Scheme, runs: int) -> tuple[Motion, list[Motion]]:
    """Return the airframe's motion at the start and after every step of a course."""
    spins = any(any(each.momentum) for each in course.inputs)
    frame = Airframe(course.vehicle, course.folder, Environment(), course.step, runs, 1, spins)

    def read_position() -> tuple[float, float, float]:
        x, y, z = (frame._fdm.get_property_value(f"position/ecef-{axis}-ft") * FOOT for axis in "xyz")
        return (x, y, z)

    def apply_scheme() -> None:
        for kind, method in zip(("rotational", "translational"), scheme.rates, strict=True):
            frame._set_property(f"simulation/integrator/rate/{kind}", method)
        frame._set_property("simulation/integrator/position/rotational", scheme.attitude)
        frame._extrapolation = scheme.make_up

    def step(inputs: StepInputs) -> Motion:
        changed = inputs.disturbance.payload != frame._disturbance.payload
        if scheme.at_once:
            frame.prepare_step(inputs.momentum, inputs.burnt)
        else:
            if course.vehicle.fuel:
                frame.burn(inputs.burnt)
            if spins:
                frame.set_momentum(inputs.momentum)
            frame._apply_disturbance(inputs.disturbance)
        state = frame.step(list(inputs.forces), inputs.disturbance, inputs.moment)
        if changed:
            apply_scheme()
        return to_motion(state, read_position())

    try:
        first = course.inputs[0]
        spin = first.momentum if spins else None
        state = frame.reset(course.initial, list(first.forces), first.disturbance.wind, spin, first.burnt)
        begin = to_motion(state, read_position())
        apply_scheme()
        motions = [step(each) for each in course.inputs]
    finally:
        frame.close()
    return begin, motions


@dataclass(frozen=True)
class Error:
    """Greatest differences between two integrations over a flight."""

    attitude_deg: float
    rate_deg_s: float
    velocity_mm_s: float
    place_mm: float


def exact(course: Course, parts: int = 2) -> list[Motion]:
    """Return the motion after every step of a course by the independent integration."""
    earth = Environment()
    begin, _ = fly_again(replace(course, inputs=course.inputs[:1]), SCHEMES["flown"], 1)
    state = start(earth.latitude_deg, earth.longitude_deg, earth.ground_m + course.initial.altitude_m, begin)
    return integrate(course.vehicle, state, course.inputs, course.step, parts, NO_PAYLOAD)


CLOSED = (
    "roll-doublet",
    "payload-drop",
    "climb-and-land",
    "full-scale-roll-doublet",
    "full-scale-payload-drop",
    "trijet-yaw-doublet",
)


def closed_loop(name: str, runs: int, fine: int = 64) -> tuple[float, float]:
    """Return a flight's greatest differences, Euler angles [deg] and position [mm], from one with ``fine`` runs."""
    logs = [fly(Scenario.load(name).replace(substeps=substeps, expect=[])).log for substeps in (runs, fine)]
    last = min(len(log) for log in logs)

    def find_difference(columns: tuple[str, ...]) -> float:
        return max(float(np.abs(logs[0][column][:last] - logs[1][column][:last]).max()) for column in columns)

    angles, positions = ("roll_rad", "pitch_rad", "yaw_rad"), ("north_m", "east_m", "down_m")
    return float(np.degrees(find_difference(angles))), 1e3 * find_difference(positions)


# Length [s] that is integrated from one row of a log, short so that residuals are those of the equations.
WINDOW_S = 0.5


def from_the_log(log: Log, scenario: Scenario, air_turns: bool = True) -> tuple[float, float]:
    """Return the greatest residuals of rate [rad/s] and velocity [m/s], WINDOW_S after rows of a flight's log.

    From each such row's motion the equations are integrated with nothing but the log's thrusts, tilts, disturbances,
    wind and rate of the air, and compared with the row at the end.  ``air_turns`` False leaves the last out.  The first
    step is left out: the air is at rest in JSBSim's first evaluation and blows in the next, a run later, between rows.
    """
    vehicle, _ = load_vehicle(scenario.aircraft, scenario.vehicle)

    def rows(*names: str) -> list[tuple[float, ...]]:
        return [tuple(map(float, row)) for row in np.stack([log[name] for name in names], axis=1)]

    def of(pattern: str, keys: Any) -> list[Any]:
        return rows(*(pattern.format(part) for part in keys))

    ned, xyz = ("north", "east", "down"), "xyz"
    angles, rates, velocities = (
        of("{}_rad", ("roll", "pitch", "yaw")),
        of("rate_{}_rad_s", "pqr"),
        of("velocity_{}_m_s", ned),
    )
    heights, thrusts = log["altitude_m"], of("thrust_{}_N", range(1, len(vehicle.jets) + 1))
    tilts, winds, turning = of("tilt_{}_rad", ("left", "right")), of("wind_{}_m_s", ned), of("air_rate_{}_rad_s", "pqr")
    pushes, twists = of("disturbance_force_{}_N", xyz), of("disturbance_moment_{}_N_m", xyz)
    payloads = rows("payload_kg", *(f"payload_{axis}_m" for axis in xyz))
    calm = (0.0, 0.0, 0.0)
    air: list[Air] = [(wind, turn if air_turns else calm) for wind, turn in zip(winds, turning, strict=True)]
    is_left = [jet.servo == "left" for jet in vehicle.jets]
    steps_in = []
    for k in range(len(log) - 1):
        axes = [jet_axis(tilts[k][0 if on_left else 1]) for on_left in is_left]
        forces = tuple((n * x, n * y, n * z) for n, (x, y, z) in zip(thrusts[k], axes, strict=True))
        mass, x, y, z = payloads[k]
        steps_in.append(
            StepInputs(forces, Disturbance(pushes[k], twists[k], payload=(mass, x, y, z)), (air[k], air[k + 1]))
        )
    earth = scenario.environment
    steps, worst = round(WINDOW_S / scenario.step_s), (0.0, 0.0)
    for first in range(1, len(steps_in) - steps + 1, steps):
        turn = to_matrix(from_euler(*angles[first]))
        motion = Motion(turn, np.array(rates[first]), np.array(velocities[first]), np.zeros(3))
        state = start(earth.latitude_deg, earth.longitude_deg, earth.ground_m + float(heights[first]), motion)
        end = integrate(vehicle, state, steps_in[first : first + steps], scenario.step_s)[-1]
        last = first + steps
        worst = (
            max(worst[0], float(np.linalg.norm(end.rate - rates[last]))),
            max(worst[1], float(np.linalg.norm(end.velocity - velocities[last]))),
        )
    return worst


def error(one: list[Motion], other: list[Motion]) -> Error:
    """Return the greatest differences between two integrations of the same course."""
    angles, rates, speeds, positions = [], [], [], []
    for a, b in zip(one, other, strict=True):
        turn = a.attitude.T @ b.attitude
        sine = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        angles.append(np.linalg.norm(sine))
        rates.append(np.linalg.norm(a.rate - b.rate))
        speeds.append(np.linalg.norm(a.velocity - b.velocity))
        positions.append(np.linalg.norm(a.position - b.position))
    return Error(
        float(np.degrees(max(angles))),
        float(np.degrees(max(rates))),
        1e3 * float(max(speeds)),
        1e3 * float(max(positions)),
    )
