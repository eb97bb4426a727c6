"""An autopilot's own loops for ``hexjet design --for``, and the parameter files beside such a design."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.api.call.choices import load_scenario
from cosim.autopilots.betaflight import MOST_GAIN, compute_gain_units
from cosim.autopilots.firmware_parameters import (
    DESIGN_FILES,
    check_vehicle,
    format_firmware_parameters,
    format_mixer_script,
)
from cosim.base.errors import FlightError
from cosim.base.storage.files import map_os_errors
from cosim.simulation.controllers.controller_file import apply_controller
from hexjet_design.loop.firmware import Firmware

if TYPE_CHECKING:
    from cosim.spec.scenario import Scenario


def find_loops(autopilot: str, aircraft: str, settings: Sequence[str]) -> Firmware:
    """Return the loops in the units of the aircraft.  Raises InputError where the autopilot lacks parameters for it."""
    scenario = load_scenario("hover", None, (), None, tuple(settings), aircraft=aircraft)
    vehicle, _ = scenario.resolved_vehicle()
    check_vehicle(autopilot, vehicle, scenario.step_s)  # before minutes of searching
    if autopilot == "betaflight":
        return Firmware(
            autopilot, units=compute_gain_units(vehicle), max_gain=MOST_GAIN, common_filter=True, common_angle=True
        )
    if autopilot == "px4":
        return Firmware(autopilot, common_filter=True)
    # what its mixer of tilting banks gives out is sent in the next loop (AP_MotorsMatrix_6DoF_Scripting)
    return Firmware(autopilot, output_delay=0 if vehicle.servo is None else 1)


def write_parameters(autopilot: str, scenario: Scenario, controller: Path) -> dict[str, Path]:
    """Write the parameter files beside the controller file that was designed for a scenario, and return their paths.

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
