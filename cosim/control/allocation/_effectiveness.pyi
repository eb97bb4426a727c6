"""What allocation by effectiveness solves in each step; ``effectiveness.h`` has the equations and their sources."""

from collections.abc import Sequence

from cosim.base.signals import Vector3

class Solver:
    """A vehicle as allocation knows it: jets, hinges and surfaces, in this order.

    Parameters
    ----------
    stations : list of tuple
        Of each jet place [m], axis (unit), moment about it per thrust [m], and its hinges from the body outwards:
        number, angle of the thrust over that of the hinge, whether it carries the jet.
    hinges : list of tuple
        Of each point [m], axis (unit), lower and upper limit [rad], largest change in a step, and how much more in a
        hurry.
    surfaces : list of tuple
        Of each the rows that it gives per unit and Pa of dynamic pressure, and the same limits.
    scales, norms : sequence of float
        Of the effectors and of the rows, which make all alike.
    weight, given : float
        N; and the part of a row that is rounding.

    Raises
    ------
    ValueError
        Where there are more of anything than a vehicle may have, or a number is not finite.
    """

    def __init__(
        self,
        stations: list[tuple[Vector3, Vector3, float, list[tuple[int, float, bool]]]],
        hinges: list[tuple[Vector3, Vector3, float, float, float, float]],
        surfaces: list[tuple[tuple[float, ...], float, float, float, float]],
        scales: Sequence[float],
        norms: Sequence[float],
        weight: float,
        given: float,
        /,
    ) -> None: ...
    def solve(
        self,
        wanted: list[float],
        lift: float,
        pressure: float,
        passes: int,
        rated: bool,
        hurried: bool,
        last: list[float],
        ends: list[tuple[float, float]],
        levels: list[tuple[int, ...]],
        preferred: list[float],
        reach: list[tuple[float, float]],
        stand: list[float],
        /,
    ) -> tuple[list[float], list[float]]:
        """Return thrusts [N] and angles for a wrench, and what is missing of it, by Newton's method.

        ``rated``: commands no faster than servos go; ``hurried``: so far ahead of them that they go at their full rate,
        and roll and pitch together as far as they can.  Raises ValueError for NaN.
        """

    def linear(self, at: list[float], pressure: float, /) -> tuple[list[float], list[list[float]]]:
        """Return the wrench in the order of the rows, and its scaled change by each effector."""

    def pitch_arms(self, angles: list[float], /) -> list[float]:
        """Return each jet's pitching moment per thrust [m], its twist left out, with the hinges at ``angles`` [rad].

        ``angles`` are those of the hinges and then the surfaces.
        """

def prioritise(
    rows: Sequence[list[float]],
    wanted: Sequence[float],
    levels: Sequence[tuple[int, ...]],
    start: Sequence[float],
    low: Sequence[float],
    high: Sequence[float],
    along_first: bool = False,
    /,
) -> list[float]:
    """Return the effectors' values that meet the wanted rows by priority within the limits.

    Parameters
    ----------
    rows : sequence of list of float
        What each effector does, of numbers around 1; at most 6 rows of 48.
    wanted : sequence of float
        One number a row.
    levels : sequence of tuple of int
        Rows by their numbers, one or two to a level, the most important level first; a row that is in none is ignored.
    start, low, high : sequence of float
        Where effectors are left if nothing is missing there, and their limits, which may be infinite.
    along_first : bool
        Levels of two rows go as far as they can along the direction of what is missing.

    Returns
    -------
    list of float
        Within the limits.

    Raises
    ------
    ValueError
        For NaN, lengths that do not fit, and levels whose rows are not there or there twice.
    """
