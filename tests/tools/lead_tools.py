"""An axis behind a slow engine, with a lead and without."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cosim.control.lead import Lead
from cosim.control.predictors.smith import NoPredictor
from cosim.control.rate import RateAxis
from cosim.spec.vehicle import EngineLead, RateGains

STEP = 0.004


def answered(lead: EngineLead, wanted: NDArray[np.float64]) -> NDArray[np.float64]:
    block = Lead(lead, STEP)
    return np.array([block.update(float(v), 0.0) for v in wanted])


def axis(lead: Lead | None, **gains: float) -> RateAxis:
    table = {"p": 0.0, "i": 0.0, "d": 0.0, "d_filter_s": 0.02, "integral_limit": 10.0, **gains}
    return RateAxis(RateGains(**table), NoPredictor(), STEP, lead)
