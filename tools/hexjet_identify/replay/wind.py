"""The constant horizontal wind of a recorded flight, from what the vehicle's speed over the ground does."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.signals import ZERO3, Vector3
from hexjet_identify.replay.flown import Model
from hexjet_identify.replay.windows import CutFlight


class Wind(NamedTuple):
    """The wind that the windows are flown in [m/s, NED, towards], with its standard deviation.

    ``deviation`` is of the component that is told less well, None where none was estimated; ``reason`` says why a wind
    is zero.
    """

    velocity: Vector3
    deviation: float | None
    reason: str

    def to_dict(self) -> dict[str, Any]:
        """Return everything, for JSON."""
        return {"ned_m_s": list(self.velocity), "deviation_m_s": self.deviation, "reason": self.reason}


def estimate_wind(
    model: Model,
    flying: CutFlight,
    most_windows: int = 10,
    rounds: int = 6,
    step_m_s: float = 8.0,
    most_m_s: float = 30.0,
) -> Wind:
    """Estimate a constant wind from the changes of velocity within some windows; 0 without a velocity.

    Where the log has an attitude the model's forces act along the measured one: what turns the vehicle otherwise than
    the model, such as a wrong moment of inertia, is no wind.  Drag goes with the square of the wind, so that it takes
    ``rounds`` of Gauss and Newton with steps of ``step_m_s`` at most.
    """
    from scipy.stats import t

    if not flying.flight.has_velocity:
        return Wind(ZERO3, None, "no velocity in the log: taken for still air")
    count = len(flying.windows)
    flying = flying.only(np.linspace(0, count - 1, min(count, most_windows)).astype(int).tolist())
    wind, deviation = np.zeros(2), np.inf
    for _ in range(rounds):
        base = _velocity_drift(model, flying, wind)
        slopes = np.stack([_velocity_drift(model, flying, wind + axis) - base for axis in np.eye(2)], axis=-1)
        normal = np.einsum("wci,wcj->ij", slopes, slopes)
        if not np.linalg.cond(normal) < 1e12:
            return Wind(ZERO3, None, "the model has no drag: taken for still air")
        inverse = np.linalg.inv(normal)
        move = -inverse @ np.einsum("wci,wc->i", slopes, base)
        scores = np.einsum("wci,wc->wi", slopes, base + np.einsum("wci,i->wc", slopes, move))
        few = len(scores) / (len(scores) - 1.0)
        deviation = float(np.sqrt(few * np.diag(inverse @ (scores.T @ scores) @ inverse).max(initial=0.0)))
        size = float(np.linalg.norm(move))
        wind = wind + move * min(1.0, step_m_s / max(size, 1e-9))
        if not np.linalg.norm(wind) < most_m_s:
            return Wind(ZERO3, None, f"beyond {most_m_s:g} m/s: drag tells too little; taken for still air")
        if size < 0.1:
            break
    # Twice the standard deviation, by Student's t for the number of windows.
    if float(np.linalg.norm(wind)) < float(t.ppf(0.9772, len(flying.windows) - 1)) * deviation:
        return Wind(ZERO3, deviation, "too small for its standard deviation: taken for still air")
    found = (float(wind[0]), float(wind[1]), 0.0)
    if _sum_rate_errors(model, flying, found) > 1.2 * _sum_rate_errors(model, flying, ZERO3):
        return Wind(ZERO3, deviation, "in it the rates are further off than in still air, which is taken")
    return Wind(found, deviation, "")


def _sum_rate_errors(model: Model, flying: CutFlight, wind: Vector3) -> float:
    """Return the sum of squared errors of the rates in a wind, (rad/s)^2: it turns a vehicle with a wing."""
    flown = model.fly(flying.flight, flying.windows, flying.starts, None, wind)
    return float(np.nansum((flying.flight.rate - flown.rate)[flying.rows] ** 2))


def _velocity_drift(model: Model, flying: CutFlight, wind: Array) -> Array:
    """Return the errors of the velocities north and east at the end of each window, (w, 2) [m/s]."""
    moved = (float(wind[0]), float(wind[1]), 0.0)
    flight = flying.flight
    flown = model.fly(flight, flying.windows, flying.starts, None, moved)
    rows = flying.rows
    drift = (flight.velocity - flown.velocity)[rows[:, -1], :2]
    if flight.has_angles:
        turned = level_part(flown.force[rows], flight.angles[rows]) - level_part(flown.force[rows], flown.angles[rows])
        drift = drift - flight.step * turned.sum(axis=1)
    return np.nan_to_num(drift)


def level_part(force: Array, angles: Array) -> Array:
    """Return the north and east parts (..., 2) of body forces (..., 3) at roll, pitch and yaw (..., 3) [rad]."""
    (x, y, z), (roll, pitch, yaw) = np.moveaxis(force, -1, 0), np.moveaxis(angles, -1, 0)
    ahead = np.cos(pitch) * x + np.sin(pitch) * (np.sin(roll) * y + np.cos(roll) * z)
    right = np.cos(roll) * y - np.sin(roll) * z
    north, east = np.cos(yaw) * ahead - np.sin(yaw) * right, np.sin(yaw) * ahead + np.cos(yaw) * right
    return np.stack([north, east], axis=-1)
