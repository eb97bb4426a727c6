"""Rate loop: one PID per axis, each fed by its predictor."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.control.predictor import Predictor
from cosim.signals import Refused, Vector3
from cosim.vehicle import RateGains


class RateAxis:
    """PID on one axis.

    ``u = p (r - y) + i integral(r - y) - d y'``, with ``y`` from the predictor and ``y'`` through a first-order
    filter.  The integral stops where allocation refused a command of the error's sign, and is limited.
    """

    def __init__(self, gains: RateGains, predictor: Predictor, step: float) -> None:
        self._p = gains.p
        self._i = gains.i * step
        self._d = gains.d
        self._limit = gains.integral_limit
        self._share = step / (gains.d_filter_s + step)
        self._step = step
        self._predictor = predictor
        self.reset()

    def reset(self) -> None:
        """At rest: no integral, nothing commanded."""
        self._predictor.reset()
        self.predicted = 0.0
        self._integral = 0.0
        self._slope = 0.0
        self._command = 0.0
        self._started = False

    def update(self, setpoint: float, measured: float, refused: float) -> float:
        """The command of this step; ``refused`` is what allocation could not give of the one before."""
        rate = self._predictor.update(measured, self._command - refused)
        error = setpoint - rate
        if refused * error <= 0.0:
            integral = self._integral + self._i * error
            limit = self._limit
            self._integral = limit if integral > limit else (-limit if integral < -limit else integral)
        if self._started:
            self._slope += self._share * ((rate - self.predicted) / self._step - self._slope)
        self._started = True
        self.predicted = rate
        self._command = self._p * error + self._integral - self._d * self._slope
        return self._command

    def tell(self, added: float) -> None:
        """The predictor reads the command behind a place where ``added`` came to it."""
        self._command += added


class RateController:
    """Three axes: rate set-point and measured rate (rad/s, body) to torque commands."""

    def __init__(self, gains: Sequence[RateGains], predictors: Sequence[Predictor], step: float) -> None:
        self._roll, self._pitch, self._yaw = (
            RateAxis(gain, predictor, step) for gain, predictor in zip(gains, predictors, strict=True)
        )

    def reset(self) -> None:
        """All axes at rest."""
        for axis in (self._roll, self._pitch, self._yaw):
            axis.reset()

    def update(self, setpoint: Vector3, measured: Vector3, refused: Refused) -> Vector3:
        """Torque commands: roll in throttle, pitch and yaw in rad of tilt at hover thrust."""
        return (
            self._roll.update(setpoint[0], measured[0], refused.roll),
            self._pitch.update(setpoint[1], measured[1], refused.pitch),
            self._yaw.update(setpoint[2], measured[2], refused.yaw),
        )

    def tell(self, added: Vector3) -> None:
        """The predictors read the commands behind a place where ``added`` came to them."""
        for axis, value in zip((self._roll, self._pitch, self._yaw), added, strict=True):
            axis.tell(value)

    @property
    def predicted(self) -> Vector3:
        """The rates that the last update was fed with, rad/s."""
        return (self._roll.predicted, self._pitch.predicted, self._yaw.predicted)
