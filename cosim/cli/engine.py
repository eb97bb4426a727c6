"""hexjet fmu: engines built and checked."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.base.errors import InputError
from cosim.cli.console import output_to_stderr, part_progress, terminal
from cosim.cli.options import DONE, FLIGHT_FAILED, Number, example, offer_to_compile
from cosim.cli.outputs import Out

if TYPE_CHECKING:
    from cosim.engine import CheckReport


@click.group()
def fmu() -> None:
    """Build and check engine FMUs."""


_FMU = Out(".fmu")
_WINDOWS = click.option(
    "--windows", is_flag=True, help="For 64-bit Windows, with MinGW's compiler (x86_64-w64-mingw32-gcc)."
)


@fmu.command("build", epilog=example("hexjet fmu build turbojet"))
@click.argument("engines", nargs=-1)
@_WINDOWS
def fmu_build(engines: tuple[str, ...], windows: bool) -> int:
    """Build the FMUs of ENGINES, or of all, from their sources; those up to date are left alone."""
    from cosim.engine import build_engines
    from cosim.engine.make.compile import compile_archive, has_windows

    for path in build_engines(list(engines) or None):
        if windows and not has_windows(path):
            compile_archive(path, windows=True)
        click.echo(str(path))
    return DONE


@fmu.command("compile", epilog=example("hexjet fmu compile their.fmu"))
@click.argument("archive", metavar="FILE.fmu", type=click.Path(path_type=Path))
@click.option("--out", type=_FMU, metavar="FILE.fmu|DIR", help="[default: into FILE.fmu itself]")
@_WINDOWS
def fmu_compile(archive: Path, out: Path | None, windows: bool) -> int:
    """Compile the sources that an FMU brings for this machine, and put the library into it.

    For an FMU without a library for this machine, or, with --windows, for one that is to run on Windows too: an engine
    of the library, an exported controller, anybody's.  Needs a C compiler.
    """
    from cosim.engine.make.compile import compile_archive

    out = out if out is None or _FMU.is_file(out) else out / archive.name
    click.echo(str(compile_archive(archive, out, windows)))
    return DONE


@fmu.command("survey", epilog=example("hexjet fmu survey engines/*.fmu engines/*.toml"))
@click.argument("engines", nargs=-1, required=True, metavar="FILE...", type=click.Path(path_type=Path))
@click.option(
    "--controller", default="baseline", show_default=True, metavar="NAME", help="As in hexjet design, or auto."
)
@click.option(
    "--time-limit", type=Number(min=1.0), default=900.0, show_default=True, metavar="S", help="For each command."
)
@click.option(
    "--page",
    metavar="FILE.md",
    type=click.Path(path_type=Path),
    help="Write each row into this page as it is found, between the marks 'measured: engines' and 'end'; other rows "
    "of its table stay.",
)
@click.option("--missing", is_flag=True, help="Leave out the engines that have a row in the page already.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
def fmu_survey(
    engines: tuple[Path, ...], controller: str, time_limit: float, page: Path | None, missing: bool, as_json: bool
) -> int:
    """One line for each of many engines: is it fit, is there a design for it, does that fly as promised.

    Checked, designed for and flown in processes of their own.  Status 1: a command of ours failed on one of them.
    """
    from dataclasses import asdict

    from cosim.design.survey import COLUMNS, FAULT, MARK, add_to_page, rows_of, survey
    from cosim.results.report.marks import check_marks, table

    if missing and page is None:
        raise InputError("--missing: goes with --page, which has the rows")
    if page:
        check_marks(page, [MARK])
    if page and missing:
        there = rows_of(page)
        engines = tuple(path for path in engines if path.stem not in there)
    rows = []
    with part_progress("survey", quiet=as_json) as tell:
        for number, row in enumerate(survey(engines, controller, time_limit), start=1):
            tell(row.engine, number, len(engines))
            rows.append(row)
            if page:
                add_to_page(page, row)
    if as_json:
        click.echo(json.dumps({"engines": [asdict(row) for row in rows]}))
    else:
        click.echo(table(COLUMNS, [row.cells for row in rows], left=len(COLUMNS) - 1), nl=False)
    return FLIGHT_FAILED if any(row.verdict == FAULT for row in rows) else DONE


@fmu.command("check", epilog=example("hexjet fmu check their.fmu --step 0.004"))
@click.argument("engine", metavar="NAME|FILE.fmu|MAPPING.toml")
@click.option(
    "--step",
    type=Number(min=0.0, min_open=True),
    metavar="S",
    help="Control step.  [default: 0.004, or the library engine's]",
)
@click.option("settings", "--set", metavar="PARAMETER=VALUE", multiple=True, help="Set a parameter of the engine.")
@click.option(
    "--time-limit", type=Number(min=1.0), default=120.0, show_default=True, metavar="S", help="For all of it."
)
@click.option("--out", type=Out(), metavar="DIR", help="[default: a new one in runs/]")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
def fmu_check(
    engine: str, step: float | None, settings: tuple[str, ...], time_limit: float, out: Path | None, as_json: bool
) -> int:
    """Tell whether an FMU is fit to be an engine, and how it answers its throttle; of a controller, what it is.

    The FMU is run in a process of its own: if it crashes, hangs or eats memory, that is told and nothing else happens.
    Leaves check.json and a page with its static curve and step responses.  Status 0: fit; 1: unfit; 2: not usable.
    """
    from cosim.base.storage.toml import parse_numbers
    from cosim.engine import check_fmu, limits_of
    from cosim.engine.make.controller_fmu import is_controller
    from cosim.flight import new_folder
    from cosim.results.report.engine_check import write_check

    if is_controller(Path(engine)):
        return _check_controller(Path(engine), as_json)
    offer_to_compile(engine)
    report = check_fmu(engine, step, parse_numbers(settings, "--set"), limits_of(time_limit))
    page = write_check(report, out if out is not None else new_folder(Path("runs"), f"check-{Path(engine).stem}"))
    if as_json:
        click.echo(json.dumps(report.to_dict(), allow_nan=False))
    else:
        print_check(report, page)
    return DONE if report.ok else FLIGHT_FAILED


def _check_controller(path: Path, as_json: bool) -> int:
    """What a controller's FMU is told and answers, and whether it flies in hover for a second, twice the same."""
    from cosim.engine.make.controller_fmu import describing, read_controller_fmu
    from cosim.flight import fly
    from cosim.spec.scenario import Scenario

    fmu = read_controller_fmu(path)
    description = describing(fmu)
    with output_to_stderr(as_json):
        run = fly(Scenario.load("hover").replace(duration_s=1.0, expect=[], controller=str(path.absolute())))
    own = run.summary.own_controller
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
        "repeatable": own.repeatable if own is not None else None,
    }
    if as_json:
        click.echo(json.dumps(report, allow_nan=False))
    else:
        for key, value in report.items():
            shown = ", ".join(value) if isinstance(value, list) else value
            terminal().print(f"{key:14} {shown}", highlight=False, soft_wrap=True, markup=False)
    return DONE if run.outcome == "completed" and report["repeatable"] else FLIGHT_FAILED


def print_check(report: CheckReport, page: Path) -> None:
    """The findings, one to a line, problems last, and where the page is."""
    console = terminal()
    for label, value in report.lines():
        console.print(f"{label:22} {value}", highlight=False, soft_wrap=True, markup=False)
    for problem in report.problems:
        console.print(f"problem: {problem}", highlight=False, soft_wrap=True, markup=False)
    console.print(f"report: {page}", highlight=False, soft_wrap=True)
    console.print("fit to fly" if report.ok else "not fit to fly", style="bold")
