"""The figures of a design: open loop, Nyquist, sensitivity and time responses, shipped and designed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.loops import crossings
from cosim.pages import BLUE, GREY, ORANGE, RED, panels, trace
from hexjet_design.assessment import AxisDesign
from hexjet_design.design import Design
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.tuning import Tuning

Figure = dict[str, Any]


def design_figures(design: Design) -> dict[str, Figure]:
    """Draw Plotly figures, by name: ``bode_roll``, ``nyquist_roll``, ``sensitivity_roll``, ``step_roll``, ..."""
    figures: dict[str, Figure] = {}
    for axis, axis_design in design.axes.items():
        loops = _close_loops(axis_design)
        figures[f"bode_{axis}"] = bode(_make_curves(loops))
        figures[f"nyquist_{axis}"] = nyquist(_make_curves(loops), design.need.max_sensitivity)
        figures[f"sensitivity_{axis}"] = _sensitivity_figure(loops, design)
        figures[f"step_{axis}"] = _step_figure(loops, axis_design)
    return figures


def _close_loops(axis_design: AxisDesign) -> list[tuple[str, str, ClosedLoop, bool]]:
    points = FrequencyGrid(axis_design.channel, close=1500)
    loops = []
    states: list[tuple[str, str, Tuning, bool]] = [
        ("shipped", ORANGE, axis_design.before.tuning, axis_design.before.stable)
    ]
    if axis_design.after is not None:
        states.append(("designed", BLUE, axis_design.after.tuning, axis_design.after.stable))
    for label, colour, tuning, stable in states:
        name = f"{label}, {tuning.controller}" if stable else f"{label}, {tuning.controller}, unstable"
        loops.append((name, colour, ClosedLoop(points, tuning), stable))
    return loops


def _grid_hz(loop: ClosedLoop) -> Array:
    return np.asarray(loop.points.theta / (2.0 * np.pi * loop.points.channel.step))


class Curve(NamedTuple):
    """Open loop to be drawn: name, colour, ``L`` at rising frequencies [Hz], style."""

    label: str
    colour: str
    hertz: Array
    loop: Complex
    style: Mapping[str, Any] = MappingProxyType({})


def _make_curves(loops: list[tuple[str, str, ClosedLoop, bool]]) -> list[Curve]:
    return [Curve(label, colour, _grid_hz(loop), loop.open_loop) for label, colour, loop, _ in loops]


def bode(curves: Sequence[Curve], height: int = 460, more: Sequence[str] = ()) -> Figure:
    """Draw gain and phase over two decades about the crossover, with the least margins marked and in the names.

    The margins keep their signs: a gain margin is the change of gain to instability, a phase margin the lag to it.  The
    phase is between -360 and 0 deg.  ``more``: the titles of further panels below these, which stay empty.
    """
    points = [margin_points(curve.loop, curve.hertz) for curve in curves]
    low, high = _crossover_range(curves, [phase for _, phase in points])
    data: list[Figure] = []
    for curve, (gain, phase) in zip(curves, points, strict=True):
        seen = (curve.hertz >= low) & (curve.hertz <= high)
        hertz, loop = curve.hertz[seen], curve.loop[seen]
        parts = [f"{-gain.value:.1f} dB"] if gain else []
        parts += [f"{phase.value + 180.0:.1f} deg"] if phase else []
        name = f"{curve.label}: {', '.join(parts)}" if parts else curve.label
        degrees = _wrap_phase(np.degrees(np.angle(loop)))
        jumps = np.flatnonzero(np.abs(np.diff(degrees)) > 180.0) + 1
        data.append(trace(name, curve.colour, hertz, decibels(loop), **curve.style))
        broken = np.insert(hertz, jumps, np.nan), np.insert(degrees, jumps, np.nan)
        data.append(trace(name, curve.colour, *broken, 1, **curve.style))
        data += [
            _margin_mark(name, curve.colour, point, of, panel)
            for panel, (point, of) in enumerate(((gain, 0.0), (phase, -180.0)))
            if point and low <= point.hertz <= high
        ]
    layout = panels(height, "frequency [Hz]", ["|L| [dB]", "phase of L [deg]", *more], True)
    layout["xaxis"]["range"] = [float(np.log10(low)), float(np.log10(high))]
    layout["yaxis2"] |= {"range": [-360.0, 0.0], "tickvals": [-360, -270, -180, -90, 0]}
    layout["shapes"] = [
        {"type": "line", "xref": "x domain", "x0": 0, "x1": 1, "yref": axis, "y0": at, "y1": at,
         "line": {"color": GREY, "width": 1, "dash": "dash"}}
        for axis, at in (("y", 0.0), ("y2", -180.0))
    ]  # fmt: skip
    return {"data": data, "layout": layout}


class MarginPoint(NamedTuple):
    """Point at which a loop has a margin: frequency [Hz], and gain [dB] or phase [deg, -360 to 0] there."""

    hertz: float
    value: float


def margin_points(loop: Complex, hertz: Array) -> tuple[MarginPoint | None, MarginPoint | None]:
    """Find where a loop is nearest to -1 in gain, on the negative real axis, and in phase, where its gain is 1.

    Straight lines between the points, as :func:`cosim.loops.loop_margins` has them; None where there is no such place.
    """
    factors, of_axis, angles, of_circle = crossings(loop, 2.0 * pi * hertz)
    phases = _wrap_phase(np.degrees(angles) - 180.0)
    return _find_nearest(-20.0 * np.log10(factors), 0.0, of_axis), _find_nearest(phases, -180.0, of_circle)


def _find_nearest(values: Array, limit: float, omega: Array) -> MarginPoint | None:
    if not len(values):
        return None
    k = int(np.argmin(np.abs(values - limit)))
    return MarginPoint(float(omega[k] / (2.0 * pi)), float(values[k]))


def _wrap_phase(degrees: Array) -> Array:
    """Return the same angles between -360 and 0 degrees, so that -180 is in the middle."""
    return np.asarray(-np.mod(-degrees, 360.0))


def decibels(loop: Complex) -> Array:
    """Return the gain of a loop in dB."""
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(loop), np.finfo(np.float64).tiny)))


def _crossover_range(curves: Sequence[Curve], phases: Sequence[MarginPoint | None]) -> tuple[float, float]:
    """Return the frequencies [Hz] from a tenth of the least to ten times the greatest crossover, as far as known."""
    crossovers = [
        phase.hertz if phase else float(curve.hertz[int(np.argmin(np.abs(decibels(curve.loop))))])
        for curve, phase in zip(curves, phases, strict=True)
    ]
    ends = [end for curve in curves for end in curve.hertz[[0, -1]].tolist()]
    return max(min(ends), 0.1 * min(crossovers)), min(max(ends), 10.0 * max(crossovers))


def _margin_mark(name: str, colour: str, point: MarginPoint, limit: float, panel: int) -> Figure:
    """Return the line from the limit, 0 dB or -180 deg, to where a loop has its least margin."""
    style = {"mode": "lines+markers", "marker": {"size": 8, "color": colour}, "line": {"color": colour, "width": 2.5}}
    at = [point.hertz, point.hertz]
    return trace(name, colour, at, [limit, point.value], panel, **style, showlegend=False)


def nyquist(curves: Sequence[Curve], peak: float, height: int = 460, far: float = 3.0) -> Figure:
    """Draw open loops in the complex plane, with the circle of ``|S|`` = ``peak``."""
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    data = [trace(f"|S| = {peak:.3g}", RED, np.cos(turn) / peak - 1.0, np.sin(turn) / peak)]
    for curve in curves:
        near = np.abs(curve.loop) < 2.0 * far
        data.append(trace(curve.label, curve.colour, curve.loop.real[near], curve.loop.imag[near], **curve.style))
    layout = panels(height, "real part of L", ["imaginary part of L"], False)
    layout["xaxis"]["range"] = [-far, 1.0]
    layout["yaxis"] |= {"range": [-far / 2.0 - 0.5, far / 2.0 + 0.5], "scaleanchor": "x"}
    return {"data": data, "layout": layout}


def _sensitivity_figure(loops: list[tuple[str, str, ClosedLoop, bool]], design: Design) -> Figure:
    data = []
    hertz = _grid_hz(loops[0][2])
    limit = design.need.max_sensitivity
    data.append(trace("limit", RED, hertz[[0, -1]], np.array([limit, limit]), line={"color": RED, "dash": "dash"}))
    for label, colour, loop, stable in loops:
        if stable:
            data.append(trace(label, colour, hertz, np.abs(loop.inner / loop.characteristic)))
            data.append(trace(label, colour, hertz, np.abs(loop.angle_response), 1))
    titles = ["|S|", "|angle / set-point|"]
    layout = panels(420, "frequency [Hz]", titles, True)
    return {"data": data, "layout": layout}


def _step_figure(
    loops: list[tuple[str, str, ClosedLoop, bool]], axis_design: AxisDesign, points: int = 1500, times: float = 25.0
) -> Figure:
    """Draw the step responses over ``times`` the time scale of the channel."""
    data: list[Figure] = []
    end = times * axis_design.channel.time_scale_s
    for label, colour, loop, stable in loops:
        if not stable:
            continue
        # A page cannot show every millisecond of a long response.
        every = max(1, round(end / points / axis_design.channel.step))
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
