"""What several commands share: kinds of options, exit statuses, the scenario that a command line states."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from cosim.base.errors import InputError
from cosim.cli import opt

if TYPE_CHECKING:
    from cosim.spec.scenario import Scenario

DONE, FLIGHT_FAILED, WRONG_INPUT = 0, 1, 2


REPORTED = "told"  # note of an interruption: the command has reported what is kept


class Terminated(KeyboardInterrupt):
    """SIGTERM, by which a batch system or a service manager asks a process to end."""


@contextmanager
def treat_sigterm_as_interrupt() -> Iterator[None]:
    """Answer SIGTERM, and the end of the terminal (SIGHUP), as Ctrl-C is answered; not what is ignored (nohup)."""

    def end(number: int, frame: object) -> None:
        raise Terminated

    handlers = {}
    if threading.current_thread() is threading.main_thread():  # only the main thread may set signal handlers
        for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):  # not every system has the second
            if signal.getsignal(number) is not signal.SIG_IGN:
                handlers[number] = signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def example(text: str) -> str:
    """Return what click shows of an example below a command's options."""
    return f"\b\nExample:\n  {text}"


class Flight(opt.Record):
    """What flies: a scenario, and what a command line writes over it."""

    scenario: str = "hover"
    controller: str | None = None
    aircraft: str | None = None
    engines: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    model: Path | None = None
    seed: int | None = None
    metrics: tuple[str, ...] = ()
    own_observers: tuple[str, ...] = ()
    sensors: str | None = None
    wind: str | None = None
    unchecked_engine: bool = False

    def load(self) -> Scenario:
        """Return the scenario with the choices of the command line.  Raises InputError for a wrong one."""
        scenario = load_scenario(
            self.scenario, self.controller, self.engines, self.seed, self.settings, self.model, self.aircraft
        )
        changes = plugin_changes(self.metrics, self.own_observers, self.sensors, self.wind)
        if self.sensors or self.wind:  # its expectations do not apply with them
            changes["expect"] = []
        if self.unchecked_engine:
            changes["engine_unchecked"] = True
        return scenario.replace(**changes) if changes else scenario


def is_given(name: str) -> bool:
    """Return whether an option of the running command is on its command line."""
    return click.get_current_context().get_parameter_source(name) is ParameterSource.COMMANDLINE


def refuse_others(why: str, *allowed: str) -> None:
    """Refuse what was given on the command line and is not allowed beside the rest, and say ``why``."""
    for parameter in click.get_current_context().command.params:
        name = parameter.name or ""
        if name not in (*allowed, "trust") and is_given(name):
            option = max(parameter.opts, key=len)
            raise InputError(f"{option}: {why}")


def offer_to_compile(*engines: str) -> None:
    """Ask once, on a terminal, whether an FMU that brings sources alone is to be compiled; elsewhere say nothing.

    Raises InputError if it is and cannot be.
    """
    import sys

    for engine in engines:
        path = Path(engine.partition("=")[2] or engine)
        if path.suffix.lower() != ".fmu" or not (sys.stdin.isatty() and sys.stderr.isatty()):
            continue
        from cosim.engine.make.compile import compile_archive, needs_compiling

        question = f"{path} has sources and no library for this machine; compile them into it?"
        if needs_compiling(path) and click.confirm(question, err=True):
            compile_archive(path)


def warn_of_fmu_defects(*engines: str, folder: Path = Path()) -> None:
    """Tell on standard error what of a foreign FMU's description, seen from ``folder``, is not as FMI has it."""
    from cosim.spec.vehicle import is_file

    for engine in dict.fromkeys(engines):
        if is_file(engine):
            from cosim.engine.qualify.check import note_harmless_violations
            from cosim.engine.spec import find_source

            for line in note_harmless_violations(find_source(str(folder / engine)).archive):
                click.echo(f"hexjet: warning: {engine}: {line}", err=True)


def load_scenario(
    name: str,
    controller: str | None,
    engines: tuple[str, ...],
    seed: int | None,
    settings: tuple[str, ...],
    model: Path | None = None,
    aircraft: str | None = None,
) -> Scenario:
    """Return the scenario with the command line's choices written over it."""
    from cosim.spec.controller_name import is_design, seen_from
    from cosim.spec.scenario import Scenario

    designed = Path(controller) if controller is not None and is_design(controller) else None
    if designed is not None:
        from cosim.simulation.controllers.controller_file import apply_controller

        scenario, controller = apply_controller(name, designed, settings, aircraft), None
    else:
        scenario = Scenario.read(name, list(settings))
    changes: dict[str, Any] = {}
    if aircraft is not None:
        from cosim.spec.vehicle import aircraft_seen_from, engine_of

        aircraft = aircraft_seen_from(aircraft, Path())
        changes |= {"aircraft": aircraft, "engine": engine_of(aircraft) or scenario.engine}
        if controller is None and model is None and designed is None and "controller" not in _keys_of(settings):
            changes |= _controller_without_a_model(aircraft, scenario)
    if controller is not None:
        # a file on the command line is meant from here, one in the scenario from the scenario's folder
        changes["controller"] = seen_from(controller, Path())
        if any(text.strip().startswith("controller_parameters") for text in settings):
            changes["controller_parameters"] = scenario.controller_parameters
    chosen = engine_choices(engines)
    if "engine" in chosen and scenario.stations:
        scenario = scenario.model_copy(update={"stations": {}, "expect": []})  # one for all
    changes |= chosen
    if seed is not None:
        changes["seed"] = seed
    if model is not None:
        from cosim.spec.scenario import parameter_files
        from cosim.spec.vehicle import read_models

        changes["vehicle"] = {"identified": read_models(model)}
        changes["parameter_files"] = parameter_files(scenario.parameter_files, "models", model)
    if settings or model is not None or designed is not None or "stations" in chosen:
        changes["expect"] = []
    scenario = scenario.replace(**changes) if changes else scenario
    scenario.resolved_vehicle()  # a wrong key is told before anything is built
    return scenario


def _keys_of(settings: tuple[str, ...]) -> set[str]:
    """Return the keys of ``--set`` that are the scenario's own."""
    return {text.partition("=")[0].strip() for text in settings}


def _controller_without_a_model(aircraft: str, scenario: Any) -> dict[str, str]:
    """Return the baseline where the predictor needs a model and the other aircraft states none; print a note."""
    from cosim.control.predictors.registry import BASELINE, PREDICTORS
    from cosim.spec.vehicle import load_vehicle

    spec = PREDICTORS.get(scenario.controller)
    if spec is None or not spec.needs_model:
        return {}
    vehicle, _ = load_vehicle(aircraft)
    if vehicle.identified or scenario.vehicle.get("identified"):
        return {}
    click.echo(
        f"hexjet: note: {vehicle.name} states no identified model, which controller {scenario.controller} needs; "
        f"flown with {BASELINE.name}",
        err=True,
    )
    return {"controller": BASELINE.name}


def plugin_changes(
    metrics: tuple[str, ...], observers: tuple[str, ...] = (), sensors: str | None = None, wind: str | None = None
) -> dict[str, Any]:
    """Return the user's blocks as changes of a scenario; a file on the command line is meant from here."""
    from cosim.spec.controller_name import seen_from

    def here(name: str) -> str:
        return str(Path(name).absolute()) if name.lower().endswith(".csv") else seen_from(name, Path())

    changes: dict[str, Any] = {"metrics": [here(name) for name in metrics]} if metrics else {}
    changes |= {"observers": [here(name) for name in observers]} if observers else {}
    return changes | {key: here(name) for key, name in (("sensors", sensors), ("wind", wind)) if name is not None}


def plugin_settings(metrics: tuple[str, ...], wind: str | None = None) -> list[str]:
    """Return the same as settings of a study, ``KEY=VALUE``."""

    return [f"{key}={json.dumps(value)}" for key, value in plugin_changes(metrics, wind=wind).items()]


def engine_for(aircraft: str, engine: str | None) -> str:
    """Return the engine that is named, or else the aircraft's own.  Raises InputError where it has none."""
    from cosim.spec.vehicle import aircraft_seen_from, engine_of

    chosen = engine or engine_of(aircraft_seen_from(aircraft, Path()))
    if chosen is None:
        raise InputError(f"{aircraft}: vehicle.toml names no engine: name one with --engine")
    return chosen


def aircraft_settings(aircraft: str | None) -> list[str]:
    """Return another aircraft with the engine that it is made for as settings of a study; a path is meant from here."""

    from cosim.spec.vehicle import aircraft_seen_from, engine_of

    if aircraft is None:
        return []
    aircraft = aircraft_seen_from(aircraft, Path())
    engine = engine_of(aircraft)
    with_engine = [] if engine is None else [f"engine={json.dumps(engine)}"]
    return [f"aircraft={json.dumps(aircraft)}", *with_engine]


def engine_choices(texts: tuple[str, ...]) -> dict[str, Any]:
    """Return ``NAME`` or ``N=NAME`` texts as changes of a scenario.  Raises InputError if one is named twice."""
    from cosim.spec.vehicle import file_seen_from

    changes: dict[str, Any] = {}
    for text in texts:
        number, equals, name = text.partition("=")
        station = number.strip() if equals and number.strip().isdigit() else None
        engine = (name if station else text).strip()
        # a file on the command line is meant from here, one in the scenario from the scenario's folder
        engine = file_seen_from(engine, Path())
        target = changes if station is None else changes.setdefault("stations", {}).setdefault(station, {})
        if "engine" in target:
            raise InputError(
                f"--engine {text}: there is already another for {f'station {station}' if station else 'all'}"
            )
        target["engine"] = engine
    return changes
