"""Flights of a batch to their ends: which ended early, which are not to be judged, and the log of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import cos, hypot, radians
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Flags
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.frames import from_euler
from cosim.base.signals import ZERO3
from cosim.base.signals import State as FlownState
from cosim.simulation.ending import Ending, TerminationCheck
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Limits
from cosim.vehicle.airframe import start_height
from hexjet_batch.log import BatchLog, FlightLog, state_values
from hexjet_batch.make import Known, read_flight
from hexjet_batch.numbers import Numbers, describe, is_absent, stack
from hexjet_batch.script import Script, find_mode
from hexjet_batch.stages.airframe import Motion
from hexjet_batch.stages.predictors import mix
from hexjet_batch.stages.rotations import to_euler
from hexjet_batch.stages.sensors import Noise
from hexjet_batch.stages.step import altitude_of, start, step


class BatchFlight(NamedTuple):
    """A flight of a batch: its index among the scenarios, how it ended, and its log.

    ``ending`` is None where it is not to be judged here, for the ``reason``: it is to be flown by JSBSim.
    """

    number: int
    ending: Ending | None
    log: FlightLog
    reason: str = ""


class Group(NamedTuple):
    """Flights that flew together: their indices among the scenarios (None: a copy), scenarios, numbers, rows, log.

    ``endings`` has those that did not fly to the end: rows, ending, values of one more row, and the reason.
    """

    numbers: Sequence[int | None]
    scenarios: Sequence[Scenario]
    n: Numbers
    rows: int
    log: BatchLog
    endings: dict[int, tuple[int, Ending | None, Any, str]]

    def flight(self, i: int) -> BatchFlight:
        """Return flight ``i`` of the group."""
        completed = self.rows, Ending("completed", f"flew {self.rows} steps"), None, ""
        rows, ending, last, why = self.endings.get(i, completed)
        return BatchFlight(self.numbers[i] or 0, ending, FlightLog(self.log.tables, i, rows, last), why)


def fly_batch(scenarios: Sequence[Scenario], together: int = 1024) -> Iterator[BatchFlight]:
    """Fly scenarios on arrays and yield each flight, in the order of those that can be flown together.

    ``together``: flights in the memory at once, enough for the overhead of a step to vanish.  Raises InputError for
    what a batch does not cover.
    """
    if together < 1:
        raise InputError(f"together = {together}: a batch has at least 1 flight")
    for first in range(0, len(scenarios), together):
        for group in fly_groups(scenarios[first : first + together]):
            for i, number in enumerate(group.numbers):
                if number is not None:
                    yield group.flight(i)._replace(number=first + number)


def fly_groups(
    scenarios: Sequence[Scenario], memory: Any = None, known: Known | None = None, *, are_covered: bool = True
) -> Iterator[Group]:
    """Fly scenarios and yield those of one structure together.

    ``memory``: where logs are kept for the next; ``known``: what flights share; not ``are_covered``: leave others out.
    """
    groups: dict[Any, dict[Any, list[Any]]] = {}
    known = Known(1024) if known is None else known
    for number, scenario in enumerate(scenarios):
        try:
            own, limits = read_flight(scenario, known), scenario.resolved_vehicle()[0].limits
        except InputError:
            if are_covered:
                raise
            continue
        structure = own.structure, describe((own.engine, own.needs_air, own.airflow, own.flown.fuel))
        key = structure, scenario.steps, scenario.sensor_noise, str(limits), str(find_mode(scenario))
        groups.setdefault(key, {}).setdefault(own.kind, []).append((number, scenario, own))
    for kinds in groups.values():
        yield _fly_group(list(kinds.values()), memory)


def _fly_group(kinds: Sequence[list[Any]], memory: Any) -> Group:
    """Fly scenarios of one structure, those whose predictors are of one kind side by side."""
    for own in kinds:
        # Sums over arrays of one flight have another order: it flies with a copy, which nobody reads.
        own += [(None, *own[0][1:])] * (len(own) == 1)
    numbers, scenarios, each = zip(*(flight for own in kinds for flight in own), strict=True)
    predictors = [stack([flight.predictors for _, _, flight in own]) for own in kinds]
    n = stack([flight.replace(predictors=None, kind=None) for flight in each])
    n = n.replace(predictors=mix(predictors, [*map(len, kinds)]))
    n, script, noise, heights, lowest, limits, motion = prepare(scenarios, n)
    rows = scenarios[0].steps
    log = BatchLog(scenarios, rows, n.jets, {} if memory is None else memory)
    flies = np.array([number is not None for number in numbers])
    endings: dict[int, tuple[int, Ending | None, Any, str]] = dict.fromkeys(np.flatnonzero(~flies), (0, None, None, ""))
    with np.errstate(all="ignore"):  # lost flights go on to infinity
        state = start(n, motion, heights, script.at(0)[1])
        for k in range(rows):
            command, inputs = script.at(k)
            if noise is not None:
                inputs = inputs._replace(draws=noise.at(k))
            state, outputs = step(n, state, inputs)
            log.add(command, inputs, outputs)
            altitude, out = altitude_of(state), outputs.report.out
            goes_on = is_within(limits, state.motion) & (altitude > lowest)
            burns = ~np.any(np.atleast_2d(out) > 0.0, axis=0) if np.ndim(out) else np.ones_like(goes_on)
            if (goes_on := goes_on & burns).all():
                continue
            for i in np.flatnonzero(flies & ~goes_on).tolist():
                flies[i] = False
                if not burns[i] or altitude[i] <= lowest[i]:
                    why = "near the ground" if altitude[i] <= lowest[i] else "an engine went out"
                    endings[i] = k + 1, None, None, why
                else:
                    endings[i] = k + 1, *_find_ending(state.motion, altitude[i], i, limits, (k + 1) * n.step), ""
            if not flies.any():
                break
    log.finish()
    return Group(numbers, scenarios, n, rows, log, endings)


def prepare(
    scenarios: Sequence[Scenario], numbers: Numbers | None = None
) -> tuple[Numbers, Script, Noise | None, Any, Any, Limits, Motion]:
    """Return what flies scenarios of one structure; ``numbers``: of all, where they are known.

    After the noise: the heights of the start, those below which a flight is not judged [m], limits, first motion.
    """
    known = Known(64)
    n = stack([read_flight(scenario, known) for scenario in scenarios]) if numbers is None else numbers
    vehicles = [scenario.resolved_vehicle()[0] for scenario in scenarios]
    heights = [start_height(vehicle, s.initial) for vehicle, s in zip(vehicles, scenarios, strict=True)]
    noise = None
    if scenarios[0].sensor_noise:
        noise = Noise([s.seed for s in scenarios], not is_absent(n.sensors.attitude.ahrs_time_constant_s))
    # Nothing but the air may act: contacts are this far from the ground whatever the attitude.
    lowest = 0.5 + np.array([max(hypot(*contact.position_m) for contact in v.contacts) for v in vehicles])
    motion = _start_motion(scenarios, heights)
    return n, Script(scenarios, heights), noise, np.array(heights), lowest, vehicles[0].limits, motion


def is_within(limits: Limits, motion: Motion) -> Flags:
    """Return which flights neither lean nor turn beyond the limits, nor are lost: comparisons with NaN are false."""
    _, x, y, _ = motion.attitude
    most = np.maximum(np.maximum(abs(motion.rate[0]), abs(motion.rate[1])), abs(motion.rate[2]))
    upright = 1.0 - 2.0 * (x * x + y * y) >= cos(radians(limits.tilt_deg))
    return np.asarray(upright & (most < radians(limits.rate_deg_s)))


def _start_motion(scenarios: Sequence[Scenario], heights: Sequence[float]) -> Motion:
    """Return the motion of the flights at their start."""
    flights = [
        ((0.0, 0.0, -height), at.velocity_ned_m_s, from_euler(*map(radians, at.attitude_deg)),
         tuple(map(radians, at.rate_deg_s)), (0.0, 0.0, 0.0), (0.0, 0.0, -GRAVITY))
        for at, height in zip((scenario.initial for scenario in scenarios), heights, strict=True)
    ]  # fmt: skip
    return Motion(*(tuple(np.array(part).T) for part in zip(*flights, strict=True)))


def _find_ending(motion: Motion, altitude: float, i: int, limits: Limits, now: float) -> tuple[Ending, dict[str, Any]]:
    """Return how the state of flight ``i`` ended it, and the values of that state."""
    at: Any = Motion(*(tuple(float(part[i]) for part in vector) for vector in motion))
    euler: Any = tuple(float(angle) for angle in to_euler(at.attitude, np))
    height = float(altitude)
    state = FlownState(
        at.position, at.velocity, at.attitude, euler, at.rate, at.force, height, ZERO3, 0.0, False, False
    )
    ending = TerminationCheck(limits).check(state, now) or Ending("failed", f"the state is not finite at {now:.3f} s")
    return ending, state_values(at, height)
