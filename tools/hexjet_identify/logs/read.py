"""Which reader a file is for, and what of each kind of log an axis or an engine is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.base.storage.files import read_file
from cosim.results.log.columns import RATES
from hexjet_identify.logs import blackbox, crazyflie, dataflash, tlog, ulog
from hexjet_identify.logs.flight_log import MAX_LOG_MB, SEARCHED_BYTES, FlightLog, LogSignals
from hexjet_identify.logs.reader import read_apart
from hexjet_identify.logs.table import make_log, read_run
from hexjet_identify.logs.table_columns import TableColumns
from hexjet_identify.logs.text_table import decode

KINDS = (
    "a run's folder, .ulg (ULog), .bin (ArduPilot DataFlash), .bbl or .bfl (Betaflight blackbox), "
    ".cfusdlog (Crazyflie), .tlog (MAVLink), tables as text (.csv, .tsv, .txt) and .parquet, "
    "and what hexjet export writes as .mcap and .mat"
)
RECOGNISED_BYTES = 512  # bytes by which a file is recognised

_READERS = (
    (ulog.recognises, "ulog.read"),
    (dataflash.recognises, "dataflash.read"),
    (crazyflie.recognises, "crazyflie.read"),
    (blackbox.recognises, "blackbox.read"),
    (tlog.recognises, "tlog.read"),
)
_BURIED_MARKS = ((ulog.MAGIC, "ulog.read"), (dataflash.MARK, "dataflash.read"), (blackbox.MARKER, "blackbox.read"))
# Tables by others, exports of a run as MCAP and MAT, and LabVIEW's files.
_TABLES = (
    (b"PAR1", "table_columns.read_parquet"),
    (b"\x89MCAP", "table_columns.read_mcap"),
    (b"MATLAB 5", "table_columns.read_mat"),
    (b"TDSm", "tdms.read"),
)
# First bytes of files that are no logs, and what these are.
_NO_LOGS = (
    (b"\x1f\x8b", "a file compressed by gzip: unpack it"),
    (b"PK\x03\x04", "a zip archive: unpack it"),
    (b"7z\xbc\xaf", "a 7z archive: unpack it"),
    (b"\xfd7zXZ", "a file compressed by xz: unpack it"),
    (b"\x28\xb5\x2f\xfd", "a file compressed by zstd: unpack it"),
    (b"BZh", "a file compressed by bzip2: unpack it"),
    (b"version https://git-lfs", "a pointer of Git LFS, and not the log: fetch it with git lfs pull"),
    (b"<", "a page (HTML or XML), such as a server sends instead of a file"),
    (b"{", "JSON"),
    (b"%PDF", "a PDF"),
    (b"\x89PNG", "a picture"),
    (b"\x7fELF", "a program"),
    (b"ARROW1", "an Arrow file; Parquet can be read"),
    (b"\xff\xff\xff\xff", "an Arrow stream: hexjet show FOLDER --page makes its run whole"),
    (b"\x89HDF", "HDF5, as MATLAB writes it; export it as CSV"),
    (b"SQLite format 3", "a database (a bag of ROS 2?); export its topics as CSV"),
    (b"#ROSBAG", "a bag of ROS; export its topics as CSV"),
    (b"FMT, ", "ArduPilot's log as text; the .bin that it was made of can be read"),
)


def is_flight_log(path: Path) -> bool:
    """Return whether a file, or that of ``FILE:N``, is the log of a flight controller that can be read."""
    try:
        return _controller_reader(_read_head(_file_and_number(path)[0])) is not None
    except InputError:
        return False


def _read_head(path: Path) -> bytes:
    return read_file(path, MAX_LOG_MB, SEARCHED_BYTES)


def _controller_reader(head: bytes) -> tuple[str, int] | None:
    """Return the reader of a flight controller's log by its first bytes, and how many bytes come before the log."""
    for recognises, reader in _READERS:
        if recognises(head[:RECOGNISED_BYTES]):
            return reader, 0
    for mark, reader in _BURIED_MARKS:
        if (before := head.find(mark)) > 0:
            return reader, before
    return None


def _file_and_number(path: Path) -> tuple[Path, int | None]:
    """Return the file, and the number of the log in it where the name ends in one."""
    name, _, digits = str(path).rpartition(":")
    if name and digits.isdecimal() and not path.exists() and Path(name).is_file():
        return Path(name), int(digits[:9])
    return path, None


def read_flight_log(path: Path, time: str | None = None, time_unit: str | None = None) -> FlightLog:
    """Read a log of any known kind: by its first bytes, by a head that is found behind others, or as a table.

    ``time`` and ``time_unit`` are a table's.  ``FILE:N`` is log number N of a file that holds several, as Betaflight's
    do.  Raises InputError for what is no log or cannot be read.
    """
    path, number = _file_and_number(path)
    if path.is_dir():
        return read_run(path)
    content = _read_content(path, number)
    return content if isinstance(content, FlightLog) else make_log(path, content, time, time_unit)


def read_columns(path: Path) -> TableColumns:
    """Read the columns of a table of another tool.  Raises InputError for another file."""
    content = _read_content(path, None)
    if isinstance(content, FlightLog):
        raise InputError(f"{path}: is a log ({content.kind}), and no table")
    return content


def _read_content(path: Path, number: int | None) -> FlightLog | TableColumns:
    """Read a file in a process of its own, with the reader for its first bytes."""
    head = _read_head(path)
    if not head:
        raise InputError(f"{path}: the file is empty")
    if path.suffix.lower() == ".toml":
        raise InputError(f"{path}: is TOML, and no log; allowed: {KINDS}")
    if number is not None:
        if blackbox.MARKER in head:
            return read_apart("blackbox.read", path, number)
        raise InputError(f"{path}: holds one log; {path}:{number} is for a blackbox file of several")
    if (found := _controller_reader(head)) is None:
        return read_apart(_table_reader(path, head), path)
    reader, before = found
    log = read_apart(reader, path)
    assert isinstance(log, FlightLog)
    notes = (f"{before} bytes before the head of the log are passed over",) if before else ()
    return replace(log, remarks=(*notes, *log.remarks))


def _table_reader(path: Path, head: bytes) -> str:
    """Return the reader of a table, or of an export of ours.  Raises InputError with what another file is instead."""
    for mark, reader in _TABLES:
        if head.startswith(mark):
            return reader
    begins = head.removeprefix(b"\xef\xbb\xbf").lstrip(b" \t\r\n")[:RECOGNISED_BYTES]
    other = next((words for mark, words in _NO_LOGS if begins.startswith(mark)), "")
    if not other and b"\nFMT, " in head:
        other = dict(_NO_LOGS)[b"FMT, "]
    if other:
        raise InputError(f"{path}: is {other}; allowed: {KINDS}")
    if decode(head) is None:
        start = head[:8].hex(" ")
        raise InputError(f"{path}: no log that is known, and no text: it begins with {start}; allowed: {KINDS}")
    return "table_columns.read_text_table"


def signals_of(log: FlightLog, key: str) -> LogSignals:
    """Return the signals of ``roll``, ``pitch``, ``yaw`` or ``engine:N`` by the names of the log's kind.

    Raises InputError where it does not.
    """
    axis = AXES.index(key) if key in AXES else None
    number = key.removeprefix("engine:") if key.startswith("engine:") else ""
    if axis is None and not number.isdigit():
        raise InputError(f"{key!r}: allowed: {', '.join(AXES)}, engine:N")
    choices = _axis_signals(axis) if axis is not None else _engine_signals(int(number))
    for choice in choices:
        if log.has(choice.command) and log.has(choice.output):
            return choice if log.has(choice.setpoint) else choice._replace(setpoint="")
    near = [choice for choice in choices if log.has(choice.command) or log.has(choice.output)]
    needed = " or ".join(f"{choice.command} with {choice.output}" for choice in near or choices)
    raise InputError(f"{log.path}: it has no {key}; say command and output, or log one of: {needed}")


def _axis_signals(n: int) -> list[LogSignals]:
    axis, rate = AXES[n], RATES[n]
    letter = "RPY"[n]
    gyro = "XYZ"[n]
    motors = ("- motor.m1 - motor.m2 + motor.m3 + motor.m4", "motor.m1 - motor.m2 - motor.m3 + motor.m4")
    yaw = "motor.m1 - motor.m2 + motor.m3 - motor.m4"
    pids = " + ".join(f"axis{part}[{n}]" for part in "PIDF")
    return [
        LogSignals(
            f"torque_{axis} + disturbance_torque_{axis} - refused_{axis}",
            f"rate_{rate}_measured_rad_s",
            f"rate_{rate}_setpoint_rad_s",
            "throttle" if axis == "roll" else "rad",
        ),
        LogSignals(
            f"hexjet_control.torque[{n}] + hexjet_disturbance.torque[{n}] - hexjet_control.refused[{n}]",
            f"vehicle_angular_velocity.xyz[{n}]",
            f"vehicle_rates_setpoint.{axis}",
            "throttle" if axis == "roll" else "rad",
        ),
        LogSignals(
            f"vehicle_torque_setpoint.xyz[{n}]", f"vehicle_angular_velocity.xyz[{n}]", f"vehicle_rates_setpoint.{axis}"
        ),
        LogSignals(
            f"vehicle_torque_setpoint.xyz[{n}]", f"sensor_combined.gyro_rad[{n}]", f"vehicle_rates_setpoint.{axis}"
        ),
        *(  # PX4 up to 1.13
            LogSignals(f"actuator_controls_0.control[{n}]", output, f"vehicle_rates_setpoint.{axis}")
            for output in (f"vehicle_angular_velocity.xyz[{n}]", f"sensor_combined.gyro_rad[{n}]")
        ),
        LogSignals(f"RATE.{letter}Out", f"deg(RATE.{letter})", f"deg(RATE.{letter}Des)"),
        LogSignals(f"RATE.{letter}Out", f"IMU[0].Gyr{gyro}", f"deg(RATE.{letter}Des)"),
        LogSignals(f"axisSum[{n}]", f"deg(gyroADC[{n}])", f"deg(setpoint[{n}])"),
        LogSignals(pids, f"deg(gyroADC[{n}])", f"deg(setpoint[{n}])"),
        LogSignals(pids.rsplit(" + ", 1)[0], f"deg(gyroADC[{n}])", f"deg(setpoint[{n}])"),
        LogSignals((*motors, yaw)[n], f"deg(gyro.{'xyz'[n]})", "", "PWM counts"),
    ]


def _engine_signals(n: int) -> list[LogSignals]:
    motors = " + ".join(f"square(motor.m{n})" for n in (1, 2, 3, 4))  # thrust goes with the square of the speed
    return [
        LogSignals(f"throttle_{n}", f"thrust_{n}_N", "", "throttle", "N"),
        LogSignals(f"actuator_motors.control[{n - 1}]", f"hexjet_thrust.newton[{n - 1}]", "", "throttle", "N"),
        LogSignals(f"actuator_motors.control[{n - 1}]", f"esc_status.esc[{n - 1}].esc_rpm", "", "throttle", "rpm"),
        LogSignals(f"RCOU.C{n}", f"ESC[{n - 1}].RPM", "", "us", "rpm"),
        LogSignals(f"SERVO_OUTPUT_RAW.servo{n}_raw", f"ESC_STATUS.rpm[{n - 1}]", "", "us", "rpm"),
        LogSignals(f"SERVO_OUTPUT_RAW.servo{n}_raw", f"ESC_TELEMETRY_1_TO_4.rpm[{n - 1}]", "", "us", "rpm"),
        LogSignals(f"motor[{n - 1}]", f"eRPM[{n - 1}]", "", "motor counts", "eRPM/100"),
        LogSignals(motors, "acc.z", "", "PWM counts squared, of all four", "g"),
    ]
