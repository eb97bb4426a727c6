"""One effect on an airframe, alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cosim.base.layout import Layout
from cosim.base.signals import EngineOutput, PerJet, PerServo, Vector3
from cosim.vehicle.effects.effect import Effect, Load


def acted(
    effect: Effect, forces: Sequence[Vector3], tilt: PerServo = (0.0, 0.0), thrust: PerJet = (), **state: Any
) -> tuple[list[Vector3], Vector3]:
    """Return the forces with those of the effect, and its moment; ``state``: what is not at rest of the airframe."""
    layout = getattr(effect, "_layout", None)  # of those that ask where jets stand and which way they push
    load = Load(layout or Layout([]))
    load.state = load.state._replace(**state)
    load.set_tilt(tilt)
    load.begin_step(EngineOutput(thrust, (), (), ()), list(forces))
    effect.add_to(load)
    return load.forces, load.moment
