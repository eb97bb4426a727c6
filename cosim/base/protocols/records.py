"""The records that the protocols speak of, beside those of :mod:`cosim.base.signals`."""

from __future__ import annotations

from enum import Enum
from math import inf
from typing import NamedTuple

from cosim.base.signals import EngineOutput, PerJet, PerServo

# Predictor diagnostics: a model's rate without and with its delay [rad/s], and the delay [samples].
Diagnostics = tuple[float, float, float]


class EngineState(Enum):
    """State of the engines that a step requires."""

    FLY = "fly"  # follows the controller's commands
    IDLE = "idle"  # least throttle, no torque
    OFF = "off"  # engine shut off
    START = "start"  # idle, while some engines still start


class Report(NamedTuple):
    """Reports of the vehicle to its pilot other than sensors, at one instant."""

    legs: bool  # a leg touches the ground
    collective: float  # mean throttle of the step before
    lost: tuple[int, ...] = ()  # numbers of failed engines, from 1
    remaining: float | None = None  # fraction of fuel, 0 to 1; None: unknown
    starting: tuple[int, ...] = ()  # numbers of engines that start, from 1


class Parameter(NamedTuple):
    """Named number of a user's controller that scenarios, ``settings``, studies and searches can set.

    It is ``controller_parameters.<name>`` there, and ``default`` where nobody states it.
    """

    name: str  # only letters, digits and _
    default: float
    unit: str = ""
    meaning: str = ""
    least: float = -inf
    most: float = inf


class Applied(NamedTuple):
    """Actuator commands of the previous step, and the engines' reports at its end."""

    throttle: PerJet  # 0 to 1; initially the start values
    tilt: PerServo  # rad, within the servo's range
    engines: EngineOutput  # engine outputs at the end of the step
    burnt: float  # kg of fuel burnt since the tank was full


class Column(NamedTuple):
    """One column of a flight's log: name, unit, frame, meaning and source."""

    name: str  # letters, digits, _; unit last: _rad_s
    unit: str
    frame: str  # reference frame (body, NED) or empty
    meaning: str
    source: str = ""  # where in Sample; empty: a block's own
