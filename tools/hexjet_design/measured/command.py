"""hexjet margins: how much gain, phase and delay a controller's loops have left, measured in flight."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from cosim.base.signals import AXES
from cosim.commands import (
    DONE,
    FLIGHT_FAILED,
    CommandProgress,
    Flight,
    example,
    opt,
    output_to_stderr,
    part_progress,
    say,
    show_table,
    warn_of_fmu_defects,
)

if TYPE_CHECKING:
    from hexjet_design.measured.api import MarginsResult

BANDS = ("enough", "narrow")  # that may be asked for


class Margins(Flight, opt.Output):
    """Options of ``hexjet margins``."""

    scenario = opt.argument(default="hover")
    controller = opt.word(
        "--controller", "NAME|FILE", "As in hexjet fly: built in, a design's file, or one of yours in any way."
    )
    aircraft = opt.word(
        "--aircraft",
        "NAME|DIR",
        "Overrides the scenario's, with the engine that it is made for; see: hexjet list aircraft.",
    )
    engines = opt.ENGINES
    axes = opt.choices("--axis", AXES, "Axis that is measured; may be repeated.  [default: all]")
    amplitude = opt.number("--amplitude", "A", "Peak of the multisine: share of thrust, rad of tilt or rad/s^2.")
    from_hz = opt.positive("--from-hz", "HZ", "Lowest frequency.  [default: two periods]")
    to_hz = opt.positive("--to-hz", "HZ", "Highest frequency.  [default: a tenth of the control rate]")
    period_s = opt.positive("--period", "S", "Period of the multisine.  [default: 20, or 60 for a slow loop]")
    periods = opt.whole("--periods", None, "Periods that are measured.", min=3, default=5)
    limit = opt.flag("--limit", "Compare each computed loop with the best that any linear controller could do.")
    at_least = opt.choice(
        "--at-least", BANDS, "Status 1 where a margin is worse; narrow: for a well-known engine alone."
    )
    seed = opt.whole("--seed", None, "Seed of sensor noise and turbulence.")
    settings = opt.SETTINGS
    out = opt.OUT
    as_json = opt.JSON


@click.command(epilog=example("hexjet margins --controller mine.py:Mine --axis roll"))
@opt.takes(Margins)
def margins(options: Margins) -> int:
    """Measure gain, phase and delay margins, both ways, and peak sensitivity of any controller in flight.

    A multisine is added between the controller and its actuators while the vehicle of SCENARIO holds still; what passes
    before and behind gives the open loop, with 95 % bounds, beside the computed one where the controller is built in.
    The last line judges every margin by docs/judging.md and names the worst.  Status 0: measured, whatever the margins;
    1: with --at-least, a margin is worse; or the vehicle does not stay in the air.
    """
    from cosim.commands import one_thread

    one_thread()
    from cosim.spec.controller_name import folder_name
    from hexjet_design.measured.api import WRITTEN
    from hexjet_design.measured.api import margins as measure

    options.check_out(*WRITTEN)
    loaded, axes = options.load(), options.axes or AXES
    warn_of_fmu_defects(loaded.engine, folder=loaded.folder)
    chosen = options.chosen("amplitude", "from_hz", "to_hz", "period_s", "periods", "limit", "at_least")
    with output_to_stderr(options.as_json), part_progress("margins", options.as_json) as show:
        result = measure(loaded, axes, progress=CommandProgress(show), **chosen)
    name = f"margins-{folder_name(result.measured.controller)}"
    result.write(options.run_folder(name))
    options.answer(result.to_dict, lambda: print_margins(result))
    return FLIGHT_FAILED if result.kept is False else DONE


def print_margins(result: MarginsResult) -> None:
    """Print its tables, what is to be said about them, where the page is, and the judgement last."""
    first, judged, *more = result.lines()
    say(first)
    for table in result.tables():
        numbers = range(1, len(table.columns))
        show_table(table.columns, table.rows, numbers, title=table.title, title_justify="left", title_style="")
    for line in [*more, f"report: {result.report}", judged]:
        say(line, wrap=False)
