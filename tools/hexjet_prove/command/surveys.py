"""hexjet faults and failsafes: what a vehicle survives, and how it comes down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.api import Progress
from cosim.base.errors import InputError
from cosim.commands import Command, show_result

if TYPE_CHECKING:
    from hexjet_prove.api.surveys import FailsafesResult


def fly_failsafes(
    *,
    aircraft: Sequence[str] = (),
    out: str | None = None,
    progress: Progress | None = None,
    **choices: Any,
) -> list[FailsafesResult]:
    """Let everything fail that the autopilot has an answer to, and tell how each flight ended.

    Flown after a take-off to every height and some hover, several times, and moving, with the speeds of touch-down and
    the thrust ten seconds after disarming.  Leaves a campaign with a case a flight; the same again goes on where it was
    stopped.

    Parameters
    ----------
    aircraft : sequence of str
        Name or folder, by default hexjet; several have a folder each in that which is written; all: those of the table.
    """
    from hexjet_prove.api.surveys import failsafes as fly_all
    from hexjet_prove.surveys.failsafes import TABLED
    from hexjet_prove.surveys.survey import load_subject

    names = tuple(dict.fromkeys(aircraft)) or ("hexjet",)
    if "all" in names:
        if len(names) > 1:
            raise InputError("aircraft all: leave out the others")
        names = TABLED
    for name in names:
        load_subject(name, choices.get("engine"))
    folders = [Path(out, Path(name).name) if out is not None and len(names) > 1 else out for name in names]
    flown = zip(names, folders, strict=True)
    return [fly_all(name, out=folder, progress=progress, **choices) for name, folder in flown]


def _flies_several(arguments: Mapping[str, Any]) -> bool:
    return "all" in arguments["aircraft"] or len(set(arguments["aircraft"])) > 1


def _show_all(results: Sequence[FailsafesResult], verbose: bool) -> None:
    for result in results:
        show_result(result, verbose)


faults = Command(
    "faults",
    "hexjet_prove.api.surveys:faults",
    "--kind flame-out --kind thrust",
    options={"aircraft": "--aircraft", "engine": "--engine", "kinds": "--kind"},
    metavars={"kinds": "NAME"},
)
failsafes = Command(
    "failsafes",
    "hexjet_prove.command.surveys:fly_failsafes",
    "--failsafe GNSS --height 10 --wind-speed 5",
    like="hexjet_prove.api.surveys:failsafes",
    options={"engine": "--engine", "kinds": "--failsafe", "heights": "--height", "winds": "--wind-speed --wind"},
    metavars={"kinds": "NAME", "heights": "M", "winds": "M/S", "moving": "M/S"},
    folder=lambda arguments: "failsafes" if _flies_several(arguments) else None,
    show=_show_all,
    data=lambda results: (
        results[0].to_dict() if len(results) == 1 else {"tables": [each.to_dict() for each in results]}
    ),
)
