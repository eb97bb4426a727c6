"""Keeping a number within limits, in the steps of a flight."""

from __future__ import annotations


def clamp(value: float, most: float) -> float:
    """Return ``value``, at most ``most`` either way; NaN stays NaN."""
    return most if value > most else (-most if value < -most else value)


def clip(value: float, low: float, high: float) -> float:
    """Return ``value``, at least ``low`` and at most ``high``; NaN stays NaN."""
    return low if value < low else (high if value > high else value)
