"""A controller with everything that can be chosen about it on one channel."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from cosim.base.errors import InputError, nearest
from cosim.control.predictors.linear import LinearSpace, PairResponse, PredictorSpace, linear_response
from cosim.control.predictors.registry import PREDICTORS, PredictorSpec
from cosim.control.predictors.state import LinearPredictor
from cosim.laws import low_frequency_delay
from cosim.simulation.controllers.controller_file import LAW
from cosim.spec.vehicle import EngineLead, PredictorTuning, RateGains, RateModel
from hexjet_design.loop.firmware import Firmware
from hexjet_design.loop.optimal import PredictorBases, Target, make_predictor


def candidates() -> tuple[str, ...]:
    """Return the names of the predictors that a design chooses from, the simplest first."""
    return tuple(name for name, spec in PREDICTORS.items() if spec.automatic)


def designable(name: str, where: str, others: Iterable[str] = ()) -> PredictorSpec:
    """Return a predictor that a design can use, by name; ``others`` are further names for the error.

    Raises InputError for an unknown one, and for one that states no frequency response.
    """
    allowed = [*others, *(name_of for name_of, spec in PREDICTORS.items() if spec.response)]
    if name in PREDICTORS and name not in allowed:
        raise InputError(f"{where}: states no frequency response, which a design needs; {nearest(name, allowed)}")
    if name not in allowed:
        raise InputError(f"{where}: {nearest(name, allowed)}")
    return PREDICTORS[name]


@dataclass(frozen=True)
class Tuning:
    """A controller on one channel with all designed parameters."""

    controller: str
    angle_gain: float  # attitude gain, 1/s
    gains: RateGains
    predictor: PredictorTuning
    model: RateModel  # model that the predictor runs
    lead: EngineLead | None = None
    firmware: Firmware | None = None  # autopilot with the gains; None: ours
    law: Mapping[str, float] | None = None  # parameters of the law at the limit
    matrices: LinearPredictor | None = field(default=None, repr=False, compare=False)  # matrices of the law's predictor

    @classmethod
    def of_law(
        cls, values: Mapping[str, float], model: RateModel, fixed: Tuning, bases: PredictorBases | None = None
    ) -> Tuning:
        """Return the law at the limit with these parameters; ``fixed`` supplies the rest.

        ``bases`` are those of the poles, where they are known.  Raises InputError where the parameters ask for more
        than the model can be.
        """
        predictor, gain, attitude = make_predictor(model, Target.of(values, low_frequency_delay(model)), bases)
        gains = fixed.gains.model_copy(update={"p": gain, "i": 0.0, "d": 0.0})
        return cls(LAW, attitude, gains, fixed.predictor, model, law=values, matrices=predictor)

    @property
    def needs_model(self) -> bool:
        """Whether the controller flies with a model of the engine."""
        return self.law is not None or PREDICTORS[self.controller].needs_model

    def answer(self) -> PairResponse:
        """Return the responses ``P_y`` and ``P_u`` of the predictor.  Raises InputError if it states none."""
        if self.matrices is not None:
            return linear_response(self.matrices)
        spec = designable(self.controller, f"controller {self.controller!r}")
        assert spec.response is not None
        return spec.response(self.model, spec.own(self.predictor))

    def space(self) -> PredictorSpace | None:
        """Return the predictor in state space; None for one that states its frequency response alone."""
        if self.matrices is not None:
            return LinearSpace(self.matrices)
        spec = designable(self.controller, f"controller {self.controller!r}")
        return None if spec.space is None else spec.space(self.model, spec.own(self.predictor))

    @property
    def has_space(self) -> bool:
        """Whether the predictor has a state space."""
        return self.law is not None or PREDICTORS[self.controller].space is not None


def round_gain(value: float) -> float:
    """Round to six significant digits, more than a gain needs."""
    return float(f"{value:.6g}")
