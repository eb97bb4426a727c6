"""What a control law of one's own is made of: one law for every axis that has an identified response.

A package that states a law as ``"controller.mine" = "mine:Mine"`` in the entry points ``hexjet.plugins`` derives it
from :class:`RateLaw`; ``tools/hexjet_laws`` has six such laws.  Rates are rad/s, times s, commands the axis' own.
``PREDICTORS`` is every predictor that flies, a mapping from its name to its ``PredictorSpec``; ``Array`` is an array of
numbers in double precision.

Examples
--------
>>> from cosim.laws import Axis, AxisLaw, RateLaw, positive_parameter
>>> class Mine(RateLaw):
...     parameters = (positive_parameter("gain", 0.5, "of the rate error, times the delay's own gain"),)
"""

from cosim.base.arrays import Array
from cosim.base.limits import clamp
from cosim.control.autopilot.geometry import wrap
from cosim.control.belief import Belief
from cosim.control.laws.axis import (
    Actuators,
    Axis,
    AxisLaw,
    Pid,
    RateLaw,
    attitude_gain_parameter,
    low_frequency_delay,
    positive_parameter,
)
from cosim.control.predictors.linear import cascade
from cosim.control.predictors.registry import PREDICTORS
from cosim.control.rate import RateAxis
from cosim.spec.vehicle import RateModel

__all__ = [
    "PREDICTORS", "Actuators", "Array", "Axis", "AxisLaw", "Belief", "Pid", "RateAxis", "RateLaw", "RateModel",
    "attitude_gain_parameter", "cascade", "clamp", "low_frequency_delay", "positive_parameter", "wrap",
]  # fmt: skip
