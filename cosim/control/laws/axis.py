"""The base of the laws in this folder: a law for every axis that engines turn, tuned by dimensionless numbers.

An identified response ``G(z)`` is, at low frequency, an integrator with a delay: ``G = k e^(-s theta) / s``.  All
parameters are stated in ``k`` and ``theta``, so one set of them is a tuning for every vehicle whose engines answer late
in the same way; what they stand for is in each law.  Axes without an identified model (those that servos turn) keep the
PID of the vehicle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from typing import ClassVar, Protocol

from cosim.base.errors import InputError
from cosim.base.protocols import Parameter
from cosim.base.signals import AXES, Vector3
from cosim.control.belief import Belief
from cosim.control.predictors.smith import NoPredictor
from cosim.control.rate import RateAxis
from cosim.spec.vehicle import RateModel


class AxisLaw(Protocol):
    """Rate loop of one axis.  Optional ``predicted`` is the fed-back rate, for the log."""

    def reset(self) -> None:
        """Return to rest, with nothing applied."""

    def update(self, setpoint: float, measured: float, applied: float) -> float:
        """Return the command of a step from rates [rad/s] and the applied part of the previous command."""


@dataclass(frozen=True)
class Axis:
    """Axis of a rate law, with its identified model."""

    belief: Belief
    name: str
    model: RateModel

    @property
    def step(self) -> float:
        """Control step, s."""
        return self.model.sample_time_s

    @property
    def slow_pole(self) -> float:
        """The pole that integrates, nearest to 1."""
        return max(self.model.poles)

    @property
    def gain(self) -> float:
        """Gain ``k`` [rad/s^2 per command] of the integrating pole, with all faster dynamics at rest."""
        value: complex = self.model.gain / self.step
        for zero in self.model.all_zeros:
            value *= 1.0 - zero
        for pole in self._faster_poles:
            value /= 1.0 - pole
        return value.real

    @property
    def delay(self) -> float:
        """Delay ``theta`` [s] of the axis at low frequency, by :func:`low_frequency_delay`."""
        return low_frequency_delay(self.model)

    @property
    def _faster_poles(self) -> list[complex]:
        return _poles_but_slowest(self.model)


def low_frequency_delay(model: RateModel) -> float:
    """Return ``theta``, s: transport, half a step of hold, and ``1 / (1 - p)`` samples of every faster pole.

    Of zeros as much less: ``arg(z - p)`` on the unit circle grows with ``1 / (1 - p)`` at its beginning.

    >>> model = load_vehicle("hexjet")[0].identified["edf-as-flown"]["roll"]
    >>> print(f"{low_frequency_delay(model):.4f} s, {model.delay_samples * model.sample_time_s} s of it transport")
    0.1414 s, 0.1 s of it transport
    """
    samples: complex = model.delay_samples + 0.5
    for pole in _poles_but_slowest(model):
        samples += 1.0 / (1.0 - pole)
    for zero in model.all_zeros:
        samples -= 1.0 / (1.0 - zero)
    return samples.real * model.sample_time_s


def _poles_but_slowest(model: RateModel) -> list[complex]:
    poles = list(model.all_poles)
    poles.remove(max(model.poles))
    return poles


class Actuators:
    """Model of the actuators: ``A = (1 - p) z / (z - p) z^-1-n``, one lag and ``n`` steps of delay."""

    def __init__(self, samples: int, pole: float) -> None:
        self._pole, self.samples = pole, samples
        powers = [pole**j for j in range(samples + 1)]
        # Weights over the delay: of the lag's state, and of each command in transport, oldest first.
        self._of_lag = sum(powers[1:])
        self._weights = [sum((1.0 - pole) * power for power in powers[: samples - i]) for i in range(samples)]
        self.reset()

    @classmethod
    def from_axis(cls, axis: Axis) -> Actuators:
        """Return the actuators of an axis: a delay of whole steps, and one lag for all poles but the integrator's."""
        samples = max(1, round(axis.model.delay_samples))
        lag = max(axis.delay / axis.step - 0.5 - samples, 0.0)  # lag in steps
        return cls(samples, lag / (1.0 + lag))

    def reset(self) -> None:
        self._sent = [0.0] * (self.samples + 1)  # commands in transport, oldest first
        self.now = 0.0

    def update(self, applied: float) -> float:
        """Return the output over the step that ends now, given its command."""
        sent = self._sent
        del sent[0]
        sent.append(applied)
        self.now = self._pole * self.now + (1.0 - self._pole) * sent[0]
        return self.now

    @property
    def upcoming_sum(self) -> float:
        """Sum of the outputs over the coming steps of the delay."""
        total = self._of_lag * self.now
        for weight, command in zip(self._weights, self._sent[-self.samples :], strict=True):
            total += weight * command
        return total


def positive_parameter(name: str, value: float, meaning: str, minimum: float = 1e-3, maximum: float = 1e3) -> Parameter:
    """Return the declaration of a positive parameter without a unit."""
    return Parameter(name, value, "", meaning, minimum, maximum)


def attitude_gain_parameter(value: float) -> Parameter:
    """Return the declaration of the attitude loop's gain [1/s], which laws do not apply themselves."""
    return positive_parameter(
        "angle", value, "gain of the attitude loop [1/s] times theta: set-points are scaled to have it"
    )


class RateLaw:
    """A rate loop of :class:`AxisLaw`; see :class:`cosim.base.protocols.RateLoop`."""

    level = "rate"
    parameters: ClassVar[tuple[Parameter, ...]]

    def make_axis_law(self, axis: Axis, values: Mapping[str, float]) -> AxisLaw:
        """Return the law of one axis.  Raises InputError for an unsuitable model."""
        raise NotImplementedError

    def make_axis(self, axis: Axis, values: Mapping[str, float]) -> tuple[AxisLaw, float]:
        """Return the law of one axis and the attitude loop's gain, 1/s.  Raises like the law."""
        return self.make_axis_law(axis, values), values["angle"] / axis.delay

    def prepare(self, belief: Belief) -> None:
        """Make a law for each axis with a model.  Raises InputError if there is none."""
        if not belief.models:
            raise InputError(
                f"{type(self).__name__}: needs a model of how this engine turns {belief.vehicle.name}, and none is "
                "identified at this step; hexjet identify makes one"
            )
        control, values = belief.vehicle.control, belief.parameters
        self._laws: list[AxisLaw] = []
        self._scales: list[float] = []
        for index, name in enumerate(AXES):
            model = belief.models.get(name)
            if model is None:
                self._laws.append(Pid(RateAxis(getattr(control.rate, name), NoPredictor(), belief.step_s)))
                self._scales.append(1.0)
            else:
                axis = Axis(belief, name, model)
                law, attitude = self.make_axis(axis, values)
                self._laws.append(law)
                self._scales.append(attitude / control.attitude.gain_1_s[index])

    def reset(self) -> None:
        """Return to rest."""
        for law in self._laws:
            law.reset()

    def update(self, setpoint: Vector3, measured: Vector3, applied: Vector3) -> Vector3:
        """Return the commands of one step."""
        (roll, pitch, yaw), (x, y, z) = self._laws, self._scales
        return (
            roll.update(x * setpoint[0], measured[0], applied[0]),
            pitch.update(y * setpoint[1], measured[1], applied[1]),
            yaw.update(z * setpoint[2], measured[2], applied[2]),
        )

    @property
    def pid_axes(self) -> list[tuple[RateAxis, float]] | None:
        """The built-in PIDs of the law with their set-point scales; None for other laws."""
        axes = [law.axis for law in self._laws if isinstance(law, Pid)]
        return list(zip(axes, self._scales, strict=True)) if len(axes) == len(self._laws) else None

    @property
    def predicted(self) -> Vector3:
        """The rates that are fed back, rad/s."""
        x, y, z = (getattr(law, "predicted", nan) for law in self._laws)
        return (x, y, z)


class Pid:
    """The built-in PID with its predictor, as an :class:`AxisLaw`."""

    def __init__(self, axis: RateAxis) -> None:
        self.axis, self._command = axis, 0.0

    def reset(self) -> None:
        self.axis.reset()
        self._command = 0.0

    def update(self, setpoint: float, measured: float, applied: float) -> float:
        self._command = self.axis.update(setpoint, measured, self._command - applied)
        return self._command

    @property
    def predicted(self) -> float:
        return self.axis.predicted
