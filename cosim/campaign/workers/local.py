"""Flights in processes of this machine.

Every process has a connection of its own, and nothing is shared between them: one that is killed at any moment, in the
middle of a message or while it starts, takes nothing with it but the flight under way.  The processes are started by
command and not forked, so that the program that starts them may be anything: threads, notebooks, a script without a
guarded main part.
"""

from __future__ import annotations

import ctypes
import gc
import os
import pickle
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from math import ceil
from multiprocessing.connection import Connection, wait
from select import poll
from threading import Thread
from typing import TYPE_CHECKING, Any

from cosim.base.errors import FlightError, InputError
from cosim.base.runtime.host import Host, die_with_parent
from cosim.base.runtime.threads import ONE_THREAD
from cosim.base.storage.scratch import scratch
from cosim.base.trust import decision, inherit
from cosim.campaign.workers.flight_row import Row, failed_row, fly_one
from cosim.campaign.workers.protocol import MAX_LOSSES, describe_loss, describe_timeout, time_limit, update_mean

if TYPE_CHECKING:
    from cosim.campaign.study.plan import Flight
    from cosim.campaign.study.study import Study

Fly = Callable[["Study", "Flight"], Row]
Failed = Callable[["Study", "Flight", str], Row]

CHECK_INTERVAL_S = 1.0  # s between checks for ended processes
# s after its time limit at which a worker process ends itself, if nobody else did.
BACKSTOP_S = 10.0
MAX_START_S = 60.0  # s; 0.5 s is usual
# If this many processes in a row end before they are ready, something else is wrong.
MAX_FAILED_STARTS = 8
READY = "ready"  # message of a process that is ready
_COMMAND = "from cosim.campaign.workers.local import serve; serve(int(sys.argv[1]), sys.argv[2])"  # code of a worker


class LocalWorkers:
    """Workers that fly in ``count`` local processes; each flight has at most ``time_limit_s``, by default of the study.

    ``fly`` makes the row of a flight in the processes, which import it by its name, and ``failed`` that of one of which
    only the reason is known.  The processes start with the first flights, at most one a flight, and stay for further
    studies until :meth:`close`.
    """

    def __init__(
        self, count: int, time_limit_s: float | None = None, fly: Fly = fly_one, failed: Failed = failed_row
    ) -> None:
        if count < 1:
            raise InputError(f"workers = {count}: at least 1")
        if time_limit_s is not None and not time_limit_s > 0.0:
            raise InputError(f"time limit = {time_limit_s:g} s: must be above 0")
        self._count = count
        self._time_limit = time_limit_s
        self._fly, self._failed = fly, failed
        self._processes: list[_Process] = []
        self._starts = 0  # failed starts in a row

    def fly(self, study: Study, flights: Iterable[Flight]) -> Iterator[Row]:
        """Fly flights and yield their rows: see :class:`cosim.campaign.workers.protocol.Workers`."""
        # Processes that are still busy fly what is no longer needed.
        self._end_busy_processes()
        limit = time_limit(study) if self._time_limit is None else self._time_limit
        waiting = _WaitingFlights(flights)
        ahead = _QueueDepth()
        try:
            while self._hand_out(study, waiting, ahead.flights, limit):
                yield from self._collect(study, waiting, ahead, limit)
        finally:
            self._end_busy_processes()

    def close(self) -> None:
        while self._processes:
            self._end(self._processes[-1])

    def __enter__(self) -> LocalWorkers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _hand_out(self, study: Study, waiting: _WaitingFlights, ahead: int, limit: float) -> bool:
        """Give each process its next flights, one each before any gets two; return False if none are left."""
        for depth in range(1 + ahead):
            if depth == 0:
                self._start_processes(waiting)
            for process in self._processes:
                if len(process.queued) == depth and (flight := waiting.next()) is not None:
                    process.send_flight(study, flight, limit)
        return any(process.queued for process in self._processes)

    def _start_processes(self, waiting: _WaitingFlights) -> None:
        idle = sum(not process.queued for process in self._processes)
        while len(self._processes) < self._count and waiting.has_more_than(idle):
            self._processes.append(_Process(self._fly))
            idle += 1

    def _collect(self, study: Study, waiting: _WaitingFlights, ahead: _QueueDepth, limit: float) -> Iterator[Row]:
        """Wait for an event and yield the resulting rows."""
        by_connection = {process.connection: process for process in self._processes}
        for connection in wait(list(by_connection), self._next_timeout(limit)):
            process = by_connection[connection]  # type: ignore[index]
            message = process.receive()
            if message is None:
                yield from self._retry_lost_flights(study, process, waiting)
            elif isinstance(message, FlightError):
                raise message
            elif message == READY:
                self._starts = 0
            else:
                ahead.record_duration(process.last_duration_s)
                yield message
        for process in list(self._processes):
            if process.exceeds_limit(limit):
                flight, *rest = self._end(process)
                waiting.put_back(rest)
                yield self._failed(study, flight, describe_timeout(limit)) | process.worker_columns(limit)
            elif not process.is_alive:
                yield from self._retry_lost_flights(study, process, waiting)

    def _next_timeout(self, limit: float) -> float:
        busy = [process for process in self._processes if process.queued]
        ends = [process.active_since + limit for process in busy if process.active_since is not None]
        return max(0.0, min([CHECK_INTERVAL_S, *(end - time.monotonic() for end in ends)]))

    def _retry_lost_flights(self, study: Study, process: _Process, waiting: _WaitingFlights) -> Iterator[Row]:
        """Queue the flights of a lost process again; yield a failed row for a flight that has crashed too many."""
        was_ready, ending = process.active_since is not None, process.describe_end()
        queued = self._end(process)
        if not was_ready:
            self._starts += 1
            if self._starts >= MAX_FAILED_STARTS:
                raise FlightError(
                    f"{MAX_FAILED_STARTS} processes in a row ended before they could fly; the last {ending}"
                )
        elif queued and waiting.count_loss(queued[0]) >= MAX_LOSSES:
            yield self._failed(study, queued.pop(0), describe_loss(ending)) | process.worker_columns()
        waiting.put_back(queued)

    def _end_busy_processes(self) -> None:
        for process in [worker for worker in self._processes if worker.queued]:
            self._end(process)

    def _end(self, process: _Process) -> list[Flight]:
        """End a process and return its flights that are not flown."""
        self._processes.remove(process)
        process.end()
        return list(process.queued)


class _WaitingFlights:
    """Flights that wait for a process; those of lost processes come first."""

    def __init__(self, flights: Iterable[Flight]) -> None:
        self._flights = iter(flights)
        self._first: deque[Flight] = deque()
        self._losses: Counter[int] = Counter()

    def next(self) -> Flight | None:
        """Return the next flight, and remove it; None if no flight waits."""
        return self._first.popleft() if self.has_more_than(0) else None

    def has_more_than(self, count: int) -> bool:
        """Return whether more than ``count`` flights wait, reading no more of them than needed."""
        while len(self._first) <= count:
            try:
                self._first.append(next(self._flights))
            except StopIteration:
                return False
        return True

    def put_back(self, flights: Iterable[Flight]) -> None:
        """Put the flights of a lost process first."""
        self._first.extendleft(reversed(list(flights)))

    def count_loss(self, flight: Flight) -> int:
        self._losses[flight.number] += 1
        return self._losses[flight.number]


class _QueueDepth:
    """Number of flights to queue in a process: 0 for long flights, so that processes end together."""

    def __init__(self) -> None:
        self.flights = 0
        self._mean_s: float | None = None  # mean duration of a flight

    def record_duration(self, seconds: float) -> None:
        """Adapt the depth to the duration of one more flight."""
        self._mean_s = update_mean(self._mean_s, seconds)
        ahead_s = 0.25  # s of work queued in a process
        max_flights = 8  # flights per message
        self.flights = min(max_flights, ceil(ahead_s / max(self._mean_s, 1e-3))) if self._mean_s < ahead_s else 0


class _Process:
    """One process, its flights, and when it began the first of them."""

    def __init__(self, fly: Fly) -> None:
        self.queued: deque[Flight] = deque()
        self.active_since: float | None = None  # None: still starting
        self.last_duration_s = 0.0  # s, duration of the last flight
        self._begun = time.monotonic()
        self._study: Study | None = None
        try:
            # The worker's temporary files are deleted with this folder.
            self._folder = tempfile.mkdtemp(prefix="worker-", dir=scratch())
        except InputError as error:
            raise FlightError(f"no process could be started: {error}") from error
        except OSError as error:
            raise FlightError(f"no process could be started: {tempfile.gettempdir()}: {error.strerror}") from error
        inherited = dict(os.environ) | ONE_THREAD | {"TMPDIR": self._folder}
        try:
            # A process group of its own keeps Ctrl-C from the worker; the process that waits handles it.
            self._process, self.connection = Host.connect(_COMMAND, self._folder, environ=inherited)
        except OSError as error:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise FlightError(f"no process could be started: {error.strerror or error}") from error
        self._send(sys.path)
        self._send(fly)

    @property
    def is_alive(self) -> bool:
        if self.active_since is None and time.monotonic() > self._begun + MAX_START_S:
            return False
        return self._process.poll() is None or self.connection.poll()

    def send_flight(self, study: Study, flight: Flight, limit: float) -> None:
        if self._study is not study:
            self._send((study, limit, decision()))
            self._study = study
        self._send(flight)
        if not self.queued and self.active_since is not None:
            self.active_since = time.monotonic()
        self.queued.append(flight)

    def receive(self) -> Any:
        """Return a row, the message "ready", or an error; None if the process is lost."""
        try:
            message = self.connection.recv()
        except (EOFError, OSError, pickle.UnpicklingError):
            return None
        now = time.monotonic()
        if isinstance(message, dict):
            self.queued.popleft()
            self.last_duration_s = now - (self.active_since or now)
        self.active_since = now
        return message

    def exceeds_limit(self, limit: float) -> bool:
        """Return whether the process exceeds its time limit and has not just reported a result."""
        is_busy = self.active_since is not None and self.queued
        return bool(is_busy) and time.monotonic() > (self.active_since or 0.0) + limit and not self.connection.poll()

    def describe_end(self) -> str:
        not_ready = f"was not ready after {MAX_START_S:g} s, as on a machine with too much to do"
        running = "closed its connection" if self.active_since is not None else not_ready
        return self._process.describe_end(1.0) or running

    def worker_columns(self, wall_s: float | None = None) -> Row:
        """Return the columns that say which process flew the row."""
        return {"worker": f"{os.uname().nodename}:{self._process.pid}", "wall_s": wall_s}

    def end(self) -> None:
        self._process.end()  # ends the processes of its engines too
        self.connection.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _send(self, message: Any) -> None:
        with suppress(OSError):
            # A lost worker is detected at the next read.
            self.connection.send(message)


def serve(descriptor: int, folder: str) -> None:
    """Fly arriving flights until the connection closes; ``folder`` is deleted at the end."""
    os.set_inheritable(descriptor, False)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with_parent()
    # A batch holds thousands of scenarios without circles, through which the collector would look again and again.
    gc.set_threshold(200_000, 20, 100)
    Thread(target=_exit_with_parent, args=(descriptor, folder), daemon=True).start()
    with suppress(EOFError, OSError):  # the other end is closed
        _serve_flights(Connection(descriptor), folder)
    _exit(folder)


def _serve_flights(connection: Connection[Any, Any], folder: str) -> None:
    sys.path[:] = connection.recv()
    fly: Fly = connection.recv()
    connection.send(READY)
    while True:
        message = connection.recv()
        if isinstance(message, tuple):
            study, limit, decided = message
            inherit(decided)  # the parent has asked the user already
            continue
        signal.setitimer(signal.ITIMER_REAL, limit + BACKSTOP_S)
        try:
            answer: Row | FlightError = fly(study, message)
        except FlightError as error:
            answer = error
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        if not os.path.isdir(folder):
            # The temporary files were deleted, which may be why the flight failed: another process flies it again.
            return
        connection.send(answer)


def _exit_with_parent(descriptor: int, folder: str) -> None:
    """End this process when its parent ends in any way."""
    hung_up = poll()
    hung_up.register(descriptor, 0)
    hung_up.poll()
    _exit(folder)


def _end_with_parent() -> None:
    """Make the system end this process a second after its parent, because C code may block Python threads.

    It sends SIGHUP, number 1, and what answers that is ``alarm`` itself: ``alarm(1)``.
    """
    if sys.platform == "linux":
        libc = ctypes.CDLL(None)
        libc.signal(int(signal.SIGHUP), libc.alarm)
        die_with_parent(signal.SIGHUP)


def _exit(folder: str) -> None:
    """End this process at once and delete its folder."""
    gone = f"{folder}-gone"
    with suppress(OSError):
        # After this a flight in progress writes nothing more into the folder.
        os.rename(folder, gone)
    shutil.rmtree(gone, ignore_errors=True)
    os._exit(1)
