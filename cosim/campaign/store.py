"""The rows of a campaign on disk, whole and readable at every moment.

``flights/part-00000.parquet`` and so on hold the rows in the order in which they were finished, ``PART_SIZE`` each but
for the last, which is now and then replaced by one that has all its rows and more.  What is finished since then is in
``flights.jsonl``, one row a line, written as the row comes: a process that is killed leaves at most its last line torn.
A row leaves the journal only when it is in a part.
"""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from math import inf
from pathlib import Path
from types import TracebackType
from typing import Any

from cosim.base.errors import FlightError, InputError, nearest
from cosim.base.storage.appended import AppendedFile
from cosim.base.storage.files import map_os_errors, parse_json, read_file, try_lock
from cosim.base.trust import without_code
from cosim.campaign.columns import stored_kinds, write_columns
from cosim.campaign.folder import (
    ASKED,
    CAMPAIGN_FILES,
    COLUMNS,
    FLIGHTS,
    JOURNAL,
    REFEREE,
    SCENARIO,
    STUDY,
    FrozenStudy,
    check_asked,
    check_unedited,
    fingerprint,
    freeze,
    is_campaign,
    load,
    read_asked,
    refuse_older_search,
)
from cosim.campaign.study.plan import Flight, flight_count, flight_key, flight_of, flights
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import KEY, Kinds, Row, Value, kinds
from cosim.results.log.arrow import read_table, write_table
from cosim.results.log.tables import NamedColumns

PART_SIZE = 4096  # rows per part, 2 MB
WRITE_INTERVAL_S = 15.0  # s between writes, which take 50 ms
SYNC_INTERVAL_S = 1.0  # s of flights that a power cut may cost
_PARTS = "part-*.parquet"  # names of the parts
_TALLIED = ("flight", "controller", "success", "outcome")  # columns that the tally needs
_EMPTY_ROW: Row = {}  # one object for millions of flights


class Tally:
    """Counts of finished flights: successes by controller, and outcomes."""

    def __init__(self) -> None:
        self.flights: Counter[str] = Counter()
        self.successes: Counter[str] = Counter()
        self.outcomes: Counter[str] = Counter()

    def add(self, controller: str, success: bool, outcome: str) -> None:
        """Count a finished flight."""
        self.flights[controller] += 1
        self.successes[controller] += success
        self.outcomes[outcome] += 1


class Store:
    """A folder of flights, opened by the one process that adds to it; a context manager.

    ``done`` has the finished flights by their keys, with the columns ``kept`` of each row, all of them for None;
    ``tally`` is what became of them, and ``of`` how many there will be, 0 where a sampler decides that as it goes.
    """

    def __init__(self, folder: Path, journal: AppendedFile, kept: Sequence[str] | None = ()) -> None:
        asked = read_asked(folder)
        self.folder = folder
        self.study = load(folder)
        self.of = 0 if asked["plan"] else flight_count(self.study)
        self.done: dict[str, Row] = {}
        self.tally = Tally()
        self._fingerprint = fingerprint(asked)
        self._kept = kept
        self._journal = journal
        self._kinds = kinds(self.study)
        self._part = 0
        self._rows: list[Row] = []  # rows of the part being filled
        self._written = 0  # how many of these rows are on disk
        self._last_write = self._last_sync = time.monotonic()

    @classmethod
    def create(
        cls, folder: Path, study: Study, plan: Mapping[str, Any] | None = None, kept: Sequence[str] | None = ()
    ) -> Store:
        """Begin a campaign in a folder without flights; ``plan`` is what a command adds to the study.

        Raises InputError if it holds anything of a campaign, or cannot be written to; nothing is changed then.
        """
        refuse_older_search(folder)
        existing = next((name for name in CAMPAIGN_FILES if (folder / name).exists()), None)
        if existing is not None and is_campaign(folder):
            raise InputError(f"{folder}: already holds a campaign ({existing}); resume goes on with it")
        frozen = freeze(study, plan)
        existing = existing or next((name for name in frozen.files if (folder / name).exists()), None)
        if existing is not None:
            raise InputError(f"{folder}: already holds {existing}; choose another folder")
        with map_os_errors(InputError, folder):
            folder.mkdir(parents=True, exist_ok=True)
            # The journal is created first: without one, the campaign had hardly begun.
            journal = _open_journal(folder, os.O_CREAT | os.O_EXCL)
        try:
            return cls._begin_in(folder, journal, frozen, kept)
        except InputError:
            for name in (*frozen.files, SCENARIO, ASKED, STUDY, JOURNAL, COLUMNS):
                (folder / name).unlink(missing_ok=True)
            with suppress(OSError):
                (folder / FLIGHTS).rmdir()
            raise

    @classmethod
    def _begin_in(cls, folder: Path, journal: AppendedFile, frozen: FrozenStudy, kept: Sequence[str] | None) -> Store:
        try:
            with map_os_errors(InputError, folder):
                (folder / FLIGHTS).mkdir(exist_ok=True)
                frozen.write_files(folder)
                write_columns(folder, Study.from_table(frozen.study, folder.absolute(), str(folder.absolute() / STUDY)))
                frozen.write_study(folder)
                store = cls(folder, journal, kept)
        except InputError:
            journal.close()
            raise
        return store

    @classmethod
    def resume(
        cls,
        folder: Path,
        study: Study | None = None,
        plan: Mapping[str, Any] | None = None,
        kept: Sequence[str] | None = (),
    ) -> Store:
        """Continue a campaign in its folder, or begin it if its process was killed before the first flight.

        Raises InputError if the folder, or the program, is not as it was at the first flight, study or plan is another
        one than the folder's, or another process is at work there.
        """
        frozen = None if study is None else freeze(study, plan)
        anew = frozen is not None and _lacks_study(folder)
        if not anew:
            load(folder)
        with map_os_errors(InputError, folder):
            journal = _open_journal(folder, os.O_CREAT)
        if frozen is not None and anew:
            return cls._begin_in(folder, journal, frozen, kept)
        try:
            check_asked(folder, frozen)
            store = cls(folder, journal, kept)
            store._read_finished_flights()
        except BaseException:
            journal.close()
            raise
        return store

    @cached_property
    def flights(self) -> Sequence[Flight]:
        return flights(self.study)

    def key(self, flight: Flight) -> str:
        """Return the hash of what is flown: scenario, program, controller, seed and values."""
        return flight_key(self._fingerprint, flight)

    def add(self, row: Row) -> None:
        """Store a finished flight under its key, unless it is stored already.

        Raises FlightError if it cannot be written; what was finished before is kept.
        """
        key = self.key(flight_of(self.study, row))
        if key in self.done:
            return
        row = row | {KEY: key}
        # Into memory first: Ctrl-C may come at any line, and rows of the journal alone never get into a part.
        self._rows.append(row)
        self._count_row(row)
        try:
            self._journal.append((json.dumps(row) + "\n").encode())
        except FlightError:
            self._rows.pop()
            del self.done[key]
            raise
        now = time.monotonic()
        if len(self._rows) >= PART_SIZE or now - self._last_write >= WRITE_INTERVAL_S:
            self.flush()
        elif now - self._last_sync >= SYNC_INTERVAL_S:
            self._journal.sync()
            self._last_sync = now

    @property
    def stored(self) -> int:
        """Number of flights in the folder after closing, including one that Ctrl-C left unreported."""
        return len(self.done) + sum(row[KEY] not in self.done for row in self._rows[-1:])

    def flush(self) -> None:
        """Move the journal's rows into the last part.  Raises FlightError if that fails."""
        if len(self._rows) > self._written:
            path = self.folder / FLIGHTS / f"part-{self._part:05d}.parquet"
            write_table(path, {name: [row.get(name) for row in self._rows] for name in self._kinds}, kinds=self._kinds)
            # Sync before the journal goes, or a power cut could bring back the old part without it.
            _sync_folder(path.parent)
            self._written = len(self._rows)
        os.ftruncate(self._journal.number, 0)
        if self._written >= PART_SIZE:
            self._part, self._rows, self._written = self._part + 1, [], 0
        self._last_write = time.monotonic()

    def close(self) -> None:
        """Move all rows into parts and release the folder; may be called twice.  Raises FlightError."""
        if self._journal.number < 0:
            return
        try:
            self.flush()
        finally:
            self._journal.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None or not issubclass(kind, FlightError):
            self.close()
            return
        # The error in progress, such as a full disk, is reported already.
        with suppress(FlightError):
            self.close()

    def _read_finished_flights(self) -> None:
        """Read the rows of finished flights from parts and journal, and move those of the journal into parts."""
        for leftover in (*self.folder.glob(".*.tmp"), *(self.folder / FLIGHTS).glob(".*.tmp")):  # of a killed process
            leftover.unlink(missing_ok=True)
        paths = _list_parts(self.folder)
        for path in paths:
            for row in _read_rows(path, None if self._kept is None else {KEY, *_TALLIED, *self._kept}):
                self._count_row(row)
            self._part = int(path.stem.removeprefix("part-")) + 1
        if paths:
            last = list(_read_rows(paths[-1]))
            if len(last) < PART_SIZE:
                self._part, self._rows, self._written = self._part - 1, last, len(last)
        for row in _read_journal(self.folder, self.of):
            if row.get(KEY) is None or row[KEY] != self.key(flight_of(self.study, row)):
                raise InputError(f"{self.folder / JOURNAL}: flight {row['flight']} is no flight of this study")
            if row[KEY] not in self.done:
                self._count_row(row)
                self._rows.append(row)
        self.flush()

    def _count_row(self, row: Row) -> None:
        self.done[str(row[KEY])] = row if self._kept is None else {name: row[name] for name in self._kept} or _EMPTY_ROW
        self.tally.add(str(row["controller"]), bool(row["success"]), str(row["outcome"]))


@dataclass(frozen=True)
class Campaign:
    """A campaign as it was when opened; flights may be added to its folder meanwhile.

    ``columns["outcome"]`` is a list with an entry for each finished flight, in the order of their numbers; there are
    flight, draw, controller, seed, every varied key under its dotted name, outcome, reason, success, steps, duration_s,
    every metric under the name that an expectation uses, hashes of the log and of what it was made from, and wall_s and
    worker.  ``of`` is how many flights the study has, and ``plan`` what a command asked beside it, as a table.
    """

    folder: Path
    study: Study
    columns: Mapping[str, list[Value]]
    of: int
    plan: Mapping[str, Any] = field(default_factory=dict)
    referee: Mapping[str, Any] = field(default_factory=dict)  # see ``read_referee``

    def __len__(self) -> int:
        return len(self.columns["flight"])

    def row(self, number: int) -> Row:
        """Return the row of one flight.  Raises InputError if it does not exist or is not finished."""
        if not 0 <= number < self.of:
            raise InputError(f"{self.folder}: flight {number}: there are 0 to {self.of - 1}")
        if number not in self.columns["flight"]:
            raise InputError(f"{self.folder}: flight {number} is not finished; resume goes on")
        index = self.columns["flight"].index(number)
        return {name: values[index] for name, values in self.columns.items()}


def open_campaign(folder: Path | str) -> Campaign:
    """Open the campaign in a folder with all flights finished so far, also if it is still running or was killed.

    >>> study = open_study("hover", vary=["vehicle.mass_kg=5.4:5.8"], runs=1, settings=["duration_s=0.2"])
    >>> open_campaign(run_campaign(study, "runs/mass", workers=1).folder).columns["success"]
    [True]

    None of the code that it names is run.  Raises InputError if there is none, a file cannot be read, or its study is
    not the one that its flights were judged by.
    """
    folder = Path(folder)
    with without_code():
        study = load(folder)
        plan = check_unedited(folder)
        of = 0 if plan else flight_count(study)
        referee = read_referee(folder)
        columns = _Columns(folder, stored_kinds(folder, study), of, referee.get("success", {}))
    return Campaign(folder, study, columns, of or len(columns["flight"]), plan, referee)


def read_referee(folder: Path) -> Mapping[str, Any]:
    """Return JSBSim's check of a folder's flights on arrays, empty if there was none.  Raises InputError."""
    path = folder / REFEREE
    return parse_json(read_file(path), str(path)) if path.is_file() else {}


class _Columns(NamedColumns[list[Value]]):
    """Columns of all finished flights, each read on demand."""

    def __init__(self, folder: Path, columns: Kinds, of: int, success: Mapping[str, bool]) -> None:
        self._names, self._success = tuple(columns), success  # success as the referee judges it
        # The journal is read first: rows that leave it meanwhile are in a part.
        journal_rows = {_flight_number(row): row for row in _read_journal(folder, of)}
        self._list_parts = [(path, read_table(path, ("flight",))["flight"]) for path in _list_parts(folder)]
        numbers = [number for _, stored in self._list_parts for number in stored]
        stored_numbers = set(numbers)
        self._journal_rows = [row for number, row in journal_rows.items() if number not in stored_numbers]
        numbers += [row["flight"] for row in self._journal_rows]
        self._order = sorted(range(len(numbers)), key=numbers.__getitem__)  # type: ignore[arg-type]
        self._read: dict[str, list[Value]] = {}

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, name: str) -> list[Value]:
        if name not in self._names:
            raise KeyError(f"no column {name!r}; {nearest(name, self._names)}")
        if name not in self._read:
            values: list[Value] = []
            for path, stored in self._list_parts:
                # A part may have grown at its end, and an older version may have written fewer columns.
                values += read_table(path, (name,), lacking=True)[name][: len(stored)]
            values += [row.get(name) for row in self._journal_rows]
            self._read[name] = [values[index] for index in self._order]
            if name == "success" and self._success:
                own = zip(self["flight"], self._read[name], strict=True)
                self._read[name] = [self._success.get(str(number), success) for number, success in own]
        return self._read[name]


def _lacks_study(folder: Path) -> bool:
    """Return whether a process was killed before writing the study, which is written last."""
    journal = folder / JOURNAL
    begun = journal.is_file() and not (folder / STUDY).exists()
    return begun and not journal.stat().st_size and not any((folder / FLIGHTS).glob("*"))


def _list_parts(folder: Path) -> list[Path]:
    return sorted((folder / FLIGHTS).glob(_PARTS))


def _read_rows(path: Path, names: Collection[str] | None = None) -> Iterator[Row]:
    columns = read_table(path, None if names is None else tuple(names))
    return (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))


def _read_journal(folder: Path, of: int) -> Iterator[Row]:
    """Yield the rows of the journal up to its end, or to the line that is torn.

    Raises InputError if it cannot be read, or has anything but flights, below ``of`` where that is not 0.
    """
    path = folder / JOURNAL
    for number, line in enumerate(read_file(path).splitlines(keepends=True) if path.exists() else (), 1):
        if not line.endswith(b"\n"):
            return
        try:
            row = parse_json(line, str(path), finite=False)
        except InputError:
            return
        is_row = isinstance(row, dict) and row.keys() >= set(_TALLIED)
        if not is_row or not isinstance(row["flight"], int) or not 0 <= row["flight"] < (of or inf):
            raise InputError(f"{folder / JOURNAL}: line {number} is no flight of this study")
        yield row


def _open_journal(folder: Path, how: int) -> AppendedFile:
    """Open the journal and take its lock.  Raises OSError, or InputError if another process has it."""
    file = AppendedFile(folder / JOURNAL, os.O_RDWR | os.O_APPEND | how)
    if try_lock(file.number) is False:
        file.close()
        raise InputError(f"{folder}: in use by another process; wait until it ends")
    return file


def _sync_folder(folder: Path) -> None:
    """Write the names in a folder to the disk."""
    file = os.open(folder, os.O_RDONLY)
    try:
        with map_os_errors(FlightError, folder):
            os.fsync(file)
    finally:
        os.close(file)


def _flight_number(row: Row) -> int:
    number = row["flight"]
    assert isinstance(number, int)
    return number
