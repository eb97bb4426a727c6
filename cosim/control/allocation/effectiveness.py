"""Allocation by effectiveness of each throttle, hinge and surface, computed from the layout where the vehicle works.

Asked for are a lift, along body -z, and three angular accelerations [rad/s^2], which the tensor of inertia makes into
moments.  Thrusts and angles ``u`` give the wrench ``f(u)`` of :class:`cosim.base.layout.Layout`, exactly: each step
solves ``f(u) = wanted`` by Newton's method from the commands of the step before, every linear problem within limits and
by priority.  What is told as not given is wanted less ``f(u)``: what the commands really give, once engines and servos
have followed.  ``effectiveness.h`` has the method, its sources and the code, in C: a solution takes thousands of
multiplications in every step, and as Python's numbers each was an object.

The priority, chosen by us: roll and pitch moment, which turn the thrust and without which everything else is lost; then
lift; then yaw, whose loss turns the nose and no more; last, where the vehicle asks for it, horizontal force.  Where the
effectors leave a choice, it is the least use of them beside a preferred one, each counted by its range and weighed by
its ``effort``: thrusts as they share the weight in hover, hinges at rest, surfaces at zero.

A hinge's command moves no faster than its servo can; one that lags follows that late.  An engine that is lost is taken
out of the layout, one that is weak or stuck stays in it with what it gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, hypot, inf, sqrt
from typing import Final, NamedTuple

from cosim.base.constants import GRAVITY
from cosim.base.errors import FlightError, InputError
from cosim.base.layout import Layout
from cosim.base.signals import NO_JETS, ZERO3, Actuation, JetHealth, PerJet, PerServo, Unallocated, Vector3
from cosim.control.allocation._effectiveness import Solver

# Rows of the force and moment demand.
ROW_ROLL: Final = 0
ROW_PITCH: Final = 1  # row of the pitching moment
ROW_LIFT: Final = 2  # row of the lift
ROW_YAW: Final = 3  # row of the yawing moment
ROW_FORWARD: Final = 4  # row of the force forward
ROW_RIGHT: Final = 5  # row of the force to the right
PRIORITIES: Final = ((ROW_ROLL, ROW_PITCH), (ROW_LIFT,), (ROW_YAW,))  # rows, highest priority first
HORIZONTAL: Final = ((ROW_FORWARD, ROW_RIGHT),)  # optional rows of lowest priority
AHEAD: Final = ((ROW_FORWARD,),)  # row added in forward flight
# Largest angle between a tilt and the demanded force. Chosen by us: beyond it are solutions with front and rear turned
# against each other, from which no small step leads out.
MAX_SWING_RAD: Final = 0.6
# Residuals below this fraction of weight, or of weight times radius of gyration, are rounding.
TINY: Final = 1e-10
# Limits of Newton iterations in a step (two are usual), and in the first one, without a previous solution.
MAX_ITERATIONS: Final = 6
MAX_FIRST: Final = 60  # iterations without a previous solution


class Effector(NamedTuple):
    """A hinge or surface as allocation treats it."""

    lower: float
    upper: float
    rest: float
    step: float  # largest change of its command in a step
    effort: float
    wrench: tuple[float, ...] = ()  # force, moment per unit and Pa, body axes
    lead: float = 0.0  # rate times lag: lead for full servo rate


class AllocationModel(NamedTuple):
    """Data of a vehicle that allocation needs.

    ``tensor``: of inertia, kg m^2, by rows; ``low`` and ``span``: thrust of the reference engine without throttle, and
    what full throttle adds [N], which shares of thrust count in; ``shares``: least and most of each station;
    ``efforts`` of the jets; ``horizontal``: force ahead and aside is asked for, below all else.
    """

    name: str
    layout: Layout
    mass: float
    tensor: tuple[Vector3, Vector3, Vector3]
    low: float
    span: float
    shares: Sequence[tuple[float, float]]
    efforts: Sequence[float]
    effectors: Sequence[Effector]
    horizontal: bool = False


StationOf = tuple[Vector3, Vector3, float, list[tuple[int, float, bool]]]
HingeOf = tuple[Vector3, Vector3, float, float, float, float]
SurfaceOf = tuple[tuple[float, ...], float, float, float, float]


class Constants(NamedTuple):
    """Effectiveness, weights and limits of the allocation, for another implementation.

    ``stations``, ``hinges``, ``surfaces``, ``scales``, ``norms`` and ``weight`` as
    :class:`._effectiveness.Solver` takes them.  ``preferred`` are the thrusts [N], and ``neutral`` the positions of
    hinges and surfaces, that a solution stays near where the effectors leave a choice.
    """

    stations: list[StationOf]
    hinges: list[HingeOf]
    surfaces: list[SurfaceOf]
    scales: list[float]
    norms: tuple[float, ...]
    weight: float
    tensor: tuple[Vector3, Vector3, Vector3]
    inverse: tuple[Vector3, Vector3, Vector3]
    low: float
    span: float
    shares: list[tuple[float, float]]
    thrust_limits: list[tuple[float, float]]
    preferred: list[float]
    levels: list[tuple[int, ...]]
    servo_limits: list[tuple[float, float]]
    neutral: list[float]


class SolverOptions(NamedTuple):
    """Start, limits and priorities of one solution that override the allocator's own."""

    last: list[float]  # thrusts [N] and servos of the last step
    thrust_limits: list[tuple[float, float]]  # N, limits of each thrust
    levels: list[tuple[int, ...]]
    servo_limits: list[tuple[float, float]]
    neutral: list[float]  # preferred servo positions


class EffectivenessAllocator:
    """Throttles and servo angles of a vehicle of any layout.

    ``is_balanced``: the engines, as they are known to be, hold the vehicle up with no roll and no pitch moment.
    Raises InputError where the vehicle cannot be held in hover, or a number of it is nothing to compute with.
    """

    def __init__(self, model: AllocationModel) -> None:
        name, layout, mass, tensor, low, span, shares, efforts, effectors, horizontal = model
        self._layout, self._tensor, self._mass = layout, tensor, mass
        self._inverse = _invert(tensor)
        self._low, self._span = low, span
        self._jets = len(layout.stations)
        self._hinges = len(layout.turns)
        self._effectors = list(effectors)
        self._limits = list(shares)
        self._levels = [*PRIORITIES, *(HORIZONTAL if horizontal else ())]
        self._levels_ahead = [*PRIORITIES, *AHEAD]
        self._weight = mass * GRAVITY
        self.hover = (self._weight / self._jets - low) / span
        gyration = (max(tensor[0][0], tensor[1][1], tensor[2][2]) / mass) ** 0.5  # radius of gyration, m
        force, moment = 1.0 / self._weight, 1.0 / (self._weight * gyration)
        # Scales of the rows, as a list: compiled code reads one item of it without making float objects.
        self._norms: list[float] = [moment, moment, force, moment, force, force]
        self._scales = [
            (most - least) * span / effort for (least, most), effort in zip(shares, efforts, strict=True)
        ] + [(effector.upper - effector.lower) / effector.effort for effector in effectors]
        self._described = _describe_effectors(model)
        try:
            self._solver = Solver(*self._described, self._scales, self._norms, self._weight, TINY)
        except ValueError as error:
            raise InputError(f"{name}: jets, hinges, surfaces, control.allocation: {error}") from error
        self.rest: PerServo = tuple([effector.rest for effector in effectors]) or (0.0, 0.0)
        self.pressure = 0.0  # dynamic pressure at the surfaces, Pa
        self._servo_limits = [(effector.lower, effector.upper) for effector in effectors]
        self._neutral = [effector.rest for effector in effectors]  # preferred positions
        self.surfaces = len(self._effectors) - self._hinges
        self.reset()
        if not self.is_balanced:
            raise InputError(
                f"{name}: jets, hinges: in hover they leave {_describe_largest_missing(self._missing, self._norms)} "
                "that nothing balances; hexjet aircraft check says what the engines can do"
            )

    def reset(self) -> None:
        """Start with all engines healthy and hinges at rest."""
        self._set_thrust_limits([JetHealth()] * self._jets)
        self._compute_hover()
        # The first commands are where the servos are.
        self._last = [*self._preferred, *(effector.rest for effector in self._effectors)]

    def _set_thrust_limits(self, health: Sequence[JetHealth]) -> None:
        """Set the thrust limits [N] for engines of this health: ``span (gain (idle + share) + fixed)``."""
        idle = self._low / self._span
        self._health = list(health)
        self._thrust_limits: list[tuple[float, float]] = []
        for (least, most), jet in zip(self._limits, health, strict=True):
            self._thrust_limits.append(
                (
                    self._span * (jet.gain * (idle + least) + jet.fixed),
                    self._span * (jet.gain * (idle + most) + jet.fixed),
                )
            )

    def _compute_hover(self) -> None:
        """Compute the thrusts and angles that balance the weight in hover, used as start and as neutral position.

        Where there is a choice they push nowhere: else dear thrusts stayed even and a tilted hinge balanced them.
        """
        even = self._low + self._span * self.hover
        self._preferred = [even] * self._jets
        self._last = [even] * self._jets + [effector.rest for effector in self._effectors]
        wanted = [0.0, 0.0, self._weight, 0.0, 0.0, 0.0]
        usual, self._levels = self._levels, [*PRIORITIES, *HORIZONTAL]
        found, missing = self._solve(wanted, self._weight, MAX_FIRST, False)
        self._levels = usual
        self._missing = [missing[row] * self._norms[row] for row in range(6)]
        self.is_balanced = all(abs(self._missing[row]) <= 1e-6 for row in (ROW_ROLL, ROW_PITCH, ROW_LIFT))
        self._preferred = found[: self._jets]
        self._hovers = self._last = found

    def replan(self, health: Sequence[JetHealth]) -> bool:
        """Allocate for engines of this health from the next step on; return True: any health can be allocated for."""
        before = self._last
        self._set_thrust_limits(health)
        self._compute_hover()
        self._last = before  # continue from the previous solution
        return True

    def trim(self, collective: float) -> PerJet:
        """Return the thrust fractions that balance the vehicle at ``collective``, with hinges near rest."""
        wanted = [0.0, 0.0, self._jets * (self._low + self._span * collective), 0.0, 0.0, 0.0]
        found, _ = self._solve(wanted, wanted[ROW_LIFT], MAX_FIRST, False)
        return self._thrust_fractions(found)

    @property
    def constants(self) -> Constants:
        """Allocation constants (effectiveness, weights, limits) for the current health of the engines."""
        stations, hinges, surfaces = self._described
        return Constants(
            stations,
            hinges,
            surfaces,
            self._scales,
            tuple(self._norms),
            self._weight,
            self._tensor,
            self._inverse,
            self._low,
            self._span,
            self._limits,
            self._thrust_limits,
            self._preferred,
            self._levels,
            self._servo_limits,
            self._neutral,
        )

    def solve_hover(self, torque: Vector3) -> tuple[list[float], list[float]]:
        """Return thrusts [N] and servos [rad] for angular accelerations [rad/s^2] in hover, however fast servos are.

        Returned second is what is missing of force [N] and moment [N m], in the order of the rows."""
        found, missing = self._solve(self._wrench(self._weight, torque, ZERO3), self._weight, MAX_FIRST, False)
        return found, [0.0 if -TINY <= m * norm <= TINY else m for m, norm in zip(missing, self._norms, strict=True)]

    def unit_changes(self, axis: int) -> tuple[list[float], list[float]]:
        """Return effector changes per rad/s^2 about an axis in hover, and the acceleration per effector's change.

        Effectors are the thrusts [N], hinges and surfaces [rad], in this order."""
        small = 1e-3
        still, _ = self.solve_hover(ZERO3)
        moved, _ = self.solve_hover((small * (axis == 0), small * (axis == 1), small * (axis == 2)))
        _, rows = self._solver.linear(still, self.pressure)
        effects: list[float] = []
        for j, scale in enumerate(self._scales):
            turn = 0.0
            for row, inverse in zip((ROW_ROLL, ROW_PITCH, ROW_YAW), self._inverse[axis], strict=True):
                turn += inverse * rows[row][j] / self._norms[row]
            effects.append(turn / scale)
        # The commands are linearised: they differ from the exact ones by the square of ``small``.
        given = 0.0
        for m, s, effect in zip(moved, still, effects, strict=True):
            given += effect * (m - s)
        return [(m - s) / given if given else 0.0 for m, s in zip(moved, still, strict=True)], effects

    def acceleration_limit(self, axis: int) -> float:
        """Return the largest angular acceleration [rad/s^2] about an axis that hover attains in both directions."""
        most = inf
        for sign in (1.0, -1.0):
            low, high = 0.0, 1.0
            while high < 1e4 and self._attains_acceleration(axis, sign * high):
                low, high = high, 2.0 * high
            for _ in range(20):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if self._attains_acceleration(axis, sign * middle) else (low, middle)
            most = min(most, low)
        return most

    def _attains_acceleration(self, axis: int, size: float, missed: float = 1e-4) -> bool:
        """Return whether hover attains an angular acceleration, but for a fraction ``missed`` of weight and moment."""
        _, missing = self.solve_hover((size * (axis == 0), size * (axis == 1), size * (axis == 2)))
        return all(abs(missing[row]) * self._norms[row] <= missed for row in (ROW_ROLL, ROW_PITCH, ROW_LIFT, ROW_YAW))

    def allocate(self, collective: float, torque: Vector3, added: Vector3 = ZERO3) -> Actuation:
        """Return throttles and tilts for lift and angular accelerations, and the part beyond the limits.

        ``collective``: the thrust fraction at which each of the reference's engines gives its part of the lift;
        ``torque``: angular accelerations [rad/s^2]; ``added``: of a disturbance that the controller does not know.
        """
        lift = self.total_thrust(collective)
        found, missing = self._solve(self._wrench(lift, torque, added), lift, MAX_ITERATIONS, True)
        return self._make_actuation(found, missing)

    def _wrench(self, lift: float, torque: Vector3, added: Vector3) -> list[float]:
        """Return the wrench of a lift [N] and angular accelerations [rad/s^2], in the order of the rows: N and N m."""
        x, y, z = torque
        if added != ZERO3:
            x, y, z = x + added[0], y + added[1], z + added[2]
        (a, b, c), (d, e, f), (g, h, i) = self._tensor
        return [a * x + b * y + c * z, d * x + e * y + f * z, lift, g * x + h * y + i * z, 0.0, 0.0]

    def total_thrust(self, collective: float) -> float:
        """Return the sum of thrusts [N] with every engine at a thrust fraction."""
        return self._jets * (self._low + self._span * collective)

    def allocate_forward(
        self, force: float, lift: float, pitch: float, torque: Vector3, tilts: Sequence[int]
    ) -> tuple[Actuation, float]:
        """Allocate ``force`` along body x and ``lift`` along -z [N], a pitching moment [N m] and angular accelerations.

        The force ahead is last in priority, and jets are not asked to push down.  Where there is a choice the servos
        ``tilts`` stand along the force that is wanted, never far from it, and the thrusts share it, upright with no
        pitching moment.  Also answered is what is missing of the force ahead [N].
        """
        jets, last = self._jets, self._last
        least = 0.0
        for low, _ in self._thrust_limits:
            least += low
        asked = lift
        # Subtract the lift of the surfaces at their last positions; what is left is the jets' share.
        for number in range(self._hinges, len(self._effectors)):
            asked += self.pressure * last[jets + number] * self._effectors[number].wrench[2]
        # The jets' share of the lift, which surfaces reduce, is raised to at least 5 % of the forward force.
        asked = lift + max(0.0, 0.05 * max(force, least) - asked)
        without = force
        if asked < least:  # even idle thrust points forward
            force = max(force, sqrt(least * least - asked * asked))
        wanted = self._wrench(asked, torque, ZERO3)
        wanted[ROW_PITCH] += pitch
        wanted[ROW_FORWARD] = force
        whole, along = max(hypot(force, asked), least), atan2(force, asked)
        neutral, preferred, servo_limits, levels = self._neutral, self._preferred, self._servo_limits, self._levels
        self._neutral, self._servo_limits = list(neutral), list(servo_limits)
        for tilt in tilts:
            low, high = servo_limits[tilt]
            middle = self._neutral[tilt] = min(max(along, low), high)
            self._servo_limits[tilt] = (max(low, middle - MAX_SWING_RAD), min(high, middle + MAX_SWING_RAD))
        self._preferred = self._share_weight(cos(along) * cos(along))
        self._levels = self._levels_ahead
        found, missing = self._solve(wanted, whole, MAX_ITERATIONS, True)
        self._neutral, self._preferred, self._servo_limits, self._levels = neutral, preferred, servo_limits, levels
        missing[ROW_LIFT] += lift - asked
        missing[ROW_FORWARD] += without - force
        return self._make_actuation(found, missing), missing[ROW_FORWARD]

    def _share_weight(self, balanced: float) -> list[float]:
        """Return each jet's part of the weight [N] at neutral angles: equal, with the least change that balances pitch.

        ``is_balanced``: the fraction of the equal parts' pitching moment that is taken out."""
        jets = self._jets
        arms = self._solver.pitch_arms(self._neutral)
        total = spread = 0.0
        for arm in arms:
            total += arm
        mean = total / jets
        for arm in arms:
            spread += (arm - mean) * (arm - mean)
        per_arm = balanced * mean / spread if spread else 0.0
        return [self._weight * (1.0 / jets - per_arm * (arm - mean)) for arm in arms]

    def _make_actuation(self, found: list[float], missing: list[float]) -> Actuation:
        """Store a solution as the start of the next step, and return its actuation with the residual ``missing``."""
        self._last = found
        for row in range(6):
            if -TINY <= missing[row] * self._norms[row] <= TINY:
                missing[row] = 0.0
        roll = pitch = yaw = 0.0
        if missing[ROW_ROLL] or missing[ROW_PITCH] or missing[ROW_YAW]:
            (a, b, c), (d, e, f), (g, h, i) = self._inverse
            x, y, z = missing[ROW_ROLL], missing[ROW_PITCH], missing[ROW_YAW]
            roll, pitch, yaw = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
        return Actuation(
            self._thrust_fractions(found),
            tuple(found[self._jets :]) or self.rest,
            Unallocated(roll, pitch, yaw, missing[ROW_LIFT] / (self._jets * self._span)),
            NO_JETS,
        )

    def _thrust_fractions(self, found: Sequence[float]) -> PerJet:
        """Return the thrust fraction of each jet for thrusts [N], limited to the range of the jet."""
        idle = self._low / self._span
        answer: list[float] = []
        for jet, health in enumerate(self._health):
            least, most = self._limits[jet]
            if health.gain <= 0.0:
                answer.append(health.command)
                continue
            share = (found[jet] / self._span - health.fixed) / health.gain - idle
            answer.append(least if share < least else (most if share > most else share))
        return tuple(answer)

    def _solve(
        self, wanted: list[float], lift: float, passes: int, rated: bool, options: SolverOptions | None = None
    ) -> tuple[list[float], list[float]]:
        """Return thrusts [N] and angles [rad] for a wrench, and its residual; ``rated``: within the servos' rates.

        With ``options`` also with the servos' lead.  Raises FlightError for what is not finite.
        """
        last, limits, levels = self._last, self._thrust_limits, self._levels
        servo_limits, neutral, pressure, preferred = self._servo_limits, self._neutral, self.pressure, self._preferred
        lead = rated and options is not None
        if options is not None:
            last, limits, levels, servo_limits, neutral = options
        try:
            return self._solver.solve(
                wanted, lift, pressure, passes, rated, lead, last, limits, levels, preferred, servo_limits, neutral
            )
        except ValueError as error:
            raise FlightError(f"the allocation cannot be solved: {error}") from error


def _describe_effectors(model: AllocationModel) -> tuple[list[StationOf], list[HingeOf], list[SurfaceOf]]:
    """Return the arguments of :class:`._effectiveness.Solver` that describe jets, hinges and surfaces."""
    layout, effectors = model.layout, model.effectors
    stations: list[StationOf] = []
    for jet, (station, chain) in enumerate(zip(layout.stations, layout.chains, strict=True)):
        links = [(number, effect, jet in layout.turns[number].carries) for number, effect in chain]
        stations.append((station.position, station.axis, station.twist, links))
    hinges: list[HingeOf] = [
        (turn.point, turn.axis, effector.lower, effector.upper, effector.step, effector.lead)
        for turn, effector in zip(layout.turns, effectors, strict=False)
    ]
    surfaces: list[SurfaceOf] = []
    for effector in effectors[len(hinges) :]:
        fx, fy, fz, mx, my, mz = effector.wrench
        surfaces.append(((mx, my, -fz, mz, fx, fy), effector.lower, effector.upper, effector.step, effector.lead))
    return stations, hinges, surfaces


def _describe_largest_missing(missing: Sequence[float], norms: Sequence[float]) -> str:
    """Describe the largest of the missing moments and lift, with its unit."""
    names = {ROW_ROLL: ("roll", "N m"), ROW_PITCH: ("pitch", "N m"), ROW_LIFT: ("lift", "N")}
    row = max(names, key=lambda each: abs(missing[each]))
    name, unit = names[row]
    return f"{missing[row] / norms[row]:.3g} {unit} of {name}"


def _invert(tensor: tuple[Vector3, Vector3, Vector3]) -> tuple[Vector3, Vector3, Vector3]:
    """Return the inverse of a symmetric positive definite matrix."""
    (a, b, c), (_, d, e), (_, _, f) = tensor
    xx, xy, xz = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * xx + b * xy + c * xz
    yy, yz, zz = a * f - c * c, b * c - a * e, a * d - b * b
    return (
        (xx / determinant, xy / determinant, xz / determinant),
        (xy / determinant, yy / determinant, yz / determinant),
        (xz / determinant, yz / determinant, zz / determinant),
    )
