"""What a flight of a campaign costs beside its steps, and what a campaign costs beside its flights."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING

from benchmarks.measures.process import COMMAND, processor_seconds
from benchmarks.measures.speed import fly_through
from benchmarks.timing import Spread

if TYPE_CHECKING:
    from cosim.campaign.study.plan import Flight
    from cosim.campaign.study.study import Study

WARM = 3  # flights that are not timed: a worker's first ones fill what it remembers
FEW, MANY = 5, 25  # flights of the two campaigns of which a round takes the difference


@dataclass(frozen=True)
class FlightCost:
    """Processor time.

    ``by_steps``: of a whole flight of a campaign by that of its steps alone, which nobody looks at, round by round;
    ``fixed_s``: of a whole campaign with its page, however few flights it has.
    """

    by_steps: Spread
    fixed_s: Spread


def measure_flight_cost(
    study: Study, seconds: float, rounds: int, folder: Path, on_round: Callable[[], object]
) -> FlightCost:
    """Fly the first flights of ``study``, ``seconds`` long, and campaigns from the command line, one worker each."""
    from cosim.campaign.study.plan import flights
    from cosim.campaign.workers.flight_row import fly_one

    by_steps = []
    for number, flight in enumerate(flights(study)):
        whole = time.process_time()
        fly_one(study, flight)
        whole = time.process_time() - whole
        steps = _time_steps(study, flight)
        if number >= WARM:
            by_steps.append(whole / steps)
    fixed = []
    for number in range(rounds):
        few, many = [_time_campaign(count, seconds, folder / f"fixed-{number}") for count in (FEW, MANY)]
        fixed.append(few - FEW * (many - few) / (MANY - FEW))
        on_round()
    return FlightCost(Spread.of(by_steps), Spread.of(fixed))


def _time_steps(study: Study, flight: Flight) -> float:
    from cosim.campaign.study.plan import scenario_of
    from cosim.simulation.build import build

    with build(scenario_of(study, flight)) as simulation:
        begin = time.process_time()
        fly_through(simulation)
        return time.process_time() - begin


def _time_campaign(runs: int, seconds: float, out: Path) -> float:
    words = ("--vary", "vehicle.mass_kg*=0.95:1.05", "--set", f"duration_s={seconds!r}", "--runs", str(runs))
    spent = processor_seconds(COMMAND, "sweep", "roll-doublet", *words, "--workers", "1", "--out", str(out))
    rmtree(out)
    return spent
