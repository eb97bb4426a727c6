"""One value of a flight that can be varied: its unit, its bounds, and a value as it takes it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import inf, isfinite
from typing import Literal

from pydantic import BaseModel

from cosim.base.errors import InputError
from cosim.spec.meanings import meaning_of
from cosim.spec.vehicle import is_aircraft_path, is_file

Value = float | int | str | bool
Kind = Literal["float", "int", "bool", "choice"]

# Units that names of keys end with, as ``m_s2`` for m/s^2; the longest ending first.
UNITS = (
    "kg m^2", "N m s", "N s/m", "m/s^2.5", "m/s^1.5", "rad/s", "deg/s", "m/s^3", "m/s^2", "1/s^2", "kg/s", "m/s", "1/s",
    "N m", "samples", "rad", "deg", "kg", "Hz", "dB", "m^2", "m", "N", "s",
)  # fmt: skip
UNIT_BY_ENDING = {"per_unit": "", "percent": "%"} | {  # unit by the ending of a name
    re.sub(r"[ /]", "_", unit).replace("^", "").replace(".", "").lower(): unit for unit in UNITS
}
UNIT_EXCEPTIONS = {"spring_n_m": "N/m", "reaction_m": "m"}  # endings not to be read by the table


@dataclass(frozen=True)
class Key:
    """One value that can be varied, with nominal value, unit and bounds."""

    path: str
    kind: Kind
    nominal: Value | None  # value in the scenario; None: has none
    unit: str = ""  # from the suffix of the name
    low: float = -inf
    high: float = inf
    open_low: bool = False  # True: ``low`` itself is not allowed
    open_high: bool = False
    choices: tuple[Value, ...] = ()
    grid: float | None = None  # s, control step; allows its multiples
    text: str = ""  # meaning, if no field states it
    field: tuple[type[BaseModel], str] | None = None  # model and field set; None: no field

    @property
    def meaning(self) -> str:
        return self.text or (meaning_of(*self.field) if self.field is not None else "")

    @property
    def allowed(self) -> str:
        """Allowed range or names of the key, in words."""
        if self.kind == "bool":
            return "true or false"
        if self.choices:
            return ", ".join(str(choice) for choice in self.choices)
        what = "a whole number" if self.kind == "int" else "a number"
        above, below = ("above" if self.open_low else "from"), ("below" if self.open_high else "to")
        if isfinite(self.low) and isfinite(self.high):
            return f"{what} {above} {self.low:g} {below} {self.high:g}"
        if isfinite(self.low):
            return f"{what} above {self.low:g}" if self.open_low else f"{what}, at least {self.low:g}"
        if isfinite(self.high):
            return f"{what} below {self.high:g}" if self.open_high else f"{what}, at most {self.high:g}"
        return what

    def fit(self, value: Value) -> Value:
        """Return ``value`` in the type of the key, rounded if the key counts something.

        Raises InputError: one line with the key, the value and what is allowed.
        """
        if self.kind == "bool" and isinstance(value, bool):
            return value
        if self.kind == "choice":
            if value in self.choices:
                return self.choices[self.choices.index(value)]
            if self._accepts_files and (is_file(str(value)) or ":" in str(value)):
                return value
            if self.path == "aircraft" and is_aircraft_path(str(value)):
                return value
        elif self.kind in ("float", "int") and isinstance(value, (int, float)) and not isinstance(value, bool):
            number = self._round_to_grid(float(value)) if isfinite(value) else value
            if isfinite(number) and self._is_within_bounds(number):
                return number
        raise InputError(f"{self.path} = {value}: must be {self._describe_requirement}")

    @property
    def _accepts_files(self) -> bool:
        return self.path.split(".")[-1] in ("engine", "controller")

    @property
    def _describe_requirement(self) -> str:
        return f"one of {self.allowed}" if self.kind == "choice" else self.allowed

    def _round_to_grid(self, value: float) -> float | int:
        if self.kind == "int":
            return round(value)
        # Round the result: 1e-9 of a step is noise of the division and would change a number that a person wrote.
        return value if self.grid is None else float(f"{round(value / self.grid) * self.grid:.12g}")

    def _is_within_bounds(self, value: float) -> bool:
        above = value > self.low if self.open_low else value >= self.low
        below = value < self.high if self.open_high else value <= self.high
        return above and below


def unit_of(path: str) -> str:
    """Return the unit given by the suffix of a name; list indices are ignored."""
    name = next((part for part in reversed(path.split(".")) if not part.isdigit()), "")
    if name in UNIT_EXCEPTIONS:
        return UNIT_EXCEPTIONS[name]
    return next((unit for end, unit in UNIT_BY_ENDING.items() if f"_{name}".endswith(f"_{end}")), "")
