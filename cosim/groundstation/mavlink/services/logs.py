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

from cosim.base.runtime.processes import Child, python_command
from cosim.base.storage.scratch import scratch
from cosim.groundstation.mavlink.services.ftp import Bytes, File
from cosim.groundstation.mavlink.services.service import MAX_CLIENTS, Client, Outgoing, Peer, RateLimit, Service
from cosim.groundstation.mavlink.wire.dialect import Message
from cosim.groundstation.mavlink.wire.dialect import mav as wire

FIRST_LOGS = 20  # runs of before that are listed, the newest; chosen by us, as each has to be made
MOST_LOGS = 200  # with those that come later
RATE = 2500.0  # LOG_DATA a second and client: 225 kB/s, as fast as a flight at 250 Hz writes them; chosen by us
LOOK_AGAIN = 2.0  # s before the folders are read again, however often somebody asks; chosen by us
PATIENCE = 300.0  # s to make one log: thirty times what an hour of flight takes
DATA = 90  # bytes in a LOG_DATA
LOG_FOLDER = "log/"
_MAKE = """
import os, pathlib
from cosim.results.export.ulog import export_ulog
if hasattr(os, "nice"):
    os.nice(10)  # the flight that is under way comes first
export_ulog(*map(pathlib.Path, sys.argv[1:]), rates="px4")  # small enough to come down in a tenth of the flight's time
"""


class DiskFile:
    """A file on the disk; what cannot be read of it is missing."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = path.stat().st_size

    def read(self, offset: int, length: int) -> bytes:
        """Return a part of the file, shorter where it ends."""
        try:
            with open(self.path, "rb") as file:
                file.seek(offset)
                return file.read(length)
        except OSError:
            return b""


@dataclass
class Log:
    """One log; ``file`` is None until it is converted, and empty if it could not be converted."""

    number: int
    run: Path
    time_utc: int  # s since 1970
    file: File | None = None


class LogStore:
    """Store of the finished runs' logs, which converts them to ULog one after the other.

    ``runs``: the folders of every finished run, oldest first.  It reads a file of each, so it is called in a thread of
    its own, and again when somebody asks after a while or after :meth:`renew`.  A log's number stays its own: runs that
    come later get the next ones.
    """

    def __init__(self, runs: Callable[[], Sequence[Path]]) -> None:
        self._runs = runs
        self._folder = Path(tempfile.mkdtemp(prefix="logs-", dir=scratch()))
        self._known: set[Path] = set()
        self._maker: tuple[Child, Log, float] | None = None
        self._made = 0  # how many of them are done with
        self._search: Thread | None = None
        self._listed: Sequence[Path] = ()
        self._looked = -inf
        self._stale = True  # a run has been finished since the last search began
        self._now = 0.0
        self.logs: list[Log] = []

    def look(self, now: float) -> None:
        """Start a search for new runs, if none is under way and the last one is not recent."""
        if self._search is None and (self._stale or now - self._looked >= LOOK_AGAIN):
            self._stale = False
            self._search = Thread(target=self._find, name="logs", daemon=True)
            self._search.start()

    def renew(self) -> None:
        """Mark older searches as outdated, because a run has just been finished; from any thread."""
        self._stale = True

    @property
    def looking(self) -> bool:
        """Whether a search for new runs is under way."""
        return self._search is not None

    def _find(self) -> None:
        with suppress(OSError):  # a folder that may not be read: as it was
            self._listed = self._runs()

    def _take_in(self, now: float) -> None:
        """List the runs that a search found, once it has ended."""
        if self._search is None or self._search.is_alive():
            return
        self._search, self._looked = None, now
        new = [run for run in self._listed if run not in self._known]
        first = not self._known
        self._known.update(new)
        for run in new[-FIRST_LOGS:] if first else new[: MOST_LOGS - len(self.logs)]:
            self.logs.append(Log(len(self.logs), run, _started(run)))
        if self._stale:  # finished while it was being looked for: who waits for the list wants it too
            self.look(now)

    def work(self, now: float) -> None:
        """List new runs, take over the log that is converted, and begin with the next one."""
        self._now = now
        self._take_in(now)
        if self._maker is not None:
            process, log, began = self._maker
            code = process.poll()
            if code is None and now - began < PATIENCE:
                return
            self._stop()
            log.file = _on_disk(self._path(log)) if code == 0 else Bytes(b"")
            self._made += 1
        if self._made < len(self.logs):
            log = self.logs[self._made]
            command = python_command(_MAKE, str(log.run), str(self._path(log)))
            quiet = subprocess.DEVNULL
            try:
                self._maker = (Child(command, stdin=quiet, stdout=quiet, stderr=quiet), log, now)
            except OSError:
                log.file = Bytes(b"")
                self._made += 1

    @property
    def making(self) -> bool:
        """Whether a log is not converted yet."""
        return self._made < len(self.logs)

    def files(self) -> Mapping[str, File]:
        """Return the converted logs as files by path, and start a search for new runs."""
        self.look(self._now)
        return {f"{LOG_FOLDER}{_name(log)}": log.file for log in self.logs if log.file is not None and log.file.size}

    def close(self) -> None:
        """Stop, and remove every converted log."""
        self._made = len(self.logs)
        self._stop()
        if self._search is not None:
            self._search.join()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _stop(self) -> None:
        if self._maker is not None:
            self._maker[0].end()
            self._maker = None

    def _path(self, log: Log) -> Path:
        return self._folder / f"{log.number}.ulg"


class LogService(Service):
    """Log service: LOG_REQUEST_LIST, _DATA and _END in, LOG_ENTRY and LOG_DATA out.  Logs are never erased."""

    handles = frozenset({"LOG_REQUEST_LIST", "LOG_REQUEST_DATA", "LOG_REQUEST_END", "LOG_ERASE"})

    def __init__(self, shelf: LogStore) -> None:
        self._shelf = shelf
        self._lists: dict[Client, tuple[int, int]] = {}  # the entries that each still waits for
        self._reads: OrderedDict[Client, _Reading] = OrderedDict()

    def handle(self, message: Message, client: Client, now: float) -> list[Message]:
        """Return the answers to one message; entries and data go out later."""
        kind = message.get_type()
        if kind == "LOG_REQUEST_LIST":
            self._shelf.look(now)
            if message.start <= message.end and (client in self._lists or len(self._lists) < MAX_CLIENTS):
                self._lists[client] = (message.start, message.end)
        elif kind == "LOG_REQUEST_DATA":
            return self._begin(message, client)
        elif kind == "LOG_REQUEST_END":
            self._reads.pop(client, None)
            self._lists.pop(client, None)
        return []

    def poll(self, now: float) -> Outgoing:
        """Return entries of converted logs, and the next part of every download."""
        self._shelf.work(now)
        out: Outgoing = []
        for client, (first, last) in list(self._lists.items()) if not self._shelf.looking else ():
            if not self._shelf.logs:
                out.append((client.peer, wire.MAVLink_log_entry_message(0, 0, 0, 0, 0)))
            last = min(last, len(self._shelf.logs) - 1)
            while first <= last and (entry := self._entry(first)) is not None:
                out.append((client.peer, entry))
                first += 1
            self._lists[client] = (first, last)
            if first > last:
                del self._lists[client]
        for client, reading in list(self._reads.items()):
            for _ in range(reading.pace.take(now, -(-(reading.end - reading.at) // DATA), client.peer)):
                out.append((client.peer, reading.next()))
                if reading.at >= reading.end:
                    break
            if reading.at >= reading.end:
                if reading.beyond:  # more was asked for than there is: an empty part is the end
                    out.append((client.peer, _data(reading.number, reading.at, b"")))
                del self._reads[client]
        return out

    @property
    def busy(self) -> bool:
        return bool(self._reads or self._lists or self._shelf.making)

    def forget(self, peer: Peer) -> None:
        """Drop the lists and downloads of a peer that is gone."""
        for store in (self._lists, self._reads):
            for client in [client for client in store if client.peer == peer]:
                store.pop(client)

    def _entry(self, number: int) -> Message | None:
        """Return a log's entry; None while it is not converted."""
        logs = self._shelf.logs
        log = logs[number]
        if log.file is None:
            return None
        size = min(log.file.size, 2**32 - 1)
        return wire.MAVLink_log_entry_message(number, len(logs), len(logs) - 1, log.time_utc, size)

    def _begin(self, message: Message, client: Client) -> list[Message]:
        logs = self._shelf.logs
        if message.id >= len(logs):
            return []
        file = logs[message.id].file
        if file is None:
            return []
        if message.ofs >= file.size or message.count == 0:
            return [_data(message.id, message.ofs, b"")]
        end = message.ofs + message.count
        old = self._reads.pop(client, None)
        if len(self._reads) >= MAX_CLIENTS:
            self._reads.popitem(last=False)
        pace = old.pace if old is not None else RateLimit(RATE, 30)
        self._reads[client] = _Reading(message.id, file, message.ofs, min(end, file.size), end > file.size, pace)
        return []


class _Reading:
    """A download of a part of a log."""

    def __init__(self, number: int, file: File, at: int, end: int, beyond: bool, pace: RateLimit) -> None:
        self.number, self.at, self.end, self.beyond, self.pace = number, at, end, beyond, pace
        self._file = file
        self._ahead, self._ahead_at = b"", at  # read from the disk in larger parts

    def next(self) -> Message:
        """Return the next LOG_DATA."""
        start = self.at - self._ahead_at
        if start + DATA > len(self._ahead):
            self._ahead, self._ahead_at, start = self._file.read(self.at, 100 * DATA), self.at, 0
        part = self._ahead[start : start + min(DATA, self.end - self.at)]
        message = _data(self.number, self.at, part)
        self.at = self.at + len(part) if part else self.end
        return message


def _on_disk(path: Path) -> File:
    try:
        return DiskFile(path)
    except OSError:
        return Bytes(b"")


def finished_runs(root: Path) -> list[Path]:
    """Return the folders of the finished runs in ``root``, in the order in which they began."""
    with suppress(OSError):
        runs = [
            summary.parent for summary in root.glob("*/summary.json") if (summary.parent / "flight.parquet").exists()
        ]
        return sorted(runs, key=lambda run: (_started(run), run.name))
    return []


def _started(run: Path) -> int:
    """Return when a run began [s since 1970]; 0 where its summary does not say."""
    import json

    try:
        stated = json.loads((run / "summary.json").read_text(encoding="utf-8"))["started"]
        moment = datetime.fromisoformat(stated)
        seconds = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        return min(2**32 - 1, max(0, int(seconds)))  # as its field
    except (OSError, ValueError, KeyError, TypeError):
        return 0


def _name(log: Log) -> str:
    moment = datetime.fromtimestamp(log.time_utc, UTC)
    return f"log_{log.number}_{moment:%Y-%m-%d-%H-%M-%S}.ulg"


def _data(number: int, offset: int, part: bytes) -> Message:
    return wire.MAVLink_log_data_message(number, offset, len(part), list(part.ljust(DATA, b"\0")))
