"""The airframe over a batch: one rigid body over a flat Earth that turns, with its drag and what its mass consists of.

Forces and moments of the jets are held over a control step in the body's axes.  Rates go by the midpoint rule, attitude
by the mean rate with its bend, velocity by the forces turned with the attitude at half the step, place by its mean.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from cosim.base.constants import GRAVITY
from cosim.vehicle.atmosphere import standard_air
from hexjet_batch.numbers import Numbers, is_absent
from hexjet_batch.stages.rotations import (
    Quaternion,
    Vector,
    add,
    cross,
    multiply,
    normalize,
    rotate,
    rotate_back,
    turn_by,
)


class Mass(NamedTuple):
    """Mass [kg], centre of gravity [m, body, from that as built], the tensor of inertia and its inverse.

    Tensors are xx, yy, zz, xy, xz, yz, the products those of the mass, as JSBSim has them.
    """

    mass: Any
    centre: Vector
    tensor: Vector
    inverse: Vector


class Motion(NamedTuple):
    """The motion of the centre of gravity [NED], its last acceleration, and the specific force [m/s^2, body]."""

    position: Vector
    velocity: Vector
    attitude: Quaternion
    rate: Vector
    acceleration: Vector
    force: Vector


def air_at(height: Any) -> tuple[Any, Any]:
    """Return pressure [Pa] and temperature [K] at heights above the sea [m], below 11 km: the standard atmosphere."""
    geopotential = 6356766.0 * height / (6356766.0 + height)
    temperature = 288.15 - 0.0065 * geopotential
    # The exponent is g M / (R L), with the numbers of cosim.vehicle.atmosphere.
    exponent = GRAVITY * 28.9645 / 8314.32 / 0.0065
    return standard_air(0.0)[0] * (temperature / 288.15) ** exponent, temperature


def mass_with(n: Numbers, points: list[tuple[Any, Vector]]) -> Mass:
    """Return the mass with point masses [kg, m] beside the vehicle as built, by the theorem of parallel axes."""
    total = n.mass_kg + sum(mass for mass, _ in points)
    centre: Vector = (0.0, 0.0, 0.0)
    (xx, yy, zz), (xy, xz, yz) = n.inertia_kg_m2, n.products_kg_m2
    if points:
        centre = tuple(sum(mass * place[i] for mass, place in points) / total for i in range(3))
    for mass, place in [(n.mass_kg, (0.0, 0.0, 0.0)), *points] if points else []:
        x, y, z = add(place, centre, -1.0)
        xx, yy, zz = xx + mass * (y * y + z * z), yy + mass * (x * x + z * z), zz + mass * (x * x + y * y)
        xy, xz, yz = xy + mass * x * y, xz + mass * x * z, yz + mass * y * z
    if is_absent(xy, xz, yz):
        return Mass(total, centre, (xx, yy, zz, 0.0, 0.0, 0.0), (1.0 / xx, 1.0 / yy, 1.0 / zz, 0.0, 0.0, 0.0))
    a, b, c = yy * zz - yz * yz, xy * zz + yz * xz, xy * yz + yy * xz
    determinant = xx * a - xy * b - xz * c
    inverse = (a, xx * zz - xz * xz, xx * yy - xy * xy, b, c, xx * yz + xy * xz)
    return Mass(total, centre, (xx, yy, zz, xy, xz, yz), tuple(value / determinant for value in inverse))


def change_mass(s: Motion, old: Mass, new: Mass) -> Motion:
    """Return the motion of the new centre of gravity; attitude and rates stay."""
    shift = add(new.centre, old.centre, -1.0)
    if is_absent(*shift):
        return s
    place = add(s.position, rotate(s.attitude, shift))
    return s._replace(position=place, velocity=add(s.velocity, rotate(s.attitude, cross(s.rate, shift))))


def _apply(tensor: Vector, v: Vector, sign: float) -> Vector:
    """Return a symmetric tensor times a vector; the products enter with ``sign``."""
    xx, yy, zz, xy, xz, yz = tensor
    x, y, z = v
    if is_absent(xy, xz, yz):
        return (xx * x, yy * y, zz * z)
    by_products = (xy * y + xz * z, xy * x + yz * z, xz * x + yz * y)
    return add((xx * x, yy * y, zz * z), by_products, sign)


def drag_of(n: Numbers, motion: Vector, attitude: Quaternion, wind: Vector) -> Vector:
    """Return the drag [N, body] at a velocity [m/s, NED], an area an axis."""
    u, v, w = rotate_back(attitude, add(motion, wind, -1.0))
    a, b, c = n.drag_area_m2
    half = -0.5 * n.density
    return (half * a * abs(u) * u, half * b * abs(v) * v, half * c * abs(w) * w)


def move(n: Numbers, mass: Mass, s: Motion, load: tuple[Vector, Vector], spin: Vector | None, wind: Vector) -> Motion:
    """Return the motion a step later.

    ``load``: force [N] and moment [N m] about the centre of gravity, but for the drag; ``spin``: angular momentum of
    rotors [kg m^2/s]; ``wind`` [m/s, NED]: the mean over the step.
    """
    (force, moment), dt, half = load, n.step, 0.5 * n.step
    lx, ly, lz = n.flown.damping_n_m_s

    def angular_acceleration(rate: Vector) -> Vector:
        momentum = _apply(mass.tensor, rate, -1.0)
        x, y, z = cross(rate, momentum if spin is None else add(momentum, spin))
        p, q, r = rate
        return _apply(mass.inverse, (moment[0] - lx * p - x, moment[1] - ly * q - y, moment[2] - lz * r - z), 1.0)

    first = angular_acceleration(s.rate)
    second = angular_acceleration(add(s.rate, first, half))
    rate = add(s.rate, second, dt)
    # Half the turn: the mean of the rates, less what they bend in between.
    turn = tuple(0.25 * dt * both for both in add(s.rate, rate))
    turn = add(turn, add(second, first, -1.0), -dt * dt / 12.0)
    middle = multiply(s.attitude, turn_by((0.5 * turn[0], 0.5 * turn[1], 0.5 * turn[2])))
    attitude = normalize(multiply(s.attitude, turn_by(turn)))
    felt = add(force, drag_of(n.flown, add(s.velocity, s.acceleration, half), middle, wind))
    fn, fe, fd = rotate(middle, felt)
    vn, ve, vd = s.velocity
    m, (north, down) = mass.mass, n.flown.earth_rate
    acceleration = (
        fn / m + 2.0 * down * ve,
        fe / m - 2.0 * (down * vn - north * vd),
        fd / m + n.flown.gravity - 2.0 * north * ve,
    )
    velocity = add(s.velocity, acceleration, dt)
    position = add(s.position, add(s.velocity, velocity), half)
    return Motion(position, velocity, attitude, rate, acceleration, (felt[0] / m, felt[1] / m, felt[2] / m))
