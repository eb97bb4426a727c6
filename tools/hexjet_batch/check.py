"""One flight on arrays beside the same one by JSBSim: what ``hexjet batch check`` calls."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from math import degrees, inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.api.call import Progress, Result, Table, check_types
from cosim.api.call.choices import apply_choices
from cosim.api.flights import fly
from cosim.base.errors import InputError
from cosim.base.storage.files import write_files
from cosim.commands import Command
from cosim.pages import Card
from cosim.results.comparison import ComparedFlight, LogComparison, compare_with_first
from cosim.results.log.recorder import MemoryLog
from cosim.results.log.tables import TIME
from cosim.results.metrics import flatten, flight_metrics
from cosim.results.report.comparison import write_comparison
from cosim.results.run import Run
from cosim.results.wording import DIGITS, metric
from cosim.spec.scenario import Scenario
from hexjet_batch.fly import BatchFlight, fly_batch

PLACE = ("north_m", "east_m", "altitude_m")  # columns of the position
# Of every sample: the columns of a quantity, its unit and what the two may differ by.
QUANTITIES = (
    (("roll_rad", "pitch_rad", "yaw_rad"), "deg", 2e-3),
    (("rate_p_rad_s", "rate_q_rad_s", "rate_r_rad_s"), "deg/s", 1e-2),
    (PLACE, "m", 0.05),
)


class Difference(NamedTuple):
    """How far the batch is from JSBSim in a quantity or a metric, in its unit, and how far it may be."""

    label: str
    unit: str
    batch: float | None
    jsbsim: float | None
    apart: float
    allowed: float

    @property
    def is_within(self) -> bool:
        """Whether the difference is no larger than allowed."""
        return self.apart <= self.allowed

    @property
    def cells(self) -> tuple[str, ...]:
        """The difference as texts, a row of a table."""
        ends = ["" if value is None else f"{value:.6g}" for value in (self.batch, self.jsbsim)]
        return (self.label, self.unit, *ends, f"{self.apart:.2g}", f"{self.allowed:.2g}")


class CheckResult(Result):
    """A batch's flight of a scenario compared with JSBSim's.

    Attributes
    ----------
    samples : list of Difference
        The largest difference of each quantity over all samples.
    metrics : list of Difference
        That of each metric.
    """

    def __init__(self, scenario: Scenario, flight: BatchFlight, run: Run) -> None:
        assert flight.ending is not None
        self.scenario, self.endings = scenario, (flight.ending.outcome, run.outcome)
        there, here = run.log, flight.log
        described = tuple(column for column in there.described if column.name in here.columns)
        names = [column.name for column in described]
        time = scenario.step_s * np.arange(len(here))
        log = MemoryLog([np.stack([time, *map(here.__getitem__, names)])], (TIME, *names), described)
        self.flights = ComparedFlight("A: JSBSim", there, run), ComparedFlight("B: batch", log)
        (self.compared,) = compare_with_first(self.flights)
        self.samples = list(find_differences(self.compared, *self.flights))
        numbers = flatten(flight_metrics(here, scenario.step_s, run.summary.reach))
        self.metrics = compare_metrics(numbers, run.summary.flat_metrics)
        self.files = {}

    @property
    def is_same(self) -> bool:
        """Whether outcome, samples and metrics are those of JSBSim."""
        return self.endings[0] == self.endings[1] and all(one.is_within for one in (*self.samples, *self.metrics))

    def to_dict(self) -> dict[str, Any]:
        """Return what ``hexjet batch check --json`` prints."""
        return {
            "scenario": self.scenario.name,
            "same": self.is_same,
            "outcomes": self.endings,
            "jsbsim_runs": self.scenario.substeps,
            "samples": [one._asdict() for one in self.samples],
            "metrics": [one._asdict() for one in self.metrics],
        }

    def lines(self) -> list[str]:
        """Return whether both flights are the same, and what differs."""
        outcome, other = self.endings
        if outcome != other:
            return [f"not the same flight: {outcome} by the batch, {other} by JSBSim"]
        found = (*self.samples, *self.metrics)
        off = [f"{one.label} by {one.apart:.2g} {one.unit}" for one in found if not one.is_within]
        by = f"JSBSim at {self.scenario.substeps} runs a step"
        return [f"not as {by}: {', '.join(off)}" if off else f"the same flight as by {by}, {outcome}"]

    def tables(self) -> list[Table]:
        """Return the largest differences of the samples, and those of the metrics."""
        columns = ("", "unit", "batch", "JSBSim", "apart", "allowed")
        named = ("Samples", self.samples), ("Metrics", self.metrics)
        return [Table(name, columns, [one.cells for one in found]) for name, found in named]

    def write(self, folder: Path) -> None:
        """Write the page and its numbers.  Raises FlightError if a file cannot be written."""
        self.files = {"report": folder / "report.html", "json": folder / "check.json"}
        write_files({self.files["json"]: json.dumps(self.to_dict(), indent=2) + "\n"})
        tables = [Card(table.title, table.columns, table.rows, is_half=True) for table in self.tables()]
        cards = [Card("A batch beside JSBSim", lines=self.lines()), *tables]
        write_comparison(self.flights, [self.compared], self.files["report"], cards)


@check_types()
def check(
    scenario: Scenario | str | Path,
    out: str | Path | None = None,
    *,
    controller: str | Path | None = None,
    aircraft: str | Path | None = None,
    engine: str | Path | Sequence[str] | None = None,
    settings: Sequence[str] | Mapping[str, object] = (),
    runs: int = 16,
    progress: Progress | None = None,
) -> CheckResult:
    """Fly a scenario on arrays and by JSBSim, and say where the two differ.

    Parameters
    ----------
    scenario : Scenario or str or Path
        What is flown, with aircraft, engine and controller where they are not given.
    out : str or Path or None
        Folder of the page; None: none is written.
    controller : str or Path or None
        In place of the scenario's.
    aircraft : str or Path or None
        In place of the scenario's, with the engine that it is made for.
    engine : str or Path or sequence of str or None
        In place of the scenario's.
    settings : sequence of str or mapping
        Written over the scenario's.
    runs : int
        Runs of JSBSim in a control step.
    progress : Progress or None
        Hears notes.

    Returns
    -------
    CheckResult
        Both flights, and the largest differences.

    Raises
    ------
    InputError
        For what a batch does not cover.
    """
    flown = apply_choices(scenario, controller, aircraft, engine, settings, note=(progress or Progress()).note)
    flown = flown.model_copy(update={"substeps": runs, "expect": [], "require": []})
    (flight,) = fly_batch([flown])
    if flight.ending is None:
        raise InputError(f"scenario {flown.name}: {flight.reason}: not flown in a batch; fly it without batch")
    run = fly(flown, report=False)
    result = CheckResult(flown, flight, run)
    if out is not None:
        result.write(Path(out))
    return result


def find_differences(compared: LogComparison, there: ComparedFlight, here: ComparedFlight) -> Iterator[Difference]:
    """Yield the largest difference of each quantity; of a place 0.5 % of the way flown is allowed too."""
    moves = [np.diff(there.log[name]) for name in PLACE]
    way = float(np.sum(np.sqrt(sum(move * move for move in moves))))
    signals = {signal.name: signal for signal in compared.signals}
    for names, unit, allowed in QUANTITIES:
        factor, allowed = (1.0, max(allowed, 0.005 * way)) if unit == "m" else (degrees(1.0), allowed)
        for name in names:
            signal = signals[name]
            row = np.searchsorted(there.log[TIME], signal.largest_s or 0.0)
            batch, jsbsim = (float(factor * flight.log[name][row]) for flight in (here, there))
            apart = inf if signal.largest is None or signal.alone else factor * signal.largest
            yield Difference(metric(name).label, unit, batch, jsbsim, apart, allowed)


def compare_metrics(here: Mapping[str, float | None], there: Mapping[str, float | None]) -> list[Difference]:
    """Return the difference of each metric that either has; 0.5 % is allowed, or one of its last printed digit."""
    found = []
    for name, value in there.items():
        said, own = metric(name), here[name]
        if value is None and own is None:
            continue
        ends = [None if number is None else said.factor * number for number in (own, value)]
        apart = inf if ends[0] is None or ends[1] is None else abs(ends[0] - ends[1])
        allowed = max(0.005 * abs(ends[1] or 0.0), 10.0 ** -DIGITS[name])
        found.append(Difference(said.label, said.unit, ends[0], ends[1], apart, allowed))
    return found


command = Command(
    "batch check",
    "hexjet_batch.check:check",
    "roll-doublet --controller baseline",
    metavars={"engine": "[N=]NAME|FILE", "runs": "N"},
    succeeded=lambda result: result.is_same,
    ends="Status 1: they differ by more than is allowed.",
)
