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

# An instance is reserved by binding the port of its number above this one; chosen by us, as nothing else uses them.
FIRST_INSTANCE_PORT = 32_760
MAX_INSTANCES = 250  # largest instance number
VARIABLES = {"px4": "PX4_SITL", "ardupilot": "ARDUPILOT_SITL"}  # environment variables of the programs
PROGRAMS = {"px4": "px4", "ardupilot": "arducopter"}  # names of the programs on the path
# How each program is built, and the page of its makers that says so.
BUILDS = {
    "px4": "make px4_sitl, and have a package in their releases; docs.px4.io, Building PX4 Software",
    "ardupilot": "./waf configure --board sitl && ./waf copter; ardupilot.org/dev, Building the code",
}
AUTOPILOTS: dict[str, type[Autopilot]] = {  # by name
    each.name: each for each in (betaflight.Betaflight, px4.Px4, ardupilot.ArduPilot)
}
_FAULT_KINDS = ("sensor_dropout", "sensor_bias")  # kinds of fault of the tables below
# Faults that would not reach an autopilot that estimates its attitude, each with the reason.
_NO_ATTITUDE_FAULTS = {
    ("attitude", kind): "it estimates its attitude by itself; allowed: gyro, gnss, barometer" for kind in _FAULT_KINDS
}
_NO_GNSS_FAULTS = "Betaflight gets no position; allowed: gyro, attitude, and barometer, which its pilot has"
_NO_BAROMETER_DROPOUT = "its simulation's barometer would go on with the last height; allowed: gyro, gnss"
_UNREACHED_FAULTS: dict[str, dict[tuple[str, str], str]] = {  # reasons, by autopilot
    "betaflight": {("gnss", kind): _NO_GNSS_FAULTS for kind in _FAULT_KINDS},
    "px4": _NO_ATTITUDE_FAULTS,
    "ardupilot": _NO_ATTITUDE_FAULTS | {("barometer", "sensor_dropout"): _NO_BAROMETER_DROPOUT},
}


@contextmanager
def reserve_instance() -> Iterator[int]:
    """Reserve an autopilot's instance number from 1 to :data:`MAX_INSTANCES`; 0 is for ``hexjet sitl``.

    A bound port holds it, so that it is free again however the process ends.  Raises FlightError if all are taken.
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
    """Return an autopilot's program: ``binary``, that of the environment, the installed one, or that on the path.

    None if there is none: the autopilot is then started by hand, except Betaflight.  Raises InputError for a file that
    is no program.
    """
    if name == "betaflight":
        return betaflight.find_program(binary)
    found = find_configured_program(binary, VARIABLES[name])
    if found is None and (on_path := which(PROGRAMS[name])) is not None:
        found = Path(on_path).resolve()
    return found


def describe_missing(name: str) -> str:
    """Return a text on where a program was searched, and how to build it."""
    return f"binary, {VARIABLES[name]}, {PROGRAMS[name]} on the path; its makers build it by {BUILDS[name]}"


def require_program(name: str, binary: Path | None) -> Path:
    """Return an autopilot's program, see :func:`find_program`, which a study cannot do without.

    Raises InputError if there is none, and for one that the user does not trust.
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
    """Return an autopilot for the scenario's vehicle, not started; its files go into ``folder``/``name``.

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
    make = {"betaflight": _prepare_betaflight, "px4": _prepare_px4, "ardupilot": _prepare_ardupilot}[name]
    return make(scenario, folder / name, program, setup)


def check_faults(name: str, scenario: Scenario) -> None:
    """Raise InputError for sensor faults of a scenario that would not reach the autopilot."""
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


def _prepare_betaflight(scenario: Scenario, folder: Path, program: Path | None, setup: Setup) -> Autopilot:
    lines = [] if setup.gains == "stock" else betaflight.make_gain_settings(vehicle_in_throttle(scenario))
    setup = replace(setup, lines=[*lines, *setup.lines])
    return betaflight.Betaflight(program, folder, *_read_vehicle_and_place(scenario), setup)


def _prepare_px4(scenario: Scenario, folder: Path, program: Path | None, setup: Setup) -> Autopilot:
    parameters = list_px4_parameters(scenario, scenario.step_s)
    if setup.gains == "stock":
        parameters = without_px4_gains(parameters)
    optional = set(PX4_OF_SOME_RELEASES) - setup.parameters.keys()  # stated ones are required
    setup = replace(setup, parameters=parameters | dict(setup.parameters))
    return px4.Px4(program, folder, *_read_vehicle_and_place(scenario), setup, optional)


def _prepare_ardupilot(scenario: Scenario, folder: Path, program: Path | None, setup: Setup) -> Autopilot:
    vehicle, step, place = _read_vehicle_and_place(scenario)
    release, remark = ardupilot.read_release(program)
    parameters = _choose_ardupilot_parameters(scenario, program, setup, release)
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


def _choose_ardupilot_parameters(
    scenario: Scenario, program: Path | None, setup: Setup, release: ardupilot.Release
) -> dict[str, float]:
    """Return ArduPilot's parameters: those of a file, or of the vehicle; stated ones override them.

    An autopilot started by hand has parameters of its own, which are assumed to be the vehicle's if there are any.
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


def _read_vehicle_and_place(scenario: Scenario) -> tuple[Vehicle, float, Geodesy]:
    """Return the vehicle, the step [s] and the geodetic origin of a scenario."""
    vehicle, _ = scenario.resolved_vehicle()
    environment = scenario.environment
    place = Geodesy(environment.latitude_deg, environment.longitude_deg, environment.ground_m)
    return vehicle, scenario.step_s, place
