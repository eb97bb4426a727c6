"""Flights of a study on arrays: workers that hand them on in chunks, and the rows that come of them."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from math import ceil
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.storage.cache import RecentCache
from cosim.results.limits import find_exceeded, flight_limits, make_limit_inputs
from cosim.results.log.columns import logged_vehicle
from cosim.results.metrics import Reach, columns, flatten, flight_metrics, metric_names
from cosim.results.requirements import FailedFlight, FlightSignals
from cosim.results.requirements.signals import event_times
from cosim.results.requirements.stated import columns_of
from cosim.results.resolved_scenario import resolve
from cosim.results.setup import make_setup
from cosim.results.summary import Setup, assess_flight
from cosim.simulation.build import build
from cosim.studies import (
    Chunk,
    Flight,
    Row,
    Study,
    Workers,
    count_processors,
    failed_row,
    fly_one,
    outcome_row,
    scenario_of,
    with_values,
    worker_name,
)
from hexjet_batch.fly import Group, fly_groups
from hexjet_batch.log import FlightLog
from hexjet_batch.make import Known, read_flight
from hexjet_batch.numbers import Numbers
from hexjet_batch.referee import judge

if TYPE_CHECKING:
    from cosim.spec.scenario import Scenario

__all__ = ["BatchWorkers", "check", "judge"]

Metrics = dict[str, float | None]
_setups: RecentCache[Setup] = RecentCache(16)
# The tables of the last flights: new memory costs more than what is done in it.
_memory: dict[str, Array] = {}
_known = Known(1024)


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


class BatchWorkers:
    """Flies a study's flights on arrays, in the processes of other workers.

    ``together``: flights of one chunk, by default those whose logs, of some 25 columns, come to a processor's share of
    ``memory_gb``, at most 4096.  A chunk with which three processes were lost is flown by JSBSim, flight by flight.
    """

    def __init__(self, workers: Workers, together: int | None = None, memory_gb: float = 3.0) -> None:
        if together is not None and together < 1:
            raise InputError(f"together = {together}: at least 1 flight")
        self._workers, self._together, self._bytes = workers, together, 1e9 * memory_gb / count_processors()

    def fly(self, study: Study, flights: Iterable[Flight]) -> Iterator[Row]:
        """See :class:`cosim.studies.Workers`."""
        under_way: dict[int, Chunk] = {}
        lost: list[Flight] = []
        most = self._together or min(4096, max(1, int(self._bytes / (25 * 8 * study.base().steps))))
        chunks = (under_way.setdefault(chunk.number, chunk) for chunk in _chunks(flights, most))
        for row in self._workers.fly(study, chunks):
            chunk, rows = under_way.pop(int(row["flight"] or 0)), row.get("rows")
            if rows is None:
                lost += chunk.flights
            else:
                yield from rows  # type: ignore[misc]  # a chunk's
        for row in self._workers.fly(study.changed(batch=False), lost):
            yield row | {"by": "jsbsim"}


def _chunks(flights: Iterable[Flight], most: int, least: int = 500) -> Iterator[Chunk]:
    """Yield chunks numbered like their first flights: equal ones for all processors, of ``most`` flights at most.

    ``least``: flights to which a chunk is not cut, as the overhead of a step is that of as many then.
    """
    waiting, processors = iter(flights), count_processors()
    while found := list(islice(waiting, most * processors)):
        size = min(most, max(least, ceil(len(found) / processors)))
        for first in range(0, len(found), size):
            own = tuple(found[first : first + size])
            yield Chunk(own[0].number, own[0].draw, own[0].controller, own[0].seed, {}, own, fly_flights)


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
        rows[place] | {"wall_s": seconds} if place in rows else fly_one(alone, flight) | {"by": "jsbsim"}
        for place, flight in enumerate(flights)
    ]


def _fly(study: Study, flights: Sequence[Flight], scenarios: Mapping[int, Scenario]) -> dict[int, Row]:
    """Return the rows of the flights that the batch itself judges, by their index in ``flights``."""
    places, stated = list(scenarios), study.base().model_dump_json()
    blank = failed_row(study, flights[0], "")
    same = {"worker": worker_name(), "by": "batch", "log_sha256": None}
    rows: dict[int, Row] = {}
    for group in fly_groups(list(scenarios.values()), _memory, _known, are_covered=False):
        known = Known(64) if group.log.is_alike() else None
        for i, flat in _measure(group):
            place = places[cast(int, group.numbers[i])]
            flight, setup = flights[place], _shared_setup(stated, scenarios[place])
            # The log of a flight that ended early is shorter, and so are its steps.
            shared = None if i in group.endings else known
            own = {"flight": flight.number, **{name: getattr(flight, name) for name in ("draw", "controller", "seed")}}
            rows[place] = {**blank, **own, **flight.values, **_judge(study, setup, group, i, flat, shared), **same}
    return rows


def _measure(group: Group, together: int = 32) -> Iterator[tuple[int, Metrics]]:
    """Yield index in the group and metrics of each flight that the batch itself judges.

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


def _reach(n: Numbers, own: Any) -> Reach:
    """Return the ranges of throttles and tilts for the metrics: numbers, or of arrays the elements of ``own``."""

    def value_of_flights(value: Any) -> Any:
        return value[own] if isinstance(value, np.ndarray) else value

    ends = zip(map(value_of_flights, n.reach[0]), map(value_of_flights, n.reach[1]), strict=True)
    tilt = None if n.servo is None else value_of_flights(n.servo.range_rad)
    return Reach.model_construct(throttle=tuple(ends), tilt_rad=tilt)


def _judge(study: Study, setup: Setup, group: Group, i: int, flat: Metrics, known: Known | None) -> Row:
    """Return the row of a flight with these metrics, judged by the functions that judge every flight."""
    scenario, flown, step = group.scenarios[i], group.flight(i), group.n.step
    assert flown.ending is not None
    steps, log = len(flown.log), cast(Any, flown.log)  # its columns are all that is read
    lost = None if flown.ending.outcome == "completed" else FailedFlight(steps * step, scenario.duration_s)
    limits = flight_limits(make_limit_inputs(scenario, scenario.resolved_vehicle()[0]), log, step, known)
    signals = FlightSignals(log, step, flat, event_times(scenario) if scenario.require else {})
    results = assess_flight(setup, limits, signals, lost)
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


def _shared_setup(stated: str, scenario: Scenario) -> Setup:
    """Return the setup of a flight, which flights of one controller, aircraft and engine share."""
    key = (stated, scenario.controller, scenario.aircraft, scenario.engine)

    def build_setup() -> Setup:
        with build(scenario, with_ledger=False) as simulation:
            return make_setup(simulation, resolve(simulation)[0], notes=False)

    return _setups.get(key, build_setup)
