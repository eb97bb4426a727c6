"""The information for a user-supplied controller before its first flight: nominal data, never the true state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from cosim.base.protocols import Predictor
from cosim.control.allocation.engine_monitor import EngineReference
from cosim.control.allocation.thrust_map import ThrustMap
from cosim.spec.vehicle import RateModel, Vehicle


@dataclass(frozen=True)
class Belief:
    """The nominal vehicle and the identified engines, as a controller may use them.

    It contains no mismatch, no fault and no true state.

    Attributes
    ----------
    step_s : float
        The control step [s].
    vehicle : Vehicle
        As stated, with the gains of the built-in controller in ``vehicle.control``.
    models : mapping of RateModel
        From torque to body rate with this engine, by axis; empty where none was identified.  The delay that the
        scenario adds to the controller's roll command is in the model of roll.
    thrust_map : ThrustMap
        From shares of thrust to throttles.
    hover : float
        The share at which the vehicle hovers, tank full.
    parameters : mapping of float
        The controller's own, by name.
    axis : str
        Of a predictor the axis that it is for; else empty.
    on_ground : bool
        The flight begins standing.
    """

    step_s: float
    vehicle: Vehicle
    models: Mapping[str, RateModel]
    thrust_map: ThrustMap
    hover: float
    parameters: Mapping[str, float]
    axis: str
    on_ground: bool
    measured_engines: Callable[[], Sequence[EngineReference]]
    built_in: Callable[[str], list[Predictor]]

    @cached_property
    def engines(self) -> Sequence[EngineReference]:
        """The engine of each jet: thrust at rest [N] by throttle, and its lag [s] behind its delay [s]."""
        return self.measured_engines()

    @property
    def model(self) -> RateModel | None:
        """The identified model of :attr:`axis`, or None."""
        return self.models.get(self.axis)

    def predictors(self, name: str) -> list[Predictor]:
        """Return the built-in predictors of a name, for roll, pitch and yaw.  Raises InputError as a flight does."""
        return self.built_in(name)

    def for_axis(self, axis: str) -> Belief:
        """Return a copy with :attr:`axis` set, so that :attr:`model` is that of this axis."""
        return replace(self, axis=axis)
