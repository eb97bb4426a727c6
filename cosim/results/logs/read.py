"""Which reader a file is for, and what of each kind of log an axis or an engine is."""

from __future__ import annotations

from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.results.columns import RATES
from cosim.results.logs import blackbox, crazyflie, dataflash, table, ulog
from cosim.results.logs.flight_log import FlightLog, LogSignals

KINDS = (
    "a run's folder, .ulg (ULog), .bin (ArduPilot DataFlash), .bbl or .bfl (Betaflight blackbox), "
    ".cfusdlog (Crazyflie), .csv, .parquet"
)


_READERS = (
    (ulog.recognises, ulog.read),
    (dataflash.recognises, dataflash.read),
    (crazyflie.recognises, crazyflie.read),
    (blackbox.recognises, blackbox.read),
)


def is_flight_log(path: Path) -> bool:
    """Whether a file begins as the log of a flight controller that can be read; ``FILE:N`` as its file does."""
    try:
        with _file_and_number(path)[0].open("rb") as file:
            head = file.read(64)
    except OSError:
        return False
    return any(recognises(head) for recognises, _ in _READERS)


def _file_and_number(path: Path) -> tuple[Path, int | None]:
    """The file, and the number of the log in it where the name says one."""
    name, _, digits = str(path).rpartition(":")
    if name and digits.isdigit() and not path.exists() and Path(name).is_file():
        return Path(name), int(digits)
    return path, None


def read_flight_log(path: Path, time: str | None = None, time_unit: str = "s") -> FlightLog:
    """Read a log of any kind that is known: by its first bytes, or by its name where it is a table.

    ``time`` and ``time_unit`` are a table's.  ``FILE:N`` is log number N of a file that holds several, as Betaflight's
    do.  Raises InputError for what is no log or cannot be read.
    """
    path, number = _file_and_number(path)
    if path.is_dir():
        return table.read_run(path)
    try:
        with path.open("rb") as file:
            head = file.read(64)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    if not head:
        raise InputError(f"{path}: the file is empty")
    if number is not None:
        if blackbox.recognises(head):
            return blackbox.read(path, number)
        raise InputError(f"{path}: holds one log; {path}:{number} is for a blackbox file of several")
    for recognises, read in _READERS:
        if recognises(head):
            return read(path)
    if path.suffix.lower() in (".csv", ".parquet"):
        return table.read_table(path, time, time_unit)
    raise InputError(f"{path}: no log that is known; allowed: {KINDS}")


def signals_of(log: FlightLog, what: str) -> LogSignals:
    """What of this log is ``roll``, ``pitch``, ``yaw`` or ``engine:N``, as far as its kind tells.

    Raises InputError where it does not.
    """
    axis = AXES.index(what) if what in AXES else None
    number = what.removeprefix("engine:") if what.startswith("engine:") else ""
    if axis is None and not number.isdigit():
        raise InputError(f"{what!r}: allowed: {', '.join(AXES)}, engine:N")
    choices = _axis(axis) if axis is not None else _engine(int(number))
    for choice in choices:
        if log.has(choice.command) and log.has(choice.output):
            return choice if log.has(choice.setpoint) else choice._replace(setpoint="")
    needed = " or ".join(f"{choice.command} with {choice.output}" for choice in choices)
    raise InputError(f"{log.path}: it has no {what}; say --command and --output, or log one of: {needed}")


def _axis(n: int) -> list[LogSignals]:
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
        LogSignals(f"RATE.{letter}Out", f"deg(RATE.{letter})", f"deg(RATE.{letter}Des)"),
        LogSignals(f"RATE.{letter}Out", f"IMU[0].Gyr{gyro}", f"deg(RATE.{letter}Des)"),
        LogSignals(f"axisSum[{n}]", f"deg(gyroADC[{n}])", f"deg(setpoint[{n}])"),
        LogSignals(pids, f"deg(gyroADC[{n}])", f"deg(setpoint[{n}])"),
        LogSignals(pids.rsplit(" + ", 1)[0], f"deg(gyroADC[{n}])", f"deg(setpoint[{n}])"),
        LogSignals((*motors, yaw)[n], f"deg(gyro.{'xyz'[n]})", "", "PWM counts"),
    ]


def _engine(n: int) -> list[LogSignals]:
    motors = " + ".join(f"square(motor.m{n})" for n in (1, 2, 3, 4))  # thrust goes with the square of the speed
    return [
        LogSignals(f"throttle_{n}", f"thrust_{n}_N", "", "throttle", "N"),
        LogSignals(f"actuator_motors.control[{n - 1}]", f"hexjet_thrust.newton[{n - 1}]", "", "throttle", "N"),
        LogSignals(f"actuator_motors.control[{n - 1}]", f"esc_status.esc[{n - 1}].esc_rpm", "", "throttle", "rpm"),
        LogSignals(f"RCOU.C{n}", f"ESC[{n - 1}].RPM", "", "us", "rpm"),
        LogSignals(f"motor[{n - 1}]", f"eRPM[{n - 1}]", "", "motor counts", "eRPM/100"),
        LogSignals(motors, "acc.z", "", "PWM counts squared, of all four", "g"),
    ]
