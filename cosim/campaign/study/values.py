"""From a number that was drawn to the value of a key: factors and offsets, whole numbers, levels of a grid."""

from __future__ import annotations

from math import ceil, exp, floor, isfinite, log

from cosim.base.errors import InputError
from cosim.campaign.study.distributions import Vary
from cosim.campaign.study.key import Key, Value


def check_vary(vary: Vary, key: Key) -> None:
    """Check that a key accepts its distribution."""
    if key.kind in ("choice", "bool"):
        if vary.values is None:
            raise InputError(f"vary {vary.text}: {key.path} is one of {key.allowed}; list values of them")
        for value in vary.values:
            key.fit(value)
        return
    if any(isinstance(value, (str, bool)) for value in vary.values or []):
        raise InputError(f"vary {vary.text}: {key.path} must be {key.allowed}")
    if vary.relative:
        if key.nominal is None:
            raise InputError(f"vary {vary.text}: the scenario states no {key.path} that a {vary.relative} could be of")
        if vary.relative == "factor" and not key.nominal:
            raise InputError(f"vary {vary.text}: {key.path} is 0, and stays so times any factor; += adds to it")
    low, high = absolute_support(vary, key)
    if not _is_allowed(low, high, key):
        span = f"{low:g} to {high:g}"
        unbounded = "" if isfinite(low) and isfinite(high) else "; state min and max, it is truncated there"
        raise InputError(f"vary {vary.text}: {key.path} would be {span}, and must be {key.allowed}{unbounded}")
    _check_steps(vary, key, low, high)


def _check_steps(vary: Vary, key: Key, low: float, high: float) -> None:
    """Refuse values that are not whole numbers or control steps, and ranges with too few of them."""
    step = quantum(key)
    if step is None:
        return
    allowed = "whole numbers" if key.kind == "int" else f"whole steps of {step:g} s"
    for value in [] if vary.relative else vary.values or []:
        if abs(round(float(value) / step) * step - float(value)) > 1e-6 * step:
            raise InputError(f"vary {vary.text}: {key.path} = {value}: takes {allowed}")
    first, last = whole_bounds(low, high, step)
    needed = len(vary.values or []) or vary.levels or 2
    count = 0 if last < first else len(set(levels(vary, key))) if vary.discrete else int(min(last - first + 1.0, 2.0))
    if count < needed:
        raise InputError(f"vary {vary.text}: {key.path} takes {allowed}; {needed} are needed, and here are {count}")


def levels(vary: Vary, key: Key) -> list[Value]:
    """Return the points of a grid: the values, or the levels of a range including both ends, evenly or in ratio."""
    if key.kind in ("choice", "bool"):
        return [key.fit(value) for value in vary.values or []]
    if vary.values is not None:
        numbers = [float(value) for value in vary.values]
    else:
        assert vary.range is not None
        numbers = _space_evenly(*vary.range, vary.levels or 2, vary.scale == "log")
    return [key.fit(value) for value in round_to_steps([to_absolute(value, vary, key) for value in numbers], vary, key)]


def _space_evenly(low: float, high: float, count: int, in_ratio: bool) -> list[float]:
    """Return ``count`` numbers from ``low`` to ``high``, evenly or in ratio, inner ones rounded to 12 digits."""
    fractions = [number / (count - 1) for number in range(1, count - 1)]
    inner = [
        low * exp(fraction * log(high / low)) if in_ratio else low + fraction * (high - low) for fraction in fractions
    ]
    return [low, *(float(f"{value:.12g}") for value in inner), high]


def round_to_steps(values: list[float], vary: Vary, key: Key) -> list[float]:
    """Round values within bounds to the nearest step of a key that has steps."""
    step = quantum(key)
    if step is None:
        return values
    first, last = whole_bounds(*absolute_support(vary, key), step)
    return [min(max(floor(value / step + 0.5), first), last) * step for value in values]


def quantum(key: Key) -> float | None:
    """Return the step that values of a key are multiples of: 1 for integers, the control step for times, or None."""
    return 1.0 if key.kind == "int" else key.grid


def whole_bounds(low: float, high: float, step: float) -> tuple[float, float]:
    """Return the first and the last whole number of steps within bounds; infinite where a bound is."""
    # Rounding of the division must not exclude the bound itself.
    slack = 1e-9
    first = float(ceil(low / step - slack)) if isfinite(low) else low
    return first, float(floor(high / step + slack)) if isfinite(high) else high


def to_absolute(number: float, vary: Vary, key: Key) -> float:
    """Return the key's value for a drawn number, which may be a factor or an offset."""
    if not vary.relative:
        return number
    assert isinstance(key.nominal, (int, float))
    return number * key.nominal if vary.relative == "factor" else number + key.nominal


def absolute_support(vary: Vary, key: Key) -> tuple[float, float]:
    """Return the least and the largest value that the key can get."""
    ends = [to_absolute(end, vary, key) for end in vary.support]
    return min(ends), max(ends)


def _is_allowed(low: float, high: float, key: Key) -> bool:
    """Return whether a key allows all values between two bounds; bounds that are never reached do not count."""
    above = low > key.low if key.open_low and isfinite(low) else low >= key.low
    below = high < key.high if key.open_high and isfinite(high) else high <= key.high
    return above and below
