"""The words of the autopilot: modes, landed states, messages, and what it is told beside the sensors."""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import NamedTuple


class Mode(Enum):
    """What flies.  MANUAL and STABILIZED are the same law here: lean and collective by stick."""

    MANUAL = "MANUAL"
    STABILIZED = "STABILIZED"
    ALTCTL = "ALTCTL"  # lean and climb rate by stick
    POSCTL = "POSCTL"  # velocity and climb rate by stick; let go, it stays
    HOLD = "HOLD"
    TAKEOFF = "TAKEOFF"
    LAND = "LAND"
    RTL = "RTL"
    MISSION = "MISSION"
    OFFBOARD = "OFFBOARD"
    ORBIT = "ORBIT"  # round a centre; begun by a request that names it, not by the mode alone


BY_STICK = frozenset({Mode.MANUAL, Mode.STABILIZED, Mode.ALTCTL, Mode.POSCTL})
DIRECT = frozenset({Mode.MANUAL, Mode.STABILIZED})


class LandedState(Enum):
    ON_GROUND = "on_ground"
    TAKING_OFF = "taking_off"
    IN_AIR = "in_air"
    LANDING = "landing"


class EngineState(Enum):
    """What the step does with the engines."""

    FLY = "fly"  # as the controllers ask
    IDLE = "idle"  # least throttle, no torque
    OFF = "off"  # shut off


class Severity(IntEnum):
    """As in syslog and MAVLink."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class Message(NamedTuple):
    """A line for the people on the ground; ``number`` counts from 1 without gaps."""

    number: int
    k: int
    severity: Severity
    text: str


class Report(NamedTuple):
    """What the vehicle reports beside its sensors at one instant."""

    legs: bool  # the contact switch: a leg touches the ground
    collective: float  # mean throttle of the step before, as allocated
    lost: tuple[int, ...] = ()  # engines that are taken for lost, counted from 1
    remaining: float | None = None  # share of the fuel that is left, 0..1; None: not measured


class Home(NamedTuple):
    """Where to return to: m, NED and height above the origin."""

    north: float
    east: float
    altitude: float
