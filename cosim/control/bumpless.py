"""Changing a law in flight without a bump in what it commands."""

from __future__ import annotations

from math import exp

TIME = 0.5  # s, over which the difference fades; chosen by us: slow against the rate loops, short for a pilot
_NEGLIGIBLE = 1e-9  # for commands of order 1: below this the difference is dropped


class Fade:
    """Old answer minus new answer at the step of the change, dying out exponentially."""

    def __init__(self, step: float) -> None:
        self._keep = exp(-step / TIME)
        self._value = 0.0

    def begin(self, difference: float) -> None:
        """Start a fade at the step of the change, instead of :meth:`update`."""
        self._value = difference

    def update(self) -> float:
        """Return the rest of the difference, one step later."""
        value = self._value * self._keep
        self._value = value if value > _NEGLIGIBLE or value < -_NEGLIGIBLE else 0.0
        return self._value
