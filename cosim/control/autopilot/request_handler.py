"""The handling of requests to the autopilot: one function a request, which returns its answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cosim.base.errors import InputError
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.flight_state import FlightState
from cosim.control.autopilot.guidance.course import MIN_HEIGHT_M
from cosim.control.autopilot.manoeuvres.remote import Setpoint
from cosim.control.autopilot.modes import STICK_MODES, Home, Mode, Severity
from cosim.control.autopilot.requests import Answer, Request, Result

_MODE_REQUESTS: dict[Mode, Request] = {  # request that enters each mode
    Mode.TAKEOFF: rq.Takeoff(),
    Mode.LAND: rq.Land(),
    Mode.RTL: rq.ReturnHome(),
    Mode.MISSION: rq.MissionStart(),
    Mode.HOLD: rq.Hold(),
}


def accept(text: str = "") -> Answer:
    """Return the answer to a request that is done or begun."""
    return Answer(True, Result.ACCEPTED, text)


def refuse(result: Result, text: str) -> Answer:
    return Answer(False, result, text)


def _arm(pilot: FlightState, request: rq.Arm, k: int) -> Answer:
    if pilot.armed:
        return accept("already armed")
    flying = pilot.is_flying()
    if flying and not request.force:
        return refuse(Result.DENIED, "arming refused: it is in the air")
    reasons = pilot.refusals()
    if reasons and not request.force:
        pilot.say(Severity.ERROR, f"arming refused: {reasons[0]}", k)
        return refuse(Result.DENIED, f"arming refused: {'; '.join(reasons)}")
    pilot.arming.arm(k, flying)
    pilot.course.cruise = None
    pilot.failsafe = ""
    if flying:
        pilot.enter(Mode.HOLD, k)
    else:
        pilot.landing.touchdown.reset()
        if not pilot.landmarks.home_is_set:
            pilot.set_home_here()
    pilot.say(Severity.INFO, "armed", k)
    return accept()


def _disarm(pilot: FlightState, request: rq.Disarm, k: int) -> Answer:
    if not pilot.armed:
        return accept("already disarmed")
    if pilot.is_standing():
        pilot.stand_down(k, "disarmed")
        return accept()
    if request.force:
        pilot.kill_engines(k)
        return accept()
    if pilot.landing.touchdown.is_bouncing:
        # Only the legs report contact, so reduce thrust first.
        pilot.enter(Mode.LAND, k)
        pilot.landing.disarms = True
        return accept("disarms when it stands")
    return refuse(Result.DENIED, "disarming refused: it is in the air")


def _kill(pilot: FlightState, request: rq.Kill, k: int) -> Answer:
    if not request.force and not pilot.is_standing():
        return refuse(Result.DENIED, "kill refused: it is in the air, and force was not given")
    pilot.kill_engines(k)
    return accept()


def _set_mode(pilot: FlightState, request: rq.SetMode, k: int) -> Answer:
    try:
        mode = Mode(request.mode)
    except ValueError:
        modes = ", ".join(mode.value for mode in Mode)
        return refuse(Result.UNSUPPORTED, f"mode {request.mode!r} is not one of {modes}")
    if mode in _MODE_REQUESTS:
        mode_request = _MODE_REQUESTS[mode]
        return HANDLERS[type(mode_request)](pilot, mode_request, k)
    if mode is Mode.ORBIT:
        return refuse(Result.DENIED, "ORBIT is begun by a command that names its radius")
    if mode is Mode.OFFBOARD and not pilot.remote.has_fresh_setpoint(pilot.k):
        return refuse(Result.TEMPORARILY_REJECTED, "OFFBOARD needs a set-point that is not old, send those first")
    if mode in STICK_MODES and pilot.is_flying() and not pilot.remote.has_fresh_sticks(pilot.k):
        return refuse(Result.TEMPORARILY_REJECTED, f"{mode.value} needs sticks, and there are none")
    pilot.enter(mode, k)
    return accept()


def _begin_take_off(pilot: FlightState, request: rq.Takeoff, k: int) -> Answer:
    if pilot.is_flying():
        return refuse(Result.DENIED, "take-off refused: already flying")
    if why := pilot.arming.find_take_off_refusal(Mode.TAKEOFF, pilot.report):
        return refuse(Result.DENIED, f"take-off refused: {why}")
    height = pilot.take_off.check_height(request.altitude_m, pilot.watch)
    pilot.enter(Mode.TAKEOFF, k)
    pilot.take_off.height = height
    pilot.arming.flew = False
    pilot.arming.since = k
    return _accept_and_tell_if_unarmed(pilot)


def _accept_and_tell_if_unarmed(pilot: FlightState) -> Answer:
    return accept("" if pilot.armed else "begins when armed")


def _begin_landing(pilot: FlightState, request: rq.Land, k: int) -> Answer:
    if not pilot.is_flying():
        return refuse(Result.TEMPORARILY_REJECTED, "landing refused: it is on the ground")
    pilot.enter(Mode.LAND, k)
    return accept()


def _begin_return(pilot: FlightState, request: rq.ReturnHome, k: int) -> Answer:
    if not pilot.is_flying():
        return refuse(Result.TEMPORARILY_REJECTED, "return refused: it is on the ground")
    if pilot.landmarks.home is None:
        return refuse(Result.DENIED, "return refused: there is no home")
    pilot.enter(Mode.RTL, k)
    return accept()


def _begin_flight_to(pilot: FlightState, request: rq.Goto, k: int) -> Answer:
    if not pilot.is_flying():
        return refuse(Result.TEMPORARILY_REJECTED, "goto refused: it is on the ground")
    course, here = pilot.course, pilot.estimates.fix.position
    holds = pilot.mode is Mode.HOLD
    position, altitude = course.position if holds else None, request.altitude
    if request.north is not None or request.east is not None:
        north, east = position or here
        position = (
            request.north if request.north is not None else north,
            request.east if request.east is not None else east,
        )
    if altitude is None:
        altitude = course.height if course.height is not None else course.stop_height
    elif altitude < pilot.landmarks.lowest_altitude:
        above = altitude - pilot.landmarks.lowest_altitude + MIN_HEIGHT_M
        return refuse(
            Result.DENIED, f"goto refused: {above:.1f} m above the ground, at least {MIN_HEIGHT_M:g} m are needed"
        )
    if why := pilot.watch.describe_outside(*(position or here), altitude, pilot.landmarks.home):
        return refuse(Result.DENIED, f"goto refused: {why}")
    if request.speed:
        _set_speed(pilot, rq.SetSpeed(request.speed), k)
    heading = course.heading if request.yaw is None and holds else request.yaw
    if not holds:
        pilot.enter(Mode.HOLD, k)
    course.aim(position, altitude, heading)
    if short := pilot.watch.energy.describe_way_shortage(position or here, altitude):
        pilot.say(Severity.WARNING, f"goto: {short}", k)
    return accept()


def _begin_orbit(pilot: FlightState, request: rq.Orbit, k: int) -> Answer:
    if not pilot.is_flying():
        return refuse(Result.TEMPORARILY_REJECTED, "orbit refused: it is on the ground")
    centre, altitude = pilot.circle.check_request(request)
    pilot.enter(Mode.ORBIT, k)
    pilot.circle.begin(request, centre, altitude)
    return accept()


def _enter_hold(pilot: FlightState, request: rq.Hold, k: int) -> Answer:
    if pilot.mode is Mode.HOLD and pilot.course.position is None:
        # It is stopping or has stopped, so a repeated request does not move the target.
        pilot.failsafe = ""
        return accept()
    pilot.enter(Mode.HOLD, k)
    return accept()


def _set_speed(pilot: FlightState, request: rq.SetSpeed, k: int) -> Answer:
    limit = pilot.parameters.table["MPC_XY_VEL_MAX"]
    if not limit.least <= request.m_s <= limit.most:
        raise InputError(f"speed {request.m_s:g} m/s refused: from {limit.least:g} to {limit.most:g} m/s")
    pilot.course.cruise = request.m_s
    return accept()


def _set_home(pilot: FlightState, request: rq.SetHome, k: int) -> Answer:
    north, east = pilot.estimates.fix.position
    pilot.landmarks.home = Home(
        request.north if request.north is not None else north,
        request.east if request.east is not None else east,
        request.altitude if request.altitude is not None else pilot.estimates.altitude,
    )
    pilot.landmarks.home_is_set = True
    return accept()


def _store_remote_input(pilot: FlightState, request: rq.Sticks | Setpoint, k: int) -> Answer:
    pilot.remote.take(request, k)
    return accept()


def _upload_mission(pilot: FlightState, request: rq.MissionUpload, k: int) -> Answer:
    if pilot.mode is Mode.MISSION and pilot.armed:
        return refuse(Result.TEMPORARILY_REJECTED, "upload refused: the mission is being flown")
    if warning := pilot.mission_flight.load(request, pilot.watch):
        pilot.say(Severity.WARNING, warning, k)
    return accept()


def _start_mission(pilot: FlightState, request: rq.MissionStart, k: int) -> Answer:
    if not pilot.mission.items:
        return refuse(Result.DENIED, "there is no mission")
    flying = pilot.is_flying()
    if not flying and (why := pilot.arming.find_take_off_refusal(Mode.MISSION, pilot.report)):
        return refuse(Result.DENIED, f"mission refused: {why}")
    if pilot.mission.done:
        pilot.mission.restart(0)
    item, short = pilot.mission_flight.find_shortage(pilot.watch.energy)
    if short and not flying and item == pilot.mission.current:
        return refuse(Result.DENIED, f"mission refused: item {item}: {short}")
    if short:
        pilot.say(Severity.WARNING, f"mission: it returns before item {item}: {short}", k)
    pilot.enter(Mode.MISSION, k)
    if not flying:
        pilot.arming.flew = False
    pilot.mission_flight.begin(flying)
    return _accept_and_tell_if_unarmed(pilot)


def _set_current_item(pilot: FlightState, request: rq.MissionSetCurrent, k: int) -> Answer:
    count = len(pilot.mission.items)
    if request.index >= count:
        return refuse(Result.DENIED, f"mission item {request.index}: there are {count}")
    pilot.mission.restart(request.index)
    if pilot.mode is Mode.MISSION:
        pilot.mission_flight.begin(pilot.is_flying())
    return accept()


def _clear_mission(pilot: FlightState, request: rq.MissionClear, k: int) -> Answer:
    pilot.mission.load(())
    if pilot.mode is Mode.MISSION:
        pilot.enter(Mode.HOLD, k)
    return accept()


def _set_fence(pilot: FlightState, request: rq.FenceUpload, k: int) -> Answer:
    before, pilot.watch.zones = pilot.watch.zones, request.zones
    if pilot.is_flying():
        why = pilot.watch.describe_outside(
            *pilot.estimates.fix.position, pilot.estimates.altitude, pilot.landmarks.home
        )
        if why:
            pilot.watch.zones = before
            return refuse(Result.DENIED, f"fence refused: it would be outside at once ({why})")
    return accept()


def _set_rally(pilot: FlightState, request: rq.RallyUpload, k: int) -> Answer:
    for index, point in enumerate(request.points):
        why = pilot.watch.describe_outside(point.north, point.east, pilot.landmarks.home_altitude, pilot.landmarks.home)
        if why:
            return refuse(Result.DENIED, f"rally point {index} refused: {why}")
    pilot.landmarks.rally = request.points
    return accept()


def _set_parameter(pilot: FlightState, request: rq.SetParameter, k: int) -> Answer:
    pilot.live.set(request.name, request.value)
    pilot.envelope.update_limits(request.name, pilot.course.guide)
    return accept()


def _inject_fault(pilot: FlightState, request: rq.InjectFault, k: int) -> Answer:
    if not pilot.parameters["SYS_FAILURE_EN"]:
        return refuse(Result.DENIED, "failures on request are off (SYS_FAILURE_EN)")
    if pilot.faults.inject is None:
        return refuse(Result.UNSUPPORTED, "nothing here can fail on request")
    pilot.faults.inject(request)
    pilot.say(Severity.WARNING, f"fault on request: {request.fault}", k)
    return accept()


def _clear_faults(pilot: FlightState, request: rq.ClearFaults, k: int) -> Answer:
    if pilot.faults.clear is None:
        return refuse(Result.UNSUPPORTED, "nothing here can fail on request")
    pilot.faults.clear()
    return accept()


def _handle_link_loss(pilot: FlightState, request: rq.LinkLost, k: int) -> Answer:
    pilot.watch.record_link_loss(k)
    pilot.say(Severity.WARNING, "ground station lost", k)
    return accept()


def _handle_link_return(pilot: FlightState, request: rq.LinkBack, k: int) -> Answer:
    pilot.watch.record_link_return()
    pilot.say(Severity.INFO, "ground station is back", k)
    return accept()


HANDLERS: dict[type[Any], Callable[[FlightState, Any, int], Answer]] = {  # function for each type of request
    rq.Arm: _arm,
    rq.Disarm: _disarm,
    rq.Kill: _kill,
    rq.SetMode: _set_mode,
    rq.Takeoff: _begin_take_off,
    rq.Land: _begin_landing,
    rq.ReturnHome: _begin_return,
    rq.Goto: _begin_flight_to,
    rq.Orbit: _begin_orbit,
    rq.Hold: _enter_hold,
    rq.SetSpeed: _set_speed,
    rq.SetHome: _set_home,
    rq.Sticks: _store_remote_input,
    rq.OffboardAttitude: _store_remote_input,
    rq.OffboardVelocity: _store_remote_input,
    rq.OffboardPosition: _store_remote_input,
    rq.MissionUpload: _upload_mission,
    rq.MissionStart: _start_mission,
    rq.MissionSetCurrent: _set_current_item,
    rq.MissionClear: _clear_mission,
    rq.FenceUpload: _set_fence,
    rq.RallyUpload: _set_rally,
    rq.SetParameter: _set_parameter,
    rq.InjectFault: _inject_fault,
    rq.ClearFaults: _clear_faults,
    rq.LinkLost: _handle_link_loss,
    rq.LinkBack: _handle_link_return,
}
