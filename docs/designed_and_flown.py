"""What a design for an autopilot's loops says of the doublet that the autopilot flew, beside what it flew.

The design's own numbers are of one step from rest.  A doublet's sides are steps too, each from where the last had got
to, so a loop that needs longer than a side overshoots by more.  The design's linear loop in the very commands of a
flight is what the flight can be held to.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from pathlib import Path

import numpy as np

from cosim.base.arrays import Array
from cosim.base.storage.toml import merge
from cosim.engine import load_engine
from cosim.results.metrics import axis_metrics, find_steps, overshoot, settling_time
from cosim.results.run import Run
from cosim.simulation.controllers.controller_file import read_controller
from cosim.spec.vehicle import load_vehicle
from hexjet_design.api import firmware_for
from hexjet_design.assessment import shipped_tuning
from hexjet_design.design import identify_there, make_dynamics
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import channels
from hexjet_design.loop.closed_loop import steps_by_response

LEVEL_S = 0.5  # at the end of a side, over which the angle that it has come to is taken
SMALL_DEG = {"roll": 4.0, "yaw": 8.0}
WITHIN = 0.2  # of the design's
SMALL_POINTS, SMALL_S = 2.0, 0.1  # differences of overshoot, % of a step, and of settling, that count as none


def predict(autopilot: str, design: Path, run: Run, axis: str) -> Array:
    """The angle of the design's linear loop in a run's own commands, rad."""
    scenario, setpoint = run.scenario, np.asarray(run.log[f"{axis}_setpoint_rad"])
    vehicle, _ = scenario.resolved_vehicle()
    engine = load_engine(scenario.engine, scenario.engine_parameters, scenario.step_s)
    dynamics = Actuator.of(engine.name, make_dynamics(identify_there(scenario, vehicle, engine, None)))
    channel = channels(scenario, vehicle, engine, dynamics)[axis]
    changes = merge(read_controller(design, scenario.aircraft).vehicle, {"mass_kg": vehicle.mass_kg})
    designed, _ = load_vehicle(scenario.aircraft, changes, str(design))
    settings = [f"engine={scenario.engine}", f"step_s={scenario.step_s}"]
    firmware = replace(firmware_for(autopilot, scenario.aircraft, settings), axis=axis)
    tuning = replace(shipped_tuning(channel, designed, engine), controller="baseline", lead=None, firmware=firmware)
    late = channel.added_delay + firmware.output_delay
    channel = replace(channel, angle_from_gyro=firmware.estimates_attitude, added_delay=late)
    step = steps_by_response(channel, tuning, len(setpoint)).angle
    angle = np.full(len(setpoint), setpoint[0])
    for first in np.flatnonzero(np.diff(setpoint)) + 1:
        angle[first:] += (setpoint[first] - setpoint[first - 1]) * step[: len(setpoint) - first]
    return angle


def as_measured(run: Run, axis: str, angle: Array) -> tuple[float, float | None]:
    """Overshoot, %, and settling, s, by the metrics of a run, if this had been its angle, rad."""
    of = axis_metrics(np.asarray(run.log[f"{axis}_setpoint_rad"]), angle, None, run.scenario.step_s)
    return of.overshoot_percent or 0.0, of.settling_time_s


def about_ends(run: Run, axis: str, angle: Array) -> tuple[float, float | None]:
    """Overshoot, %, and settling, s, of the worst side of a doublet, each about the angle that it has come to.

    So what an estimator takes for level is not in it.
    """
    step, setpoint = run.scenario.step_s, np.asarray(run.log[f"{axis}_setpoint_rad"])
    sides = []
    for side in find_steps(setpoint, setpoint, step):
        error = (setpoint - angle)[side.first : side.end]
        error = error - np.mean(error[-round(LEVEL_S / step) :])
        sides.append((overshoot(error, side.size) or 0.0, settling_time(error, side.size, step)))
    times = [time for _, time in sides if time is not None]
    return max(size for size, _ in sides), max(times) if len(times) == len(sides) else None


def still_doublet(run: Run, axis: str, settling_s: float, whole_microseconds: bool) -> list[str]:
    """Options that make a run's doublet last until it has settled, with still sensors; and small, within all limits.

    ``whole_microseconds``: of outputs that are so coarse, a small doublet would have but a few.
    """
    command = run.scenario.command[0]
    small = command.amplitude if whole_microseconds else SMALL_DEG[axis]
    width = max(command.width_s, float(ceil(1.4 * settling_s)))
    settings = [
        f"command.0.amplitude={small}",
        f"command.0.width_s={width}",
        f"duration_s={command.start_s + 3.0 * width}",
        "sensor_noise=false",
        "vehicle.sensors.accelerometer.bias_m_s2=[0,0,0]",
    ]
    return [word for setting in settings for word in ("--set", setting)]


def agrees(designed: tuple[float, float | None], flown: tuple[float, float | None]) -> bool:
    """Whether overshoot and settling are the design's within :data:`WITHIN`, or nearer than what counts as none."""
    (over, settled), (flown_over, flown_settled) = designed, flown
    if abs(flown_over - over) > max(WITHIN * over, SMALL_POINTS):
        return False
    if settled is None or flown_settled is None:
        return settled is flown_settled
    return abs(flown_settled - settled) <= max(WITHIN * settled, SMALL_S)
