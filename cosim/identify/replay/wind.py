"""The constant horizontal wind of a recorded flight, from what the vehicle's speed over the ground does."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.signals import ZERO3, Vector3
from cosim.identify.replay.flown import Model
from cosim.identify.replay.windows import Flying

ROUNDS: Final = 6  # of Gauss and Newton: drag goes with the square of the wind
STEP_M_S: Final = 8.0  # in one of them: in still air the slope tells little
CLOSE_M_S: Final = 0.1
MOST_WINDOWS: Final = 10  # that are looked at
PROBE_M_S: Final = 1.0
SURE: Final = 2.0  # times its standard deviation; a smaller wind is not told from none
MOST_M_S: Final = 30.0


class Wind(NamedTuple):
    """The wind that the windows are flown in: m/s NED, where the air moves to; and how well it is known."""

    velocity: Vector3
    deviation: float | None  # m/s, of each component; None: not estimated
    reason: str  # of a wind that is zero

    def to_dict(self) -> dict[str, Any]:
        """Return everything, for JSON."""
        return {"ned_m_s": list(self.velocity), "deviation_m_s": self.deviation, "reason": self.reason}


def estimate_wind(model: Model, flying: Flying) -> Wind:
    """Estimate a wind from the changes of velocity within the windows; none where the log has none."""
    if not flying.flight.has_velocity:
        return Wind(ZERO3, None, "no velocity in the log: taken for still air")
    flying = flying.only(
        np.linspace(0, len(flying.windows) - 1, min(len(flying.windows), MOST_WINDOWS)).astype(int).tolist()
    )
    wind, deviation = np.zeros(2), np.inf
    for _ in range(ROUNDS):
        base = _drift(model, flying, wind)
        slopes = np.stack([_drift(model, flying, wind + PROBE_M_S * axis) - base for axis in np.eye(2)], axis=-1)
        slopes /= PROBE_M_S
        normal = np.einsum("wci,wcj->ij", slopes, slopes)
        if not np.linalg.cond(normal) < 1e12:
            return Wind(ZERO3, None, "the model has no drag: taken for still air")
        inverse = np.linalg.inv(normal)
        move = -inverse @ np.einsum("wci,wc->i", slopes, base)
        scores = np.einsum("wci,wc->wi", slopes, base + np.einsum("wci,i->wc", slopes, move))
        deviation = float(np.sqrt(max(np.trace(inverse @ (scores.T @ scores) @ inverse), 0.0) / 2.0))
        size = float(np.linalg.norm(move))
        wind = wind + move * min(1.0, STEP_M_S / max(size, 1e-9))
        if not np.linalg.norm(wind) < MOST_M_S:
            return Wind(ZERO3, None, f"beyond {MOST_M_S:g} m/s: drag tells too little; taken for still air")
        if size < CLOSE_M_S:
            break
    if float(np.linalg.norm(wind)) < SURE * deviation:
        return Wind(ZERO3, deviation, "less than twice its standard deviation: taken for still air")
    return Wind((float(wind[0]), float(wind[1]), 0.0), deviation, "")


def _drift(model: Model, flying: Flying, wind: Array) -> Array:
    """Return by how much velocities north and east are off at the end of each window, (w, 2) m/s."""
    moved = (float(wind[0]), float(wind[1]), 0.0)
    flown = model.fly(flying.flight, flying.windows, flying.starts, None, moved)
    last = flying.rows[:, -1]
    return np.nan_to_num((flying.flight.velocity - flown.velocity)[last, :2])
