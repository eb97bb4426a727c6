"""What may be exchanged, each by anything of the right shape: the protocols between a flight and its blocks.

Every block is told values and answers with values.  Vectors are tuples of three floats, body forward-right-down or NED
as said; per jet is a tuple from jet 1 on; everything is SI, angles are rad; the records are those of
:mod:`cosim.base.signals`.  Step ``k`` acts over ``[t_k, t_k+1)``, ``t_k = k dt``.  A block may keep whatever it likes
from one call to the next, as long as ``reset`` brings it back to where a new one is; it reads no clock, no file and no
shared random generator, so that a flight is the same to the last bit when it is flown again.

A :class:`cosim.base.errors.FlightError` raised by a block ends the flight as ``failed``; nothing of that step is
logged.
"""

from cosim.base.protocols.blocks import (
    Allocator,
    Columns,
    Controller,
    Engines,
    Metric,
    Observer,
    Pilot,
    Sensors,
    Shows,
    columns_of,
)
from cosim.base.protocols.custom import AttitudeLoop, OwnSensors, Predictor, RateLoop, WholeController, Wind
from cosim.base.protocols.records import Applied, Column, Diagnostics, EngineState, Parameter, Report

__all__ = [
    "Allocator",
    "Applied",
    "AttitudeLoop",
    "Column",
    "Columns",
    "Controller",
    "Diagnostics",
    "EngineState",
    "Engines",
    "Metric",
    "Observer",
    "OwnSensors",
    "Parameter",
    "Pilot",
    "Predictor",
    "RateLoop",
    "Report",
    "Sensors",
    "Shows",
    "WholeController",
    "Wind",
    "columns_of",
]
