"""What becomes of what is asked of the autopilot: one method a request, each gives its answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from cosim.base.errors import InputError
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.flight_state import FlightState, Parts
from cosim.control.autopilot.guidance.course import LOWEST_M
from cosim.control.autopilot.manoeuvres.remote import Setpoint
from cosim.control.autopilot.modes import BY_STICK, Home, Mode, Severity
from cosim.control.autopilot.requests import Answer, Request, Result

Fault = Callable[[rq.InjectFault], None]

_BEGUN_BY: dict[Mode, Request] = {
    Mode.TAKEOFF: rq.Takeoff(),
    Mode.LAND: rq.Land(),
    Mode.RTL: rq.ReturnHome(),
    Mode.MISSION: rq.MissionStart(),
    Mode.HOLD: rq.Hold(),
}


def yes(text: str = "") -> Answer:
    """Return the answer to a request that is done, or begun."""
    return Answer(True, Result.ACCEPTED, text)


def no(result: Result, text: str) -> Answer:
    """Return the answer to a request that is refused, and why."""
    return Answer(False, result, text)


class FaultCommands(NamedTuple):
    """What is called for faults by command, and may raise InputError; None: such commands are not supported."""

    inject: Fault | None = None
    clear: Callable[[], None] | None = None


class Answers:
    """The answers to the requests of ground stations, each of which is carried out or refused."""

    def __init__(self, parts: Parts, state: FlightState, faults: FaultCommands) -> None:
        self._parameters, self._live, self._estimates, self._envelope = (
            parts.parameters,
            parts.live,
            parts.estimates,
            parts.envelope,
        )
        self._places, self._course, self._watch, self._remote = parts.places, parts.course, parts.watch, parts.remote
        self._arming, self._take_off, self._landing = parts.arming, parts.take_off, parts.landing
        self._circle, self._mission = parts.circle, parts.mission
        self._state, (self._inject, self._clear) = state, faults

    def _arm(self, request: rq.Arm, k: int) -> Answer:
        if self._arming.armed:
            return yes("already armed")
        flying = self._state.flying()
        if flying and not request.force:
            return no(Result.DENIED, "arming refused: it is in the air")
        reasons = self._state.refusals()
        if reasons and not request.force:
            self._state.say(Severity.ERROR, f"arming refused: {reasons[0]}", k)
            return no(Result.DENIED, f"arming refused: {'; '.join(reasons)}")
        self._arming.arm(k, flying)
        self._course.cruise = None
        self._state.failsafe = ""
        if flying:
            self._state.enter(Mode.HOLD, k)
        else:
            self._landing.touchdown.reset()
            if not self._places.home_given:
                self._state.home_here()
        self._state.say(Severity.INFO, "armed", k)
        return yes()

    def _disarm(self, request: rq.Disarm, k: int) -> Answer:
        if not self._arming.armed:
            return yes("already disarmed")
        if self._state.stands():
            self._state.stand_down(k, "disarmed")
            return yes()
        if request.force:
            self._state.shut_off(k)
            return yes()
        if self._landing.touchdown.bouncing:
            # the legs say so, and nothing else yet: the thrust goes first
            self._state.enter(Mode.LAND, k)
            self._landing.disarms = True
            return yes("disarms when it stands")
        return no(Result.DENIED, "disarming refused: it is in the air")

    def _kill(self, request: rq.Kill, k: int) -> Answer:
        if not request.force and not self._state.stands():
            return no(Result.DENIED, "kill refused: it is in the air, and force was not given")
        self._state.shut_off(k)
        return yes()

    def _set_mode(self, request: rq.SetMode, k: int) -> Answer:
        try:
            mode = Mode(request.mode)
        except ValueError:
            known = ", ".join(mode.value for mode in Mode)
            return no(Result.UNSUPPORTED, f"mode {request.mode!r} is not one of {known}")
        if mode in _BEGUN_BY:
            begun = _BEGUN_BY[mode]
            return ANSWERS[type(begun)](self, begun, k)
        if mode is Mode.ORBIT:
            return no(Result.DENIED, "ORBIT is begun by a command that names its radius")
        if mode is Mode.OFFBOARD and not self._remote.setpoint_fresh(self._state.k):
            return no(Result.TEMPORARILY_REJECTED, "OFFBOARD needs a set-point that is not old, send those first")
        if mode in BY_STICK and self._state.flying() and not self._remote.sticks_fresh(self._state.k):
            return no(Result.TEMPORARILY_REJECTED, f"{mode.value} needs sticks, and there are none")
        self._state.enter(mode, k)
        return yes()

    def _begin_take_off(self, request: rq.Takeoff, k: int) -> Answer:
        if self._state.flying():
            return no(Result.DENIED, "take-off refused: already flying")
        if why := self._arming.grounded(Mode.TAKEOFF, self._state.report):
            return no(Result.DENIED, f"take-off refused: {why}")
        height = self._take_off.asked(request.altitude_m, self._watch)
        self._state.enter(Mode.TAKEOFF, k)
        self._take_off.height = height
        self._arming.flew = False
        self._arming.since = k
        return self._begins()

    def _begins(self) -> Answer:
        return yes("" if self._arming.armed else "begins when armed")

    def _land(self, request: rq.Land, k: int) -> Answer:
        if not self._state.flying():
            return no(Result.TEMPORARILY_REJECTED, "landing refused: it is on the ground")
        self._state.enter(Mode.LAND, k)
        return yes()

    def _return(self, request: rq.ReturnHome, k: int) -> Answer:
        if not self._state.flying():
            return no(Result.TEMPORARILY_REJECTED, "return refused: it is on the ground")
        if self._places.home is None:
            return no(Result.DENIED, "return refused: there is no home")
        self._state.enter(Mode.RTL, k)
        return yes()

    def _goto(self, request: rq.Goto, k: int) -> Answer:
        if not self._state.flying():
            return no(Result.TEMPORARILY_REJECTED, "goto refused: it is on the ground")
        course, here = self._course, self._estimates.fix.position
        holds = self._state.mode is Mode.HOLD
        place, altitude = course.place if holds else None, request.altitude
        if request.north is not None or request.east is not None:
            north, east = place or here
            place = (
                request.north if request.north is not None else north,
                request.east if request.east is not None else east,
            )
        if altitude is None:
            altitude = course.height if course.height is not None else course.stop_height
        elif altitude < self._places.lowest:
            above = altitude - self._places.lowest + LOWEST_M
            return no(
                Result.DENIED, f"goto refused: {above:.1f} m above the ground, at least {LOWEST_M:g} m are needed"
            )
        if why := self._watch.outside(*(place or here), altitude, self._places.home):
            return no(Result.DENIED, f"goto refused: {why}")
        if request.speed:
            self._set_speed(rq.SetSpeed(request.speed), k)
        heading = course.heading if request.yaw is None and holds else request.yaw
        if not holds:
            self._state.enter(Mode.HOLD, k)
        course.aim(place, altitude, heading)
        if short := self._watch.energy.short_of_place(place or here, altitude):
            self._state.say(Severity.WARNING, f"goto: {short}", k)
        return yes()

    def _begin_orbit(self, request: rq.Orbit, k: int) -> Answer:
        if not self._state.flying():
            return no(Result.TEMPORARILY_REJECTED, "orbit refused: it is on the ground")
        centre, altitude = self._circle.asked(request)
        self._state.enter(Mode.ORBIT, k)
        self._circle.begin(request, centre, altitude)
        return yes()

    def _stop(self, request: rq.Hold, k: int) -> Answer:
        if self._state.mode is Mode.HOLD and self._course.place is None:
            # it stops or has stopped: asking again does not move where it stays
            self._state.failsafe = ""
            return yes()
        self._state.enter(Mode.HOLD, k)
        return yes()

    def _set_speed(self, request: rq.SetSpeed, k: int) -> Answer:
        limit = self._parameters.table["MPC_XY_VEL_MAX"]
        if not limit.least <= request.m_s <= limit.most:
            raise InputError(f"speed {request.m_s:g} m/s refused: from {limit.least:g} to {limit.most:g} m/s")
        self._course.cruise = request.m_s
        return yes()

    def _set_home(self, request: rq.SetHome, k: int) -> Answer:
        north, east = self._estimates.fix.position
        self._places.home = Home(
            request.north if request.north is not None else north,
            request.east if request.east is not None else east,
            request.altitude if request.altitude is not None else self._estimates.altitude,
        )
        self._places.home_given = True
        return yes()

    def _take(self, request: rq.Sticks | Setpoint, k: int) -> Answer:
        self._remote.take(request, k)
        return yes()

    def _upload(self, request: rq.MissionUpload, k: int) -> Answer:
        if self._state.mode is Mode.MISSION and self._arming.armed:
            return no(Result.TEMPORARILY_REJECTED, "upload refused: the mission is being flown")
        self._mission.load(request, self._watch)
        return yes()

    def _start_mission(self, request: rq.MissionStart, k: int) -> Answer:
        if not self._mission.mission.items:
            return no(Result.DENIED, "there is no mission")
        flying = self._state.flying()
        if not flying and (why := self._arming.grounded(Mode.MISSION, self._state.report)):
            return no(Result.DENIED, f"mission refused: {why}")
        if self._mission.mission.done:
            self._mission.mission.restart(0)
        item, short = self._mission.short(self._watch.energy)
        if short and not flying and item == self._mission.mission.current:
            return no(Result.DENIED, f"mission refused: item {item}: {short}")
        if short:
            self._state.say(Severity.WARNING, f"mission: it returns before item {item}: {short}", k)
        self._state.enter(Mode.MISSION, k)
        if not flying:
            self._arming.flew = False
        self._mission.begin(flying)
        return self._begins()

    def _set_current(self, request: rq.MissionSetCurrent, k: int) -> Answer:
        count = len(self._mission.mission.items)
        if request.index >= count:
            return no(Result.DENIED, f"mission item {request.index}: there are {count}")
        self._mission.mission.restart(request.index)
        if self._state.mode is Mode.MISSION:
            self._mission.begin(self._state.flying())
        return yes()

    def _clear_mission(self, request: rq.MissionClear, k: int) -> Answer:
        self._mission.mission.load(())
        if self._state.mode is Mode.MISSION:
            self._state.enter(Mode.HOLD, k)
        return yes()

    def _draw_fence(self, request: rq.FenceUpload, k: int) -> Answer:
        before, self._watch.zones = self._watch.zones, request.zones
        if self._state.flying():
            why = self._watch.outside(*self._estimates.fix.position, self._estimates.altitude, self._places.home)
            if why:
                self._watch.zones = before
                return no(Result.DENIED, f"fence refused: it would be outside at once ({why})")
        return yes()

    def _set_rally(self, request: rq.RallyUpload, k: int) -> Answer:
        for index, point in enumerate(request.points):
            why = self._watch.outside(point.north, point.east, self._places.home_altitude, self._places.home)
            if why:
                return no(Result.DENIED, f"rally point {index} refused: {why}")
        self._places.rally = request.points
        return yes()

    def _set_parameter(self, request: rq.SetParameter, k: int) -> Answer:
        self._live.set(request.name, request.value)
        self._envelope.follow(request.name, self._course.guide)
        return yes()

    def _inject_fault(self, request: rq.InjectFault, k: int) -> Answer:
        if not self._parameters["SYS_FAILURE_EN"]:
            return no(Result.DENIED, "failures on request are off (SYS_FAILURE_EN)")
        if self._inject is None:
            return no(Result.UNSUPPORTED, "nothing here can fail on request")
        self._inject(request)
        self._state.say(Severity.WARNING, f"fault on request: {request.fault}", k)
        return yes()

    def _clear_faults(self, request: rq.ClearFaults, k: int) -> Answer:
        if self._clear is None:
            return no(Result.UNSUPPORTED, "nothing here can fail on request")
        self._clear()
        return yes()

    def _link_lost(self, request: rq.LinkLost, k: int) -> Answer:
        self._watch.lost_link(k)
        self._state.say(Severity.WARNING, "ground station lost", k)
        return yes()

    def _link_back(self, request: rq.LinkBack, k: int) -> Answer:
        self._watch.found_link()
        self._state.say(Severity.INFO, "ground station is back", k)
        return yes()


ANSWERS: dict[type[Any], Callable[[Answers, Any, int], Answer]] = {
    rq.Arm: Answers._arm,
    rq.Disarm: Answers._disarm,
    rq.Kill: Answers._kill,
    rq.SetMode: Answers._set_mode,
    rq.Takeoff: Answers._begin_take_off,
    rq.Land: Answers._land,
    rq.ReturnHome: Answers._return,
    rq.Goto: Answers._goto,
    rq.Orbit: Answers._begin_orbit,
    rq.Hold: Answers._stop,
    rq.SetSpeed: Answers._set_speed,
    rq.SetHome: Answers._set_home,
    rq.Sticks: Answers._take,
    rq.OffboardAttitude: Answers._take,
    rq.OffboardVelocity: Answers._take,
    rq.OffboardPosition: Answers._take,
    rq.MissionUpload: Answers._upload,
    rq.MissionStart: Answers._start_mission,
    rq.MissionSetCurrent: Answers._set_current,
    rq.MissionClear: Answers._clear_mission,
    rq.FenceUpload: Answers._draw_fence,
    rq.RallyUpload: Answers._set_rally,
    rq.SetParameter: Answers._set_parameter,
    rq.InjectFault: Answers._inject_fault,
    rq.ClearFaults: Answers._clear_faults,
    rq.LinkLost: Answers._link_lost,
    rq.LinkBack: Answers._link_back,
}
