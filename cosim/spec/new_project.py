"""Creation of a user's project: a folder with a vehicle, an engine, a flight, a study, a notebook and a script."""

from __future__ import annotations

from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.storage.files import map_os_errors
from cosim.base.storage.paths import data_folder
from cosim.base.trust import remember_written
from cosim.spec.new_aircraft import new_aircraft

TEMPLATES = Path(__file__).parent / "templates" / "project"  # templates of a new project
FILES = ("engine/engine.toml", "flight.toml", "study.toml", "compare.py", "notebook.ipynb")  # files of a new project


def new_project(name: str, out: str | Path | None = None) -> Path:
    """Write a flyable project: vehicle, engine, flight with expectations, study, notebook, script.

    The vehicle is a copy of the Hex-Jet, the engine one of the library with its numbers in a file.

    Parameters
    ----------
    name : str
        The project's name and its vehicle's: letters, digits, - and _.
    out : str or Path or None
        An empty or new folder; None: one of its name here.
    """
    folder = Path(name if out is None else out)
    with map_os_errors(InputError, folder):
        if folder.exists() and any(folder.iterdir()):
            raise InputError(f"{folder}: is not empty; choose another name, or another folder (out)")
    fitted = data_folder("fmus") / "fitted.fmu"
    with map_os_errors(InputError, fitted):
        content = fitted.read_bytes()
    vehicle = new_aircraft(name, "hexjet", folder / "vehicle")
    with map_os_errors(InputError, folder):
        (folder / "engine").mkdir()
        for file in FILES:
            (folder / file).write_text((TEMPLATES / file).read_text(encoding="utf-8").replace("{name}", name), "utf-8")
        # Identified models are stored by engine: those of the base's engine hold for this copy of it.
        text = vehicle.read_text(encoding="utf-8").replace("[identified.edf-as-flown.", '[identified."engine.toml".')
        vehicle.write_text(text.replace("edf-as-flown", "../engine/engine.toml"), encoding="utf-8")
        archive = folder / "engine" / "engine.fmu"
        archive.write_bytes(content)
    remember_written(archive.parent, [archive])
    return folder
