"""Armed or not, what the engines do, and why arming would be refused."""

from __future__ import annotations

from math import degrees

from cosim.base.protocols import EngineState, Report
from cosim.control.autopilot.failsafes import FailsafeMonitor
from cosim.control.autopilot.guidance.course import Course
from cosim.control.autopilot.manoeuvres.remote import RemoteControl
from cosim.control.autopilot.modes import DIRECT, LandedState, Mode
from cosim.control.autopilot.parameters import NOTHING


class Arming:
    """Arming and the commanded state of the engines, with the reasons why arming is refused.

    ``since`` is the step of arming, of the start of a take-off, or of standing again; ``flew``: since arming."""

    # Largest body rate [rad/s] to arm at: a vehicle that turns faster is being carried by hand.
    max_rate = 0.2

    def __init__(self, course: Course, remote: RemoteControl, watch: FailsafeMonitor, step: float) -> None:
        self._parameters, self._estimates, self._landmarks = course.parameters, course.estimates, course.landmarks
        self._remote = remote
        self._watch = watch
        self._step = step
        self.reset(EngineState.IDLE)

    def reset(self, engines: EngineState) -> None:
        """Start disarmed, or armed and in the air if ``engines`` is FLY."""
        self.armed = self.flew = engines is EngineState.FLY
        self.engines = engines
        self.since = 0

    def arm(self, k: int, flying: bool) -> None:
        self.armed = True
        self.engines = EngineState.FLY if flying else EngineState.IDLE
        self.flew = flying
        self.since = k

    def leave_ground(self, k: int) -> None:
        """Switch the engines from idle to flight."""
        self.engines = EngineState.FLY
        self.since = k

    def stand(self, k: int) -> None:
        """Let the engines idle, on the ground."""
        self.engines = EngineState.IDLE
        self.since = k

    def disarm(self) -> None:
        """Disarm the standing vehicle: the engines are off."""
        self.kill_engines()
        self.flew = False

    def kill_engines(self) -> None:
        """Disarm and switch all engines off at once, in the air too."""
        self.armed = False
        self.engines = EngineState.OFF

    def restart_wait(self, k: int) -> None:
        """Restart the timeout for standing armed at step ``k``."""
        self.since = k

    def idle_too_long(self, k: int) -> bool:
        """Return whether the vehicle has stood armed for longer than the parameter allows."""
        wait = self._parameters["HJ_DISARM_LAND" if self.flew else "HJ_DISARM_IDLE"]
        return (k - self.since) * self._step >= wait and (wait > 0.0 or self.flew)

    def refusals(self, mode: Mode, landed: LandedState, report: Report, k: int) -> tuple[str, ...]:
        """Return every reason for which arming would be refused at step ``k``."""
        estimates = self._estimates
        if estimates.measured is None:
            return ("no measurements yet",)
        reasons = []
        limit = self._parameters["HJ_ARM_LEAN"]
        roll, pitch, _ = estimates.euler
        lean = degrees(max(abs(roll), abs(pitch)))
        if lean > limit:
            reasons.append(f"not level: leans {lean:.0f} deg, {limit:g} deg are allowed")
        if max(abs(rate) for rate in estimates.measured.rate) > self.max_rate:
            reasons.append("it is being moved")
        if report.starting:
            reasons.append(f"engine {', '.join(map(str, report.starting))} has yet to start")
        if report.lost:
            reasons.append(_describe_failure(report))
        remaining = self._watch.energy.remaining
        if remaining is not None and 100.0 * remaining <= self._parameters["HJ_FUEL_CRIT"]:
            reasons.append(f"fuel or battery at {100.0 * remaining:.0f} %")
        if self._landmarks.home is None:
            reasons.append("no home: waiting for the position")
        if landed is not LandedState.ON_GROUND:
            reasons.append("it is in the air")
        reasons.extend(estimates.failures)
        if refusal := self.find_position_refusal(mode):
            reasons.append(refusal)
        return (*reasons, *self._remote.refusals(mode, k))

    def find_take_off_refusal(self, mode: Mode, report: Report) -> str:
        """Return why a mode cannot leave the ground: an engine has failed, or no position; empty: it can."""
        if report.lost and int(self._parameters["HJ_ENG_ACT"]) != NOTHING:
            return _describe_failure(report)
        return self.find_position_refusal(mode)

    def find_position_refusal(self, mode: Mode) -> str:
        """Return why a mode cannot be flown from the ground for want of a position; empty: it can."""
        if self._estimates.has_position or mode in (*DIRECT, Mode.ALTCTL) or self._remote.commands_collective(mode):
            return ""
        return f"mode {mode.value} needs the position, and the GNSS receiver has stopped"


def _describe_failure(report: Report) -> str:
    return f"engine {', '.join(map(str, report.lost))} failed"
