"""The topics of a ULog and what each field of theirs holds: rows of a log to PX4's names, frames and units."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.constants import SENSORS
from cosim.base.signals import AXES
from cosim.logs import HEXJET, RATES, LoggedVehicle, jets_in
from hexjet_export.logs.contents import Block, quaternions

MAX_MOTORS = 12  # size of PX4's actuator_motors
_XYZ, _NED = ("x", "y", "z"), ("north", "east", "down")  # axes of body and NED

# Values of PX4's vehicle_status: armed, and the flight modes that are nearest to ours.
_ARMED, _ALTITUDE_MODE, _STABILIZED_MODE, _ACRO_MODE = 2, 1, 15, 10


class Field(NamedTuple):
    """One field of a topic: ``length`` values of a ULog type (0: a scalar), read from a block of log rows."""

    kind: str
    name: str
    length: int
    values: Callable[[Block], Array]


def _array_field(kind: str, name: str, *columns: str) -> Field:
    """Return a field whose elements are columns of the log, unchanged."""
    return Field(kind, name, len(columns), lambda block: np.stack([block[column] for column in columns], axis=1))


def column(kind: str, name: str, column: str, factor: float = 1.0) -> Field:
    """Return a scalar field: a column of the log times a factor."""
    return Field(kind, name, 0, lambda block: factor * block[column])


def _optional(kind: str, name: str, *columns: str, length: int = 0) -> Field:
    """Return a field whose elements are columns of the log, NaN for those that an older log lacks."""

    def values(block: Block) -> Array:
        missing = np.full(len(block["time_s"]), np.nan)
        blocks = [block.get(column, missing) for column in columns]
        return np.stack(blocks, axis=1) if length else blocks[0]

    return Field(kind, name, length, values)


def _constant_field(kind: str, name: str, value: float) -> Field:
    return Field(kind, name, 0, lambda block: np.full(len(block["time_s"]), value))


def _sample_time() -> Field:
    """Return the field of the sample's time, which is that of publishing."""
    return Field("uint64_t", "timestamp_sample", 0, lambda block: np.rint(1e6 * block["time_s"]))


def _quaternion_field(name: str, pattern: str) -> Field:
    """Return the quaternion field, body to NED, of three columns of attitude angles."""
    return Field("float", name, 4, lambda block: quaternions(*(block[pattern.format(axis)] for axis in AXES)))


def _thrust_body(block: Block) -> Array:
    """Return the collective as PX4's thrust vector: along -z, 0 to 1."""
    still = np.zeros_like(block["collective"])
    return np.stack((still, still, -block["collective"]), axis=1)


def _motor_throttles(block: Block) -> Array:
    """Return the throttles of as many motors as the message has; NaN for motors that do not exist."""
    control = np.full((len(block["time_s"]), MAX_MOTORS), np.nan)
    for jet in range(min(jets_in(block), MAX_MOTORS)):  # all throttles are in hexjet_throttle
        control[:, jet] = block[f"throttle_{jet + 1}"]
    return control


def _flight_mode(block: Block) -> Array:
    """Return PX4's flight mode by the closed loops: rates only, attitude, attitude and height."""
    mode = np.where(np.isnan(block["altitude_setpoint_m"]), _STABILIZED_MODE, _ALTITUDE_MODE)
    return np.where(np.isnan(block["roll_setpoint_rad"]), _ACRO_MODE, mode).astype(float)


def _estimated_position() -> list[Field]:
    """Return the fields of PX4's vehicle_local_position as the autopilot estimates it.

    Not valid before the autopilot's first estimate.  Height, climb and heading that an older record lacks are as
    measured.
    """

    def make_validity_field(name: str) -> Field:
        return Field("bool", name, 0, lambda block: np.nan_to_num(block[f"autopilot_{name}"]))

    def make_estimate_field(name: str, column: str, factor: float = 1.0) -> Field:
        def values(block: Block) -> Array:
            estimates = block[f"autopilot_{name}"]
            return np.where(np.isnan(estimates), factor * block[column], estimates)

        return Field("float", name, 0, values)

    return [
        _sample_time(),
        *(make_validity_field(name) for name in ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")),
        *(column("float", name, f"autopilot_{name}") for name in ("x", "y")),
        make_estimate_field("z", "altitude_measured_m", -1.0),
        *(column("float", name, f"autopilot_{name}") for name in ("vx", "vy")),
        make_estimate_field("vz", "velocity_down_measured_m_s"),
        make_estimate_field("heading", "yaw_measured_rad"),
        *(column("float", name, f"autopilot_{name}") for name in ("eph", "epv", "evh", "evv")),
        Field("bool", "dead_reckoning", 0, lambda block: block["autopilot_xy_valid"] == 0.0),
    ]


def _local_position(suffix: str) -> list[Field]:
    """Return the fields of PX4's vehicle_local_position from true columns, or measured ones by ``suffix``."""
    names = zip(_XYZ, _NED, strict=True)
    pairs = [(xyz, f"{ned}{suffix}_m", f"velocity_{ned}{suffix}_m_s") for xyz, ned in names]
    return [
        _sample_time(),
        *(_constant_field("bool", name, 1.0) for name in ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")),
        *(column("float", xyz, axis) for xyz, axis, _ in pairs),
        *(column("float", f"v{xyz}", speed) for xyz, _, speed in pairs),
        column("float", "heading", f"yaw{suffix}_rad"),
    ]


def _rate_columns(suffix: str) -> list[str]:
    return [f"rate_{rate}{suffix}_rad_s" for rate in RATES]


def topics(vehicle: LoggedVehicle) -> dict[str, list[Field]]:
    """Return the fields of each ULog topic for the log of a vehicle."""
    jets, servos, surfaces, _ = vehicle
    moved = [*servos, *surfaces]

    def jet_columns(pattern: str) -> list[str]:
        return [pattern.format(jet) for jet in range(1, jets + 1)]

    found = {
        "vehicle_attitude": [_sample_time(), _quaternion_field("q", "{}_measured_rad")],
        "vehicle_attitude_groundtruth": [_sample_time(), _quaternion_field("q", "{}_rad")],
        "vehicle_attitude_setpoint": [
            _quaternion_field("q_d", "{}_setpoint_rad"),
            Field("float", "thrust_body", 3, _thrust_body),
        ],
        "vehicle_angular_velocity": [_sample_time(), _array_field("float", "xyz", *_rate_columns("_measured"))],
        "vehicle_angular_velocity_groundtruth": [_sample_time(), _array_field("float", "xyz", *_rate_columns(""))],
        "vehicle_rates_setpoint": [
            *(column("float", axis, rate) for axis, rate in zip(AXES, _rate_columns("_setpoint"), strict=True)),
            Field("float", "thrust_body", 3, _thrust_body),
        ],
        "vehicle_local_position": _local_position("_measured"),
        "vehicle_local_position_groundtruth": _local_position(""),
        "vehicle_local_position_setpoint": [
            *(_optional("float", xy, f"{direction}_setpoint_m") for xy, direction in (("x", "north"), ("y", "east"))),
            column("float", "z", "altitude_setpoint_m", -1.0),
            *(_constant_field("float", name, np.nan) for name in ("vx", "vy", "vz", "yaw")),
        ],
        "sensor_combined": [
            _array_field("float", "gyro_rad", *_rate_columns("_measured")),
            _constant_field("int32_t", "accelerometer_timestamp_relative", 0.0),
            _array_field("float", "accelerometer_m_s2", *(f"specific_force_{axis}_measured_m_s2" for axis in _XYZ)),
        ],
        "actuator_motors": [_sample_time(), Field("float", "control", MAX_MOTORS, _motor_throttles)],
        "vehicle_status": [
            _constant_field("uint8_t", "arming_state", _ARMED),
            Field("uint8_t", "nav_state", 0, _flight_mode),
        ],
        "vehicle_land_detected": [
            column("bool", "landed", "on_ground"),
            column("bool", "maybe_landed", "on_ground"),
            column("bool", "ground_contact", "on_ground"),
        ],
        "wind": [
            _sample_time(),
            column("float", "windspeed_north", "wind_north_m_s"),
            column("float", "windspeed_east", "wind_east_m_s"),
        ],
        "hexjet_height": [  # above the ground, not the sea
            column("float", "true_m", "altitude_m"),
            column("float", "measured_m", "altitude_measured_m"),
            column("float", "setpoint_m", "altitude_setpoint_m"),
        ],
        "hexjet_thrust": [_array_field("float", "newton", *jet_columns("thrust_{}_N"))],
        "hexjet_engine": [  # NaN where an engine does not report it
            _array_field("float", "spool_speed_rad_s", *jet_columns("spool_speed_{}_rad_s")),
            _array_field("float", "exhaust_temperature_k", *jet_columns("exhaust_temperature_{}_K")),
            _array_field("float", "fuel_flow_kg_s", *jet_columns("fuel_flow_{}_kg_s")),
            column("float", "fuel_kg", "fuel_kg"),
            _array_field("float", "spool_moment_n_m", *(f"spool_moment_{axis}_N_m" for axis in _XYZ)),
        ],
        "hexjet_rate_predicted": [_array_field("float", "xyz", *_rate_columns("_predicted"))],
        "hexjet_throttle": [_array_field("float", "throttle", *jet_columns("throttle_{}"))],
        "hexjet_tilt": [
            _array_field("float", "actual_rad", *(f"tilt_{name}_rad" for name in servos)),
            _array_field("float", "command_rad", *(f"tilt_{name}_command_rad" for name in servos)),
        ],
        "hexjet_deflection": [
            _array_field("float", "actual", *(f"deflection_{name}" for name in surfaces)),
            _array_field("float", "command", *(f"deflection_{name}_command" for name in surfaces)),
        ],
        "hexjet_control": [
            _array_field("float", "torque", *(f"torque_{axis}" for axis in AXES)),
            _array_field("float", "refused", *(f"refused_{axis}" for axis in AXES)),
            column("float", "collective", "collective"),
            column("float", "refused_collective", "refused_collective"),
        ],
        "hexjet_disturbance": [
            _array_field("float", "force_n", *(f"disturbance_force_{axis}_N" for axis in _XYZ)),
            _array_field("float", "moment_n_m", *(f"disturbance_moment_{axis}_N_m" for axis in _XYZ)),
            _array_field("float", "torque", *(f"disturbance_torque_{axis}" for axis in AXES)),
            column("float", "payload_kg", "payload_kg"),
            column("float", "mass_kg", "mass_kg"),
            _optional("float", "air_rate_rad_s", *(f"air_rate_{rate}_rad_s" for rate in RATES), length=len(RATES)),
        ],
        "hexjet_fault": [  # fault 1: active; health 1: healthy
            _optional("float", "jet", *jet_columns("fault_jet_{}"), length=jets),
            _optional("float", "servo", *(f"fault_servo_{name}" for name in moved), length=len(moved)),
            _optional("float", "sensor", *(f"fault_{name}" for name in SENSORS), length=len(SENSORS)),
            _optional("float", "health", *jet_columns("health_{}"), length=jets),
        ],
    }
    missing = {"hexjet_throttle": jets <= MAX_MOTORS, "hexjet_tilt": not servos, "hexjet_deflection": not surfaces}
    return {name: fields for name, fields in found.items() if not missing.get(name)}


TOPICS = topics(HEXJET)  # topics of a vehicle with six jets

CUSTOM = "hexjet_own"  # topic of columns that blocks added

# Topics that an autopilot's record replaces, and topics that it adds.
REPLACED_TOPICS = ("vehicle_status", "vehicle_land_detected")
AUTOPILOT_TOPICS: dict[str, list[Field]] = {
    "vehicle_local_position": _estimated_position(),
    "vehicle_local_position_setpoint": [
        *(column("float", name, f"autopilot_{name}_sp") for name in ("x", "y", "z")),
        *(_constant_field("float", name, np.nan) for name in ("vx", "vy", "vz")),
        column("float", "yaw", "autopilot_yaw_sp"),
    ],
    "hexjet_gnss": _local_position("_measured"),  # as received
}
# Seconds between a topic's messages, about those of PX4's default profile (its logged_topics.cpp).
INTERVAL_S = dict.fromkeys((*TOPICS, *AUTOPILOT_TOPICS, CUSTOM), 0.2)
INTERVAL_S |= dict.fromkeys(("vehicle_angular_velocity", "vehicle_rates_setpoint", "hexjet_rate_predicted"), 0.02)
INTERVAL_S |= dict.fromkeys(("vehicle_attitude", "vehicle_attitude_setpoint", "hexjet_control"), 0.05)
INTERVAL_S |= dict.fromkeys(
    (
        *("vehicle_attitude_groundtruth", "vehicle_angular_velocity_groundtruth", "vehicle_local_position"),
        *("vehicle_local_position_setpoint", "sensor_combined", "actuator_motors"),
        *("hexjet_thrust", "hexjet_tilt", "hexjet_throttle", "hexjet_deflection"),
    ),
    0.1,
)
