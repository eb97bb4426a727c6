"""The allocation of a vehicle, by what it has or states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import inf
from typing import Any, TypeVar

from cosim.base.protocols import Allocator
from cosim.base.storage.cache import RecentCache
from cosim.control.allocation.allocation import RotorAllocator, TiltAllocator
from cosim.control.allocation.effectiveness import AllocationModel, EffectivenessAllocator, Effector
from cosim.control.allocation.hinged_recovery import EngineLag, HingedRecovery
from cosim.control.allocation.thrust_map import StaticCurve, ThrustMap
from cosim.control.phases.recovery import Recovery
from cosim.engine import EngineSpec
from cosim.simulation.controllers.models import make_thrust_map
from cosim.simulation.engine_reference import make_engine_reference
from cosim.spec.scenario import Environment, Scenario
from cosim.spec.vehicle import Vehicle
from cosim.vehicle.airframe import Airframe
from cosim.vehicle.model_file import read_model

_models: RecentCache[Any] = RecentCache(32)  # results of queries by model
T = TypeVar("T")  # type of a query's result


def make_allocator(
    scenario: Scenario,
    vehicle: Vehicle,
    stations: Sequence[EngineSpec],
    thrust_map: ThrustMap,
    hover: float,
    catch: Recovery | None,
) -> Allocator:
    """Return the allocator of a vehicle, by its actuators or by the allocation that it states."""
    limits = vehicle.control.allocation
    if vehicle.allocation == "effectiveness":
        return _make_effectiveness_allocator(scenario, vehicle, stations, thrust_map)
    if vehicle.servo is None:
        return RotorAllocator(vehicle.jets, limits, hover)
    lift = _throttle_rise(scenario, vehicle, stations) if scenario.monitored and catch is None else inf
    return TiltAllocator(vehicle.jets, limits, vehicle.servo.range_rad, hover, thrust_map.idle, lift)


def make_effectiveness(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec) -> EffectivenessAllocator:
    """Return the allocator by effectiveness of a vehicle with one engine at every station.  Raises InputError."""
    stations = [engine] * len(vehicle.jets)
    thrust_map, _ = make_thrust_map(vehicle, engine, stations)
    return _make_effectiveness_allocator(scenario, vehicle, stations, thrust_map)


def _make_effectiveness_allocator(
    scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec], thrust_map: ThrustMap
) -> EffectivenessAllocator:
    limits, step = vehicle.control.allocation, scenario.step_s
    jets = len(vehicle.jets)
    ends: list[tuple[float, ...]] = []
    for fraction in (limits.throttle_min, limits.throttle_max):
        throttles = thrust_map.throttle((fraction,) * jets)
        curves = [StaticCurve(spec.name, *spec.rising_curve) for spec in stations]
        thrusts = [_thrust_at(curve, u) for curve, u in zip(curves, throttles, strict=True)]
        ends.append(tuple([(thrust - thrust_map.low) / thrust_map.span for thrust in thrusts]))
    # Where a hinge carries engines, all keep its pace: with vanes ahead of slow banks the jetwing turned over.
    layout = vehicle.layout()
    lead_factor = 0.0 if layout.moves else 1.0
    effectors = [
        Effector(
            *hinge.angle_limits,
            hinge.rest_rad,
            hinge.rate_limit_rad_s * step,
            hinge.effort,
            lead=lead_factor * hinge.rate_limit_rad_s * hinge.lag_s,
        )
        for hinge in vehicle.hinges
    ]
    # The vehicle's own JSBSim model tells what each surface does per unit of deflection and Pa.
    effects = query_model("surfaces", scenario, vehicle, Airframe.surface_effects) if vehicle.surfaces else []
    effectors += [
        Effector(*surface.range, 0.0, surface.rate_limit_1_s * step, surface.effort, effect)
        for surface, effect in zip(vehicle.surfaces, effects, strict=True)
    ]
    model = AllocationModel(
        vehicle.name,
        layout,
        vehicle.mass_kg,
        vehicle.tensor,
        thrust_map.low,
        thrust_map.span,
        list(zip(*ends, strict=True)),
        [jet.effort for jet in vehicle.jets],
        effectors,
        limits.horizontal,
    )
    lag = _recovery_lag(scenario, vehicle, stations)
    return EffectivenessAllocator(model) if lag is None else HingedRecovery(model, lag)


def _recovery_lag(scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec]) -> EngineLag | None:
    """Return the engines' lag for the recovery after an engine loss; None if the vehicle has none.

    A throttle has acted after the delay and a third of the lag, by when an engine is well on its way: chosen by us.
    """
    monitor = vehicle.control.monitor
    if not scenario.monitored or monitor is None or not monitor.catch:
        return None
    references = [make_engine_reference(spec, scenario.step_s) for spec in stations]
    delay, lag = max(reference.delay for reference in references), max(reference.lag for reference in references)
    return EngineLag(delay + lag / 3.0, scenario.step_s)


def query_model(what: str, scenario: Scenario, vehicle: Vehicle, query: Callable[[Airframe], T]) -> T:
    """Return what ``query`` reads from the vehicle's JSBSim model, cached per vehicle and model."""
    _, folder = scenario.resolved_vehicle()
    model = None if vehicle.model is None else read_model(folder / vehicle.model)

    def query_airframe() -> T:
        frame = Airframe(vehicle, folder, Environment(), scenario.step_s, 1, 0)
        try:
            return query(frame)
        finally:
            frame.close()

    answer: T = _models.get((what, model, vehicle.model_dump_json(), scenario.step_s), query_airframe)
    return answer


def _thrust_at(curve: StaticCurve, throttle: float) -> float:
    """Return the thrust at rest [N], linear between the points of the curve."""
    for (u, v), (f, g) in zip(pairwise(curve.throttle), pairwise(curve.thrust), strict=True):
        if throttle <= v:
            return f + (g - f) * (throttle - u) / (v - u)
    return curve.thrust[-1]


def _throttle_rise(scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec]) -> float:
    """Return the largest throttle rise per step with which height lost with an engine is recovered.

    From least to most in no less than the longest lag of the engines: told to go faster they are at the limit of their
    acceleration, all alike, and what roll asks for between them is lost.
    """
    limits, step = vehicle.control.allocation, scenario.step_s
    longest = max(make_engine_reference(spec, step).longest for spec in stations)
    return (limits.throttle_max - limits.throttle_min) * step / max(longest, step)
