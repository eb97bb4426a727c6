"""Measures and flies the loops of docs/judging.md, and writes its tables: ``python docs/judging.py``.

Half a minute of one processor.  Every number is what ``hexjet margins`` and ``hexjet fly`` give with the same settings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import asin, degrees, log10
from pathlib import Path
from typing import Any, NamedTuple

from cosim import Run, Scenario, fly, margins
from cosim.results.report.marks import row, table, write_marks

PAGE = Path(__file__).parent / "judging.md"
FLIGHT, AXIS, STEP_MS = "roll-doublet", "roll", 4
CALM = ("vehicle.control.rate.roll.p=0.016", "vehicle.control.attitude.gain_1_s=[2.2, 5.0, 3.0]")


class Loop(NamedTuple):
    """One loop of roll: controller and settings of the flight."""

    controller: str = "smith"
    settings: tuple[str, ...] = ()


LOOPS: Mapping[str, Loop] = {
    "calm": Loop(settings=CALM),
    "shipped": Loop(),
    "filtered": Loop("filtered-smith"),
    "hasty": Loop(settings=("vehicle.control.attitude.gain_1_s=[5.0, 5.0, 3.0]",)),
    "busy": Loop(
        settings=(*CALM, "vehicle.control.rate.roll.d=0.004", "vehicle.control.rate.roll.d_filter_s=0.004"),
    ),
}
# What the controllers are not told, by the heading of its column.
OFF: Mapping[str, tuple[str, ...]] = {
    "as modelled": (),
    "40 ms later": ("mismatch.delay_samples=10",),
    "80 ms later": ("mismatch.delay_samples=20",),
    "20 % more thrust": ("mismatch.thrust_factor=1.2",),
    "both, 40 ms": ("mismatch.thrust_factor=1.2", "mismatch.delay_samples=10"),
}
# Peak sensitivities with what is said of them.
PEAKS: Mapping[float, str] = {
    1.7: "good: what `hexjet design` asks for",
    2.0: "usual: the upper limit",
    2.5: "from 2.0 to here only with a well-known engine",
    3.8: "above 2.5 do not fly on it alone: *hasty*",
}


def guaranteed(peak: float) -> tuple[float, float]:
    """Return the gain margin (dB) and the phase margin (deg) that a peak sensitivity guarantees.

    A loop that stays ``1 / peak`` away from -1 crosses the real axis at ``-1 + 1 / peak`` at the nearest, and the unit
    circle at twice the angle whose sine is half of that distance.
    """
    return 20.0 * log10(peak / (peak - 1.0)), degrees(2.0 * asin(0.5 / peak))


def measured(loop: Loop) -> dict[str, float]:
    """The margins of a loop's axis, as ``hexjet margins --axis roll --json`` has them."""
    found: Any = margins(FLIGHT, [AXIS], controller=loop.controller, settings=loop.settings).to_dict()
    return {name: each["value"] for name, each in found["axes"][AXIS]["measured"].items() if each is not None}


def flown(loop: Loop, off: Sequence[str]) -> Run:
    """The flight of a loop with what its controller is not told."""
    settings = (f'controller="{loop.controller}"', "expect=[]", *loop.settings, *off)
    return fly(Scenario.load(FLIGHT, list(settings)))


def margins_row(name: str, found: Mapping[str, float]) -> list[str]:
    return [
        name,
        f"{found['gain_db']:.1f} dB",
        f"{found['gain_down_db']:.1f} dB",
        f"{found['phase_deg']:.1f} deg",
        f"{found['crossover_hz']:.2f} Hz",
        f"{1000.0 * found['delay_s']:.0f} ms",
        f"{found['peak_sensitivity']:.2f}",
    ]


def outcome(run: Run) -> str:
    """Overshoot and settling of a flight in a cell; "swings" where it does not settle, "lost" where it ends early."""
    if run.outcome != "completed":
        return "lost"
    roll = run.metrics[AXIS]
    if roll.settling_time_s is not None:
        return f"{roll.overshoot_percent:.0f} %, {roll.settling_time_s:.2f} s"
    return f"swings {degrees(roll.oscillation_rad):.1f} deg"


def flights_row(name: str, runs: Sequence[Run]) -> list[str]:
    return [name, *map(outcome, runs), f"{runs[0].summary.flat_metrics['effort.throttle_1_s']:.2f} 1/s"]


def parts() -> dict[str, str]:
    """The tables, by their marks."""
    columns = ["loop", "gain up", "gain down", "phase", "crossover", "delay", "peak |S|"]
    heads = ["max |S|", "guaranteed gain margin", "guaranteed phase margin", "judgement"]
    rows = [(peak, *guaranteed(peak), said) for peak, said in PEAKS.items()]
    lines = [row(heads), "| --- | ---: | ---: | --- |"]
    lines += [f"| {peak:.1f} | {gain:.1f} dB | {phase:.1f} deg | {said} |" for peak, gain, phase, said in rows]
    return {
        "what a peak sensitivity guarantees": "".join(f"{line}\n" for line in lines),
        "margins of five loops": table(columns, [margins_row(name, measured(loop)) for name, loop in LOOPS.items()]),
        "flights of five loops": table(
            ["loop", *OFF, "effort"],
            [flights_row(name, [flown(loop, off) for off in OFF.values()]) for name, loop in LOOPS.items()],
        ),
    }


if __name__ == "__main__":
    write_marks(PAGE, parts())
