"""The tables of failsafes: the file of every flight, with what flies it again, and the table of a vehicle."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import isnan, nan
from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.storage.files import map_os_errors
from cosim.base.storage.toml import toml_text
from cosim.control.autopilot.requests import to_dict
from cosim.results.autopilot.request_log import Entry
from cosim.spec.scenario import Scenario
from hexjet_prove.surveys.failsafe_flight import Row
from hexjet_prove.surveys.failsafes import Failsafes


def write(result: Failsafes, folder: Path) -> Path:
    """Write ``failsafes.csv``, and in ``flights/`` a scenario with its requests for every row, for ``hexjet fly``.

    Raises InputError if they cannot be written.
    """
    table = folder / "failsafes.csv"
    flights = folder / "flights"
    names = [field.name for field in fields(Row)]
    with map_os_errors(InputError, folder):
        flights.mkdir(parents=True, exist_ok=True)
        with open(table, "w", newline="", encoding="utf-8") as file:
            lines = csv.writer(file)
            lines.writerow([*names, "flight"])
            for flight in result.flights:
                name = file_name(flight.row)
                lines.writerow([*(getattr(flight.row, column) for column in names), f"flights/{name}.toml"])
                write_flight(flights, name, flight.scenario, flight.entries)
    return table


def write_flight(folder: Path, name: str, scenario: Scenario, entries: Sequence[Entry]) -> Path:
    """Write a scenario that ``hexjet fly`` flies again, and beside it the file of its requests.  Raises OSError."""
    requests = [{"step": entry.step, "sender": entry.sender} | to_dict(entry.request) for entry in entries]
    text = "".join(json.dumps(line, allow_nan=False) + "\n" for line in requests)
    (folder / f"{name}.jsonl").write_text(text, encoding="utf-8")
    table = scenario.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    table |= {"name": name, "requests": f"{name}.jsonl"}
    path = folder / f"{name}.toml"
    path.write_text(toml_text(table), encoding="utf-8")
    return path


def file_name(row: Row) -> str:
    """Return the name of the flight's files, without their suffix."""
    return (
        f"{row.failsafe.lower().replace(' ', '-')}-{row.height_m:g}m-{row.wind_m_s:g}m_s"
        + (f"-at-{row.speed_m_s:g}m_s" if row.speed_m_s else "")
        + (f"-{row.number}" if row.number else "")
    )


@dataclass(frozen=True)
class FailsafeSummary:
    """One failsafe in one wind and at one speed, all heights together."""

    failsafe: str
    wind_m_s: float
    speed_m_s: float
    ends: str  # distinct outcomes of the flights
    touchdown_m_s: float  # the fastest; NaN: none touched
    sideways_m_s: float
    thrust_n: float  # the most; NaN: none was disarmed


def summary(result: Failsafes) -> list[FailsafeSummary]:
    """Return the outcomes at all heights for each failsafe, wind and speed."""
    table = []
    for name, wind, speed in dict.fromkeys((row.failsafe, row.wind_m_s, row.speed_m_s) for row in result.rows):
        rows = [row for row in result.rows if (row.failsafe, row.wind_m_s, row.speed_m_s) == (name, wind, speed)]
        verdicts = [row.verdict for row in rows]
        distinct = dict.fromkeys(verdicts)
        if len(distinct) == 1:
            ends: str = verdicts[0]
        else:
            ends = ", ".join(
                f"{verdict} from {', '.join(f'{row.height_m:g}' for row in rows if row.verdict == verdict)} m"
                for verdict in distinct
            )
        worst = [_worst(rows, column) for column in ("touchdown_m_s", "sideways_m_s", "thrust_n")]
        table.append(FailsafeSummary(name, wind, speed, ends, *worst))
    return table


def grid(result: Failsafes) -> list[list[str]]:
    """Return the head and the lines of the table of flights after a take-off, several in a cell."""
    rows = sorted(result.rows, key=lambda row: (row.speed_m_s > 0.0, row.height_m))
    columns = list(dict.fromkeys(map(_column, rows)))
    cells: dict[tuple[str, str], list[Row]] = {}
    for row in result.rows:
        cells.setdefault((row.failsafe, _column(row)), []).append(row)

    def cell(name: str, column: str) -> str:
        flights = cells.get((name, column))
        return "-" if flights is None else format_cell(flights)

    names = dict.fromkeys(row.failsafe for row in result.rows)
    return [["failsafe", *columns], *([name, *(cell(name, column) for column in columns)] for name in names)]


def _column(row: Row) -> str:
    """Return the column's head for a flight whose wind is one of several in its cell."""
    return f"{row.height_m:g} m" + (f", moving at {row.speed_m_s:g} m/s" if row.speed_m_s else "")


def format_cell(rows: Sequence[Row]) -> str:
    """Return the cell of several flights of the page's table: how many ended how, and the worst numbers of all."""
    counts: dict[str, list[Row]] = {}
    for row in sorted(rows, key=lambda row: row.verdict not in ("landed", "holds")):
        counts.setdefault(row.verdict, []).append(row)
    ends = []
    for verdict, flights in counts.items():
        end = f"{len(flights)} of {len(rows)} {verdict}"
        if verdict not in ("landed", "holds", "refused"):
            end += f" (wind {' and '.join(f'{wind:g}' for wind in sorted({row.wind_m_s for row in flights}))} m/s)"
        ends.append(end)

    numbers = (
        (_worst(rows, "off_m"), "{:.2f} m off"),
        (_worst(rows, "touchdown_m_s"), "{:.2f} m/s"),
        (_worst(rows, "sideways_m_s"), "sideways {:.2f} m/s"),
        (_worst(rows, "drift_m") if rows[0].failsafe.startswith("GNSS") else nan, "{:.1f} m away"),
        (_worst(rows, "thrust_n"), "{:.1f} N"),
    )
    return ", ".join([*ends, *(form.format(value) for value, form in numbers if not isnan(value))])


def _worst(rows: Sequence[Row], column: str) -> float:
    """Return the largest of a column's numbers; NaN where there is none."""
    return max((value for row in rows if not isnan(value := getattr(row, column))), default=nan)
