"""Whether an output moves before its command: columns that are swapped, or clocks that are not one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cosim.base.arrays import Array
from cosim.identify.bench.evidence import test_residuals
from cosim.identify.bench.fit import Form, Problem, fit

LONGEST_LEAD_S = 3.0
LEAST_LEAD = 1.5  # rows: by less than that the command may be taken for held where it is not
LEAST_FALL = 30.0  # of the deviance, that a lead has to be worth
MOST_LEFT = 0.5  # of the power that was left over, that it may leave: else it is no lead that is missing
BOTH_WAYS = "columns that are swapped, or clocks that are not one"


def find_lead(problem: Problem, deviance: float, left_over: Array, curve: bool = False) -> float:
    """Return by how many seconds the output leads the command; 0 where that explains the logs no better.

    ``deviance`` and ``left_over`` are those of what explains them so far, without a lead; ``curve``: with a static one.
    """
    span = min(float(part.times[-1] - part.times[0]) for part in problem.parts)
    longest = min(LONGEST_LEAD_S, 0.25 * span)
    parts = [replace(part, command_times=part.command_times - longest) for part in problem.parts]
    ahead = Problem(parts, longest, problem.drift)
    found = fit(ahead, Form(1, curve))
    rest = ahead.residual(found)
    if found.deviance > deviance - LEAST_FALL or np.mean(rest**2) > MOST_LEFT * np.mean(left_over**2):
        return 0.0
    if test_residuals(ahead.parts, rest, found.delay, found.total[0]).cause:  # no noise: a clock that wobbles
        return 0.0
    row = max(max(part.step, float(np.median(np.diff(part.command_times)))) for part in problem.parts)
    lead = longest - found.delay
    return lead if lead > LEAST_LEAD * row else 0.0
