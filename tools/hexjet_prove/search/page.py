"""What a search found, in words and figures: for the terminal and the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import log10
from pathlib import Path
from typing import Any

from cosim.pages import GREEN, GREY, RED, Card, Page, closest, dotted, link, marked, run_colour, sentence
from cosim.spec.controller_name import short_name
from cosim.spec.scenario import Scenario, flown_parameters, list_changes
from cosim.studies import Value, referee_cards, with_referee
from hexjet_prove.search.question import SavedResult, case_rows
from hexjet_prove.search.search import Edge, SearchResult
from hexjet_prove.search.span import Span

Figure = dict[str, Any]

BOUNDARY_NOTE = (  # note on the figure
    "The first value that breaks; a triangle where it holds to the end of the range. Dotted: where the search starts."
)
ROW_PX = 44  # height of a row in the figure

COLUMNS = ("controller", "key", "at", "from", "holds to", "breaks at", "change", "then")  # table of boundaries


def write_page(searched: SavedResult[SearchResult], path: Path) -> None:
    """Write the page of a search.  Raises FlightError if the file cannot be written."""
    result = searched.result
    base, drawn = result.study.base(), figures(result)
    names, seeds = [short_name(name) for name in result.study.controller_names], result.plan.seeds
    facts = [("controller" if len(names) == 1 else "controllers", ", ".join(names))]
    facts += [("seed" if len(seeds) == 1 else "seeds", ", ".join(map(str, seeds)))]
    criterion = [sentence(line) for line in (result.criterion, result.engine_note) if line]
    fine = [f"{line}." for line in (*map(describe_resolution, result.plan.spans), *together_lines(result))]
    cards = [
        Card("The boundary", text=BOUNDARY_NOTE, figure="curve") if "curve" in drawn else None,
        *(Card(span.key.path, text="Green: holds; red: breaks; dotted: where the search starts.", figure=f"key{number}")
          for number, span in enumerate(result.plan.spans) if f"key{number}" in drawn),
        Card("Each key alone" if len(result.plan.spans) > 1 else "Where it breaks", *table(result), " ".join(fine)),
        cases_card("The flights that show it", searched, path),
    ]  # fmt: skip
    page = Page(
        "the smallest change that breaks",
        base.name if list_changes(base, flown_parameters(base)) else base.title or base.name,
        [*cards, *referee_cards(searched.referee)],
        drawn,
        answer=with_referee(answers(result), searched.referee),
        summary=criterion,
        facts=list_facts(base, result.flights, facts),
        are_figures_linked=False,
    )
    page.write(path)


def list_facts(base: Scenario, flights: int, more: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return the facts on flights for the page of a search or of rare failures."""
    named = [("scenario", base.name), ("aircraft", base.aircraft_name), ("engine", str(base.engine))]
    return [*named, *more, ("flights", f"{flights:,}")]


def cases_card(
    title: str,
    answered: SavedResult[Any],
    page: Path,
    columns: Sequence[str] = (),
    cells: Callable[[Any], Sequence[str]] = lambda case: (),
) -> Card | None:
    """Return the card of repeated flights with their pages; None if there are none.

    ``columns`` and ``cells``: what is said of a case besides.
    """
    rows, listed = [], list(case_rows(answered, page))
    for each in listed:
        case = each["case"]
        values = ", ".join(f"{key} = {text(value)}" for key, value in case.values.items())
        same = marked(case.again, "met") if case.same else marked("no", "unmet")
        rows.append((link(case.name, each["report"]), *cells(case), values, str(case.seed), case.reason, same))
    commands = [f"hexjet fly {each['command']}" for each in listed if each["report"]]
    titles = ("case", *columns, "values", "seed", "ending", "as in the search")
    note = "Flown again from their own scenario files, recorded in full."
    return Card(title, titles, rows, note, code="\n".join(commands)) if rows else None


def text(value: Value | None, unit: str = "") -> str:
    """Format a value with its unit, in at most six digits."""
    if value is None:
        return "-"
    digits = f"{value:.6g}" if isinstance(value, float) else str(value)
    return f"{digits} {unit}".strip()


def table(result: SearchResult) -> tuple[list[str], list[list[str]]]:
    """Return titles and rows of every edge, without columns that are the same in all of them."""
    over = result.plan.over
    titles = [over.key.path if title == "at" and over else title for title in COLUMNS]
    omitted = {1} if len(result.plan.spans) == 1 else set()
    omitted |= set() if over else {2}
    columns = [k for k in range(len(COLUMNS)) if k not in omitted]
    return [titles[k] for k in columns], [[_make_row(result, edge)[k] for k in columns] for edge in result.edges]


def _make_row(result: SearchResult, edge: Edge) -> tuple[str, ...]:
    """Return the cells of an edge, in the order of ``COLUMNS``."""
    over = result.plan.over
    level = text(edge.level, over.key.unit) if over else ""
    common = short_name(edge.controller), edge.key, level, text(edge.start, edge.unit)
    if edge.start_breaks:
        holds_to = "nowhere" if edge.holds is None else f"again at {text(edge.holds)}"
        return *common, holds_to, text(edge.breaks), "none", _describe_break(edge)
    if edge.breaks is None:
        return *common, f"{text(edge.end)}, the end", "-", "-", ""
    return *common, text(edge.holds), text(edge.breaks), _describe_change(edge), _describe_break(edge)


def answers(result: SearchResult, at_most: int = 4) -> list[str]:
    """Return a sentence for each of the first boundaries, ``at_most`` of them."""
    return [_describe_edge(result, edge) for edge in result.edges[:at_most]]


def _describe_edge(result: SearchResult, edge: Edge) -> str:
    """Describe a boundary in one sentence."""
    over = result.plan.over
    where = f", {over.key.path} {text(edge.level, over.key.unit)}" if over else ""
    subject = f"{short_name(edge.controller)}{where}: {edge.key}"
    if edge.start_breaks:
        again = "" if edge.holds is None else f", and holds again at {text(edge.holds, edge.unit)}"
        return f"{subject} breaks where it starts, at {text(edge.start, edge.unit)}{again}."
    if edge.breaks is None:
        return f"{subject} holds from {text(edge.start)} to the end, {text(edge.end, edge.unit)}."
    return (
        f"{subject} holds to {text(edge.holds)} and breaks at {text(edge.breaks, edge.unit)}: {_describe_break(edge)}."
    )


def _describe_change(edge: Edge) -> str:
    start, breaks = float(edge.start), float(edge.breaks or 0.0)
    if not start:
        return f"{breaks - start:+.4g}"
    percent = 100.0 * (breaks - start) / abs(start)
    relative = f"{percent:+.3g} %" if abs(percent) < 1000.0 else f"{breaks / start:.3g} times"
    return f"{breaks - start:+.4g} ({relative})"


def _describe_break(edge: Edge) -> str:
    some = f"{edge.broken} of {edge.flown}: " if edge.flown > 1 else ""
    back = "; holds again further out" if edge.comes_back and not edge.start_breaks else ""
    return f"{some}{edge.reason}{back}"


def describe_resolution(span: Span) -> str:
    """Describe the resolution of the search along a key."""
    unit = span.key.unit
    fine = "exactly" if span.key.kind == "int" and span.tolerance <= 1.0 else f"to {text(span.tolerance, unit)}"
    nominal = span.key.nominal
    outside = isinstance(nominal, int | float) and not span.low <= nominal <= span.high
    nearest = f", the end nearest to the scenario's {text(nominal)}," if outside else ""
    return (
        f"{span.key.path} from {text(span.value_at(0.0))}{nearest} within {text(span.low)} to {text(span.high, unit)}: "
        f"scanned in steps of {span.step_text}, the first change bisected {fine}; "
        "what lasts for less than a step may be missed"
    )


def together_lines(result: SearchResult) -> list[str]:
    """Return a line on the joint search of several keys, if there is one."""
    if len(result.plan.spans) == 1:
        return []
    return ["each key was searched alone; hexjet search --likely searches all of them together"]


def figures(result: SearchResult) -> dict[str, Figure]:
    """Return Plotly figures by name: ``curve``, or ``key0``, ``key1``, ..."""
    if result.plan.over:
        return {"curve": _make_boundary(result)}
    return {f"key{number}": _make_bands(result, span) for number, span in enumerate(result.plan.spans)}


def _make_bands(result: SearchResult, span: Span) -> Figure:
    """Return the figure of where each controller passes and fails along a key, one bar each."""
    data: list[Figure] = []
    edges = [edge for edge in result.edges if edge.key == span.key.path]
    for edge in edges:
        for first, last, breaks in edge.bands:
            data.append(_make_bar(short_name(edge.controller), float(first), float(last), RED if breaks else GREEN))
    names = list(dict.fromkeys(short_name(edge.controller) for edge in edges))
    layout = closest(110 + ROW_PX * len(names), has_legend=False)
    layout["annotations"] = [
        _make_label(short_name(edge.controller), float(edge.breaks), text(edge.breaks, edge.unit), span.logarithmic)
        for edge in edges
        if edge.breaks is not None and not edge.start_breaks
    ]
    layout["shapes"] = [dotted(GREY, x=span.start)]
    layout["xaxis"] = {"title": {"text": _axis_title(span)}, "type": "log" if span.logarithmic else "linear"}
    layout["yaxis"] = {"automargin": True, "type": "category", "range": [len(names) - 0.4, -0.6]}
    return {"data": data, "layout": layout}


def _make_bar(name: str, first: float, last: float, colour: str) -> Figure:
    does = "breaks" if colour == RED else "holds"
    return {
        "type": "scatter", "mode": "lines+markers", "x": [first, last], "y": [name, name],
        "line": {"color": colour, "width": 10}, "marker": {"color": colour, "size": 10, "symbol": "square"},
        "hovertemplate": f"{name}: {does} from {first:.6g} to {last:.6g}<extra></extra>",
    }  # fmt: skip


def _make_label(name: str, value: float, label: str, logarithmic: bool) -> Figure:
    x = log10(value) if logarithmic else value
    return {"x": x, "y": name, "text": label, "showarrow": False, "yshift": 15}


def _make_boundary(result: SearchResult) -> Figure:
    """Return the figure of the first key's edge over the second key, a line for each controller and side."""
    over, span = result.plan.over, result.plan.spans[0]
    assert over is not None
    data: list[Figure] = []
    for number, controller in enumerate(result.study.controller_names):
        for side in ("up", "down"):
            edges = [e for e in result.edges if e.controller == controller and e.side == side]
            if edges:
                name = short_name(controller)
                data += _make_branch(edges, run_colour(number), name, not any(d["name"] == name for d in data))
    layout = closest(460)
    layout["shapes"] = [dotted(GREY, y=span.start)]
    layout["xaxis"] = {"title": {"text": f"{over.key.path} [{over.key.unit or '1'}]"}}
    if over.key.kind in ("choice", "bool"):
        layout["xaxis"]["type"] = "category"
    layout["yaxis"] = {"title": {"text": _axis_title(span)}, "type": "log" if span.logarithmic else "linear"}
    return {"data": data, "layout": layout}


def _make_branch(edges: list[Edge], colour: str, name: str, first: bool) -> list[Figure]:
    broken = [e for e in edges if e.breaks is not None]
    common: Figure = {"type": "scatter", "name": name, "legendgroup": name}
    line = common | {
        "mode": "lines+markers",
        "showlegend": first,
        "x": [e.level for e in edges],
        "y": [None if e.breaks is None else float(e.breaks) for e in edges],
        "line": {"color": colour, "width": 2},
        "marker": {"color": colour, "size": 7},
        "text": [f"holds to {text(e.holds)}, breaks at {text(e.breaks)}" for e in edges],
        "hovertemplate": f"{name}, %{{x}}: %{{text}}<extra></extra>",
    }
    ends = [e for e in edges if e.breaks is None]
    free = common | {
        "mode": "markers",
        "showlegend": first and not broken,
        "x": [e.level for e in ends],
        "y": [float(e.end) for e in ends],
        "marker": {"color": colour, "size": 10, "symbol": f"triangle-{edges[0].side}-open"},
        "hovertemplate": f"{name}, %{{x}}: holds to the end, %{{y}}<extra></extra>",
    }
    return [line, free] if ends else [line]


def _axis_title(span: Span) -> str:
    return f"{span.key.path} [{span.key.unit or '1'}]"
