"""What is said before a study is flown of models and designs that its flights do not keep: once, whatever varies."""

from __future__ import annotations

from collections.abc import Iterator

from cosim.base.errors import FlightError, InputError
from cosim.campaign.study.key import Value
from cosim.campaign.study.plan import Flight, flights, scenario_of
from cosim.campaign.study.study import Study
from cosim.control.predictors.registry import PREDICTORS
from cosim.simulation.controllers.controller_file import list_design_notes
from cosim.simulation.engines import load_engines
from cosim.simulation.model_agreement import ModelAgreement, compare_flown_models
from cosim.spec.scenario import Scenario, flown_parameters

# Prefixes of keys that change neither a model nor the vehicle.
NOT_MODELLED = ("mismatch.", "command.", "controller_parameters.")


def model_notes(study: Study) -> list[str]:
    """Return at most one note, on the flight at the ends of the ranges whose controller's model deviates most.

    Empty where all models are the vehicles', and where no controller believes one.  A flight that cannot be built is
    passed over: it is a row of the campaign, with the reason.
    """
    if study.autopilot is not None:
        return []
    compared = noted = 0
    worst: tuple[Flight, ModelAgreement] | None = None
    for flight in _extreme_flights(study):
        try:
            scenario = scenario_of(study, flight)
            vehicle, _ = scenario.resolved_vehicle()
            agreements = compare_flown_models(scenario, vehicle, load_engines(scenario, vehicle)[0])
        except (InputError, FlightError):
            continue
        compared += bool(agreements)
        farthest = max(agreements, key=lambda agreement: agreement.distance, default=None)
        if farthest is not None and farthest.is_noteworthy:
            noted += 1
            if worst is None or farthest.distance > worst[1].distance:
                worst = flight, farthest
    if worst is None:
        return []
    flight, agreement = worst
    return [
        f"{agreement.note}; that is flight {flight.number}, the farthest off of {noted} among {compared} at the ends "
        "of what varies"
    ]


def nominal_model_notes(scenario: Scenario) -> list[str]:
    """Return notes on the models of a flight's controller that differ from the vehicle, one line each."""
    vehicle, _ = scenario.resolved_vehicle()
    agreements = compare_flown_models(scenario, vehicle, load_engines(scenario, vehicle)[0])
    return [agreement.note for agreement in agreements if agreement.is_noteworthy]


def design_warnings(study: Study) -> list[str]:
    """Return warnings on the designs that a study flies: failed or missing proof, or another engine.

    Of the first draw with each controller; one that cannot be built is passed over, and is a row of the campaign.
    """
    if study.autopilot is not None:
        return []
    planned, notes = flights(study), []
    for number in range(len(study.controller_names)):
        try:
            scenario = scenario_of(study, planned[number])
            vehicle, _ = scenario.resolved_vehicle()
            notes += list_design_notes(flown_parameters(scenario), load_engines(scenario, vehicle)[0])
        except (InputError, FlightError):
            continue
    return list(dict.fromkeys(notes))


def _extreme_flights(study: Study) -> Iterator[Flight]:
    """Yield the flights at the ends of the ranges, whose models are compared with the vehicle.

    These are the first draw with each controller that may use another model, of the built-in ones only one, as they
    use the same model; then the draws with the least and the most of every key that may matter, with the first.
    """
    planned, names = flights(study), study.controller_names
    count = len(names)
    controllers = [k for k, name in enumerate(names) if name in PREDICTORS and PREDICTORS[name].needs_model][:1]
    controllers += [k for k, name in enumerate(names) if name not in PREDICTORS]
    max_flights = 1000  # flights compared at the ends of ranges
    first_flights = [planned[n] for n in range(0, min(len(planned), max_flights * count), count)]
    chosen = {0}
    for key in study.drawn:
        if not key.startswith(NOT_MODELLED):
            values = [flight.values[key] for flight in first_flights]
            chosen |= _extremes(values)
    for n in sorted(chosen):
        for k in controllers if n == 0 else controllers[:1]:
            yield planned[n * count + k]


def _extremes(values: list[Value]) -> set[int]:
    """Return the indices of the least and the greatest number, or of the first of each value that is no number."""
    numbers = [value for value in values if isinstance(value, (int, float))]
    if len(numbers) < len(values):
        return {values.index(value) for value in dict.fromkeys(values)}
    return {numbers.index(min(numbers)), numbers.index(max(numbers))}
