"""Where the time outside JSBSim goes: every block of a step timed alone on recorded inputs, and in flight."""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import starmap
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.measures.speed import RECORDED, Flights, collect, fly_through
from benchmarks.timing import Action, Cost, Job
from cosim.base.arrays import Array
from cosim.base.signals import ZERO3, PerJet, PerServo, Sample, Unallocated, Vector3
from cosim.results.log.arrow import StreamSink
from cosim.results.log.recorder import MemorySink, Recorder
from cosim.simulation.step import Simulation
from cosim.spec.vehicle import layout_of
from cosim.vehicle.effects.effect import Load

SUBSTEPS = 4  # as the shipped scenarios have it

COMMAND, DISTURBANCE, ATTITUDE, RATE, ALTITUDE = "command", "disturbance", "attitude", "rate, predictor", "altitude"
ALLOCATION, ENGINES, SERVOS, FORCES = "allocation", "engines", "servos", "jet forces"
AIRFRAME, SENSORS, END_CHECK = "airframe but its runs", "sensors", "end of flight?"
ROWS, DISK = "recorder: rows", "recorder: to disk"
INSTRUMENTED = "instrumented flight"


@dataclass(frozen=True)
class InFlight:
    """Median of a block between the others in a flight: microseconds by the clock, and units.

    In flight a block finds its code and data pushed out of the processor's caches by the others.
    """

    us: float
    units: float


@dataclass(frozen=True)
class Breakdown:
    """The blocks alone and in flight, and the recorded step without its JSBSim runs, timed among them.

    The airframe in flight is its whole step less the units, and so bears what JSBSim's runs cost more in flight.
    A block that is compiled lets no clock between itself and the others and is known alone only.
    """

    substeps: int
    outside: Cost
    alone: dict[str, Cost]
    in_flight: dict[str, InFlight]
    rest_units: float  # what the step has more than its blocks in flight: the loop, records, what medians leave out


@dataclass(frozen=True)
class Block:
    """A block with the inputs that it had, and what it ``answered`` where the flight keeps that."""

    name: str
    reset: Callable[[], object]
    function: Callable[..., Any]
    inputs: Sequence[tuple[Any, ...]] = field(repr=False)
    answered: Sequence[Any] | None = field(default=None, repr=False)

    def replay(self) -> list[Any]:
        """Return the block's answers to the inputs, from its start."""
        self.reset()
        return list(starmap(self.function, self.inputs))

    def job(self, steps: int) -> Job:
        """Return the job that times the block; the loop over the inputs runs in C and adds little."""
        return Job(self.name, SUBSTEPS, steps, self._prepare)

    def _prepare(self) -> Action:
        self.reset()
        return partial(deque, starmap(self.function, self.inputs), 0)


def measure_blocks(steps: int, rounds: int, folder: Path, on_round: Callable[[], object]) -> Breakdown:
    """Time the blocks and, among them, the whole step."""
    with Flights(steps, folder) as flights:
        replay, clocks = Replay(flights.build(SUBSTEPS), folder), Clocks(flights.build(SUBSTEPS), steps)
        jobs = [block.job(steps) for block in replay.blocks()]
        try:
            pairs = collect([*jobs, clocks.job, flights.recorded(SUBSTEPS)], flights.units(), rounds, on_round)
        finally:
            replay.close()
    outside = Cost.of(pairs[SUBSTEPS, RECORDED], less=SUBSTEPS)
    alone = {job.name: Cost.of(pairs[SUBSTEPS, job.name]) for job in jobs}
    # a median over steps leaves out what other processes took, and so does processor time
    in_flight = clocks.blocks([pair.unit.cpu for pair in pairs[SUBSTEPS, INSTRUMENTED]])
    units = {name: in_flight[name].units if name in in_flight else cost.units.median for name, cost in alone.items()}
    return Breakdown(SUBSTEPS, outside, alone, in_flight, outside.units.median - sum(units.values()))


class Replay:
    """The blocks of :meth:`cosim.simulation.step.Simulation.step` and of the loop around it, after one flight."""

    def __init__(self, simulation: Simulation, folder: Path) -> None:
        self._simulation = simulation
        self._folder = folder
        self._streams = 0
        self._stream: StreamSink | None = None
        recorded, memory = _Keep(), MemorySink()
        recorder = Recorder(simulation.dt, memory)
        fly_through(simulation, [recorded, recorder])
        recorder.flush()
        self._samples = recorded.samples
        self._tables = memory.tables
        self._states = [*[sample.state for sample in recorded.samples[1:]], simulation.state]  # after each step
        self._measured = [*[sample.measured for sample in recorded.samples[1:]], simulation.measured]

    def blocks(self) -> list[Block]:
        """In the order in which a step comes by them."""
        return [*self._control(), *self._plant(), *self._recording()]

    def close(self) -> None:
        """Close what the last replay left open."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _control(self) -> list[Block]:
        simulation, samples = self._simulation, self._samples
        cascade = simulation.cascade
        attitude, rate, altitude = cascade.attitude, cascade.rate, cascade.altitude
        # what was not allocated is known one step later
        lacks = [Unallocated(), *[sample.actuation.unallocated for sample in samples]]
        step_inputs = list(zip(samples, lacks, strict=False))
        ks = [(sample.k,) for sample in samples]
        return [
            Block(COMMAND, _nothing, simulation.command_script.at, ks, [s.command for s in samples]),
            Block(DISTURBANCE, _nothing, simulation.disturbances.at, ks, [s.disturbance for s in samples]),
            Block(
                ATTITUDE,
                attitude.reset,
                attitude.update,
                [(s.command, s.measured) for s in samples],
                [s.control.rate_setpoint for s in samples],
            ),
            Block(
                RATE,
                rate.reset,
                rate.update,
                [(s.control.rate_setpoint, s.measured.rate, lack) for s, lack in step_inputs],
                [s.control.torque for s in samples],
            ),
            Block(
                ALTITUDE,
                altitude.reset,
                altitude.update,
                [(s.command, s.measured, lack) for s, lack in step_inputs],
                [s.control.collective for s in samples],
            ),
            Block(
                ALLOCATION,
                _nothing,
                cascade.allocator.allocate,
                [(s.control.collective, s.control.torque, s.disturbance.torque_command) for s in samples],
                [s.actuation for s in samples],
            ),
        ]

    def _plant(self) -> list[Block]:
        simulation, samples, states = self._simulation, self._samples, self._states
        propulsion, airframe, sensors, termination = (
            simulation.propulsion,
            simulation.airframe,
            simulation.sensors,
            simulation.termination,
        )
        engines = propulsion.engines
        left, right = propulsion.servos
        initial = simulation.scenario.initial
        load = Load(layout_of(simulation.vehicle.jets, simulation.vehicle.hinges))
        forces = [_push(load, sample.thrust, sample.tilt) for sample in samples]
        airframe.moving = False  # from here on it writes and reads, and JSBSim stands still

        def reset_servos() -> None:
            left.reset()
            right.reset()

        def servos(left_command: float, right_command: float) -> tuple[float, float]:
            return left.update(left_command), right.update(right_command)

        return [
            Block(
                ENGINES,
                partial(engines.reset, simulation.cascade.allocator.hover),
                engines.step,
                [(s.k, s.actuation.throttle) for s in samples],
                [s.engines for s in samples],
            ),
            Block(SERVOS, reset_servos, servos, [s.actuation.tilt for s in samples], [s.tilt for s in samples]),
            Block(FORCES, _nothing, partial(_push, load), [(s.thrust, s.tilt) for s in samples]),
            Block(
                AIRFRAME,
                partial(airframe.reset, initial, forces[0], ZERO3),
                airframe.step,
                [(force, s.disturbance) for force, s in zip(forces, samples, strict=True)],
            ),
            Block(
                SENSORS,
                partial(sensors.reset, samples[0].state),
                sensors.sample,
                [(state,) for state in states],
                self._measured,
            ),
            Block(
                END_CHECK,
                partial(termination.reset, initial.on_ground),
                termination.check,
                [(state, k * simulation.dt) for k, state in enumerate(states, 1)],
                [None] * len(states),
            ),
        ]

    def _recording(self) -> list[Block]:
        recorder = Recorder(self._simulation.dt, _Nowhere())
        return [
            Block(ROWS, _nothing, recorder.observe, [(sample,) for sample in self._samples]),
            Block(DISK, self._new_stream, self._write, [(table,) for table in self._tables]),
        ]

    def _new_stream(self) -> None:
        self.close()
        self._streams += 1
        self._stream = StreamSink(self._folder / f"blocks-{self._streams:04d}.arrows", "timed")

    def _write(self, table: Array) -> None:
        assert self._stream is not None
        self._stream.write(table)


class Clocks:
    """A flight with a clock around every block that lets one in: a compiled one does not."""

    def __init__(self, simulation: Simulation, steps: int) -> None:
        self._simulation = simulation
        self._recorder = Recorder(simulation.dt, _Nowhere())
        self._spent: dict[str, list[int]] = defaultdict(list)  # ns, call by call, of the flight that is flown
        self._medians: dict[str, list[float]] = defaultdict(list)  # s a step, flight by flight
        self.job = Job(INSTRUMENTED, SUBSTEPS, steps, self._prepare)
        cascade, propulsion = simulation.cascade, simulation.propulsion
        owners: list[tuple[str, Any, str]] = [
            (COMMAND, simulation.command_script, "at"),
            (DISTURBANCE, simulation.disturbances, "at"),
            (ATTITUDE, cascade.attitude, "update"),
            (RATE, cascade.rate, "update"),
            (ALTITUDE, cascade.altitude, "update"),
            (ALLOCATION, cascade.allocator, "allocate"),
            (ENGINES, propulsion.engines.bank, "step"),
            *[(SERVOS, servo, "update") for servo in propulsion.servos],
            (AIRFRAME, simulation.airframe, "step"),
            (SENSORS, simulation.sensors, "sample"),
            (END_CHECK, simulation.termination, "check"),
            (ROWS, self._recorder, "observe"),
        ]
        self._calls = {name: sum(owner[0] == name for owner in owners) for name, _, _ in owners}
        for name, owner, method in owners:
            with suppress(AttributeError):
                setattr(owner, method, self._clocked(name, getattr(owner, method)))

    def _clocked(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        now, note = time.perf_counter_ns, self._spent[name].append

        def clocked(*arguments: Any) -> Any:
            begin = now()
            answer = function(*arguments)
            note(now() - begin)
            return answer

        return clocked

    def _prepare(self) -> Action:
        self._simulation.reset()
        return self._fly

    def _fly(self) -> None:
        for spent in self._spent.values():
            spent.clear()
        fly_through(self._simulation, [self._recorder])
        now = time.perf_counter_ns
        clock_cost = median([-(now() - now()) for _ in range(1000)])  # what the clock itself takes
        for name, spent in self._spent.items():
            if len(spent) == self._calls[name] * self.job.steps:
                self._medians[name].append(1e-9 * (median(spent) - clock_cost) * self._calls[name])

    def blocks(self, units: Sequence[float]) -> dict[str, InFlight]:
        """Return the medians of the flights by block; ``units`` are the unit's seconds, flight by flight."""
        blocks = {}
        for name, medians in self._medians.items():
            less = SUBSTEPS if name == AIRFRAME else 0
            rows = list(zip(medians, units, strict=True))
            blocks[name] = InFlight(
                1e6 * median([spent - less * unit for spent, unit in rows]),
                median([spent / unit - less for spent, unit in rows]),
            )
        return blocks


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


def _push(load: Load, thrust: PerJet, tilt: PerServo) -> list[Vector3]:
    """Return the jets' forces, hinges turned."""
    load.set_tilt(tilt)
    return load.along_axes(thrust)


def _nothing() -> None:
    """There is nothing to reset."""
