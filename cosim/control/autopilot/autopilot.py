"""The autopilot: what a ground station asks for, and the command of every control step.

Requests come in between two steps (:meth:`Autopilot.handle`); :meth:`Autopilot.update` then gives the command of the
step.  Time is counted in steps, so that the same requests at the same steps give the same flight, bit for bit.
"""

from __future__ import annotations

from cosim.base.errors import InputError
from cosim.base.protocols import EngineState, Report
from cosim.base.signals import Command, Measured
from cosim.control.autopilot.failsafes import OUTSIDE_FENCE
from cosim.control.autopilot.flight_state import FlightState
from cosim.control.autopilot.modes import DIRECT, STICK_MODES, Home, LandedState, Mode, Severity
from cosim.control.autopilot.parameters import LAND
from cosim.control.autopilot.request_handler import HANDLERS, refuse
from cosim.control.autopilot.requests import Answer, Request, Result
from cosim.control.autopilot.status import Status


class Autopilot(FlightState):
    """Flight modes of one vehicle, which turn requests of ground stations into commands."""

    # Highest sink rate [m/s] of a vehicle that stands on its legs.
    max_settle_sink = 1.0

    @property
    def engines(self) -> EngineState:
        return self.arming.engines

    @property
    def seen(self) -> Measured:
        """The measurements, sensed or estimated, that the loops fly the present step with."""
        return self.estimates.now

    @property
    def status(self) -> Status:
        """The state after the last step, for telemetry."""
        refusals = () if self.armed else self.refusals()
        course, guide, mission = self.course, self.course.guide, self.mission
        track = None if guide.track is None else guide.track.position
        position = track if course.position is None else course.position
        target = None
        if position is not None and self.is_flying():
            target = Home(*position, course.height if course.height is not None else guide.altitude)
        return Status(
            self.k,
            self.mode,
            self.armed,
            self.landed,
            self.engines,
            not refusals,
            refusals,
            self.home,
            self.estimates.fix,
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
            self.remote.has_fresh_sticks(self.k),
            self.watch.link_lost >= 0,
            self.watch.zones,
            self.landmarks.rally,
            self.circle.orbit if self.mode is Mode.ORBIT else None,
            self.estimates.has_position,
            self.estimates.measured,
            self.estimates.quality,
        )

    def update(self, k: int, measured: Measured, report: Report) -> Command:
        """Return the command of step ``k``; :attr:`engines` is the required engine state."""
        self._update_estimates(k, measured, report)
        self._check_failsafes(k)
        command = self._command_step(k)
        if self.engines is not EngineState.FLY:
            self.envelope.reset(airborne=False)
            return command
        return self.envelope.shape(command)._replace(collective=self._limit_fall(k, command.collective))

    def _update_estimates(self, k: int, measured: Measured, report: Report) -> None:
        self._report_starts(k, report)
        self.k, self.report = k, report
        is_standing = not self.is_flying()
        is_rising = self.landed is LandedState.TAKING_OFF
        is_grounded = is_standing or (is_rising and not self.landing.touchdown.is_off_ground)
        has_failed = bool(report.lost)
        if not has_failed:
            self._last_healthy_step = k
        is_pushed = self._is_pushed_by_hinges and 0 < k - self._last_healthy_step < self._push_steps
        self.estimates.update(k, measured, is_standing, is_grounded, is_pushed, self.landing.touchdown.has_contact)
        if self.home is None and k >= self._home_delay and is_standing:
            self.set_home_here()
        elif self.home is None and not is_standing:
            # A flight that begins in the air has its home there.
            self.landmarks.home = Home(*self.estimates.fix.position, 0.0)
        if self.landed is LandedState.IN_AIR:
            self.energy.ground_speed.update_wind()
        self.course.begin(k, self._loses_heading and has_failed, self._is_pushed_by_hinges and has_failed)
        self.landing.update(report, self.landed is LandedState.IN_AIR and not self.course.descending)
        self.energy.consume(report, self.engines is EngineState.FLY, self.landed is LandedState.IN_AIR)

    def _report_starts(self, k: int, report: Report) -> None:
        """Report starting and started engines; an armed vehicle on the ground waits for them."""
        off = self.engines is EngineState.OFF
        if self.report.starting and not report.starting and not off:
            self.say(Severity.INFO, "all engines run", k)
        if report.starting and self.armed and not self.is_flying():
            if not self.report.starting:
                self.say(Severity.INFO, "the engines start", k)
            self.arming.restart_wait(k)

    def _check_failsafes(self, k: int) -> None:
        """Check all conditions that may end the present mode."""
        if not self.armed:
            return
        estimates, report = self.estimates, self.report
        if self.watch.detect_tipping(estimates.now):
            if self.landed in (LandedState.ON_GROUND, LandedState.TAKING_OFF):
                self.say(Severity.CRITICAL, "tipped over", k)
                self.kill_engines(k)
            elif not self.failsafe.startswith("leans"):
                self.say(Severity.CRITICAL, "leans as if control were lost", k)
                self.failsafe = "leans as if control were lost"
            return
        if self.is_flying():
            acting = self.failsafe.startswith(OUTSIDE_FENCE)
            self.watch.update(k, estimates.now, estimates.fix, self.home, report, self.mode, acting)
            self.watch.check_sensors(estimates.failures)
            if not estimates.has_position and self.mode not in (*DIRECT, Mode.ALTCTL, Mode.LAND):
                self.activate_failsafe(LAND, "position lost")
        if self.mode in STICK_MODES and self.is_flying() and not self.remote.has_fresh_sticks(k):
            self.say(Severity.WARNING, "sticks lost, holding", k)
            self.enter(Mode.HOLD, k)
        if self.mode is Mode.OFFBOARD and not self.remote.has_fresh_setpoint(k):
            self.say(Severity.WARNING, "no more set-points, holding", k)
            self.enter(Mode.HOLD, k)

    def _command_step(self, k: int) -> Command:
        """Return the command of step ``k`` before it is shaped for the loops."""
        self.course.descending = self.course.landing = False
        if self.engines is EngineState.OFF or not self.armed:
            if self.landing.touchdown.is_standing:
                self.landed = LandedState.ON_GROUND
            return self._idle_command()
        if self.landed is LandedState.ON_GROUND:
            return self._command_on_ground(k)
        if self.landed is LandedState.TAKING_OFF:
            return self._command_take_off(k)
        return self._command_in_air(k)

    def _limit_fall(self, k: int, collective: float | None) -> float | None:
        """Return the requested collective, or the larger one needed to avoid the ground.

        Where height control takes over from a pilot's throttle it is the one that slows the vehicle down.
        """
        report, ground = self.report, self.landmarks.ground
        if collective is None and self.landing.touchdown.is_off_ground and not report.lost:
            braking = self.envelope.slow_down(ground, report.remaining)
            if braking is not None:
                self.course.guide.restart_height()
                return braking
        if collective is None or self.landing.collective is not None or not self._is_collective_commanded():
            # Before the first step nothing was allocated.
            if k > 0:
                self.envelope.restart_at(report.collective)
            return collective
        if not self.landing.touchdown.is_off_ground:
            return self.envelope.floor.limit_rate(collective)
        return self.envelope.limit_fall(collective, ground, report.remaining)

    def _command_on_ground(self, k: int) -> Command:
        """Return the command of the armed, standing vehicle; disarm it after some time."""
        arming = self.arming
        if self.mode is Mode.MISSION and arming.flew:
            self._continue_mission(k)
        if self._needs_take_off(k) and not self.report.starting:
            self.landed = LandedState.TAKING_OFF
            arming.leave_ground(k)
            self.mission_flight.leave_ground(self.mode is Mode.MISSION)
            self.landing.touchdown.reset()
            self.take_off.begin(k)
            return self._command_take_off(k)
        if arming.idle_too_long(k):
            self.stand_down(k, "landed, disarmed" if arming.flew else "not taken off, disarmed")
        return self._idle_command()

    def _continue_mission(self, k: int) -> None:
        """Keep a vehicle that landed in a mission waiting as its item states, and disarm it if the mission ends."""
        mission = self.mission_flight
        if mission.waits_on_ground:
            mission.stay_on_ground(k)
            self.arming.restart_wait(k)
        if not (mission.waits_on_ground or self.mission.done):
            item, short = mission.find_shortage(self.energy)
            why = self.arming.find_take_off_refusal(self.mode, self.report)
            if why or (short and item == self.mission.current):
                self.stand_down(k, f"mission item {self.mission.current} refused: {why or short}, disarmed")

    def _needs_take_off(self, k: int) -> bool:
        """Return whether the mode or the request needs the vehicle to leave the ground."""
        if self.mode is Mode.TAKEOFF:
            return not self.arming.flew
        if self.mode is Mode.MISSION:
            item = self.mission.item
            return item is not None and not (self.arming.flew and self.mission_flight.waits_on_ground)
        return self.remote.needs_take_off(self.mode, k)

    def _command_take_off(self, k: int) -> Command:
        if self.landing.has_lifted:
            self.landed = LandedState.IN_AIR
            self.arming.flew = True
            self.landing.lift_off()
            return self._command_in_air(k)
        if not self._needs_take_off(k):
            return self._end_take_off(k, "")
        if self._is_collective_commanded():
            return self._command_mode(k)
        command = self.take_off.rise(k - self.arming.since)
        return self._end_take_off(k, "did not leave the ground") if command is None else command

    def _end_take_off(self, k: int, why: str) -> Command:
        """End a take-off in the air or on the ground; with a reason, disarm."""
        if self.landing.touchdown.is_off_ground:
            self.landed = LandedState.IN_AIR
            return self._command_in_air(k)
        self.stand(k)
        if why:
            self.say(Severity.ERROR, why, k)
            self.stand_down(k, "disarmed")
        return self._idle_command()

    def _command_in_air(self, k: int) -> Command:
        """Return the command in flight, or of settling where the legs have touched the ground in a descent."""
        landing, course = self.landing, self.course
        has_contact = landing.detect_contact()
        if landing.reject_switch():
            self.say(Severity.WARNING, "the legs report ground in the air, their switch is ignored", k)
        if landing.collective is None and self.mode is Mode.HOLD and course.position is None and has_contact:
            # Without a request to take off it stays on the ground.
            landing.collective, self.landed = self.report.collective, LandedState.LANDING
        is_down = has_contact and self.estimates.now.velocity[2] < self.max_settle_sink
        if landing.collective is not None:
            if is_down:
                return self._command_settling(k, landing.collective)
            landing.collective = None
        command = self._command_mode(k)
        if self._is_collective_commanded():
            if has_contact and landing.touchdown.is_standing:
                self.stand(k)
        elif course.descending and is_down:
            landing.collective = self.report.collective
            self.landed = LandedState.LANDING
        elif self.landed is LandedState.LANDING and not course.descending:
            self.landed = LandedState.IN_AIR
        return command

    def _command_settling(self, k: int, collective: float) -> Command:
        """Return the command that removes the thrust, and detect when the vehicle stands."""
        command = self.landing.settle(collective)
        if self.landing.has_settled:
            disarms = self.landing.disarms
            self.stand(k)
            if disarms:
                self.stand_down(k, "disarmed")
        return command

    def _idle_command(self) -> Command:
        return Command((0.0, 0.0, self.estimates.euler[2]), self.estimates.altitude, None, 0.0)

    def _command_mode(self, k: int) -> Command:
        """Return the command of the present mode; enter Hold when its manoeuvre is complete."""
        mode = self.mode
        if mode in STICK_MODES or mode is Mode.OFFBOARD:
            return self.remote.fly(mode)
        if mode is Mode.MISSION:
            command = self.mission_flight.fly(k) or self._end_mission(k)
        elif mode is Mode.LAND:
            command = self.course.descend()
        elif mode is Mode.RTL:
            command = self.return_flight.fly()
        elif mode is Mode.ORBIT:
            command = self.circle.fly()
            if self.circle.complete:
                self.say(Severity.INFO, "orbit complete", k)
                self.enter(Mode.HOLD, k)
        elif mode is Mode.TAKEOFF:
            command = self.take_off.climb()
            if self.take_off.complete:
                self.hold_here(k)
                self.say(Severity.INFO, "take-off complete", k)
        else:
            command = self.course.fly()
        if self.course.landing:
            self.landed = LandedState.LANDING
        return command

    def _end_mission(self, k: int) -> Command:
        self.say(Severity.INFO, "mission finished", k)
        self.hold_here(k)
        return self.course.fly()

    def _is_collective_commanded(self) -> bool:
        return self.remote.commands_collective(self.mode)

    def handle(self, request: Request, k: int) -> Answer:
        """Handle a request before step ``k``.  Never raises for anything a ground station may send."""
        handler = HANDLERS.get(type(request))
        if handler is None:
            return refuse(Result.UNSUPPORTED, f"{type(request).__name__} is not known here")
        try:
            answer: Answer = handler(self, request, k)
        except InputError as error:
            return refuse(Result.DENIED, str(error))
        return answer
