"""When fuel or battery ask for the way home, or down: while what that takes is there with a margin, and no later."""

from __future__ import annotations

from collections.abc import Callable

from cosim.control.autopilot.energy import Energy
from cosim.control.autopilot.modes import Mode
from cosim.control.autopilot.parameters import LAND, NOTHING, Parameters

# Chosen by us, with the reason.
_LOOK_S = 0.1  # between two looks: a thousandth of a short-lived tank
_DOWN_SHARE = 0.5  # of the margin of the way home: the descent alone goes wrong in fewer ways
_LAST_SHARE = 0.3  # of it, where a landing that was taken over begins again: what the reckoning itself may be off
_LAST_FLOOR = 0.5  # of the floor of the landing, likewise
_AGAIN = 1.1  # times a threshold: with more than that left it may be passed anew, after a descent that a pilot flew
_PATIENCE_S = 10.0  # between two warnings that nothing is left to wait for
_RETURNS, _LANDS, _LANDS_AGAIN = 1, 2, 3


class TankWatch:
    """Acts at three levels: return, land, and land again where a landing was taken over; warns where it is.

    Each level is what the way takes, as :class:`Energy` reckons it, with its share of ``HJ_FUEL_MARGIN``; the
    parameters in per cent are the least.
    """

    def __init__(self, parameters: Parameters, energy: Energy, step: float, act: Callable[[int, str], None]) -> None:
        self._parameters, self._energy, self._act = parameters, energy, act
        self._every, self._patience = max(1, round(_LOOK_S / step)), round(_PATIENCE_S / step)
        self.reset()

    def reset(self) -> None:
        """Nothing has been acted upon."""
        self._level = 0
        self._dry = False
        self._warned: int | None = None  # the step at which it last warned of a landing taken over; None: it lands

    def update(self, k: int, mode: Mode) -> None:
        """Look at one step in the air, in a mode, and act once at each level."""
        remaining = self._energy.remaining
        if remaining is None or self._dry or (k % self._every and remaining > 0.0):
            return
        if remaining <= 0.0:
            self._dry = True
            self._act(LAND, f"the {self._energy.name} is gone")
            return
        p, left, margin = self._parameters, 100.0 * remaining, self._energy.margin
        home, down = self._energy.needs()
        low = max(p["HJ_FUEL_LOW"], 100.0 * (1.0 + margin) * home)
        critical = max(p["HJ_FUEL_CRIT"], 100.0 * (1.0 + _DOWN_SHARE * margin) * down)
        if mode not in (Mode.RTL, Mode.LAND) and left > _AGAIN * critical:
            self._level = 0 if left > _AGAIN * low else min(self._level, _RETURNS)
        if left <= critical and self._level < _LANDS:
            self._level = _LANDS
            self._act(LAND, self._why("down", down, critical > p["HJ_FUEL_CRIT"], "critical"))
        elif left <= low and self._level < _RETURNS:
            self._level = _RETURNS
            way = "down" if home == down else "home"
            self._act(int(p["HJ_FUEL_ACT"]), self._why(way, home, low > p["HJ_FUEL_LOW"], "low"))
        elif self._level >= _LANDS:
            self._watch_landing(k, mode, left, down)

    def _why(self, way: str, need: float, reckoned: bool, word: str) -> str:
        """Describe why a level is reached: what the way takes, or where that is little the floor."""
        left = 100.0 * (self._energy.remaining or 0.0)
        if not reckoned:
            return f"energy {word} ({left:.0f} %)"
        return f"{self._energy.name} for the way {way}: {100.0 * need:.0f} %, {left:.0f} % left"

    def _watch_landing(self, k: int, mode: Mode, left: float, down: float) -> None:
        """Warn of a landing that was taken over, and land again at the last moment."""
        if mode is Mode.LAND:
            self._warned = None
            return
        last = 100.0 * (1.0 + _LAST_SHARE * self._energy.margin) * down
        last = max(_LAST_FLOOR * self._parameters["HJ_FUEL_CRIT"], last)
        why = self._why("down", down, True, "")
        if self._level == _LANDS and left <= last:
            self._level, self._warned = _LANDS_AGAIN, None
            self._act(LAND, f"last {why}")
        elif self._warned is None:
            self._warned = k
            again = f", lands again at {last:.0f} %" if self._level == _LANDS else ""
            self._act(NOTHING, f"landing taken over: {why}{again}")
        elif self._level == _LANDS_AGAIN and k - self._warned >= self._patience:
            self._warned = k
            self._act(NOTHING, f"it does not land: {why}")
