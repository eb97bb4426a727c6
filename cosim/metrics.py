"""What a flight's log says in numbers: pure functions of its columns.

Errors are set-point minus true angle, wrapped to (-pi, pi], where a set-point exists.  Overshoot and settling time are
stated only for a set-point that moves in steps and nothing but steps: it is constant for at least ``HOLD_S`` after each
of its changes.  A set-point that differs from the attitude at the start of the flight is a step at that moment.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from cosim.columns import RATES
from cosim.config import nearest
from cosim.scenario import Range
from cosim.signals import AXES

Array = NDArray[np.float64]

HOLD_S = 0.2  # chosen by us: shorter than any doublet worth flying, longer than the holds of recorded sticks at 10 Hz
SMALLEST_STEP_RAD = 1e-3  # chosen by us: a smaller offset at the start is trim or noise, not a command
SETTLING_BAND = 0.05  # of the step's size, the common 5 % convention
FINAL_S = 1.0  # the end of the flight that tells whether it is at rest
FLIGHT_M = 0.2  # chosen by us: less is a hop at take-off or a bounce


class Record(BaseModel):
    """A frozen record of a summary; keys that a newer version wrote are left aside."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class AxisMetrics(Record):
    """One axis.  None stands for what this flight cannot tell."""

    commanded: bool  # its set-point changes during the flight, or differs from the attitude at the start
    rmse_rad: float | None = None
    max_abs_error_rad: float | None = None
    overshoot_percent: float | None = None  # of the step's size, past it in its direction; worst step
    settling_time_s: float | None = None  # from a step until within 5 % of its size for good; worst step
    rate_rmse_rad_s: float | None = None  # true rate against its set-point
    final_error_rad: float | None = None  # mean absolute error over the last second
    oscillation_rad: float | None = None  # half the peak-to-peak of the error over the last second


class AltitudeMetrics(Record):
    """Height above the ground against its set-point."""

    rmse_m: float | None = None
    max_abs_error_m: float | None = None


class Metrics(Record):
    """Everything that is measured of one flight."""

    axes: dict[str, AxisMetrics]
    altitude: AltitudeMetrics
    touchdown_m_s: float | None = None  # descent speed just before the first contact after a flight


class Columns(Protocol):
    """The columns of a log by name."""

    def __getitem__(self, name: str) -> Array: ...


class Step(NamedTuple):
    """One step of a set-point: it acts on rows ``first`` to ``end - 1``."""

    first: int
    end: int
    size: float  # rad, with its sign


def flight_metrics(log: Columns, step_s: float) -> Metrics:
    """The metrics of a whole flight; ``step_s`` is the control step.  At most five columns are held at a time."""
    return Metrics(
        axes={axis: _axis_of(log, axis, rate, step_s) for axis, rate in zip(AXES, RATES, strict=True)},
        altitude=altitude_metrics(log["altitude_setpoint_m"], log["altitude_m"]),
        touchdown_m_s=touchdown(
            (log["on_ground"] > 0.0) | (log["hull_contact"] > 0.0), log["altitude_m"], log["velocity_down_m_s"]
        ),
    )


def columns() -> tuple[str, ...]:
    """The names of the columns that :func:`flight_metrics` reads."""
    names = [name for axis, rate in zip(AXES, RATES, strict=True) for name in _axis_columns(axis, rate)]
    return (*names, "altitude_setpoint_m", "altitude_m", "on_ground", "hull_contact", "velocity_down_m_s")


def _axis_columns(axis: str, rate: str) -> tuple[str, str, str, str]:
    return f"{axis}_setpoint_rad", f"{axis}_rad", f"rate_{rate}_setpoint_rad_s", f"rate_{rate}_rad_s"


def _axis_of(log: Columns, axis: str, rate: str, step_s: float) -> AxisMetrics:
    setpoint, angle, rate_setpoint, true_rate = (log[name] for name in _axis_columns(axis, rate))
    return axis_metrics(setpoint, angle, rate_setpoint, true_rate, step_s)


def axis_metrics(setpoint: Array, angle: Array, rate_setpoint: Array, rate: Array, step_s: float) -> AxisMetrics:
    """The metrics of one axis from its columns (rad, rad/s)."""
    error = wrap(setpoint - angle)
    last = error[-round(FINAL_S / step_s) :]
    last = last[np.isfinite(last)]
    steps = find_steps(setpoint, angle, step_s)
    return AxisMetrics(
        commanded=bool(steps) or bool(np.any(np.diff(setpoint[np.isfinite(setpoint)]) != 0.0)),
        rmse_rad=_rms(error),
        max_abs_error_rad=_largest(np.abs(error)),
        overshoot_percent=_worst([overshoot(error[s.first : s.end], s.size) for s in steps]),
        settling_time_s=_worst([settling_time(error[s.first : s.end], s.size, step_s) for s in steps]),
        rate_rmse_rad_s=_rms(rate_setpoint - rate),
        final_error_rad=float(np.mean(np.abs(last))) if last.size else None,
        oscillation_rad=float(0.5 * np.ptp(last)) if last.size else None,
    )


def find_steps(setpoint: Array, angle: Array, step_s: float) -> list[Step]:
    """The steps of a set-point (rad); none if it ever moves in another way or is missing on some row."""
    if not setpoint.size or not np.all(np.isfinite(setpoint)):
        return []
    changes = np.flatnonzero(np.diff(setpoint) != 0.0) + 1
    starts = setpoint[changes - 1]
    held = np.diff(np.concatenate((changes, [setpoint.size])))
    if abs(wrap(setpoint[:1] - angle[:1])[0]) > SMALLEST_STEP_RAD:
        held = np.append(changes[0] if changes.size else setpoint.size, held)
        changes, starts = np.append(0, changes), np.append(angle[0], starts)
    if np.any(held < HOLD_S / step_s - 0.5):  # half a row, against rounding
        return []
    targets = setpoint[changes]
    return [
        Step(int(first), int(first + rows), float(size))
        for first, rows, size in zip(changes, held, wrap(targets - starts), strict=True)
    ]


def overshoot(error: Array, size: float) -> float | None:
    """How far a response runs past its target, in percent of the step's size; ``error`` is target minus response."""
    past = _largest(-error * np.sign(size))
    return None if past is None else max(0.0, 100.0 * past / abs(size))


def settling_time(error: Array, size: float, step_s: float) -> float | None:
    """Time from a step's first row to the first row from which the error stays within 5 % of the step's size.

    None if the last row is outside.
    """
    outside = np.flatnonzero(~(np.abs(error) <= SETTLING_BAND * abs(size)))
    settled = int(outside[-1]) + 1 if outside.size else 0
    return None if settled == error.size else settled * step_s


def altitude_metrics(setpoint: Array, altitude: Array) -> AltitudeMetrics:
    """Height error (m) on the rows that have a set-point."""
    error = setpoint - altitude
    return AltitudeMetrics(rmse_m=_rms(error), max_abs_error_m=_largest(np.abs(error)))


def touchdown(contact: NDArray[np.bool_], altitude: Array, velocity_down: Array) -> float | None:
    """Descent speed (m/s) on the last row before the first contact that ends a flight.

    A flight is a stretch in the air that was at least ``FLIGHT_M`` above where it ends.
    """
    edges = np.diff(contact.astype(np.int8))
    landings = np.flatnonzero(edges == 1) + 1
    departures = np.append(0, np.flatnonzero(edges == -1) + 1)
    for row in landings:
        since = departures[departures < row][-1]
        if np.max(altitude[since:row]) - altitude[row] >= FLIGHT_M:
            return float(velocity_down[row - 1])
    return None


def wrap(angle: Array) -> Array:
    """Angles (rad) brought to (-pi, pi]; those within it are not touched."""
    return np.where(np.abs(angle) <= pi, angle, pi - np.mod(pi - angle, 2.0 * pi))


def flatten(metrics: Metrics) -> dict[str, float | None]:
    """Every metric under the name that an expectation uses, such as ``roll.overshoot_percent``."""
    flat: dict[str, float | None] = {}
    for axis, of_axis in metrics.axes.items():
        flat |= {f"{axis}.{name}": value for name, value in of_axis.model_dump(exclude={"commanded"}).items()}
    flat |= {f"altitude.{name}": value for name, value in metrics.altitude.model_dump().items()}
    return flat | {"touchdown_m_s": metrics.touchdown_m_s}


def metric_names() -> list[str]:
    """Every name that an expectation may use."""
    nothing = AxisMetrics(commanded=False)
    return list(flatten(Metrics(axes=dict.fromkeys(AXES, nothing), altitude=AltitudeMetrics())))


def check_expectations(flat: Mapping[str, float | None], expected: Mapping[str, Range]) -> list[str]:
    """One line for every expectation that is not met, or that names no metric."""
    complaints = []
    for name, allowed in expected.items():
        if name not in flat:
            complaints.append(f"unknown metric {name!r}; {nearest(name, flat)}")
            continue
        value = flat[name]
        low, high = allowed.min, allowed.max
        if value is None:
            complaints.append(f"{name}: this flight has none, expected {_span(low, high)}")
        elif (low is not None and value < low) or (high is not None and value > high):
            complaints.append(f"{name} = {value:.6g}, expected {_span(low, high)}")
    return complaints


def _span(low: float | None, high: float | None) -> str:
    if low is None:
        return f"at most {high:g}"
    return f"at least {low:g}" if high is None else f"{low:g} to {high:g}"


def _rms(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    largest = float(np.max(np.abs(known), initial=0.0))
    if not largest:
        return 0.0 if known.size else None
    return largest * float(np.sqrt(np.mean(np.square(known / largest))))  # scaled: no square overflows


def _largest(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.max(known)) if known.size else None


def _worst(values: list[float | None]) -> float | None:
    """The largest; None if there are none, or if one of them is None."""
    known = [value for value in values if value is not None]
    return max(known) if known and len(known) == len(values) else None
