"""The controllers a user can choose: the same cascade and gains, one of these between measurement and rate loop."""

from __future__ import annotations

from collections.abc import Callable

from cosim.base.protocols import Predictor
from cosim.control.predictors.smith import (
    FilteredSmithPredictor,
    NoPredictor,
    SmithPredictor,
    robustness_filter,
)
from cosim.spec.vehicle import PredictorTuning, RateModel

Make = Callable[[RateModel, PredictorTuning], Predictor]


def _filtered_smith(model: RateModel, tuning: PredictorTuning) -> Predictor:
    return FilteredSmithPredictor(model, *robustness_filter(model, tuning.filter_s))


def _state(model: RateModel, tuning: PredictorTuning) -> Predictor:
    from cosim.control.predictors.state import DoubleIntegratorObserver, StateModel, StatePredictor

    observer = DoubleIntegratorObserver(tuning.observer_rad_s, model.sample_time_s)
    return StatePredictor(model, observer, StateModel(model))


def _model_observer(disturbance: bool) -> Make:
    def make(model: RateModel, tuning: PredictorTuning) -> Predictor:
        from cosim.control.predictors.state import (
            ModalPredictor,
            ModelObserver,
            StateModel,
            StatePredictor,
        )

        bandwidth = tuning.disturbance_observer_rad_s if disturbance else tuning.model_observer_rad_s
        if len(model.poles) != 2 or model.pole_pairs or model.zero_pairs:
            return ModalPredictor(model, bandwidth, disturbance)
        state = StateModel(model)
        return StatePredictor(model, ModelObserver(state, bandwidth, disturbance), state)

    return make


PREDICTORS: dict[str, Make] = {
    "baseline": lambda model, tuning: NoPredictor(),
    "smith": lambda model, tuning: SmithPredictor(model),
    "filtered-smith": _filtered_smith,
    "state": _state,
    "state-model": _model_observer(disturbance=False),
    "state-disturbance": _model_observer(disturbance=True),
}
TITLES = {
    "baseline": "cascaded P and PID, fed with the measured rate",
    "smith": "the same gains, fed with Smith's predictor (paper)",
    "filtered-smith": "Smith's predictor with a robustness filter: no offset under a constant disturbance (ours)",
    "state": "d-step state predictor with a double-integrator observer (paper)",
    "state-model": "d-step state predictor with an observer of the identified model (ours)",
    "state-disturbance": "the same, with the input disturbance estimated and predicted (ours, after Sanz et al.)",
}
