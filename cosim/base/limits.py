"""Keeping a number within limits, in the steps of a flight."""

from __future__ import annotations


def clamp(value: float, limit: float) -> float:
    """Return ``value``, clamped to ``-limit`` .. ``limit``; NaN stays NaN.

    >>> clamp(-3.0, 2.0), clamp(1.5, 2.0)
    (-2.0, 1.5)
    """
    return limit if value > limit else (-limit if value < -limit else value)


def clip(value: float, low: float, high: float) -> float:
    """Return ``value``, at least ``low`` and at most ``high``; NaN stays NaN."""
    return low if value < low else (high if value > high else value)
