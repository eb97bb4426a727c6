"""What is known of a run before its first step, from the simulation that is about to fly."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

from cosim.base.runtime import kernels
from cosim.base.storage.files import read_file
from cosim.control.cascade import Cascade
from cosim.engine import EngineSpec
from cosim.results.expectations import allowed_metric_names, find_expectation
from cosim.results.limits import LimitInputs, make_limit_inputs, note_small_steps
from cosim.results.metrics import Reach
from cosim.results.requirements.signals import event_times
from cosim.results.requirements.stated import check_signals, stated_requirements
from cosim.results.summary import (
    DelayRow,
    EngineUncertainty,
    Integration,
    OwnController,
    ParametersRecord,
    PluginRecord,
    Setup,
    StationEngine,
    UncertainParameter,
    now,
    versions,
)
from cosim.simulation.controllers.controller_file import list_design_notes
from cosim.simulation.controllers.source import IN_MEMORY_PREFIX
from cosim.simulation.model_agreement import list_model_notes
from cosim.simulation.notes import note_few_substeps, note_settings_without_effect
from cosim.simulation.step import Simulation
from cosim.spec.controller_name import label, split_file_name
from cosim.spec.scenario import FlownParameters, Scenario, flown_parameters
from cosim.spec.vehicle import is_aircraft_path
from cosim.spec.vehicle.sensor_profile import describe_profile
from cosim.vehicle.airframe import AIR_METHOD, GROUND_METHOD, INTEGRATION_METHOD_NAMES, POSITION_METHODS


def make_setup(simulation: Simulation, resolved: Scenario, notes: bool = True) -> Setup:
    """Return the data of a run before its first step; ``resolved`` is the scenario as flown.

    ``notes``: compare its models with the vehicle, for who reads what is found.  Raises InputError for a requirement on
    a signal that is not logged.
    """
    scenario, engine = simulation.scenario, simulation.engine
    if scenario.require:
        check_signals(simulation, allowed_metric_names(scenario))
    files = flown_parameters(scenario)
    parameters = [
        ParametersRecord(kind=parameter.kind, file=copy.file, sha256=copy.sha256, controller=parameter.controller,
                         changed=tuple(parameter.changed))
        for parameter, copy in zip(files, resolved.parameter_files, strict=True)
    ]  # fmt: skip
    yardstick = make_limit_inputs(scenario, simulation.vehicle)
    model = simulation.vehicle.model or f"{simulation.vehicle.name}.xml"
    model = Path(model).name if is_aircraft_path(scenario.aircraft) else model
    return Setup(
        scenario=scenario.name,
        title=scenario.title,
        description=scenario.description,
        changed=resolved.changed,
        parameter_files=parameters,
        aircraft=scenario.aircraft_name,
        engine=engine.name,
        controller=label(scenario.controller),
        own_controller=_describe_controller(simulation),
        brought=[
            PluginRecord(key=key, name=source.label, sha256=source.sha256, files=source.hashes, version=source.version)
            for key, sources in simulation.plugins.sources.items()
            for source in sources
        ],
        seed=scenario.seed,
        sensors=describe_profile(scenario.sensor_profile),
        step_s=scenario.step_s,
        integration=describe_integration(scenario),
        planned_s=scenario.duration_s,
        started=now(),
        engine_curve=list(zip(engine.curve.throttle, engine.curve.thrust, strict=True)),
        engine_uncertainty=_engine_uncertainty(engine),
        stations=[_describe_station(station, engine) for station in simulation.stations],
        jets_m=[jet.position_m for jet in simulation.vehicle.jets],
        delay_ledger=[DelayRow(**vars(row)) for row in simulation.ledger],
        reach=find_reach(simulation),
        yardstick=yardstick,
        expectation=find_expectation(scenario),
        requires=stated_requirements(scenario),
        event_times_s=event_times(scenario) if scenario.require else {},
        notes=_collect_notes(simulation, files, yardstick) if notes else [],
        versions=versions(),
        blas_kernels=kernels.find_kernels(),
        sha256={
            model: simulation.airframe.file_sha256,
            f"{model} as flown": simulation.airframe.sha256,
            **_engine_hashes([engine, *simulation.stations]),
            **{file.file: file.sha256 for file in resolved.parameter_files},
            **(simulation.controller_source.hashes if simulation.controller_source is not None else {}),
            **{
                n: h
                for sources in simulation.plugins.sources.values()
                for source in sources
                for n, h in source.hashes.items()
            },
        },
    ).retitled()


def _collect_notes(simulation: Simulation, flown: Sequence[FlownParameters], yardstick: LimitInputs) -> list[str]:
    scenario, vehicle = simulation.scenario, simulation.vehicle
    return [
        *list_design_notes(flown, simulation.engine),
        *list_model_notes(scenario, vehicle, simulation.engine),
        *note_settings_without_effect(scenario, vehicle, simulation.stations),
        *note_small_steps(scenario, yardstick),
        *note_few_substeps(scenario),
    ]


def _describe_controller(simulation: Simulation) -> OwnController | None:
    source, scenario = simulation.controller_source, simulation.scenario
    if source is None:
        return None
    named = split_file_name(source.name)
    return OwnController(
        name=source.name if named is None else named.resolve(scenario.folder).text,
        level=source.level,
        sha256=source.sha256,
        files=source.hashes,
        version=source.version,
        parameters=source.resolve_values(scenario.controller_parameters, "controller_parameters"),
        again=not source.name.startswith(IN_MEMORY_PREFIX),
    )


def describe_integration(scenario: Scenario) -> Integration:
    """Return how the airframe of a flight is integrated: see :mod:`cosim.vehicle.airframe`."""
    return Integration(
        runs=scenario.substeps,
        run_s=scenario.step_s / scenario.substeps,
        rates=INTEGRATION_METHOD_NAMES[AIR_METHOD],
        velocities=INTEGRATION_METHOD_NAMES[AIR_METHOD],
        attitude=INTEGRATION_METHOD_NAMES[POSITION_METHODS["rotational"]],
        position=INTEGRATION_METHOD_NAMES[POSITION_METHODS["translational"]],
        on_ground=INTEGRATION_METHOD_NAMES[GROUND_METHOD],
    )


def find_reach(simulation: Simulation) -> Reach:
    """Return the command ranges of throttles and tilts: those of the built-in allocation, or of the actuators."""
    vehicle, limits = simulation.vehicle, simulation.vehicle.control.allocation
    jets = len(vehicle.jets)
    least, most = (0.0,) * jets, (1.0,) * jets
    if isinstance(simulation.controller, Cascade):
        least, most = (
            simulation.controller.thrust_map.throttle((throttle,) * jets)
            for throttle in (limits.throttle_min, limits.throttle_max)
        )
    return Reach(
        throttle=tuple(zip(least, most, strict=True)),
        tilt_rad=vehicle.servo.range_rad if vehicle.servo else None,
        servos=None if vehicle.servo else vehicle.ranges or None,
    )


def _engine_uncertainty(spec: EngineSpec) -> EngineUncertainty | None:
    if spec.uncertainty is None:
        return None
    rows = [UncertainParameter(**row._asdict(), flown=spec.parameters[row.name]) for row in spec.uncertain_ranges]
    return EngineUncertainty(source=spec.uncertainty.source, parameters=rows)


def _describe_station(spec: EngineSpec, reference: EngineSpec) -> StationEngine:
    curve = () if spec is reference else tuple(zip(spec.curve.throttle, spec.curve.thrust, strict=True))
    file = "" if spec.library else (spec.mapping or spec.path).name
    return StationEngine(engine=spec.name, sha256=spec.sha256, curve=curve, file=file, isolated=spec.isolated)


def _engine_hashes(specs: Sequence[EngineSpec]) -> dict[str, str]:
    """Return the hashes of all archives and mapping files by name, or by path if names clash."""
    hashes: dict[str, str] = {}
    for spec in specs:
        files = {spec.path: spec.sha256}
        if spec.mapping is not None:
            files[spec.mapping] = sha256(read_file(spec.mapping)).hexdigest()
        for path, value in files.items():
            name = path.name if hashes.get(path.name, value) == value else str(path)
            hashes[name] = value
    return hashes
