"""Which controllers a design tries; and the law at the limit, one of them, on an axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf
from pathlib import Path

from cosim.base.errors import InputError
from cosim.control.predictors.registry import BASELINE
from cosim.simulation.controllers.controller_file import LAW, Requirements
from cosim.spec.vehicle import RateModel, Vehicle
from hexjet_design.assessment import AxisDesign, assess
from hexjet_design.limits import Say, tolerance_checks
from hexjet_design.loop.at_limit import tune_at_limit
from hexjet_design.loop.criteria import fine_loop, is_acceptable, objective
from hexjet_design.loop.firmware import Firmware
from hexjet_design.loop.programme import need_solver
from hexjet_design.loop.tuning import Tuning, candidates, designable

WITH_LEAD = " + lead"  # suffix of a candidate with a lead


def candidate_names(controller: str, start: Path | None) -> Sequence[str]:
    """Return the controllers to try.  Raises InputError for one that no design can use."""
    if controller == LAW:
        need_solver()
        if start is not None:
            raise InputError(f"controller {LAW}: its search begins at the limit: leave start out")
        return (LAW,)
    names = candidates() if controller == "auto" else (controller,)
    for name in names:
        designable(name, f"controller {name}", ["auto", LAW])
    return names


def servo_candidates(
    names: Sequence[str], controller: str, vehicle: Vehicle, firmware: Firmware | None
) -> Sequence[str]:
    """Return the controllers to try if servos control roll; ``auto`` is the baseline without firmware."""
    if controller == LAW:
        raise InputError(f"controller {LAW}: servos turn the roll of {vehicle.name}, and engines have to")
    return (BASELINE.name,) if controller == "auto" and firmware is None else names


def design_axis_at_limit(
    axis: AxisDesign, fixed: Tuning, model: RateModel, need: Requirements, roll: Tuning | None, say: Say
) -> AxisDesign:
    """Return an axis with the law at the limit, found on roll; other axes use roll's with their own models."""
    channel = axis.channel
    say(f"{channel.name}: {LAW}")
    if roll is None or roll.law is None:
        found = tune_at_limit(channel, model, fixed, need)
        tuning, value, why_not = found.tuning, found.objective, found.why_not
    else:
        tuning = Tuning.of_law(roll.law, model, fixed)
        closed = fine_loop(channel, tuning)
        kept = is_acceptable(closed, need)
        value, why_not = (objective(closed), "") if kept else (inf, "they are missed with roll's answers")
    if tuning is None or why_not:
        return replace(axis, candidates={LAW: inf}, why_not=why_not)
    checks = tolerance_checks(channel, tuning, need)
    return replace(axis, candidates={LAW: value}, after=assess(channel, tuning, need), checks=checks)


def find_simplest(objectives: Mapping[str, float], complexity_cost: float = 0.06, lead_cost: float = 0.19) -> str:
    """Return the simplest candidate that is about as good as the best.

    Those with a lead only where it pays.  ``complexity_cost``: of the objective: a more complex controller must answer
    3 % faster to be chosen.  ``lead_cost``: the same of a lead, 10 % faster: it works the throttle, and believes in the
    engine's lags.
    """
    led = {name: value for name, value in objectives.items() if name.endswith(WITH_LEAD)}
    plain = {name: value for name, value in objectives.items() if name not in led}
    least = min(plain.values())
    among = led if led and min(led.values()) < least - lead_cost else plain
    enough = min(among.values()) + complexity_cost
    return next(name for name, value in among.items() if value <= enough)
