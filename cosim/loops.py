"""The loop of one axis: its blocks as they fly, to be stepped with another plant, and its frequency response.

Rates are rad/s, angles rad, times s, frequencies Hz, gains dB and phases deg; ``z`` are points on the upper half of
the unit circle, an array of complex numbers, and a response is an array as long.  ``PREDICTORS`` is every predictor
that flies, a mapping from its name to its ``PredictorSpec``.
"""

from cosim.control.frequency import grid, impulse_response, pid_response, zeros_outside
from cosim.control.margins import (
    LoopMargins,
    crossings,
    delayed_margins,
    loop_margins,
    proper_fraction,
    sample_delayed,
)  # fmt: skip
from cosim.control.predictors.linear import delayed_response, model_response
from cosim.control.predictors.registry import PREDICTORS, PredictorSpec
from cosim.control.predictors.smith import DelayedModel, DelayLine, rate_model
from cosim.control.predictors.state import DoubleIntegratorObserver, StateModel, StatePredictor
from cosim.control.rate import RateAxis
from cosim.results.metrics import overshoot, settling_time
from cosim.spec.vehicle import PredictorTuning, RateGains, RateModel

__all__ = [
    "PREDICTORS", "DelayLine", "DelayedModel", "DoubleIntegratorObserver", "LoopMargins", "PredictorSpec",
    "PredictorTuning", "RateAxis", "RateGains", "RateModel", "StateModel", "StatePredictor", "crossings",
    "delayed_margins", "delayed_response", "grid", "impulse_response", "loop_margins", "model_response",
    "overshoot", "pid_response", "proper_fraction", "rate_model", "sample_delayed", "settling_time",
    "zeros_outside",
]  # fmt: skip
