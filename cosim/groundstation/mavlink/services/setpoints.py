"""MANUAL_CONTROL and SET_*_TARGET: sticks and set-points that come many times a second, without an acknowledgement."""

from __future__ import annotations

from math import cos, isfinite, remainder, sin, tau

from cosim.base.errors import InputError
from cosim.control.autopilot.requests import OffboardAttitude, OffboardPosition, OffboardVelocity, Sticks
from cosim.groundstation.mavlink.services.mav_command import ABSOLUTE_FRAMES, LOCAL_NED, RELATIVE_FRAMES
from cosim.groundstation.mavlink.telemetry_state import TelemetryState
from cosim.groundstation.mavlink.wire.dialect import Message

_OFFSET_NED, _BODY_NED, _BODY_OFFSET, _BODY_FRD = 7, 8, 9, 12  # MAV_FRAME
_HEADING_FRAMES = (_BODY_NED, _BODY_OFFSET, _BODY_FRD)  # velocities along the heading
# Bits of POSITION_TARGET_TYPEMASK that mark fields as ignored.
_POSITION, _VELOCITY, _YAW, _YAW_RATE = 0b111, 0b111 << 3, 1 << 10, 1 << 11
# Bits of ATTITUDE_TARGET_TYPEMASK that mark fields as ignored.
_NO_RATES, _NO_THRUST, _NO_ATTITUDE = 0b111, 1 << 6, 1 << 7

OffboardSetpoint = OffboardAttitude | OffboardVelocity | OffboardPosition


def parse_sticks(message: Message) -> Sticks:
    """Return the sticks in MANUAL_CONTROL: x forward, y right, z thrust 0 to 1000, r yaw to the right.

    Raises InputError for an axis that is not sent or out of range.
    """
    axes = (message.x, message.y, message.r, message.z)
    if any(not -1000 <= axis <= 1000 for axis in axes):
        raise InputError("sticks: x, y, z and r must all be given, from -1000 to 1000")
    return Sticks(message.y / 1000.0, message.x / 1000.0, message.r / 1000.0, max(0, message.z) / 1000.0)


def parse_attitude(message: Message) -> OffboardAttitude:
    """Return the set-point in SET_ATTITUDE_TARGET: attitude or three rates, and thrust.  Raises InputError."""
    mask, rates = message.type_mask, (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
    if mask & _NO_THRUST:
        raise InputError("attitude set-point: the thrust is missing")
    if not mask & _NO_ATTITUDE and all(isfinite(value) for value in message.q):
        return OffboardAttitude(quaternion=tuple(message.q), thrust=message.thrust)
    if mask & _NO_RATES:
        raise InputError("attitude set-point: neither an attitude nor three rates")
    return OffboardAttitude(rates=rates, thrust=message.thrust)


def parse_local(message: Message, state: TelemetryState) -> OffboardSetpoint:
    """Return the position or velocity set-point in SET_POSITION_TARGET_LOCAL_NED.  Raises InputError."""
    frame = message.coordinate_frame
    if frame not in (LOCAL_NED, _OFFSET_NED, *_HEADING_FRAMES):
        raise InputError(f"set-point: frame {frame} is not known here")
    heading = state.euler[2] if frame in _HEADING_FRAMES else 0.0
    yaw = _parse_yaw(message, heading)
    position = (message.x, message.y, message.z)
    if _is_complete(message.type_mask, _POSITION, position):
        x, y, z = position
        if frame in (_BODY_OFFSET, _BODY_FRD):
            x, y = _rotate_to_north(x, y, heading)
        if frame in (_OFFSET_NED, _BODY_OFFSET, _BODY_FRD):
            position_now = state.status.fix.position
            x, y, z = x + position_now[0], y + position_now[1], z - state.altitude
        return OffboardPosition(x, y, z, yaw)
    return _parse_velocity(message, heading, yaw)


def parse_global(message: Message, state: TelemetryState) -> OffboardSetpoint:
    """Return the position or velocity set-point in SET_POSITION_TARGET_GLOBAL_INT.  Raises InputError."""
    frame = message.coordinate_frame
    if frame not in (*ABSOLUTE_FRAMES, *RELATIVE_FRAMES):
        raise InputError(f"set-point: frame {frame} is not known here")
    yaw = _parse_yaw(message, 0.0)
    lat, lon = message.lat_int * 1e-7, message.lon_int * 1e-7
    if not _is_complete(message.type_mask, _POSITION, (lat, lon, message.alt)):
        return _parse_velocity(message, 0.0, yaw)
    if not (-90.0 <= lat <= 90.0 and -180.0 <= lon <= 180.0):
        raise InputError(f"set-point: {lat:g}, {lon:g} is no latitude and longitude")
    geodesy = state.vehicle.geodesy
    altitude = message.alt + (state.altitude - state.height_above_home if frame in RELATIVE_FRAMES else -geodesy.ground)
    north, east, _ = geodesy.to_local(lat, lon, geodesy.ground + altitude)
    return OffboardPosition(north, east, -altitude, yaw)


def _parse_velocity(message: Message, heading: float, yaw: float | None) -> OffboardVelocity:
    speeds = (message.vx, message.vy, message.vz)
    if not _is_complete(message.type_mask, _VELOCITY, speeds):
        raise InputError("set-point: neither a whole position nor a whole velocity")
    vx, vy = _rotate_to_north(speeds[0], speeds[1], heading)
    yaw_rate = (
        None if message.type_mask & _YAW_RATE or not isfinite(message.yaw_rate) or yaw is not None else message.yaw_rate
    )
    return OffboardVelocity(vx, vy, speeds[2], yaw, yaw_rate)


def _is_complete(mask: int, bits: int, values: tuple[float, ...]) -> bool:
    """Return whether no field of the mask is ignored and all values are finite."""
    return not mask & bits and all(isfinite(value) for value in values)


def _parse_yaw(message: Message, heading: float) -> float | None:
    if message.type_mask & _YAW or not isfinite(message.yaw):
        return None
    return remainder(message.yaw + heading, tau)


def _rotate_to_north(x: float, y: float, angle: float) -> tuple[float, float]:
    """Rotate components along and across a heading [rad] to north and east."""
    c, s = cos(angle), sin(angle)
    return x * c - y * s, x * s + y * c
