"""The requirements of a study, each with the flights that broke it and its smallest margin."""

from __future__ import annotations

from math import isfinite

from cosim.campaign.analysis.table import describe_range
from cosim.campaign.proof.result import ProvenRequirement
from cosim.campaign.store import Campaign
from cosim.results.wording import metric
from cosim.spec.scenario import Range

FLOWN = "flies to its end, within the flight's own limits"


def proven_requirements(campaign: Campaign) -> list[ProvenRequirement]:
    """Return what a flight must keep to count as a success: to fly, and then each condition of the study's success."""
    outcomes, beyond = campaign.columns.get("outcome", []), campaign.columns.get("beyond", [])
    lost = sum(outcome != "completed" or bool(limits) for outcome, limits in zip(outcomes, beyond, strict=True))
    flown = ProvenRequirement("R1", FLOWN, lost, len(outcomes), None, "", None)
    conditions = enumerate(campaign.study.success.items(), 2)
    return [flown, *(_condition(campaign, f"R{number}", name, allowed) for number, (name, allowed) in conditions)]


def _condition(campaign: Campaign, label: str, name: str, allowed: Range) -> ProvenRequirement:
    """Return the requirement on one metric; its margin is of the flights that completed and have it."""
    of, columns = metric(name), campaign.columns
    smallest: tuple[float, int] | None = None
    broken = told = 0
    rows = zip(columns["flight"], columns["outcome"], columns.get(name, [None] * len(campaign)), strict=True)
    for number, outcome, value in rows:
        if outcome != "completed":
            continue
        told += 1
        if not isinstance(value, (int, float)) or not isfinite(value):
            broken += 1  # a metric that the flight does not have is not within its range
            continue
        ends = [allowed.max - value] if allowed.max is not None else []
        ends += [value - allowed.min] if allowed.min is not None else []
        margin = of.factor * min(ends)
        broken += margin < 0.0
        if smallest is None or margin < smallest[0]:
            smallest = margin, int(number or 0)
    says = f"{of.label} {describe_range(name, allowed)}"
    least, flight = smallest or (None, None)
    return ProvenRequirement(label, says, broken, told, least, of.unit, flight)
