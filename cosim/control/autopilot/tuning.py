"""Parameters that act while it flies: a change of a gain goes through ``retune``, without a bump in the command."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import radians
from typing import NamedTuple

from cosim.base.protocols import Predictor
from cosim.base.signals import AXES
from cosim.control.altitude import AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.autopilot.guidance.position_control import PositionController
from cosim.control.autopilot.guidance.tracker import Tracker
from cosim.control.autopilot.parameters import Parameters
from cosim.control.predictors.registry import PREDICTORS
from cosim.control.rate import RateController
from cosim.spec.vehicle import AltitudeGains, AttitudeGains, Control, PredictorTuning, RateGains

PredictorMaker = Callable[[str, float, PredictorTuning], list[Predictor]]


class Blocks(NamedTuple):
    """Control blocks whose gains parameters change in flight.

    ``predictors`` makes the three axes' predictors for a controller's name, the delay of the roll model in samples
    and a tuning; it raises InputError where the vehicle has no model for them.
    """

    attitude: AttitudeController
    altitude: AltitudeController
    rate: RateController
    position: PositionController
    tracker: Tracker
    predictors: PredictorMaker


class ControlLoops(NamedTuple):
    """Control loops commanded by the autopilot, and the data to make their predictors.

    ``controller`` and ``delay`` (samples of the roll model; None without one) are what the rate loops fly with at the
    start; ``predictors`` makes others.  ``level``: of a controller from outside in the place of some of the loops.
    """

    attitude: AttitudeController
    altitude: AltitudeController
    rate: RateController
    predictors: PredictorMaker
    controller: str
    delay: float | None
    level: str = ""


class LiveTuning:
    """Applies changed parameters to the control blocks in flight."""

    def __init__(self, parameters: Parameters, control: Control, blocks: Blocks, step: float) -> None:
        self._parameters = parameters
        self._control = control
        self._blocks = blocks
        self._step = step
        # A predictor selected in flight starts from this history: 4 s at 250 Hz, 40 delays of a jet.
        blocks.rate.keep_history(1000)

    def set(self, name: str, value: float) -> None:
        """Store a parameter, effective from the next step.  Raises InputError if it is not allowed."""
        parameters = self._parameters
        value = parameters.check(name, value)
        if value == parameters[name]:
            return
        new = dict(parameters.values) | {name: value}
        if name.startswith("HJ_PRED_"):
            self._set_predictors(new)
        elif name in _RATE_NAMES:
            self._blocks.rate.retune(rate_gains(self._control, new))
        elif name.startswith("HJ_ATT_") or name.startswith("HJ_RLIM_"):
            self._blocks.attitude.retune(_attitude_gains(self._control, new), self._step)
        elif name in ("HJ_ALT_P", "HJ_CLIMB_P", "HJ_CLIMB_I", "HJ_SPEED_UP", "HJ_SPEED_DN"):
            self._blocks.altitude.retune(_altitude_gains(self._control, new))
        elif name in ("HJ_POS_P", "HJ_VEL_P", "HJ_LEAN_MAX"):
            lean = radians(new["HJ_LEAN_MAX"])
            self._blocks.position.retune(new["HJ_POS_P"], new["HJ_VEL_P"], lean)
        elif name in ("HJ_ACC_HOR", "HJ_JERK_HOR"):
            self._blocks.tracker.limit(new["HJ_ACC_HOR"], new["HJ_JERK_HOR"])
        parameters.set(name, value)

    def _set_predictors(self, values: Mapping[str, float]) -> None:
        name = controller_of(values)
        assert name is not None  # the table has no other values
        tuning = _predictor_tuning(self._control, values)
        predictors = self._blocks.predictors(name, values["HJ_PRED_DELAY"], tuning)
        self._blocks.rate.retune(rate_gains(self._control, values), predictors)


_RATE_NAMES = frozenset(f"HJ_{axis.upper()}_{term}" for axis in AXES for term in "PID")  # gains of the rate loops


def rate_gains(control: Control, values: Mapping[str, float]) -> list[RateGains]:
    """Return the gains of the three rate laws with P, I and D of ``values``."""
    return [
        law.model_copy(update={term: values[f"HJ_{axis.upper()}_{term.upper()}"] for term in "pid"})
        for axis, law in zip(AXES, (control.rate.roll, control.rate.pitch, control.rate.yaw), strict=True)
    ]


def controller_of(values: Mapping[str, float]) -> str | None:
    """Return the name of the predictor that HJ_PRED_TYPE selects; None for a custom one."""
    return next((spec.name for spec in PREDICTORS.values() if spec.value == values["HJ_PRED_TYPE"]), None)


def control_of(control: Control, values: Mapping[str, float]) -> Control:
    """Return a vehicle's control table with the gains of ``values``: rate, attitude, height, predictor."""
    roll, pitch, yaw = rate_gains(control, values)
    return control.model_copy(
        update={
            "rate": control.rate.model_copy(update={"roll": roll, "pitch": pitch, "yaw": yaw}),
            "attitude": _attitude_gains(control, values),
            "altitude": _altitude_gains(control, values),
            "predictor": _predictor_tuning(control, values),
        }
    )


def _predictor_tuning(control: Control, values: Mapping[str, float]) -> PredictorTuning:
    tuning = control.predictor
    for spec in PREDICTORS.values():
        live = {own.name: values[own.mavlink] for own in spec.parameters if own.mavlink}
        tuning = spec.tuned(tuning, live)
    return tuning


def _attitude_gains(control: Control, values: Mapping[str, float]) -> AttitudeGains:
    gain = [values[f"HJ_ATT_{axis.upper()}"] for axis in AXES]
    limit = [radians(values[f"HJ_RLIM_{axis.upper()}"]) for axis in AXES]
    return control.attitude.model_copy(update={"gain_1_s": tuple(gain), "rate_limit_rad_s": tuple(limit)})


def _altitude_gains(control: Control, values: Mapping[str, float]) -> AltitudeGains:
    return control.altitude.model_copy(
        update={
            "position_1_s": values["HJ_ALT_P"],
            "velocity_1_s": values["HJ_CLIMB_P"],
            "integral_1_s2": values["HJ_CLIMB_I"],
            "climb_limit_m_s": values["HJ_SPEED_UP"],
            "descent_limit_m_s": values["HJ_SPEED_DN"],
        }
    )
