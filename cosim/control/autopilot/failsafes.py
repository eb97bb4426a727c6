"""What may go wrong while the vehicle flies: fence, link, fuel, engines, lean.  It says what and once; others act."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, hypot, radians, tan

from cosim.base.constants import GRAVITY
from cosim.base.protocols import Report
from cosim.base.signals import Measured
from cosim.control.autopilot.energy import Energy
from cosim.control.autopilot.estimation.position import Fix
from cosim.control.autopilot.fence import beyond
from cosim.control.autopilot.modes import Home, Mode
from cosim.control.autopilot.parameters import LAND, NOTHING, Parameters
from cosim.control.autopilot.requests import FenceZone
from cosim.control.autopilot.tank_watch import TankWatch

Act = Callable[[int, str], None]  # an action of the parameters, and why
# Chosen by us: times longer than a gust's or a manoeuvre's; beyond 0.7 of the lean little is left to steer with.
_LOST_CONTROL_S = 0.5
_WIND_S = 2.0
_MOST_WIND = 0.7
_FURTHER_M = 2.0  # outside the fence: beyond where it was taken over; GNSS noise is less
_PATIENCE_S = 10.0  # outside the fence, taken over, and nothing was done to come back: it acts again
OUTSIDE = "outside the fence"
_TO_GROUND = ("attitude lost", "gyro lost")  # what stands in for these gets worse with time


class Watch:
    """Looks at every step; calls ``act`` with a parameter's action and the reason when something begins."""

    def __init__(self, parameters: Parameters, energy: Energy, step: float, act: Act) -> None:
        self._parameters = parameters
        self.energy = energy
        self._tank = TankWatch(parameters, energy, step, act)
        self._step = step
        self._act = act
        self.zones: tuple[FenceZone, ...] = ()  # drawn by a ground station; they stay from flight to flight
        self.reset()

    def reset(self) -> None:
        """Full, linked, inside, nothing lost."""
        self.link_lost = -1  # the step at which the link was lost; -1: it is there
        self._link_acted = False
        self.energy.reset()
        self._tank.reset()
        self._excess: float | None = None  # how far outside it was when it last acted or was taken over; None: inside
        self._acted = False  # what the fence asked for is being done
        self._waited = 0.0  # s outside, taken over
        self._lost: tuple[int, ...] = ()
        self._failed: tuple[str, ...] = ()
        self._leaning = self._pushed = 0.0

    def lost_link(self, k: int) -> None:
        if self.link_lost < 0:
            self.link_lost = k
            self._link_acted = False

    def found_link(self) -> None:
        self.link_lost = -1

    def update(
        self, k: int, measured: Measured, fix: Fix, home: Home | None, report: Report, mode: Mode, acting: bool = False
    ) -> None:
        """One step in the air in a mode; ``acting``: what the fence asked for is still what is being done."""
        self._engines(report)
        self._tank.update(k, mode)
        self._fence(fix.position, measured.altitude, home, acting)
        self._wind(fix)
        if self.link_lost >= 0 and not self._link_acted:
            late = (k - self.link_lost) * self._step
            if late >= self._parameters["HJ_LINK_DELAY"]:
                self._link_acted = True
                self._act(int(self._parameters["HJ_LINK_ACT"]), "no ground station")

    def tipped(self, measured: Measured) -> bool:
        """Return whether the vehicle has leaned further than its limit for half a second."""
        _, x, y, _ = measured.attitude
        upright = 1.0 - 2.0 * (x * x + y * y)
        leaning = upright < cos(radians(self._parameters["HJ_TIP_LEAN"]))
        self._leaning = self._leaning + self._step if leaning else 0.0
        return self._leaning >= _LOST_CONTROL_S

    def outside(self, north: float, east: float, altitude: float, home: Home | None) -> str:
        """Why a place is outside the fence; empty if it is not."""
        return self._beyond(north, east, altitude, home)[1]

    def _beyond(self, north: float, east: float, altitude: float, home: Home | None) -> tuple[float, str]:
        """How far outside the fence a place is (m), and why; 0 and nothing where it is inside."""
        drawn = beyond(self.zones, north, east)
        around = self._beyond_radius(north, east, altitude, home)
        return around if around[0] >= drawn[0] else drawn

    def _beyond_radius(self, north: float, east: float, altitude: float, home: Home | None) -> tuple[float, str]:
        """Return how far outside the cylinder around home a position is (m), and why; 0 and nothing where inside."""
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

    def _engines(self, report: Report) -> None:
        new = [str(jet) for jet in report.lost if jet not in self._lost]
        self._lost = report.lost
        if new:
            dry = f", {self.energy.name} is gone" if self.energy.remaining == 0.0 else ""
            self._act(int(self._parameters["HJ_ENG_ACT"]), f"engine {', '.join(new)} failed{dry}")

    def sensors(self, failed: tuple[str, ...]) -> None:
        """Act on sensors that have newly failed; without its own attitude or rates the vehicle must not fly on."""
        new = [text for text in failed if text not in self._failed]
        self._failed = failed
        for text in new:
            self._act(LAND if text in _TO_GROUND else int(self._parameters["HJ_SENS_ACT"]), text)

    def _wind(self, fix: Fix) -> None:
        most = GRAVITY * tan(radians(self._parameters["HJ_LEAN_MAX"]))
        before = self._pushed
        self._pushed = before + self._step if hypot(*fix.disturbance) > _MOST_WIND * most else 0.0
        if before < _WIND_S <= self._pushed:
            self._act(NOTHING, "wind takes most of the lean that is allowed")

    def _fence(self, place: tuple[float, float], altitude: float, home: Home | None, acting: bool) -> None:
        """Act where the fence is passed, and again where that was taken over and it does not come back.

        A pilot who takes over may fly it back: it acts again 2 m further out than where it was taken over (also when
        the fence itself has come nearer by that), or after 10 s outside.
        """
        excess, why = self._beyond(*place, altitude, home)
        if not why:
            self._excess, self._acted = None, False
            return
        if self._excess is not None and acting:
            self._acted = True
            return
        if self._acted:
            # taken over in this step
            self._acted, self._excess, self._waited = False, excess, 0.0
        self._waited += self._step
        if self._excess is None or excess > self._excess + _FURTHER_M or self._waited > _PATIENCE_S:
            self._excess, self._waited = excess, 0.0
            self._act(int(self._parameters["HJ_FENCE_ACT"]), f"{OUTSIDE}: {why}")
