"""Limits of attitude commands to what the engines of this vehicle can follow.

Sticks, missions and set-points ask for leans, headings and rates that step.  A loop that has to answer for late engines
drives its command to the stop on such a step, and with its command at the stop it is no longer the loop that was
designed.  So what is asked for moves with bounded rate, acceleration and jerk: both leans as one vector, so that a
diagonal reversal is a straight line, and the heading beside them.  The bounds follow from the designed loop and from
the torque that there is: :func:`attitude_limits`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cosim.base.constants import GRAVITY
from cosim.base.limits import clamp
from cosim.base.signals import AXES, Vector3
from cosim.control.allocation.authority import compute_reach
from cosim.control.autopilot.geometry import Pair, limit_length, wrap
from cosim.control.autopilot.guidance.tracker import Tracker
from cosim.spec.vehicle import EngineLead, Vehicle

# Fraction of the torque that set-points may use, chosen by us; the rest is for wind, noise and overshoot.
COMMAND_FRACTION = 0.25
# Time in which an acceleration builds up, over the attitude loop's time constant: fast enough not to be felt as lag.
BUILD_UP_TIME = 0.5


class AttitudeLimits(NamedTuple):
    """Bounds of the attitude set-point: rad/s, rad/s^2, rad/s^3; roll and pitch share theirs."""

    rate: float
    acceleration: float
    jerk: float
    yaw_rate: float
    yaw_acceleration: float
    yaw_jerk: float


def attitude_limits(
    gain: Sequence[float],
    authority: Sequence[float],
    lean: float,
    yaw_rate: float,
    rate_limit: Sequence[float],
    least_gain: float = 0.1,
) -> AttitudeLimits:
    """Return the bounds for the attitude loop's gains K (roll, pitch, yaw; 1/s) and the usable angular accelerations.

    With ``K = min(K_roll, K_pitch)`` and the most lean L that is asked for,

        rate          K L                        what the loop itself asks for when it is a full lean behind
        acceleration  min(K^2 L, authority)      what it does in the first instant after a step of L
        jerk          acceleration K / 0.5       from rest on; twice that where the acceleration turns round

    so that content faster than the loop's own answer is taken out.  Heading: ``yaw_rate``, ``yaw_rate min(K, K_yaw)``,
    and the same again.  ``authority``: see :func:`angular_authority`; no rate is beyond ``rate_limit``.
    An attitude loop with less than ``least_gain`` [1/s] is not flown.
    """
    k = max(min(gain[0], gain[1]), least_gain)
    k_yaw = max(min(k, gain[2]), least_gain)
    a = min(k * k * lean, authority[0], authority[1])
    turn = min(yaw_rate, rate_limit[2])
    a_yaw = min(turn * k_yaw, authority[2])
    return AttitudeLimits(
        min(k * lean, rate_limit[0], rate_limit[1]),
        a,
        a * k / BUILD_UP_TIME,
        turn,
        a_yaw,
        a_yaw * k_yaw / BUILD_UP_TIME,
    )


def angular_authority(vehicle: Vehicle, hover: float, idle: float, gain: Sequence[float]) -> Vector3:
    """Return the angular acceleration [rad/s^2] that set-points may use about each axis, a quarter of the available.

    ``A = (1/4) room K_u / e``: ``room`` is what hover leaves of the command (throttle either way, or tilt), ``K_u`` the
    angular acceleration per command (moment over inertia; thrust from the weight, at ``hover`` with the fraction
    ``idle`` that an engine gives without throttle), and ``e = 1 + 2 zeta K/w + (K/w)^2`` what a lead asks for beyond
    that to turn the vehicle at the loop's own speed K [1/s] through lags of ``w``, ``zeta`` (``1 + K/w`` for a single
    one, ``1 + K tau`` through a servo).
    """
    if vehicle.allocation == "effectiveness":
        return _full_authority(vehicle, hover, idle, gain)
    jets, control = vehicle.jets, vehicle.control
    limits, inertia = control.allocation, vehicle.inertia_kg_m2
    weight = vehicle.mass_kg * GRAVITY
    room = min(hover - limits.throttle_min, limits.throttle_max - hover)
    per_jet = weight / len(jets) / (hover + idle)  # N per unit of throttle of one jet
    authority = []
    for axis, name in enumerate(AXES):
        servo = vehicle.servo
        if servo is not None and axis > 0:
            if axis == 1:
                moment = weight * abs(sum(jet.position_m[2] for jet in jets)) / len(jets)
            else:
                moment = weight * sum(abs(jet.position_m[1]) for jet in jets) / len(jets)
            extra = 1.0 + gain[axis] * servo.lag_s
            authority.append(COMMAND_FRACTION * servo.range_rad * moment / inertia[axis] / extra)
            continue
        lever = sum(abs((jet.position_m[1], jet.position_m[0], jet.reaction_m)[axis]) for jet in jets)
        lead = getattr(control.lead, name, None)
        authority.append(COMMAND_FRACTION * room * lever * per_jet / inertia[axis] / _lead_gain_at(lead, gain[axis]))
    return (authority[0], authority[1], authority[2])


def _full_authority(vehicle: Vehicle, hover: float, idle: float, gain: Sequence[float], least: float = 0.02) -> Vector3:
    """Return the angular authority [rad/s^2] of a layout in which every throttle and hinge may turn every axis.

    It is a quarter of what the layout attains about each axis, with the slowest hinge taken for all; of ``least``
    [rad/s^2] about one that hardly anything turns, where set-points creep and do not stand.
    """
    per_jet = vehicle.mass_kg * GRAVITY / len(vehicle.jets) / (hover + idle)
    limits, jets = vehicle.control.allocation, len(vehicle.jets)
    low, high = ([per_jet * (fraction + idle)] * jets for fraction in (limits.throttle_min, limits.throttle_max))
    reach = compute_reach(vehicle, low, high)
    lines = [tuple(sign * (n == axis) for n in range(3)) for axis in range(3) for sign in (1.0, -1.0)]
    sizes = [size.lower for size in reach.section(lines)]
    slowest = max([hinge.lag_s for hinge in vehicle.hinges], default=0.0)
    authority = []
    for axis, name in enumerate(AXES):
        extra = max(1.0 + gain[axis] * slowest, _lead_gain_at(getattr(vehicle.control.lead, name, None), gain[axis]))
        moment = max(0.0, min(sizes[2 * axis], sizes[2 * axis + 1]))
        authority.append(COMMAND_FRACTION * max(moment / vehicle.inertia_kg_m2[axis], least) / extra)
    return (authority[0], authority[1], authority[2])


def _lead_gain_at(lead: EngineLead | bool | None, gain: float) -> float:
    """Return ``1 / G`` of the lead's engine poles at ``s = gain`` [1/s]; 1 without a lead."""
    if not isinstance(lead, EngineLead):
        return 1.0
    x = gain / lead.natural_rad_s
    return 1.0 + x if lead.damping is None else 1.0 + 2.0 * lead.damping * x + x * x


class Shaper:
    """Shapes commanded leans, headings or rates to what the loops can follow.

    Attitudes are followed by two :class:`Tracker`, of the leans (rad) and of the heading: from rest to rest a change of
    lean D takes ``D/R + R/(2 A) + R/(2 0.75 A) + A/J`` (rate R, acceleration A, jerk J), and nothing overshoots.
    Rates are followed in the same way and within the same bounds; the lean that they add up to is not bounded.
    """

    def __init__(self, limits: AttitudeLimits, step: float) -> None:
        self._step = step
        self._limits = limits
        self._lean = Tracker(limits.acceleration, limits.jerk, step)
        self._yaw = Tracker(limits.yaw_acceleration, limits.yaw_jerk, step)
        self.reset()

    def reset(self) -> None:
        """Discard the set-points; the next ones begin at the vehicle's state."""
        self._used = self._rates = False

    def limit(self, limits: AttitudeLimits) -> None:
        """Change the limits at the next update; the set-point continues."""
        self._limits = limits
        self._lean.limit(limits.acceleration, limits.jerk)
        self._yaw.limit(limits.yaw_acceleration, limits.yaw_jerk)
        if self._used:
            lean, yaw = self._lean.track, self._yaw.track
            self._lean.start(lean.position, lean.velocity)
            self._yaw.start(yaw.position, yaw.velocity)

    def attitude(self, set_point: Vector3, now: Vector3) -> Vector3:
        """Return roll, pitch and yaw (rad) for the attitude loop; ``now``: the vehicle's attitude."""
        if not self._used or self._rates:
            self._start_set_points(now)
        self._rates = False
        roll, pitch = self._lean.towards((set_point[0], set_point[1]), self._limits.rate).position
        # The heading is unwrapped and goes the short way from the point that leads it, also beyond half a turn.
        point = self._yaw.point[0]
        yaw, _ = self._yaw.towards((point + wrap(set_point[2] - point), 0.0), self._limits.yaw_rate).position
        return (roll, pitch, wrap(yaw))

    def rate(self, set_point: Vector3, now: Vector3) -> Vector3:
        """Return body rates (rad/s) for the rate loop."""
        if not self._used:
            self._start_set_points(now)
        self._rates = True
        limits = self._limits
        p, q = self._lean.at_velocity(limit_length(set_point[0], set_point[1], limits.rate)).velocity
        r, _ = self._yaw.at_velocity((clamp(set_point[2], limits.yaw_rate), 0.0)).velocity
        return (p, q, r)

    def _start_set_points(self, now: Vector3) -> None:
        rates: tuple[Pair, Pair] = ((0.0, 0.0), (0.0, 0.0))
        if self._used:
            rates = (self._lean.track.velocity, self._yaw.track.velocity)
        self._lean.start((now[0], now[1]), rates[0])
        self._yaw.start((now[2], 0.0), rates[1])
        self._used = True
