"""Notes on settings of a flight that have no effect or cost accuracy, for terminal, page and summary."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from cosim.engine import EngineSpec
from cosim.spec.scenario import SUBSTEPS, Scenario, StepErrors, list_differing_keys, measured_errors
from cosim.spec.vehicle import Vehicle

# Height [m] below which JSBSim's MIL-F-8785C turbulence depends on the wind; well above it on the severity.
MAX_LOW_M = 300.0


def note_settings_without_effect(scenario: Scenario, vehicle: Vehicle, engines: Sequence[EngineSpec]) -> list[str]:
    return [*note_incomplete_turbulence(scenario), *note_missing_fuel_flow(vehicle, engines)]


def note_few_substeps(scenario: Scenario, varied: Collection[str] = ()) -> list[str]:
    """Return a note on the accuracy of a flight whose JSBSim runs per step are fewer than usual or set by an error.

    It has what was measured of the aircraft, and what of this flight, or of the keys ``varied`` by a study, was not.
    Empty where a scenario states as many runs as usual, or more.
    """
    runs, error = scenario.substeps, scenario.step_error
    if runs >= SUBSTEPS and error is None:
        return []
    measured = measured_errors(scenario.aircraft)
    flown, usual = (measured.errors_at(each) for each in (runs, SUBSTEPS)) if measured else (None, None)
    if measured is None or flown is None or usual is None:
        what = f"what fewer than {SUBSTEPS} cost {scenario.aircraft_name} in accuracy has not been measured"
    else:
        what = (
            f"shipped flights of {scenario.aircraft} then differ by up to {flown[0]:g} deg and {flown[1]:g} mm from "
            f"those with 16, with {SUBSTEPS} by {usual[0]:g} deg and {usual[1]:g} mm"
        )
        others = list_unmeasured(scenario, measured, varied)
        what += f"; not measured here: {_join_names(others)}" if others else ""
    gusts = "; the turbulence is another than with other numbers" if scenario.environment.turbulence_severity else ""
    return [f"substeps = {runs}{f', for {error!r}' if error else ''}: {what}{gusts}"]


def list_unmeasured(scenario: Scenario, measured: StepErrors, varied: Collection[str] = ()) -> list[str]:
    """Return the keys by which a flight differs from those with measured step errors."""
    if scenario.name in measured.scenarios:
        shipped = Scenario.load(scenario.name).replace(aircraft=scenario.aircraft, **measured.settings)
        differing = list_differing_keys(scenario, shipped)
        if "duration_s" in differing and scenario.duration_s < shipped.duration_s:
            differing.remove("duration_s")
        return list(dict.fromkeys([*differing, *varied]))
    bare = Scenario(name="bare", duration_s=scenario.duration_s, aircraft=scenario.aircraft)
    as_shipped = bare.resolved(step_s=bare.resolved_vehicle()[0].control_step)
    own = [key for key in list_differing_keys(scenario, as_shipped) if key == "step_s" or key.startswith("vehicle.")]
    named = {"engine": (scenario.engine, measured.engines), "controller": (scenario.controller, measured.controllers)}
    own = [*(key for key, (name, flown) in named.items() if name not in flown), *own]
    return ["this flight, which is none of them", *dict.fromkeys([*own, *varied])]


def _join_names(names: Sequence[str], most: int = 4) -> str:
    """Return names joined by commas, with the number of those beyond the first ``most``."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def note_incomplete_turbulence(scenario: Scenario) -> list[str]:
    """Return a note if turbulence is only half stated: wind without severity or vice versa."""
    environment = scenario.environment
    wind, severity = environment.turbulence_wind_m_s, environment.turbulence_severity
    if wind and not severity:
        return [
            f"turbulence is off: environment.turbulence_wind_m_s = {wind:g} acts with a turbulence_severity of 1 to 7"
        ]
    if severity and not wind:
        return [
            f"no turbulence below {MAX_LOW_M:g} m: environment.turbulence_severity = {severity} switches it on, and "
            "its strength there is turbulence_wind_m_s, which is 0"
        ]
    return []


def note_varied_turbulence(scenario: Scenario, keys: Collection[str]) -> list[str]:
    """Return a note if varying these ``keys`` changes turbulence not at all or only on and off."""
    wind, severity = "environment.turbulence_wind_m_s", "environment.turbulence_severity"
    if severity in keys:
        return [f"below {MAX_LOW_M:g} m {severity} is a switch: 1 to 7 are the same there, {wind} is the strength"]
    if wind in keys and not scenario.environment.turbulence_severity:
        return [f"turbulence is off: {wind} acts with a {severity} of 1 to 7"]
    return note_incomplete_turbulence(scenario) if wind not in keys else []


def note_missing_fuel_flow(vehicle: Vehicle, engines: Iterable[EngineSpec]) -> list[str]:
    """Return a line for each kind of engine that reports no fuel flow to a vehicle with a tank."""
    specs = list(engines)
    without_flow = dict.fromkeys(spec.name for spec in specs if not spec.has_port("fuel_flow"))
    if vehicle.fuel is None or not without_flow:
        return []
    some_report = any(spec.has_port("fuel_flow") for spec in specs)
    ending = "what it burns does not leave the tank" if some_report else "the tank stays full"
    return [f"engine {name} reports no fuel flow: {ending}" for name in without_flow]
