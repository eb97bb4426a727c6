"""COMMAND_LONG and COMMAND_INT: the autopilot's requests for each command, or an answer without one.

Numbers and meanings are those of MAVLink's common.xml.
"""

from __future__ import annotations

from collections.abc import Callable
from math import hypot, radians, remainder, tau

from cosim.base.errors import InputError
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.modes import Mode
from cosim.groundstation.mavlink.modes import CUSTOM, FROM_STANDARD, MODES, REFUSED_PX4, from_custom, from_main_sub
from cosim.groundstation.mavlink.services.items import MAX_DISTANCE_M
from cosim.groundstation.mavlink.services.mav_command import (
    ABSOLUTE_FRAMES,
    RELATIVE_FRAMES,
    CommandResult,
    Context,
    MavCommand,
    Plan,
)
from cosim.groundstation.mavlink.streams import BY_ID, MIN_INTERVAL_S, stream_interval
from cosim.groundstation.mavlink.telemetry import gps_global_origin, mode_line
from cosim.groundstation.mavlink.wire.dialect import BY_NAME, mav

# Largest distance at which an origin counts as the same: rounding to 1e-7 deg (1 cm) and a station's arithmetic.
MAX_ORIGIN_ERROR_M = 1.0
ORIGIN_FIXED = "the origin stays where the flight began; place puts it elsewhere"  # reason of a refusal

# FAILURE_UNIT of motor and servo. INJECT_FAILURE has no severity: those below are noticeable and can be flown.
_MOTOR, _SERVO = 101, 102
_SENSORS = {0: "gyro", 3: "barometer", 4: "gnss"}  # sensor by FAILURE_UNIT
_OK, _OFF, _STUCK, _WRONG, _SLOW, _DELAYED = 0, 1, 2, 4, 5, 6  # FAILURE_TYPE
_ENGINE_FAULTS = {  # fault and severity by FAILURE_TYPE
    _OFF: ("flame_out", None),
    _STUCK: ("stuck_throttle", None),
    _WRONG: ("thrust_loss", 0.5),
    _SLOW: ("slow_spool", 0.5),  # s
    _DELAYED: ("delay_growth", 0.1),  # s
}
_GYRO_BIAS, _BAROMETER_BIAS, _GNSS_BIAS = (0.05, 0.0, 0.0), 3.0, (5.0, 0.0, 0.0)  # injected biases, rad/s; m; m, NED


class _FrameError(Exception):
    """Raised for a coordinate frame that the command does not support."""


Handler = Callable[[MavCommand, Context], Plan]


def plan_command(command: MavCommand, context: Context) -> Plan:
    """Return the plan that executes a command; errors become refusals."""
    handler = _HANDLERS.get(command.number)
    if handler is None:
        return Plan(result=CommandResult.UNSUPPORTED)
    try:
        return handler(command, context)
    except InputError as error:
        return Plan(result=CommandResult.DENIED, text=str(error))
    except _FrameError:
        return Plan(result=CommandResult.UNSUPPORTED_FRAME)


def _to_plan(*requests: rq.Request) -> Plan:
    return Plan(requests)


def _refusal(text: str, result: CommandResult = CommandResult.DENIED) -> Plan:
    return Plan(result=result, text=text)


def _to_integer(value: float | None) -> int:
    """Return a parameter as an integer, or -1 if it is missing or not whole."""
    return int(value) if value is not None and value == int(value) and abs(value) < 2**31 else -1


def _plan_arming(command: MavCommand, context: Context, force_code: float = 21196.0) -> Plan:
    arm, force = command.params[0], command.params[1] == force_code
    if arm == 1.0:
        return _to_plan(rq.Arm(force))
    return _to_plan(rq.Disarm(force)) if arm == 0.0 else _refusal("arm: parameter 1 must be 0 or 1")


def _take_off(command: MavCommand, context: Context) -> Plan:
    """Plan a take-off to parameter 7 [m] above sea (PX4), or above home (ArduPilot or relative frames)."""
    altitude = command.params[6]
    if altitude is None:
        return _to_plan(rq.Takeoff())
    if command.frame in RELATIVE_FRAMES or context.vehicle.personality == "ardupilot":
        return _to_plan(rq.Takeoff(altitude))
    if command.frame is not None and command.frame not in ABSOLUTE_FRAMES:
        return _refusal("", CommandResult.UNSUPPORTED_FRAME)
    state = context.state
    if altitude < state.altitude_above_sea + 1.0:
        here = f"the vehicle is at {state.altitude_above_sea:.0f} m"
        return _refusal(f"take-off refused: {altitude:.0f} m above sea level asked for, {here}")
    return _to_plan(rq.Takeoff(altitude - state.altitude_above_sea + state.height_above_home))


def _plan_landing(command: MavCommand, context: Context) -> Plan:
    if command.position is not None:
        north, east = _to_local(command.position, context)
        here = context.state.status.fix.position
        if (north - here[0]) ** 2 + (east - here[1]) ** 2 > 4.0:
            return _refusal("land refused: it lands where it is; fly to the place first")
    return _to_plan(rq.Land())


def _plan_mode(command: MavCommand, context: Context) -> Plan:
    base, main, sub = (_to_integer(value) for value in command.params[:3])
    if base < 0 or not base & CUSTOM:
        return _refusal("mode: only custom modes are known here", CommandResult.UNSUPPORTED)
    if context.vehicle.personality == "ardupilot":
        return _plan_mode_change(from_custom(main, "ardupilot"), f"{main}")
    name = REFUSED_PX4.get((main, sub), "")
    return _plan_mode_change(from_main_sub(main, sub), f"{main}, {sub}{f', {name},' if name else ''}")


def _plan_standard_mode(command: MavCommand, context: Context) -> Plan:
    number = _to_integer(command.params[0])
    return _plan_mode_change(FROM_STANDARD.get(number), f"{number}")


def _plan_mode_change(mode: Mode | None, number: str) -> Plan:
    if mode is None:
        return _refusal(f"mode {number} is not known here", CommandResult.UNSUPPORTED)
    return _to_plan(rq.SetMode(mode.value))


def _reposition(command: MavCommand, context: Context) -> Plan:
    """Plan a flight to a position, height and yaw [rad]; if all are missing, a pause."""
    speed, yaw = command.params[0], command.params[3]
    if command.position is None and command.params[6] is None and yaw is None:
        return _to_plan(rq.Hold())
    heading = None if yaw is None else remainder(yaw, tau)
    return _to_plan(rq.Goto(*_target(command, context), heading, speed if speed is not None and speed > 0.0 else None))


def _orbit(command: MavCommand, context: Context) -> Plan:
    """Plan DO_ORBIT: a negative radius turns left; parameter 4 is the angle to fly [rad], 0 endless."""
    radius, speed, yaw, angle = command.params[:4]
    if radius is None:
        return _refusal("orbit: parameter 1, the radius, is missing")
    target = _target(command, context)
    return _to_plan(
        rq.Orbit(
            abs(radius),
            radius > 0.0,
            speed if speed is not None and speed > 0.0 else None,
            *target,
            _ORBIT_YAW.get(0 if yaw is None else int(yaw), rq.OrbitYaw.AS_IT_IS),
            0.0 if angle is None else abs(angle) / tau,
        )
    )


_ORBIT_YAW = {0: rq.OrbitYaw.CENTRE, 3: rq.OrbitYaw.TANGENT}  # yaw by ORBIT_YAW_BEHAVIOUR


def _turn(command: MavCommand, context: Context) -> Plan:
    """Plan CONDITION_YAW: turn to a heading [deg], relative in direction of parameter 3 if parameter 4 is 1."""
    angle = command.params[0]
    if angle is None:
        return _refusal("yaw: parameter 1 is missing")
    heading = radians(angle)
    if command.params[3] == 1.0:
        sense = -1.0 if command.params[2] is not None and command.params[2] < 0.0 else 1.0
        heading = context.state.euler[2] + sense * heading
    return _to_plan(rq.Goto(yaw=remainder(heading, tau)))


def _plan_speed_change(command: MavCommand, context: Context) -> Plan:
    kind, speed = command.params[0], command.params[1]
    if kind not in (None, 0.0, 1.0):
        return _refusal("speed: only that over the ground can be set")
    if speed is None or speed < 0.0:
        return _refusal("speed: parameter 2 must be m/s")
    return _to_plan(rq.SetSpeed(speed))


def _plan_home_change(command: MavCommand, context: Context) -> Plan:
    if command.params[0] == 1.0:
        return _to_plan(rq.SetHome())
    if command.position is None:
        return _refusal("home: latitude and longitude are missing")
    return _to_plan(rq.SetHome(*_target(command, context)))


def _plan_flight_termination(command: MavCommand, context: Context) -> Plan:
    if command.params[0] is None or command.params[0] < 0.5:
        return _refusal("terminate: parameter 1 must be 1; there is no way back")
    return _to_plan(rq.Kill(True))


def _start_mission(command: MavCommand, context: Context) -> Plan:
    """Plan a mission start at the item of parameter 1, or at the present item if that is 0."""
    first = _to_integer(command.params[0])
    return _to_plan(rq.MissionSetCurrent(first), rq.MissionStart()) if first > 0 else _to_plan(rq.MissionStart())


def _plan_mission_item_change(command: MavCommand, context: Context) -> Plan:
    item = _to_integer(command.params[0])
    return _refusal("mission: parameter 1 must be an item") if item < 0 else _to_plan(rq.MissionSetCurrent(item))


def _plan_pause_or_continuation(command: MavCommand, context: Context) -> Plan:
    if command.params[0] == 0.0:
        return _to_plan(rq.Hold())
    return _to_plan(rq.MissionStart()) if command.params[0] == 1.0 else _refusal("pause: parameter 1 must be 0 or 1")


def _target(command: MavCommand, context: Context) -> tuple[float | None, float | None, float | None]:
    """Return a command's target north, east and above the origin [m], each None if missing.

    Raises InputError for an invalid or too distant position, _FrameError for another frame.
    """
    if command.frame is not None and command.frame not in (*ABSOLUTE_FRAMES, *RELATIVE_FRAMES):
        raise _FrameError
    altitude = command.params[6]
    above = None if altitude is None else _to_height(command, altitude, context)
    north, east = (None, None) if command.position is None else _to_local(command.position, context, above)
    return north, east, above


def _to_local(position: tuple[float, float], context: Context, above: float | None = None) -> tuple[float, float]:
    """Return north and east [m] of a position (deg) at a height above the origin [m], by default the vehicle's."""
    lat, lon = position
    if not (-90.0 <= lat <= 90.0 and -180.0 <= lon <= 180.0):
        raise InputError(f"{lat:g}, {lon:g} is no latitude and longitude")
    geodesy = context.vehicle.geodesy
    height = geodesy.ground + (context.state.altitude if above is None else above)
    north, east = geodesy.to_local(lat, lon, height)[:2]
    if max(abs(north), abs(east)) > MAX_DISTANCE_M:
        far, most = hypot(north, east) / 1e3, MAX_DISTANCE_M / 1e3
        raise InputError(f"{lat:g}, {lon:g} is {far:.0f} km from where the flight began; {most:.0f} km is the most")
    return north, east


def _to_height(command: MavCommand, value: float, context: Context) -> float:
    """Return a command's altitude as a height above the origin [m]."""
    if command.frame in RELATIVE_FRAMES:
        return value + context.state.altitude - context.state.height_above_home
    return value - context.vehicle.geodesy.ground


def _plan_failure_injection(command: MavCommand, context: Context) -> Plan:
    unit, kind = _to_integer(command.params[0]), _to_integer(command.params[1])
    which = 0 if command.params[2] is None else _to_integer(command.params[2])
    if kind == _OK:
        return _to_plan(rq.ClearFaults())  # MAVLink cannot name a single fault
    faults: tuple[rq.InjectFault, ...] = ()
    if unit == _MOTOR:
        if not 0 <= which <= context.vehicle.jets:
            return _refusal(f"failure: engine {which}; there are 1 to {context.vehicle.jets}, and 0 for all")
        if fault := _ENGINE_FAULTS.get(kind):
            jets = (which,) if which else tuple(range(1, context.vehicle.jets + 1))
            faults = (rq.InjectFault(fault[0], jets, amount=fault[1]),)
    elif unit == _SERVO and kind in (_OFF, _STUCK):
        servos = context.vehicle.servos
        if not 0 <= which <= len(servos):
            if servos == ("left", "right"):
                return _refusal(f"failure: servo {which}; 1 is the left one, 2 the right one, 0 both")
            return _refusal(f"failure: servo {which}; there are 1 to {len(servos)}, and 0 for all")
        faults = tuple(rq.InjectFault("servo_jam", servo=servo) for servo in (servos[which - 1 : which] or servos))
    elif unit in _SENSORS:
        faults = _make_sensor_faults(kind, _SENSORS[unit])
    return Plan(faults) if faults else _refusal("failure: not one that can be made here", CommandResult.UNSUPPORTED)


def _make_sensor_faults(kind: int, sensor: str) -> tuple[rq.InjectFault, ...]:
    if kind in (_OFF, _STUCK):
        return (rq.InjectFault("sensor_dropout", sensor=sensor),)
    if kind != _WRONG:
        return ()
    if sensor == "barometer":
        return (rq.InjectFault("sensor_bias", sensor=sensor, amount=_BAROMETER_BIAS),)
    return (rq.InjectFault("sensor_bias", sensor=sensor, vector=_GYRO_BIAS if sensor == "gyro" else _GNSS_BIAS),)


def _request_message(command: MavCommand, context: Context) -> Plan:
    number = _to_integer(command.params[0])
    messages = context.find_message(number)
    if messages is None and number == BY_NAME["AVAILABLE_MODES"].id:
        return _report_modes(command, context)
    if messages is None and number == BY_NAME["MESSAGE_INTERVAL"].id:
        return _get_interval(command._replace(params=(command.params[1], *command.params[1:])), context)
    if messages is None and number in BY_ID:
        messages = BY_ID[number].make_messages(context.state)
        if not messages:
            # The value is not known yet; the client asks again after a temporary rejection.
            return _refusal("", CommandResult.TEMPORARILY_REJECTED)
    return Plan(result=CommandResult.UNSUPPORTED) if messages is None else Plan(messages=tuple(messages))


def _report_modes(command: MavCommand, context: Context) -> Plan:
    index = 0 if command.params[1] is None else _to_integer(command.params[1])
    if index == 0:
        return Plan(messages=tuple(mode_line(context.vehicle, i) for i in range(1, len(MODES) + 1)))
    if not 1 <= index <= len(MODES):
        return _refusal(f"mode {index}: there are 1 to {len(MODES)}")
    return Plan(messages=(mode_line(context.vehicle, index),))


def _make_request_handler(name: str) -> Handler:
    number = float(BY_NAME[name].id)
    return lambda command, context: _request_message(command._replace(params=(number, *command.params[1:])), context)


def _get_interval(command: MavCommand, context: Context) -> Plan:
    number = _to_integer(command.params[0])
    if not 0 <= number <= 0xFFFF:
        return _refusal("interval: parameter 1 must be a message", CommandResult.UNSUPPORTED)
    if number not in BY_ID:
        return Plan(result=CommandResult.UNSUPPORTED, messages=(mav.MAVLink_message_interval_message(number, 0),))
    every = stream_interval(context.peer, number)
    micro = round(every * 1e6) if every else -1
    return Plan(messages=(mav.MAVLink_message_interval_message(number, micro),))


def _set_origin(command: MavCommand, context: Context) -> Plan:
    """Plan DO_SET_GLOBAL_ORIGIN: accept only the flight's own origin, and report it."""
    at = context.vehicle.geodesy
    messages = tuple(gps_global_origin(context.state))
    if command.position is None:
        return Plan(result=CommandResult.DENIED, text="origin: latitude and longitude are missing", messages=messages)
    if command.frame is not None and command.frame not in ABSOLUTE_FRAMES:
        return Plan(result=CommandResult.UNSUPPORTED_FRAME, messages=messages)
    off = hypot(*at.to_local(*command.position, at.ground)[:2])
    if off > MAX_ORIGIN_ERROR_M:
        return Plan(result=CommandResult.DENIED, text=ORIGIN_FIXED, messages=messages)
    return Plan(messages=messages)


def _set_interval(command: MavCommand, context: Context) -> Plan:
    """Set a message's interval for the requesting station: parameter 2 [us], -1 never, 0 default."""
    number, micro = _to_integer(command.params[0]), command.params[1]
    if number not in BY_ID:
        return Plan(result=CommandResult.UNSUPPORTED)
    if micro is None or (micro < 0.0 and micro != -1.0) or micro > 3600e6:
        return _refusal("interval: parameter 2 must be microseconds, at most an hour")
    if micro == 0.0:
        context.peer.intervals.pop(number, None)
    else:
        context.peer.intervals[number] = 0.0 if micro < 0.0 else max(MIN_INTERVAL_S, micro * 1e-6)
    return Plan()


def _report_prearm_checks(command: MavCommand, context: Context) -> Plan:
    status = context.state.status
    if status.armed:
        return _refusal("pre-arm checks: already armed", CommandResult.TEMPORARILY_REJECTED)
    text = f"not ready: {'; '.join(status.refusals)}" if status.refusals else "ready to arm"
    return Plan(text=text)


def _reboot(command: MavCommand, context: Context) -> Plan:
    """Plan a new flight if parameter 1 is 1, or the end of the session if it is 2."""
    number = _to_integer(command.params[0])
    if not 1 <= number <= len(context.shutdown_requests):
        return Plan(result=CommandResult.UNSUPPORTED)
    if context.state.status.armed:
        return _refusal("reboot refused: armed")
    return _to_plan(context.shutdown_requests[number - 1])


_HANDLERS: dict[int, Handler] = {  # by MAV_CMD
    17: lambda command, context: _to_plan(rq.Hold()),  # NAV_LOITER_UNLIM
    20: lambda command, context: _to_plan(rq.ReturnHome()),  # NAV_RETURN_TO_LAUNCH
    21: _plan_landing,  # NAV_LAND
    22: _take_off,  # NAV_TAKEOFF
    115: _turn,  # CONDITION_YAW
    176: _plan_mode,  # DO_SET_MODE
    178: _plan_speed_change,  # DO_CHANGE_SPEED
    179: _plan_home_change,  # DO_SET_HOME
    185: _plan_flight_termination,  # DO_FLIGHTTERMINATION
    34: _orbit,  # DO_ORBIT
    192: _reposition,  # DO_REPOSITION
    193: _plan_pause_or_continuation,  # DO_PAUSE_CONTINUE
    224: _plan_mission_item_change,  # DO_SET_MISSION_CURRENT
    246: _reboot,  # PREFLIGHT_REBOOT_SHUTDOWN
    262: _plan_standard_mode,  # DO_SET_STANDARD_MODE
    300: _start_mission,  # MISSION_START
    400: _plan_arming,  # COMPONENT_ARM_DISARM
    401: _report_prearm_checks,  # RUN_PREARM_CHECKS
    410: _make_request_handler("HOME_POSITION"),  # GET_HOME_POSITION
    420: _plan_failure_injection,  # INJECT_FAILURE
    510: _get_interval,  # GET_MESSAGE_INTERVAL
    511: _set_interval,  # SET_MESSAGE_INTERVAL
    512: _request_message,  # REQUEST_MESSAGE
    519: _make_request_handler("PROTOCOL_VERSION"),  # REQUEST_PROTOCOL_VERSION
    520: _make_request_handler("AUTOPILOT_VERSION"),  # REQUEST_AUTOPILOT_CAPABILITIES
    611: _set_origin,  # DO_SET_GLOBAL_ORIGIN
}
# Commands whose repetition, after a lost acknowledgement, is acknowledged and not executed again.
ONCE_ONLY = frozenset({22, 420})
