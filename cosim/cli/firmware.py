"""``hexjet design --for``: an autopilot's loops for a design, and what came of it as its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.base.errors import FlightError, InputError
from cosim.base.storage.files import map_os_errors
from cosim.cli.options import load_scenario

if TYPE_CHECKING:
    from cosim.design.loop.firmware import Firmware
    from cosim.spec.scenario import Scenario


def firmware_for(autopilot: str, aircraft: str, settings: Sequence[str]) -> Firmware:
    """Return the loops in the units of the aircraft.  Raises InputError where the autopilot lacks parameters for it."""
    from cosim.autopilots.betaflight import MOST_GAIN, compute_gain_units
    from cosim.autopilots.firmware_parameters import format_firmware_parameters
    from cosim.design.loop.firmware import Firmware

    scenario = load_scenario("hover", None, (), None, tuple(settings), None, aircraft)
    vehicle, _ = scenario.resolved_vehicle()
    format_firmware_parameters(autopilot, vehicle, scenario.step_s)  # before minutes of searching
    if autopilot == "betaflight":
        return Firmware(
            autopilot, units=compute_gain_units(vehicle), max_gain=MOST_GAIN, common_filter=True, common_angle=True
        )
    return Firmware(autopilot, common_filter=autopilot == "px4", common_angle=autopilot == "ardupilot")


def search_gains(autopilot: str, scenario: Scenario, settings: Sequence[str], out: Path, quiet: bool) -> Path:
    """Search gains for an autopilot's own loops with a scenario's aircraft and engine; return the controller file.

    As ``hexjet design --for`` does, with its defaults; the file is ``out``, its page beside it.  Raises InputError
    where no gains keep the requirements.
    """
    from cosim.cli.console import part_progress
    from cosim.control.predictors.registry import BASELINE
    from cosim.design.design import design
    from cosim.design.result import write

    firmware = firmware_for(autopilot, scenario.aircraft, settings)
    with part_progress(f"gains for {autopilot}", quiet=quiet) as tell:
        designed = design(
            scenario.engine,
            scenario.aircraft,
            controller=BASELINE.name,
            settings=settings,
            lead=False,
            scheduled=False,
            firmware=firmware,
            say=lambda text: tell(text, 0, 1),
        )
    paths = write(designed, out)
    if not designed.ok:
        raise InputError(
            f"{autopilot}: no gains of its own loops keep the requirements of a design for {scenario.aircraft} with "
            f"engine {scenario.engine}, see {paths['report']}; allowed: --gains vehicle, stock, or a file"
        )
    return paths["controller"]


def write_parameters(autopilot: str, aircraft: str, controller: Path, step: float) -> Path:
    """Write the parameter file beside the controller file and return its path.

    For ArduPilot the mixer of tilting banks, a script, is written beside it.  Raises FlightError.
    """
    from cosim.autopilots.firmware_parameters import format_firmware_parameters, format_mixer_script

    vehicle, _ = load_scenario("hover", str(controller), (), None, (), None, aircraft).resolved_vehicle()
    path = controller.with_suffix(".txt" if autopilot == "betaflight" else ".params" if autopilot == "px4" else ".parm")
    with map_os_errors(FlightError, path):
        path.write_text(format_firmware_parameters(autopilot, vehicle, step))
        if autopilot == "ardupilot" and vehicle.servo is not None:
            path.with_suffix(".lua").write_text(format_mixer_script(vehicle))
    return path
