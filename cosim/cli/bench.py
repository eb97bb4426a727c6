"""hexjet bench: what it costs."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from cosim.cli.options import DONE, FLIGHT_FAILED, Number, example


@click.command(epilog=example("hexjet bench --only step --only engines"))
@click.option("--full", is_flag=True, help="Everything, with longer flights and a campaign: some ten minutes.")
@click.option("--campaign", is_flag=True, help="What a second worker brings to a campaign, too: a minute more.")
@click.option(
    "--only",
    "parts",
    multiple=True,
    metavar="PART",
    help="This part alone, or these: step, blocks, others, own, peers, rotorpy, time, engines, log, pages, start, "
    "memory, campaign.",
)
@click.option("--steps", type=click.IntRange(min=250), help="Steps of a timed flight.  [2500, with --full 5000]")
@click.option("--rounds", type=click.IntRange(min=1), help="Repetitions.  [5, with --full 9]")
@click.option("--starts", type=click.IntRange(min=1), help="Processes started for each figure of a process.  [5]")
@click.option("--memory-minutes", type=Number(min=0.1), metavar="MINUTES", help="Flown for the memory.  [5, or 60]")
@click.option(
    "--dir", "folder", type=click.Path(exists=True, file_okay=False), metavar="DIR", help="Where flights are recorded."
)
@click.option("--page", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE.md", help="Write the tables in.")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
@click.pass_context
def bench(
    context: click.Context,
    /,
    full: bool,
    campaign: bool,
    parts: tuple[str, ...],
    page: Path | None,
    as_json: bool,
    **amounts: Any,
) -> int:
    """Measure what a flight costs on this machine, in microseconds and in JSBSim runs.

    Beside bare JSBSim, and beside ecos, libcosim, FMPy and RotorPy as far as they are installed.  Times belong to the
    machine: however long anything takes, the exit status is 0.
    """
    from cosim.bench import make_plan, measure
    from cosim.bench.page import check_page, write_page
    from cosim.bench.show import print_result, progress
    from cosim.bench.targets import to_dict

    plan = make_plan(full, campaign, parts, amounts)
    if page is not None:
        check_page(page)
    with progress(quiet=as_json) as tell:
        result = measure(plan, tell)
    if page is not None:
        write_page(page, result, _as_given(context))
    if as_json:
        click.echo(json.dumps(to_dict(result), allow_nan=False))
    else:
        print_result(result)
    return FLIGHT_FAILED if result.failed else DONE


def _as_given(context: click.Context) -> str:
    """The command with the options that were given, as it can be typed again."""
    words = ["hexjet", context.info_name or ""]
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if context.get_parameter_source(parameter.name or "") is ParameterSource.COMMANDLINE:
            for item in value if isinstance(value, tuple) else [value]:
                text = f"{item:g}" if isinstance(item, float) else str(item)
                words += [max(parameter.opts, key=len), *([] if item is True else [text])]
    return shlex.join(words)
