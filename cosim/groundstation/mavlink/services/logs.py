"""The vehicle's logs: finished runs as ULog, listed and read by LOG_REQUEST_LIST and LOG_REQUEST_DATA, or as files.

A run becomes a ULog when somebody asks for the list, one after the other and in a process of its own, so that a flight
that is under way keeps its deadlines.  A log is listed when it is made, because ground stations take the size that
they are told for the true one.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from threading import Thread

from cosim.base.runtime.host import Host, python_command
from cosim.base.storage.files import read_json
from cosim.base.storage.scratch import scratch
from cosim.groundstation.mavlink.services.ftp import File, MemoryFile
from cosim.groundstation.mavlink.services.service import MAX_CLIENTS, Client, Outgoing, RateLimit, Service
from cosim.groundstation.mavlink.wire.dialect import Message
from cosim.groundstation.mavlink.wire.dialect import mav as wire
from cosim.groundstation.mavlink.wire.peer import Peer

MAX_DATA_BYTES = 90  # data in one LOG_DATA
LOG_FOLDER = "log/"  # folder of logs in FTP paths
# Python code of the process that converts a log.
_CONVERSION_CODE = """
import os, pathlib
from cosim.results.export import export_log
if hasattr(os, "nice"):
    os.nice(10)  # the present flight comes first
# PX4's rates, so that a download takes a tenth of the flight's time.
export_log("ulog", *map(pathlib.Path, sys.argv[1:]), rates="px4")
"""


class DiskFile:
    """Readable file on disk; unreadable parts are returned empty."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = path.stat().st_size

    def read(self, offset: int, length: int) -> bytes:
        """Return a part of the file, shorter at its end."""
        try:
            with open(self.path, "rb") as file:
                file.seek(offset)
                return file.read(length)
        except OSError:
            return b""


@dataclass
class LogEntry:
    """Log of one run; ``file`` is None before its conversion, and empty if that failed."""

    number: int
    run: Path
    time_utc: int  # s since 1970
    file: File | None = None


class LogStore:
    """Store of finished runs' logs, which converts them to ULog in turn.

    ``runs``: returns the folders of every finished run, oldest first.  It reads a file of each, so it is called in a
    thread of its own, and again on a request after ``search_interval_s`` or :meth:`mark_outdated`.  A log
    keeps its number: later runs get the next ones.  ``max_earlier``: earlier runs that are listed, the newest, as each
    has to be converted.  ``max_logs``: in all.  ``search_interval_s``: between two searches, however often somebody
    asks.  ``timeout_s``: for one log: thirty times what an hour of flight takes.
    """

    def __init__(
        self,
        runs: Callable[[], Sequence[Path]],
        max_earlier: int = 20,
        max_logs: int = 200,
        search_interval_s: float = 2.0,
        timeout_s: float = 300.0,
    ) -> None:
        self.timeout_s = timeout_s
        self.search_interval_s = search_interval_s
        self.max_logs = max_logs
        self.max_earlier = max_earlier
        self._runs = runs
        self._folder = Path(tempfile.mkdtemp(prefix="logs-", dir=scratch()))
        self._seen_runs: set[Path] = set()
        self._conversion: tuple[Host, LogEntry, float] | None = None
        self._converted_count = 0  # logs converted so far, failures included
        self._search: Thread | None = None
        self._found_runs: Sequence[Path] = ()
        self._last_search = -inf
        self._is_outdated = True  # a run ended after the last search
        self._now = 0.0
        self.logs: list[LogEntry] = []

    def search(self, now: float) -> None:
        """Start a search for new runs, unless one runs or was made recently."""
        if self._search is None and (self._is_outdated or now - self._last_search >= self.search_interval_s):
            self._is_outdated = False

            def run_search() -> None:
                # If a folder cannot be read, the list stays as it is.
                with suppress(OSError):
                    self._found_runs = self._runs()

            self._search = Thread(target=run_search, name="logs", daemon=True)
            self._search.start()

    def mark_outdated(self) -> None:
        """Mark older searches as outdated, because a run has just been finished; from any thread."""
        self._is_outdated = True

    @property
    def is_searching(self) -> bool:
        """Whether a search for new runs is under way."""
        return self._search is not None

    def _add_found_runs(self, now: float) -> None:
        if self._search is None or self._search.is_alive():
            return
        self._search, self._last_search = None, now
        new = [run for run in self._found_runs if run not in self._seen_runs]
        first = not self._seen_runs
        self._seen_runs.update(new)
        for run in new[-self.max_earlier :] if first else new[: self.max_logs - len(self.logs)]:
            self.logs.append(LogEntry(len(self.logs), run, _start_time(run)))
        if self._is_outdated:  # a run has ended during the search
            self.search(now)

    def poll(self, now: float) -> None:
        """Add found runs, take over a finished conversion, and begin the next one."""
        self._now = now
        self._add_found_runs(now)
        if self._conversion is not None:
            process, log, started = self._conversion
            code = process.poll()
            if code is None and now - started < self.timeout_s:
                return
            self._stop_conversion()
            log.file = MemoryFile(b"")
            with suppress(OSError):
                log.file = DiskFile(self._path_of_converted_log(log)) if code == 0 else log.file
            self._converted_count += 1
        if self._converted_count < len(self.logs):
            log = self.logs[self._converted_count]
            command = python_command(_CONVERSION_CODE, str(log.run), str(self._path_of_converted_log(log)))
            quiet = subprocess.DEVNULL
            try:
                self._conversion = (Host(command, stdin=quiet, stdout=quiet, stderr=quiet), log, now)
            except OSError:
                log.file = MemoryFile(b"")
                self._converted_count += 1

    @property
    def is_converting(self) -> bool:
        """Whether a log is not converted yet."""
        return self._converted_count < len(self.logs)

    def files(self) -> Mapping[str, File]:
        """Return the converted logs as files by path, and start a search for new runs."""
        self.search(self._now)
        return {f"{LOG_FOLDER}{_file_name(log)}": log.file for log in self.logs if log.file and log.file.size}

    def close(self) -> None:
        """End search and conversion, and remove all converted logs."""
        self._converted_count = len(self.logs)
        self._stop_conversion()
        if self._search is not None:
            self._search.join()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _stop_conversion(self) -> None:
        if self._conversion is not None:
            self._conversion[0].end()
            self._conversion = None

    def _path_of_converted_log(self, log: LogEntry) -> Path:
        return self._folder / f"{log.number}.ulg"


class LogService(Service):
    """Log service: LOG_REQUEST_LIST, _DATA and _END in, LOG_ENTRY and LOG_DATA out.  Logs are never erased.

    ``rate``: of LOG_DATA, 1/s, to a client: as fast as a flight at 250 Hz writes them, 225 kB/s.
    """

    handles = frozenset({"LOG_REQUEST_LIST", "LOG_REQUEST_DATA", "LOG_REQUEST_END", "LOG_ERASE"})

    def __init__(self, store: LogStore, rate: float = 2500.0) -> None:
        self.rate = rate
        self._store = store
        self._lists: dict[Client, tuple[int, int]] = {}  # entries still to be sent, per client
        self._downloads: OrderedDict[Client, _Download] = OrderedDict()

    def handle(self, message: Message, client: Client, now: float) -> list[Message]:
        """Return the answers to one message; entries and data are sent later."""
        kind = message.get_type()
        if kind == "LOG_REQUEST_LIST":
            self._store.search(now)
            if message.start <= message.end and (client in self._lists or len(self._lists) < MAX_CLIENTS):
                self._lists[client] = (message.start, message.end)
        elif kind == "LOG_REQUEST_DATA":
            return self._begin_download(message, client)
        elif kind == "LOG_REQUEST_END":
            self._downloads.pop(client, None)
            self._lists.pop(client, None)
        return []

    def poll(self, now: float) -> Outgoing:
        """Return entries of converted logs, and the next data of every download."""
        self._store.poll(now)
        out: Outgoing = []
        for client, (first, last) in list(self._lists.items()) if not self._store.is_searching else ():
            if not self._store.logs:
                out.append((client.peer, wire.MAVLink_log_entry_message(0, 0, 0, 0, 0)))
            last = min(last, len(self._store.logs) - 1)
            while first <= last and (entry := self._make_log_entry(first)) is not None:
                out.append((client.peer, entry))
                first += 1
            self._lists[client] = (first, last)
            if first > last:
                del self._lists[client]
        for client, download in list(self._downloads.items()):
            for _ in range(
                download.limit.take_tokens(now, -(-(download.end - download.at) // MAX_DATA_BYTES), client.peer)
            ):
                out.append((client.peer, download.next()))
                if download.at >= download.end:
                    break
            if download.at >= download.end:
                if download.is_past_end:  # an empty part marks the end
                    out.append((client.peer, _make_log_data(download.number, download.at, b"")))
                del self._downloads[client]
        return out

    @property
    def is_busy(self) -> bool:
        return bool(self._downloads or self._lists or self._store.is_converting)

    def forget(self, peer: Peer) -> None:
        for store in (self._lists, self._downloads):
            for client in [client for client in store if client.peer == peer]:
                store.pop(client)

    def _make_log_entry(self, number: int) -> Message | None:
        """Return LOG_ENTRY of a log, or None while it is not converted."""
        logs = self._store.logs
        file = logs[number].file
        if file is None:
            return None
        size = min(file.size, 2**32 - 1)
        return wire.MAVLink_log_entry_message(number, len(logs), len(logs) - 1, logs[number].time_utc, size)

    def _begin_download(self, message: Message, client: Client) -> list[Message]:
        logs = self._store.logs
        file = logs[message.id].file if message.id < len(logs) else None
        if file is None:
            return []
        if message.ofs >= file.size or message.count == 0:
            return [_make_log_data(message.id, message.ofs, b"")]
        end = message.ofs + message.count
        old = self._downloads.pop(client, None)
        if len(self._downloads) >= MAX_CLIENTS:
            self._downloads.popitem(last=False)
        limit = old.limit if old is not None else RateLimit(self.rate, 30)
        self._downloads[client] = _Download(message.id, file, message.ofs, min(end, file.size), end > file.size, limit)
        return []


class _Download:
    """Download of a part of a log by one client."""

    def __init__(self, number: int, file: File, at: int, end: int, is_past_end: bool, limit: RateLimit) -> None:
        self.number, self.at, self.end, self.is_past_end, self.limit = number, at, end, is_past_end, limit
        self._file = file
        self._buffer, self._buffer_at = b"", at  # read from disk in larger parts

    def next(self) -> Message:
        start = self.at - self._buffer_at
        if start + MAX_DATA_BYTES > len(self._buffer):
            self._buffer, self._buffer_at, start = self._file.read(self.at, 100 * MAX_DATA_BYTES), self.at, 0
        part = self._buffer[start : start + min(MAX_DATA_BYTES, self.end - self.at)]
        message = _make_log_data(self.number, self.at, part)
        self.at = self.at + len(part) if part else self.end
        return message


def find_finished_runs(root: Path) -> list[Path]:
    """Return the folders of the finished runs in ``root``, in the order in which they began."""
    with suppress(OSError):
        runs = [
            summary.parent for summary in root.glob("*/summary.json") if (summary.parent / "flight.parquet").exists()
        ]
        return sorted(runs, key=lambda run: (_start_time(run), run.name))
    return []


def _start_time(run: Path) -> int:
    """Return the start time of a run [s since 1970]; 0 if unknown."""
    try:
        started = read_json(run / "summary.json")["started"]
        moment = datetime.fromisoformat(started)
        seconds = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        return min(2**32 - 1, max(0, int(seconds)))  # unsigned, 32 bits
    except (ValueError, KeyError, TypeError):
        return 0


def _file_name(log: LogEntry) -> str:
    moment = datetime.fromtimestamp(log.time_utc, UTC)
    return f"log_{log.number}_{moment:%Y-%m-%d-%H-%M-%S}.ulg"


def _make_log_data(number: int, offset: int, part: bytes) -> Message:
    return wire.MAVLink_log_data_message(number, offset, len(part), list(part.ljust(MAX_DATA_BYTES, b"\0")))
