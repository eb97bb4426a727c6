"""Identification: a frequency sweep in, the fitted model with its confidence bounds out.

``response`` turns a record into a frequency response with coherence, ``fit`` that into a model, ``engine`` and
``axis`` sweep one FMU or the flying vehicle, ``result`` says and stores what came out.
"""

from cosim.design.identify.axis import identify_axis
from cosim.design.identify.engine import identify_engine
from cosim.design.identify.fit import Fit, Model, fit
from cosim.design.identify.page import write
from cosim.design.identify.response import FrequencyResponse, Record, estimate
from cosim.design.identify.result import Identification, Sweep

__all__ = [
    "Fit",
    "FrequencyResponse",
    "Identification",
    "Model",
    "Record",
    "Sweep",
    "estimate",
    "fit",
    "identify_axis",
    "identify_engine",
    "write",
]
