"""What a second worker brings to a campaign, beside what a second process brings to bare JSBSim.

Two cores share a memory bus, and may share more.  So how far a campaign scales is judged by how far JSBSim alone does,
in the same minutes: each round times one process and two, bare and flying, to and fro.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from subprocess import Popen
from typing import TYPE_CHECKING, NamedTuple

from benchmarks.measures.campaign_flight import FlightCost, measure_flight_cost
from benchmarks.measures.long_flight import resident_of
from benchmarks.measures.process import start_python
from benchmarks.timing import Spread
from cosim import FlightError

if TYPE_CHECKING:
    from types import TracebackType

    from cosim.campaign.study.plan import Flight
    from cosim.campaign.study.study import Study
    from cosim.campaign.workers.flight_row import Row
    from cosim.campaign.workers.protocol import Workers

PROCESSES = (1, 2)
WARM = 5  # flights of each worker that are not timed, at the beginning and at the end
EARLY = 50  # flights of a worker after which its memory is first looked at
SLICES = 10  # of the long study, whose rates are compared

_BARE = "from benchmarks.measures.bare_runs import main; main()"


@dataclass(frozen=True)
class Scaling:
    """Throughput by number of processes, all together, and from one process to two, round by round."""

    rate: dict[int, Spread]  # 1/s
    gain: Spread


@dataclass(frozen=True)
class WorkerMemory:
    """Resident memory of one worker after its first ``EARLY`` flights and after its last, MB."""

    flights: int
    early_mb: float | None
    end_mb: float | None


@dataclass(frozen=True)
class LongStudy:
    """One study flown by two workers from end to end.  ``rate``: flights a second, over tenths of the study."""

    flights: int
    wall_s: float
    rate: Spread
    workers: list[WorkerMemory]


@dataclass(frozen=True)
class CampaignCost:
    """``share``: the campaign's gain by bare JSBSim's gain, round by round.

    ``cheap_s``: what the study takes by the clock with as many JSBSim runs a step as ``substeps = "campaign"`` flies.
    """

    flight_s: float
    flights: int  # a worker flies in a round
    bare: Scaling  # JSBSim runs
    flown: Scaling  # flights
    share: Spread
    flight: FlightCost
    study: LongStudy | None
    cheap_s: float | None


class _Look(NamedTuple):
    """When a row came, and what the worker that flew it then held."""

    time: float
    worker: str
    resident: float | None


class Watched:
    """Workers whose rows are looked at as they come."""

    def __init__(self, workers: Workers) -> None:
        self._workers = workers
        self.looks: list[_Look] = []

    def fly(self, study: Study, flights: Iterable[Flight]) -> Iterator[Row]:
        for row in self._workers.fly(study, flights):
            if row["outcome"] != "completed":
                raise FlightError(f"a timed flight of the campaign ended early: {row['reason']}")
            worker = str(row["worker"])
            self.looks.append(_Look(time.perf_counter(), worker, resident_of(worker.rpartition(":")[2])))
            yield row

    def close(self) -> None:
        self._workers.close()

    def __enter__(self) -> Watched:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@dataclass(frozen=True)
class CampaignPlan:
    """How much of a campaign is measured.

    ``rounds``, seconds of JSBSim alone, flights of a worker in a round, the first and last few of them not timed, how
    long they are, in how many rounds whole campaigns are flown to find what one costs without its flights, and how many
    flights the ``study`` after the rounds has (0: none).
    """

    rounds: int = 5
    bare_s: float = 1.5
    flights: int = 30
    flight_s: float = 10.0
    fixed_rounds: int = 3
    study: int = 0


def measure_campaign(plan: CampaignPlan, folder: Path, on_round: Callable[[], object]) -> CampaignCost:
    """Time both with one process and with two, and then a study from end to end."""
    bare: dict[int, list[float]] = {count: [] for count in PROCESSES}
    rates: dict[int, list[float]] = {count: [] for count in PROCESSES}
    with ExitStack() as stack:
        alone = stack.enter_context(Bare())
        workers = {count: stack.enter_context(_workers(count)) for count in PROCESSES}
        for number in range(plan.rounds):
            jobs = [(kind, count) for count in PROCESSES for kind in ("bare", "flown")]
            for kind, count in jobs if number % 2 == 0 else reversed(jobs):
                if kind == "bare":
                    bare[count].append(alone.rate(count, plan.bare_s))
                else:
                    study = make_study(count * plan.flights, plan.flight_s)
                    looks = fly_study(study, workers[count], folder / f"{number}-{count}")
                    rates[count].append(rate(looks, count))
            on_round()
    cost = measure_flight_cost(
        make_study(plan.flights, plan.flight_s), plan.flight_s, plan.fixed_rounds, folder, on_round
    )
    long = cheap_s = None
    if plan.study:
        looks, wall_s = _fly_long(make_study(plan.study, plan.flight_s), folder / "long")
        long = _long(looks, wall_s)
        _, cheap_s = _fly_long(make_study(plan.study, plan.flight_s, substeps="campaign"), folder / "cheap")
        on_round()
    gains = [[two / one for one, two in zip(*by.values(), strict=True)] for by in (bare, rates)]
    return CampaignCost(
        plan.flight_s,
        plan.flights,
        _scaling(bare, gains[0]),
        _scaling(rates, gains[1]),
        Spread.of([ours / theirs for theirs, ours in zip(*gains, strict=True)]),
        cost,
        long,
        cheap_s,
    )


def _fly_long(study: Study, folder: Path) -> tuple[list[_Look], float]:
    """Fly a study with new workers, and return when its rows came, and the time by the clock."""
    with _workers(PROCESSES[-1]) as fresh:
        begin = time.perf_counter()
        looks = fly_study(study, fresh, folder)
        return looks, time.perf_counter() - begin


def _scaling(rates: dict[int, list[float]], gain: list[float]) -> Scaling:
    return Scaling({count: Spread.of(values) for count, values in rates.items()}, Spread.of(gain))


def _workers(count: int) -> Workers:
    from cosim.campaign.workers.local import LocalWorkers

    return LocalWorkers(count)


def fly_study(study: Study, workers: Workers, folder: Path) -> list[_Look]:
    """Fly a study as ``hexjet sweep`` does, with a table on disk, and tell when each row came."""
    from cosim.campaign.run import run_campaign

    watched = Watched(workers)
    run_campaign(study, folder, watched)
    return watched.looks


def make_study(flights: int, seconds: float, **settings: str) -> Study:
    """``roll-doublet`` for so long, its mass a little other each time; ``settings`` are further ones."""
    from cosim.campaign.study.study import Study

    table = {
        "name": "benchmark",
        "scenario": "roll-doublet",
        "settings": {"duration_s": seconds} | settings,
        "design": "latin-hypercube",
        "runs": flights,
        "vary": [{"key": "vehicle.mass_kg", "relative": "factor", "range": [0.95, 1.05]}],
    }
    return Study.from_table(table, Path(), "benchmark")


def rate(looks: Sequence[_Look], workers: int) -> float:
    """Flights a second while all workers are warm and none has run out of flights."""
    busy = looks[WARM * workers - 1 : len(looks) - WARM * workers + 1]
    if len(busy) < 2:
        raise ValueError(f"{len(looks)} flights are too few for {workers} workers")
    return (len(busy) - 1) / (busy[-1].time - busy[0].time)


def _long(looks: Sequence[_Look], wall: float) -> LongStudy:
    edges = [round(part * (len(looks) - 1) / SLICES) for part in range(SLICES + 1)]
    rates = [(b - a) / (looks[b].time - looks[a].time) for a, b in pairwise(edges) if b > a]
    workers = []
    for worker in dict.fromkeys(look.worker for look in looks):
        resident = [look.resident for look in looks if look.worker == worker]
        workers.append(WorkerMemory(len(resident), resident[min(EARLY, len(resident)) - 1], resident[-1]))
    return LongStudy(len(looks), wall, Spread.of(rates), workers)


class Bare:
    """Processes that run JSBSim alone; they end when there is nobody left to ask them."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        self._children: list[Popen[str]] = []

    def __enter__(self) -> Bare:
        with ExitStack() as stack:
            for _ in range(PROCESSES[-1]):
                child = stack.enter_context(start_python(_BARE, ask=True))
                self._children.append(child)
            for child in self._children:
                _answer(child)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def rate(self, count: int, seconds: float) -> float:
        """JSBSim runs a second of ``count`` processes together."""
        children = self._children[:count]
        for child in children:
            assert child.stdin is not None
            with suppress(OSError):  # it has ended, which is seen when it is to answer
                child.stdin.write(f"{seconds!r}\n")
                child.stdin.flush()
        replies = [_answer(child).split() for child in children]
        return sum(int(runs) / float(spent) for runs, spent in replies)


def _answer(child: Popen[str]) -> str:
    assert child.stdout is not None
    line = child.stdout.readline()
    if not line:
        raise FlightError(f"the process that runs JSBSim alone ended with status {child.wait()}")
    return line
