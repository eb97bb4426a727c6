"""Flights of a study on arrays: workers that hand them on in chunks, and the rows that come of them."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cosim.base.errors import InputError
from cosim.base.storage.cache import RecentCache
from cosim.results.limits import make_limit_inputs
from cosim.results.log.columns import logged_vehicle
from cosim.results.metrics import Reach, columns, metric_names
from cosim.results.requirements.signals import event_times
from cosim.results.requirements.stated import columns_of
from cosim.results.resolved_scenario import resolve
from cosim.results.run import Run
from cosim.results.setup import make_setup
from cosim.results.summary import Setup, summarize
from cosim.simulation.build import build
from cosim.studies import (
    Flight,
    Row,
    Study,
    Workers,
    failed_row,
    fly_one,
    outcome_row,
    scenario_of,
    with_values,
    worker_name,
)
from hexjet_batch.fly import BatchFlight, fly_batch
from hexjet_batch.make import read_flight
from hexjet_batch.referee import judge

if TYPE_CHECKING:
    from cosim.spec.scenario import Scenario

__all__ = ["BatchWorkers", "check", "judge"]

BATCH, JSBSIM = "batch", "jsbsim"
_setups: RecentCache[Setup] = RecentCache(16)


def check(study: Study) -> None:
    """Raise InputError, before the first flight, for a study that a batch does not cover."""
    where, base = f"study {study.name}", study.base()
    if study.autopilot is not None:
        raise InputError(f"{where}: an autopilot is not flown in a batch; fly it without batch")
    recorded = columns(logged_vehicle(base.resolved_vehicle()[0]))
    for name in columns_of(base, metric_names()):
        if name not in recorded:
            raise InputError(f"{where}: a batch does not record {name}, which it requires; fly it without batch")
    for controller in study.tried:
        read_flight(with_values(base, {"controller": controller}))


@dataclass(frozen=True)
class Chunk(Flight):
    """Flights that a process flies together, as one piece of its work; its row has all of theirs."""

    flights: tuple[Flight, ...] = ()

    def fly(self, study: Study) -> dict[str, Any]:
        """Fly them in this process."""
        begin = time.perf_counter()
        rows = fly_flights(study, self.flights)
        return {"flight": self.number, "rows": rows, "wall_s": time.perf_counter() - begin}


class BatchWorkers:
    """Flies a study's flights on arrays, in the processes of other workers.

    ``together``: flights of one chunk, by default up to 1024 whose logs come to 0.8 GB.  A chunk with which three
    processes were lost is flown by JSBSim, flight by flight.
    """

    def __init__(self, workers: Workers, together: int | None = None) -> None:
        if together is not None and together < 1:
            raise InputError(f"together = {together}: at least 1 flight")
        self._workers, self._together = workers, together

    def fly(self, study: Study, flights: Iterable[Flight]) -> Iterator[Row]:
        """See :class:`cosim.studies.Workers`."""
        under_way: dict[int, Chunk] = {}
        lost: list[Flight] = []
        together = self._together or min(1024, max(1, 2_560_000 // study.base().steps))
        for row in self._workers.fly(study, _chunks(iter(flights), under_way, together)):
            chunk, rows = under_way.pop(int(row["flight"] or 0)), row.get("rows")
            if rows is None:
                lost += chunk.flights
            else:
                yield from rows  # type: ignore[misc]  # a chunk's
        for row in self._workers.fly(study.changed(batch=False), lost):
            yield row | {"by": JSBSIM}

    def close(self) -> None:
        """End every process."""
        self._workers.close()

    def __enter__(self) -> BatchWorkers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _chunks(flights: Iterator[Flight], under_way: dict[int, Chunk], together: int) -> Iterator[Chunk]:
    """Yield chunks of one controller each, which fly together best, and note them by their numbers."""
    waiting: dict[str, list[Flight]] = {}
    for flight in flights:
        group = waiting.setdefault(flight.controller, [])
        group.append(flight)
        if len(group) == together:
            yield _chunk(waiting.pop(flight.controller), under_way)
    for group in waiting.values():
        yield _chunk(group, under_way)


def _chunk(flights: Sequence[Flight], under_way: dict[int, Chunk]) -> Chunk:
    first = flights[0]
    chunk = Chunk(first.number, first.draw, first.controller, first.seed, {}, tuple(flights))
    return under_way.setdefault(chunk.number, chunk)


def fly_flights(study: Study, flights: Sequence[Flight]) -> list[Row]:
    """Fly flights of a study together and return their rows, in their order.

    What a batch does not cover or judge, such as a flight near the ground, is flown by JSBSim.
    """
    begin = time.perf_counter()
    scenarios: dict[int, Scenario] = {}
    for place, flight in enumerate(flights):
        with suppress(InputError):  # JSBSim says why nothing flies it
            scenarios[place] = scenario_of(study, flight)
    try:
        rows = _fly(study, flights, scenarios)
    except InputError:  # one is not covered, which is rare
        rows = _fly(study, flights, {place: each for place, each in scenarios.items() if _is_covered(each)})
    seconds = (time.perf_counter() - begin) / max(len(rows), 1)
    alone = study.changed(batch=False)
    return [
        rows[place] | {"wall_s": seconds} if place in rows else fly_one(alone, flight) | {"by": JSBSIM}
        for place, flight in enumerate(flights)
    ]


def _is_covered(scenario: Scenario) -> bool:
    try:
        read_flight(scenario)
    except InputError:
        return False
    return True


def _fly(study: Study, flights: Sequence[Flight], scenarios: Mapping[int, Scenario]) -> dict[int, Row]:
    """Return the rows of the flights that a batch judges, by their places."""
    places, stated = list(scenarios), study.base().model_dump_json()
    blank = failed_row(study, flights[0], "")
    rows: dict[int, Row] = {}
    for flown in fly_batch(list(scenarios.values())):
        place = places[flown.number]
        if flown.ending is not None:
            flight = flights[place]
            own = {"flight": flight.number, "draw": flight.draw, "seed": flight.seed, **flight.values}
            rows[place] = blank | own | _outcome(study, stated, flight.controller, scenarios[place], flown)
    return rows


def _outcome(study: Study, stated: str, controller: str, scenario: Scenario, flown: BatchFlight) -> Row:
    """Return what a row says of a flight, measured by the functions that measure every flight."""
    assert flown.ending is not None
    vehicle = scenario.resolved_vehicle()[0]
    key = (stated, controller, scenario.aircraft, scenario.engine)
    setup = _setups.get(key, lambda: _setup(scenario)).model_copy(update={
        "seed": scenario.seed,
        "planned_s": scenario.duration_s,
        "reach": Reach(
            throttle=tuple(zip(*flown.numbers.reach, strict=True)),
            tilt_rad=vehicle.servo.range_rad if vehicle.servo else None,
        ),
        "yardstick": make_limit_inputs(scenario, vehicle),
        "event_times_s": event_times(scenario) if scenario.require else {},
    })  # fmt: skip
    log: Any = flown.log  # its columns are all that metrics read
    summary = summarize(setup, log, flown.ending.outcome, flown.ending.reason, None)
    outcome = outcome_row(study, Run(summary, log, None, scenario), "")
    return outcome | {"controller": controller, "worker": worker_name(), "log_sha256": None, "by": BATCH}


def _setup(scenario: Scenario) -> Setup:
    """Return what is known of a flight beforehand, most of which those of one study share."""
    with build(scenario, with_ledger=False) as simulation:
        return make_setup(simulation, resolve(simulation)[0], notes=False)
