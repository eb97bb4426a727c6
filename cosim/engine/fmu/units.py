"""Units of an FMU's variables: from what its description declares, or from a unit's name, to SI.

A table instead of a library of units: the description itself states almost every unit in SI base units, what remains is
a few dozen names, and a library knows none of the quirks below (a revolution without ``rad``).
"""

from __future__ import annotations

from math import isclose, pi
from typing import NamedTuple

from cosim.base.constants import GRAVITY
from cosim.engine.library import BASE_UNITS, UNITS

Exponents = tuple[int, ...]  # one exponent for each of BASE_UNITS


class Unit(NamedTuple):
    """Unit by ``SI value = factor * value + offset``, with the exponents of the SI base units."""

    exponents: Exponents
    factor: float = 1.0
    offset: float = 0.0


class Quantity(NamedTuple):
    """Quantity that a port measures, with the names of its units."""

    name: str
    si: str
    units: dict[str, tuple[float, float]]  # name: factor and offset to SI

    @property
    def exponents(self) -> Exponents:
        """Exponents of the SI base units in the SI unit of the quantity."""
        return exponents(self.si)


def exponents(unit: str) -> Exponents:
    """Return the exponents of the SI base units for a unit of :data:`UNITS`."""
    return tuple(int(UNITS[unit].get(base, 0)) for base in BASE_UNITS)


class UnitError(ValueError):
    """Error for an unsuitable unit: a clause that follows the variable's name."""


# Weight [N] of an international pound under standard gravity, exact.
POUND_FORCE = 0.45359237 * GRAVITY
FOOT, POUND = 0.3048, 0.45359237  # m in a foot, kg in a pound, both exact


def _units(*rows: tuple[str, float], offset: float = 0.0) -> dict[str, tuple[float, float]]:
    """Return factor and offset by unit name, from rows of names separated by blanks with their factor."""
    return {name: (factor, offset) for names, factor in rows for name in names.split()}


_PSI, _RPM = POUND_FORCE / 0.0254**2, UNITS["rpm"]["factor"]  # Pa, and rad/s per rpm
FORCE = Quantity("a force", "N", _units(
    ("N newton", 1.0), ("mN", 1e-3), ("daN", 10.0), ("kN", 1e3), ("MN", 1e6), ("lbf lb_f lbs", POUND_FORCE),
    ("klbf", 1e3 * POUND_FORCE), ("kgf kp", GRAVITY), ("gf", GRAVITY * 1e-3),
))  # fmt: skip
PRESSURE = Quantity("a pressure", "Pa", _units(
    ("Pa pascal", 1.0), ("hPa", 1e2), ("kPa", 1e3), ("MPa", 1e6), ("mbar", 1e2), ("bar", 1e5), ("atm", 101325.0),
    ("psi psia", _PSI), ("inHg", 3386.389), ("mmHg", 133.322387415), ("Torr", 101325.0 / 760.0),  # inHg: at 0 degC
    ("lbf/in2", _PSI), ("N/m2", 1.0),
))  # fmt: skip
TEMPERATURE = Quantity("a temperature", "K", {
    **_units(("K kelvin degK", 1.0), ("degR R Rankine", 5.0 / 9.0)),
    **_units(("degC deg_C \u00b0C \u2103 C celsius", 1.0), offset=273.15),
    **_units(("degF deg_F \u00b0F F fahrenheit", 5.0 / 9.0), offset=273.15 - 32.0 * 5.0 / 9.0),
})  # fmt: skip
SPEED = Quantity("a speed", "m/s", _units(
    ("m/s m.s-1 mps", 1.0), ("km/h kph kmh", 1.0 / 3.6), ("kn kt kts knot knots", 1852.0 / 3600.0), ("ft/s fps", FOOT),
    ("ft/min", FOOT / 60.0), ("mph mi/h", 5280.0 * FOOT / 3600.0),
))  # fmt: skip
ANGULAR_SPEED = Quantity("a speed of rotation", "rad/s", _units(
    ("rad/s rad.s-1 rad/sec", 1.0), ("rpm rev/min r/min 1/min min-1 U/min r.min-1", _RPM), ("krpm", 1e3 * _RPM),
    ("rps rev/s r/s Hz", 2.0 * pi), ("deg/s", pi / 180.0),
))  # fmt: skip
MASS_FLOW = Quantity("a mass flow", "kg/s", _units(
    ("kg/s kg.s-1", 1.0), ("kg/min", 1.0 / 60.0), ("kg/h kg/hr", 1.0 / 3600.0), ("g/s", 1e-3), ("g/min", 1e-3 / 60.0),
    ("g/h g/hr", 1e-3 / 3600.0), ("lb/s lbm/s pps", POUND), ("lb/min", POUND / 60.0),
    ("lb/h lb/hr lbm/h lbm/hr pph", POUND / 3600.0),
))  # fmt: skip
RATIO = Quantity("a ratio", "1", {
    **_units(("1 -", 1.0)), "": (1.0, 0.0), **_units(("ratio", 1.0), ("% percent pct perc", 0.01)),
})  # fmt: skip
LENGTH = Quantity("a length", "m", _units(("m metre meter", 1.0), ("km", 1e3), ("ft feet", FOOT), ("kft", 1e3 * FOOT)))
DENSITY = Quantity("a density", "kg/m3", _units(
    ("kg/m3 kg/m^3 kg.m-3 g/l", 1.0), ("g/cm3", 1e3), ("lb/ft3 lbm/ft3", POUND / FOOT**3),
    ("slug/ft3", POUND_FORCE / FOOT**4),  # a slug is lbf s^2 / ft
))  # fmt: skip
MOMENT = Quantity("a moment", "N.m", _units(
    ("N.m Nm N*m N-m", 1.0), ("kN.m kNm", 1e3), ("mN.m mNm", 1e-3),
    ("lbf.ft lbf*ft ft.lbf ft-lbf lb-ft", POUND_FORCE * FOOT), ("lbf.in in.lbf in-lbf", POUND_FORCE * 0.0254),
))  # fmt: skip
QUANTITIES = (FORCE, PRESSURE, TEMPERATURE, SPEED, ANGULAR_SPEED, MASS_FLOW, RATIO, LENGTH, DENSITY, MOMENT)

_PER_SECOND = exponents("1/s")  # exponents of rad/s, and of rpm too


def find_unit(name: str, quantity: Quantity) -> tuple[float, float] | None:
    """Return factor and offset of a unit by name; case matters only where it distinguishes units."""
    if name in quantity.units:
        return quantity.units[name]
    close = {size for known, size in quantity.units.items() if known.lower() == name.strip().lower()}
    return close.pop() if len(close) == 1 else None


def is_unit_of(name: str | None, base: Unit | None, quantity: Quantity) -> bool:
    if name is None:
        return False
    if base is None:
        return find_unit(name, quantity) is not None
    turns = quantity is ANGULAR_SPEED and base.exponents == _PER_SECOND and find_unit(name, quantity) is not None
    return turns or base.exponents == quantity.exponents


def to_si(name: str, base: Unit | None, quantity: Quantity) -> tuple[float, float]:
    """Return factor and offset from a declared unit to SI.

    A declared revolution (``1/s`` without ``rad``) goes by its name.  Raises UnitError if the unit is not one of this
    quantity, is not known, or is declared as another than its name says: then one of the two is wrong.
    """
    known = find_unit(name, quantity)
    if base is None:
        if known is None:
            raise UnitError(f"is in {name}, which the FMU does not define; known: {', '.join(quantity.units)}")
        return known
    if quantity is ANGULAR_SPEED and base.exponents == _PER_SECOND and known is not None:
        return known
    if base.exponents != quantity.exponents and known is not None:
        raise UnitError(f"is in {name}, which the FMU defines as something else than {quantity.name}")
    if base.exponents != quantity.exponents:
        raise UnitError(f"is in {name}; it must be {quantity.name}, such as {quantity.si}")
    # Rounded conversion factors differ by less than these tolerances, those of wrong units by more.
    if known and not (
        isclose(base.factor, known[0], rel_tol=1e-3) and isclose(base.offset, known[1], rel_tol=1e-3, abs_tol=0.1)
    ):
        raise UnitError(
            f"is in {name}, which the FMU defines as {_show_unit(base.factor, base.offset, quantity.si)} and which is "
            f"{_show_unit(*known, quantity.si)}"
        )
    return base.factor, base.offset


def _show_unit(factor: float, offset: float, si: str) -> str:
    return f"{factor:g} {si}" + (f" above {offset:g} {si}" if offset else "")
