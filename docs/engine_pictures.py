"""Draws the pictures of the engines' READMEs from their FMUs: ``make pictures``."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from cosim.engine import EngineBank, EngineSpec, build_engines, list_engine_names, load_engine

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

ENGINES = Path(__file__).parents[1] / "engines"
ORANGE, BLUE, GREY, RED = "#e8891c", "#2a78d6", "#8a939b", "#b3402a"
RPM = 30.0 / math.pi  # rpm per rad/s
# Text stays text, and the same flight gives the same file.
STYLE = {"svg.fonttype": "none", "svg.hashsalt": "engines", "font.family": "sans-serif", "font.size": 9}

Array = NDArray[np.float64]


class Flight(NamedTuple):
    """Signals of one engine, a value a step: s, N, rpm, K, kg/s."""

    time: Array
    thrust: Array
    speed: Array
    temperature: Array
    fuel: Array


def fly(spec: EngineSpec, step: float, start: float, throttle: Callable[[float], float], seconds: float) -> Flight:
    """Run an engine from equilibrium; ``throttle`` gives that of a time, negative for shut off."""
    rows = []
    running = True
    with EngineBank(spec, 1, step) as bank:
        bank.reset(start)
        for k in range(round(seconds / step)):
            u = throttle(k * step)
            if (u >= 0.0) != running:
                running = bank.set_run(0, u >= 0.0) and u >= 0.0
            out = bank.step(k, (max(u, 0.0),))
            values = (out.thrust, out.spool_speed, out.exhaust_temperature, out.fuel_flow)
            rows.append(((k + 1) * step, *(one[0] for one in values)))
    time, thrust, speed, temperature, fuel = np.array(rows)[:: max(1, len(rows) // 600)].T
    return Flight(time, thrust, speed * RPM, temperature, fuel)


def draw_static(axes: Axes, spec: EngineSpec) -> None:
    axes.plot(spec.curve.throttle, spec.curve.thrust, color=BLUE)
    ends = [spec.curve.thrust[0], spec.curve.thrust[-1]]
    axes.plot([0, 1], ends, "--", color=GREY, lw=0.8)
    axes.set(xlabel="throttle", ylabel="thrust at rest [N]", xlim=(0, 1), ylim=(0, None))


def draw_large_steps(axes: Axes, up: Flight, down: Flight) -> None:
    axes.plot(up.time, up.thrust, color=BLUE, label="throttle 0 to 1")
    axes.plot(down.time, down.thrust, color=ORANGE, label="1 to 0")
    axes.set(xlabel="time [s]", ylabel="thrust [N]", xlim=(0, up.time[-1]), ylim=(0, None))
    axes.legend(frameon=False, fontsize=8)


def draw_small_steps(axes: Axes, spec: EngineSpec, step: float, seconds: float) -> None:
    for u, colour in ((0.1, ORANGE), (0.5, BLUE), (0.9, GREY)):
        before, after = (fly(spec, step, level, lambda _, u=level: u, 0.2).thrust[-1] for level in (u, u + 0.01))
        moved = fly(spec, step, u, lambda _, u=u: u + 0.01, seconds)
        axes.plot(moved.time, (moved.thrust - before) / (after - before), color=colour, label=f"at {u:g}")
    axes.set(xlabel="time [s]", ylabel="share of a step of 0.01 throttle", xlim=(0, seconds), ylim=(0, None))
    axes.legend(frameon=False, fontsize=8)


def first_order(name: str) -> None:
    spec = load_engine(name, {}, step := _read_step(name))
    seconds = 25.0 * max(spec.lag or 0.0, 0.01) / 5.0 + (spec.transport_delay or 0.0)
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.2, 2.6), constrained_layout=True)
    draw_static(left, spec)
    draw_large_steps(right, fly(spec, step, 0.0, lambda _: 1.0, seconds), fly(spec, step, 1.0, lambda _: 0.0, seconds))
    _save(figure, name)


def identified(name: str) -> None:
    spec = load_engine(name, {}, step := _read_step(name))
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(10.2, 2.8), constrained_layout=True)
    draw_static(left, spec)
    draw_large_steps(middle, fly(spec, step, 0.0, lambda _: 1.0, 10.0), fly(spec, step, 1.0, lambda _: 0.0, 10.0))
    draw_small_steps(right, spec, step, 8.0)
    _save(figure, name)


def turbine(name: str) -> None:
    spec = load_engine(name, {}, step := _read_step(name))
    figure, rows = plt.subplots(2, 3, figsize=(10.2, 5.2), constrained_layout=True)
    up, down = fly(spec, step, 0.0, lambda _: 1.0, 8.0), fly(spec, step, 1.0, lambda _: 0.0, 8.0)
    draw_static(rows[0, 0], spec)
    draw_large_steps(rows[0, 1], up, down)
    draw_small_steps(rows[0, 2], spec, step, 5.0)
    for flight, colour in ((up, BLUE), (down, ORANGE)):
        rows[1, 0].plot(flight.time, flight.speed / 1e3, color=colour)
        rows[1, 1].plot(flight.time, flight.temperature - 273.15, color=colour)
    rows[1, 0].set(xlabel="time [s]", ylabel="speed [1000 rpm]", xlim=(0, 8), ylim=(0, None))
    rows[1, 1].set(xlabel="time [s]", ylabel="exhaust [°C]", xlim=(0, 8), ylim=(0, None))
    started = fly(spec, step, 0.5, lambda t: 0.5 if t < 2.0 else -1.0 if t < 10.0 else 0.0 if t < 34.0 else 0.5, 45.0)
    life = rows[1, 2]
    life.plot(started.time, started.speed / 1e3, color=BLUE)
    life.set(xlabel="time [s]", ylabel="speed [1000 rpm]", xlim=(0, 45), ylim=(0, None))
    life.set_zorder(1)
    life.patch.set_visible(False)
    hot = life.twinx()
    hot.plot(started.time, started.temperature - 273.15, color=RED, lw=0.9)
    hot.set_ylabel("exhaust [°C]", color=RED)
    life.set_title("shut off at 2 s, started at 10 s, half throttle at 34 s", fontsize=8, loc="left")
    _save(figure, name)


def _read_step(name: str) -> float:
    return 0.0025 if name == "motor" else 0.004


def _save(figure: plt.Figure, name: str) -> None:
    for axes in figure.axes:
        axes.grid(alpha=0.3)
        axes.spines["top"].set_visible(False)
    target = ENGINES / name / "response.svg"
    figure.savefig(target, metadata={"Date": None, "Creator": None})
    plt.close(figure)
    target.write_text("\n".join(line.rstrip() for line in target.read_text().splitlines()) + "\n")


if __name__ == "__main__":
    build_engines()
    mpl.rcParams.update(STYLE)
    for engine in list_engine_names():
        draw = (
            turbine
            if engine.startswith(("turbine-", "jetcat-"))
            else identified
            if engine.startswith("p220")
            else first_order
        )
        draw(engine)
