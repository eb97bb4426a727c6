"""What is asked of a batch and what acts on it, step by step, from the scripts of its scenarios."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Any

import numpy as np

from cosim.base.signals import Command, Disturbance
from cosim.simulation.script.command_script import CommandScript
from cosim.simulation.script.disturbance_script import DisturbanceScript
from cosim.spec.scenario import GustDisturbance, Scenario
from hexjet_batch.numbers import Numbers, name_values, stack
from hexjet_batch.stages.rotations import Quaternion, Vector, add, from_euler
from hexjet_batch.stages.step import Inputs


class Script:
    """Commands and disturbances of the flights of a batch.

    Where all flights have the same ones they are read once a step; else each flight's own, at the steps at which any
    may change.
    """

    def __init__(self, scenarios: Sequence[Scenario], heights: Sequence[float]) -> None:
        first = scenarios[0]
        self._step = first.step_s
        self._changes: set[int] | None = None
        pairs = list(zip(scenarios, heights, strict=True))
        if all(_asked(scenario) == _asked(first) for scenario in scenarios) and len(set(heights)) == 1:
            pairs = pairs[:1]
        else:
            self._changes = set().union(*(_find_changes(scenario) for scenario in scenarios))
        self._commands = [CommandScript(scenario, height) for scenario, height in pairs]
        self._disturbances = [DisturbanceScript(scenario) for scenario, _ in pairs]
        self._has_payload = any(entry.kind == "payload" for scenario in scenarios for entry in scenario.disturbance)
        self._gusts = _read_gusts([scenario for scenario, _ in pairs])
        self._last: tuple[Command, Disturbance] | None = None
        self._payload: Any = None
        self._setpoint: tuple[Any, Quaternion] = (None, (1.0, 0.0, 0.0, 0.0))

    def at(self, k: int) -> tuple[Command, Inputs]:
        """Return the command of step ``k`` and all that acts in it; ``k`` must follow the last step asked for."""
        if self._last is None or self._changes is None or k in self._changes:
            command = stack([script.at(k) for script in self._commands])
            acting = stack([script.at(k)._replace(gust=None) for script in self._disturbances])
            # The same object as long as it stays: the mass is that of the step before then.
            if self._has_payload and not (
                self._last and all(map(np.array_equal, acting.payload, self._last[1].payload))
            ):
                self._payload = acting.payload[0], tuple(acting.payload[1:])
            self._last = command, acting
        command, acting = self._last
        if command.attitude is not self._setpoint[0]:
            roll, pitch, yaw = map(np.asarray, command.attitude)
            self._setpoint = command.attitude, from_euler(roll, pitch, yaw, np)
        return command, Inputs(
            k, self._setpoint[1], command.altitude, command.rate, command.collective, acting.force, acting.moment,
            acting.torque_command, acting.torque_output, acting.torque_seen, self._wind(k, acting.wind),
            self._payload,
        )  # fmt: skip

    def _wind(self, k: int, steady: Vector) -> Vector:
        """Return the wind in the middle of a step, with the gust that blows: a cosine up, a time, a cosine down."""
        for gust in self._gusts:
            t = (k - gust.begin + 0.5) * self._step
            up = np.clip(t / gust.rise_s, 0.0, 1.0)
            down = np.clip((t - gust.rise_s - gust.hold_s) / gust.fall_s, 0.0, 1.0)
            # A gust ends at once (``gust.end``) when a later one begins.
            share = 0.25 * (1.0 - np.cos(pi * up)) * (1.0 + np.cos(pi * down)) * (k < gust.end)
            if np.any(share):
                steady = add(steady, gust.velocity_ned_m_s, share)
        return steady


def _read_gusts(scenarios: Sequence[Scenario]) -> list[Any]:
    """Return the first, second and further gust of the flights; those of a flight that has less blow at nothing."""
    flights = []
    for scenario in scenarios:
        entries = [entry for entry in scenario.disturbance if isinstance(entry, GustDisturbance)]
        entries.sort(key=lambda entry: entry.start_s)
        begins = [scenario.count(entry.start_s, "start_s") for entry in entries]
        gusts = [name_values(entry.model_dump(exclude={"kind", "start_s"})) for entry in entries]
        ends = [*begins[1:], scenario.steps][: len(begins)]
        flights.append([gust.replace(begin=a, end=b) for gust, a, b in zip(gusts, begins, ends, strict=True)])
    none = Numbers(velocity_ned_m_s=(0.0, 0.0, 0.0), rise_s=1.0, hold_s=0.0, fall_s=1.0, begin=0, end=0)
    most = max(len(gusts) for gusts in flights)
    return [stack(column) for column in zip(*(gusts + [none] * (most - len(gusts)) for gusts in flights), strict=True)]


def find_mode(scenario: Scenario) -> tuple[Any, ...]:
    """Return what flights must share to be asked together: rates or angles, and from when on a collective."""
    signals = find_signals(scenario)
    # A table may ask for a collective; when any begins is as the script says it.
    return signals, scenario.command if "collective" in signals else None


def find_signals(scenario: Scenario) -> list[str]:
    """Return the signals that a scenario commands; of a table those of its file."""
    if any(entry.kind in ("table", "sticks") for entry in scenario.command):
        return CommandScript(scenario, 0.0).signals
    return sorted({entry.signal for entry in scenario.command if hasattr(entry, "signal")})


def _asked(scenario: Scenario) -> tuple[Any, ...]:
    """Return the part of a scenario that a script is made from."""
    wind, centre = scenario.environment.wind_ned_m_s, scenario.mismatch.centre_m
    payload = centre if scenario.disturbance else None
    return scenario.command, scenario.disturbance, scenario.initial, wind, payload, scenario.duration_s


def _find_changes(scenario: Scenario) -> set[int]:
    """Return the steps at which a script's commands may change: every step, of what moves from step to step."""
    times = [0.0]
    for entry in (*scenario.command, *scenario.disturbance):
        if entry.kind in ("ramp", "sweep", "table", "sticks") or getattr(entry, "shape", "") == "sweep":
            return set(range(scenario.steps))
        length = getattr(entry, "duration_s", None) or 0.0
        times += [entry.start_s, entry.start_s + length / 2.0, entry.start_s + length]
    return {round(time / scenario.step_s) for time in times}
