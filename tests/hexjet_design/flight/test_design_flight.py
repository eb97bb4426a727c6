"""What hexjet design wrote for every engine of the library, flown in six degrees of freedom."""

from __future__ import annotations

from math import ceil, pi, radians
from typing import Any

import numpy as np
import pytest
from places import DESIGNS

from cosim import fly
from cosim.engine import list_engine_names
from cosim.simulation.controllers.controller_file import apply_controller, read_controller
from cosim.spec.vehicle import load_vehicle

ENGINES = sorted(path.stem for path in DESIGNS.glob("*.toml"))


def flown(engine: str, scenario: str, *settings: str) -> Any:
    path = DESIGNS / f"{engine}.toml"
    made = read_controller(path).design
    given = [f'engine="{made.engine}"', f"step_s={made.step_s}", *settings]
    return fly(apply_controller(scenario, path, given, made.aircraft))


def test_every_engine_of_the_library_has_a_design() -> None:
    # a form to be fitted to a bench log: no engine of its own; one whose thrust is not known and nobody has flown
    without = ["fitted", "jetcat-p300"]
    assert sorted(list_engine_names()) == sorted([*ENGINES, *without])


@pytest.mark.parametrize("engine", ENGINES)
def test_a_design_flies_the_roll_doublet(engine: str) -> None:
    """A side of the doublet lasts 3 s, or twenty time constants of a loop that is slower; it has arrived at its end.

    5 % of the largest change of the set-point, 20 deg: what a settling time is counted to.
    """
    made = read_controller(DESIGNS / f"{engine}.toml").design
    width = max(3.0, ceil(20.0 / (2.0 * pi * made.axes["roll"].bandwidth_hz)))
    run = flown(engine, "roll-doublet", f"command.0.width_s={width}", f"duration_s={1.0 + 4.0 * width}")
    assert run.outcome == "completed"
    roll = run.metrics["roll"]
    assert roll.overshoot_percent < 25.0
    assert roll.oscillation_rad < 0.05 * radians(20.0)
    time, error = run.log["time_s"], np.abs(run.log["roll_rad"] - run.log["roll_setpoint_rad"])
    for side in (1, 2, 3):
        end = 1.0 + side * width
        assert error[(time > end - 0.2 * width) & (time < end - 0.02)].max() < 0.05 * radians(20.0)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("axis", ["pitch", "yaw"])
def test_a_design_flies_the_other_doublets(engine: str, axis: str) -> None:
    """The doublet of the vehicle's size: by Froude's law a side is 1.5 times as long at full scale."""
    scaled = read_controller(DESIGNS / f"{engine}.toml").design.aircraft in ("hexjet-p220", "hexjet-100")
    run = flown(engine, f"full-scale-{axis}-doublet" if scaled else f"{axis}-doublet")
    assert run.outcome == "completed"
    metrics = run.metrics[axis]
    assert metrics.overshoot_percent < 30.0
    assert abs(metrics.final_error_rad) < 0.02
    assert metrics.oscillation_rad < 0.01


@pytest.mark.parametrize("share", [0.7, 1.3])
@pytest.mark.parametrize("later", [18, 32])
def test_a_design_survives_its_tolerances_in_flight(share: float, later: int) -> None:
    """30 % of gain and of delay either way, set on the engine; the controller is not told."""
    run = flown(
        "edf-as-flown",
        "roll-doublet",
        f"engine_parameters.delay_samples={later}",
        # thrust 30 % off would change the hover throttle; the moment is 30 % off where the inertia is
        f"vehicle.inertia_kg_m2=[{0.041571 / share}, 0.052, 0.070]",
    )
    assert run.outcome == "completed"
    assert run.metrics["roll"].oscillation_rad < 0.02


def growth(engine: str, seconds: float, *settings: str) -> float:
    """From a degree of roll without noise: the largest roll of the flight's last sixth over that of the second.

    A flight that is lost grew.
    """
    path = DESIGNS / f"{engine}.toml"
    made = read_controller(path).design
    given = [f'engine="{made.engine}"', f"step_s={made.step_s}", f"duration_s={seconds}", "sensor_noise=false",
             "initial.attitude_deg=[1.0, 0.0, 0.0]", *settings]  # fmt: skip
    run = fly(apply_controller("hover", path, given, made.aircraft))
    if run.outcome != "completed":
        return 10.0
    roll = np.abs(run.log["roll_rad"])
    part = len(roll) // 6
    return float(roll[-part:].max() / roll[part : 2 * part].max())


@pytest.mark.parametrize("engine", ["turbojet", "edf-as-flown", "p220"])
@pytest.mark.parametrize(("share", "grows"), [(0.95, False), (1.05, True)])
def test_a_flight_flips_at_the_delay_margin(engine: str, share: float, grows: bool) -> None:
    """Whole samples, to the inside or outside of 5 % off what the file states; the engine alone is told."""
    made = read_controller(DESIGNS / f"{engine}.toml").design
    margin = made.axes["roll"].delay_margin_s
    assert margin is not None
    later = share * margin / made.step_s
    samples = (0 if engine == "p220" else 25) + (ceil(later) if grows else int(later))
    assert (growth(engine, 30.0, f"engine_parameters.delay_samples={samples}") > 1.0) == grows


@pytest.mark.parametrize("engine", ["edf", "p220", "turbojet", "edf-as-flown"])
@pytest.mark.parametrize(("share", "grows"), [(1.05, False), (0.95, True)])
def test_a_flight_flips_at_the_lower_gain_margin(engine: str, share: float, grows: bool) -> None:
    """5 % above and below the edge.  Where there is no predictor, P, I and D are changed; where there is, the lever of the
    jets, of which the predictor does not know, and yaw's gains the other way.

    Fuel burns meanwhile; the gains are held.
    """
    file = read_controller(DESIGNS / f"{engine}.toml")
    margin = file.design.axes["roll"].gain_margin_down_db
    assert margin is not None
    factor = share * 10.0 ** (margin / 20.0)
    rate = file.vehicle["control"]["rate"]
    if file.controller == "baseline":
        changed = [f"vehicle.control.rate.roll.{key}={factor * rate['roll'][key]}" for key in "pid"]
    else:
        places = [jet.position_m for jet in load_vehicle(file.design.aircraft)[0].jets]
        changed = [f"vehicle.jets.{k}.position_m=[{x}, {factor * y}, {z}]" for k, (x, y, z) in enumerate(places)]
        changed += [f"vehicle.control.rate.yaw.{key}={rate['yaw'][key] / factor}" for key in "pid"]
    changed += ["vehicle.control.schedule=false"] if engine == "p220" else []
    # the fan without a predictor is at the limits of its throttle after ten seconds, and grows no further
    assert (growth(engine, 12.0 if engine == "edf" else 60.0, *changed) > 1.0) == grows
