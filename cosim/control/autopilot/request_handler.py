"""The handling of requests to the autopilot: one method a request, which returns its answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from cosim.base.errors import InputError
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.flight_state import AutopilotComponents, FlightState
from cosim.control.autopilot.guidance.course import LOWEST_M
from cosim.control.autopilot.manoeuvres.remote import Setpoint
from cosim.control.autopilot.modes import BY_STICK, Home, Mode, Severity
from cosim.control.autopilot.requests import Answer, Request, Result

Fault = Callable[[rq.InjectFault], None]

_MODE_REQUESTS: dict[Mode, Request] = {
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
    """Return the answer to a request that is refused, with the reason."""
    return Answer(False, result, text)


class FaultCommands(NamedTuple):
    """What is called for faults by command, and may raise InputError; None: such commands are not supported."""

    inject: Fault | None = None
    clear: Callable[[], None] | None = None


class RequestHandler:
    """Carries out or refuses the requests of ground stations."""

    def __init__(self, components: AutopilotComponents, state: FlightState, faults: FaultCommands) -> None:
        self._parameters, self._live = components.parameters, components.live
        self._estimates, self._envelope = components.estimates, components.envelope
        self._landmarks, self._course, self._watch, self._remote = (
            components.landmarks,
            components.course,
            components.watch,
            components.remote,
        )
        self._arming, self._take_off, self._landing = components.arming, components.take_off, components.landing
        self._circle, self._mission = components.circle, components.mission
        self._state, (self._inject, self._clear) = state, faults

    def _arm(self, request: rq.Arm, k: int) -> Answer:
        if self._arming.armed:
            return accept("already armed")
        flying = self._state.is_flying()
        if flying and not request.force:
            return refuse(Result.DENIED, "arming refused: it is in the air")
        reasons = self._state.refusals()
        if reasons and not request.force:
            self._state.say(Severity.ERROR, f"arming refused: {reasons[0]}", k)
            return refuse(Result.DENIED, f"arming refused: {'; '.join(reasons)}")
        self._arming.arm(k, flying)
        self._course.cruise = None
        self._state.failsafe = ""
        if flying:
            self._state.enter(Mode.HOLD, k)
        else:
            self._landing.touchdown.reset()
            if not self._landmarks.home_is_set:
                self._state.set_home_here()
        self._state.say(Severity.INFO, "armed", k)
        return accept()

    def _disarm(self, request: rq.Disarm, k: int) -> Answer:
        if not self._arming.armed:
            return accept("already disarmed")
        if self._state.is_standing():
            self._state.stand_down(k, "disarmed")
            return accept()
        if request.force:
            self._state.shut_off(k)
            return accept()
        if self._landing.touchdown.is_bouncing:
            # The legs alone report contact: the thrust has to go first.
            self._state.enter(Mode.LAND, k)
            self._landing.disarms = True
            return accept("disarms when it stands")
        return refuse(Result.DENIED, "disarming refused: it is in the air")

    def _kill(self, request: rq.Kill, k: int) -> Answer:
        if not request.force and not self._state.is_standing():
            return refuse(Result.DENIED, "kill refused: it is in the air, and force was not given")
        self._state.shut_off(k)
        return accept()

    def _set_mode(self, request: rq.SetMode, k: int) -> Answer:
        try:
            mode = Mode(request.mode)
        except ValueError:
            modes = ", ".join(mode.value for mode in Mode)
            return refuse(Result.UNSUPPORTED, f"mode {request.mode!r} is not one of {modes}")
        if mode in _MODE_REQUESTS:
            mode_request = _MODE_REQUESTS[mode]
            return HANDLERS[type(mode_request)](self, mode_request, k)
        if mode is Mode.ORBIT:
            return refuse(Result.DENIED, "ORBIT is begun by a command that names its radius")
        if mode is Mode.OFFBOARD and not self._remote.setpoint_fresh(self._state.k):
            return refuse(Result.TEMPORARILY_REJECTED, "OFFBOARD needs a set-point that is not old, send those first")
        if mode in BY_STICK and self._state.is_flying() and not self._remote.sticks_fresh(self._state.k):
            return refuse(Result.TEMPORARILY_REJECTED, f"{mode.value} needs sticks, and there are none")
        self._state.enter(mode, k)
        return accept()

    def _begin_take_off(self, request: rq.Takeoff, k: int) -> Answer:
        if self._state.is_flying():
            return refuse(Result.DENIED, "take-off refused: already flying")
        if why := self._arming.find_take_off_refusal(Mode.TAKEOFF, self._state.report):
            return refuse(Result.DENIED, f"take-off refused: {why}")
        height = self._take_off.check_height(request.altitude_m, self._watch)
        self._state.enter(Mode.TAKEOFF, k)
        self._take_off.height = height
        self._arming.flew = False
        self._arming.since = k
        return self._accept_start()

    def _accept_start(self) -> Answer:
        return accept("" if self._arming.armed else "begins when armed")

    def _land(self, request: rq.Land, k: int) -> Answer:
        if not self._state.is_flying():
            return refuse(Result.TEMPORARILY_REJECTED, "landing refused: it is on the ground")
        self._state.enter(Mode.LAND, k)
        return accept()

    def _return(self, request: rq.ReturnHome, k: int) -> Answer:
        if not self._state.is_flying():
            return refuse(Result.TEMPORARILY_REJECTED, "return refused: it is on the ground")
        if self._landmarks.home is None:
            return refuse(Result.DENIED, "return refused: there is no home")
        self._state.enter(Mode.RTL, k)
        return accept()

    def _goto(self, request: rq.Goto, k: int) -> Answer:
        if not self._state.is_flying():
            return refuse(Result.TEMPORARILY_REJECTED, "goto refused: it is on the ground")
        course, here = self._course, self._estimates.fix.position
        holds = self._state.mode is Mode.HOLD
        position, altitude = course.position if holds else None, request.altitude
        if request.north is not None or request.east is not None:
            north, east = position or here
            position = (
                request.north if request.north is not None else north,
                request.east if request.east is not None else east,
            )
        if altitude is None:
            altitude = course.height if course.height is not None else course.stop_height
        elif altitude < self._landmarks.lowest_altitude:
            above = altitude - self._landmarks.lowest_altitude + LOWEST_M
            return refuse(
                Result.DENIED, f"goto refused: {above:.1f} m above the ground, at least {LOWEST_M:g} m are needed"
            )
        if why := self._watch.describe_outside(*(position or here), altitude, self._landmarks.home):
            return refuse(Result.DENIED, f"goto refused: {why}")
        if request.speed:
            self._set_speed(rq.SetSpeed(request.speed), k)
        heading = course.heading if request.yaw is None and holds else request.yaw
        if not holds:
            self._state.enter(Mode.HOLD, k)
        course.aim(position, altitude, heading)
        if short := self._watch.energy.describe_way_shortage(position or here, altitude):
            self._state.say(Severity.WARNING, f"goto: {short}", k)
        return accept()

    def _begin_orbit(self, request: rq.Orbit, k: int) -> Answer:
        if not self._state.is_flying():
            return refuse(Result.TEMPORARILY_REJECTED, "orbit refused: it is on the ground")
        centre, altitude = self._circle.check_request(request)
        self._state.enter(Mode.ORBIT, k)
        self._circle.begin(request, centre, altitude)
        return accept()

    def _hold(self, request: rq.Hold, k: int) -> Answer:
        if self._state.mode is Mode.HOLD and self._course.position is None:
            # It stops or has stopped: a repeated request does not move the target.
            self._state.failsafe = ""
            return accept()
        self._state.enter(Mode.HOLD, k)
        return accept()

    def _set_speed(self, request: rq.SetSpeed, k: int) -> Answer:
        limit = self._parameters.table["MPC_XY_VEL_MAX"]
        if not limit.least <= request.m_s <= limit.most:
            raise InputError(f"speed {request.m_s:g} m/s refused: from {limit.least:g} to {limit.most:g} m/s")
        self._course.cruise = request.m_s
        return accept()

    def _set_home(self, request: rq.SetHome, k: int) -> Answer:
        north, east = self._estimates.fix.position
        self._landmarks.home = Home(
            request.north if request.north is not None else north,
            request.east if request.east is not None else east,
            request.altitude if request.altitude is not None else self._estimates.altitude,
        )
        self._landmarks.home_is_set = True
        return accept()

    def _store_remote_input(self, request: rq.Sticks | Setpoint, k: int) -> Answer:
        self._remote.take(request, k)
        return accept()

    def _upload(self, request: rq.MissionUpload, k: int) -> Answer:
        if self._state.mode is Mode.MISSION and self._arming.armed:
            return refuse(Result.TEMPORARILY_REJECTED, "upload refused: the mission is being flown")
        if warning := self._mission.load(request, self._watch):
            self._state.say(Severity.WARNING, warning, k)
        return accept()

    def _start_mission(self, request: rq.MissionStart, k: int) -> Answer:
        if not self._mission.mission.items:
            return refuse(Result.DENIED, "there is no mission")
        flying = self._state.is_flying()
        if not flying and (why := self._arming.find_take_off_refusal(Mode.MISSION, self._state.report)):
            return refuse(Result.DENIED, f"mission refused: {why}")
        if self._mission.mission.done:
            self._mission.mission.restart(0)
        item, short = self._mission.find_shortage(self._watch.energy)
        if short and not flying and item == self._mission.mission.current:
            return refuse(Result.DENIED, f"mission refused: item {item}: {short}")
        if short:
            self._state.say(Severity.WARNING, f"mission: it returns before item {item}: {short}", k)
        self._state.enter(Mode.MISSION, k)
        if not flying:
            self._arming.flew = False
        self._mission.begin(flying)
        return self._accept_start()

    def _set_current(self, request: rq.MissionSetCurrent, k: int) -> Answer:
        count = len(self._mission.mission.items)
        if request.index >= count:
            return refuse(Result.DENIED, f"mission item {request.index}: there are {count}")
        self._mission.mission.restart(request.index)
        if self._state.mode is Mode.MISSION:
            self._mission.begin(self._state.is_flying())
        return accept()

    def _clear_mission(self, request: rq.MissionClear, k: int) -> Answer:
        self._mission.mission.load(())
        if self._state.mode is Mode.MISSION:
            self._state.enter(Mode.HOLD, k)
        return accept()

    def _set_fence(self, request: rq.FenceUpload, k: int) -> Answer:
        before, self._watch.zones = self._watch.zones, request.zones
        if self._state.is_flying():
            why = self._watch.describe_outside(
                *self._estimates.fix.position, self._estimates.altitude, self._landmarks.home
            )
            if why:
                self._watch.zones = before
                return refuse(Result.DENIED, f"fence refused: it would be outside at once ({why})")
        return accept()

    def _set_rally(self, request: rq.RallyUpload, k: int) -> Answer:
        for index, point in enumerate(request.points):
            why = self._watch.describe_outside(
                point.north, point.east, self._landmarks.home_altitude, self._landmarks.home
            )
            if why:
                return refuse(Result.DENIED, f"rally point {index} refused: {why}")
        self._landmarks.rally = request.points
        return accept()

    def _set_parameter(self, request: rq.SetParameter, k: int) -> Answer:
        self._live.set(request.name, request.value)
        self._envelope.update_limits(request.name, self._course.guide)
        return accept()

    def _inject_fault(self, request: rq.InjectFault, k: int) -> Answer:
        if not self._parameters["SYS_FAILURE_EN"]:
            return refuse(Result.DENIED, "failures on request are off (SYS_FAILURE_EN)")
        if self._inject is None:
            return refuse(Result.UNSUPPORTED, "nothing here can fail on request")
        self._inject(request)
        self._state.say(Severity.WARNING, f"fault on request: {request.fault}", k)
        return accept()

    def _clear_faults(self, request: rq.ClearFaults, k: int) -> Answer:
        if self._clear is None:
            return refuse(Result.UNSUPPORTED, "nothing here can fail on request")
        self._clear()
        return accept()

    def _handle_link_loss(self, request: rq.LinkLost, k: int) -> Answer:
        self._watch.record_link_loss(k)
        self._state.say(Severity.WARNING, "ground station lost", k)
        return accept()

    def _handle_link_return(self, request: rq.LinkBack, k: int) -> Answer:
        self._watch.record_link_return()
        self._state.say(Severity.INFO, "ground station is back", k)
        return accept()


HANDLERS: dict[type[Any], Callable[[RequestHandler, Any, int], Answer]] = {
    rq.Arm: RequestHandler._arm,
    rq.Disarm: RequestHandler._disarm,
    rq.Kill: RequestHandler._kill,
    rq.SetMode: RequestHandler._set_mode,
    rq.Takeoff: RequestHandler._begin_take_off,
    rq.Land: RequestHandler._land,
    rq.ReturnHome: RequestHandler._return,
    rq.Goto: RequestHandler._goto,
    rq.Orbit: RequestHandler._begin_orbit,
    rq.Hold: RequestHandler._hold,
    rq.SetSpeed: RequestHandler._set_speed,
    rq.SetHome: RequestHandler._set_home,
    rq.Sticks: RequestHandler._store_remote_input,
    rq.OffboardAttitude: RequestHandler._store_remote_input,
    rq.OffboardVelocity: RequestHandler._store_remote_input,
    rq.OffboardPosition: RequestHandler._store_remote_input,
    rq.MissionUpload: RequestHandler._upload,
    rq.MissionStart: RequestHandler._start_mission,
    rq.MissionSetCurrent: RequestHandler._set_current,
    rq.MissionClear: RequestHandler._clear_mission,
    rq.FenceUpload: RequestHandler._set_fence,
    rq.RallyUpload: RequestHandler._set_rally,
    rq.SetParameter: RequestHandler._set_parameter,
    rq.InjectFault: RequestHandler._inject_fault,
    rq.ClearFaults: RequestHandler._clear_faults,
    rq.LinkLost: RequestHandler._handle_link_loss,
    rq.LinkBack: RequestHandler._handle_link_return,
}
