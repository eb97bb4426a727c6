"""Six separate FMU instances stepped by us and by other co-simulation engines: the same FMU, inputs and step.

The others are optional; one that is not there is named with the reason, and the rest is measured.  All step the
FMI 2.0 build, which every one of them takes, and all answer bit for bit alike, which a test says where they are
installed.
"""

from __future__ import annotations

import ctypes
import sys
import zipfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from importlib import import_module, metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from xml.etree import ElementTree

from benchmarks.measures.speed import Flights, collect
from benchmarks.timing import Action, Cost, Job
from cosim import FlightError
from cosim.base.signals import JETS
from cosim.engine import EngineBank, load_engine
from cosim.files import scratch

ENGINE = "edf-as-flown-fmi2"
STEP_S = 0.004
SUBSTEPS = 4  # as in the shipped scenarios
MAX_STEPS = 1000  # the slowest takes 0.25 ms a step

OURS = "ours"
EXCHANGE = "throttles in, step, thrusts out"
ALONE = "step alone"

Throttles = Sequence[float]


class Stepper(NamedTuple):
    """Six new instances at time 0: steps with values exchanged, and without where that is possible."""

    exchange: Callable[[int, Throttles], Sequence[float]]
    step: Callable[[int], object] | None


Opener = Callable[[ExitStack], Stepper]


@dataclass(frozen=True)
class Peer:
    """A co-simulation engine that steps FMUs; ``open`` makes new instances, closed with the stack."""

    name: str
    package: str  # name of the distribution
    open: Opener


@dataclass(frozen=True)
class Peers:
    """Cost of a step of six engines, by program and task; why programs are missing."""

    fmu: str
    steps: int
    costs: dict[str, dict[str, Cost]]
    versions: dict[str, str]
    missing: dict[str, str]


def inputs(steps: int) -> list[tuple[float, ...]]:
    """Return six throttles for each step, all different and all moving."""
    return [tuple(0.4 + 0.02 * jet + 0.01 * ((k + jet) % 2) for jet in range(JETS)) for k in range(steps)]


def find_peers() -> tuple[list[Peer], dict[str, str]]:
    """Return the programs that can be used here, ours first, and why others cannot."""
    peers = [Peer(OURS, "hexjet-cosim", _open_hexjet), Peer("FMPy's wrappers", "FMPy", _open_fmpy)]
    missing = {}
    for name, package, prepare in (("ecos", "ecospy", _prepare_ecos), ("libcosim", "libcosimpy", _prepare_libcosim)):
        try:
            peers.append(Peer(name, package, prepare()))
        except (ImportError, OSError) as error:
            missing[name] = f"{error}; it comes with: pip install {package}"
    return peers, missing


def measure_peers(steps: int, rounds: int, folder: Path, on_round: Callable[[], object]) -> Peers:
    """Time all programs in interleaved rounds."""
    steps = min(steps, MAX_STEPS)
    peers, missing = find_peers()
    with ExitStack() as stack, Flights(steps, folder) as flights:
        benches = [stack.enter_context(Bench(peer, steps)) for peer in peers]
        pairs = collect([job for bench in benches for job in bench.jobs()], flights.units(), rounds, on_round)
    costs: dict[str, dict[str, Cost]] = {peer.name: {} for peer in peers}
    for (_, label), rows in pairs.items():
        name, _, task = label.partition(": ")
        costs[name][task] = Cost.of(rows)
    versions = {peer.name: metadata.version(peer.package) for peer in peers}
    return Peers(f"{ENGINE}.fmu", steps, costs, versions, missing)


class Bench:
    """One program with instances of its own, new ones for every timing."""

    def __init__(self, peer: Peer, steps: int) -> None:
        self._peer = peer
        self._steps = steps
        self._inputs = inputs(steps)
        self._open = ExitStack()

    def __enter__(self) -> Bench:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def new(self) -> Stepper:
        """Open new instances; those before are closed."""
        self._open.close()
        return self._peer.open(self._open)

    def jobs(self) -> list[Job]:
        """Return the jobs of steps with values exchanged, and without where that is possible."""
        jobs = [Job(f"{self._peer.name}: {EXCHANGE}", SUBSTEPS, self._steps, self._exchange)]
        if self.new().step is not None:
            jobs.append(Job(f"{self._peer.name}: {ALONE}", SUBSTEPS, self._steps, self._run_without_exchange))
        return jobs

    def _exchange(self) -> Action:
        return partial(self._run, self.new().exchange)

    def _run(self, exchange: Callable[[int, Throttles], Sequence[float]]) -> None:
        for k, throttles in enumerate(self._inputs):
            thrust = exchange(k, throttles)
        if not min(thrust) > 0.0:
            raise FlightError(f"{self._peer.name}: six engines at part throttle give {list(thrust)} N")

    def _run_without_exchange(self) -> Action:
        step = self.new().step
        assert step is not None

        def action() -> None:
            for k in range(self._steps):
                step(k)

        return action


def _read_archive() -> tuple[Path, int, int]:
    """Return the archive, and the value references of its throttle and its thrust."""
    path = load_engine(ENGINE, {}, STEP_S).path
    with zipfile.ZipFile(path) as archive, archive.open("modelDescription.xml") as file:
        variables = ElementTree.parse(file).iter("ScalarVariable")
        references = {variable.get("name"): int(variable.get("valueReference", "")) for variable in variables}
    return path, references["throttle"], references["thrust"]


def _open_hexjet(stack: ExitStack) -> Stepper:
    bank = stack.enter_context(EngineBank(load_engine(ENGINE, {}, STEP_S), JETS, STEP_S))
    bank.reset(0.0)
    return Stepper(lambda k, throttles: bank.step(k, tuple(throttles)).thrust, None)


def _open_fmpy(stack: ExitStack) -> Stepper:
    """Return a stepper of FMPy's Python wrappers around instances of the same archive."""
    fmpy: Any = import_module("fmpy")
    path, throttle, thrust = _read_archive()
    description = fmpy.read_model_description(path)
    folder = fmpy.extract(path, stack.enter_context(TemporaryDirectory(dir=scratch())))
    slaves = [fmpy.instantiate_fmu(folder, description) for _ in range(JETS)]
    for slave in slaves:
        stack.callback(slave.freeInstance)
        slave.setupExperiment()
        slave.enterInitializationMode()
        slave.exitInitializationMode()

    def exchange(k: int, throttles: Throttles) -> Sequence[float]:
        for slave, value in zip(slaves, throttles, strict=True):
            slave.setReal([throttle], [value])
        step(k)
        return [slave.getReal([thrust])[0] for slave in slaves]

    def step(k: int) -> None:
        for slave in slaves:
            slave.doStep(currentCommunicationPoint=k * STEP_S, communicationStepSize=STEP_S)

    return Stepper(exchange, step)


def _prepare_ecos() -> Opener:
    library = Path(sys.prefix) / "lib" / "libtbb.so.12"
    if library.is_file():
        # ecospy's library for Linux needs oneTBB, which the package tbb installs outside the search path.
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    ecospy = import_module("ecospy")
    ecospy.EcosLib.set_log_level("off")

    def open_instances(stack: ExitStack) -> Stepper:
        path, _, _ = _read_archive()
        structure = ecospy.EcosSimulationStructure()
        for jet in range(JETS):
            structure.add_model(f"jet{jet}", str(path))
        simulation = ecospy.EcosSimulation(step_size=STEP_S, structure=structure)
        stack.callback(structure.free)
        stack.callback(simulation.free)
        simulation.init()
        ports = [(f"jet{jet}::throttle", f"jet{jet}::thrust") for jet in range(JETS)]

        def exchange(k: int, throttles: Throttles) -> Sequence[float]:
            for (throttle, _), value in zip(ports, throttles, strict=True):
                simulation.set_real(throttle, value)
            simulation.step()
            return [simulation.get_real(thrust) for _, thrust in ports]

        return Stepper(exchange, lambda k: simulation.step())

    return open_instances


def _prepare_libcosim() -> Opener:
    names = ("Execution", "Slave", "Manipulator", "Observer", "Logging")
    execution, slave, manipulator, observer, logging = (import_module(f"libcosimpy.Cosim{part}") for part in names)
    logging.log_output_level(logging.CosimLogLevel.FATAL)

    def open_instances(stack: ExitStack) -> Stepper:
        path, throttle, thrust = _read_archive()
        run = execution.CosimExecution.from_step_size(round(STEP_S * 1e9))
        slaves = [slave.CosimLocalSlave(str(path), f"jet{jet}") for jet in range(JETS)]
        indices = [run.add_local_slave(each) for each in slaves]
        inlet, outlet = manipulator.CosimManipulator.create_override(), observer.CosimObserver.create_last_value()
        if min(indices) < 0 or not run.add_manipulator(inlet) or not run.add_observer(outlet):
            raise FlightError(f"libcosim does not take {path.name}")

        def exchange(k: int, throttles: Throttles) -> Sequence[float]:
            for index, value in zip(indices, throttles, strict=True):
                inlet.slave_real_values(index, [throttle], [value])
            run.step()
            return [outlet.last_real_values(index, [thrust])[0] for index in indices]

        def step(k: int, keep: Any = slaves) -> None:  # libcosim keeps no reference
            run.step()

        return Stepper(exchange, step)

    return open_instances
