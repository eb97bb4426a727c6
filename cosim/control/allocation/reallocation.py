"""Re-planning around engines that are lost, weak or stuck: what is left, and how it gives what all engines gave.

Everything is stated in *shares*: thrust over the range ``T(1) - T(0)`` of one healthy engine, so that a healthy engine
at command ``u`` gives ``idle + u``.  With all engines healthy, collective ``c`` and roll ``r`` ask jet ``i`` for
``idle + c + s_i r``, with ``s_i`` +1 on the left and -1 on the right.  The force and the moments about x and y of that
are what a plan gives with the engines that are left:

    sum w_i v_i = sum w_i (idle + c + s_i r),   w = 1, y, x,   v_i = gain_i (idle + u_i) + fixed_i

so that the rest of the controller, its identified models and its hover feed-forward stay as they are.  The commands are
affine in collective and roll, ``u = trim + up (c - c0) + roll r``; their weights come from a linear program that leaves
the most roll either way around hover.  What those weights cannot give of a large collective the engines that are kept
free for roll give too, as far as roll does not ask for them: ``boost`` leads on from there to the most that is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

from cosim.base.errors import InputError
from cosim.base.signals import JetHealth
from cosim.spec.vehicle import AllocationLimits, Jet

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[Any]

# Chosen by us: fraction of hover thrust kept either way for height control during roll, 1.5 m/s^2 of climb; then
# fractions of that reserve, tried in turn, because a runaway engine leaves little room downwards.
_RESERVE, _RESERVE_FALLBACKS = 0.15, (1.0, 0.5, 0.25, 0.1)


@dataclass(frozen=True)
class Plan:
    """Throttles of all jets as an affine function of collective and roll, after an engine loss.

    ``boost`` is what each jet adds for collective beyond the largest that ``up`` reaches.  ``pitch`` is the pitch
    moment that the throttles leave, in share m: constant, per collective, per roll, per collective of ``boost``.
    """

    centre: float
    free: tuple[bool, ...]  # controlled jets; others get ``trim``
    trim: tuple[float, ...]
    up: tuple[float, ...]
    roll: tuple[float, ...]
    roll_range: tuple[float, float]  # that leaves a range of collective
    boost: tuple[float, ...]
    pitch: tuple[float, float, float, float]


def plan(
    jets: Sequence[Jet], limits: AllocationLimits, hover: float, idle: float, health: Sequence[JetHealth]
) -> Plan | None:
    """Return throttles for collective and roll without parasitic pitch; None if the remaining engines cannot balance.

    ``hover`` is the share asked of every jet in hover.
    """
    import numpy as np

    low, high = limits.throttle_min, limits.throttle_max
    rows, side = _effect_rows(jets), np.array([-1.0 if jet.position_m[1] > 0.0 else 1.0 for jet in jets])
    gain = np.array([engine.gain for engine in health])
    fixed = np.array([engine.fixed for engine in health])
    free = np.flatnonzero(gain > 0.0)
    if not free.size:
        return None
    given = rows[:, free] * gain[free]
    stands = rows @ fixed + given.sum(axis=1) * idle  # force and moments with zero commands
    per_collective, per_roll = rows.sum(axis=1), rows @ side
    at_zero = per_collective * idle - stands  # load that commands add at collective 0
    top = _most_collective(given, at_zero, per_collective, low, high)
    if top is None:
        return None
    most = min(top[0], hover * (1.0 + 2.0 * _RESERVE))
    centre, kept = (hover, min(_RESERVE * hover, 0.5 * (most - hover))) if most > hover else (0.9 * most, 0.05 * most)
    planned = None
    for part in _RESERVE_FALLBACKS:
        reserve = part * kept
        planned = _optimise_commands(
            given,
            at_zero + per_collective * centre,
            per_collective * reserve,
            per_roll,
            side[free],
            (low, high, centre, reserve),
        )
        if planned is not None:
            break
    if planned is None:
        return None
    trim, up, roll, reach = planned
    up, roll = up / reserve, roll / reach
    trim, up, roll = (
        _correct_residual(given, value, wanted)
        for value, wanted in (
            (trim, at_zero + per_collective * centre),
            (up, per_collective),
            (roll, per_roll),
        )
    )
    boost = _boost_commands(trim, up, centre, top, high, low)
    left = [
        float(residual[2])
        for residual in (
            given @ trim - at_zero - per_collective * centre,
            given @ up - per_collective,
            given @ roll - per_roll,
            given @ boost - per_collective if boost.any() else np.zeros(3),
        )
    ]
    # Levers below a billionth of a metre are rounding.
    constant, per_up, per_reach, per_boost = (0.0 if abs(value) < 1e-9 else value for value in left)
    everything = np.zeros((4, len(jets)))
    everything[0] = [engine.command for engine in health]
    everything[:, free] = (trim, up, roll, boost)
    return Plan(
        centre=centre,
        free=tuple(engine.gain > 0.0 for engine in health),
        trim=tuple(everything[0].tolist()),
        up=tuple(everything[1].tolist()),
        roll=tuple(everything[2].tolist()),
        roll_range=_roll_range(trim, up, roll, low, high),
        boost=tuple(everything[3].tolist()),
        pitch=(constant, per_up, per_reach, per_boost),
    )


def _effect_rows(jets: Sequence[Jet]) -> Array:
    """Return lift, and roll and pitch moment, of each jet per unit of thrust: shape (3, jets)."""
    import numpy as np

    return np.array([[1.0, jet.position_m[1], jet.position_m[0]] for jet in jets]).T


def command_to_torque(jets: int, allocator: Any) -> list[list[float]]:
    """Return the pseudo-inverse of a bank or rotor allocation, from commands to demand.

    Rows of roll, pitch and yaw, by every throttle and then the left and the right tilt; at hover's thrust, where a tilt
    is what was asked for.  Raises InputError for an allocator of another kind.
    """
    import numpy as np

    columns = np.zeros((jets + 2, 4))  # columns: collective, roll, pitch, yaw
    columns[:jets, 0] = 1.0
    if hasattr(allocator, "pitch_sign"):
        columns[:jets, 1] = [1.0 if on_left else -1.0 for on_left in allocator.left]
        columns[jets:, 2] = allocator.pitch_sign
        columns[jets:, 3] = (1.0, -1.0)
    elif hasattr(allocator, "signs"):
        columns[:jets, 1:] = allocator.signs
    else:
        raise InputError(f"{type(allocator).__name__}: its torques are not those of banks or rotors")
    # Couplings below the rounding are none.
    return [[round(float(x), 15) + 0.0 for x in row] for row in np.linalg.pinv(columns)[1:]]


def load_solver() -> None:
    """Import the solver, which takes 0.2 s, before a flight that may need it."""
    import scipy.optimize  # noqa: F401


def _linprog(cost: Any, ub: Any = None, eq: Any = None, bounds: Any = None) -> Any:
    """Solve a linear program with scipy; None if infeasible."""
    from scipy.optimize import linprog

    a, b = ub if ub is not None else (None, None)
    e, f = eq if eq is not None else (None, None)
    solution = linprog(cost, A_ub=a, b_ub=b, A_eq=e, b_eq=f, bounds=bounds, method="highs")
    return solution if solution.status == 0 else None


def _most_collective(
    given: Array, at_zero: Array, per_collective: Array, low: float, high: float
) -> tuple[float, Array] | None:
    """Return the largest balanced collective of the free jets, and its commands; None if there is none above 0."""
    import numpy as np

    count = given.shape[1]
    cost = np.append(np.zeros(count), -1.0)
    solution = _linprog(
        cost,
        eq=(np.column_stack([given, -per_collective]), at_zero),
        bounds=[(low, high)] * count + [(0.0, None)],
    )
    return None if solution is None or solution.x[-1] <= 1e-6 else (float(solution.x[-1]), solution.x[:count])


def _boost_commands(trim: Array, up: Array, centre: float, top: tuple[float, Array], high: float, low: float) -> Array:
    """Return each jet's command per collective beyond the largest that the plan reaches without roll, up to ``top``.

    Both ends give their collective in balance, and so does everything between them.
    """
    import numpy as np

    flat = 1e-9  # throttle per collective counted as 0

    room = [
        ((high if slope > 0.0 else low) - base) / slope
        for base, slope in zip(trim, up, strict=True)
        if abs(slope) > flat
    ]
    reached = min(room, default=0.0)
    gain = top[0] - centre - reached
    if gain <= 1e-6:
        return np.zeros(len(trim))
    boost: Array = (top[1] - trim - reached * up) / gain
    boost[np.abs(boost) < flat] = 0.0
    return boost


def _optimise_commands(
    given: Array, trim: Array, up: Array, roll: Array, side: Array, limits: tuple[float, float, float, float]
) -> tuple[Array, Array, Array, float] | None:
    """Find commands for trim, ``up`` and the largest multiple ``reach`` of ``roll`` with each jet in its limits.

    Every corner ``trim +- up +- roll`` is within the limits, which are low, high, centre and what is kept for ``up``.
    ``up`` and ``roll`` may leave pitch over, at a cost, and jets may do more than in health, at a small one.
    """
    import numpy as np

    low, high, centre, kept = limits
    n = given.shape[1]
    zero, none = np.zeros((3, n)), np.zeros((3, 1))
    # Unknowns: trim, up, roll (n each); reach; pitch left over by up and by roll (2 each); largest excess of each.
    over_up, over_roll = np.zeros((3, 7)), np.zeros((3, 7))
    over_up[2, :2], over_roll[2, 2:4] = (1.0, -1.0), (1.0, -1.0)
    equal = np.vstack(
        [
            np.hstack([given, zero, zero, none, np.zeros((3, 7))]),
            np.hstack([zero, given, zero, none, over_up]),
            np.hstack([zero, zero, given, -roll[:, None], over_roll]),
        ]
    )
    eye, off, empty, ones = np.eye(n), np.zeros((n, n)), np.zeros((n, 8)), np.ones((n, 1))
    corners = np.vstack([np.hstack([eye, a * eye, b * eye, empty]) for a, b in product((1.0, -1.0), repeat=2)])
    columns = np.eye(8)[5:]
    usual = np.zeros((n, 1)), np.zeros((n, 1)), side[:, None]
    excess, wanted = [], []
    for index, value in enumerate((centre, kept, 0.0)):
        chosen = [eye if place == index else off for place in range(3)]
        for sign in (1.0, -1.0):
            beyond = np.hstack([-sign * usual[index], np.zeros((n, 4)), -ones * columns[index][None, 5:]])
            excess.append(np.hstack([*(sign * part for part in chosen), beyond]))
            wanted.append(np.full(n, sign * value))
    unequal = np.vstack([corners, -corners, *excess])
    bound = np.concatenate([np.full(4 * n, high), np.full(4 * n, -low), *wanted])
    # Roll authority weighs 1. A pitch moment left to tilts is dear, as throttles balance pitch where they can; the
    # largest departure of a jet from its nominal command costs a little, which spreads the load.
    cost = np.concatenate([np.zeros(3 * n), [-1.0], np.full(4, 1e3), np.full(3, 0.05)])
    bounds = [(None, None)] * (3 * n) + [(0.0, None)] * 8
    solution = _linprog(cost, (unequal, bound), (equal, np.concatenate([trim, up, np.zeros(3)])), bounds)
    if solution is None or solution.x[3 * n] < 1e-6:
        return None
    return solution.x[:n], solution.x[n : 2 * n], solution.x[2 * n : 3 * n], float(solution.x[3 * n])


def _correct_residual(given: Array, value: Array, wanted: Array) -> Array:
    """Return commands with the smallest change for which lift and moments equal ``wanted`` exactly, if possible."""
    import numpy as np

    moved: Array = value + np.linalg.lstsq(given, wanted - given @ value, rcond=None)[0]
    return moved if np.allclose(given @ moved, wanted, rtol=0.0, atol=1e-9) else value


def _roll_range(trim: Array, up: Array, roll: Array, low: float, high: float) -> tuple[float, float]:
    """Return the range of the roll command in which a collective keeps all jets within their limits."""
    import numpy as np

    both = np.column_stack([up, roll])
    ub = np.vstack([both, -both]), np.append(high - trim, trim - low)
    ends = [_linprog((0.0, sign), ub, bounds=[(None, None), (None, None)]) for sign in (1.0, -1.0)]
    lowest, highest = (0.0 if end is None else float(end.x[1]) for end in ends)
    return (lowest, highest)
