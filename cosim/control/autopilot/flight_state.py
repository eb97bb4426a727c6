"""The mode and the landed state, and every change of either."""

from __future__ import annotations

from dataclasses import dataclass

from cosim.base.protocols import Report
from cosim.control.autopilot.arming import Arming
from cosim.control.autopilot.estimation.estimates import Estimates
from cosim.control.autopilot.failsafes import Watch
from cosim.control.autopilot.guidance.course import Course, Landmarks
from cosim.control.autopilot.guidance.envelope import Envelope
from cosim.control.autopilot.manoeuvres.circle import Circle
from cosim.control.autopilot.manoeuvres.ground import Landing, TakeOff
from cosim.control.autopilot.manoeuvres.mission_flight import MissionFlight
from cosim.control.autopilot.manoeuvres.remote import Remote
from cosim.control.autopilot.manoeuvres.return_flight import ReturnFlight
from cosim.control.autopilot.modes import Home, LandedState, Mode, Severity
from cosim.control.autopilot.parameters import HOLD, LAND, RETURN, Parameters
from cosim.control.autopilot.status import Messages
from cosim.control.autopilot.tuning import LiveTuning

_ACTIONS = {Mode.HOLD: "holding", Mode.RTL: "returning", Mode.LAND: "landing"}  # failsafes, the more cautious the later


@dataclass(frozen=True)
class AutopilotComponents:
    """Stateful components of the autopilot, shared by :class:`FlightState` and the request handler."""

    parameters: Parameters
    live: LiveTuning
    estimates: Estimates
    envelope: Envelope
    landmarks: Landmarks
    course: Course
    watch: Watch
    remote: Remote
    arming: Arming
    take_off: TakeOff
    landing: Landing
    return_flight: ReturnFlight
    circle: Circle
    mission: MissionFlight


class FlightState:
    """Mode, landed state, acting failsafe and messages, of step ``k`` with its ``report``."""

    def __init__(self, components: AutopilotComponents, jets: int, airborne: bool) -> None:
        self._estimates, self._landmarks, self._course = components.estimates, components.landmarks, components.course
        self._remote, self._arming, self._take_off = components.remote, components.arming, components.take_off
        self._landing, self._return_flight, self._mission = (
            components.landing,
            components.return_flight,
            components.mission,
        )
        self._jets, self._airborne = jets, airborne
        self.reset()

    def reset(self) -> None:
        """Start a flight."""
        self.mode = Mode.HOLD
        self.landed = LandedState.IN_AIR if self._airborne else LandedState.ON_GROUND
        self.failsafe = ""
        self.messages = Messages()
        self.k = -1
        self.report = Report(not self._airborne, 0.0)

    def refusals(self) -> tuple[str, ...]:
        """Return every reason for which arming would be refused now."""
        return self._arming.refusals(self.mode, self.landed, self.report, self.k)

    def enter(self, mode: Mode, k: int) -> None:
        """Enter another mode, or the same one from its beginning."""
        if mode is not self.mode:
            self.say(Severity.INFO, f"mode {mode.value}", k)
            if self.mode is Mode.MISSION and self._arming.armed and (rest := self._mission.mission.describe_rest()):
                self.say(Severity.WARNING, rest, k)
        self.mode = mode
        # No mode flies without any engine.
        if len(self.report.lost) < self._jets:
            self.failsafe = ""
        self._landing.abort()
        self._take_off.reset()
        self._return_flight.reset()
        self._mission.abort()
        self._course.aim(None, None, None)
        if self.landed is LandedState.LANDING:
            self.landed = LandedState.IN_AIR

    def hold_here(self, k: int) -> None:
        """Enter HOLD at the present target."""
        position, height = self._course.position, self._course.height
        self.enter(Mode.HOLD, k)
        self._course.aim(position, height, None)

    def stand(self, k: int) -> None:
        """Note that the vehicle has come to stand, armed."""
        self.landed = LandedState.ON_GROUND
        self._arming.stand(k)
        self._landing.collective = None
        self._course.guide.reset()
        if self._arming.flew:
            if self.mode is Mode.MISSION:
                self._mission.advance(flying=False)
            self.say(Severity.INFO, "landed", k)

    def stand_down(self, k: int, text: str) -> None:
        """Disarm the standing vehicle and announce why."""
        self.landed = LandedState.ON_GROUND
        self._landing.abort()
        if self.mode in (Mode.TAKEOFF, Mode.LAND, Mode.RTL, Mode.MISSION):
            self.enter(Mode.HOLD, k)
        self._arming.disarm()
        self.failsafe = ""
        self.say(Severity.INFO, text, k)

    def shut_off(self, k: int) -> None:
        """Switch all engines off at once, in the air too."""
        self._arming.shut_off()
        self._landing.collective = None
        self.say(Severity.CRITICAL, "engines shut off", k)

    def activate_failsafe(self, action: int, reason: str) -> None:
        """Take a parameter's action, unless the mode is at least as cautious."""
        self.failsafe = reason
        if action == RETURN and self._landmarks.home is None:
            action = LAND
        mode = {HOLD: Mode.HOLD, RETURN: Mode.RTL, LAND: Mode.LAND}.get(action)
        by_caution = list(_ACTIONS)
        rank = by_caution.index(self.mode) if self.mode in by_caution else -1
        if mode is None or rank >= by_caution.index(mode):
            self.say(Severity.WARNING, reason, self.k)
            return
        self.enter(mode, self.k)
        self.failsafe = reason
        self.say(Severity.CRITICAL, f"{reason}: {_ACTIONS[mode]}", self.k)

    def set_home_here(self) -> None:
        """Set home and the ground to where the vehicle stands."""
        self._landmarks.home = Home(*self._estimates.fix.position, self._estimates.altitude)
        self._landmarks.ground = self._estimates.altitude

    def is_flying(self) -> bool:
        """Return whether the vehicle is in the air, or on its way there."""
        return self.landed is not LandedState.ON_GROUND

    def is_standing(self) -> bool:
        """Return whether the vehicle is on the ground, not by the switch alone and whatever the engines do."""
        taking_off = self.landed is LandedState.TAKING_OFF
        return not self.is_flying() or (
            self._landing.is_still_grounded if taking_off else self._landing.has_weight_on_legs
        )

    def say(self, severity: Severity, text: str, k: int) -> None:
        """Send a line to the people on the ground."""
        self.messages.say(k, severity, text)
