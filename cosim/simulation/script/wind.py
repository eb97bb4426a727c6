"""A wind over time and place, beside what the scenario's own disturbances blow."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cosim.base.frames import rotate
from cosim.base.signals import Disturbance, State, Vector3

Velocity = Callable[[float, float, float, float], Vector3]  # (s, north, east, height [m]) -> m/s NED


class FieldWind:
    """Wind of a spatial field in a step: at the vehicle, and its difference at each engine.

    The airframe flies in the air at its centre of gravity; an engine's intake, and what its stream does to the
    vehicle, in the air at its station.  ``positions``: the stations [m, body], none if the wind is the same everywhere.
    """

    def __init__(
        self, velocity: Velocity, reset: Callable[[], None], step: float, positions: Sequence[Vector3], height: float
    ) -> None:
        self._velocity, self._reset, self._step = velocity, reset, step
        self._positions, self._height = tuple(positions), height
        self.at_jets: list[Vector3] = []  # m/s NED, relative to that at the centre

    def reset(self, wind: Vector3) -> Vector3:
        """Start a flight, and return its initial wind [m/s]: the field's plus ``wind`` of the disturbances."""
        self._reset()
        self.at_jets = []
        x, y, z = self._velocity(0.0, 0.0, 0.0, self._height)
        return (wind[0] + x, wind[1] + y, wind[2] + z)

    def add_wind(self, k: int, state: State, disturbance: Disturbance) -> Disturbance:
        time = k * self._step
        north, east, _ = state.position
        height = state.altitude
        x, y, z = self._velocity(time, north, east, height)
        at_jets: list[Vector3] = []
        for position in self._positions:
            ahead, right, below = rotate(state.attitude, position)
            u, v, w = self._velocity(time, north + ahead, east + right, height - below)
            at_jets.append((u - x, v - y, w - z))
        self.at_jets = at_jets
        a, b, c = disturbance.wind
        return disturbance._replace(wind=(a + x, b + y, c + z))
