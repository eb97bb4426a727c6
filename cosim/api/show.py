"""What can be flown, with its numbers, their units and what they mean: what ``hexjet show`` calls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cosim.api.call import Result, Table, check_types
from cosim.api.flights import FlightResult
from cosim.api.listing import KINDS, Kind, catalogue
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError, similar
from cosim.base.storage.paths import data_folder
from cosim.base.trust import without_code
from cosim.spec.controller_name import is_design
from cosim.spec.file_kind import AIRCRAFT, SCENARIO, STUDY

if TYPE_CHECKING:
    from cosim.engine import EngineSpec
    from cosim.engine.library import EngineDefinition
    from cosim.spec.vehicle import Vehicle

_SHOWABLE_FILES = (  # files that can be shown, for messages
    "the folder of a run, a design or an aircraft, the file of a scenario, a study, a design or an engine's mapping"
)
_TEXT_KEYS = ("name", "title", "description")  # keys that are no numbers


class Number(NamedTuple):
    """One value of a file with unit and meaning."""

    name: str
    value: Any
    unit: str
    meaning: str


class ShowResult(Result):
    """Description of a file, or the result of a run.

    Attributes
    ----------
    items : list of dict
        One for each kind that has the name: ``kind``, ``name``, ``title``, ``description``, and ``numbers``, each with
        ``name``, ``value``, ``unit`` and ``meaning``.
    """

    def __init__(self, items: list[dict[str, Any]]) -> None:
        self.items = items
        self.files = {}

    def to_list(self) -> list[dict[str, Any]]:
        """Return what ``hexjet show --json`` prints: an entry for each kind that has the name, SI."""
        return [item | {"numbers": [number._asdict() for number in item["numbers"]]} for item in self.items]

    def to_dict(self) -> dict[str, Any]:
        """Return the first entry of :meth:`to_list`."""
        return self.to_list()[0]

    def lines(self) -> list[str]:
        """Return name, kind, title and description of each entry, or a run's result."""
        if (flight := self._open_flight_result()) is not None:
            return flight.lines()
        return [
            line
            for item in self.items
            for line in (f"{item['name']}, {singular_kind(item)}: {item['title']}", item["description"])
            if line
        ]

    def tables(self) -> list[Table]:
        """Return a table of values per entry in display units (deg for rad), or a run's tables."""
        if (flight := self._open_flight_result()) is not None:
            return flight.tables()
        return [Table("", ("number", "value", "unit", "meaning"), number_rows(item)) for item in self.items]

    def _open_flight_result(self) -> FlightResult | None:
        """Return the flight's result if a run is shown, else None."""
        from cosim.results.run import open_run

        return FlightResult(open_run(self.items[0]["name"])) if self.items[0]["kind"] == "runs" else None


@check_types()
def show(name: str | Path, kind: Kind | None = None) -> ShowResult:
    """Return the values, units and meanings of a scenario, study, engine, aircraft, controller, run or design.

    To measure the thrust of an engine, its FMU is held at throttles until it stands still.

    >>> show("edf").verdict
    'edf, engine: Electric ducted fan'

    Parameters
    ----------
    name : str or Path
        A scenario, study, engine, aircraft or controller, also by its file; the folder of a run; the file of a design;
        or the mapping file of an engine.
    kind : str or None
        Where several kinds have the name; None: all that have it.

    Raises
    ------
    InputError
        If nothing is called so.
    """
    with without_code():
        path = str(name)
        file = None if kind else _show_design(path) or _show_mapping(path) or _show_run(path) or _show_file(path)
        return ShowResult([file] if file else _find_entries(path, [kind] if kind else KINDS))


def singular_kind(item: Mapping[str, Any]) -> str:
    kind = str(item["kind"])
    return {"studies": "study", "aircraft": "aircraft"}.get(kind, kind.removesuffix("s"))


def number_rows(item: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """Return an entry's values as texts, in display units (deg for rad)."""
    from cosim.results.wording import display_unit

    rows = []
    for number in item["numbers"]:
        unit, factor = display_unit(number.unit)
        value = factor * number.value if factor != 1.0 and isinstance(number.value, float) else number.value
        unit = unit if value is not number.value or factor == 1.0 else number.unit
        rows.append((number.name, _format_value(value), unit, number.meaning))
    return rows


def _find_entries(name: str, kinds: Sequence[str]) -> list[dict[str, Any]]:
    """Return the library's entries called ``name``, one per kind.  Raises InputError if there are none."""
    catalogues = {kind: catalogue(kind) for kind in kinds}
    shown = [
        {"kind": kind, **entry, "description": _description_of(kind, name), "numbers": list(_list_numbers(kind, name))}
        for kind, entries in catalogues.items()
        for entry in entries
        if entry["name"] == name
    ]
    if not shown:
        path = Path(name)
        if path.exists():
            raise InputError(f"{name}: cannot be shown; allowed: a name of hexjet show, {_SHOWABLE_FILES}")
        names = {*KINDS, *(entry["name"] for entries in catalogues.values() for entry in entries)}
        names |= {str(other) for folder in {Path("runs"), path.parent} if folder.is_dir() for other in folder.iterdir()}
        raise InputError(f"nothing is called {name!r}; {similar(name, names)}")
    return shown


def _show_run(name: str) -> dict[str, Any] | None:
    """Return the description of the run in folder ``name``, or None if it is no run.  Raises InputError."""
    from cosim.results.report.requirements import checked_rows
    from cosim.results.run import SUMMARY, open_run

    if not (Path(name) / SUMMARY).is_file():
        return None
    summary = open_run(name).summary
    meanings: dict[str, list[str]] = {}
    for key, (_, source, allowed, margin, at) in checked_rows(summary):
        meanings.setdefault(key, []).append(f"{source} {allowed}, margin {margin}, {at}")
    return {
        "kind": "runs",
        "name": name,
        "title": summary.ending,
        "description": f"{summary.scenario}: {summary.aircraft}, engine {summary.engine_shown}, "
        f"controller {summary.controller_shown}, seed {summary.seed}",
        "numbers": [
            Number(key, value, _find_unit(key), "; ".join(meanings.get(key, ())))
            for key, value in summary.flat_metrics.items()
            if value is not None or key in meanings
        ],
    }


def _show_file(name: str) -> dict[str, Any] | None:
    """Return the description of a scenario's, study's or aircraft's file; None for other names.  Raises InputError."""
    from cosim.base.storage.toml import read_toml

    path = Path(name)
    file = path / "vehicle.toml" if path.is_dir() else path
    if file.suffix.lower() != ".toml" or not file.is_file():
        return None
    table = read_toml(file)
    kinds = {STUDY: "studies", AIRCRAFT: "aircraft", SCENARIO: "scenarios"}
    kind = next((name for kind, name in kinds.items() if kind.matches(table)), None)
    if kind is None:
        return None
    if kind == "aircraft":
        numbers = _list_aircraft_numbers(name)
    else:
        numbers = _list_scenario_numbers(name, table) if kind == "scenarios" else _list_file_numbers(table, kind)
    described = {key: " ".join(str(table.get(key, "")).split()) for key in ("title", "description")}
    return {"kind": kind, "name": name, **described, "numbers": list(numbers)}


def _show_design(name: str) -> dict[str, Any] | None:
    """Return the description of a controller file, or None for other names.  Raises InputError."""
    from cosim.base.storage.toml import read_toml
    from cosim.simulation.controllers.controller_file import AxisRecord, describe_proof, read_purpose
    from cosim.spec.meanings import meaning_of

    path = Path(name) / "controller.toml" if Path(name).is_dir() else Path(name)
    table = read_toml(path) if is_design(str(path)) and path.is_file() else {}
    if not isinstance(table.get("design"), Mapping):  # a study's design is a string
        return None
    purpose = read_purpose(path)
    margins = [
        number._replace(meaning=meaning_of(AxisRecord, number.name.rpartition(".")[2]))
        for axis, record in purpose.axes.items()
        for number in _list_leaf_numbers(record.model_dump(exclude_none=True, exclude={"candidates"}), f"{axis}.")
    ]
    return {
        "kind": "designs",
        "name": name,
        "title": f"{table['controller']} for {purpose.aircraft} with engine {purpose.engine}",
        "description": describe_proof(purpose),
        "numbers": [*margins, *_list_file_numbers(table["vehicle"], "vehicle")],
    }


def _show_mapping(name: str) -> dict[str, Any] | None:
    """Return the description of an engine's mapping file, whose FMU is not run, or None.  Raises InputError."""
    from cosim.base.storage.toml import read_toml
    from cosim.engine.source import find_source, resolve_parameters

    path = Path(name)
    if path.suffix.lower() != ".toml" or not path.is_file() or "fmu" not in read_toml(path):
        return None
    source = find_source(name)
    values, _ = resolve_parameters(source, {})
    known = {variable.name: variable for variable in source.archive.parameters}
    numbers = [Number(each, value, known[each].unit or "", known[each].description) for each, value in values.items()]
    table = source.mapping.uncertainty
    uncertain = table.parameters if table is not None else []
    for index, each in enumerate(uncertain):
        assert table is not None
        meaning = table.describe(index)
        numbers.append(Number(f"uncertainty.{each}", table.deviation[index], known[each].unit or "", meaning))
    return {
        "kind": "engines",
        "name": name,
        "title": source.mapping.title or source.archive.model,
        "description": f"uncertainty: {table.source or 'of no stated source'}" if table is not None else "",
        "numbers": numbers,
    }


def _read_library_file(kind: str, name: str) -> dict[str, Any]:
    """Return the tables of a library entry's TOML file; a controller has none."""
    if kind == "controllers":
        return {}
    inside = {"aircraft": f"{name}/vehicle.toml", "engines": f"{name}/engine.toml"}.get(kind, f"{name}.toml")
    from cosim.base.storage.toml import read_toml

    return read_toml(data_folder(kind) / inside)


def _description_of(kind: str, name: str) -> str:
    return " ".join(str(_read_library_file(kind, name).get("description", "")).split())


def _list_numbers(kind: str, name: str) -> Iterator[Number]:
    """Return the values that are shown of a library entry of this kind."""
    if kind == "aircraft":
        return _list_aircraft_numbers(name)
    if kind == "engines":
        return _list_engine_numbers(name)
    if kind == "controllers":
        return _list_controller_numbers(name)
    table = _read_library_file(kind, name)
    return _list_scenario_numbers(name, table) if kind == "scenarios" else _list_file_numbers(table, kind)


def _list_scenario_numbers(name: str, table: Mapping[str, Any]) -> Iterator[Number]:
    """Yield a scenario's aircraft, engine, controller and duration, defaults included, then what its file states."""
    from cosim.spec.meanings import meaning_of
    from cosim.spec.scenario import Scenario

    scenario = Scenario.load(name)
    first = ("duration_s", "step_s", "aircraft", "engine", "controller", "seed")
    for key in first:
        yield Number(key, getattr(scenario, key), _find_unit(key), meaning_of(Scenario, key))
    yield from _list_file_numbers({key: value for key, value in table.items() if key not in first}, "scenarios")


def _list_aircraft_numbers(name: str) -> Iterator[Number]:
    from cosim.spec.vehicle import is_file, load_vehicle

    vehicle, _ = load_vehicle(name)
    engines = [jet.engine for jet in vehicle.jets]
    jets, weight = len(vehicle.jets), vehicle.mass_kg * GRAVITY
    yield Number("mass", vehicle.mass_kg, "kg", "with fuel, without payload")
    for axis, inertia in zip("xyz", vehicle.inertia_kg_m2, strict=True):
        yield Number(f"inertia {axis}", inertia, "kg m^2", f"about the body's {axis}")
    for pair, product in zip(("x y", "x z", "y z"), vehicle.products_kg_m2, strict=True):
        if product:
            yield Number(f"product {pair}", product, "kg m^2", f"integral of {pair} over the mass")
    yield Number("jets", jets, "", "engines" + ("" if vehicle.servo is None else " on two tilting banks"))
    yield from _list_hinge_numbers(vehicle)
    for surface in vehicle.surfaces:
        yield Number(f"surface {surface.name}", surface.range[1], "", f"the most, {surface.range[0]:g} the least")
    arms = [(max(abs(jet.position_m[n]) for jet in vehicle.jets), word) for n, word in ((1, "sideways"), (0, "ahead"))]
    for arm, word in arms:
        yield Number(f"arm {word}", arm, "m", "of the farthest jet from the centre of gravity")
    yield Number("hover thrust", weight / jets, "N", "of each jet: weight over jets")
    if vehicle.engine is not None and not any(is_file(each or vehicle.engine) for each in engines):
        yield from _list_thrusts(vehicle, weight)
    if vehicle.servo is not None:
        yield Number("tilt range", vehicle.servo.range_rad, "rad", "of a bank, either way from straight up")
        yield Number("tilt rate", vehicle.servo.rate_limit_rad_s, "rad/s", "the fastest that a bank turns")
        yield Number("tilt lag", vehicle.servo.lag_s, "s", "of the first-order servo")
    if vehicle.fuel is not None:
        yield Number("fuel", vehicle.fuel.mass_kg, "kg", "in the tank at the start, part of the mass")
    yield Number("span", vehicle.aero.span_m, "m", "by which turbulence and limits are scaled")
    for axis, area in zip("xyz", vehicle.aero.drag_area_m2, strict=True):
        yield Number(f"drag area {axis}", area, "m^2", f"drag coefficient times area along {axis}")
    yield from _list_dead_times(vehicle)


def _list_dead_times(vehicle: Vehicle) -> Iterator[Number]:
    for engine, axes in vehicle.identified.items():
        for axis, model in axes.items():
            late = model.delay_samples * model.sample_time_s
            yield Number(
                f"dead time, {axis}, {engine}",
                late,
                "s",
                "of the identified model from command to rate, besides its lags",
            )


def _list_hinge_numbers(vehicle: Vehicle) -> Iterator[Number]:
    """Yield the range of each hinge, with the jets that it moves."""
    for hinge in vehicle.hinges:
        effects = [f"carries {', '.join(map(str, hinge.carries))}"] if hinge.carries else []
        effects += [f"deflects {', '.join(map(str, hinge.deflects))}"] if hinge.deflects else []
        lowest, highest = hinge.angle_limits
        name, motion = f"hinge {hinge.name}", " and ".join(effects)
        if lowest == -highest:
            yield Number(name, highest, "rad", f"either way; {motion}")
        else:
            yield Number(name, highest, "rad", f"the most; {motion}")
            yield Number(f"{name}, least", lowest, "rad", "the other end of its range")


def _list_thrusts(vehicle: Vehicle, weight: float) -> Iterator[Number]:
    """Yield full thrust and thrust to weight of an aircraft's default engines; ``weight`` in N."""
    assert vehicle.engine is not None
    kinds = [jet.engine or vehicle.engine for jet in vehicle.jets]
    full = {kind: _load_library_engine(kind)[1].curve.thrust[-1] for kind in dict.fromkeys(kinds)}
    yield Number("engine", vehicle.engine, "", "what it is made for")
    for kind, thrust in full.items():
        at = ", ".join(str(number) for number, engine in enumerate(kinds, 1) if engine == kind)
        name, of = ("full thrust", "") if len(full) == 1 else (f"full thrust, {kind}", f"; jets {at}")
        yield Number(name, thrust, "N", f"of one engine at rest, at full throttle{of}")
    total = sum(full[kind] for kind in kinds)
    yield Number("thrust to weight", total / weight, "", "all engines at full throttle")


def _list_engine_numbers(name: str) -> Iterator[Number]:
    definition, spec = _load_library_engine(name)
    throttle = spec.curve.throttle
    yield Number("full thrust", spec.curve.thrust[-1], "N", f"at rest, at throttle {throttle[-1]:g}")
    # An engine without idling runs down by a lag; below this fraction of full thrust what remains is taken as 0.
    idle = spec.curve.thrust[0] if spec.curve.thrust[0] > 1e-9 * spec.curve.thrust[-1] else 0.0
    yield Number("idle thrust", idle, "N", f"at rest, at throttle {throttle[0]:g}")
    yield Number("internal step", definition.internal_step, "s", "control steps are whole multiples of it")
    if spec.delay_samples is not None:
        delay = spec.delay_samples * definition.internal_step
        yield Number("dead time", delay, "s", "from throttle to thrust, besides its lags")
    if definition.rotor_inertia:
        yield Number("rotor inertia", definition.rotor_inertia, "kg m^2", "of everything that turns")
    for variable in definition.variables:
        value = spec.parameters.get(variable.name, variable.start)
        yield Number(
            variable.name,
            variable.causality if value is None or variable.causality != "parameter" else value,
            variable.unit or "",
            variable.description,
        )


def _load_library_engine(name: str) -> tuple[EngineDefinition, EngineSpec]:
    """Return a shipped engine's definition, and the engine loaded at its internal step.  Raises InputError."""
    from cosim.engine import find_source, load_engine

    source = find_source(name)
    assert source.engine is not None
    return source.engine, load_engine(source, {}, source.engine.internal_step)


def _list_controller_numbers(name: str) -> Iterator[Number]:
    from cosim.control.predictors.registry import PREDICTORS

    spec = PREDICTORS.get(name)
    if spec is None:
        return
    yield Number(
        "model", "yes" if spec.needs_model else "no", "", "whether it needs an identified model of the vehicle"
    )
    for parameter in spec.parameters:
        value = "vehicle's" if parameter.default is None else parameter.default
        span = f"; {parameter.least:g} to {parameter.most:g}"
        yield Number(parameter.name, value, parameter.unit, f"{parameter.text}{span}")


def _list_file_numbers(table: Mapping[str, Any], kind: str) -> Iterator[Number]:
    """Yield a value for each key of a file, and for each entry of a list of tables."""
    from cosim.campaign.study.study import Study
    from cosim.spec.meanings import meaning_of
    from cosim.spec.scenario import Scenario
    from cosim.spec.vehicle import Vehicle

    model = {"scenarios": Scenario, "studies": Study}.get(kind, Vehicle)
    for key, value in table.items():
        if key not in _TEXT_KEYS:
            yield from (leaf._replace(meaning=meaning_of(model, key)) for leaf in _list_leaf_numbers({key: value}, ""))


def _list_leaf_numbers(table: Mapping[str, Any], prefix: str) -> Iterator[Number]:
    """Yield each value of nested tables, under its dotted key behind ``prefix``."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _list_leaf_numbers(value, f"{prefix}{key}.")
        elif isinstance(value, list) and any(isinstance(element, Mapping) for element in value):
            for number, item in enumerate(value):
                leaves = (f"{leaf.name}={_format_value(leaf.value)}" for leaf in _list_leaf_numbers(item, ""))
                yield Number(f"{prefix}{key}.{number}", " ".join(leaves), "", "")
        else:
            yield Number(f"{prefix}{key}", value, _find_unit(key), "")


def _find_unit(key: str) -> str:
    """Return the unit in which the name of a key ends, empty if there is none."""
    from cosim.campaign.study.key import unit_of

    return unit_of(key)


def _format_value(value: Any) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_format_value(element) for element in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)
