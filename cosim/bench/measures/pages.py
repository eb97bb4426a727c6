"""What the page of a flight weighs, and how long it takes to write, by the seconds that were flown."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from cosim.base.errors import FlightError
from cosim.bench.timing import Spread
from cosim.flight import fly
from cosim.results.report.flight import write_report
from cosim.results.run import LOG
from cosim.spec.scenario import Scenario

FLIGHT = "roll-doublet"  # noisy sensors and all; after its script it hovers
MB = 1e-6


@dataclass(frozen=True)
class Page:
    """One page: megabytes with all in it and beside shared assets, and the log's; seconds to write it, and the same
    by those that the steps of the flight took.
    """

    whole_mb: float
    shared_mb: float
    log_mb: float
    write_s: Spread
    by_flight: Spread


@dataclass(frozen=True)
class Pages:
    """Pages by the seconds flown."""

    flight: str
    by_length: dict[int, Page]


def measure_pages(seconds: Sequence[int], rounds: int, folder: Path, on_round: Callable[[], object]) -> Pages:
    """Fly so long, recorded in full, and write the page of each several times.  Raises FlightError."""
    return Pages(FLIGHT, {length: _page(length, rounds, folder / f"{length}", on_round) for length in seconds})


def _page(seconds: int, rounds: int, folder: Path, on_round: Callable[[], object]) -> Page:
    run = fly(Scenario.load(FLIGHT).replace(duration_s=float(seconds), expect=[]), folder, report=False)
    if run.outcome != "completed" or not run.summary.wall_s:
        raise FlightError(f"the flight of {seconds} s ended early: {run.reason}")
    whole, shared = folder / "whole.html", folder / "shared.html"
    write_report(run, shared, shared_assets=True)
    took = []
    for _ in range(rounds):
        begin = time.perf_counter()
        write_report(run, whole)
        took.append(time.perf_counter() - begin)
        on_round()
    flown = run.summary.wall_s
    return Page(
        whole_mb=MB * whole.stat().st_size,
        shared_mb=MB * shared.stat().st_size,
        log_mb=MB * (folder / LOG).stat().st_size,
        write_s=Spread.of(took),
        by_flight=Spread.of([each / flown for each in took]),
    )
