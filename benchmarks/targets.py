"""What the project asks of itself, and how the measurements stand to it."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.measures.browser import PageTimes
from benchmarks.measures.others import Others
from benchmarks.measures.own_blocks import CLASSES, CONTROLLER, FMU, ISOLATED, PREDICTOR, PROCESS, PROCESSES, RATE
from benchmarks.measures.process import FLY, HELP, IMPORT, UNIT
from benchmarks.measures.speed import ENGINES, OUTSIDE, RECORDED
from benchmarks.suite import Result
from benchmarks.timing import Spread

RUNS = "JSBSim runs"
OUTSIDE_UNITS = 1.0  # JSBSim runs, a control step of the standard flight
DEAREST_UNITS = 6.0  # of any other flight that is measured, of every vehicle
VEHICLE_TIMES = 2.0  # a step of any vehicle by the Hex-Jet's with as many JSBSim runs
HINGED = ("trijet", "quadjet", "jetwing")
BY_BARE = {1: 4.5, 4: 2.0}  # whole flight by bare JSBSim, by runs a step
ENGINE_UNITS = 1.5  # JSBSim runs: six engine FMUs, a control step
CLASS_UNITS = 1.5  # JSBSim runs more: a controller from outside, as a class
PROCESS_UNITS = 3.0  # JSBSim runs more, of wall time: what is exchanged with a process
FIRST_STEP_S = 1.5
COMMAND_UNITS = {HELP: 1.0, IMPORT: 1.0, FLY: 5.7}  # processor time by that of importing numpy and pydantic
PAGE_MB = {20: 1.5, 600: 12.0}  # by the seconds flown
CAMPAIGN_PAGE_MB = 2.0
CAMPAIGN_OPEN_S = 1.0
OPEN_S = 0.5  # until a page is laid out and first painted
FRAMES_S = 59.0  # of the 60 that a screen shows; what is counted in a few seconds is a frame more or less
STEP_GROWTH = 1.05  # the step of the longest flight by that of the shortest: what a quiet machine can tell from 1
FLIGHT_GROWTH_MB = 2.0  # from the first quarter of a long flight to its end: blocks of the log come and go
LONG_MINUTES = 60.0
LONG_PAGE_MB = 12.0
PEAK_MB = 200.0
CAMPAIGN_GAIN = 0.95  # of bare JSBSim's gain from one process to two
WORKER_GROWTH = 1.05  # a worker's memory at its end by that after its first flights
STUDY_FLIGHTS = 2000
STUDY_S = 60.0
CAMPAIGN_FLIGHT = 1.15  # a campaign's flight by its steps
CAMPAIGN_FIXED_S = 1.5  # processor time of a campaign without its flights

_OWN_KEYS = {
    PREDICTOR: "predictor",
    RATE: "rate",
    CONTROLLER: "controller",
    PROCESS: "process",
    ISOLATED: "isolated",
    FMU: "fmu",
}
_COMMAND_KEYS = {HELP: "help", IMPORT: "import", FLY: "fly"}


@dataclass(frozen=True)
class TargetResult:
    """One thing that is asked for: at most ``bound``, or at least if ``least``.  The median decides.

    ``key`` is its name in ``before.toml``.
    """

    name: str
    measured: Spread
    bound: float
    unit: str
    least: bool = False
    key: str = ""

    @property
    def met(self) -> bool:
        median = self.measured.median
        return median >= self.bound if self.least else median <= self.bound

    @property
    def before(self) -> str | None:
        """What it came to before, in words, as ``before.toml`` has it; None: it was not measured."""
        return values_before().get(self.key)


@cache
def values_before() -> dict[str, str]:
    """Return what was measured before, by key, whatever it is from."""
    table = tomllib.loads((Path(__file__).parent / "before.toml").read_text(encoding="utf-8"))
    return {key: value for source in table.values() for key, value in source.items()}


def judge_targets(result: Result) -> list[TargetResult]:
    """Everything that is asked for and was measured."""
    return [*_step(result), *_processes(result), *_campaign(result)]


def to_dict(result: Result) -> dict[str, Any]:
    """Return a result as it goes into JSON, with what is asked for."""
    return result.to_dict() | {
        "asked": [asdict(row) | {"met": row.met, "before": row.before} for row in judge_targets(result)]
    }


def runs_a_step(runs: int) -> str:
    """In words."""
    return f"{runs} run{'s' if runs > 1 else ''} a step"


def _step(result: Result) -> Iterator[TargetResult]:
    for runs, costs in (result.step or {}).items():
        in_it = runs_a_step(runs)
        yield TargetResult(
            f"not JSBSim, recorded in full, {in_it}", costs[OUTSIDE].units, OUTSIDE_UNITS, RUNS, key=f"outside-{runs}"
        )
        recorded = costs[RECORDED].units.times(1.0 / runs)
        yield TargetResult(
            f"whole flight by bare JSBSim, {in_it}", recorded, BY_BARE[runs], "times", key=f"bare-{runs}"
        )
        yield TargetResult(f"{ENGINES}, {in_it}", costs[ENGINES].units, ENGINE_UNITS, RUNS, key=f"engines-{runs}")
    if result.others:
        units = [cost.units for costs in result.others.outside.values() for cost in costs.values()]
        dearest = max(units, key=lambda each: each.median)
        name = "the dearest of the other flights, recorded in full"
        yield TargetResult(name, dearest, DEAREST_UNITS, RUNS, key="dearest")
        yield from vehicle_targets(result.others)
    if result.own:
        for name in CLASSES:
            yield TargetResult(f"more by {name}", result.own.more[name].units, CLASS_UNITS, RUNS, key=_OWN_KEYS[name])
        for name in PROCESSES:
            if name in result.own.more:
                wall = result.own.more[name].units_wall
                yield TargetResult(f"more by {name}, of wall time", wall, PROCESS_UNITS, RUNS, key=_OWN_KEYS[name])
    if result.time:
        shortest, longest = min(result.time.steps), max(result.time.steps)
        name = f"a step of {longest} s flown by one of {shortest} s"
        yield TargetResult(name, result.time.growth, STEP_GROWTH, "times", key="growth")


def vehicle_targets(others: Others) -> Iterator[TargetResult]:
    """Return every vehicle with hinges, and the dearest of all, by the Hex-Jet with as many runs a step."""
    for runs in next(iter(others.vehicles.values())):
        for vehicle in HINGED:
            if vehicle in others.vehicles:
                name = f"a step of the {vehicle} by the Hex-Jet's, {runs_a_step(runs)}"
                by_hexjet = others.vehicles[vehicle][runs]
                yield TargetResult(name, by_hexjet, VEHICLE_TIMES, "times", key=f"{vehicle}-{runs}")
        dearest = max(others.vehicles, key=lambda name: others.vehicles[name][runs].median)
        name = f"a step of the dearest vehicle, {dearest}, by the Hex-Jet's, {runs_a_step(runs)}"
        yield TargetResult(name, others.vehicles[dearest][runs], VEHICLE_TIMES, "times")


def _processes(result: Result) -> Iterator[TargetResult]:
    if result.pages:
        for seconds, page in result.pages.by_length.items():
            if seconds in PAGE_MB:
                name = f"the page of {seconds} s flown"
                yield TargetResult(name, Spread.of([page.whole_mb]), PAGE_MB[seconds], "MB", key=f"page-{seconds}")
                yield from _page_times(name, page.seen, f"page-{seconds}")
        campaign = result.pages.campaign
        name = f"the page of a campaign of {campaign.flights} flights"
        key = f"campaign-page-{campaign.flights}"
        yield TargetResult(name, Spread.of([campaign.mb]), CAMPAIGN_PAGE_MB, "MB", key=key)
        if campaign.seen:
            yield TargetResult(
                f"{name}, until it is there", campaign.seen.open_s, CAMPAIGN_OPEN_S, "s", key=f"{key}-open"
            )
    if result.start:
        yield TargetResult("from command to first step", result.start.first_step_s, FIRST_STEP_S, "s", key="first-step")
        for name, bound in COMMAND_UNITS.items():
            yield TargetResult(
                f"{name}, by {UNIT}", result.start.commands[name].units, bound, "times", key=_COMMAND_KEYS[name]
            )
    if result.memory:
        minutes = f"{result.memory.minutes:g} min flown"
        if result.memory.growth_mb:
            name, growth = f"memory gained from a quarter to the end, {minutes}", result.memory.growth_mb
            yield TargetResult(name, growth, FLIGHT_GROWTH_MB, "MB", key="memory-growth")
        long = result.memory.minutes == LONG_MINUTES  # before was that of an hour
        name = f"memory at its peak, page and all, {minutes}"
        yield TargetResult(name, result.memory.peak_mb, PEAK_MB, "MB", key="memory-page" if long else "")
        if result.memory.page_mb is not None:
            size = Spread.of([result.memory.page_mb])
            name = f"the page of {minutes}"
            yield TargetResult(name, size, LONG_PAGE_MB, "MB", key="page-long" if long else "")


def _page_times(name: str, times: PageTimes | None, key: str) -> Iterator[TargetResult]:
    if times:
        yield TargetResult(f"{name}, until it is there", times.open_s, OPEN_S, "s", key=f"{key}-open")
        yield TargetResult(
            f"{name}, scrolled", times.scrolled.rate, FRAMES_S, "frames a second", True, f"{key}-scrolled"
        )


def _campaign(result: Result) -> Iterator[TargetResult]:
    campaign = result.campaign
    if campaign is None:
        return
    name = "gain by a second worker, by bare JSBSim's"
    yield TargetResult(name, campaign.share, CAMPAIGN_GAIN, "times", True, "gain")
    name, by_steps = "a campaign's flight by its steps", campaign.flight.by_steps
    yield TargetResult(name, by_steps, CAMPAIGN_FLIGHT, "times", key="flight-by-steps")
    name = "processor time of a campaign without its flights"
    yield TargetResult(name, campaign.flight.fixed_s, CAMPAIGN_FIXED_S, "s", key="study-fixed")
    if campaign.study:
        growth = [
            worker.end_mb / worker.early_mb for worker in campaign.study.workers if worker.end_mb and worker.early_mb
        ]
        if growth:
            yield TargetResult(
                "memory of a worker, last flight by 50th",
                Spread.of(growth),
                WORKER_GROWTH,
                "times",
                key="worker-growth",
            )
        if campaign.study.flights == STUDY_FLIGHTS:
            wall = Spread.of([campaign.study.wall_s])
            name = f"{STUDY_FLIGHTS} flights of {campaign.flight_s:g} s, two workers"
            yield TargetResult(name, wall, STUDY_S, "s", key="study")
            if campaign.cheap_s is not None:
                yield TargetResult(f'{name}, substeps = "campaign"', Spread.of([campaign.cheap_s]), STUDY_S, "s")
