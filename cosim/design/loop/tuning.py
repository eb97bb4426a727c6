"""A controller with everything that can be chosen about it on one channel."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from cosim.base.errors import InputError, nearest
from cosim.control.predictors.linear import PairResponse, PredictorSpace
from cosim.control.predictors.registry import PREDICTORS, PredictorSpec
from cosim.design.loop.firmware import Firmware
from cosim.spec.vehicle import EngineLead, PredictorTuning, RateGains, RateModel


def candidates() -> tuple[str, ...]:
    """Return the names of the predictors that a design chooses from, the simplest first."""
    return tuple(name for name, spec in PREDICTORS.items() if spec.automatic)


def designable(name: str, where: str, others: Iterable[str] = ()) -> PredictorSpec:
    """Return the predictor of a name that a design can use; ``others`` are further names that an error line offers.

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
    """A controller on one channel with all parameters that a design chooses."""

    controller: str
    angle_gain: float  # 1/s
    gains: RateGains
    predictor: PredictorTuning
    model: RateModel  # what the predictor believes
    lead: EngineLead | None = None
    firmware: Firmware | None = None  # whose loop has these gains; None: ours

    def answer(self) -> PairResponse:
        """Return the responses ``P_y`` and ``P_u`` of the predictor.  Raises InputError for one that states none."""
        spec = designable(self.controller, f"controller {self.controller!r}")
        assert spec.response is not None
        return spec.response(self.model, spec.own(self.predictor))

    def space(self) -> PredictorSpace | None:
        """Return the predictor in state space; None for one that states its frequency response alone."""
        spec = designable(self.controller, f"controller {self.controller!r}")
        return None if spec.space is None else spec.space(self.model, spec.own(self.predictor))


def round_gain(value: float) -> float:
    """Round to six significant digits, which is as exact as a gain is meant."""
    return float(f"{value:.6g}")
