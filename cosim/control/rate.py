"""Rate loop: one PID per axis, each fed by its predictor."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import nan
from typing import NamedTuple

from cosim.base.limits import clamp
from cosim.base.protocols import Diagnostics, Predictor
from cosim.base.signals import Unallocated, Vector3
from cosim.control.bumpless import Fade
from cosim.control.lead import Lead
from cosim.control.predictors.smith import NoPredictor, SmithPredictor
from cosim.spec.vehicle import EngineLead, RateGains

_NO_DIAGNOSTICS: Diagnostics = (nan, nan, nan)  # diagnostics of no predictor


class _OldLaw(NamedTuple):
    """Gains (per step) and predictor in use before a change in flight."""

    p: float
    i: float
    d: float
    limit: float
    filter_gain: float
    predictor: Predictor

    def next_integral(self, integral: float, error: float, stop: bool) -> float:
        """Return the limited integral after one more error; the present one if ``stop``."""
        return integral if stop else max(-self.limit, min(self.limit, integral + self.i * error))


class RateAxis:
    """PID of one axis, with predictor and lead.

    ``u = p (r - y) + i integral(r - y) - d y'``, with ``y`` from the predictor and ``y'`` through a first-order
    filter.  The integral stops where allocation has left a residual of the error's sign, and is limited.  With a lead
    the command is the lead's output for ``u``, and the predictor reads that.  ``gains``: the nominal ones.
    """

    def __init__(self, gains: RateGains, predictor: Predictor, step: float, lead: Lead | None = None) -> None:
        self.gains = gains
        self._factors = (1.0, 1.0, 1.0)
        self._p = gains.p
        self._i = gains.i * step
        self._d = gains.d
        self._limit = gains.integral_limit
        self._filter_gain = step / (gains.d_filter_s + step)
        self._step = step
        self._set_predictor(predictor)
        self._lead = lead
        self._history: deque[tuple[float, float]] | None = None
        self.reset()

    def reset(self) -> None:
        """Return to rest: no integral, nothing commanded."""
        self._predictor.reset()
        self.predicted = 0.0
        self._integral = 0.0
        self._slope = 0.0
        self._command = 0.0
        self._started = False
        self._fade: Fade | None = None
        self._old_law: _OldLaw | None = None
        if self._lead is not None:
            self._lead.settle(0.0)
        if self._history is not None:
            self._history.clear()

    def update(self, setpoint: float, measured: float, unallocated: float) -> float:
        """Return the command; ``unallocated``: part of the previous one that allocation could not deliver."""
        if self._history is not None:
            self._history.append((measured, self._command - unallocated))
        if self._old_law is not None:
            return self._update_at_change(self._old_law, setpoint, measured, unallocated)
        rate = self._predictor.update(measured, self._command - unallocated) if self._predicts else measured
        error = setpoint - rate
        if unallocated * error <= 0.0:
            integral = self._integral + self._i * error
            limit = self._limit
            self._integral = clamp(integral, limit)
        if self._started:
            self._slope += self._filter_gain * ((rate - self.predicted) / self._step - self._slope)
        self._started = True
        self.predicted = rate
        self._command = self._p * error + self._integral - self._d * self._slope
        if self._fade is not None:
            self._command += self._fade.update()
        if self._lead is not None:
            self._command = self._lead.update(self._command, unallocated)
        return self._command

    def scale_gains(self, p: float, i: float, d: float, lead: EngineLead | None) -> None:
        """Scale the nominal gains from the next update on, and set the lead: see :mod:`cosim.control.schedule`.

        The integral is kept in the command's unit and the lead keeps its past, so small changes make no bump.
        """
        self._factors = (p, i, d)
        gains = self.gains
        self._p, self._i, self._d = p * gains.p, i * (gains.i * self._step), d * gains.d
        if lead is not None and self._lead is not None:
            self._lead.set_poles(lead)

    def keep_history(self, samples: int) -> None:
        """Store this many past steps, to initialise a predictor that is selected in flight."""
        self._history = deque(maxlen=samples)

    def retune(self, gains: RateGains, predictor: Predictor | None = None) -> None:
        """Change gains, and the predictor unless None, at the next update without a jump.

        The next command is still the old law's; the difference to the new law's fades from then on.
        """
        if self._old_law is None:
            self._old_law = _OldLaw(self._p, self._i, self._d, self._limit, self._filter_gain, self._predictor)
        step = self._step
        p, i, d = self._factors
        self.gains = gains
        self._p, self._i, self._d = p * gains.p, i * (gains.i * step), d * gains.d
        self._limit = gains.integral_limit
        self._filter_gain = step / (gains.d_filter_s + step)
        if predictor is not None:
            predictor.reset()
            for measured, applied in self._history or ():
                predictor.update(measured, applied)
            self._set_predictor(predictor)

    @property
    def predictor(self) -> Predictor:
        """The predictor from the next update on."""
        return self._predictor

    def _set_predictor(self, predictor: Predictor) -> None:
        self._predictor: SmithPredictor | Predictor = predictor
        self._predicts = not isinstance(predictor, NoPredictor)  # else the measurement is fed back

    def _update_at_change(self, old: _OldLaw, setpoint: float, measured: float, unallocated: float) -> float:
        """Return the command in the step of a gain change: that of the old gains, from which the difference fades."""
        self._old_law = None
        applied = self._command - unallocated
        # The new predictor was initialised with the commands before this step.
        old_rate = old.predictor.update(measured, applied)
        is_swapped = self._predictor is not old.predictor
        rate = self._predictor.update(measured, applied) if is_swapped else old_rate
        stop = unallocated * (setpoint - old_rate) > 0.0
        integral = old.next_integral(self._integral, setpoint - old_rate, stop)
        slope = self._slope
        if self._started:
            slope += old.filter_gain * ((old_rate - self.predicted) / self._step - slope)
        command = old.p * (setpoint - old_rate) + integral - old.d * slope
        if self._fade is not None:
            command += self._fade.update()
        # Changing the predictor makes the predicted rate jump, and that jump must not enter the derivative.
        self._slope = slope
        self._integral = max(-self._limit, min(self._limit, integral))
        self.predicted = rate
        self._started = True
        self._fade = Fade(self._step)
        self._fade.begin(command - (self._p * (setpoint - rate) + self._integral - self._d * slope))
        self._command = command if self._lead is None else self._lead.update(command, unallocated)
        return self._command

    def add_to_command(self, added: float) -> None:
        """Add an injected signal to the command that the predictor receives."""
        self._command += added

    @property
    def diagnostics(self) -> Diagnostics:
        """Diagnostics of the predictor; NaN if it has none."""
        diagnostics: Diagnostics = getattr(self._predictor, "diagnostics", _NO_DIAGNOSTICS)
        return diagnostics


class RateController:
    """Rate controller of three axes: torque commands from rate set-point and measured rate [rad/s, body]."""

    def __init__(
        self,
        gains: Sequence[RateGains],
        predictors: Sequence[Predictor],
        step: float,
        leads: Sequence[Lead | None] = (None, None, None),
    ) -> None:
        self._roll, self._pitch, self._yaw = (
            RateAxis(gain, predictor, step, lead)
            for gain, predictor, lead in zip(gains, predictors, leads, strict=True)
        )

    def reset(self) -> None:
        for axis in (self._roll, self._pitch, self._yaw):
            axis.reset()

    def update(self, setpoint: Vector3, measured: Vector3, unallocated: Unallocated) -> Vector3:
        """Return the torque commands: roll in throttle, pitch and yaw in rad of tilt at hover thrust."""
        return (
            self._roll.update(setpoint[0], measured[0], unallocated.roll),
            self._pitch.update(setpoint[1], measured[1], unallocated.pitch),
            self._yaw.update(setpoint[2], measured[2], unallocated.yaw),
        )

    def scale_roll_gains(self, p: float, i: float, d: float, lead: EngineLead | None) -> None:
        """Scale the gains of roll; see :meth:`RateAxis.scale_gains`."""
        self._roll.scale_gains(p, i, d, lead)

    def keep_history(self, samples: int) -> None:
        """Store the past steps of all axes; see :meth:`RateAxis.keep_history`."""
        for axis in (self._roll, self._pitch, self._yaw):
            axis.keep_history(samples)

    def retune(self, gains: Sequence[RateGains], predictors: Sequence[Predictor] | None = None) -> None:
        """Change the gains on all axes; see :meth:`RateAxis.retune`."""
        replacements = predictors or (None, None, None)
        for axis, gain, predictor in zip((self._roll, self._pitch, self._yaw), gains, replacements, strict=True):
            axis.retune(gain, predictor)

    def add_to_command(self, added: Vector3) -> None:
        """Add injected signals to the commands that the predictors receive."""
        for axis, value in zip((self._roll, self._pitch, self._yaw), added, strict=True):
            axis.add_to_command(value)

    @property
    def diagnostics(self) -> tuple[Diagnostics, Diagnostics, Diagnostics]:
        """The :attr:`RateAxis.diagnostics` of all axes."""
        return (self._roll.diagnostics, self._pitch.diagnostics, self._yaw.diagnostics)

    @property
    def predictors(self) -> tuple[Predictor, Predictor, Predictor]:
        """The predictors of roll, pitch and yaw."""
        return (self._roll.predictor, self._pitch.predictor, self._yaw.predictor)

    @property
    def predicted(self) -> Vector3:
        """The measured or predicted rates [rad/s] of the last update."""
        return (self._roll.predicted, self._pitch.predicted, self._yaw.predicted)
