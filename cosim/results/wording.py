"""What metrics are called and in which unit they are shown: one way for terminal, pages and tables.

Files and Python have SI; what a person reads has degrees for angles.
"""

from __future__ import annotations

from math import degrees
from typing import NamedTuple

from cosim.base.signals import AXES


class Metric(NamedTuple):
    """Metric of a report: its key, its label, and the displayed unit with its factor."""

    name: str
    label: str
    unit: str
    factor: float


# What a metric's name ends with, the unit shown, and the factor to it.
UNITS = (
    ("_rad_s", "deg/s", degrees(1.0)),
    ("_rad", "deg", degrees(1.0)),
    ("_percent", "%", 1.0),
    ("_1_s", "1/s", 1.0),
    ("_m_s", "m/s", 1.0),
    ("_kg", "kg", 1.0),
    ("_m", "m", 1.0),
    ("_s", "s", 1.0),
)
METRIC_WORDS = {  # words for the parts of metrics' names
    "rmse": "RMSE",
    "max_abs_error": "largest error",
    "rate_rmse": "rate RMSE",
    "settling_time": "settling time",
    "final_error": "error at the end",
    "oscillation": "residual oscillation",
    "touchdown": "touchdown speed",
    "fuel_burnt": "fuel burnt",
}
WHOLE_FLIGHT = {  # words for metrics of no axis
    "position.drift_m": "drift from the start",
    "position.final_drift_m": "drift at the end",
    "speed.max_m_s": "largest ground speed",
    "position.waypoints_left": "waypoints not reached",
    "speed.final_m_s": "ground speed at the end",
    "effort.saturated_percent": "time in saturation",
    "effort.alternating_percent": "alternating commands",
    "effort.throttle_1_s": "throttle activity",
    "effort.tilt_rad_s": "tilt activity",
}
# The digits behind the point of each metric, in the order in which they are shown.
AXIS_DIGITS = {
    "rmse_rad": 2,
    "max_abs_error_rad": 2,
    "overshoot_percent": 1,
    "settling_time_s": 3,
    "rate_rmse_rad_s": 2,
    "final_error_rad": 3,
    "oscillation_rad": 3,
}
DIGITS = {f"{axis}.{key}": digits for axis in AXES for key, digits in AXIS_DIGITS.items()} | {
    "altitude.rmse_m": 3,
    "altitude.max_abs_error_m": 3,
    "altitude.final_error_m": 3,
    "position.drift_m": 2,
    "position.final_drift_m": 2,
    "position.rmse_m": 2,
    "position.max_abs_error_m": 2,
    "position.final_error_m": 2,
    "position.waypoints_left": 0,
    "speed.max_m_s": 2,
    "speed.final_m_s": 2,
    "touchdown_m_s": 2,
    "effort.saturated_percent": 1,
    "effort.alternating_percent": 0,
    "effort.throttle_1_s": 3,
    "effort.tilt_rad_s": 1,
    "fuel_burnt_kg": 3,
}
NONE = "–"


def metric(name: str) -> Metric:
    """Return the label, unit and factor of a metric: ``roll.rmse_rad`` is the roll RMSE in deg."""
    *axis, last = name.split(".")
    for end, unit, factor in UNITS:
        if last.endswith(end):
            base = last.removesuffix(end)
            words = WHOLE_FLIGHT.get(name) or " ".join([*axis, METRIC_WORDS.get(base, base.replace("_", " "))])
            return Metric(name, words, unit, factor)
    return Metric(name, WHOLE_FLIGHT.get(name) or " ".join([*axis, last.replace("_", " ")]), "", 1.0)


def display_unit(unit: str) -> tuple[str, float]:
    """Return the displayed unit of a log's quantity, and its factor."""
    return {"rad": ("deg", degrees(1.0)), "rad/s": ("deg/s", degrees(1.0))}.get(unit, (unit, 1.0))


def show_value(value: float | None, factor: float = 1.0, digits: int = 3) -> str:
    """Format a value; a dash if the flight cannot tell."""
    return NONE if value is None else f"{factor * value:z.{digits}f}"
