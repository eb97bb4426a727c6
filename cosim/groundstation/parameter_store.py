"""Storage of parameters between flights: one small TOML file for each vehicle."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.storage.files import one_line, write_whole
from cosim.base.storage.toml import read_toml, toml_text
from cosim.base.storage.user import settings_folder
from cosim.engine import file_label
from cosim.spec.controller_name import HASH_DIGITS, folder_name
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import is_file

FORCE_NAME = "HJ_FORCE"  # valid for one flight, never saved
_FORMAT_VERSION = 1  # version of the file's format
_HEAD_LINE = "# What differs from the defaults; written by hexjet gcs.\n"  # first line of the file


def make_vehicle_key(scenario: Scenario) -> str:
    """Return the key of a vehicle's saved parameters, whose defaults depend on engine and controller."""
    engine = file_label(Path(scenario.engine)) if is_file(scenario.engine) else scenario.engine
    designs = [f"{Path(f.file).stem}-{f.sha256[:HASH_DIGITS]}" for f in scenario.parameter_files if f.kind == "design"]
    return "-".join([scenario.aircraft_name, engine, folder_name(scenario.controller), *map(folder_name, designs)])


def find_default_file(vehicle: str) -> Path:
    """Return the default file of a vehicle's parameters, in the folder of the user's settings."""
    return settings_folder() / "parameters" / f"{vehicle}.toml"


class ParameterStore:
    """Store of one vehicle's changed parameters in a file.

    What the vehicle refuses (a name of another version, a range of another engine) is told once and stays in the file.
    A file that cannot be understood is never written over: it is renamed to ``NAME.broken`` first.
    """

    def __init__(self, path: Path, vehicle: str) -> None:
        self.path = path
        self._vehicle = vehicle
        self._refused: dict[str, float] = {}
        self._saved: dict[str, float] | None = None

    def load(self) -> dict[str, float]:
        """Return the values in the file except HJ_FORCE; empty if there is no file.

        Raises InputError: one line, what is wrong and where.
        """
        if not self.path.exists():
            return {}
        data = read_toml(self.path)
        allowed = {"format", "vehicle", "parameters"}
        for key in data:
            if key not in allowed:
                raise InputError(f"{self.path}: unknown key {key!r}; allowed: {', '.join(sorted(allowed))}")
        if data.get("format") != _FORMAT_VERSION:
            raise InputError(f"{self.path}: format = {data.get('format')!r}: must be {_FORMAT_VERSION}")
        if data.get("vehicle") != self._vehicle:
            raise InputError(
                f"{self.path}: vehicle = {data.get('vehicle')!r}: these are not the parameters of {self._vehicle}"
            )
        table = data.get("parameters", {})
        if not isinstance(table, dict):
            raise InputError(f"{self.path}: parameters: must be a table of names and numbers")
        for name, value in table.items():
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise InputError(f"{self.path}: parameters.{name} = {value!r}: must be a number")
        self._saved = {name: float(value) for name, value in table.items()}
        return {name: value for name, value in self._saved.items() if name != FORCE_NAME}

    def restore(self, apply: Callable[[str, float], None]) -> list[str]:
        """Apply each value of the file; return one line for each that is refused with InputError.

        Raises InputError for a file that cannot be read.
        """
        values, complaints = self.load(), []
        if FORCE_NAME in (self._saved or {}):
            complaints.append(
                f"{self.path}: {FORCE_NAME} is not taken from a file: set it anew in each flight that needs it"
            )
        for name, value in values.items():
            try:
                apply(name, value)
            except InputError as error:
                self._refused[name] = value
                complaints.append(f"{self.path}: {error}")
        return complaints

    def save(self, changed: Mapping[str, float]) -> None:
        """Write the changed values, whole or not at all.  Raises InputError if they cannot be written."""
        values = {**{n: v for n, v in self._refused.items() if n not in changed}, **changed}
        if values == self._saved or (not values and not self.path.exists()):
            return

        numbers = {name: values[name] for name in sorted(values)}
        text = _HEAD_LINE + toml_text({"format": _FORMAT_VERSION, "vehicle": self._vehicle, "parameters": numbers})
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._rename_broken()
            write_whole(self.path, text)
        except OSError as error:
            raise InputError(f"{self.path}: {one_line(error)}") from error
        self._saved = values

    def _rename_broken(self) -> None:
        """Rename an unreadable file to keep it from being overwritten."""
        try:
            ParameterStore(self.path, self._vehicle).load()
        except InputError:
            broken = self.path.with_name(f"{self.path.name}.broken")
            number = 1
            while broken.exists():
                number += 1
                broken = self.path.with_name(f"{self.path.name}.broken-{number}")
            os.rename(self.path, broken)
