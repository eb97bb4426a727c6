"""The vehicle's messages out, each a function of one snapshot; units and invalid values as the definitions have them.

An unknown quantity is left out or sent as unknown; no value is invented for a gauge.
"""

from __future__ import annotations

from math import atan2, degrees, hypot, isfinite, isnan, nan, pi

from cosim.base.constants import GRAVITY
from cosim.base.frames import conjugate, from_euler, rotate
from cosim.control.autopilot.estimation.wind import estimate_wind
from cosim.control.autopilot.modes import Home, LandedState, Mode
from cosim.control.autopilot.status import Status
from cosim.groundstation.mavlink.modes import AUTOPILOT, LANDED, MODES, STANDARD, base_mode, custom_mode, vehicle_type
from cosim.groundstation.mavlink.telemetry_state import (
    I16,
    I32,
    U8,
    U16,
    TelemetryState,
    VehicleConstants,
    to_e7,
    to_field,
    to_mm,
)
from cosim.groundstation.mavlink.wire.dialect import Message, mav
from cosim.vehicle.atmosphere import standard_air, standard_density

_GYRO, _ACCEL, _MAG, _BARO, _GPS = 1, 2, 4, 8, 32  # MAV_SYS_STATUS_SENSOR
_RATE, _ATTITUDE, _YAW, _HEIGHT, _POSITION, _MOTORS = 1024, 2048, 4096, 8192, 16384, 32768  # MAV_SYS_STATUS_SENSOR
_GEOFENCE, _AHRS, _BATTERY, _PREARM, _PROPULSION = 1 << 20, 1 << 21, 1 << 25, 1 << 28, 1 << 30  # MAV_SYS_STATUS_SENSOR
# Sensors reported as present. There is no magnetometer, as attitude is measured with the heading, but without its bit
# MAVSDK never reports the vehicle as ready.
_PRESENT = _GYRO | _ACCEL | _MAG | _BARO | _GPS | _RATE | _ATTITUDE | _YAW | _HEIGHT | _POSITION | _MOTORS | _AHRS

# Bits of MAV_PROTOCOL_CAPABILITY that this vehicle has.
_CAPABILITIES = 2 | 4 | 8 | 32 | 64 | 128 | 256 | 2048 | 8192 | 16384 | 32768
_BYTEWISE, _C_CAST = 16, 131072  # parameter encodings
PARAMETER_ENCODING = {"px4": _BYTEWISE, "ardupilot": _C_CAST, "generic": 0}  # bit of MAV_PROTOCOL_CAPABILITY

# Bits of HIGHRES_IMU_UPDATED_FLAGS: three axes of each sensor; absolute pressure and its height.
_FORCE_FIELDS, _GYRO_FIELDS, _BAROMETER_FIELDS = 0b111, 0b111_000, 1 << 9 | 1 << 11
_LOCAL_NED, _BODY_FRD = 1, 12  # MAV_FRAME
_NO_MISSION, _NOT_STARTED, _ACTIVE, _PAUSED, _COMPLETE = 1, 2, 3, 4, 5  # MISSION_STATE


def heartbeat(v: TelemetryState) -> list[Message]:
    status, personality = v.status, v.vehicle.personality
    state = 5 if status.failsafe else 4 if status.armed else 3
    base, custom = base_mode(status.mode, status.armed), custom_mode(status.mode, personality)
    kind = vehicle_type(v.vehicle.jets)
    return [mav.MAVLink_heartbeat_message(kind, AUTOPILOT[personality], base, custom, state, 3)]


def sys_status(v: TelemetryState) -> list[Message]:
    status = v.status
    has_tank = not isnan(v.vehicle.fuel_capacity)
    battery = 0 if has_tank or v.remaining is None else _BATTERY
    present = _PRESENT | _GEOFENCE | _PREARM | _PROPULSION | battery
    # The fence is reported healthy and disabled, because MAVProxy treats an unhealthy fence as breached.
    enabled = present & ~_GEOFENCE
    lost = any(health == 0.0 for health in v.sample.health[: v.vehicle.jets])
    bad = (_PREARM if not (status.ready or status.armed) else 0) | (_PROPULSION if lost else 0) | _list_unhealthy(v)
    health = present & ~bad
    load = v.snapshot.pace.load
    return [
        mav.MAVLink_sys_status_message(
            present, enabled, health,
            0 if load is None else to_field(load * 1000.0, 0, 1000),
            U16, -1, _battery_percent(v), 0, 0, 0, 0, 0, 0,
        )
    ]  # fmt: skip


def _list_unhealthy(v: TelemetryState) -> int:
    """Return MAV_SYS_STATUS_SENSOR bits of untrusted sensors and of the control loops that need them."""
    quality = v.status.quality
    return sum(
        bits
        for bits, trusted in (
            (_GYRO, quality.gyro),
            (_ACCEL, quality.accelerometer),
            (_BARO, quality.barometer),
            (_GPS | _POSITION, quality.gnss),
            (_MAG | _YAW, quality.attitude_sensor),
            (_AHRS | _ATTITUDE, quality.attitude),
            (_HEIGHT, quality.climb),
        )
        if not trusted
    )


def _battery_percent(v: TelemetryState) -> int:
    return -1 if v.remaining is None else to_field(100.0 * v.remaining, 0, 100)


def system_time(v: TelemetryState) -> list[Message]:
    return [mav.MAVLink_system_time_message(int(v.events.clock() * 1e6), v.ms)]


def gps_raw_int(v: TelemetryState) -> list[Message]:
    vehicle, (vn, ve, _) = v.vehicle, v.measured.velocity
    north, east, down = v.measured.position
    lat, lon, metres = vehicle.geodesy.to_geodetic(north, east, -down)
    fixed = v.status.positioned
    speed = to_field(hypot(vn, ve) * 100.0, 0, U16 - 1) if fixed else U16
    course = to_field(degrees(atan2(ve, vn) % (2.0 * pi)) * 100.0, 0, 35999) if fixed else U16
    return [
        mav.MAVLink_gps_raw_int_message(
            # Without a geoid model the ellipsoid height stays 0, which marks an extension field as not sent.
            v.us, 3 if fixed else 1, to_e7(lat), to_e7(lon), to_mm(metres), U16, U16, speed, course, U8, 0,
            to_field(vehicle.position_noise * 1e3, 0, I32), to_field(vehicle.position_noise * 1e3, 0, I32),
            to_field(vehicle.velocity_noise * 1e3, 0, I32), 0, 0,
        )
    ]  # fmt: skip


def attitude(v: TelemetryState) -> list[Message]:
    return [mav.MAVLink_attitude_message(v.ms, *v.euler, *v.estimate.rate)]


def attitude_quaternion(v: TelemetryState) -> list[Message]:
    return [mav.MAVLink_attitude_quaternion_message(v.ms, *v.estimate.attitude, *v.estimate.rate)]


def local_position_ned(v: TelemetryState) -> list[Message]:
    fix = v.status.fix
    down = v.estimate.velocity[2]
    return [mav.MAVLink_local_position_ned_message(v.ms, *fix.position, -v.altitude, *fix.velocity, down)]


def global_position_int(v: TelemetryState) -> list[Message]:
    vn, ve = v.status.fix.velocity
    speeds = (to_field(speed * 100.0, -I16, I16) for speed in (vn, ve, v.estimate.velocity[2]))
    heading = to_field(degrees(v.euler[2]) % 360.0 * 100.0, 0, 35999)
    lat, lon = v.position_deg
    return [
        mav.MAVLink_global_position_int_message(
            v.ms, to_e7(lat), to_e7(lon), to_mm(v.altitude_above_sea), to_mm(v.height_above_home), *speeds, heading
        )
    ]  # fmt: skip


def vfr_hud(v: TelemetryState) -> list[Message]:
    heading = to_field(degrees(v.euler[2]) % 360.0, 0, 360) % 360
    throttle = to_field(100.0 * v.sample.control.collective, 0, 100)
    speed = hypot(*v.status.fix.velocity)
    # There is no airspeed sensor on board.
    return [mav.MAVLink_vfr_hud_message(nan, speed, heading, throttle, v.altitude_above_sea, -v.estimate.velocity[2])]


def attitude_target(v: TelemetryState) -> list[Message]:
    command = v.sample.command
    quaternion = from_euler(*command.attitude)
    mask = 0 if command.rate is None else 128  # bit 7: ignore attitude, use rates
    return [
        mav.MAVLink_attitude_target_message(
            v.ms, mask, quaternion, *v.sample.control.rate_setpoint, v.sample.control.collective
        )
    ]


# Type mask of a target with position and yaw, without velocity, acceleration and yaw rate.
_POSITION_ONLY = 0b1101_1111_1000


def position_target_local_ned(v: TelemetryState) -> list[Message]:
    target = v.status.target
    if target is None:
        return []
    return [
        mav.MAVLink_position_target_local_ned_message(
            v.ms, _LOCAL_NED, _POSITION_ONLY & ~(1 << 10), target.north, target.east, -target.altitude,
            0.0, 0.0, 0.0, 0.0, 0.0, 0.0, v.status.yaw, 0.0,
        )
    ]  # fmt: skip


def position_target_global_int(v: TelemetryState) -> list[Message]:
    target = v.status.target
    if target is None:
        return []
    lat, lon, height = v.vehicle.geodesy.to_geodetic(*target)
    return [
        mav.MAVLink_position_target_global_int_message(
            v.ms, 5, _POSITION_ONLY & ~(1 << 10), to_e7(lat), to_e7(lon), height,
            0.0, 0.0, 0.0, 0.0, 0.0, 0.0, v.status.yaw, 0.0,
        )
    ]  # fmt: skip


def altitude(v: TelemetryState) -> list[Message]:
    return [
        mav.MAVLink_altitude_message(v.us, v.altitude, v.altitude_above_sea, v.altitude, v.height_above_home, nan, nan)
    ]


def battery_status(v: TelemetryState) -> list[Message]:
    """Return BATTERY_STATUS with the remaining fuel or battery [%], as stations show no fuel message."""
    function = 1 if isnan(v.vehicle.fuel_capacity) else 2  # MAV_BATTERY_FUNCTION: all, propulsion
    voltages, percent = [U16] * 10, _battery_percent(v)
    return [mav.MAVLink_battery_status_message(0, function, 0, I16, voltages, -1, -1, -1, percent, 0, 0, [0] * 4, 0, 0)]


def autopilot_version(v: TelemetryState) -> list[Message]:
    vehicle = v.vehicle
    version = _encode_version(vehicle.version)
    capabilities = _CAPABILITIES | PARAMETER_ENCODING[vehicle.personality]
    identity = list(vehicle.name.encode()[:18].ljust(18, b"\0"))
    return [
        mav.MAVLink_autopilot_version_message(
            capabilities, version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, vehicle.system, identity
        )
    ]


def _encode_version(text: str) -> int:
    """Return the version as four bytes: major, minor, patch and kind of release.

    QGroundControl asks for an update of anything below 1.4.1, so what this project calls 0.1 is 2.1 here.  The kind is
    128, a beta: an official release would be compared with PX4's newest.
    """
    major, minor, patch = parse_version(text)
    return min(major + 2, U8) << 24 | minor << 16 | patch << 8 | 128


def parse_version(version: str) -> tuple[int, int, int]:
    """Return major, minor and patch of a version, each clipped to a byte."""
    numbers = [min(int(part), U8) if part.isdigit() else 0 for part in version.split(".")[:3]]
    major, minor, patch = (*numbers, 0, 0, 0)[:3]
    return major, minor, patch


def protocol_version(v: TelemetryState) -> list[Message]:
    return [mav.MAVLink_protocol_version_message(200, 100, 200, [0] * 8, [0] * 8)]


def component_information_basic(v: TelemetryState) -> list[Message]:
    capabilities = _CAPABILITIES | PARAMETER_ENCODING[v.vehicle.personality]
    name, version = v.vehicle.name.encode()[:31], v.vehicle.version.encode()[:23]
    return [mav.MAVLink_component_information_basic_message(v.ms, capabilities, 0, b"", name, version, b"", b"")]


def home_position(v: TelemetryState) -> list[Message]:
    home: Home | None = v.status.home
    if home is None:
        return []
    lat, lon, height = v.vehicle.geodesy.to_geodetic(*home)
    return [
        mav.MAVLink_home_position_message(
            to_e7(lat), to_e7(lon), to_mm(height), home.north, home.east, -home.altitude, [1.0, 0.0, 0.0, 0.0],
            nan, nan, nan, v.us,
        )
    ]  # fmt: skip


def orbit_execution_status(v: TelemetryState) -> list[Message]:
    """Return ORBIT_EXECUTION_STATUS: centre and radius [m] of the present orbit (negative: to the left)."""
    orbit, centre = v.status.orbit, v.status.target
    if orbit is None or centre is None:
        return []
    lat, lon, height = v.vehicle.geodesy.to_geodetic(*centre)
    radius = orbit.radius if orbit.clockwise else -orbit.radius
    return [mav.MAVLink_orbit_execution_status_message(v.us, radius, 5, to_e7(lat), to_e7(lon), height)]


def gps_global_origin(v: TelemetryState) -> list[Message]:
    start = v.vehicle.geodesy
    return [
        mav.MAVLink_gps_global_origin_message(
            to_e7(start.latitude_deg), to_e7(start.longitude_deg), to_mm(start.ground), v.us
        )
    ]


def extended_sys_state(v: TelemetryState) -> list[Message]:
    return [mav.MAVLink_extended_sys_state_message(0, LANDED[v.status.landed])]


def estimator_status(v: TelemetryState) -> list[Message]:
    """Return ESTIMATOR_STATUS: which estimates are valid, absolute positions only with a home.

    A position that is dead-reckoned without fixes counts as relative, as far as its speed is valid.  Where no
    autopilot estimates anything the accuracies are the sensors'.
    """
    quality, home, vehicle = v.status.quality, v.status.home is not None, v.vehicle
    position_accuracy = vehicle.position_noise if isnan(quality.position_m) else quality.position_m
    height_accuracy = vehicle.height_noise if isnan(quality.height_m) else quality.height_m
    flags = sum(
        bits
        for bits, valid in (
            (1, quality.attitude),
            (2 | 8, quality.speed),
            (4, quality.climb),
            (256, home and quality.speed),
            (16 | 512, home and quality.position),
            (32, home and quality.height),
        )
        if valid
    )
    return [mav.MAVLink_estimator_status_message(v.us, flags, *[nan] * 6, position_accuracy, height_accuracy)]


def wind_cov(v: TelemetryState) -> list[Message]:
    """Return WIND_COV: wind estimated from the force on the vehicle, as no sensor measures it."""
    status, fix = v.status, v.status.fix
    if status.landed is LandedState.ON_GROUND or not status.positioned:
        return []
    vehicle, thrust = v.snapshot.info.vehicle, v.sample.engines.thrust[: v.vehicle.jets]
    density = standard_density(v.altitude_above_sea)
    wind = estimate_wind(vehicle, fix.disturbance, fix.velocity, v.euler, thrust, density)
    if wind is None:
        return []
    return [mav.MAVLink_wind_cov_message(v.us, *wind, nan, nan, nan, v.altitude_above_sea, nan, nan)]


def current_mode(v: TelemetryState) -> list[Message]:
    mode = v.status.mode
    number = custom_mode(mode, v.vehicle.personality)
    return [mav.MAVLink_current_mode_message(STANDARD.get(mode, 0), number, 0)]


def available_modes(v: TelemetryState) -> list[Message]:
    return [mode_line(v.vehicle, index) for index in range(1, len(MODES) + 1)]


def mode_line(vehicle: VehicleConstants, index: int) -> Message:
    """Return AVAILABLE_MODES of one mode by its index from 1."""
    mode, name, properties = MODES[index - 1]
    number = custom_mode(mode, vehicle.personality)
    return mav.MAVLink_available_modes_message(
        len(MODES), index, STANDARD.get(mode, 0), number, properties, name.encode()
    )


def mission_progress(status: Status) -> Message:
    """Return MISSION_CURRENT: the progress of the mission."""
    return mav.MAVLink_mission_current_message(*mission_state(status))


def mission_state(status: Status) -> tuple[int, int, int, int]:
    """Return the mission's present item, number of items (65535: none), state, and whether it is flown."""
    count = status.mission_count
    return (max(0, min(status.mission_current, count - 1)), count or 65535, *_mission_state_code(status))


def _mission_state_code(status: Status) -> tuple[int, int]:
    """Return MISSION_STATE, and 1 if the mission is being flown or 2 if not."""
    flies = status.mode is Mode.MISSION and status.armed
    if not status.mission_count:
        return _NO_MISSION, 2
    if status.mission_done:
        return _COMPLETE, 1 if flies else 2
    if flies:
        return _ACTIVE, 1
    begun = status.mission_current > 0 or status.mission_reached >= 0
    return (_PAUSED if begun else _NOT_STARTED), 2


def mission_current(v: TelemetryState) -> list[Message]:
    return [mission_progress(v.status)]


def predictor_array(v: TelemetryState) -> list[Message]:
    """Return DEBUG_FLOAT_ARRAY "predictor": seven signals of roll, pitch and yaw.

    Measured rate, predicted rate, model without delay, model with delay (rad/s), delay (s), set-point of the rate
    (rad/s), command.
    """
    sample, (model, delayed, delay) = v.sample, v.predictor_signals
    rows = (
        sample.measured.rate, sample.control.rate_predicted, model, delayed, delay,
        sample.control.rate_setpoint, sample.control.torque,
    )  # fmt: skip
    values = [value for row in rows for value in row]
    return [mav.MAVLink_debug_float_array_message(v.us, b"predictor", 1, values + [0.0] * (58 - len(values)))]


def named_values(v: TelemetryState) -> list[Message]:
    """Return NAMED_VALUE_FLOAT messages of the roll predictor, for tools that plot single numbers."""
    sample, (model, _, delay) = v.sample, v.predictor_signals
    measured, predicted = sample.measured.rate[0], sample.control.rate_predicted[0]
    values = {
        b"rate_p": measured,
        b"pred_p": predicted,
        b"pred_err": predicted - measured,
        b"model_p": model[0],
        b"delay_ms": delay[0] * 1e3,
    }
    return [
        mav.MAVLink_named_value_float_message(v.ms, name, value) for name, value in values.items() if isfinite(value)
    ]


def debug_vect(v: TelemetryState) -> list[Message]:
    """Return DEBUG_VECT with the predicted body rates [rad/s]."""
    return [mav.MAVLink_debug_vect_message(b"rate_pred", v.us, *v.sample.control.rate_predicted)]


def flight_information(v: TelemetryState) -> list[Message]:
    events = v.events
    return [
        mav.MAVLink_flight_information_message(v.ms, events.armed, events.took_off, events.flights, events.landed_ms)
    ]


def odometry(v: TelemetryState) -> list[Message]:
    """Return ODOMETRY: position and attitude in NED, velocity and rates in body axes."""
    fix = v.status.fix
    velocity = (*fix.velocity, v.estimate.velocity[2])
    body = rotate(conjugate(v.estimate.attitude), velocity)
    unknown = [nan] * 21
    return [
        mav.MAVLink_odometry_message(
            v.us, _LOCAL_NED, _BODY_FRD, *fix.position, -v.altitude, v.estimate.attitude, *body, *v.estimate.rate,
            unknown, unknown, 0, 8, 0,
        )
    ]  # fmt: skip


def highres_imu(v: TelemetryState) -> list[Message]:
    """Return HIGHRES_IMU: measured rates and specific force, and barometric height with standard pressure.

    The force is marked invalid without an accelerometer.
    """
    force, rate, height = v.measured.specific_force, v.measured.rate, v.vehicle.geodesy.ground + v.measured.altitude
    pressure = 0.01 * standard_air(height)[0]  # hPa
    updated = _GYRO_FIELDS | _BAROMETER_FIELDS | (0 if isnan(force[2]) else _FORCE_FIELDS)
    return [mav.MAVLink_highres_imu_message(v.us, *force, *rate, nan, nan, nan, pressure, nan, height, nan, updated, 0)]


def hil_state_quaternion(v: TelemetryState) -> list[Message]:
    """Return HIL_STATE_QUATERNION: the true state of the simulation."""
    state = v.sample.state
    lat, lon, height = v.vehicle.geodesy.to_geodetic(*state.position[:2], state.altitude)
    speeds = [to_field(speed * 100.0, -I16, I16) for speed in state.velocity]
    air = to_field(100.0 * hypot(*(a - b for a, b in zip(state.velocity, state.wind, strict=True))), 0, U16)
    force = [to_field(value / GRAVITY * 1e3, -I16, I16) for value in state.specific_force]
    return [
        mav.MAVLink_hil_state_quaternion_message(
            v.us, state.attitude, *state.rate, to_e7(lat), to_e7(lon), to_mm(height),
            *speeds, air, air, *force,
        )
    ]  # fmt: skip


def statustext(severity: int, text: str, number: int) -> list[Message]:
    """Return STATUSTEXT messages of 50 characters each for a text, grouped by ``number`` (not 0)."""
    data = text.encode("ascii", "replace")[: 50 * 256]
    if len(data) <= 50:
        return [mav.MAVLink_statustext_message(severity, data)]
    pieces = [data[i : i + 50] for i in range(0, len(data), 50)]
    if len(pieces[-1]) == 50 and len(pieces) < 256:
        pieces.append(b"")  # a full piece is followed by another
    number = number % U16 + 1
    return [mav.MAVLink_statustext_message(severity, piece, number, i) for i, piece in enumerate(pieces)]
