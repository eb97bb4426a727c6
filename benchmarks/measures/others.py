"""What a recorded step costs in other flights than ``hover``: other controllers, engines, faults, and every vehicle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.measures.speed import SUBSTEPS, Flights, collect
from benchmarks.timing import Cost, Pair, Spread
from cosim import Scenario
from cosim.spec.vehicle import aircraft_names, engine_of

REFERENCE = "hexjet"

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
    "quadrotor, hover": ("hover", {"aircraft": "quadrotor", "engine": "motor", "controller": "baseline"}),
    "octojet, an engine out in wind": ("octojet-flame-out-in-wind", {}),
    "trijet, yaw doublet: two nozzles beside a lift fan": ("trijet-yaw-doublet", {}),
    "quadjet, yaw doublet: four jets on hinges of their own": ("quadjet-yaw-doublet", {}),
    "jetwing, transition: hinges, surfaces and a wing": ("jetwing-transition", {}),
}


@dataclass(frozen=True)
class Others:
    """What is not JSBSim of a recorded step, by flight and by JSBSim runs a step.

    The unit is a run of the Hex-Jet's airframe; what another airframe costs JSBSim more is counted as ours.
    ``vehicles``: a recorded step of each vehicle that is shipped by that of the Hex-Jet with as many JSBSim runs.
    """

    outside: dict[str, dict[int, Cost]]
    vehicles: dict[str, dict[int, Spread]]


def hover_of(aircraft: str) -> Scenario:
    """Return the hover of an aircraft with the engine that it is made for and no predictor, clear of the ground."""
    engine = engine_of(aircraft)
    assert engine is not None, aircraft
    return Scenario.load("hover").replace(
        aircraft=aircraft, engine=engine, controller="baseline", initial={"altitude_m": 20.0}
    )


def measure_others(seconds: float, rounds: int, folder: Path, on_round: Callable[[], object]) -> Others:
    """Fly each so long, recorded in full, between two timings of the unit."""
    loaded = {shown: Scenario.load(name).replace(**changes) for shown, (name, changes) in FLIGHTS.items()}
    loaded |= {aircraft: hover_of(aircraft) for aircraft in aircraft_names()}
    with Flights(250, folder) as flights:
        jobs = [
            flights.fly(scenario.replace(substeps=substeps, duration_s=seconds, expect=[])).recorded(shown)
            for shown, scenario in loaded.items()
            for substeps in SUBSTEPS
        ]
        pairs = collect(jobs, flights.units(), rounds, on_round)
    return Others(
        {shown: {runs: Cost.of(pairs[runs, shown], less=runs) for runs in SUBSTEPS} for shown in FLIGHTS},
        {
            aircraft: {runs: ratio(pairs[runs, aircraft], pairs[runs, REFERENCE]) for runs in SUBSTEPS}
            for aircraft in aircraft_names()
        },
    )


def ratio(pairs: Sequence[Pair], reference: Sequence[Pair]) -> Spread:
    """Return a step's units by those of the reference's, round by round."""
    return Spread.of(
        [
            (one.step.cpu / one.unit.cpu) / (other.step.cpu / other.unit.cpu)
            for one, other in zip(pairs, reference, strict=True)
        ]
    )
