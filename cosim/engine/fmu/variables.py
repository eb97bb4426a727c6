"""Variables that an FMU declares, and an engine's ports on them."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import floor, inf

from cosim.engine.fmu.units import Unit

REALS = ("Real", "Float64", "Float32")  # FMI types that are floats
INTEGERS = ("Integer", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")  # integer types
THROTTLE_TYPES = (*REALS, *INTEGERS)  # types allowed for a throttle
SWITCH_TYPES = (*REALS, "Boolean", *INTEGERS)  # types allowed for on and off
# Value of an input or a parameter: a number, a Boolean, or the name of an enumeration's item.
ConstantValue = bool | int | float | str


@dataclass(frozen=True)
class Variable:
    """Scalar variable or array element of an FMU; ``start`` is None if not stated."""

    name: str
    type: str  # type name in FMI
    reference: int
    unit: str | None
    min: float | None
    max: float | None
    start: float | None
    description: str
    causality: str = ""
    variability: str = ""
    base: Unit | None = None  # SI exponents and factor of the unit
    items: tuple[tuple[str, int], ...] = ()  # items of an enumeration
    index: int = 0  # index in an array, in FMI's order
    starts: tuple[float, ...] = (0.0,)  # start values of the array; 0 if absent

    @property
    def is_array(self) -> bool:
        """Whether the variable is an element of an array, so that setting it sets other elements too."""
        return len(self.starts) > 1


@dataclass(frozen=True)
class Port:
    """Port of an engine: an FMU's variable in co-simulation units, ``canonical = scale * value + offset``.

    The other way round it is ``value = gain * canonical + bias``, limited to ``low .. high``: both ways are kept, so
    that the ends of a range are met exactly.
    """

    variable: Variable
    scale: float = 1.0
    offset: float = 0.0
    gain: float = 1.0
    bias: float = 0.0
    low: float = field(default=-inf, repr=False)
    high: float = field(default=inf, repr=False)

    def value(self, canonical: float) -> float:
        """Return the FMU's value for one in co-simulation units, computed as the C loop does."""
        value = self.gain * canonical
        if self.bias != 0.0:
            value += self.bias
        value = min(max(value, self.low), self.high)
        return float(floor(value + 0.5)) if self.variable.type in INTEGERS else value
