"""The small records that travel on the wires between the blocks of one control step.

Frames: *body* is forward-right-down (FRD) with its origin at the centre of gravity of the vehicle as built;
*NED* is north-east-down with its origin on the ground below the starting point.  Angles are in rad, everything
else is in SI units.  A quaternion is ``(w, x, y, z)`` and turns body vectors into NED vectors.
"""

from __future__ import annotations

from math import nan
from typing import Final, NamedTuple

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
PerJet = tuple[float, ...]  # jet 1 first
# What servos move: the left and the right bank, or the hinges of a vehicle and then its surfaces, as it states them.
# Of a bank positive tilts the thrust forward, of a hinge it turns right-handed about its axis [rad]; a surface is in
# the unit of its property.
PerServo = tuple[float, ...]

ZERO3: Vector3 = (0.0, 0.0, 0.0)
UNKNOWN3: Vector3 = (nan, nan, nan)
JETS = 6  # columns in every log
MOST_JETS = 16  # servo outputs that MAVLink has
ALL_WELL: Final[PerJet] = (1.0,) * MOST_JETS  # no engine is known to have failed
NO_JETS: Final[frozenset[int]] = frozenset()
# Every jet of the log; left and right servo; gyro, attitude, GNSS, barometer.
NO_FAULTS: Final[tuple[float, ...]] = (0.0,) * (JETS + 2 + 4)
AXES = ("roll", "pitch", "yaw")


class Command(NamedTuple):
    """What the pilot or the script asks for during one step."""

    attitude: Vector3  # roll, pitch, yaw [rad], NED to body
    altitude: float  # m above the ground, without collective
    rate: Vector3 | None = None  # rad/s, body; instead of attitude
    collective: float | None = None  # mean throttle, instead of altitude
    place: tuple[float, float] | None = None  # north, east [m] to go to
    ahead: float | None = None  # m/s along the heading, over the ground


class Disturbance(NamedTuple):
    """The disturbances that act on the vehicle during one step."""

    force: Vector3 = ZERO3  # N, body, at the centre of gravity
    moment: Vector3 = ZERO3  # N m, body
    torque_command: Vector3 = ZERO3  # added to the rate loop's output, unseen
    wind: Vector3 = ZERO3  # m/s, NED, towards; no turbulence
    payload: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # kg, then its place [m], body
    gust: tuple[Vector3, float, float, float] | None = None  # m/s NED; rise, hold, fall [s]; once
    torque_output: Vector3 = ZERO3  # as before, but before the added delay
    torque_seen: Vector3 = ZERO3  # of torque_output, as predictors see it


class State(NamedTuple):
    """The true motion of the airframe at one instant."""

    position: Vector3  # m, NED, of the centre of gravity
    velocity: Vector3  # m/s, NED, over the ground, of the same
    attitude: Quaternion  # body to NED
    euler: Vector3  # roll, pitch, yaw [rad]
    rate: Vector3  # rad/s, body, against the rotating Earth
    specific_force: Vector3  # m/s^2, body, centre of gravity as built
    altitude: float  # m above the ground
    wind: Vector3  # m/s, NED, turbulence included
    mass: float  # kg
    on_ground: bool  # a leg touches
    hull_contact: bool  # anything but a leg touches
    air_rate: Vector3 = ZERO3  # rad/s, body: rotation of the air


class Measured(NamedTuple):
    """What the sensors tell the controller at one instant."""

    rate: Vector3  # rad/s, body, after the gyro's filter
    attitude: Quaternion
    position: Vector3  # m, NED
    velocity: Vector3  # m/s, NED
    altitude: float  # m above the ground
    specific_force: Vector3 = UNKNOWN3  # m/s^2, body; NaN: no accelerometer


class Unallocated(NamedTuple):
    """What allocation could not give: requested minus achieved."""

    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    collective: float = 0.0


class Actuation(NamedTuple):
    """What the controller asks of the engines and of the servos."""

    throttle: PerJet  # 0..1, jet 1 first
    tilt: PerServo
    unallocated: Unallocated
    off: frozenset[int] = NO_JETS  # jets shut on purpose, from 0


class ControlSignals(NamedTuple):
    """What a controller shows of itself for one step."""

    rate_setpoint: Vector3  # rad/s, body
    rate_predicted: Vector3  # rad/s, body, fed back to the rate loop
    torque: Vector3  # throttle, rad, rad; or rad/s^2
    collective: float  # mean throttle asked for
    allocated: float  # the collective that allocation gave


class Ambient(NamedTuple):
    """The air around the engines during one step."""

    pressure: float  # Pa, static
    temperature: float  # K, static
    air_speed: PerJet  # m/s into each intake, along the thrust


class EngineOutput(NamedTuple):
    """What the engines deliver and report at the end of one step; NaN where an engine does not say."""

    thrust: PerJet  # N, along each jet
    spool_speed: PerJet  # rad/s
    exhaust_temperature: PerJet  # K
    fuel_flow: PerJet  # kg/s
    force_forward: PerJet = ()  # N across the jet: body x when upright
    force_right: PerJet = ()  # N across the jet: body y
    torque: PerJet = ()  # N m on the airframe, about the thrust


class JetHealth(NamedTuple):
    """What can still be had of one jet; thrusts as a share of the range of a healthy one, full over no throttle."""

    gain: float = 1.0  # 0: does not follow its command
    fixed: float = 0.0  # thrust it delivers whatever the command
    command: float = 0.0  # throttle of a jet that does not follow


class Sample(NamedTuple):
    """One row of the log: everything that was on the wires during step ``k``.

    ``state`` and ``measured`` are taken at ``t_k``, before the step; the rest acts over ``[t_k, t_k+1)``.
    """

    k: int
    time: float
    command: Command
    state: State
    measured: Measured
    control: ControlSignals
    actuation: Actuation
    tilt: PerServo  # angles of the servos
    engines: EngineOutput  # delivered and reported
    disturbance: Disturbance
    fuel: float = nan  # kg on board at t_k; NaN without a tank
    spool_moment: Vector3 = UNKNOWN3  # N m, body, of the rotors; NaN: unknown
    faults: tuple[float, ...] = NO_FAULTS  # 1 where a fault acts
    health: PerJet = ALL_WELL  # estimated share that each jet gives
    own: tuple[float, ...] = ()  # columns of blocks that show some

    @property
    def thrust(self) -> PerJet:
        """N, delivered."""
        return self.engines.thrust
