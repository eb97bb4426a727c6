"""hexjet bench: what it costs."""

from __future__ import annotations

import shlex

import click

from cosim.commands import DONE, FLIGHT_FAILED, example, is_given, opt


class Bench(opt.Output):
    """Options of ``hexjet bench``."""

    full = opt.flag("--full", "More rounds of longer flights.")
    parts = opt.words(
        "--only",
        "PART",
        "This part alone, or these: step, peers, pathsim, rotorpy, start.",
    )
    steps = opt.whole("--steps", None, "Steps of a timed flight.  [2500, with --full 5000]", min=250)
    rounds = opt.whole("--rounds", None, "Repetitions.  [5, with --full 9]", min=1)
    starts = opt.whole("--starts", None, "Processes started for each figure of a process.  [5]", min=1)
    folder = opt.path("--dir", "DIR", "Where flights are recorded.", exists=True, file_okay=False)
    page = opt.path("--page", "FILE.md", "Write the tables in.", dir_okay=False)
    as_json = opt.JSON


@click.command(epilog=example("hexjet bench --only step --only peers"))
@opt.takes(Bench)
def bench(options: Bench) -> int:
    """Measure what a flight costs on this machine, in microseconds and in JSBSim runs.

    Beside bare JSBSim, and beside ecos, libcosim, FMPy, PathSim and RotorPy as far as they are installed.  Times belong
    to the machine: however long anything takes, the exit status is 0.
    """
    from benchmarks.page import check_page, write_page
    from benchmarks.show import print_result, progress
    from benchmarks.suite import make_plan, measure
    from benchmarks.targets import to_dict

    amounts = options.chosen("steps", "rounds", "starts", "folder")
    plan, page = make_plan(options.full, options.parts, amounts), options.page
    if page is not None:
        check_page(page)
    with progress(quiet=options.as_json) as tell:
        result = measure(plan, tell)
    if page is not None:
        write_page(page, result, _command_line())
    options.answer(lambda: to_dict(result), lambda: print_result(result))
    return FLIGHT_FAILED if result.failed else DONE


def _command_line() -> str:
    """Return the running command with the options that were given, as it can be typed again."""
    context = click.get_current_context()
    words = ["hexjet", context.info_name or ""]
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if is_given(parameter.name or ""):
            for item in value if isinstance(value, tuple) else [value]:
                text = f"{item:g}" if isinstance(item, float) else str(item)
                words += [max(parameter.opts, key=len), *([] if item is True else [text])]
    return shlex.join(words)
