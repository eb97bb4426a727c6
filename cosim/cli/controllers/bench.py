"""hexjet identify bench: an engine out of its bench logs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.base.errors import InputError
from cosim.cli import opt
from cosim.cli.console import output_to_stderr, say, show_table
from cosim.cli.options import DONE, FLIGHT_FAILED, example

if TYPE_CHECKING:
    from cosim.identify.bench import BenchIdentification, BenchRecord
    from cosim.identify.bench.evidence import HeldBack
    from cosim.identify.bench.grey_box import GreyIdentification

MOST_MOVEMENTS = 16  # that a terminal shows; the page has all


class Bench(opt.LogPart, opt.Output):
    """Options of ``hexjet identify bench``."""

    logs: tuple[Path, ...] = opt.argument(metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path))
    command_text = opt.word("--command", "SUM", "Throttle or set-point.  [default: the column called so]")
    output_text = opt.word("--output", "SUM", "Thrust or speed.  [default: the column called so]")
    limits: tuple[float, float] | None = opt.option(
        "--range", type=(opt.Number(), opt.Number()), metavar="LOW HIGH", help="What throttle 0 and 1 are in the log."
    )
    between = opt.choice(
        "--between", ("auto", "held", "straight"), "What the command does between two rows.", default="auto"
    )
    longest_delay = opt.number("--longest-delay", "S", "Looked for.", min=0.0, max=4.0, min_open=True, default=2.0)
    engine = opt.word("--engine", "NAME|FILE.fmu", "Fit parameters of this engine instead.")
    fitted = opt.words("--fit", "PARAMETER", "One of them; beside the delay, which always is.")
    settings = opt.words("--set", "PARAMETER=VALUE", "Set one of them, or say where to begin.")
    time_column, time_unit, begin, end = opt.LOG_PART
    out = opt.OUT
    as_json = opt.JSON


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
    from cosim.identify.bench import Choices, Columns, read_records
    from cosim.identify.bench import identify_bench as identify
    from cosim.identify.bench.beyond_lags import fit_beyond_lags
    from cosim.identify.bench.result import write
    from cosim.identify.files import FILES, RECORD

    options.check_out(RECORD, *FILES)
    columns = Columns(
        options.command_text, options.output_text, options.time_column, options.time_unit, options.begin, options.end
    )
    if options.engine is None and (options.fitted or options.settings):
        raise InputError("--fit and --set are for the parameters of an engine: --engine NAME")
    if options.engine is not None:
        return _fit_engine(read_records(options.logs, columns), options)
    with output_to_stderr(options.as_json):
        found = identify(read_records(options.logs, columns), Choices(*_choices(options)))
        beyond = fit_beyond_lags(found, options.longest_delay)
    if beyond is not None:
        return _write_fitted(beyond, options)
    with output_to_stderr(options.as_json):
        paths = write(found, options.run_folder("identify-bench"))
    options.answer(found.to_dict, lambda: print_bench(found, paths))
    return FLIGHT_FAILED if found.refused else DONE


def _fit_engine(records: list[BenchRecord], options: Bench) -> int:
    from cosim.base.storage.toml import parse_numbers
    from cosim.identify.bench.grey_box import GreyChoices, fit_engine
    from cosim.identify.bench.identify import is_straight, throttle_limits

    notes: list[str] = []
    limits = (0.0, 1.0)
    if records[0].command_unit not in ("rpm", "krpm"):
        limits, known = throttle_limits(records, options.limits, notes)
        if not known:
            raise InputError(f"{records[0].path}: what throttle 0 and 1 are is not known: --range LOW HIGH")
    straight = is_straight(records, options.between, notes)
    settings = parse_numbers(options.settings, "--set")
    choices = GreyChoices(str(options.engine), options.fitted, settings, limits, straight, options.longest_delay)
    with output_to_stderr(options.as_json):
        found = fit_engine(records, choices)
    return _write_fitted(replace(found, notes=(*found.notes, *notes)), options)


def _write_fitted(found: GreyIdentification, options: Bench) -> int:
    from cosim.identify.bench.grey_box_result import write

    with output_to_stderr(options.as_json):
        paths = write(found, options.run_folder("identify-bench"))
    options.answer(found.to_dict, lambda: print_fitted(found, paths))
    return DONE if found.leaves_engine else FLIGHT_FAILED


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


def _choices(options: Bench) -> tuple[tuple[float, float] | None, str, float]:
    return options.limits, options.between, options.longest_delay


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
