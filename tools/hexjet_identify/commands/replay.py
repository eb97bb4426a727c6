"""hexjet replay: a recorded flight flown again, or a model alone with its commands."""

from __future__ import annotations

from typing import Any

from cosim.api.call import Limits, check_types
from cosim.commands import Command, one_thread
from hexjet_identify.api.replay import ReplayResult
from hexjet_identify.api.replay import replay as fly_again
from hexjet_identify.commands import LOG_METAVARS, LOG_OPTIONS


@check_types(inertia_tolerance=Limits(0.0, 50.0), mass_tolerance=Limits(0.0, 50.0), thrust_tolerance=Limits(0.0, 50.0))
def replay_within_percent(
    log: str,
    *,
    inertia_tolerance: float = 5.0,
    mass_tolerance: float = 2.0,
    thrust_tolerance: float = 3.0,
    **choices: Any,
) -> ReplayResult:
    """Fly a recorded flight again, in six degrees of freedom, and judge the model by it.

    The recorded commands drive the vehicle in short windows, each started from the recorded state; the vehicle is drawn
    within its tolerances.  Says what the model explains, and names what is wrong with it where the log tells: an
    inertia, a delay, swapped engines.  Leaves a page, replay.json and replay.csv.

    Parameters
    ----------
    inertia_tolerance : float
        Standard deviation of each moment of inertia [%].
    mass_tolerance : float
        Standard deviation of the mass [%].
    thrust_tolerance : float
        Standard deviation of the thrust [%] of an engine that states no uncertainty.
    """
    return fly_again(
        log,
        inertia_tolerance=0.01 * inertia_tolerance,
        mass_tolerance=0.01 * mass_tolerance,
        thrust_tolerance=0.01 * thrust_tolerance,
        **choices,
    )


replay = Command(
    "replay",
    "hexjet_identify.commands.replay:replay_within_percent",
    "flight.ulg --aircraft ./mine --engine bench/engine.toml",
    like="hexjet_identify.api.replay:replay",
    modes={"model": "hexjet_identify.api.logs:validate"},
    options={"scenario": "--scenario", **LOG_OPTIONS},
    metavars={"engine": "[N=]NAME|FILE", "model": "MODEL", "throttle": "N=SUM", "throttle_range": "LOW HIGH",
              "inertia_tolerance": "%", "mass_tolerance": "%", "thrust_tolerance": "%", **LOG_METAVARS},
    folder=lambda arguments: "validation" if arguments.get("model") else "replay",
    before=lambda arguments: one_thread(),
    succeeded=lambda result: result.explained,
    ends="With --model, a model of an axis or an engine alone is fed the commands of the log.  Status 0: explained; "
    "1: not, or not told.",
)  # fmt: skip
