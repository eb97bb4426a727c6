"""What one control step costs as a whole, with one JSBSim run of the same airframe as the unit."""

from __future__ import annotations

import gc
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import repeat, starmap
from operator import sub
from pathlib import Path
from tempfile import mkdtemp

from benchmarks.timing import Action, Clocked, Cost, Job, Pair, interleave
from cosim import FlightError, Scenario
from cosim.base.constants import GRAVITY
from cosim.base.protocols import Engines, Observer
from cosim.base.signals import JETS, ZERO3, Sample, Vector3
from cosim.engine.wrappers import EngineChain
from cosim.flight import record
from cosim.results.run import Recording
from cosim.simulation.build import build
from cosim.simulation.step import Simulation
from cosim.vehicle.airframe import ADAMS_BASHFORTH_2, ADAMS_BASHFORTH_3, AIR_METHOD, FORCE_EXTRAPOLATION, RECTANGULAR

SUBSTEPS = (1, 4)
UNIT_RUNS = 2000  # JSBSim runs of one timing of the unit

BARE = "one bare JSBSim run()"
ENGINES = "six engine FMUs"
WHOLE_STEP = "whole step, no observer"
RECORDED = "whole step, recorded to disk"
AIRFRAME = "airframe: forces in, runs, state out"
PLAIN = "the same by JSBSim's own integrators, forces in once"
PRICE = "price of the better integrators"
OUTSIDE_JSBSIM = "not JSBSim, no observer"
OUTSIDE = "not JSBSim, recorded to disk"

# JSBSim's integration methods if a model's file names none.
JSBSIM_MODELS = {
    "rate/rotational": RECTANGULAR,
    "rate/translational": ADAMS_BASHFORTH_2,
    "position/rotational": RECTANGULAR,
    "position/translational": ADAMS_BASHFORTH_3,
}

Pairs = dict[tuple[int, str], list[Pair]]  # by JSBSim runs a step, and name


class RepeatedFlight:
    """A flight that is flown again and again, and may be recorded below ``folder``."""

    def __init__(self, simulation: Simulation, folder: Path) -> None:
        self.simulation = simulation
        self.scenario = simulation.scenario
        self._folder = folder
        self._recordings = 0
        self._recording: Recording | None = None

    def close(self) -> None:
        """Finish the last recording."""
        if self._recording is not None:
            self._recording.finish("completed", "timed")
            self._recording = None

    def plain(self, name: str) -> Job:
        """Return the job of a whole flight without observers."""
        return self._job(name, lambda: [])

    def recorded(self, name: str, every: int = 1) -> Job:
        """Return the job of a whole flight recorded to a run's folder: each step, or each ``every``-th."""
        return self._job(name, partial(self._observers, every))

    def _job(self, name: str, observers: Callable[[], Sequence[Observer]]) -> Job:
        def prepare() -> Action:
            self.simulation.reset()
            return partial(fly_through, self.simulation, observers())

        return Job(name, self.scenario.substeps, self.scenario.steps, prepare)

    def _observers(self, every: int) -> Sequence[Observer]:
        recording = self.new_recording()
        return [recording if every == 1 else Every(every, recording)]

    def new_recording(self) -> Recording:
        """Begin a recording to a folder of its own; the one before it is finished."""
        self.close()
        self._recordings += 1
        self._recording = record(self.simulation, self._folder / f"{self._recordings:04d}")
        return self._recording


class Every:
    """Observer that passes each ``every``-th step on to another observer."""

    def __init__(self, every: int, observer: Observer) -> None:
        self._every = every
        self._observer = observer

    def observe(self, sample: Sample) -> None:
        if sample.k % self._every == 0:
            self._observer.observe(sample)


class Flights:
    """Flights of ``hover``, ``steps`` long: six FMUs, Smith predictor, noisy sensors; recorded below ``folder``."""

    def __init__(self, steps: int, folder: Path) -> None:
        self.steps = steps
        self._folder = folder
        self._stack = ExitStack()
        folder.mkdir(parents=True, exist_ok=True)
        try:
            self._whole = {substeps: self.fly(hover(self.steps, substeps)) for substeps in SUBSTEPS}
            # The unit is timed on airframes of its own, so that the flights are not changed.
            self._bare = {substeps: self.build(substeps) for substeps in SUBSTEPS}
        except BaseException:
            self._stack.close()
            raise

    def build(self, substeps: int) -> Simulation:
        """Build one more flight, which is closed with the others."""
        return self._stack.enter_context(build(hover(self.steps, substeps)))

    def fly(self, scenario: Scenario) -> RepeatedFlight:
        """Return a scenario's flight, which is closed with the others and recorded in a folder of its own."""
        simulation = self._stack.enter_context(build(scenario))
        flight = RepeatedFlight(simulation, Path(mkdtemp(dir=self._folder)))
        self._stack.callback(flight.close)
        return flight

    def __enter__(self) -> Flights:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def units(self) -> dict[int, Job]:
        """Return the jobs of bare JSBSim by its runs a step, which decide how long a run lasts."""
        return {substeps: Job(BARE, substeps, UNIT_RUNS, partial(self._run_bare, substeps)) for substeps in SUBSTEPS}

    def jobs(self, substeps: int) -> list[Job]:
        """Return the jobs: the engines alone, the airframe alone, and whole flights without and with recording."""
        return [
            Job(ENGINES, substeps, self.steps, partial(self._step_engines, substeps)),
            self._whole[substeps].plain(WHOLE_STEP),
            self.recorded(substeps),
            Job(AIRFRAME, substeps, self.steps, partial(self._fly_airframe, substeps, False)),
            Job(PLAIN, substeps, self.steps, partial(self._fly_airframe, substeps, True)),
        ]

    def recorded(self, substeps: int) -> Job:
        """Return the job of a whole flight recorded to a run's folder."""
        return self._whole[substeps].recorded(RECORDED)

    def _run_bare(self, substeps: int) -> Action:
        return bare(self._bare[substeps], UNIT_RUNS)

    def _fly_airframe(self, substeps: int, plain: bool) -> Action:
        return airframe_alone(self._bare[substeps], self.steps, plain)

    def _step_engines(self, substeps: int) -> Action:
        simulation = self._whole[substeps].simulation
        return step_bank(simulation.propulsion.engines, JETS, simulation.cascade.allocator.hover, self.steps)


def bare(simulation: Simulation, runs: int) -> Action:
    """Return the job of ``runs`` bare JSBSim runs of the airframe in hover with constant forces."""
    _begin(simulation)
    run = simulation.airframe.jsbsim_run()

    def action() -> None:
        for _ in repeat(None, runs):
            run()

    return action


def _begin(simulation: Simulation, more: float = 0.0) -> list[Vector3]:
    """Reset the airframe to hover; return the jets' forces that carry it, and ``more`` of them."""
    jets = len(simulation.vehicle.jets)
    lift = -simulation.vehicle.mass_kg * GRAVITY / jets
    simulation.airframe.reset(simulation.scenario.initial, [(0.0, 0.0, lift)] * jets, ZERO3)
    return [(0.0, 0.0, (1.0 + more) * lift)] * jets


def airframe_alone(simulation: Simulation, steps: int, plain: bool) -> Action:
    """Return the job of the airframe's part of control steps, with other forces in each.

    ``plain``: by the integrators that JSBSim has where nobody chooses, and without what the first run makes up.
    """
    moving = [_begin(simulation, more) for more in (0.01, -0.01)]
    frame = simulation.airframe
    if plain:
        for name, method in JSBSIM_MODELS.items():
            frame._set_property(f"simulation/integrator/{name}", method)
    run, more = frame.jsbsim_run(), frame.substeps - 1
    twice = more > 0 and not plain
    fraction, write, write_ahead, read = (
        FORCE_EXTRAPOLATION[AIR_METHOD],
        frame._write_loads,
        frame._write_extrapolated,
        frame._read_state,
    )

    def action() -> None:
        for k in range(steps):
            forces = moving[k % 2]
            if twice:
                write_ahead(forces, ZERO3, ZERO3, fraction)
                run()
                write(forces, ZERO3, ZERO3)
            else:
                write(forces, ZERO3, ZERO3)
                run()
            for _ in range(more):
                run()
            read()

    return action


def step_bank(engines: Engines | EngineChain, count: int, throttle: float, steps: int) -> Action:
    """Step ``count`` engines ``steps`` times with throttles that move about ``throttle``."""
    engines.reset(throttle)
    moving = ((throttle,) * count, (throttle + 0.01,) * count)
    inputs = [(k, moving[k % 2]) for k in range(steps)]
    return partial(deque, starmap(engines.step, inputs), 0)


def hover(steps: int, substeps: int) -> Scenario:
    """Return the shipped ``hover``, ``steps`` long."""
    scenario = Scenario.load("hover")
    return scenario.replace(duration_s=steps * scenario.step_s, substeps=substeps, expect=[])


def warm_up(folder: Path) -> None:
    """Fly and record one second, so that no job's time includes first imports."""
    with Flights(250, folder) as flights:
        for unit in flights.units().values():
            unit.prepare()()
        flights.recorded(SUBSTEPS[-1]).prepare()()


def fly_through(simulation: Simulation, observers: Sequence[Observer] = ()) -> None:
    """Fly to the end.  Raises FlightError if the vehicle fails, as its time would mean nothing."""
    ending = simulation.run(observers)
    if ending.outcome != "completed":
        raise FlightError(f"the timed flight ended early: {ending.reason}")


def collect(jobs: Sequence[Job], units: Mapping[int, Job], rounds: int, on_round: Callable[[], object]) -> Pairs:
    """Time the jobs in interleaved rounds; ``on_round`` is called after each round."""
    pairs: Pairs = defaultdict(list)
    gc.freeze()  # many objects, else scanned every job
    try:
        for done, (job, pair) in enumerate(interleave(jobs, units, rounds), 1):
            pairs[job.substeps, job.name].append(pair)
            if done % len(jobs) == 0:
                on_round()
    finally:
        gc.unfreeze()
    return pairs


def differences(pairs: Sequence[Pair], less: Sequence[Pair]) -> list[Pair]:
    """Return how much more a step of one job costs than of another, round by round, in the first's unit."""
    return [Pair(Clocked(*map(sub, one.step, other.step)), one.unit) for one, other in zip(pairs, less, strict=True)]


def measure_speed(steps: int, rounds: int, folder: Path, on_round: Callable[[], object]) -> dict[int, dict[str, Cost]]:
    """Return costs by JSBSim runs a step and name; flights are recorded below ``folder``."""
    with Flights(steps, folder) as flights:
        jobs = [job for substeps in SUBSTEPS for job in flights.jobs(substeps)]
        measured = collect(jobs, flights.units(), rounds, on_round)
    costs: dict[int, dict[str, Cost]] = {}
    for substeps in SUBSTEPS:
        pairs = {name: rows for (runs, name), rows in measured.items() if runs == substeps}
        units = [pair.unit for rows in pairs.values() for pair in rows]
        costs[substeps] = {
            BARE: Cost.of([Pair(unit, unit) for unit in units]),
            **{name: Cost.of(rows) for name, rows in pairs.items()},
            PRICE: Cost.of(differences(pairs[AIRFRAME], pairs[PLAIN])),
            OUTSIDE_JSBSIM: Cost.of(pairs[WHOLE_STEP], less=substeps),
            OUTSIDE: Cost.of(pairs[RECORDED], less=substeps),
        }
    return costs
