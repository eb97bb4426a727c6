"""The measurements as a person reads them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from cosim.bench.blocks import Breakdown
from cosim.bench.peers import ALONE, EXCHANGE, Peers
from cosim.bench.process import Memory, Startup
from cosim.bench.speed import BARE
from cosim.bench.suite import Result
from cosim.bench.timing import Cost, Spread

if TYPE_CHECKING:
    from rich.table import Table


@contextmanager
def progress(quiet: bool) -> Iterator[Callable[[str, int, int], object]]:
    """Shows on a terminal how far the measurements are; says nothing in a pipe."""
    if quiet or not sys.stderr.isatty():
        yield lambda what, done, total: None
        return
    from rich.console import Console
    from rich.progress import Progress, TaskID

    with Progress(console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def tell(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done)

        yield tell


def print_result(result: Result) -> None:
    """Tables, then what was asked for and what came out."""
    from rich.console import Console

    console = Console()
    machine, plan = result.machine, result.plan
    console.print(
        f"{machine.cpu}, {machine.cores} cores, {machine.system}, Python {result.versions['python']}, "
        f"JSBSim {result.versions.get('jsbsim', '?')}; {plan.rounds} rounds of {plan.steps} steps",
        highlight=False,
    )
    console.print(
        "Median [quartiles] of the rounds; cpu: processor time of the thread.  A unit is one bare JSBSim run(), timed "
        "in the same round just before and after, cpu by cpu.",
        highlight=False,
        markup=False,
    )
    if machine.processor_share < 0.95:
        console.print(
            f"Other work took {1.0 - machine.processor_share:.0%} of the wall time: "
            "trust the units rather than the microseconds.",
            style="yellow",
            highlight=False,
        )
    for substeps, costs in result.speed.items():
        console.print(_costs(f"one control step, JSBSim runs in it: {substeps}", costs))
    console.print(_blocks(result.breakdown))
    console.print(_peers(result.peers))
    for name, reason in result.peers.missing.items():
        console.print(f"{name} not measured: {reason}", style="yellow", highlight=False, markup=False)
    console.print(_startup(result.startup))
    if result.memory:
        console.print(_memory(result.memory))
    console.print(_headlines(result))


def _table(title: str, *columns: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    table.add_column("", no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table


def _spread(spread: Spread, digits: int) -> str:
    return f"{spread.median:.{digits}f} [{spread.low:.{digits}f}, {spread.high:.{digits}f}]"


def _costs(title: str, costs: dict[str, Cost]) -> Table:
    table = _table(title, "us wall", "us cpu", "units")
    for name, cost in costs.items():
        units = "1" if name == BARE else _spread(cost.units, 2)
        table.add_row(name, f"{cost.wall_us.median:.2f}", f"{cost.cpu_us.median:.2f}", units)
    return table


def _blocks(breakdown: Breakdown) -> Table:
    title = f"where it goes outside JSBSim, {breakdown.substeps} runs a step"
    table = _table(title, "us alone", "us in flight", "units", "%")
    whole = breakdown.outside.units.median
    for name, cost in breakdown.alone.items():
        met = breakdown.in_flight.get(name)
        us, units = ("-", cost.units.median) if met is None else (f"{met.us:.2f}", met.units)
        table.add_row(name, f"{cost.cpu_us.median:.2f}", us, f"{units:.2f}", f"{100.0 * units / whole:.0f}")
    rest = breakdown.rest_units
    table.add_row("rest: loop, records", "", "", f"{rest:.2f}", f"{100.0 * rest / whole:.0f}", end_section=True)
    table.add_row("all, recorded to disk", "", f"{breakdown.outside.cpu_us.median:.2f}", f"{whole:.2f}", "100")
    return table


def _peers(peers: Peers) -> Table:
    """Units of all threads' processor time: some of them step in threads of their own."""
    title = f"six instances of {peers.fmu}, {peers.steps} steps; units of all threads together"
    table = _table(title, "us wall", "units")
    for name, costs in peers.costs.items():
        for what in (EXCHANGE, ALONE):
            if what in costs:
                cost = costs[what]
                table.add_row(
                    f"{name} {peers.versions[name]}: {what}", _spread(cost.wall_us, 2), _spread(cost.units_process, 2)
                )
    return table


def _startup(startup: Startup) -> Table:
    table = _table("hexjet fly hover", "s")
    for name, spread in (
        ("Python starts", startup.python_s),
        ("imports", startup.imports_s),
        ("builds the flight, begins the log", startup.build_s),
        ("to the first step", startup.first_step_s),
    ):
        table.add_row(name, _spread(spread, 3))
    return table


def _memory(memory: Memory) -> Table:
    title = (
        f"{memory.minutes:g} min flown, {memory.steps} steps, in {memory.wall_s:.0f} s; folder {memory.log_mb:.0f} MB"
    )
    table = _table(title, "resident MB", "peak so far MB")
    for landmark in memory.landmarks:
        resident = "-" if landmark.resident_mb is None else f"{landmark.resident_mb:.0f}"
        where = f"{landmark.where} of the flight" if "/" in landmark.where else landmark.where
        table.add_row(where, resident, f"{landmark.peak_mb:.0f}")
    return table


def _headlines(result: Result) -> Table:
    table = _table("asked for", "measured", "at most", "")
    for name, value, most, unit in result.headlines():
        table.add_row(name, f"{value:.3g}", f"{most:g} {unit}", "" if value <= most else "over")
    return table
