"""Modes, landed states and messages of the autopilot."""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import NamedTuple


class Mode(Enum):
    """Flight modes.  MANUAL and STABILIZED are the same here: sticks command lean and collective."""

    MANUAL = "MANUAL"
    STABILIZED = "STABILIZED"
    ALTCTL = "ALTCTL"  # stick: lean and climb rate
    POSCTL = "POSCTL"  # sticks: velocity and climb, else hold
    HOLD = "HOLD"
    TAKEOFF = "TAKEOFF"
    LAND = "LAND"
    RTL = "RTL"
    MISSION = "MISSION"
    OFFBOARD = "OFFBOARD"
    ORBIT = "ORBIT"  # circles around the requested centre


STICK_MODES = frozenset({Mode.MANUAL, Mode.STABILIZED, Mode.ALTCTL, Mode.POSCTL})  # modes flown by sticks
DIRECT = frozenset({Mode.MANUAL, Mode.STABILIZED})  # stick modes without height hold


class LandedState(Enum):
    """Landed state of the vehicle, from standing to flying."""

    ON_GROUND = "on_ground"
    TAKING_OFF = "taking_off"
    IN_AIR = "in_air"
    LANDING = "landing"


class Severity(IntEnum):
    """Severity of a message, numbered as in syslog and MAVLink."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class Message(NamedTuple):
    """A message to ground stations; ``number`` counts from 1 without gaps."""

    number: int
    k: int
    severity: Severity
    text: str


class Home(NamedTuple):
    """The position to return to: m, NED and height above the origin."""

    north: float
    east: float
    altitude: float
