"""The designs in tests/designs, read."""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
from places import DESIGNS
from state_space import Engine, realised

from cosim.engine import EngineBank, load_engine
from cosim.spec.vehicle import load_vehicle
from hexjet_design.design import throttle_for

# pole and delay of G(z) as the engines' pages state them, thrust at full throttle [N], and who flies them
LINEAR = {
    "edf": (0.8748, 0, 9.80665 * 0.2554 / (1.0 - 0.8748)),
    "edf-as-flown": (0.8748, 25, 9.80665 * 0.2554 / (1.0 - 0.8748)),
    "turbojet": (0.9879, 25, 9.80665 * 0.01866 / (1.0 - 0.9879)),
    "motor": (0.865447, 5, 4.374747),
}


def stored(name: str) -> dict[str, Any]:
    return tomllib.loads((DESIGNS / f"{name}.toml").read_text(encoding="utf-8"))


def small_step(engine: str, aircraft: str, samples: int = 4000) -> tuple[Engine, float]:
    """An engine around hover from its answer to 1e-4 of throttle, and the thrust [N] between its throttles 0 and 1.

    That is a hundredth of what :mod:`hexjet_design` sweeps with, in time and not in frequency; what a limit on its
    acceleration does to the sweep is not in it.
    """
    spec, step, change = load_engine(engine, {}, 0.004), 0.004, 1e-4
    throttle = throttle_for(spec, load_vehicle(aircraft)[0])
    with EngineBank(spec, 1, step) as bank:
        bank.reset(throttle)
        settled = [bank.step(k, (throttle,)).thrust[0] for k in range(500)][-1]
        answer = np.array([bank.step(500 + k, (throttle + change,)).thrust[0] for k in range(samples)]) - settled
    delay = int(np.argmax(np.abs(answer) > 1e-9 * abs(answer[-1])))
    found = realised(answer, delay, 2 if engine.startswith("p220") else 3)
    x, course = np.zeros(len(found.A)), []
    for k in range(samples):
        x = found.A @ x + found.B * (1.0 if k >= delay else 0.0)
        course.append(found.C @ x)
    # an engine of second order in its state answers a small step as a linear one to about the step
    assert np.abs(course - answer / answer[-1]).max() < 1e-4
    return found, spec.curve.thrust[-1] - spec.curve.thrust[0]
