"""Engines that are shut off."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.faults import Engines
from cosim.rundown import Burning, FlameOutLaw
from cosim.signals import EngineOutput, PerJet


class Shutoff:
    """Which engines of a bank are shut off: by their port ``run``, which lets their own physics run them down.

    A turbine without that port goes out by its law (:mod:`cosim.rundown`), and is on again at once when it is set on,
    for that law has no start on the ground.  Any other engine stands at throttle 0, and its thrust is taken as nothing
    at once.
    """

    def __init__(self, bank: Engines, laws: Sequence[FlameOutLaw | None], step: float) -> None:
        self._bank = bank
        self._laws = laws
        self._count = len(laws)
        self._step = step
        self.reset()

    def reset(self) -> None:
        """All are on, as a bank that was reset is."""
        self.off: frozenset[int] = frozenset()  # 0 to count - 1
        self._cut: frozenset[int] = frozenset()  # those without the port
        self._dying: dict[int, Burning] = {}  # of them those that go out by a law

    def set(self, index: int, on: bool) -> None:
        """Shut one engine off, or on again, before the next step; ``index`` from 0.  Raises EngineError."""
        if on == (index not in self.off):
            return
        changed = frozenset((index,))
        self.off = self.off - changed if on else self.off | changed
        if not self._bank.set_run(index, on):
            self._cut = self._cut - changed if on else self._cut | changed
            law = self._laws[index]
            if on:
                self._dying.pop(index, None)
            elif law is not None and not law.electric:
                self._dying[index] = Burning(law, self._step)

    def all_off(self) -> None:
        """Shut off what is not off yet."""
        for index in range(self._count):
            self.set(index, False)

    def throttle(self, throttle: PerJet) -> PerJet:
        """The throttles that reach the engines."""
        if not self._cut:
            return throttle
        given = self._without(throttle)
        if not self._dying:
            return given
        return tuple([self._dying[i].throttle(throttle[i]) if i in self._dying else u for i, u in enumerate(given)])

    def delivered(self, output: EngineOutput) -> EngineOutput:
        """What the engines deliver."""
        if not self._cut:
            return output
        thrust, fuel_flow = self._without(output.thrust), self._without(output.fuel_flow)
        if not self._dying:
            return output._replace(thrust=thrust, fuel_flow=fuel_flow)
        newtons, speeds = list(thrust), list(output.spool_speed)
        for i, engine in self._dying.items():
            newtons[i], speeds[i] = engine.deliver(output.thrust[i], output.spool_speed[i])
        return output._replace(thrust=tuple(newtons), spool_speed=tuple(speeds), fuel_flow=fuel_flow)

    def _without(self, values: PerJet) -> PerJet:
        return tuple([0.0 if index in self._cut else value for index, value in enumerate(values)])
