"""An autopilot for a flight from its name and its set-up, for ``hexjet sitl`` and campaigns alike."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from shutil import which
from typing import Any

from cosim import FlightError, InputError, Scenario
from cosim.base.geodesy import Geodesy
from cosim.base.signals import Vector3
from cosim.base.trust import Code, need_trust
from cosim.simulation.controllers.models import make_scenario_belief
from cosim.spec.controller_name import is_design
from hexjet_sitl import ardupilot, betaflight, px4
from hexjet_sitl.block import AutopilotBlock
from hexjet_sitl.firmware_parameters import list_px4_parameters, vehicle_in_throttle
from hexjet_sitl.lockstep import LOCAL, Autopilot, StartTiming, check_words, find_configured_program
from hexjet_sitl.parameters import (
    PX4_OF_SOME_RELEASES,
    ardupilot_hold,
    ardupilot_parameters,
    ardupilot_script,
    ardupilot_sticks,
    leave_ardupilot_gains,
    leave_px4_gains,
    parameter_file,
    read_parameters,
)
from hexjet_sitl.pilot import find_hover_throttle
from hexjet_sitl.run import AutopilotRun, fly_autopilot

INSTANCE_PORTS = 32_760  # the first of the ports that stand for a number; chosen by us, nobody's
MOST_INSTANCES = 250  # numbers: as many instances as hexjet sitl takes
VARIABLES = {"px4": "PX4_SITL", "ardupilot": "ARDUPILOT_SITL"}  # of the environment: a program that nobody states
PROGRAMS = {"px4": "px4", "ardupilot": "arducopter"}  # names by which they are looked for on the path
BUILDS = {  # how their makers build them, and where they say so
    "px4": "make px4_sitl, and have a package in their releases; docs.px4.io, Building PX4 Software",
    "ardupilot": "./waf configure --board sitl && ./waf copter; ardupilot.org/dev, Building the code",
}
# Faults of sensors that do not reach an autopilot as what they are, and why.
_OWN_ATTITUDE = "it estimates its attitude by itself; allowed: gyro, gnss, barometer"
_NO_POSITION = "Betaflight is told no position; allowed: gyro, attitude, and barometer, which its pilot has"
_UNTOLD: dict[str, dict[tuple[str, str], str]] = {
    "betaflight": dict.fromkeys([("gnss", "sensor_dropout"), ("gnss", "sensor_bias")], _NO_POSITION),
    "px4": dict.fromkeys([("attitude", "sensor_dropout"), ("attitude", "sensor_bias")], _OWN_ATTITUDE),
    "ardupilot": {
        ("attitude", "sensor_dropout"): _OWN_ATTITUDE,
        ("attitude", "sensor_bias"): _OWN_ATTITUDE,
        (
            "barometer",
            "sensor_dropout",
        ): "its simulation's barometer would go on with the last height; allowed: gyro, gnss",
    },
}
PORT_SPACING = 20  # ports of Betaflight from one instance to the next: fourteen are one's


@dataclass(frozen=True)
class Setup:
    """Options of an autopilot, as those of ``hexjet sitl`` and a study's table [autopilot] state them.

    Of what belongs to one autopilot the others see nothing.
    """

    instance: int = 0  # number of the instance, where several run at the same time
    limit_s: float = 5.0  # wall-clock time limit of an answer
    port: int | None = None  # Betaflight: its first port; None: that of the instance
    gains: str = "vehicle"  # whose are in the scenario's vehicle: its own, or a file's; "stock": as it ships
    lines: Sequence[str] = ()  # Betaflight: lines for its console
    parameters: Mapping[str, float] = field(default_factory=dict)  # PX4, ArduPilot: over those made from the vehicle
    magnetic_field: Vector3 | None = None  # PX4: gauss, NED; None: the Earth's at the place
    hold_from_s: float | None = None  # PX4, ArduPilot: of the flight; from then on it holds place and height
    hands_off: bool = False  # PX4, ArduPilot: a ground station arms and flies it
    defaults: Path | None = None  # ArduPilot: its parameters; None: those made from the vehicle
    channels: Sequence[str] = ()  # ArduPilot: NUMBER=PULSE or NUMBER=PULSE@SECONDS, beside the sticks
    station: int | None = None  # ArduPilot: the UDP port of this machine to which it talks MAVLink

    def __post_init__(self) -> None:
        check_words(self.parameters, self.lines)


@dataclass(frozen=True)
class PreparedAutopilot:
    """An autopilot that is not started yet, its program, and its details for a run's lockstep.json."""

    name: str
    autopilot: Autopilot
    program: Path | None  # None: started by hand
    endpoint: str  # address that a program started by hand connects to
    details: Mapping[str, Any]
    hold_from_s: float = inf  # of the flight
    remark: str = ""  # on a program of a version that was not flown
    hands_off: bool = False

    def fly(
        self, scenario: Scenario, folder: Path, page: bool = True, realtime_factor: float | None = None
    ) -> AutopilotRun:
        """Fly a scenario, see :func:`hexjet_sitl.run.fly_autopilot`."""
        return fly_autopilot(
            scenario,
            AutopilotBlock(self.autopilot, self.name, start_timing(self.name), self.hold_from_s, self.hands_off),
            folder,
            files=[] if self.program is None else [self.program],
            details=dict(self.details),
            realtime_factor=realtime_factor,
            page=page,
        )


def start_timing(name: str) -> StartTiming:
    """Return an autopilot's timing before its flight."""
    timings = {"betaflight": betaflight.HANDLING, "px4": px4.HANDLING, "ardupilot": ardupilot.HANDLING}
    return timings[name]


@contextmanager
def reserve_instance() -> Iterator[int]:
    """Reserve an instance number from 1 to :data:`MOST_INSTANCES` for this process; 0 is left to ``hexjet sitl``.

    It is held by a bound port, so that it is free again whatever becomes of the process.  Raises FlightError where all
    are taken.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reserved:
        for number in range(1, MOST_INSTANCES + 1):
            try:
                reserved.bind((LOCAL, INSTANCE_PORTS + number))
            except OSError:
                continue
            yield number
            return
    raise FlightError(f"{MOST_INSTANCES} autopilots fly on this machine already")


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
    """Return where a program was looked for, and how its makers build it."""
    return f"--binary, {VARIABLES[name]}, {PROGRAMS[name]} on the path; its makers build it by {BUILDS[name]}"


def require_program(name: str, binary: Path | None) -> Path:
    """Return the program as :func:`find_program`, where nobody can start one by hand and a study states it.

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


def prepare(name: str, scenario: Scenario, folder: Path, program: Path | None, setup: Setup) -> PreparedAutopilot:
    """Prepare an autopilot for the scenario's vehicle; its files go into a folder of its name in the run's ``folder``.

    ``program``: see :func:`find_program`.  Raises InputError.
    """
    if is_design(scenario.controller):
        raise InputError(
            f"controller = {scenario.controller}: {name} flies in the place of the controller; the gains of a design "
            f"go into it by --gains {scenario.controller}"
        )
    check_faults(name, scenario)
    if setup.hands_off and not scenario.initial.on_ground:
        raise InputError(
            f"--hands-off: scenario {scenario.name} begins in the air; a ground station takes a vehicle that stands: "
            "allowed is initial.on_ground = true, such as climb-and-land"
        )
    make = {"betaflight": _betaflight, "px4": _px4, "ardupilot": _ardupilot}[name]
    return replace(make(scenario, folder / name, program, setup), hands_off=setup.hands_off)


def check_faults(name: str, scenario: Scenario) -> None:
    """Raise InputError for the fault of a sensor that would not reach the autopilot as what it is."""
    for index, fault in enumerate(scenario.fault):
        if fault.kind not in ("sensor_bias", "sensor_dropout"):
            continue
        if untold := _UNTOLD[name].get((fault.sensor, fault.kind)):
            raise InputError(f"{name}: fault.{index}: {fault.kind} of {fault.sensor}: {untold}")
        if name == "ardupilot" and fault.kind == "sensor_bias" and fault.sensor == "gnss" and fault.bias[2]:
            raise InputError(
                f"{name}: fault.{index}.bias: its simulation has one height, the barometer's; allowed for gnss: a bias "
                "to north and east, velocity_bias"
            )


def _betaflight(scenario: Scenario, folder: Path, program: Path | None, setup: Setup) -> PreparedAutopilot:
    assert program is not None
    vehicle, _ = scenario.resolved_vehicle()
    lines = [
        *([] if setup.gains == "stock" else betaflight.make_gain_settings(vehicle_in_throttle(scenario))),
        *setup.lines,
    ]
    port = betaflight.PORT + PORT_SPACING * setup.instance if setup.port is None else setup.port
    ground = scenario.environment.ground_m
    autopilot = betaflight.Betaflight(program, folder, vehicle, scenario.step_s, lines, port, setup.limit_s, ground)
    details = {"gains": setup.gains, "console": autopilot.settings}
    return PreparedAutopilot("betaflight", autopilot, program, f"UDP port {port}", details)


def _px4(scenario: Scenario, folder: Path, program: Path | None, setup: Setup) -> PreparedAutopilot:
    vehicle, _ = scenario.resolved_vehicle()
    parameters = list_px4_parameters(scenario, scenario.step_s)
    if setup.gains == "stock":
        parameters = leave_px4_gains(parameters)
    parameters |= setup.parameters
    optional = set(PX4_OF_SOME_RELEASES) - setup.parameters.keys()  # who states one wants it
    launch = px4.LaunchOptions(setup.instance, setup.limit_s, parameters, setup.magnetic_field, optional)
    autopilot = px4.Px4(program, folder, vehicle, scenario.step_s, _geodesy(scenario), launch)
    endpoint = f"TCP port {px4.PORT + setup.instance}"
    details = {"gains": setup.gains, "hold_from_s": setup.hold_from_s, "parameters": parameters}
    hold_from = inf if setup.hold_from_s is None else setup.hold_from_s
    return PreparedAutopilot("px4", autopilot, program, endpoint, details, hold_from)


def _ardupilot(scenario: Scenario, folder: Path, program: Path | None, setup: Setup) -> PreparedAutopilot:
    vehicle, _ = scenario.resolved_vehicle()
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
    launch = ardupilot.LaunchOptions(
        setup.instance,
        setup.limit_s,
        parameters,
        defaults,
        [ardupilot.parse_channel(text, "--channel") for text in setup.channels],
        setup.station,
    )
    autopilot = ardupilot.ArduPilot(program, folder, vehicle, scenario.step_s, _geodesy(scenario), launch)
    endpoint = f"UDP port {ardupilot.PORT + ardupilot.PORT_SPACING * setup.instance}"
    details = {
        "gains": setup.gains,
        "hold_from_s": setup.hold_from_s,
        "defaults": str(setup.defaults or defaults),
        "parameters": parameters,
        "channels": list(setup.channels),
    }
    hold_from = inf if setup.hold_from_s is None else setup.hold_from_s
    return PreparedAutopilot("ardupilot", autopilot, program, endpoint, details, hold_from, remark)


def _ardupilot_parameters(
    scenario: Scenario, program: Path | None, setup: Setup, release: ardupilot.Release
) -> dict[str, float]:
    """Return what an ArduPilot flies with: the file stated over its sticks, or the vehicle's; over both what is stated.

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
        parameters = leave_ardupilot_gains(parameters) if setup.gains == "stock" else parameters
        return parameters | hold | dict(setup.parameters)
    except InputError:
        if program is not None:
            raise
        return ardupilot_sticks(release) | dict(setup.parameters)


def _geodesy(scenario: Scenario) -> Geodesy:
    environment = scenario.environment
    return Geodesy(environment.latitude_deg, environment.longitude_deg, environment.ground_m)
