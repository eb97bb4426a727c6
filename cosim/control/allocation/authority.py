"""What a layout can do at all: the largest moment in a direction while the weight is held, by linear programs.

With the hinges standing, force and moment are linear in the thrusts, and one program is exact.  Over the hinges they
are not: the programs are made linear where the hinges stand, answer with a step of them, and the step is kept where the
exact program at its end gives more (sequential linear programming with a trust region; Fletcher and Sainz de la Maza,
"Nonlinear programming and nonsmooth optimization by successive linear programming", Mathematical Programming 43, 1989).
What is found is attained exactly; with hinges there may be more elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from cosim.base.constants import GRAVITY
from cosim.base.layout import Layout
from cosim.base.signals import Vector3
from cosim.spec.vehicle import Vehicle

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[Any]

DOWN: Final = 2  # the row of body z in force and moment
MISSED: Final = 1e3  # what missing a newton of what is held costs, in what is wanted: more than any lever gives
STEPS: Final = 25  # of the hinges; some ten are the rule
SMALL: Final = 2e-3  # of a hinge's range: a step that is looked no further into
TRUST: Final = (0.5, 0.1)  # of a hinge's range: the first steps of two climbs, which may end on different tops
COARSE: Final = 0.04  # the same for a drawing
MEETS: Final = 1e-7  # of the weight: what is held is met


class Authority(NamedTuple):
    """The largest moments either way [N m, the smaller of the two], with these jets lost; None: it falls."""

    lost: tuple[int, ...]
    lift: float  # most thrust in balance over the weight
    moment: Vector3 | None


class _Asked(NamedTuple):
    """The most of ``goal . (force, moment)`` with ``rows . (force, moment) = values``."""

    goal: Array
    rows: Array
    values: Array


class Reach:
    """A layout with the thrusts that its engines give [N, least and most] and the ranges of its hinges [rad]."""

    def __init__(
        self,
        layout: Layout,
        least: Sequence[float],
        most: Sequence[float],
        hinges: Sequence[tuple[float, float]],
        rest: Sequence[float],
        weight: float,
    ) -> None:
        import numpy as np

        self._layout, self._weight = layout, weight
        self._least, self._most = np.array(least, float), np.array(most, float)
        self._low, self._high = np.array([low for low, _ in hinges]), np.array([high for _, high in hinges])
        self._rest = np.array(rest, float)

    def without(self, lost: Sequence[int]) -> Reach:
        """The same without some jets, numbered from 1."""
        least, most = self._least.copy(), self._most.copy()
        for jet in lost:
            least[jet - 1] = most[jet - 1] = 0.0
        hinges = list(zip(self._low, self._high, strict=True))
        return Reach(self._layout, least.tolist(), most.tolist(), hinges, self._rest.tolist(), self._weight)

    def section(self, directions: Sequence[Any]) -> list[float]:
        """:meth:`moment` along neighbouring directions, to some percent: each begins where the one before ended."""
        at, found = self._rest, []
        for direction in directions:
            # the better of where the direction before it ended and of the rest
            at, most = self._best(self._about(direction), [(at, 0.3), (self._rest, 0.5)], COARSE)
            found.append(most)
        return found

    def authority(self, lost: Sequence[int] = ()) -> Authority:
        """Lift and the moment about each axis with the other two at zero."""
        import numpy as np

        left = self.without(lost)
        lift = left._largest(_Asked(-np.eye(6)[DOWN], np.eye(6)[3:], np.zeros(3))) / self._weight
        ends = []
        for axis in range(3):
            ends.append(min(left.moment(sign * np.eye(3)[axis]) for sign in (1.0, -1.0)))
        roll, pitch, yaw = ends
        holds = min(ends) > -inf and lift >= 1.0
        found = (max(roll, 0.0), max(pitch, 0.0), max(yaw, 0.0)) if holds else None
        return Authority(tuple(lost), max(lift, 0.0), found)

    def moment(self, direction: Any) -> float:
        """The largest moment [N m] along a unit direction about the body's axes, with none across it and the weight
        held; minus infinity where the weight cannot be held so."""
        return self._largest(self._about(direction))

    def _about(self, direction: Any) -> _Asked:
        import numpy as np

        along = np.concatenate([np.zeros(3), np.asarray(direction, float)])
        _, _, turned = np.linalg.svd(along[3:].reshape(1, 3))
        across = [np.concatenate([np.zeros(3), row]) for row in turned[1:]]
        return _Asked(along, np.array([np.eye(6)[DOWN], *across]), np.array([-self._weight, 0.0, 0.0]))

    def _largest(self, asked: _Asked) -> float:
        return self._best(asked, [(self._rest, trust) for trust in TRUST], SMALL)[1]

    def _best(self, asked: _Asked, starts: Sequence[tuple[Array, float]], fine: float) -> tuple[Array, float]:
        """Where the best of some climbs ends, each from an angle with a trust, and what it attains there."""
        if not len(self._rest):
            starts = starts[:1]  # nothing turns: the program is exact
        return max((self._climbed(asked, at, trust, fine) for at, trust in starts), key=lambda end: end[1])

    def _climbed(self, asked: _Asked, at: Array, trust: float, fine: float) -> tuple[Array, float]:
        """Where a climb from ``at`` ends, and what it attains there."""
        import numpy as np

        thrust, merit, missed = self._exact(asked, at)
        for _ in range(STEPS if len(at) else 0):
            step = self._stepped(asked, at, thrust, trust)
            new = np.clip(at + step, self._low, self._high)
            other, better, still = self._exact(asked, new)
            if better - MISSED * still > merit - MISSED * missed + 1e-9 * self._weight:
                at, thrust, merit, missed = new, other, better, still
            else:
                trust *= 0.4
                if trust < fine:
                    break
        return at, (merit if missed <= MEETS * self._weight else -inf)

    def effects(self, at: Any) -> Array:
        """Force and moment of each jet per thrust, with the hinges at ``at``: shape (6, jets)."""
        import numpy as np

        layout, angles = self._layout, [float(angle) for angle in at]
        axes, places = layout.axes(angles), layout.standing(angles)
        columns = []
        for jet, group in enumerate(layout.groups):
            axis = np.array(axes[group])
            columns.append([*axis, *(np.cross(places[jet], axis) + layout.stations[jet].twist * axis)])
        return np.array(columns).T

    def _exact(self, asked: _Asked, at: Array) -> tuple[Array, float, float]:
        """The best thrusts with the hinges standing, what they give of the goal, and what they miss of what is held."""
        import numpy as np

        goal, rows, values = asked
        effects = self.effects(at)
        jets = effects.shape[1]
        cost = np.concatenate([-(goal @ effects), np.full(2 * len(rows), MISSED)])
        equal = np.hstack([rows @ effects, np.eye(len(rows)), -np.eye(len(rows))])
        bounds = [*zip(self._least, self._most, strict=True), *[(0.0, None)] * (2 * len(rows))]
        found = _solved(cost, equal, values, bounds)
        thrust = found[:jets]
        return thrust, float(goal @ effects @ thrust), float(np.sum(found[jets:]))

    def _stepped(self, asked: _Asked, at: Array, thrust: Array, trust: float) -> Array:
        """A step of the hinges that is best to first order, within ``trust`` of their ranges."""
        import numpy as np

        goal, rows, values = asked
        effects, count = self.effects(at), len(at)
        turns = np.empty((6, count))
        for hinge in range(count):
            nudge = np.zeros(count)
            nudge[hinge] = 1e-6
            turns[:, hinge] = (self.effects(at + nudge) - self.effects(at - nudge)) @ thrust / 2e-6
        jets = effects.shape[1]
        span = trust * (self._high - self._low)
        cost = np.concatenate([-(goal @ effects), -(goal @ turns), np.full(2 * len(rows), MISSED)])
        equal = np.hstack([rows @ effects, rows @ turns, np.eye(len(rows)), -np.eye(len(rows))])
        bounds = [
            *zip(self._least, self._most, strict=True),
            *zip(np.maximum(-span, self._low - at), np.minimum(span, self._high - at), strict=True),
            *[(0.0, None)] * (2 * len(rows)),
        ]
        return _solved(cost, equal, values, bounds)[jets : jets + count]


def reach_of(vehicle: Vehicle, least: Sequence[float], most: Sequence[float]) -> Reach:
    """What the vehicle's layout can do with engines of these thrusts [N] at the allocation's limits."""
    turns = vehicle.turns
    return Reach(vehicle.layout(), least, most, turns, vehicle.rest[: len(turns)], vehicle.mass_kg * GRAVITY)


def _solved(cost: Array, equal: Array, values: Array, bounds: Any) -> Array:
    from scipy.optimize import linprog

    found = linprog(cost, A_eq=equal, b_eq=values, bounds=bounds, method="highs")
    assert found.status == 0, found.message  # what is missed is free, so there always is an answer
    answer: Array = found.x
    return answer
