"""The same airframe in JSBSim, hovering in a block diagram of PathSim's: what a loop in plain Python would cost.

PathSim is optional; where it is missing that is stated with the reason.  Its blocks: the airframe, which takes a force
and makes the JSBSim runs of a control step, a law that holds the height, and a scope that keeps all outputs in memory.
No engines, no sensors, no predictor, no log on disk: ours has all of these in its step.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

from benchmarks.measures.speed import RECORDED, Flights, bare, collect
from benchmarks.timing import Action, Cost, Job, Spread, ratio
from cosim import FlightError
from cosim.base.constants import GRAVITY
from cosim.simulation.step import Simulation

PACKAGE = "pathsim"
SUBSTEPS = 4  # as in the shipped scenarios
LABEL = "PathSim with JSBSim"
NEWTON_LBF, FOOT_M = 1.0 / 4.4482216152605, 0.3048
OUTPUTS = (
    *("position/h-agl-ft", "velocities/h-dot-fps"),
    *("attitude/phi-rad", "attitude/theta-rad", "attitude/psi-rad"),
    *("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec"),
)
MAX_DRIFT_FT = 1.0  # else it does not hover


@dataclass(frozen=True)
class BlockDiagram:
    """Cost of a step of hover, recorded to disk, in PathSim and here; ``ratio``: PathSim's by ours, by rounds.

    ``missing``: why PathSim was not measured.
    """

    steps: int
    ours: Cost
    cost: Cost | None
    ratio: Spread | None
    version: str | None
    missing: str | None


def measure_block_diagram(steps: int, rounds: int, folder: Path, on_round: Callable[[], object]) -> BlockDiagram:
    """Time hover here and in PathSim in interleaved rounds."""
    pathsim = find_pathsim()
    missing = pathsim if isinstance(pathsim, str) else None
    with Flights(steps, folder) as flights:
        jobs = [flights.recorded(SUBSTEPS)]
        if not isinstance(pathsim, str):
            jobs.append(Job(LABEL, SUBSTEPS, steps, partial(pathsim.hover, flights.build(SUBSTEPS), steps)))
        pairs = collect(jobs, flights.units(), rounds, on_round)
    ours, theirs = pairs[SUBSTEPS, RECORDED], pairs.get((SUBSTEPS, LABEL))
    if theirs is None:
        return BlockDiagram(steps, Cost.of(ours), None, None, None, missing)
    return BlockDiagram(steps, Cost.of(ours), Cost.of(theirs), ratio(theirs, ours), metadata.version(PACKAGE), None)


def find_pathsim() -> PathSim | str:
    """Return PathSim, or the reason why it cannot be used."""
    os.environ.setdefault("MPLBACKEND", "Agg")  # PathSim imports pyplot
    try:
        return PathSim()
    except (ImportError, OSError) as error:
        return f"{error}; it comes with: pip install {PACKAGE}"


class PathSim:
    """PathSim's classes, and the block diagram that is built of them."""

    def __init__(self) -> None:
        pathsim, blocks = import_module("pathsim"), import_module("pathsim.blocks")
        self._simulation, self._connection = pathsim.Simulation, pathsim.Connection
        self._function, self._scope = blocks.Function, blocks.Scope
        self._plant = _plant_class(blocks.Block)

    def hover(self, simulation: Simulation, steps: int) -> Action:
        """Return the action of ``steps`` control steps of hover; it raises FlightError if the vehicle drifts."""
        bare(simulation, 0)  # resets the airframe to hover
        plant = self._plant(simulation)
        height, lift = float(plant.outputs[0]), simulation.vehicle.mass_kg / len(simulation.vehicle.jets)

        def law(now: float, climb: float) -> float:
            return -lift * (GRAVITY + FOOT_M * (4.0 * (height - now) - 4.0 * climb))

        control, scope, connect = self._function(law), self._scope(), self._connection
        wires = [connect(plant[0], control[0]), connect(plant[1], control[1]), connect(control, plant)]
        wires += [connect(plant[index], scope[index]) for index in range(len(OUTPUTS))]
        step = simulation.scenario.step_s
        diagram = self._simulation([plant, control, scope], wires, dt=step, log=False)

        def action() -> None:
            diagram.run(duration=(steps - 0.5) * step, adaptive=False)  # half a step less, for rounding
            times, columns = scope.read()
            if len(times) != steps + 1:
                raise FlightError(f"PathSim flew {len(times) - 1} steps of {steps}")
            if not abs(float(columns[0][-1]) - height) < MAX_DRIFT_FT:
                raise FlightError(f"PathSim does not hover: it ends {columns[0][-1] - height:g} ft off")

        return action


def _plant_class(block: Any) -> Any:
    """Return the class of the airframe's block: input force [N, down], JSBSim runs at a step's end, outputs."""

    class Plant(block):  # type: ignore[misc]
        def __init__(self, simulation: Simulation) -> None:
            super().__init__()
            self.fdm, self.runs = simulation.airframe._fdm, simulation.scenario.substeps
            self.forces = [f"external_reactions/jet{n}/z" for n, _ in enumerate(simulation.vehicle.jets, 1)]
            self.read_outputs()

        def __len__(self) -> int:
            return 0  # no direct feed-through

        def update(self, t: float) -> None:
            """Nothing between the steps."""

        def sample(self, t: float, dt: float) -> None:
            fdm, lift = self.fdm, NEWTON_LBF * float(self.inputs[0])
            for name in self.forces:
                fdm.set_property_value(name, lift)
            for _ in range(self.runs):
                fdm.run()
            self.read_outputs()

        def read_outputs(self) -> None:
            self.outputs.update_from_array([self.fdm.get_property_value(name) for name in OUTPUTS])

    return Plant
