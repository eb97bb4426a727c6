"""Names and files of the shipped scenarios."""

from __future__ import annotations

from pathlib import Path

from cosim.base.errors import InputError, similar
from cosim.base.storage.paths import data_folder


def scenario_names() -> list[str]:
    return sorted(path.stem for path in data_folder("scenarios").glob("*.toml"))


def find_scenario(name: str | Path) -> Path:
    """Return the file of a scenario by name or path.  Raises InputError if there is none."""
    path = Path(name)
    if path.suffix == ".toml" or path.is_file():
        if not path.is_file():
            raise InputError(f"{path}: no such scenario file")
        return path
    if str(name) not in scenario_names():
        if (path / "scenario.toml").is_file() and not (path / "study.toml").is_file():
            raise InputError(f"{path} is a run's folder; its scenario is {path / 'scenario.toml'}")
        if path.exists() or len(path.parts) > 1:
            raise InputError(f"{path}: is no scenario, which is a .toml file or a name of hexjet show")
        raise InputError(
            f"unknown scenario {str(name)!r}; {similar(str(name), scenario_names())}, or give the path of a .toml file"
        )
    return data_folder("scenarios") / f"{name}.toml"
