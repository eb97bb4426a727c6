"""hexjet fmu: engines built and checked."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.cli import opt
from cosim.cli.console import echo, output_to_stderr, say
from cosim.cli.groups import Group
from cosim.cli.options import DONE, FLIGHT_FAILED, example
from cosim.cli.outputs import Out

if TYPE_CHECKING:
    from cosim.api.checks import EngineCheckResult


@click.group(cls=Group)
def fmu() -> None:
    """Build and check engine FMUs."""


class Build(opt.Record):
    """Options of ``hexjet fmu build``."""

    engines: tuple[str, ...] = opt.argument(nargs=-1)


@fmu.command("build", epilog=example("hexjet fmu build turbojet"))
@opt.takes(Build)
def fmu_build(options: Build) -> int:
    """Build the FMUs of ENGINES, or of all, from their sources; those up to date are left alone."""
    from cosim.engine import build_engines

    for path in build_engines(list(options.engines) or None):
        echo(str(path))
    return DONE


class Check(opt.Output):
    """Options of ``hexjet fmu check``."""

    engine: str = opt.argument(metavar="NAME|FILE")
    step_s = opt.positive("--step", "S", "Control step.  [default: 0.004, or the library engine's]")
    settings = opt.words("--set", "PARAMETER=VALUE", "Set a parameter of the engine.")
    time_limit_s = opt.number("--time-limit", "S", "Time of the clock for the whole check.", min=1.0, default=120.0)
    out = opt.OUT
    as_json = opt.JSON


@fmu.command("check", epilog=example("hexjet fmu check their.fmu --step 0.004"))
@opt.takes(Check)
def fmu_check(options: Check) -> int:
    """Tell whether an FMU is fit to be an engine, and how it answers its throttle; of a controller, what it is.

    The FMU is run in a process of its own: if it crashes, hangs or eats memory, that is told and nothing else happens.
    Leaves check.json and a page with its static curve and step responses.  Status 0: fit; 1: unfit; 2: not usable.
    """
    from cosim.api.checks import CHECK, check_engine
    from cosim.engine.make.controller_fmu import is_controller

    engine = options.engine
    if is_controller(Path(engine)):
        return _check_controller(Path(engine), options)
    from cosim.engine import file_label

    options.check_out(*CHECK)
    result = check_engine(**options.chosen("engine", "step_s", "settings", "time_limit_s"))
    result.write(options.run_folder(f"check-{file_label(Path(engine))}"))
    options.answer(result.to_dict, lambda: print_check(result))
    return DONE if result.is_fit else FLIGHT_FAILED


def _check_controller(path: Path, output: opt.Output) -> int:
    """Print what a controller's FMU is told and answers, and whether a second of hover is twice the same."""
    from cosim.engine.make.controller_fmu import describe_controller, read_controller_fmu
    from cosim.flight import fly_watched as fly
    from cosim.spec.scenario import Scenario

    fmu = read_controller_fmu(path)
    description = describe_controller(fmu)
    with output_to_stderr(output.as_json):
        run = fly(Scenario.load("hover").replace(duration_s=1.0, expect=[], controller=str(path.absolute())))
    record = run.summary.own_controller
    report = {
        "controller": path.name,
        "fmi": fmu.fmi,
        "level": fmu.level,
        "inputs": list(fmu.inputs),
        "outputs": list(fmu.outputs),
        "parameters": [name for name, *_ in description["parameters"]],
        "columns": [name for name, *_ in description["columns"]],
        "notes": list(fmu.notes),
        "hover of 1 s": f"{run.outcome}, {run.reason}",
        "repeatable": record.repeatable if record is not None else None,
    }

    def show() -> None:
        for key, value in report.items():
            say(f"{key:14} {', '.join(value) if isinstance(value, list) else value}", wrap=False)

    output.answer(lambda: report, show)
    return DONE if run.outcome == "completed" and report["repeatable"] else FLIGHT_FAILED


def print_check(result: EngineCheckResult) -> None:
    """Print the findings, one to a line, problems last, and where the page is."""
    report = result.check
    lines = [f"{label:22} {value}" for label, value in report.lines()]
    for line in [*lines, *(f"problem: {problem}" for problem in report.problems), f"report: {result.report}"]:
        say(line, wrap=False)
    say(f"[bold]{'fit to fly' if report.ok else 'not fit to fly'}[/bold]", marked=True)


class Map(opt.Output):
    """Options of ``hexjet fmu map``."""

    fmu: Path = opt.argument(metavar="FILE.fmu", type=click.Path(path_type=Path))
    out = opt.out("[default: beside FILE.fmu, under its name]", "FILE.toml|DIR", Out(".toml"))
    as_json = opt.JSON


@fmu.command("map", epilog=example("hexjet fmu map their.fmu --out mine.toml"))
@opt.takes(Map)
def fmu_map(options: Map) -> int:
    """Begin the mapping file of an engine's FMU: the ports that are found, and what is to be stated of others.

    Nothing of the FMU is run.  Status 1: something is open that an engine needs.
    """
    from cosim.api.checks import map_engine

    result = map_engine(options.fmu, options.out)
    mapping = result.files["mapping"]

    def show() -> None:
        for line in [*result.lines(), f"mapping: {mapping}"]:
            say(line, wrap=False)
        say(f"next: hexjet fmu check {mapping}" if result.is_complete else f"next: state in {mapping} what is open")

    options.answer(result.to_dict, show)
    return DONE if result.is_complete else FLIGHT_FAILED
