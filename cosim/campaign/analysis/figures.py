"""The figures of a campaign's page: plain dicts of the figure schema that ``report/assets/figures.js`` draws.

As in :mod:`cosim.results.report.flight_figures` no library draws here.  Everything is counted over all flights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.campaign.analysis.sensitivity import Ranking
from cosim.campaign.analysis.statistics import Proportion, assign_classes, wilson
from cosim.campaign.analysis.summary import controller_indices
from cosim.campaign.analysis.table import KINDS, FlightTable, KeyColumn
from cosim.results.report.plot import ABOVE, GREEN, GREY, MAGENTA, ORANGE, RED, bars, layout, run_colour
from cosim.results.wording import Metric

Figure = dict[str, Any]

KIND_COLOURS = dict(zip(KINDS, (GREEN, ORANGE, RED, MAGENTA, GREY), strict=True))  # colour of each outcome
MAX_CURVES = 12  # most influential keys that get a curve


def campaign_figures(
    table: FlightTable,
    proportions: Sequence[Proportion],
    rankings: Mapping[str, Sequence[Ranking | None]],
    order: Sequence[int],
) -> dict[str, Figure]:
    """Return every figure of the report by its name; ``order`` are the keys by influence."""
    figures = {"outcomes": outcomes(table), "probability": probability(table, proportions)}
    figures |= {f"ranking-{name}": ranking_figure(table, ranking) for name, ranking in rankings.items() if any(ranking)}
    figures |= {f"key-{number}": success_over(table, table.keys[key]) for number, key in enumerate(order[:MAX_CURVES])}
    return figures | {f"metric-{number}": distribution(table, metric) for number, metric in enumerate(table.metrics)}


def outcomes(table: FlightTable) -> Figure:
    """Return the figure of how the flights of each controller ended, in percent of its flights."""
    counts = np.array(
        [
            np.bincount(table.kind[table.rows_of(controller)], minlength=len(KINDS))
            for controller in controller_indices(table)
        ]
    )
    of = np.maximum(counts.sum(axis=1), 1)
    data = [
        bars(
            name,
            table.controllers,
            round_digits(100.0 * counts[:, kind] / of),
            customdata=counts[:, kind].tolist(),
            marker={"color": KIND_COLOURS[name]},
            hovertemplate=f"%{{y}}: %{{customdata}} {name} (%{{x:.4~g}} %)<extra></extra>",
        )
        for kind, name in enumerate(KINDS)
        if counts[:, kind].any()
    ]
    layout = _layout_with_legend(_figure_height(table)) | {"barmode": "stack"}
    layout["legend"]["traceorder"] = "normal"
    layout["xaxis"] = {"title": {"text": "of the flights [%]"}, "range": [0.0, 100.0]}
    layout["yaxis"] = _names_axis()
    return {"data": data, "layout": layout}


def probability(table: FlightTable, proportions: Sequence[Proportion]) -> Figure:
    """Return the figure of each controller's fraction of successes; of draws with Wilson's and the exact interval."""
    flown = [
        (controller, proportion) for controller, proportion in enumerate(proportions) if proportion.value is not None
    ]
    data = []
    for controller, proportion in flown:
        low, high = proportion.wilson
        value = 100.0 * proportion.hits / proportion.of
        common: Figure = {"type": "scatter", "y": [table.controllers[controller]], "showlegend": False}
        colour = run_colour(controller)
        text = f"{table.controllers[controller]}: {value:.4g} %, {proportion.hits} of {proportion.of}"
        if not table.grid:
            ends = [100.0 * end for end in proportion.exact]
            line = {"x": ends, "y": common["y"] * 2, "mode": "lines", "line": {"color": colour, "width": 1}}
            data.append(common | line | {"hoverinfo": "skip"})
            line = {"x": [100.0 * low, 100.0 * high], "y": common["y"] * 2, "mode": "lines", "hoverinfo": "skip"}
            data.append(common | line | {"line": {"color": colour, "width": 5}, "opacity": 0.55})
            text += f"<br>95 %: {100.0 * low:.4g} to {100.0 * high:.4g} %"
        marker = {"color": colour, "size": 10}
        data.append(
            common | {"x": [value], "mode": "markers", "marker": marker, "hovertemplate": f"{text}<extra></extra>"}
        )
    layout = _layout_with_legend(_figure_height(table)) | {"showlegend": False}
    layout["xaxis"] = {"title": {"text": "success [%]"}, "range": _percent_range(table, proportions)}
    # A figure without flights has no points from which Plotly could make the axis.
    layout["yaxis"] = _names_axis() | {"categoryorder": "array", "categoryarray": table.controllers, "type": "category"}
    return {"data": data, "layout": layout}


def _percent_range(table: FlightTable, proportions: Sequence[Proportion]) -> list[float]:
    """Return the range of an axis in percent around all bounds, with a margin of at least a tenth of their span."""
    ends = [
        end
        for proportion in proportions
        if proportion.of
        for end in ((proportion.hits / proportion.of,) * 2 if table.grid else proportion.exact)
    ]
    low, high = 100.0 * min(ends, default=0.0), 100.0 * max(ends, default=1.0)
    margin = max(0.06 * (high - low), 0.5 * (10.0 - (high - low)), 0.5)
    return [max(low - margin, -1.0), min(high + margin, 101.0)]


def _figure_height(table: FlightTable) -> int:
    return 96 + 34 * len(table.controllers)


def ranking_figure(table: FlightTable, rankings: Sequence[Ranking | None]) -> Figure:
    """Return the figure of first-order indices, largest on top; the noise floor is shaded."""
    ranked = [(controller, ranking) for controller, ranking in enumerate(rankings) if ranking is not None]
    by_key = {controller: {effect.key: effect for effect in ranking.effects} for controller, ranking in ranked}
    labels = {key.path: wrap_label(key.label) for key in table.keys}
    largest = {path: max(effects[path].index for effects in by_key.values()) for path in labels}
    paths = sorted(labels, key=lambda path: largest[path])[-MAX_CURVES:]
    data = []
    for controller, _ in reversed(ranked):  # Plotly draws the last one on top
        effects = [by_key[controller][path] for path in paths]
        bar = bars(
            table.controllers[controller],
            [labels[path] for path in paths],
            [_to_percent(effect.index) for effect in effects],
            marker={"color": run_colour(controller), "opacity": [1.0 if effect.real else 0.3 for effect in effects]},
            hovertemplate=f"%{{y}}, {table.controllers[controller]}: %{{x:.1f}} %<extra></extra>",
        )
        if not table.grid:
            above = [max(0.0, _to_percent(effect.interval[1]) - _to_percent(effect.index)) for effect in effects]
            below = [max(0.0, _to_percent(effect.index) - _to_percent(effect.interval[0])) for effect in effects]
            bar["error_x"] = _make_error_bars(above, below, 3) | {"color": GREY}
        data.append(bar)
    floor = _to_percent(max(ranking.floor for _, ranking in ranked))
    layout = _layout_with_legend(96 + len(paths) * (16 + (14 if len(ranked) < 3 else 10) * len(ranked))) | {
        "barmode": "group",
        "bargap": 0.25,
    }
    layout["legend"]["traceorder"] = "reversed"
    layout["showlegend"] = len(ranked) > 1
    top = max(
        [*(_to_percent(effect.interval[1]) for effects in by_key.values() for effect in effects.values()), 2 * floor]
    )
    layout["xaxis"] = {
        "title": {"text": "of the variance [%]"},
        "range": [0.0, min(100.0, 1.06 * top)],
        "zeroline": True,
    }
    layout["yaxis"] = {"automargin": True, "ticksuffix": " "}
    layout["shapes"] = [_make_shaded_region(0.0, floor)]
    return {"data": data, "layout": layout}


def _to_percent(fraction: float) -> float:
    return round(100.0 * max(fraction, 0.0), 3)


def wrap_label(label: str, width: int = 24) -> str:
    """Return a label broken at its dots into lines of ``width`` characters, if its parts allow it."""
    lines = [""]
    for part in label.replace(".", ".\0").split("\0"):
        if lines[-1] and len(lines[-1]) + len(part) > width:
            lines.append("")
        lines[-1] += part
    return "<br>".join(lines)


def success_over(table: FlightTable, key: KeyColumn) -> Figure:
    """Return the figure of the success rate over one key, with 95 % intervals, all other keys as drawn."""
    data = []
    for controller in controller_indices(table):
        rows = table.rows_of(controller) & np.isfinite(key.numbers)
        count = int(np.sum(rows))
        if not count:
            continue
        values = key.numbers[rows]
        numbered = assign_classes(values, int(np.clip(count // 40, 4, 16)) if not table.grid else count)
        of, hits = np.bincount(numbered), np.bincount(numbered, table.success[rows])
        low, high = wilson(hits, of)
        fraction = hits / of
        middle = group_medians(numbered, values)
        name = table.controllers[controller]
        trace: Figure = {
            "type": "scatter",
            "name": name,
            "x": _offset_marks(middle, controller, table, key),
            "y": round_digits(100.0 * fraction),
            "mode": "markers" if key.levels else "lines+markers",
            "line": {"color": run_colour(controller), "width": 1.6},
            "marker": {"color": run_colour(controller), "size": 6},
            "customdata": [
                f"{_format_value(value, key)}: {int(k)} of {int(n)}"
                for value, k, n in zip(middle, hits, of, strict=True)
            ],
            "hovertemplate": f"{name}, %{{customdata}}, %{{y:.1f}} %<extra></extra>",
        }
        if not table.grid:
            above, below = round_digits(100.0 * (high - fraction)), round_digits(100.0 * (fraction - low))
            trace["error_y"] = _make_error_bars(above, below, 2)
        data.append(trace)
    layout = _layout_with_legend(270) | {"showlegend": False}
    layout["margin"] |= {"t": 30}
    layout["xaxis"] = key_axis(key)
    layout["yaxis"] = {"title": {"text": "success [%]"}, "range": [-3.0, 103.0]}
    return {"data": data, "layout": layout}


def group_medians(numbered: NDArray[np.integer[Any]], values: Array) -> Array:
    """Return the median of the values of each class, none of which is empty."""
    order = np.lexsort((values, numbered))
    counts = np.bincount(numbered)
    first = np.cumsum(counts) - counts
    ordered = values[order]
    return np.array(0.5 * (ordered[first + (counts - 1) // 2] + ordered[first + counts // 2]), dtype=np.float64)


def _offset_marks(middle: Array, controller: int, table: FlightTable, key: KeyColumn) -> list[float]:
    """Return how far a controller's marks are moved along the axis, so that controllers do not hide each other."""
    apart = controller - 0.5 * (len(table.controllers) - 1)
    if key.levels:
        return round_digits(middle + 0.12 * apart)
    low, high = np.nanmin(key.numbers), np.nanmax(key.numbers)
    if key.log:
        return round_digits(middle * (high / low) ** (0.005 * apart), 5)
    return round_digits(middle + 0.005 * (high - low) * apart, 5)


def _format_value(value: float, key: KeyColumn) -> str:
    return key.levels[round(value)] if key.levels else f"{value:.4g} {key.unit}".strip()


def key_axis(key: KeyColumn) -> Figure:
    """Return the axis of a key: linear, logarithmic, or the names of its choices."""
    axis: Figure = {"title": {"text": key.title}}
    if key.levels:
        span = [-0.5, len(key.levels) - 0.5]
        return axis | {
            "tickvals": list(range(len(key.levels))),
            "ticktext": key.levels,
            "range": span,
            "zeroline": False,
        }
    return axis | {"type": "log" if key.log else "linear", "zeroline": False}


def distribution(table: FlightTable, metric: Metric) -> Figure:
    """Return the figure of a metric's cumulative distribution, in percent of all flights.

    A curve ends below 100 % where flights have no value of the metric.
    """
    data = []
    largest: list[float] = []
    max_points = 160
    for controller in controller_indices(table):
        rows = table.rows_of(controller)
        values = np.sort(metric.factor * table.values[metric.name][rows])  # np.sort puts NaN last
        finite = values[np.isfinite(values)]
        if not finite.size:
            continue
        picked = np.unique(np.linspace(0, finite.size - 1, max_points).round().astype(np.intp))
        name = table.controllers[controller]
        largest.append(float(finite[-1]))
        data.append(
            {
                "type": "scatter",
                "mode": "lines" if finite.size > 1 else "markers",
                "name": name,
                "x": round_digits(finite[picked]),
                "y": round_digits(100.0 * (picked + 1) / values.size),
                "line": {"color": run_colour(controller), "width": 1.8, "shape": "hv"},
                "hovertemplate": f"{name}: %{{y:.1f}} % of the flights up to %{{x:.4~g}} {metric.unit}<extra></extra>",
            }
        )
    layout = _layout_with_legend(270) | {"showlegend": False}
    layout["margin"] |= {"t": 30}
    layout["xaxis"] = {"title": {"text": f"{metric.label} [{metric.unit}]"}, "zeroline": False} | _metric_axis(
        table, metric
    )
    layout["yaxis"] = {"title": {"text": "of all flights [%]"}, "range": [-3.0, 103.0]}
    return {"data": data, "layout": layout}


def _metric_axis(table: FlightTable, metric: Metric) -> Figure:
    """Return the axis of a metric, logarithmic for values that are spread over decades."""
    values = table.values[metric.name]
    finite = values[np.isfinite(values)]
    low, high = np.quantile(finite, [0.05, 0.95]) if finite.size else (0.0, 0.0)
    return {"type": "log", "dtick": 1} if finite.size and finite.min() > 0.0 and high > 30.0 * low else {}


def round_digits(values: Array, digits: int = 4) -> list[Any]:
    """Round to significant digits, with None for what is not a number."""
    return [float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in values.tolist()]


def _layout_with_legend(height: int) -> Figure:
    legend = {"orientation": "h", "xref": "paper", "yref": "paper", "x": 0, "y": 1, **ABOVE}
    return layout(height, 60, 14, 36, 52, hovermode="closest", legend=legend)


def _make_error_bars(above: Sequence[float], below: Sequence[float], width: int) -> Figure:
    return {"type": "data", "symmetric": False, "array": above, "arrayminus": below, "thickness": 1, "width": width}


def _names_axis() -> Figure:
    return {"automargin": True, "autorange": "reversed", "ticksuffix": " "}


def _make_shaded_region(start: float, end: float) -> Figure:
    return {
        "type": "rect",
        **{"xref": "x", "yref": "paper", "x0": start, "x1": end, "y0": 0, "y1": 1, "layer": "below"},
        "fillcolor": GREY,
        "opacity": 0.22,
        "line": {"width": 0},
    }
