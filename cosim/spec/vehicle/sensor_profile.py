"""Sensor profiles: named settings that a scenario applies to the sensors of any aircraft."""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.base.storage.toml import merge, read_toml, validate
from cosim.spec.controller_name import HASH_DIGITS
from cosim.spec.vehicle.files import load_vehicle
from cosim.spec.vehicle.sensors import Sensors
from cosim.spec.vehicle.vehicle import Vehicle

STATED = "stated"  # name of the unchanged profile
_LATENCY_KEYS = ("latency_s", "latency_samples")  # of a profile, of a vehicle


def profile_names() -> list[str]:
    """Return the names of all sensor profiles, the neutral one first."""
    return [STATED, *read_toml(_profiles_path())]


def describe_profile(profile: str) -> str:
    """Return a profile's name with its file and the first letters of that file's SHA-256; nothing for ``stated``."""
    if profile == STATED:
        return ""
    return f"{profile} ({_profiles_path().name} {sha256(_profiles_path().read_bytes()).hexdigest()[:HASH_DIGITS]})"


def load_with_profile(
    aircraft: str, overrides: dict[str, Any], where: str, folder: Path, profile: str, step: float
) -> tuple[Vehicle, Path]:
    """Return an aircraft with a sensor profile and then a scenario's overrides merged over it.

    As :func:`cosim.spec.vehicle.load_vehicle`; a profile's latency is rounded to a whole number of control steps [s].
    """
    vehicle, own_folder = load_vehicle(aircraft, overrides, where, folder)
    tables = _read_profile(profile)
    if not tables:
        return vehicle, own_folder
    for table in tables.values():
        if _LATENCY_KEYS[0] in table:
            table[_LATENCY_KEYS[1]] = round(table.pop(_LATENCY_KEYS[0]) / step)
    merged = merge(merge(vehicle.sensors.model_dump(), tables), overrides.get("sensors", {}))
    return vehicle.model_copy(update={"sensors": validate(Sensors, merged, f"{where}.sensors")}), own_folder


def refuse_restated(stated: dict[str, Any], profiles: Iterable[str], where: str) -> None:
    """Raise InputError for a profile with a file that states its own sensors, such as a run's scenario.

    ``stated``: the file's ``vehicle.sensors``.  Raises InputError if it has a value that one of the profiles states.
    """
    for sensor, table in (item for profile in profiles for item in _read_profile(profile).items()):
        for key in table:
            name = _LATENCY_KEYS[1] if key == _LATENCY_KEYS[0] else key
            if name in stated.get(sensor, {}):
                raise InputError(
                    f"{where}: sensors: the file itself states {sensor}.{name} in vehicle.sensors, which would stand "
                    "instead of the profile's; leave vehicle.sensors out of it, or take the scenario it was made from"
                )


def _profiles_path() -> Path:
    return data_folder("aircraft") / "sensors.toml"


def _read_profile(profile: str) -> dict[str, dict[str, Any]]:
    return {} if profile == STATED else read_toml(_profiles_path())[profile]
