"""Conversion of numbers to the integers of message fields."""

from __future__ import annotations

from math import isnan

U8, U16, I16, I32 = 0xFF, 0xFFFF, 0x7FFF, 0x7FFFFFFF
U32 = 0xFFFFFFFF


def to_field(value: float, low: int, high: int) -> int:
    """Return a value rounded and clipped to a field's range; NaN becomes 0."""
    return 0 if isnan(value) else round(min(max(value, low), high))


def to_e7(angle_deg: float) -> int:
    return to_field(angle_deg * 1e7, -I32, I32)


def to_mm(metres: float) -> int:
    return to_field(metres * 1e3, -I32, I32)
