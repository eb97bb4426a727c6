"""What the pages of flights show at first: strips of one flight, and the figures of several laid over each other.

Strips are drawn by ``assets/strips.js`` in the page, figures (dicts of Plotly's schema) by Plotly in notebooks.  Angles
are shown in degrees, everything else in SI.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil, pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.protocols import Column
from cosim.base.signals import AXES, JETS
from cosim.results.comparison import ComparedFlight, base_of, difference, step_of
from cosim.results.log.columns import RATES, jets_in, known, own_columns, servos_in, surfaces_in
from cosim.results.log.recorder import Log, MemoryLog
from cosim.results.log.tables import TIME
from cosim.results.report.page import drawn
from cosim.results.report.plot import (
    ABOVE,
    BLUE,
    GREEN,
    GREY,
    MAGENTA,
    ORANGE,
    RED,
    Figure,
    axis_name,
    layout,
    run_colour,
    share,
)
from cosim.results.run import Run
from cosim.results.summary import Summary

MOST_POINTS = 4000  # per trace; more cannot be seen and makes the page slow
MOST_SHADES = 30  # per figure
PANEL_PX = 165
DEG = 180.0 / pi

_DASHES = ("solid", "dash", "dot", "dashdot")  # of several runs in one plot
AT_REST = "thrust_{}_at_rest_N"
JET_ROWS = ((3, 1), (6, 5), (2, 4))  # front to back, left and right: the Hex-Jet's numbering


class Trace(NamedTuple):
    """One column drawn in a panel."""

    column: str
    label: str
    colour: str = BLUE
    dash: str = "solid"
    width: float = 1.8
    held: bool = False  # drawn as a staircase: what is asked for is held over a control step
    only_if_moving: bool = False  # left out where it is 0 throughout


class Panel(NamedTuple):
    """One pair of axes; columns times ``scale`` come to ``unit``."""

    title: str
    unit: str
    traces: Sequence[Trace]
    scale: float = 1.0
    least_span: float = 0.0  # so that the noise around a constant does not fill the panel


def _setpoint(column: str) -> Trace:
    return Trace(column, "set-point", GREY, "dash", 1.5, held=True)


def _followed(name: str, si: str, unit: str, scale: float, least_span: float) -> Panel:
    """Return the panel of a quantity and its set-point: measured, true, and asked for; its columns end with ``si``."""
    traces = [
        Trace(f"{name}_measured_{si}", "measured", ORANGE, width=1.2),
        Trace(f"{name}_{si}", "true", BLUE),
        _setpoint(f"{name}_setpoint_{si}"),
    ]
    return Panel(name.capitalize(), unit, traces, scale, least_span)


def _asked(column: str, label: str) -> Trace:
    """Return the trace of a demand of a controller: noisy, so a thin line behind the others."""
    return Trace(column, label, GREY, width=1.1, held=True)


def _effort(name: str) -> list[Trace]:
    return [
        Trace(f"torque_{name}", "asked for", BLUE, width=1.5, held=True),
        Trace(f"disturbance_torque_{name}", "disturbance", MAGENTA, "dot", held=True, only_if_moving=True),
        Trace(f"refused_{name}", "refused", RED, held=True, only_if_moving=True),
    ]


def _vector(pattern: str, names: tuple[str, str, str]) -> list[Trace]:
    return [
        Trace(pattern.format(name), name, colour) for name, colour in zip(names, (BLUE, ORANGE, GREEN), strict=True)
    ]


ATTITUDE = [_followed(axis, "rad", "deg", DEG, 4.0) for axis in AXES]
RATE = [
    Panel(
        f"{axis.capitalize()} rate",
        "deg/s",
        [
            _asked(f"rate_{rate}_setpoint_rad_s", "set-point"),
            Trace(f"rate_{rate}_measured_rad_s", "measured", ORANGE, width=1.5),
            Trace(f"rate_{rate}_predicted_rad_s", "predicted", BLUE, width=1.5),
        ],
        DEG,
        least_span=10.0,
    )
    for axis, rate in zip(AXES, RATES, strict=True)
]


def _tilt(log: Log) -> list[Panel]:
    """Return the panels of servos: banks and hinges, and surfaces."""
    angles = [
        Panel(
            f"{name.capitalize().replace('_', ' ')} servo",
            "deg",
            [_asked(f"tilt_{name}_command_rad", "commanded"), Trace(f"tilt_{name}_rad", "actual", width=1.4)],
            DEG,
            least_span=4.0,
        )
        for name in servos_in(log.columns)
    ]
    return angles + [
        Panel(
            name.capitalize().replace("_", " "),
            "deflection",
            [_asked(f"deflection_{name}_command", "commanded"), Trace(f"deflection_{name}", "actual", width=1.4)],
            least_span=0.1,
        )
        for name in surfaces_in(log.columns)
    ]


def _efforts(log: Log) -> list[Panel]:
    """Return the panels of what the loops ask for, in the units of the vehicle's allocation."""
    if not any(column.name == "torque_roll" and column.unit == "rad/s^2" for column in log.described):
        return EFFORT
    return [EFFORT[0], *(Panel(axis.capitalize(), "rad/s²", _effort(axis), least_span=0.5) for axis in AXES)]


EFFORT = [
    Panel(
        "Collective",
        "throttle",
        [
            Trace("collective", "asked for", BLUE, width=1.5, held=True),
            Trace("refused_collective", "refused", RED, held=True, only_if_moving=True),
        ],
        least_span=0.2,
    ),
    Panel("Roll", "throttle", _effort("roll"), least_span=0.05),
    Panel("Pitch", "deg of tilt", _effort("pitch"), DEG, least_span=2.0),
    Panel("Yaw", "deg of tilt", _effort("yaw"), DEG, least_span=2.0),
]
HEIGHT = [
    _followed("altitude", "m", "m", 1.0, 2.0),
    Panel("Climb rate", "m/s", [Trace("velocity_down_m_s", "true", BLUE)], scale=-1.0, least_span=1.0),
]
PLACE = [_followed(name, "m", "m", 1.0, 2.0) for name in ("north", "east")]
OUTSIDE = [  # a panel is left out where it is 0 throughout
    Panel("Force", "N", _vector("disturbance_force_{}_N", ("x", "y", "z"))),
    Panel("Moment", "N m", _vector("disturbance_moment_{}_N_m", ("x", "y", "z"))),
    Panel("Wind", "m/s", _vector("wind_{}_m_s", ("north", "east", "down"))),
    Panel("Payload", "kg", [Trace("payload_kg", "mass", held=True)]),
]
# of a flight less another: less_the_first()
_LESS = "_less"
LESS_NAMES = (*(f"{axis}_rad{_LESS}" for axis in AXES), f"altitude_m{_LESS}", "apart_m")
LESS_COLUMNS = (
    *(
        Column(name, name.split("_")[1], "", f"{name.removesuffix(_LESS)} less the first flight's")
        for name in LESS_NAMES[:-1]
    ),
    Column("apart_m", "m", "", "distance from the first flight, level"),
)
LESS = (
    *(Panel(axis.capitalize(), "deg", [Trace(name, axis)], DEG) for axis, name in zip(AXES, LESS_NAMES, strict=False)),
    Panel("Altitude", "m", [Trace(LESS_NAMES[-2], "altitude")]),
    Panel("Apart, level", "m", [Trace(LESS_NAMES[-1], "apart")]),
)
_UPSETS = (
    *(f"disturbance_force_{x}_N" for x in "xyz"),
    *(f"disturbance_moment_{x}_N_m" for x in "xyz"),
    *(f"disturbance_torque_{axis}" for axis in AXES),
    "payload_kg",
)


ENGINES = (  # a panel is left out where no engine says anything
    ("Spool speed", "rpm", "spool_speed_{}_rad_s", 30.0 / pi),
    ("Exhaust temperature", "K", "exhaust_temperature_{}_K", 1.0),
    ("Fuel flow", "g/s", "fuel_flow_{}_kg_s", 1e3),
)
SPOOLS = Panel("Moment of the spools", "N m", _vector("spool_moment_{}_N_m", ("x", "y", "z")))
TANK = Panel("Fuel on board", "kg", [Trace("fuel_kg", "fuel", BLUE)])


def run_figures(log: Log, summary: Summary) -> dict[str, Figure]:
    """Return the strips of one run that its page shows at first, by their figure's name: panels and their signals.

    ``shared``: one scale for all panels.  ``equal``: cross-plots with both axes to one scale, east and north.
    """
    reader = Reader(log, summary.step_s)
    east_north = [Trace("east_m", "east", BLUE), Trace("north_m", "north", BLUE)]
    figures = {
        "attitude": strips(reader, ATTITUDE),
        "rate": strips(reader, RATE),
        "thrust": strips(reader, thrust_panels(summary)) | {"shared": True},
        "tilt": strips(reader, _tilt(log)),
        "effort": strips(reader, _efforts(log)),
        "height": strips(reader, HEIGHT),
        "track": strips(reader, [Panel("Track", "m", east_north)]) | {"equal": True},
    }
    if any(reader.known(trace.column) for panel in PLACE for trace in panel.traces if trace.label == "set-point"):
        figures["place"] = strips(reader, PLACE)
    outside = [panel for panel in OUTSIDE if any(reader.moves(trace.column) for trace in panel.traces)]
    if outside:
        figures["outside"] = strips(reader, outside)
    own = [column for column in own_columns(log.described) if reader.known(column.name)]
    if own:
        figures["own"] = strips(
            reader, [Panel(column.name, column.unit, [Trace(column.name, column.name)]) for column in own]
        )
    inside = engine_panels(reader)
    if inside:
        figures["engines"] = strips(reader, inside)
    return figures


def strips(reader: Reader, panels: Sequence[Panel]) -> Figure:
    """Return panels as ``assets/strips.js`` draws them, without signals that never move where their trace says so."""
    return {
        "panels": [
            _strip(
                panel, [(0, trace) for trace in panel.traces if not trace.only_if_moving or reader.moves(trace.column)]
            )
            for panel in panels
        ]
    }


def _strip(panel: Panel, traces: Sequence[tuple[int, Trace]]) -> dict[str, Any]:
    """Return a panel with these traces, each of the run of that number."""
    return {
        "title": panel.title,
        "unit": panel.unit,
        "least": panel.least_span,
        "signals": [
            {
                "run": run,
                "column": trace.column,
                "label": trace.label,
                "colour": trace.colour,
                "dash": trace.dash,
                "width": trace.width,
                "held": trace.held,
                "scale": panel.scale,
                "shown": panel.unit,
            }
            for run, trace in traces
        ],
    }


def engine_panels(reader: Reader) -> list[Panel]:
    """Return the panels of engine reports other than thrust, spools' moment and tank, where there are any."""
    panels = []
    jets = range(1, jets_in(reader.log.columns) + 1)
    for title, unit, pattern, scale in ENGINES:
        traces = [Trace(pattern.format(jet), f"jet {jet}", run_colour(jet - 1), width=1.4) for jet in jets]
        known = [trace for trace in traces if reader.known(trace.column)]
        if known:
            panels.append(Panel(title, unit, known, scale))
    healths = [Trace(f"health_{jet}", f"jet {jet}", run_colour(jet - 1), width=1.4) for jet in jets]
    given_up = [trace for trace in healths if reader.known(trace.column) and np.nanmin(reader.log[trace.column]) < 1.0]
    if given_up:
        panels.append(Panel("Health, as monitored", "1", given_up, least_span=1.2))
    return panels + [panel for panel in (SPOOLS, TANK) if reader.known(panel.traces[0].column)]


def comparison_figures(flights: Sequence[ComparedFlight], less: Mapping[int, Log]) -> dict[str, Figure]:
    """Return the strips of several flights: attitudes, rates, efforts, heights and tracks, each over the others.

    What each is less the first is among them.  Figures of columns that no log has are left out.

    ``less``: by the number of a flight its :func:`less_the_first`, on the page as runs after the flights, in order.
    """
    readers = [Reader.of(flight) for flight in flights]
    labels = [flight.label for flight in flights]
    chosen = {"attitude": (ATTITUDE, "true"), "rate": (RATE, "measured"), "effort": (EFFORT, "asked for")}
    figures: dict[str, list[tuple[Panel, list[tuple[int, Trace]]]]] = {
        name: over(readers, labels, panels, which) for name, (panels, which) in chosen.items()
    }
    figures["height"] = over(readers, labels, HEIGHT, "true")
    figures["difference"] = []
    for panel in LESS:
        name = panel.traces[0].column
        found = [
            (len(flights) + n, Trace(name, labels[number], run_colour(number), width=1.4))
            for n, (number, log) in enumerate(less.items())
            if name in log.columns
        ]
        if found:
            figures["difference"].append((panel, found))
    placed = [n for n, flight in enumerate(flights) if {"north_m", "east_m"} <= set(flight.log.columns)]
    track = [(n, Trace(f"{way}_m", f"{labels[n]}, {way}", run_colour(n))) for n in placed for way in ("east", "north")]
    figures["track"] = [(Panel("Track", "m", []), track)] if track else []
    told: dict[str, Figure] = {
        name: {"panels": [_strip(panel, traces) for panel, traces in panels]}
        for name, panels in figures.items()
        if panels
    }
    if "track" in told:
        told["track"]["equal"] = True
    return told


def less_the_first(flights: Sequence[ComparedFlight]) -> dict[int, MemoryLog]:
    """Return the differences of each further flight from the first, by its number.

    They are of true attitude [rad], height [m] and level distance [m], at the times that both flights have; as far as
    both have the columns.
    """
    first, differences = flights[0].log, {}
    level = ("north_m", "east_m")
    wanted = [((name.removesuffix(_LESS),), name) for name in LESS_NAMES[:-1]] + [(level, LESS_NAMES[-1])]
    for number, flight in enumerate(flights[1:], 1):
        base = base_of(first, flight.log)
        common = {*first.columns} & {*flight.log.columns}
        columns = {TIME: base.times}
        for names, name in wanted:
            if common.issuperset(names):
                apart = [difference(first, flight.log, one, base) for one in names]
                columns[name] = apart[0] if len(apart) == 1 else np.hypot(*apart)
        if base.times.size > 1 and len(columns) > 1:
            differences[number] = MemoryLog([np.stack(list(columns.values()))], tuple(columns), LESS_COLUMNS)
    return differences


def plot(runs: Run | Sequence[Run], *columns: str) -> Any:
    """Plot columns of a run, or of several, over time.

    Parameters
    ----------
    runs : Run or sequence of Run
        Whose logs are drawn over each other.
    *columns : str
        Their names; those of one unit share a panel, in SI units.  The attitude in degrees where none is named.

    Returns
    -------
    plotly.graph_objects.Figure
        A notebook shows it; ``write_html(path)`` makes a page of it, ``show()`` opens a browser.

    Raises
    ------
    InputError
        For a column that a log has not, or where Plotly is not installed.
    """
    flights = [runs] if isinstance(runs, Run) else list(runs)
    readers = [Reader(run.log, run.summary.step_s) for run in flights]
    if not columns:
        labels = [
            f"{n}: {run.summary.controller_shown}, {run.summary.engine_shown}" for n, run in enumerate(flights, 1)
        ]
        one = len(flights) == 1
        return drawn(stacked(readers[0], ATTITUDE) if one else overlaid(readers, labels, ATTITUDE, "true"))
    units = {column.name: column.unit for run in flights for column in run.log.described}
    for name in columns:
        for run in flights:
            known(name, run.log.columns)
    shared = list(dict.fromkeys(units.get(name, "") for name in columns))
    panels = [Panel("", unit, []) for unit in shared]
    data = []
    for number, reader in enumerate(readers):
        for n, name in enumerate(columns):
            at = shared.index(units.get(name, ""))
            label = name if len(readers) == 1 else f"{number + 1}: {name}"
            trace = Trace(name, label, run_colour(n), _DASHES[number % len(_DASHES)])
            data.append(_line(reader, panels[at], at, trace))
    return drawn({"data": _named_once(data), "layout": _stacked_layout(panels, data)})


# ---- reading


class Reader:
    """The columns of a log as Plotly wants them, thinned out where there are more rows than can be seen."""

    def __init__(self, log: Log, step_s: float, times: Array | None = None) -> None:
        self.log = log
        self.step_s = step_s
        self._times = times  # of the rows, where they are not 0, step_s, ...

    @classmethod
    def of(cls, flight: ComparedFlight) -> Reader:
        """Return a reader of a flight that is compared."""
        if flight.run is not None:
            return cls(flight.log, flight.run.summary.step_s)
        times = flight.log[TIME]
        return cls(flight.log, step_of(times), times)

    def xy(self, values: Array) -> Figure:
        """Return the x and y of a trace for one value a row."""
        rows = thinned(values)
        if self._times is not None:
            x, y = (self._times, values) if rows is None else (self._times[rows], values[rows])
            return {"x": x.astype(np.float64), "y": y.astype(np.float32)}
        if rows is None:
            return {"x0": 0.0, "dx": self.step_s, "y": values.astype(np.float32)}
        return {"x": rows * self.step_s, "y": values[rows].astype(np.float32)}

    def moves(self, column: str) -> bool:
        """Return whether a column is ever anything but 0."""
        return bool(np.any(np.abs(self.log[column]) > 0.0))

    def known(self, column: str) -> bool:
        """Return whether a column is there and ever a number."""
        return column in self.log.columns and bool(np.any(np.isfinite(self.log[column])))

    def upsets(self) -> list[tuple[float, float]]:
        """Return the intervals [s] in which something disturbs the vehicle, wind apart."""
        disturbed = np.zeros(len(self.log), dtype=bool)
        for column in _UPSETS:
            disturbed |= self.log[column] != 0.0
        return self.stretches(disturbed)

    def stretches(self, mask: NDArray[np.bool_]) -> list[tuple[float, float]]:
        """Return the intervals [s] of a mask, gaps of less than 0.1 s closed; none if there are too many to see."""
        edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
        starts, ends = edges[::2] * self.step_s, edges[1::2] * self.step_s
        apart = starts[1:] - ends[:-1] >= 0.1
        first = np.concatenate(([True], apart))[: starts.size]
        last = np.concatenate((apart, [True]))[: ends.size]
        pairs = list(zip(starts[first].tolist(), ends[last].tolist(), strict=True))
        return pairs if len(pairs) <= MOST_SHADES else []


def thinned(values: Array, most: int = MOST_POINTS) -> NDArray[np.intp] | None:
    """Return the rows to draw, at most ``most``, so that no peak is lost; None for all rows.

    They are the first, the last, and the least and the greatest of each of many equal stretches.  A stretch without a
    number stays a gap.
    """
    if values.size <= most:
        return None
    inner = values[1:-1]
    length = ceil(inner.size / (most // 2 - 1))
    padded = np.full(ceil(inner.size / length) * length, np.nan)
    padded[: inner.size] = inner
    stretches = padded.reshape(-1, length)
    known = np.isfinite(stretches)
    starts = 1 + length * np.arange(len(stretches))
    low = starts + np.argmin(np.where(known, stretches, np.inf), axis=1)
    high = starts + np.argmax(np.where(known, stretches, -np.inf), axis=1)
    return np.unique(np.concatenate(([0], low, high, [values.size - 1])))


# ---- figures over time


def stacked(reader: Reader, panels: Sequence[Panel]) -> Figure:
    """Return panels above each other over one time axis."""
    data = [
        _line(reader, panel, number, trace)
        for number, panel in enumerate(panels)
        for trace in panel.traces
        if not trace.only_if_moving or reader.moves(trace.column)
    ]
    return {"data": _named_once(data), "layout": _stacked_layout(panels, data)}


def over(
    readers: Sequence[Reader], labels: Sequence[str], panels: Sequence[Panel], which: str
) -> list[tuple[Panel, list[tuple[int, Trace]]]]:
    """Return panels above each other, each with the trace ``which`` of every run that has it, by the run's number.

    The set-point is the longest run's where the others ask for the same as long as they last, else each run's own.
    """
    longest = max(range(len(readers)), key=lambda run: len(readers[run].log))
    drawn = []
    for panel in panels:
        own = [trace for trace in panel.traces if trace.label == which]
        traces = [
            (run, trace._replace(label=labels[run], colour=run_colour(run)))
            for run, reader in enumerate(readers)
            for trace in own
            if trace.column in reader.log.columns
        ]
        if not traces:
            continue
        for setpoint in (trace for trace in panel.traces if trace.label == "set-point" and which == "true"):
            asked = [run for run, reader in enumerate(readers) if reader.known(setpoint.column)]
            if asked and all(_asks_as(readers[run], readers[longest], setpoint.column) for run in asked):
                traces.append((longest, setpoint))
            else:
                traces += [
                    (run, setpoint._replace(label=f"{labels[run]}, set-point", colour=run_colour(run))) for run in asked
                ]
        drawn.append((panel, traces))
    return drawn


def overlaid(readers: Sequence[Reader], labels: Sequence[str], panels: Sequence[Panel], which: str) -> Figure:
    """Return the panels of :func:`over` as a figure of Plotly."""
    figures = over(readers, labels, panels, which)
    data = [_line(readers[run], panel, n, trace) for n, (panel, traces) in enumerate(figures) for run, trace in traces]
    return {"data": _named_once(data), "layout": _stacked_layout([panel for panel, _ in figures], data)}


def _asks_as(reader: Reader, other: Reader, column: str) -> bool:
    """Return whether a log asks for the same as a longer one as long as it lasts."""
    if reader is other:
        return True
    if column not in other.log.columns or reader.step_s != other.step_s:
        return False
    ours = reader.log[column]
    return np.array_equal(ours, other.log[column][: ours.size], equal_nan=True)


def thrust_panels(summary: Summary) -> list[Panel]:
    """Return a panel for each jet, front to back: the thrust at rest for its throttle, and the thrust delivered."""
    curves = thrust_curves(summary)
    return [
        Panel(
            f"Jet {jet}",
            "N",
            [
                *([_asked(AT_REST.format(jet), "commanded")] if curves[jet - 1] else []),
                Trace(f"thrust_{jet}_N", "delivered", width=1.5),
            ],
            least_span=4.0,
        )
        for row in jet_rows(summary.jets_m)
        for jet in row
    ]


def at_rest(log: Log, summary: Summary) -> dict[str, Array]:
    """Return columns that a page has beside the log's: each engine's thrust at rest for its throttle."""
    columns = {}
    for jet, curve in enumerate(thrust_curves(summary), 1):
        if curve and f"throttle_{jet}" in log.columns:
            points = np.array(curve, dtype=float)
            columns[AT_REST.format(jet)] = np.interp(log[f"throttle_{jet}"], points[:, 0], points[:, 1])
    return columns


def thrust_curves(summary: Summary) -> list[list[tuple[float, float]]]:
    """Return throttle and thrust at rest of the engine at each station, empty where it is not known."""
    own = [list(station.curve) for station in summary.stations]
    return [curve or summary.engine_curve for curve in own + [[]] * (max(JETS, len(summary.jets_m)) - len(own))]


def jet_rows(jets_m: Sequence[Sequence[float]]) -> tuple[tuple[int, ...], ...]:
    """Return jet numbers from front to back, (left, right), by their positions in the body frame if these are known."""
    if not jets_m:
        return JET_ROWS
    places = sorted((-x, y, number) for number, (x, y, _) in enumerate(jets_m, start=1))
    left = [number for _, y, number in places if y < 0.0]
    right = [number for _, y, number in places if y >= 0.0]
    if len(left) == len(right):
        return tuple(zip(left, right, strict=True))
    if len(jets_m) <= JETS:
        return JET_ROWS
    return tuple(tuple(range(n, min(n + 2, len(jets_m) + 1))) for n in range(1, len(jets_m) + 1, 2))


# ---- the track


# ---- pieces


def _line(reader: Reader, panel: Panel, number: int, trace: Trace) -> Figure:
    """Return a trace in the panel with this number, counted from 0."""
    return _values(reader, panel.scale * reader.log[trace.column], panel, trace) | {"yaxis": axis_name("y", number)}


def _values(reader: Reader, values: Array, panel: Panel, trace: Trace) -> Figure:
    return {
        "type": "scatter",
        "mode": "lines" if values.size > 1 else "markers",
        "name": trace.label,
        "legendgroup": trace.label,
        "hovertemplate": f"{panel.title}, {trace.label}: %{{y:.4~g}} {panel.unit}<extra></extra>",
        "line": {
            "color": trace.colour,
            "width": trace.width,
            "dash": trace.dash,
            "shape": "hv" if trace.held else "linear",
        },
        **reader.xy(values),
    }


def _named_once(data: list[Figure]) -> list[Figure]:
    """Show each label once in the legend; a click on it works on all panels."""
    seen: set[str] = set()
    for trace in data:
        trace["showlegend"] = trace["name"] not in seen
        seen.add(trace["name"])
    return data


def _stacked_layout(panels: Sequence[Panel], data: Sequence[Mapping[str, Any]]) -> Figure:
    made = _layout(len(panels) * PANEL_PX + 80)
    for number, panel in enumerate(panels):
        low, high = share(number, len(panels), gap=0.04)
        axis = {"domain": [low, high], "anchor": "x", "title": {"text": f"{panel.title} [{panel.unit}]".lstrip()}}
        drawn = [trace["y"] for trace in data if trace["yaxis"] == axis_name("y", number)]
        narrow = _span(drawn, panel.least_span)
        if narrow[1] - narrow[0] <= panel.least_span:
            axis["range"] = narrow
        made[axis_name("yaxis", number)] = axis
    made["xaxis"] = _time_axis(data) | {"anchor": axis_name("y", len(panels) - 1)}
    return made


def _layout(height: int) -> Figure:
    place = {"xref": "paper", "yref": "paper", "x": 0, "y": 1}
    return layout(
        height, 64, 12, 40, 44, hovermode="x unified", hoversubplots="axis",
        legend={"orientation": "h", "traceorder": "normal", **place, **ABOVE},
    )  # fmt: skip


def _time_axis(data: Sequence[Mapping[str, Any]]) -> Figure:
    ends = [(t["x"][-1] if "x" in t else t["x0"] + t["dx"] * (len(t["y"]) - 1)) for t in data if len(t["y"])]
    return {
        "title": {"text": "time [s]"},
        "hoverformat": ".3f",
        "range": [0.0, max([float(end) for end in ends] + [1e-3])],
    }


def _span(values: Sequence[Array], least: float) -> list[float]:
    """Return the range from least to greatest with a margin, widened to ``least`` around the middle."""
    known = np.concatenate([np.empty(0), *(part[np.isfinite(part)] for part in values)])
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    margin = max(0.06 * (high - low), 0.5 * (least - (high - low)))
    return [low - margin, high + margin]
