"""Gains for an autopilot's own loops, searched where ``hexjet sitl`` needs them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.api.firmware import firmware_for
from cosim.base.errors import InputError

if TYPE_CHECKING:
    from cosim.spec.scenario import Scenario


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
