"""The tank."""

from __future__ import annotations

from cosim.base.signals import PerJet


class Tank:
    """Tank whose fuel is reduced by the engines' reported flows until it is empty.

    The flow at a step's end holds for all of the step, like the thrust.  An engine without a report burns nothing, and
    none fills the tank.
    """

    def __init__(self, mass: float, step: float, full: float = 1.0) -> None:
        self.mass = mass
        self._full = full
        self._step = step
        self.reset()

    def reset(self) -> None:
        """Fill the tank as at the start of a flight."""
        self.burnt = (1.0 - self._full) * self.mass  # fuel burnt since the tank was full, kg

    @property
    def remaining(self) -> float:
        """Fuel on board, kg."""
        return self.mass - self.burnt

    @property
    def empty(self) -> bool:
        return self.burnt >= self.mass

    def burn(self, flows: PerJet) -> bool:
        """Burn ``flows`` [kg/s], one per engine, for one step; return whether fuel was burnt."""
        flow = 0.0
        for rate in flows:
            if rate > 0.0:  # NaN compares as False
                flow += rate
        used = flow * self._step
        if not used or self.empty:
            return False
        self.burnt = min(self.burnt + used, self.mass)
        return True
