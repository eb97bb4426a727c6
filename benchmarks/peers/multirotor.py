"""A hover by RotorPy and by us: each with its own quadrotor, controller and sensors, for as long and at the same rate.

Not the same work, and so no verdict: RotorPy integrates rigid body and motors by an adaptive Runge-Kutta method
(``scipy.integrate.solve_ivp``) anew in every control step and keeps its log in memory; we run JSBSim's fixed steps
with an FMU for every engine and write every column to disk.  What it does is count_calls and stated with its times.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module, metadata
from itertools import starmap
from math import sqrt
from pathlib import Path
from typing import Any

from benchmarks.measures.speed import Flights, collect, hover
from benchmarks.timing import Action, Cost, Job, Pair, Spread
from cosim import FlightError, Scenario

PACKAGE = "rotorpy"
RATES = (250, 400)  # control [Hz]: Hex-Jet, quadrotor
MAX_DRIFT_M = 0.1  # else it does not hover

WHOLE_FLIGHT, PLANT = "whole flight", "vehicle alone"
SUBSTEPS = 4  # as in the shipped scenarios


def quadrotor(steps: int) -> Scenario:
    """Return ``hover`` on the quadrotor with its own motors at 400 Hz."""
    step = 0.0025
    return Scenario.load("hover").replace(
        aircraft="quadrotor", engine="motor", step_s=step, substeps=SUBSTEPS, duration_s=steps * step, expect=[]
    )


@dataclass(frozen=True)
class Hover:
    """Cost of one way of hovering at ``rate`` steps a second.

    ``factor``: seconds flown in a second of wall time.  ``ratio``: its step by ours at the same rate, round by round.
    """

    rate: int
    cost: Cost
    factor: Spread
    ratio: Spread


@dataclass(frozen=True)
class Multirotor:
    """Costs of hovering by name: ours and RotorPy's; ``missing``: why RotorPy was not measured.

    ``evaluations``: of RotorPy's equations of motion in a control step, of the integration and of the rest.
    """

    seconds: float
    hovers: dict[str, Hover]
    version: str | None
    evaluations: dict[int, float]
    missing: str | None


HEXJET_LABELS = {250: "ours, Hex-Jet", 400: "ours, quadrotor"}


def measure_multirotor(seconds: float, rounds: int, folder: Path, on_round: Callable[[], object]) -> Multirotor:
    """Time all ways of hovering in interleaved rounds."""
    rotorpy = find_rotorpy()
    missing = rotorpy if isinstance(rotorpy, str) else None
    jobs: dict[str, tuple[int, Job]] = {}
    evaluations = {}
    with Flights(250, folder) as flights:
        for rate, scenario in ((250, hover), (400, lambda steps, _: quadrotor(steps))):
            name = HEXJET_LABELS[rate]
            jobs[name] = rate, flights.fly(scenario(round(seconds * rate), SUBSTEPS)).recorded(name)
            if not isinstance(rotorpy, str):
                evaluations[rate] = rotorpy.evaluations(rate)
                for label, action in ((WHOLE_FLIGHT, rotorpy.whole), (PLANT, rotorpy.plant)):
                    name = f"RotorPy, {label}, {rate} Hz"
                    steps = round(seconds * rate)
                    jobs[name] = rate, Job(name, SUBSTEPS, steps, partial(action, rate, steps))
        pairs = collect([job for _, job in jobs.values()], flights.units(), rounds, on_round)
    rows = {name: pairs[SUBSTEPS, name] for name in jobs}
    hovers = {name: _hover(rate, rows[name], rows[HEXJET_LABELS[rate]]) for name, (rate, _) in jobs.items()}
    return Multirotor(seconds, hovers, None if missing else metadata.version(PACKAGE), evaluations, missing)


def _hover(rate: int, rows: list[Pair], hexjet: list[Pair]) -> Hover:
    return Hover(
        rate,
        Cost.of(rows),
        Spread.of([1.0 / (rate * step.wall) for step, _ in rows]),
        Spread.of([(a.step.cpu / a.unit.cpu) / (b.step.cpu / b.unit.cpu) for a, b in zip(rows, hexjet, strict=True)]),
    )


def find_rotorpy() -> RotorPy | str:
    """Return RotorPy, or the reason why it cannot be used."""
    os.environ.setdefault("MPLBACKEND", "Agg")  # RotorPy imports pyplot
    try:
        return RotorPy()
    except (ImportError, OSError) as error:
        return f"{error}; it comes with: pip install {PACKAGE}"


class RotorPy:
    """RotorPy's Hummingbird in hover, by its geometric controller and noisy motion capture, without wind."""

    def __init__(self) -> None:
        self._environment = import_module("rotorpy.environments").Environment
        self._multirotor = import_module("rotorpy.vehicles.multirotor").Multirotor
        self._parameters = import_module("rotorpy.vehicles.hummingbird_params").quad_params
        self._control = import_module("rotorpy.controllers.quadrotor_control").SE3Control
        self._trajectory = import_module("rotorpy.trajectories.hover_traj").HoverTraj
        self._replays: dict[tuple[int, int], tuple[Callable[..., Any], list[tuple[Any, ...]]]] = {}

    def whole(self, rate: int, steps: int) -> Action:
        """Return the action of ``Environment.run`` without drawing; it raises FlightError if the vehicle drifts."""
        return partial(self._fly, self._build(self._vehicle(), rate), rate, steps)

    def plant(self, rate: int, steps: int) -> Action:
        """Return the action of ``Multirotor.step`` alone, on the states and motor commands of a flight."""
        if (rate, steps) not in self._replays:
            self._replays[rate, steps] = self._replay(rate, steps)
        step, inputs = self._replays[rate, steps]
        return partial(deque, starmap(step, inputs), 0)

    def _replay(self, rate: int, steps: int) -> tuple[Callable[..., Any], list[tuple[Any, ...]]]:
        vehicle, inputs = self._vehicle(), []
        step = vehicle.step

        def note_arguments(*arguments: Any) -> Any:
            inputs.append(arguments)
            return step(*arguments)

        vehicle.step = note_arguments
        self._fly(self._build(vehicle, rate), rate, steps)
        return step, inputs

    def evaluations(self, rate: int, steps: int = 50) -> float:
        """Return how often the equations of motion are evaluated per control step of a whole flight."""
        vehicle = self._vehicle()
        inner, count = vehicle._s_dot_fn, 0

        def count_calls(*arguments: Any) -> Any:
            nonlocal count
            count += 1
            return inner(*arguments)

        vehicle._s_dot_fn = count_calls
        self._fly(self._build(vehicle, rate), rate, steps)
        return count / steps

    def _vehicle(self) -> Any:
        import numpy as np

        numbers = self._parameters
        speed = sqrt(9.81 * numbers["mass"] / (numbers["num_rotors"] * numbers["k_eta"]))  # RotorPy's gravity
        start = {
            "x": np.zeros(3),
            "v": np.zeros(3),
            "q": np.array([0.0, 0.0, 0.0, 1.0]),
            "w": np.zeros(3),
            "wind": np.zeros(3),
            "rotor_speeds": np.full(numbers["num_rotors"], speed),
        }
        return self._multirotor(numbers, initial_state=start)

    def _build(self, vehicle: Any, rate: int) -> Any:
        control = self._control(self._parameters)
        return self._environment(vehicle=vehicle, controller=control, trajectory=self._trajectory(), sim_rate=rate)

    def _fly(self, environment: Any, rate: int, steps: int) -> None:
        # Half a step less, as RotorPy adds up its time and rounding must not add a step.
        end = (steps - 0.5) / rate
        result = environment.run(t_final=end, use_mocap=True, terminate=False, plot=False, verbose=False)
        steps_flown = len(result["time"]) - 1
        if steps_flown != steps:
            raise FlightError(f"RotorPy flew {steps_flown} steps of {steps}: {result['exit'].value}")
        position = [float(value) for value in result["state"]["x"][-1]]
        if not all(abs(value) < MAX_DRIFT_M for value in position):
            raise FlightError(f"RotorPy does not hover: it ends at {position} m")
