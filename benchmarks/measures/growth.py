"""How the cost of a step grows: with the time that is flown, the number of engines, the rows that are recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.measures.process import Memory, measure_memory
from benchmarks.measures.speed import UNIT_RUNS, Flights, bare, collect, hover, step_bank
from benchmarks.timing import Cost, Job, Spread
from cosim import Scenario
from cosim.engine import EngineBank, load_engine
from cosim.simulation.build import build

SUBSTEPS = 4  # as the shipped scenarios have it
ENGINE = "edf-as-flown"
COUNTS = (1, 2, 4, 6, 8, 12, 16)  # engines in a bank, to as many as a vehicle may have
EVERY = (1, 2, 5, 25)  # steps a recorded row
BANK_STEPS = 20_000  # one takes a microsecond

HEXJET, QUADROTOR = "Hex-Jet, 6 engines, 2 servos", "quadrotor, 4 engines"
BARE_QUADROTOR = "bare JSBSim run(), quadrotor"
# the same engine on four, six and eight stations, so that a row differs from the next by engines and their vehicle
TURBINES = {
    "quadjet": "quadjet, 4 turbines",
    "hexjet-100": "Hex-Jet of 100 N a jet, 6 turbines",
    "octojet": "octojet, 8 turbines",
}


@dataclass(frozen=True)
class Lengths:
    """A recorded step, and the memory of a process of its own, by the seconds that are flown.

    ``growth``: the longest flight's step by the shortest's, round by round.
    """

    steps: dict[int, Cost]
    growth: Spread
    memory: dict[int, Memory]


@dataclass(frozen=True)
class EngineCounts:
    """A bank's step by its engines, and whole flights with six and with four, and with four, six and eight turbines.

    ``flown``: by name; the unit is a run of the Hex-Jet's airframe for all.
    """

    engine: str
    banks: dict[int, Cost]
    flown: dict[str, Cost]


@dataclass(frozen=True)
class LogRates:
    """A step by how many of them share a recorded row; 0: nothing is recorded."""

    steps: dict[int, Cost]


def measure_lengths(
    seconds: Sequence[int], rounds: int, times: int, folder: Path, on_round: Callable[[], object]
) -> Lengths:
    """Fly ``hover`` for so long, recorded in full; what comes after the last step is not timed.

    Memory is that of ``times`` processes each.
    """
    with Flights(250, folder) as flights:
        jobs = []
        for length in seconds:
            scenario = hover(round(length / Scenario.load("hover").step_s), SUBSTEPS)
            jobs.append(flights.fly(scenario).recorded(str(length)))
        pairs = collect(jobs, flights.units(), rounds, on_round)
    rows = {length: pairs[SUBSTEPS, str(length)] for length in seconds}
    least, most = (rows[pick(seconds)] for pick in (min, max))
    growth = [(b.step.cpu / b.unit.cpu) / (a.step.cpu / a.unit.cpu) for a, b in zip(least, most, strict=True)]
    memory = {length: measure_memory(length / 60.0, times, folder, on_round, report=False) for length in seconds}
    return Lengths({length: Cost.of(values) for length, values in rows.items()}, Spread.of(growth), memory)


def measure_engine_counts(steps: int, rounds: int, folder: Path, on_round: Callable[[], object]) -> EngineCounts:
    """Step banks of one engine, and fly the aircraft recorded in full, each between two timings of the unit."""
    with ExitStack() as stack, Flights(250, folder) as flights:
        jobs = [_bank(stack, count) for count in COUNTS]
        small = flights.fly(quadrotor(steps))
        large = flights.fly(hover(steps, SUBSTEPS))
        alone = stack.enter_context(build(quadrotor(250)))
        jobs += [
            large.recorded(HEXJET),
            small.recorded(QUADROTOR),
            *[flights.fly(turbines(aircraft, steps)).recorded(name) for aircraft, name in TURBINES.items()],
            Job(BARE_QUADROTOR, SUBSTEPS, UNIT_RUNS, partial(bare, alone, UNIT_RUNS)),
        ]
        pairs = collect(jobs, flights.units(), rounds, on_round)
    return EngineCounts(
        ENGINE,
        {count: Cost.of(pairs[SUBSTEPS, str(count)]) for count in COUNTS},
        {name: Cost.of(pairs[SUBSTEPS, name]) for name in (HEXJET, QUADROTOR, BARE_QUADROTOR, *TURBINES.values())},
    )


def measure_log_rates(steps: int, rounds: int, folder: Path, on_round: Callable[[], object]) -> LogRates:
    """Fly ``hover`` with every n-th step recorded, and with none."""
    with Flights(steps, folder) as flights:
        flight = flights.fly(hover(steps, SUBSTEPS))
        jobs = [flight.plain("0"), *[flight.recorded(str(every), every) for every in EVERY]]
        pairs = collect(jobs, flights.units(), rounds, on_round)
    return LogRates({every: Cost.of(pairs[SUBSTEPS, str(every)]) for every in (*EVERY, 0)})


def quadrotor(steps: int) -> Scenario:
    """``hover`` on the quadrotor with its own motors, at its 400 Hz."""
    step = 0.0025
    return Scenario.load("hover").replace(
        aircraft="quadrotor",
        engine="motor",
        step_s=step,
        substeps=SUBSTEPS,
        duration_s=steps * step,
        expect=[],
    )


def turbines(aircraft: str, steps: int) -> Scenario:
    """Return a hover of ``aircraft`` on turbines of 100 N by the paper's cascade."""
    flight = Scenario.load("octojet-hover")
    return flight.replace(
        aircraft=aircraft, controller="baseline", substeps=SUBSTEPS, duration_s=steps * flight.step_s, expect=[]
    )


def _bank(stack: ExitStack, count: int) -> Job:
    step = 0.004
    bank = stack.enter_context(EngineBank(load_engine(ENGINE, {}, step), count, step))
    return Job(str(count), SUBSTEPS, BANK_STEPS, partial(step_bank, bank, count, 0.4, BANK_STEPS))
