"""The engines of a flight: which there are, and the chain in which they fly."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.base.errors import InputError
from cosim.engine import Air, EngineSpec, find_source, load_engine, make_bank
from cosim.engine.fmu.port_kinds import SIDE_LOADS
from cosim.engine.wrappers import EngineChain
from cosim.simulation.engine_reference import make_engine_reference
from cosim.simulation.script.mismatch import compute_engine_mismatch
from cosim.spec.scenario import Scenario, Station
from cosim.spec.vehicle import Vehicle, file_seen_from
from cosim.vehicle.airframe import start_height
from cosim.vehicle.atmosphere import standard_air


def load_engines(scenario: Scenario, vehicle: Vehicle) -> list[EngineSpec]:
    """Return the scenario's engine, then the one at each station; each engine with its parameters is measured once.

    They are measured in the still air at the height where the flight starts.  Raises InputError as a flight.
    """
    jets = len(vehicle.jets)
    for number in (*scenario.stations, *scenario.mismatch.stations):
        if int(number) > jets:
            key = "stations" if number in scenario.stations else "mismatch.stations"
            where = f"scenario {scenario.name}: {key}.{number}"
            raise InputError(f"{where}: {scenario.aircraft_name} has stations 1 to {jets}")
    loader = _Loader(scenario, vehicle)
    engine = loader.load(scenario.engine, scenario.engine_parameters)
    stations = list_stations(scenario, vehicle)
    stated = [engine if station is None else loader.load(*loader.parameters_of(station)) for station in stations]
    return [engine, *stated]


def flown_engines(scenario: Scenario, vehicle: Vehicle, stated: Sequence[EngineSpec]) -> Sequence[EngineSpec]:
    """Return the engines that really fly at the stations where the controller assumes ``stated``.

    These are the same without parameters in the scenario's mismatch.  Raises InputError as a flight.
    """
    common, single = scenario.mismatch.engine_parameters, scenario.mismatch.stations
    if not common and not single:
        return stated
    loader, flown = _Loader(scenario, vehicle), []
    for index, station in enumerate(list_stations(scenario, vehicle)):
        engine, parameters = loader.parameters_of(station or Station.model_construct())
        unknown = {} if station is not None and station.engine is not None else common
        unknown = {**unknown, **single.get(str(index + 1), {})}
        spec = stated[index]
        if unknown:  # the stated archive was checked already
            spec = loader.load(engine, {**parameters, **unknown}, spec.isolated)
        flown.append(spec)
    return flown


def list_stations(scenario: Scenario, vehicle: Vehicle) -> list[Station | None]:
    """Return the station tables of the scenario or else of the vehicle, one per jet; None: the scenario's engine."""
    _, folder = scenario.resolved_vehicle()
    own = [None if jet.engine is None else Station(engine=file_seen_from(jet.engine, folder)) for jet in vehicle.jets]
    return [scenario.stations.get(str(number), station) for number, station in enumerate(own, 1)]


class _Loader:
    """Loader of a flight's engines, cached by file and parameters, measured in the still air of the start."""

    def __init__(self, scenario: Scenario, vehicle: Vehicle) -> None:
        self._scenario = scenario
        height = scenario.environment.ground_m + start_height(vehicle, scenario.initial)
        self._air = Air(*standard_air(height), 0.0)
        self._loaded: dict[tuple[str, frozenset[tuple[str, float]]], EngineSpec] = {}

    def parameters_of(self, station: Station) -> tuple[str, dict[str, float]]:
        """Return the name of a station's engine, and its parameters."""
        if station.engine is None:
            return self._scenario.engine, {**self._scenario.engine_parameters, **station.parameters}
        return station.engine, station.parameters

    def load(self, engine: str, parameters: dict[str, float], tried: bool | None = None) -> EngineSpec:
        """Load an engine; ``tried``: its archive was checked before, and whether it is isolated."""
        scenario, key = self._scenario, (engine, frozenset(parameters.items()))
        if key not in self._loaded:
            self._loaded[key] = load_engine(
                find_source(engine, scenario.folder),
                parameters,
                scenario.step_s,
                unchecked=scenario.engine_unchecked or tried is not None,
                air=self._air,
                isolated=scenario.engine_isolated if tried is None else tried,
            )
        return self._loaded[key]


def make_engines(scenario: Scenario, stations: Sequence[EngineSpec]) -> EngineChain:
    """Return the chain of the engines at the stations, with faults and mismatch.  Raises InputError as a flight."""
    step = scenario.step_s
    factors, delay = compute_engine_mismatch(scenario.mismatch, len(stations))
    return EngineChain(
        make_bank(stations, step),
        [spec.flame_out for spec in stations],
        lambda jet: make_engine_reference(stations[jet], step).lag,
        step,
        factors,
        delay,
        any(spec.has_port(port) for spec in stations for port in SIDE_LOADS),
    )
