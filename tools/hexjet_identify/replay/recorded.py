"""A flight's log at the control steps of a vehicle: what was commanded, and what was measured."""

from __future__ import annotations

from collections.abc import Mapping as Table
from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import file_digest
from typing import Final

import numpy as np

from cosim.base.arrays import Array, Flags
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.results.log.columns import RATES
from cosim.results.run import LOG, SUMMARY
from cosim.spec.vehicle import Vehicle
from hexjet_identify.logs import Channel, FlightLog
from hexjet_identify.logs.log_columns import FORWARD_LEFT_UP_KINDS, match_columns

XYZ: Final = ("x", "y", "z")
NED: Final = ("north", "east", "down")
# Minimum duration of commands and measurements for any verdict [s].
MIN_DURATION_S: Final = 2.0
# PX4's outputs, in microseconds.
PX4_OUTPUTS: Final = "actuator_outputs"
PULSE_RANGE_US: Final = (1000.0, 2000.0)  # pulses of throttle 0 and 1
# Values of throttle 0 and 1, by the kind of log or by the topic.
THROTTLE_RANGES: Final = {
    PX4_OUTPUTS: PULSE_RANGE_US,
    "Crazyflie": (0.0, 65535.0),
    "ArduPilot DataFlash": PULSE_RANGE_US,
    "MAVLink telemetry log": PULSE_RANGE_US,
    "Betaflight blackbox": (48.0, 2047.0),
}
# A table with these columns, or a log with topics of this prefix, was written by this program.
OWN_COLUMNS: Final = {"throttle_1", "thrust_1_N", "health_1"}
OWN_TOPICS: Final = "hexjet_"  # prefix of this program's topics
# By kind of log: how to log commands more often.
_FASTER_LOG_HINTS: Final = {
    "ULog": "PX4: SDLOG_PROFILE with high rate; of ours: hexjet export --to ulog --rates all",
    "ArduPilot DataFlash": "ArduPilot writes RCOU ten times a second; hexjet identify log --axis takes RATE.ROut",
}
# Channels that may hold the command of an engine, {n} from 1 or {m} from 0.
_MOTORS: Final = (
    "throttle_{n}", "hexjet_throttle.throttle[{m}]", "actuator_motors.control[{m}]", PX4_OUTPUTS + ".output[{m}]",
    "motor.m{n}", "RCOU.C{n}", "motor[{m}]", "SERVO_OUTPUT_RAW.servo{n}_raw",
)  # fmt: skip
# Specific force, in m/s^2 or _UNITS of it; FRD but for LEFT_AND_UP.
_FORCES: Final = (
    "specific_force_{x}_measured_m_s2", "specific_force_{x}_m_s2", "sensor_combined.accelerometer_m_s2[{m}]",
    "vehicle_acceleration.xyz[{m}]", "IMU[0].Acc{X}", "IMU.Acc{X}", "acc.{x}", "SCALED_IMU.{x}acc", "RAW_IMU.{x}acc",
)  # fmt: skip
# Channels of rates [rad/s, FRD] for logs without our columns.
_GYROS: Final = (
    "vehicle_angular_velocity.xyz[{m}]", "sensor_combined.gyro_rad[{m}]", "IMU[0].Gyr{X}", "IMU.Gyr{X}",
)  # fmt: skip
# Parts of the names of channels that may be commands.
_LIKE_MOTORS: Final = ("throttle_", "motor", "rcou", "output", "pwm")
_UNITS: Final = {"acc.": GRAVITY, "SCALED_IMU": 1e-3 * GRAVITY, "RAW_IMU": 1e-3 * GRAVITY}


@dataclass(frozen=True)
class ThrottleChannels:
    """The user's choices: the channel of an engine by its number from 1, and the values of throttle 0 and 1."""

    throttles: Table[int, str] = field(default_factory=dict)
    limits: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class RecordedFlight:
    """A log resampled at control steps of ``step`` s, at ``times`` [s] of its clock; NaN where it has no value.

    ``throttle`` (n, jets), 0 to 1, and ``tilt`` (n, servos), rad, act over the step; ``rate`` (n, 3) [rad/s, FRD],
    ``force`` (n, 3) [m/s^2, FRD], ``angles`` (n, 3) [rad], ``velocity`` (n, 3) [m/s, NED] and ``altitude`` (n,) [m] are
    measured at its beginning.  ``usable`` (n,): commands and rates are there, without a gap, and it flies.
    """

    step: float
    times: Array
    throttle: Array
    tilt: Array
    rate: Array
    force: Array
    angles: Array
    velocity: Array
    altitude: Array
    usable: Flags
    notes: tuple[str, ...]

    @property
    def has_force(self) -> bool:
        """Whether the log has an accelerometer."""
        return bool(np.isfinite(self.force).any())

    @property
    def has_angles(self) -> bool:
        """Whether the log has an attitude."""
        return bool(np.isfinite(self.angles).any())

    @property
    def has_velocity(self) -> bool:
        """Whether the log has a velocity over the ground."""
        return bool(np.isfinite(self.velocity).any())


def is_simulated(log: FlightLog) -> bool:
    """Return whether a log is a run of this program, an export of one, or lies in the folder of one."""
    folders = [log.path, *log.path.absolute().parents[:2]]
    names = [name.partition(".")[0] for name in log.channels]
    ours = set(names) >= OWN_COLUMNS or any(name.startswith(OWN_TOPICS) for name in names)
    return ours or any((folder / SUMMARY).is_file() for folder in folders)


def hash_log(log: FlightLog) -> str:
    """Return the SHA-256 of a log's file; of a run's folder, that of the log in it."""
    with (log.path / LOG if log.path.is_dir() else log.path).open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


def record_flight(
    log: FlightLog,
    vehicle: Vehicle,
    step: float,
    mapping: ThrottleChannels,
    part: tuple[float | None, float | None],
    max_throttle: float = 1.5,
) -> RecordedFlight:
    """Resample a log at a vehicle's control steps, between the times ``part`` [s].

    A command holds from its stamp to the next; where the log has several rows in a step, they are averaged.  Raises
    InputError for a log that lacks commands of engines or rates, has slow ones, or those of another number of engines,
    and where they exceed ``max_throttle``: then they are no throttles from 0 to 1.
    """
    notes: list[str] = list(log.remarks)
    columns = match_columns(log) | dict(log.channels)
    gyros = _find_gyros(log, columns, notes)
    throttles, tilts = _find_throttles(log, vehicle, mapping, notes), _find_tilts(columns, vehicle)
    clock = _make_clock(log, [*throttles, *gyros], step, part)
    _check_command_rate(log, throttles[0])
    throttle = np.stack([_hold_on_clock(channel, clock, step) for channel in throttles], axis=1)
    tilt = np.reshape([_hold_on_clock(channel, clock, step) for channel in tilts], (len(tilts), len(clock))).T
    if (most := float(np.nanmax(throttle))) > max_throttle:
        raise InputError(f"{log.path}: throttles up to {most:g}: say what 0 and 1 are (throttle_range)")
    rate = np.stack([_sample_on_clock(channel, clock, step) for channel in gyros], axis=1)
    ground = _sample_optional(columns, ("on_ground", "vehicle_land_detected.landed"), clock, step)
    usable = np.isfinite(np.concatenate([throttle, rate], axis=1)).all(axis=1) & ~(ground > 0.5)
    usable &= _has_no_gap(throttles[0], clock, step) & _has_no_gap(gyros[0], clock, step)
    if (seconds := float(np.sum(usable)) * step) < MIN_DURATION_S:
        raise InputError(
            f"{log.path}: {seconds:.2f} s have commands and rates without a gap, in the air; {MIN_DURATION_S:g} s "
            "are needed"
        )
    angles = [(f"{axis}_measured_rad", f"{axis}_rad") for axis in AXES]
    velocities = [(f"velocity_{n}_m_s", f"velocity_{n}_measured_m_s") for n in NED]
    return RecordedFlight(
        step, clock, np.clip(np.nan_to_num(throttle), 0.0, 1.0), np.nan_to_num(tilt), rate,
        _find_forces(log, columns, clock, step), _sample_vectors(_unwrap_angles(columns), angles, clock, step),
        _sample_vectors(columns, velocities, clock, step),
        _sample_optional(columns, ("altitude_m", "altitude_measured_m"), clock, step), usable, tuple(notes),
    )  # fmt: skip


def _find_gyros(log: FlightLog, columns: Table[str, Channel], notes: list[str]) -> list[Channel]:
    """Return the measured rates.  Raises InputError where one is missing."""
    rates = []
    for m, r in enumerate(RATES):
        names = (f"rate_{r}_measured_rad_s", f"rate_{r}_rad_s", *(p.format(m=m, X="XYZ"[m]) for p in _GYROS))
        if (rate := _find_channel(columns, names, notes)) is None:
            have = ", ".join(sorted(log.channels)[:12])
            raise InputError(f"{log.path}: no angular rates, such as rate_p_measured_rad_s; it has {have}"[:400])
        rates.append(rate)
    return rates


def _find_motor(log: FlightLog, n: int, mapping: ThrottleChannels) -> str | None:
    """Return the channel of an engine's command; None where the log has none."""
    if n in mapping.throttles:
        return mapping.throttles[n]
    names = [pattern.format(n=n, m=n - 1) for pattern in _MOTORS]
    return next((name for name in names if name in log.channels and np.isfinite(log.channels[name].values).any()), None)


def _find_throttles(log: FlightLog, vehicle: Vehicle, mapping: ThrottleChannels, notes: list[str]) -> list[Channel]:
    """Return the throttle, 0 to 1, of each jet."""
    jets = len(vehicle.jets)
    wrong = [n for n in mapping.throttles if not 1 <= n <= jets]
    if wrong:
        raise InputError(f"throttle {wrong[0]}=...: {vehicle.name} has engines 1 to {jets}")
    names = [_find_motor(log, n, mapping) for n in range(1, jets + 1)]
    if None in names:
        commanded = sum(name is not None for name in names)
        have = ", ".join(name for name in log.channels if any(key in name.lower() for key in _LIKE_MOTORS))
        what = f"commands of {commanded} engines" if commanded else "no commands of engines"
        raise InputError(
            f"{log.path}: {what}, and {vehicle.name} has {jets}; say throttle N=CHANNEL; of that kind it has "
            f"{have or 'nothing'}"[:400]
        )
    # The two tilts' outputs of the same kind may follow those of the engines.
    has_tilts = vehicle.servo is not None and str(names[-1]).startswith(("RCOU.", "SERVO_OUTPUT_RAW.", PX4_OUTPUTS))
    behind = jets + (2 if has_tilts else 0)
    further = next(
        (kind.format(n=behind + 1, m=behind) for kind in _MOTORS if kind.format(n=jets, m=jets - 1) == names[-1]), ""
    )
    others = log.channels[further].values if further in log.channels else np.zeros(0)
    if np.unique(others[np.isfinite(others)]).size > 1:
        raise InputError(
            f"{log.path}: commands of more engines ({further}) than the {jets} of {vehicle.name}: another aircraft?"
        )
    low, high = mapping.limits or (0.0, 1.0)
    first = str(names[0])
    kind = next((kind for kind in (first.partition(".")[0], log.kind) if kind in THROTTLE_RANGES), None)
    if mapping.limits is None and kind and not first.startswith(("throttle_", "actuator_motors")):
        low, high = THROTTLE_RANGES[kind]
        notes.append(f"{first} and the like: {low:g} is taken for throttle 0 and {high:g} for 1, as {kind} has it")
    channels = [_clean_channel(log.signal(str(name)), str(name), notes) for name in names]
    return [channel._replace(values=(channel.values - low) / (high - low)) for channel in channels]


def _find_tilts(columns: Table[str, Channel], vehicle: Vehicle) -> list[Channel]:
    """Return the commands of the servos and surfaces, in the vehicle's order; raise InputError where one is missing."""
    found: list[Channel] = []
    if not vehicle.ranges:
        return found
    servos = len(vehicle.actuators) - len(vehicle.surfaces)
    for number, name in enumerate(vehicle.actuators):
        surface = number - servos
        choices = (
            (f"tilt_{name}_command_rad", f"hexjet_tilt.command_rad[{number}]", "hexjet_tilt.command_rad")
            if surface < 0
            else (f"deflection_{name}_command", f"hexjet_deflection.command[{surface}]", "hexjet_deflection.command")
        )
        channel = _find_channel(columns, choices, [])
        fraction = _find_channel(columns, (f"actuator_servos.control[{number}]",), []) if surface < 0 else None
        if channel is None and fraction is not None and vehicle.servo is not None:
            # PX4 logs fractions of the banks' whole range.
            channel = fraction._replace(values=vehicle.servo.range_rad * fraction.values)
        if channel is None:
            raise InputError(f"no command of the {name} servo of {vehicle.name}: a column {choices[0]} is needed")
        found.append(channel)
    return found


def _find_channel(columns: Table[str, Channel], names: Sequence[str], notes: list[str]) -> Channel | None:
    """Return the first of these channels that has finite values, cleaned; None if there is none."""
    for name in names:
        if (channel := columns.get(name)) is not None and np.isfinite(channel.values).any():
            return _clean_channel(channel, name, notes)
    return None


def _clean_channel(channel: Channel, name: str, notes: list[str]) -> Channel:
    """Return a channel with finite values and growing times alone; note the rows that are left out."""
    good = np.isfinite(channel.values) & np.isfinite(channel.times)
    if not good.all():
        notes.append(f"{name}: {int(np.sum(~good))} values are no numbers; left out")
    times, values = channel.times[good], channel.values[good]
    grows = np.concatenate([[True], times[1:] > np.maximum.accumulate(times)[:-1]]) if len(times) else good[good]
    if not grows.all():
        notes.append(f"{name}: {int(np.sum(~grows))} rows whose time does not grow; left out")
    return channel._replace(times=times[grows], values=values[grows])


def _make_clock(
    log: FlightLog, channels: Sequence[Channel], step: float, part: tuple[float | None, float | None]
) -> Array:
    """Return the times of control steps; they fall on the log's rows if these are one step apart."""
    if any(len(channel.times) < 2 for channel in channels):
        raise InputError(f"{log.path}: less than two rows of commands or rates")
    begin = max(float(channel.times[0]) for channel in channels)
    end = min(float(channel.times[-1]) for channel in channels)
    if part[0] is not None:
        begin = max(begin, part[0] + step * np.ceil((begin - part[0]) / step) if part[0] < begin else part[0])
    if part[1] is not None:
        end = min(end, part[1])
    steps = int(np.floor((end - begin) / step + 1e-6)) if end > begin else 0
    if steps * step < MIN_DURATION_S:
        seconds = max(end - begin, 0.0)
        raise InputError(f"{log.path}: {seconds:.2g} s of commands and rates; {MIN_DURATION_S:g} s are needed")
    return np.asarray(begin + step * np.arange(steps + 1), np.float64)


def _check_command_rate(log: FlightLog, command: Channel, max_apart_s: float = 0.03) -> None:
    """Raise InputError for commands more than ``max_apart_s`` apart: the engines' motion is not in the log."""
    apart = float(np.median(np.diff(command.times)))
    if apart > max_apart_s:
        # How commands are logged oftener, where that is known of a kind of log.
        hint = f" ({_FASTER_LOG_HINTS[log.kind]})" if log.kind in _FASTER_LOG_HINTS else ""
        raise InputError(
            f"{log.path}: its commands are {1e3 * apart:.3g} ms apart; at most {1e3 * max_apart_s:g} ms tell "
            f"what they did{hint}"
        )


def _hold_on_clock(channel: Channel, clock: Array, step: float) -> Array:
    """Return the command of each control step: held from its stamp, or averaged where rows come faster."""
    times, values = channel.times, channel.values
    apart = float(np.median(np.diff(times)))
    if apart < 0.75 * step:
        return _mean_over_spans(times, values, clock, clock + step)
    row = np.searchsorted(times, clock + 0.25 * step, side="right") - 1
    return np.where(row >= 0, values[np.maximum(row, 0)], np.nan)


def _sample_on_clock(channel: Channel, clock: Array, step: float) -> Array:
    """Return a measurement at each step's beginning: interpolated, or averaged where rows come faster."""
    apart = float(np.median(np.diff(channel.times))) if len(channel.times) > 1 else step
    if apart < 0.75 * step:
        return _mean_over_spans(channel.times, channel.values, clock - 0.5 * step, clock + 0.5 * step)
    return np.interp(clock, channel.times, channel.values, left=np.nan, right=np.nan)


def _mean_over_spans(times: Array, values: Array, begin: Array, end: Array) -> Array:
    """Return the mean over each span of values that hold from their stamps, NaN where there is no stamp."""
    first, after = np.searchsorted(times, begin), np.searchsorted(times, end)
    total = np.concatenate([[0.0], np.cumsum(values)])
    count = after - first
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (total[after] - total[first]) / count
    between: Array = np.interp(0.5 * (begin + end), times, values)
    return np.asarray(np.where(count > 0, mean, between), np.float64)


def _has_no_gap(channel: Channel, clock: Array, step: float, max_gap: float = 5.0) -> Flags:
    """Return at which times the channel has no gap of more than ``max_gap`` control steps or rows."""
    after = np.clip(np.searchsorted(channel.times, clock), 1, len(channel.times) - 1)
    apart = channel.times[after] - channel.times[after - 1]
    return np.asarray(apart <= max_gap * max(step, float(np.median(np.diff(channel.times)))))


def _sample_optional(columns: Table[str, Channel], names: Sequence[str], clock: Array, step: float) -> Array:
    channel = _find_channel(columns, names, [])
    return np.full(len(clock), np.nan) if channel is None else _sample_on_clock(channel, clock, step)


def _sample_vectors(columns: Table[str, Channel], names: Sequence[tuple[str, ...]], clock: Array, step: float) -> Array:
    return np.stack([_sample_optional(columns, choices, clock, step) for choices in names], axis=1)


def _unwrap_angles(columns: Table[str, Channel]) -> dict[str, Channel]:
    """Return the channels of the angles, unwrapped."""
    angles = {}
    for name in (f"{axis}{suffix}_rad" for axis in AXES for suffix in ("", "_measured")):
        channel = _find_channel(columns, (name,), [])
        if channel is not None:
            angles[name] = channel._replace(values=np.unwrap(channel.values))
    return angles


def _find_forces(log: FlightLog, columns: Table[str, Channel], clock: Array, step: float) -> Array:
    """Return the specific force, m/s^2 FRD."""
    for pattern in _FORCES:
        names = [pattern.format(x=x, X=x.upper(), m=m) for m, x in enumerate(XYZ)]
        if all(_find_channel(columns, (name,), []) is not None for name in names):
            unit = next((value for key, value in _UNITS.items() if pattern.startswith(key)), 1.0)
            turned = np.array([1.0, -1.0, -1.0]) if log.kind in FORWARD_LEFT_UP_KINDS else np.ones(3)
            return _sample_vectors(columns, [(name,) for name in names], clock, step) * unit * turned
    return np.full((len(clock), 3), np.nan)
