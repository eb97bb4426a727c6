"""What the autopilot consists of, its mode and landed state, and every change of either."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from cosim.base.errors import InputError
from cosim.base.protocols import EngineState, Report
from cosim.base.signals import Measured
from cosim.control.autopilot.arming import Arming
from cosim.control.autopilot.energy import Energy
from cosim.control.autopilot.estimation.estimator import Estimator
from cosim.control.autopilot.failsafes import FailsafeMonitor
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
from cosim.control.autopilot.manoeuvres.remote import RemoteControl
from cosim.control.autopilot.manoeuvres.return_flight import ReturnFlight
from cosim.control.autopilot.manoeuvres.touchdown import Touchdown
from cosim.control.autopilot.modes import Home, LandedState, Message, Mode, Severity
from cosim.control.autopilot.parameters import HOLD, LAND, RETURN, Parameters, table
from cosim.control.autopilot.requests import InjectFault
from cosim.control.autopilot.tuning import Blocks, ControlLoops, LiveTuning
from cosim.spec.vehicle import PilotSettings, PositionGains, Vehicle

# Flight modes that failsafes enter, with the message's verb; the more cautious ones come later.
_FAILSAFE_MODES = {Mode.HOLD: "holding", Mode.RTL: "returning", Mode.LAND: "landing"}


class Thrust(NamedTuple):
    """The nominal thrust of the vehicle."""

    hover: float  # collective at hover
    idle: float = 0.0  # idle thrust over the thrust range
    answer: tuple[float, float] = (0.2, 0.2)  # s, delay plus lag: at hover and longest


class FaultCommands(NamedTuple):
    """Functions that inject and clear faults by command; may raise InputError.  None: commands are not supported."""

    inject: Callable[[InjectFault], None] | None = None
    clear: Callable[[], None] | None = None


class FlightState:
    """State of a flight at step ``k``: mode, landed state, active failsafe, messages; and the components that fly.

    ``engines``: at the start; where they fly, it begins in the air, armed, holding.  ``noisy``: the sensors have their
    noise, which distinguishes a receiver that has stopped from one that stands still.
    """

    # Time [s] after an engine loss in which sideways acceleration is ignored: it comes from hinges, not wind.
    pushed_s = 3.0
    # Time [s] of GNSS fixes before the position may become home.
    home_delay_s = 1.0

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
        gains, settings, slowest = _find_settings(vehicle)
        limits = vehicle.control.allocation
        least_throttle = limits.throttle_min
        self.parameters = parameters = Parameters(
            table(vehicle.control, settings, loops.controller, loops.delay, loops.level, vehicle.jets)
        )
        position = PositionController(gains, step)
        tracker = Tracker(settings.acceleration_m_s2, settings.jerk_m_s3, step)
        blocks = Blocks(loops.attitude, loops.altitude, loops.rate, position, tracker, loops.predictors)
        self.live = LiveTuning(parameters, vehicle.control, blocks, step)
        self.estimates = estimates = Estimator(vehicle.sensors, gains, step, slowest, noisy)
        self.envelope = Envelope(vehicle, hover, idle, answer, parameters, estimates, step)
        self.landmarks = landmarks = Landmarks()
        guide = Guide(tracker, position, parameters, self.envelope.height_limits(), step)
        self.course = course = Course(parameters, estimates, landmarks, guide)
        self.energy = Energy(course, GroundSpeed(course, vehicle, gains.catch_up_m_s, step), hover, step)
        self.watch = watch = FailsafeMonitor(parameters, self.energy, step, self.activate_failsafe)
        self.remote = RemoteControl(course, limits, hover, step)
        self.arming = Arming(course, self.remote, watch, step)
        self.take_off = TakeOff(course, hover, least_throttle, step)
        touchdown = Touchdown(hover, step, idle, settings.spool_s)
        self.landing = Landing(course, touchdown, hover, least_throttle, step)
        self.return_flight = ReturnFlight(course)
        self.circle = Circle(course, watch)
        self.mission_flight = MissionFlight(course, self.circle, self.return_flight, step)
        self.faults = faults
        self._jets, self._engines, self._airborne = len(vehicle.jets), engines, engines is EngineState.FLY
        # A flight that begins in the air assumes the ground at height 0, where the vehicle would stand on its legs.
        legs = (contact.position_m[2] for contact in vehicle.contacts if contact.kind == "leg")
        self._leg_height = max(legs, default=0.0) if self._airborne else 0.0
        # Whether hinges that turn engines push the vehicle aside after an engine loss, before throttles have followed.
        catch = vehicle.control.monitor is not None and vehicle.control.monitor.catch
        self._is_pushed_by_hinges = catch and vehicle.layout().moves
        self._push_steps = round(self.pushed_s / step)
        # Whether the vehicle cannot hold its heading with one engine out.
        self._loses_heading = self._is_pushed_by_hinges or vehicle.allocation == "rotors"
        self._home_delay = round(self.home_delay_s / step)
        self.reset()

    def reset(self, measured: Measured | None = None) -> None:
        """Start a flight at a measured state; parameters, mission, fence and rally points are kept."""
        self.mode = Mode.HOLD
        self.landed = LandedState.IN_AIR if self._airborne else LandedState.ON_GROUND
        # Reason of the active failsafe; empty: none.
        self.failsafe = ""
        # Latest messages to ground stations.
        self.messages: deque[Message] = deque(maxlen=200)
        self._message_count = 0
        self.k = -1
        self.report = Report(not self._airborne, 0.0)
        # Last step at which all engines ran.
        self._last_healthy_step = 0
        self.estimates.reset(measured)
        self.landmarks.reset(self._leg_height)
        self.course.reset()
        self.remote.reset()
        self.arming.reset(self._engines)
        self.take_off.reset()
        self.landing.reset()
        self.return_flight.reset()
        self.circle.reset()
        self.mission_flight.reset()
        self.envelope.reset(self._airborne)
        self.watch.reset()

    @property
    def armed(self) -> bool:
        return self.arming.armed

    @property
    def home(self) -> Home | None:
        return self.landmarks.home

    @property
    def mission(self) -> Mission:
        return self.mission_flight.mission

    def refusals(self) -> tuple[str, ...]:
        """Return every reason for which arming would be refused now."""
        return self.arming.refusals(self.mode, self.landed, self.report, self.k)

    def enter(self, mode: Mode, k: int) -> None:
        """Enter a mode, or restart the present one."""
        if mode is not self.mode:
            self.say(Severity.INFO, f"mode {mode.value}", k)
            if self.mode is Mode.MISSION and self.armed and (rest := self.mission_flight.mission.describe_remaining()):
                self.say(Severity.WARNING, rest, k)
        self.mode = mode
        # No mode can fly without any engine.
        if len(self.report.lost) < self._jets:
            self.failsafe = ""
        self.landing.abort()
        self.take_off.reset()
        self.return_flight.reset()
        self.mission_flight.abort()
        self.course.aim(None, None, None)
        if self.landed is LandedState.LANDING:
            self.landed = LandedState.IN_AIR

    def hold_here(self, k: int) -> None:
        """Enter HOLD at the present target."""
        position, height = self.course.position, self.course.height
        self.enter(Mode.HOLD, k)
        self.course.aim(position, height, None)

    def stand(self, k: int) -> None:
        """Record that the armed vehicle stands on the ground, and let the engines idle."""
        self.landed = LandedState.ON_GROUND
        self.arming.stand(k)
        self.landing.collective = None
        self.course.guide.reset()
        if self.arming.flew:
            if self.mode is Mode.MISSION:
                self.mission_flight.advance(flying=False)
            self.say(Severity.INFO, "landed", k)

    def stand_down(self, k: int, text: str) -> None:
        """Disarm the standing vehicle and announce why."""
        self.landed = LandedState.ON_GROUND
        self.landing.abort()
        if self.mode in (Mode.TAKEOFF, Mode.LAND, Mode.RTL, Mode.MISSION):
            self.enter(Mode.HOLD, k)
        self.arming.disarm()
        self.failsafe = ""
        self.say(Severity.INFO, text, k)

    def kill_engines(self, k: int) -> None:
        """Switch all engines off at once, in the air too."""
        self.arming.kill_engines()
        self.landing.collective = None
        self.say(Severity.CRITICAL, "engines shut off", k)

    def activate_failsafe(self, action: int, reason: str) -> None:
        """Enter the mode of a failsafe's action unless the present mode is at least as cautious."""
        self.failsafe = reason
        if action == RETURN and self.landmarks.home is None:
            action = LAND
        mode = {HOLD: Mode.HOLD, RETURN: Mode.RTL, LAND: Mode.LAND}.get(action)
        by_caution = list(_FAILSAFE_MODES)
        rank = by_caution.index(self.mode) if self.mode in by_caution else -1
        if mode is None or rank >= by_caution.index(mode):
            self.say(Severity.WARNING, reason, self.k)
            return
        self.enter(mode, self.k)
        self.failsafe = reason
        self.say(Severity.CRITICAL, f"{reason}: {_FAILSAFE_MODES[mode]}", self.k)

    def set_home_here(self) -> None:
        """Set home and ground to the present position."""
        self.landmarks.home = Home(*self.estimates.fix.position, self.estimates.altitude)
        self.landmarks.ground = self.estimates.altitude

    def is_flying(self) -> bool:
        """Return whether the vehicle is in the air, or on its way there."""
        return self.landed is not LandedState.ON_GROUND

    def is_standing(self) -> bool:
        """Return whether the vehicle is on the ground, by leg switch and weight, with engines running or not."""
        taking_off = self.landed is LandedState.TAKING_OFF
        return not self.is_flying() or (
            self.landing.is_still_grounded if taking_off else self.landing.has_weight_on_legs
        )

    def say(self, severity: Severity, text: str, k: int) -> None:
        """Append a message to those that ground stations receive."""
        self._message_count += 1
        self.messages.append(Message(self._message_count, k, severity, text))


def _find_settings(vehicle: Vehicle, min_ratio: float = 2.5) -> tuple[PositionGains, PilotSettings, float]:
    """Return a vehicle's position gains and pilot settings, and the smaller attitude gain of roll and pitch, 1/s.

    Raises InputError where it has none, or an attitude gain below ``min_ratio`` times that of the velocity.
    """
    gains, settings = vehicle.control.position, vehicle.control.pilot
    if gains is None or settings is None:
        missing = "position" if gains is None else "pilot"
        raise InputError(f"vehicle.control.{missing} is missing: {vehicle.name} cannot be flown from a ground station")
    slowest = min(vehicle.control.attitude.gain_1_s[:2])
    if gains.velocity_1_s > slowest / min_ratio or gains.position_1_s > gains.velocity_1_s / 2.0:
        raise InputError(
            f"vehicle.control.position: velocity_1_s {gains.velocity_1_s:g} and position_1_s "
            f"{gains.position_1_s:g} are too fast for {vehicle.name}, whose attitude gain is {slowest:g} 1/s: at "
            f"most {slowest / min_ratio:.3g}, and at most half of velocity_1_s"
        )
    return gains, settings, slowest
