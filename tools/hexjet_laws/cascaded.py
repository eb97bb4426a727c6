"""The built-in PID with each of the built-in predictors, tuned as the other laws are.

    u = p (r - y^) + i integral(r - y^) - d y^'

with ``y^`` from the predictor: see :class:`cosim.laws.RateAxis`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cosim.base.protocols import Parameter
from cosim.laws import PREDICTORS, Axis, AxisLaw, Pid, RateAxis, RateLaw, attitude_gain_parameter, positive_parameter


def _make_gain_parameters(a: float, p: float, i: float, d: float) -> tuple[Parameter, ...]:
    return (
        attitude_gain_parameter(a),
        positive_parameter("p", p, "proportional gain times k theta"),
        positive_parameter("i", i, "integral over proportional gain [1/s] times theta", 0.0),
        positive_parameter("d", d, "derivative over proportional gain [s] over theta", 0.0),
    )


class Cascaded(RateLaw):
    """PID without predictor, tuned to a peak sensitivity of 1.7 like the other laws."""

    predictor: ClassVar[str] = "baseline"
    parameters = _make_gain_parameters(0.2414, 0.7053, 0.1938, 0.4911)

    def make_axis_law(self, axis: Axis, values: Mapping[str, float]) -> AxisLaw:
        """Return the PID, its derivative filtered at a tenth of its lead but no faster than a step."""
        vehicle, theta = axis.belief.vehicle, axis.delay
        p = values["p"] / (axis.gain * theta)
        d = values["d"] * theta
        gains = getattr(vehicle.control.rate, axis.name).model_copy(
            update={"p": p, "i": p * values["i"] / theta, "d": p * d, "d_filter_s": max(axis.step, 0.1 * d)}
        )
        spec = PREDICTORS[self.predictor]
        tuning = {parameter.name: values["predictor"] * parameter.scale(theta) for parameter in spec.parameters}
        predictor = spec.predictor(axis.model, spec.tuned(vehicle.control.predictor, tuning))
        return Pid(RateAxis(gains, predictor, axis.step))


class Smith(Cascaded):
    """PID with Smith's predictor (O. J. M. Smith, 1957), as in the paper."""

    predictor = "smith"
    parameters = _make_gain_parameters(0.4926, 2.305, 0.08939, 0.3639)


class FilteredSmith(Cascaded):
    """PID with Smith's predictor behind a robustness filter (Normey-Rico and Camacho, 2007)."""

    predictor = "filtered-smith"
    parameters = (
        *_make_gain_parameters(0.2476, 0.7396, 0.2357, 0.3533),
        positive_parameter("predictor", 0.4134, "time constant of the filter over theta"),
    )


class StatePredictor(Cascaded):
    """PID with the paper's state predictor."""

    predictor = "state"
    parameters = (
        *_make_gain_parameters(0.3866, 1.13, 0.1345, 0.1375),
        positive_parameter("predictor", 11.2, "bandwidth of the observer times theta"),
    )


class StateDisturbance(Cascaded):
    """PID with the state predictor that estimates a disturbance of the input (after Sanz et al., 2016)."""

    predictor = "state-disturbance"
    parameters = (
        *_make_gain_parameters(0.2821, 0.9686, 0.36, 0.01454),
        positive_parameter("predictor", 59.91, "bandwidth of the observer times theta"),
    )
