"""A long flight in a process of its own that says how much memory it holds: see :mod:`cosim.bench.process`."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

from cosim.errors import FlightError
from cosim.flight import fly
from cosim.run import REPORT
from cosim.scenario import Scenario
from cosim.signals import Sample

MEGABYTE = 1e6
PARTS = 4  # of the flight, at whose ends memory is looked at


def fly_long(folder: Path, minutes: float, tell: Callable[[str, int], None]) -> None:
    """Fly ``hover`` for so long, recorded in full; ``tell`` is called with each landmark and the steps until there."""
    hover = Scenario.load("hover")
    scenario = hover.replace(duration_s=round(60.0 * minutes / hover.step_s) * hover.step_s, expect=[])
    marks = {scenario.steps * part // PARTS - 1: f"{part}/{PARTS}" for part in range(1, PARTS + 1)}

    class Watch:
        def observe(self, sample: Sample) -> None:
            if sample.k in marks:
                tell(marks[sample.k], sample.k + 1)

    tell("start", 0)
    run = fly(scenario, folder, observers=[Watch()], report=False)
    if run.outcome != "completed":
        raise FlightError(f"the long flight ended early: {run.reason}")
    tell("log and summary", run.summary.steps)
    from cosim.report import write_report  # as late as a flight has it

    write_report(run, folder / REPORT)
    tell("report", run.summary.steps)


def resident_and_peak() -> tuple[float | None, float]:
    """Resident memory of this process, None if the system does not tell, and the most there was of it: MB."""
    try:
        with open("/proc/self/status", encoding="utf-8", errors="replace") as status:
            words = [line.split() for line in status]
    except OSError:
        import resource

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # bytes on macOS, kilobytes elsewhere
        return None, peak * (1.0 if sys.platform == "darwin" else 1024.0) / MEGABYTE
    # not ru_maxrss, which on Linux begins with that of the process that started this one
    kilobytes = {row[0]: int(row[1]) for row in words if row[0] in ("VmRSS:", "VmHWM:")}
    return 1024 * kilobytes["VmRSS:"] / MEGABYTE, 1024 * kilobytes["VmHWM:"] / MEGABYTE


def _tell(where: str, steps: int) -> None:
    print(json.dumps([where, *resident_and_peak(), steps]), flush=True)


if __name__ == "__main__":
    fly_long(Path(sys.argv[1]), float(sys.argv[2]), _tell)
