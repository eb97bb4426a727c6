"""Where the aircraft, engines, FMUs, scenarios and studies are: in the clone, or inside the installed package."""

from __future__ import annotations

from pathlib import Path

ENGINE = "engine.toml"
_PACKAGE = Path(__file__).resolve().parents[2]  # folder of the package
_DATA_ROOT = _PACKAGE / "data" if (_PACKAGE / "data").is_dir() else _PACKAGE.parent  # of aircraft, engines, scenarios


def data_folder(name: str) -> Path:
    """Return the folder ``aircraft``, ``engines``, ``fmus``, ``scenarios`` or ``studies``."""
    return _DATA_ROOT / name


def names_in(folder: str, marker: str) -> list[str]:
    """Return the names of the sub-folders of ``folder`` that hold a file called ``marker``."""
    return sorted(path.parent.name for path in data_folder(folder).glob(f"*/{marker}"))


def files_in(folder: str) -> list[str]:
    """Return the names of the TOML files in ``folder``."""
    return sorted(path.stem for path in data_folder(folder).glob("*.toml"))
