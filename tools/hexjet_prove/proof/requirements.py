"""The requirements of a study, each with the flights that broke it and its smallest margin."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from cosim.results.requirements import parse_formula
from cosim.spec.scenario import Range, RequireEntry
from cosim.studies import LIMITED, MARGIN_OF, Campaign, describe_range, metric
from hexjet_prove.proof.result import ProvenRequirement

# Limits that apply only if the scenario states them.
NO_DEFAULT = {"throttle_activity_1_s", "tilt_activity_rad_s", "fuel_burnt_kg"}


def proven_requirements(campaign: Campaign) -> list[ProvenRequirement]:
    """Return the requirements of a successful flight: to reach its end, each formula, each condition."""
    outcomes, beyond = campaign.columns.get("outcome", []), campaign.columns.get("beyond", [])
    flown = [(outcome, limits) for outcome, limits in zip(outcomes, beyond, strict=True) if outcome != "failed"]
    lost = sum(outcome != "completed" or bool(limits) for outcome, limits in flown)
    listed = [ProvenRequirement("R1", _describe_flown(campaign), lost, len(flown), None, "", None)]
    for entry in campaign.study.base().require:
        listed.append(_prove_formula(campaign, f"R{len(listed) + 1}", entry))
    for name, allowed in campaign.study.success.items():
        listed.append(_prove_condition(campaign, f"R{len(listed) + 1}", name, allowed))
    return listed


def _describe_flown(campaign: Campaign) -> str:
    """Return the requirement to fly to the end, with the limits that count and those that are off, by key."""
    scenario, position = campaign.study.base(), LIMITED["place_error_m"]
    is_placed = any(value is not None for value in campaign.columns.get(position, []))
    absent = NO_DEFAULT | {"drift_m" if is_placed else "place_error_m"}
    if scenario.requests is not None:
        absent |= {"drift_m", "speed_m_s"}
    counting, off = [], []
    for key, value in scenario.limits.model_dump().items():
        if value is False or (value is None and key in absent):
            off.append(key)
        else:
            counting.append(key if value is None else f"{key} = {value:g}")
    return (
        f"flies to its end; limits that count: {', '.join(counting) or 'none'}; limits that are off: "
        f"{', '.join(off) or 'none'}"
    )


def _prove_formula(campaign: Campaign, label: str, entry: RequireEntry) -> ProvenRequirement:
    """Return a requirement of scenario or study; failed flights miss it."""
    unit = parse_formula(entry.formula).unit
    says = f"{entry.name}: {entry.formula}"
    flown = [index for index, outcome in enumerate(campaign.columns["outcome"]) if outcome != "failed"]
    return _make_requirement(campaign, label, says, entry.name, flown, 1.0, "" if unit == "1" else unit)


def _prove_condition(campaign: Campaign, label: str, name: str, allowed: Range) -> ProvenRequirement:
    """Return the requirement on one metric, of the flights that completed."""
    of, outcomes = metric(name), campaign.columns["outcome"]
    completed = [index for index, outcome in enumerate(outcomes) if outcome == "completed"]
    says = f"{of.label} {describe_range(name, allowed)}"
    return _make_requirement(campaign, label, says, name, completed, of.factor, of.unit)


def _make_requirement(
    campaign: Campaign, label: str, says: str, name: str, indices: Sequence[int], factor: float, unit: str
) -> ProvenRequirement:
    """Return a requirement with its margins in rows ``indices``, displayed with ``factor``."""
    column, numbers = campaign.columns.get(MARGIN_OF + name, [None] * len(campaign)), campaign.columns["flight"]
    margins = [
        (factor * float(value), int(numbers[index] or 0))
        for index in indices
        if isinstance(value := column[index], (int, float)) and isfinite(value)
    ]
    broken = len(indices) - sum(margin >= 0.0 for margin, _ in margins)  # an unevaluated margin counts as missed
    least, flight = min(margins, default=(None, None))
    return ProvenRequirement(label, says, broken, len(indices), least, unit, flight)
