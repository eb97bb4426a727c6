"""Changing a law in flight without a bump in what it commands."""

from __future__ import annotations

from math import exp


class Fade:
    """Difference of old and new output at a change of gains, which decays exponentially.

    ``fade_s``: slow against the rate loops, short for a pilot; ``negligible``: of commands of order 1, dropped.
    """

    def __init__(self, step: float, fade_s: float = 0.5, negligible: float = 1e-9) -> None:
        self._keep, self._negligible = exp(-step / fade_s), negligible
        self._value = 0.0

    def begin(self, difference: float) -> None:
        """Start a fade at the step of the change, in place of an :meth:`update`."""
        self._value = difference

    def update(self) -> float:
        """Return what is left of the difference after one more step."""
        value = self._value * self._keep
        self._value = value if value > self._negligible or value < -self._negligible else 0.0
        return self._value
