"""A vehicle with single gimballed nozzles, a surface and products of inertia: built, flown, its log, its faults."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import Scenario, fly
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.engine import load_engine
from cosim.results.report.flight_figures import run_figures
from cosim.simulation.build import build
from cosim.spec.scenario import Environment
from cosim.spec.vehicle import Vehicle, load_vehicle
from cosim.stepper import Stepper
from cosim.vehicle.airframe import Airframe
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import channels
from hexjet_design.loop.dynamics import make_lag_dynamics

# pitch moment -0.5 m^3 times pressure times the elevator's position, which a lag of 0.05 s brings to its command
WING = """<fdm_config>
<flight_control name="fcs">
 <channel name="p"><lag_filter name="fcs/elevator"><input>fcs/elevator-cmd-norm</input><c1>20</c1>
 <output>fcs/elevator-pos-norm</output></lag_filter></channel>
</flight_control>
<aerodynamics>
 <axis name="PITCH"><function name="aero/m"><product><property>aero/qbar-psf</property>
 <property>fcs/elevator-pos-norm</property><value>-17.657333360744296</value></product></function></axis>
</aerodynamics>
</fdm_config>"""
GAINS = {"p": 6.0, "i": 4.0, "d": 0.0, "d_filter_s": 0.01, "integral_limit": 5.0}


def nozzle(jet: int, place: tuple[float, ...], axis: tuple[float, ...], name: str) -> dict[str, Any]:
    return {
        "name": f"{name}{jet}", "position_m": place, "axis": axis, "deflects": [jet], "lag_s": 0.01,
        "rate_limit_rad_s": 10.0, "range_rad": 0.3, "mass_kg": 0.01, "inertia_kg_m2": 1e-6, "effort": 0.3,
    }  # fmt: skip


def gimballed(folder: Path, **changes: Any) -> Scenario:
    """The quadrotor with a gimbal of two hinges at each of its jets, and a tail."""
    (folder / "wing.xml").write_text(WING)
    jets = enumerate(load_vehicle("quadrotor")[0].jets, 1)
    ways = (("ahead", (0.0, -1.0, 0.0)), ("aside", (1.0, 0.0, 0.0)))
    vehicle = {
        "model": str(folder / "wing.xml"),
        "products_kg_m2": [0.0, 0.0002, 0.0],
        "hinges": [nozzle(number, jet.position_m, axis, name) for number, jet in jets for name, axis in ways],
        "surfaces": [{"name": "elevator", "property": "fcs/elevator-cmd-norm", "lag_s": 0.02, "rate_limit_1_s": 10.0}],
        "control": {"rate": dict.fromkeys(("roll", "pitch", "yaw"), GAINS)},
    }
    table = {"aircraft": "quadrotor", "engine": "motor", "controller": "baseline", "step_s": 0.0025, "vehicle": vehicle}
    return Scenario.load("hover").replace(**(table | {"expect": [], "duration_s": 0.5} | changes))


def test_it_hovers_and_its_log_has_what_moves(tmp_path: Path) -> None:
    run = fly(gimballed(tmp_path))
    assert run.outcome == "completed"
    assert np.abs(run.log["roll_rad"]).max() < 0.01
    assert np.abs(run.log["refused_roll"]).max() == 0.0
    units = {column.name: column.unit for column in run.log.described}
    assert {"tilt_aside4_command_rad", "fault_servo_elevator"} <= units.keys()
    assert "tilt_left_rad" not in units
    assert (units["torque_roll"], units["tilt_ahead1_rad"], units["deflection_elevator"]) == ("rad/s^2", "rad", "1")
    assert "rad/s²" in str(run_figures(run.log, run.summary)["effort"])


def test_a_nozzle_that_jams_is_a_fault_by_its_name(tmp_path: Path) -> None:
    jam = {"kind": "servo_jam", "servo": "ahead2", "start_s": 0.1, "angle_deg": 5.0}
    run = fly(gimballed(tmp_path, fault=[jam], duration_s=0.3))
    assert run.log["tilt_ahead2_rad"][-1] == pytest.approx(np.radians(5.0), abs=1e-4)
    assert run.log["fault_servo_ahead2"].sum() > 0.0
    for wrong, said in (({"servo": "left"}, "has the servos ahead1"), ({"servo": "elevator"}, "is a surface")):
        with pytest.raises(InputError, match=said):
            build(gimballed(tmp_path, fault=[jam | wrong]))


def test_what_a_surface_does_is_what_the_model_says(tmp_path: Path) -> None:
    vehicle, folder = gimballed(tmp_path).resolved_vehicle()
    frame = Airframe(vehicle, folder, Environment(), 0.0025, 1, 0)
    try:
        (effect,) = frame.surface_effects()
    finally:
        frame.close()
    # 17.657333 ft^3 are half a cubic metre
    assert effect == pytest.approx((0.0, 0.0, 0.0, 0.0, -0.5, 0.0), abs=1e-9)


def test_by_hand_every_servo_has_a_number(tmp_path: Path) -> None:
    with Stepper(gimballed(tmp_path), actuators=True) as flight:
        flight.step(throttle=[0.5] * 4, tilt=[0.1] * 8 + [0.5])
        with pytest.raises(InputError, match="tilt"):
            flight.step(tilt=[0.1, 0.1])


def test_where_two_lags_share_an_axis_the_lesser_is_an_uncertainty_of_the_greater(tmp_path: Path) -> None:
    scenario = gimballed(tmp_path)
    vehicle, _ = scenario.resolved_vehicle()
    engine = load_engine("motor", {}, scenario.step_s)

    def with_effort(effort: float) -> Vehicle:
        hinges = [hinge.model_copy(update={"effort": effort}) for hinge in vehicle.hinges]
        return vehicle.model_copy(update={"hinges": hinges})

    answer = Actuator.of("engine", make_lag_dynamics([0.05], 0.0, scenario.step_s))
    shared = {axis: plant.actuator for axis, plant in channels(scenario, with_effort(1.0), engine, answer).items()}
    assert (shared["roll"].name, shared["yaw"].name) == ("engine", "tilt servo")
    unsure = {axis: np.array([share for _, share in shared[axis].dynamics.unsure]) for axis in ("roll", "yaw")}
    assert min(shares.max() for shares in unsure.values()) > 0.1
    # what the engine's model leaves by itself comes on top
    loose = replace(answer, dynamics=replace(answer.dynamics, unsure=((0.01, 0.2), (400.0, 0.2))))
    roll = channels(scenario, with_effort(1.0), engine, loose)["roll"].actuator
    assert [share for _, share in roll.dynamics.unsure] == pytest.approx(unsure["roll"] + 0.2, abs=1e-12)
    # hinges that are dear leave it to the jets
    roll = channels(scenario, with_effort(100.0), engine, answer)["roll"]
    assert (roll.unit, roll.gain, roll.actuator.name) == ("rad/s^2", 1.0, "engine")
    # more than the jets give alone, each as far as hover leaves either way at its lever
    span = engine.curve.thrust[-1] - engine.curve.thrust[0]
    share = (vehicle.mass_kg * GRAVITY / 4 - engine.curve.thrust[0]) / span
    limits = vehicle.control.allocation
    spread = min(share - limits.throttle_min, limits.throttle_max - share)
    assert roll.room > 4 * 0.08 * span * spread / 0.001928
