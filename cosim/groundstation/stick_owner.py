"""Arbitration of sticks where several ground stations send some."""

from __future__ import annotations

from cosim.control.autopilot.parameters import Parameters


class StickOwner:
    """Holder of the sticks: the sender who had them first, until it falls silent, as PX4 chooses between sources."""

    def __init__(self, parameters: Parameters, step: float) -> None:
        self._parameters, self._step = parameters, step
        self._holder, self._at = "", 0
        self._announced = False

    def others(self, sender: str, k: int) -> str:
        """Return who else holds the sticks at step ``k``; empty: ``sender`` holds them from now on."""
        fresh = (k - self._at) * self._step <= self._parameters["HJ_STICK_TIME"]
        if self._holder not in ("", sender) and fresh:
            return self._holder
        self._announced = self._announced and self._holder == sender
        self._holder, self._at = sender, k
        return ""

    def first_time(self) -> bool:
        """Return whether this is the first refusal since the sticks changed hands, so that it is reported once."""
        announced, self._announced = self._announced, True
        return not announced
