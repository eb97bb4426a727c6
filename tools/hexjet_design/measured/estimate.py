"""From periods of a broken loop to its margins, with the bounds that the periods' spread leaves them.

With the loop closed a signal ``w`` added at the plant's input becomes ``S w`` behind it, ``S = 1 / (1 + L)``, so that
``L = 1 / S - 1`` whatever noise is in the loop: noise adds to ``S`` and averages out of it.

The bounds are of the jackknife (J. W. Tukey, 1958): what is asked for is computed from all periods and from all but
one, and the spread of ``n m - (n - 1) m_i`` says how sure it is; Student's t with n - 1 degrees of freedom at 95 %.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import isfinite, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array, Complex
from cosim.base.errors import FlightError
from cosim.loops import LoopMargins, loop_margins

# Points per measured interval, interpolated linearly in log gain and phase over log frequency.
REFINEMENT = 20


QUANTITIES = tuple(field.name for field in fields(LoopMargins))  # margins of a loop


@dataclass(frozen=True)
class Bounded:
    """A number and its 95 % interval; NaN if the periods do not agree that it exists."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Response:
    """A measured loop: ``L``, ``S``, deviation of ``S`` and coherence at each line."""

    hertz: Array
    loop: Complex
    sensitivity: Complex
    spread: Array
    coherence: Array
    used: NDArray[np.bool_]  # lines used for margins, above the noise
    margins: Mapping[str, Bounded]


def measured(sensitivity: Complex, hertz: Array, step: float = 0.0, transport_s: float | None = None) -> Response:
    """Estimate loop and margins from ``S`` by period and line, (periods, lines), of two periods at least.

    ``step`` and ``transport_s``: see :func:`cosim.loops.loop_margins`.

    Raises FlightError where next to nothing stands out of the noise.
    """
    periods = len(sensitivity)
    mean = sensitivity.mean(axis=0)
    scatter = np.sum(np.abs(sensitivity - mean) ** 2, axis=0) / (periods - 1)
    spread = np.sqrt(scatter / periods)
    loop = 1.0 / mean - 1.0
    # Lines whose S has a larger standard deviation are not used for margins.
    max_relative_spread = 0.1
    used = spread <= max_relative_spread * np.abs(mean)
    min_lines = 10  # with fewer lines there are no margins
    if int(used.sum()) < min_lines:
        raise FlightError(
            f"only {int(used.sum())} of {len(hertz)} lines stand out of the noise: more amplitude or periods"
        )

    def compute_margins(rows: Complex) -> dict[str, float | None]:
        return vars(loop_margins(*refine((1.0 / rows.mean(axis=0) - 1.0)[used], hertz[used]), step, transport_s))

    estimates = compute_margins(sensitivity)
    values_without_part = [compute_margins(np.delete(sensitivity, number, axis=0)) for number in range(periods)]
    bounded = {
        name: _bound_by_jackknife(value, [margins[name] for margins in values_without_part])
        for name, value in estimates.items()
        if value is not None
    }
    coherence = np.abs(mean) ** 2 / (np.abs(mean) ** 2 + scatter / periods)
    return Response(hertz, loop, mean, spread, coherence, used, bounded)


def refine(loop: Complex, hertz: Array, tiny: float = 1e-12) -> tuple[Complex, Array]:
    """Return a loop measured at these frequencies, and the frequencies, with :data:`REFINEMENT` times the points."""
    x = np.log(hertz)
    fine = np.interp(np.arange(0, (len(x) - 1) * REFINEMENT + 1) / REFINEMENT, np.arange(len(x)), x)
    size = np.interp(fine, x, np.log(np.maximum(np.abs(loop), tiny)))
    phase = np.interp(fine, x, np.unwrap(np.angle(loop)))
    return np.exp(size + 1j * phase), np.exp(fine)


def _bound_by_jackknife(value: float, values_without_part: list[float | None]) -> Bounded:
    from scipy.special import stdtrit

    if any(value is None for value in values_without_part):
        return Bounded(value, nan, nan)
    count = len(values_without_part)
    each = np.array(values_without_part, np.float64)
    half = float(stdtrit(count - 1, 0.975)) * sqrt((count - 1) / count * float(np.sum((each - each.mean()) ** 2)))
    return Bounded(value, value - half, value + half)


def relative_difference(name: str, value: float, reference: float) -> float:
    """Return by how much a margin is off a reference, relative; of a gain in dB by its factor, NaN of a 0."""
    if name.endswith("_db"):
        return float(10.0 ** ((value - reference) / 20.0) - 1.0)
    return float((value - reference) / reference) if reference else nan


def relative_differences(one: Mapping[str, Bounded], other: Mapping[str, Bounded]) -> dict[str, float]:
    """Return the relative difference of each margin of ``one`` from that of ``other``; dB as factors."""
    margins = {}
    for name in one.keys() & other.keys():
        a, b = one[name].value, other[name].value
        if isfinite(a) and isfinite(b):
            margins[name] = relative_difference(name, a, b)
    return margins
