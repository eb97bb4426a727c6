"""Return and landing for want of fuel or battery, while what the way takes is there with a margin."""

from __future__ import annotations

from collections.abc import Callable

from cosim.control.autopilot.energy import Energy
from cosim.control.autopilot.modes import Mode
from cosim.control.autopilot.parameters import LAND, NOTHING, Parameters

# Chosen by us, with the reason.
_LOOK_S = 0.1  # s between checks: a thousandth of a short-lived tank
_DOWN_FRACTION = 0.5  # fraction of the margin of the return: the descent alone goes wrong in fewer ways
_LAST_FRACTION = 0.3  # of it, where a landing that was taken over begins again: the error of the estimate itself
_LAST_FLOOR = 0.5  # fraction of the landing's reserve, likewise
_AGAIN = 1.1  # times a threshold: with more than that left it may act again, after a descent that a pilot flew
_PATIENCE_S = 10.0  # s between warnings that nothing is left to wait for
_RETURNS, _LANDS, _LANDS_AGAIN = 1, 2, 3


class TankWatch:
    """Acts at three levels: return, land, and land again where a landing was taken over, which it warns of.

    Each level is what the way takes, as :class:`Energy` estimates it, with its part of ``HJ_FUEL_MARGIN``; the
    parameters in per cent are the least.
    """

    def __init__(self, parameters: Parameters, energy: Energy, step: float, act: Callable[[int, str], None]) -> None:
        self._parameters, self._energy, self._act = parameters, energy, act
        self._interval, self._patience = max(1, round(_LOOK_S / step)), round(_PATIENCE_S / step)
        self.reset()

    def reset(self) -> None:
        """Start a flight."""
        self._level = 0
        self._dry = False
        self._warned_at: int | None = None  # step of the last warning of a landing taken over; None: it lands

    def update(self, k: int, mode: Mode) -> None:
        """Check one step in the air, in a mode, and act once at each level."""
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
        critical = max(p["HJ_FUEL_CRIT"], 100.0 * (1.0 + _DOWN_FRACTION * margin) * down)
        if mode not in (Mode.RTL, Mode.LAND) and percent > _AGAIN * critical:
            self._level = 0 if percent > _AGAIN * low else min(self._level, _RETURNS)
        if percent <= critical and self._level < _LANDS:
            self._level = _LANDS
            self._act(LAND, self._describe("down", down, critical > p["HJ_FUEL_CRIT"], "critical"))
        elif percent <= low and self._level < _RETURNS:
            self._level = _RETURNS
            way = "down" if home == down else "home"
            self._act(int(p["HJ_FUEL_ACT"]), self._describe(way, home, low > p["HJ_FUEL_LOW"], "low"))
        elif self._level >= _LANDS:
            self._watch_landing(k, mode, percent, down)

    def _describe(self, way: str, need: float, is_estimated: bool, word: str) -> str:
        """Describe why a level is reached: what the way takes, or where that is little the floor."""
        percent = 100.0 * (self._energy.remaining or 0.0)
        if not is_estimated:
            return f"energy {word} ({percent:.0f} %)"
        return f"{self._energy.name} for the way {way}: {100.0 * need:.0f} %, {percent:.0f} % left"

    def _watch_landing(self, k: int, mode: Mode, percent: float, down: float) -> None:
        """Warn of a landing that was taken over, and land again at the last moment."""
        if mode is Mode.LAND:
            self._warned_at = None
            return
        last = 100.0 * (1.0 + _LAST_FRACTION * self._energy.margin) * down
        last = max(_LAST_FLOOR * self._parameters["HJ_FUEL_CRIT"], last)
        why = self._describe("down", down, True, "")
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
