"""Flights of a study on arrays: workers that hand them on in chunks, and the rows that come of them."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.storage.cache import RecentCache
from cosim.results.limits import find_exceeded, flight_limits, make_limit_inputs
from cosim.results.log.columns import logged_vehicle
from cosim.results.metrics import columns, flatten, flight_metrics, metric_names
from cosim.results.requirements import FlightSignals, Lost, RequirementResult, flight_requirements
from cosim.results.requirements.signals import event_times
from cosim.results.requirements.stated import columns_of, stated_requirements
from cosim.results.resolved_scenario import resolve
from cosim.results.setup import make_setup
from cosim.results.summary import Setup
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
from hexjet_batch.fly import Group, fly_groups
from hexjet_batch.log import FlightLog
from hexjet_batch.make import read_flight
from hexjet_batch.numbers import Numbers
from hexjet_batch.referee import judge

if TYPE_CHECKING:
    from cosim.spec.scenario import Scenario

__all__ = ["BatchWorkers", "check", "judge"]

BATCH, JSBSIM = "batch", "jsbsim"
Metrics = dict[str, float | None]
Known = RecentCache[Any]
_setups: RecentCache[Setup] = RecentCache(16)
# The tables of the last flights: new memory costs more than what is done in it.
_memory: dict[str, Array] = {}


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
        chunks = (under_way.setdefault(chunk.number, chunk) for chunk in _chunks(flights, together))
        for row in self._workers.fly(study, chunks):
            chunk, rows = under_way.pop(int(row["flight"] or 0)), row.get("rows")
            if rows is None:
                lost += chunk.flights
            else:
                yield from rows  # type: ignore[misc]  # a chunk's
        for row in self._workers.fly(study.changed(batch=False), lost):
            yield row | {"by": JSBSIM}


def _chunks(flights: Iterable[Flight], together: int) -> Iterator[Chunk]:
    """Yield chunks of one controller each, which fly together best, numbered like their first flights."""
    waiting: dict[str, list[Flight]] = defaultdict(list)
    for flight in flights:
        waiting[flight.controller].append(flight)
        if len(waiting[flight.controller]) == together:
            yield _chunk(waiting.pop(flight.controller))
    yield from map(_chunk, waiting.values())


def _chunk(flights: Sequence[Flight]) -> Chunk:
    first = flights[0]
    return Chunk(first.number, first.draw, first.controller, first.seed, {}, tuple(flights))


def fly_flights(study: Study, flights: Sequence[Flight]) -> list[Row]:
    """Return the rows of flights flown together, in their order; JSBSim flies what a batch does not cover or judge."""
    begin = time.perf_counter()
    scenarios: dict[int, Scenario] = {}
    for place, flight in enumerate(flights):
        with suppress(InputError):  # JSBSim says why nothing flies it
            scenarios[place] = scenario_of(study, flight)
    rows = _fly(study, flights, scenarios)
    seconds = (time.perf_counter() - begin) / max(len(rows), 1)
    alone = study.changed(batch=False)
    return [
        rows[place] | {"wall_s": seconds} if place in rows else fly_one(alone, flight) | {"by": JSBSIM}
        for place, flight in enumerate(flights)
    ]


def _fly(study: Study, flights: Sequence[Flight], scenarios: Mapping[int, Scenario]) -> dict[int, Row]:
    """Return the rows of the flights that a batch judges, by their places."""
    places, stated = list(scenarios), study.base().model_dump_json()
    blank = failed_row(study, flights[0], "")
    same = {"worker": worker_name(), "by": BATCH, "log_sha256": None}
    rows: dict[int, Row] = {}
    for group in fly_groups(list(scenarios.values()), memory=_memory):
        known = Known(64) if group.log.is_alike() else None
        for i, flat in _measure(group):
            place = places[group.numbers[i]]
            flight, setup = flights[place], _setup_of(stated, scenarios[place])
            # The log of a flight that ended early is shorter, and so are its steps.
            shared = None if i in group.endings else known
            own: Row = {"flight": flight.number, "draw": flight.draw, "controller": flight.controller}
            own |= {"seed": flight.seed, **flight.values}
            rows[place] = {**blank, **own, **_judge(study, setup, group, i, flat, shared), **same}
    return rows


def _measure(group: Group, together: int = 16) -> Iterator[tuple[int, Metrics]]:
    """Yield the metrics of the flights of a group that are judged, by their places in it.

    ``together``: flights that are measured at once, so that their columns stay in the cache.
    """
    alone = [i for i, (_, ending, _, _) in group.endings.items() if ending is not None]
    for first in range(0, len(group.numbers), together):
        own = [i for i in range(len(group.numbers))[first : first + together] if i not in group.endings]
        log = FlightLog(group.log.tables, own, group.rows)
        if own and log.has_numbers:
            found = flatten(flight_metrics(log, group.n.step, _reach(group.n, np.array(own)[:, None])))
            values = [
                np.broadcast_to(np.nan if value is None else value, len(own)).tolist() for value in found.values()
            ]
            for i, row in zip(own, zip(*values, strict=True), strict=True):
                yield i, {name: None if value != value else value for name, value in zip(found, row, strict=True)}
        else:
            alone += own
    for i in alone:
        yield i, flatten(flight_metrics(group.flight(i).log, group.n.step, _reach(group.n, i)))


def _reach(n: Numbers, own: Any) -> Any:
    """Return the ranges of throttles and tilts as metrics read them: numbers, or what some flights have of arrays."""

    def column(value: Any) -> Any:
        return value[own] if isinstance(value, np.ndarray) else value

    ends = zip(map(column, n.reach[0]), map(column, n.reach[1]), strict=True)
    tilt = None if n.servo is None else column(n.servo.range_rad)
    return SimpleNamespace(throttle=tuple(ends), tilt_rad=tilt, servos=None)


def _judge(study: Study, setup: Setup, group: Group, i: int, flat: Metrics, known: Known | None) -> Row:
    """Return what a row says of a flight with these metrics, by the functions that judge every flight."""
    scenario, flown, step = group.scenarios[i], group.flight(i), group.n.step
    assert flown.ending is not None
    steps, log = len(flown.log), cast(Any, flown.log)  # its columns are all that is read
    lost = None if flown.ending.outcome == "completed" else Lost(steps * step, scenario.duration_s)
    limits = flight_limits(make_limit_inputs(scenario, scenario.resolved_vehicle()[0]), log, step, known)
    signals = FlightSignals(log, step, flat, event_times(scenario) if scenario.require else {})
    required = flight_requirements(limits, {}, stated_requirements(scenario))
    results = [RequirementResult.of(each.assess(signals, lost)) for each in required]
    summary = SimpleNamespace(
        **dict(setup) | {"planned_s": scenario.duration_s},
        outcome=flown.ending.outcome,
        reason=flown.ending.reason,
        beyond=find_exceeded(limits, flat),
        requirements=results,
        requirements_kept=all(result.kept for result in results if result.source == "require"),
        steps=steps,
        duration_s=steps * step,
        flat_metrics=flat,
    )
    return outcome_row(study, cast(Any, SimpleNamespace(summary=summary, log=log, scenario=scenario)), "")


def _setup_of(stated: str, scenario: Scenario) -> Setup:
    """Return what is known of a flight beforehand, most of which those of one study share."""
    key = (stated, scenario.controller, scenario.aircraft, scenario.engine)

    def make() -> Setup:
        with build(scenario, with_ledger=False) as simulation:
            return make_setup(simulation, resolve(simulation)[0], notes=False)

    return _setups.get(key, make)
