"""Write real-engine.md's tables and figure: recorded steps and ramps of a JetCat P300-PRO beside our turbines.

python docs/real_engine.py RECORDINGS [--fit] [--pages docs]

With --fit the parameters of jetcat-p300 are fitted anew, from all steps, each half and each day, and their table is
written instead.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from scipy.optimize import least_squares

from cosim.base.arrays import Array
from cosim.engine import load_engine, make_bank
from cosim.results.report.marks import check_marks, write_marks

mpl.use("Agg")
import matplotlib.pyplot as plt

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
RAMPS = [(C, 80.0, 50.7)]  # set-point by hand, 10 krpm/s, six ramps up and one down: nothing is fitted to them
ENGINES = ("jetcat-p300", "turbine-220", "turbine-100", "turbine-20")
SHARES = (0.1, 0.5, 0.9)
FROM = {  # about where every fit begins, far from what it finds; delay_samples is fitted as a real number
    "fuel_integral": 0.015, "fuel_response": 0.001, "fuel_ramp": 0.001, "fuel_fall": 0.2, "pump_time_constant": 0.1,
    "delay_samples": 50.0,
}  # fmt: skip
PUMP_STEP_S, PUMP_FROM = 0.02, np.array([0.02, 0.015, 0.5, 0.2])
HALVES = {
    "all ten": range(10), "1st, 3rd, ...": range(0, 10, 2), "2nd, 4th, ...": range(1, 10, 2),
    "2023-01-09": range(6), "2023-02-22": range(6, 10), "without two steps to 100": (0, 1, 2, 4, 5, 7, 8, 9),
}  # fmt: skip


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


def fit(steps: Sequence[Recorded]) -> tuple[dict[str, float], Array]:
    """Return the parameters with the least squares of what the speeds at all rows are off by, and their correlation."""
    begin, real = np.array(list(FROM.values())), np.concatenate([step.speed for step in steps])

    def off(points: Sequence[Array]) -> Array:
        tried = [dict(zip(FROM, (begin * point).tolist(), strict=True)) for point in points]
        return np.array([np.concatenate(courses) - real for courses in follow(steps, tried)])

    def slopes(point: Array) -> Array:
        here, *moved = off([point, *(point + 1e-3 * np.diag(point))])
        return np.asarray((np.array(moved) - here).T / (1e-3 * point))

    best = least_squares(
        lambda x: off([x])[0], np.ones(len(begin)), slopes, (0.06, 50.0), max_nfev=60, xtol=1e-4, ftol=1e-5
    )
    spread = np.linalg.pinv(best.jac.T @ best.jac)  # steps that never come to a limit do not tell it
    correlation = spread / np.sqrt(np.maximum(np.outer(np.diag(spread), np.diag(spread)), 1e-300))
    return dict(zip(FROM, (begin * best.x).tolist(), strict=True)), correlation


def pump(step: Recorded, gain: float, response: float, rise: float, fall: float, by_error: bool = True) -> Array:
    """Return the pump's volts at the rows, led by the recorded set-point and speed alone, in the ECU's law.

    ``by_error``: the change of the error counts, else that of the speed alone.
    """
    times = np.arange(step.times[0], step.times[-1] + PUMP_STEP_S, PUMP_STEP_S)
    asked, speed = (np.interp(times, step.times, course) for course in (step.setpoint, step.speed))
    pushed = np.diff(asked - speed if by_error else -speed)
    steps = PUMP_STEP_S * gain * (speed[:-1] / 60.0) ** 2 * (asked - speed)[:-1] + response * pushed
    volts = [float(step.volts[step.times < 0.0].mean())]
    for change in steps.tolist():
        volts.append(volts[-1] + min(max(change, -PUMP_STEP_S * fall * volts[-1]), PUMP_STEP_S * rise))
    return np.interp(step.times, times, volts)


def pump_table(steps: Sequence[Recorded], ramps: Sequence[Recorded]) -> list[str]:
    """Return the page's rows: the ECU's law fitted to the pump's volts, in its two forms, and again to the ramps."""
    lines = [
        "| what changes the volts | gain, V/s per krpm | response, V per krpm | rise, V/s | fall, 1/s | steps, rms | "
        "ramps, rms |",
        "| --- |" + " ---: |" * 6,
    ]

    def off(x: Array, by_error: bool, on: Sequence[Recorded]) -> Array:
        return np.concatenate([pump(step, *(x * PUMP_FROM), by_error) - step.volts for step in on])

    for what, by_error, on in (
        ("error and its change", True, steps),
        ("error and the change of the speed", False, steps),
        ("error and its change, fitted to the ramps", True, ramps),
    ):
        best = least_squares(off, np.ones(4), diff_step=1e-3, args=(by_error, on)).x
        gain, response, rise, fall = best * PUMP_FROM
        far = [f"{np.sqrt(np.mean(off(best, by_error, one) ** 2)):.3f} V" for one in (steps, ramps)]
        lines.append(f"| {what} | {gain:.4f} | {response:.4f} | {rise:.3f} | {fall:.3f} | {' | '.join(far)} |")
    return lines


def fit_table(steps: Sequence[Recorded]) -> list[str]:
    """Return the rows of the fits beside what the engine states, and say what the two differ in."""
    spec = load_engine("jetcat-p300", {}, STEP_S)
    if spec.uncertainty is None:
        raise SystemExit("engines/jetcat-p300/engine.toml: no [uncertainty] to compare with")
    deviation = dict(zip(spec.uncertainty.parameters, spec.uncertainty.deviation, strict=True))
    found = {name: fit([steps[n] for n in chosen]) for name, chosen in HALVES.items()}
    print(np.array2string(found["all ten"][1], precision=2, separator=", "))
    fits = {name: values for name, (values, _) in found.items()}
    fits["engine.toml"] = {key: spec.parameters[key] for key in FROM}
    lines = ["| | " + " | ".join(fits) + " | deviation |", "| --- |" + " ---: |" * (len(fits) + 1)]
    for key in FROM:
        cells = " | ".join(f"{values[key]:.4g}" for values in fits.values())
        lines.append(f"| `{key}` | {cells} | {deviation[key]:.4g} |")
        for name, values in fits.items():
            if abs(values[key] - fits["engine.toml"][key]) > deviation[key]:
                print(f"{key}: {values[key]:.4g} fitted to {name}, more than its deviation from engine.toml's")
    columns = []
    for name, courses in zip(fits, follow(steps, list(fits.values())), strict=True):
        left = [got - step.speed for got, step in zip(courses, steps, strict=True)]
        inside = HALVES.get(name, range(10))
        others = [n for n in range(10) if n not in inside] or list(range(10))
        share = [100.0 * float(np.sqrt(np.mean(one**2))) / SWING_KRPM for one in left]
        rms = [
            100.0 * float(np.sqrt(np.mean(np.concatenate([left[n] for n in part]) ** 2))) / SWING_KRPM
            for part in (inside, others)
        ]
        real = np.array([crossings(steps[n].times, steps[n].speed, ends_of(steps[n], steps[n].speed)) for n in others])
        got = np.array([crossings(steps[n].times, courses[n], ends_of(steps[n], courses[n])) for n in others])
        far = 100.0 * np.abs(got / real - 1.0)
        within = f"{np.count_nonzero(far <= 10.0)} of {far.size}"
        columns.append([*(f"{one:.2f}" for one in (*rms, max(share[n] for n in others))), within])
        columns[-1] += [f"{worst:.0f}" for worst in far.max(axis=0)]
    titles = ["fitted steps, rms, %", "other steps, rms, %", "worst other step, rms, %", "times within 10 %"]
    titles += [f"worst time to {100.0 * share:.0f} %, %" for share in SHARES]
    cells = np.array(columns).T.tolist()
    return lines + [f"| {title} | " + " | ".join(row) + " | |" for title, row in zip(titles, cells, strict=True)]


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


def engine_table(steps: Sequence[Recorded], answers: dict[str, list[Array]], ramps: Sequence[Recorded]) -> list[str]:
    """Return the page's rows: an engine each, over all steps and over the ramps."""
    real = np.array([crossings(step.times, step.speed, ends_of(step, step.speed)) for step in steps])
    lines = [
        "| engine | off over all ten steps, rms, % of range | in its worst step | times within 10 % | farthest time | "
        "off over the ramps, rms | at most |",
        "| --- |" + " ---: |" * 6,
    ]
    for name, courses in answers.items():
        left = [got - step.speed for got, step in zip(courses, steps, strict=True)]
        each = [100.0 * float(np.sqrt(np.mean(one**2))) / SWING_KRPM for one in left]
        whole = 100.0 * float(np.sqrt(np.mean(np.concatenate(left) ** 2))) / SWING_KRPM
        got = [crossings(step.times, one, ends_of(step, one)) for step, one in zip(steps, courses, strict=True)]
        far = 100.0 * (np.array(got) / real - 1.0)
        within, worst = np.count_nonzero(np.abs(far) <= 10.0), far.flat[np.abs(far).argmax()]
        off = 100.0 * np.concatenate([model(name, ramp) - ramp.speed for ramp in ramps]) / SWING_KRPM
        lines.append(
            f"| `{name}` | {whole:.2f} | {max(each):.1f} | {within} of {far.size} | {worst:+.0f} % | "
            f"{np.sqrt(np.mean(off**2)):.2f} | {np.abs(off).max():.0f} |"
        )
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
    parser.add_argument("--pages", type=Path, default=Path(__file__).parent, help="where the pages are")
    parser.add_argument("--fit", action="store_true", help="fit jetcat-p300 anew and write that table")
    chosen = parser.parse_args()
    page, data = chosen.pages / "real-engine.md", chosen.pages / "tables" / "real-engine.md"
    check_marks(page, ["engines", "volts"])
    check_marks(data, ["steps", "fit"])
    steps = read_steps(chosen.recordings)
    if chosen.fit:
        rows = fit_table(steps)
        print("\n".join(rows))
        write_marks(data, {"fit": "\n".join(rows) + "\n"})
    else:
        answers = {name: [model(name, step) for step in steps] for name in ENGINES}
        draw(steps, answers, chosen.pages / "pictures" / "real-engine.png")
        ramps = read_steps(chosen.recordings, RAMPS)
        parts = {"engines": engine_table(steps, answers, ramps), "volts": pump_table(steps, ramps)}
        write_marks(data, {"steps": "\n".join(table(steps, answers)) + "\n"})
        write_marks(page, {mark: "\n".join(rows) + "\n" for mark, rows in parts.items()})


if __name__ == "__main__":
    main()
