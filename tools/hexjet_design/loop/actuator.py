"""What answers the command of an axis: engines, or servos with what they turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, prod

import numpy as np

from cosim.simulation.axis_chain import AxisPart
from cosim.spec.vehicle import Hinge, RateModel, Servo
from hexjet_design.loop.dynamics import Dynamics, make_lag_dynamics

SERVO = "tilt servo"  # actuator that turns a thrust
THIS_STEP_ONLY: tuple[float, ...] = (1.0, 0.0, 0.0)  # weights if only this step acts


@dataclass(frozen=True)
class Actuator:
    """The engines or servos that respond to a command: their dynamics with gain 1 at rest."""

    name: str
    dynamics: Dynamics
    model: RateModel  # the model with hold, sampled

    @classmethod
    def of(cls, name: str, dynamics: Dynamics) -> Actuator:
        """Make an actuator from continuous dynamics; its sampled model is computed once."""
        return cls(name, dynamics, dynamics.discrete(name))

    def with_delay(self, samples: float) -> Actuator:
        """Return the actuator with another transport delay, samples."""
        dynamics = replace(self.dynamics, delay_samples=samples)
        return replace(self, dynamics=dynamics, model=self.model.model_copy(update={"delay_samples": samples}))


def servo_actuator(servo: Servo | Hinge, step: float, slower: float = 1.0) -> Actuator:
    """Return a servo of a tilt or a hinge as it acts below its rate limit, its lag multiplied by ``slower``."""
    return Actuator.of(SERVO, make_lag_dynamics([slower * servo.lag_s], 0.0, step))


def make_hinge_actuator(
    parts: Sequence[AxisPart], step: float, slower: float = 1.0
) -> tuple[Actuator, tuple[float, ...]]:
    """Return hinges as one actuator, and how much of its answers makes the moment, as :attr:`Channel.shape`.

    Servos of lags ``T_i`` with poles ``a_i`` in z give, each by its share and with what it turns,

        sum_i W_i(z) (1 - a_i) / (z - a_i) = A(z) sum_i W_i(z) prod_j!=i (1 - a_j / z) / (1 - a_j),

    with ``W_i`` of :meth:`AxisPart.compute_weights` and ``A`` all of the lags in a row, so that the second factor
    has no poles.  It is taken over the sum of the shares, and ``slower`` multiplies the lags.  The dynamics are those
    of the lag that gives most: they say how quick a loop may be, the model and the shape what it meets.
    """
    servos = [servo_actuator(part.servos[0], step, slower) for part in parts]
    poles = [exp(step * servo.dynamics.poles[0].real) for servo in servos]
    shape = np.zeros(1)
    for k, part in enumerate(parts):
        answer = np.array(part.compute_weights(step))
        for pole in poles[:k] + poles[k + 1 :]:
            answer = np.convolve(answer, [1.0 / (1.0 - pole), -pole / (1.0 - pole)])
        shape = shape + answer if k else answer
    main = servos[max(range(len(parts)), key=lambda k: parts[k].fraction)]
    if len(poles) > 1:
        gain = prod([1.0 - pole for pole in poles])
        zeros = [0.0] * (len(poles) - 1)
        changed = {"gain": gain, "zeros": zeros, "poles": sorted(poles, reverse=True)}
        main = replace(main, model=main.model.model_copy(update=changed))
    return main, tuple((shape / sum([part.fraction for part in parts])).tolist())
