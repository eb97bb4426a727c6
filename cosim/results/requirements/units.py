"""The units that a requirement may be written in, and the unit that a signal's name says.

A table instead of a library of units: a log has a dozen units, and the names of its columns end with theirs.
"""

from __future__ import annotations

from functools import lru_cache
from math import pi

from cosim.base.errors import InputError

_RAD_PER_DEG = pi / 180.0  # rad per degree
UNITS: dict[str, tuple[str, float]] = {  # SI unit, and the factor to it
    "rad": ("rad", 1.0),
    "deg": ("rad", _RAD_PER_DEG),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", _RAD_PER_DEG),
    "rpm": ("rad/s", pi / 30.0),
    "rad/s^2": ("rad/s^2", 1.0),
    "deg/s^2": ("rad/s^2", _RAD_PER_DEG),
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "km": ("m", 1e3),
    "m/s": ("m/s", 1.0),
    "km/h": ("m/s", 1.0 / 3.6),
    "m/s^2": ("m/s^2", 1.0),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "min": ("s", 60.0),
    "1/s": ("1/s", 1.0),
    "N": ("N", 1.0),
    "kN": ("N", 1e3),
    "N m": ("N m", 1.0),
    "kg": ("kg", 1.0),
    "g": ("kg", 1e-3),
    "kg/s": ("kg/s", 1.0),
    "g/s": ("kg/s", 1e-3),
    "K": ("K", 1.0),
    "1": ("1", 1.0),
    "%": ("1", 1e-2),
}
# Unit by the ending of a name with _ for / and blanks; the longest ending counts.
_ENDINGS = {f"_{unit.replace('/', '_').replace(' ', '_').replace('^', '')}": unit for unit in UNITS if unit != "%"}
_ENDINGS |= {"_percent": "%"}
_LONGEST_FIRST = sorted(_ENDINGS, key=len, reverse=True)  # longest endings first
_SI_ENDINGS = {"_deg": "_rad", "_deg_s": "_rad_s", "_deg_s2": "_rad_s2", "_rpm": "_rad_s", "_g_s": "_kg_s"}


def unit_of(name: str) -> str:
    """Return the unit from the ending of a signal's name; 1 without one, as ``throttle_2``."""
    ending = _ending_of(name)
    return _ENDINGS[ending] if ending else "1"


def in_si(name: str) -> str:
    """Return the name that the log has for a signal: ``roll_rad`` for ``roll_deg``."""
    ending = _ending_of(name)
    return name.removesuffix(ending) + _SI_ENDINGS[ending] if ending in _SI_ENDINGS else name


def in_degrees(name: str) -> str:
    """Return the name that an angle or its rate has in degrees: ``roll_deg`` for ``roll_rad``; others unchanged."""
    ending = next((shown for shown, logged in _SI_ENDINGS.items() if "deg" in shown and _ending_of(name) == logged), "")
    return name.removesuffix(_SI_ENDINGS[ending]) + ending if ending else name


def factor_between(unit: str, other: str) -> float:
    """Return the number of ``other`` in one ``unit``.  Raises InputError for different quantities."""
    (si, factor), (other_si, other_factor) = UNITS[unit], UNITS[other]
    if si != other_si:
        raise InputError(f"{unit} is not a unit of what is in {other}")
    return 1.0 if unit == other else factor / other_factor


@lru_cache(1024)
def _ending_of(name: str) -> str:
    return next((ending for ending in _LONGEST_FIRST if name.endswith(ending) and ending != "_1"), "")
