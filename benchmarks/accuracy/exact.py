"""A rigid body on the rotating Earth, integrated without JSBSim: what the airframe's error is measured against.

Same equations and constants as in flight, another frame and another method: position, velocity, attitude and rates
against inertial space, classical Runge-Kutta of fourth order within each control step, so that no step reaches over a
jump of what is held.  Earth and air as in :mod:`benchmarks.accuracy.check_cases`; drag and damping as ``vehicle.toml``
states them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cosim.base.signals import Disturbance, Vector3
from cosim.spec.vehicle import Vehicle

EARTH_RATE = np.array([0.0, 0.0, 7.292115e-5])  # rad/s
MU, RADIUS, J2 = 3.986004418e14, 6378137.0, 1.08262982e-3  # WGS 84: m^3/s^2, m
POLAR_RADIUS = 6356752.314245  # m
Array = NDArray[np.float64]
Payload = tuple[float, float, float, float]  # kg, and position [m, body]
NO_PAYLOAD: Payload = (0.0, 0.0, 0.0, 0.0)
Air = tuple[Vector3, Vector3]  # wind [m/s, NED], its rotation [rad/s]


@dataclass(frozen=True)
class StepInputs:
    """Forces, wind and masses that act over one control step."""

    forces: tuple[Vector3, ...]  # N, body, at the jets' stations
    disturbance: Disturbance
    air: tuple[Air, Air] | None = None  # at both ends of the step
    moment: Vector3 = (0.0, 0.0, 0.0)  # N m, body, added to the disturbance's
    momentum: Vector3 = (0.0, 0.0, 0.0)  # of rotors, kg m^2/s, body
    burnt: float = 0.0  # kg


@dataclass(frozen=True)
class Motion:
    """Attitude, rates, velocity and position of the vehicle at one instant."""

    attitude: Array  # body to NED, 3 x 3
    rate: Array  # rad/s, body, against the Earth
    velocity: Array  # m/s, NED
    position: Array  # m, Earth-centred, Earth-fixed


def cross(a: Array, b: Array) -> Array:
    """Return the cross product of two vectors, in a tenth of numpy's time."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def matrix(q: Array) -> Array:
    """Return the rotation matrix of a quaternion (w, x, y, z)."""
    w, x, y, z = (q / np.linalg.norm(q)).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion(turn: Array) -> Array:
    """Return the quaternion of a rotation matrix whose angle is below 180 deg."""
    w = 0.5 * np.sqrt(max(1.0 + np.trace(turn), 1e-16))
    axis = [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    return np.array([w, *(part / (4.0 * w) for part in axis)])


def local(latitude: float, longitude: float) -> Array:
    """Return the rotation from NED to Earth-fixed axes at a geodetic latitude and longitude [rad]."""
    s, c, sl, cl = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    return np.array([[-s * cl, -sl, -c * cl], [-s * sl, cl, -c * sl], [c, 0.0, -s]])


def geodetic(position: Array) -> tuple[float, float, float]:
    """Return latitude, longitude [rad] and height above the ellipsoid [m] of an Earth-fixed position (Bowring)."""
    x, y, z = position.tolist()
    e2 = 1.0 - (POLAR_RADIUS / RADIUS) ** 2
    flat = np.hypot(x, y)
    latitude = np.arctan2(z, flat * (1.0 - e2))
    for _ in range(4):
        normal = RADIUS / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + e2 * normal * np.sin(latitude), flat)
    normal = RADIUS / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    height = flat * np.cos(latitude) + z * np.sin(latitude) - normal * (1.0 - e2 * np.sin(latitude) ** 2)
    return float(latitude), float(np.arctan2(y, x)), float(height)


def gravitation(r: Array) -> Array:
    """Return the Earth's attraction with J2 [m/s^2] at an inertial position."""
    size = float(np.linalg.norm(r))
    across, flat = 5.0 * (r[2] / size) ** 2, 1.5 * J2 * (RADIUS / size) ** 2
    return np.asarray(-MU / size**3 * r * (1.0 + flat * (np.array([1.0, 1.0, 3.0]) - across)))


def density(height: float) -> float:
    """Return the air density [kg/m^3] of the US Standard Atmosphere 1976 below 11 km."""
    geopotential = 6356766.0 * height / (6356766.0 + height)
    temperature = 288.15 - 0.0065 * geopotential
    pressure = 101325.0 * (temperature / 288.15) ** (9.80665 / (287.05287 * 0.0065))
    return float(pressure / (287.05287 * temperature))


class Body:
    """Mass, inertia and lever arms of the vehicle with what is fixed to it during one step."""

    def __init__(self, vehicle: Vehicle, payload: Payload, burnt: float = 0.0) -> None:
        masses = [(payload[0], np.array(payload[1:]))]
        if vehicle.fuel:
            masses.append((-burnt, np.array(vehicle.fuel.position_m)))
        self.mass = vehicle.mass_kg + sum(mass for mass, _ in masses)
        self.centre = sum((mass * position for mass, position in masses), np.zeros(3)) / self.mass
        xy, xz, yz = vehicle.products_kg_m2
        self.inertia = np.diag(vehicle.inertia_kg_m2) - np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
        for mass, position in [*masses, (-self.mass, self.centre)]:  # parallel axes to the common centre
            self.inertia = self.inertia + mass * (position @ position * np.eye(3) - np.outer(position, position))
        self.inverse = np.linalg.inv(self.inertia)
        self.arms = [np.array(jet.position_m) - self.centre for jet in vehicle.jets]
        self.drag_area, self.damping = np.array(vehicle.aero.drag_area_m2), np.array(vehicle.aero.damping_n_m_s)
        self.drag_arm = np.array(vehicle.aero.centre_m) - self.centre


def start(latitude_deg: float, longitude_deg: float, height: float, motion: Motion) -> Array:
    """Return the inertial state (13 numbers) of a motion at a geodetic position; at t = 0 the axes are the Earth's."""
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    e2 = 1.0 - (POLAR_RADIUS / RADIUS) ** 2
    normal = RADIUS / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    r = np.array(
        [
            (normal + height) * np.cos(latitude) * np.cos(longitude),
            (normal + height) * np.cos(latitude) * np.sin(longitude),
            (normal * (1.0 - e2) + height) * np.sin(latitude),
        ]
    )
    to_earth = local(latitude, longitude)
    turn = to_earth @ motion.attitude
    return np.concatenate(
        [
            r,
            to_earth @ motion.velocity + cross(EARTH_RATE, r),
            quaternion(turn),
            motion.rate + turn.T @ EARTH_RATE,
        ]
    )


def earth(t: float) -> Array:
    """Return the rotation from inertial to Earth-fixed axes at time ``t`` [s]."""
    angle = EARTH_RATE[2] * t
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def motion_of(state: Array, t: float) -> Motion:
    """Return the motion relative to the ground ``t`` seconds after the start."""
    r, v, turn = state[:3], state[3:6], matrix(state[6:10])
    to_earth = earth(t)
    position = to_earth @ r
    latitude, longitude, _ = geodetic(position)
    to_ned = local(latitude, longitude).T @ to_earth
    return Motion(to_ned @ turn, state[10:] - turn.T @ EARTH_RATE, to_ned @ (v - cross(EARTH_RATE, r)), position)


def let_go(state: Array, shift: Array) -> Array:
    """Return the state after the centre of gravity moved by ``shift`` [m, body] without moving the body."""
    turn = matrix(state[6:10])
    moved = [state[:3] + turn @ shift, state[3:6] + turn @ cross(state[10:], shift), state[6:]]
    return np.concatenate(moved)


def air_at(inputs: StepInputs, fraction: float) -> tuple[Array, Array]:
    """Return wind and rotation of the air after this fraction of the step."""
    if inputs.air is None:
        return np.array(inputs.disturbance.wind), np.zeros(3)
    begin, end = np.array(inputs.air)
    wind, turning = begin + fraction * (end - begin)
    return wind, turning


def derivative(state: Array, t: float, body: Body, inputs: StepInputs, fraction: float) -> Array:
    """Return the state's time derivative under ``inputs`` after ``fraction`` of the step."""
    wind, air_rate = air_at(inputs, fraction)
    r, v, q, w = state[:3], state[3:6], state[6:10], state[10:]
    turn = matrix(q)
    to_earth = earth(t)
    latitude, longitude, height = geodetic(to_earth @ r)
    through = turn.T @ (v - cross(EARTH_RATE, r) - to_earth.T @ local(latitude, longitude) @ wind)
    drag = -0.5 * density(height) * body.drag_area * np.abs(through) * through
    push = np.array(inputs.disturbance.force)
    force, moment = drag + push, cross(body.drag_arm, drag) - cross(body.centre, push)
    for arm, jet in zip(body.arms, inputs.forces, strict=True):
        newtons = np.array(jet)
        force, moment = force + newtons, moment + cross(arm, newtons)
    moment = moment + np.array(inputs.disturbance.moment) + np.array(inputs.moment)
    moment = moment - body.damping * (w - turn.T @ EARTH_RATE - air_rate)
    spin = body.inverse @ (moment - cross(w, body.inertia @ w + np.array(inputs.momentum)))
    a, (x, y, z) = q[0], q[1:].tolist()
    p, qq, rr = w.tolist()
    turning = 0.5 * np.array(
        [-x * p - y * qq - z * rr, a * p + y * rr - z * qq, a * qq + z * p - x * rr, a * rr + x * qq - y * p]
    )
    return np.concatenate([v, turn @ force / body.mass + gravitation(r), turning, spin])


def integrate(
    vehicle: Vehicle,
    state: Array,
    course: Sequence[StepInputs],
    step: float,
    parts: int = 2,
    payload: Payload | None = None,
) -> list[Motion]:
    """Return the motion after every control step; ``parts``: Runge-Kutta steps in each.

    ``payload``: on board at the start; None: that of the first step.
    """
    motions, h = [], step / parts
    masses = (course[0].disturbance.payload if payload is None else payload, course[0].burnt)
    body = Body(vehicle, *masses)
    for k, inputs in enumerate(course):
        if (inputs.disturbance.payload, inputs.burnt) != masses:
            masses, before = (inputs.disturbance.payload, inputs.burnt), body.centre
            body = Body(vehicle, *masses)
            state = let_go(state, body.centre - before)
        for part in range(parts):
            t, begin, middle, end = k * step + part * h, part / parts, (part + 0.5) / parts, (part + 1) / parts
            one = derivative(state, t, body, inputs, begin)
            two = derivative(state + 0.5 * h * one, t + 0.5 * h, body, inputs, middle)
            three = derivative(state + 0.5 * h * two, t + 0.5 * h, body, inputs, middle)
            four = derivative(state + h * three, t + h, body, inputs, end)
            state = state + h / 6.0 * (one + 2.0 * two + 2.0 * three + four)
        motions.append(motion_of(state, (k + 1) * step))
    return motions
