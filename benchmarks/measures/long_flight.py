"""A long flight in a process of its own that says how much memory it holds: see :mod:`benchmarks.measures.process`."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

from cosim import FlightError, Scenario, fly
from cosim.base.signals import Sample
from cosim.results.run import REPORT

MEGABYTE = 1e6
INTERVALS = 4  # of the flight, at whose ends memory is looked at
WRITTEN, REPORTED = "log and summary", "report"


def fly_long(folder: Path, minutes: float, tell: Callable[[str, int], None], last: str = REPORTED) -> None:
    """Fly ``hover`` for so long, recorded in full; ``tell`` is called with each landmark and the steps until there.

    ``last``: the landmark that ends it.
    """
    hover = Scenario.load("hover")
    scenario = hover.replace(duration_s=round(60.0 * minutes / hover.step_s) * hover.step_s, expect=[])
    marks = {scenario.steps * part // INTERVALS - 1: f"{part}/{INTERVALS}" for part in range(1, INTERVALS + 1)}

    class Watch:
        def observe(self, sample: Sample) -> None:
            if sample.k in marks:
                tell(marks[sample.k], sample.k + 1)

    tell("start", 0)
    run = fly(scenario, folder, observers=[Watch()], report=False)
    if run.outcome != "completed":
        raise FlightError(f"the long flight ended early: {run.reason}")
    tell(WRITTEN, run.summary.steps)
    if last == WRITTEN:
        return
    from cosim.results.report.flight import write_report  # as late as a flight has it

    write_report(run, folder / REPORT)
    tell(REPORTED, run.summary.steps)


def resident_and_peak() -> tuple[float | None, float]:
    """Resident memory of this process, None if the system does not tell, and the most there was of it: MB."""
    # not ru_maxrss, which on Linux begins with that of the process that started this one
    status = _status("self")
    if status:
        return status["VmRSS:"], status["VmHWM:"]
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # bytes on macOS, kilobytes elsewhere
    return None, peak * (1.0 if sys.platform == "darwin" else 1024.0) / MEGABYTE


def resident_of(process: str) -> float | None:
    """Resident memory of a process by its number, MB; None if the system does not tell, or it has ended."""
    return _status(process).get("VmRSS:")


def _status(process: str) -> dict[str, float]:
    """Return what Linux says of a process's memory, MB; nothing where there is no such process, or no Linux."""
    try:
        with open(f"/proc/{process}/status", encoding="utf-8", errors="replace") as status:
            words = [line.split() for line in status]
    except OSError:
        return {}
    return {row[0]: 1024 * int(row[1]) / MEGABYTE for row in words if row[0] in ("VmRSS:", "VmHWM:")}


def main(folder: str, minutes: str, last: str) -> None:
    """Print a JSON array at each landmark: its name, resident memory, the most there was, and the steps."""

    def tell(where: str, steps: int) -> None:
        print(json.dumps([where, *resident_and_peak(), steps]), flush=True)

    fly_long(Path(folder), float(minutes), tell, last)
