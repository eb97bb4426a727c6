"""The records that the protocols speak of, beside those of :mod:`cosim.base.signals`."""

from __future__ import annotations

from enum import Enum
from math import inf
from typing import NamedTuple

from cosim.base.signals import EngineOutput, PerJet, PerServo

Diagnostics = tuple[float, float, float]  # a model's rate without its delay, and with it [rad/s]; the delay [samples]


class EngineState(Enum):
    """What the step does with the engines."""

    FLY = "fly"  # as the controller asks
    IDLE = "idle"  # least throttle, no torque
    OFF = "off"  # shut off
    START = "start"  # as idle, and some have yet to start


class Report(NamedTuple):
    """What the vehicle reports to its pilot beside its sensors at one instant."""

    legs: bool  # the contact switch: a leg touches the ground
    collective: float  # mean throttle of the step before, as allocated
    lost: tuple[int, ...] = ()  # engines that are taken for lost, counted from 1
    remaining: float | None = None  # share of the fuel that is left, 0..1; None: not measured
    starting: tuple[int, ...] = ()  # engines that have yet to start, counted from 1


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

    throttle: PerJet  # 0 to 1; before the first step those at which the engines stand
    tilt: PerServo  # rad, left and right servo or hinges, kept within the servos' range
    engines: EngineOutput  # reported at its end
    burnt: float  # kg of fuel, counted from a full tank


class Column(NamedTuple):
    """One column of a flight's log: what it is called and what it means, and where its numbers come from."""

    name: str  # letters, digits and _; ends with its unit where that is not plain: _rad_s, _N
    unit: str
    frame: str  # body, NED, ...; empty where there is none
    meaning: str
    source: str = ""  # as in cosim.results.log.columns; a block that shows leaves it out
