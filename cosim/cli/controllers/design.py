"""hexjet design: a controller for an engine."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.base.errors import InputError
from cosim.cli.console import output_to_stderr, part_progress, terminal
from cosim.cli.options import DONE, FLIGHT_FAILED, Number, engine_for, example, offer_to_compile, warn_of_blemishes

if TYPE_CHECKING:
    from rich.console import Console

    from cosim.design.design import Design


@click.command(epilog=example("hexjet design --engine turbojet --out turbojet.toml"))
@click.option("--engine", metavar="NAME|FILE", help="A name, an .fmu or a .toml.  [default: the aircraft's own]")
@click.option("--aircraft", default="hexjet", show_default=True, help="See: hexjet list aircraft.")
@click.option(
    "--controller",
    default="auto",
    show_default=True,
    metavar="NAME",
    help="One of the predictors, or the best of them.",
)
@click.option("--model", type=click.Path(path_type=Path), metavar="FILE.toml", help="As hexjet identify writes it.")
@click.option(
    "--amplitude",
    type=Number(min=0.0, min_open=True, max=0.5),
    metavar="A",
    help="Of the engine's sweep, in throttle; more where the flight will reach its limits.  [default: 0.005]",
)
@click.option("--max-sensitivity", type=Number(min=1.05, max=10.0), default=1.7, show_default=True, help="Peak of |S|.")
@click.option(
    "--delay-tolerance",
    type=Number(0.0, 1.0),
    default=0.3,
    show_default=True,
    help="Of the delay, both ways.",
)
@click.option(
    "--gain-tolerance", type=Number(0.0, 0.95), default=0.3, show_default=True, help="Of the gain, both ways."
)
@click.option(
    "--min-bandwidth",
    type=Number(min=0.0),
    default=0.16,
    show_default=True,
    metavar="HZ",
    help="Of roll and pitch.",
)
@click.option(
    "--noise-share",
    type=Number(min=0.0, min_open=True, max=1.0),
    default=0.0833,
    show_default=True,
    help="One standard deviation of sensor noise in a command, as a share of its room.",
)
@click.option(
    "--for",
    "autopilot",
    type=click.Choice(["betaflight", "px4", "ardupilot"]),
    help="Gains for that autopilot's own loops, with their filters, delays and units; see hexjet sitl.",
)
@click.option("--lead/--no-lead", default=True, help="Try a lead against the engine's lag.  [default: --lead]")
@click.option(
    "--schedule/--no-schedule",
    "scheduled",
    default=True,
    help="Let gains follow the thrust where fuel burns and a full tank's do not fit.  [default: --schedule]",
)
@click.option(
    "--start",
    type=click.Path(path_type=Path),
    metavar="FILE.toml",
    help="A controller file: search from its gains on, for its candidate alone; seconds.",
)
@click.option(
    "--proof/--no-proof",
    default=True,
    help="End with the proof: measured past the crossover, flown at the corners of the tolerances.  [default: --proof]",
)
@click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="As in hexjet fly, over a plain hover.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False, writable=True),
    metavar="FILE.toml",
    help="[default: a new folder in runs/]",
)
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
def design(
    engine: str | None,
    aircraft: str,
    controller: str,
    model: Path | None,
    amplitude: float | None,
    max_sensitivity: float,
    delay_tolerance: float,
    gain_tolerance: float,
    min_bandwidth: float,
    noise_share: float,
    autopilot: str | None,
    lead: bool,
    scheduled: bool,
    start: Path | None,
    proof: bool,
    settings: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> int:
    """Design a controller for an engine on an aircraft: predictor, its model, and the gains of all axes.

    Writes a controller file for hexjet fly --controller, and a page beside it.  A design ends with its proof: the loops
    with the engine's own response, and hover, gust, and doublets to the lean that the pilot may ask for, flown with
    noise, at the corners of the tolerances and with one engine off.  What is worse as flown than with the gains that
    ship is said first.
    Status 1: no design keeps the requirements, and what would allow one; or its proof failed, and where.
    """
    from cosim.base.runtime.threads import one_thread

    one_thread()
    from cosim.design.design import design as make
    from cosim.design.prove import proved
    from cosim.design.result import to_dict, write
    from cosim.simulation.controllers.controller_file import Requirements

    if out is not None:  # before minutes of searching
        if out.suffix.lower() != ".toml":
            raise InputError(f"--out {out}: must end in .toml, by which --controller knows it")
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--out {out}: cannot be written to: {error.strerror or error}") from error
    engine = engine_for(aircraft, engine)
    firmware = None
    if autopilot is not None:
        from cosim.cli.firmware import firmware_for
        from cosim.control.predictors.registry import BASELINE

        if controller not in ("auto", BASELINE.name) or start is not None:
            raise InputError(f"--for {autopilot}: it has no predictor of ours: leave --controller and --start out")
        firmware = firmware_for(autopilot, aircraft, settings)
        controller, lead, scheduled, proof = BASELINE.name, False, False, False
    offer_to_compile(engine)
    warn_of_blemishes(engine)
    need = Requirements(
        max_sensitivity=max_sensitivity,
        delay_tolerance=delay_tolerance,
        gain_tolerance=gain_tolerance,
        min_bandwidth_hz=min_bandwidth,
        noise_share=noise_share,
    )
    with output_to_stderr(as_json), part_progress("design", quiet=as_json) as tell:
        search = partial(
            make,
            engine,
            aircraft,
            controller=controller,
            need=need,
            settings=settings,
            model=model,
            amplitude=amplitude,
            lead=lead,
            scheduled=scheduled,
            start=start,
            firmware=firmware,
            say=lambda text: tell(text, 0, 1),
        )
        made = search()
        if proof:
            made = proved(made, lambda text: tell(text, 0, 1), lambda unsure: search(unsure=unsure))
    paths = write(made, out)
    if autopilot is not None and made.ok:
        from cosim.cli.firmware import write_parameters

        paths["parameters"] = write_parameters(autopilot, aircraft, paths["controller"], made.scenario.step_s)
    if as_json:
        click.echo(json.dumps(to_dict(made, paths), allow_nan=False))
    else:
        print_design(made, paths)
    return DONE if made.ok else FLIGHT_FAILED


AT_A_LEVEL = ("peak |S|", "phase deg", "bandwidth Hz", "tolerated")  # of fuel; the page has every column
NAME_WIDTH = 32  # "altitude, 75% of fuel, scheduled"


def print_design(design: Design, paths: dict[str, Path]) -> None:
    """Print the answer and the files, the margins of the linear loops, what they rest on, and the flights compared."""
    from cosim.design.as_flown import WORSE_WORDS, comparison_columns, comparison_rows
    from cosim.design.result import COLUMNS, answer_lines, channel_rows, detail_lines, level_rows, row_lines

    console = terminal()

    def print_lines(lines: Iterable[str]) -> None:
        for line in lines:
            console.print(line, highlight=False, markup=False)

    console.print(f"{design.vehicle.name} with engine [bold]{design.engine.name}[/bold]", highlight=False)
    print_lines(answer_lines(design))
    for name, path in paths.items():
        console.print(f"{name}: {path}", highlight=False, soft_wrap=True)
    shown = [k for k, column in enumerate(COLUMNS) if column not in ("attitude 1/s", "P", "I", "D", "delay ms")]
    columns = [list(column) for column in zip(COLUMNS, *channel_rows(design), strict=True)]
    _print_side_by_side(console, [columns[k] for k in shown])
    if levels := level_rows(design):
        said = [0, *(COLUMNS.index(column) for column in AT_A_LEVEL)]
        _print_table(console, [[row[k] for k in said] for row in (COLUMNS, *levels)])
    print_lines([*row_lines(design), *detail_lines(design)])
    if design.proof is not None and design.proof.compared:
        compared = design.proof.compared
        _print_side_by_side(console, [comparison_columns(compared), *comparison_rows(compared)])
        print_lines([WORSE_WORDS])


def _print_side_by_side(console: Console, lines: Sequence[Sequence[str]]) -> None:
    """Print a table, headings first, in pieces of as many pairs of columns as the terminal is wide."""
    side = max(1, (console.width - 14) // 40 * 2)
    for first in range(1, len(lines[0]), side):
        _print_table(console, [[line[0], *line[first : first + side]] for line in lines])


def _print_table(console: Console, lines: Sequence[Sequence[str]]) -> None:
    """Print a table, headings first; a line's name is wrapped last."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for n, heading in enumerate(lines[0]):
        least = 1 if n else min(NAME_WIDTH, max(len(line[0]) for line in lines))
        table.add_column(heading, justify="right" if n else "left", min_width=least)
    for line in lines[1:]:
        table.add_row(*line)
    console.print(table)
