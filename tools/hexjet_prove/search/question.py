"""The folder of a question about a study that flights answer: a search, or the probability of a rare failure.

``study/`` has the study and the scenario with all their numbers, a TOML file what was asked, ``flights.jsonl`` a line a
flight as it came, and ``cases/`` the runs of the flights that show the answer.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from cosim.base.errors import FlightError, InputError
from cosim.base.storage.files import lock_file, map_os_errors, write_whole
from cosim.base.storage.toml import read_toml, toml_text
from cosim.flight import fly_watched as fly
from cosim.results.log.digest import log_digest
from cosim.results.run import REPORT, SCENARIO
from cosim.studies import Flight, FrozenStudy, Row, Study, check_asked, freeze, load_study, scenario_of
from hexjet_prove.search.probe import Journal
from hexjet_prove.search.search import describe_flight

STUDY, JOURNAL, CASES = "study", "flights.jsonl", "cases"


class Words(NamedTuple):
    """How messages name the file of what is asked, what a folder may lack or hold, another one, and who works there."""

    file: str
    none: str
    one: str
    other: str
    busy: str


def _holds_question(out: Path, frozen: FrozenStudy, asked: Mapping[str, Any], resume: bool, words: Words) -> bool:
    """Return whether the folder holds this very question, to be resumed; InputError if it holds anything else."""
    if not out.exists() or not any(out.iterdir()):
        return False
    if not (out / words.file).is_file():
        raise InputError(f"{out}: is not empty and holds no {words.none}; choose another folder")
    if not resume:
        raise InputError(f"{out}: already holds {words.one}; choose another folder, or --resume goes on with it")
    holds = f"{out}: holds {words.other}"
    check_asked(out / STUDY, frozen, holds)
    saved = read_toml(out / words.file)
    for key in sorted(asked.keys() | saved.keys()):
        if asked.get(key) != saved.get(key):
            raise InputError(f"{holds}; {words.file}: {key} is {saved.get(key)} there and {asked.get(key)} here")
    return True


def _begin_question(out: Path, frozen: FrozenStudy, asked: Mapping[str, Any], words: Words) -> None:
    """Write what the folder needs before its first flight."""
    (out / STUDY).mkdir(parents=True)
    frozen.write(out / STUDY)
    (out / JOURNAL).touch()
    write_whole(out / words.file, toml_text(dict(asked)))  # the last: a folder that has it has all


class FlownCase(Protocol):
    """A flight that shows the answer, flown again: a dataclass."""

    @property
    def same(self) -> bool:
        """Whether it is as it was before, bit for bit."""
        ...


class Answer(Protocol):
    """What came of a question."""

    def to_json(self) -> dict[str, Any]:
        """Return it as a table."""
        ...


A = TypeVar("A", bound=Answer)
C = TypeVar("C", bound=FlownCase)


@dataclass(frozen=True)
class Answered(Generic[A, C]):
    """An answer, its folder, and the flights that show it, flown again."""

    folder: Path
    result: A
    cases: tuple[C, ...]

    @property
    def confirmed(self) -> bool:
        """Whether every case came out as it had before."""
        return all(case.same for case in self.cases)

    def to_json(self) -> dict[str, Any]:
        """Return the table that the folder's JSON file holds."""
        cases = [asdict(case) for case in self.cases]  # type: ignore[call-overload]
        return {"folder": str(self.folder), **self.result.to_json(), "cases": cases, "confirmed": self.confirmed}

    def write(self, name: str) -> None:
        """Write the folder's JSON file.  Raises OSError."""
        write_whole(self.folder / name, json.dumps(self.to_json(), indent=1, allow_nan=False) + "\n")


@contextmanager
def open_question(
    study: Study, asked: Mapping[str, Any], out: Path, resume: bool, words: Words
) -> Iterator[tuple[Study, Journal]]:
    """Hold the folder of a question, which is begun if need be; yields the study as it is there, and the flights.

    ``asked`` is what is asked, as a table.  Raises InputError if study or folder is not usable (another question's, in
    use, or one that is not resumed), and nothing is overwritten then; FlightError if the folder cannot be written to.
    """
    frozen = freeze(study)
    with map_os_errors(FlightError, out):
        if not _holds_question(out, frozen, asked, resume, words):
            _begin_question(out, frozen, asked, words)
        with lock_file(out / JOURNAL, f"{out}: another {words.busy} is at work there"):
            yield load_study(out / STUDY), Journal(out / JOURNAL)


def empty_cases(out: Path) -> Path:
    """Return the folder for the runs that show the answer, without what one left that was stopped while it flew."""
    shutil.rmtree(out / CASES, ignore_errors=True)
    return out / CASES


class FlownAgain(NamedTuple):
    """A flight flown again: its outcome, what came of it in words, and whether it is as in its row, bit for bit."""

    outcome: str
    reason: str
    same: bool


def fly_row_again(study: Study, flight: Flight, row: Row, folder: Path) -> FlownAgain:
    """Fly a flight that has a row once more, recorded in full in ``folder``, and compare it with its row."""
    try:
        run = fly(scenario_of(study, flight), folder)
    except InputError as error:  # it could not be flown the first time either, which is how it failed
        return FlownAgain("failed", str(error), row["reason"] == str(error))
    same = row["log_sha256"] == log_digest(run.log) and row["outcome"] == run.outcome
    reason = describe_flight(study, row) if same else f"{run.outcome}, {run.summary.reason}"
    return FlownAgain(run.outcome, reason, same)


def case_rows(answered: Answered[Any, Any], page: Path) -> list[dict[str, Any]]:
    """Return each ``case`` with its ``report`` as linked from a page, empty without one, and the file to fly again."""
    rows = []
    for case in answered.cases:
        folder = answered.folder / CASES / case.name
        report = folder / REPORT
        link = Path(os.path.relpath(report, page.parent)).as_posix() if report.is_file() else ""
        rows.append({"case": case, "report": link, "command": shlex.quote((folder / SCENARIO).as_posix())})
    return rows
