"""The wind that explains the lateral acceleration of a hovering vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from math import copysign, cos, pi, sin, sqrt

from cosim.base.signals import Vector3
from cosim.control.autopilot.geometry import Pair
from cosim.spec.vehicle import Vehicle


def estimate_wind(
    vehicle: Vehicle, push: Pair, velocity: Pair, euler: Vector3, thrust: Sequence[float], density: float
) -> Pair | None:
    """Return the wind [m/s, north and east] that explains the acceleration ``push``; None if it cannot be estimated.

    Level in hover, the body's drag and the air that the jets swallow hold the vehicle back with
    ``m b = (rho A |V| / 2 + M) V`` along each of its axes, ``A`` the drag area of the axis and ``M`` the mass flow of
    all jets; ``V`` is that equation's root, and the wind is the vehicle's velocity and ``V``.  The mass is the nominal
    one, so a lighter vehicle is told too much wind.

    ``push``: the acceleration that the attitude does not explain [m/s^2, NED]; ``velocity`` over the ground [m/s, NED];
    ``euler`` [rad]; ``thrust`` of every jet, as reported [N]; ``density`` of the air [kg/m^3].  Nothing can be told of
    a vehicle with a wing, whose lift pushes it as well, of one without drag, where no push is estimated, and of one
    that leans half as far again as it may be asked to: lean and thrust then do not explain how it moves.
    """
    gains, (forward, side, _) = vehicle.control.position, vehicle.aero.drag_area_m2
    max_lean = 0.5 * pi if gains is None else min(1.5 * gains.lean_rad, 0.5 * pi)
    is_tipped = cos(euler[0]) * cos(euler[1]) < cos(max_lean)
    linear, mass = _mass_flow(vehicle, thrust), vehicle.mass_kg
    has_drag = linear != 0.0 or min(forward, side) > 0.0
    if vehicle.control.wing is not None or push == (0.0, 0.0) or is_tipped or not has_drag:
        return None
    c, s = cos(euler[2]), sin(euler[2])
    u = _speed_at_drag(mass * (push[0] * c + push[1] * s), 0.5 * density * forward, linear)
    v = _speed_at_drag(mass * (push[1] * c - push[0] * s), 0.5 * density * side, linear)
    return velocity[0] + u * c - v * s, velocity[1] + u * s + v * c


def drag_limited_speed(vehicle: Vehicle, acceleration: float, thrust: Sequence[float], density: float) -> float | None:
    """Return the air speed [m/s] at which drag equals an acceleration [m/s^2], on the side with more drag.

    ``thrust`` and ``density`` are as of :func:`estimate_wind`.  None for a vehicle with a wing and one without drag.
    """
    linear, area = _mass_flow(vehicle, thrust), max(vehicle.aero.drag_area_m2[:2])
    if vehicle.control.wing is not None or max(linear, area) <= 0.0:
        return None
    return _speed_at_drag(vehicle.mass_kg * acceleration, 0.5 * density * area, linear)


def _speed_at_drag(force: float, square: float, linear: float) -> float:
    """Return the speed V [m/s] at which the drag ``square V |V| + linear V`` is ``force`` [N]."""
    size = abs(force)
    if square == 0.0:
        return force / linear
    return copysign((sqrt(linear * linear + 4.0 * square * size) - linear) / (2.0 * square), force)


def _mass_flow(vehicle: Vehicle, thrust: Sequence[float]) -> float:
    """Return the mass flow of all jets [kg/s]."""
    total = 0.0
    for jet, newton in zip(vehicle.jets, thrust, strict=True):
        flow = jet.airflow or vehicle.airflow
        if flow is not None and newton > 0.0:
            total += flow.kg_s * (newton / flow.at_thrust_n) ** flow.exponent
    return total
