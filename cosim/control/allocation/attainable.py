"""What no thrusts and hinge angles of a layout can exceed: the convex hull of all forces and moments, from outside.

With ``u = (cos a, sin a)`` of every hinge free of each other the wrench of a jet is linear in its thrust and in each
``u``: a hinge turns force and moment about its point alike.  Over a piece of its range ``u`` runs along an arc, which
lies in the triangle of the arc's ends and of the point where the tangents there meet, further out by ``1 / cos`` of
half the piece.  A function that is linear in each of its arguments lies, over triangles and intervals, in the convex
hull of its values at their corners.  So the corners of all pieces hold everything that engines on common hinges can do,
and one linear program over shares of the corners bounds what is asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple

from cosim.base.layout import Layout

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[Any]


class Objective(NamedTuple):
    """Linear program: maximise ``goal . (force, moment)`` subject to ``rows . (force, moment) = values``."""

    goal: Array
    rows: Array
    values: Array


class Bound(NamedTuple):
    """Maximum over a hull (minus infinity: infeasible), with thrusts, hinge angles and the angles' spread there."""

    upper: float
    thrust: Array
    angles: Array
    spread: Array


class Hull:
    """Convex hull of the forces and moments of a layout with thrusts [N] and hinge angles [rad] within limits."""

    def __init__(self, columns: Array, sets: Array, thrusts: Array, angles: Array) -> None:
        self.columns = columns  # force and moment of corners: 6 rows
        self._sets = sets  # rows of 0/1: which engines a set has
        self._thrusts, self._angles = thrusts, angles  # one row per corner

    @classmethod
    def of(cls, layout: Layout, min_thrust: Array, max_thrust: Array, low: Array, high: Array) -> Hull | None:
        """Return the hull of a layout; None if its hinges do not allow one or it has too many corners."""
        import numpy as np

        columns, sets, thrusts, angles = [], [], [], []
        for number, (jets, hinges) in enumerate(_group_jets_by_hinges(layout)):
            effects = [_thrust_turn_factor(layout, hinge, jets) for hinge in hinges]
            if None in effects or any(_deflects_outside_carrier(layout, jet) for jet in jets):
                return None
            spans = [abs(effect or 0.0) * (high[h] - low[h]) for h, effect in zip(hinges, effects, strict=True)]
            cells = _cell_count(spans, 2 ** sum(bool(min_thrust[jet] < max_thrust[jet]) for jet in jets))
            if not cells:
                return None
            arcs = [_corners(low[h], high[h], cells, effect or 0.0) for h, effect in zip(hinges, effects, strict=True)]
            corners = np.array(list(product(*(range(2 * cells + 1) for _ in hinges))), int)
            turned = {hinge: arcs[n][1][corners[:, n]] for n, hinge in enumerate(hinges)}
            wrench = {jet: _wrenches(layout, jet, turned, len(corners)) for jet in jets}
            at = np.zeros((len(corners), len(low)))
            for n, hinge in enumerate(hinges):
                at[:, hinge] = arcs[n][0][corners[:, n]]
            for ends in product(*(sorted({float(min_thrust[jet]), float(max_thrust[jet])}) for jet in jets)):
                columns.append(sum(end * wrench[jet] for end, jet in zip(ends, jets, strict=True)))
                thrust = np.zeros(len(layout.stations))
                thrust[jets] = ends
                thrusts.append(np.tile(thrust, (len(corners), 1)))
                angles.append(at)
                sets.append(np.full(len(corners), number))
        owner = np.concatenate(sets)
        rows = np.array([owner == number for number in range(int(owner[-1]) + 1)], float)
        return cls(np.vstack(columns).T, rows, np.vstack(thrusts), np.vstack(angles))

    def bound(self, objective: Objective, scale: float) -> Bound:
        """Return the maximum over the hull; ``scale`` [N or N m]: what forces and moments are divided by."""
        import numpy as np
        from scipy.optimize import Bounds, LinearConstraint, milp

        equal = np.vstack([objective.rows @ self.columns / scale, self._sets])
        values = np.concatenate([objective.values / scale, np.ones(len(self._sets))])
        # A problem without integers is a linear program; milp has less overhead than linprog.
        result = milp(
            -(objective.goal @ self.columns) / scale,
            constraints=LinearConstraint(equal, values, values),
            bounds=Bounds(0.0, np.inf),
        )
        if result.status == 2:
            nothing = np.zeros(self._angles.shape[1])
            return Bound(-inf, np.zeros(self._thrusts.shape[1]), nothing, nothing)
        assert result.status == 0, result.message  # weights of corners are bounded
        weights = result.x
        thrust, angles = weights @ self._thrusts, weights @ self._angles
        spread = np.sqrt(np.maximum(weights @ self._angles**2 - angles**2, 0.0))
        return Bound(float(-result.fun) * scale, thrust, angles, spread)


def _group_jets_by_hinges(layout: Layout) -> Iterator[tuple[list[int], list[int]]]:
    """Yield groups of jets that share hinges, each with the numbers of these hinges."""
    hinges_of = [{number for number, _ in chain} for chain in layout.chains]
    remaining = set(range(len(hinges_of)))
    while remaining:
        jets, hinges = {min(remaining)}, set(hinges_of[min(remaining)])
        while connected := {jet for jet in remaining if hinges_of[jet] & hinges} - jets:
            jets |= connected
            hinges = hinges.union(*(hinges_of[jet] for jet in connected))
        remaining -= jets
        yield sorted(jets), sorted(hinges)


def _thrust_turn_factor(layout: Layout, hinge: int, jets: list[int]) -> float | None:
    """Return by how much thrusts turn per angle of a hinge; None: not equal for all jets."""
    effects = {effect for jet in jets for number, effect in layout.chains[jet] if number == hinge}
    return effects.pop() if len(effects) == 1 else None


def _deflects_outside_carrier(layout: Layout, jet: int) -> bool:
    """Return whether a hinge that carries a jet is inside of one that deflects it.

    Force and lever then turn by the same angle, and their product is not linear in it."""
    deflected = False
    for number, _ in layout.chains[jet]:
        if jet not in layout.turns[number].carries:
            deflected = True
        elif deflected:
            return True
    return False


def _cell_count(spans: list[float], ends: int, corners: int = 400, max_corners: int = 6000, widest: float = 1.0) -> int:
    """Return into how many pieces to cut each hinge's range; 0: it would take more corners than allowed.

    A piece of the ``widest`` [rad] has a triangle that is out by 14 %.  With so many ``corners`` of one set of engines
    on common hinges a program takes milliseconds; with more than ``max_corners`` no bound is computed.
    """
    enough = [n for n in (16, 12, 8, 6, 4, 3, 2, 1) if all(span / n <= widest for span in spans)]
    few = [n for n in enough if ends * (2 * n + 1) ** len(spans) <= corners]
    if few:
        return few[0]
    return enough[-1] if enough and ends * (2 * enough[-1] + 1) ** len(spans) <= max_corners else 0


def _corners(low: float, high: float, cells: int, effect: float) -> tuple[Array, Array]:
    """Return the corners of triangles round a hinge's arc: angles [rad], cosine and sine of the thrust's turn."""
    import numpy as np

    ends = np.linspace(low, high, cells + 1)
    angles = np.concatenate([ends, 0.5 * (ends[1:] + ends[:-1])])
    out = np.ones(len(angles))
    out[cells + 1 :] /= np.cos(0.5 * effect * (high - low) / cells)
    return angles, np.column_stack([out * np.cos(effect * angles), out * np.sin(effect * angles)])


def _wrenches(layout: Layout, jet: int, turned: dict[int, Array], count: int) -> Array:
    """Return force and moment per thrust for cosine and sine of each hinge, which may vary independently."""
    import numpy as np

    station = layout.stations[jet]
    position = np.array(station.position)
    force = np.tile(np.array(station.axis, float), (count, 1))
    moment = np.cross(position, force) + station.twist * force
    for number, _ in reversed(layout.chains[jet]):
        turn = layout.turns[number]
        force, about = _rotate(turn.axis, turned[number], force), moment - np.cross(turn.point, force)
        if jet in turn.carries:
            moment = _rotate(turn.axis, turned[number], about) + np.cross(turn.point, force)
        else:
            moment = np.cross(position, force) + station.twist * force
    return np.hstack([force, moment])


def _rotate(axis: Any, at: Array, vectors: Array) -> Array:
    """Return vectors rotated by Rodrigues' formula, each by the cosine and sine in its row of ``at``."""
    import numpy as np

    unit = np.array(axis)
    along = np.outer(vectors @ unit, unit)
    rotated: Array = along + at[:, :1] * (vectors - along) + at[:, 1:] * np.cross(unit, vectors)
    return rotated
