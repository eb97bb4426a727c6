"""How far a flown row is from failure, as one number: positive where it was a success, negative where it failed.

Counting knows yes and no alone.  Methods that go towards failure need to know which of two successes is nearer to it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite

from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import LIMITS_MARGIN, MARGIN_OF, Row, study_requirements
from cosim.results.requirements import LOST, UNKNOWN, FailedFlight, range_requirements
from cosim.spec.scenario import Range

MARGIN = "margin"  # column of a row with the margin
OWN_LIMITS = "the flight's own limits"  # name of the requirement on the limits
# The margin of a failed flight is at most minus this, so that it is below 0.
MIN_FAILED_MARGIN = 1e-9


def row_margin(row: Row, study: Study) -> float:
    """Return the margin of a flown row: its column ``margin`` or, without one, that of the study's ``[success]``.

    The second is the smallest over all conditions of (max - value) or (value - min), each divided by the scale of the
    requirement that the condition is; 1.0 where nothing is asked but that the flight completes within its limits.  A
    flight that was lost has -1 at its planned end and -2 at its start, linearly between.  A success has 0 at least, and
    everything else less than 0.
    """
    if not row["success"] and row["outcome"] != "completed":
        stated = row.get(MARGIN)
        return -abs(_to_finite_margin(stated)) if stated is not None else _margin_of_failed_flight(row, study)
    stated = row.get(MARGIN)
    margin = _to_finite_margin(stated) if stated is not None else success_margin(row, study.success)
    return max(margin, 0.0) if row["success"] else min(margin, -MIN_FAILED_MARGIN)


def requirement_margins(study: Study) -> tuple[list[str], Callable[[Row], list[float]]]:
    """Return the names of a study's requirements, and a function that returns a row's margins over their scales.

    The last is :data:`OWN_LIMITS`, with the loss of the flight.  One at least is less than 0 where the row is no
    success, and none elsewhere.
    """
    scales = {requirement.name: requirement.divisor for requirement in study_requirements(study)}

    def read_margins(row: Row) -> list[float]:
        whole, success = row_margin(row, study), bool(row["success"])
        known = [(row.get(MARGIN_OF + name), scale) for name, scale in scales.items()] + [(row.get(LIMITS_MARGIN), 1.0)]
        if all(margin is None for margin, _ in known):
            return [UNKNOWN] * len(scales) + [whole]
        unknown = UNKNOWN if success else -UNKNOWN
        found = [unknown if margin is None else _to_finite_margin(margin) / scale for margin, scale in known]
        if known[-1][0] is None:
            found[-1] = UNKNOWN
        if success:
            return [max(margin, 0.0) for margin in found]
        return found if min(found) < 0.0 else [*found[:-1], min(whole, -MIN_FAILED_MARGIN)]

    return [*scales, OWN_LIMITS], read_margins


def success_margin(values: Mapping[str, object], success: Mapping[str, Range]) -> float:
    """Return the smallest margin of the conditions; minus 1 for a metric that the flight does not have."""
    margins = [1.0]
    for name, allowed in success.items():
        value = values.get(name)
        if value is None:
            margins.append(-1.0)
            continue
        number = _to_finite_margin(value)
        (requirement,) = range_requirements({name: allowed}, "success")
        if allowed.max is not None:
            margins.append((allowed.max - number) / requirement.divisor)
        if allowed.min is not None:
            margins.append((number - allowed.min) / requirement.divisor)
    return min(margins[1:], default=margins[0])


def _margin_of_failed_flight(row: Row, study: Study) -> float:
    flown = row.get("duration_s")
    return -FailedFlight(0.0 if flown is None else _to_finite_margin(flown), study.base().duration_s).scales


def _to_finite_margin(value: object) -> float:
    """Return a margin as a float; a non-finite one counts as lost (-LOST)."""
    assert isinstance(value, (int, float))
    return float(value) if isfinite(value) else -LOST
