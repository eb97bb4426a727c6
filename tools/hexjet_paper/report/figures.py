"""The figures of the paper's report: what the paper draws, from both fidelities side by side, and what it does not.

Plain dicts of Plotly's figure schema, as in :mod:`cosim.results.report.time_plot`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import log10
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.loops import model_response
from cosim.pages import BLUE, GREEN, GREY, MAGENTA, ORANGE, RED, axis_name, layout, share
from hexjet_paper import numbers
from hexjet_paper.comparison import TITLES
from hexjet_paper.experiments import COMPARED, Result
from hexjet_paper.extensions import MAX_SENSITIVITY, RobustnessMap
from hexjet_paper.linear import STATE_AS_PRINTED
from hexjet_paper.loops import Sweep

if TYPE_CHECKING:
    from hexjet_paper.report.result import Reproduction

Figure = dict[str, Any]

COLOURS = {  # colour of each controller
    "baseline": ORANGE,
    "smith": BLUE,
    "filtered-smith": "#1098ad",
    "state": GREEN,
    STATE_AS_PRINTED: MAGENTA,
    "state-model": "#7048e8",
    "state-disturbance": "#a0522d",
}
NAMES = TITLES | {  # controllers' names
    "filtered-smith": "filtered Smith",
    "state-model": "state predictor, model-based observer",
    "state-disturbance": "state predictor with disturbance estimate",
}
LABELS = NAMES | {  # shorter names for narrow headings
    "state": "state predictor, G_n(z)",
    STATE_AS_PRINTED: "state predictor, as printed",
    "state-model": "state, model-based observer",
    "state-disturbance": "state, disturbance estimate",
}
FIDELITIES = ("linear plant", "six degrees of freedom")  # columns of figures
# Colour scale of peak sensitivities, from 1 to 4.
_SENSITIVITY_COLOURS = [[0.0, "#fff9db"], [0.25, "#8ce99a"], [0.55, "#1098ad"], [1.0, "#364fc7"]]
_UNSTABLE_COLOUR = "#c9a0a0"


class Curve(NamedTuple):
    """One curve of a panel."""

    name: str
    x: Sequence[float] | NDArray[np.float64]
    y: Sequence[float | None] | NDArray[np.float64]
    colour: str
    dash: str = "solid"
    width: float = 1.8
    mode: str = "lines"


class Panel(NamedTuple):
    """One pair of axes with its curves; ranges in Plotly's form, None for all values."""

    title: str
    x_title: str
    y_title: str
    curves: Sequence[Curve]
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    x_log: bool = False


def paper_figures(reproduction: Reproduction) -> dict[str, Figure]:
    """Return all figures of the page by their names in the template."""
    part = reproduction.linear
    both = (part.results, reproduction.flight_results)
    figures = {f"step-{n}": panels([_draw_pair(both, f"step-{n}", COMPARED, "angle", 30.0)]) for n in (5, 10, 25)}
    figures |= {
        f"disturbance-{n}": panels([_draw_pair(both, f"disturbance-{n}", COMPARED, "rate", 9.0)]) for n in (5, 10)
    }
    figures["identification"] = identification(reproduction)
    figures["bode"] = bode(part.sweeps, reproduction.flight_sweeps)
    figures |= {f"payload-{n}": _draw_payload(both, n) for n in (5, 10)}
    figures["disturbance-payload"] = panels(
        [_draw_pair(both, "disturbance-5-payload", ("smith", "state", STATE_AS_PRINTED), "rate", 9.0)]
    )
    for name in ("hexjet-doublet", "hexjet-doublet-calibrated"):
        figures[name] = panels([_draw_pair(both, name, ("baseline", "smith"), "angle", 30.0)])
    figures["manual"] = manual(reproduction)
    for vehicle in ("quadrotor", "hexjet"):
        figures[f"robustness-{vehicle}"] = robustness(
            [robustness_map for robustness_map in part.maps if robustness_map.vehicle == vehicle]
        )
    figures["delay"] = delays(reproduction)
    figures["offset"] = offsets(reproduction)
    figures["turbojet"] = turbojet(reproduction)
    return figures


def _draw_pair(
    both: Sequence[Mapping[str, Result]], experiment: str, controllers: Sequence[str], quantity: str, limit: float
) -> list[Panel]:
    """Return panels of one experiment in both fidelities on one scale, cut where an unstable loop would dominate."""
    drawn = []
    for results, title in zip(both, FIDELITIES, strict=True):
        present = {c: results[f"{experiment}.{c}"] for c in controllers if f"{experiment}.{c}" in results}
        curves = [_make_curve(result, quantity, NAMES[c], COLOURS[c]) for c, result in present.items()]
        if present and quantity == "angle":
            longest = max(present.values(), key=lambda result: len(result.time))  # a failed flight ends early
            curves.insert(0, Curve("set-point", longest.time, np.degrees(longest.setpoint), GREY, "dash", 1.3))
        drawn.append((title, curves))
    return [Panel(title, "time [s]", _axis_title(quantity), curves, y_range=(-limit, limit)) for title, curves in drawn]


def _axis_title(quantity: str) -> str:
    return "roll [deg]" if quantity == "angle" else "roll rate [rad/s]"


def _make_curve(result: Result, quantity: str, name: str, colour: str, dash: str = "solid") -> Curve:
    values = np.degrees(result.angle) if quantity == "angle" else np.array(result.rate)
    return Curve(name, result.time, values, colour, dash)


def _draw_payload(both: Sequence[Mapping[str, Result]], delay: int) -> Figure:
    """Draw a row for each predictor: its steps without and with payload."""
    rows = []
    for controller in ("smith", "state", STATE_AS_PRINTED):
        row = []
        for results, title in zip(both, FIDELITIES, strict=True):
            bare, loaded = (results.get(f"step-{delay}{load}.{controller}") for load in ("", "-payload"))
            curves = []
            if bare and loaded:
                curves = [
                    Curve("set-point", bare.time, np.degrees(bare.setpoint), GREY, "dash", 1.3),
                    _make_curve(bare, "angle", NAMES[controller], COLOURS[controller]),
                    _make_curve(loaded, "angle", "with payload", RED, "dot"),
                ]
            row.append(Panel(title, "time [s]", _axis_title("angle"), curves, y_range=(-30.0, 30.0)))
        rows.append(row)
    return panels(rows, panel_height=200)


def identification(reproduction: Reproduction) -> Figure:
    """Draw the swept responses of turbojet, EDF and roll rate beside the printed models."""
    value = numbers.value
    step, delay = value("hexjet.step"), value("hexjet.delay")
    hertz = np.geomspace(0.1, 10.0, 200)
    z = np.exp(2j * np.pi * hertz * step)
    late = z**-delay
    printed = {
        "turbojet": value("turbojet.gain") / (z - value("turbojet.pole")) * late,
        "edf": value("edf.gain") / (z - value("edf.pole")),
        "roll": model_response(numbers.roll_model(), z) * late,
    }
    titles = {"turbojet": "turbojet, kgf", "edf": "EDF, kgf", "roll": "Hex-Jet roll, rad/s"}
    ends = (log10(0.1), log10(10.0))
    rows: list[list[Panel]] = []
    for part, label in (("gain", "gain [dB]"), ("phase", "phase [deg]")):
        row = []
        for name, response in printed.items():
            curve = 20.0 * np.log10(np.abs(response)) if part == "gain" else np.degrees(np.unwrap(np.angle(response)))
            curves = [Curve("printed", hertz.tolist(), curve, GREY)]
            measured = reproduction.identified.responses.get(name)
            if measured:
                points = np.array(getattr(measured, part))
                if part == "phase":  # shift by turns to the printed branch
                    points += 360.0 * np.round((np.interp(measured.hertz[0], hertz, curve) - points[0]) / 360.0)
                curves.append(Curve("ours, swept", measured.hertz, points, BLUE, mode="markers"))
            row.append(Panel(titles[name], "frequency [Hz]", label, curves, x_range=ends, x_log=True))
        rows.append(row)
    return panels(rows)


def bode(linear: Mapping[str, Sweep], measured: Mapping[str, Sweep]) -> Figure:
    """Draw gain and phase of the measured open loops."""
    rows = []
    for part, title, limits in (("gain", "gain of C G* [dB]", (-18.0, 24.0)), ("phase", "phase [deg]", (-400.0, 0.0))):
        row = []
        for sweeps, name in zip((linear, measured), FIDELITIES, strict=True):
            curves = [Curve(NAMES[c], s.frequency, getattr(s, part), COLOURS[c]) for c, s in sweeps.items()]
            level = 0.0 if part == "gain" else -180.0
            curves.append(Curve("0 dB, -180 deg", [0.5, 20.0], [level, level], GREY, "dot", 1.2))
            ends = (log10(0.5), log10(20.0))
            row.append(Panel(name, "frequency [Hz]", title, curves, x_range=ends, y_range=limits, x_log=True))
        rows.append(row)
    return panels(rows)


def manual(reproduction: Reproduction) -> Figure:
    """Draw the manual flight: angles and rates of the three axes."""
    flight = reproduction.manual
    rows = []
    for axis in flight.angle:
        time = flight.time
        rows.append(
            [
                Panel("angle", "time [s]", f"{axis} [deg]", _make_tracking_curves(time, flight.angle[axis])),
                Panel("rate", "time [s]", f"{axis} rate [deg/s]", _make_tracking_curves(time, flight.rate[axis])),
            ]
        )
    return panels(rows, panel_height=180)


def _make_tracking_curves(time: Sequence[float], pair: tuple[Sequence[float], Sequence[float]]) -> list[Curve]:
    command, response = pair
    return [
        Curve("flown", time, np.degrees(response), BLUE, width=1.5),
        Curve("set-point", time, np.degrees(command), GREY, "dash", 1.3),
    ]


def robustness(maps: Sequence[RobustnessMap], columns: int = 3) -> Figure:
    """Draw peak sensitivity over delay and gain errors, with unstable cells and the limit MAX_SENSITIVITY."""
    rows = -(-len(maps) // columns)
    figure: Figure = {"data": [], "layout": _make_layout(rows * 265 + 60)}
    layout = figure["layout"] | {"hovermode": "closest", "showlegend": False, "annotations": []}
    for number, robustness_map in enumerate(maps):
        row, column = divmod(number, columns)
        x, y = axis_name("x", number), axis_name("y", number)
        layout[axis_name("xaxis", number)] = {
            "domain": share(column, columns, 0.05, from_top=False),
            "anchor": y,
            "title": {"text": "delay error [samples]", "standoff": 4},
        }
        height = share(row, rows, 0.3 / rows, from_top=True)
        layout[axis_name("yaxis", number)] = {
            "domain": height,
            "anchor": x,
            "type": "log",
            "tickvals": [0.25, 0.5, 1, 2, 4],
            **({"title": {"text": "gain error [times]"}} if column == 0 else {}),
        }
        layout["annotations"].append(
            _heading(f"{LABELS[robustness_map.controller]}: {100.0 * robustness_map.stable_share:.0f} % stable", x, y)
        )
        figure["data"] += _make_map_traces(robustness_map, x, y, number == 0)
    figure["layout"] = layout
    return figure


def _make_map_traces(robustness_map: RobustnessMap, x: str, y: str, with_scale: bool) -> list[Figure]:
    common = {"x": robustness_map.delay_errors, "y": robustness_map.gains, "xaxis": x, "yaxis": y}
    says = "delay %{x:+d} samples, gain x %{y:.3g}: "
    unstable = [[1 if cell is None else None for cell in row] for row in robustness_map.sensitivity]
    rounded = [[None if cell is None else round(cell, 4) for cell in row] for row in robustness_map.sensitivity]
    return [
        common
        | {
            "type": "heatmap",
            "z": rounded,
            "zmin": 1.0,
            "zmax": 4.0,
            "colorscale": _SENSITIVITY_COLOURS,
            "showscale": with_scale,
            "colorbar": {"title": {"text": "M_s"}, "thickness": 12, "len": 0.6, "y": 0.5},
            "hoverongaps": False,
            "hovertemplate": says + "M_s %{z:.2f}<extra></extra>",
        },
        common
        | {
            "type": "heatmap",
            "z": unstable,
            "colorscale": [[0.0, _UNSTABLE_COLOUR], [1.0, _UNSTABLE_COLOUR]],
            "showscale": False,
            "hoverongaps": False,
            "hovertemplate": says + "unstable<extra></extra>",
        },
        common
        | {
            "type": "contour",
            "z": rounded,
            "contours": {"coloring": "none", "start": MAX_SENSITIVITY, "end": MAX_SENSITIVITY, "size": 1.0},
            "line": {"color": "#000", "width": 1.4},
            "showscale": False,
            "hoverinfo": "skip",
        },
        {
            "type": "scatter",
            "x": [0],
            "y": [1.0],
            "xaxis": x,
            "yaxis": y,
            "mode": "markers",
            "marker": {"symbol": "x-thin", "size": 11, "line": {"width": 2, "color": "#000"}},
            "hovertemplate": "as modelled<extra></extra>",
        },
    ]


def delays(reproduction: Reproduction) -> Figure:
    """Draw tracking error and peak sensitivity over delay, as far as a loop is stable."""
    rows = []
    for quantity, title, limits in (("rmse", "RMSE [deg]", None), ("sensitivity", "peak sensitivity", (0.0, 8.0))):
        row = []
        for vehicle in ("quadrotor", "hexjet"):
            curves = []
            for (of, controller), points in reproduction.linear.delays.items():
                if of == vehicle:
                    values = [getattr(point, quantity) for point in points]
                    if quantity == "rmse":
                        values = [None if value is None else float(np.degrees(value)) for value in values]
                    x = [point.delay for point in points]
                    curves.append(Curve(NAMES[controller], x, values, COLOURS[controller], mode="lines+markers"))
            row.append(
                Panel({"hexjet": "Hex-Jet"}.get(vehicle, vehicle), "delay [samples]", title, curves, y_range=limits)
            )
        rows.append(row)
    return panels(rows)


def offsets(reproduction: Reproduction) -> Figure:
    """Draw roll after the onset of a constant disturbance, on the linear plant and in flight."""
    linear, in_flight = (
        [
            Curve(NAMES[offset.controller], offset.time, np.degrees(angle), COLOURS[offset.controller])
            for offset, angle in pairs
        ]
        for pairs in (
            [(offset, offset.angle) for offset in reproduction.linear.offsets],
            [(offset, offset.roll) for offset in reproduction.offsets],
        )
    )
    titles = ("linear plant: constant roll command", "six degrees of freedom: half a kilogram 1 cm to the right")
    return panels(
        [[Panel(title, "time [s]", "roll [deg]", c) for title, c in zip(titles, (linear, in_flight), strict=True)]],
        panel_height=300,
    )


def turbojet(reproduction: Reproduction) -> Figure:
    """Draw the attitude bandwidth that each controller reaches with delayed fans and with turbojets."""
    reaches = reproduction.linear.turbojet
    layout = _make_layout(330) | {"hovermode": "closest", "barmode": "group"}
    layout["yaxis"] = {"title": {"text": "attitude bandwidth [Hz]"}, "rangemode": "tozero"}
    layout["xaxis"] = {"tickangle": 0}
    layout["margin"]["b"] = 64  # two lines of text
    data = []
    for engine, colour in (("edf-as-flown", ORANGE), ("turbojet", BLUE)):
        of_engine = [reach for reach in reaches if reach.engine == engine]
        data.append(
            {
                "type": "bar",
                "name": engine,
                "x": [LABELS[reach.controller].replace(", ", ",<br>") for reach in of_engine],
                "y": [reach.bandwidth for reach in of_engine],
                "marker": {"color": colour},
                "hovertemplate": "%{x}: %{y:.3f} Hz<extra></extra>",
            }
        )
    return {"data": data, "layout": layout}


def panels(rows: Sequence[Sequence[Panel]], panel_height: int = 250) -> Figure:
    """Draw panels in rows and columns with one legend; panels without curves say that they were not flown."""
    layout = _make_layout(len(rows) * panel_height + 90) | {"annotations": []}
    data: list[Figure] = []
    labels: set[str] = set()
    columns = len(rows[0])
    for row, across in enumerate(rows):
        for column, panel in enumerate(across):
            number = row * columns + column
            x, y = axis_name("x", number), axis_name("y", number)
            last = row == len(rows) - 1
            layout[axis_name("xaxis", number)] = {
                "domain": share(column, columns, 0.08, from_top=False),
                "anchor": y,
                "type": "log" if panel.x_log else "linear",
                **({"title": {"text": panel.x_title}} if last else {"showticklabels": False}),
                **({"matches": "x"} if number else {}),
                **({"range": list(panel.x_range)} if panel.x_range else {}),
                **({"tickvals": [0.5, 1, 2, 5, 10, 20]} if panel.x_log else {}),
            }
            layout[axis_name("yaxis", number)] = {
                "domain": share(row, len(rows), 0.07, from_top=True),
                "anchor": x,
                "title": {"text": panel.y_title},
                **({"range": list(panel.y_range)} if panel.y_range else {}),
            }
            if row == 0:
                layout["annotations"].append(_heading(panel.title, x, y))
            if not panel.curves:
                layout["annotations"].append(_heading("not flown", x, y) | {"y": 0.5, "x": 0.5, "xanchor": "center"})
                data.append({"type": "scatter", "x": [None], "y": [None], "xaxis": x, "yaxis": y, "showlegend": False})
            for curve in panel.curves:
                data.append(_make_trace(curve, x, y) | {"showlegend": curve.name not in labels})
                labels.add(curve.name)
    return {"data": data, "layout": layout}


def _make_trace(curve: Curve, x: str, y: str) -> Figure:
    return {
        "type": "scatter",
        "mode": curve.mode,
        "name": curve.name,
        "legendgroup": curve.name,
        "x": _to_float32(curve.x),
        "y": _to_float32(curve.y),
        "xaxis": x,
        "yaxis": y,
        "line": {"color": curve.colour, "dash": curve.dash, "width": curve.width},
        "marker": {"size": 4},
        "hovertemplate": f"{curve.name}: %{{y:.4~g}}<extra></extra>",
    }


def _to_float32(values: Sequence[float | None] | NDArray[np.float64]) -> Any:
    """Return numbers as a compact array, NaN for gaps and for values beyond 1e9 of a loop that diverged."""
    array = np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    return np.where(np.abs(array) < 1e9, array, np.nan).astype(np.float32)


def _make_layout(height: int) -> Figure:
    # The legend stands above the panels' headings.
    legend = {"orientation": "h", "x": 0, "y": 1.0 + 22.0 / (height - 110), "yanchor": "bottom"}
    return layout(height, 60, 12, 66, 44, hovermode="x unified", legend=legend)


def _heading(text: str, x: str, y: str) -> Figure:
    """Return a heading at the upper left corner of the panel with these axes."""
    return {
        "text": f"<b>{text}</b>",
        "showarrow": False,
        **{"x": 0.0, "y": 1.0, "xref": f"{x} domain", "yref": f"{y} domain", "xanchor": "left", "yanchor": "bottom"},
    }
