"""What an engine's ports are: their order in the C loop, their quantities, and what tools call them."""

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
from cosim.engine.fmu.variables import LEVERS, REALS, SWITCHES

# In the order of the C loop.
BASE = ("throttle", "ambient_pressure", "ambient_temperature", "air_speed")
INPUTS = (*BASE, *DERIVED)
ASIDE = ("force_forward", "force_right", "torque")  # loads of an engine on the airframe other than its thrust
OUTPUTS = ("thrust", "spool_speed", "exhaust_temperature", "fuel_flow", *ASIDE)
AMBIENT = INPUTS[1:]
NEEDED = ("throttle", "thrust")


class PortKind(NamedTuple):
    """What a port is, and what it is usually called.

    Names are compared in lower case and without anything but letters and digits.  They are plain words and the symbols
    of gas turbine performance programs: FN and N as in the glossary of GSP, Fnet, Nmech and Wf as in NASA's T-MATS, PLA
    for the power lever's angle, thrust-lbs, n1 and fuel-flow-rate-pps as in JSBSim's properties.  Left out is what
    means different things to different tools: ``P0`` and ``T0`` (static or total), ``FG`` (gross thrust, without ram
    drag), ``T4`` and ``T5`` (on one side of the turbine or the other).
    """

    causality: str
    quantity: Quantity
    types: tuple[str, ...]
    usual_names: tuple[str, ...]
    ambiguous_names: tuple[str, ...] = ()  # names that count where no better one is found
    only_mapped: bool = False  # never found by name, because an FMU may mean another thing by it


KINDS: Mapping[str, PortKind] = {
    "throttle": PortKind(
        "input",
        RATIO,
        LEVERS,
        (
            "throttle", "throttlecmd", "throttlecommand", "throttlecmdnorm", "throttleinput", "throttlelever",
            "throttleposition", "throttlepos", "throttlesetting", "thr", "thrcmd", "thrustlever", "thrustleverangle",
            "tla", "pla", "powerlever", "powerleverangle", "powersetting",
        ),
        ("lever", "command", "cmd", "control", "u"),
    ),
    "ambient_pressure": PortKind(
        "input",
        PRESSURE,
        REALS,
        (
            "ambientpressure", "pressureambient", "pambient", "pamb", "ps0", "staticpressure", "atmosphericpressure",
            "patm", "pinf",
        ),
        ("pressure",),
    ),
    "ambient_temperature": PortKind(
        "input",
        TEMPERATURE,
        REALS,
        (
            "ambienttemperature", "temperatureambient", "ambienttemp", "tambient", "tamb", "ts0", "oat",
            "outsideairtemperature", "statictemperature", "tinf",
        ),
        ("temperature",),
    ),
    "air_speed": PortKind(
        "input",
        SPEED,
        REALS,
        (
            "airspeed", "trueairspeed", "tas", "vtas", "flightspeed", "flightvelocity", "freestreamvelocity", "v0",
            "vinf", "vair",
        ),
    ),
    "altitude": PortKind(
        "input",
        LENGTH,
        REALS,
        ("altitude", "alt", "pressurealtitude", "flightaltitude", "hp", "zp"),
    ),
    "mach": PortKind("input", RATIO, REALS, ("mach", "machnumber", "flightmach", "mn", "xm")),
    "density": PortKind(
        "input", DENSITY, REALS, ("density", "airdensity", "ambientdensity", "rho", "rhoamb", "rhoair")
    ),
    "total_pressure": PortKind(
        "input",
        PRESSURE,
        REALS,
        ("totalpressure", "ptotal", "ptot", "stagnationpressure", "pt0", "pt1", "inlettotalpressure"),
    ),
    "total_temperature": PortKind(
        "input",
        TEMPERATURE,
        REALS,
        ("totaltemperature", "ttotal", "ttot", "stagnationtemperature", "tt0", "tt1", "totalairtemperature", "tat"),
    ),
    "run": PortKind("input", RATIO, SWITCHES, ("run", "enginerun", "runcommand", "runcmd", "fuelon", "runswitch")),
    "thrust": PortKind(
        "output",
        FORCE,
        REALS,
        (
            "thrust", "fn", "fnet", "netthrust", "thrustnet", "thrustforce", "jetthrust", "enginethrust",
        ),
        ("force", "f"),
    ),
    "ram_drag": PortKind("output", FORCE, REALS, (), only_mapped=True),  # taken from a thrust that is the gross one
    "spool_speed": PortKind(
        "output",
        ANGULAR_SPEED,
        REALS,
        (
            "spoolspeed", "rotorspeed", "shaftspeed", "rotationalspeed", "enginespeed", "nmech", "xn", "n1", "n2",
            "rpm",
        ),
        ("n", "speed", "omega", "w"),
    ),
    "exhaust_temperature": PortKind(
        "output",
        TEMPERATURE,
        REALS,
        ("exhausttemperature", "exhaustgastemperature", "exhausttemp", "egt"),
    ),
    "fuel_flow": PortKind(
        "output",
        MASS_FLOW,
        REALS,
        (
            "fuelflow", "fuelmassflow", "fuelflowrate", "fuelrate", "fuelconsumption", "wf", "wfuel", "mdotfuel",
            "mdotf", "mfuel", "ff",
        ),
    ),
    # in the frame of the jet, which tilts with it; a torque of an engine is most often that of its shaft
    "force_forward": PortKind("output", FORCE, REALS, (), only_mapped=True),
    "force_right": PortKind("output", FORCE, REALS, (), only_mapped=True),
    "torque": PortKind("output", MOMENT, REALS, (), only_mapped=True),
    "start": PortKind(
        "parameter",
        RATIO,
        REALS,
        ("throttlestart", "startthrottle", "initialthrottle", "throttleinitial", "throttleinit", "throttle0"),
    ),
}  # fmt: skip
