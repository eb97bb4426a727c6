"""The rows of a campaign on disk, whole and readable at every moment.

``flights/part-00000.parquet`` and so on hold the rows in the order in which they were finished, ``PART_ROWS`` each but
for the last, which is now and then replaced by one that has all its rows and more.  What is finished since then is in
``flights.jsonl``, one row a line, written as the row comes: a process that is killed leaves at most its last line torn.
A row leaves the journal only when it is in a part.
"""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from cosim.base.errors import FlightError, InputError
from cosim.base.storage.appended import AppendedFile
from cosim.base.storage.files import map_os_errors, parse_json, read_file, try_lock
from cosim.base.trust import without_code
from cosim.campaign.columns import stored_kinds, write_columns
from cosim.campaign.folder import (
    CAMPAIGN_FILES,
    COLUMNS,
    FLIGHTS,
    JOURNAL,
    RECORD,
    SCENARIO,
    STUDY,
    FrozenStudy,
    check_asked,
    check_unedited,
    freeze,
    is_campaign,
    load,
)
from cosim.campaign.study.plan import flight_count, flights
from cosim.campaign.study.sequential import StoppingRule
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import Kinds, Row, Value, kinds, verdict_of
from cosim.results.log.arrow import read_table, write_table

PART_ROWS = 4096  # 2 MB
WRITE_S = 15.0  # s between replacements of the last part, each of which takes 50 ms
SYNC_S = 1.0  # s between syncs of the journal to disk: what a power cut may cost
_PARTS = "part-*.parquet"
_TALLIED = ("flight", "controller", "success", "outcome")


class FinishedNumbers:
    """The numbers of finished flights, a byte each, for there may be millions."""

    def __init__(self, of: int) -> None:
        self._marks = bytearray(of)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __contains__(self, number: int) -> bool:
        return bool(self._marks[number])

    def add(self, number: int) -> None:
        self._count += not self._marks[number]
        self._marks[number] = 1

    def remove(self, number: int) -> None:
        self._count -= self._marks[number]
        self._marks[number] = 0


class Tally:
    """Counts of what is finished: by controller, how many of how many were a success; and by outcome."""

    def __init__(self) -> None:
        self.flights: Counter[str] = Counter()
        self.successes: Counter[str] = Counter()
        self.outcomes: Counter[str] = Counter()

    def add(self, controller: str, success: bool, outcome: str) -> None:
        self.flights[controller] += 1
        self.successes[controller] += success
        self.outcomes[outcome] += 1


class Store:
    """A campaign's folder as the one process that adds to it sees it; a context manager.

    ``flights`` are all of the study's, ``done`` the numbers of those that are finished, ``tally`` what became of them.
    """

    def __init__(self, folder: Path, journal: AppendedFile) -> None:
        self.folder = folder
        self.study = load(folder)
        self.flights = flights(self.study)
        self.done = FinishedNumbers(len(self.flights))
        self.tally = Tally()
        self._journal = journal
        self._kinds = kinds(self.study)
        self._part = 0
        self._rows: list[Row] = []  # rows of the part that is being filled
        self._written = 0  # of them
        self._last_write = self._last_sync = time.monotonic()

    @classmethod
    def create(cls, folder: Path, study: Study) -> Store:
        """Begin a campaign in a folder that holds none.

        Raises InputError if it holds anything of one, or cannot be written to; nothing is changed then.
        """
        existing = next((name for name in CAMPAIGN_FILES if (folder / name).exists()), None)
        if existing is not None:
            what = f"already holds a campaign ({existing})" if is_campaign(folder) else f"already holds {existing}"
            more = "; --resume goes on with it" if is_campaign(folder) else "; choose another folder"
            raise InputError(f"{folder}: {what}{more}")
        frozen = freeze(study)
        existing = next((name for name in frozen.files if (folder / name).exists()), None)
        if existing is not None:
            raise InputError(f"{folder}: already holds {existing}; choose another folder")
        with map_os_errors(InputError, folder):
            folder.mkdir(parents=True, exist_ok=True)
            journal = _open_journal(folder, os.O_CREAT | os.O_EXCL)  # first: an empty one tells that it hardly began
        try:
            return cls._begin_with(folder, journal, frozen)
        except InputError:
            for name in (*frozen.files, SCENARIO, RECORD, STUDY, JOURNAL, COLUMNS):
                (folder / name).unlink(missing_ok=True)
            with suppress(OSError):
                (folder / FLIGHTS).rmdir()
            raise

    @classmethod
    def _begin_with(cls, folder: Path, journal: AppendedFile, frozen: FrozenStudy) -> Store:
        try:
            with map_os_errors(InputError, folder):
                (folder / FLIGHTS).mkdir(exist_ok=True)
                frozen.write(folder)
                store = cls(folder, journal)
                write_columns(folder, store.study)
        except InputError:
            journal.close()
            raise
        return store

    @classmethod
    def resume(cls, folder: Path, study: Study | None = None) -> Store:
        """Go on with the campaign in a folder, or begin it if it was killed before it had begun.

        Raises InputError if the folder, or the program, is not as it was at the first flight, ``study`` is another one
        than the folder's, or another process is at work there.
        """
        frozen = None if study is None else freeze(study)
        anew = frozen is not None and _lacks_study(folder)
        if not anew:
            load(folder)
        with map_os_errors(InputError, folder):
            journal = _open_journal(folder, os.O_CREAT)
        if frozen is not None and anew:
            return cls._begin_with(folder, journal, frozen)
        try:
            check_asked(folder, frozen, f"{folder}: holds another study")
            store = cls(folder, journal)
            store._take_up()
        except BaseException:
            journal.close()
            raise
        return store

    def add(self, row: Row) -> None:
        """Keep a finished flight; one that is finished already is left aside.

        Raises FlightError if it cannot be written; what was finished before is kept.
        """
        number = _flight_number(row)
        if number in self.done:
            return
        # in memory first: Ctrl-C may come between any two lines, and what only the journal has is not put into a part
        self._rows.append(row)
        self._note(row)
        try:
            self._journal.append((json.dumps(row) + "\n").encode())
        except FlightError:
            self._rows.pop()
            self.done.remove(number)
            raise
        now = time.monotonic()
        if len(self._rows) >= PART_ROWS or now - self._last_write >= WRITE_S:
            self.flush()
        elif now - self._last_sync >= SYNC_S:
            self._journal.sync()
            self._last_sync = now

    @property
    def stored(self) -> int:
        """How many flights the folder has when it is closed; the last may be held and not noted yet, if Ctrl-C came."""
        return len(self.done) + sum(_flight_number(row) not in self.done for row in self._rows[-1:])

    def flush(self) -> None:
        """Put what is in the journal into the last part.  Raises FlightError if it cannot be written."""
        if len(self._rows) > self._written:
            path = self.folder / FLIGHTS / f"part-{self._part:05d}.parquet"
            write_table(path, {name: [row.get(name) for row in self._rows] for name in self._kinds}, kinds=self._kinds)
            _sync_folder(path.parent)  # a power cut must not bring back the part before, now that the journal goes
            self._written = len(self._rows)
        os.ftruncate(self._journal.number, 0)
        if self._written >= PART_ROWS:
            self._part, self._rows, self._written = self._part + 1, [], 0
        self._last_write = time.monotonic()

    def close(self) -> None:
        """Put everything into parts and give the folder free; may be called twice.  Raises FlightError as flush."""
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
        with suppress(FlightError):  # the disk is full, say; that is being told already
            self.close()

    def _take_up(self) -> None:
        """Find out what is finished, the rows of the journal among it."""
        for leftover in (*self.folder.glob(".*.tmp"), *(self.folder / FLIGHTS).glob(".*.tmp")):  # of a killed process
            leftover.unlink(missing_ok=True)
        paths = _parts(self.folder)
        for path in paths:
            columns = read_table(path, _TALLIED)
            for number, controller, success, outcome in zip(*columns.values(), strict=True):
                self.done.add(int(number or 0))
                self.tally.add(str(controller), bool(success), str(outcome))
            self._part = int(path.stem.removeprefix("part-")) + 1
        if paths:
            columns = read_table(paths[-1])
            last = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
            if len(last) < PART_ROWS:
                self._part, self._rows, self._written = self._part - 1, last, len(last)
        for row in _journal(self.folder, len(self.flights)):
            if _flight_number(row) not in self.done:
                self._note(row)
                self._rows.append(row)
        self.flush()

    def _note(self, row: Row) -> None:
        self.done.add(_flight_number(row))
        self.tally.add(str(row["controller"]), bool(row["success"]), str(row["outcome"]))


@dataclass(frozen=True)
class Campaign:
    """A campaign as it was when it was opened; flights may be added to its folder meanwhile.

    ``columns["outcome"]`` is a list with an entry for each finished flight, in the order of their numbers; there are
    flight, draw, controller, seed, every varied key under its dotted name, outcome, reason, success, steps, duration_s,
    every metric under the name that an expectation uses, hashes of the log and of what it was made from, and wall_s and
    worker.  ``of`` is how many flights the study has.
    """

    folder: Path
    study: Study
    columns: Mapping[str, list[Value]]
    of: int

    def __len__(self) -> int:
        return len(self.columns["flight"])

    def row(self, number: int) -> Row:
        """Return the row of one flight.  Raises InputError if there is none, or it is not finished."""
        if not 0 <= number < self.of:
            raise InputError(f"{self.folder}: flight {number}: there are 0 to {self.of - 1}")
        if number not in self.columns["flight"]:
            raise InputError(f"{self.folder}: flight {number} is not finished; --resume goes on")
        index = self.columns["flight"].index(number)
        return {name: values[index] for name, values in self.columns.items()}


def open_campaign(folder: Path | str) -> Campaign:
    """Open the campaign in a folder with every flight finished by now; it may still be flown, or have been killed.

    >>> campaign = open_campaign(folder)
    >>> campaign.columns["success"].count(True) / len(campaign)
    1.0

    None of the code that it names is run.  Raises InputError if there is none, a file cannot be read, or its study is
    not the one that its flights were judged by.
    """
    folder = Path(folder)
    with without_code():
        study = load(folder)
        check_unedited(folder)
        of = flight_count(study)
        columns = stored_kinds(folder, study)
    return Campaign(folder, study, _Columns(folder, columns, of), of)


def count_flights(rule: StoppingRule, campaign: Campaign) -> None:
    """Let a stopping rule count the flights of a campaign."""
    columns = [campaign.columns.get(name, []) for name in ("flight", "outcome", "success")]
    for number, outcome, success in zip(*columns, strict=True):
        rule.add(int(number or 0), verdict_of(outcome, success))


class _Columns(Mapping[str, list[Value]]):
    """The columns of all finished flights; each is read when it is asked for."""

    def __init__(self, folder: Path, columns: Kinds, of: int) -> None:
        self._names = tuple(columns)
        # the journal first: what leaves it meanwhile is in a part by then
        journal_rows = {_flight_number(row): row for row in _journal(folder, of)}
        self._parts = [(path, read_table(path, ("flight",))["flight"]) for path in _parts(folder)]
        numbers = [number for _, stored in self._parts for number in stored]
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
            raise KeyError(name)
        if name not in self._read:
            values: list[Value] = []
            for path, stored in self._parts:
                # it may have grown at its end, and an older version may have written fewer columns
                values += read_table(path, (name,), lacking=True)[name][: len(stored)]
            values += [row.get(name) for row in self._journal_rows]
            self._read[name] = [values[index] for index in self._order]
        return self._read[name]


def _lacks_study(folder: Path) -> bool:
    """Return whether a process was killed between its first file here and the study, which is written last."""
    journal = folder / JOURNAL
    begun = journal.is_file() and not (folder / STUDY).exists()
    return begun and not journal.stat().st_size and not any((folder / FLIGHTS).glob("*"))


def _parts(folder: Path) -> list[Path]:
    return sorted((folder / FLIGHTS).glob(_PARTS))


def _journal(folder: Path, of: int) -> Iterator[Row]:
    """Yield the rows of the journal up to its end, or to the line that is torn.

    Raises InputError if it cannot be read, or has anything but flights below ``of``.
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
        if not is_row or not isinstance(row["flight"], int) or not 0 <= row["flight"] < of:
            raise InputError(f"{folder / JOURNAL}: line {number} is no flight of this study")
        yield row


def _open_journal(folder: Path, how: int) -> AppendedFile:
    """Open the journal and take its lock.  Raises InputError if another process has it, OSError."""
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
