"""Models of a scenario's disturbances: on the vehicle from outside, and added to the controller's signals."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from cosim.base.storage.toml import Duration, Model, Positive, Seconds, Vector
from cosim.spec.scenario.commands import Amplitude

Axis = Literal["roll", "pitch", "yaw"]


class ForceDisturbance(Model):
    """A constant force at the centre of gravity of the vehicle as built, body frame."""

    kind: Literal["force"]
    start_s: Seconds
    duration_s: Duration
    force_n: Vector


class MomentDisturbance(Model):
    """A constant moment, body frame."""

    kind: Literal["moment"]
    start_s: Seconds
    duration_s: Duration
    moment_n_m: Vector


class TorqueCommandDisturbance(Model):
    """Signal added to the rate controller's output on one axis, unknown to the controller.

    The unit is that output's: throttle on roll, rad of tilt on pitch and yaw.  It enters at the ``actuators``, or at
    the ``controller``: before the added delay, and if ``seen`` before the place where a predictor reads the command.
    """

    kind: Literal["torque_command"]
    axis: Axis
    shape: Literal["step", "doublet", "sweep"] = "step"
    start_s: Seconds
    duration_s: Duration  # of the whole step, doublet or sweep
    amplitude: Amplitude
    from_hz: Positive = 0.3
    to_hz: Positive = 4.0
    at: Literal["actuators", "controller"] = "actuators"
    seen: bool = False  # whether the predictor is told of it

    @model_validator(mode="after")
    def _refuse_seen_at_actuators(self) -> Self:
        if self.seen and self.at == "actuators":
            raise ValueError("a predictor can see only what is added at the controller (at = 'controller')")
        return self


class PayloadDisturbance(Model):
    """A point mass fixed to the vehicle from ``start_s`` on, for ``duration_s`` or to the end."""

    kind: Literal["payload"]
    start_s: Seconds
    duration_s: Duration | None = None
    mass_kg: Positive
    offset_m: Vector


class WindDisturbance(Model):
    """Change of the steady wind (where the air moves to), NED."""

    kind: Literal["wind"]
    start_s: Seconds
    duration_s: Duration | None = None
    velocity_ned_m_s: Vector


class GustDisturbance(Model):
    """JSBSim's one-minus-cosine gust: rises over ``rise_s``, holds and falls."""

    kind: Literal["gust"]
    start_s: Seconds
    velocity_ned_m_s: Vector
    rise_s: Duration
    hold_s: Seconds
    fall_s: Duration

    @property
    def duration_s(self) -> float:
        """Duration of rise, hold and fall [s]."""
        return self.rise_s + self.hold_s + self.fall_s


DisturbanceEntry = Annotated[
    ForceDisturbance
    | MomentDisturbance
    | TorqueCommandDisturbance
    | PayloadDisturbance
    | WindDisturbance
    | GustDisturbance,
    Field(discriminator="kind"),
]
