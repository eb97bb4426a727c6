"""Write real-engine.md's tables and figure: recorded steps of a JetCat P300-PRO beside our turbines.

python docs/real_engine.py RECORDINGS [--page docs/real-engine.md]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np

from cosim.base.arrays import Array
from cosim.engine import load_engine, make_bank

mpl.use("Agg")
import matplotlib.pyplot as plt

STEP_S = 0.004
RPM = 60.0 / (2.0 * np.pi)
SWING_KRPM = 67.0  # from idle, 33, to 100 krpm: what a share of the range is taken of
BEFORE_S = 3.0
A, B = "run-2023-01-09-a", "run-2023-02-22-b"
STEPS = [  # recording, begin [s], seconds that are compared; the even ones were fitted, the odd foretold, and reverse
    (A, 88.9, 29.0), (A, 118.9, 29.0), (A, 178.9, 29.0), (A, 208.9, 29.0), (A, 238.9, 19.0), (A, 258.9, 15.0),
    (B, 88.9, 8.5), (B, 268.5, 29.0), (B, 567.9, 29.0), (B, 1067.5, 29.0),
]  # fmt: skip
ENGINES = ("jetcat-p300", "turbine-220", "turbine-100", "turbine-20")
SHARES = (0.1, 0.5, 0.9)


class Recorded(NamedTuple):
    """One step: rows of time [s, from the step], set-point and speed [krpm]."""

    times: Array
    setpoint: Array
    speed: Array


def read_steps(folder: Path) -> list[Recorded]:
    """Return the ten clean steps."""
    files = {name: np.genfromtxt(folder / f"{name}.csv", delimiter=",", names=True) for name in (A, B)}
    steps = []
    for name, begin, seconds in STEPS:
        rows = files[name][
            np.abs(files[name]["time_s"] - begin - 0.5 * (seconds - BEFORE_S)) <= 0.5 * (seconds + BEFORE_S)
        ]
        steps.append(Recorded(rows["time_s"] - begin, rows["setpoint_rpm"] / 1e3, rows["rpm"] / 1e3))
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


def table(steps: Sequence[Recorded], answers: dict[str, list[Array]]) -> list[str]:
    """Return the page's rows: a step and an engine each."""
    lines = [
        "| step, krpm | engine | off, rms, % of range | 10 % s | 50 % s | 90 % s |",
        "| --- | --- | ---: | ---: | ---: | ---: |",
    ]
    for n, step in enumerate(steps):
        title = f"{step.setpoint[0]:.0f} to {step.setpoint[-1]:.0f}"
        real = crossings(step.times, step.speed, ends_of(step, step.speed))
        lines.append(f"| {title} | **recorded** | | " + " | ".join(f"{one:.2f}" for one in real) + " |")
        for name, courses in answers.items():
            off = 100.0 * float(np.sqrt(np.mean((courses[n] - step.speed) ** 2))) / SWING_KRPM
            got = crossings(step.times, courses[n], ends_of(step, courses[n]))
            cells = [f"{one:.2f} ({100.0 * (one / true - 1.0):+.0f} %)" for one, true in zip(got, real, strict=True)]
            lines.append(f"| | `{name}` | {off:.1f} | " + " | ".join(cells) + " |")
    return lines


def draw(steps: Sequence[Recorded], answers: dict[str, list[Array]], target: Path) -> None:
    """Draw every step."""
    figure, axes = plt.subplots(5, 2, figsize=(10.0, 13.0), constrained_layout=True)
    for n, (step, axis) in enumerate(zip(steps, axes.flat, strict=True)):
        axis.plot(step.times, step.speed, "k", lw=2.0, label="recorded")
        for name, courses in answers.items():
            axis.plot(step.times, courses[n], lw=1.0, label=name)
        axis.set(xlim=(-1.0, 12.0), xlabel="time [s]", ylabel="speed [krpm]")
        axis.grid(alpha=0.3)
    axes.flat[0].legend(fontsize=7)
    figure.savefig(target, dpi=80)
    plt.close(figure)


def main() -> None:
    """Write table and figure into the page, between its marks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--page", type=Path, default=Path(__file__).parent / "real-engine.md")
    chosen = parser.parse_args()
    steps = read_steps(chosen.recordings)
    answers = {name: [model(name, step) for step in steps] for name in ENGINES}
    draw(steps, answers, chosen.page.parent / "pictures" / "real-engine.png")
    head, _, rest = chosen.page.read_text(encoding="utf-8").partition("<!-- measured: steps -->\n")
    tail = rest.partition("<!-- end -->")[2]
    rows = "\n".join(table(steps, answers))
    chosen.page.write_text(f"{head}<!-- measured: steps -->\n{rows}\n<!-- end -->{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
