"""An autopilot for a flight from its name and its set-up, for ``hexjet sitl`` and campaigns alike."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from shutil import which

from cosim import FlightError, InputError, Scenario
from cosim.base.geodesy import Geodesy
from cosim.base.trust import Code, need_trust
from cosim.simulation.controllers.models import make_scenario_belief
from cosim.spec.controller_name import is_design
from cosim.spec.vehicle import Vehicle
from hexjet_sitl import ardupilot, betaflight, px4
from hexjet_sitl.firmware_parameters import list_px4_parameters, vehicle_in_throttle
from hexjet_sitl.lockstep import LOCAL, Autopilot, Setup, find_configured_program
from hexjet_sitl.parameters import (
    PX4_OF_SOME_RELEASES,
    ardupilot_hold,
    ardupilot_parameters,
    ardupilot_script,
    ardupilot_sticks,
    parameter_file,
    read_parameters,
    without_ardupilot_gains,
    without_px4_gains,
)
from hexjet_sitl.pilot import find_hover_throttle

# Ports above it represent instance numbers; chosen by us: nothing else uses them.
FIRST_INSTANCE_PORT = 32_760
MAX_INSTANCES = 250  # limit of hexjet sitl
VARIABLES = {"px4": "PX4_SITL", "ardupilot": "ARDUPILOT_SITL"}  # variables with the path of a program
PROGRAMS = {"px4": "px4", "ardupilot": "arducopter"}  # names on the path
# How their makers build them, and where they say so.
BUILDS = {
    "px4": "make px4_sitl, and have a package in their releases; docs.px4.io, Building PX4 Software",
    "ardupilot": "./waf configure --board sitl && ./waf copter; ardupilot.org/dev, Building the code",
}
AUTOPILOTS: dict[str, type[Autopilot]] = {  # class of each autopilot
    each.name: each for each in (betaflight.Betaflight, px4.Px4, ardupilot.ArduPilot)
}
# Faults of sensors that an autopilot would not get as such, and why.
_BOTH = ("sensor_dropout", "sensor_bias")
_ATTITUDE = {  # reason for autopilots that estimate it
    ("attitude", kind): "it estimates its attitude by itself; allowed: gyro, gnss, barometer" for kind in _BOTH
}
_NO_POSITION = "Betaflight gets no position; allowed: gyro, attitude, and barometer, which its pilot has"
_HEIGHT = "its simulation's barometer would go on with the last height; allowed: gyro, gnss"  # reason of a refusal
_UNREACHED_FAULTS: dict[str, dict[tuple[str, str], str]] = {  # reason by autopilot, sensor and fault
    "betaflight": {("gnss", kind): _NO_POSITION for kind in _BOTH},
    "px4": _ATTITUDE,
    "ardupilot": _ATTITUDE | {("barometer", "sensor_dropout"): _HEIGHT},
}


@contextmanager
def reserve_instance() -> Iterator[int]:
    """Reserve an instance number from 1 to :data:`MAX_INSTANCES`; 0 is for ``hexjet sitl``.

    It is held by a bound port, so that it is free again whatever becomes of the process.  Raises FlightError where all
    are taken.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reserved:
        for number in range(1, MAX_INSTANCES + 1):
            try:
                reserved.bind((LOCAL, FIRST_INSTANCE_PORT + number))
            except OSError:
                continue
            yield number
            return
    raise FlightError(f"{MAX_INSTANCES} autopilots fly on this machine already")


def find_program(name: str, binary: Path | None) -> Path | None:
    """Return the program that is given, that the environment names, or that is installed or on the path.

    None: there is none, and the autopilot is started by hand; Betaflight never is.  Raises InputError for what is no
    program.
    """
    if name == "betaflight":
        return betaflight.find_program(binary)
    found = find_configured_program(binary, VARIABLES[name])
    if found is None and (on_path := which(PROGRAMS[name])) is not None:
        found = Path(on_path).resolve()
    return found


def describe_missing(name: str) -> str:
    """Return where a program was searched, and how to build it."""
    return f"binary, {VARIABLES[name]}, {PROGRAMS[name]} on the path; its makers build it by {BUILDS[name]}"


def require_program(name: str, binary: Path | None) -> Path:
    """Return the program as :func:`find_program`, required for studies.

    Raises InputError for none, and for one that the user does not trust.
    """
    program = find_program(name, binary)
    if binary is not None:
        need_trust([Code(binary)], name)
    if program is None:
        raise InputError(
            f"{name}: no program is named; allowed: binary in the table [autopilot], {VARIABLES[name]}, or "
            f"{PROGRAMS[name]} on the path"
        )
    return program


def prepare(name: str, scenario: Scenario, folder: Path, program: Path | None, setup: Setup) -> Autopilot:
    """Return an autopilot for the scenario's vehicle; its files go into a folder of its name in the run's ``folder``.

    ``program``: see :func:`find_program`.  Raises InputError.
    """
    if is_design(scenario.controller):
        raise InputError(
            f"controller = {scenario.controller}: {name} flies in the place of the controller; the gains of a design "
            f"go into it as gains {scenario.controller}"
        )
    check_faults(name, scenario)
    if setup.hands_off and not scenario.initial.on_ground:
        raise InputError(
            f"hands_off: scenario {scenario.name} begins in the air; a ground station takes a vehicle that stands: "
            "allowed is initial.on_ground = true, such as climb-and-land"
        )
    make = {"betaflight": _betaflight, "px4": _px4, "ardupilot": _ardupilot}[name]
    return make(scenario, folder / name, program, setup)


def check_faults(name: str, scenario: Scenario) -> None:
    """Raise InputError for sensor faults that would not reach the autopilot as such."""
    for index, fault in enumerate(scenario.fault):
        if fault.kind not in ("sensor_bias", "sensor_dropout"):
            continue
        if untold := _UNREACHED_FAULTS[name].get((fault.sensor, fault.kind)):
            raise InputError(f"{name}: fault.{index}: {fault.kind} of {fault.sensor}: {untold}")
        if name == "ardupilot" and fault.kind == "sensor_bias" and fault.sensor == "gnss" and fault.bias[2]:
            raise InputError(
                f"{name}: fault.{index}.bias: its simulation has one height, the barometer's; allowed for gnss: a bias "
                "to north and east, velocity_bias"
            )


def _betaflight(scenario: Scenario, folder: Path, program: Path | None, setup: Setup) -> Autopilot:
    lines = [] if setup.gains == "stock" else betaflight.make_gain_settings(vehicle_in_throttle(scenario))
    setup = replace(setup, lines=[*lines, *setup.lines])
    return betaflight.Betaflight(program, folder, *_surroundings(scenario), setup)


def _px4(scenario: Scenario, folder: Path, program: Path | None, setup: Setup) -> Autopilot:
    parameters = list_px4_parameters(scenario, scenario.step_s)
    if setup.gains == "stock":
        parameters = without_px4_gains(parameters)
    optional = set(PX4_OF_SOME_RELEASES) - setup.parameters.keys()  # required if the user states one
    setup = replace(setup, parameters=parameters | dict(setup.parameters))
    return px4.Px4(program, folder, *_surroundings(scenario), setup, optional)


def _ardupilot(scenario: Scenario, folder: Path, program: Path | None, setup: Setup) -> Autopilot:
    vehicle, step, place = _surroundings(scenario)
    release, remark = ardupilot.read_release(program)
    parameters = _ardupilot_parameters(scenario, program, setup, release)
    defaults = None
    if program is not None:
        defaults = folder / "hexjet.parm"
        folder.mkdir(parents=True, exist_ok=True)
        defaults.write_text(parameter_file("ardupilot", parameters))
        if setup.defaults is None and (script := ardupilot_script(vehicle)) is not None:
            (folder / "scripts").mkdir(exist_ok=True)
            (folder / "scripts" / "hexjet.lua").write_text(script)
    started = replace(setup, parameters=parameters, defaults=defaults)
    autopilot = ardupilot.ArduPilot(program, folder, vehicle, step, place, started)
    autopilot.details["defaults"] = str(setup.defaults or defaults)
    autopilot.remark = remark
    return autopilot


def _ardupilot_parameters(
    scenario: Scenario, program: Path | None, setup: Setup, release: ardupilot.Release
) -> dict[str, float]:
    """Return ArduPilot's parameters: a file over its sticks, or the vehicle's; stated ones on top.

    One that is started by hand has its own; the vehicle's are taken for them where there are any.
    """
    hold: dict[str, float] = {}
    vehicle, _ = scenario.resolved_vehicle()
    if setup.hold_from_s is not None or setup.hands_off:
        throttle = find_hover_throttle(make_scenario_belief(scenario, {}))
        hold = ardupilot_hold(throttle, vehicle.control.allocation.throttle_min)
    if setup.defaults is not None:
        return ardupilot_sticks(release) | hold | read_parameters(setup.defaults) | dict(setup.parameters)
    try:
        parameters = ardupilot_parameters(vehicle_in_throttle(scenario), scenario.step_s, release)
        parameters = without_ardupilot_gains(parameters) if setup.gains == "stock" else parameters
        return parameters | hold | dict(setup.parameters)
    except InputError:
        if program is not None:
            raise
        return ardupilot_sticks(release) | dict(setup.parameters)


def _surroundings(scenario: Scenario) -> tuple[Vehicle, float, Geodesy]:
    """Return the vehicle, the step [s] and the place of a scenario."""
    vehicle, _ = scenario.resolved_vehicle()
    environment = scenario.environment
    place = Geodesy(environment.latitude_deg, environment.longitude_deg, environment.ground_m)
    return vehicle, scenario.step_s, place
