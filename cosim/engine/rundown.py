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
    """Law of an engine's thrust after a flame-out, until its rotor stands.

    ``own``: by its port ``run`` and its own equations.  ``electric``: along its lag.  Else by the law above.
    """

    is_modelled: bool = False
    is_electric: bool = False
    thrust_left: float = 1.0  # thrust ratio right after the flame-out
    half_speed_s: float = 1.0  # s until the rotor has half its speed
    exponent: float = 1.0  # exponent of thrust over unlit speed
    relight_s: float = 0.0  # s from the start command to idle


MODELLED = FlameOutLaw(is_modelled=True)  # the FMU models flame-outs itself
ELECTRIC = FlameOutLaw(is_electric=True)  # fans, without a flame


def make_flame_out_law(table: Mapping[str, float]) -> FlameOutLaw:
    """Return the law that a ``[flame_out]`` table specifies."""
    if "electric" in table:
        return ELECTRIC
    return FlameOutLaw(
        thrust_left=table["thrust_left"],
        half_speed_s=table["run_down_s"],
        exponent=table["exponent"],
        relight_s=table["relight_s"],
    )
