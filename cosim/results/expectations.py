"""What a scenario expects of its flight: which entry counts, and whether its names can be met at all."""

from __future__ import annotations

from cosim.base.errors import InputError, nearest
from cosim.control.predictors.registry import PREDICTORS
from cosim.engine import list_engine_names
from cosim.results.metrics import metric_names
from cosim.results.requirements.stated import check_requirements
from cosim.simulation.controllers.source import list_installed as own_controllers
from cosim.simulation.plugins import load_metrics
from cosim.spec.controller_name import split_file_name
from cosim.spec.scenario import Expectation, Scenario
from cosim.spec.vehicle import aircraft_names, is_aircraft_path, is_file


def check_expected(scenario: Scenario) -> None:
    """Refuse an expectation of an unknown controller, engine or metric (InputError)."""
    check_requirements(scenario, whole=scenario.origin is None)  # a shortened flight may end before them
    allowed_metrics = allowed_metric_names(scenario)
    for index, entry in enumerate(scenario.expect):
        where = f"scenario {scenario.name}: expect.{index}"
        checks = (
            ("controller", [entry.controller], _controllers_like(entry.controller)),
            ("aircraft", [] if is_aircraft_path(entry.aircraft) else [entry.aircraft], aircraft_names()),
            ("metrics", list(entry.metrics), allowed_metrics),
        )
        for key, names, allowed in checks:
            for name in names:
                if name not in allowed:
                    raise InputError(f"{where}.{key}: unknown {name!r}; {nearest(name, allowed)}")
        if not is_file(entry.engine):
            plain = entry.engine.removesuffix("-fmi2")
            if plain not in list_engine_names():
                raise InputError(f"{where}.engine: unknown {entry.engine!r}; {nearest(plain, list_engine_names())}")


def allowed_metric_names(scenario: Scenario) -> list[str]:
    """Return the names of the built-in metrics and of the scenario's own.  Raises InputError."""
    return [*metric_names(), *(name for metric in load_metrics(scenario) for name in metric.names)]


def _controllers_like(controller: str) -> list[str]:
    """Return the names of built-in controllers, and ``controller`` if it has the form of a user's."""
    if controller in PREDICTORS or ":" in controller or split_file_name(controller):
        return [*PREDICTORS, controller]
    return [*PREDICTORS, *(name for name, _ in own_controllers())]


def find_expectation(scenario: Scenario) -> Expectation | None:
    """Return the scenario's expectation for its controller, engine and aircraft, or None."""
    configuration = (scenario.controller, scenario.engine, scenario.aircraft)
    return next((e for e in scenario.expect if (e.controller, e.engine, e.aircraft) == configuration), None)
