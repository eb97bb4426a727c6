"""Recorded steps and ramps of a JetCat P300-PRO, and what our engines do of them: docs/full-scale.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.engine import load_engine, make_bank

STEP_S = 0.004
FIT_STEP_S = 0.02  # a fit asks the bank every fifth step of the engine: five times as cheap
RPM = 60.0 / (2.0 * np.pi)
SWING_KRPM = 67.0  # from idle, 33, to 100 krpm: what a share of the range is taken of
BEFORE_S = 3.0
A, B, C = "run-2023-01-09-a", "run-2023-02-22-b", "run-2022-12-14"
STEPS = [  # recording, begin [s], seconds that are compared; the even ones were fitted, the odd foretold, and reverse
    (A, 88.9, 29.0), (A, 118.9, 29.0), (A, 178.9, 29.0), (A, 208.9, 29.0), (A, 238.9, 19.0), (A, 258.9, 15.0),
    (B, 88.9, 8.5), (B, 268.5, 29.0), (B, 567.9, 29.0), (B, 1067.5, 29.0),
]  # fmt: skip
SHARES = (0.1, 0.5, 0.9)


class Recorded(NamedTuple):
    """One step: rows of time [s, from the step], set-point and speed [krpm], the fuel pump's volts."""

    times: Array
    setpoint: Array
    speed: Array
    volts: Array


def read_steps(folder: Path, chosen: Sequence[tuple[str, float, float]] = tuple(STEPS)) -> list[Recorded]:
    """Return the ten clean steps, or other stretches: recording, begin [s], seconds."""
    names = {name for name, *_ in chosen}
    files = {name: np.genfromtxt(folder / f"{name}.csv", delimiter=",", names=True) for name in names}
    steps = []
    for name, begin, seconds in chosen:
        rows = files[name][
            np.abs(files[name]["time_s"] - begin - 0.5 * (seconds - BEFORE_S)) <= 0.5 * (seconds + BEFORE_S)
        ]
        steps.append(Recorded(rows["time_s"] - begin, rows["setpoint_rpm"] / 1e3, rows["rpm"] / 1e3, rows["pump_V"]))
    return steps


def model(name: str, step: Recorded) -> Array:
    """Return the speed [krpm] of an engine of ours at the rows, its range laid over the recorded one's."""
    spec = load_engine(name, {}, STEP_S)
    idle, full = spec.parameters["idle_speed"], spec.parameters["full_speed"]
    own = name == "jetcat-p300"
    times = np.arange(step.times[0] - 1.0, step.times[-1] + STEP_S, STEP_S)
    wanted = step.setpoint if own else (idle + (full - idle) * (step.setpoint - 33.0) / (106.0 - 33.0)) / 1e3
    exponent = spec.parameters["thrust_exponent"]
    low = (idle / full) ** exponent
    throttle = ((np.clip(wanted * 1e3, idle, full) / full) ** exponent - low) / (1.0 - low)
    course = np.clip(np.interp(times, step.times, throttle), 0.0, 1.0)
    with make_bank([spec], STEP_S) as bank:
        speed = [bank.reset(float(course[0])).spool_speed[0] * RPM]
        speed += [bank.step(k, (float(u),)).spool_speed[0] * RPM for k, u in enumerate(course[:-1])]
    found = np.interp(step.times, times, speed)
    return np.asarray(found / 1e3 if own else 33.0 + (106.0 - 33.0) * (found - idle) / (full - idle))


def follow(steps: Sequence[Recorded], tried: Sequence[Mapping[str, float]]) -> list[list[Array]]:
    """Return the speeds [krpm] at the rows of ``jetcat-p300`` with each set of parameters, all in one bank."""
    spec = load_engine("jetcat-p300", {}, FIT_STEP_S)
    idle, full, exponent = (spec.parameters[key] for key in ("idle_speed", "full_speed", "thrust_exponent"))
    low = (idle / full) ** exponent
    grids = [np.arange(step.times[0] - 1.0, step.times[-1] + FIT_STEP_S, FIT_STEP_S) for step in steps]
    count = max(len(grid) for grid in grids)
    specs, courses = [], []
    for values in tried:
        for step, grid in zip(steps, grids, strict=True):
            throttle = ((np.clip(step.setpoint * 1e3, idle, full) / full) ** exponent - low) / (1.0 - low)
            # the delay is laid into the course, where it need not be whole; held, a sample stands for its middle
            delay = values["delay_samples"] * STEP_S - 0.5 * (FIT_STEP_S - STEP_S)
            asked = np.interp(grid - delay, step.times, throttle)
            courses.append(np.pad(asked, (0, count - len(grid)), mode="edge"))
            specs.append(load_engine("jetcat-p300", {**values, "delay_samples": 0}, FIT_STEP_S))
    inputs = np.clip(np.array(courses).T, 0.0, 1.0).tolist()
    with make_bank(specs, FIT_STEP_S) as bank:
        speeds = [bank.reset(inputs[0]).spool_speed]
        speeds += [bank.step(k, tuple(row)).spool_speed for k, row in enumerate(inputs[:-1])]
    found = iter(np.array(speeds).T * RPM / 1e3)
    return [
        [np.interp(step.times, grid, next(found)[: len(grid)]) for step, grid in zip(steps, grids, strict=True)]
        for _ in tried
    ]


def crossings(times: Array, speed: Array, ends: tuple[float, float]) -> list[float]:
    """Return when a share of the way is passed for the first time, s."""
    share = (speed - ends[0]) / (ends[1] - ends[0])
    found = []
    for wanted in SHARES:
        above = np.flatnonzero((share >= wanted) & (times > 0.0))
        k = int(above[0]) if len(above) else 0
        found.append(float(np.interp(wanted, share[k - 1 : k + 1], times[k - 1 : k + 1])) if k else float("nan"))
    return found


def ends_of(step: Recorded, speed: Array) -> tuple[float, float]:
    """Return the speed before the step and at its end."""
    last = speed[-20:].mean() if step.times[-1] > 10.0 else step.setpoint[-1]
    return float(speed[step.times < 0.0].mean()), float(last)
