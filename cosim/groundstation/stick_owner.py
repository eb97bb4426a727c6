"""Whose sticks count where several ground stations send some."""

from __future__ import annotations

from cosim.control.autopilot.parameters import Parameters


class StickOwner:
    """Whose sticks count: those of who had them first, until they are let go; as PX4 chooses between its sources."""

    def __init__(self, parameters: Parameters, step: float) -> None:
        self._parameters, self._step = parameters, step
        self._holder, self._at = "", 0
        self._announced = False

    def others(self, sender: str, k: int) -> str:
        """Who else has them at step ``k``; empty: from now on ``sender`` has."""
        fresh = (k - self._at) * self._step <= self._parameters["HJ_STICK_TIME"]
        if self._holder not in ("", sender) and fresh:
            return self._holder
        self._announced = self._announced and self._holder == sender
        self._holder, self._at = sender, k
        return ""

    def first_time(self) -> bool:
        """Is this the first time since they changed hands?  It is said once, however many others there are."""
        announced, self._announced = self._announced, True
        return not announced
