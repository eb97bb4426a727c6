"""Pages with several runs laid over each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cosim import Run
from cosim.results.comparison import compare_with_first
from cosim.results.report.comparison import ComparedFlight, run_labels, write_comparison


def compare_report(runs: Sequence[Run], path: Path) -> None:
    """Write one page with several runs laid over each other."""
    labels = run_labels([run.summary for run in runs])
    flights = [ComparedFlight(label, run.log, run) for label, run in zip(labels, runs, strict=True)]
    write_comparison(flights, compare_with_first(flights), path)
