"""Writes real-engine.md's table of the next bench test: small steps, which the two fits of the real one answer apart.

python docs/small_steps.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from full_scale_ecu import AIRCRAFT, FITTED, STEP

from cosim.base.arrays import Array
from cosim.engine import EngineSpec, load_engine, make_bank
from cosim.results.report.marks import check_marks, table, write_marks
from cosim.spec.vehicle import load_vehicle
from hexjet_design.design import throttle_for
from hexjet_identify.bench.fit import Part
from hexjet_identify.bench.missing_evidence import SMALL, SmallTest, find_small_test

PAGE = Path(__file__).parent / "real-engine.md"
MARK = "next test"
RPM = 60.0 / (2.0 * np.pi)
ROW_S = 0.1  # of the recorded telemetry
SWING = 67e3  # rpm, from idle to 100 krpm
NOISE = (
    0.98,
    8.5,
)  # of the recorded speed at rest (50 and 75 krpm, run-2023-02-22-b): memory of a row, what is new, rpm
SETTLE_S = 20.0


def hover_speed(spec: EngineSpec) -> float:
    """The speed [rpm], to a thousand, at which six of these engines carry the vehicle."""
    with make_bank([spec], STEP) as bank:
        return round(bank.reset(throttle_for(spec, load_vehicle(AIRCRAFT)[0])).spool_speed[0] * RPM, -3)


def answers(part: Part) -> list[Array]:
    """The speed [rpm] of each fit at the rows of a command in rpm, from rest at the command's first."""
    specs = [load_engine(engine, parameters, STEP) for engine, parameters in FITTED.values()]
    times = np.arange(part.command_times[0] - SETTLE_S, part.times[-1] + STEP, STEP)
    held = part.command[np.maximum(np.searchsorted(part.command_times, times, side="right") - 1, 0)]
    found = []
    for spec in specs:
        idle, full, exponent = (spec.parameters[key] for key in ("idle_speed", "full_speed", "thrust_exponent"))
        low = (idle / full) ** exponent
        throttle = ((held / full) ** exponent - low) / (1.0 - low)
        with make_bank([spec], STEP) as bank:
            course = [bank.reset(float(throttle[0])).spool_speed[0] * RPM]
            course += [bank.step(k, (float(u),)).spool_speed[0] * RPM for k, u in enumerate(throttle[:-1])]
        found.append(np.asarray(np.interp(part.times, times, course)))
    return found


def test_of(level: float, step: float) -> SmallTest:
    """The shortest test of steps of that size about that level [rpm] which tells the two apart."""
    blank = np.zeros(1)

    def both(part: Part) -> tuple[Array, Array]:
        one, other = answers(part)
        return one, other

    test = find_small_test(Part(blank, blank, blank, blank, ROW_S, False), level, step, NOISE, both)
    assert test is not None
    return test


def swing_and_lag(level: float, step: float, hold_s: float) -> list[tuple[float, float]]:
    """Of each fit, the swing of its speed [rpm, peak to peak] and by how much its fundamental is behind [s]."""
    begins = hold_s * np.arange(30)
    command = level + step * np.resize([1.0, -1.0], len(begins))
    times = np.arange(begins[-4], begins[-1] + hold_s, STEP)[:-1]
    part = Part(np.append(-hold_s, begins), np.append(level, command), times, times, STEP, False)
    turns = np.exp(-1j * np.pi / hold_s * times)
    found = []
    for course in answers(part):
        # the fundamental of the steps is a sine that begins at 0
        phase = -np.angle(np.mean((course - course.mean()) * turns) * 1j) % (2.0 * np.pi)
        found.append((float(np.ptp(course)), float(phase * hold_s / np.pi)))
    return found


def written() -> str:
    """The sentence of the test, and the two rows."""
    level, step = hover_speed(load_engine(next(iter(FITTED.values()))[0], {}, STEP)), float(f"{SMALL * SWING:.0e}")
    test = test_of(level, step)
    rows = [
        [name, f"{swing:.0f} rpm", f"{lag:.2f} s", f"{test.apart:.0f} rpm, {test.deviations:.0f} times what noise does"]
        for name, (swing, lag) in zip(FITTED, swing_and_lag(level, step, test.hold_s), strict=True)
    ]
    words = (
        f"The set-point {step:.0f} rpm up and down about {level:.0f} rpm, where the vehicle hovers, each held "
        f"{test.hold_s:g} s, for {test.seconds:.0f} s, set-point and speed in one row every {ROW_S:g} s:"
    )
    columns = ["if the real one is", "its speed swings by", "behind the set-point by", "the other fit is off by (rms)"]
    return f"{words}\n\n{table(columns, rows)}"


def main() -> None:
    """Write the table into the page."""
    check_marks(PAGE, [MARK])
    write_marks(PAGE, {MARK: written()})


if __name__ == "__main__":
    main()
