"""What bounded effectors can do of several things that are wanted, the more important first.

Wanted are values of linear functions ``rows[r] . x`` of effectors ``low <= x <= high``; rows stand in levels.  Each
level is brought as near to what is wanted of it as the effectors can while what the levels before it were given stays
as it is.  A level of two rows keeps the direction of what is missing as far as it goes; then each row goes on alone or,
where it is asked for, both go as far along that direction as they can, whatever comes across it.

The method is the redistributed pseudo-inverse with priorities (Bodson, "Evaluation of Optimization Methods for Control
Allocation", J. Guidance, Control, and Dynamics 25, 2002), made exact by an active set (Härkegård, "Efficient Active Set
Algorithms for Solving Constrained Least Squares Problems in Aircraft Control Allocation", 41st IEEE CDC, 2002): for
each row the effectors move along that row's part that is square to all rows that are held, an effector that meets its
limit is left there, and where nothing moves any more one whose multiplier has the wrong sign is let go again.  That
is a linear program along a line, solved by the steepest feasible direction; it ends, after a bounded number of moves,
where no effector can do more.  While no limit is met the answer is the least one beside the start,
``x0 + A^+ (wanted - A x0)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Final

RANK: Final = 1e-20  # square of the part of a row, over the row's, below which it has none of its own
DONE: Final = 1e-13  # of what is wanted, in the rows' unit: nothing is missing


def prioritise(
    rows: Sequence[list[float]],
    wanted: Sequence[float],
    levels: Sequence[Sequence[int]],
    start: Sequence[float],
    low: Sequence[float],
    high: Sequence[float],
    along_first: bool = False,
) -> list[float]:
    """Return the effectors' values that meet the wanted rows by priority within the limits; see the module's text.

    Parameters
    ----------
    rows : sequence of list of float
        What each effector does, of numbers around 1.
    wanted : sequence of float
        One number a row.
    levels : sequence of sequence of int
        Rows by their numbers, one or two to a level, the most important level first; a row that is in none is ignored.
    start, low, high : sequence of float
        Where effectors are left if nothing is missing there, and their limits.
    along_first : bool
        Levels of two rows go as far as they can along the direction of what is missing.

    Returns
    -------
    list of float
        Within the limits.
    """
    x = [low[i] if value < low[i] else (high[i] if value > high[i] else value) for i, value in enumerate(start)]
    held: list[list[float]] = []
    for level in levels:
        first = rows[level[0]]
        if len(level) == 1:
            _alone(first, wanted[level[0]], held, x, low, high)
            held.append(first)
            continue
        second = rows[level[1]]
        a, b = wanted[level[0]] - _dot(first, x), wanted[level[1]] - _dot(second, x)
        size = sqrt(a * a + b * b)
        if size > DONE:
            a, b = a / size, b / size
            along = [a * p + b * q for p, q in zip(first, second, strict=True)]
            across = [a * q - b * p for p, q in zip(first, second, strict=True)]
            left = size - _move(along, size, [*held, across], x, low, high)
            if left > DONE and along_first:
                _move(along, left, held, x, low, high)
                _alone(across, a * wanted[level[1]] - b * wanted[level[0]], [*held, along], x, low, high)
            elif left > DONE:
                _alone(first, wanted[level[0]], [*held, second], x, low, high)
                _alone(second, wanted[level[1]], [*held, first], x, low, high)
        held.append(first)
        held.append(second)
    return x


def _alone(
    row: list[float],
    wanted: float,
    held: Sequence[list[float]],
    x: list[float],
    low: Sequence[float],
    high: Sequence[float],
) -> None:
    """Bring one row as near to what is wanted of it as it goes while ``held`` keep their values."""
    missing = wanted - _dot(row, x)
    if missing > DONE:
        _move(row, missing, held, x, low, high)
    elif missing < -DONE:
        _move([-value for value in row], -missing, held, x, low, high)


def _move(
    row: list[float],
    amount: float,
    held: Sequence[list[float]],
    x: list[float],
    low: Sequence[float],
    high: Sequence[float],
) -> float:
    """Raise ``row . x`` by ``amount`` or as far as it goes, with ``held`` rows as they are; by how much it was."""
    count = len(x)
    free = [low[i] < high[i] for i in range(count)]
    whole = _dot(row, row)
    given = 0.0
    if whole == 0.0:
        return given
    for _ in range(4 * count + 4):
        along = _square_to(row, held, free)
        size = _square(along, free)
        if size <= RANK * whole:
            # nothing that is free moves it: what stands at a limit, and would, comes free again
            if not _release(along, 1e-9 * sqrt(whole), free, x, low, high):
                return given
            continue
        first = _first_limit(along, (amount - given) / size, free, x, low, high)
        if first is None:
            continue
        stopped, met = first
        for i in range(count):
            if free[i]:
                value = x[i] + stopped * along[i]
                x[i] = low[i] if value < low[i] else (high[i] if value > high[i] else value)
        given += stopped * size
        if met < 0:
            return given
        x[met] = high[met] if along[met] > 0.0 else low[met]
        free[met] = False
    return given


def _first_limit(
    along: Sequence[float],
    reach: float,
    free: list[bool],
    x: Sequence[float],
    low: Sequence[float],
    high: Sequence[float],
) -> tuple[float, int] | None:
    """Return how far ``x`` goes along a direction, ``reach`` at most, and the effector whose limit ends it, else -1.

    Where free effectors are at their limits already, they are fixed there and None is returned.
    """
    stopped, met = reach, -1
    shut = False
    for i, speed in enumerate(along):
        if not free[i] or speed == 0.0:
            continue
        room = ((high[i] if speed > 0.0 else low[i]) - x[i]) / speed
        if room <= 0.0:
            free[i] = False
            shut = True
        elif room < stopped:
            stopped, met = room, i
    return None if shut else (stopped, met)


def _release(
    along: Sequence[float],
    least: float,
    free: list[bool],
    x: Sequence[float],
    low: Sequence[float],
    high: Sequence[float],
) -> bool:
    """Free the effector at a limit that ``along`` moves most from it, more than ``least``; return if there is one."""
    best, freed = least, -1
    for i, move in enumerate(along):
        if not free[i] and low[i] < high[i]:
            inward = move if x[i] <= low[i] else (-move if x[i] >= high[i] else 0.0)
            if inward > best:
                best, freed = inward, i
    if freed >= 0:
        free[freed] = True
    return freed >= 0


def _square_to(row: list[float], held: Sequence[list[float]], free: Sequence[bool]) -> list[float]:
    """``row`` less its part in the rows ``held``, as the free effectors see them.

    Of effectors that are not free it is what the row would gain by them with the held rows held: their multipliers.
    """
    basis: list[list[float]] = []
    for other in held:
        part = _less(other, basis, free)
        square = _square(part, free)
        if square > RANK * _square(other, free):
            scale = 1.0 / sqrt(square)
            basis.append([value * scale for value in part])
    return _less(row, basis, free)


def _square(row: Sequence[float], free: Sequence[bool]) -> float:
    """Return the sum of the squares of a row over the free effectors."""
    total = 0.0
    for i, value in enumerate(row):
        if free[i]:
            total += value * value
    return total


def _less(row: list[float], basis: Sequence[list[float]], free: Sequence[bool]) -> list[float]:
    """``row`` without its part along each of an orthonormal basis; twice, which is enough for rounding."""
    part = row
    count = len(row)
    for _ in (0, 1):
        for unit in basis:
            along = 0.0
            for i in range(count):
                if free[i]:
                    along += unit[i] * part[i]
            part = [part[i] - along * unit[i] for i in range(count)]
    return part


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    total = 0.0
    for i, value in enumerate(a):
        total += value * b[i]
    return total
