"""Arbitration of sticks where several ground stations send some."""

from __future__ import annotations

from cosim.control.autopilot.parameters import Parameters


class StickOwner:
    """Holder of the sticks: the sender who had them first, until it falls silent, as PX4 chooses between sources."""

    def __init__(self, parameters: Parameters, step: float) -> None:
        self._parameters, self._step = parameters, step
        self._holder, self._last_step = "", 0
        self._is_announced = False

    def find_other_holder(self, sender: str, k: int) -> str:
        """Return the other sender that holds the sticks at step ``k``; empty: ``sender`` holds them from now on."""
        is_recent = (k - self._last_step) * self._step <= self._parameters["HJ_STICK_TIME"]
        if self._holder not in ("", sender) and is_recent:
            return self._holder
        self._is_announced = self._is_announced and self._holder == sender
        self._holder, self._last_step = sender, k
        return ""

    def note_refusal(self) -> bool:
        """Note a refusal, and return whether it is the first since the holder changed, so that it is reported once."""
        was_announced, self._is_announced = self._is_announced, True
        return not was_announced
