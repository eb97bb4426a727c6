"""Aircraft files: found by name or path, read, scaled from another aircraft where they say so, and validated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim.base.errors import InputError, nearest
from cosim.base.storage.cache import RecentCache
from cosim.base.storage.paths import data_folder, names_in
from cosim.base.storage.toml import Model, Positive, merge, read_toml, validate
from cosim.spec.file_kind import AIRCRAFT, refuse_other_kind
from cosim.spec.plausible import find_implausible
from cosim.spec.scaling import scale_vehicle
from cosim.spec.vehicle.vehicle import Vehicle

VEHICLE = "vehicle.toml"  # in an aircraft's folder


class ScaledFrom(Model):
    """The table ``scaled``: keys that the file does not have are taken from ``base``, scaled to this mass."""

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
    """Return an aircraft's name, read from its file where a path is given; raise InputError as :func:`load_vehicle`."""
    return load_vehicle(aircraft, folder=folder)[0].name if is_aircraft_path(aircraft) else aircraft


def engine_of(aircraft: str, folder: Path = Path()) -> str | None:
    """Return the engine an aircraft is designed for, a file as an absolute path; None where its file names none.

    Raises InputError as :func:`load_vehicle`.
    """
    vehicle, own_folder = load_vehicle(aircraft, folder=folder)
    return None if vehicle.engine is None else file_seen_from(vehicle.engine, own_folder)


def file_seen_from(engine: str, folder: Path) -> str:
    """Return an engine's name; a file's path is made absolute, taken relative to ``folder``."""
    return str((folder / engine).absolute()) if is_file(engine) else engine


def is_file(engine: str) -> bool:
    """Return whether an engine is given by a file: an FMU, a system of them (SSP), or a mapping file that names one."""
    return engine.lower().endswith((".fmu", ".ssp", ".toml")) or "/" in engine


def find_aircraft(aircraft: str, folder: Path = Path()) -> Path:
    """Return the ``vehicle.toml`` of an aircraft given by its name or by a path relative to ``folder``.

    Raises InputError for an unknown aircraft (lists the known ones) and for a path where none is.
    """
    if not is_aircraft_path(aircraft):
        path = data_folder("aircraft") / aircraft / VEHICLE
        if not path.is_file():
            suggestion = nearest(aircraft, aircraft_names())
            here = f"./{aircraft}" if (folder / aircraft / VEHICLE).is_file() else "the path of a folder"
            raise InputError(f"unknown aircraft {aircraft!r}; {suggestion}, or {here}")
        return path
    path = folder / aircraft
    path = path / VEHICLE if path.is_dir() else path
    if not path.is_file():
        raise InputError(f"aircraft {path}: no such file; name a folder with a {VEHICLE}, or such a file")
    return path


_vehicles: RecentCache[tuple[dict[str, Any], Vehicle]] = RecentCache(32)
_bases: RecentCache[str | None] = RecentCache(32)


def load_vehicle(
    name: str, overrides: dict[str, Any] | None = None, where: str = "vehicle", folder: Path = Path()
) -> tuple[Vehicle, Path]:
    """Read an aircraft's ``vehicle.toml`` with ``overrides`` merged over it.

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

    Returns
    -------
    tuple of Vehicle and Path
        The vehicle, and the folder of its file.

    Raises
    ------
    InputError
        For an unknown aircraft (lists the known ones), a path where none is, or a wrong key.
    """
    path = find_aircraft(name, folder)
    tables, vehicle = _read_cached(path)
    if overrides:
        vehicle = validate(Vehicle, merge(tables, _without_bank_inertia(overrides)), where)
    return vehicle, path.parent


def read_tables(name: str, folder: Path = Path()) -> dict[str, Any]:
    """Return the tables of an aircraft's file, scaling applied; raise InputError as :func:`load_vehicle`."""
    return _read_cached(find_aircraft(name, folder))[0]


def _read_cached(path: Path) -> tuple[dict[str, Any], Vehicle]:
    return _vehicles.get((path, *_source_texts(path)), lambda: _read(path))


def _without_bank_inertia(overrides: dict[str, Any]) -> dict[str, Any]:
    """Set the bank inertia of a fully specified servo to zero: files older than that key had none."""
    servo = overrides.get("servo")
    if not isinstance(servo, dict) or not {"lag_s", "rate_limit_rad_s", "range_rad"} <= set(servo):
        return overrides
    return overrides | {"servo": {"bank_inertia_kg_m2": 0.0, "bank_imbalance_kg_m": 0.0} | servo}


def _source_texts(path: Path) -> list[bytes]:
    """Return the contents of an aircraft's file and of the file that it is scaled from, where there is one."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    base = _bases.get((path, text), lambda: _find_base(path))
    return [text] if base is None else [text, (data_folder("aircraft") / base / VEHICLE).read_bytes()]


def _find_base(path: Path) -> str | None:
    """Return the shipped aircraft that a ``vehicle.toml`` is scaled from; None where it is not."""
    law = read_toml(path).get("scaled")
    base = law.get("base") if isinstance(law, dict) else None
    return base if base in aircraft_names() else None


def _read(path: Path) -> tuple[dict[str, Any], Vehicle]:
    tables = _read_tables(path)
    vehicle = validate(Vehicle, tables, str(path))
    if path.parents[1] != data_folder("aircraft") and vehicle.name in aircraft_names():
        raise InputError(f"{path}: name = {vehicle.name!r}: is the name of an aircraft that is shipped; choose another")
    engines = ((f"jets.{number}.engine", jet.engine) for number, jet in enumerate(vehicle.jets, 1))
    for key, file in (("engine", vehicle.engine), ("model", vehicle.model), *engines):
        if file is not None and (key == "model" or is_file(file)) and not (path.parent / file).is_file():
            raise InputError(f"{path}: {key} = {file!r}: no such file, as seen from the folder of {path.name}")
    _refuse_implausible(vehicle, path)
    return tables, vehicle


def _refuse_implausible(vehicle: Vehicle, path: Path) -> None:
    positions = {f"jets.{n}.position_m": jet.position_m for n, jet in enumerate(vehicle.jets)}
    contacts = {f"contacts.{n}.position_m": contact.position_m for n, contact in enumerate(vehicle.contacts)}
    legs = {key: position for contact, (key, position) in zip(vehicle.contacts, contacts.items(), strict=True)
            if contact.kind == "leg"}  # fmt: skip
    fuel = {"fuel.position_m": vehicle.fuel.position_m} if vehicle.fuel else {}
    if why := find_implausible(vehicle.mass_kg, vehicle.inertia_kg_m2, positions | contacts | fuel, legs):
        raise InputError(f"{path}: {why}")


def _read_tables(path: Path) -> dict[str, Any]:
    """Return the tables of a ``vehicle.toml``, merged over those of the aircraft that it scales, if any."""
    tables = read_toml(path)
    refuse_other_kind(tables, path, AIRCRAFT)
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
