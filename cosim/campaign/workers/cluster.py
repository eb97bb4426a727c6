"""Flights on a Dask cluster: the only module that imports ``distributed``.

A task is a few flights of a study.  The study travels with them by its contents, so that a worker needs the package and
no file, and whoever joins later can fly too.  Tasks of a worker that is lost are Dask's to give to another; a flight is
a function of its study alone, so that flying it again makes the same row.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
import os
import warnings
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from itertools import count as numbers
from itertools import islice
from math import ceil
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from cosim.base.errors import FlightError, InputError
from cosim.base.storage.files import read_json
from cosim.base.storage.scratch import scratch
from cosim.campaign.folder import FrozenStudy, freeze
from cosim.campaign.installed import installed_versions, list_differences
from cosim.campaign.workers import remote
from cosim.campaign.workers.flight_row import Row, failed_row
from cosim.campaign.workers.protocol import time_limit, update_mean

if TYPE_CHECKING:
    from cosim.campaign.study.plan import Flight
    from cosim.campaign.study.study import Study

MAX_CONNECT_S = 4.0  # s until a scheduler must have answered
MAX_FIRST_WORKER_S = 10.0  # s until the scheduler has a worker
CHECK_INTERVAL_S = 1.0  # s between counts of the workers
MAX_IN_TASK = 64  # flights in one task


class DaskWorkers:
    """The workers of the Dask scheduler at ``address``, or for None ``count`` threads of this process.

    ``address`` is one such as ``tcp://host:8786``, or a scheduler file (``.json``).  Whatever else Dask needs to know,
    such as certificates for ``tls://``, it takes from its own configuration.  ``time_limit_s``: as for LocalWorkers.

    Raises InputError if Dask is not installed, the scheduler does not answer or has no workers, or what is installed
    with a worker is not what is installed here.
    """

    def __init__(self, address: str | None, count: int | None = None, time_limit_s: float | None = None) -> None:
        if time_limit_s is not None and not time_limit_s > 0.0:
            raise InputError(f"time limit = {time_limit_s:g} s: must be above 0")
        if address is not None and count is not None:
            raise InputError(f"workers {count}: a cluster has the workers that it has; leave it out with cluster")
        self._import_dask = _import_dask()
        self._time_limit = time_limit_s
        self._where = address or "the cluster of this process"
        self._frozen: tuple[Study, FrozenStudy] | None = None
        self._cluster: Any = None
        self._client: Any = None
        self._quiet = _LogFilter()
        try:
            self._client = self._connect(address) if address else self._start_cluster(count)
            self._threads = _Threads(self._client)
            self._check_workers()
        except BaseException:
            self.close()
            raise

    def _start_cluster(self, count: int | None) -> Any:
        # Threads of this process suffice, because each flight runs in a process of its own.
        self._cluster = self._import_dask.LocalCluster(
            n_workers=1,
            threads_per_worker=count or len(os.sched_getaffinity(0)),
            processes=False,
            dashboard_address="127.0.0.1:0",
            # Otherwise the worker's status page would listen on all interfaces.
            worker_dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
            memory_limit=0,
            local_directory=str(scratch()),
        )
        return self._import_dask.Client(self._cluster, set_as_default=False)

    def _connect(self, address: str) -> Any:
        scheduler = _scheduler_at(address)
        # Dask warns about versions of its own; those that matter to flights are compared here.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                return self._import_dask.Client(scheduler, timeout=MAX_CONNECT_S, set_as_default=False, name="hexjet")
            except (OSError, ValueError, TypeError) as error:
                raise InputError(f"cluster {address}: {_first_line(error)}") from error

    def _check_workers(self) -> None:
        """Refuse workers whose versions differ from those of this machine."""
        end = monotonic() + MAX_FIRST_WORKER_S
        while not (workers := self._threads.query_scheduler()):
            if monotonic() > end:
                option = f"--scheduler-file {self._where}" if self._where.endswith(".json") else self._where
                raise InputError(f"cluster {self._where}: has no workers; one is started with: dask worker {option}")
            sleep(0.1)
        installed = {name: self._client.submit(installed_versions, workers=[name], pure=False) for name in workers}
        check_s = 20.0  # s; busy workers report with each task
        end = monotonic() + check_s
        for name, future in installed.items():
            try:
                remote_versions = future.result(timeout=max(0.1, end - monotonic()))
            except TimeoutError:
                continue
            except Exception as error:
                raise InputError(f"cluster {self._where}: worker {name}: {_describe_error(error)}") from error
            differences = list_differences(remote_versions, installed_versions())
            if differences:
                raise InputError(f"cluster {self._where}: worker {name} has {', '.join(differences)}")

    def fly(self, study: Study, flights: Iterable[Flight]) -> Iterator[Row]:
        """Fly flights and yield their rows: see :class:`cosim.campaign.workers.protocol.Workers`."""
        limit = time_limit(study) if self._time_limit is None else self._time_limit
        tasks = _Tasks(self._client, study, self._pack_study(study), flights, limit)
        try:
            while not tasks.is_done:
                # One task per thread runs and one waits.
                tasks.hand_out(2 * self._threads.thread_count)
                yield from tasks.collect()
                self._require_worker()
        finally:
            tasks.cancel()

    def _pack_study(self, study: Study) -> FrozenStudy:
        """Return the study with all files that another machine needs to fly it."""
        if self._frozen is None or self._frozen[0] is not study:
            self._frozen = study, freeze(study)
        return self._frozen[1]

    def _require_worker(self) -> None:
        """Raise FlightError if no worker is left that could fly."""
        if self._client.status in ("closing", "closed"):
            raise FlightError(f"{self._where}: the scheduler is lost")
        without = self._threads.time_without_workers_s
        # A batch system may take a machine away in the middle of a campaign and bring another later.
        max_without_s = 120.0
        if without > max_without_s:
            raise FlightError(f"{self._where}: has had no workers for {without:.0f} s")

    def close(self) -> None:
        client, cluster = self._client, self._cluster
        self._client = self._cluster = None
        try:
            if client is not None and client.status == "running":
                client.run(_end_idle, wait=False, on_error="ignore")
            for opened in (client, cluster):
                with suppress(TimeoutError):
                    if opened is not None:
                        opened.close(timeout=2.0)
            if cluster is not None:
                remote.end_idle()
        finally:
            self._quiet.end()

    def __enter__(self) -> DaskWorkers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Threads:
    """Number of flights that the cluster can fly at a time, updated every ``CHECK_INTERVAL_S``."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._by_worker: dict[str, int] = {}
        self._counted_at = -CHECK_INTERVAL_S
        self._last_worker_at = monotonic()  # when a worker was last connected

    @property
    def thread_count(self) -> int:
        if monotonic() > self._counted_at + CHECK_INTERVAL_S:
            self.query_scheduler()
        return sum(self._by_worker.values())

    @property
    def time_without_workers_s(self) -> float:
        """Time for which no worker has been connected, s."""
        return 0.0 if self._by_worker else monotonic() - self._last_worker_at

    def query_scheduler(self) -> dict[str, int]:
        """Ask the scheduler for the number of threads of each worker."""
        with suppress(OSError, TimeoutError):
            self._by_worker = dict(self._client.sync(self._client.scheduler.ncores, callback_timeout=MAX_CONNECT_S))
        self._counted_at = monotonic()
        if self._by_worker:
            self._last_worker_at = self._counted_at
        return self._by_worker


class _Tasks:
    """Flights of one study as Dask tasks: a limited number at a time, and their rows as they arrive."""

    def __init__(self, client: Any, study: Study, frozen: FrozenStudy, flights: Iterable[Flight], limit: float) -> None:
        self._client = client
        self._study = study
        self._frozen = frozen
        self._content_hash = _content_hash(frozen)
        self._limit = limit
        self._flights = iter(flights)
        self._buffer: deque[Flight] = deque()
        self._returned: deque[list[Flight]] = deque()  # flights of lost tasks, to be flown again
        self._packed: Any | None = None  # the study, after its upload
        self._pending: dict[str, tuple[Any, list[Flight]]] = {}
        self._finished: SimpleQueue[Any] = SimpleQueue()
        self._mean_s: float | None = None  # mean duration of a flight
        self._is_exhausted = False
        self._name = f"hexjet-{uuid4().hex[:12]}"
        self._number = numbers()

    @property
    def is_done(self) -> bool:
        return self._is_exhausted and not self._returned and not self._pending

    def hand_out(self, count: int) -> None:
        """Keep ``count`` tasks running while there are flights."""
        while len(self._pending) < count and self._client.status == "running":
            batch = self._returned.popleft() if self._returned else self._next_batch(count)
            if not batch:
                return
            self._submit_batch(batch)

    def collect(self) -> Iterator[Row]:
        """Wait a short time for a task to end, and return the rows of all ended tasks."""
        with suppress(Empty):
            future = self._finished.get(timeout=CHECK_INTERVAL_S)
            while True:
                yield from self._take_rows(future)
                future = self._finished.get_nowait()

    def cancel(self) -> None:
        futures = [future for future, _ in self._pending.values()]
        self._pending.clear()
        if futures and self._client.status == "running":
            with suppress(OSError, TimeoutError):
                self._client.cancel(futures, force=True)

    def _next_batch(self, tasks: int) -> list[Flight]:
        """Return the flights of the next of ``tasks``: one until a flight's duration is known, and fewer at the end."""
        task_s = 0.5  # s of work per task; hand-out takes 5 ms
        size = 1 if self._mean_s is None else min(MAX_IN_TASK, max(1, round(task_s / max(self._mean_s, 1e-3))))
        missing = size * tasks - len(self._buffer)
        self._buffer.extend(islice(self._flights, max(0, missing)))
        self._is_exhausted = not self._buffer
        size = min(size, ceil(len(self._buffer) / tasks))
        return [self._buffer.popleft() for _ in range(size)]

    def _submit_batch(self, batch: list[Flight]) -> None:
        with warnings.catch_warnings():  # Dask warns about large objects
            warnings.simplefilter("ignore")
            if self._packed is None:
                name = f"{self._name}-study-{next(self._number)}"
                self._packed = self._client.submit(_identity_task, self._frozen, key=name)
            future = self._client.submit(
                _fly,
                self._packed,
                self._content_hash,
                installed_versions(),
                batch,
                self._limit,
                key=f"{self._name}-flights-{next(self._number)}",
                pure=False,
            )
        self._pending[str(future.key)] = future, batch
        future.add_done_callback(self._finished.put)

    def _take_rows(self, future: Any) -> Iterator[Row]:
        pending = self._pending.pop(str(future.key), None)
        if pending is None:
            return
        batch = pending[1]
        if future.status in ("cancelled", "lost"):  # cancelled by the scheduler or a user
            self._returned.append(batch)
            self._packed = None
            return
        try:
            rows: list[Row] = future.result(timeout=MAX_CONNECT_S)
        except _import_dask().KilledWorker as error:
            yield from self._retry_singly(batch, error)
        except (TimeoutError, CancelledError):
            # The worker left with its rows, so Dask has the flights flown again.
            self._pending[str(future.key)] = pending
            self._finished.put(future)
        except (FlightError, InputError) as error:
            raise FlightError(str(error)) from error
        except Exception as error:
            raise FlightError(f"a worker cannot fly: {_describe_error(error)}") from error
        else:
            self._note_durations(rows)
            yield from rows

    def _retry_singly(self, batch: list[Flight], error: Any) -> Iterator[Row]:
        """Fly each flight again alone after Dask gave up a batch that lost several workers."""
        if len(batch) > 1:
            self._returned.extend([flight] for flight in batch)
            return
        times = error.allowed_failures + 1
        reason = f"the worker was lost in this flight {times} times; the last was {error.last_worker.address}"
        yield failed_row(self._study, batch[0], reason)

    def _note_durations(self, rows: Sequence[Row]) -> None:
        for row in rows:
            seconds = row.get("wall_s")
            if isinstance(seconds, float):
                self._mean_s = update_mean(self._mean_s, seconds)


def _identity_task(frozen: FrozenStudy) -> FrozenStudy:
    """Return the study itself, as a task that Dask repeats if its result is lost."""
    return frozen


def _fly(
    frozen: FrozenStudy, digest: str, expected: Mapping[str, str], flights: list[Flight], limit: float
) -> list[Row]:
    """Fly flights on a cluster's worker.  Raises FlightError if its package versions differ."""
    worker = _import_dask().get_worker()
    wrong = list_differences(installed_versions(), expected)
    if wrong:
        raise FlightError(f"worker {worker.address} has {', '.join(wrong)}")
    return remote.fly_together(frozen, digest, flights, limit, Path(worker.local_directory))


async def _end_idle() -> None:
    remote.end_idle()


def _content_hash(frozen: FrozenStudy) -> str:
    digest = hashlib.sha256(json.dumps([frozen.study, frozen.scenario], sort_keys=True, default=str).encode())
    for name, content in sorted(frozen.files.items()):
        digest.update(f"{name} {hashlib.sha256(content).hexdigest()}".encode())
    return digest.hexdigest()


def _import_dask() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise InputError(f"cluster needs Dask, which is not installed ({error}): pip install distributed") from error
    return distributed


def _scheduler_at(address: str) -> str:
    """Return the address of a scheduler that answers within ``MAX_CONNECT_S``.  Raises InputError if none does."""
    if address.endswith(".json"):
        try:
            scheduler = str(read_json(Path(address))["address"])
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"cluster {address}: no scheduler file: {_first_line(error)}") from error
    else:
        scheduler = address
    answer: list[BaseException | dict[str, Any]] = []

    def connect() -> None:
        try:
            answer.append(asyncio.run(asyncio.wait_for(_read_identity(scheduler), MAX_CONNECT_S)))
        except Exception as error:
            answer.append(error)

    asking = Thread(target=connect, daemon=True)  # a notebook already runs an event loop
    asking.start()
    asking.join()
    if isinstance(answer[0], (OSError, TimeoutError)):
        raise InputError(
            f"cluster {address}: no scheduler answers within {MAX_CONNECT_S:g} s; one is started with: dask scheduler"
        ) from answer[0]
    if isinstance(answer[0], BaseException):
        hint = "; an address looks like tcp://HOST:8786" if isinstance(answer[0], ValueError) else ""
        raise InputError(f"cluster {address}: {_first_line(answer[0])}{hint}") from answer[0]
    if answer[0].get("type") != "Scheduler":
        raise InputError(f"cluster {address}: is a {answer[0].get('type')}, not a scheduler")
    return scheduler


async def _read_identity(address: str) -> dict[str, Any]:
    dask = _import_dask()
    arguments = dask.Security().get_connection_args("client")
    async with dask.rpc(address, connection_args=arguments) as scheduler:
        identity: dict[str, Any] = await scheduler.identity()
        return identity


def _describe_error(error: BaseException) -> str:
    """Describe a worker's error in one line."""
    if isinstance(error, ModuleNotFoundError) and str(error.name).split(".")[0] == "cosim":
        return "hexjet-cosim is not installed there"
    return f"{type(error).__name__}: {_first_line(error)}"


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


class _LogFilter:
    """Filters Dask's log of lost connections, which one message replaces."""

    def __init__(self) -> None:
        names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in ("distributed", "tornado")]
        self._levels = {name: logging.getLogger(name).level for name in [*names, "asyncio"]}
        for name in self._levels:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)

    def end(self) -> None:
        for name, level in self._levels.items():
            logging.getLogger(name).setLevel(level)
