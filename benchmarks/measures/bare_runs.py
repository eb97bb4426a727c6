"""A process that only runs JSBSim's airframe when it is told to: see :mod:`benchmarks.measures.campaign`."""

from __future__ import annotations

import sys
import time

from benchmarks.measures.speed import bare, hover
from cosim.simulation.build import build

RUNS = 20_000  # from one reset to the next: 20 s in hover, in which it rises by some metres
SUBSTEPS = 4  # as the shipped scenarios have it


def main() -> None:
    """For each line with a number of seconds, run for so long; print the runs done and the seconds spent in them."""
    with build(hover(250, SUBSTEPS)) as simulation:
        print("ready", flush=True)
        for line in sys.stdin:
            end = time.perf_counter() + float(line)
            runs, spent = 0, 0.0
            while time.perf_counter() < end:
                action = bare(simulation, RUNS)
                begin = time.perf_counter()
                action()
                spent += time.perf_counter() - begin
                runs += RUNS
            print(runs, spent, flush=True)
