"""What an engine's ports are: their order in the C loop, and their quantities."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from cosim.engine.fmu.air import DERIVED
from cosim.engine.fmu.units import (
    ANGULAR_SPEED,
    DENSITY,
    FORCE,
    LENGTH,
    MASS_FLOW,
    MOMENT,
    PRESSURE,
    RATIO,
    SPEED,
    TEMPERATURE,
    Quantity,
)
from cosim.engine.fmu.variables import REALS, SWITCH_TYPES, THROTTLE_TYPES

# Inputs in the order of the C loop.
BASE_INPUTS = ("throttle", "ambient_pressure", "ambient_temperature", "air_speed")
INPUTS = (*BASE_INPUTS, *DERIVED)  # all inputs
SIDE_LOADS = ("force_forward", "force_right", "torque")  # loads on the airframe beside thrust
OUTPUTS = ("thrust", "spool_speed", "exhaust_temperature", "fuel_flow", *SIDE_LOADS)  # all outputs
AMBIENT = INPUTS[1:]  # inputs other than throttle
NEEDED = ("throttle", "thrust")  # ports that every engine has


class PortKind(NamedTuple):
    """Kind of a port: causality, quantity and allowed types.

    A port is found by its own name; what other tools call it is for a mapping file to say, because a name that means
    different things to different tools gives a wrong number.
    """

    causality: str
    quantity: Quantity
    types: tuple[str, ...] = REALS
    library_name: str = ""  # name in shipped engines, if different
    only_mapped: bool = False  # used only if a mapping names it


KINDS: Mapping[str, PortKind] = {  # quantity and types of each port
    "throttle": PortKind("input", RATIO, THROTTLE_TYPES),
    "ambient_pressure": PortKind("input", PRESSURE),
    "ambient_temperature": PortKind("input", TEMPERATURE),
    "air_speed": PortKind("input", SPEED),
    "altitude": PortKind("input", LENGTH),
    "mach": PortKind("input", RATIO),
    "density": PortKind("input", DENSITY),
    "total_pressure": PortKind("input", PRESSURE),
    "total_temperature": PortKind("input", TEMPERATURE),
    "run": PortKind("input", RATIO, SWITCH_TYPES),
    "thrust": PortKind("output", FORCE),
    # Ram drag is subtracted from a thrust that is gross thrust.
    "ram_drag": PortKind("output", FORCE, only_mapped=True),
    "spool_speed": PortKind("output", ANGULAR_SPEED),
    "exhaust_temperature": PortKind("output", TEMPERATURE),
    "fuel_flow": PortKind("output", MASS_FLOW),
    # Forces are in the frame of the jet, which tilts with it; most engines' torque is that of the shaft.
    "force_forward": PortKind("output", FORCE, only_mapped=True),
    "force_right": PortKind("output", FORCE, only_mapped=True),
    "torque": PortKind("output", MOMENT, only_mapped=True),
    "start": PortKind("parameter", RATIO, library_name="throttle_start"),
}
