"""What acts on the vehicle from outside, step by step."""

from __future__ import annotations

from operator import sub

from cosim.base.errors import InputError
from cosim.base.signals import AXES, ZERO3, Disturbance, Vector3
from cosim.simulation.script.command_script import Waveform, make_doublet, make_pulse, make_sweep
from cosim.spec.scenario import (
    ForceDisturbance,
    GustDisturbance,
    MomentDisturbance,
    PayloadDisturbance,
    Scenario,
    TorqueCommandDisturbance,
    WindDisturbance,
)

Payload = tuple[float, float, float, float]


class DisturbanceScript:
    """Sum of a scenario's disturbances at every control step; the same object while unchanged."""

    def __init__(self, scenario: Scenario) -> None:
        self._forces: list[tuple[Waveform, Vector3]] = []
        self._moments: list[tuple[Waveform, Vector3]] = []
        self._winds: list[tuple[Waveform, Vector3]] = []
        self._torques: list[tuple[int, Waveform]] = []  # added at the actuators
        self._outputs: list[tuple[int, Waveform]] = []  # added to the controller's output
        self._seen: list[tuple[int, Waveform]] = []
        self._payloads: list[tuple[Waveform, Payload]] = []
        self._gusts: dict[int, tuple[Vector3, float, float, float]] = {}
        self._steady_wind = scenario.environment.wind_ned_m_s
        for index, entry in enumerate(scenario.disturbance):
            where = f"disturbance.{index}"
            start = scenario.count(entry.start_s, f"{where}.start_s")
            if isinstance(entry, GustDisturbance):
                self._add_gust(entry, start, where)
                continue
            end = None
            if entry.duration_s is not None:
                end = start + scenario.count(entry.duration_s, f"{where}.duration_s")
            on = make_pulse(start, end, 1.0)
            if isinstance(entry, ForceDisturbance):
                self._forces.append((on, entry.force_n))
            elif isinstance(entry, MomentDisturbance):
                self._moments.append((on, entry.moment_n_m))
            elif isinstance(entry, WindDisturbance):
                self._winds.append((on, entry.velocity_ned_m_s))
            elif isinstance(entry, PayloadDisturbance):
                # Relative to the actual centre of gravity, where the airframe's body axes begin.
                x, y, z = map(sub, entry.offset_m, scenario.mismatch.centre_m)
                self._payloads.append((on, (entry.mass_kg, x, y, z)))
            else:
                assert end is not None
                torque = AXES.index(entry.axis), _torque_wave(entry, scenario, start, end - start, where)
                (self._torques if entry.at == "actuators" else self._outputs).append(torque)
                if entry.seen:
                    self._seen.append(torque)
        self._parts: tuple[object, ...] | None = None
        self._last = Disturbance()
        self._calm = not scenario.disturbance

    def _add_gust(self, entry: GustDisturbance, start: int, where: str) -> None:
        if start in self._gusts or not any(entry.velocity_ned_m_s):
            raise InputError(f"{where}: a gust needs a velocity, and a start_s of its own")
        self._gusts[start] = (entry.velocity_ned_m_s, entry.rise_s, entry.hold_s, entry.fall_s)

    def at(self, k: int) -> Disturbance:
        """Return the disturbance held over step ``k``."""
        if self._calm and self._parts:
            return self._last
        parts = (
            _sum_vectors(self._forces, k),
            _sum_vectors(self._moments, k),
            _sum_torques(self._torques, k),
            _sum_vectors(self._winds, k, self._steady_wind),
            self._total_payload(k),
            self._gusts.get(k),
            _sum_torques(self._outputs, k),
            _sum_torques(self._seen, k),
        )
        if parts != self._parts:
            self._parts = parts
            self._last = Disturbance(*parts)
        return self._last

    def _total_payload(self, k: int) -> Payload:
        """Return all payloads on board as one point mass at their common centre."""
        mass = x = y = z = 0.0
        for on, (m, px, py, pz) in self._payloads:
            if on(k):
                mass, x, y, z = mass + m, x + m * px, y + m * py, z + m * pz
        return (mass, x / mass, y / mass, z / mass) if mass else (0.0, 0.0, 0.0, 0.0)


def _sum_torques(entries: list[tuple[int, Waveform]], k: int) -> Vector3:
    if not entries:
        return ZERO3
    total = [0.0, 0.0, 0.0]
    for axis, wave in entries:
        total[axis] += wave(k)
    return (total[0], total[1], total[2])


def _sum_vectors(entries: list[tuple[Waveform, Vector3]], k: int, start: Vector3 = ZERO3) -> Vector3:
    if not entries:
        return start
    x, y, z = start
    for on, (a, b, c) in entries:
        if on(k):
            x, y, z = x + a, y + b, z + c
    return (x, y, z)


def _torque_wave(entry: TorqueCommandDisturbance, scenario: Scenario, start: int, length: int, where: str) -> Waveform:
    if entry.shape == "sweep":
        return make_sweep(scenario.step_s, start, length, entry.amplitude, entry.from_hz, entry.to_hz)
    if entry.shape == "doublet":
        if length % 2:
            raise InputError(f"{where}.duration_s: a doublet needs an even number of {scenario.step_s:g} s steps")
        return make_doublet(start, length // 2, entry.amplitude)
    return make_pulse(start, start + length, entry.amplitude)
