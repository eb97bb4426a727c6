"""Whether a vehicle breaks at a point: flown with every seed, by any workers, and never twice."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path

from cosim.base.errors import FlightError
from cosim.base.storage.files import map_os_errors, one_line, open_without_links, parse_json
from cosim.studies import EngineDraw, Flight, Row, Study, Value, Workers

Rows = dict[tuple["Point", int], Row]


@dataclass(frozen=True)
class Point:
    """A controller, and the values that are written over the scenario."""

    controller: str
    values: tuple[tuple[str, Value], ...]

    @classmethod
    def of(cls, controller: str, values: Mapping[str, Value]) -> Point:
        """Return the point of these values, which is the same in any order of them."""
        return cls(controller, tuple(sorted(values.items())))


@dataclass(frozen=True)
class PointResult:
    """The outcome of a point's flights."""

    broken: int
    flights: int
    breaks: bool
    worst: Row  # row of the first seed that broke, or else of the first seed


def count_needed(fraction: float, flights: int) -> int:
    """Return how many of a point's flights have to break before it does."""
    return max(1, ceil(fraction * flights - 1e-9))


class FlownRows:
    """The rows of what was asked for: each flown once, by any workers, and written to a journal as it comes."""

    def __init__(
        self, study: Study, workers: Workers, journal: Journal | None, progress: Callable[[int], None]
    ) -> None:
        self._study, self._workers, self._journal, self._progress = study, workers, journal, progress
        self.rows: Rows = journal.read() if journal else {}

    def fly(self, keys: Sequence[tuple[Point, int]], flight: Callable[[Point, int, int], Flight]) -> None:
        """Fly those that have no row yet; ``flight`` makes one of a point, a seed and a number.

        Raises FlightError if a flight cannot be flown.
        """
        missing = list(dict.fromkeys(key for key in keys if key not in self.rows))
        numbered = dict(enumerate(missing, len(self.rows)))
        flights = [flight(*key, number) for number, key in numbered.items()]
        for row in self._workers.fly(self._study, flights):
            key = numbered.pop(int(row["flight"] or 0))
            self.rows[key] = row
            if self._journal:
                self._journal.add(*key, row)
            self._progress(len(self.rows))
        if numbered:
            raise FlightError(f"{len(numbered)} flights were not flown")


class Prober:
    """Flies points with every seed.

    A point breaks if at least ``fraction`` of its flights do, and one in any case: where the flight does not end
    ``completed``, or misses what the study asks for.
    """

    def __init__(
        self,
        study: Study,
        seeds: Sequence[int],
        fraction: float,
        workers: Workers,
        journal: Journal | None = None,
        progress: Callable[[int], None] = lambda count: None,
        engine: EngineDraw | None = None,
    ) -> None:
        self._engine = engine
        self.study = study
        self.seeds = tuple(seeds)
        self.needed = count_needed(fraction, len(self.seeds))
        self._flown = FlownRows(study, workers, journal, progress)
        self._requests: dict[tuple[Point, int], None] = {}  # keys are in the order of the requests

    @property
    def flights(self) -> int:
        """How many flights were asked for."""
        return len(self._requests)

    def evaluate(self, points: Sequence[Point]) -> list[bool]:
        """Return whether each point breaks."""
        self._fly(points)
        return [self.result(point).breaks for point in points]

    def result(self, point: Point) -> PointResult:
        """Return the outcome of a point that was flown."""
        rows = [self._flown.rows[point, seed] for seed in self.seeds]
        broken = [row for row in rows if not row["success"]]
        return PointResult(len(broken), len(rows), len(broken) >= self.needed, (broken or rows)[0])

    def row(self, point: Point, seed: int) -> Row:
        """Return the row of a flown point with a seed."""
        return self._flown.rows[point, seed]

    def flight(self, point: Point, seed: int, number: int = 0) -> Flight:
        """Return the flight of a point with a seed; all but the first seed bring a draw of an uncertain engine."""
        drawn = self._engine if seed != self.seeds[0] else None
        engine = {} if drawn is None else drawn.named(str(seed))
        return Flight(number, number // len(self.seeds), point.controller, seed, engine | dict(point.values))

    def _fly(self, points: Sequence[Point]) -> None:
        new = [(p, seed) for p in dict.fromkeys(points) for seed in self.seeds if (p, seed) not in self._requests]
        self._requests.update(dict.fromkeys(new))
        self._flown.fly(new, self.flight)


class Journal:
    """Rows in a file, a line each as they come; what a killed search has flown is read back."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self) -> Rows:
        """Read every whole row and cut off a torn last line.  Raises FlightError if the file cannot be read."""
        rows: Rows = {}
        try:
            if not self.path.exists():
                return rows
            with open(self.path, "rb+", opener=open_without_links) as file:
                while line := file.readline():
                    if not line.endswith(b"\n"):
                        file.truncate(file.tell() - len(line))
                        break
                    entry = parse_json(line, "", finite=False)
                    rows[Point.of(entry["controller"], entry["values"]), entry["seed"]] = entry["row"]
        except OSError as error:
            raise FlightError(f"{self.path}: {one_line(error)}") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FlightError(f"{self.path}: line {len(rows) + 1} is not a flight of a search") from error
        return rows

    def add(self, point: Point, seed: int, row: Row) -> None:
        """Write one row.  Raises FlightError if that fails."""
        line = {"controller": point.controller, "seed": seed, "values": dict(point.values), "row": row}
        with (
            map_os_errors(FlightError, self.path),
            open(self.path, "a", encoding="utf-8", opener=open_without_links) as file,
        ):
            file.write(json.dumps(line) + "\n")
