"""The engines of a flight: which there are, and the chain in which they fly."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.base.errors import InputError
from cosim.engine import Air, EngineSpec, load_engine, make_bank
from cosim.engine.fmu.port_kinds import ASIDE
from cosim.engine.wrappers import EngineChain
from cosim.simulation.engine_reference import engine_reference
from cosim.simulation.script.mismatch import engines_as_flown
from cosim.spec.scenario import Scenario, Station
from cosim.spec.vehicle import Vehicle, file_seen_from, is_file
from cosim.vehicle.airframe import start_height
from cosim.vehicle.atmosphere import standard_air


def engines_of(scenario: Scenario, vehicle: Vehicle) -> list[EngineSpec]:
    """Return the scenario's engine, then the one at each station; each engine with its parameters is measured once.

    They are measured in the still air at the height where the flight starts.  Raises InputError as a flight.
    """
    jets = len(vehicle.jets)
    air = Air(*standard_air(scenario.environment.ground_m + start_height(vehicle, scenario.initial)), 0.0)
    for number in scenario.stations:
        if int(number) > jets:
            where = f"scenario {scenario.name}: stations.{number}"
            raise InputError(f"{where}: {scenario.aircraft_name} has stations 1 to {jets}")
    loaded: dict[tuple[str, frozenset[tuple[str, float]]], EngineSpec] = {}

    def load(engine: str, parameters: dict[str, float]) -> EngineSpec:
        key = engine, frozenset(parameters.items())
        if key not in loaded:
            # a file is seen from the scenario's folder
            source = str(scenario.folder / engine) if is_file(engine) else engine
            unchecked, apart = scenario.engine_unchecked, scenario.engine_isolated
            loaded[key] = load_engine(source, parameters, scenario.step_s, unchecked=unchecked, air=air, apart=apart)
        return loaded[key]

    def load_station(station: Station) -> EngineSpec:
        if station.engine is None:
            return load(scenario.engine, {**scenario.engine_parameters, **station.parameters})
        return load(station.engine, station.parameters)

    engine = load(scenario.engine, scenario.engine_parameters)
    _, folder = scenario.resolved_vehicle()
    own = [None if jet.engine is None else Station(engine=file_seen_from(jet.engine, folder)) for jet in vehicle.jets]
    stations = [scenario.stations.get(str(number), own[number - 1]) for number in range(1, jets + 1)]
    specs = [engine if station is None else load_station(station) for station in stations]
    for spec in specs:
        count = len(spec.archive.engines)
        if jets % count:
            raise InputError(
                f"scenario {scenario.name}: engine {spec.name}: its FMU holds {count} engines, and "
                f"{scenario.aircraft_name} has {jets} stations, which is no whole multiple"
            )
    return [engine, *(spec.at(station) for station, spec in enumerate(specs))]


def _starts_in_flight(scenario: Scenario, stations: Sequence[EngineSpec]) -> bool:
    """Return whether starts are flown.  Raises InputError where that is asked for, and no engine has one."""
    if scenario.engine_start == "before flight":
        return False
    if not any(spec.archive.starting.stages for spec in stations):
        names = ", ".join(dict.fromkeys(spec.name for spec in stations))
        raise InputError(
            f'scenario {scenario.name}: engine_start = "in flight": {names} has no start; state one in '
            "[start] of its mapping file, or leave engine_start out"
        )
    return True


def make_engines(scenario: Scenario, stations: Sequence[EngineSpec]) -> EngineChain:
    """Return the engines at the stations in the chain that they fly in.  Raises InputError as a flight."""
    in_flight, step = _starts_in_flight(scenario, stations), scenario.step_s
    factors, delay = engines_as_flown(scenario.mismatch, len(stations))
    return EngineChain(
        make_bank(stations, step, in_flight),
        [spec.flame_out for spec in stations],
        lambda jet: engine_reference(stations[jet], step).lag,
        step,
        factors,
        delay,
        any(spec.has(port) for spec in stations for port in ASIDE),
    )
