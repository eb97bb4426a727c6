"""The requirements of a study, each with the flights that broke it and its smallest margin."""

from __future__ import annotations

from math import isfinite

from cosim.campaign.analysis.table import describe_range
from cosim.campaign.proof.result import ProvenRequirement
from cosim.campaign.store import Campaign
from cosim.campaign.workers.flight_row import MARGIN_OF
from cosim.results.requirements import parse_formula
from cosim.results.wording import metric
from cosim.spec.scenario import Range, RequireEntry

FLOWN = "flies to its end, within the flight's own limits"


def proven_requirements(campaign: Campaign) -> list[ProvenRequirement]:
    """Return what a flight must keep to count as a success: to fly, each formula, and each condition of the study."""
    outcomes, beyond = campaign.columns.get("outcome", []), campaign.columns.get("beyond", [])
    lost = sum(outcome != "completed" or bool(limits) for outcome, limits in zip(outcomes, beyond, strict=True))
    listed = [ProvenRequirement("R1", FLOWN, lost, len(outcomes), None, "", None)]
    for entry in campaign.study.base().require:
        listed.append(_formula(campaign, f"R{len(listed) + 1}", entry))
    for name, allowed in campaign.study.success.items():
        listed.append(_condition(campaign, f"R{len(listed) + 1}", name, allowed))
    return listed


def _formula(campaign: Campaign, label: str, entry: RequireEntry) -> ProvenRequirement:
    """Return a requirement of the scenario or the study with the margins that the rows have of it."""
    column = campaign.columns.get(MARGIN_OF + entry.name, [])
    margins = [
        (float(value), int(number or 0))
        for number, value in zip(campaign.columns["flight"], column, strict=False)
        if isinstance(value, (int, float)) and isfinite(value)
    ]
    broken = len(campaign) - sum(margin >= 0.0 for margin, _ in margins)  # one that was not tested is not kept
    least, flight = min(margins, default=(None, None))
    unit = parse_formula(entry.formula).unit
    says = f"{entry.name}: {entry.formula}"
    return ProvenRequirement(label, says, broken, len(campaign), least, "" if unit == "1" else unit, flight)


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
