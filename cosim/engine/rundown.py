"""Thrust of an engine after a flame-out, for models without a port ``run``.

A gas turbine loses its hot jet at once.  The compressor still moves cold air, which brakes the rotor with a torque
proportional to the square of the speed, so that

    w' = -k w^2      n / n_0 = 1 / (1 + t / run_down)      T / T_0 = left (n / n_0)^exponent

The three numbers come from a gas-path model of the same class, which has the port (engines/README.md); the fit keeps
within 0.015 of the thrust before for four seconds.  A fan's motor has no fire: without current its
thrust dies along its own lag.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class FlameOutLaw(NamedTuple):
    """The law of an engine's thrust after a flame-out.

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
    """Return the law that a ``[flame_out]`` table specifies."""
    if "electric" in stated:
        return ELECTRIC
    return FlameOutLaw(
        left=stated["thrust_left"],
        run_down=stated["run_down_s"],
        exponent=stated["exponent"],
        relight=stated["relight_s"],
    )
