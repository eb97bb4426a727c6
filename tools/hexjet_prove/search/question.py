"""What a search leaves in the folder of its flights: the answer, its page, and the flights that show it, flown again.

``study.toml`` and ``scenario.toml`` have the study with all its numbers, ``asked.toml`` what was asked beside them,
``flights/`` and ``flights.jsonl`` a row a flight, and ``cases/`` the runs of the flights that show the answer: their
``scenario.toml`` flies as it is.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from cosim.api.call import WholeLine
from cosim.base.errors import FlightError, InputError
from cosim.base.storage.files import write_whole
from cosim.results.run import REPORT, SCENARIO
from cosim.studies import CASES, Campaign, Value, fly_again
from hexjet_prove.search.search import describe_flight


class Answer(Protocol):
    """Result of a search."""

    def to_json(self) -> dict[str, Any]:
        """Return the result as a table."""
        ...


A = TypeVar("A", bound=Answer)  # type of an answer


@dataclass(frozen=True)
class Case:
    """Flight that shows the result, flown again."""

    name: str  # name of its folder in cases/
    flight: int
    controller: str
    breaks: bool
    distance: float | None  # standard deviations from the middle
    values: Mapping[str, Value | None]
    seed: int
    outcome: str
    reason: str  # how the flight ended
    same: bool  # True: same result again, see ``again``
    again: str  # what is the same


@dataclass(frozen=True)
class SavedResult(Generic[A]):
    """A result, its folder, and the repeated flights that show it."""

    folder: Path
    result: A
    cases: tuple[Case, ...]
    referee: Mapping[str, Any]  # JSBSim's check of flights on arrays

    @property
    def confirmed(self) -> bool:
        """Whether all repeated flights had the same result."""
        return all(case.same for case in self.cases)

    def to_json(self) -> dict[str, Any]:
        """Return the table that the folder's JSON file holds."""
        cases = [asdict(case) for case in self.cases]
        return {"folder": str(self.folder), **self.result.to_json(), "cases": cases, "confirmed": self.confirmed}

    def lines(self) -> list[str]:
        """Return the result of each repeated flight, with the command that flies it."""
        lines = []
        for each in case_rows(self, self.folder / REPORT):
            case = each["case"]
            distance = "" if case.distance is None else f", {case.distance:.2f} standard deviations out"
            again = case.again if case.same else "NOT the same"
            line = f"{case.name}: flight {case.flight}{distance}; {case.reason}; flown again {again}"
            lines.append(WholeLine(f"{line}: hexjet fly {each['command']}") if each["report"] else line)
        return lines

    def write(self, name: str) -> None:
        """Write the folder's JSON file.  Raises FlightError."""
        text = json.dumps(self.to_json(), indent=1, allow_nan=False) + "\n"
        write_whole(self.folder / name, text, FlightError)


def fly_cases(campaign: Campaign, chosen: Iterable[tuple[str, int, bool, float | None]]) -> tuple[Case, ...]:
    """Fly flights again, recorded in ``cases/``, each given as (name, number, whether it fails, its distance)."""
    shutil.rmtree(campaign.folder / CASES, ignore_errors=True)  # left by an interrupted search
    return tuple(_fly_case(campaign, *case) for case in chosen)


def _fly_case(campaign: Campaign, name: str, number: int, breaks: bool, distance: float | None) -> Case:
    row, study = campaign.row(number), campaign.study
    values = {key: row[key] for key in study.drawn if row[key] is not None}
    outcome, reason, same, what = "failed", str(row["reason"]), True, ""
    try:
        again = fly_again(campaign, number, campaign.folder / CASES / name)
    except FlightError:  # it failed in the same way the first time
        same = row["outcome"] == "failed"
    except InputError as error:
        reason, same = str(error), False
    else:
        outcome, same, what = again.run.outcome, again.same, again.sameness
        reason = describe_flight(study, row) if same else f"{outcome}, {again.run.summary.reason}"
    seed = int(row["seed"] or 0)
    return Case(name, number, str(row["controller"]), breaks, distance, values, seed, outcome, reason, same, what)


def case_rows(answered: SavedResult[Any], page: Path) -> Iterator[dict[str, Any]]:
    """Yield each ``case`` with the link to its ``report``, or empty, and its scenario file."""
    for case in answered.cases:
        folder = answered.folder / CASES / case.name
        report = folder / REPORT
        link = Path(os.path.relpath(report, page.parent)).as_posix() if report.is_file() else ""
        yield {"case": case, "report": link, "command": shlex.quote((folder / SCENARIO).as_posix())}
