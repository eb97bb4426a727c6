"""Engines that are shut off."""

from __future__ import annotations

from cosim.faults import Engines
from cosim.signals import EngineOutput, PerJet


class Shutoff:
    """Which engines of a bank are shut off: by their port ``run``, which lets their own physics run them down.

    An engine without that port stands at throttle 0 instead, and its thrust and fuel flow are taken as nothing at once.
    """

    def __init__(self, bank: Engines, count: int) -> None:
        self._bank = bank
        self._count = count
        self.reset()

    def reset(self) -> None:
        """All are on, as a bank that was reset is."""
        self.off: frozenset[int] = frozenset()  # 0 to count - 1
        self._cut: frozenset[int] = frozenset()  # those without the port

    def set(self, index: int, on: bool) -> None:
        """Shut one engine off, or on again, before the next step; ``index`` from 0.  Raises EngineError."""
        if on == (index not in self.off):
            return
        changed = frozenset((index,))
        self.off = self.off - changed if on else self.off | changed
        if not self._bank.set_run(index, on):
            self._cut = self._cut - changed if on else self._cut | changed

    def all_off(self) -> None:
        """Shut off what is not off yet."""
        for index in range(self._count):
            self.set(index, False)

    def throttle(self, throttle: PerJet) -> PerJet:
        """The throttles that reach the engines."""
        return self._without(throttle) if self._cut else throttle

    def delivered(self, output: EngineOutput) -> EngineOutput:
        """What the engines deliver."""
        if not self._cut:
            return output
        return output._replace(thrust=self._without(output.thrust), fuel_flow=self._without(output.fuel_flow))

    def _without(self, values: PerJet) -> PerJet:
        return tuple([0.0 if index in self._cut else value for index, value in enumerate(values)])
