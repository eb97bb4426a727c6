"""Failsafes of a flight: fence, link, fuel, engines, sensors, wind, lean.  Each event is reported once."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, hypot, radians, tan

from cosim.base.constants import GRAVITY
from cosim.base.frames import upright
from cosim.base.protocols import Report
from cosim.base.signals import Measured
from cosim.control.autopilot.energy import Energy
from cosim.control.autopilot.estimation.position import Fix
from cosim.control.autopilot.fence import measure_excess
from cosim.control.autopilot.modes import Home, Mode
from cosim.control.autopilot.parameters import LAND, NOTHING, Parameters
from cosim.control.autopilot.requests import FenceZone

Act = Callable[[int, str], None]  # called with an action and its reason
OUTSIDE_FENCE = "outside the fence"  # beginning of the fence's reason
# Failures after which the vehicle lands at once, because estimates without these sensors get worse with time.
_LAND_AT_ONCE_ON = ("attitude lost", "gyro lost")
_RETURNS, _LANDS, _LANDS_AGAIN = 1, 2, 3  # levels of the fuel failsafe


class FailsafeMonitor:
    """Checks fence, link, fuel, engines and sensors each step; calls ``act`` with action and reason of a new event."""

    # Times [s] that a lean must last to count as lost control, and a wind to be reported: longer than gusts.
    lost_control_s, wind_s = 0.5, 2.0
    # Largest fraction of the allowed lean that wind may take: beyond it little is left for steering.
    max_wind = 0.7
    # After a pilot took over outside the fence, the fence acts again this far further out, or after this time outside.
    further_m, patience_s = 2.0, 10.0

    def __init__(self, parameters: Parameters, energy: Energy, step: float, act: Act) -> None:
        self._parameters = parameters
        self.energy = energy
        self._tank = FuelFailsafe(parameters, energy, step, act)
        self._step = step
        self._act = act
        self.zones: tuple[FenceZone, ...] = ()  # drawn by a station; kept across flights
        self.reset()

    def reset(self) -> None:
        """Start a flight without any event."""
        self.link_lost = -1  # step of the loss; -1: connected
        self._link_has_acted = False
        self.energy.reset()
        self._tank.reset()
        self._excess: float | None = None  # m outside when the fence last acted
        self._is_fence_action_flown = False  # until a pilot takes over or it is inside
        self._waited_s = 0.0  # s outside since the pilot took over
        self._lost_engines: tuple[int, ...] = ()
        self._failed_sensors: tuple[str, ...] = ()
        self._lean_s = self._wind_s = 0.0

    def record_link_loss(self, k: int) -> None:
        if self.link_lost < 0:
            self.link_lost = k
            self._link_has_acted = False

    def record_link_return(self) -> None:
        self.link_lost = -1

    def update(
        self, k: int, measured: Measured, fix: Fix, home: Home | None, report: Report, mode: Mode, acting: bool = False
    ) -> None:
        """Check one step in the air; ``acting``: the fence's action is being flown."""
        self._act_on_failed_engines(report)
        self._tank.update(k, mode)
        self._check_fence(fix.position, measured.altitude, home, acting)
        self._warn_of_wind(fix)
        if self.link_lost >= 0 and not self._link_has_acted:
            elapsed = (k - self.link_lost) * self._step
            if elapsed >= self._parameters["HJ_LINK_DELAY"]:
                self._link_has_acted = True
                self._act(int(self._parameters["HJ_LINK_ACT"]), "no ground station")

    def detect_tipping(self, measured: Measured) -> bool:
        """Return whether the vehicle has leaned further than its limit for half a second; called once a step."""
        is_leaning = upright(measured.attitude) < cos(radians(self._parameters["HJ_TIP_LEAN"]))
        self._lean_s = self._lean_s + self._step if is_leaning else 0.0
        return self._lean_s >= self.lost_control_s

    def describe_outside(self, north: float, east: float, altitude: float, home: Home | None) -> str:
        """Return why a position is outside the fence; empty if it is inside."""
        return self._measure_excess(north, east, altitude, home)[1]

    def _measure_excess(self, north: float, east: float, altitude: float, home: Home | None) -> tuple[float, str]:
        """Return the distance outside the fence (m) and the reason; 0 and empty inside."""
        drawn = measure_excess(self.zones, north, east)
        around = self._measure_excess_around_home(north, east, altitude, home)
        return around if around[0] >= drawn[0] else drawn

    def _measure_excess_around_home(
        self, north: float, east: float, altitude: float, home: Home | None
    ) -> tuple[float, str]:
        """Return how far outside the cylinder around home a position is (m), and why; 0 and an empty text inside."""
        radius, ceiling = self._parameters["HJ_FENCE_RAD"], self._parameters["HJ_FENCE_ALT"]
        if home is None:
            return 0.0, ""
        distance = hypot(north - home.north, east - home.east)
        height = altitude - home.altitude
        if radius > 0.0 and distance > radius:
            return distance - radius, f"{distance:.0f} m from home, the fence is at {radius:g} m"
        if ceiling > 0.0 and height > ceiling:
            return height - ceiling, f"{height:.0f} m above home, the fence is at {ceiling:g} m"
        return 0.0, ""

    def _act_on_failed_engines(self, report: Report) -> None:
        new = [str(jet) for jet in report.lost if jet not in self._lost_engines]
        self._lost_engines = report.lost
        if new:
            dry = f", {self.energy.name} is gone" if self.energy.remaining == 0.0 else ""
            self._act(int(self._parameters["HJ_ENG_ACT"]), f"engine {', '.join(new)} failed{dry}")

    def check_sensors(self, failed: tuple[str, ...]) -> None:
        """Act on sensors that have just failed; without attitude or rates the vehicle must land."""
        new = [text for text in failed if text not in self._failed_sensors]
        self._failed_sensors = failed
        for text in new:
            self._act(LAND if text in _LAND_AT_ONCE_ON else int(self._parameters["HJ_SENS_ACT"]), text)

    def _warn_of_wind(self, fix: Fix) -> None:
        most = GRAVITY * tan(radians(self._parameters["HJ_LEAN_MAX"]))
        before = self._wind_s
        self._wind_s = before + self._step if hypot(*fix.disturbance) > self.max_wind * most else 0.0
        if before < self.wind_s <= self._wind_s:
            self._act(NOTHING, "wind takes most of the lean that is allowed")

    def _check_fence(self, position: tuple[float, float], altitude: float, home: Home | None, acting: bool) -> None:
        """Act when the fence is crossed, and again if a pilot took over and stays outside.

        A pilot who takes over may fly it back: it acts again 2 m further out than where it was taken over (also when
        the fence itself has come nearer by that), or after 10 s outside.
        """
        excess, why = self._measure_excess(*position, altitude, home)
        if not why:
            self._excess, self._is_fence_action_flown = None, False
            return
        if self._excess is not None and acting:
            self._is_fence_action_flown = True
            return
        if self._is_fence_action_flown:
            # A pilot took over in this step.
            self._is_fence_action_flown, self._excess, self._waited_s = False, excess, 0.0
        self._waited_s += self._step
        if self._excess is None or excess > self._excess + self.further_m or self._waited_s > self.patience_s:
            self._excess, self._waited_s = excess, 0.0
            self._act(int(self._parameters["HJ_FENCE_ACT"]), f"{OUTSIDE_FENCE}: {why}")


class FuelFailsafe:
    """Acts on low fuel at three levels: return, land, and land again after a pilot took over.

    Each level is what the way takes, as :class:`Energy` estimates it, with its part of ``HJ_FUEL_MARGIN``; the
    parameters in per cent are the least.
    """

    # Times [s] between checks, a thousandth of a small tank, and between warnings when nothing can be done.
    interval_s, patience_s = 0.1, 10.0
    # Fraction of the return's margin that a landing in place needs: a descent alone can go wrong in fewer ways.
    down_fraction = 0.5
    # A landing that a pilot stopped begins again at these fractions of the margin and of the landing reserve.
    last_fraction, last_floor = 0.3, 0.5
    # After a pilot stopped the descent the failsafe may act again with this many times the threshold left.
    rearm_factor = 1.1

    def __init__(self, parameters: Parameters, energy: Energy, step: float, act: Act) -> None:
        self._parameters, self._energy, self._act = parameters, energy, act
        self._interval, self._patience = max(1, round(self.interval_s / step)), round(self.patience_s / step)
        self.reset()

    def reset(self) -> None:
        """Start a flight without any event."""
        self._level = 0
        self._dry = False
        self._warned_at: int | None = None  # step of the warning; None: it lands

    def update(self, k: int, mode: Mode) -> None:
        """Check one step in the air and act once per level."""
        remaining = self._energy.remaining
        if remaining is None or self._dry or (k % self._interval and remaining > 0.0):
            return
        if remaining <= 0.0:
            self._dry = True
            self._act(LAND, f"the {self._energy.name} is gone")
            return
        p, percent, margin = self._parameters, 100.0 * remaining, self._energy.margin
        home, down = self._energy.needed_fractions()
        low = max(p["HJ_FUEL_LOW"], 100.0 * (1.0 + margin) * home)
        critical = max(p["HJ_FUEL_CRIT"], 100.0 * (1.0 + self.down_fraction * margin) * down)
        if mode not in (Mode.RTL, Mode.LAND) and percent > self.rearm_factor * critical:
            self._level = 0 if percent > self.rearm_factor * low else min(self._level, _RETURNS)
        if percent <= critical and self._level < _LANDS:
            self._level = _LANDS
            self._act(LAND, self._describe_level("down", down, critical > p["HJ_FUEL_CRIT"], "critical"))
        elif percent <= low and self._level < _RETURNS:
            self._level = _RETURNS
            way = "down" if home == down else "home"
            self._act(int(p["HJ_FUEL_ACT"]), self._describe_level(way, home, low > p["HJ_FUEL_LOW"], "low"))
        elif self._level >= _LANDS:
            self._watch_landing(k, mode, percent, down)

    def _describe_level(self, way: str, need: float, is_estimated: bool, word: str) -> str:
        """Return why a level is reached: the energy that the way needs, or the minimum."""
        percent = 100.0 * (self._energy.remaining or 0.0)
        if not is_estimated:
            return f"energy {word} ({percent:.0f} %)"
        return f"{self._energy.name} for the way {way}: {100.0 * need:.0f} %, {percent:.0f} % left"

    def _watch_landing(self, k: int, mode: Mode, percent: float, down: float) -> None:
        """Warn if a pilot took over the landing, and land again at the last moment."""
        if mode is Mode.LAND:
            self._warned_at = None
            return
        last = 100.0 * (1.0 + self.last_fraction * self._energy.margin) * down
        last = max(self.last_floor * self._parameters["HJ_FUEL_CRIT"], last)
        why = self._describe_level("down", down, True, "")
        if self._level == _LANDS and percent <= last:
            self._level, self._warned_at = _LANDS_AGAIN, None
            self._act(LAND, f"last {why}")
        elif self._warned_at is None:
            self._warned_at = k
            again = f", lands again at {last:.0f} %" if self._level == _LANDS else ""
            self._act(NOTHING, f"landing taken over: {why}{again}")
        elif self._level == _LANDS_AGAIN and k - self._warned_at >= self._patience:
            self._warned_at = k
            self._act(NOTHING, f"it does not land: {why}")
