"""Flights laid over each other, whoever flew them: what ``hexjet compare`` calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.api.call import Progress, Result, Table, check_types
from cosim.base.errors import InputError
from cosim.base.trust import without_code
from cosim.results.run import Run

if TYPE_CHECKING:
    from cosim.results.comparison import ComparedFlight, LogComparison, Signal

PAGE = "comparison.html"  # file name of the page
LABELS = "ABCDEFGH"  # one label per colour of a flight
DEFAULT_SIGNALS = ("roll_rad", "pitch_rad", "yaw_rad", "altitude_m", "north_m", "east_m", "collective")


class CompareResult(Result):
    """Comparison of two to eight flights: metrics side by side, every signal against the first flight's.

    Attributes
    ----------
    flights : tuple of ComparedFlight
        Each has ``label``, ``log`` and, where it is one of ours, ``run``.
    compared : tuple of LogComparison
        Each flight but the first against the first: its ``signals`` have the largest difference, and when.
    """

    short_tables = 1

    def __init__(
        self, flights: Sequence[ComparedFlight], compared: Sequence[LogComparison], signal: Sequence[str] = ()
    ) -> None:
        self.flights = tuple(flights)
        self.compared = tuple(compared)
        self._patterns = signal
        self.files = {}

    def write(self, page: Path | str) -> CompareResult:
        """Write the comparison's page and return this result with its path.

        Parameters
        ----------
        page : Path or str
            A name that ends in ``.html``, or the folder of ``comparison.html``.

        Raises
        ------
        InputError
            If it is there already, or its folder cannot be made.
        FlightError
            If it cannot be written.
        """
        from cosim.base.storage.files import map_os_errors
        from cosim.results.report.comparison import write_comparison

        path = page_path(Path(page))
        if path.exists():
            raise InputError(f"{path}: is there already; choose another name or remove it")
        with map_os_errors(InputError, path.parent):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_comparison(self.flights, self.compared, path)
        self.files = {"report": path}
        return self

    def to_dict(self) -> dict[str, Any]:
        from cosim.results.report.comparison import inputs_between

        runs = []
        for flight in self.flights:
            summary = None if flight.run is None else flight.run.summary
            identity = (
                {}
                if summary is None
                else {key: getattr(summary, key) for key in ("scenario", "aircraft", "engine", "controller", "seed")}
                | {key: getattr(summary, key) for key in ("outcome", "reason", "verdict", "step_s", "duration_s")}
                | {"metrics": summary.flat_metrics}
            )
            runs.append({"label": flight.label, "source": flight.source, "remarks": list(flight.remarks)} | identity)
        differences = [
            pair._asdict()
            | {"signals": {s.name: s._asdict() for s in pair.signals}}
            | {"inputs": {key: [first, second] for key, first, second in inputs_between(self.flights[0], flight)}}
            for pair, flight in zip(self.compared, self.flights[1:], strict=True)
        ]
        return {"runs": runs, "differences": differences, "page": None if self.report is None else str(self.report)}

    def lines(self) -> list[str]:
        """Return a line for each flight, for its difference from the first, and for each input that differs."""
        from cosim.results.report.comparison import describe_pair, inputs_between

        lines = [f"{flight.label[0]} {flight.source}: {describe_flight(flight)}" for flight in self.flights]
        max_inputs = 12  # lines printed per pair; the page has all
        for pair, flight in zip(self.compared, self.flights[1:], strict=True):
            lines.append(" ".join(describe_pair(pair)))
            inputs = inputs_between(self.flights[0], flight)
            # A hash says less than the settings that differ with it.
            inputs = [each for each in inputs if not each[0].startswith("sha256.")] or inputs
            lines += [f"  {key}: {one}; {flight.label[0]} {other}" for key, one, other in inputs[:max_inputs]]
            if len(inputs) > max_inputs:
                lines.append(f"  and {len(inputs) - max_inputs} inputs more that are not the same")
        return lines

    def tables(self) -> list[Table]:
        """Return the metrics side by side, and per pair of flights the signals chosen or the first that differ."""
        from cosim.results.report.comparison import comparison_rows, signal_cells

        rows = [
            (
                f"{row['axis']} {row['title']}" if row["axis"] != "whole flight" else row["title"],
                *(cell["text"] for cell in row["cells"]),
                row["unit"],
            )
            for row in comparison_rows([None if each.run is None else each.run.summary for each in self.flights])
        ]
        tables = [Table("", ("metric", *(flight.label[0] for flight in self.flights), "unit"), rows)] if rows else []
        for pair, flight in zip(self.compared, self.flights[1:], strict=True):
            cells = [
                (signal.name, "the same", "", "", "", "") if signal.same else signal_cells(signal)
                for signal in self._select_signals(pair)
            ]
            tables += [Table(flight.label, SIGNAL_TITLES, cells)] if cells and not pair.same else []
        return tables

    def _select_signals(self, pair: LogComparison) -> list[Signal]:
        """Return the signals for a pair's table: those of the patterns, else position and the first that differ."""
        from cosim.results.report.comparison import by_time

        if self._patterns:
            return [each for each in pair.signals if any(fnmatchcase(each.name, one) for one in self._patterns)]
        max_signals = 5  # further signals shown, first that differ
        names = dict.fromkeys([*DEFAULT_SIGNALS, *(signal.name for signal in by_time(pair.signals)[:max_signals])])
        found = {signal.name: signal for signal in pair.signals}
        return [found[name] for name in names if name in found]


SIGNAL_TITLES = ("signal", "first at, s", "largest", "at, s", "RMS", "unit")  # column heads of the signal table


@check_types()
def compare(
    *flights: str | Path | Run,
    flight: Sequence[int] = (),
    signal: Sequence[str] = (),
    shift: Mapping[str, float] | None = None,
    page: bool = True,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> CompareResult:
    """Lay two to eight flights over each other: metrics side by side, every signal against that of the first.

    >>> compare([fly("hover", settings={"duration_s": 0.2}, seed=seed) for seed in (1, 2)]).flights[1].run.outcome
    'completed'

    Parameters
    ----------
    *flights : str or Path or Run
        A run or its folder; ``DIR:N``, a flight of a campaign, which is flown again; a scenario, flown here and now; a
        table, CSV or Parquet; or a log of another flight controller.
    flight : sequence of int
        These flights of the campaigns among them; the same as ``DIR:N``.
    signal : sequence of str
        Patterns of the signals in the tables, such as ``thrust_*``; by default attitude, place, collective and the
        first that differ.
    shift : mapping or None
        Seconds that are added to the times of a flight, by its letter A, B, ...: of a log whose clock began elsewhere.
    page : bool
        Write the page, or none.
    out : str or Path or None
        The page or its folder; without it nothing is written.
    progress : Progress or None
        Hears notes.

    Returns
    -------
    CompareResult
        Metrics and differences.

    Raises
    ------
    InputError
        For what is no flight, and where the page is there already.
    """
    from cosim.results.comparison import compare_with_first

    hears = progress or Progress()
    flights = tuple(expand_campaigns(flights, flight))
    if not 2 <= len(flights) <= len(LABELS):
        raise InputError(
            f"compare: {len(flights)} flight{'s' if len(flights) != 1 else ''}; allowed: 2 to {len(LABELS)}"
        )
    out = out if page else None
    if out is not None and page_path(Path(out)).exists():
        raise InputError(f"{page_path(Path(out))}: is there already; choose another name or remove it")
    loaded = [_load_labelled_flight(letter, each, hears.note) for letter, each in zip(LABELS, flights, strict=False)]
    loaded = _shift_times(loaded, shift or {})
    result = CompareResult(loaded, compare_with_first(loaded), signal)
    for pattern in signal:
        if not any(fnmatchcase(each.name, pattern) for pair in result.compared for each in pair.signals):
            raise InputError(f"compare: signal: no signal that the flights share is called {pattern!r}")
    return result if out is None else result.write(out)


def page_path(out: Path) -> Path:
    """Return the page's path, given the page or its folder."""
    return out if out.suffix.lower() == ".html" and not out.is_dir() else out / PAGE


def write_page(names: Sequence[str], folder: Path) -> Path:
    """Write a page that compares recorded flights into a new folder, and return the page's path."""
    with without_code():
        page = compare(*names, out=folder).report
    assert page is not None
    return page


def expand_campaigns(names: Sequence[str | Path | Run], flights: Sequence[int]) -> list[str | Path | Run]:
    """Return the flights to compare; a campaign's folder is replaced by its ``flights``."""
    from cosim.campaign.folder import is_campaign

    requested: list[str | Path | Run] = []
    campaigns = [name for name in names if not isinstance(name, Run) and is_campaign(Path(name))]
    for name in names:
        if name not in campaigns:
            requested.append(name)
        elif not flights:
            raise InputError(f"{name}: is a campaign; say which flight: {name}:0, or flight 0")
        else:
            requested += [f"{str(name).rstrip('/')}:{number}" for number in flights]
    if flights and not campaigns:
        raise InputError("compare: flight: none of these is a campaign")
    return requested


def _load_labelled_flight(letter: str, flight: str | Path | Run, note: Callable[[str], None]) -> ComparedFlight:
    from cosim.campaign import fly_again, open_campaign
    from cosim.campaign.folder import is_campaign
    from cosim.flight import fly_watched as fly
    from cosim.results.comparison import ComparedFlight
    from cosim.results.log.readers import is_flight_log, read_flight_log
    from cosim.results.run import open_run, recover_killed_run
    from cosim.spec.scenario import Scenario, scenario_names

    if isinstance(flight, Run):
        where = str(flight.folder) if flight.folder is not None else flight.summary.scenario
        return ComparedFlight(f"{letter}: {Path(where).name}", flight.log, flight, where)
    name = str(flight)
    path = Path(name)
    label = f"{letter}: {path.name or path.absolute().name}"
    folder, _, number = name.rpartition(":")
    if folder and number.isdigit() and is_campaign(Path(folder)):
        repeated = fly_again(open_campaign(Path(folder)), int(number))
        if not repeated.same:
            note(f"{name}: {repeated.verdict}: {'; '.join(repeated.otherwise)}")
        return ComparedFlight(label, repeated.run.log, repeated.run, name, (f"flown again: {repeated.verdict}",))
    if path.is_dir():
        run = open_run(path)
        return ComparedFlight(label, run.log, run, name)
    if path.suffix.lower() == ".toml" or name in scenario_names():
        recover_killed_run(path)
        run = fly(Scenario.read(name, []))
        return ComparedFlight(label, run.log, run, name, ("flown for this comparison",))
    if path.suffix.lower() in (".csv", ".parquet") or is_flight_log(path):
        log, remarks = read_flight_log(path)
        return ComparedFlight(label, log, None, name, remarks)
    raise InputError(
        f"{name}: no flight; allowed: the folder of a run, CAMPAIGN:NUMBER, a scenario, a log "
        "(.csv, .parquet, ULog, DataFlash, Betaflight's blackbox, Crazyflie, .tlog)"
    )


def _shift_times(flights: Sequence[ComparedFlight], shifts: Mapping[str, float]) -> list[ComparedFlight]:
    """Shift the times of these flights.  Raises InputError for an unknown letter or an invalid number."""
    from cosim.results.comparison import shift_times

    moved = list(flights)
    for letter, by in shifts.items():
        index = LABELS.find(letter.strip().upper()) if letter.strip() else -1
        if not 0 <= index < len(moved) or not isfinite(by):
            allowed = ", ".join(LABELS[: len(moved)])
            raise InputError(f"compare: shift: {letter}={by:g}: is not one of {allowed} = a number of seconds")
        moved[index] = shift_times(moved[index], by)
    return moved


def describe_flight(flight: ComparedFlight) -> str:
    """Return a sentence on a flight: what flew, how it ended, and remarks on its log."""
    if flight.run is None:
        text = "a log"
    else:
        summary = flight.run.summary
        text = f"{summary.scenario}, {summary.aircraft}, {summary.engine_shown}, {summary.controller_shown}, "
        text += summary.ending
    return "; ".join([text, *flight.remarks])
