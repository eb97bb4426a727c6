"""Wiring a flight: the one place where its blocks are made and joined."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from itertools import pairwise
from math import hypot, inf, radians
from pathlib import Path
from typing import Any, TypeVar

from cosim.base.constants import GRAVITY, SERVOS
from cosim.base.errors import FlightError, InputError, Notice
from cosim.base.frames import from_euler, rotate
from cosim.base.protocols import Allocator, Predictor, Sensors
from cosim.base.runtime import kernels
from cosim.base.signals import AXES
from cosim.base.storage.cache import Memory
from cosim.control.allocation.allocation import RotorAllocator, TiltAllocator
from cosim.control.allocation.effectiveness import EffectivenessAllocator, Effectors, Mover
from cosim.control.allocation.engine_monitor import EngineMonitor
from cosim.control.allocation.hinged_catch import HingedCatch, Late
from cosim.control.allocation.reallocation import get_ready
from cosim.control.allocation.thrust_map import StaticCurve, ThrustMap
from cosim.control.altitude import AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.belief import Belief
from cosim.control.cascade import Cascade
from cosim.control.catch import Catch
from cosim.control.lead import Lead
from cosim.control.predictors.registry import BASELINE, PREDICTORS
from cosim.control.predictors.smith import NoPredictor
from cosim.control.rate import RateController
from cosim.control.reduced_attitude import ReducedAttitude
from cosim.control.schedule import GainSchedule
from cosim.control.wing import WingFlight, WingTable
from cosim.engine import (
    Air,
    EngineSpec,
    load_engine,
    make_bank,
)
from cosim.engine.fmu.port_kinds import ASIDE
from cosim.engine.wrappers import EngineChain
from cosim.simulation.code import need_trust_of
from cosim.simulation.controllers.deadline import Deadline
from cosim.simulation.controllers.guard import (
    GuardedAttitude,
    GuardedController,
    GuardedPredictor,
    GuardedRate,
    Named,
)
from cosim.simulation.controllers.process import ProcessBlock
from cosim.simulation.controllers.source import Source, find
from cosim.simulation.delay_ledger import delay_ledger
from cosim.simulation.ending import Judge
from cosim.simulation.engine_reference import engine_reference
from cosim.simulation.plugins import load_plugins
from cosim.simulation.script.commander import Commander
from cosim.simulation.script.disturber import Disturber
from cosim.simulation.script.fault_schedule import FaultSchedule
from cosim.simulation.script.mismatch import as_flown, engines_as_flown
from cosim.simulation.step import Simulation
from cosim.simulation.with_places import PlacePilot, flies_to_places
from cosim.spec.scenario import Environment, Scenario, Station, TorqueCommandDisturbance
from cosim.spec.vehicle import EngineLead, RateModel, Vehicle, aircraft_seen_from, file_seen_from, is_file
from cosim.vehicle.airframe import Airframe, standing_height, start_height
from cosim.vehicle.atmosphere import standard_air
from cosim.vehicle.effects.ground_effect import GroundJets
from cosim.vehicle.effects.make import make_effects
from cosim.vehicle.effects.rotors import RotorDynamics
from cosim.vehicle.model_file import read_model
from cosim.vehicle.propulsion import Propulsion
from cosim.vehicle.sensors import FaultySensors, SensorSuite
from cosim.vehicle.servo import TiltServo
from cosim.vehicle.tank import Tank

# How finely the corridor of a wing is asked of its model, and at which speed: as surfaces are; chosen by us
WING_ROWS = 16
WING_AT_M_S = 20.0
_models: Memory[Any] = Memory(32)  # what those of vehicles say of their surfaces and wings
T = TypeVar("T")


def build(scenario: Scenario, own: Source | None = None) -> Simulation:
    """Wire a flight; ``own`` is a controller that a program hands over, else the scenario's is found by its name.

    Raises InputError for anything in scenario, vehicle, engine or controller that does not fit, or is not trusted.
    """
    need_trust_of(scenario)
    kernels.warn_of_others()
    own = own or find_controller(scenario)
    told = own_parameters(scenario, own)
    plugins = load_plugins(scenario)
    scenario.count(scenario.duration_s, "duration_s")
    vehicle, folder = scenario.resolved_vehicle()
    _need_tank(scenario, vehicle)
    _need_room_below(scenario, vehicle)
    PREDICTORS.check(vehicle.control.predictor, f"scenario {scenario.name}: vehicle.control.predictor")
    engine, *stations = specs = engines_of(scenario, vehicle)
    laws = [spec.flame_out for spec in stations]
    step, initial = scenario.step_s, scenario.initial
    flown = as_flown(vehicle, scenario.mismatch)
    effects = make_effects(vehicle, flown, stations, step)
    with ExitStack() as made:
        plugged = end = None
        if own is not None:
            plugged = _Plugged(own, told, scenario, vehicle, engine, stations)
            end = made.callback(plugged.close)
            plugged.make()
        controller = _cascade(scenario, vehicle, engine, stations, plugged)
        airframe = Airframe(
            flown,
            folder,
            scenario.environment,
            step,
            scenario.substeps,
            scenario.seed,
            any(isinstance(effect, RotorDynamics) for effect in effects),
        )
        made.callback(airframe.close)
        in_flight = _starts_in_flight(scenario, stations)
        bank = make_bank(stations, step, in_flight)
        made.callback(bank.close)
        engines = EngineChain(
            bank,
            laws,
            lambda jet: engine_reference(stations[jet], step).lag,
            step,
            *engines_as_flown(scenario.mismatch, len(stations)),
            aside=any(spec.has(port) for spec in stations for port in ASIDE),
        )
        servos = [TiltServo(vehicle.servo, step) for _ in SERVOS] if vehicle.servo else []
        servos += [TiltServo(hinge, step) for hinge in vehicle.hinges]
        servos += [TiltServo(surface, step) for surface in vehicle.surfaces]
        ground = vehicle.ground_effect
        propulsion = Propulsion(
            flown.jets,
            engines,
            servos,
            effects,
            Tank(vehicle.fuel.mass_kg, step, initial.fuel) if vehicle.fuel else None,
            airframe.air,
            flown.hinges,
            GroundJets(ground, flown.jets) if ground and ground.hot_gas else None,
        )
        suite: Sensors = SensorSuite(vehicle.sensors, step, scenario.seed, scenario.sensor_noise)
        sensors = FaultySensors(suite if plugins.sensors is None else plugins.sensors(suite))
        height = start_height(flown, initial)
        commander = Commander(scenario, height)
        if "ahead_m_s" in commander.signals and vehicle.control.wing is None:
            raise InputError(
                f"scenario {scenario.name}: command: 'ahead_m_s': {vehicle.name} has no [control.wing] to fly ahead "
                "with; take a velocity"
            )
        simulation = Simulation(
            scenario,
            vehicle,
            specs,
            delay_ledger(scenario, vehicle, stations, controller.allocator, "ahead_m_s" in commander.signals),
            commander,
            PlacePilot(scenario, vehicle, commander, controller.allocator.hover, controller.thrust_map.idle)
            if flies_to_places(scenario)
            else None,
            Disturber(scenario),
            controller if plugged is None or plugged.whole is None else plugged.whole,
            propulsion,
            airframe,
            sensors,
            FaultSchedule(scenario, engines, servos, sensors, laws, vehicle.actuators, len(vehicle.surfaces)),
            Judge(vehicle.limits),
            own,
            end,
            None if plugged is None else plugged.repeats,
            None if plugged is None or plugged.whole is None else controller,
            plugins,
            None if plugins.wind is None else plugins.wind(flown, step, height),
        )
        made.pop_all()
        return simulation


def _need_tank(scenario: Scenario, vehicle: Vehicle) -> None:
    """Refuse part of a tank that is not there, as faults and factors of jets that are not there are refused."""
    if vehicle.fuel is None and scenario.initial.fuel != 1.0:
        raise InputError(
            f"scenario {scenario.name}: initial.fuel = {scenario.initial.fuel:g}: {vehicle.name} has no tank; leave it "
            "out, or state vehicle.fuel"
        )


def _need_room_below(scenario: Scenario, vehicle: Vehicle) -> None:
    """Refuse a start with a contact deeper in the ground than the legs are pressed in when the vehicle stands on them.

    What stands deeper is thrown out of the ground by its springs.
    """
    initial = scenario.initial
    if initial.on_ground:
        return
    roll, pitch, yaw = [radians(angle) for angle in initial.attitude_deg]
    turned = from_euler(roll, pitch, yaw)
    below = max([rotate(turned, contact.position_m)[2] for contact in vehicle.contacts])
    pressed = max(contact.position_m[2] for contact in vehicle.contacts if contact.kind == "leg")
    least = below - (pressed - standing_height(vehicle))
    if initial.altitude_m < least:
        raise InputError(
            f"scenario {scenario.name}: initial.altitude_m = {initial.altitude_m:g}: {vehicle.name} would start "
            f"{below - initial.altitude_m:.3g} m deep in the ground; at least {least:.3g}, or initial.on_ground = true"
        )


def _starts_in_flight(scenario: Scenario, stations: Sequence[EngineSpec]) -> bool:
    """Whether starts are flown.  Raises InputError where that is asked for, and no engine has one."""
    if scenario.engine_start == "before flight":
        return False
    if not any(spec.archive.starting.stages for spec in stations):
        names = ", ".join(dict.fromkeys(spec.name for spec in stations))
        raise InputError(
            f'scenario {scenario.name}: engine_start = "in flight": {names} has no start; state one in '
            "[start] of its mapping file, or leave engine_start out"
        )
    return True


def engines_of(scenario: Scenario, vehicle: Vehicle) -> list[EngineSpec]:
    """The scenario's engine, then the one at each station; each engine with its parameters is measured once.

    They are measured in the still air at the height where the flight starts.  Raises InputError as :func:`build`.
    """
    jets = len(vehicle.jets)
    air = Air(*standard_air(scenario.environment.ground_m + start_height(vehicle, scenario.initial)), 0.0)
    for number in scenario.stations:
        if int(number) > jets:
            where = f"scenario {scenario.name}: stations.{number}"
            raise InputError(f"{where}: {scenario.aircraft_name} has stations 1 to {jets}")
    known: dict[tuple[str, frozenset[tuple[str, float]]], EngineSpec] = {}

    def load(engine: str, parameters: dict[str, float]) -> EngineSpec:
        key = engine, frozenset(parameters.items())
        if key not in known:
            # a file is seen from the scenario's folder
            source = str(scenario.folder / engine) if is_file(engine) else engine
            unchecked, apart = scenario.engine_unchecked, scenario.engine_isolated
            known[key] = load_engine(source, parameters, scenario.step_s, unchecked=unchecked, air=air, apart=apart)
        return known[key]

    def at(station: Station) -> EngineSpec:
        if station.engine is None:
            return load(scenario.engine, {**scenario.engine_parameters, **station.parameters})
        return load(station.engine, station.parameters)

    engine = load(scenario.engine, scenario.engine_parameters)
    _, folder = scenario.resolved_vehicle()
    own = [None if jet.engine is None else Station(engine=file_seen_from(jet.engine, folder)) for jet in vehicle.jets]
    stations = [scenario.stations.get(str(number), own[number - 1]) for number in range(1, jets + 1)]
    found = [engine if station is None else at(station) for station in stations]
    for spec in found:
        held = len(spec.archive.engines)
        if jets % held:
            raise InputError(
                f"scenario {scenario.name}: engine {spec.name}: its FMU holds {held} engines, and "
                f"{scenario.aircraft_name} has {jets} stations, which is no whole multiple"
            )
    return [engine, *(spec.at(station) for station, spec in enumerate(found))]


def find_controller(scenario: Scenario) -> Source | None:
    """The scenario's controller where it is from outside.  Raises InputError for an unknown one, or another file."""
    source = find(scenario.controller, scenario.folder, f"unknown controller {scenario.controller!r}")
    if source is not None:
        source.expect(scenario.controller_sha256, f"scenario {scenario.name}")
    return source


def own_parameters(scenario: Scenario, own: Source | None) -> dict[str, float]:
    """The values of a controller's own parameters.  Raises InputError where the scenario states others."""
    where = f"scenario {scenario.name}: controller_parameters"
    if own is not None:
        return own.values(scenario.controller_parameters, where)
    for name in scenario.controller_parameters:
        raise InputError(
            f"{where}.{name}: controller {scenario.controller} has none of its own; it is tuned under vehicle.control"
        )
    return {}


class _Plugged:
    """A controller from outside, made and told what it may believe, in the place of its level."""

    def __init__(
        self,
        own: Source,
        parameters: dict[str, float],
        scenario: Scenario,
        vehicle: Vehicle,
        engine: EngineSpec,
        stations: Sequence[EngineSpec],
    ) -> None:
        self._own, self._scenario = own, scenario
        self._deadline = Deadline(scenario.controller_limit_s * (1.0 if own.repeats else 2.0))
        self._named = Named(own.label, self._deadline)
        self._blocks: list[Any] = []
        self.whole: GuardedController | None = None
        self.attitude: GuardedAttitude | None = None
        self.rate: GuardedRate | None = None
        if own.level == "controller" and any(
            isinstance(disturbance, TorqueCommandDisturbance) for disturbance in scenario.disturbance
        ):
            raise InputError(
                f"scenario {scenario.name}: disturbance: torque_command acts on a rate loop's output, which controller "
                f"{own.label} does not have; take force, moment or wind"
            )
        if own.level == "controller" and scenario.added_delay_samples:
            raise InputError(
                f"scenario {scenario.name}: added_delay_samples = {scenario.added_delay_samples}: is added to a rate "
                f"loop's output, which controller {own.label} does not have; take mismatch.delay_samples"
            )
        self._belief = _told(scenario, vehicle, engine, stations, parameters)

    def make(self) -> None:
        """Its block, but for predictors.  Raises InputError as ``_made``; :meth:`close` ends what was begun by then."""
        if self._own.level == "controller":
            self.whole = GuardedController(self._made(self._belief), self._named, self._belief)
        elif self._own.level == "rate":
            self.rate = GuardedRate(self._made(self._belief), self._named)
        elif self._own.level == "attitude":
            self.attitude = GuardedAttitude(self._made(self._belief), self._named)

    def predictors(self) -> list[Predictor]:
        """What stands between measurement and our rate loop: the user's where engines answer, or one of ours."""
        belief = self._belief
        if self._own.level != "predictor":
            return belief.predictors(self._own.predictor)
        there = belief.models or (AXES if belief.vehicle.allocation == "rotors" else AXES[:1])
        return [
            GuardedPredictor(self._made(belief.of(axis)), self._named, axis) if axis in there else NoPredictor()
            for axis in AXES
        ]

    def _made(self, belief: Belief) -> Any:
        """A block that is told what it may believe.  Raises InputError for one that takes that badly."""
        block = self._own.make()
        self._blocks.append(block)
        if isinstance(block, ProcessBlock):  # it has limits of its own, and takes a while to start
            block.limit(self._scenario.controller_limit_s)
            block.prepare(belief)
            return block
        if hasattr(block, "prepare"):
            try:
                self._named.call("prepare", block.prepare, belief)
            except FlightError as error:
                raise InputError(str(error)) from error
        return block

    def repeats(self) -> bool | None:
        """Whether processes, asked the same again, answer the same; None: it is code of this process."""
        asked = [block.repeats() for block in self._blocks if isinstance(block, ProcessBlock)]
        return all(asked) if asked else None

    def close(self) -> None:
        for block in self._blocks:
            if hasattr(block, "close"):
                block.close()
        self._deadline.close()


def belief_of(scenario: Scenario, parameters: Mapping[str, float]) -> Belief:
    """What a controller with these parameters would be told in a scenario.  Raises InputError as :func:`build`."""
    vehicle, _ = scenario.resolved_vehicle()
    engine, *stations = engines_of(scenario, vehicle)
    return _told(scenario, vehicle, engine, stations, parameters)


def _told(
    scenario: Scenario,
    vehicle: Vehicle,
    engine: EngineSpec,
    stations: Sequence[EngineSpec],
    parameters: Mapping[str, float],
) -> Belief:
    """What a controller from outside is told, with its own parameters."""
    thrust_map, hover = _hovering(vehicle, engine, stations)
    built_in = scenario.model_copy(update={"controller": BASELINE.name})
    return Belief(
        scenario.step_s,
        vehicle,
        _believed(scenario, vehicle, engine),
        thrust_map,
        hover,
        parameters,
        "",
        scenario.initial.on_ground,
        lambda: [engine_reference(spec, scenario.step_s) for spec in stations],
        lambda name: predictors(built_in.model_copy(update={"controller": name}), vehicle, engine),
    )


def models_of(vehicle: Vehicle, engine: EngineSpec) -> dict[str, RateModel]:
    """Return the models, by axis, that the vehicle states for an engine.

    Those of an engine that is a file are filed under its name and its hash: with a note, one whose hash is of another
    file of that name is left out, and one without a hash is taken.
    """
    models: dict[str, RateModel] = {}
    for axis, model in vehicle.identified.get(engine.family, {}).items():
        where = f"vehicle.identified.{engine.family!r}.{axis}"
        if not engine.owns(model.engine_sha256):
            other = f"is of another {engine.family} (sha256 {model.engine_sha256[:12]}, not {engine.fingerprint[:12]})"
            warnings.warn(f"{where}: {other}: left out; hexjet identify {axis} makes one of this", Notice, stacklevel=2)
            continue
        if not engine.library and not model.engine_sha256:
            unsure = f"states no hash: that it is of this {engine.family} is not verified"
            warnings.warn(f"{where}: {unsure}", Notice, stacklevel=2)
        models[axis] = model
    return models


def _believed(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec) -> dict[str, RateModel]:
    """The identified models for this engine and this step, the delay that the controller adds in that of roll."""
    models: dict[str, RateModel] = {}
    for axis, model in models_of(vehicle, engine).items():
        if abs(model.sample_time_s - scenario.step_s) <= 1e-9:
            added = scenario.added_delay_samples if axis == "roll" else 0
            delay = model.delay_samples + added
            models[axis] = model.model_copy(update={"delay_samples": delay}) if added else model
    return models


def _hovering(vehicle: Vehicle, engine: EngineSpec, stations: Sequence[EngineSpec]) -> tuple[ThrustMap, float]:
    """From shares of thrust to throttles, and the share in hover."""
    curves = {id(station): StaticCurve(station.name, *station.rising) for station in (engine, *stations)}
    thrust_map = ThrustMap(curves[id(engine)], [curves[id(station)] for station in stations])
    return thrust_map, thrust_map.share(vehicle.mass_kg * GRAVITY / len(vehicle.jets))


def _cascade(
    scenario: Scenario,
    vehicle: Vehicle,
    engine: EngineSpec,
    stations: Sequence[EngineSpec],
    plugged: _Plugged | None,
) -> Cascade:
    step = scenario.step_s
    gains = vehicle.control
    thrust_map, hover = _hovering(vehicle, engine, stations)
    general = vehicle.allocation == "effectiveness"
    if not general and not gains.allocation.throttle_min < hover < gains.allocation.throttle_max:
        raise InputError(
            f"engine {engine.name}: {vehicle.name} ({vehicle.mass_kg:g} kg) would hover at throttle {hover:.2f}, "
            f"outside {gains.allocation.throttle_min:g} to {gains.allocation.throttle_max:g}"
        )
    _need_lift(vehicle, stations)
    catch = _catch(scenario, vehicle, stations, thrust_map) if plugged is None else None
    return Cascade(
        AttitudeController(gains.attitude),
        RateController(
            (gains.rate.roll, gains.rate.pitch, gains.rate.yaw),
            predictors(scenario, vehicle, engine) if plugged is None else plugged.predictors(),
            step,
            [_lead(vehicle, axis, step) for axis in AXES],
        ),
        AltitudeController(
            gains.altitude,
            vehicle.mass_kg,
            thrust_map.collective,
            step,
            _lead(vehicle, "altitude", step),
        ),
        _allocator(scenario, vehicle, stations, thrust_map, hover, catch),
        thrust_map,
        _monitor(scenario, vehicle, stations) if scenario.monitored else None,
        GainSchedule(gains.schedule, gains.lead, step) if gains.schedule else None,
        vehicle,
        scenario.added_delay_samples,
        opposites(vehicle) if gains.monitor is not None and gains.monitor.shut_opposite else (),
        step,
        plugged.attitude if plugged else None,
        plugged.rate if plugged else None,
        catch,
        _reduced(scenario, vehicle, stations, thrust_map) if plugged is None else None,
        _wing(scenario, vehicle),
    )


def _allocator(
    scenario: Scenario,
    vehicle: Vehicle,
    stations: Sequence[EngineSpec],
    thrust_map: ThrustMap,
    hover: float,
    catch: Catch | None,
) -> Allocator:
    """By what the vehicle has, or states."""
    limits = vehicle.control.allocation
    if vehicle.allocation == "effectiveness":
        return _by_effectiveness(scenario, vehicle, stations, thrust_map)
    if vehicle.servo is None:
        return RotorAllocator(vehicle.jets, limits, hover)
    lift = _lift(scenario, vehicle, stations) if scenario.monitored and catch is None else inf
    return TiltAllocator(vehicle.jets, limits, vehicle.servo.range_rad, hover, thrust_map.idle, lift)


def effectiveness_of(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec) -> EffectivenessAllocator:
    """The allocation of a vehicle with this engine at every station.  Raises InputError as :func:`build`."""
    stations = [engine] * len(vehicle.jets)
    thrust_map, _ = _hovering(vehicle, engine, stations)
    return _by_effectiveness(scenario, vehicle, stations, thrust_map)


def _by_effectiveness(
    scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec], thrust_map: ThrustMap
) -> EffectivenessAllocator:
    limits, step = vehicle.control.allocation, scenario.step_s
    jets = len(vehicle.jets)
    ends: list[tuple[float, ...]] = []
    for share in (limits.throttle_min, limits.throttle_max):
        throttles = thrust_map.throttle((share,) * jets)
        curves = [StaticCurve(spec.name, *spec.rising) for spec in stations]
        thrusts = [_thrust_at(curve, u) for curve, u in zip(curves, throttles, strict=True)]
        ends.append(tuple([(thrust - thrust_map.low) / thrust_map.span for thrust in thrusts]))
    # where a hinge carries engines all keep its pace: vanes that ran ahead of slow banks turned the jetwing over
    layout = vehicle.layout()
    ahead = 0.0 if layout.moves else 1.0
    movers = [
        Mover(
            *hinge.least_most,
            hinge.rest_rad,
            hinge.rate_limit_rad_s * step,
            hinge.effort,
            lead=ahead * hinge.rate_limit_rad_s * hinge.lag_s,
        )
        for hinge in vehicle.hinges
    ]
    movers += [
        Mover(*surface.range, 0.0, surface.rate_limit_1_s * step, surface.effort, effect)
        for surface, effect in zip(vehicle.surfaces, _surface_effects(scenario, vehicle), strict=True)
    ]
    effectors = Effectors(
        vehicle.name,
        layout,
        vehicle.mass_kg,
        vehicle.tensor,
        thrust_map.low,
        thrust_map.span,
        list(zip(*ends, strict=True)),
        [jet.effort for jet in vehicle.jets],
        movers,
        limits.horizontal,
    )
    late = _late(scenario, vehicle, stations)
    return EffectivenessAllocator(effectors) if late is None else HingedCatch(effectors, late)


def _late(scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec]) -> Late | None:
    """Of the engines, where the vehicle is to be caught without one of them.

    A throttle has acted after the delay and a third of the lag, by when an engine is well on its way: chosen by us.
    """
    monitor = vehicle.control.monitor
    if not scenario.monitored or monitor is None or not monitor.catch:
        return None
    known = [engine_reference(spec, scenario.step_s) for spec in stations]
    return Late(max(each.delay for each in known) + max(each.lag for each in known) / 3.0, scenario.step_s)


def _surface_effects(scenario: Scenario, vehicle: Vehicle) -> list[tuple[float, ...]]:
    """What each surface of the vehicle's own JSBSim model does per unit and Pa, as the model says."""
    return _asked("surfaces", scenario, vehicle, Airframe.surface_effects) if vehicle.surfaces else []


def _wing(scenario: Scenario, vehicle: Vehicle) -> WingFlight | None:
    """Flight ahead on the wing of the vehicle's own JSBSim model, where the vehicle states how."""
    settings = vehicle.control.wing
    if settings is None:
        return None
    least, most = settings.alpha_rad
    alphas = [least + (most - least) * row / WING_ROWS for row in range(WING_ROWS + 1)]
    lift, drag, moment = _asked("wing", scenario, vehicle, lambda frame: frame.wing_effects(alphas, WING_AT_M_S))
    names = [hinge.name for hinge in vehicle.hinges]
    tilts = [names.index(name) for name in settings.tilts]
    table = WingTable(tuple(alphas), tuple(lift), tuple(drag), tuple(moment))
    control = vehicle.control
    late = 1.0 / control.attitude.gain_1_s[1] + 1.0 / control.rate.pitch.p  # s: attitude, and rates below it
    return WingFlight(settings, table, tilts, vehicle.mass_kg, scenario.step_s, late)


def _asked(what: str, scenario: Scenario, vehicle: Vehicle, ask: Callable[[Airframe], T]) -> T:
    """What the vehicle's own JSBSim model says of surfaces, or of a wing, once for a vehicle and a model."""
    _, folder = scenario.resolved_vehicle()
    model = None if vehicle.model is None else read_model(folder / vehicle.model)

    def make() -> T:
        frame = Airframe(vehicle, folder, Environment(), scenario.step_s, 1, 0)
        try:
            return ask(frame)
        finally:
            frame.close()

    answer: T = _models.get((what, model, vehicle.model_dump_json(), scenario.step_s), make)
    return answer


def _thrust_at(curve: StaticCurve, throttle: float) -> float:
    """Thrust at rest [N], linear between the points of the curve."""
    for (u, v), (f, g) in zip(pairwise(curve.throttle), pairwise(curve.thrust), strict=True):
        if throttle <= v:
            return f + (g - f) * (throttle - u) / (v - u)
    return curve.thrust[-1]


def _reduced(
    scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec], thrust_map: ThrustMap
) -> ReducedAttitude | None:
    """Where rotors do not tilt and a lost one is to be caught."""
    monitor = vehicle.control.monitor
    if vehicle.allocation != "rotors" or not scenario.monitored or monitor is None or not monitor.catch:
        return None
    known = [engine_reference(spec, scenario.step_s) for spec in stations]
    lag, delay = max(each.lag for each in known), max(each.delay for each in known)
    added = scenario.added_delay_samples
    return ReducedAttitude(vehicle, opposites(vehicle), thrust_map, lag, delay, scenario.step_s, added)


def _catch(scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec], thrust_map: ThrustMap) -> Catch | None:
    """Where the opposite of a lost engine is shut off, with the engine that the vehicle is made for.

    With that one its constants were chosen; slower ones stay longer at their limits, which it does not know.
    """
    monitor, lead = vehicle.control.monitor, getattr(vehicle.control.lead, "roll", None)
    own = scenario.engine == vehicle.engine and all(each.name == vehicle.engine for each in stations)
    if (
        vehicle.allocation != "banks"
        or not own
        or not scenario.monitored
        or monitor is None
        or not (monitor.shut_opposite and monitor.catch)
    ):
        return None
    if not isinstance(lead, EngineLead) or lead.damping is None:
        return None
    delay = max(engine_reference(spec, scenario.step_s).delay for spec in stations)
    return Catch(vehicle, thrust_map, lead, delay, scenario.step_s)


def _lift(scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec]) -> float:
    """How far a throttle may go up in a step for the height that is lost with an engine.

    From least to most in no less than the longest lag of the engines: told to go faster they are at the limit of their
    acceleration, all alike, and what roll asks for between them is lost.
    """
    limits, step = vehicle.control.allocation, scenario.step_s
    longest = max(engine_reference(spec, step).longest for spec in stations)
    return (limits.throttle_max - limits.throttle_min) * step / max(longest, step)


def opposites(vehicle: Vehicle) -> tuple[int, ...]:
    """For every jet, from 0, the one across the centre of gravity.  Raises InputError if one has none."""
    places = [jet.position_m for jet in vehicle.jets]
    pairs = []
    for number, (x, y, _) in enumerate(places, 1):
        across = [i for i, (a, b, _) in enumerate(places) if hypot(a + x, b + y) < 1e-3 * hypot(x, y)]
        if len(across) != 1:
            raise InputError(f"{vehicle.name}: control.monitor.shut_opposite: no jet stands opposite jet {number}")
        pairs.append(across[0])
    return tuple(pairs)


def _lead(vehicle: Vehicle, command: str, step: float) -> Lead | None:
    stated = getattr(vehicle.control.lead, command, None)
    return Lead(stated, step) if stated else None


def _need_lift(vehicle: Vehicle, stations: Sequence[EngineSpec]) -> None:
    """Refuse stations whose engines cannot carry the vehicle together, whatever the scenario's engine could."""
    weight, most = vehicle.mass_kg * GRAVITY, sum(station.curve.thrust[-1] for station in stations)
    if most <= weight:
        raise InputError(
            f"stations: the engines give at most {most:.1f} N together; {vehicle.name} ({vehicle.mass_kg:g} kg) "
            f"weighs {weight:.1f} N"
        )


def _monitor(scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec]) -> EngineMonitor:
    settings, limits = vehicle.control.monitor, vehicle.control.allocation
    if settings is None:
        raise InputError(
            f"scenario {scenario.name}: {vehicle.name} has no [control.monitor] to watch its engines with; "
            "state it, or set monitor = false"
        )
    get_ready()
    known = {key: engine_reference(spec, scenario.step_s) for key, spec in {id(s): s for s in stations}.items()}
    return EngineMonitor(
        settings,
        [known[id(spec)] for spec in stations],
        vehicle.mass_kg * GRAVITY / len(stations),
        (limits.throttle_min, limits.throttle_max),
        scenario.step_s,
        settings.catch,
    )


def _one_command(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec) -> str:
    """What to do about an engine for which there is no model: design for it, and fly that."""
    what = engine.name if engine.library else str(engine.mapping or engine.path)
    named = aircraft_seen_from(scenario.aircraft, scenario.folder)
    aircraft = "" if named == "hexjet" else f" --aircraft {named}"
    file = f"{vehicle.name}-{Path(what).stem}.toml"
    return (
        f"one is made, with gains to go with it, by: hexjet design --engine {what}{aircraft} --out {file} "
        f"(then fly with --controller {file}; or fly --controller {BASELINE.name})"
    )


def _said_of(models: Mapping[str, Any]) -> str:
    return f"models for: {', '.join(sorted(models))}" if models else "none"


def predictors(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec) -> list[Predictor]:
    """One predictor per axis: the controller's where the vehicle has an identified model for this engine, else none."""
    spec = PREDICTORS[scenario.controller]
    models = models_of(vehicle, engine) if spec.needs_model else {}
    if spec.needs_model and not models:
        raise InputError(
            f"controller {scenario.controller!r} needs an identified model of {vehicle.name} with engine "
            f"{engine.family!r}; there are {_said_of(vehicle.identified)}; " + _one_command(scenario, vehicle, engine)
        )
    believed = _believed(scenario, vehicle, engine)
    made: list[Predictor] = []
    for axis in AXES:
        model = believed.get(axis)
        if spec.needs_model and model is None and axis in models:
            sample_time = models[axis].sample_time_s
            raise InputError(
                f"vehicle.identified.{engine.family}.{axis}: the model's sample time {sample_time:g} s is not the "
                f"scenario's step {scenario.step_s:g} s"
            )
        # jets that tilt give pitch and yaw by servo, which no predictor is for
        predicted = model is not None if spec.needs_model else axis == "roll" or vehicle.allocation == "rotors"
        made.append(spec.predictor(model, vehicle.control.predictor) if predicted else NoPredictor())
    return made
