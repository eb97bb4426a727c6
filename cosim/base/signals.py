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
PerJet = tuple[float, ...]  # one number per jet, jet 1 first
# One number per servo: the left and the right bank, or the hinges and then the surfaces in the vehicle's order.
# Positive tilts a bank's thrust forward [rad] and turns a hinge right-handed about its axis [rad]; a surface is in the
# unit of its property.
PerServo = tuple[float, ...]

ZERO3: Vector3 = (0.0, 0.0, 0.0)
UNKNOWN3: Vector3 = (nan, nan, nan)
JETS = 6  # jets with columns in every log
MAX_JETS = 16  # MAVLink has 16 servo outputs
ALL_HEALTHY: Final[PerJet] = (1.0,) * MAX_JETS  # each jet follows its commands
NO_JETS: Final[frozenset[int]] = frozenset()
# Fault flags, all inactive: each jet of the log; left and right servo; gyro, attitude, GNSS, barometer.
NO_FAULTS: Final[tuple[float, ...]] = (0.0,) * (JETS + 2 + 4)
AXES = ("roll", "pitch", "yaw")


class Command(NamedTuple):
    """Command of a pilot or script for one step; None: not commanded."""

    attitude: Vector3  # roll, pitch, yaw [rad], NED to body
    altitude: float  # m above ground; unused with a collective
    rate: Vector3 | None = None  # rad/s, body; replaces attitude
    collective: float | None = None  # mean throttle; replaces altitude
    place: tuple[float, float] | None = None  # target north, east [m]
    ahead: float | None = None  # commanded m/s along heading, over ground


class Disturbance(NamedTuple):
    """Disturbances that act on the vehicle during one step."""

    force: Vector3 = ZERO3  # N, body, at the centre of gravity
    moment: Vector3 = ZERO3  # N m, body
    torque_command: Vector3 = ZERO3  # added to rate loop output, not predicted
    wind: Vector3 = ZERO3  # change of wind, m/s, NED, where it blows
    payload: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # kg, then its position [m], body
    gust: tuple[Vector3, float, float, float] | None = None  # m/s NED; rise, hold, fall [s]; one gust
    torque_output: Vector3 = ZERO3  # as above, added before the added delay
    torque_seen: Vector3 = ZERO3  # part of torque_output told to predictors


class State(NamedTuple):
    """The true motion of the airframe at one instant."""

    position: Vector3  # m, NED, of the centre of gravity
    velocity: Vector3  # m/s, NED, over the ground, of that point
    attitude: Quaternion  # body to NED
    euler: Vector3  # roll, pitch, yaw [rad]
    rate: Vector3  # rad/s, body, relative to the Earth
    specific_force: Vector3  # m/s^2, body, centre of gravity as built
    altitude: float  # m above the ground
    wind: Vector3  # m/s, NED, turbulence included
    mass: float  # kg
    on_ground: bool  # a leg touches the ground
    hull_contact: bool  # a point other than a leg touches
    air_rate: Vector3 = ZERO3  # rad/s, body: rotation of the air


class Measured(NamedTuple):
    """Measurements of the sensors for the controller at one instant."""

    rate: Vector3  # rad/s, body, after the gyro's filter
    attitude: Quaternion
    position: Vector3  # m, NED
    velocity: Vector3  # m/s, NED
    altitude: float  # m above the ground
    specific_force: Vector3 = UNKNOWN3  # m/s^2, body; NaN: no accelerometer


class Unallocated(NamedTuple):
    """Part of the demand that allocation could not deliver: requested minus achieved."""

    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    collective: float = 0.0


class Actuation(NamedTuple):
    """Commands of the controller to engines and servos."""

    throttle: PerJet  # 0..1, jet 1 first
    tilt: PerServo
    unallocated: Unallocated
    off: frozenset[int] = NO_JETS  # jets shut off on purpose, from 0


class ControlSignals(NamedTuple):
    """Internal signals of a controller for one step, for the log."""

    rate_setpoint: Vector3  # rad/s, body
    rate_predicted: Vector3  # rad/s, body, fed back to the rate loop
    torque: Vector3  # roll: throttle; pitch, yaw: rad of tilt
    collective: float  # mean throttle asked for
    allocated: float  # collective after allocation


class Ambient(NamedTuple):
    """The air around the engines during one step."""

    pressure: float  # Pa, static
    temperature: float  # K, static
    air_speed: PerJet  # m/s into each intake, along the thrust


class EngineOutput(NamedTuple):
    """Outputs and reports of the engines at the end of one step; NaN if an engine does not report it."""

    thrust: PerJet  # N, along each jet
    spool_speed: PerJet  # rad/s
    exhaust_temperature: PerJet  # K
    fuel_flow: PerJet  # kg/s
    force_forward: PerJet = ()  # N across the jet: body x when upright
    force_right: PerJet = ()  # N across the jet: body y
    torque: PerJet = ()  # N m on the airframe, about the thrust


class JetHealth(NamedTuple):
    """Remaining ability of one jet; thrusts are fractions of a healthy jet's range from zero to full throttle."""

    gain: float = 1.0  # response to the command; 0: ignores it
    fixed: float = 0.0  # thrust delivered whatever the command
    command: float = 0.0  # throttle of a jet that ignores commands


class Sample(NamedTuple):
    """One row of the log: all signals of step ``k``.

    ``state`` and ``measured`` are taken at ``t_k``, before the step; the rest acts over ``[t_k, t_k+1)``.
    """

    k: int
    time: float
    command: Command
    state: State
    measured: Measured
    control: ControlSignals
    actuation: Actuation
    tilt: PerServo  # servo angles
    engines: EngineOutput  # true and reported engine outputs
    disturbance: Disturbance
    fuel: float = nan  # kg on board at t_k; NaN without a tank
    spool_moment: Vector3 = UNKNOWN3  # N m, body, of the rotors; NaN: unknown
    faults: tuple[float, ...] = NO_FAULTS  # 1 where a fault is active
    health: PerJet = ALL_HEALTHY  # estimated fraction of command, per jet
    own: tuple[float, ...] = ()  # extra log columns of blocks

    @property
    def thrust(self) -> PerJet:
        """Delivered thrust of each jet [N]."""
        return self.engines.thrust
