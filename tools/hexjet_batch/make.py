"""The numbers of flights, from the same scenarios that JSBSim flies, and what a batch does not cover."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from math import cos, exp, radians, sin
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.geodesy import gravity
from cosim.base.signals import AXES
from cosim.base.storage.cache import RecentCache
from cosim.control.allocation.allocation import RotorAllocator, TiltAllocator
from cosim.control.lead import Lead
from cosim.control.predictors.registry import PREDICTORS
from cosim.control.schedule import SCHEDULE_RESOLUTION, GainSchedule
from cosim.engine import EngineSpec, find_source
from cosim.simulation.controllers.models import make_predictors, make_thrust_map
from cosim.simulation.engines import flown_engines, load_engines
from cosim.simulation.script.mismatch import apply_mismatch, compute_engine_mismatch
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Schedule, Vehicle, load_vehicle
from cosim.vehicle.airframe import start_height
from cosim.vehicle.atmosphere import standard_density
from hexjet_batch.numbers import Numbers, describe, name_values
from hexjet_batch.script import find_signals
from hexjet_batch.stages.engines import P220, DelayedLag, Fitted
from hexjet_batch.stages.loops import ScheduleNumbers
from hexjet_batch.stages.predictors import read_predictor
from hexjet_batch.stages.turbine import Turbine

Known = RecentCache[Any]
# The kind of each engine of the library.
KINDS: dict[str, Any] = {
    **dict.fromkeys(("turbojet", "edf", "edf-as-flown", "motor"), DelayedLag()),
    "fitted": Fitted(),
    **dict.fromkeys(("turbine-20", "turbine-100", "turbine-220", "jetcat-p300"), Turbine()),
    "p220": P220(),
}


@cache
def _is_shipped(model: Path) -> bool:
    """Return whether a JSBSim model is the Hex-Jet's or the quadrotor's, whose aerodynamics are those of here."""
    folders = {name: load_vehicle(name)[1] for name in ("hexjet", "quadrotor")}
    return model.read_bytes() in [(folder / f"{name}.xml").read_bytes() for name, folder in folders.items()]


_GUIDED = ("place", "velocity", "waypoints", "track")  # kinds of guided commands
# What a batch does not fly, and how it is seen in a scenario and its vehicle.
REFUSED: dict[str, Callable[[Scenario, Vehicle], Any]] = {
    "an autopilot (`requests`)": lambda s, v: s.requests is not None,
    "places, velocities, waypoints and tracks, which the position law flies": lambda s, v: any(
        entry.kind in _GUIDED for entry in s.command
    ),
    "a JSBSim model of one's own (`model`)": lambda s, v: (
        v.model and not _is_shipped(s.resolved_vehicle()[1] / v.model)
    ),
    "a speed ahead on a wing": lambda s, v: "ahead_m_s" in find_signals(s),
    "hinges, surfaces and jets that do not point up": lambda s, v: v.allocation == "effectiveness",
    "jets with an airflow of their own": lambda s, v: any(jet.airflow is not None for jet in v.jets),
    "banks that are not balanced (`bank_imbalance_kg_m`)": lambda s, v: v.servo and v.servo.bank_imbalance_kg_m,
    "a ground effect": lambda s, v: v.ground_effect and (v.ground_effect.suckdown or v.ground_effect.hot_gas),
    "a start on the ground": lambda s, v: s.initial.on_ground,
    "a start above 10 km": lambda s, v: s.environment.ground_m + s.initial.altitude_m > 10_000.0,
    "faults": lambda s, v: s.fault,
    "the engine monitor": lambda s, v: s.monitored,
    "turbulence": lambda s, v: s.environment.turbulence_severity,
    "a wind over place and time (`wind`)": lambda s, v: s.wind,
    "sensors, metrics and observers of one's own": lambda s, v: s.sensor_plugin or s.metrics or s.observers,
    "a controller of one's own": lambda s, v: s.controller not in PREDICTORS,
}


def read_flight(scenario: Scenario, known: Known | None = None) -> Numbers:
    """Return the numbers of a flight; ``known`` keeps what flights share.  Raises InputError for what is refused."""
    vehicle, where, known = scenario.resolved_vehicle()[0], f"scenario {scenario.name}", known or Known(64)
    for what, is_there in REFUSED.items():
        if is_there(scenario, vehicle):
            raise InputError(f"{where}: {what}: not flown in a batch; fly it without batch")
    flown = apply_mismatch(vehicle, scenario.mismatch)
    factors, late = compute_engine_mismatch(scenario.mismatch, len(vehicle.jets))
    height = scenario.environment.ground_m + start_height(vehicle, scenario.initial)
    key = scenario.folder, height, scenario.model_dump_json(include=_ASKED), vehicle.model_dump_json(include=_BELIEVED)
    stations, laws = known.get(key, lambda: _read_laws(scenario, vehicle))
    differs = scenario.mismatch.model_dump_json(include={"engine_parameters", "stations", "delay_samples"})
    places = tuple(jet.position_m for jet in flown.jets)

    def make() -> tuple[Numbers, bool, Numbers]:
        engines = flown_engines(scenario, vehicle, stations)
        needs_air, channels = engines[0].has_port("ambient_temperature"), laws.channels
        jets = Numbers(
            places=places,
            banks=channels if vehicle.servo is not None else (0,) * len(places),
            channels=channels,
            engines=tuple(range(len(places))) if needs_air else channels,
            rotors=tuple(jet.spin * spec.rotor_inertia for jet, spec in zip(flown.jets, engines, strict=True)),
            reactions=tuple(jet.reaction_m for jet in flown.jets),
        )
        return _engine(engines, scenario.step_s, late, where), needs_air, jets

    engine, needs_air, jets = known.get((key, differs, places), make)
    # The flights by JSBSim write the same tables, whose names these keep.
    tables = name_values(vehicle.model_dump(include={"sensors", "airflow"}))
    return Numbers(
        xp=np,
        **vars(laws),
        jets=jets,
        factors=factors or (1.0,) * len(places),
        engine=engine,
        needs_air=needs_air,
        airflow=tables.airflow,
        flown=_body(scenario, flown),
        sensors=_sensors(tables.sensors, scenario),
    )


# What the controller is made for, of a scenario and of its vehicle.
_ASKED = {"name", "aircraft", "controller", "step_s", "added_delay_samples", "stations", "engine", "engine_parameters",
          "engine_unchecked", "engine_isolated"}  # fmt: skip
_BELIEVED = {"name", "jets", "identified", "control", "mass_kg", "servo", "allocation"}


def _read_laws(scenario: Scenario, vehicle: Vehicle) -> tuple[list[EngineSpec], Numbers]:
    """Return the assumed engine of each station, and the numbers of controller and servos."""
    where, step, control, servo = f"scenario {scenario.name}", scenario.step_s, vehicle.control, vehicle.servo
    engine, *stations = load_engines(scenario, vehicle)
    thrust_map = make_thrust_map(vehicle, engine, stations)[0]
    predictors = tuple(read_predictor(made, where) for made in make_predictors(scenario, vehicle, engine))
    weight = vehicle.mass_kg * GRAVITY
    hover = thrust_map.fraction(weight / len(vehicle.jets))
    lift = (thrust_map.low + thrust_map.span) * len(vehicle.jets)
    if not (control.allocation.throttle_min < hover < control.allocation.throttle_max and lift > weight):
        raise InputError(f"{where}: engine {engine.name} does not hold {vehicle.name} up")
    gains = name_values(control.model_dump(include={"attitude", "rate", "altitude", "allocation"}))
    leads = [_lead_constants(getattr(control.lead, name, None), step) for name in (*AXES, "altitude")]
    rates = [getattr(gains.rate, axis) for axis in AXES]
    if servo is not None:
        banks = TiltAllocator(vehicle.jets, control.allocation, servo.range_rad, hover, thrust_map.idle)
        channels = tuple(0 if left else 1 for left in banks.left)
        allocation = gains.allocation.replace(
            method="banks", range_rad=servo.range_rad, hover=hover, idle=thrust_map.idle, pitch_sign=banks.pitch_sign
        )
    else:
        channels = tuple(range(len(vehicle.jets)))
        signs = RotorAllocator(vehicle.jets, control.allocation, hover).signs
        allocation = gains.allocation.replace(method="rotors", signs=signs)
    inverse = thrust_map.stations[0]
    laws = Numbers(
        step=step,
        kind=describe(predictors),
        channels=channels,
        attitude=gains.attitude,
        rate=tuple(axis.replace(lead=lead, step=step) for axis, lead in zip(rates, leads[:3], strict=True)),
        predictors=predictors,
        height=gains.altitude.replace(
            mass_kg=vehicle.mass_kg, low=thrust_map.low, span=thrust_map.span, jets=len(vehicle.jets), lead=leads[3],
            step=step,
        ),
        schedule=_schedule(vehicle, step),
        added_delay=scenario.added_delay_samples,
        allocation=allocation,
        thrust=Numbers(
            throttles=None if inverse is None else tuple(inverse.throttles),
            thrusts=() if inverse is None else tuple(inverse.thrusts),
        ),
        reach=tuple(
            thrust_map.throttle((share,) * len(vehicle.jets))
            for share in (control.allocation.throttle_min, control.allocation.throttle_max)
        ),
        servo=None if servo is None else name_values(servo.model_dump()),
    )  # fmt: skip
    # What flights that fly together share, but for their predictors.
    return stations, laws.replace(structure=describe(laws.replace(predictors=None, kind=None)))


def _body(scenario: Scenario, flown: Vehicle) -> Numbers:
    """Return the numbers of the rigid body as flown, with density and gravity at the place of the flight."""
    place, fuel = scenario.environment, flown.fuel
    latitude, turn = radians(place.latitude_deg), 7.292115e-5  # rad/s, of WGS 84
    height = place.ground_m + start_height(flown, scenario.initial)
    tank = None if fuel is None else name_values(fuel.model_dump()).replace(share=scenario.initial.fuel)
    return Numbers(
        mass_kg=flown.mass_kg,
        inertia_kg_m2=flown.inertia_kg_m2,
        products_kg_m2=flown.products_kg_m2,
        fuel=tank,
        drag_area_m2=flown.aero.drag_area_m2,
        centre_m=flown.aero.centre_m,
        damping_n_m_s=flown.aero.damping_n_m_s,
        density=standard_density(height),
        gravity=gravity(place.latitude_deg, height),
        earth_rate=(turn * cos(latitude), -turn * sin(latitude)),
        ground_m=place.ground_m,
    )


def _sensors(sensors: Numbers, scenario: Scenario) -> Numbers:
    """Return the sensors with the biases that the seed draws added to those that are stated."""
    gyro, accelerometer = sensors.gyro, sensors.accelerometer
    if not gyro.bias_sigma_rad_s and not accelerometer.bias_sigma_m_s2:
        return sensors
    drawn = np.random.default_rng(np.random.SeedSequence(scenario.seed, spawn_key=(6,))).standard_normal(6).tolist()

    def biased(stated: Sequence[float], sigma: float, draws: Sequence[float]) -> tuple[float, ...]:
        return tuple(value + sigma * draw for value, draw in zip(stated, draws, strict=True))

    turned = gyro.replace(bias_rad_s=biased(gyro.bias_rad_s, gyro.bias_sigma_rad_s, drawn[:3]))
    pushed = accelerometer.replace(bias_m_s2=biased(accelerometer.bias_m_s2, accelerometer.bias_sigma_m_s2, drawn[3:]))
    return sensors.replace(gyro=turned, accelerometer=pushed)


def _schedule(vehicle: Vehicle, step: float, rows: int = 1001) -> ScheduleNumbers | None:
    """Return the schedule of a vehicle, in rows as fine as its gains follow the level of thrust."""
    control = vehicle.control
    if not isinstance(control.schedule, Schedule):
        return None
    schedule = GainSchedule(control.schedule, control.lead, step)
    low, high = control.schedule.level[0].share, control.schedule.level[-1].share
    table = []
    for share in np.linspace(low, high, rows):
        at = schedule.at(float(share))
        roll, height = at.roll, at.altitude
        leads = [_lead_constants(lead, step) or (0.0,) * 5 for lead in (roll.lead, height.lead)]
        table.append((roll.angle, roll.p, roll.i, roll.d, height.angle, height.p, height.i, *leads[0], *leads[1]))
    gain = 1.0 - exp(-step / control.schedule.filter_s)
    return ScheduleNumbers(low, high, gain, SCHEDULE_RESOLUTION * (high - low), np.array(table))


def _lead_constants(settings: Any, step: float) -> tuple[float, ...] | None:
    return Lead(settings, step).constants if settings else None


# Parameters of an ECU that a batch does not fly, with the values that switch each off.
_UNFLOWN_PARAMETERS = {"command_interval": 1.0} | dict.fromkeys(
    ("command_resolution", "command_dead_band", "command_rate", "speed_dead_band", "fuel_gain"), 0.0
)


def _engine(engines: Sequence[EngineSpec], step: float, late: int, where: str) -> Numbers:
    """Return the kind of the engines with their parameters."""
    first = engines[0]
    name = first.path.stem.removesuffix("-fmi2")
    others = [engine for engine in engines if engine is not first]
    if any(engine.path != first.path or engine.parameters != first.parameters for engine in others):
        raise InputError(f"{where}: engines that differ by station: not flown in a batch; fly it without batch")
    # The engine is one of the library's, perhaps by a file that changes only its parameters.
    plain = all((p.scale, p.offset, p.gain, p.bias) == (1.0, 0.0, 1.0, 0.0) for p in first.ports.values())
    if name not in KINDS or not (first.library or (plain and first.path.resolve() == find_source(name).path.resolve())):
        raise InputError(f"{where}: engine {first.name}: not flown in a batch; fly it without batch")
    if first.internal_step is not None and abs(first.internal_step - step) > 1e-9:
        raise InputError(f"{where}: engine {first.name} takes several steps in one of control: fly it without batch")
    numbers = {key: float(value) for key, value in first.parameters.items()}
    if stated := [key for key, nothing in _UNFLOWN_PARAMETERS.items() if numbers.get(key, nothing) != nothing]:
        raise InputError(f"{where}: engine {first.name}: {stated[0]}: not flown in a batch; fly it without batch")
    if "pressure_ratio" in numbers:
        ratio = numbers["pressure_ratio"] ** (2.0 / 7.0)
        numbers["full_rise"] = (ratio - 1.0) / numbers["compressor_efficiency"]
    delay = round(numbers.get("delay_samples", 0.0)) + late
    return Numbers(**{**numbers, "kind": KINDS[name], "delay": delay, "step": step, "xp": np})
