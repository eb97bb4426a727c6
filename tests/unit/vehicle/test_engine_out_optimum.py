"""docs/engine_out.py: the vehicle that the trajectory optimiser flies is the one that is simulated."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import pytest
from places import script

from cosim.base.constants import GRAVITY
from cosim.spec.vehicle import load_vehicle

ca = pytest.importorskip("casadi", reason="CasADi is not installed: pip install -e '.[bounds]'")


@pytest.fixture(scope="module")
def page() -> Any:
    return script("engine_out")


# aircraft/../engines/turbine-100/README.md, which its own tests hold: thrust [N], speed [rpm], fuel [g/s]
@pytest.mark.parametrize(("thrust", "speed", "fuel"), [(27.79, 110288.0, 2.559), (50.39, 130233.0, 3.426)])
def test_its_engine_stands_where_the_engine_does(page: Any, thrust: float, speed: float, fuel: float) -> None:
    n, flow, integral, reference = page.Turbine("turbine-100").steady(thrust)
    assert n * 154000.0 == pytest.approx(speed, rel=1e-4)
    assert flow == pytest.approx(fuel, rel=1e-3)
    assert reference == n
    assert integral == pytest.approx(flow + 12.0 * n)


@pytest.mark.parametrize("aircraft", ["quadjet", "jetwing"])
def test_its_jets_push_and_turn_as_the_layout_says(page: Any, aircraft: str) -> None:
    vehicle, _ = load_vehicle(aircraft)
    problem = page.Problem(vehicle, vehicle.engine, 1)
    x, u = ca.SX.sym("x", problem.size), ca.SX.sym("u", problem.hinges + 3)
    change = ca.Function("change", [x, u], [problem.change(x, u)[0]])
    gas = ca.Function("gas", [x], [ca.vertcat(*problem.turbine.gas(x[0], x[1]))])
    draw = np.random.default_rng(3)
    layout, (a, b, c) = vehicle.layout(), vehicle.inertia_kg_m2
    inertia = np.diag([a, b, c])
    for (i, j), product in zip(((0, 1), (0, 2), (1, 2)), vehicle.products_kg_m2, strict=True):
        inertia[i, j] = inertia[j, i] = -product
    for _ in range(5):
        state = np.array(problem._hover(3.0))
        hinges = state[10 : 10 + problem.hinges] = draw.uniform(-0.25, 0.25, problem.hinges)
        at = 10 + problem.hinges
        state[at] *= 0.7
        state[at + 1 :: 4] *= draw.uniform(0.8, 1.1, 3)
        idle = np.zeros(problem.size)

        def thrust(n: float, fuel: float, idle: np.ndarray = idle) -> float:
            idle[:2] = n, fuel
            return float(gas(idle)[1])

        thrusts = [thrust(state[at], 0.0)] + [thrust(state[at + 1 + 4 * k], state[at + 2 + 4 * k]) for k in range(3)]
        force, moment = layout.wrench(thrusts, list(hinges))
        slope = np.array(change(state, np.zeros(problem.hinges + 3))).ravel()
        # upright and at rest, the body's axes are the world's
        assert slope[1:4] == pytest.approx(np.array(force) / vehicle.mass_kg + [0.0, 0.0, GRAVITY], abs=1e-9)
        assert slope[7:10] == pytest.approx(np.linalg.solve(inertia, moment), abs=1e-9)
    # turned by a right angle of yaw, what pushed north pushes east
    state[6] = 0.5 * pi
    turned = np.array(change(state, np.zeros(problem.hinges + 3))).ravel()
    assert turned[2] == pytest.approx(slope[1], abs=1e-9)
    assert turned[1] == pytest.approx(-slope[2], abs=1e-9)
