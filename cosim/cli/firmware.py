"""Gains for an autopilot's own loops, searched where ``hexjet sitl`` needs them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cosim.base.errors import InputError

if TYPE_CHECKING:
    from cosim.spec.scenario import Scenario

Autopilot = Literal["betaflight", "px4", "ardupilot"]


def search_gains(autopilot: Autopilot, scenario: Scenario, settings: Sequence[str], out: Path, quiet: bool) -> Path:
    """Search gains for an autopilot's own loops with a scenario's aircraft and engine; return the controller file.

    As ``hexjet design --for`` does, with its defaults; the file is ``out``, its page beside it.  Raises InputError
    where no gains keep the requirements.
    """
    from cosim import design
    from cosim.cli.console import CommandProgress, part_progress

    with part_progress(f"gains for {autopilot}", quiet=quiet) as show:
        progress = CommandProgress(show)
        made = design(scenario.engine, scenario.aircraft, autopilot=autopilot, settings=settings, progress=progress)
    paths = made.write(out).files
    if not made.ok:
        raise InputError(
            f"{autopilot}: no gains of its own loops keep the requirements of a design for {scenario.aircraft} with "
            f"engine {scenario.engine}, see {paths['report']}; allowed: --gains vehicle, stock, or a file"
        )
    return paths["controller"]
