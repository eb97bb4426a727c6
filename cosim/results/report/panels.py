"""The panels of a flight's figures: which columns of the log are drawn together, how, and in which unit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import degrees, pi
from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.signals import AXES, JETS
from cosim.results.log.columns import RATES, jets_in, servos_in, surfaces_in
from cosim.results.log.recorder import Log
from cosim.results.report.log_reader import Reader
from cosim.results.report.plot import BLUE, GREEN, GREY, MAGENTA, ORANGE, RED, run_colour
from cosim.results.summary import Summary

DEG = degrees(1.0)
AT_REST = "thrust_{}_at_rest_N"  # column: thrust that a jet settles at
HEXJET_ROWS = ((3, 1), (6, 5), (2, 4))  # front to back, left and right


class Trace(NamedTuple):
    """One column drawn in a panel."""

    column: str
    label: str
    colour: str = BLUE
    dash: str = "solid"
    width: float = 1.8
    is_staircase: bool = False  # values held over a control step
    only_if_moving: bool = False  # left out where it is 0 throughout


class Panel(NamedTuple):
    """Panel with one pair of axes; columns times ``scale`` are in ``unit``."""

    title: str
    unit: str
    traces: Sequence[Trace]
    scale: float = 1.0
    least_span: float = 0.0  # smallest span, so noise fills no panel


def _tracking_panel(name: str, si: str, unit: str, scale: float, least_span: float) -> Panel:
    """Return the panel of a set-point and the quantity that follows it, measured and true; columns end with ``si``."""
    traces = [
        Trace(f"{name}_measured_{si}", "measured", ORANGE, width=1.2),
        Trace(f"{name}_{si}", "true", BLUE),
        Trace(f"{name}_setpoint_{si}", "set-point", GREY, "dash", 1.5, is_staircase=True),
    ]
    return Panel(name.capitalize(), unit, traces, scale, least_span)


def _demand_trace(column: str, label: str) -> Trace:
    """Return the trace of a demand of a controller: noisy, so a thin line behind the others."""
    return Trace(column, label, GREY, width=1.1, is_staircase=True)


def _effort_traces(name: str) -> list[Trace]:
    return [
        Trace(f"torque_{name}", "asked for", BLUE, width=1.5, is_staircase=True),
        Trace(f"disturbance_torque_{name}", "disturbance", MAGENTA, "dot", is_staircase=True, only_if_moving=True),
        Trace(f"refused_{name}", "refused", RED, is_staircase=True, only_if_moving=True),
    ]


def _axis_traces(pattern: str, names: tuple[str, str, str]) -> list[Trace]:
    return [
        Trace(pattern.format(name), name, colour) for name, colour in zip(names, (BLUE, ORANGE, GREEN), strict=True)
    ]


ATTITUDE = [_tracking_panel(axis, "rad", "deg", DEG, 4.0) for axis in AXES]
RATE = [
    Panel(
        f"{axis.capitalize()} rate",
        "deg/s",
        [
            _demand_trace(f"rate_{rate}_setpoint_rad_s", "set-point"),
            Trace(f"rate_{rate}_measured_rad_s", "measured", ORANGE, width=1.5),
            Trace(f"rate_{rate}_predicted_rad_s", "predicted", BLUE, width=1.5),
        ],
        DEG,
        least_span=10.0,
    )
    for axis, rate in zip(AXES, RATES, strict=True)
]


def tilt_panels(log: Log) -> list[Panel]:
    """Return the panels of servos: banks and hinges, and surfaces."""
    return [
        *(_servo_panel(f"{name} servo", f"tilt_{name}", "_rad", "deg", DEG, 4.0) for name in servos_in(log.columns)),
        *(_servo_panel(name, f"deflection_{name}", "", "deflection", 1.0, 0.1) for name in surfaces_in(log.columns)),
    ]


def _servo_panel(name: str, column: str, end: str, unit: str, scale: float, least_span: float) -> Panel:
    traces = [_demand_trace(f"{column}_command{end}", "commanded"), Trace(f"{column}{end}", "actual", width=1.4)]
    return Panel(name.capitalize().replace("_", " "), unit, traces, scale, least_span)


def effort_panels(log: Log) -> list[Panel]:
    """Return the panels of what the loops command, in the units of the vehicle's allocation."""
    if not any(column.name == "torque_roll" and column.unit == "rad/s^2" for column in log.described):
        return EFFORT
    return [EFFORT[0], *(Panel(axis.capitalize(), "rad/s²", _effort_traces(axis), least_span=0.5) for axis in AXES)]


EFFORT = [
    Panel(
        "Collective",
        "throttle",
        [
            Trace("collective", "asked for", BLUE, width=1.5, is_staircase=True),
            Trace("refused_collective", "refused", RED, is_staircase=True, only_if_moving=True),
        ],
        least_span=0.2,
    ),
    Panel("Roll", "throttle", _effort_traces("roll"), least_span=0.05),
    Panel("Pitch", "deg of tilt", _effort_traces("pitch"), DEG, least_span=2.0),
    Panel("Yaw", "deg of tilt", _effort_traces("yaw"), DEG, least_span=2.0),
]
HEIGHT = [
    _tracking_panel("altitude", "m", "m", 1.0, 2.0),
    Panel("Climb rate", "m/s", [Trace("velocity_down_m_s", "true", BLUE)], scale=-1.0, least_span=1.0),
]
POSITION = [_tracking_panel(name, "m", "m", 1.0, 2.0) for name in ("north", "east")]
# Panels that are 0 throughout are left out, as are those of engines where no engine reports the quantity.
DISTURBANCES = [
    Panel("Force", "N", _axis_traces("disturbance_force_{}_N", ("x", "y", "z"))),
    Panel("Moment", "N m", _axis_traces("disturbance_moment_{}_N_m", ("x", "y", "z"))),
    Panel("Wind", "m/s", _axis_traces("wind_{}_m_s", ("north", "east", "down"))),
    Panel("Payload", "kg", [Trace("payload_kg", "mass", is_staircase=True)]),
]
ENGINES = (
    ("Spool speed", "rpm", "spool_speed_{}_rad_s", 30.0 / pi),
    ("Exhaust temperature", "K", "exhaust_temperature_{}_K", 1.0),
    ("Fuel flow", "g/s", "fuel_flow_{}_kg_s", 1e3),
)
SPOOLS = Panel("Moment of the spools", "N m", _axis_traces("spool_moment_{}_N_m", ("x", "y", "z")))
TANK = Panel("Fuel on board", "kg", [Trace("fuel_kg", "fuel", BLUE)])


def engine_panels(reader: Reader) -> list[Panel]:
    """Return the panels of engine reports other than thrust, spools' moment and tank, where there are any."""
    panels = []
    jets = range(1, jets_in(reader.log.columns) + 1)
    for title, unit, pattern, scale in ENGINES:
        traces = [Trace(pattern.format(jet), f"jet {jet}", run_colour(jet - 1), width=1.4) for jet in jets]
        present = [trace for trace in traces if reader.has_values(trace.column)]
        if present:
            panels.append(Panel(title, unit, present, scale))
    healths = [Trace(f"health_{jet}", f"jet {jet}", run_colour(jet - 1), width=1.4) for jet in jets]
    failed = [
        trace for trace in healths if reader.has_values(trace.column) and np.nanmin(reader.log[trace.column]) < 1.0
    ]
    if failed:
        panels.append(Panel("Health, as monitored", "1", failed, least_span=1.2))
    return panels + [panel for panel in (SPOOLS, TANK) if reader.has_values(panel.traces[0].column)]


def thrust_panels(summary: Summary) -> list[Panel]:
    """Return a panel for each jet, front to back: the thrust at rest for its throttle, and the thrust delivered."""
    curves = thrust_curves(summary)
    return [
        Panel(
            f"Jet {jet}",
            "N",
            [
                *([_demand_trace(AT_REST.format(jet), "commanded")] if curves[jet - 1] else []),
                Trace(f"thrust_{jet}_N", "delivered", width=1.5),
            ],
            least_span=1.0,
        )
        for row in jet_rows(summary.jets_m)
        for jet in row
    ]


def make_rest_columns(log: Log, summary: Summary) -> dict[str, Callable[[], Array]]:
    """Return functions that compute columns for the page: each engine's thrust at rest for its throttle."""
    columns: dict[str, Callable[[], Array]] = {}
    for jet, curve in enumerate(thrust_curves(summary), 1):
        if curve and f"throttle_{jet}" in log.columns:
            throttle, thrust = np.array(curve, dtype=float).T
            columns[AT_REST.format(jet)] = partial(_interpolate_column, log, f"throttle_{jet}", throttle, thrust)
    return columns


def _interpolate_column(log: Log, column: str, x: Array, y: Array) -> Array:
    return np.interp(log[column], x, y)


def thrust_curves(summary: Summary) -> list[list[tuple[float, float]]]:
    """Return throttle and thrust at rest of the engine at each station, empty where it is not known."""
    curves = [list(station.curve) for station in summary.stations]
    return [curve or summary.engine_curve for curve in curves + [[]] * (max(JETS, len(summary.jets_m)) - len(curves))]


def jet_rows(jets_m: Sequence[Sequence[float]]) -> tuple[tuple[int, ...], ...]:
    """Return jet numbers from front to back, (left, right), by their positions in the body frame if these are known."""
    if not jets_m:
        return HEXJET_ROWS
    ordered = sorted((-x, y, number) for number, (x, y, _) in enumerate(jets_m, start=1))
    port = [number for _, y, number in ordered if y < 0.0]
    starboard = [number for _, y, number in ordered if y >= 0.0]
    if len(port) == len(starboard):
        return tuple(zip(port, starboard, strict=True))
    if len(jets_m) <= JETS:
        return HEXJET_ROWS
    return tuple(tuple(range(n, min(n + 2, len(jets_m) + 1))) for n in range(1, len(jets_m) + 1, 2))
