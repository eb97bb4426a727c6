"""By what a tuning of a channel is judged: the objective of a search, and the requirements that its loop must keep."""

from __future__ import annotations

from math import log1p

import numpy as np

from cosim.simulation.controllers.controller_file import Requirements
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.tuning import Tuning

# Fraction of a step by which the overshoot in flight may exceed the computed one, for noise and nonlinearity.
OVERSHOOT_ROOM = 0.10
# Factor on requirements at a corner of the tolerances, where only stability is promised.
CORNER_FACTOR = 2.0
FINE_POINTS = 4000  # frequencies to check a tuning


def objective(closed: ClosedLoop) -> float:
    """Return ``ln`` of the integrated absolute error of a set-point step, plus a third of that of a load step.

    The logarithm needs no units and no sizes of the steps.  At a bandwidth w the first goes with 1/w, the second with
    1/w^3, so the third makes both count as bandwidth.
    """
    return float(np.log(closed.step_error) + np.log(closed.load_error) / 3.0)


def excess(closed: ClosedLoop, need: Requirements, spare: float = 0.0) -> float:
    """Return the sum of the relative excesses over the requirements; 0 where all are met."""
    return sum(max(part, 0.0) for part in excesses(closed, need, spare).values())


def excesses(closed: ClosedLoop, need: Requirements, spare: float = 0.0, step_m: float = 1.0) -> dict[str, float]:
    """Return the relative excess over each requirement; negative if it is met with margin."""
    channel = closed.points.channel
    step = step_m if channel.name == "altitude" else need.step_rad
    tolerated = closed.compute_tolerance(need.delay_samples(channel.transport_samples), need.gain_tolerance)
    largest = need.max_sensitivity * (1.0 - spare)
    return {
        # Far from robust to a misfit there is no sensitivity, but the search still needs a slope.
        "peak sensitivity": closed.peak_sensitivity / largest - 1.0
        if closed.points.unsure is None
        else 1.0 - max(0.0, closed.distance) * largest + log1p(max(0.0, closed.beyond_stability)),
        "tolerances": (1.0 + spare) - tolerated if need.delay_tolerance or need.gain_tolerance else 0.0,
        "noise": closed.noise / (need.noise_share * channel.room * (1.0 - spare)) - 1.0,
        "overshoot": closed.overshoot / (need.max_overshoot * (1.0 - spare)) - 1.0,
        "step size": closed.step_peak * step / (channel.room * (1.0 - spare)) - 1.0,
        "bandwidth": 1.0 + spare - closed.bandwidth / need.min_bandwidth_hz if need.min_bandwidth_hz else 0.0,
    }


def is_acceptable(closed: ClosedLoop, need: Requirements) -> bool:
    """Return whether a loop is stable and within the requirements."""
    return closed.unstable_poles == 0 and excess(closed, need) == 0.0


def fine_loop(channel: Channel, tuning: Tuning) -> ClosedLoop:
    """Return a channel closed with a tuning, at the :data:`FINE_POINTS` points with which a tuning is checked."""
    return ClosedLoop(FrequencyGrid(channel, close=FINE_POINTS), tuning)
