"""A run's log in formats of others: CSV, and ULog for PlotJuggler and PX4's Flight Review.

ULog follows PX4's "ULog File Format", version 1.  Topics have PX4's names and fields where a quantity is the same thing
in the same frame and unit (FRD body, NED, quaternions from body to NED); ``vehicle_*`` is what the sensors say,
``*_groundtruth`` is what is so, and ``wind`` is the true wind.  What PX4 has no topic for is in topics that begin with
``hexjet_``, and what blocks show of their own in ``hexjet_own``.  Values are float32, as PX4 logs them; the CSV has
every digit.
"""

from __future__ import annotations

import csv
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.constants import SENSORS, SERVOS
from cosim.base.errors import InputError
from cosim.base.files import one_line, replacing
from cosim.base.protocols import Column
from cosim.base.signals import AXES, JETS, MOST_JETS
from cosim.results import ulog_autopilot
from cosim.results.autopilot_record import read_pilot_record
from cosim.results.columns import RATES, jets_in, own_columns
from cosim.results.events import events_of
from cosim.results.run import (
    RUN_FILES,
    Run,
    Summary,
    open_run,
)

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


Rates = Literal["all", "px4"]
_INFO, _ERROR = 6, 3  # severities as in syslog
_STRUCT = {"float": "f", "bool": "B", "uint8_t": "B", "int32_t": "i", "uint64_t": "Q"}
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


def export_ulog(folder: Path, path: Path, rates: Rates = "all") -> None:
    """Write a run's log as ULog, with what its autopilot did if one flew it.

    ``rates``: ``all`` writes every step, ``px4`` each topic about as often as PX4's default profile does
    (:data:`EVERY_S`), which is a tenth of it, and at the last step.  Raises InputError if there is no run or the file
    cannot be written.
    """
    run = open_run(folder)
    step, lines = run.summary.step_s, read_pilot_record(folder)
    own = own_columns(run.log.described)
    held = dict(_of(lines, jets_in(run.log.columns))) | (
        {OWN: [_column("float", column.name, column.name) for column in own]} if own else {}
    )
    topics = {name: _topic(fields, step if rates == "all" else EVERY_S[name], step) for name, fields in held.items()}
    pilot = ulog_autopilot.states(lines, run.summary.steps, step)
    at_start, changes = ulog_autopilot.parameters(lines)
    with _output(run, path) as temporary, open(temporary, "wb") as file:
        file.write(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))
        file.write(_message(b"B", bytes(40)))
        file.writelines(_message(b"I", _info(key, value)) for key, value in _facts(run.summary).items())
        file.writelines(_message(b"I", _info(f"{OWN}_{column.name}", _said_of(column))) for column in own)
        file.writelines(_message(b"P", ulog_autopilot.parameter(name, value)) for name, value in at_start.items())
        file.writelines(_message(b"F", _format(name, topic.fields)) for name, topic in topics.items())
        file.writelines(_message(b"F", _series_format(name, series)) for name, series in pilot.items())
        file.writelines(
            _message(b"A", struct.pack("<BH", 0, number) + name.encode())
            for number, name in enumerate([*topics, *pilot])
        )
        events = [
            *_series_messages(pilot, len(topics), step),
            *_said(lines, run.summary, changes, step),
            *_happened(run, step),
        ]
        events.sort(key=lambda event: event[0])
        done, first = 0, 0
        estimates, last = ulog_autopilot.estimates(lines), len(run.log) - 1
        for block in run.log.blocks(run.log.columns, ROWS):
            if estimates is not None:
                block = block | _held(estimates, first, len(block["time_s"]))
            messages = [
                each for n, topic in enumerate(topics.values()) for each in _messages(topic, n, block, first, last)
            ]
            first += len(block["time_s"])
            while done < len(events) and events[done][0] < first:
                messages.append(events[done])
                done += 1
            messages.sort(key=lambda message: message[0])
            file.writelines(content for _, content in messages)
        file.writelines(content for _, content in events[done:])


# ---- ULog


class _Topic(NamedTuple):
    """A topic of the rows: what is in it, and every how many rows."""

    fields: list[Field]
    every: int
    kind: np.dtype[np.void]


_Timed = tuple[int, bytes]  # a message and its step


def _of(lines: Sequence[ulog_autopilot.Line], jets: int) -> list[tuple[str, list[Field]]]:
    """The topics of the rows: with an autopilot its own words stand for what follows from the loops."""
    if not any(line["kind"] == "state" for line in lines):
        return list(topics(jets).items())
    return [(name, fields) for name, fields in (topics(jets) | _BY_AUTOPILOT).items() if name not in STATES]


def _topic(fields: list[Field], seconds: float, step: float) -> _Topic:
    return _Topic(fields, max(1, round(seconds / step)), _message_type(fields))


def _messages(topic: _Topic, number: int, block: Block, first: int, last: int) -> Iterator[_Timed]:
    """The data messages of one topic in a block whose first row is step ``first``; that of the ``last`` step always."""
    count = len(block["time_s"])
    steps = [*range(first + -first % topic.every, first + count, topic.every)]
    if first <= last < first + count and last % topic.every:
        steps.append(last)
    rows = {name: values[np.array(steps, dtype=np.intp) - first] for name, values in block.items()}
    made = np.zeros(len(steps), dtype=topic.kind)
    _fill(made, number, topic.fields, rows)
    content, size = made.tobytes(), topic.kind.itemsize
    for n, k in enumerate(steps):
        yield k, content[n * size : (n + 1) * size]


def _held(estimates: ulog_autopilot.Series, first: int, count: int) -> Block:
    """The autopilot's estimates as columns of a block: each holds until the next."""
    at = np.searchsorted(estimates.k, np.arange(first, first + count), side="right") - 1
    return {
        f"autopilot_{name}": np.where(at < 0, np.nan, values[np.maximum(at, 0)])
        for name, values in estimates.values.items()
    }


def _series_format(name: str, series: ulog_autopilot.Series) -> bytes:
    fields = "".join(f"{ulog_autopilot.TYPES.get(field, 'float')} {field};" for field in series.values)
    return f"{name}:uint64_t timestamp;{fields}".encode()


def _series_messages(pilot: Mapping[str, ulog_autopilot.Series], number: int, step: float) -> Iterator[_Timed]:
    for series in pilot.values():
        packing = "<HQ" + "".join(_STRUCT[ulog_autopilot.TYPES.get(field, "float")] for field in series.values)
        for n, k in enumerate(series.k.tolist()):
            values = (values[n] for values in series.values.values())
            kinds = (ulog_autopilot.TYPES.get(field, "float") for field in series.values)
            row = [float(v) if kind == "float" else int(v) for v, kind in zip(values, kinds, strict=True)]
            yield k, _message(b"D", struct.pack(packing, number, _microseconds(k * step), *row))
        number += 1


def _said(
    lines: Sequence[ulog_autopilot.Line], summary: Summary, changes: Iterable[tuple[int, str, float]], step: float
) -> Iterator[_Timed]:
    """Messages of the autopilot, its changes of mode, parameters that were changed, and how the flight ended."""
    said = [*ulog_autopilot.messages(lines), *((k, _INFO, text) for k, text in ulog_autopilot.mode_changes(lines))]
    for k, severity, text in said:
        yield k, _logged(severity, k * step, text)
    for k, name, value in changes:
        yield k, _message(b"P", ulog_autopilot.parameter(name, value))
    level = _INFO if summary.outcome == "completed" else _ERROR
    yield summary.steps, _logged(level, summary.duration_s, f"{summary.outcome}: {summary.reason}")
    for text in summary.exceeded:
        yield summary.steps, _logged(_ERROR, summary.duration_s, f"beyond its limit: {text}")


def _happened(run: Run, step: float) -> Iterator[_Timed]:
    """Faults, the engine monitor's verdicts, what came from outside and contacts, and where one of them ends."""
    for event in events_of(run):
        if event.kind != "pilot":
            yield round(event.time_s / step), _logged(event.severity, event.time_s, event.text)
            if event.end_s is not None:
                yield round(event.end_s / step), _logged(_INFO, event.end_s, f"over: {event.text}")


def _logged(severity: int, time: float, text: str) -> bytes:
    level = str(severity).encode()
    return _message(b"L", level + struct.pack("<Q", _microseconds(time)) + text.encode()[:60_000])


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


def _said_of(column: Column) -> str:
    """What a field of ours means: ULog's fields have no units."""
    return f"[{column.unit}] {f'{column.frame}: ' if column.frame else ''}{column.meaning}"


def _microseconds(seconds: float) -> int:
    return round(1e6 * seconds)


# ---- what each field holds


def _columns(kind: str, name: str, *columns: str) -> Field:
    """An array field of columns as they are."""
    return Field(kind, name, len(columns), lambda block: np.stack([block[column] for column in columns], axis=1))


def _column(kind: str, name: str, column: str, factor: float = 1.0) -> Field:
    """A scalar field: a column times a factor."""
    return Field(kind, name, 0, lambda block: factor * block[column])


def _known(kind: str, name: str, *columns: str, length: int = 0) -> Field:
    """A field of columns as they are, NaN for those that an older log has not."""

    def values(block: Block) -> Array:
        missing = np.full(len(block["time_s"]), np.nan)
        blocks = [block.get(column, missing) for column in columns]
        return np.stack(blocks, axis=1) if length else blocks[0]

    return Field(kind, name, length, values)


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


def _accelerometer(block: Block) -> Array:
    """What the accelerometer gives; the true specific force stands in where a log is older than its model."""
    names = [f"specific_force_{axis}_measured_m_s2" for axis in _XYZ]
    if names[0] not in block:
        names = [f"specific_force_{axis}_m_s2" for axis in _XYZ]
    return np.stack([block[name] for name in names], axis=1)


def _motors(block: Block) -> Array:
    """Throttles of as many motors as the message has, NaN of those that do not exist."""
    control = np.full((len(block["time_s"]), MOST_JETS), np.nan)
    for jet in range(jets_in(block)):
        control[:, jet] = block[f"throttle_{jet + 1}"]
    return control


def _mode(block: Block) -> Array:
    """PX4's mode by the loops that are closed: rates only, attitude, attitude and height."""
    held = np.where(np.isnan(block["altitude_setpoint_m"]), _STABILIZED_MODE, _ALTITUDE_MODE)
    return np.where(np.isnan(block["roll_setpoint_rad"]), _ACRO_MODE, held).astype(float)


def _estimated_position() -> list[Field]:
    """PX4's vehicle_local_position as the autopilot estimates it, and what of it is valid and how sure.

    Not valid before the autopilot's first word.  An older record has no height, climb and heading of its own: then they
    are as measured.
    """

    def told(name: str) -> Field:
        return Field("bool", name, 0, lambda block: np.nan_to_num(block[f"autopilot_{name}"]))

    def estimate(name: str, column: str, factor: float = 1.0) -> Field:
        def values(block: Block) -> Array:
            estimates = block[f"autopilot_{name}"]
            return np.where(np.isnan(estimates), factor * block[column], estimates)

        return Field("float", name, 0, values)

    return [
        _sampled(),
        *(told(name) for name in ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")),
        *(_column("float", name, f"autopilot_{name}") for name in ("x", "y")),
        estimate("z", "altitude_measured_m", -1.0),
        *(_column("float", name, f"autopilot_{name}") for name in ("vx", "vy")),
        estimate("vz", "velocity_down_measured_m_s"),
        estimate("heading", "yaw_measured_rad"),
        *(_column("float", name, f"autopilot_{name}") for name in ("eph", "epv", "evh", "evv")),
        Field("bool", "dead_reckoning", 0, lambda block: block["autopilot_xy_valid"] == 0.0),
    ]


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


def topics(jets: int) -> dict[str, list[Field]]:
    """What is in each topic, of a log of so many jets."""

    def of_jets(pattern: str) -> list[str]:
        return [pattern.format(jet) for jet in range(1, jets + 1)]

    return {
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
            *(_known("float", xy, f"{place}_setpoint_m") for xy, place in (("x", "north"), ("y", "east"))),
            _column("float", "z", "altitude_setpoint_m", -1.0),
            *(_constant("float", name, np.nan) for name in ("vx", "vy", "vz", "yaw")),
        ],
        "sensor_combined": [
            _columns("float", "gyro_rad", *_rates("_measured")),
            _constant("int32_t", "accelerometer_timestamp_relative", 0.0),
            Field("float", "accelerometer_m_s2", 3, _accelerometer),
        ],
        "actuator_motors": [_sampled(), Field("float", "control", MOST_JETS, _motors)],
        "vehicle_status": [
            _constant("uint8_t", "arming_state", _ARMED),
            Field("uint8_t", "nav_state", 0, _mode),
        ],
        "vehicle_land_detected": [
            _column("bool", "landed", "on_ground"),
            _column("bool", "maybe_landed", "on_ground"),
            _column("bool", "ground_contact", "on_ground"),
        ],
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
        "hexjet_thrust": [_columns("float", "newton", *of_jets("thrust_{}_N"))],
        "hexjet_engine": [  # NaN where an engine does not say
            _columns("float", "spool_speed_rad_s", *of_jets("spool_speed_{}_rad_s")),
            _columns("float", "exhaust_temperature_k", *of_jets("exhaust_temperature_{}_K")),
            _columns("float", "fuel_flow_kg_s", *of_jets("fuel_flow_{}_kg_s")),
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
            _known("float", "air_rate_rad_s", *(f"air_rate_{rate}_rad_s" for rate in RATES), length=len(RATES)),
        ],
        "hexjet_fault": [  # 1 where a fault acts; and what the engine monitor believes of each jet, 1 for healthy
            _known("float", "jet", *of_jets("fault_jet_{}"), length=jets),
            _known("float", "servo", *(f"fault_servo_{side}" for side in SERVOS), length=len(SERVOS)),
            _known("float", "sensor", *(f"fault_{name}" for name in SENSORS), length=len(SENSORS)),
            _known("float", "health", *of_jets("health_{}"), length=jets),
        ],
    }


TOPICS = topics(JETS)

OWN = "hexjet_own"  # what the flight's blocks show of their own; an info message of the file says what each field is

# What an autopilot says better than the rows do, and what it adds.
STATES = ("vehicle_status", "vehicle_land_detected")
_BY_AUTOPILOT: dict[str, list[Field]] = {
    "vehicle_local_position": _estimated_position(),
    "vehicle_local_position_setpoint": [
        *(_column("float", name, f"autopilot_{name}_sp") for name in ("x", "y", "z")),
        *(_constant("float", name, np.nan) for name in ("vx", "vy", "vz")),
        _column("float", "yaw", "autopilot_yaw_sp"),
    ],
    "hexjet_gnss": _local_position("_measured"),  # as received
}
# Seconds between two messages of a topic: about PX4's default profile (its logged_topics.cpp), ours by their like.
EVERY_S = dict.fromkeys((*TOPICS, *_BY_AUTOPILOT, OWN), 0.2) | {
    "vehicle_attitude": 0.05,
    "vehicle_attitude_groundtruth": 0.1,
    "vehicle_attitude_setpoint": 0.05,
    "vehicle_angular_velocity": 0.02,
    "vehicle_angular_velocity_groundtruth": 0.1,
    "vehicle_rates_setpoint": 0.02,
    "vehicle_local_position": 0.1,
    "vehicle_local_position_setpoint": 0.1,
    "sensor_combined": 0.1,
    "actuator_motors": 0.1,
    "vehicle_status": 0.2,
    "hexjet_thrust": 0.1,
    "hexjet_rate_predicted": 0.02,
    "hexjet_tilt": 0.1,
    "hexjet_control": 0.05,
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
