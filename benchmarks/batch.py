"""What a control step of flights on arrays costs, in runs of bare JSBSim: python -m benchmarks.batch.

Of each size: the step of flights that are all alike, of drawn masses and inertias, of drawn delays and thrusts too,
with noise, and with the log and the metrics of the flight.  Every measurement stands between two of the unit, so that
ratios hold on a busy machine too.  Crazyflow (attitude control) is measured beside it where it is installed: pip
install crazyflow.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.measures.speed import BARE, WHOLE_STEP, Flights
from benchmarks.timing import Action, Cost, Job, Pair, interleave
from cosim import Scenario
from cosim.base.arrays import Array
from cosim.files import scratch
from cosim.pages import table
from cosim.results.metrics import flight_metrics
from hexjet_batch import read_flight, start, step
from hexjet_batch.fly import prepare
from hexjet_batch.log import BatchLog, FlightLog
from hexjet_batch.numbers import stack

SIZES = (64, 1024, 4096, 16384)
# The tables of the last flights, as a campaign's chunks have them.
MEMORY: dict[str, Array] = {}
# What is drawn, and what is kept of the flights.
ALIKE, MASSES, DELAYS = "all alike", "masses drawn", "delays and thrusts drawn too"
NOISE, METRICS = "masses and noise drawn", "the same, with log and metrics"
DRAWN = (ALIKE, MASSES, DELAYS, NOISE, METRICS)


def batch(size: int, what: str, rows: int) -> Action:
    """Return what flies ``rows`` steps of so many Hex-Jets, of 32 kinds where anything is drawn."""
    base = Scenario.load("roll-doublet").replace(duration_s=rows * 0.004, expect=[], sensor_noise=what in DRAWN[3:])
    kinds = [base] * 32
    if what != ALIKE:
        masses = ({"mass_kg": 5.4 + 0.01 * i, "inertia_kg_m2": [0.1 + 0.001 * i] * 3} for i in range(32))
        kinds = [base.replace(vehicle=vehicle) for vehicle in masses]
    if what == DELAYS:
        drawn = ({"delay_samples": i % 4, "thrust_factor": 0.98 + 0.001 * i} for i in range(32))
        kinds = [kind.replace(mismatch=mismatch) for kind, mismatch in zip(kinds, drawn, strict=True)]
    each = [read_flight(kind) for kind in kinds]
    scenarios = [kinds[i % 32].model_copy(update={"seed": i}) for i in range(size)]
    n, script, noise, heights, _, _, motion = prepare(scenarios, stack([each[i % 32] for i in range(size)]))

    def action() -> None:
        state, log = start(n, motion, heights, script.at(0)[1]), BatchLog(scenarios, rows, n.jets, MEMORY)
        for k in range(rows):
            command, inputs = script.at(k)
            if noise is not None:
                inputs = inputs._replace(draws=noise.at(k))
            state, outputs = step(n, state, inputs)
            if what == METRICS:
                log.add(command, inputs, outputs)
        if what == METRICS:
            log.finish()
            for first in range(0, size, 16):
                flight_metrics(FlightLog(log.tables, [*range(first, min(first + 16, size))], rows), n.step)

    return action


def crazyflow(size: int, rows: int) -> Callable[[], Action]:
    """Return what prepares ``rows`` steps of so many worlds of Crazyflow, by attitude.  Raises ImportError."""
    sims = import_module("crazyflow.sim")

    @cache
    def prepare_worlds() -> Action:
        sim = sims.Sim(n_worlds=size, control="attitude")
        asked = np.tile(np.array([0.0, 0.0, 0.0, 0.4], dtype=np.float32), (size, 1, 1))

        def action() -> None:
            for _ in range(rows):
                sim.attitude_control(asked)
                sim.step(1)
            np.asarray(sim.data.states.pos)

        action()  # what is compiled
        return action

    return prepare_worlds


def make_jobs(rows: int) -> Iterator[Job]:
    """Yield the jobs of every size; a step of a job is one of one vehicle."""
    for size in SIZES:
        steps = min(2500, max(rows // 2, 4096 * rows // size))
        for what in DRAWN:
            yield Job(f"batch of {size:,}, {what}", 1, size * steps, partial(batch, size, what, steps))
    try:
        for size in SIZES[1:3]:
            yield Job(f"Crazyflow, {size:,} worlds", 1, size * rows, crazyflow(size, rows))
    except ImportError as error:
        print(f"without Crazyflow: {error}")


def draw(costs: Mapping[str, float], path: Path) -> None:
    """Draw the costs by batch size, a line for what is drawn, and points for Crazyflow."""
    from matplotlib import pyplot as plt

    plt.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "batch", "font.family": "sans-serif"}
    figure, axes = plt.subplots(figsize=(7.0, 3.8), constrained_layout=True)
    lines = [(f"batch of {{:,}}, {what}", "o-", what) for what in DRAWN]
    for name, mark, label in (*lines, ("Crazyflow, {:,} worlds", "s", "Crazyflow, attitude control")):
        if found := {size: costs[name.format(size)] for size in SIZES if name.format(size) in costs}:
            axes.loglog([*found], [*found.values()], mark, ms=4, label=label)
    axes.axhline(1.0, color="0.6", ls=":", label=BARE)
    axes.set(xlabel="flights of a batch", ylabel="a vehicle and step,\nin runs of bare JSBSim")
    axes.set_xticks(SIZES, [f"{size:,}" for size in SIZES])
    axes.minorticks_off()
    axes.set_yticks(ticks := [0.05, 0.1, 0.2, 0.5, 1.0, 2.0], [str(tick) for tick in ticks])
    axes.legend(fontsize=8, frameon=False)
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.batch", description=__doc__)
    parser.add_argument("--rows", type=int, default=400, help="steps of 4,096 flights; of fewer flights more")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--figure", type=Path, help="file of the figure, such as docs/pictures/batch-cost.svg")
    asked = parser.parse_args()
    found: dict[str, list[Pair]] = defaultdict(list)
    with TemporaryDirectory(prefix="bench-", dir=scratch()) as folder, Flights(2500, Path(folder)) as flights:
        units = flights.units()
        whole = next(job for job in flights.jobs(1) if job.name == WHOLE_STEP)
        for job, pair in interleave([whole, *make_jobs(asked.rows)], units, asked.rounds):
            found[job.name].append(pair)
    unit = 1e6 * float(np.median([pair.unit.cpu for pairs in found.values() for pair in pairs]))
    costs = [(name, Cost.of(pairs)) for name, pairs in found.items()]
    rows = [(name, f"{cost.cpu_us.median:.2f}", f"{cost.units_process.median:.3f}") for name, cost in costs]
    print(table(("a vehicle and step", "us", f"of {BARE}"), [(BARE, f"{unit:.2f}", "1"), *rows], 2))
    if asked.figure is not None:
        draw({name: cost.units_process.median for name, cost in costs}, asked.figure)


if __name__ == "__main__":
    main()
