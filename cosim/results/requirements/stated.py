"""The requirements that a scenario states: made from its ``[[require]]``, and refused where nothing could keep them."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf
from typing import TYPE_CHECKING

from cosim.base.errors import InputError, nearest
from cosim.results.contacts import CONTACTS
from cosim.results.log.columns import log_columns, logged_vehicle
from cosim.results.requirements.formula import AllOrAny, Comparison, Formula, Not
from cosim.results.requirements.requirement import Requirement
from cosim.results.requirements.signals import DERIVED, event_times, needed_columns
from cosim.results.requirements.units import in_degrees, in_si

if TYPE_CHECKING:
    from cosim.simulation.step import Simulation
    from cosim.spec.scenario import Scenario


def stated_requirements(scenario: Scenario) -> list[Requirement]:
    return [
        Requirement(name=entry.name, formula=entry.formula, scale=entry.scale, reason=entry.reason)
        for entry in scenario.require
    ]


def check_requirements(scenario: Scenario, whole: bool = True) -> None:
    """Refuse invalid formulas and unknown events; if ``whole``, also times after the end of the flight.

    Raises InputError.
    """
    times, end_s = event_times(scenario), scenario.duration_s if whole else inf
    for requirement in stated_requirements(scenario):
        try:
            _check_formula(requirement, times, end_s)
        except InputError as error:
            raise InputError(f"scenario {scenario.name}: require {requirement.name}: {error}") from error


def note_first_row(scenario: Scenario) -> list[str]:
    """Return a line for each formula that looks at signals of the log in the first row alone."""
    signals = {*(column.name for column in log_columns()), *DERIVED}
    return [
        f"require {each.name}: {each.formula} is judged in the first row alone; always({each.formula}) in all"
        for each in stated_requirements(scenario)
        if _is_about_first_row_only(each.parsed.formula) and signals.intersection(map(in_si, each.names))
    ]


def _is_about_first_row_only(formula: Formula) -> bool:
    return isinstance(formula, (Comparison, Not, AllOrAny)) and all(map(_is_about_first_row_only, formula.parts))


def _check_formula(requirement: Requirement, times: dict[str, list[float]], end_s: float) -> None:
    parsed = requirement.parsed
    if requirement.scale is None and not parsed.tolerance:
        raise InputError(f"compares with no number but 0: state its scale, in {parsed.unit}")
    known = [*times, *CONTACTS]
    for name in parsed.formula.events:
        if name not in known:
            raise InputError(f"unknown event {name!r}; {nearest(name, known)}")
    latest = parsed.formula.last_relevant_time_s([0.0], times)
    if latest > end_s:
        raise InputError(f"speaks of {latest:g} s, and the flight ends at {end_s:g} s")


def check_signals(simulation: Simulation, metrics: Iterable[str]) -> None:
    """Refuse signals that are no columns of the simulation's log, derived from such, or ``metrics`` (InputError)."""
    scenario = simulation.scenario
    if not scenario.require:
        return
    columns = log_columns(logged_vehicle(simulation.vehicle), simulation.columns)
    known = {*(column.name for column in columns), *metrics, *DERIVED}
    for requirement in stated_requirements(scenario):
        for name in requirement.names:
            if in_si(name) not in known:
                likely, _, _ = nearest(name, {*known, *map(in_degrees, known)}).partition("allowed:")
                raise InputError(
                    f"scenario {scenario.name}: require {requirement.name}: unknown signal {name!r}; {likely}allowed: "
                    f"the columns of the log, metrics, and {', '.join(DERIVED)}; angles also in deg"
                )


def columns_of(scenario: Scenario, metrics: Iterable[str]) -> list[str]:
    """Return the columns of the log that a scenario's requirements are assessed from."""
    known, columns = set(metrics), []
    for requirement in stated_requirements(scenario):
        names = [name for name in requirement.names if name not in known]
        columns += needed_columns(names, requirement.parsed.formula.events)
    return list(dict.fromkeys(columns))
