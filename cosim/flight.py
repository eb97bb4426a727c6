"""One flight from a scenario to a finished run."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any

from cosim.base.errors import FlightError, InputError, nearest
from cosim.base.protocols import Observer
from cosim.base.runtime import kernels
from cosim.base.storage.toml import read_toml, toml_text
from cosim.control.cascade import Cascade
from cosim.control.predictors.registry import PREDICTORS
from cosim.engine import EngineSpec, engine_names, load_engine
from cosim.engine.spec import find_source
from cosim.results.autopilot.autopilot_record import PilotRecord
from cosim.results.autopilot.request_log import REQUESTS, Replay, read_requests
from cosim.results.limits import yardstick
from cosim.results.log.columns import log_columns, logged_vehicle
from cosim.results.log.recorder import KeepingSink
from cosim.results.metrics import Reach, metric_names
from cosim.results.run import AUTOPILOT, REPORT, RUN_FILES, Recording, Run, begin_run
from cosim.results.summary import (
    DelayRow,
    Integration,
    OwnController,
    ParametersRecord,
    PluginRecord,
    Setup,
    StationEngine,
    now,
    versions,
)
from cosim.simulation.build import build
from cosim.simulation.code import need_trust_of
from cosim.simulation.controllers.controller_file import design_notes, with_controller
from cosim.simulation.controllers.source import OBJECT, Source, of_object
from cosim.simulation.controllers.source import names as own_controllers
from cosim.simulation.ending import Ending
from cosim.simulation.model_agreement import flight_notes
from cosim.simulation.notes import idle_notes
from cosim.simulation.pacing import Pace
from cosim.simulation.plugins import Plugins, metrics_of
from cosim.simulation.step import Simulation
from cosim.simulation.with_autopilot import with_autopilot
from cosim.spec.controller_name import FileName, file_name, is_design, label, seen_from
from cosim.spec.scenario import (
    CommandEntry,
    Expectation,
    Scenario,
    Station,
    SticksCommand,
    TableCommand,
    TrackCommand,
    changes_of,
    copied_parameters,
    flown_parameters,
)
from cosim.spec.vehicle import VEHICLE, aircraft_names, as_read, is_file, is_own, load_vehicle
from cosim.spec.vehicle.sensor_profile import profile_words
from cosim.vehicle.airframe import (
    IN_THE_AIR,
    METHODS,
    ON_THE_GROUND,
    POSITIONS,
)
from cosim.vehicle.model_file import read_model


def fly(
    scenario: Scenario | str | Path,
    out: Path | str | None = None,
    *,
    controller: Any = None,
    observers: Sequence[Observer] = (),
    realtime_factor: float | None = None,
    report: bool = True,
    shared_assets: bool = False,
    watch: Callable[[Simulation, Pace, Path | None, float | None], Observer] | None = None,
    sink: KeepingSink | None = None,
) -> Run:
    """Fly a scenario to its end, record every step, and give back the finished run.

    A crash, a divergence or a failing engine is an outcome, not an exception.

    Parameters
    ----------
    scenario : Scenario or str or Path
        Who flies, what is asked of it and what disturbs it; or its name, or the path of its file.
    out : Path or str or None
        The run's folder, made if need be; without it the log stays in memory.
    controller : str or Path or object or None
        In place of the scenario's: a name or a file as ``hexjet fly --controller`` takes it, one of ``hexjet design``
        among them; or a class or an object of one's own, see docs/own-controller.md.
    observers : sequence of Observer
        They see every step.
    realtime_factor : float or None
        Seconds of flight in a second of the clock, 1.0 is real time; None: as fast as it goes.
    report : bool
        Whether ``report.html`` is written into the folder.
    shared_assets : bool
        Whether what draws that page goes into one folder beside those of runs, rather than into each page.
    watch : callable or None
        Makes a further observer of the flight when it is built, from the simulation, its pace, the folder and the
        planned duration [s].
    sink : KeepingSink or None
        Keeps of the log what it wants to, at least the columns of :func:`cosim.results.metrics.columns`.

    Returns
    -------
    Run
        Summary and log; every column is one float64 a control step, in the unit that its name says.

    Raises
    ------
    InputError
        If the scenario, the vehicle, the engine or the folder is not usable; nothing is written then.
    """
    scenario, own = opened(scenario, controller)
    need_trust_of(scenario)  # before its metrics are asked for their names
    check_expected(scenario)
    with build(scenario, own) as simulation:
        replay = pilot = None
        if scenario.requests is not None:
            pilot = with_autopilot(simulation, not scenario.initial.on_ground)
            replay = Replay(pilot, read_requests(scenario.folder / scenario.requests))
        folder = None if out is None else Path(out)
        recording = record(simulation, folder, sink=sink)
        noting = PilotRecord(pilot, folder / AUTOPILOT, simulation.dt) if pilot is not None and folder else None
        pace = Pace(simulation.dt, realtime_factor)
        watching = [*simulation.plugins.observers, *observers, *([noting] if noting else [])]
        watching += [watch(simulation, pace, folder, realtime_factor)] if watch else []
        begin = time.perf_counter()
        try:
            ending = simulation.run([recording, *watching], pace if realtime_factor or watch else None, replay)
            if noting is not None:
                noting.close()
            simulation.plugins.close()
        except FlightError as error:  # the log cannot be written: the disk is full, say
            ending = Ending("failed", str(error))
        except KeyboardInterrupt:
            if sink is not None:  # whoever keeps a flight for itself flies more than one, and is to stop altogether
                raise
            ending = Ending("failed", f"interrupted at {simulation.k * simulation.dt:.3f} s")
        wall = time.perf_counter() - begin
        if noting is not None:
            with suppress(FlightError):  # it has been told
                noting.close()
        reason = ending.reason
        if replay is not None and replay.otherwise:
            reason += f"; {len(replay.otherwise)} requests were answered otherwise, the first: {replay.otherwise[0]}"
        if simulation.faults.commanded and replay is None:  # faults came by command
            recording.restate(resolve(simulation)[0])
        recording.repeats(simulation.repeats())
        run = recording.finish(ending.outcome, reason, wall, pace.report if realtime_factor else None)
        return with_page(run, shared_assets) if report else run


def opened(scenario: Scenario | str | Path, controller: Any = None) -> tuple[Scenario, Source | None]:
    """Return a scenario with the controller to fly, and that controller where a program handed it over.

    The parameters are those of :func:`fly`.  Raises InputError.
    """
    if isinstance(controller, (str, Path)) and is_design(str(controller)):
        return with_controller(scenario, Path(controller)), None
    if not isinstance(scenario, Scenario):
        scenario = Scenario.load(scenario)
    if controller is None:
        return scenario, None
    if isinstance(controller, (str, Path)):
        return scenario.replace(controller=seen_from(str(controller), Path())), None
    own = of_object(controller)
    return scenario.replace(controller=own.name), own


def with_page(run: Run, shared_assets: bool = False) -> Run:
    """Write the page of a run beside its log where it has a folder; return the run.  Raises FlightError."""
    if run.folder is not None:
        from cosim.results.report.flight import write_report

        write_report(run, run.folder / REPORT, shared_assets)
    return run


def record(
    simulation: Simulation,
    folder: Path | None,
    contents: Mapping[str, Path | bytes] | None = None,
    background: bool = False,
    sink: KeepingSink | None = None,
) -> Recording:
    """Begin the recording of a flight, in ``folder`` or in memory; ``contents`` are those of files of the scenario.

    ``sink`` may keep less in memory than all.  ``background``: a thread writes the rows.  Raises InputError if the
    folder is not usable.
    """
    resolved, files = resolve(simulation)
    columns = log_columns(logged_vehicle(simulation.vehicle), simulation.columns)
    files |= dict(contents or {})
    metrics = simulation.plugins.metrics
    setup = _setup(simulation, resolved)
    if folder is None:  # nothing is copied: its parameter files are where they were
        scenario = simulation.scenario
        resolved = resolved.resolved(parameter_files=[f.seen_from(scenario.folder) for f in scenario.parameter_files])
    return begin_run(setup, resolved, folder, files, background, sink, columns, metrics)


def resolve(simulation: Simulation) -> tuple[Scenario, dict[str, Path | bytes]]:
    """Return the scenario as it flies, with all numbers of vehicle and engines, and the files to go beside it."""
    scenario = simulation.flown
    files: dict[str, Path | bytes] = {}
    if scenario.requests is not None:
        files[REQUESTS] = scenario.folder / scenario.requests
    commands: list[CommandEntry] = []
    for index, entry in enumerate(scenario.command):
        if isinstance(entry, (TableCommand, SticksCommand, TrackCommand)):
            source = scenario.folder / entry.file
            name = source.name if source.name not in files else f"{index}-{source.name}"
            files[name] = source
            entry = entry.model_copy(update={"file": name})
        commands.append(entry)
    parameters = flown_parameters(simulation.scenario)
    own = simulation.own
    controller: dict[str, Any] = _plugin_names(simulation.plugins, files)
    if own is not None:
        controller |= {"controller": copied_controller(own, files), "controller_sha256": own.sha256 or None}
        told = own.values(scenario.controller_parameters, "controller_parameters")
        controller["controller_parameters"] = _floats(told)
    aircraft, vehicle, names = copied_aircraft(simulation, files)
    engine, jets = simulation.engine, simulation.vehicle.jets
    # each part was checked when the scenario was read, so nothing is checked once more
    return scenario.resolved(
        **{
            **controller,
            "parameter_files": copied_parameters(parameters, files, RUN_FILES),
            "changed": changes_of(simulation.scenario, parameters),
            "command": commands,
            "engine": names[id(engine)],
            "engine_parameters": _floats(engine.parameters),
            "stations": {
                str(number): Station(engine=names[id(station)], parameters=_floats(station.parameters))
                for number, station in enumerate(simulation.stations, 1)
                if station.source != engine.source or jets[number - 1].engine is not None
            },
            "aircraft": aircraft,
            "expect": [
                entry.model_copy(update={"aircraft": aircraft}) if entry.aircraft == scenario.aircraft else entry
                for entry in scenario.expect
            ],
            "vehicle": vehicle,
            **({"requests": REQUESTS} if scenario.requests is not None else {}),
        }
    ), files


def copied_aircraft(
    simulation: Simulation, files: dict[str, Path | bytes]
) -> tuple[str, dict[str, Any], dict[int, str]]:
    """Return the name of the aircraft beside a resolved scenario, its numbers, and the names of the engines there.

    The engines are those of their specs' ids; files of the user's, of aircraft and engines, are added to ``files``.

    Raises InputError where another file has the name of one of its own.
    """
    scenario, specs = simulation.flown, [simulation.engine, *simulation.stations]
    stated = simulation.vehicle.model_dump(mode="json", exclude_none=True)
    if not is_own(scenario.aircraft):
        return scenario.aircraft, stated, engine_files(specs, files)
    _, folder = scenario.resolved_vehicle()
    table, own = as_read(scenario.aircraft, scenario.folder), dict[str, Path | bytes]()
    model = simulation.vehicle.model
    if model is not None:
        own[Path(model).name] = read_model(folder / model)
        renamed = {"model": Path(model).name}
        table, stated = table | renamed, stated | renamed
    own[VEHICLE] = b""
    for name in own:
        if name in files:
            raise InputError(f"aircraft {scenario.aircraft_name}: another file of the flight has the name {name!r}")
    files |= own
    names = engine_files(specs, files)
    called = {(spec.mapping or spec.path).resolve(): names[id(spec)] for spec in specs}
    table, stated = (_with_engines(aircraft_table, folder, called) for aircraft_table in (table, stated))
    files[VEHICLE] = toml_text(_written(table)).encode()
    return VEHICLE, stated, names


def _with_engines(table: dict[str, Any], folder: Path, called: Mapping[Path, str]) -> dict[str, Any]:
    """Return a vehicle's table, its engine files seen from ``folder``, by their names beside a scenario.

    An engine that does not fly is left out.
    """

    def renamed(part: dict[str, Any]) -> dict[str, Any]:
        engine = part.get("engine")
        if engine is None or not is_file(engine):
            return part
        name = called.get((folder / engine).resolve())
        return {key: value for key, value in part.items() if key != "engine"} | ({"engine": name} if name else {})

    jets = {"jets": [renamed(jet) for jet in table["jets"]]} if "jets" in table else {}
    return renamed(table) | jets


def copied_vehicle(aircraft: str, folder: Path, files: dict[str, Path | bytes]) -> str:
    """Return the name of one of several aircraft of the user's beside a scenario, whose files are added to ``files``.

    Its files begin with its name.  Raises InputError as :func:`cosim.spec.vehicle.load_vehicle`, for its engine, and
    where another file has the name of one of them.
    """
    vehicle, place = load_vehicle(aircraft, folder=folder)
    table, own = as_read(aircraft, folder), dict[str, Path | bytes]()
    if vehicle.model is not None:
        name = f"{vehicle.name}-{Path(vehicle.model).name}"
        own[name] = read_model(place / vehicle.model)
        table = table | {"model": name}
    stated = {
        engine: None for engine in (vehicle.engine, *(jet.engine for jet in vehicle.jets)) if engine and is_file(engine)
    }
    step, sources = vehicle.control_step, [place / engine for engine in stated]
    specs = {source.resolve(): load_engine(str(source), {}, step, apart=True) for source in sources}
    names = engine_files(list(specs.values()), files)
    table = _with_engines(table, place, {source: names[id(spec)] for source, spec in specs.items()})
    own[f"{vehicle.name}-{VEHICLE}"] = toml_text(_written(table)).encode()
    for name in own:
        if name in files:
            raise InputError(f"aircraft {vehicle.name}: another file has the name {name!r}")
    files |= own
    return f"{vehicle.name}-{VEHICLE}"


def _written(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table without the None that TOML cannot express."""
    return {
        key: _written(value) if isinstance(value, Mapping) else value
        for key, value in table.items()
        if value is not None
    }


def _plugin_names(plugins: Plugins, files: dict[str, Path | bytes]) -> dict[str, Any]:
    """Return the blocks beside the controller, by what they are called beside a resolved scenario, and their hashes."""
    stated: dict[str, Any] = {}
    hashes: dict[str, str] = {}
    for key, sources in plugins.sources.items():
        names = [copied_controller(source, files) for source in sources]
        stated[key] = names if key in ("metrics", "observers") else names[0]
        hashes |= {name: source.sha256 for name, source in zip(names, sources, strict=True)}
    return stated | ({"own_sha256": hashes} if hashes else {})


def _floats(values: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in values.items()}


def copied_controller(own: Source, files: dict[str, Path | bytes]) -> str:
    """Return the name of a controller beside a resolved scenario; the files it is made of are added to ``files``.

    Raises InputError where another file has the name of one that it imports.
    """
    named = file_name(own.name) or FileName("", own.name, "") if own.files and own.copied else None
    if named is None:
        return own.name
    first, *others = own.files.items()
    name, number = first[0], len(files)
    while name in files and files[name] != first[1]:
        name, number = f"{number}-{first[0]}", number + 1
    files[name] = first[1]
    for each, path in others:
        if files.setdefault(each, path) != path:
            raise InputError(f"{own.label}: imports {each}, and another file has this name already")
    return named._replace(file=name).text


def engine_files(specs: Sequence[EngineSpec], files: dict[str, Path | bytes]) -> dict[int, str]:
    """Return the name of each spec (by its id) beside a resolved scenario; foreign ones add their files to ``files``.

    A mapping file goes along with its archive and names that archive there.
    """
    noted = {held.resolve(): name for name, held in files.items() if isinstance(held, Path)}
    copied: dict[Path, str] = {}

    def copy(source: Path, content: Path | bytes) -> str:
        place = source.resolve()
        if place not in copied:
            name, number = noted.get(place, source.name), len(copied)
            while name in files and name != noted.get(place):  # files of one name from several folders
                name, number = f"{number}-{source.name}", number + 1
            copied[place] = name
            files[name] = content
        return copied[place]

    names = {}
    for spec in specs:
        if spec.library:
            names[id(spec)] = spec.name
            continue
        archive = copy(spec.path, spec.path)
        names[id(spec)] = archive if spec.mapping is None else copy(spec.mapping, _mapping(spec.mapping, archive))
    return names


def _mapping(path: Path, archive: str) -> Path | bytes:
    """Return a mapping file as it is, or written anew with this name of its archive and its parameter set's values."""
    stated = read_toml(path)
    if "parameter_set" in stated:
        del stated["parameter_set"]
        stated["parameters"] = find_source(str(path)).mapping.parameters
    elif stated["fmu"] == archive:
        return path
    return toml_text(stated | {"fmu": archive}).encode()


def _setup(simulation: Simulation, resolved: Scenario) -> Setup:
    scenario, engine = simulation.scenario, simulation.engine
    flown = flown_parameters(scenario)
    parameters = [
        ParametersRecord(kind=each.kind, file=copy.file, sha256=copy.sha256, controller=each.controller,
                         changed=tuple(each.changed))
        for each, copy in zip(flown, resolved.parameter_files, strict=True)
    ]  # fmt: skip
    model = simulation.vehicle.model or f"{simulation.vehicle.name}.xml"
    model = Path(model).name if is_own(scenario.aircraft) else model
    return Setup(
        scenario=scenario.name,
        title=scenario.title,
        description=scenario.description,
        changed=resolved.changed,
        parameter_files=parameters,
        aircraft=scenario.aircraft_name,
        engine=engine.name,
        controller=label(scenario.controller),
        own_controller=_own_controller(simulation),
        brought=[
            PluginRecord(key=key, name=source.label, sha256=source.sha256, files=source.hashes, version=source.version)
            for key, sources in simulation.plugins.sources.items()
            for source in sources
        ],
        seed=scenario.seed,
        sensors=profile_words(scenario.sensor_profile),
        step_s=scenario.step_s,
        integration=integration(scenario),
        planned_s=scenario.duration_s,
        started=now(),
        engine_curve=list(zip(engine.curve.throttle, engine.curve.thrust, strict=True)),
        stations=[_station(station, engine) for station in simulation.stations],
        jets_m=[jet.position_m for jet in simulation.vehicle.jets],
        delay_ledger=[DelayRow(**asdict(row)) for row in simulation.ledger],
        reach=reach(simulation),
        yardstick=yardstick(scenario, simulation.vehicle),
        expectation=expectation(scenario),
        notes=[
            *design_notes(flown, engine),
            *flight_notes(scenario, simulation.vehicle, engine),
            *idle_notes(scenario, simulation.vehicle, simulation.stations),
        ],
        versions=versions(),
        blas_kernels=kernels.loaded(),
        sha256={
            model: simulation.airframe.file_sha256,
            f"{model} as flown": simulation.airframe.sha256,
            **_engine_hashes([engine, *simulation.stations]),
            **{file.file: file.sha256 for file in resolved.parameter_files},
            **(simulation.own.hashes if simulation.own is not None else {}),
            **{
                n: h
                for sources in simulation.plugins.sources.values()
                for source in sources
                for n, h in source.hashes.items()
            },
        },
    ).retitled()


def _own_controller(simulation: Simulation) -> OwnController | None:
    own, scenario = simulation.own, simulation.scenario
    if own is None:
        return None
    named = file_name(own.name)
    return OwnController(
        name=own.name if named is None else named.seen_from(scenario.folder).text,
        level=own.level,
        sha256=own.sha256,
        files=own.hashes,
        version=own.version,
        parameters=own.values(scenario.controller_parameters, "controller_parameters"),
        again=not own.name.startswith(OBJECT),
    )


def integration(scenario: Scenario) -> Integration:
    """Return how the airframe of a flight is integrated: see :mod:`cosim.vehicle.airframe`."""
    return Integration(
        runs=scenario.substeps,
        run_s=scenario.step_s / scenario.substeps,
        rates=METHODS[IN_THE_AIR],
        velocities=METHODS[IN_THE_AIR],
        attitude=METHODS[POSITIONS["rotational"]],
        position=METHODS[POSITIONS["translational"]],
        on_ground=METHODS[ON_THE_GROUND],
    )


def reach(simulation: Simulation) -> Reach:
    """Return the range of the throttles and tilts of a flight: by the built-in allocation, or at all."""
    vehicle, limits = simulation.vehicle, simulation.vehicle.control.allocation
    jets = len(vehicle.jets)
    least, most = (0.0,) * jets, (1.0,) * jets
    if isinstance(simulation.controller, Cascade):
        least, most = (
            simulation.controller.thrust_map.throttle((share,) * jets)
            for share in (limits.throttle_min, limits.throttle_max)
        )
    return Reach(
        throttle=tuple(zip(least, most, strict=True)),
        tilt_rad=vehicle.servo.range_rad if vehicle.servo else None,
        servos=None if vehicle.servo else vehicle.ranges or None,
    )


def _station(spec: EngineSpec, reference: EngineSpec) -> StationEngine:
    curve = () if spec is reference else tuple(zip(spec.curve.throttle, spec.curve.thrust, strict=True))
    file = "" if spec.library else (spec.mapping or spec.path).name
    return StationEngine(engine=spec.name, sha256=spec.sha256, curve=curve, file=file, apart=spec.misbehaves)


def _engine_hashes(specs: Sequence[EngineSpec]) -> dict[str, str]:
    """Return the hashes of every archive and mapping file, by name; what differs under one name, by path."""
    hashes: dict[str, str] = {}
    for spec in specs:
        files = {spec.path: spec.sha256}
        if spec.mapping is not None:
            files[spec.mapping] = sha256(spec.mapping.read_bytes()).hexdigest()
        for path, value in files.items():
            name = path.name if hashes.get(path.name, value) == value else str(path)
            hashes[name] = value
    return hashes


def check_expected(scenario: Scenario) -> None:
    """Refuse expectations that nothing could meet: of an unknown controller, engine or metric (InputError)."""
    allowed_metrics = known_metrics(scenario)
    for index, entry in enumerate(scenario.expect):
        where = f"scenario {scenario.name}: expect.{index}"
        known = (
            ("controller", [entry.controller], _controllers_like(entry.controller)),
            ("aircraft", [] if is_own(entry.aircraft) else [entry.aircraft], aircraft_names()),
            ("metrics", list(entry.metrics), allowed_metrics),
        )
        for key, names, allowed in known:
            for name in names:
                if name not in allowed:
                    raise InputError(f"{where}.{key}: unknown {name!r}; {nearest(name, allowed)}")
        if not is_file(entry.engine):
            plain = entry.engine.removesuffix("-fmi2")
            if plain not in engine_names():
                raise InputError(f"{where}.engine: unknown {entry.engine!r}; {nearest(plain, engine_names())}")


def known_metrics(scenario: Scenario) -> list[str]:
    """Return the names of the built-in metrics and of the scenario's own.  Raises InputError."""
    return [*metric_names(), *(name for metric in metrics_of(scenario) for name in metric.names)]


def _controllers_like(controller: str) -> list[str]:
    """Return the names of the built-in ones, and this one where it is named as a user's is."""
    if controller in PREDICTORS or ":" in controller or file_name(controller):
        return [*PREDICTORS, controller]
    return [*PREDICTORS, *(name for name, _ in own_controllers())]


def expectation(scenario: Scenario) -> Expectation | None:
    """Return what the scenario expects of its controller with its engine on its aircraft, if it does."""
    flown = (scenario.controller, scenario.engine, scenario.aircraft)
    return next((e for e in scenario.expect if (e.controller, e.engine, e.aircraft) == flown), None)


def new_folder(parent: Path, name: str) -> Path:
    """Return ``parent/name-001``, or the first number that is free."""
    number = 1
    while (folder := parent / f"{name}-{number:03d}").exists():
        number += 1
    return folder


def reserve_folder(parent: Path, name: str) -> Path:
    """Make the folder of :func:`new_folder` at once: two that ask at the same time get two.  Raises InputError."""
    while True:
        folder = new_folder(parent, name)
        try:
            parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir()
        except FileExistsError:
            if not parent.is_dir():
                raise InputError(f"{parent}: is no folder") from None
        except OSError as error:
            raise InputError(f"{folder}: {error.strerror or error}") from error
        else:
            return folder
