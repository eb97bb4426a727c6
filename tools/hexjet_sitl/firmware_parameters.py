"""A vehicle's parameters as text for one of the autopilots, its own loops, and the scale of its torques."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Literal

from cosim import FlightError, InputError, Scenario
from cosim.api.call import Limits, check_types
from cosim.api.call.choices import apply_choices, load_scenario
from cosim.base.signals import AXES, Vector3
from cosim.files import map_os_errors
from cosim.simulation.axis_chain import is_turned_by_throttle
from cosim.simulation.controllers.controller_file import apply_controller
from cosim.simulation.controllers.models import make_scenario_belief
from cosim.spec.vehicle import Vehicle
from hexjet_sitl.ardupilot import NEWEST_RELEASE, Release
from hexjet_sitl.betaflight import (
    MAX_GAIN,
    compute_gain_units,
    compute_torque_scale,
    make_base_settings,
    make_gain_settings,
    make_gyro_settings,
    make_mixer_settings,
)
from hexjet_sitl.parameters import (
    ARDUPILOT_TARGETS,
    PX4_TARGETS,
    ardupilot_parameters,
    ardupilot_script,
    ardupilot_torque_scale,
    parameter_file,
    px4_hover,
    px4_target,
    px4_torque_scale,
    refuse_effectiveness,
)
from hexjet_sitl.pilot import find_hover_throttle

if TYPE_CHECKING:
    from hexjet_design.loop.firmware import Firmware

# Parameter files of a design by autopilot and key: the target, and the suffix of the file's name.
DESIGN_FILES: dict[str, dict[str, tuple[str, str]]] = {
    "betaflight": {"board_parameters": ("board", ".board.txt"), "stand_parameters": ("sitl", ".stand.txt")},
    "px4": {"board_parameters": ("board", ".board.params"), "stand_parameters": ("sitl", ".stand.params")},
    "ardupilot": {"board_parameters": ("board", ".board.parm"), "stand_parameters": ("sitl", ".stand.parm")},
}
_STAND_TEXT = "For the stand, hexjet sitl {}, and for no board: {}."  # for a SITL
_BOARD_TEXT = (  # for a board
    "For a board that flies: {} stay as they are. {} makes its raw gyro as late as the vehicle's, with which the gains "
    "were designed; where it is not here the vehicle states no filter."
)
_RADIO_TEXT = "it has the radio's mapping and all flight modes"  # part of both
_TARGET_TEXTS = {  # by autopilot and target
    "betaflight": {
        "sitl": _STAND_TEXT.format("betaflight", "arming checks are off, switches are mapped"),
        "board": _BOARD_TEXT.format("mixer and gains; its receiver, switches and checks", "gyro_lpf1_static_hz"),
    },
    "px4": {
        "sitl": _STAND_TEXT.format("px4", _RADIO_TEXT),
        "hil": f"For a board in the loop, and for none that flies: {_RADIO_TEXT}.",
        "board": _BOARD_TEXT.format("its radio, modes and checks", "IMU_GYRO_CUTOFF"),
    },
    "ardupilot": {
        "sitl": _STAND_TEXT.format("ardupilot", "arming checks and gyro filter are off"),
        "board": _BOARD_TEXT.format("its radio, modes and arming checks", "INS_GYRO_FILTER"),
    },
}
# Comment lines of each target; ArduPilot reads lines of at most 98 characters.
TARGET_NOTES = {
    autopilot: {target: wrap(text, 96) for target, text in texts.items()} for autopilot, texts in _TARGET_TEXTS.items()
}


def vehicle_in_throttle(scenario: Scenario, around_hover: float = 0.03) -> Vehicle:
    """Return a scenario's vehicle with rate gains in throttle instead of thrust fraction.

    An autopilot's torque is throttle, and nothing bends it as our allocation does: what a throttle gives around hover
    is the slope of the engine's curve.  A straight curve leaves the vehicle as it is.  ``around_hover``: of thrust,
    either way, over which a throttle's slope is taken.
    """
    vehicle, belief = scenario.resolved_vehicle()[0], make_scenario_belief(scenario, {})
    if belief.thrust_map.identity:
        return vehicle
    jets, hover = len(vehicle.jets), belief.hover
    more, less = (belief.thrust_map.throttle((hover + way,) * jets) for way in (around_hover, -around_hover))
    slope = (sum(more) - sum(less)) / (2.0 * around_hover * jets)
    rate = vehicle.control.rate
    changed = {}
    for index, axis in enumerate(AXES):
        if is_turned_by_throttle(vehicle, index):
            gains = getattr(rate, axis)
            scaled = {name: slope * getattr(gains, name) for name in ("p", "i", "d", "integral_limit")}
            changed[axis] = gains.model_copy(update=scaled)
    control = vehicle.control.model_copy(update={"rate": rate.model_copy(update=changed)})
    return vehicle.model_copy(update={"control": control})


def list_px4_parameters(scenario: Scenario, step: float, target: str = "sitl") -> dict[str, float]:
    """Return PX4's parameters for a scenario's vehicle with its engines, flown in steps of ``step`` [s].

    ``target``: see :func:`hexjet_sitl.parameters.px4_target`.  Raises InputError for a vehicle that PX4
    has no parameters for.
    """
    parameters = px4_target(vehicle_in_throttle(scenario), step, target)
    return parameters | px4_hover(find_hover_throttle(make_scenario_belief(scenario, {})))


def format_firmware_parameters(
    autopilot: str, scenario: Scenario, step: float, target: str = "sitl", release: Release = NEWEST_RELEASE
) -> str:
    """Return a parameter file for a scenario's vehicle; for Betaflight it has lines for the console.

    ``target``: see :func:`hexjet_sitl.parameters.px4_target` and ``ardupilot_parameters``; ``release``: of
    ArduPilot, whose names and units they have.  Raises InputError for a vehicle that it has no parameters for.
    """
    vehicle = vehicle_in_throttle(scenario)
    if autopilot == "betaflight":
        lines = [
            *(f"# {note}" for note in TARGET_NOTES[autopilot][target]),
            *make_mixer_settings(vehicle, vehicle.control.allocation.throttle_min),
            *(make_gyro_settings(vehicle) if target == "board" else make_base_settings(vehicle)),
            *make_gain_settings(vehicle),
            "save",
        ]
        return "\n".join(lines) + "\n"
    notes = TARGET_NOTES[autopilot][target]
    if autopilot == "px4":
        return parameter_file(autopilot, list_px4_parameters(scenario, step, target), notes)
    names = "since ArduCopter 4.7" if release > (4, 6) else "until ArduCopter 4.6"
    parameters = ardupilot_parameters(vehicle, step, release, target)
    return parameter_file(autopilot, parameters, (*notes, f"Names and units are those {names}."))


def format_mixer_script(vehicle: Vehicle) -> str:
    """Return the Lua script that mixes the vehicle's outputs in ArduPilot.

    Raises InputError for a vehicle that is a frame of ArduCopter and needs none.
    """
    script = ardupilot_script(vehicle)
    if script is None:
        raise InputError(f"--script: {vehicle.name}: has no tilting banks; its frame needs no script")
    return script


def find_torque_scale(autopilot: str, vehicle: Vehicle) -> Vector3:
    """Return what one unit of the autopilot's torque output commands: throttle on roll, else tilt [rad] or throttle.

    Raises InputError for a vehicle that is flown by effectiveness.
    """
    refuse_effectiveness(autopilot, vehicle)
    if autopilot == "betaflight":
        return compute_torque_scale(vehicle)
    return px4_torque_scale(vehicle) if autopilot == "px4" else ardupilot_torque_scale(vehicle)


def find_loops(autopilot: str, aircraft: str, settings: Sequence[str]) -> Firmware:
    """Return an autopilot's loops, with gains in the aircraft's units.  Raises InputError if it cannot fly it."""
    from hexjet_design.loop.firmware import Firmware

    scenario = load_scenario("hover", None, (), None, tuple(settings), aircraft=aircraft)
    vehicle, _ = scenario.resolved_vehicle()
    format_firmware_parameters(autopilot, scenario, scenario.step_s)  # fails before minutes of search
    if autopilot == "betaflight":
        return Firmware(
            autopilot, units=compute_gain_units(vehicle), max_gain=MAX_GAIN, common_filter=True, common_angle=True
        )
    if autopilot == "px4":
        return Firmware(autopilot, common_filter=True)
    # ArduPilot sends the outputs of a scripted mixer in the next loop (AP_MotorsMatrix_6DoF_Scripting).
    return Firmware(autopilot, output_delay=0 if vehicle.servo is None else 1)


def write_parameters(autopilot: str, scenario: Scenario, controller: Path) -> dict[str, Path]:
    """Write an autopilot's parameter files beside a designed controller file, and return their paths.

    For ArduPilot the mixer of tilting banks, a script, is written beside them.  Raises FlightError.
    """
    flown = apply_controller(scenario, controller)
    vehicle, _ = flown.resolved_vehicle()
    files = DESIGN_FILES[autopilot]
    paths = {name: controller.with_suffix(suffix) for name, (_, suffix) in files.items()}
    with map_os_errors(FlightError, controller):
        for name, (target, _) in files.items():
            paths[name].write_text(format_firmware_parameters(autopilot, flown, flown.step_s, target))
        if autopilot == "ardupilot" and vehicle.servo is not None:
            controller.with_suffix(".lua").write_text(format_mixer_script(vehicle))
    return paths


@check_types(rate=Limits(50, 2000))
def list_parameters(
    autopilot: Literal["px4", "ardupilot", "betaflight"],
    *,
    aircraft: str | Path = "hexjet",
    gains: str | Path | None = None,
    rate: int = 250,
    target: Literal["sitl", "hil", "board"] = "sitl",
    release: Literal["4.6", "4.8"] = "4.8",
    script: bool = False,
) -> str:
    """Print the vehicle as an autopilot's parameters: geometry, mixing, gains, filters, sticks.

    What cannot be said in its parameters stands in the lines that begin with #.  For Betaflight they are lines for its
    console.

    Parameters
    ----------
    autopilot : str
        Whose they are.
    aircraft : str or Path
        A name, or the folder of your own.
    gains : str or Path or None
        A file of hexjet design, in place of the vehicle's own.
    rate : int
        Steps a second.
    target : str
        Its SITL, of PX4 a board in the loop, or a board that flies, which keeps its own radio, modes and checks.
    release : str
        ArduPilot's: by whose names; they are others since 4.7.
    script : bool
        ArduPilot's mixer of tilting banks, a Lua script, in the place of parameters.

    Returns
    -------
    str
        The file.

    Raises
    ------
    InputError
        For a vehicle that the autopilot has no parameters for.
    """
    targets = {"px4": PX4_TARGETS, "ardupilot": ARDUPILOT_TARGETS}.get(autopilot, ("sitl", "board"))
    if target not in targets:
        raise InputError(f"target {target}: allowed for {autopilot}: {', '.join(targets)}")
    if script and autopilot != "ardupilot":
        raise InputError(f"script: {autopilot} has none; allowed is ardupilot")
    scenario = apply_choices("hover", gains, aircraft)
    if script:
        return format_mixer_script(scenario.resolved_vehicle()[0])
    return format_firmware_parameters(autopilot, scenario, 1.0 / rate, target, (4, int(release[2:])))
