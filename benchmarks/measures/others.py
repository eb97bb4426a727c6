"""What a recorded step costs in other flights than ``hover``: other controllers, engines, vehicles, and faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.measures.speed import SUBSTEPS, Flights, collect
from benchmarks.timing import Cost
from cosim import Scenario

# by what is shown: the shipped scenario, and what is changed of it
FLIGHTS: dict[str, tuple[str, dict[str, Any]]] = {
    "hover, no predictor": ("hover", {"controller": "baseline"}),
    "hover, filtered Smith predictor": ("hover", {"controller": "filtered-smith"}),
    "hover, state predictor with disturbance": ("hover", {"controller": "state-disturbance"}),
    "hover, true turbojets": ("hover", {"engine": "turbojet", "controller": "baseline"}),
    "hover, physical turbines with spinning rotors": (
        "hover",
        {"aircraft": "hexjet-100", "engine": "turbine-100", "controller": "filtered-smith"},
    ),
    "gust": ("gust", {}),
    "full scale in a gust: P220, spinning rotors, fuel, intakes": ("full-scale-gust", {}),
    "flame-out: engine monitor, allocation planned anew": ("fault-flame-out", {}),
}


@dataclass(frozen=True)
class Others:
    """What is not JSBSim of a recorded step, by flight and by JSBSim runs a step.

    The unit is a run of the Hex-Jet's airframe; what another airframe costs JSBSim more is counted as ours.
    """

    outside: dict[str, dict[int, Cost]]


def measure_others(seconds: float, rounds: int, folder: Path, on_round: Callable[[], object]) -> Others:
    """Fly each so long, recorded in full, between two timings of the unit."""
    with Flights(250, folder) as flights:
        jobs = [
            flights.fly(
                Scenario.load(name).replace(**changes, substeps=substeps, duration_s=seconds, expect=[])
            ).recorded(shown)
            for shown, (name, changes) in FLIGHTS.items()
            for substeps in SUBSTEPS
        ]
        pairs = collect(jobs, flights.units(), rounds, on_round)
    return Others({shown: {runs: Cost.of(pairs[runs, shown], less=runs) for runs in SUBSTEPS} for shown in FLIGHTS})
