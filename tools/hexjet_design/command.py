"""hexjet design: a controller for an engine."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

import click

from cosim.commands import (
    DONE,
    FLIGHT_FAILED,
    CommandProgress,
    example,
    opt,
    output_to_stderr,
    part_progress,
    say,
    show_table,
    terminal,
    warn_of_fmu_defects,
)

if TYPE_CHECKING:
    from hexjet_design.design import Design


class DesignOptions(opt.Output):
    """Options of ``hexjet design``."""

    engine = opt.word("--engine", "NAME|FILE", "A name, an .fmu or a .toml.  [default: the aircraft's own]")
    aircraft = opt.word("--aircraft", "NAME|DIR", "See: hexjet list aircraft.", "hexjet")
    controller = opt.word(
        "--controller", "NAME", "A predictor, auto for the best of them, or optimal: near the limit.", "auto"
    )
    model = opt.path("--model", "FILE.toml", "Take the models in this file, as hexjet identify writes it.")
    amplitude = opt.number(
        "--amplitude",
        "A",
        "Amplitude of the engine's chirp, in throttle; more where the flight will reach its limits.  [default: 0.005]",
        min=0.0,
        max=0.5,
        min_open=True,
    )
    max_sensitivity = opt.number("--max-sensitivity", None, "Peak of |S|.", min=1.05, max=10.0, default=1.7)
    delay_tolerance = opt.number(
        "--delay-tolerance",
        None,
        "Share of the delay that it may be off, both ways.  [default: the engine's [uncertainty], or 0.3 without one]",
        min=0.0,
        max=1.0,
    )
    gain_tolerance = opt.number(
        "--gain-tolerance",
        None,
        "Share of the gain that it may be off, both ways.  [default: as of the delay]",
        min=0.0,
        max=0.95,
    )
    engine_spread = opt.number(
        "--engine-spread",
        None,
        "Share of gain and lag by which one engine is off in the proof.  [default: as the engine's [uncertainty], or "
        "0.3, at most the gain's tolerance where that is not the engine's]",
        min=0.0,
        max=0.95,
    )
    min_bandwidth_hz = opt.number("--min-bandwidth", "HZ", "Least bandwidth of roll and pitch.", min=0.0, default=0.16)
    noise_share = opt.number(
        "--noise-share",
        None,
        "One standard deviation of sensor noise in a command, as a share of its room.",
        min=0.0,
        max=1.0,
        min_open=True,
        default=0.0833,
    )
    autopilot = opt.choice(
        "--for",
        ["betaflight", "px4", "ardupilot"],
        "Gains for that autopilot's own loops, with their filters, delays and units; see hexjet sitl.",
    )
    lead: bool = opt.option(
        "--lead/--no-lead", default=True, help="Try a lead against the engine's lag.  [default: --lead]"
    )
    scheduled: bool = opt.option(
        "--schedule/--no-schedule",
        default=True,
        help="Let gains follow the thrust where fuel burns and a full tank's do not fit.  [default: --schedule]",
    )
    start = opt.path(
        "--start", "FILE.toml", "A controller file: search from its gains on, for its candidate alone; seconds."
    )
    proof: bool = opt.option(
        "--proof/--no-proof",
        default=True,
        help="End with the proof: measured past the crossover, flown at the corners of the tolerances.  [default: "
        "--proof]",
    )
    limit = opt.flag("--limit", "Compare each axis with the best that any linear controller could do; a minute.")
    settings = opt.words("--set", "KEY=VALUE", "As in hexjet fly, over a plain hover.")
    out = opt.path("--out", "FILE.toml", "[default: a new folder in runs/]", dir_okay=False, writable=True)
    as_json = opt.JSON


@click.command(epilog=example("hexjet design --engine turbojet --out turbojet.toml"))
@opt.takes(DesignOptions)
def design(options: DesignOptions) -> int:
    """Design a controller for an engine on an aircraft: predictor, its model, and the gains of all axes.

    Writes a controller file for hexjet fly --controller, and a page beside it.  A design ends with its proof: the loops
    with the engine's own response, and hover, gust, and doublets to the lean that the pilot may ask for, flown with
    noise, at the corners of the tolerances and with one engine off.  What is worse as flown than with the gains that
    ship is said right after the verdict.
    Status 1: no design keeps the requirements, and what would allow one; or its proof failed, where, and what would
    allow it: a controller that flies as designed is written, marked as not proved.
    """
    from cosim.commands import one_thread

    one_thread()
    from cosim.api.call.choices import engine_for
    from hexjet_design.api import design as make
    from hexjet_design.api import prepare

    if options.out is not None:  # before any question
        prepare(options.out)
    engine = engine_for(options.aircraft, options.engine)
    warn_of_fmu_defects(engine)
    chosen = options.chosen(
        "aircraft", "controller", "model", "amplitude", "max_sensitivity", "delay_tolerance", "gain_tolerance",
        "engine_spread", "min_bandwidth_hz", "noise_share", "autopilot", "lead", "scheduled", "start", "proof", "limit",
        "settings",
    )  # fmt: skip
    with output_to_stderr(options.as_json), part_progress("design", quiet=options.as_json) as show:
        result = make(engine, progress=CommandProgress(show), **chosen)
    result.write(options.out)

    def show_answer() -> None:
        print_design(result.designed, result.files)
        if "controller" in result.files and options.autopilot is None:
            say(f"next: {fly_command(options, result.files['controller'])}", wrap=False)

    options.answer(result.to_dict, show_answer)
    return DONE if result.ok else FLIGHT_FAILED


def fly_command(options: DesignOptions, file: Path) -> str:
    """Return the command that flies a design: with its aircraft, its engine and the settings that it was made for."""
    given = [("--aircraft", options.aircraft if options.aircraft != "hexjet" else None), ("--engine", options.engine)]
    given += [*(("--set", text) for text in options.settings), ("--controller", str(file))]
    return " ".join(["hexjet fly SCENARIO", *(f"{name} {quote(value)}" for name, value in given if value)])


# columns at a fuel level; the report has every column
AT_A_LEVEL = ("peak |S|", "phase deg", "bandwidth Hz", "tolerated")


def print_design(design: Design, paths: dict[str, Path]) -> None:
    """Print the answer and the files, the margins of the linear loops, what they rest on, and the flights compared."""
    from hexjet_design.proof.comparison import WORSE_WORDS, comparison_columns, comparison_rows
    from hexjet_design.result import COLUMNS, answer_lines, channel_rows, detail_lines, level_rows, row_lines

    def say_all(lines: Iterable[str]) -> None:
        for line in lines:
            say(line)

    say(f"{design.vehicle.name} with engine [bold]{design.engine.name}[/bold]", marked=True)
    say_all(answer_lines(design))
    for name, path in paths.items():
        say(f"{name}: {path}", wrap=False)
    columns_shown = [k for k, column in enumerate(COLUMNS) if column not in ("attitude 1/s", "P", "I", "D", "delay ms")]
    columns = [list(column) for column in zip(COLUMNS, *channel_rows(design), strict=True)]
    _show_in_pieces([columns[k] for k in columns_shown])
    if levels := level_rows(design):
        columns_of_levels = [0, *(COLUMNS.index(column) for column in AT_A_LEVEL)]
        _show([[row[k] for k in columns_of_levels] for row in (COLUMNS, *levels)])
    say_all([*row_lines(design), *detail_lines(design)])
    if design.proof is not None and design.proof.compared:
        compared = design.proof.compared
        _show_in_pieces([comparison_columns(compared), *comparison_rows(compared)])
        say(WORSE_WORDS)


def _show_in_pieces(lines: Sequence[Sequence[str]]) -> None:
    """Print a table, headings first, in pieces of as many pairs of columns as the terminal is wide."""
    side = max(1, (terminal().width - 14) // 40 * 2)
    for first in range(1, len(lines[0]), side):
        _show([[line[0], *line[first : first + side]] for line in lines])


def _show(lines: Sequence[Sequence[str]], name_width: int = 32) -> None:
    """Print a table, headings first; a line's name is wrapped last."""
    width = min(name_width, max(len(line[0]) for line in lines))
    numbers = range(1, len(lines[0]))
    show_table(lines[0], lines[1:], numbers, name_width=width, pad_edge=False, collapse_padding=True)
