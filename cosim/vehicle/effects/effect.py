"""The base class of effects beside thrust, and the load that they add to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from cosim.base._turning import along
from cosim.base.layout import Layout
from cosim.base.signals import UNKNOWN3, ZERO3, EngineOutput, PerJet, PerServo, State, Vector3

NO_OUTPUT = EngineOutput((), (), (), ())  # output before the first step
_ALONG: Final = along  # direct access in compiled code
_STILL = State(ZERO3, ZERO3, (1.0, 0.0, 0.0, 0.0), ZERO3, ZERO3, ZERO3, 0.0, ZERO3, 0.0, False, False)  # at rest


def add_vectors(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


class Load:
    """Forces and moment on the airframe over one step, and the state that effects compute them from.

    ``forces`` [N, body] act at the jets' stations with the hinges at zero, together with ``moment`` [N m, body];
    effects add to both.  ``engine_forces`` [N, body] are those of the engines alone.
    ``axes`` of the thrust, one a group of the ``layout``, and ``positions``, one a jet [m], are those with the
    servos at ``tilt``, computed once a step.
    ``momentum`` [kg m^2/s, body] is that of the rotors at the step's end, ``spool_moment`` [N m, body] what they act
    on the airframe with, kept as the object that goes into the log.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.axes: list[Vector3] = []
        self.positions: list[Vector3] = []
        self.output = NO_OUTPUT  # engine outputs at the end of the step
        self.tilt: PerServo = ()  # rad, at the end of the step
        self.state = _STILL  # airframe at the step's beginning
        self.gusts: list[Vector3] = []  # extra wind at each jet, m/s NED
        self.clear()

    def clear(self) -> None:
        """Start with rotors at rest."""
        self.momentum = ZERO3
        self.spool_moment: Any = UNKNOWN3

    def set_tilt(self, tilt: PerServo) -> None:
        """Turn the hinges to the servos' angles at the step's end [rad]."""
        self.tilt = tilt
        self.axes, self.positions = self.layout.axes(tilt), self.layout.positions(tilt)

    def along_axes(self, thrust: PerJet) -> list[Vector3]:
        """Return each jet's thrust along its own turned axis: N, body."""
        forces: list[Vector3] = _ALONG(self.axes, self.layout.groups, thrust)
        return forces

    def begin_step(self, output: EngineOutput, engine_forces: list[Vector3]) -> None:
        """Begin a step with the thrust of each jet [N, body] and no moment."""
        self.output = output
        self.engine_forces = self.forces = engine_forces
        self.moment = (0.0, 0.0, 0.0)

    def add_moment(self, moment: Vector3) -> None:
        """Add a moment [N m, body] to the load."""
        self.moment = add_vectors(self.moment, moment)


class Effect:
    """Effect on the airframe other than thrust, which adds forces and a moment to a :class:`Load`.

    Effects share the list in ``forces``: one that changes it puts a new list there.
    """

    acts_at_rest = False  # True: acts on a vehicle at rest as well

    def start(self, load: Load) -> None:
        """Begin a flight at rest, with engines at ``load.output``."""

    def add_to(self, load: Load) -> None:
        """Add the effect's forces and moment over a step to ``load``."""


def add_forces(forces: Sequence[Vector3], others: Sequence[Vector3]) -> list[Vector3]:
    """Return the sums of two sequences of forces, station by station."""
    return [add_vectors(force, other) for force, other in zip(forces, others, strict=True)]
