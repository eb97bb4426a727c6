"""A log of another flight controller as columns of a flight of ours: what it has, on one clock, in our units."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.signals import AXES, MAX_JETS
from cosim.results.log.columns import COLUMNS, RATES
from cosim.results.log.recorder import MemoryLog
from cosim.results.log.tables import TIME
from hexjet_identify.logs.flight_log import Channel, FlightLog
from hexjet_identify.logs.read import is_flight_log as is_flight_log
from hexjet_identify.logs.read import read_columns, read_flight_log, signals_of
from hexjet_identify.logs.table import NOT_NUMBERS, columns_with_time

# Suffix of the topics that a simulation, PX4's or ours, logs as the truth.
_TRUTH = "_groundtruth"
_ATTITUDE = "vehicle_attitude{}.q[{}]"  # of PX4: w first, body to NED
_SETPOINT = "vehicle_attitude_setpoint.q_d[{}]"
_LOCAL = "vehicle_local_position{}.{}"
_NED = "LOCAL_POSITION_NED."  # of MAVLink
_AXES = tuple(zip(RATES, AXES, strict=True))
# Our columns as sums of channels of other logs, the nearest first, in our signs and units.
_SUMS = {
    "roll_rad": ("deg(ATT.Roll)", "deg(stateEstimate.roll)", "ATTITUDE.roll"),
    # of the Crazyflie: nose up, other than its gyro
    "pitch_rad": ("deg(ATT.Pitch)", "deg(stateEstimate.pitch)", "ATTITUDE.pitch"),
    "yaw_rad": ("deg(ATT.Yaw)", "-1*deg(stateEstimate.yaw)", "ATTITUDE.yaw"),
    "altitude_m": ("-1*" + _LOCAL.format(_TRUTH, "z"), "-1*vehicle_local_position.z", "-1*XKF1[0].PD", "BARO[0].Alt",
                   "stateEstimate.z", "-1*" + _NED + "z"),
    "north_m": (_LOCAL.format(_TRUTH, "x"), "vehicle_local_position.x", "XKF1[0].PN", _NED + "x"),
    "east_m": (_LOCAL.format(_TRUTH, "y"), "vehicle_local_position.y", "XKF1[0].PE", _NED + "y"),
    "velocity_north_m_s": (_LOCAL.format(_TRUTH, "vx"), "vehicle_local_position.vx", "XKF1[0].VN", _NED + "vx"),
    "velocity_east_m_s": (_LOCAL.format(_TRUTH, "vy"), "vehicle_local_position.vy", "XKF1[0].VE", _NED + "vy"),
    "velocity_down_m_s": (_LOCAL.format(_TRUTH, "vz"), "vehicle_local_position.vz", "XKF1[0].VD", _NED + "vz"),
    **{f"rate_{rate}_measured_rad_s": (f"ATTITUDE.{axis}speed",) for rate, axis in _AXES},
    **{f"rate_{rate}_setpoint_rad_s": (f"ATTITUDE_TARGET.body_{axis}_rate",) for rate, axis in _AXES},
}  # fmt: skip
ANGLES = tuple(f"{axis}_rad" for axis in AXES)
# Kinds of logs with axes forward, left and up; ours are forward, right and down.
FORWARD_LEFT_UP_KINDS = ("Betaflight blackbox", "Crazyflie")
ESTIMATES_NOTE = "attitude, position and velocity are its estimates, and not the truth as in a flight of ours"


def read_flight_columns(path: Path) -> tuple[MemoryLog, tuple[str, ...]]:
    """Return a log or a table under our column names, with remarks; raise InputError for a damaged one."""
    return read_log(path) if path.suffix.lower() in (".csv", ".parquet") else as_columns(read_flight_log(path))


def as_columns(log: FlightLog) -> tuple[MemoryLog, tuple[str, ...]]:
    """Return a log under our column names, at the times of its fastest channel, and remarks on it.

    Slower ones hold their values, NaN before the first.  Times count from its first row.  InputError if it has none.
    """
    columns = match_columns(log)
    if not columns:
        raise InputError(f"{log.path}: the {log.kind} log has no rates, attitude, position or throttles that are known")
    clock = max(columns.values(), key=lambda channel: len(channel.times)).times
    clock = clock[np.concatenate([[True], np.diff(clock) > 0.0])] if len(clock) else clock
    if len(clock) < 2 or not np.all(np.isfinite(clock)) or not np.all(np.diff(clock) > 0.0):
        raise InputError(f"{log.path}: its time does not grow from row to row")
    rows = [clock - clock[0], *(_resample(channel, clock) for channel in columns.values())]
    remarks = [f"{log.kind}: {len(columns)} columns of a flight of ours are in it", *log.remarks]
    if columns.keys() & _SUMS.keys() and not any(_TRUTH in name for name in log.channels):
        remarks.append(ESTIMATES_NOTE)
    if clock[0] != 0.0:
        remarks.append(f"times count from its first row, {clock[0]:.3f} s of its clock")
    names = (TIME, *columns)
    described = tuple(column for column in COLUMNS if column.name in names)
    return MemoryLog([np.stack(rows)], names, described), tuple(remarks)


def read_log(path: Path) -> tuple[MemoryLog, tuple[str, ...]]:
    """Read a CSV or Parquet log of another tool, and return it with remarks on it.

    Its columns are ours where they are called as ours; its time [s] is called and grows as
    :mod:`hexjet_identify.logs.table` has it.  Columns without numbers are left out.  Raises InputError.
    """
    table = columns_with_time(path, read_columns(path))
    columns, times, time = table.columns, table.times, table.name
    if times.size < 2:
        raise InputError(f"{path}: {times.size} rows; at least two are needed")
    wrong = np.flatnonzero(~(np.diff(times) > 0.0))
    if wrong.size or not np.isfinite(times[0]):
        row = int(wrong[0]) + 2 if wrong.size else 1
        raise InputError(f"{path}: row {row}: {time} must be a number and grow from row to row")
    remarks = [f"{time} is taken for the time in seconds"] if time != TIME and not table.remarks else []
    remarks += table.remarks
    if table.left_out:
        remarks.append(f"{NOT_NUMBERS}: {', '.join(table.left_out)}")
    named = {column.name: column for column in COLUMNS}
    strange = [name for name in columns if name not in named]
    if len(strange) == len(columns):
        raise InputError(f"{path}: no column is called as one of a flight's log, such as roll_rad, altitude_m")
    names = (TIME, *columns)
    described = tuple(named[name] for name in names if name in named)
    return MemoryLog([np.stack([times, *columns.values()])], names, described), tuple(remarks)


def match_columns(log: FlightLog) -> dict[str, Channel]:
    """Return the channels of another flight controller's log by our column names, in our units."""
    columns = _match_rates(log)
    true, estimated = (log.has(_ATTITUDE.format(suffix, 3)) for suffix in (_TRUTH, ""))
    for there, pattern, name in (
        (true, _ATTITUDE.replace("{}", _TRUTH, 1), "{}_rad"),
        (estimated, _ATTITUDE.replace("{}", "", 1), "{}_measured_rad" if true else "{}_rad"),
        (log.has(_SETPOINT.format(3)), _SETPOINT, "{}_setpoint_rad"),
    ):
        if there:
            components = [log.channels[pattern.format(n)] for n in range(4)]
            for axis, values in zip(AXES, _euler(*(part.values for part in components)), strict=True):
                columns[name.format(axis)] = Channel(components[0].times, values)
    for name, choices in _SUMS.items():
        text = next((choice for choice in choices if log.has(choice)), None)
        if text is not None and name not in columns:
            columns[name] = _wrap_angle(log.signal(text)) if name in ANGLES else log.signal(text)
    return columns | _match_engines(log)


def _match_rates(log: FlightLog) -> dict[str, Channel]:
    """Return measured rates and rate set-points, rad/s, of the axes that the log's kind has."""
    columns: dict[str, Channel] = {}
    for axis, rate in zip(AXES, RATES, strict=True):
        try:
            signals = signals_of(log, axis)
        except InputError:
            continue
        sign = -1.0 if log.kind in FORWARD_LEFT_UP_KINDS and axis != "roll" else 1.0
        for kind, signal in (("measured", signals.output), ("setpoint", signals.setpoint)):
            if signal:
                channel = log.signal(signal)
                columns[f"rate_{rate}_{kind}_rad_s"] = channel._replace(values=sign * channel.values)
    return columns


def _match_engines(log: FlightLog) -> dict[str, Channel]:
    """Return the engines' throttles, 0 to 1, and thrusts, N, by our column names."""
    columns: dict[str, Channel] = {}
    for jet in range(1, MAX_JETS + 1):
        throttle, thrust = f"actuator_motors.control[{jet - 1}]", f"hexjet_thrust.newton[{jet - 1}]"
        if log.has(throttle) and np.isfinite(log.channels[throttle].values).any():
            columns[f"throttle_{jet}"] = log.channels[throttle]
        if log.has(thrust) and log.has(throttle) and np.isfinite(log.channels[thrust].values).any():
            # Our topic stamps a thrust at the end of a step; our columns have it in the row of that step's command.
            columns[f"thrust_{jet}_N"] = _shift_to_command(log.channels[thrust], log.channels[throttle].times)
    return columns


def _shift_to_command(thrust: Channel, throttle: Array) -> Channel:
    """Return a thrust at the times of the commands that it answers; a damaged log may lack some."""
    before = np.searchsorted(throttle, thrust.times, side="left") - 1
    step = (
        float(np.median((thrust.times - throttle[np.maximum(before, 0)])[before >= 0])) if (before >= 0).any() else 0.0
    )
    times = thrust.times - step
    same = len(times) == len(throttle) and bool(np.allclose(times, throttle, rtol=0.0, atol=1e-6))
    return thrust._replace(times=throttle if same else times)


def _resample(channel: Channel, clock: Array) -> Array:
    """Return a channel held from row to row at the times ``clock``, with half a step of tolerance."""
    slack = 0.5 * float(np.median(np.diff(clock)))
    row = np.searchsorted(channel.times, clock + slack, side="right") - 1
    return np.where(row >= 0, channel.values[np.maximum(row, 0)], np.nan)


def _euler(w: Array, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Return roll, pitch and yaw, rad, of quaternions from body to NED."""
    arcs: Callable[[Array, Array], Array] = np.arctan2
    return (
        arcs(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
        arcs(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def _wrap_angle(channel: Channel) -> Channel:
    """Return an angle wrapped to -pi to pi; a log may have it from 0 to 2 pi."""
    return channel._replace(values=np.angle(np.exp(1j * channel.values)))
