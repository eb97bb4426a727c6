"""What an engine gives after its fire went out, where its model cannot say it: no port ``run``.

A gas turbine loses its hot jet at once.  What is left is the cold air that the compressor of a rotor still moves,
and the rotor is braked by it: every torque on it goes with the square of the speed, so that

    w' = -k w^2      n / n_0 = 1 / (1 + t / run_down)      T / T_0 = left (n / n_0)^exponent

The three numbers come from a gas-path model of the same class, which has the port (engines/README.md); the fit keeps
within 0.015 of the thrust before for four seconds.  A fan's motor has no fire: without current its
thrust dies along its own lag.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class FlameOutLaw(NamedTuple):
    """How an engine goes out.

    ``own``: by its port ``run`` and its own equations.  ``electric``: along its lag.  Else by the law above.
    """

    own: bool = False
    electric: bool = False
    left: float = 1.0  # of the thrust, with the fire just out
    run_down: float = 1.0  # s, until the rotor has half its speed
    exponent: float = 1.0  # of thrust over speed, cold
    relight: float = 0.0  # s, from the call for a start to idle


OWN = FlameOutLaw(own=True)
ELECTRIC = FlameOutLaw(electric=True)


def law_of(stated: Mapping[str, float]) -> FlameOutLaw:
    """The law that a ``[flame_out]`` table states."""
    if "electric" in stated:
        return ELECTRIC
    return FlameOutLaw(
        left=stated["thrust_left"],
        run_down=stated["run_down_s"],
        exponent=stated["exponent"],
        relight=stated["relight_s"],
    )


class Burning:
    """An engine's thrust and speed while its fire is out, by ``law``, and while it is lit again.

    The thrust at the end of the first step without fire is ``T_0``: the engine itself keeps its command over that one
    and has throttle 0 from then on.  Lit again, the thrust goes in a straight line, over ``law.relight``, from what is
    left to that of the engine at throttle 0; then the engine has its command again.
    """

    def __init__(self, law: FlameOutLaw, step: float) -> None:
        self._law = law
        self._step = step
        self._steps = 0  # without fire
        self._lit = -1  # steps since it was called to start; -1 while it is not
        self._thrust = 0.0
        self._speed = 0.0
        self.burns = False  # has its command again

    def light(self) -> None:
        """From the next step on it starts; at once without a time for it."""
        self._lit = 0
        self.burns = self._law.relight <= 0.0

    def throttle(self, command: float) -> float:
        """What reaches the engine."""
        return command if self.burns or not self._steps else 0.0

    def deliver(self, thrust: float, speed: float) -> tuple[float, float]:
        """Thrust [N] and speed [rad/s] at the end of a step, for those of the engine itself."""
        if self.burns:
            return thrust, speed
        if not self._steps:
            self._thrust, self._speed = thrust, speed
        self._steps += 1
        law = self._law
        slowed = 1.0 / (1.0 + self._steps * self._step / law.run_down)
        cold, turning = self._thrust * law.left * slowed**law.exponent, self._speed * slowed
        if self._lit < 0:
            return cold, turning
        self._lit += 1
        share = self._lit * self._step / law.relight
        if share >= 1.0:
            self.burns = True
            share = 1.0
        return cold + share * (thrust - cold), turning + share * (speed - turning)
