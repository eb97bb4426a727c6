"""The records that the protocols speak of, beside those of :mod:`cosim.base.signals`."""

from __future__ import annotations

from enum import Enum
from math import inf
from typing import NamedTuple

from cosim.base.signals import EngineOutput, PerJet, PerServo

# A model's rate without its delay and with it [rad/s], and the delay [samples].
Diagnostics = tuple[float, float, float]


class EngineState(Enum):
    """What the step does with the engines."""

    FLY = "fly"  # as the controller asks
    IDLE = "idle"  # least throttle, no torque
    OFF = "off"  # shut off
    START = "start"  # as idle, and some have yet to start


class Report(NamedTuple):
    """What the vehicle reports to its pilot beside its sensors at one instant."""

    legs: bool  # a leg touches the ground
    collective: float  # mean throttle of the step before
    lost: tuple[int, ...] = ()  # failed engines, counted from 1
    remaining: float | None = None  # share of fuel, 0 to 1; None: unknown
    starting: tuple[int, ...] = ()  # engines yet to start, counted from 1


class Parameter(NamedTuple):
    """One number of a controller of one's own that scenarios, ``settings``, studies and searches reach by its name.

    It is ``controller_parameters.<name>`` there, and ``default`` where nobody states it.
    """

    name: str  # letters, digits and _
    default: float
    unit: str = ""
    meaning: str = ""
    least: float = -inf
    most: float = inf


class Applied(NamedTuple):
    """What became of the step before: what the actuators were given, and what the engines report of it."""

    throttle: PerJet  # 0 to 1; at first the initial ones
    tilt: PerServo  # rad, within the servo's range
    engines: EngineOutput  # reported at its end
    burnt: float  # kg of fuel, counted from a full tank


class Column(NamedTuple):
    """One column of a flight's log: what it is called and what it means, and where its numbers come from."""

    name: str  # letters, digits, _; with unit: _rad_s
    unit: str
    frame: str  # body, NED, ...; or empty
    meaning: str
    source: str = ""  # empty for columns of blocks
