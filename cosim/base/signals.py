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
JETS = 6  # columns that every log has of what a jet has, so that logs can be laid side by side
MOST_JETS = 16  # as many as MAVLink has servo outputs for; chosen by us
ALL_WELL: Final[PerJet] = (1.0,) * MOST_JETS  # health of unmonitored or fully working engines
NO_JETS: Final[frozenset[int]] = frozenset()
# every jet of the log; left and right servo; gyro, attitude, GNSS, barometer
NO_FAULTS: Final[tuple[float, ...]] = (0.0,) * (JETS + 2 + 4)
AXES = ("roll", "pitch", "yaw")


class Command(NamedTuple):
    """What the pilot or the script asks for during one step."""

    attitude: Vector3  # roll, pitch, yaw [rad], NED to body, order yaw-pitch-roll
    altitude: float  # height above the ground [m], held when collective is None
    rate: Vector3 | None = None  # body rates [rad/s]; replaces the attitude loop
    collective: float | None = None  # mean throttle [0..1]; replaces the altitude hold
    place: tuple[float, float] | None = None  # north, east [m] to be at; None: none is asked for
    ahead: float | None = None  # speed along the heading [m/s], over the ground; None: none is asked for


class Disturbance(NamedTuple):
    """The disturbances that act on the vehicle during one step."""

    force: Vector3 = ZERO3  # N, body, at the centre of gravity of the vehicle as built
    moment: Vector3 = ZERO3  # N m, body
    torque_command: Vector3 = ZERO3  # added to the rate controller's output, unknown to the controller
    wind: Vector3 = ZERO3  # m/s, NED: where the air moves to, turbulence not included
    payload: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # kg, then its place [m], body
    gust: tuple[Vector3, float, float, float] | None = None  # m/s NED, rise, hold, fall [s]; only in the step it starts
    torque_output: Vector3 = ZERO3  # as torque_command, but added before the added delay
    torque_seen: Vector3 = ZERO3  # the part of torque_output that a predictor sees


class State(NamedTuple):
    """The true motion of the airframe at one instant."""

    position: Vector3  # m, NED, of the centre of gravity, which a payload moves in the body
    velocity: Vector3  # m/s, NED, over the ground, of the same
    attitude: Quaternion  # body to NED
    euler: Vector3  # roll, pitch, yaw [rad]
    rate: Vector3  # rad/s, body, against the rotating Earth
    specific_force: Vector3  # m/s^2, body, what an accelerometer at the centre of gravity as built feels
    altitude: float  # m above the ground
    wind: Vector3  # m/s, NED, turbulence included
    mass: float  # kg
    on_ground: bool  # a leg touches
    hull_contact: bool  # anything but a leg touches
    air_rate: Vector3 = ZERO3  # rad/s, body: at which turbulence turns the air; aerodynamic damping sees rate less this


class Measured(NamedTuple):
    """What the sensors tell the controller at one instant."""

    rate: Vector3  # rad/s, body, after the gyro's filter
    attitude: Quaternion
    position: Vector3  # m, NED
    velocity: Vector3  # m/s, NED
    altitude: float  # m above the ground
    specific_force: Vector3 = UNKNOWN3  # m/s^2, body, by the accelerometer; NaN where there is none


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
    off: frozenset[int] = NO_JETS  # the jets, from 0, that are shut off on purpose


class ControlSignals(NamedTuple):
    """What a controller shows of itself for one step."""

    rate_setpoint: Vector3  # rad/s, body
    rate_predicted: Vector3  # rad/s, body: what the rate loop is fed with
    torque: Vector3  # the rate loop's output: throttle, rad of tilt, rad of tilt; or rad/s^2, see docs/own-aircraft.md
    collective: float  # mean throttle asked for
    allocated: float  # the collective that allocation gave


class Ambient(NamedTuple):
    """The air around the engines during one step."""

    pressure: float  # Pa, static
    temperature: float  # K, static
    air_speed: PerJet  # m/s, into each intake: of the vehicle through the air, along the jet's thrust


class EngineOutput(NamedTuple):
    """What the engines deliver and report at the end of one step; NaN where an engine does not say."""

    thrust: PerJet  # N, along each jet
    spool_speed: PerJet  # rad/s
    exhaust_temperature: PerJet  # K
    fuel_flow: PerJet  # kg/s
    force_forward: PerJet = ()  # N, across the jet: along body x while it is upright, and tilting with it
    force_right: PerJet = ()  # N, across the jet: along body y
    torque: PerJet = ()  # N m on the airframe, about the jet's axis, right-handed along its thrust


class JetHealth(NamedTuple):
    """What can still be had of one jet; thrusts as a share of the range of a healthy one, full over no throttle."""

    gain: float = 1.0  # thrust delivered per thrust commanded; 0: it does not follow its command
    fixed: float = 0.0  # thrust it delivers whatever the command
    command: float = 0.0  # throttle command of a jet that does not follow


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
    spool_moment: Vector3 = UNKNOWN3  # N m, body, of the spinning rotors on the airframe; NaN where not modelled
    faults: tuple[float, ...] = NO_FAULTS  # 1 where a fault acts
    health: PerJet = ALL_WELL  # share of its command that each jet gives, as the monitor believes
    own: tuple[float, ...] = ()  # what blocks show of their own: see cosim.base.protocols.Shows

    @property
    def thrust(self) -> PerJet:
        """N, delivered."""
        return self.engines.thrust
