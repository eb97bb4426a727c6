"""Requirements: formulas over the signals of a flight, each with a margin, positive kept and negative broken.

A scenario's and a study's ``[[require]]`` state them; limits, ``[[expect]]`` and ``[success]`` are such too.
"""

from cosim.results.requirements.grammar import parse_formula
from cosim.results.requirements.requirement import (
    LOST,
    UNKNOWN,
    Assessment,
    FailedFlight,
    Requirement,
    RequirementResult,
    flight_requirements,
    limit_requirements,
    range_requirements,
    smallest_margin,
)
from cosim.results.requirements.signals import FlightSignals

__all__ = [
    "LOST",
    "UNKNOWN",
    "Assessment",
    "FailedFlight",
    "FlightSignals",
    "Requirement",
    "RequirementResult",
    "flight_requirements",
    "limit_requirements",
    "parse_formula",
    "range_requirements",
    "smallest_margin",
]
