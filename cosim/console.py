"""What a person sees in the terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.engine import CheckReport
    from cosim.identify import Identification
    from cosim.paper.reproduce import Reproduction
    from cosim.run import Run
    from cosim.scenario import Scenario
    from cosim.signals import Sample
    from cosim.simulation import Observer

_PIPE_WIDTH = 120
_COLUMNS = (
    ("rmse, rad", "rmse_rad", "{:.4f}"),
    ("max error, rad", "max_abs_error_rad", "{:.4f}"),
    ("overshoot, %", "overshoot_percent", "{:.1f}"),
    ("settling, s", "settling_time_s", "{:.2f}"),
    ("rate rmse, rad/s", "rate_rmse_rad_s", "{:.4f}"),
    ("final error, rad", "final_error_rad", "{:.4f}"),
)


@contextmanager
def flight_progress(scenario: Scenario, quiet: bool) -> Iterator[Sequence[Observer]]:
    """An observer that shows how far the flight is, on a terminal; none in a pipe."""
    if quiet or not sys.stderr.isatty():
        yield ()
        return
    from rich.console import Console
    from rich.progress import Progress

    every = max(1, round(0.5 / scenario.step_s))
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(scenario.name, total=scenario.steps)

        class Watch:
            def observe(self, sample: Sample) -> None:
                if sample.k % every == 0:
                    progress.update(task, completed=sample.k)

        yield (Watch(),)


@contextmanager
def output_to_stderr(active: bool) -> Iterator[None]:
    """While a flight must leave standard output alone, send what an FMU or a library prints there to standard error."""
    if not active:
        yield
        return
    import ctypes
    import os

    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        ctypes.CDLL(None).fflush(None)  # what C code has printed but not yet written
        os.dup2(kept, 1)
        os.close(kept)


@contextmanager
def part_progress(title: str, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """A function that is told the part that is done, how many are, and of how many; shown on a terminal."""
    if quiet or not sys.stderr.isatty():
        yield lambda part, done, of: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(title, total=None)
        yield lambda part, done, of: progress.update(task, description=part, completed=done, total=of)


def print_run(run: Run) -> None:
    """Outcome, metrics, what was expected and not met, and where the report is."""
    summary = run.summary
    console = _console()
    console.print(f"{summary.scenario}: [bold]{run.outcome}[/bold], {run.reason}", highlight=False)
    console.print(
        f"{summary.aircraft}, engine {summary.engine}, controller {summary.controller}, seed {summary.seed}: "
        f"{summary.duration_s:.2f} s flown" + _speed(summary.realtime_factor),
        highlight=False,
    )
    print_metrics([run])
    for complaint in summary.complaints:
        console.print(f"not as expected: {complaint}", highlight=False)
    if run.folder is not None:
        console.print(f"report: {run.folder / 'report.html'}", highlight=False, soft_wrap=True)


def print_metrics(runs: Sequence[Run], by: str = "axis") -> None:
    """A table of the commanded axes' metrics, one row an axis and run; ``by`` names the first column."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    table.add_column(by)
    for title, _, _ in _COLUMNS:
        table.add_column(title, justify="right")
    for run in runs:
        for axis, metrics in run.metrics.items():
            if metrics.commanded or by == "axis":
                label = axis if by == "axis" else f"{run.summary.controller}, {axis}"
                table.add_row(label, *[_cell(getattr(metrics, key), form) for _, key, form in _COLUMNS])
    _console().print(table)


def print_catalogue(found: dict[str, list[dict[str, Any]]]) -> None:
    """Names and titles, kind by kind."""
    console = _console()
    for kind, entries in found.items():
        if len(found) > 1:
            console.print(f"[bold]{kind}[/bold]")
        width = max((len(entry["name"]) for entry in entries), default=0)
        for entry in entries:
            console.print(f"  {entry['name']:{width}}  {entry['title']}", highlight=False, soft_wrap=True)


def print_check(report: CheckReport) -> None:
    """The findings, one to a line, problems last."""
    console = _console()
    for label, value in report.lines():
        console.print(f"{label:22} {value}", highlight=False, soft_wrap=True)
    for problem in report.problems:
        console.print(f"problem: {problem}", highlight=False, soft_wrap=True)
    console.print("fit to fly" if report.ok else "not fit to fly", style="bold")


def print_identification(found: Identification, paths: dict[str, Path]) -> None:
    """The models side by side, the chosen one's discrete form, how the stated one compares, and where the files are."""
    from rich import box
    from rich.table import Table

    from cosim.identify.result import equations, fit_rows

    console = _console()
    sweep, response = found.sweep, found.response
    console.print(
        f"{found.subject}: [bold]{found.channel}[/bold], {sweep.from_hz:.3g} to {sweep.to_hz:.3g} Hz in "
        f"{sweep.duration_s:g} s, amplitude {sweep.amplitude:.3g}; {len(response.hertz)} points, "
        f"coherence at least {response.coherence.min():.4f}",
        highlight=False,
    )
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("with 95 % bounds")
    for fit in found.fits:
        table.add_column(fit.label, justify="right")
    for row in fit_rows(found):
        table.add_row(*row)
    console.print(table)
    for text in equations(found):
        console.print(f"G(z) = {text}", highlight=False, markup=False)
    deviation = found.reference_deviation()
    if found.reference is not None and deviation is not None:
        console.print(
            f"the model that {found.subject} states ({found.reference.source}) is within {deviation[0]:.2f} dB and "
            f"{deviation[1]:.1f} deg of the response",
            highlight=False,
        )
    if found.ledger_samples is not None:
        console.print(f"all delay as the delay ledger has it: {found.ledger_samples:.2f} samples", highlight=False)
    for note in found.notes:
        console.print(f"note: {note}", highlight=False)
    for name in ("model", "report"):
        if name in paths:
            console.print(f"{name}: {paths[name]}", highlight=False, soft_wrap=True)


def print_paper(found: Reproduction, report: Path) -> None:
    """Claims and numbers of the paper beside ours, how many claims follow, and where the report is."""
    from rich import box
    from rich.table import Table

    from cosim.paper.page import compared, tally

    console = _console()
    table = Table(box=box.SIMPLE_HEAD)
    for title in ("quantity", "unit", "paper", "linear", "", "flight", "", "origin"):
        table.add_column(title, justify="left" if title in ("quantity", "unit", "origin") else "right")
    for row in compared(found.rows):
        name = f"{row.quantity} ({row.note})" if ".state" in row.key else row.quantity
        linear = _cell(row.linear, "{:.4g}"), _cell(row.linear_deviation, "{:+.1f} %")
        flight = _cell(row.flight, "{:.4g}"), _cell(row.flight_deviation, "{:+.1f} %")
        table.add_row(name, row.unit, f"{row.paper:.4g}", *linear, *flight, row.origin)
    console.print(table)
    table = Table(box=box.SIMPLE_HEAD)
    for title in ("claim", "linear plant", "six degrees of freedom"):
        table.add_column(title)
    for claim in found.claims:
        table.add_row(claim.claim, claim.linear.verdict, claim.flight.verdict if claim.flight else "-")
    console.print(table)
    for fidelity, counts in tally(found.claims).items():
        said = ", ".join(f"{verdict}: {count}" for verdict, count in counts.items() if count)
        console.print(f"{len(found.claims)} claims, {fidelity}: {said}", highlight=False)
    console.print(f"report: {report}", highlight=False, soft_wrap=True)


def _speed(factor: float | None) -> str:
    return "" if factor is None else f", {factor:.0f} x real time"


def _cell(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _console() -> Any:
    from rich.console import Console

    # in a pipe there is no width to fit
    return Console() if sys.stdout.isatty() else Console(width=_PIPE_WIDTH)
