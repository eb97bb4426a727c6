"""One flight from a scenario to a finished run."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from cosim.config import nearest
from cosim.control.choice import PREDICTORS
from cosim.engine import engine_names
from cosim.errors import FlightError, InputError
from cosim.metrics import metric_names
from cosim.run import DelayRow, Recording, Run, Setup, begin_run, now, versions
from cosim.scenario import Expectation, Scenario, SticksCommand, TableCommand
from cosim.simulation import Ending, Observer, Simulation, build


def fly(
    scenario: Scenario,
    out: Path | str | None = None,
    *,
    observers: Sequence[Observer] = (),
    realtime_factor: float | None = None,
    report: bool = True,
) -> Run:
    """Fly a scenario to its end, record every step, and give back the finished run.

    ``out`` is the run's folder, made if need be; without it the log stays in memory.  ``observers`` see every step.
    ``realtime_factor`` paces the flight (1.0 is real time).  A crash, a divergence or a failing engine is an outcome,
    not an exception.

    Raises InputError if the scenario, the vehicle, the engine or the folder is not usable; nothing is written then.
    """
    check_expected(scenario)
    with build(scenario) as simulation:
        recording = record(simulation, None if out is None else Path(out))
        begin = time.perf_counter()
        try:
            ending = simulation.run([recording, *observers], realtime_factor)
        except FlightError as error:  # the log cannot be written: the disk is full, say
            ending = Ending("failed", str(error))
        except KeyboardInterrupt:
            ending = Ending("failed", f"interrupted at {simulation.k * simulation.dt:.3f} s")
        return recording.finish(ending.outcome, ending.reason, time.perf_counter() - begin, report)


def record(simulation: Simulation, folder: Path | None) -> Recording:
    """Begin the recording of a flight, in ``folder`` or in memory.  Raises InputError if the folder is not usable."""
    resolved, files = resolve(simulation)
    return begin_run(_setup(simulation), resolved, folder, files)


def resolve(simulation: Simulation) -> tuple[Scenario, dict[str, Path]]:
    """The scenario as it flies, with every number of vehicle and engine in it, and the files to copy beside it."""
    scenario = simulation.scenario
    files: dict[str, Path] = {}
    commands = []
    for index, entry in enumerate(scenario.command):
        table = entry.model_dump(mode="json", exclude_none=True)
        if isinstance(entry, (TableCommand, SticksCommand)):
            source = scenario.folder / entry.file
            name = source.name if source.name not in files else f"{index}-{source.name}"
            files[name] = source
            table["file"] = name
        commands.append(table)
    engine = simulation.engine
    if not engine.library:
        files[engine.path.name] = engine.path
    data = scenario.model_dump(mode="json", exclude_none=True) | {
        "command": commands,
        "engine": engine.name if engine.library else engine.path.name,
        "engine_parameters": dict(engine.parameters),
        "vehicle": simulation.vehicle.model_dump(mode="json", exclude_none=True),
    }
    return Scenario.from_table(data, scenario.folder, f"scenario {scenario.name}"), files


def _setup(simulation: Simulation) -> Setup:
    scenario, engine = simulation.scenario, simulation.engine
    return Setup(
        scenario=scenario.name,
        title=scenario.title,
        description=scenario.description,
        aircraft=scenario.aircraft,
        engine=engine.name,
        controller=scenario.controller,
        seed=scenario.seed,
        step_s=scenario.step_s,
        planned_s=scenario.duration_s,
        started=now(),
        engine_curve=list(zip(engine.curve.throttle, engine.curve.thrust, strict=True)),
        jets_m=[jet.position_m for jet in simulation.vehicle.jets],
        delay_ledger=[DelayRow(**asdict(row)) for row in simulation.ledger],
        expectation=expectation(scenario),
        versions=versions(),
        sha256={
            simulation.vehicle.model: simulation.airframe.file_sha256,
            f"{simulation.vehicle.model} as flown": simulation.airframe.sha256,
            engine.path.name: engine.sha256,
        },
    )


def check_expected(scenario: Scenario) -> None:
    """Refuse expectations that nothing could meet: of an unknown controller, engine or metric (InputError)."""
    for index, entry in enumerate(scenario.expect):
        where = f"scenario {scenario.name}: expect.{index}"
        known = (("controller", [entry.controller], list(PREDICTORS)), ("metrics", list(entry.metrics), metric_names()))
        for key, names, allowed in known:
            for name in names:
                if name not in allowed:
                    raise InputError(f"{where}.{key}: unknown {name!r}; {nearest(name, allowed)}")
        if not entry.engine.lower().endswith(".fmu"):
            plain = entry.engine.removesuffix("-fmi2")
            if plain not in engine_names():
                raise InputError(f"{where}.engine: unknown {entry.engine!r}; {nearest(plain, engine_names())}")


def expectation(scenario: Scenario) -> Expectation | None:
    """What the scenario expects of its controller with its engine, if it says so."""
    for entry in scenario.expect:
        if entry.controller == scenario.controller and entry.engine == scenario.engine:
            return entry
    return None


def new_folder(parent: Path, name: str) -> Path:
    """``parent/name-001``, or the first number that is free."""
    number = 1
    while (folder := parent / f"{name}-{number:03d}").exists():
        number += 1
    return folder
