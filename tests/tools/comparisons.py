"""Pages with several runs laid over each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cosim import Run
from cosim.results.comparison import compare_with_first
from cosim.results.report.comparison import ComparedFlight, write_comparison


def compare_report(runs: Sequence[Run], path: Path) -> None:
    """Write one page with several runs laid over each other."""
    flights = [ComparedFlight(run.summary.controller_shown, run.log, run) for run in runs]
    write_comparison(flights, compare_with_first(flights), path)
