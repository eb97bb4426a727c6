"""The autopilot: what a ground station asks for, and the command of every control step.

Requests come in between two steps (:meth:`Autopilot.handle`); :meth:`Autopilot.update` then gives the command of the
step.  Time is counted in steps, so that the same requests at the same steps give the same flight, bit for bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from cosim.base.errors import InputError
from cosim.base.protocols import EngineState, Report
from cosim.base.signals import Command, Measured
from cosim.control.altitude import AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.arming import Arming
from cosim.control.autopilot.estimation.estimates import Estimates
from cosim.control.autopilot.failsafes import OUTSIDE, Watch
from cosim.control.autopilot.guidance.course import LOWEST_M, Course, Places
from cosim.control.autopilot.guidance.envelope import Envelope
from cosim.control.autopilot.guidance.guide import Guide
from cosim.control.autopilot.guidance.position_control import PositionController
from cosim.control.autopilot.guidance.tracker import Tracker
from cosim.control.autopilot.manoeuvres.circle import Circle
from cosim.control.autopilot.manoeuvres.ground import Landing, TakeOff
from cosim.control.autopilot.manoeuvres.homeward import Homeward
from cosim.control.autopilot.manoeuvres.mission import Mission
from cosim.control.autopilot.manoeuvres.mission_flight import MissionFlight
from cosim.control.autopilot.manoeuvres.remote import Remote, Setpoint
from cosim.control.autopilot.manoeuvres.touchdown import Touchdown
from cosim.control.autopilot.modes import BY_STICK, DIRECT, Home, LandedState, Message, Mode, Severity
from cosim.control.autopilot.parameters import HOLD, LAND, RETURN, Parameters, table
from cosim.control.autopilot.requests import Answer, ItemKind, Request, Result
from cosim.control.autopilot.status import Messages, Status
from cosim.control.autopilot.tuning import Blocks, Live, PredictorMaker
from cosim.control.rate import RateController
from cosim.spec.vehicle import PilotSettings, PositionGains, Vehicle

# Chosen by us, with the reason.
_APART = 2.5  # attitude gain over velocity gain, at least: nearer, the loop that the law takes for done is not
_KNOWN_S = 1.0  # a second of GNSS before its place may be called home
_SETTLE_SINK = 1.0  # m/s: sinking faster than this is no contact

Fault = Callable[[rq.InjectFault], None]


class Autopilot:
    """Modes of one vehicle: it asks those who know in turn, and says which of them flies.

    ``hover``: the collective at which it hovers.  ``controller`` and ``delay`` (samples; None without a model) are
    what the rate loops fly with at the start; ``predictors`` makes others.  ``inject`` and ``clear`` are called for
    faults by command, and may raise InputError.  ``airborne``: the flight begins in the air, armed, holding.
    ``idle``: thrust of an engine without throttle, as a share of what full throttle adds to it.  ``answer``: delay
    and lag [s] with which the thrust answers, about hover and the longest.  ``noisy``: the sensors have their noise, by
    which a receiver that has stopped is told from one that stands.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        step: float,
        hover: float,
        controller: str,
        delay: float | None,
        attitude: AttitudeController,
        altitude: AltitudeController,
        rate: RateController,
        predictors: PredictorMaker,
        inject: Fault | None = None,
        clear: Callable[[], None] | None = None,
        airborne: bool = False,
        idle: float = 0.0,
        answer: tuple[float, float] = (0.2, 0.2),
        noisy: bool = True,
        level: str = "",
    ) -> None:
        gains, settings, slowest = _settings(vehicle)
        limits = vehicle.control.allocation
        least = limits.throttle_min
        self.parameters = parameters = Parameters(
            table(vehicle.control, settings, controller, delay, level, vehicle.jets)
        )
        position = PositionController(gains, step)
        tracker = Tracker(settings.acceleration_m_s2, settings.jerk_m_s3, step)
        blocks = Blocks(attitude, altitude, rate, position, tracker, predictors)
        self._live = Live(parameters, vehicle.control, blocks, step)
        self._estimates = estimates = Estimates(vehicle.sensors, gains, step, slowest, noisy)
        self._envelope = Envelope(vehicle, hover, idle, answer, parameters, estimates, step)
        self._places = places = Places()
        guide = Guide(tracker, position, parameters, self._envelope.height_limits(), step)
        self._course = course = Course(parameters, estimates, places, guide)
        self._watch = watch = Watch(parameters, hover, step, self._failsafe)
        self._remote = Remote(course, limits, hover, step)
        self._arming = Arming(course, self._remote, watch, step)
        self._take_off = TakeOff(course, hover, least, step)
        touchdown = Touchdown(hover, step, idle, settings.spool_s)
        self._landing = Landing(course, touchdown, hover, least, step)
        self._homeward = Homeward(course)
        self._circle = Circle(course, watch)
        self._mission = MissionFlight(course, self._circle, self._homeward, step)
        self._inject, self._clear = inject, clear
        self._airborne = airborne
        self._rotors = vehicle.allocation == "rotors"  # of which none can be lost without a spin
        # a flight that begins in the air knows the ground as 0: it stands on its legs there
        legs = (contact.position_m[2] for contact in vehicle.contacts if contact.kind == "leg")
        self._standing = max(legs, default=0.0) if airborne else 0.0
        self._known = round(_KNOWN_S / step)
        self.reset()

    def reset(self, measured: Measured | None = None) -> None:
        """As at the start, where the sensors say ``measured``; parameters, mission, fence and rally points stay."""
        self.mode = Mode.HOLD
        self.landed = LandedState.IN_AIR if self._airborne else LandedState.ON_GROUND
        self.failsafe = ""
        self._messages = Messages()
        self._k = -1
        self._report = Report(not self._airborne, 0.0)
        self._estimates.reset(measured)
        self._places.reset(self._standing)
        self._course.reset()
        self._remote.reset()
        self._arming.reset(self._airborne)
        self._take_off.reset()
        self._landing.reset()
        self._homeward.reset()
        self._circle.reset()
        self._mission.reset()
        self._envelope.reset(self._airborne)
        self._watch.reset()

    # --- what there is to see --------------------------------------------------------------------------------------

    @property
    def armed(self) -> bool:
        return self._arming.armed

    @property
    def engines(self) -> EngineState:
        return self._arming.engines

    @property
    def seen(self) -> Measured:
        """What the loops are to fly the present step with."""
        return self._estimates.now

    @property
    def home(self) -> Home | None:
        return self._places.home

    @property
    def mission(self) -> Mission:
        return self._mission.mission

    @property
    def messages(self) -> deque[Message]:
        """The last lines for the people on the ground."""
        return self._messages.lines

    def refusals(self) -> tuple[str, ...]:
        """Every reason for which arming would be refused now."""
        return self._arming.refusals(self.mode, self.landed, self._report, self._k)

    @property
    def status(self) -> Status:
        """The state after the last step, for telemetry."""
        refusals = () if self.armed else self.refusals()
        course, guide, mission = self._course, self._course.guide, self.mission
        track = None if guide.track is None else guide.track.position
        place = track if course.place is None else course.place
        target = None
        if place is not None and self._flying():
            target = Home(*place, course.height if course.height is not None else guide.altitude)
        return Status(
            self._k,
            self.mode,
            self.armed,
            self.landed,
            self.engines,
            not refusals,
            refusals,
            self.home,
            self._estimates.fix,
            target,
            track,
            guide.altitude,
            guide.yaw,
            len(mission.items),
            mission.current,
            mission.reached,
            mission.done and bool(mission.items),
            self.failsafe,
            self._watch.remaining,
            self._remote.sticks_fresh(self._k),
            self._watch.link_lost >= 0,
            self._watch.zones,
            self._places.rally,
            self._circle.orbit if self.mode is Mode.ORBIT else None,
            self._estimates.positioned,
            self._estimates.measured,
            self._estimates.trust,
        )

    # --- one step --------------------------------------------------------------------------------------------------

    def update(self, k: int, measured: Measured, report: Report) -> Command:
        """The command of step ``k``; :attr:`engines` says what the engines do with it."""
        self._notice(k, measured, report)
        self._guard(k)
        command = self._fly(k)
        if self.engines is not EngineState.FLY:
            self._envelope.reset(airborne=False)
            return command
        return self._envelope.shaped(command)._replace(collective=self._caught(k, command.collective))

    def _notice(self, k: int, measured: Measured, report: Report) -> None:
        """What the sensors and the engines say."""
        if self._report.starting and not report.starting:
            self._say(Severity.INFO, "all engines run", k)
        self._k, self._report = k, report
        standing = not self._flying()
        rising = self.landed is LandedState.TAKING_OFF
        grounded = standing or (rising and not self._landing.touchdown.off)
        self._estimates.update(k, measured, standing, grounded)
        if self.home is None and k >= self._known and standing:
            self._home_here()
        elif self.home is None and not standing:
            # the flight began in the air
            self._places.home = Home(*self._estimates.fix.position, 0.0)
        self._course.begin(k, self._rotors and bool(report.lost))
        self._landing.look(report, self.landed is LandedState.IN_AIR and not self._course.descending)
        self._watch.consume(report, self.engines is EngineState.FLY)

    def _guard(self, k: int) -> None:
        """Everything that may end what is being done."""
        if not self.armed:
            return
        estimates, report = self._estimates, self._report
        if self._watch.tipped(estimates.now):
            if self.landed in (LandedState.ON_GROUND, LandedState.TAKING_OFF):
                self._say(Severity.CRITICAL, "tipped over", k)
                self._shut_off(k)
            elif not self.failsafe.startswith("leans"):
                self._say(Severity.CRITICAL, "leans as if control were lost", k)
                self.failsafe = "leans as if control were lost"
            return
        if self._flying():
            # what was taken over is watched anew
            acting = self.failsafe.startswith(OUTSIDE)
            self._watch.update(k, estimates.now, estimates.fix, self.home, report, acting)
            self._watch.sensors(estimates.senses.failed)
            if not estimates.positioned and self.mode not in (*DIRECT, Mode.ALTCTL, Mode.LAND):
                self._failsafe(LAND, "position lost")
        if self.mode in BY_STICK and self._flying() and not self._remote.sticks_fresh(k):
            self._say(Severity.WARNING, "sticks lost, holding", k)
            self._enter(Mode.HOLD, k)
        if self.mode is Mode.OFFBOARD and not self._remote.setpoint_fresh(k):
            self._say(Severity.WARNING, "no more set-points, holding", k)
            self._enter(Mode.HOLD, k)

    def _fly(self, k: int) -> Command:
        """What is asked for at step ``k``, steps and all."""
        self._course.descending = self._course.landing = False
        if self.engines is EngineState.OFF or not self.armed:
            if self._landing.touchdown.standing:
                self.landed = LandedState.ON_GROUND
            return self._idle()
        if self.landed is LandedState.ON_GROUND:
            return self._on_ground(k)
        if self.landed is LandedState.TAKING_OFF:
            return self._taking_off(k)
        return self._in_air(k)

    def _caught(self, k: int, collective: float | None) -> float | None:
        """The collective that was asked for, or what it takes not to hit the ground."""
        floor = self._envelope.floor
        if collective is None or self._landing.collective is not None or not self._gives_collective():
            # nothing was allocated before the first step
            if k > 0:
                floor.level(self._report.collective)
            return collective
        if not self._landing.touchdown.off:
            return floor.slowed(collective)
        return self._envelope.caught(collective, self._places.ground, self._report.remaining)

    def _on_ground(self, k: int) -> Command:
        """Armed and standing: waits for a reason to leave, not for ever."""
        arming = self._arming
        if self._wants_up(k) and not self._report.starting:
            self.landed = LandedState.TAKING_OFF
            arming.leave_ground(k)
            self._mission.leave_ground(self.mode is Mode.MISSION)
            self._landing.touchdown.reset()
            self._take_off.leave(k)
            return self._taking_off(k)
        if arming.idle_too_long(k):
            self._stand_down(k, "landed, disarmed" if arming.flew else "not taken off, disarmed")
        return self._idle()

    def _wants_up(self, k: int) -> bool:
        """Does what is asked for need the vehicle to leave the ground?"""
        if self.mode is Mode.TAKEOFF:
            return not self._arming.flew
        if self.mode is Mode.MISSION:
            item = self.mission.item
            return item is not None and (not self._arming.flew or item.kind is ItemKind.TAKEOFF)
        return self._remote.wants_up(self.mode, k)

    def _taking_off(self, k: int) -> Command:
        """From idle to the air."""
        if self._landing.lifted:
            self.landed = LandedState.IN_AIR
            self._arming.flew = True
            self._landing.lift_off()
            return self._in_air(k)
        if not self._wants_up(k):
            return self._give_up(k, "")
        if self._gives_collective():
            return self._by_mode(k)
        command = self._take_off.rise(k - self._arming.since)
        return self._give_up(k, "did not leave the ground") if command is None else command

    def _give_up(self, k: int, why: str) -> Command:
        """Off the take-off: in the air already, or back to standing; with a reason, disarmed."""
        if self._landing.touchdown.off:
            self.landed = LandedState.IN_AIR
            return self._in_air(k)
        self._stand(k)
        if why:
            self._say(Severity.ERROR, why, k)
            self._stand_down(k, "disarmed")
        return self._idle()

    def _in_air(self, k: int) -> Command:
        """Flying, unless the legs have found the ground and something wants to stay there."""
        landing, course = self._landing, self._course
        touched = landing.touched()
        if landing.disbelieves():
            self._say(Severity.WARNING, "the legs report ground in the air, their switch is ignored", k)
        if landing.collective is None and self.mode is Mode.HOLD and course.place is None and touched:
            # nobody asked it to leave the ground
            landing.collective, self.landed = self._report.collective, LandedState.LANDING
        down = touched and self._estimates.now.velocity[2] < _SETTLE_SINK
        if landing.collective is not None:
            if down:
                return self._settle(k, landing.collective)
            landing.collective = None
        command = self._by_mode(k)
        if self._gives_collective():
            if touched and landing.touchdown.standing:
                self._stand(k)
        elif course.descending and down:
            landing.collective = self._report.collective
            self.landed = LandedState.LANDING
        elif self.landed is LandedState.LANDING and not course.descending:
            self.landed = LandedState.IN_AIR
        return command

    def _settle(self, k: int, collective: float) -> Command:
        """On the ground: the thrust goes, and then it stands."""
        command = self._landing.settle(collective)
        if self._landing.settled:
            disarms = self._landing.disarms
            self._stand(k)
            if disarms:
                self._stand_down(k, "disarmed")
        return command

    def _stand(self, k: int) -> None:
        """It has come to stand, armed."""
        self.landed = LandedState.ON_GROUND
        self._arming.stand(k)
        self._landing.collective = None
        self._course.guide.reset()
        if self._arming.flew:
            if self.mode is Mode.MISSION:
                self._mission.advance(flying=False)
            self._say(Severity.INFO, "landed", k)

    def _stand_down(self, k: int, text: str) -> None:
        """It stands, disarmed."""
        self._arming.disarm()
        self.landed = LandedState.ON_GROUND
        self._landing.abort()
        if self.mode in (Mode.TAKEOFF, Mode.LAND, Mode.RTL, Mode.MISSION):
            self._enter(Mode.HOLD, k)
        self.failsafe = ""
        self._say(Severity.INFO, text, k)

    def _idle(self) -> Command:
        return Command((0.0, 0.0, self._estimates.euler[2]), self._estimates.altitude, None, 0.0)

    # --- what flies in each mode -----------------------------------------------------------------------------------

    def _by_mode(self, k: int) -> Command:
        """The command of whom the mode names; some end by themselves, and it holds."""
        mode = self.mode
        if mode in BY_STICK or mode is Mode.OFFBOARD:
            return self._remote.fly(mode)
        if mode is Mode.MISSION:
            command = self._mission.fly(k) or self._mission_over(k)
        elif mode is Mode.LAND:
            command = self._course.descend()
        elif mode is Mode.RTL:
            command = self._homeward.fly()
        elif mode is Mode.ORBIT:
            command = self._circle.fly()
            if self._circle.complete:
                self._say(Severity.INFO, "orbit complete", k)
                self._enter(Mode.HOLD, k)
        elif mode is Mode.TAKEOFF:
            command = self._take_off.climb()
            if self._take_off.complete:
                self._hold_here(k)
                self._say(Severity.INFO, "take-off complete", k)
        else:
            command = self._course.fly()
        if self._course.landing:
            self.landed = LandedState.LANDING
        return command

    def _mission_over(self, k: int) -> Command:
        self._say(Severity.INFO, "mission finished", k)
        self._hold_here(k)
        return self._course.fly()

    def _hold_here(self, k: int) -> None:
        """HOLD at the place and the height that it has come to."""
        place, height = self._course.place, self._course.height
        self._enter(Mode.HOLD, k)
        self._course.aim(place, height, None)

    def _enter(self, mode: Mode, k: int) -> None:
        """Another mode, or the same from its beginning."""
        if mode is not self.mode:
            self._say(Severity.INFO, f"mode {mode.value}", k)
        self.mode = mode
        self.failsafe = ""
        self._landing.abort()
        self._take_off.reset()
        self._homeward.reset()
        self._mission.abort()
        self._course.aim(None, None, None)
        if self.landed is LandedState.LANDING:
            self.landed = LandedState.IN_AIR

    def _failsafe(self, action: int, reason: str) -> None:
        """Do what a parameter says, unless something at least as careful is being done."""
        self.failsafe = reason
        if action == RETURN and self.home is None:
            action = LAND
        mode = {HOLD: Mode.HOLD, RETURN: Mode.RTL, LAND: Mode.LAND}.get(action)
        careful = list(_DOES)
        rank = careful.index(self.mode) if self.mode in careful else -1
        if mode is None or rank >= careful.index(mode):
            self._say(Severity.WARNING, reason, self._k)
            return
        self._enter(mode, self._k)
        self.failsafe = reason
        self._say(Severity.CRITICAL, f"{reason}: {_DOES[mode]}", self._k)

    def _shut_off(self, k: int) -> Answer:
        self._arming.shut_off()
        self._landing.collective = None
        self._say(Severity.CRITICAL, "engines shut off", k)
        return _yes()

    def _home_here(self) -> None:
        self._places.home = Home(*self._estimates.fix.position, self._estimates.altitude)

    def _flying(self) -> bool:
        return self.landed is not LandedState.ON_GROUND

    def _gives_collective(self) -> bool:
        return self._remote.gives_collective(self.mode)

    def _stands(self) -> bool:
        """On the ground by more than the switch's word, whatever the engines do."""
        taking_off = self.landed is LandedState.TAKING_OFF
        return not self._flying() or (self._landing.unlifted if taking_off else self._landing.weighs)

    def _say(self, severity: Severity, text: str, k: int) -> None:
        self._messages.say(k, severity, text)

    # --- requests --------------------------------------------------------------------------------------------------

    def handle(self, request: Request, k: int) -> Answer:
        """Take a request before step ``k``.  Never raises for what a ground station may send."""
        handler = _HANDLERS.get(type(request))
        if handler is None:
            return _no(Result.UNSUPPORTED, f"{type(request).__name__} is not known here")
        try:
            answer: Answer = handler(self, request, k)
        except InputError as error:
            return _no(Result.DENIED, str(error))
        return answer

    def _arm(self, request: rq.Arm, k: int) -> Answer:
        if self.armed:
            return _yes("already armed")
        flying = self._flying()
        if flying and not request.force:
            return _no(Result.DENIED, "arming refused: it is in the air")
        reasons = self.refusals()
        if reasons and not request.force:
            self._say(Severity.ERROR, f"arming refused: {reasons[0]}", k)
            return _no(Result.DENIED, f"arming refused: {'; '.join(reasons)}")
        self._arming.arm(k, flying)
        self._course.cruise = None
        self.failsafe = ""
        if flying:
            self._enter(Mode.HOLD, k)
        else:
            self._landing.touchdown.reset()
            if not self._places.home_given:
                self._home_here()
        self._say(Severity.INFO, "armed", k)
        return _yes()

    def _disarm(self, request: rq.Disarm, k: int) -> Answer:
        if not self.armed:
            return _yes("already disarmed")
        if self._stands():
            self._stand_down(k, "disarmed")
            return _yes()
        if request.force:
            return self._shut_off(k)
        if self._landing.touchdown.bouncing:
            # the legs say so, and nothing else yet: the thrust goes first
            self._enter(Mode.LAND, k)
            self._landing.disarms = True
            return _yes("disarms when it stands")
        return _no(Result.DENIED, "disarming refused: it is in the air")

    def _kill(self, request: rq.Kill, k: int) -> Answer:
        if not request.force and not self._stands():
            return _no(Result.DENIED, "kill refused: it is in the air, and force was not given")
        return self._shut_off(k)

    def _set_mode(self, request: rq.SetMode, k: int) -> Answer:
        try:
            mode = Mode(request.mode)
        except ValueError:
            known = ", ".join(mode.value for mode in Mode)
            return _no(Result.UNSUPPORTED, f"mode {request.mode!r} is not one of {known}")
        if mode in _BEGUN_BY:
            return self.handle(_BEGUN_BY[mode], k)
        if mode is Mode.ORBIT:
            return _no(Result.DENIED, "ORBIT is begun by a command that names its radius")
        if mode is Mode.OFFBOARD and not self._remote.setpoint_fresh(self._k):
            return _no(Result.TEMPORARILY_REJECTED, "OFFBOARD needs a set-point that is not old, send those first")
        if mode in BY_STICK and self._flying() and not self._remote.sticks_fresh(self._k):
            return _no(Result.TEMPORARILY_REJECTED, f"{mode.value} needs sticks, and there are none")
        self._enter(mode, k)
        return _yes()

    def _begin_take_off(self, request: rq.Takeoff, k: int) -> Answer:
        if self._flying():
            return _no(Result.DENIED, "take-off refused: already flying")
        if blind := self._arming.blind(Mode.TAKEOFF):
            return _no(Result.DENIED, f"take-off refused: {blind}")
        height = self._take_off.asked(request.altitude_m, self._watch)
        self._enter(Mode.TAKEOFF, k)
        self._take_off.height = height
        self._arming.flew = False
        self._arming.since = k
        return self._begins()

    def _begins(self) -> Answer:
        return _yes("" if self.armed else "begins when armed")

    def _land(self, request: rq.Land, k: int) -> Answer:
        if not self._flying():
            return _no(Result.TEMPORARILY_REJECTED, "landing refused: it is on the ground")
        self._enter(Mode.LAND, k)
        return _yes()

    def _return(self, request: rq.ReturnHome, k: int) -> Answer:
        if not self._flying():
            return _no(Result.TEMPORARILY_REJECTED, "return refused: it is on the ground")
        if self.home is None:
            return _no(Result.DENIED, "return refused: there is no home")
        self._enter(Mode.RTL, k)
        return _yes()

    def _goto(self, request: rq.Goto, k: int) -> Answer:
        if not self._flying():
            return _no(Result.TEMPORARILY_REJECTED, "goto refused: it is on the ground")
        course, here = self._course, self._estimates.fix.position
        holds = self.mode is Mode.HOLD
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
            return _no(
                Result.DENIED, f"goto refused: {above:.1f} m above the ground, at least {LOWEST_M:g} m are needed"
            )
        if why := self._watch.outside(*(place or here), altitude, self.home):
            return _no(Result.DENIED, f"goto refused: {why}")
        if request.speed:
            self._set_speed(rq.SetSpeed(request.speed), k)
        heading = course.heading if request.yaw is None and holds else request.yaw
        if not holds:
            self._enter(Mode.HOLD, k)
        course.aim(place, altitude, heading)
        return _yes()

    def _begin_orbit(self, request: rq.Orbit, k: int) -> Answer:
        if not self._flying():
            return _no(Result.TEMPORARILY_REJECTED, "orbit refused: it is on the ground")
        centre, altitude = self._circle.asked(request)
        self._enter(Mode.ORBIT, k)
        self._circle.begin(request, centre, altitude)
        return _yes()

    def _stop(self, request: rq.Hold, k: int) -> Answer:
        if self.mode is Mode.HOLD and self._course.place is None:
            # it stops or has stopped: asking again does not move where it stays
            self.failsafe = ""
            return _yes()
        self._enter(Mode.HOLD, k)
        return _yes()

    def _set_speed(self, request: rq.SetSpeed, k: int) -> Answer:
        limit = self.parameters.table["MPC_XY_VEL_MAX"]
        if not limit.least <= request.m_s <= limit.most:
            raise InputError(f"speed {request.m_s:g} m/s refused: from {limit.least:g} to {limit.most:g} m/s")
        self._course.cruise = request.m_s
        return _yes()

    def _set_home(self, request: rq.SetHome, k: int) -> Answer:
        north, east = self._estimates.fix.position
        self._places.home = Home(
            request.north if request.north is not None else north,
            request.east if request.east is not None else east,
            request.altitude if request.altitude is not None else self._estimates.altitude,
        )
        self._places.home_given = True
        return _yes()

    def _take(self, request: rq.Sticks | Setpoint, k: int) -> Answer:
        self._remote.take(request, k)
        return _yes()

    def _upload(self, request: rq.MissionUpload, k: int) -> Answer:
        if self.mode is Mode.MISSION and self.armed:
            return _no(Result.TEMPORARILY_REJECTED, "upload refused: the mission is being flown")
        self._mission.load(request, self._watch)
        return _yes()

    def _start_mission(self, request: rq.MissionStart, k: int) -> Answer:
        if not self.mission.items:
            return _no(Result.DENIED, "there is no mission")
        flying = self._flying()
        if not flying and (blind := self._arming.blind(Mode.MISSION)):
            return _no(Result.DENIED, f"mission refused: {blind}")
        if self.mission.done:
            self.mission.restart(0)
        self._enter(Mode.MISSION, k)
        if not flying:
            self._arming.flew = False
        self._mission.begin(flying)
        return self._begins()

    def _set_current(self, request: rq.MissionSetCurrent, k: int) -> Answer:
        count = len(self.mission.items)
        if request.index >= count:
            return _no(Result.DENIED, f"mission item {request.index}: there are {count}")
        self.mission.restart(request.index)
        if self.mode is Mode.MISSION:
            self._mission.begin(self._flying())
        return _yes()

    def _clear_mission(self, request: rq.MissionClear, k: int) -> Answer:
        self.mission.load(())
        if self.mode is Mode.MISSION:
            self._enter(Mode.HOLD, k)
        return _yes()

    def _draw_fence(self, request: rq.FenceUpload, k: int) -> Answer:
        before, self._watch.zones = self._watch.zones, request.zones
        if self._flying():
            why = self._watch.outside(*self._estimates.fix.position, self._estimates.altitude, self.home)
            if why:
                self._watch.zones = before
                return _no(Result.DENIED, f"fence refused: it would be outside at once ({why})")
        return _yes()

    def _set_rally(self, request: rq.RallyUpload, k: int) -> Answer:
        for index, point in enumerate(request.points):
            why = self._watch.outside(point.north, point.east, self._places.home_altitude, self.home)
            if why:
                return _no(Result.DENIED, f"rally point {index} refused: {why}")
        self._places.rally = request.points
        return _yes()

    def _set_parameter(self, request: rq.SetParameter, k: int) -> Answer:
        self._live.set(request.name, request.value)
        self._envelope.follow(request.name, self._course.guide)
        return _yes()

    def _inject_fault(self, request: rq.InjectFault, k: int) -> Answer:
        if not self.parameters["SYS_FAILURE_EN"]:
            return _no(Result.DENIED, "failures on request are off (SYS_FAILURE_EN)")
        if self._inject is None:
            return _no(Result.UNSUPPORTED, "nothing here can fail on request")
        self._inject(request)
        self._say(Severity.WARNING, f"fault on request: {request.fault}", k)
        return _yes()

    def _clear_faults(self, request: rq.ClearFaults, k: int) -> Answer:
        if self._clear is None:
            return _no(Result.UNSUPPORTED, "nothing here can fail on request")
        self._clear()
        return _yes()

    def _link_lost(self, request: rq.LinkLost, k: int) -> Answer:
        self._watch.lost_link(k)
        self._say(Severity.WARNING, "ground station lost", k)
        return _yes()

    def _link_back(self, request: rq.LinkBack, k: int) -> Answer:
        self._watch.found_link()
        self._say(Severity.INFO, "ground station is back", k)
        return _yes()


_DOES = {Mode.HOLD: "holding", Mode.RTL: "returning", Mode.LAND: "landing"}  # failsafes, the more careful the later
_BEGUN_BY: dict[Mode, Request] = {
    Mode.TAKEOFF: rq.Takeoff(),
    Mode.LAND: rq.Land(),
    Mode.RTL: rq.ReturnHome(),
    Mode.MISSION: rq.MissionStart(),
    Mode.HOLD: rq.Hold(),
}


def _settings(vehicle: Vehicle) -> tuple[PositionGains, PilotSettings, float]:
    """What a vehicle states for its autopilot, and the attitude gain of roll or pitch that is less, 1/s.

    Raises InputError where it states nothing, or a position law that is too fast for its attitude loop.
    """
    gains, settings = vehicle.control.position, vehicle.control.pilot
    if gains is None or settings is None:
        missing = "position" if gains is None else "pilot"
        raise InputError(f"vehicle.control.{missing} is missing: {vehicle.name} cannot be flown from a ground station")
    slowest = min(vehicle.control.attitude.gain_1_s[:2])
    if gains.velocity_1_s > slowest / _APART or gains.position_1_s > gains.velocity_1_s / 2.0:
        raise InputError(
            f"vehicle.control.position: velocity_1_s {gains.velocity_1_s:g} and position_1_s "
            f"{gains.position_1_s:g} are too fast for {vehicle.name}, whose attitude gain is {slowest:g} 1/s: at "
            f"most {slowest / _APART:.3g}, and at most half of velocity_1_s"
        )
    return gains, settings, slowest


def _yes(text: str = "") -> Answer:
    return Answer(True, Result.ACCEPTED, text)


def _no(result: Result, text: str) -> Answer:
    return Answer(False, result, text)


_HANDLERS: dict[type[Any], Callable[[Autopilot, Any, int], Answer]] = {
    rq.Arm: Autopilot._arm,
    rq.Disarm: Autopilot._disarm,
    rq.Kill: Autopilot._kill,
    rq.SetMode: Autopilot._set_mode,
    rq.Takeoff: Autopilot._begin_take_off,
    rq.Land: Autopilot._land,
    rq.ReturnHome: Autopilot._return,
    rq.Goto: Autopilot._goto,
    rq.Orbit: Autopilot._begin_orbit,
    rq.Hold: Autopilot._stop,
    rq.SetSpeed: Autopilot._set_speed,
    rq.SetHome: Autopilot._set_home,
    rq.Sticks: Autopilot._take,
    rq.OffboardAttitude: Autopilot._take,
    rq.OffboardVelocity: Autopilot._take,
    rq.OffboardPosition: Autopilot._take,
    rq.MissionUpload: Autopilot._upload,
    rq.MissionStart: Autopilot._start_mission,
    rq.MissionSetCurrent: Autopilot._set_current,
    rq.MissionClear: Autopilot._clear_mission,
    rq.FenceUpload: Autopilot._draw_fence,
    rq.RallyUpload: Autopilot._set_rally,
    rq.SetParameter: Autopilot._set_parameter,
    rq.InjectFault: Autopilot._inject_fault,
    rq.ClearFaults: Autopilot._clear_faults,
    rq.LinkLost: Autopilot._link_lost,
    rq.LinkBack: Autopilot._link_back,
}
