"""What a controller may believe of what it flies: identified models, predictors made from them, the hover."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError, notify
from cosim.base.protocols import Predictor
from cosim.base.signals import AXES
from cosim.control.allocation.thrust_map import StaticCurve, ThrustMap
from cosim.control.belief import Belief
from cosim.control.predictors.registry import BASELINE, PREDICTORS
from cosim.control.predictors.smith import NoPredictor
from cosim.engine import EngineSpec
from cosim.simulation.engine_reference import make_engine_reference
from cosim.simulation.engines import load_engines
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import RateModel, Vehicle, aircraft_seen_from


def make_scenario_belief(scenario: Scenario, parameters: Mapping[str, float]) -> Belief:
    """Return the belief that a controller with these parameters would get in a scenario.  Raises InputError."""
    vehicle, _ = scenario.resolved_vehicle()
    engine, *stations = load_engines(scenario, vehicle)
    return make_belief(scenario, vehicle, engine, stations, parameters)


def make_belief(
    scenario: Scenario,
    vehicle: Vehicle,
    engine: EngineSpec,
    stations: Sequence[EngineSpec],
    parameters: Mapping[str, float],
) -> Belief:
    """Return the models and parameters that a user's controller gets."""
    thrust_map, hover = make_thrust_map(vehicle, engine, stations)
    built_in = scenario.model_copy(update={"controller": BASELINE.name})
    return Belief(
        scenario.step_s,
        vehicle,
        find_step_models(scenario, vehicle, engine),
        thrust_map,
        hover,
        parameters,
        "",
        scenario.initial.on_ground,
        lambda: [make_engine_reference(spec, scenario.step_s) for spec in stations],
        lambda name: make_predictors(built_in.model_copy(update={"controller": name}), vehicle, engine),
    )


def find_models(vehicle: Vehicle, engine: EngineSpec) -> dict[str, RateModel]:
    """Return the identified models by axis that the vehicle states for an engine.

    Those of an engine that is a file are filed under its name and its hash: with a note, one whose hash is of another
    file of that name is left out, and one without a hash is taken.
    """
    models: dict[str, RateModel] = {}
    for axis, model in engine.models_in(vehicle.identified).items():
        where = f"vehicle.identified.{engine.family!r}.{axis}"
        if not engine.matches_model(model.engine_sha256):
            other = f"is of another {engine.family} (sha256 {model.engine_sha256[:12]}, not {engine.fingerprint[:12]})"
            notify(f"{where}: {other}: left out; hexjet identify {axis} makes one of this")
            continue
        if not engine.library and not model.engine_sha256:
            notify(f"{where}: states no hash: that it is of this {engine.family} is not verified")
        models[axis] = model
    return models


def find_step_models(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec) -> dict[str, RateModel]:
    """Return the identified models for this engine and step, the delay that the controller adds in that of roll."""
    models: dict[str, RateModel] = {}
    for axis, model in find_models(vehicle, engine).items():
        if abs(model.sample_time_s - scenario.step_s) <= 1e-9:
            added = scenario.added_delay_samples if axis == "roll" else 0
            delay = model.delay_samples + added
            models[axis] = model.model_copy(update={"delay_samples": delay}) if added else model
    return models


def make_thrust_map(vehicle: Vehicle, engine: EngineSpec, stations: Sequence[EngineSpec]) -> tuple[ThrustMap, float]:
    """Return the map from thrust fractions to throttles, and the fraction in hover."""
    distinct = {id(station): station for station in (engine, *stations)}
    curves = {number: StaticCurve(station.name, *station.rising_curve) for number, station in distinct.items()}
    thrust_map = ThrustMap(curves[id(engine)], [curves[id(station)] for station in stations])
    return thrust_map, thrust_map.fraction(vehicle.mass_kg * GRAVITY / len(vehicle.jets))


def make_predictors(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec) -> list[Predictor]:
    """Return one predictor per axis, the controller's if the vehicle has a model for this engine."""
    spec = PREDICTORS[scenario.controller]
    models = find_models(vehicle, engine) if spec.needs_model else {}
    if spec.needs_model and not models:
        known = ", ".join(sorted(vehicle.identified))
        raise InputError(
            f"controller {scenario.controller!r} needs an identified model of {vehicle.name} with engine "
            f"{engine.family!r}; there are {f'models for: {known}' if known else 'none'}; "
            + _advise_design(scenario, vehicle, engine)
        )
    models_at_step = find_step_models(scenario, vehicle, engine)
    predictors_by_axis: list[Predictor] = []
    for axis in AXES:
        model = models_at_step.get(axis)
        if spec.needs_model and model is None and axis in models:
            raise InputError(
                f"vehicle.identified.{engine.family}.{axis}: the model's sample time {models[axis].sample_time_s:g} s "
                f"is not the scenario's step {scenario.step_s:g} s"
            )
        # Pitch and yaw of tilting jets act by servos, for which there is no predictor.
        predicted = model is not None if spec.needs_model else axis == "roll" or vehicle.allocation == "rotors"
        predictors_by_axis.append(spec.predictor(model, vehicle.control.predictor) if predicted else NoPredictor())
    return predictors_by_axis


def _advise_design(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec) -> str:
    """Return the advice for an engine without an identified model: the command that designs a controller for it."""
    engine_name = engine.name if engine.library else str(engine.mapping or engine.path)
    aircraft_seen = aircraft_seen_from(scenario.aircraft, scenario.folder)
    aircraft = "" if aircraft_seen == "hexjet" else f" --aircraft {aircraft_seen}"
    file = f"{vehicle.name}-{engine.name}.toml"
    return (
        f"one is made, with gains to go with it, by: hexjet design --engine {engine_name}{aircraft} --out {file} "
        f"(then fly with controller {file}; or with controller {BASELINE.name})"
    )
