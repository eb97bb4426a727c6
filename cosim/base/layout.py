"""Where every jet stands and which way it pushes while the hinges of a vehicle are turned.

A jet has a station ``r0`` and a thrust axis ``e0`` (unit, body) with all hinges at zero.  A hinge turns what it carries
about an axis through a point, right-handed.  Hinges that move the same jet form a chain in the order in which they are
stated, from the body outwards: with ``R_k`` the rotation of hinge k by its angle about the axis *as stated*, at zero,

    e = R_1 R_2 ... e0,        r = X_1 X_2 ... r0,        X_k x = p_k + R_k (x - p_k),

the product of exponentials (Brockett, 1984; Murray, Li and Sastry, "A Mathematical Introduction to Robotic
Manipulation", 1994, section 3.2).  A hinge that *carries* a jet turns station and thrust; one that *deflects* it turns
its thrust alone, by ``effect`` of its own angle: a nozzle or a vane behind the engine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import atan2, cos, sin, sqrt
from typing import Any, NamedTuple

from cosim.base._turning import Turning
from cosim.base.frames import cross
from cosim.base.signals import Vector3

UP: Vector3 = (0.0, 0.0, -1.0)  # straight up in body axes


class Station(NamedTuple):
    """A jet: its position, its thrust axis, and its moment about that axis per thrust, right-handed [m]."""

    position: Vector3
    axis: Vector3
    twist: float = 0.0


class HingeAxis(NamedTuple):
    """A hinge: a point of its axis, the axis (unit vector), and the jets that it carries or deflects, from 0."""

    point: Vector3
    axis: Vector3
    carries: tuple[int, ...] = ()
    deflects: tuple[int, ...] = ()
    effect: float = 1.0  # turn of the thrust per turn of the hinge


class TurnedHinge(NamedTuple):
    """Effect of one hinge, by its number from 0, on one jet, with the outer hinges at given angles.

    ``axis`` (unit, body) is what the thrust turns about, ``station_axis`` through ``point`` [m] what the station does:
    a deflecting hinge between body and hinge turns the thrust alone, and so the first and not the second.
    """

    number: int
    effect: float
    carries: bool
    axis: Vector3
    station_axis: Vector3
    point: Vector3


def rotate_about(axis: Vector3, angle: float, vector: Vector3) -> Vector3:
    """Return ``vector`` turned about the unit vector ``axis`` by ``angle`` rad, right-handed: Rodrigues' formula."""
    return rotate_by(axis, cos(angle), sin(angle), vector)


def rotate_by(axis: Vector3, c: float, s: float, vector: Vector3) -> Vector3:
    """Return ``vector`` turned right-handed about the unit vector ``axis`` by an angle of cosine ``c``, sine ``s``."""
    x, y, z = axis
    vx, vy, vz = vector
    along = (x * vx + y * vy + z * vz) * (1.0 - c)
    return (
        vx * c + (y * vz - z * vy) * s + x * along,
        vy * c + (z * vx - x * vz) * s + y * along,
        vz * c + (x * vy - y * vx) * s + z * along,
    )


class Layout:
    """Stations and hinges of one vehicle, with positions and thrust axes at given angles.

    Jets whose thrust points the same way whatever the hinges do are a group: ``groups[i]`` is that of jet ``i``.
    ``moves``: some hinge carries a jet, so that stations move.
    """

    def __init__(self, stations: Sequence[Station], turns: Sequence[HingeAxis] = ()) -> None:
        self.stations, self.turns = tuple(stations), tuple(turns)
        self.rest_positions: list[Vector3] = [station.position for station in stations]  # positions with hinges at zero
        # For each jet: the numbers of its hinges from the body outwards, and their effect on its thrust's angle.
        chains: list[list[tuple[int, float]]] = []
        self._carriers: list[list[int]] = []
        for jet in range(len(stations)):
            chain = []
            for number, turn in enumerate(turns):
                if jet in turn.carries:
                    chain.append((number, 1.0))
                elif jet in turn.deflects:
                    chain.append((number, turn.effect))
            chains.append(chain)
            self._carriers.append([number for number, turn in enumerate(turns) if jet in turn.carries])
        self.chains = chains
        self.moves = any(self._carriers)
        kinds: list[tuple[Vector3, list[tuple[int, float]]]] = []
        self.groups: list[int] = []
        for station, chain in zip(stations, chains, strict=True):
            kind = (station.axis, chain)
            if kind not in kinds:
                kinds.append(kind)
            self.groups.append(kinds.index(kind))
        self._kinds = kinds
        self._still: list[Vector3] = [axis for axis, _ in kinds]
        direction_chains: list[Any] = [
            [(self.turns[number].axis, number, effect, None) for number, effect in reversed(chain)]
            for _, chain in kinds
        ]
        self._turn_axes: Callable[[Sequence[float]], list[Vector3]] = Turning(self._still, direction_chains).turned
        position_chains: list[Any] = [
            [(self.turns[number].axis, number, 1.0, self.turns[number].point) for number in reversed(carriers)]
            for carriers in self._carriers
        ]
        self._carry: Callable[[Sequence[float]], list[Vector3]] = Turning(self.rest_positions, position_chains).turned

    def axes(self, angles: Sequence[float]) -> list[Vector3]:
        """Return the unit thrust direction, body, of each group of jets, with the hinges at ``angles`` rad."""
        if not self.turns:
            return self._still
        return self._turn_axes(angles)

    def frames(self, angles: Sequence[float]) -> list[tuple[Vector3, Vector3, Vector3]]:
        """Return each group's unit vectors of thrust, forward and right, in body axes, turned with the thrust.

        From straight up to the nominal axis by the least turn (half a turn about y where it points straight down),
        then by the hinges.
        """
        result: list[tuple[Vector3, Vector3, Vector3]] = []
        for axis, chain in self._kinds:
            x, y, z = axis
            forward: Vector3 = (1.0, 0.0, 0.0)
            right: Vector3 = (0.0, 1.0, 0.0)
            sine = sqrt(x * x + y * y)
            if sine > 1e-12:
                # The least rotation from -z to the axis is about (-z) x axis.
                about, angle = (y / sine, -x / sine, 0.0), atan2(sine, -z)
                forward, right = rotate_about(about, angle, forward), rotate_about(about, angle, right)
            elif z > 0.0:
                forward = (-1.0, 0.0, 0.0)
            for number, effect in reversed(chain):
                hinge, angle = self.turns[number].axis, effect * angles[number]
                axis, forward, right = (
                    rotate_about(hinge, angle, axis),
                    rotate_about(hinge, angle, forward),
                    rotate_about(hinge, angle, right),
                )
            result.append((axis, forward, right))
        return result

    def positions(self, angles: Sequence[float]) -> list[Vector3]:
        """Return the position [m, body] of each jet, with the hinges at ``angles`` rad."""
        if not self.moves:
            return self.rest_positions
        return self._carry(angles)

    def turned_hinges(self, angles: Sequence[float], jet: int) -> list[TurnedHinge]:
        """Return the hinges that turn a jet's thrust, outwards, with axes and points turned by the ``angles`` [rad]."""
        chain, carriers = self.chains[jet], self._carriers[jet]
        result = []
        for index, (number, effect) in enumerate(chain):
            axis, point = self.turns[number].axis, self.turns[number].point
            station_axis = axis
            for outer, outer_effect in reversed(chain[:index]):
                about, angle = self.turns[outer].axis, outer_effect * angles[outer]
                axis = rotate_about(about, angle, axis)
                if outer in carriers:
                    station_axis = rotate_about(about, angle, station_axis)
                    px, py, pz = self.turns[outer].point
                    x, y, z = rotate_about(about, angle, (point[0] - px, point[1] - py, point[2] - pz))
                    point = (px + x, py + y, pz + z)
            result.append(TurnedHinge(number, effect, number in carriers, axis, station_axis, point))
        return result

    def wrench(self, thrust: Sequence[float], angles: Sequence[float]) -> tuple[Vector3, Vector3]:
        """Return force [N] and moment [N m] of all jets on the body, about the origin of their positions."""
        axes, positions = self.axes(angles), self.positions(angles)
        fx = fy = fz = mx = my = mz = 0.0
        for jet, newton in enumerate(thrust):
            ex, ey, ez = axes[self.groups[jet]]
            twist = self.stations[jet].twist
            x, y, z = newton * ex, newton * ey, newton * ez
            lx, ly, lz = cross(positions[jet], (x, y, z))
            fx, fy, fz = fx + x, fy + y, fz + z
            mx, my, mz = mx + lx + twist * x, my + ly + twist * y, mz + lz + twist * z
        return (fx, fy, fz), (mx, my, mz)
