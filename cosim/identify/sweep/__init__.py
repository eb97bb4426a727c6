"""Identification: a frequency sweep in, the fitted model with its confidence bounds out.

``response`` turns a record into a frequency response with coherence, ``fit`` that into a model, ``engine`` and
``axis`` sweep one FMU or the flying vehicle, ``result`` says and stores what came out.
"""

from cosim.identify.sweep.axis import identify_axis
from cosim.identify.sweep.engine import fly_sweep, identify_engine
from cosim.identify.sweep.fit import Fit, Model, fit, point_weights, separate_equal
from cosim.identify.sweep.page import write
from cosim.identify.sweep.response import FrequencyResponse, Record, estimate
from cosim.identify.sweep.result import Identification, Sweep, suitable_duration
