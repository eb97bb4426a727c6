"""Made-up flights for the tests of what a run leaves behind: every number is plausible, none is a result."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import cos, exp, nan, pi, sin, sqrt
from pathlib import Path
from random import Random
from typing import Any

from pyulog import ULog

from cosim.base.frames import from_euler
from cosim.base.signals import (
    Actuation,
    Command,
    ControlSignals,
    Disturbance,
    EngineOutput,
    Measured,
    Sample,
    State,
    Unallocated,
)
from cosim.results.export import export_log
from cosim.results.run import Run, begin_run
from cosim.results.summary import DelayRow, Setup
from cosim.spec.scenario import Expectation, Range, Scenario

STEP = 0.004
SILENT = (nan,) * 6  # engines that report nothing but their thrust


class Rows:
    """An observer that keeps every sample."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []

    def observe(self, sample: Sample) -> None:
        self.samples.append(sample)


def exported(folder: Path | None, path: Path) -> ULog:
    """The ULog of a run, written to ``path`` and read back."""
    assert folder is not None
    export_log("ulog", folder, path)
    log = ULog(str(path))
    assert not log.file_corruption
    return log


def second_order(t: float, zeta: float, omega: float) -> tuple[float, float]:
    """Unit step response of omega^2 / (s^2 + 2 zeta omega s + omega^2) and its slope."""
    if t <= 0.0:
        return 0.0, 0.0
    root = sqrt(1.0 - zeta * zeta)
    damped, decay = omega * root, exp(-zeta * omega * t)
    value = 1.0 - decay * (cos(damped * t) + zeta / root * sin(damped * t))
    return value, decay * omega / root * sin(damped * t)


def samples(steps: int, zeta: float = 0.4, omega: float = 9.0, seed: int = 1, growth: float = 0.0) -> Iterator[Sample]:
    """A roll doublet of 10 deg from 1 s, each half 2 s long, answered by a second-order system with a little noise."""
    random = Random(seed)
    plan = [(1.0, 10.0), (3.0, -20.0), (5.0, 10.0)]
    for k in range(steps):
        t = k * STEP
        setpoint = sum(size for start, size in plan if t >= start - 1e-9) * pi / 180.0
        pairs = [(size * pi / 180.0, second_order(t - start, zeta, omega)) for start, size in plan]
        wave = growth * exp(0.9 * t) * 1e-3
        roll = sum(size * value for size, (value, _) in pairs) + wave * sin(11.0 * t)
        rate = sum(size * slope for size, (_, slope) in pairs) + 11.0 * wave * cos(11.0 * t)
        ahead = sum(size * second_order(t + 0.1 - start, zeta, omega)[1] for (start, size) in _radians(plan))
        torque = 0.02 * (3.5 * (setpoint - roll) - ahead)
        noise = random.gauss(0.0, 0.01)
        spread = [torque if jet in (2, 3, 6) else -torque for jet in range(1, 7)]
        throttle = tuple(0.45 + part for part in spread)
        late = 0.02 * (3.5 * (setpoint - roll) - rate)
        thrust = tuple(20.0 * (0.45 + (late if part > 0 else -late)) for part in spread)
        yield Sample(
            k,
            t,
            Command((setpoint, 0.0, 0.0), 30.0),
            State(
                (0.4 * t, 0.3 * sin(t), -30.0 - 0.05 * sin(0.7 * t)),
                (0.4, 0.3 * cos(t), -0.035 * cos(0.7 * t)),
                from_euler(roll, 0.01 * sin(2 * t), 0.005 * t),
                (roll, 0.01 * sin(2 * t), 0.005 * t),
                (rate, 0.02 * cos(2 * t), 0.005),
                (0.1, -0.2, -9.8),
                30.0 + 0.05 * sin(0.7 * t),
                (2.0, 1.0 + 0.4 * sin(3 * t), 0.0),
                5.525,
                False,
                False,
            ),
            Measured(
                (rate + noise, 0.02 * cos(2 * t), 0.005),
                from_euler(roll + 0.1 * noise, 0.01 * sin(2 * t), 0.005 * t),
                (0.4 * t, 0.3 * sin(t), -30.0),
                (0.4, 0.3 * cos(t), 0.0),
                30.0 + noise,
            ),
            ControlSignals(
                (3.5 * (setpoint - roll), -0.02, 0.0),
                (ahead, 0.02 * cos(2 * t), 0.005),
                (torque, 0.002 * sin(t), 0.001),
                0.45,
                0.45,
            ),
            Actuation(throttle, (0.02 * sin(2 * t), 0.02 * sin(2 * t)), Unallocated(0.0, 0.0, 0.0, 0.0)),  # type: ignore[arg-type]
            (0.018 * sin(2 * t - 0.2), 0.018 * sin(2 * t - 0.2)),
            EngineOutput(thrust, SILENT, SILENT, SILENT),
            Disturbance(moment=(0.3, 0.0, 0.0)) if 6.0 < t < 7.0 else Disturbance(),
        )


def record(
    steps: int,
    folder: Path | None = None,
    outcome: Any = "completed",
    reason: str = "",
    change: Callable[[Sample], Sample] = lambda sample: sample,
    **known: Any,
) -> Run:
    """The run of :func:`samples`, each of them changed."""
    recording = begin_run(setup(**known), scenario(), folder)
    for sample in samples(steps):
        recording.observe(change(sample))
    return recording.finish(outcome, reason, wall_s=0.1)


def _radians(plan: list[tuple[float, float]]) -> list[tuple[float, float]]:
    return [(start, size * pi / 180.0) for start, size in plan]


def scenario(**changes: Any) -> Scenario:
    """The scenario that :func:`samples` pretends to fly."""
    return Scenario(
        name="roll-doublet",
        title="Roll doublet",
        description="Ten degrees of roll, one way and then the other, at 30 m.",
        duration_s=8.0,
        command=[{"kind": "doublet", "signal": "roll_deg", "start_s": 1.0, "amplitude": 10.0, "width_s": 2.0}],
    ).replace(**changes)


def setup(**changes: Any) -> Setup:
    """What is known before that flight."""
    places = ((0.15, 0.15), (-0.15, -0.15), (0.15, -0.15), (-0.15, 0.15), (0.0, 0.15), (0.0, -0.15))
    flown, limits = scenario(), {"roll.overshoot_percent": Range(max=35.0)}
    stated = ("title", "description", "aircraft", "engine", "controller", "seed", "step_s")
    known: dict[str, Any] = {name: getattr(flown, name) for name in stated} | {
        "scenario": flown.name,
        "planned_s": 8.0,
        "started": "2030-01-01T12:00:00+00:00",
        "engine_curve": [(0.0, 0.0), (0.5, 10.0), (1.0, 20.0)],
        "jets_m": [(x, y, 0.0) for x, y in places],
        "delay_ledger": [
            DelayRow(element="command held over the step", owner="control step", kind="hold", samples=0.5),
            DelayRow(element="transport delay", owner="engine edf-as-flown", kind="transport", samples=25.0),
            DelayRow(element="force acts half a JSBSim run late", owner="JSBSim", kind="transport", samples=0.5),
        ],
        "expectation": Expectation(controller="smith", engine="edf-as-flown", metrics=limits),
        "versions": {"python": "3.11.0", "hexjet-cosim": "0.2.0"},
        "sha256": {"hexjet.xml": "ab" * 32, "edf-as-flown.fmu": "cd" * 32},
    }
    return Setup(**(known | changes))
