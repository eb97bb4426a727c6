"""Several flights on one page: laid over each other, their metrics side by side, and what is different."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from cosim.base.signals import AXES
from cosim.results.comparison import ComparedFlight, LogComparison, Signal, list_input_differences, median_step
from cosim.results.events import list_events
from cosim.results.log.tables import TIME
from cosim.results.report.cards import Card, Page, code, coloured, link, marked
from cosim.results.report.flight import found_values, verdict, verdict_badge
from cosim.results.report.flight_figures import comparison_figures, subtract_first
from cosim.results.report.page import Flights
from cosim.results.report.plot import run_colour
from cosim.results.report.requirements import compared_margins
from cosim.results.report.signals_data import FlightData, describe_run, run_data
from cosim.results.run import REPORT, Run
from cosim.results.summary import Summary
from cosim.results.wording import DIGITS, NONE, display_unit, metric

STRIPS = (  # plots in order: name, title, caption
    ("first", "", ""),
    ("attitude", "", ""),
    (
        "difference",
        "Differences",
        "The first flight is the zero: true angles and height of the others less its own, and how far both are from "
        "each other, level.",
    ),
    ("rate", "Rates", "As the gyro gives them."),
    ("effort", "Control effort", "What the controllers asked for."),
    ("height", "Height", "Above the ground."),
    ("track", "Track", "Seen from above, both axes to one scale; from the open circle to the filled one."),
)
METRICS_NOTE = (
    "True angles against the set-point. Overshoot is stated in percent of each step, the worst step counts; settled is "
    "within 5 % of the step for good; – means that there is none. Where all fly the same "
    "scenario, the least is green among the flights that completed"
)


def write_comparison(
    flights: Sequence[ComparedFlight], compared: Sequence[LogComparison], path: Path, more: Sequence[Card] = ()
) -> None:
    """Write the page of flights that :func:`cosim.results.comparison.compare_with_first` compared.

    ``more``: cards that come first.  Raises FlightError if the file cannot be written.
    """
    summaries = [None if flight.run is None else flight.run.summary for flight in flights]
    with_run = [summary for summary in summaries if summary is not None]
    title, description = _headline(with_run)
    less = subtract_first(flights)
    strips = comparison_figures(flights, less)
    data = [flight_data(flight, number) for number, flight in enumerate(flights)]
    for number, log in less.items():
        label, times = f"{flights[number].label} less {flights[0].label}", log[TIME]
        step = median_step(times)
        even = bool(np.allclose(times, step * np.arange(times.size), rtol=0.0, atol=1e-6 * step))
        data.append(run_data(FlightData(log, label, run_colour(number), step_s=step, times=None if even else times)))
    colours = [run_colour(number) for number in range(len(flights))]
    named = [coloured(flight.label, colour) for flight, colour in zip(flights, colours, strict=True)]
    cards = [
        *more,
        *[Card(title, text=text, figure=name, is_half=name in ("first", "attitude", "height", "track"))
          for name, title, text in STRIPS if name in strips],
        _metrics_card(summaries, named),
        _requirements_card(summaries, named),
        *[card for number, pair in enumerate(compared, 1)
          for card in _pair_cards(pair, colours[number], inputs_between(flights[0], flights[number]))],
        Card("What flew", text=description, lines=[*filter(None, map(_describe_flight, flights))]),
    ]  # fmt: skip
    page = Page(
        "comparison",
        title,
        cards,
        answer=[_describe_outcome(flight, name, path) for flight, name in zip(flights, named, strict=True)],
        flights=Flights("comparison", data, strips),
    )
    page.write(path)


def _describe_outcome(flight: ComparedFlight, name: Markup, path: Path) -> Markup:
    """Return how a flight ended, with a link to its own page."""
    if flight.run is None:
        return Markup("{} a log without a run: it has no metrics.").format(name)
    badge, word = verdict_badge(flight.run.summary)
    own = link("full report", _report_link(flight.run, path)) if _report_link(flight.run, path) else ""
    return Markup(" ").join((name, marked(word, f"badge {badge}"), verdict(flight.run.summary), marked(own, "small")))


def _describe_flight(flight: ComparedFlight) -> str:
    """Return what flew, and the file that a log was read from."""
    parts = []
    if flight.run is not None:
        summary = flight.run.summary
        parts += [
            f"{summary.scenario}, {summary.aircraft}, engine {summary.engine_shown}, controller "
            f"{summary.controller_shown}, seed {summary.seed}"
        ]
    parts += [flight.source] if flight.source else []
    return f"{flight.label}: {'; '.join([*parts, *flight.remarks])}" if parts else ""


def _metrics_card(summaries: Sequence[Summary | None], named: Sequence[Markup]) -> Card | None:
    rows = comparison_rows(summaries)
    done = [name for name, each in zip(named, summaries, strict=True) if each and each.outcome == "completed"]
    few = Markup(": here {} alone did, so nothing is.").format(done[0]) if done else ": here none did."
    text = METRICS_NOTE + ("." if len(done) > 1 else few)
    cells = [[marked(cell["text"], "best") if cell["best"] else cell["text"] for cell in row["cells"]] for row in rows]
    listed = [(row["axis"], row["title"], *texts, row["unit"]) for row, texts in zip(rows, cells, strict=True)]
    return Card("Metrics", ("axis", "metric", *named, "unit"), listed, text) if rows else None


def _requirements_card(summaries: Sequence[Summary | None], named: Sequence[str]) -> Card | None:
    rows = [
        (row["name"], *(marked(text or NONE, kind) for text, kind in row["cells"]), code(row["formula"]))
        for row in compared_margins(summaries)
    ]
    return Card("Margins of requirements", ("requirement", *named, "formula"), rows) if rows else None


def _pair_cards(pair: LogComparison, colour: str, inputs: Sequence[tuple[str, str, str]]) -> Iterator[Card]:
    """Yield cards on what two flights have in common, and on inputs and signals that differ."""
    name = f"{pair.second} against {pair.first}"
    unlike = [signal_cells(signal) for signal in by_time(pair.signals)]
    alike = [signal.name for signal in pair.signals if signal.same]
    same = f"The same to the last bit: {', '.join(alike)}." if alike and unlike else ""
    yield Card(coloured(name, colour), text=same, lines=[" ".join(describe_pair(pair))])
    if inputs:
        yield Card(f"{name}: what went into both and differs", ("key", pair.first, pair.second), inputs)
    if unlike:
        text = (
            "By the first step on which they differ, in any bit. Largest and RMS of what "
            f"{pair.second} is less {pair.first}, over the steps on which both are numbers."
        )
        columns = ("signal", "first differs [s]", "largest", "at [s]", "RMS", "unit")
        yield Card(f"{name}: signals that differ", columns, unlike, text)


def _headline(summaries: Sequence[Summary]) -> tuple[str, str]:
    """Return a page's title and description: the flights' own where all have the same, else the scenario's name."""
    names, titles, stories = (
        {str(getattr(summary, key)).strip() for summary in summaries} for key in ("scenario", "title", "description")
    )
    if len(names) != 1:
        return "Comparison", ""
    title = titles.pop() if len(titles) == 1 else ""
    return title or names.pop(), stories.pop() if len(stories) == 1 and title else ""


def flight_data(flight: ComparedFlight, number: int) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the data of one of several flights for replay and strips, in its colour."""
    colour = run_colour(number)
    if flight.run is None:
        times = flight.log[TIME]
        return run_data(FlightData(flight.log, flight.label, colour, step_s=median_step(times), times=times))
    described = describe_run(flight.run, flight.label, colour, list_events(flight.run))
    return run_data(described._replace(log=flight.log))


def describe_pair(pair: LogComparison) -> list[str]:
    """Describe on which steps two flights were compared, and what is the same."""
    if not pair.steps:
        return [f"{pair.first} and {pair.second} have no time in common."]
    if pair.same:
        return [f"{pair.second} is the same as {pair.first} to the last bit: {pair.steps} steps, all columns."]
    alike = sum(signal.same for signal in pair.signals)
    sentences = [
        f"{pair.second} less {pair.first}, on the {pair.steps} steps of {pair.steps_of} "
        f"from {pair.begins_s:g} s to {pair.ends_s:g} s."
    ]
    if pair.held:
        sentences.append(f"The steps differ: values of {pair.held} are held until its next step.")
    sentences.append(f"{alike} of {len(pair.signals)} signals are the same to the last bit.")
    for whose, names in ((pair.first, pair.only_first), (pair.second, pair.only_second)):
        if names:
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            sentences.append(f"Only {whose} has {', '.join(names[:3])}{more}.")
    return sentences


def by_time(signals: Sequence[Signal]) -> list[Signal]:
    """Return the signals that differ, the earliest difference first."""
    unlike = [(signal.first_s, signal) for signal in signals if signal.first_s is not None]
    return [signal for _, signal in sorted(unlike, key=lambda pair: pair[0])]


def signal_cells(signal: Signal) -> tuple[str, str, str, str, str, str]:
    """Return a signal's name, first differing step [s], largest difference, its time [s], RMS and unit, as texts."""
    unit, factor = display_unit(signal.unit)
    numbers = [signal.largest, signal.rms]
    largest, rms = (NONE if value is None else f"{factor * value:.3g}" for value in numbers)
    times = (signal.first_s, signal.largest_s)
    first, at = (NONE if value is None else f"{value:.3f}" for value in times)
    return signal.name, first, largest, at, rms, unit


def inputs_between(first: ComparedFlight, second: ComparedFlight) -> list[tuple[str, str, str]]:
    """Return what differs between two flights' inputs; nothing where one is a log alone."""
    return [] if first.run is None or second.run is None else list_input_differences(first.run, second.run)


def comparison_rows(summaries: Sequence[Summary | None]) -> list[dict[str, Any]]:
    """Return the metrics of the commanded axes and of the whole flight, a row each; a summary of None has none.

    The least of a row among the flights that completed is marked where all fly the same scenario: of different ones it
    would say nothing.
    """
    with_run = [summary for summary in summaries if summary is not None]
    alike = len({summary.scenario for summary in with_run}) == 1
    judged = [alike and summary is not None and summary.outcome == "completed" for summary in summaries]
    commanded = {axis for summary in with_run for axis, metrics in summary.metrics.items() if metrics.commanded}
    found = [{} if summary is None else found_values(summary) for summary in summaries]
    flat = [{} if summary is None else summary.flat_metrics for summary in summaries]
    rows: list[dict[str, Any]] = []
    for name in dict.fromkeys([*DIGITS, *(name for texts in found for name in texts)]):
        of, axis, texts = metric(name), name.split(".")[0], [each.get(name, NONE) for each in found]
        if (axis in AXES and axis not in commanded) or set(texts) == {NONE}:
            continue
        title = of.label.removeprefix(f"{axis} ") if axis in AXES else of.label
        rows.append(
            {
                "axis": axis if axis in AXES else "whole flight",
                "title": title[0].upper() + title[1:],
                "unit": of.unit,
                "cells": _mark_least(texts, [each.get(name) for each in flat], judged),
            }
        )
    return rows


def _mark_least(texts: Sequence[str], values: Sequence[float | None], judged: Sequence[bool]) -> list[dict[str, Any]]:
    """Return the cells of a row, the least of the judged values marked unless all of them read the same."""
    cells = list(zip(texts, values, judged, strict=True))
    least = min((value for _, value, among in cells if among and value is not None), default=None)
    differ = len({text for text, _, among in cells if among}) > 1
    return [
        {"text": text, "best": differ and among and value is not None and value == least}
        for text, value, among in cells
    ]


def _report_link(run: Run, path: Path) -> str:
    """Return the relative path from a page to the run's own report, or an empty string."""
    if run.folder is None or not (run.folder / REPORT).is_file():
        return ""
    return Path(os.path.relpath(run.folder / REPORT, path.parent)).as_posix()
