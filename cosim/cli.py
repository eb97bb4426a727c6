"""The command line: arguments in, calls out."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from cosim.errors import FlightError, InputError

DONE, FLIGHT_FAILED, WRONG_INPUT = 0, 1, 2
KINDS = ("scenarios", "engines", "aircraft", "controllers")


def _example(text: str) -> str:
    return f"\b\nExample:\n  {text}"


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="hexjet-cosim", prog_name="hexjet")
def cli() -> None:
    """Co-simulation of the Hex-Jet: JSBSim airframe, FMU engines, predictor-based control."""


@cli.command(epilog=_example("hexjet fly roll-doublet --controller baseline --set vehicle.mass_kg=6.0"))
@click.argument("scenario")
@click.option("--controller", metavar="NAME", help="Overrides the scenario's; see: hexjet list controllers.")
@click.option("--engine", metavar="NAME|FILE.fmu", help="Overrides the scenario's; see: hexjet list engines.")
@click.option(
    "settings",
    "--set",
    metavar="KEY=VALUE",
    multiple=True,
    help="Write a value over the scenario's, e.g. vehicle.mass_kg=6.0; its expectations are not checked then.",
)
@click.option(
    "--model",
    type=click.Path(path_type=Path),
    metavar="FILE.toml",
    help="Predict with the identified models in this file, as hexjet identify writes it.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="The run's folder.  [default: a new one in runs/]"
)
@click.option("--seed", type=int, help="Overrides the scenario's seed.")
@click.option("--realtime", is_flag=True, help="Pace the flight in real time.")
@click.option("as_json", "--json", is_flag=True, help="Print the run's summary as one JSON object and nothing else.")
def fly(
    scenario: str,
    controller: str | None,
    engine: str | None,
    settings: tuple[str, ...],
    model: Path | None,
    out: Path | None,
    seed: int | None,
    realtime: bool,
    as_json: bool,
) -> int:
    """Fly SCENARIO: a name in scenarios/ or the path of a TOML file.

    Leaves a folder with summary, resolved scenario, log and report.  Status 0: flown as planned; 1: the flight failed
    or did not come to what the scenario expects; 2: wrong input.
    """
    from cosim.console import flight_progress, output_to_stderr, print_run
    from cosim.flight import fly as fly_scenario
    from cosim.flight import new_folder

    flown = load_scenario(scenario, controller, engine, seed, settings, model)
    folder = out if out is not None else new_folder(Path("runs"), f"{flown.name}-{flown.controller}")
    with output_to_stderr(as_json), flight_progress(flown, quiet=as_json) as observers:
        run = fly_scenario(flown, folder, observers=observers, realtime_factor=1.0 if realtime else None)
    if as_json:
        click.echo(json.dumps(run.summary.model_dump(mode="json"), allow_nan=False))
    else:
        print_run(run)
    return DONE if run.outcome == "completed" and run.summary.expectations_met is not False else FLIGHT_FAILED


def load_scenario(
    name: str,
    controller: str | None,
    engine: str | None,
    seed: int | None,
    settings: tuple[str, ...],
    model: Path | None = None,
) -> Any:
    """The scenario with the command line's choices written over it."""
    from cosim.scenario import Scenario

    scenario = Scenario.load(name, list(settings))
    changes: dict[str, Any] = {}
    if controller is not None:
        changes["controller"] = controller
    if engine is not None:
        # a file on the command line is meant from here, one in the scenario from the scenario's folder
        is_file = engine.lower().endswith(".fmu") or "/" in engine
        changes["engine"] = str(Path(engine).absolute()) if is_file else engine
    if seed is not None:
        changes["seed"] = seed
    if model is not None:
        from cosim.vehicle import read_models

        changes["vehicle"] = {"identified": read_models(model)}
    if settings or model is not None:
        changes["expect"] = []
    return scenario.replace(**changes) if changes else scenario


@cli.command("list", epilog=_example("hexjet list engines"))
@click.argument("kind", required=False, type=click.Choice(KINDS))
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object.")
def list_(kind: str | None, as_json: bool) -> int:
    """List what can be flown: scenarios, engines, aircraft, controllers."""
    from cosim.catalogue import catalogue
    from cosim.console import print_catalogue

    found = {name: catalogue(name) for name in ([kind] if kind else KINDS)}
    if as_json:
        click.echo(json.dumps(found))
    else:
        print_catalogue(found)
    return DONE


@cli.group()
def fmu() -> None:
    """Build and check engine FMUs."""


@fmu.command("build", epilog=_example("hexjet fmu build turbojet"))
@click.argument("engines", nargs=-1)
def fmu_build(engines: tuple[str, ...]) -> int:
    """Build the FMUs of ENGINES, or of all, from their sources; those up to date are left alone."""
    from cosim.engine import build_engines

    for path in build_engines(list(engines) or None):
        click.echo(str(path))
    return DONE


@fmu.command("check", epilog=_example("hexjet fmu check turbojet"))
@click.argument("engine", metavar="NAME|FILE.fmu")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object.")
def fmu_check(engine: str, as_json: bool) -> int:
    """Tell whether an FMU is fit to be an engine: validate it, run it through its throttle, measure its response."""
    from cosim.console import print_check
    from cosim.engine import check_fmu

    report = check_fmu(engine)
    if as_json:
        click.echo(json.dumps(report.to_dict(), allow_nan=False))
    else:
        print_check(report)
    return DONE if report.ok else FLIGHT_FAILED


@cli.group()
def identify() -> None:
    """Sweep an engine or an axis in flight, and fit a model with a delay to its response."""


def _sweep_options(command: Any) -> Any:
    for option in reversed(
        [
            click.option("--from-hz", type=float, metavar="HZ", help="Lowest frequency of the response."),
            click.option("--to-hz", type=float, metavar="HZ", help="Highest frequency of the response."),
            click.option("--amplitude", type=float, metavar="A", help="Of the sweep, in the unit of the command."),
            click.option("--duration", type=float, metavar="S", help="Of the sweep."),
            click.option("holds", "--hold", metavar="NAME=VALUE", multiple=True, help="Keep a parameter of the model."),
            click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="[default: a new one in runs/]"),
            click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else."),
        ]
    ):
        command = option(command)
    return command


@identify.command("engine", epilog=_example("hexjet identify engine turbojet --set delay_samples=40"))
@click.argument("name", metavar="NAME|FILE.fmu")
@click.option("--throttle", type=float, default=0.5, show_default=True, help="Around which it is swept.")
@click.option("--step", type=float, default=0.004, show_default=True, metavar="S", help="Sample time.")
@click.option("--lags", type=click.IntRange(0, 2), default=0, show_default=True, help="Lags beside the first pole.")
@click.option("settings", "--set", metavar="PARAMETER=VALUE", multiple=True, help="Set a parameter of the engine.")
@_sweep_options
def identify_engine(
    name: str, settings: tuple[str, ...], holds: tuple[str, ...], out: Path | None, as_json: bool, **choices: Any
) -> int:
    """Identify an engine, throttle to thrust: one pole and a delay.

    Band, amplitude and duration are chosen to suit the engine where they are not given.
    """
    from cosim.config import parse_numbers
    from cosim.identify import identify_engine as identify

    found = identify(name, parse_numbers(settings, "--set"), hold=parse_numbers(holds, "--hold"), **choices)
    return _finish_identification(found, out, f"identify-{Path(name).stem}", as_json)


def _identify_axis(
    axis: str, settings: tuple[str, ...], holds: tuple[str, ...], out: Path | None, as_json: bool, **choices: Any
) -> int:
    from cosim.config import parse_numbers
    from cosim.identify import identify_axis

    found = identify_axis(axis, settings=settings, hold=parse_numbers(holds, "--hold"), **choices)
    return _finish_identification(found, out, f"identify-{axis}", as_json)


def _finish_identification(found: Any, out: Path | None, name: str, as_json: bool) -> int:
    from cosim.console import print_identification
    from cosim.flight import new_folder
    from cosim.identify import write

    paths = write(found, out if out is not None else new_folder(Path("runs"), name))
    if as_json:
        click.echo(json.dumps(found.to_dict(), allow_nan=False))
    else:
        print_identification(found, paths)
    return DONE


def _axis_command(axis: str) -> None:
    @identify.command(axis, epilog=_example(f"hexjet identify {axis} --engine edf --out {axis}-model"))
    @click.option("--aircraft", default="hexjet", show_default=True, help="See: hexjet list aircraft.")
    @click.option("--engine", metavar="NAME|FILE.fmu", help="See: hexjet list engines.  [default: edf-as-flown]")
    @click.option("--controller", metavar="NAME", help="[default: smith, or baseline if no model is known]")
    @click.option("--substeps", type=int, help="JSBSim steps in a control step.")
    @click.option("--seed", type=int, help="Of the sensor noise.")
    @click.option("--lags", type=click.IntRange(1, 2), default=1, show_default=True, help="Beside the slow pole.")
    @click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="As in hexjet fly.")
    @_sweep_options
    def command(**choices: Any) -> int:
        return _identify_axis(axis, **choices)

    command.help = (
        f"Identify the {axis} axis in flight, torque command to measured rate: a slow pole, a lag and a delay.\n\n"
        "Writes a model file for hexjet fly --model."
    )


for _axis in ("roll", "pitch", "yaw"):
    _axis_command(_axis)


@cli.command(epilog=_example("hexjet report runs/roll-doublet-smith-001"))
@click.argument("folder", type=click.Path(path_type=Path), metavar="DIR")
def report(folder: Path) -> int:
    """Write the report of the run in DIR again; a run that was killed is finished first, with all that it recorded."""
    from cosim.console import print_run
    from cosim.report import write_report
    from cosim.run import REPORT, open_run

    run = open_run(folder)
    write_report(run, folder / REPORT)
    print_run(run)
    return DONE


@cli.command(epilog=_example("hexjet paper --out runs/paper"))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    default=Path("runs/paper"),
    show_default=True,
    help="Where the result goes; parts that are there already are taken up.",
)
@click.option("--workers", type=click.IntRange(1, 64), default=2, show_default=True, help="Processes.")
@click.option("as_json", "--json", is_flag=True, help="Print the comparison as one JSON object and nothing else.")
def paper(out: Path, workers: int, as_json: bool) -> int:
    """Reproduce the paper: every experiment on the linear plant and in six degrees of freedom, number by number.

    Leaves comparison.csv, comparison.json and report.html in DIR.  An interrupted call goes on where it ended.
    """
    from cosim.console import part_progress, print_paper
    from cosim.paper.reproduce import DATA, REPORT, reproduce

    with part_progress("paper", quiet=as_json) as say:
        found = reproduce(out, say, workers)
    if as_json:
        click.echo(json.dumps(json.loads((out / DATA).read_text(encoding="utf-8")), allow_nan=False))
    else:
        print_paper(found, out / REPORT)
    return DONE


@cli.command(epilog=_example("hexjet export runs/roll-doublet-smith-001 --to ulog"))
@click.argument("folder", type=click.Path(path_type=Path), metavar="DIR")
@click.option("target", "--to", type=click.Choice(["ulog", "csv"]), required=True, help="The format.")
def export(folder: Path, target: str) -> int:
    """Write the log of the run in DIR as CSV, or as ULog for PlotJuggler and Flight Review."""
    from cosim.export import export_csv, export_ulog

    path = folder / {"ulog": "flight.ulg", "csv": "flight.csv"}[target]
    (export_ulog if target == "ulog" else export_csv)(folder, path)
    click.echo(str(path))
    return DONE


@cli.command(epilog=_example("hexjet bench --memory-minutes 5"))
@click.option("--steps", type=click.IntRange(min=250), default=5000, show_default=True, help="Steps of a flight.")
@click.option("--rounds", type=click.IntRange(min=1), default=9, show_default=True, help="Repetitions.")
@click.option("--starts", type=click.IntRange(min=1), default=5, show_default=True, help="Processes started.")
@click.option("--full", is_flag=True, help="Fly an hour for the memory too: two minutes or more.")
@click.option("--memory-minutes", type=click.FloatRange(min=0.1), metavar="MINUTES", help="A shorter flight for it.")
@click.option(
    "--dir", "folder", type=click.Path(exists=True, file_okay=False), metavar="DIR", help="Where flights are recorded."
)
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
def bench(
    steps: int, rounds: int, starts: int, full: bool, memory_minutes: float | None, folder: str | None, as_json: bool
) -> int:
    """Measure what a flight costs on this machine, in microseconds and in JSBSim runs; nothing is judged."""
    from cosim.bench import Plan, measure
    from cosim.bench.show import print_result, progress

    plan = Plan(steps, rounds, starts, 60.0 if full and memory_minutes is None else memory_minutes, folder)
    with progress(quiet=as_json) as tell:
        result = measure(plan, tell)
    if as_json:
        click.echo(json.dumps(result.to_dict(), allow_nan=False))
    else:
        print_result(result)
    return DONE


def main(arguments: list[str] | None = None) -> None:
    """The command ``hexjet``: exits with 0, 1 (the flight failed) or 2 (wrong input, one line)."""
    try:
        status = cli.main(args=arguments, prog_name="hexjet", standalone_mode=False)
    except InputError as error:
        _complain(str(error))
        status = WRONG_INPUT
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help() if error.ctx else "", err=True)
        status = WRONG_INPUT
    except click.ClickException as error:
        where = f" ({error.ctx.command_path} --help)" if isinstance(error, click.UsageError) and error.ctx else ""
        _complain(" ".join(error.format_message().split()) + where)
        status = WRONG_INPUT
    except FlightError as error:
        _complain(str(error))
        status = FLIGHT_FAILED
    except BrokenPipeError:
        # whoever read the output has gone; keep Python from complaining about it while it shuts down
        sys.stdout = None
        status = DONE
    except (click.Abort, KeyboardInterrupt):
        status = 130
    sys.exit(status if isinstance(status, int) else DONE)


def _complain(message: str) -> None:
    click.echo(f"hexjet: {message}", err=True)
