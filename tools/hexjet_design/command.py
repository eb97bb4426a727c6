"""hexjet design: a controller for an engine."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.commands import Command, one_thread, say, show_table, terminal

if TYPE_CHECKING:
    from hexjet_design.api import DesignResult
    from hexjet_design.design import Design


# Columns of tables at a fuel level; the report has all columns.
LEVEL_COLUMNS = ("peak |S|", "phase deg", "bandwidth Hz", "tolerated")


def print_design(result: DesignResult, verbose: bool = False) -> None:
    """Print result and files; ``verbose``: linear margins, evidence, and compared flights too."""
    from hexjet_design.result import answer_lines

    design = result.designed
    say(f"{design.vehicle.name} with engine [bold]{design.engine.name}[/bold]", marked=True)
    _print_lines(answer_lines(design))
    for name, path in result.files.items():
        say(f"{name}: {path}", wrap=False)
    if verbose:
        _print_details(design)
    if result.fly_command:
        say(f"next: {result.fly_command}", wrap=False)


def _print_details(design: Design) -> None:
    """Print the linear margins, the evidence, and the compared flights."""
    from hexjet_design.proof.comparison import WORSE_WORDS, comparison_columns, comparison_rows
    from hexjet_design.result import COLUMNS, channel_rows, detail_lines, level_rows, row_lines

    columns_shown = [k for k, column in enumerate(COLUMNS) if column not in ("attitude 1/s", "P", "I", "D", "delay ms")]
    columns = [list(column) for column in zip(COLUMNS, *channel_rows(design), strict=True)]
    _print_in_pieces([columns[k] for k in columns_shown])
    if levels := level_rows(design):
        columns_of_levels = [0, *(COLUMNS.index(column) for column in LEVEL_COLUMNS)]
        _print_table([[row[k] for k in columns_of_levels] for row in (COLUMNS, *levels)])
    _print_lines([*row_lines(design), *detail_lines(design)])
    if design.proof is not None and design.proof.compared:
        compared = design.proof.compared
        _print_in_pieces([comparison_columns(compared), *comparison_rows(compared)])
        say(WORSE_WORDS)


def _print_lines(lines: Iterable[str]) -> None:
    for line in lines:
        say(line)


def _print_in_pieces(lines: Sequence[Sequence[str]]) -> None:
    """Print a table, headings first, in pieces of as many pairs of columns as the terminal is wide."""
    side = max(1, (terminal().width - 14) // 40 * 2)
    for first in range(1, len(lines[0]), side):
        _print_table([[line[0], *line[first : first + side]] for line in lines])


def _print_table(lines: Sequence[Sequence[str]], name_width: int = 32) -> None:
    """Print a table, headings first; a line's name is wrapped last."""
    width = min(name_width, max(len(line[0]) for line in lines))
    numbers = range(1, len(lines[0]))
    show_table(lines[0], lines[1:], numbers, name_width=width, pad_edge=False, collapse_padding=True)


def _default_folder(arguments: Mapping[str, Any]) -> str:
    """Return the default folder, named by aircraft and engine."""
    from cosim.api.call.choices import engine_for

    aircraft, engine = arguments["aircraft"], arguments["engine"]
    return f"design-{Path(aircraft).absolute().name}-{Path(engine_for(aircraft, engine)).stem}"


design = Command(
    "design",
    "hexjet_design.api:design",
    "--engine turbojet --out turbojet.toml",
    options={"engine": "--engine", "aircraft": "--aircraft", "min_bandwidth_hz": "--min-bandwidth",
             "autopilot": "--for", "scheduled": "--schedule"},
    metavars={"model": "FILE.toml", "start": "FILE.toml", "amplitude": "A", "out": "DIR|FILE.toml",
              "controller": "NAME"},
    writes=(".toml",),
    folder=_default_folder,
    before=lambda arguments: one_thread(),
    notes="warning",
    succeeded=lambda result: result.ok,
    show=print_design,
    ends="Status 1: no design keeps the requirements, and what would allow one; or its proof failed, where, and what "
    "would allow it.",
)  # fmt: skip
