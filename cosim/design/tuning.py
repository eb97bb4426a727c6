"""A controller with everything that can be chosen about it on one channel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cosim.design.frequency import (
    Complex,
    Pair,
    observer_response,
    predictor_response,
)
from cosim.spec.vehicle import (
    EngineLead,
    PredictorTuning,
    RateGains,
    RateModel,
)

CANDIDATES = ("baseline", "smith", "filtered-smith", "state-model", "state-disturbance")
TUNED = {
    "filtered-smith": "filter_s",
    "state-model": "model_observer_rad_s",
    "state-disturbance": "disturbance_observer_rad_s",
}  # what of the predictor's tuning a controller has of its own


@dataclass(frozen=True)
class Tuning:
    """A controller with everything that can be chosen about it on one channel."""

    controller: str
    angle_gain: float  # 1/s
    gains: RateGains
    predictor: PredictorTuning
    model: RateModel  # what the predictor believes
    lead: EngineLead | None = None

    def answer(self) -> Callable[[Complex], Pair]:
        """``P_y`` and ``P_u`` of the predictor."""
        if self.controller == "state-model":
            return observer_response(self.model, self.predictor.model_observer_rad_s, disturbance=False)
        if self.controller == "state-disturbance":
            return observer_response(self.model, self.predictor.disturbance_observer_rad_s, disturbance=True)
        return predictor_response(self.controller, self.model, self.predictor)
