"""What an engine does to the airframe beside its thrust: forces across the jet and a torque about it, as its FMU says."""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine_tools import STEP
from foreign_engines import Row, force, foreign, lever, mapped

from cosim import Scenario, fly
from cosim.base.errors import InputError
from cosim.base.signals import ZERO3, Actuation, Unallocated
from cosim.engine import load_engine
from cosim.results.log.digest import log_digest
from cosim.simulation.build import build
from cosim.spec.scenario import ThrustLoss

FORWARD, RIGHT, TORQUE = 0.1, -0.05, 0.02  # of the thrust: -, -, m
TILT = (0.3, -0.2)
THROTTLE = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
ROWS: list[Row] = [lever(), force(), force("Fx", "forward"), force("Fy", "right"), ("swirl", "torque", "output", 'unit="N.m"'),
                   force("Fg", "gross"), force("Fram", "drag")]  # fmt: skip
LINES = ("force_forward = 'Fx'", "force_right = 'Fy'", "torque = 'swirl'")


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made_of = f"lag=0.05,drag=0.5,forward={FORWARD},right={RIGHT},torque={TORQUE}"
    return foreign(tmp_path_factory.mktemp("aside"), "aside", made_of, ROWS)


@pytest.fixture(scope="module")
def full(fmu: Path) -> Path:
    return mapped(fmu, "[ports]", "thrust = 'thrust'", *LINES)


def scenario(engine: Path, **more: Any) -> Scenario:
    table = {"name": "aside", "engine": str(engine), "controller": "baseline", "engine_unchecked": True,
             "duration_s": 0.2, "sensor_noise": False, **more}  # fmt: skip
    return Scenario.from_table(table, Scenario.load("hover").folder, "test")


def pushed(flown: Scenario, fault: ThrustLoss | None = None) -> Iterator[Any]:
    """After 0.4 s at the throttles and tilts: thrusts, tilts, forces, moment, and JSBSim's wrench about the vehicle."""
    with build(flown) as simulation:
        simulation.reset()
        propulsion, frame = simulation.propulsion, simulation.airframe
        propulsion.reset(THROTTLE, simulation.state, ZERO3)
        if fault is not None:
            propulsion.engines.begin_fault(fault)
        for k in range(100):
            forces, moment = propulsion.step(k, Actuation(THROTTLE, TILT, Unallocated()), simulation.state)
        frame.step(forces, simulation.disturbances.at(0), moment)
        yield simulation, np.array(propulsion.output.thrust), propulsion.tilt, np.array(forces), np.array(moment)


def test_force_and_moment_on_the_body(full: Path) -> None:
    """``F = T (e + 0.1 f - 0.05 r)``, e, f and r the jet's own axes as it is tilted, ``M = 0.02 T e``: to 1e-12, and JSBSim's."""
    for simulation, thrust, tilt, forces, moment in pushed(scenario(full)):
        assert tilt == pytest.approx(TILT, abs=1e-3)
        total, turned = np.zeros(3), np.zeros(3)
        for i, jet in enumerate(simulation.vehicle.jets):
            angle = tilt[0] if jet.servo == "left" else tilt[1]
            along = np.array([sin(angle), 0.0, -cos(angle)])
            ahead = np.array([cos(angle), 0.0, sin(angle)])
            wanted = thrust[i] * (along + FORWARD * ahead + RIGHT * np.array([0.0, 1.0, 0.0]))
            assert forces[i] == pytest.approx(wanted, abs=1e-12)
            total += TORQUE * thrust[i] * along
            turned += np.cross(jet.position_m, wanted)
        assert moment == pytest.approx(total, abs=1e-12)
        force_there, moment_there = simulation.airframe.external_wrench()
        assert force_there == pytest.approx(forces.sum(axis=0), rel=1e-9, abs=1e-9)
        assert moment_there == pytest.approx(turned + total, rel=1e-9, abs=1e-9)


def test_a_torque_takes_the_place_of_the_jets_reaction(fmu: Path, full: Path) -> None:
    reacting = {"vehicle": {"jets": {"1": {"reaction_m": 0.5}}}}
    for _, thrust, tilt, _, moment in pushed(scenario(fmu, **reacting)):
        against = [-sin(tilt[0]), 0.0, cos(tilt[0])]  # the thrust of the left bank, about which the rotor turns
        assert moment == pytest.approx([0.5 * thrust[1] * part for part in against], abs=1e-12)
    moments = [moment for extra in ({}, reacting) for *_, moment in pushed(scenario(full, **extra))]
    assert moments[0].tolist() == moments[1].tolist()


def test_it_goes_with_the_thrust_that_a_fault_leaves(full: Path) -> None:
    sound, weak = (next(iter(pushed(scenario(full), fault))) for fault in (None, ThrustLoss(kind="thrust_loss", jet=[2], start_s=0.0, share=0.25)))  # fmt: skip
    assert weak[3][1] == pytest.approx(0.75 * sound[3][1], rel=1e-12)
    assert weak[3][2].tolist() == sound[3][2].tolist()


def test_gross_thrust_and_ram_drag_beside_it(fmu: Path) -> None:
    """What acts is their difference, along the jet; what is across goes with what the FMU says."""
    path = mapped(fmu, "[ports]", "thrust = 'Fg'", "ram_drag = 'Fram'", *LINES)
    for _, thrust, _, forces, _ in pushed(scenario(path)):
        assert thrust == pytest.approx(20.0 * np.array(THROTTLE), rel=1e-2)
        assert forces[:, 1] == pytest.approx(RIGHT * thrust, rel=1e-9)


def test_it_flies_and_is_logged(full: Path) -> None:
    flown = scenario(full)
    run, apart = fly(flown), fly(flown.replace(engine_isolated=True))
    column = next(each for each in run.log.described if each.name == "torque_Nm_3")
    assert (column.unit, column.frame) == ("N m", "jet")
    assert run.log["torque_Nm_3"] == pytest.approx(TORQUE * run.log["thrust_3_N"], rel=1e-12)
    assert run.log["force_right_N_1"] == pytest.approx(RIGHT * run.log["thrust_1_N"], rel=1e-12)
    assert abs(run.log["roll_rad"][-1]) > 0.0  # forces to the side above the centre of gravity
    assert log_digest(run.log) == log_digest(apart.log)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (("torque = 'Fx'",), "its Fx is in N; it must be a moment, such as N.m"),
        (("force_forward = 'throttle'",), "has no output called throttle for force_forward"),
    ],
)
def test_what_is_none_is_refused(lines: tuple[str, ...], said: str, fmu: Path) -> None:
    with pytest.raises(InputError, match=said):
        load_engine(str(mapped(fmu, "[ports]", "thrust = 'thrust'", *lines)), {}, STEP, unchecked=True)


def test_a_torque_is_never_guessed(fmu: Path) -> None:
    """That of most engines is their shaft's, which the airframe does not feel."""
    spec = load_engine(str(mapped(fmu, "[ports]", "thrust = 'thrust'")), {}, STEP, unchecked=True)
    assert not any(spec.has_port(port) for port in ("force_forward", "force_right", "torque"))
