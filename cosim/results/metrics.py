"""What a flight's log says in numbers: pure functions of its columns.

Errors are set-point minus true angle, wrapped to (-pi, pi], where a set-point exists.  Overshoot and settling time are
stated only for a set-point that moves in steps and nothing but steps: it is constant for at least ``HOLD_S`` after each
of its changes.  A set-point that differs from the attitude at the start of the flight is a step at that moment.

What is said of an axis at the end is the mean over the last second; of height, place and speed, that of the last row.
docs/metrics.md has every definition.

Columns may be tables of many flights, a line for each or one that all share, and metrics are arrays then: of whole
flights in the air all the time, whose columns have a number everywhere or nowhere.
"""

from collections.abc import Iterable, Iterator, Mapping
from functools import cache, lru_cache
from math import pi
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from cosim.base.arrays import Array
from cosim.base.errors import nearest
from cosim.base.protocols import Columns
from cosim.base.signals import AXES, JETS
from cosim.results.contacts import find_contact_rows, height_error
from cosim.results.log.columns import HEXJET, RATES, LoggedVehicle, jets_in, log_columns, logged_vehicle_of, servos_in
from cosim.spec.scenario import Range

R = TypeVar("R", bound="Record")  # kind of a record
# Chosen by us: smaller offsets at the start are trim or noise and not a command.
MIN_STEP_RAD = 1e-3
SETTLING_BAND = 0.05  # fraction of the step's size
FINAL_WINDOW_S = 1.0  # window at the end of the flight
REFUSED = ("refused_roll", "refused_pitch", "refused_yaw", "refused_collective")  # columns of what was not allocated
POSITION_SETPOINT = ("north_setpoint_m", "east_setpoint_m")  # columns of the commanded position
WIND = ("wind_north_m_s", "wind_east_m_s", "wind_down_m_s")  # columns of the wind
# Columns of disturbances other than wind begin with these.
UPSETS = ("disturbance_", "payload_kg", "fault_")
WAYPOINTS_LEFT = "waypoints_left"  # column of scripts with waypoints
THROTTLE, HEALTH, FLOW = "throttle_{}", "health_{}", "fuel_flow_{}_kg_s"  # columns of a jet
TILT = "tilt_{}_command_rad"  # column of a tilt servo's command
DEFLECTION = "deflection_{}_command"  # column of a surface's command


class Record(BaseModel):
    """Frozen record of a summary, which ignores keys of newer versions."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, defer_build=True)


class AxisMetrics(Record):
    """Metrics of one axis; None: not measurable in this flight."""

    commanded: bool  # set-point moves or begins elsewhere
    rmse_rad: float | None = None  # root mean square of the error
    max_abs_error_rad: float | None = None  # largest magnitude of the error
    overshoot_percent: float | None = None  # of the worst step, in % of its size
    settling_time_s: float | None = None  # s, worst step, until it stays within 5 %
    rate_rmse_rad_s: float | None = None  # RMSE of the true rate to its set-point
    final_error_rad: float | None = None  # mean |error| over the last second
    oscillation_rad: float | None = None  # half peak-to-peak over the last second


class AltitudeMetrics(Record):
    """Height above the ground against its set-point."""

    rmse_m: float | None = None  # root mean square of the error
    max_abs_error_m: float | None = None  # largest magnitude of the error
    final_error_m: float | None = None  # error at the last row


class PositionMetrics(Record):
    """Horizontal position: distance from the start, and from the commanded position if any."""

    drift_m: float | None = None  # largest distance from the start
    final_drift_m: float | None = None  # distance from the start at the end
    rmse_m: float | None = None  # RMS distance from the commanded place
    max_abs_error_m: float | None = None  # largest distance from commanded place
    final_error_m: float | None = None  # distance from commanded place at the end
    waypoints_left: float | None = None  # waypoints not reached at the end


class SpeedMetrics(Record):
    """Horizontal speed over the ground."""

    max_m_s: float | None = None  # largest speed
    final_m_s: float | None = None  # speed at the end


class EffortMetrics(Record):
    """Use of the actuators: saturation and activity."""

    saturated_percent: float | None = None  # of the steps in the air
    alternating_percent: float | None = None  # of steps: worst command, worst second
    throttle_1_s: float | None = None  # travel per second, mean over the jets
    tilt_rad_s: float | None = None  # travel per second of a servo's command


class Metrics(Record):
    """All metrics of one flight."""

    axes: dict[str, AxisMetrics]
    altitude: AltitudeMetrics
    touchdown_m_s: float | None = None  # sink rate before the first contact
    position: PositionMetrics = Field(default_factory=PositionMetrics)
    speed: SpeedMetrics = Field(default_factory=SpeedMetrics)
    effort: EffortMetrics = Field(default_factory=EffortMetrics)
    fuel_burnt_kg: float | None = None  # between the first and the last row


class Reach(Record):
    """Ranges of the actuators' commands."""

    throttle: tuple[tuple[float, float], ...]  # range of each jet, jet 1 first
    tilt_rad: float | None = None  # two banks: largest tilt either way
    servos: tuple[tuple[float, float], ...] | None = None  # range of each hinge and surface


class Step(NamedTuple):
    """One step of a set-point, which acts on rows ``first`` to ``end - 1``."""

    first: int
    end: int
    size: float  # rad, signed


def flight_metrics(log: Columns, step_s: float, reach: Reach | None = None) -> Metrics:
    """Return the metrics of a whole flight; ``step_s`` is the control step.  A few columns at a time are held.

    Without ``reach`` only what allocation refused counts as saturation.
    """
    axes = {axis: _axis_metrics(log, axis, rate, step_s) for axis, rate in zip(AXES, RATES, strict=True)}
    contact, jets = find_contact_rows(log), jets_in(log.columns)
    saturated, flying = saturation_in_flight(log, reach), np.count_nonzero(~contact)
    altitude, speed = log["altitude_m"], np.hypot(log["velocity_north_m_s"], log["velocity_east_m_s"])
    return _to_record(
        Metrics,
        axes=axes,
        altitude=altitude_metrics(log["altitude_setpoint_m"], altitude, contact),
        touchdown_m_s=touchdown(contact, altitude, log["velocity_down_m_s"]),
        position=_position_metrics(log),
        speed=_to_record(SpeedMetrics, max_m_s=_peak(speed), final_m_s=_last_value(speed)),
        effort=_to_record(
            EffortMetrics,
            saturated_percent=_to_plain(100.0 * np.count_nonzero(saturated, axis=-1) / flying) if flying else None,
            alternating_percent=alternating_percent(_ranges(log, reach), step_s),
            throttle_1_s=activity((log[name] for name in _jet_columns(THROTTLE, jets)), step_s),
            tilt_rad_s=activity((log[TILT.format(name)] for name in servos_in(log.columns)), step_s),
        ),
        fuel_burnt_kg=fuel_burnt(log["fuel_kg"], (log[name] for name in _jet_columns(FLOW, jets)), step_s),
    )


@lru_cache(16)
def columns(vehicle: LoggedVehicle = HEXJET, waypoints: bool = False) -> tuple[str, ...]:
    """Return the log columns of a vehicle that the metrics and limits of a flight are computed from.

    ``waypoints``: of a flight along some.
    """
    jets = max(vehicle.jets, JETS)
    names = [name for axis, rate in zip(AXES, RATES, strict=True) for name in _axis_columns(axis, rate)]
    return (
        *names,
        *("altitude_setpoint_m", "altitude_m", "on_ground", "hull_contact", "velocity_down_m_s"),
        *("north_m", "east_m", *POSITION_SETPOINT, "velocity_north_m_s", "velocity_east_m_s"),
        *([WAYPOINTS_LEFT] if waypoints else ()),
        *(
            *REFUSED,
            *_jet_columns(THROTTLE, jets),
            *_jet_columns(HEALTH, jets),
            *_servo_columns(vehicle),
            *_jet_columns(FLOW, jets),
            "fuel_kg",
        ),
        *WIND,
        *(column.name for column in log_columns(vehicle) if column.name.startswith(UPSETS)),
    )


def _servo_columns(vehicle: LoggedVehicle) -> list[str]:
    """Return the command columns of servos: banks and hinges, and behind them surfaces."""
    return [TILT.format(name) for name in vehicle.servos] + [DEFLECTION.format(name) for name in vehicle.surfaces]


def _jet_columns(pattern: str, jets: int) -> list[str]:
    return [pattern.format(jet) for jet in range(1, jets + 1)]


def _axis_columns(axis: str, rate: str) -> tuple[str, str, str, str]:
    return f"{axis}_setpoint_rad", f"{axis}_rad", f"rate_{rate}_setpoint_rad_s", f"rate_{rate}_rad_s"


def _axis_metrics(log: Columns, axis: str, rate: str, step_s: float) -> AxisMetrics:
    setpoint, angle, rate_setpoint, true_rate = (log[name] for name in _axis_columns(axis, rate))
    error = wrap(setpoint - angle)
    last = _finite_values(error[..., -round(FINAL_WINDOW_S / step_s) :])
    steps, percent, seconds = _measure_steps(setpoint, angle, error, step_s)
    return _to_record(
        AxisMetrics,
        commanded=bool(steps) or bool(np.any(np.diff(setpoint[np.isfinite(setpoint)]) != 0.0)),
        rmse_rad=_rms(error),
        max_abs_error_rad=_peak(np.abs(error)),
        overshoot_percent=percent,
        settling_time_s=seconds,
        rate_rmse_rad_s=_rms(rate_setpoint - true_rate),
        final_error_rad=_to_plain(np.mean(np.abs(last), axis=-1)) if last.size else None,
        oscillation_rad=_to_plain(0.5 * np.ptp(last, axis=-1)) if last.size else None,
    )


def _measure_steps(setpoint: Array, angle: Array, error: Array, step_s: float) -> tuple[list[Step], Any, Any]:
    """Return the steps of a set-point, and the worst overshoot and settling time of the responses."""
    if error.ndim > 1 and not (len(setpoint) == 1 and np.all(angle[:, 0] == angle[0, 0])):
        tables = np.broadcast_arrays(setpoint, angle, error)
        each = [_measure_steps(a, b, c, step_s)[1:] for a, b, c in zip(*tables, strict=True)]
        return [], *np.array(each, dtype=float).T
    steps = find_steps(np.ravel(setpoint), np.ravel(angle[..., :1]), step_s)
    answers = [(error[..., first:end], size) for first, end, size in steps]
    over = _max_or_none([overshoot(answer, size) for answer, size in answers])
    return steps, over, _max_or_none([settling_time(answer, size, step_s) for answer, size in answers])


def find_steps(setpoint: Array, angle: Array, step_s: float, hold_s: float = 0.2) -> list[Step]:
    """Return the steps of a set-point (rad); none if it also moves otherwise or is missing in some row.

    ``hold_s``: shorter than any doublet worth flying, longer than the holds of recorded sticks at 10 Hz.
    """
    if not setpoint.size or not np.all(np.isfinite(setpoint)):
        return []
    changes = np.flatnonzero(np.diff(setpoint) != 0.0) + 1
    starts = setpoint[changes - 1]
    lengths = np.diff(np.concatenate((changes, [setpoint.size])))
    if abs(wrap(setpoint[:1] - angle[:1])[0]) > MIN_STEP_RAD:
        lengths = np.append(changes[0] if changes.size else setpoint.size, lengths)
        changes, starts = np.append(0, changes), np.append(angle[0], starts)
    if np.any(lengths < hold_s / step_s - 0.5):  # half a row of tolerance for rounding
        return []
    targets = setpoint[changes]
    return [
        Step(int(first), int(first + rows), float(size))
        for first, rows, size in zip(changes, lengths, wrap(targets - starts), strict=True)
    ]


def overshoot(error: Array, size: float) -> Any:
    """Return how far a response runs past its target, in percent of the step's size; None without a number.

    ``error`` is target minus response, one value a row; ``size`` is the step's, in the same unit.

    >>> overshoot(np.array([1.0, 0.2, -0.1, 0.0]), size=1.0)
    10.0
    """
    past = _peak(-error * np.sign(size))
    return None if past is None else _to_plain(np.maximum(100.0 * past / abs(size), 0.0))


def settling_time(error: Array, size: float, step_s: float) -> Any:
    """Return the time [s] from a step until the error stays within 5 % of its size.

    None if the last row is outside.

    >>> settling_time(np.array([1.0, 0.2, -0.04, 0.0]), size=1.0, step_s=0.01)
    0.02
    """
    outside, rows = ~(np.abs(error) <= SETTLING_BAND * abs(size)), error.shape[-1]
    settled = np.max(np.where(outside, np.arange(1, rows + 1), 0), axis=-1, initial=0)
    times = np.where(settled == rows, np.nan, settled * step_s)
    return times if error.ndim > 1 else None if settled == rows else float(times)


def altitude_metrics(setpoint: Array, altitude: Array, contact: NDArray[np.bool_] | None = None) -> AltitudeMetrics:
    """Return the metrics of the height error (m), over the rows that have a set-point."""
    error = height_error(setpoint, altitude, contact)
    size = np.abs(error)
    return _to_record(AltitudeMetrics, rmse_m=_rms(error), max_abs_error_m=_peak(size), final_error_m=_last_value(size))


def saturation_in_flight(log: Columns, reach: Reach | None) -> NDArray[np.bool_]:
    """Return the rows in the air with a saturated actuator, which the metric counts and reports mark."""
    return saturation(log, reach) & ~find_contact_rows(log)


def saturation(log: Columns, reach: Reach | None, tolerance: float = 1e-9) -> NDArray[np.bool_]:
    """Return the rows with an allocation residual, or with an actuator commanded to an end of its range.

    Actuators are throttles, tilts, hinges and surfaces.  A jet that the monitor has given up, whose throttle is closed
    for that, does not count.  ``tolerance``: throttle, rad: rounding between a limit and a command that was cut there.
    """
    rows = np.zeros(log["on_ground"].shape, dtype=np.bool_)
    for name in REFUSED:
        rows = rows | (np.abs(log[name]) > 0.0)
    if reach is None:
        return rows
    for jet, (least, most) in enumerate(reach.throttle, 1):
        throttle, is_failed = log[THROTTLE.format(jet)], log[HEALTH.format(jet)] < 1.0
        rows = rows | (((throttle <= least + tolerance) | (throttle >= most - tolerance)) & ~is_failed)
    for command, least, most in _servo_ranges(log, reach):
        rows = rows | (command <= least + tolerance) | (command >= most - tolerance)
    return rows


def _ranges(log: Columns, reach: Reach | None) -> Iterator[tuple[Array, float, float]]:
    """Yield the command of every throttle, tilt, hinge and surface with the ends of its range."""
    if reach is not None:
        for jet, (least, most) in enumerate(reach.throttle, 1):
            yield log[THROTTLE.format(jet)], least, most
        yield from _servo_ranges(log, reach)


def _servo_ranges(log: Columns, reach: Reach) -> Iterator[tuple[Array, float, float]]:
    banks = None if reach.tilt_rad is None else ((-reach.tilt_rad, reach.tilt_rad),) * 2
    for name, (least, most) in zip(
        _servo_columns(logged_vehicle_of(log.columns)), reach.servos or banks or (), strict=False
    ):
        yield log[name], least, most


def alternating_percent(
    commands: Iterable[tuple[Array, float, float]], step_s: float, reversal: float = 0.01
) -> float | None:
    """Return the share of a second's steps (percent) on which a command turns back: worst second, worst command.

    ``commands`` come with the ends of their ranges.  A command turns back where it goes one way and then the other, by
    more than ``reversal`` of its range both times.  One that alternates at every step, at half the control rate, comes
    to 100; white noise, however strong, to 2/3 of that: the probability that the middle of three is an extreme. None
    for a flight of less than a second and where no range is known.  ``reversal``: of a command's range: 10 us of a
    pulse that spans 1000, several dead bands of a servo.
    """
    rows, worst = round(FINAL_WINDOW_S / step_s), None
    for command, least, most in commands:
        if np.all(most <= least) or command.shape[-1] < rows + 2 or not np.all(np.isfinite(command)):
            continue
        change = np.diff(command)
        change /= most - least
        turns = change[..., 1:] * change[..., :-1] < 0.0
        np.abs(change, out=change)
        turns &= np.minimum(change[..., 1:], change[..., :-1]) > reversal
        count = np.zeros((*turns.shape[:-1], turns.shape[-1] + 1), dtype=np.int32)
        np.cumsum(turns, axis=-1, out=count[..., 1:])
        own = 100.0 * np.max(count[..., rows:] - count[..., :-rows], axis=-1) / rows
        worst = _to_plain(own if worst is None else np.maximum(worst, own))
    return worst


def activity(commands: Iterable[Array], step_s: float) -> float | None:
    """Return the total variation of commands per second: sum |u_k+1 - u_k| / time, mean over the commands.

    It is the common measure of a control signal's effort.  A command without a number is left out.
    """
    values = [
        _to_plain(np.sum(np.abs(np.diff(command)), axis=-1)) / ((command.shape[-1] - 1) * step_s)
        for command in commands
        if command.shape[-1] > 1 and np.all(np.isfinite(command))
    ]
    return sum(values) / len(values) if values else None


def fuel_burnt(fuel: Array, flows: Iterable[Array], step_s: float) -> Any:
    """Return the fuel (kg) burnt: lost from the tank, or reported by the engines.

    None where no engine reports its flow: a tank stays full then, whatever is burnt.
    """
    reported = [flow for flow in flows if flow.size and np.any(np.isfinite(flow))]
    if reported and fuel.size and np.all(np.isfinite(fuel)):
        return _to_plain(fuel[..., 0] - fuel[..., -1])
    burnt = [_to_plain(np.sum(flow[..., :-1], axis=-1)) for flow in reported if np.all(np.isfinite(flow))]
    return sum(burnt) * step_s if burnt else None


def _position_metrics(log: Columns) -> PositionMetrics:
    north, east = log["north_m"], log["east_m"]
    drift = np.hypot(north - north[..., :1], east - east[..., :1]) if north.size else north
    ends = {"drift_m": _peak(drift), "final_drift_m": _last_value(drift)}
    if not commands_position(log):
        return _to_record(PositionMetrics, **ends)
    off = np.hypot(log[POSITION_SETPOINT[0]] - north, log[POSITION_SETPOINT[1]] - east)
    remaining = _last_value(log[WAYPOINTS_LEFT]) if WAYPOINTS_LEFT in log.columns else None
    errors = {"rmse_m": _rms(off), "max_abs_error_m": _peak(off), "final_error_m": _last_value(off)}
    return _to_record(PositionMetrics, **ends, **errors, waypoints_left=remaining)


def commands_position(log: Columns) -> bool:
    return POSITION_SETPOINT[0] in log.columns and bool(np.any(np.isfinite(log[POSITION_SETPOINT[0]])))


def touchdown(contact: NDArray[np.bool_], altitude: Array, velocity_down: Array, flight_m: float = 0.2) -> float | None:
    """Return the descent speed (m/s) on the last row before the first contact that ends a flight.

    A flight is a stretch in the air that was at least ``flight_m`` above where it ends.  ``flight_m``: less is a hop at
    take-off or a bounce.
    """
    edges = np.diff(contact.astype(np.int8))
    landings = np.flatnonzero(edges == 1) + 1
    departures = np.append(0, np.flatnonzero(edges == -1) + 1)
    for row in landings:
        since = departures[departures < row][-1]
        if np.max(altitude[since:row]) - altitude[row] >= flight_m:
            return float(velocity_down[row - 1])
    return None


def wrap(angle: Array) -> Array:
    """Return angles (rad) wrapped to (-pi, pi], unchanged if within."""
    outside = ~(np.abs(angle) <= pi)
    if not np.any(outside):
        return angle
    wrapped = angle.copy()
    wrapped[outside] = pi - np.mod(pi - angle[outside], 2.0 * pi)
    return wrapped


def flatten(metrics: Metrics) -> dict[str, float | None]:
    """Return every metric under the name that an expectation uses, such as ``roll.overshoot_percent``."""
    flat: dict[str, float | None] = {}
    for axis, of_axis in metrics.axes.items():
        flat |= {f"{axis}.{name}": value for name, value in of_axis if name != "commanded"}
    flat |= {f"altitude.{name}": value for name, value in metrics.altitude}
    flat["touchdown_m_s"] = metrics.touchdown_m_s
    for part in ("position", "speed", "effort"):
        flat |= {f"{part}.{name}": value for name, value in getattr(metrics, part)}
    return flat | {"fuel_burnt_kg": metrics.fuel_burnt_kg}


@cache
def metric_names() -> tuple[str, ...]:
    """Return every name that an expectation may use."""
    nothing = AxisMetrics(commanded=False)
    return tuple(flatten(Metrics(axes=dict.fromkeys(AXES, nothing), altitude=AltitudeMetrics())))


def check_expectations(flat: Mapping[str, float | None], expected: Mapping[str, Range]) -> list[str]:
    """Return a line for every expectation that is not met, or that names no metric."""
    complaints = []
    for name, allowed in expected.items():
        if name not in flat:
            complaints.append(f"unknown metric {name!r}; {nearest(name, flat, 'docs/metrics.md')}")
            continue
        value = flat[name]
        low, high = allowed.min, allowed.max
        if value is None:
            complaints.append(f"{name}: this flight has none, expected {_describe_range(low, high)}")
        elif (low is not None and value < low) or (high is not None and value > high):
            complaints.append(f"{name} = {value:.6g}, expected {_describe_range(low, high)}")
    return complaints


def _describe_range(low: float | None, high: float | None) -> str:
    if low is None:
        return f"at most {high:g}"
    return f"at least {low:g}" if high is None else f"{low:g} to {high:g}"


def _to_record(kind: type[R], **values: Any) -> R:
    """Return a ``kind`` of ``values``; without validation if they are arrays, an entry per flight."""
    is_of_many = any(isinstance(value, np.ndarray) for value in values.values())
    return kind.model_construct(**values) if is_of_many else kind(**values)


def _to_plain(value: Any) -> Any:
    """Return the number of one flight as a Python number, those of many flights as an array."""
    return value if np.ndim(value) else float(value)


def _finite_values(values: Array) -> Array:
    """Return the finite values of one flight; values of many flights are finite everywhere or nowhere."""
    return values if values.ndim > 1 else values[np.isfinite(values)]


def _last_value(values: Array) -> Any:
    if values.ndim > 1:
        return values[..., -1]
    return float(values[-1]) if values.size and np.isfinite(values[-1]) else None


def _rms(values: Array) -> Any:
    finite = _finite_values(values)
    if not finite.size:
        return None
    largest = np.maximum(np.max(finite, axis=-1), -np.min(finite, axis=-1))
    # Scaled, so that no square overflows.
    scale = np.where(largest > 0.0, largest, 1.0)[..., None]
    scaled = np.divide(finite, scale, out=None if finite is values else finite)
    return _to_plain(largest * np.sqrt(np.mean(np.square(scaled, out=scaled), axis=-1)))


def _peak(values: Array) -> Any:
    finite = _finite_values(values)
    return _to_plain(np.max(finite, axis=-1)) if finite.size else None


def _max_or_none(values: list[Any]) -> Any:
    """Return the largest value; None if there is none or one value is None."""
    return _to_plain(np.max(values, axis=0)) if values and all(value is not None for value in values) else None
