"""Aircraft files: found by name or path, read, scaled from another aircraft where they say so, and validated."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from math import hypot, sqrt
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError, nearest
from cosim.base.signals import Vector3
from cosim.base.storage.cache import RecentCache
from cosim.base.storage.files import read_file
from cosim.base.storage.paths import ENGINE, data_folder, names_in
from cosim.base.storage.toml import Model, Positive, merge, read_toml, validate
from cosim.spec.file_kind import AIRCRAFT, check_kind
from cosim.spec.scaling import scale_vehicle
from cosim.spec.vehicle.vehicle import Vehicle

VEHICLE = "vehicle.toml"  # in an aircraft's folder


class ScaledFrom(Model):
    """Table ``scaled`` of a vehicle: missing keys are those of ``base``, scaled to this mass."""

    base: str
    mass_kg: Positive


def aircraft_names() -> list[str]:
    """Return the names of all shipped aircraft."""
    return names_in("aircraft", VEHICLE)


def is_aircraft_path(aircraft: str) -> bool:
    """Return whether an aircraft is named by a path: a folder with a ``vehicle.toml``, or such a file."""
    return "/" in aircraft or aircraft.lower().endswith(".toml") or aircraft in (".", "..")


def aircraft_seen_from(aircraft: str, folder: Path) -> str:
    """Return an aircraft's name; a path is made absolute, taken relative to ``folder``."""
    return str((folder / aircraft).absolute()) if is_aircraft_path(aircraft) else aircraft


def aircraft_name(aircraft: str, folder: Path = Path()) -> str:
    """Return an aircraft's name, from its file if given by path.  Raises InputError."""
    return load_vehicle(aircraft, folder=folder)[0].name if is_aircraft_path(aircraft) else aircraft


def engine_of(aircraft: str, folder: Path = Path()) -> str | None:
    """Return the engine an aircraft is designed for, a file as an absolute path; None where its file names none.

    Raises InputError as :func:`load_vehicle`.
    """
    vehicle, own_folder = load_vehicle(aircraft, folder=folder)
    return None if vehicle.engine is None else file_seen_from(vehicle.engine, own_folder)


def file_seen_from(engine: str, folder: Path) -> str:
    """Return an engine's name; the path of a file, or of a folder's engine.toml, is made absolute from ``folder``."""
    path = folder / engine
    if (path / ENGINE).is_file() and engine not in names_in("engines", ENGINE):
        return str((path / ENGINE).absolute())
    return str(path.absolute()) if is_file(engine) else engine


def is_file(engine: str) -> bool:
    """Return whether an engine is given by a file: FMU, mapping file, or the removed .ssp."""
    return engine.lower().endswith((".fmu", ".ssp", ".toml")) or "/" in engine


def find_aircraft(aircraft: str, folder: Path = Path()) -> Path:
    """Return the ``vehicle.toml`` of an aircraft given by its name or by a path relative to ``folder``.

    Raises InputError for an unknown aircraft (lists the known ones) and for a path where none is.
    """
    if not isinstance(aircraft, str):
        raise InputError(f"aircraft {aircraft!r}: must be a name or a path, as a text")
    if not is_aircraft_path(aircraft):
        path = data_folder("aircraft") / aircraft / VEHICLE
        if not path.is_file():
            suggestion = nearest(aircraft, aircraft_names())
            here = f"./{aircraft}" if (folder / aircraft / VEHICLE).is_file() else "the path of a folder"
            if (folder / aircraft).exists() and "./" not in here:
                raise InputError(f"{aircraft}: is no aircraft; {suggestion}, or {here}")
            raise InputError(f"unknown aircraft {aircraft!r}; {suggestion}, or {here}")
        return path
    path = folder / aircraft / (VEHICLE if (folder / aircraft).is_dir() else "")
    if not path.is_file():
        raise InputError(f"aircraft {path}: no such file; name a folder with a {VEHICLE}, or such a file")
    return path


_vehicles: RecentCache[tuple[dict[str, Any], Vehicle]] = RecentCache(32)
_bases: RecentCache[str | None] = RecentCache(32)


def load_vehicle(
    name: str, overrides: dict[str, Any] | None = None, where: str = "vehicle", folder: Path = Path()
) -> tuple[Vehicle, Path]:
    """Return an aircraft, ``overrides`` merged over its ``vehicle.toml``, and the folder of that file.

    >>> load_vehicle("hexjet", {"mass_kg": 6.0})[0].mass_kg
    6.0

    Parameters
    ----------
    name : str
        Name of a shipped aircraft, or a path: a folder, or a file.
    overrides : dict or None
        Tables that replace values of the file.
    where : str
        Name of the overrides in error messages.
    folder : Path
        Folder that a relative path starts from.

    Raises
    ------
    InputError
        For an unknown aircraft (lists the known ones), a path where none is, or a wrong key.
    """
    path = find_aircraft(name, folder)
    key, tables, vehicle = _read_unless_cached(path)
    if overrides:
        stated = _default_bank_inertia(overrides)
        key = (*key, repr(overrides))
        vehicle = _vehicles.get(key, lambda: (tables, validate(Vehicle, merge(tables, stated, vehicle), where)))[1]
    return vehicle, path.parent


def read_tables(name: str, folder: Path = Path()) -> dict[str, Any]:
    """Return the tables of an aircraft's file, scaling applied; raise InputError as :func:`load_vehicle`."""
    return _read_unless_cached(find_aircraft(name, folder))[1]


def _default_bank_inertia(overrides: dict[str, Any]) -> dict[str, Any]:
    """Set the bank inertia of a fully stated servo to zero by default, as files older than that key mean."""
    servo = overrides.get("servo")
    if not isinstance(servo, dict) or not {"lag_s", "rate_limit_rad_s", "range_rad"} <= set(servo):
        return overrides
    return overrides | {"servo": {"bank_inertia_kg_m2": 0.0, "bank_imbalance_kg_m": 0.0} | servo}


def _read_unless_cached(path: Path) -> tuple[tuple[Hashable, ...], dict[str, Any], Vehicle]:
    """Return path and contents of an aircraft's file, with those of its scaling base if any; its tables; the aircraft.

    What was read of the same contents before is returned as it is.
    """
    contents = read_file(path)
    base = _bases.get((path, contents), lambda: _find_base(path))
    sources = [contents] if base is None else [contents, read_file(data_folder("aircraft") / base / VEHICLE)]
    return (path, *sources), *_vehicles.get((path, *sources), lambda: _read_vehicle(path))


def _find_base(path: Path) -> str | None:
    """Return the shipped aircraft that a ``vehicle.toml`` is scaled from, or None."""
    law = read_toml(path).get("scaled")
    base = law.get("base") if isinstance(law, dict) else None
    return base if base in aircraft_names() else None


def _read_vehicle(path: Path) -> tuple[dict[str, Any], Vehicle]:
    tables = _read_tables(path)
    vehicle = validate(Vehicle, tables, str(path))
    if path.resolve().parents[1] != data_folder("aircraft") and vehicle.name in aircraft_names():
        raise InputError(f"{path}: name = {vehicle.name!r}: is the name of an aircraft that is shipped; choose another")
    engines = ((f"jets.{number}.engine", jet.engine) for number, jet in enumerate(vehicle.jets, 1))
    for key, file in (("engine", vehicle.engine), ("model", vehicle.model), *engines):
        if file is not None and (key == "model" or is_file(file)) and not (path.parent / file).is_file():
            raise InputError(f"{path}: {key} = {file!r}: no such file, as seen from the folder of {path.name}")
    _refuse_implausible(vehicle, path)
    return tables, vehicle


def _refuse_implausible(vehicle: Vehicle, path: Path) -> None:
    """Raise InputError for values in implausible units, and for legs that cannot carry the vehicle.

    Files are checked as they are read, overrides are not: a study may vary a vehicle beyond what is plausible.
    """
    positions = {f"jets.{n}.position_m": jet.position_m for n, jet in enumerate(vehicle.jets)}
    contacts = {f"contacts.{n}.position_m": contact.position_m for n, contact in enumerate(vehicle.contacts)}
    legs = {key: position for contact, (key, position) in zip(vehicle.contacts, contacts.items(), strict=True)
            if contact.kind == "leg"}  # fmt: skip
    fuel = {"fuel.position_m": vehicle.fuel.position_m} if vehicle.fuel else {}
    if why := _find_implausible(vehicle.mass_kg, vehicle.inertia_kg_m2, positions | contacts | fuel, legs):
        raise InputError(f"{path}: {why}")


def _find_implausible(
    mass: float,
    inertia: Vector3,
    positions: Mapping[str, Vector3],
    legs: Mapping[str, Vector3],
    farthest: float = 100.0,
) -> str:
    """Return the first implausible value as one line (key, value, allowed range), or an empty string.

    ``mass`` [kg], ``inertia`` [kg m^2], positions of all parts and of the ``legs`` [m, body frame] by their keys.
    ``farthest``: m from the centre of gravity, chosen by us: no vehicle here has a part beyond it.
    """
    for key, position in positions.items():
        if hypot(*position) > farthest:
            return (
                f"{key} {list(position)}: {hypot(*position):g} m from the centre of gravity, and at most "
                f"{farthest:g} m is allowed; places are in m"
            )
    return _check_gyration(mass, inertia, list(positions.values())) or _check_legs(legs)


def _check_gyration(
    mass: float, inertia: Vector3, positions: list[Vector3], low: float = 0.02, high: float = 3.0
) -> str:
    """Return a line on the first moment of inertia with an implausible radius of gyration, or an empty string.

    ``low`` and ``high``: allowed radius over the farthest part's distance from the axis.  Bodies have 0.05 to 1; chosen
    by us: a wrong unit is off by thirty at least.
    """
    for n, (axis, moment) in enumerate(zip("xyz", inertia, strict=True)):
        farthest = max(hypot(*(x for other, x in enumerate(position) if other != n)) for position in positions)
        radius = sqrt(moment / mass)
        if not low * farthest <= radius <= high * farthest:
            least, most = (mass * (ratio * farthest) ** 2 for ratio in (low, high))
            return (
                f"inertia_kg_m2.{n} = {moment:g} with mass_kg = {mass:g}: a radius of gyration of {radius:.3g} m about "
                f"{axis}, where parts reach {farthest:.3g} m; {least:.2g} to {most:.2g} kg m^2 is allowed: are they in "
                "kg, m and kg m^2?"
            )
    return ""


def _check_legs(legs: Mapping[str, Vector3]) -> str:
    if len(legs) < 3:
        return f"contacts: {len(legs)} of kind 'leg'; a vehicle stands on three at least, around its centre of gravity"
    for key, foot in legs.items():
        if foot[2] <= 0.0:
            return f"{key} {list(foot)}: a leg reaches below the centre of gravity; z points down and must be above 0"
    if not _encloses_origin([(x, y) for x, y, _ in legs.values()]):
        at = ", ".join(f"[{x:g}, {y:g}]" for x, y, _ in legs.values())
        return f"contacts: the centre of gravity, [0, 0], is not between the legs at {at} m; they must stand around it"
    return ""


def _encloses_origin(points: list[tuple[float, float]]) -> bool:
    """Return whether the origin is inside the convex hull: no line through it has all points on one side."""
    for x, y in points:
        # Only lines through the origin and one of the points need to be tried.
        sides = [x * b - y * a for a, b in points]
        if min(sides) >= 0.0 or max(sides) <= 0.0:
            ahead = [x * a + y * b for (a, b), side in zip(points, sides, strict=True) if side == 0.0]
            if min(ahead) >= 0.0 or not any(sides):
                return False
    return True


def _read_tables(path: Path) -> dict[str, Any]:
    """Read a ``vehicle.toml``, merged over the tables of its scaled base, if any."""
    tables = read_toml(path)
    check_kind(tables, path, AIRCRAFT)
    if "scaled" not in tables:
        return tables
    where = f"{path}: scaled"
    table = tables.pop("scaled")
    if not isinstance(table, dict):
        raise InputError(f"{where} = {table!r}: must be a table with base and mass_kg")
    law = validate(ScaledFrom, table, where)
    folder = data_folder("aircraft") / law.base
    if law.base not in aircraft_names():
        raise InputError(f"{where}.base: unknown aircraft {law.base!r}; {nearest(law.base, aircraft_names())}")
    base = read_toml(folder / VEHICLE)
    if "scaled" in base:
        raise InputError(f"{where}.base: {law.base} is a scaled copy itself; name the aircraft that it is made from")
    original = validate(Vehicle, base, str(folder / VEHICLE)).model_dump(mode="json", exclude_none=True)
    if any(key in original for key in ("hinges", "surfaces")) or "model" not in original:
        raise InputError(
            f"{where}.base: {law.base} is not of banks or rotors in a model of its own, which is what the law scales; "
            f"hexjet aircraft new NAME --from {law.base} copies it as it is"
        )
    near = path.parents[1] == data_folder("aircraft")
    model = f"../{law.base}/{original['model']}" if near else str(folder / original["model"])
    return merge(scale_vehicle(original, law.mass_kg) | {"model": model, "engine": None}, tables)
