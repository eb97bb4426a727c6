"""The measurements on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from benchmarks.suite import PARTS, Result
from benchmarks.tables import ASKED, BESIDE, MACHINE, MISSED, Table, tables

if TYPE_CHECKING:
    from rich.table import Table as Drawn

QUIET_FRACTION = 0.95  # of processor time in the wall time, below which others had the machine too
UNIT = (
    "Median [quartiles] of the rounds; cpu: processor time of the thread.  A unit is one bare JSBSim run(), timed in "
    "the same round just before and after, cpu by cpu."
)


@contextmanager
def progress(quiet: bool) -> Iterator[Callable[[str, int, int], object]]:
    """Show on a terminal how far the measurements are; say nothing in a pipe."""
    if quiet or not sys.stderr.isatty():
        yield lambda what, done, total: None
        return
    from rich.console import Console
    from rich.progress import Progress, TaskID

    with Progress(console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def tell(part: str, done: int, total: int) -> None:
            if part not in tasks:
                tasks[part] = bars.add_task(part, total=total)
            bars.update(tasks[part], completed=done)

        yield tell


def print_result(result: Result) -> None:
    """Tables, and last what was asked for and what came out."""
    from rich.console import Console

    # in a pipe there is no width to keep to
    console = (
        Console(highlight=False, markup=False)
        if sys.stdout.isatty()
        else Console(highlight=False, markup=False, width=160)
    )
    machine, plan = result.machine, result.plan
    console.print(
        f"{machine.cpu}, {machine.cores} cores, {machine.system}, Python {result.versions['python']}, "
        f"JSBSim {result.versions.get('jsbsim', '?')}; {plan.rounds} rounds of {plan.steps} steps"
    )
    console.print(UNIT)
    if machine.processor_share is not None and machine.processor_share < QUIET_FRACTION:
        console.print(
            f"Other work took {1.0 - machine.processor_share:.0%} of the wall time: "
            "trust the units rather than the microseconds.",
            style="yellow",
        )
    if not machine.compiled:
        console.print("The modules of a control step are not compiled: make setup compiles them.", style="yellow")
    tables_by_part = tables(result)
    for key in [*(key for key in tables_by_part if key not in (ASKED, MISSED, BESIDE, MACHINE)), ASKED, BESIDE]:
        for table in tables_by_part[key]:
            console.print(_rich_table(table))
            for note in table.notes:
                console.print(note)
    for part, why in result.failed.items():
        console.print(f"{part} not measured: {why}", style="red")
    left_out = [part for part in PARTS if part not in tables_by_part and part not in result.failed]
    if left_out:
        console.print(f"not measured: {', '.join(left_out)}")


def _rich_table(table: Table) -> Drawn:
    from rich import box
    from rich.table import Table as Drawn

    drawn = Drawn(title=table.title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    drawn.add_column("", no_wrap=True)
    for column in table.columns:
        drawn.add_column(column, justify="right", no_wrap=True)
    for row in table.rows:
        drawn.add_row(*row)
    return drawn
