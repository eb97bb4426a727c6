"""A recorded flight flown again by its set-points: the vehicle with its controller, from the recorded start on.

A controller hides what is wrong with a vehicle, and the one here may not be the one that flew: whether the whole
answers its set-points as recorded can be said, what is at fault cannot.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cosim.base.errors import InputError
from cosim.base.signals import Command
from cosim.simulation.build import build
from hexjet_identify.replay.flown import LOWEST_M, UNKNOWN_M, Change, Flown, Model, Starts, Window
from hexjet_identify.replay.recorded import RecordedFlight
from hexjet_identify.replay.windows import Flying, measure_noise


def cut_whole(model: Model, flight: RecordedFlight, length_s: float) -> Flying:
    """Cut the longest part of a flight without a gap into windows in which both are compared."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flight.usable.astype(int), [0]])))
    begin, end = max(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True), key=lambda part: part[1] - part[0])
    part = slice(begin, end)
    assert flight.setpoints is not None
    signals = ("times", "rate", "force", "angles", "velocity", "altitude", "usable", "setpoints")
    whole = replace(flight, **{name: getattr(flight, name)[part] for name in signals})
    rows = max(round(length_s / flight.step), 4)
    windows = tuple(Window(first, first + rows) for first in range(0, end - begin - 1 - rows, rows))
    if len(windows) < 2:
        raise InputError(f"{(end - begin) * flight.step:.2g} s of set-points without a gap are less than two windows")
    nothing = np.zeros((len(windows), 3))
    return Flying(whole, windows, Starts(nothing, nothing, nothing), measure_noise(model, whole, whole.usable))


def fly_setpoints(model: Model, flight: RecordedFlight, change: Change) -> Flown:
    """Fly the set-points of a flight from its recorded start.  Raises FlightError and InputError as a flight."""
    assert flight.setpoints is not None
    angles, rate, velocity = (np.nan_to_num(values[0]) for values in (flight.angles, flight.rate, flight.velocity))
    height = np.where(np.isfinite(flight.altitude), flight.altitude, UNKNOWN_M)
    wanted = flight.setpoints
    heights = wanted[:, 3] if wanted.shape[1] > 3 else height
    initial: dict[str, Any] = {
        "on_ground": False,
        "altitude_m": max(float(height[0]), LOWEST_M),
        "attitude_deg": np.degrees(angles).tolist(),
        "velocity_ned_m_s": velocity.tolist(),
        "rate_deg_s": np.degrees(rate).tolist(),
    }
    steps = len(flight.times)
    inertia = [factor * value for factor, value in zip(change.inertia, model.vehicle.inertia_kg_m2, strict=True)]
    mismatch: dict[str, Any] = {"mass_factor": change.mass, "thrust_factor": change.thrust}
    if change.parameters:
        mismatch["engine_parameters"] = dict(change.parameters)
    scenario = model.scenario.replace(
        initial=initial,
        vehicle={"inertia_kg_m2": inertia},
        mismatch=mismatch,
        duration_s=steps * flight.step,
        command=[],
        fault=[],
    )
    flown = Flown(*(np.full((steps, 3), np.nan) for _ in Flown._fields))
    level = float(heights[0]) - initial["altitude_m"] if float(height[0]) < LOWEST_M else 0.0
    with build(scenario) as simulation:
        model.engine = model.engine or simulation.engine
        simulation.reset()
        for k, (row, up) in enumerate(zip(wanted[:, :3].tolist(), heights.tolist(), strict=True)):
            sample = simulation.step(Command((row[0], row[1], row[2]), up - level))
            measured, state = sample.measured, sample.state
            flown.rate[k], flown.force[k] = measured.rate, measured.specific_force
            flown.angles[k], flown.velocity[k] = state.euler, state.velocity
    return flown
