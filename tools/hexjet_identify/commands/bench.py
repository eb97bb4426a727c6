"""hexjet identify bench: an engine out of its bench logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.commands import DONE, FLIGHT_FAILED, example, opt, output_to_stderr, say, show_table

if TYPE_CHECKING:
    from hexjet_identify.api.bench import BenchIdentifyResult


class Bench(opt.LogPart, opt.Output):
    """Options of ``hexjet identify bench``."""

    logs: tuple[Path, ...] = opt.argument(metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path))
    command = opt.word("--command", "SUM", "Throttle or set-point.  [default: the column called so]")
    output = opt.word("--output", "SUM", "Thrust or speed.  [default: the column called so]")
    throttle_range: tuple[float, float] | None = opt.renamed(
        opt.option(
            "--throttle-range",
            type=(opt.Number(), opt.Number()),
            metavar="LOW HIGH",
            help="What throttle 0 and 1 are in the log.",
        ),
        "--range",
    )
    between = opt.choice(
        "--between", ("auto", "held", "straight"), "What the command does between two rows.", default="auto"
    )
    longest_delay_s = opt.number(
        "--longest-delay", "S", "Longest delay that is looked for.", min=0.0, max=4.0, min_open=True, default=2.0
    )
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
    """Identify an engine from its bench logs: static line, delay, lags, limits, with bounds.

    Reads CSV, Parquet, TDMS: steps, staircases, ramps, chirps, whatever moved the throttle.  Says first whether the
    model explains the logs.  Leaves a page, identification.json and, of a thrust in N, an engine with its uncertainty;
    says what the logs do not tell, and the next test.  With --engine it fits the parameters of that one instead: a
    turbine and its ECU.  Several logs are taken for one engine's.
    Status 1: the logs do not tell, or the model does not explain them.
    """
    from cosim.commands import one_thread

    one_thread()
    from cosim.identify.files import FILES, RECORD
    from hexjet_identify.api.bench import identify_bench as identify

    options.check_out(RECORD, *FILES)
    with output_to_stderr(options.as_json):
        result = identify(*options.logs, **options.chosen(*_CHOSEN))
        result.write(options.run_folder("identify-bench"))
    options.answer(result.to_dict, lambda: print_bench(result))
    return DONE if result.found else FLIGHT_FAILED


def print_bench(result: BenchIdentifyResult) -> None:
    """Print the verdict, the numbers, what is to be said of them, and the files."""
    verdict, *others = result.lines()
    say(verdict)
    for table in result.tables():
        show_table(table.columns, table.rows, range(1, len(table.columns)))
    for line in others:
        say(line)
    for name in ("engine", "report"):
        if name in result.files:
            say(f"{name}: {result.files[name]}", wrap=False)
