"""An autopilot's own loops for a design, and what came of it as its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.api.call.choices import load_scenario
from cosim.base.errors import FlightError
from cosim.base.storage.files import map_os_errors

if TYPE_CHECKING:
    from cosim.design.loop.firmware import Firmware
    from cosim.spec.scenario import Scenario


def firmware_for(autopilot: str, aircraft: str, settings: Sequence[str]) -> Firmware:
    """Return the loops in the units of the aircraft.  Raises InputError where the autopilot lacks parameters for it."""
    from cosim.autopilots.betaflight import MOST_GAIN, compute_gain_units
    from cosim.autopilots.firmware_parameters import check_vehicle
    from cosim.design.loop.firmware import Firmware

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
    return Firmware(autopilot, common_angle=True, output_delay=0 if vehicle.servo is None else 1)


def write_parameters(autopilot: str, scenario: Scenario, controller: Path) -> Path:
    """Write the parameter file beside the controller file that was designed for a scenario, and return its path.

    For ArduPilot the mixer of tilting banks, a script, is written beside it.  Raises FlightError.
    """
    from cosim.autopilots.firmware_parameters import format_firmware_parameters, format_mixer_script
    from cosim.simulation.controllers.controller_file import apply_controller

    flown = apply_controller(scenario, controller)
    vehicle, _ = flown.resolved_vehicle()
    path = controller.with_suffix(".txt" if autopilot == "betaflight" else ".params" if autopilot == "px4" else ".parm")
    with map_os_errors(FlightError, path):
        path.write_text(format_firmware_parameters(autopilot, flown, flown.step_s))
        if autopilot == "ardupilot" and vehicle.servo is not None:
            path.with_suffix(".lua").write_text(format_mixer_script(vehicle))
    return path
