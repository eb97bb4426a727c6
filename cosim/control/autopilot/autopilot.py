"""The autopilot: what a ground station asks for, and the command of every control step.

Requests come in between two steps (:meth:`Autopilot.handle`); :meth:`Autopilot.update` then gives the command of the
step.  Time is counted in steps, so that the same requests at the same steps give the same flight, bit for bit.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from cosim.base.errors import InputError
from cosim.base.protocols import EngineState, Report
from cosim.base.signals import Command, Measured
from cosim.control.autopilot.arming import Arming
from cosim.control.autopilot.energy import Energy
from cosim.control.autopilot.estimation.estimates import Estimates
from cosim.control.autopilot.failsafes import OUTSIDE, Watch
from cosim.control.autopilot.flight_state import AutopilotComponents, FlightState
from cosim.control.autopilot.guidance.course import Course, Landmarks
from cosim.control.autopilot.guidance.envelope import Envelope
from cosim.control.autopilot.guidance.ground_speed import GroundSpeed
from cosim.control.autopilot.guidance.guide import Guide
from cosim.control.autopilot.guidance.position_control import PositionController
from cosim.control.autopilot.guidance.tracker import Tracker
from cosim.control.autopilot.manoeuvres.circle import Circle
from cosim.control.autopilot.manoeuvres.ground import Landing, TakeOff
from cosim.control.autopilot.manoeuvres.mission import Mission
from cosim.control.autopilot.manoeuvres.mission_flight import MissionFlight
from cosim.control.autopilot.manoeuvres.remote import Remote
from cosim.control.autopilot.manoeuvres.return_flight import ReturnFlight
from cosim.control.autopilot.manoeuvres.touchdown import Touchdown
from cosim.control.autopilot.modes import BY_STICK, DIRECT, Home, LandedState, Message, Mode, Severity
from cosim.control.autopilot.parameters import LAND, Parameters, table
from cosim.control.autopilot.request_handler import HANDLERS, FaultCommands, RequestHandler, refuse
from cosim.control.autopilot.requests import Answer, Request, Result
from cosim.control.autopilot.status import Status
from cosim.control.autopilot.tuning import Blocks, ControlLoops, LiveTuning
from cosim.spec.vehicle import PilotSettings, PositionGains, Vehicle

# Chosen by us, with the reason.
_GAIN_RATIO = 2.5  # attitude gain over velocity gain, at least: else the position law is too fast
_HOME_DELAY_S = 1.0  # s of GNSS before its position may become home
# Hinges that turn engines push the vehicle aside for so long when one is lost: by then throttles have followed.  Taken
# for wind, the push made it lean when it was over.
_PUSHED_S = 3.0
_SETTLE_SINK = 1.0  # m/s: sinking faster than this is no contact


class Thrust(NamedTuple):
    """The nominal thrust of the vehicle."""

    hover: float  # collective at which it hovers
    idle: float = 0.0  # thrust of an engine without throttle, as a fraction of what full throttle adds to it
    answer: tuple[float, float] = (0.2, 0.2)  # delay and lag [s] of the thrust, about hover and the longest


class Autopilot:
    """Flight modes of one vehicle: the requests of ground stations become the command of every control step.

    ``engines``: at the start; where they fly, it begins in the air, armed, holding.  ``noisy``: the sensors have their
    noise, which distinguishes a receiver that has stopped from one that stands still.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        step: float,
        thrust: Thrust,
        loops: ControlLoops,
        faults: FaultCommands,
        engines: EngineState = EngineState.IDLE,
        noisy: bool = True,
    ) -> None:
        hover, idle, answer = thrust
        gains, settings, slowest = _settings(vehicle)
        limits = vehicle.control.allocation
        least_throttle = limits.throttle_min
        self.parameters = parameters = Parameters(
            table(vehicle.control, settings, loops.controller, loops.delay, loops.level, vehicle.jets)
        )
        position = PositionController(gains, step)
        tracker = Tracker(settings.acceleration_m_s2, settings.jerk_m_s3, step)
        blocks = Blocks(loops.attitude, loops.altitude, loops.rate, position, tracker, loops.predictors)
        live = LiveTuning(parameters, vehicle.control, blocks, step)
        self._estimates = estimates = Estimates(vehicle.sensors, gains, step, slowest, noisy)
        self._envelope = Envelope(vehicle, hover, idle, answer, parameters, estimates, step)
        self._landmarks = landmarks = Landmarks()
        guide = Guide(tracker, position, parameters, self._envelope.height_limits(), step)
        self._course = course = Course(parameters, estimates, landmarks, guide)
        self.energy = Energy(course, GroundSpeed(course, vehicle, gains.catch_up_m_s, step), hover, step)
        self._watch = watch = Watch(parameters, self.energy, step, self._activate_failsafe)
        self._remote = Remote(course, limits, hover, step)
        self._arming = Arming(course, self._remote, watch, step)
        self._take_off = TakeOff(course, hover, least_throttle, step)
        touchdown = Touchdown(hover, step, idle, settings.spool_s)
        self._landing = Landing(course, touchdown, hover, least_throttle, step)
        self._return_flight = ReturnFlight(course)
        self._circle = Circle(course, watch)
        self._mission = MissionFlight(course, self._circle, self._return_flight, step)
        components = AutopilotComponents(
            parameters, live, estimates, self._envelope, landmarks, course, watch, self._remote, self._arming,
            self._take_off, self._landing, self._return_flight, self._circle, self._mission,
        )  # fmt: skip
        airborne = engines is EngineState.FLY
        self._state = FlightState(components, len(vehicle.jets), airborne)
        self._request_handler = RequestHandler(components, self._state, faults)
        self._airborne, self._engines = airborne, engines
        # whether hinges that turn engines push it aside after a loss, before throttles have followed
        catch = vehicle.control.monitor is not None and vehicle.control.monitor.catch
        self._is_pushed_by_hinges = catch and vehicle.layout().moves
        self._push_steps = round(_PUSHED_S / step)
        # whether it cannot hold its heading without an engine
        self._loses_heading = self._is_pushed_by_hinges or vehicle.allocation == "rotors"
        # A flight that begins in the air assumes the ground at height 0, where the vehicle would stand on its legs.
        legs = (contact.position_m[2] for contact in vehicle.contacts if contact.kind == "leg")
        self._leg_height = max(legs, default=0.0) if airborne else 0.0
        self._home_delay = round(_HOME_DELAY_S / step)
        self.reset()

    def reset(self, measured: Measured | None = None) -> None:
        """Start a flight where the sensors read ``measured``; parameters, mission, fence and rally points stay."""
        self._last_healthy_step = 0  # the last step with all engines
        self._state.reset()
        self._estimates.reset(measured)
        self._landmarks.reset(self._leg_height)
        self._course.reset()
        self._remote.reset()
        self._arming.reset(self._engines)
        self._take_off.reset()
        self._landing.reset()
        self._return_flight.reset()
        self._circle.reset()
        self._mission.reset()
        self._envelope.reset(self._airborne)
        self._watch.reset()

    def _activate_failsafe(self, action: int, reason: str) -> None:
        self._state.activate_failsafe(action, reason)

    # --- what there is to see --------------------------------------------------------------------------------------

    @property
    def mode(self) -> Mode:
        return self._state.mode

    @property
    def landed(self) -> LandedState:
        return self._state.landed

    @property
    def failsafe(self) -> str:
        """The reason of the acting failsafe; empty where none acts."""
        return self._state.failsafe

    @property
    def armed(self) -> bool:
        return self._arming.armed

    @property
    def engines(self) -> EngineState:
        return self._arming.engines

    @property
    def seen(self) -> Measured:
        """The measurements, sensed or estimated, that the loops fly the present step with."""
        return self._estimates.now

    @property
    def home(self) -> Home | None:
        return self._landmarks.home

    @property
    def mission(self) -> Mission:
        return self._mission.mission

    @property
    def messages(self) -> deque[Message]:
        """The last messages to ground stations."""
        return self._state.messages.lines

    def refusals(self) -> tuple[str, ...]:
        """Return every reason for which arming would be refused now."""
        return self._state.refusals()

    @property
    def status(self) -> Status:
        """The state after the last step, for telemetry."""
        refusals = () if self.armed else self.refusals()
        course, guide, mission = self._course, self._course.guide, self.mission
        track = None if guide.track is None else guide.track.position
        position = track if course.position is None else course.position
        target = None
        if position is not None and self._state.is_flying():
            target = Home(*position, course.height if course.height is not None else guide.altitude)
        return Status(
            self._state.k,
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
            self.energy.remaining,
            self._remote.sticks_fresh(self._state.k),
            self._watch.link_lost >= 0,
            self._watch.zones,
            self._landmarks.rally,
            self._circle.orbit if self.mode is Mode.ORBIT else None,
            self._estimates.has_position,
            self._estimates.measured,
            self._estimates.trust,
        )

    # --- one step --------------------------------------------------------------------------------------------------

    def update(self, k: int, measured: Measured, report: Report) -> Command:
        """Return the command of step ``k``; :attr:`engines` says what the engines do with it."""
        self._update_estimates(k, measured, report)
        self._check_failsafes(k)
        command = self._command_step(k)
        if self.engines is not EngineState.FLY:
            self._envelope.reset(airborne=False)
            return command
        return self._envelope.shape(command)._replace(collective=self._limit_fall(k, command.collective))

    def _update_estimates(self, k: int, measured: Measured, report: Report) -> None:
        """Update the estimates from the sensors and the engines' report."""
        self._report_starts(k, report)
        self._state.k, self._state.report = k, report
        is_standing = not self._state.is_flying()
        is_rising = self.landed is LandedState.TAKING_OFF
        is_grounded = is_standing or (is_rising and not self._landing.touchdown.is_off_ground)
        has_failed = bool(report.lost)
        if not has_failed:
            self._last_healthy_step = k
        is_pushed = self._is_pushed_by_hinges and 0 < k - self._last_healthy_step < self._push_steps
        self._estimates.update(k, measured, is_standing, is_grounded, is_pushed, self._landing.touchdown.has_contact)
        if self.home is None and k >= self._home_delay and is_standing:
            self._state.set_home_here()
        elif self.home is None and not is_standing:
            # The flight began in the air.
            self._landmarks.home = Home(*self._estimates.fix.position, 0.0)
        if self.landed is LandedState.IN_AIR:
            self.energy.ground_speed.update_wind()
        self._course.begin(k, self._loses_heading and has_failed, self._is_pushed_by_hinges and has_failed)
        self._landing.update(report, self.landed is LandedState.IN_AIR and not self._course.descending)
        self.energy.consume(report, self.engines is EngineState.FLY, self.landed is LandedState.IN_AIR)

    def _report_starts(self, k: int, report: Report) -> None:
        """Report engines that start and have started; a vehicle that stands armed waits for them."""
        off = self.engines is EngineState.OFF
        if self._state.report.starting and not report.starting and not off:
            self._state.say(Severity.INFO, "all engines run", k)
        if report.starting and self.armed and not self._state.is_flying():
            if not self._state.report.starting:
                self._state.say(Severity.INFO, "the engines start", k)
            self._arming.restart_wait(k)

    def _check_failsafes(self, k: int) -> None:
        """Check everything that may end the present mode."""
        if not self.armed:
            return
        estimates, report = self._estimates, self._state.report
        if self._watch.detect_tipping(estimates.now):
            if self.landed in (LandedState.ON_GROUND, LandedState.TAKING_OFF):
                self._state.say(Severity.CRITICAL, "tipped over", k)
                self._state.shut_off(k)
            elif not self.failsafe.startswith("leans"):
                self._state.say(Severity.CRITICAL, "leans as if control were lost", k)
                self._state.failsafe = "leans as if control were lost"
            return
        if self._state.is_flying():
            acting = self.failsafe.startswith(OUTSIDE)
            self._watch.update(k, estimates.now, estimates.fix, self.home, report, self.mode, acting)
            self._watch.check_sensors(estimates.senses.failures)
            if not estimates.has_position and self.mode not in (*DIRECT, Mode.ALTCTL, Mode.LAND):
                self._state.activate_failsafe(LAND, "position lost")
        if self.mode in BY_STICK and self._state.is_flying() and not self._remote.sticks_fresh(k):
            self._state.say(Severity.WARNING, "sticks lost, holding", k)
            self._state.enter(Mode.HOLD, k)
        if self.mode is Mode.OFFBOARD and not self._remote.setpoint_fresh(k):
            self._state.say(Severity.WARNING, "no more set-points, holding", k)
            self._state.enter(Mode.HOLD, k)

    def _command_step(self, k: int) -> Command:
        """Return the command of step ``k`` before it is shaped for the loops."""
        self._course.descending = self._course.landing = False
        if self.engines is EngineState.OFF or not self.armed:
            if self._landing.touchdown.is_standing:
                self._state.landed = LandedState.ON_GROUND
            return self._idle_command()
        if self.landed is LandedState.ON_GROUND:
            return self._command_on_ground(k)
        if self.landed is LandedState.TAKING_OFF:
            return self._command_take_off(k)
        return self._command_in_air(k)

    def _limit_fall(self, k: int, collective: float | None) -> float | None:
        """Return the requested collective, or the greater one that it takes not to hit the ground.

        Where height control takes over from a pilot's throttle it is the one that slows the vehicle down.
        """
        report, ground = self._state.report, self._landmarks.ground
        if collective is None and self._landing.touchdown.is_off_ground and not report.lost:
            braking = self._envelope.slow_down(ground, report.remaining)
            if braking is not None:
                self._course.guide.restart_height()
                return braking
        if collective is None or self._landing.collective is not None or not self._gives_collective():
            # Nothing was allocated before the first step.
            if k > 0:
                self._envelope.restart_at(report.collective)
            return collective
        if not self._landing.touchdown.is_off_ground:
            return self._envelope.floor.limit_rate(collective)
        return self._envelope.limit_fall(collective, ground, report.remaining)

    def _command_on_ground(self, k: int) -> Command:
        """Return the command of the armed, standing vehicle; disarm it after some time."""
        arming = self._arming
        if self.mode is Mode.MISSION and arming.flew:
            self._go_on_with_mission(k)
        if self._wants_up(k) and not self._state.report.starting:
            self._state.landed = LandedState.TAKING_OFF
            arming.leave_ground(k)
            self._mission.leave_ground(self.mode is Mode.MISSION)
            self._landing.touchdown.reset()
            self._take_off.leave(k)
            return self._command_take_off(k)
        if arming.idle_too_long(k):
            self._state.stand_down(k, "landed, disarmed" if arming.flew else "not taken off, disarmed")
        return self._idle_command()

    def _go_on_with_mission(self, k: int) -> None:
        """Let a vehicle that has landed in a mission wait where an item says so, and disarm it if it may not go on."""
        mission = self._mission
        if mission.waits_on_ground:
            mission.stay_on_ground(k)
            self._arming.restart_wait(k)
        if not (mission.waits_on_ground or self.mission.done):
            item, short = mission.find_shortage(self.energy)
            why = self._arming.find_take_off_refusal(self.mode, self._state.report)
            if why or (short and item == self.mission.current):
                self._state.stand_down(k, f"mission item {self.mission.current} refused: {why or short}, disarmed")

    def _wants_up(self, k: int) -> bool:
        """Return whether the mode or the request needs the vehicle to leave the ground."""
        if self.mode is Mode.TAKEOFF:
            return not self._arming.flew
        if self.mode is Mode.MISSION:
            item = self.mission.item
            return item is not None and not (self._arming.flew and self._mission.waits_on_ground)
        return self._remote.needs_take_off(self.mode, k)

    def _command_take_off(self, k: int) -> Command:
        """Return the command of a take-off."""
        if self._landing.has_lifted:
            self._state.landed = LandedState.IN_AIR
            self._arming.flew = True
            self._landing.lift_off()
            return self._command_in_air(k)
        if not self._wants_up(k):
            return self._end_take_off(k, "")
        if self._gives_collective():
            return self._command_mode(k)
        command = self._take_off.rise(k - self._arming.since)
        return self._end_take_off(k, "did not leave the ground") if command is None else command

    def _end_take_off(self, k: int, why: str) -> Command:
        """End a take-off: in the air already, or back to standing; with a reason, disarmed."""
        if self._landing.touchdown.is_off_ground:
            self._state.landed = LandedState.IN_AIR
            return self._command_in_air(k)
        self._state.stand(k)
        if why:
            self._state.say(Severity.ERROR, why, k)
            self._state.stand_down(k, "disarmed")
        return self._idle_command()

    def _command_in_air(self, k: int) -> Command:
        """Return the command in flight, or of settling where the legs have touched the ground in a descent."""
        landing, course = self._landing, self._course
        has_contact = landing.detect_contact()
        if landing.reject_switch():
            self._state.say(Severity.WARNING, "the legs report ground in the air, their switch is ignored", k)
        if landing.collective is None and self.mode is Mode.HOLD and course.position is None and has_contact:
            # No request has asked it to leave the ground.
            landing.collective, self._state.landed = self._state.report.collective, LandedState.LANDING
        is_down = has_contact and self._estimates.now.velocity[2] < _SETTLE_SINK
        if landing.collective is not None:
            if is_down:
                return self._command_settling(k, landing.collective)
            landing.collective = None
        command = self._command_mode(k)
        if self._gives_collective():
            if has_contact and landing.touchdown.is_standing:
                self._state.stand(k)
        elif course.descending and is_down:
            landing.collective = self._state.report.collective
            self._state.landed = LandedState.LANDING
        elif self.landed is LandedState.LANDING and not course.descending:
            self._state.landed = LandedState.IN_AIR
        return command

    def _command_settling(self, k: int, collective: float) -> Command:
        """Return the command that takes the thrust away, and note when the vehicle stands."""
        command = self._landing.settle(collective)
        if self._landing.has_settled:
            disarms = self._landing.disarms
            self._state.stand(k)
            if disarms:
                self._state.stand_down(k, "disarmed")
        return command

    def _idle_command(self) -> Command:
        return Command((0.0, 0.0, self._estimates.euler[2]), self._estimates.altitude, None, 0.0)

    # --- what flies in each mode -----------------------------------------------------------------------------------

    def _command_mode(self, k: int) -> Command:
        """Return the command of the manoeuvre that the mode names; where one is complete, enter Hold."""
        mode = self.mode
        if mode in BY_STICK or mode is Mode.OFFBOARD:
            return self._remote.fly(mode)
        if mode is Mode.MISSION:
            command = self._mission.fly(k) or self._end_mission(k)
        elif mode is Mode.LAND:
            command = self._course.descend()
        elif mode is Mode.RTL:
            command = self._return_flight.fly()
        elif mode is Mode.ORBIT:
            command = self._circle.fly()
            if self._circle.complete:
                self._state.say(Severity.INFO, "orbit complete", k)
                self._state.enter(Mode.HOLD, k)
        elif mode is Mode.TAKEOFF:
            command = self._take_off.climb()
            if self._take_off.complete:
                self._state.hold_here(k)
                self._state.say(Severity.INFO, "take-off complete", k)
        else:
            command = self._course.fly()
        if self._course.landing:
            self._state.landed = LandedState.LANDING
        return command

    def _end_mission(self, k: int) -> Command:
        self._state.say(Severity.INFO, "mission finished", k)
        self._state.hold_here(k)
        return self._course.fly()

    def _gives_collective(self) -> bool:
        return self._remote.commands_collective(self.mode)

    # --- requests --------------------------------------------------------------------------------------------------

    def handle(self, request: Request, k: int) -> Answer:
        """Take a request before step ``k``.  Never raises for what a ground station may send."""
        handler = HANDLERS.get(type(request))
        if handler is None:
            return refuse(Result.UNSUPPORTED, f"{type(request).__name__} is not known here")
        try:
            answer: Answer = handler(self._request_handler, request, k)
        except InputError as error:
            return refuse(Result.DENIED, str(error))
        return answer


def _settings(vehicle: Vehicle) -> tuple[PositionGains, PilotSettings, float]:
    """Return a vehicle's position gains and pilot settings, and the smaller attitude gain of roll and pitch, 1/s.

    Raises InputError where it has none, or a position law that is too fast for its attitude loop.
    """
    gains, settings = vehicle.control.position, vehicle.control.pilot
    if gains is None or settings is None:
        missing = "position" if gains is None else "pilot"
        raise InputError(f"vehicle.control.{missing} is missing: {vehicle.name} cannot be flown from a ground station")
    slowest = min(vehicle.control.attitude.gain_1_s[:2])
    if gains.velocity_1_s > slowest / _GAIN_RATIO or gains.position_1_s > gains.velocity_1_s / 2.0:
        raise InputError(
            f"vehicle.control.position: velocity_1_s {gains.velocity_1_s:g} and position_1_s "
            f"{gains.position_1_s:g} are too fast for {vehicle.name}, whose attitude gain is {slowest:g} 1/s: at "
            f"most {slowest / _GAIN_RATIO:.3g}, and at most half of velocity_1_s"
        )
    return gains, settings, slowest
