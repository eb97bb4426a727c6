"""The figures of a design: open loop, Nyquist, sensitivity and time responses, shipped and designed."""

from __future__ import annotations

import numpy as np

from cosim.base.arrays import Array
from cosim.design.assessment import AxisDesign
from cosim.design.design import Design
from cosim.design.loop.closed_loop import ClosedLoop, FrequencyGrid
from cosim.design.loop.tuning import Tuning
from cosim.results.report.plot import BLUE, GREY, ORANGE, RED, Figure, panels, trace

POINTS = 1500
TIME_POINTS = 1500  # points in time
FAR = 3.0  # of Nyquist's plane
TIMES = 25.0  # delays of the channel that are drawn in time


def design_figures(design: Design) -> dict[str, Figure]:
    """Draw Plotly figures, by name: ``bode_roll``, ``nyquist_roll``, ``sensitivity_roll``, ``step_roll``, ..."""
    figures: dict[str, Figure] = {}
    for axis, axis_design in design.axes.items():
        loops = _loops(axis_design)
        figures[f"bode_{axis}"] = _bode(loops)
        figures[f"nyquist_{axis}"] = _nyquist(loops, design)
        figures[f"sensitivity_{axis}"] = _sensitivity(loops, design)
        figures[f"step_{axis}"] = _step(loops, axis_design)
    return figures


def _loops(axis_design: AxisDesign) -> list[tuple[str, str, ClosedLoop, bool]]:
    points = FrequencyGrid(axis_design.channel, close=POINTS)
    loops = []
    states: list[tuple[str, str, Tuning, bool]] = [
        ("shipped", ORANGE, axis_design.before.tuning, axis_design.before.stable)
    ]
    if axis_design.after is not None:
        states.append(("designed", BLUE, axis_design.after.tuning, axis_design.after.stable))
    for label, colour, tuning, stable in states:
        loops.append((f"{label}, {tuning.controller}", colour, ClosedLoop(points, tuning), stable))
    return loops


def _hertz(loop: ClosedLoop) -> Array:
    return np.asarray(loop.points.theta / (2.0 * np.pi * loop.points.channel.step))


def _bode(loops: list[tuple[str, str, ClosedLoop, bool]]) -> Figure:
    data = []
    for label, colour, loop, _ in loops:
        value = loop.open_loop
        hertz = _hertz(loop)
        phase = np.degrees(np.unwrap(np.angle(value)))
        phase -= 360.0 * np.round((phase[0] + 180.0) / 360.0)
        data.append(trace(label, colour, hertz, 20.0 * np.log10(np.abs(value))))
        data.append(trace(label, colour, hertz, phase, 1))
    return {"data": data, "layout": panels(460, "frequency [Hz]", ["|L| [dB]", "phase of L [deg]"], True)}


def _nyquist(loops: list[tuple[str, str, ClosedLoop, bool]], design: Design) -> Figure:
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    radius = 1.0 / design.need.max_sensitivity
    data = [trace(f"|S| = {design.need.max_sensitivity:g}", RED, radius * np.cos(turn) - 1.0, radius * np.sin(turn))]
    for label, colour, loop, _ in loops:
        value = loop.open_loop
        near = np.where(np.abs(value) < 2.0 * FAR, value, np.nan)
        keep = np.isfinite(near)
        data.append(trace(label, colour, value.real[keep], value.imag[keep]))
    layout = panels(460, "real part of L", ["imaginary part of L"], False)
    layout["xaxis"]["range"] = [-FAR, 1.0]
    layout["yaxis"] |= {"range": [-FAR / 2.0 - 0.5, FAR / 2.0 + 0.5], "scaleanchor": "x"}
    return {"data": data, "layout": layout}


def _sensitivity(loops: list[tuple[str, str, ClosedLoop, bool]], design: Design) -> Figure:
    data = []
    hertz = _hertz(loops[0][2])
    limit = design.need.max_sensitivity
    data.append(trace("limit", RED, hertz[[0, -1]], np.array([limit, limit]), line={"color": RED, "dash": "dash"}))
    for label, colour, loop, stable in loops:
        if stable:
            data.append(trace(label, colour, hertz, np.abs(loop.inner / loop.characteristic)))
            data.append(trace(label, colour, hertz, np.abs(loop.angle_response), 1))
    titles = ["|S|", "|angle / set-point|"]
    layout = panels(420, "frequency [Hz]", titles, True)
    return {"data": data, "layout": layout}


def _step(loops: list[tuple[str, str, ClosedLoop, bool]], axis_design: AxisDesign) -> Figure:
    data: list[Figure] = []
    end = TIMES * axis_design.channel.pace_s
    for label, colour, loop, stable in loops:
        if not stable:
            continue
        # every millisecond of a long response is more than a page shows
        every = max(1, round(end / TIME_POINTS / axis_design.channel.step))
        angle, load = loop.steps.angle[::every], loop.steps.load[::every]
        time = np.arange(len(angle), dtype=np.float64) * every * axis_design.channel.step
        keep = time <= end
        if not data:
            data.append(trace("set-point", GREY, time[keep][[0, -1]], np.ones(2)))
        data.append(trace(label, colour, time[keep], angle[keep]))
        if loop.tuning.gains.i:
            data.append(trace(label, colour, time[keep], load[keep], 1))
    unit = "m" if axis_design.channel.name == "altitude" else "rad"
    titles = ["after a step of 1", f"{unit} per {axis_design.channel.unit} of load"]
    return {"data": data, "layout": panels(420, "time [s]", titles, False)}
