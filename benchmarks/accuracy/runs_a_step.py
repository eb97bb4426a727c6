"""By how much the shipped flights differ from themselves with more JSBSim runs a step, vehicle by vehicle.

What is found goes into ``aircraft/substeps.toml``, by which a scenario's ``substeps = "0.1 deg"`` becomes a number.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.accuracy.exact import Array
from cosim import Scenario, fly
from cosim.base.frames import from_euler
from cosim.results.log.recorder import Log
from cosim.spec.scenario import scenario_names
from cosim.spec.vehicle import engine_of, load_vehicle

RUNS = (1, 2, 3, 4, 6, 8)
FINE = 16  # runs of the flight compared with
# Shipped vehicles without scenarios of their own, and changes to fly them.
_OTHERS: dict[str, dict[str, str]] = {
    "hexjet-100": {"engine": "turbine-100", "controller": "filtered-smith"},
    "quadrotor": {"engine": "motor", "controller": "baseline"},
    "crazyflie": {"controller": "baseline"},
}
_OTHER_FLIGHTS = ("hover", "hover-in-wind", "roll-doublet")
_FLIGHTS_WITHOUT_PLACE = ("hover", "roll-doublet")


class Difference(NamedTuple):
    """Greatest differences of a flight from one with more runs a step: angle between attitudes, and distance."""

    attitude_deg: float
    place_mm: float


class Flight(NamedTuple):
    """A flight's differences by its runs a step; ``touches``: it is on the ground at some time."""

    aircraft: str
    name: str
    engine: str
    controller: str
    touches: bool
    apart: dict[int, Difference]


def shipped_flights() -> Iterator[Scenario]:
    """Yield every shipped scenario without turbulence, and flights of the vehicles that have none.

    JSBSim draws its turbulence anew at every run: with another number of runs a flight meets other gusts, and cannot be
    compared.
    """
    for name in scenario_names():
        scenario = Scenario.load(name).replace(expect=[])
        if not scenario.environment.turbulence_severity:
            yield scenario
    for aircraft, changes in _OTHERS.items():
        vehicle, _ = load_vehicle(aircraft)
        flown: Any = {"engine": engine_of(aircraft), **changes}
        for name in _OTHER_FLIGHTS if vehicle.control.position else _FLIGHTS_WITHOUT_PLACE:
            yield Scenario.load(name).replace(aircraft=aircraft, **flown, expect=[])


def measure_flight(scenario: Scenario, runs: tuple[int, ...] = RUNS, fine: int = FINE) -> Flight:
    """Return a scenario's differences with each number of runs a step from ``fine`` runs."""
    reference = fly(scenario.replace(substeps=fine)).log
    apart = {each: compare(fly(scenario.replace(substeps=each)).log, reference) for each in runs}
    touches = bool(np.any(reference["on_ground"] > 0.0))
    return Flight(scenario.aircraft, scenario.name, Path(scenario.engine).name, scenario.controller, touches, apart)


def compare(one: Log, other: Log) -> Difference:
    """Return the greatest differences between two logs of a flight, to the end of the shorter."""
    rows = min(len(one), len(other))
    (turned, there), (reference, here) = _motion(one, rows), _motion(other, rows)
    along = np.abs(np.sum(turned * reference, axis=1))
    w, v, wr, vr = turned[:, :1], turned[:, 1:], reference[:, :1], reference[:, 1:]
    across = np.linalg.norm(w * vr - wr * v - np.cross(v, vr), axis=1)
    return Difference(
        float(np.degrees(2.0 * np.arctan2(across, along)).max()),
        1e3 * float(np.linalg.norm(there - here, axis=1).max()),
    )


def _motion(log: Log, rows: int) -> tuple[Array, Array]:
    """Return attitudes as quaternions, and positions [m], of a log's first rows."""
    angles = np.stack([log[f"{axis}_rad"][:rows] for axis in ("roll", "pitch", "yaw")], axis=1)
    places = np.stack([log[f"{axis}_m"][:rows] for axis in ("north", "east", "down")], axis=1)
    return np.array([from_euler(*map(float, row)) for row in angles]), places


def worst(flights: list[Flight]) -> dict[str, dict[int, Difference]]:
    """Return the greatest differences by vehicle and runs a step, which never rise with more runs."""
    answer: dict[str, dict[int, Difference]] = {}
    for aircraft in sorted({flight.aircraft for flight in flights}):
        own = [flight.apart for flight in flights if flight.aircraft == aircraft]
        answer[aircraft] = {
            runs: Difference(max(each[runs].attitude_deg for each in own), max(each[runs].place_mm for each in own))
            for runs in own[0]
        }
    return answer


def vehicle_rows(flights: list[Flight]) -> list[list[str]]:
    """Return a table row for each vehicle: its flights, and the greatest differences by runs a step."""
    return [
        [
            aircraft,
            str(sum(flight.aircraft == aircraft for flight in flights)),
            *(f"{each.attitude_deg:.2g} deg, {each.place_mm:.2g} mm" for each in by_runs.values()),
        ]
        for aircraft, by_runs in worst(flights).items()
    ]


def provenance(aircraft: str, flights: Sequence[Flight]) -> Iterator[str]:
    """Yield the comments of TOML on which flights of a vehicle were measured, and with what settings."""
    yield f"scenarios = {json.dumps([flight.name for flight in flights])}"
    if aircraft in _OTHERS:
        yield "settings = { " + ", ".join(f'{key} = "{value}"' for key, value in _OTHERS[aircraft].items()) + " }"
    yield f"engines = {json.dumps(sorted({flight.engine for flight in flights}))}"
    yield f"controllers = {json.dumps(sorted({flight.controller for flight in flights}))}"


def as_toml(flights: list[Flight]) -> str:
    """Return the text of ``aircraft/substeps.toml``."""
    lines = [
        "# Greatest differences of each vehicle's shipped flights, those without turbulence, from the same with",
        f"# {FINE} JSBSim runs in a control step: the angle between attitudes, and the distance. Measured and written",
        "# by python -m benchmarks.accuracy --only runs; docs/accuracy.md has every flight.",
    ]
    for aircraft, by_runs in worst(flights).items():
        own = [flight for flight in flights if flight.aircraft == aircraft]
        lines += [
            "",
            f"[{aircraft}]",
            f"flights = {len(own)}",
            *provenance(aircraft, own),
            f"runs = {list(by_runs)}",
            f"attitude_deg = [{', '.join(f'{each.attitude_deg:.2g}' for each in by_runs.values())}]",
            f"place_mm = [{', '.join(f'{each.place_mm:.2g}' for each in by_runs.values())}]",
        ]
    return "\n".join(lines) + "\n"
