"""Controllers to export, every branch of them gone through."""

from __future__ import annotations

import random
from math import cos, sin
from pathlib import Path
from typing import Any

from cosim.base.protocols import EngineState
from cosim.base.signals import ZERO3, Command, Disturbance, EngineOutput, Measured
from cosim.simulation.step import Simulation
from cosim.spec.scenario import Scenario
from hexjet_export.controller import measure
from hexjet_export.controller.files import Labels, render_sources
from hexjet_export.controller.vectors import RecordedFlight, RecordingController

CC = measure.find_compiler()
STRICT = (
    "-Wsign-conversion", "-Wshadow", "-Wstrict-prototypes", "-Wmissing-prototypes", "-Wundef", "-Wcast-qual", "-Werror",
)  # fmt: skip
QUIET = EngineOutput((0.0,) * 6, (0.0,) * 6, (0.0,) * 6, (0.0,) * 6)


def written(folder: Path, simulation: Simulation, vectors: RecordedFlight, form: dict[str, Any]) -> Path:
    """The C files of a controller."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in render_sources(form, vectors, Labels("ours", "a test", None, ("a test",))).items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def driven(simulation: Simulation, steps: int, seed: int) -> RecordedFlight:
    """The controller with inputs that no flight would have: every branch is gone through, limits included."""
    chance, vectors = random.Random(seed), RecordedFlight()
    vehicle = simulation.vehicle
    controller = RecordingController(simulation.controller, vectors)
    burnt = 0.1 * vehicle.mass_kg if vehicle.fuel else 0.0
    controller.reset(chance.random() < 0.5, burnt)
    engines, command, size = EngineState.FLY, Command((0.0, 0.0, 0.0), 3.0), 0.01
    for k in range(steps):
        if k % 15 == 0:
            size = chance.choice([0.001, 0.03, 1.0])
            engines = chance.choice([EngineState.FLY] * 6 + [EngineState.IDLE, EngineState.OFF])
            command = Command(
                (chance.gauss(0, 0.3), chance.gauss(0, 0.3), chance.choice([-0.0, 0.0, chance.uniform(-3, 3)])),
                3.0 + chance.gauss(0, size),
                (chance.gauss(0, 1), chance.gauss(0, 1), chance.gauss(0, 1)) if chance.random() < 0.2 else None,
                chance.uniform(0.0, 1.1) if chance.random() < 0.2 else None,
            )
        lean, heading = chance.gauss(0, size), chance.uniform(-3, 3)
        attitude = (cos(lean) * cos(heading), sin(lean), chance.gauss(0, 0.01) * size, cos(lean) * sin(heading))
        measured = Measured(
            (chance.gauss(0, size), chance.gauss(0, size), chance.gauss(0, size)),
            attitude,
            ZERO3,
            (0.0, 0.0, chance.gauss(0, size)),
            3.0 + chance.gauss(0, size),
        )
        controller.update(command, measured, Disturbance(), engines)
        burnt += 1e-4 if vehicle.fuel else 0.0
        controller.watch(QUIET, burnt)
    return vectors


def scenario(name: str, **changes: Any) -> Scenario:
    return Scenario.load(name).replace(expect=[], **changes)


PAIRED = {
    "gain": 0.004, "zeros": [-0.9], "poles": [0.999, 0.97], "pole_pairs": [(0.95, 0.05)], "delay_samples": 7.0,
    "sample_time_s": 0.004, "source": "made up",
}  # fmt: skip
BROKEN_DELAY = {
    "gain": 0.02, "zeros": [-0.9], "poles": [0.999, 0.95], "delay_samples": 12.4, "sample_time_s": 0.004, "source": "made up",
}  # fmt: skip
LAG = {"natural_rad_s": 6.0, "pole_rad_s": 20.0}
OVERDAMPED = {"natural_rad_s": 1.3, "damping": 1.4, "pole_rad_s": 8.0}
LEVELS = {
    "filter_s": 0.5,
    "level": [
        {"share": share, "roll": {"p": 0.5 + share, "i": 0.7, **LAG}, "altitude": {"angle": 1.0 + share, **LAG}}
        for share in (0.3, 0.5, 0.6)
    ],
}
HEXJET = "roll-doublet"
CASES = {
    "baseline": (HEXJET, {"controller": "baseline"}),
    "state": (HEXJET, {"controller": "state"}),
    "state-model": (HEXJET, {"controller": "state-model"}),
    "state-disturbance": (HEXJET, {"controller": "state-disturbance"}),
    "a delay that is added": (HEXJET, {"controller": "filtered-smith", "added_delay_samples": 3}),
    "a broken delay, smith": (HEXJET, {"controller": "smith", "model": BROKEN_DELAY}),
    "a broken delay, filtered": (HEXJET, {"controller": "filtered-smith", "model": BROKEN_DELAY}),
    "a broken delay, state": (HEXJET, {"controller": "state-disturbance", "model": BROKEN_DELAY}),
    "pairs of poles, smith": (HEXJET, {"controller": "smith", "model": PAIRED}),
    "pairs of poles, state-model": (HEXJET, {"controller": "state-model", "model": PAIRED}),
    "pairs of poles, state-disturbance": (HEXJET, {"controller": "state-disturbance", "model": PAIRED}),
    "curves, leads and schedule": ("full-scale-roll-doublet", {"controller": "filtered-smith"}),
    "four poles, state-disturbance": ("full-scale-roll-doublet", {"controller": "state-disturbance"}),
    "leads of a single lag": (HEXJET, {"control": {"lead": {"roll": LAG, "pitch": LAG, "altitude": LAG}}}),
    "the same, scheduled": (HEXJET, {"control": {"lead": {"roll": LAG, "altitude": LAG}, "schedule": LEVELS}}),
    "leads of more than critical damping": (
        "full-scale-roll-doublet",
        {"control": {"schedule": {"filter_s": 0.1, "level": [
            {"share": share, "roll": OVERDAMPED, "altitude": OVERDAMPED} for share in (0.3, 0.35, 0.6)
        ]}}},
    ),
    "a schedule without leads": (HEXJET, {"control": {"schedule": LEVELS}}),
    "a rotorcraft, three predictors": (HEXJET, {"controller": "smith", "aircraft": "quadrotor", "engine": "motor"}),
    "hinges in chains": ("trijet-roll-doublet", {"controller": "baseline"}),
    "a rate law of PIDs": (HEXJET, {"controller": "pid-smith"}),
    "a rate law, optimal": (HEXJET, {"controller": "optimal"}),
    "nozzles, and no horizontal force": ("quadjet-roll-doublet", {"controller": "baseline"}),
}  # fmt: skip
LOOPS = {
    "shares": (HEXJET, {"controller": "filtered-smith", "added_delay_samples": 3}),
    "curves, leads and schedule": ("full-scale-roll-doublet", {"controller": "state-disturbance"}),
    "accelerations": ("trijet-roll-doublet", {"controller": "baseline"}),
    "surfaces and a wing": ("jetwing-roll-doublet", {"controller": "baseline"}),
}


def made(name: str, changes: dict[str, Any]) -> Scenario:
    changes = dict(changes)
    if "model" in changes:
        changes["vehicle"] = {"identified": {"edf-as-flown": {"roll": changes.pop("model")}}}
    if "control" in changes:
        changes["vehicle"] = {"control": changes.pop("control")}
    if changes.get("aircraft") == "quadrotor":
        changes["step_s"] = 0.0025
    return scenario(name, **changes)
