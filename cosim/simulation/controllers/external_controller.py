"""A user's controller in place of the built-in one of its level, with the nominal model that it is given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cosim.base.errors import FlightError, InputError
from cosim.base.protocols import Predictor
from cosim.base.signals import AXES
from cosim.control.belief import Belief
from cosim.control.predictors.smith import NoPredictor
from cosim.engine import EngineSpec
from cosim.simulation.controllers.guard import (
    CallGuard,
    GuardedAttitude,
    GuardedController,
    GuardedPredictor,
    GuardedRate,
)
from cosim.simulation.controllers.models import make_belief
from cosim.simulation.controllers.process import ProcessBlock
from cosim.simulation.controllers.source import Source, find_controller_source
from cosim.spec.scenario import Scenario, TorqueCommandDisturbance
from cosim.spec.vehicle import Vehicle


def find_controller(scenario: Scenario) -> Source | None:
    """Return the scenario's user-supplied controller.  Raises InputError if unknown or changed."""
    source = find_controller_source(scenario.controller, scenario.folder, f"unknown controller {scenario.controller!r}")
    if source is not None:
        source.check_hash(scenario.controller_sha256, f"scenario {scenario.name}")
    return source


def resolve_parameters(scenario: Scenario, source: Source | None) -> dict[str, float]:
    """Return the values of a controller's parameters.  Raises InputError for unknown ones."""
    where = f"scenario {scenario.name}: controller_parameters"
    if source is not None:
        return source.resolve_values(scenario.controller_parameters, where)
    for name in scenario.controller_parameters:
        raise InputError(
            f"{where}.{name}: controller {scenario.controller} has none of its own; it is tuned under vehicle.control"
        )
    return {}


class ExternalController:
    """A user's controller at its level, with the models that it receives."""

    def __init__(
        self,
        source: Source,
        parameters: dict[str, float],
        scenario: Scenario,
        vehicle: Vehicle,
        engine: EngineSpec,
        stations: Sequence[EngineSpec],
    ) -> None:
        self.source, self._scenario = source, scenario
        self._guard = CallGuard(source.label)
        self._blocks: list[Any] = []
        self.whole: GuardedController | None = None
        self.attitude: GuardedAttitude | None = None
        self.rate: GuardedRate | None = None
        if source.level == "controller" and any(
            isinstance(disturbance, TorqueCommandDisturbance) for disturbance in scenario.disturbance
        ):
            raise InputError(
                f"scenario {scenario.name}: disturbance: torque_command acts on a rate loop's output, which controller "
                f"{source.label} does not have; take force, moment or wind"
            )
        if source.level == "controller" and scenario.added_delay_samples:
            raise InputError(
                f"scenario {scenario.name}: added_delay_samples = {scenario.added_delay_samples}: is added to a rate "
                f"loop's output, which controller {source.label} does not have; take mismatch.delay_samples"
            )
        self._belief = make_belief(scenario, vehicle, engine, stations, parameters)

    def make_block(self) -> None:
        """Return the user's block, except predictors.  Raises InputError; :meth:`close` frees it."""
        if self.source.level == "controller":
            self.whole = GuardedController(self._prepare(self._belief), self._guard, self._belief)
        elif self.source.level == "rate":
            self.rate = GuardedRate(self._prepare(self._belief), self._guard)
        elif self.source.level == "attitude":
            self.attitude = GuardedAttitude(self._prepare(self._belief), self._guard)

    def make_predictors(self) -> list[Predictor]:
        """Return the predictors that feed the rate loop: the user's, or built-in ones."""
        belief = self._belief
        if self.source.level != "predictor":
            return belief.predictors(self.source.predictor)
        axes = belief.models or (AXES if belief.vehicle.allocation == "rotors" else AXES[:1])
        return [
            GuardedPredictor(self._prepare(belief.for_axis(axis)), self._guard, axis) if axis in axes else NoPredictor()
            for axis in AXES
        ]

    def _prepare(self, belief: Belief) -> Any:
        """Return a new block after its ``prepare`` with the belief.  Raises InputError if that fails."""
        block = self.source.make()
        self._blocks.append(block)
        if isinstance(block, ProcessBlock):  # a process has its own time limit
            block.set_limit(self._scenario.controller_limit_s)
            block.prepare(belief)
            return block
        if hasattr(block, "prepare"):
            try:
                self._guard.call("prepare", block.prepare, belief)
            except FlightError as error:
                raise InputError(str(error)) from error
        return block

    def check_repeatable(self) -> bool | None:
        """Return whether the controller's processes repeat their answers; None: it runs in this process."""
        answers = [block.check_repeatable() for block in self._blocks if isinstance(block, ProcessBlock)]
        return all(answers) if answers else None

    def close(self) -> None:
        for block in self._blocks:
            if hasattr(block, "close"):
                block.close()
