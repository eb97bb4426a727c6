"""The control authority of a layout: the largest moment in a direction while the weight is held, between two bounds.

At most: a linear program over the hull of all forces and moments (:mod:`cosim.control.allocation.attainable`).  With
the hinges standing these are linear in the thrusts, and that is exact.  At least: a climb from where the program
stands, with thrusts and angles free within their limits, by sequential quadratic programming (Kraft, "A software
package for sequential quadratic programming", DFVLR-FB 88-28, 1988); what it ends at is attained.  Where the two
differ, the ranges of hinges are cut in two and each part is bounded by itself, the one with the most first: branch and
bound (Land and Doig, "An automatic method of solving discrete programming problems", Econometrica 28, 1960).
"""

from __future__ import annotations

from collections.abc import Sequence
from heapq import heappop, heappush
from math import inf
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from cosim.base.constants import GRAVITY
from cosim.base.frames import cross
from cosim.base.layout import Layout
from cosim.base.signals import Vector3
from cosim.control.allocation.attainable import Bound, Hull, Objective
from cosim.spec.vehicle import Vehicle

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[Any]

DOWN: Final = 2  # row of body z in forces and moments
# Fraction of its range by which each start is moved for a second attempt, because the first may fail.
SHIFT: Final = 0.1


class Range(NamedTuple):
    """Bounds of a maximum: a lower one that is attained (minus infinity: none) and an upper one (infinity: unknown)."""

    lower: float
    upper: float

    @property
    def is_exact(self) -> bool:
        """Whether both bounds are equal to three digits."""
        return self.upper < inf and self.upper - self.lower <= 1e-3 * abs(self.upper)

    def describe(self) -> str:
        """Return the range as text, to three digits."""
        if self.is_exact:
            return f"{self.lower:.3g}"
        return f"at least {self.lower:.3g}" if self.upper == inf else f"{self.lower:.3g} to {self.upper:.3g}"


class Authority(NamedTuple):
    """Largest lift and moments [N m, the smaller of both directions] of a vehicle with some jets out.

    ``lift``: most thrust in balance over the weight; ``moment``: what is attained, None where no balance was found.
    ``lift_bound``, ``moment_bound``: what is not exceeded, infinity where that is not known; None where there is no
    balance: without it the vehicle falls.
    """

    lost: tuple[int, ...]
    lift: float
    moment: Vector3 | None
    lift_bound: float
    moment_bound: Vector3 | None

    @property
    def cannot_hover(self) -> bool:
        """Whether no balance of the weight exists."""
        return self.moment_bound is None

    def moment_range(self, axis: int) -> Range:
        """Return both bounds of the moment about an axis [N m]."""
        least = 0.0 if self.moment is None else self.moment[axis]
        return Range(least, 0.0 if self.moment_bound is None else self.moment_bound[axis])


class Reach:
    """Forces and moments that a layout attains, with thrust ranges [N] of engines and angle ranges [rad] of hinges."""

    def __init__(
        self,
        layout: Layout,
        min_thrust: Sequence[float],
        max_thrust: Sequence[float],
        hinges: Sequence[tuple[float, float]],
        rest: Sequence[float],
        weight: float,
    ) -> None:
        import numpy as np

        self._layout, self._weight = layout, weight
        self._least, self._most = np.array(min_thrust, float), np.array(max_thrust, float)
        self._low, self._high = np.array([low for low, _ in hinges]), np.array([high for _, high in hinges])
        self._rest = np.array(rest, float)
        self._hull = Hull.of(layout, self._least, self._most, self._low, self._high)

    @property
    def is_bounded(self) -> bool:
        return self._hull is not None

    def without(self, lost: Sequence[int]) -> Reach:
        """Return the reach of the same layout without some jets, numbered from 1."""
        least, most = self._least.copy(), self._most.copy()
        for jet in lost:
            least[jet - 1] = most[jet - 1] = 0.0
        hinges = list(zip(self._low, self._high, strict=True))
        return Reach(self._layout, least.tolist(), most.tolist(), hinges, self._rest.tolist(), self._weight)

    def section(self, directions: Sequence[Any]) -> list[Range]:
        """Return bounds of the largest moment [N m] along each direction, without tightening them."""
        return [self._bounds(self._make_moment_objective(direction), 0) for direction in directions]

    def authority(self, lost: Sequence[int] = ()) -> Authority:
        """Return the largest lift, and the largest moment about each axis with the other two at zero."""
        import numpy as np

        remaining = self.without(lost)
        lift = remaining._bounds(Objective(-np.eye(6)[DOWN], np.eye(6)[3:], np.zeros(3)))
        lines = [sign * np.eye(3)[axis] for axis in range(3) for sign in (1.0, -1.0)]
        ends = [remaining.moment(line) for line in lines]

        def make_moment(sizes: Sequence[float], upward: float) -> Vector3 | None:
            if min(sizes) == -inf or upward < self._weight:
                return None
            roll, pitch, yaw = (max(0.0, min(sizes[2 * axis : 2 * axis + 2])) for axis in range(3))
            return roll, pitch, yaw

        return Authority(
            tuple(lost),
            max(lift.lower / self._weight, 0.0),
            make_moment([end.lower for end in ends], lift.lower),
            max(lift.upper / self._weight, 0.0),
            make_moment([end.upper for end in ends], lift.upper),
        )

    def moment(self, direction: Any) -> Range:
        """Return the largest moment [N m] along a unit direction in body axes, with none across it at hover's lift.

        Minus infinity where the weight cannot be carried so."""
        return self._bounds(self._make_moment_objective(direction))

    def _make_moment_objective(self, direction: Any) -> Objective:
        import numpy as np

        along = np.concatenate([np.zeros(3), np.asarray(direction, float)])
        _, _, basis = np.linalg.svd(along[3:].reshape(1, 3))
        across = [np.concatenate([np.zeros(3), row]) for row in basis[1:]]
        return Objective(along, np.array([np.eye(6)[DOWN], *across]), np.array([-self._weight, 0.0, 0.0]))

    def _bounds(self, objective: Objective, cuts: int = 12) -> Range:
        """Return bounds of the maximum, tightened by at most ``cuts`` cuts of hinge ranges (a few are usual)."""
        if self._hull is None:
            return Range(self._search_maximum(objective), inf)
        root = self._hull.bound(objective, self._weight)
        if not len(self._rest):
            return Range(root.upper, root.upper)  # without hinges the bound is exact
        least, closed, number = -inf, -inf, 0
        queue: list[tuple[float, int, Array, Array, Bound]] = [(-root.upper, 0, self._low, self._high, root)]
        while queue:
            most = max(closed, -queue[0][0])
            # Moments below a millionth of the weight times 1 m are rounding.
            if Range(least, most).is_exact or most - least <= 1e-6 * self._weight or most == -inf:
                break
            _, _, low, high, bound = heappop(queue)
            least = max(least, self._maximise(objective, bound.thrust, bound.angles))
            widest = int(bound.spread.argmax())
            if cuts <= 0 or not bound.spread[widest]:
                closed = max(closed, bound.upper)  # this box cannot be bounded more closely
                continue
            cuts -= 1
            for half in range(2):
                ends = low.copy(), high.copy()
                ends[1 - half][widest] = 0.5 * (low[widest] + high[widest])
                hull = Hull.of(self._layout, self._least, self._most, *ends)
                assert hull is not None  # a part of a bounded hull is bounded too
                inside = hull.bound(objective, self._weight)
                number += 1
                heappush(queue, (-inside.upper, number, *ends, inside))
        most = max([closed, *(-part[0] for part in queue)])
        return Range(least, max(least, most))

    def _search_maximum(self, objective: Objective, starts: int = 8) -> float:
        """Return the largest value found by optimising from rest and from the points of a Halton sequence."""
        from scipy.stats import qmc

        even = 0.5 * (self._least + self._most)
        points = qmc.Halton(len(self._rest), scramble=False).random(starts)
        return max(
            self._maximise(objective, even, start) for start in (self._rest, *qmc.scale(points, self._low, self._high))
        )

    def _maximise(self, objective: Objective, thrust: Array, at: Array) -> float:
        """Return the value optimised from these thrusts and angles; if that fails, from a point nearby."""
        import numpy as np

        scale = self._weight / len(thrust)
        low, high = np.concatenate([self._least / scale, self._low]), np.concatenate([self._most / scale, self._high])
        start = np.clip(np.concatenate([thrust / scale, at]), low, high)
        offset = start + SHIFT * (0.5 * (low + high) - start) + SHIFT**2 * (high - low) * np.cos(np.arange(len(start)))
        best = self._optimise(objective, start, low, high)
        return best if best > -inf else self._optimise(objective, np.clip(offset, low, high), low, high)

    def _optimise(self, objective: Objective, start: Array, low: Array, high: Array, tolerance: float = 1e-7) -> float:
        """Return the value optimised by quadratic programs in turn; constraints hold to ``tolerance`` of the weight."""
        import numpy as np
        from scipy.optimize import minimize

        goal, rows, values = (
            objective.goal / self._weight,
            objective.rows / self._weight,
            objective.values / self._weight,
        )
        jets = len(self._least)
        scale = self._weight / jets

        def compute_wrench(x: Array) -> tuple[Array, Array]:
            effects, turns = self._linearise_wrench(x[:jets] * scale, x[jets:])
            return effects @ x[:jets] * scale, np.hstack([effects * scale, turns])

        # Rows that nothing changes would make the program infeasible, so they are checked here directly.
        middle = 0.5 * (low + high)
        offset = middle + SHIFT * (high - low) * np.cos(np.arange(len(middle)))
        changes = np.hstack([rows @ compute_wrench(x)[1] * (high > low) for x in (start, middle, offset)])
        sides, sizes, _ = np.linalg.svd(changes, full_matrices=False)
        active = sides[:, sizes > 1e-9 * max(sizes[0], 1e-300)].T

        def negative_goal(x: Array) -> tuple[float, Array]:
            wrench, change = compute_wrench(x)
            return -float(goal @ wrench), -(goal @ change)

        result = minimize(
            negative_goal,
            start,
            jac=True,
            method="SLSQP",
            bounds=list(zip(low, high, strict=True)),
            constraints={
                "type": "eq",
                "fun": lambda x: active @ (rows @ compute_wrench(x)[0] - values),
                "jac": lambda x: active @ rows @ compute_wrench(x)[1],
            },
            options={"ftol": 1e-10, "maxiter": 100},
        )
        wrench, _ = compute_wrench(np.clip(result.x, low, high))
        residual = np.max(np.abs(rows @ wrench - values))
        return float(objective.goal @ wrench) if residual <= tolerance else -inf

    def _linearise_wrench(self, thrust: Array, at: Any) -> tuple[Array, Array]:
        """Return force and moment of each jet per thrust, hinges ``at`` [rad], and their change per rad of each hinge.

        Shapes (6, jets) and (6, hinges).
        """
        import numpy as np

        layout, angles = self._layout, [float(angle) for angle in at]
        axes, positions = layout.axes(angles), layout.positions(angles)
        columns, turns = [], np.zeros((6, len(angles)))
        for jet, group in enumerate(layout.groups):
            axis, twist = axes[group], layout.stations[jet].twist
            columns.append([*axis, *_moment_of_force(positions[jet], axis, twist)])
            for hinge in layout.turned_hinges(angles, jet):
                # The thrust turns with the hinge, and so does the station if the hinge carries it.
                fx, fy, fz = cross(hinge.axis, axis)
                force = (hinge.effect * fx, hinge.effect * fy, hinge.effect * fz)
                change = np.array([*force, *_moment_of_force(positions[jet], force, twist)])
                if hinge.carries:
                    (x, y, z), (px, py, pz) = positions[jet], hinge.point
                    change[3:] += cross(cross(hinge.station_axis, (x - px, y - py, z - pz)), axis)
                turns[:, hinge.number] += thrust[jet] * change
        return np.array(columns).T, turns


def compute_reach(vehicle: Vehicle, min_thrust: Sequence[float], max_thrust: Sequence[float]) -> Reach:
    """Return the reach of the vehicle's layout with engines of these thrusts [N], at the allocation's limits."""
    turns = vehicle.turns
    return Reach(vehicle.layout(), min_thrust, max_thrust, turns, vehicle.rest[: len(turns)], vehicle.mass_kg * GRAVITY)


def _moment_of_force(position: Vector3, force: Vector3, twist: float) -> Vector3:
    x, y, z = cross(position, force)
    fx, fy, fz = force
    return (x + twist * fx, y + twist * fy, z + twist * fz)
