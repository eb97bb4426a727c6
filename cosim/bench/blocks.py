"""Where the time outside JSBSim goes: every block of a step timed alone, on the inputs that it had in a flight."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import starmap
from pathlib import Path
from typing import Any

from cosim.bench.speed import RECORDED, Flights, collect, fly_through
from cosim.bench.timing import Action, Cost, Job
from cosim.recorder import Array, MemorySink, Recorder, StreamSink
from cosim.signals import ZERO3, Refused, Sample, State
from cosim.simulation import Simulation

SUBSTEPS = 4  # as the shipped scenarios have it; matters to the whole step only


@dataclass(frozen=True)
class Breakdown:
    """The blocks, and the recorded step without its JSBSim runs, timed among them."""

    substeps: int
    outside: Cost
    blocks: dict[str, Cost]
    rest_units: float  # what the step has more than its blocks together: the loop, its records, colder caches
    rest_us: float  # the same in processor time


@dataclass(frozen=True)
class Block:
    """A block with the inputs that it had, and what it ``answered`` where the flight keeps that."""

    name: str
    reset: Callable[[], object]
    function: Callable[..., Any]
    inputs: Sequence[tuple[Any, ...]] = field(repr=False)
    answered: Sequence[Any] | None = field(default=None, repr=False)

    def replay(self) -> list[Any]:
        """The block's answers to the inputs, from its start."""
        self.reset()
        return list(starmap(self.function, self.inputs))

    def job(self, steps: int) -> Job:
        """Timing it; the loop over the inputs runs in C and adds little."""
        return Job(self.name, SUBSTEPS, steps, self._prepare)

    def _prepare(self) -> Action:
        self.reset()
        return partial(deque, starmap(self.function, self.inputs), 0)


def measure_blocks(steps: int, rounds: int, folder: Path, on_round: Callable[[], object]) -> Breakdown:
    """Time the blocks and, among them, the whole step."""
    with Flights(steps, folder) as flights:
        stage = Stage(flights, folder)
        jobs = [block.job(steps) for block in stage.blocks()]
        try:
            found = collect([*jobs, flights.recorded(SUBSTEPS)], flights.units(), rounds, on_round)
        finally:
            stage.close()
    outside = Cost.of(found[SUBSTEPS, RECORDED], less=SUBSTEPS)
    costs = {job.name: Cost.of(found[SUBSTEPS, job.name]) for job in jobs}
    return Breakdown(
        SUBSTEPS,
        outside,
        costs,
        outside.units.median - sum(cost.units.median for cost in costs.values()),
        outside.cpu_us.median - sum(cost.cpu_us.median for cost in costs.values()),
    )


class Stage:
    """The blocks of :meth:`cosim.simulation.Simulation.step` and of the loop around it, after one flight."""

    def __init__(self, flights: Flights, folder: Path) -> None:
        self._folder = folder
        self._streams = 0
        self._stream: StreamSink | None = None
        self.simulation = flights.build(SUBSTEPS)
        self._kept = _Keep()
        memory = MemorySink()
        recorder = Recorder(self.simulation.dt, memory)
        fly_through(self.simulation, [self._kept, recorder])
        recorder.flush()
        self._tables = memory.tables
        self._after = self.simulation.state, self.simulation.measured

    def blocks(self) -> list[Block]:
        """In the order in which a step comes by them."""
        simulation, samples = self.simulation, self._kept.samples
        return [*_control(simulation, samples), *_plant(simulation, samples, *self._after), *self._recording()]

    def close(self) -> None:
        """Close what the last replay left open."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _recording(self) -> list[Block]:
        recorder = Recorder(self.simulation.dt, _Nowhere())
        return [
            Block("recorder: rows", _nothing, recorder.observe, [(sample,) for sample in self._kept.samples]),
            Block("recorder: blocks to disk", self._new_stream, self._write, [(table,) for table in self._tables]),
        ]

    def _new_stream(self) -> None:
        self.close()
        self._streams += 1
        self._stream = StreamSink(self._folder / f"blocks-{self._streams:04d}.arrows", "timed")

    def _write(self, table: Array) -> None:
        assert self._stream is not None
        self._stream.write(table)


class _Keep:
    """An observer that keeps every sample."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []

    def observe(self, sample: Sample) -> None:
        self.samples.append(sample)


class _Nowhere:
    """Takes blocks of the log and forgets them."""

    def write(self, table: Array) -> None:
        pass


def _nothing() -> None:
    """There is nothing to reset."""


def _control(simulation: Simulation, samples: Sequence[Sample]) -> list[Block]:
    # what was refused is known one step later
    told = list(zip(samples, [Refused(), *[sample.actuation.refused for sample in samples]], strict=False))
    ks = [(sample.k,) for sample in samples]
    attitude, rate, altitude = simulation.attitude, simulation.rate, simulation.altitude
    return [
        Block("command", _nothing, simulation.commander.at, ks, [s.command for s in samples]),
        Block("disturbance", _nothing, simulation.disturber.at, ks, [s.disturbance for s in samples]),
        Block(
            "attitude",
            attitude.reset,
            attitude.update,
            [(s.command, s.measured) for s in samples],
            [s.rate_setpoint for s in samples],
        ),
        Block(
            "rate and predictor",
            rate.reset,
            rate.update,
            [(s.rate_setpoint, s.measured.rate, refused) for s, refused in told],
            [s.torque_command for s in samples],
        ),
        Block(
            "altitude",
            altitude.reset,
            altitude.update,
            [(s.command, s.measured, refused) for s, refused in told],
            [s.collective for s in samples],
        ),
        Block(
            "allocation",
            _nothing,
            simulation.allocator.allocate,
            [(s.collective, s.torque_command, s.disturbance.torque_command) for s in samples],
            [s.actuation for s in samples],
        ),
    ]


def _plant(simulation: Simulation, samples: Sequence[Sample], state: State, measured: Any) -> list[Block]:
    """``state`` and ``measured`` are those after the last step."""
    initial = simulation.scenario.initial
    engines, sensors, judge = simulation.engines, simulation.sensors, simulation.judge
    states = [*[sample.state for sample in samples[1:]], state]
    jet_forces = simulation._jet_forces
    forces = [jet_forces(sample.thrust, sample.tilt) for sample in samples]
    left, right = simulation.servos
    airframe = simulation.airframe
    airframe.substeps = 0  # from here on it writes and reads, and JSBSim stands still

    def reset_servos() -> None:
        left.reset()
        right.reset()

    def servos(left_command: float, right_command: float) -> tuple[float, float]:
        return left.update(left_command), right.update(right_command)

    return [
        Block(
            "engines",
            partial(engines.reset, simulation.allocator.hover),
            engines.step,
            [(s.k, s.actuation.throttle) for s in samples],
            [s.thrust for s in samples],
        ),
        Block("servos", reset_servos, servos, [s.actuation.tilt for s in samples], [s.tilt for s in samples]),
        Block("jet forces", _nothing, jet_forces, [(s.thrust, s.tilt) for s in samples]),
        Block(
            "airframe: write and read",
            partial(airframe.reset, initial, forces[0], ZERO3),
            airframe.step,
            [(force, s.disturbance) for force, s in zip(forces, samples, strict=True)],
        ),
        Block(
            "sensors",
            partial(sensors.reset, samples[0].state),
            sensors.sample,
            [(each,) for each in states],
            [*[s.measured for s in samples[1:]], measured],
        ),
        Block(
            "end of flight?",
            partial(judge.reset, initial.on_ground),
            judge.look,
            [(each, k * simulation.dt) for k, each in enumerate(states, 1)],
            [None] * len(states),
        ),
    ]
