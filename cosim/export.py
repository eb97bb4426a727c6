"""A run's log in formats of others: CSV, and ULog for PlotJuggler and PX4's Flight Review.

ULog follows PX4's "ULog File Format", version 1.  Topics have PX4's names and fields where a quantity is the same thing
in the same frame and unit (FRD body, NED, quaternions from body to NED); ``vehicle_*`` is what the sensors say,
``*_groundtruth`` is what is so, and ``wind`` is the true wind.  What PX4 has no topic for is in topics that begin with
``hexjet_``.  Values are float32, as PX4 logs them; the CSV has every digit.
"""

from __future__ import annotations

import csv
import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.columns import RATES
from cosim.errors import InputError
from cosim.files import one_line, replacing
from cosim.run import RUN_FILES, Run, Summary, open_run
from cosim.signals import AXES, JETS

Array = NDArray[np.float64]
Block = dict[str, Array]

ROWS = 4096  # converted at once
_XYZ, _NED = ("x", "y", "z"), ("north", "east", "down")

# PX4's vehicle_status: armed, and the flight mode that is nearest
_ARMED, _ALTITUDE_MODE, _STABILIZED_MODE, _ACRO_MODE = 2, 1, 15, 10


class Field(NamedTuple):
    """One field of a topic: ``length`` values of a ULog type, 0 for a scalar, and where they come from."""

    kind: str
    name: str
    length: int
    values: Callable[[Block], Array]


_TYPES = {"float": "<f4", "bool": "<u1", "uint8_t": "<u1", "int32_t": "<i4", "uint64_t": "<u8"}


def export_csv(folder: Path, path: Path) -> None:
    """Write every column of a run's log as CSV, each number with all its digits; missing set-points are ``nan``.

    Raises InputError if there is no run or the file cannot be written.
    """
    run = open_run(folder)
    with _output(run, path) as temporary, open(temporary, "w", encoding="ascii", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(run.log.columns)
        for block in run.log.blocks(run.log.columns, ROWS):
            writer.writerows(zip(*(values.tolist() for values in block.values()), strict=True))


def export_ulog(folder: Path, path: Path) -> None:
    """Write a run's log as ULog.  Raises InputError if there is no run or the file cannot be written."""
    run = open_run(folder)
    topics = list(TOPICS.items())
    row_type = np.dtype([(name, _message_type(fields)) for name, fields in topics])
    with _output(run, path) as temporary, open(temporary, "wb") as file:
        file.write(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))
        file.write(_message(b"B", bytes(40)))
        file.writelines(_message(b"I", _info(key, value)) for key, value in _facts(run.summary).items())
        file.writelines(_message(b"F", _format(name, fields)) for name, fields in topics)
        file.writelines(
            _message(b"A", struct.pack("<BH", 0, number) + name.encode()) for number, (name, _) in enumerate(topics)
        )
        for block in run.log.blocks(run.log.columns, ROWS):
            rows = np.zeros(len(block["time_s"]), dtype=row_type)
            for number, (name, fields) in enumerate(topics):
                _fill(rows[name], number, fields, block)
            file.write(rows.tobytes())
        level = b"6" if run.outcome == "completed" else b"3"
        said = f"{run.outcome}: {run.reason}".encode()[:60_000]
        file.write(_message(b"L", level + struct.pack("<Q", _microseconds(run.summary.duration_s)) + said))


# ---- ULog


def _fill(message: NDArray[np.void], number: int, fields: Iterable[Field], block: Block) -> None:
    """Write one data message a row."""
    message["size"] = message.dtype.itemsize - 3  # without its header: size and type
    message["type"] = ord("D")
    message["id"] = number
    message["timestamp"] = np.rint(1e6 * block["time_s"])
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite
        for field in fields:
            message[field.name] = field.values(block)


def _message_type(fields: Iterable[Field]) -> np.dtype[np.void]:
    head = [("size", "<u2"), ("type", "u1"), ("id", "<u2"), ("timestamp", "<u8")]
    return np.dtype(head + [(f.name, _TYPES[f.kind], (f.length,) if f.length else ()) for f in fields])


def _format(name: str, fields: Iterable[Field]) -> bytes:
    parts = (f"{f.kind}[{f.length}] {f.name};" if f.length else f"{f.kind} {f.name};" for f in fields)
    return f"{name}:uint64_t timestamp;{''.join(parts)}".encode()


def _info(key: str, value: str) -> bytes:
    content = value.encode()[:60_000]
    full_key = f"char[{len(content)}] {key}".encode()
    return bytes([len(full_key)]) + full_key + content


def _message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + kind + content


def _facts(summary: Summary) -> dict[str, str]:
    return {
        "sys_name": "hexjet-cosim",
        "ver_sw": summary.versions.get("hexjet-cosim", "unknown"),
        "ver_hw": summary.aircraft,
        "hexjet_scenario": summary.scenario,
        "hexjet_engine": summary.engine,
        "hexjet_controller": summary.controller,
        "hexjet_seed": str(summary.seed),
        "hexjet_outcome": summary.outcome,
        "hexjet_reason": summary.reason,
    }


def _microseconds(seconds: float) -> int:
    return round(1e6 * seconds)


# ---- what each field holds


def _columns(kind: str, name: str, *columns: str) -> Field:
    """An array field of columns as they are."""
    return Field(kind, name, len(columns), lambda block: np.stack([block[column] for column in columns], axis=1))


def _column(kind: str, name: str, column: str, factor: float = 1.0) -> Field:
    """A scalar field: a column times a factor."""
    return Field(kind, name, 0, lambda block: factor * block[column])


def _constant(kind: str, name: str, value: float) -> Field:
    return Field(kind, name, 0, lambda block: np.full(len(block["time_s"]), value))


def _sampled() -> Field:
    """The time of the sample: there is no delay between sampling and publishing."""
    return Field("uint64_t", "timestamp_sample", 0, lambda block: np.rint(1e6 * block["time_s"]))


def _quaternion(name: str, pattern: str) -> Field:
    """The quaternion, body to NED, of three columns of angles."""
    return Field("float", name, 4, lambda block: quaternions(*(block[pattern.format(axis)] for axis in AXES)))


def quaternions(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Quaternions w, x, y, z, shape (n, 4), of the yaw-pitch-roll sequence (rad): body to NED."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(0.5 * angle), np.sin(0.5 * angle)) for angle in (roll, pitch, yaw))
    return np.stack(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        axis=1,
    )


def _thrust_body(block: Block) -> Array:
    """The collective as PX4 has it: along -z, 0 to 1."""
    still = np.zeros_like(block["collective"])
    return np.stack((still, still, -block["collective"]), axis=1)


def _motors(block: Block) -> Array:
    """Twelve throttles, of which six exist."""
    control = np.full((len(block["time_s"]), 12), np.nan)
    for jet in range(JETS):
        control[:, jet] = block[f"throttle_{jet + 1}"]
    return control


def _mode(block: Block) -> Array:
    """PX4's mode by the loops that are closed: rates only, attitude, attitude and height."""
    held = np.where(np.isnan(block["altitude_setpoint_m"]), _STABILIZED_MODE, _ALTITUDE_MODE)
    return np.where(np.isnan(block["roll_setpoint_rad"]), _ACRO_MODE, held).astype(float)


def _local_position(suffix: str) -> list[Field]:
    """PX4's vehicle_local_position of the true columns, or with ``_measured`` of the measured ones."""
    names = zip(_XYZ, _NED, strict=True)
    pairs = [(xyz, f"{ned}{suffix}_m", f"velocity_{ned}{suffix}_m_s") for xyz, ned in names]
    return [
        _sampled(),
        *(_constant("bool", name, 1.0) for name in ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")),
        *(_column("float", xyz, place) for xyz, place, _ in pairs),
        *(_column("float", f"v{xyz}", speed) for xyz, _, speed in pairs),
        _column("float", "heading", f"yaw{suffix}_rad"),
    ]


def _rates(suffix: str) -> list[str]:
    return [f"rate_{rate}{suffix}_rad_s" for rate in RATES]


TOPICS: dict[str, list[Field]] = {
    "vehicle_attitude": [_sampled(), _quaternion("q", "{}_measured_rad")],
    "vehicle_attitude_groundtruth": [_sampled(), _quaternion("q", "{}_rad")],
    "vehicle_attitude_setpoint": [
        _quaternion("q_d", "{}_setpoint_rad"),
        Field("float", "thrust_body", 3, _thrust_body),
    ],
    "vehicle_angular_velocity": [_sampled(), _columns("float", "xyz", *_rates("_measured"))],
    "vehicle_angular_velocity_groundtruth": [_sampled(), _columns("float", "xyz", *_rates(""))],
    "vehicle_rates_setpoint": [
        *(_column("float", axis, rate) for axis, rate in zip(AXES, _rates("_setpoint"), strict=True)),
        Field("float", "thrust_body", 3, _thrust_body),
    ],
    "vehicle_local_position": _local_position("_measured"),
    "vehicle_local_position_groundtruth": _local_position(""),
    "vehicle_local_position_setpoint": [
        *(_constant("float", name, np.nan) for name in ("x", "y")),
        _column("float", "z", "altitude_setpoint_m", -1.0),
        *(_constant("float", name, np.nan) for name in ("vx", "vy", "vz", "yaw")),
    ],
    # the vehicle carries no accelerometer model: the true specific force stands in
    "sensor_combined": [
        _columns("float", "gyro_rad", *_rates("_measured")),
        _constant("int32_t", "accelerometer_timestamp_relative", 0.0),
        _columns("float", "accelerometer_m_s2", *(f"specific_force_{axis}_m_s2" for axis in _XYZ)),
    ],
    "actuator_motors": [_sampled(), Field("float", "control", 12, _motors)],
    "vehicle_status": [
        _constant("uint8_t", "arming_state", _ARMED),
        Field("uint8_t", "nav_state", 0, _mode),
    ],
    "vehicle_land_detected": [_column("bool", "landed", "on_ground"), _column("bool", "ground_contact", "on_ground")],
    "wind": [
        _sampled(),
        _column("float", "windspeed_north", "wind_north_m_s"),
        _column("float", "windspeed_east", "wind_east_m_s"),
    ],
    "hexjet_height": [  # above the ground, where PX4's barometric height is above the sea
        _column("float", "true_m", "altitude_m"),
        _column("float", "measured_m", "altitude_measured_m"),
        _column("float", "setpoint_m", "altitude_setpoint_m"),
    ],
    "hexjet_thrust": [_columns("float", "newton", *(f"thrust_{jet}_N" for jet in range(1, JETS + 1)))],
    "hexjet_engine": [  # NaN where an engine does not say
        _columns("float", "spool_speed_rad_s", *(f"spool_speed_{jet}_rad_s" for jet in range(1, JETS + 1))),
        _columns("float", "exhaust_temperature_k", *(f"exhaust_temperature_{jet}_K" for jet in range(1, JETS + 1))),
        _columns("float", "fuel_flow_kg_s", *(f"fuel_flow_{jet}_kg_s" for jet in range(1, JETS + 1))),
        _column("float", "fuel_kg", "fuel_kg"),
        _columns("float", "spool_moment_n_m", *(f"spool_moment_{axis}_N_m" for axis in _XYZ)),
    ],
    "hexjet_rate_predicted": [_columns("float", "xyz", *_rates("_predicted"))],
    "hexjet_tilt": [
        _columns("float", "actual_rad", "tilt_left_rad", "tilt_right_rad"),
        _columns("float", "command_rad", "tilt_left_command_rad", "tilt_right_command_rad"),
    ],
    "hexjet_control": [
        _columns("float", "torque", *(f"torque_{axis}" for axis in AXES)),
        _columns("float", "refused", *(f"refused_{axis}" for axis in AXES)),
        _column("float", "collective", "collective"),
        _column("float", "refused_collective", "refused_collective"),
    ],
    "hexjet_disturbance": [
        _columns("float", "force_n", *(f"disturbance_force_{axis}_N" for axis in _XYZ)),
        _columns("float", "moment_n_m", *(f"disturbance_moment_{axis}_N_m" for axis in _XYZ)),
        _columns("float", "torque", *(f"disturbance_torque_{axis}" for axis in AXES)),
        _column("float", "payload_kg", "payload_kg"),
        _column("float", "mass_kg", "mass_kg"),
    ],
}


@contextmanager
def _output(run: Run, path: Path) -> Iterator[Path]:
    """A temporary file that becomes ``path`` if all goes well."""
    if path.name in RUN_FILES and run.folder is not None and path.resolve().parent == run.folder.resolve():
        raise InputError(f"{path}: belongs to the run itself; choose another name")
    try:
        with replacing(path) as temporary:
            yield temporary
    except OSError as error:
        raise InputError(f"{path}: {one_line(error)}") from error
