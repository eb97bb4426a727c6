"""What one control step costs as a whole, with one JSBSim run of the same airframe as the unit."""

from __future__ import annotations

import gc
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import repeat, starmap
from pathlib import Path

from cosim.bench.timing import Action, Cost, Job, Pair, interleave
from cosim.control.altitude import GRAVITY
from cosim.errors import FlightError
from cosim.flight import record
from cosim.run import Recording
from cosim.scenario import Scenario
from cosim.signals import JETS, ZERO3
from cosim.simulation import Observer, Simulation, build

SUBSTEPS = (1, 4)
UNIT_RUNS = 2000  # timed before and after every job

BARE = "one bare JSBSim run()"
ENGINES = "six engine FMUs"
FLOWN = "whole step, no observer"
RECORDED = "whole step, recorded to disk"
OUTSIDE_FLOWN = "not JSBSim, no observer"
OUTSIDE = "not JSBSim, recorded to disk"

Pairs = dict[tuple[int, str], list[Pair]]  # of the rounds, by JSBSim runs a step and name


class Flights:
    """Flights of ``hover``, ``steps`` long: six FMUs, Smith predictor, noisy sensors; recorded below ``folder``."""

    def __init__(self, steps: int, folder: Path) -> None:
        self.steps = steps
        self._folder = folder
        self._recordings = 0
        self._recording: Recording | None = None
        self._stack = ExitStack()
        try:
            self._whole = {substeps: self.build(substeps) for substeps in SUBSTEPS}
            # airframes of their own, so that timing the unit leaves the flights alone
            self._bare = {substeps: self.build(substeps) for substeps in SUBSTEPS}
        except BaseException:
            self._stack.close()
            raise

    def build(self, substeps: int) -> Simulation:
        """One more flight; closed with the others."""
        return self._stack.enter_context(build(hover(self.steps, substeps)))

    def __enter__(self) -> Flights:
        return self

    def __exit__(self, *_: object) -> None:
        self._end_recording()
        self._stack.close()

    def units(self) -> dict[int, Job]:
        """Bare JSBSim by the number of runs a step, which decides how long one of its steps is."""
        return {substeps: Job(BARE, substeps, UNIT_RUNS, partial(self._run_bare, substeps)) for substeps in SUBSTEPS}

    def jobs(self, substeps: int) -> list[Job]:
        """The engines alone, and whole flights without and with recording."""
        return [
            Job(ENGINES, substeps, self.steps, partial(self._step_engines, substeps)),
            Job(FLOWN, substeps, self.steps, partial(self._fly, substeps)),
            self.recorded(substeps),
        ]

    def recorded(self, substeps: int) -> Job:
        """A whole flight recorded to a run's folder."""
        return Job(RECORDED, substeps, self.steps, partial(self._fly_recorded, substeps))

    def _run_bare(self, substeps: int) -> Action:
        simulation = self._bare[substeps]
        lift = (0.0, 0.0, -simulation.vehicle.mass_kg * GRAVITY / JETS)
        simulation.airframe.reset(simulation.scenario.initial, [lift] * JETS, ZERO3)
        run = simulation.airframe.bare_run()

        def action() -> None:
            for _ in repeat(None, UNIT_RUNS):
                run()

        return action

    def _step_engines(self, substeps: int) -> Action:
        simulation = self._whole[substeps]
        throttle = simulation.allocator.hover
        simulation.engines.reset(throttle)
        moving = ((throttle,) * JETS, (throttle + 0.01,) * JETS)
        inputs = [(k, moving[k % 2]) for k in range(self.steps)]
        return partial(deque, starmap(simulation.engines.step, inputs), 0)

    def _fly(self, substeps: int) -> Action:
        simulation = self._whole[substeps]
        simulation.reset()
        return partial(fly_through, simulation)

    def _fly_recorded(self, substeps: int) -> Action:
        simulation = self._whole[substeps]
        simulation.reset()
        return partial(fly_through, simulation, [self.new_recording(simulation)])

    def new_recording(self, simulation: Simulation) -> Recording:
        """A recording to a folder of its own; the one before it is finished."""
        self._end_recording()
        self._recordings += 1
        self._recording = record(simulation, self._folder / f"{self._recordings:04d}")
        return self._recording

    def _end_recording(self) -> None:
        if self._recording is not None:
            self._recording.finish("completed", "timed", report=False)
            self._recording = None


def hover(steps: int, substeps: int) -> Scenario:
    """The shipped ``hover``, ``steps`` long."""
    scenario = Scenario.load("hover")
    return scenario.replace(duration_s=steps * scenario.step_s, substeps=substeps, expect=[])


def fly_through(simulation: Simulation, observers: Sequence[Observer] = ()) -> None:
    """Fly to the end.  Raises FlightError if the vehicle does not get there: its time would say nothing."""
    ending = simulation.run(observers)
    if ending.outcome != "completed":
        raise FlightError(f"the timed flight ended early: {ending.reason}")


def collect(jobs: Sequence[Job], units: Mapping[int, Job], rounds: int, on_round: Callable[[], object]) -> Pairs:
    """Time the jobs, interleaved; ``on_round`` is called after each round."""
    found: Pairs = defaultdict(list)
    gc.freeze()  # recorded inputs are many: the collector would go through them all before every job
    try:
        for done, (job, pair) in enumerate(interleave(jobs, units, rounds), 1):
            found[job.substeps, job.name].append(pair)
            if done % len(jobs) == 0:
                on_round()
    finally:
        gc.unfreeze()
    return found


def measure_speed(steps: int, rounds: int, folder: Path, on_round: Callable[[], object]) -> dict[int, dict[str, Cost]]:
    """Costs by the number of JSBSim runs a step and by name; flights are recorded below ``folder``."""
    with Flights(steps, folder) as flights:
        jobs = [job for substeps in SUBSTEPS for job in flights.jobs(substeps)]
        found = collect(jobs, flights.units(), rounds, on_round)
    costs: dict[int, dict[str, Cost]] = {}
    for substeps in SUBSTEPS:
        pairs = {name: rows for (runs, name), rows in found.items() if runs == substeps}
        units = [pair.unit for rows in pairs.values() for pair in rows]
        costs[substeps] = {
            BARE: Cost.of([Pair(unit, unit) for unit in units]),
            **{name: Cost.of(rows) for name, rows in pairs.items()},
            OUTSIDE_FLOWN: Cost.of(pairs[FLOWN], less=substeps),
            OUTSIDE: Cost.of(pairs[RECORDED], less=substeps),
        }
    return costs
