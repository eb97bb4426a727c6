"""hexjet identify bench: an engine out of its bench logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.cli import opt
from cosim.cli.console import output_to_stderr, say, show_table
from cosim.cli.options import DONE, FLIGHT_FAILED, example

if TYPE_CHECKING:
    from cosim.api.identify import BenchIdentifyResult
    from cosim.identify.bench import BenchIdentification
    from cosim.identify.bench.evidence import HeldBack
    from cosim.identify.bench.grey_box import GreyIdentification

MOST_MOVEMENTS = 16  # that a terminal shows; the page has all


class Bench(opt.LogPart, opt.Output):
    """Options of ``hexjet identify bench``."""

    logs: tuple[Path, ...] = opt.argument(metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path))
    command = opt.word("--command", "SUM", "Throttle or set-point.  [default: the column called so]")
    output = opt.word("--output", "SUM", "Thrust or speed.  [default: the column called so]")
    throttle_range: tuple[float, float] | None = opt.option(
        "--throttle-range",
        aliases=["--range"],
        type=(opt.Number(), opt.Number()),
        metavar="LOW HIGH",
        help="What throttle 0 and 1 are in the log.",
    )
    between = opt.choice(
        "--between", ("auto", "held", "straight"), "What the command does between two rows.", default="auto"
    )
    longest_delay_s = opt.number("--longest-delay", "S", "Looked for.", min=0.0, max=4.0, min_open=True, default=2.0)
    engine = opt.word("--engine", "NAME|FILE", "Fit parameters of this engine instead.")
    fit = opt.words("--fit", "PARAMETER", "One of them; beside the delay, which always is.")
    settings = opt.words("--set", "PARAMETER=VALUE", "Set one of them, or say where to begin.")
    time_column, time_unit, begin, end = opt.LOG_PART
    out = opt.OUT
    as_json = opt.JSON


_CHOSEN = (
    "command", "output", "throttle_range", "between", "longest_delay_s", "engine", "fit", "settings", "time_column",
    "time_unit", "begin", "end",
)  # fmt: skip


@click.command("bench", epilog=example("hexjet identify bench bench.csv --out my-engine"))
@opt.takes(Bench)
def identify_bench(options: Bench) -> int:
    """Identify an engine from its bench logs: delay, one lag or two, gain, static curve, with bounds.

    Reads CSV, Parquet, TDMS: steps, staircases, ramps, chirps, whatever moved the throttle.  Leaves a page,
    identification.json and, of a thrust in N, an engine with its uncertainty.  Says what the logs do not tell, and the
    next test.  With --engine it fits the parameters of that one instead: a turbine and its ECU.  Several logs are taken
    for one engine's; a load cell's, without a command, is laid on the clock of the one before it.
    Status 1: the logs do not tell, or the model does not explain them.
    """
    from cosim.base.runtime.threads import one_thread

    one_thread()
    from cosim.api.identify import identify_bench as identify
    from cosim.identify.files import FILES, RECORD

    options.check_out(RECORD, *FILES)
    with output_to_stderr(options.as_json):
        result = identify(*options.logs, **options.chosen(*_CHOSEN))
        result.write(options.run_folder("identify-bench"))
    options.answer(result.to_dict, lambda: print_result(result))
    return DONE if result.found else FLIGHT_FAILED


def print_result(result: BenchIdentifyResult) -> None:
    """Print the forms, or what was fitted of an engine."""
    from cosim.identify.bench import BenchIdentification

    found = result.identification
    if isinstance(found, BenchIdentification):
        print_bench(found, result.files)
    else:
        print_fitted(found, result.files)


def print_fitted(found: GreyIdentification, paths: dict[str, Path]) -> None:
    """Print what was fitted of an engine, what is to be said of it, and where the files are."""
    from cosim.identify.bench.grey_box import output_unit
    from cosim.identify.bench.grey_box_result import rows, summary

    say(summary(found))
    show_table(("with 95 % bounds", found.choices.engine), rows(found), (1,))
    _show_movements(found.held_back, output_unit(found.records[0]), found.swing)
    for note in found.notes:
        say(f"note: {note}")
    if "engine" not in paths:
        say("no engine: with these parameters it does not explain the log")
    for name in ("engine", "report"):
        if name in paths:
            say(f"{name}: {paths[name]}", wrap=False)


def _show_movements(held_back: HeldBack | None, unit: str, swing: float) -> None:
    from cosim.identify.bench.evidence import MOVEMENT_COLUMNS, movement_rows

    if held_back is not None and 0 < len(held_back.movements) <= MOST_MOVEMENTS:
        show_table(MOVEMENT_COLUMNS, movement_rows(held_back, unit, swing), range(2, len(MOVEMENT_COLUMNS)))


def print_bench(found: BenchIdentification, paths: dict[str, Path]) -> None:
    """Print the forms beside each other, what is to be said of them, what the log does not tell, and the files."""
    from cosim.identify.bench.evidence import output_swing
    from cosim.identify.bench.result import describe_held, rows, summary, why_no_engine

    say(summary(found))
    labels = [estimate.form.label for estimate in found.estimates[:2]]
    show_table(("with 95 % bounds", *labels), [row[:3] for row in rows(found)], range(1, 1 + len(labels)))
    _show_movements(found.held_back, found.records[0].output_unit, output_swing(found.problem.parts))
    held = describe_held(found)
    if held and held not in found.notes:
        say(f"held back: {held}")
    for note in found.notes:
        say(f"note: {note}")
    for line in found.untold:
        say(f"not told: {line}")
    if reason := why_no_engine(found):
        say(f"no engine: {reason}")
    for name in ("engine", "report"):
        if name in paths:
            say(f"{name}: {paths[name]}", wrap=False)
