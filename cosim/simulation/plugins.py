"""Blocks of the user's beside the controller: metrics, observers, sensors and a wind, found by their names.

A wind may also be a table, ``FILE.csv``.
Whatever one of them raises or gives back wrongly ends the flight as a :class:`FlightError` that names it; a metric's
error is the metric's, the flight is over by then.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.base.errors import FlightError, InputError, describe_error, nearest
from cosim.base.plugins.entry_points import KIND_GROUPS, find_entries
from cosim.base.protocols import Columns, Sensors
from cosim.base.signals import Measured, Sample, State, Vector3
from cosim.simulation.controllers.guard import CallGuard, read_columns_of
from cosim.simulation.controllers.source import PYTHON_NAME, Source, check_method, find_python
from cosim.simulation.script.command_script import read_columns
from cosim.simulation.script.wind import FieldWind
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle
from cosim.spec.vehicle.sensor_profile import profile_names

if TYPE_CHECKING:
    import numpy as np

METRIC_PREFIX = "own."  # prefix of a custom metric's name
WIND_COLUMNS = ("time_s", "north_m_s", "east_m_s", "down_m_s")  # columns of a table of wind
# Numbers of plug-ins' random streams; 0 and 1 are those of the built-in sensors.
_RANDOM_STREAMS = {"observer": 2, "sensors": 3, "wind": 4}


@dataclass(frozen=True)
class BlockInfo:
    """Data for the ``prepare`` of a block other than a controller."""

    step_s: float
    vehicle: Vehicle  # the vehicle as stated
    _seed: int
    _key: tuple[int, int]

    def random(self) -> np.random.Generator:
        """Return a random generator of the block's own, the same at every call: for ``reset``, or for each flight."""
        import numpy as np

        return np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=self._key))


@dataclass(frozen=True)
class CustomMetric:
    """User's metric: names, log columns that it reads (None: any), and source of its function."""

    source: Source
    names: tuple[str, ...]  # metric names with METRIC_PREFIX
    columns: tuple[str, ...] | None

    def compute(self, log: Columns, step_s: float) -> dict[str, float | None]:
        """Return the metric's numbers by name; None if undefined for this flight.  Raises FlightError."""
        where = f"metric {self.source.label}"
        try:
            answer = self.source.make()(log, step_s)
        except (FlightError, InputError) as error:
            raise FlightError(f"{where}: {error}") from error
        except Exception as error:
            raise FlightError(f"{where}: raised {describe_error(error)}") from error
        names = [name.removeprefix(METRIC_PREFIX) for name in self.names]
        if not isinstance(answer, Mapping):
            if len(names) != 1:
                raise FlightError(f"{where}: gave {answer!r}: must be a mapping with {', '.join(names)}")
            answer = {names[0]: answer}
        if set(answer) != set(names):
            raise FlightError(f"{where}: gave {', '.join(map(str, answer))}: must be {', '.join(names)}")
        values: dict[str, float | None] = {}
        for name in names:
            value = answer[name]
            try:
                number = None if value is None else float(value)
            except (TypeError, ValueError) as error:
                raise FlightError(f"{where}: {name} = {value!r}: must be a number or None") from error
            values[METRIC_PREFIX + name] = number if number is not None and isfinite(number) else None
        return values


@dataclass(frozen=True)
class Plugins:
    """User blocks that a scenario names besides its controller."""

    metrics: tuple[CustomMetric, ...] = ()
    observers: tuple[GuardedObserver, ...] = ()
    sensors: Callable[[Sensors], Sensors] | None = None  # wraps the built-in sensors
    wind: Callable[[Vehicle, float, float], FieldWind] | None = None
    sources: Mapping[str, Sequence[Source]] = field(default_factory=dict)  # sources by key of the scenario

    def close(self) -> None:
        """Tell observers that the flight is over.  Raises FlightError."""
        for observer in self.observers:
            observer.close()


def find_block(kind: str, name: str, folder: Path) -> Source:
    """Return the source of a block by name; a file is relative to ``folder``.  Raises InputError."""
    source = find_python(kind, name, folder)
    if source is None:
        entries = find_entries(kind)
        ways = f"FILE.py:Name, package.module:Name or an entry point of {KIND_GROUPS[kind]}"
        more = f" ({nearest(name, entries)})" if entries else ""
        first = {"wind": "FILE.csv, ", "sensors": "".join(f"{profile}, " for profile in profile_names())}
        raise InputError(f"{kind} {name}: must be {first.get(kind, '')}{ways}{more}")
    return source


def load_plugins(scenario: Scenario) -> Plugins:
    """Return the user's blocks that a scenario names besides its controller, ready to fly.

    Raises InputError for a name, a file or a table that does not do, and for another file than the one that flew.
    """
    names_by_key = {"metrics": scenario.metrics, "observers": scenario.observers}
    names_by_key |= {
        key: [name] for key, name in (("sensors", scenario.sensor_plugin), ("wind", scenario.wind)) if name
    }
    kinds = {"metrics": "metric", "observers": "observer"}
    sources = {
        key: [_find_block_source(kinds.get(key, key), name, scenario) for name in names]
        for key, names in names_by_key.items()
        if names
    }
    vehicle = scenario.resolved_vehicle()[0] if sources else None
    plugins: dict[str, Any] = {}
    if vehicle is not None:
        names_taken: set[str] = set()
        metrics = []
        for source in sources.get("metrics", []):
            metrics.append(read_metric(source))
            for each in metrics[-1].names:
                if each in names_taken:
                    raise InputError(f"metric {source.label}: {each} is said by another one already")
                names_taken.add(each)
        plugins["metrics"] = tuple(metrics)
        plugins["observers"] = tuple(
            [
                GuardedObserver(s, _make_block(s, scenario, vehicle, n))
                for n, s in enumerate(sources.get("observers", []))
            ]
        )
        for source in sources.get("sensors", []):
            block = _make_block(source, scenario, vehicle, 0)
            plugins["sensors"] = lambda inner: GuardedSensors(source, block, inner)  # noqa: B023  there is one
        for source in sources.get("wind", []):
            plugins["wind"] = _make_wind(source, scenario, vehicle)
    return Plugins(sources=sources, **plugins)


def _find_block_source(kind: str, name: str, scenario: Scenario) -> Source:
    if kind == "wind" and name.lower().endswith(".csv"):
        path = (scenario.folder / name).absolute()
        if not path.is_file():
            raise InputError(f"wind {name}: {path}: no such file")
        table = WindTable.read(path)
        source = Source(name, kind, lambda: table, {path.name: path})
    else:
        source = find_block(kind, name, scenario.folder)
    source.check_hash(scenario.own_sha256.get(name), f"scenario {scenario.name}", kind, "own_sha256")
    return source


def read_metric(source: Source) -> CustomMetric:
    """Return a source's metric, with the names and columns that it declares.  Raises InputError."""
    where, block = f"metric {source.label}", source.make()
    default_name = getattr(block, "__name__", type(block).__name__).lower()
    names = getattr(block, "names", (default_name,))
    if isinstance(names, str) or not names or not all(isinstance(n, str) and PYTHON_NAME.fullmatch(n) for n in names):
        raise InputError(f"{where}: names = {names!r}: must be names of letters, digits and _, no digit first")
    if len({*names}) < len(names):
        raise InputError(f"{where}: names = {names!r}: one is there twice")
    columns = getattr(block, "columns", None)
    if columns is not None and (isinstance(columns, str) or not all(isinstance(column, str) for column in columns)):
        raise InputError(f"{where}: columns = {columns!r}: must be names of columns of the log")
    return CustomMetric(source, tuple(METRIC_PREFIX + n for n in names), None if columns is None else tuple(columns))


def make_unavailable_metric(name: str) -> CustomMetric:
    """Return a metric that refuses to be computed, for a killed flight: what finishes such a flight runs no code."""

    def refuse_to_measure() -> Any:
        raise InputError("not measured: the flight was killed, and what finishes such a flight runs no code")

    return CustomMetric(Source(name, "metric", refuse_to_measure, {}), (), ())


def load_metrics(scenario: Scenario) -> list[CustomMetric]:
    """Return the scenario's custom metrics.  Raises InputError."""
    return [read_metric(_find_block_source("metric", name, scenario)) for name in scenario.metrics]


def _make_block(source: Source, scenario: Scenario, vehicle: Vehicle, number: int) -> Any:
    block = source.make()
    if hasattr(block, "prepare"):
        check_method(block, "prepare", ("told",), f"{source.level} {source.label}")
        info = BlockInfo(scenario.step_s, vehicle, scenario.seed, (_RANDOM_STREAMS[source.level], number))
        try:
            _call_guarded(source, "prepare", block.prepare, info)
        except FlightError as error:
            raise InputError(str(error)) from error
    return block


def _call_guarded(source: Source, what: str, method: Callable[..., Any], *arguments: Any) -> Any:
    return CallGuard(source.label, kind=source.level).call(what, method, *arguments)


class GuardedObserver:
    """User's observer, whose errors name it."""

    def __init__(self, source: Source, block: Any) -> None:
        self._source, self._block = source, block

    def observe(self, sample: Sample) -> None:
        _call_guarded(self._source, "observe", self._block.observe, sample)

    def close(self) -> None:
        """Call the observer's ``close``, as the flight is over and the log complete."""
        if hasattr(self._block, "close"):
            _call_guarded(self._source, "close", self._block.close)


class GuardedSensors:
    """User's sensors, which get the true state and the built-in measurement."""

    def __init__(self, source: Source, block: Any, inner: Sensors) -> None:
        self._source, self._block, self._inner = source, block, inner
        self.columns = read_columns_of(block)

    def reset(self, state: State) -> Measured:
        return self._call_and_check("reset", self._block.reset, state, self._inner.reset(state))

    def sample(self, state: State) -> Measured:
        return self._call_and_check("sample", self._block.sample, state, self._inner.sample(state))

    def _call_and_check(self, what: str, method: Callable[..., Any], state: State, measured: Measured) -> Measured:
        answer = _call_guarded(self._source, what, method, state, measured)
        where = f"sensors {self._source.label}"
        if not isinstance(answer, Measured):
            raise FlightError(f"{where}: {what} gave {type(answer).__name__}: must be a Measured")
        values: list[Any] = []
        for name, part in zip(Measured._fields, answer, strict=True):
            given: Any = (part,) if name == "altitude" else part
            try:
                numbers = [float(value) for value in given]
            except (TypeError, ValueError):
                raise FlightError(f"{where}: {name} = {part!r}: must be numbers") from None
            if len(numbers) != (1 if name == "altitude" else 4 if name == "attitude" else 3):
                raise FlightError(f"{where}: {name} has {len(numbers)} numbers")
            if name != "specific_force" and not all(isfinite(value) for value in numbers):
                raise FlightError(f"{where}: {name} = {part}: must be finite")
            values.append(numbers[0] if name == "altitude" else tuple(numbers))
        return Measured(*values)

    @property
    def shown(self) -> tuple[float, ...]:
        return tuple([float(value) for value in _call_guarded(self._source, "shown", lambda: self._block.shown)])


def _make_wind(source: Source, scenario: Scenario, vehicle: Vehicle) -> Callable[[Vehicle, float, float], FieldWind]:
    block = _make_block(source, scenario, vehicle, 0)

    def reset() -> None:
        if hasattr(block, "reset"):
            _call_guarded(source, "reset", block.reset)

    def velocity(time: float, north: float, east: float, height: float) -> Vector3:
        answer = _call_guarded(source, "velocity", block.velocity, time, north, east, height)
        try:
            x, y, z = [float(value) for value in answer]
        except (TypeError, ValueError):
            raise FlightError(f"wind {source.label}: velocity gave {answer!r}: must be three numbers") from None
        if not (isfinite(x) and isfinite(y) and isfinite(z)):
            raise FlightError(f"wind {source.label}: velocity gave {(x, y, z)}: must be finite")
        return (x, y, z)

    stations = () if isinstance(block, WindTable) else tuple(jet.position_m for jet in vehicle.jets)
    return lambda flown, step, height: FieldWind(
        velocity, reset, step, () if not stations else tuple(jet.position_m for jet in flown.jets), height
    )


class WindTable:
    """Wind that is equal everywhere: rows of time [s] and velocity [m/s, NED], interpolated linearly.

    Before the first row the first holds, after the last the last.
    """

    def __init__(self, times: Sequence[float], velocities: Sequence[Vector3]) -> None:
        self._times, self._velocities = list(times), list(velocities)

    @classmethod
    def read(cls, path: Path) -> WindTable:
        """Return the wind of a file with header :data:`WIND_COLUMNS`.  Raises InputError with file and line."""
        times, columns = read_columns(path, WIND_COLUMNS[1:], f"wind {path.name}", all_of_them=True)
        north, east, down = columns.values()
        return cls(times, list(zip(north, east, down, strict=True)))

    def velocity(self, time: float, north: float, east: float, height: float) -> Vector3:
        """Return the velocity of the air [m/s, NED] at ``time``, at any position."""
        after = bisect_right(self._times, time)
        if after == 0:
            return self._velocities[0]
        if after == len(self._times):
            return self._velocities[-1]
        first, last = self._times[after - 1], self._times[after]
        share = (time - first) / (last - first)
        (a, b, c), (x, y, z) = self._velocities[after - 1], self._velocities[after]
        return (a + share * (x - a), b + share * (y - b), c + share * (z - c))
