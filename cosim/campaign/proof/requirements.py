"""The requirements of a study, each with the flights that broke it and its smallest margin."""

from __future__ import annotations

from collections.abc import Sequence
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
    """Return a requirement of the scenario or the study; a flight that was lost broke it."""
    unit = parse_formula(entry.formula).unit
    says = f"{entry.name}: {entry.formula}"
    return _proven(campaign, label, says, entry.name, range(len(campaign)), 1.0, "" if unit == "1" else unit)


def _condition(campaign: Campaign, label: str, name: str, allowed: Range) -> ProvenRequirement:
    """Return the requirement on one metric, of the flights that completed."""
    of, outcomes = metric(name), campaign.columns["outcome"]
    completed = [index for index, outcome in enumerate(outcomes) if outcome == "completed"]
    says = f"{of.label} {describe_range(name, allowed)}"
    return _proven(campaign, label, says, name, completed, of.factor, of.unit)


def _proven(
    campaign: Campaign, label: str, says: str, name: str, indices: Sequence[int], factor: float, unit: str
) -> ProvenRequirement:
    """Return a requirement with what the rows of ``indices`` say of its margin, shown ``factor`` times as large."""
    column, numbers = campaign.columns.get(MARGIN_OF + name, [None] * len(campaign)), campaign.columns["flight"]
    margins = [
        (factor * float(value), int(numbers[index] or 0))
        for index in indices
        if isinstance(value := column[index], (int, float)) and isfinite(value)
    ]
    broken = len(indices) - sum(margin >= 0.0 for margin, _ in margins)  # one that was not tested is not kept
    least, flight = min(margins, default=(None, None))
    return ProvenRequirement(label, says, broken, len(indices), least, unit, flight)
