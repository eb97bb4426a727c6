"""One key between two ends, and how far from where the search starts a value lies.

A deviation is a number from -1 to 1: the share of the way from the start to the end on that side, in the logarithm
where the range is logarithmic.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, exp, log

from cosim.base.errors import InputError
from cosim.studies import Key, Value, Vary, absolute_support, check_vary, quantum, whole_bounds
from hexjet_prove.search.line_search import Between


@dataclass(frozen=True)
class Span:
    """The range of a key, scanned in ``points`` and bisected to ``tolerance`` in the key's unit.

    ``start``: the key's value in the scenario, or the end nearest to it; the lower one if the scenario states none.
    """

    key: Key
    low: float
    high: float
    start: float
    points: int
    tolerance: float
    logarithmic: bool = False

    @property
    def sides(self) -> tuple[int, ...]:
        """1 if there is room above the start, -1 if below."""
        return tuple(side for side in (1, -1) if self._length_of_side(side) > 0.0)

    @property
    def quantum(self) -> float | None:
        """Step whose multiples the key takes; None without one."""
        return quantum(self.key)

    @property
    def step_text(self) -> str:
        """Step of the scan in words; a narrower band may be missed."""
        if self.logarithmic:
            return f"a factor of {(self.high / self.low) ** (1.0 / (self.points - 1)):.4g}"
        step = (self.high - self.low) / (self.points - 1)
        return f"{ceil(step / self.quantum - 1e-9) * self.quantum if self.quantum else step:.4g}"

    def end_value(self, side: int) -> Value:
        """Return the value at the end of the range on a side."""
        return self.value_at(float(side))

    def value_at(self, deviation: float) -> Value:
        """Return the value at a deviation, rounded and limited to one that the key accepts."""
        # Twelve digits, so 0.3 and not 0.30000000000000004; the ends stay exact.
        return self.key.fit(min(max(float(f"{self.number_at(deviation):.12g}"), self.low), self.high))

    def number_at(self, deviation: float) -> float:
        """Return the number at a deviation, whether or not the key accepts it."""
        number = self._to_scale(self.start) + deviation * self._length_of_side(1 if deviation >= 0.0 else -1)
        return exp(number) if self.logarithmic else number

    def deviation(self, value: float) -> float:
        """Return the deviation of a value, 1 or -1 at the range's ends."""
        off = self._to_scale(value) - self._to_scale(self.start)
        reach = self._length_of_side(1 if off >= 0.0 else -1)
        return off / reach if reach else 0.0

    def positions(self, side: int) -> list[float]:
        """Return the positions of a scan from the start to the end of a side, 0 to 1, all of different values."""
        whole = self.quantum
        reach = self._length_of_side(side)
        step = (self._to_scale(self.high) - self._to_scale(self.low)) / (self.points - 1)
        count = max(1, ceil(reach / step - 1e-9))
        if whole is None or self.logarithmic:
            positions = [min(1.0, number * step / reach) for number in range(count + 1)]
        else:
            steps = round(reach / whole)
            positions = [min(steps, round(number * step / whole)) / steps for number in range(count + 1)]
        by_value = {self.value_at(side * position): position for position in positions}
        return list(by_value.values())

    def bisector(self, side: int) -> Between:
        """Return the function that halves an interval of positions on a side.

        It returns None where the values of the two positions are within the tolerance, or neighbours.
        """
        whole = self.quantum

        def bisect(near: float, far: float) -> float | None:
            a, b = float(self.value_at(side * near)), float(self.value_at(side * far))
            if abs(b - a) <= max(self.tolerance, whole or 0.0) * (1.0 + 1e-9):
                return None
            if whole is None:
                return 0.5 * (near + far)
            value = round((a + b) / 2.0 / whole - 1e-9) * whole
            return abs(self.deviation(value))

        return bisect

    def _to_scale(self, value: float) -> float:
        return log(value) if self.logarithmic else value

    def _length_of_side(self, side: int) -> float:
        """Return the distance from the start to the high (side > 0) or low end, logarithmic if the span is."""
        end = self.high if side > 0 else self.low
        return abs(self._to_scale(end) - self._to_scale(self.start))


def span(vary: Vary, key: Key, tolerance: float | None) -> Span:
    """Return the span of a ``KEY=LO:HI`` or ``KEY=LO:HI:POINTS``.

    Raises InputError for anything but a range of numbers, and for a tolerance that is none.
    """
    if vary.range is None or key.kind not in ("float", "int"):
        raise InputError(f"vary {vary.text}: a search needs a range of numbers, {key.path}=LO:HI or LO:HI:POINTS")
    check_vary(vary.model_copy(update={"levels": None}), key)
    low, high = absolute_support(vary, key)
    step = quantum(key)
    if step is not None:
        first, last = whole_bounds(low, high, step)
        low, high = first * step, last * step
    nominal = low if key.nominal is None else float(key.nominal)
    if tolerance is not None and not 0.0 < tolerance < high - low:
        raise InputError(f"tolerance {key.path}={tolerance:g}: must be above 0 and below the range's {high - low:g}")
    return Span(
        key,
        low,
        high,
        min(max(nominal, low), high),
        vary.levels or 21,
        tolerance or (1.0 if key.kind == "int" else (high - low) / 200),
        vary.scale == "log",
    )
