"""Margins over an engine's uncertainty: the measured loop with the answer of each drawn engine in place of the nominal.

Where thrust turns an axis, the engine's answer is a factor of the loop, whatever controller is in it: ``L`` of a drawn
engine is the measured one times the ratio of the two answers.  So nothing is flown for it.  Whether a drawn loop is
stable is told by Nyquist's criterion: the measured one is, so ``(1 + L) / (1 + L0)`` may not turn about 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

import numpy as np

from cosim.base.arrays import Complex
from cosim.loops import loop_margins
from hexjet_design.measured.estimate import QUANTITIES, Response, refine

PERCENTILES = (2.5, 97.5)  # ends of a 95 % range
NO_MARGIN = {name: -inf if name == "gain_down_db" else inf for name in QUANTITIES}  # values of an unstable loop


@dataclass(frozen=True)
class EngineRange:
    """95 % range of each margin over the draws, infinite if absent; an unstable loop has no margin."""

    ranges: Mapping[str, tuple[float, float]]
    draws: int
    unstable: int  # number of unstable ones

    def to_dict(self) -> dict[str, Any]:
        """Return ranges and counts for JSON, null if absent."""

        def to_json(value: float) -> float | None:
            return float(value) if isfinite(value) else None

        ranges = {name: {"low": to_json(low), "high": to_json(high)} for name, (low, high) in self.ranges.items()}
        return {"margins_95": ranges, "draws": self.draws, "unstable_draws": self.unstable}


def range_over_engines(response: Response, ratios: Complex, step: float, transport_s: float | None) -> EngineRange:
    """Return the ranges of a measured loop's margins over engines whose response is ``ratios`` of the nominal.

    ``ratios``: a row a draw, a column a used line of the response.  ``step`` [s] and ``transport_s``: see
    :func:`cosim.loops.loop_margins`.
    """
    lines = response.hertz[response.used]
    loop, hertz = refine(response.loop[response.used], lines)
    found: dict[str, list[float]] = {name: [] for name in response.margins}
    unstable = 0
    for ratio in ratios:
        drawn = loop * refine(ratio, lines)[0]
        stable = stays_stable(loop, drawn)
        unstable += not stable
        margins = vars(loop_margins(drawn, hertz, step, transport_s))
        for name, values in found.items():
            value = margins[name]
            lost = inf if name == "peak_sensitivity" else 0.0
            values.append((NO_MARGIN[name] if value is None else value) if stable or name == "crossover_hz" else lost)
    ranges = {}
    for name, values in found.items():
        low, high = np.percentile(values, PERCENTILES, method="nearest")
        ranges[name] = (float(low), float(high))
    return EngineRange(ranges, len(ratios), unstable)


def stays_stable(reference: Complex, loop: Complex) -> bool:
    """Return whether a loop is stable, given a stable one that is nearly the same at both ends of the band."""
    turn = np.unwrap(np.angle((1.0 + loop) / (1.0 + reference)))
    return abs(float(turn[-1] - turn[0])) < 0.5 * np.pi
