"""An engine drawn by its own ``[uncertainty]``: one draw for all engines of the vehicle, and one of spread for each.

What is drawn flies and is not known to the controller: it stands under ``mismatch``.  Each parameter is normal about
its nominal value, cut off at ``cosim.engine.fmu.uncertainty.MAX_SIGMA`` deviations and at the FMU's limits.  The
common deviations are correlated through normal variables (a Gaussian copula), so that each keeps its distribution.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from hashlib import sha256
from math import ceil, floor, inf, isfinite

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.campaign.study.key import Key, Value
from cosim.campaign.study.keys import FLOWN_PARAMETERS, FLOWN_STATIONS, flown_engine_keys
from cosim.engine import EngineSource, find_source
from cosim.engine.fmu.uncertainty import Uncertainty, cut_normal
from cosim.simulation.engines import list_stations
from cosim.spec.scenario import Scenario

ENGINE = "engine"  # key of the drawn engine
DRAWN_BY = "by the engine's [uncertainty]"
# A quantile of 0 would be minus infinity under a normal distribution.
MIN_QUANTILE = 2.0**-54
UNCERTAINTY_HINT = (
    "hexjet engine from-bench writes one, docs/own-engine.md says how; or list engines, vary engine=A,B, or vary "
    "single parameters, vary mismatch.engine_parameters.NAME=LO:HI"
)


@dataclass(frozen=True)
class _UncertainParameter:
    """One uncertain parameter: deviation and spread, its key for all engines, and keys for single stations."""

    deviation: float
    spread: float
    common: Key
    stations: tuple[Key, ...]


class EngineDraw:
    """Draws of an engine's uncertain parameters.

    ``names``: the key that each of the numbers between 0 and 1 stands for that make one, ``sides`` of them; of
    correlated keys one stands for what those before it leave open.  ``keys``: what gets a value in each, in order.
    """

    def __init__(self, table: Uncertainty, parameters: Sequence[_UncertainParameter]) -> None:
        self._table, self._parameters = table, parameters
        self.keys = [key for of in parameters for key in (*([of.common] if of.deviation else []), *of.stations)]
        self.names = [of.common.path for of in parameters] + [key.path for of in parameters for key in of.stations]
        self.sides = len(self.names)

    @property
    def description(self) -> str:
        """Sentence on the parameters drawn, how, and the origin of their uncertainty."""
        each = ", each engine by itself too" if any(self._table.spreads) else ""
        return (
            f"drawn {DRAWN_BY} ({', '.join(self._table.parameters)}{each}; "
            f"source: {self._table.source or 'not stated'})"
        )

    def draw_by_name(self, name: str) -> dict[str, Value]:
        """Return the values that a name selects, by key; the same on each machine."""
        seed = int.from_bytes(sha256(name.encode()).digest())
        points = np.maximum(np.random.default_rng(seed).random((1, self.sides)), MIN_QUANTILE)
        return {key.path: column[0] for key, column in zip(self.keys, self.values(points), strict=True)}

    def values(self, points: Array) -> list[list[Value]]:
        """Return a column of values for each key from ``points``, a row a draw and a column a side."""
        from scipy.special import ndtri

        count = len(self._parameters)
        side, columns = count, []
        for of, quantiles in zip(self._parameters, self._table.quantiles(ndtri(points[:, :count])), strict=True):
            centre = np.full(len(points), _nominal_value(of.common))
            drawn = cut_normal(quantiles, centre, of.deviation, of.common.low, of.common.high)
            if of.deviation:
                columns.append(_fit_to_key(drawn, of.common))
            for key in of.stations:
                centre = np.clip(drawn + (_nominal_value(key) - _nominal_value(of.common)), key.low, key.high)
                columns.append(_fit_to_key(cut_normal(points[:, side], centre, of.spread, key.low, key.high), key))
                side += 1
        return columns


def engine_draw(scenario: Scenario, source: EngineSource | None = None) -> EngineDraw:
    """Return the draws of a scenario's engine.  Raises InputError for an engine that states no uncertainty."""
    source = find_source(source or scenario.engine, scenario.folder)
    table = source.uncertainty
    if table is None:
        raise InputError(f"vary engine: {scenario.engine} has no [uncertainty] in a mapping file; {UNCERTAINTY_HINT}")
    vehicle, _ = scenario.resolved_vehicle()
    keys = {key.path: key for key in flown_engine_keys(scenario, source, len(vehicle.jets))}
    stated = {number: station for number, station in scenario.stations.items() if station.engine is not None}
    stations = [
        str(number)
        for number, jet in enumerate(vehicle.jets, 1)
        if str(number) not in stated and (jet.engine is None or str(number) in scenario.stations)
    ]
    parameters = []
    for name, deviation, spread in zip(table.parameters, table.deviation, table.spreads, strict=True):
        common = keys[f"{FLOWN_PARAMETERS}.{name}"]
        own = [keys[f"{FLOWN_STATIONS}{number}.{name}"] for number in stations]
        # A station that states another value is drawn around that value.
        single = tuple(key for key in own if spread or key.nominal != common.nominal)
        parameters.append(_UncertainParameter(deviation, spread, common, single))
    return EngineDraw(table, parameters)


def default_draw(scenario: Scenario, nominal: bool, varied: Collection[str] = ()) -> tuple[EngineDraw | None, str]:
    """Return the draws of an engine's uncertainty that a study makes by default, and a note.

    None for an engine that states no uncertainty, with a line on single stations' engines that do; None where
    ``nominal`` says so, and where a key of ``varied`` is drawn with it or brings another engine.  Raises InputError.
    """
    others = _describe_stations_not_drawn(scenario)
    source = find_source(scenario.engine, scenario.folder)
    if source.uncertainty is None:
        return None, others
    draw = engine_draw(scenario, source)
    drawn = {key.path for key in draw.keys}
    other = next((key for key in varied if key in drawn or brings_engine(key)), None)
    if nominal or other is not None:
        why = "" if other is None else f": {other} is varied"
        return None, f"the engine flies as it is stated and is not {draw.description}{why}"
    more = f"; {others}" if others else ""
    return draw, f"the engine of each flight is {draw.description}; nominal_engine flies it as it is stated{more}"


def _describe_stations_not_drawn(scenario: Scenario) -> str:
    """Describe stations whose own engine has an uncertainty that is not drawn; empty if none."""
    vehicle, _ = scenario.resolved_vehicle()
    found: dict[str, list[str]] = {}
    for number, station in enumerate(list_stations(scenario, vehicle), 1):
        engine = station.engine if station else None
        if engine is not None and find_source(engine, scenario.folder).uncertainty is not None:
            found.setdefault(engine, []).append(str(number))
    stations = "; ".join(f"{', '.join(numbers)}: {engine}" for engine, numbers in found.items())
    return f"[uncertainty] of engines at single stations is not drawn ({stations})" if found else ""


def brings_engine(key: str) -> bool:
    """Return whether a key may select another engine than the drawn one."""
    return key in (ENGINE, "aircraft") or (key.startswith("stations.") and key.endswith(f".{ENGINE}"))


def _nominal_value(key: Key) -> float:
    assert isinstance(key.nominal, (int, float))
    return float(key.nominal)


def _fit_to_key(drawn: Array, key: Key) -> list[Value]:
    """Return a drawn value in the key's type: integers within bounds for counts."""
    if key.kind != "int":
        return list(drawn.tolist())
    low = ceil(key.low) if isfinite(key.low) else -inf
    high = floor(key.high) if isfinite(key.high) else inf
    return [int(min(max(floor(value + 0.5), low), high)) for value in drawn.tolist()]
