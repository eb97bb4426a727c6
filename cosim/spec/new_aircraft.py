"""Creation of a user's aircraft folder as a copy of a shipped aircraft."""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path
from shutil import copyfile

from cosim.base.errors import InputError, nearest
from cosim.base.storage.files import map_os_errors
from cosim.base.storage.toml import toml_text
from cosim.spec.vehicle import VEHICLE, aircraft_names, engine_of, find_aircraft, is_file, load_vehicle, read_tables

# First comment of the new file.
HEAD = """\
# {name}: begun as a copy of {base}.  Every number here is yours to change; hexjet aircraft check looks it over.
# Units are SI, or in the key's name.  Body frame: x forward, y right, z down, origin at the centre of gravity of the
# vehicle as built.  A JSBSim model of your own may stand beside this file, with the wings and tables that it has:
#   model = "mine.xml"

"""


# Second comment of the new file, if the base aircraft has identified models.
MODELS = """\
# Under [identified] are models of {base}: those of this vehicle as long as its inertia, jets, sensors and engine are.
# hexjet aircraft check compares them, and so does every flight with a predictor; hexjet identify roll makes another.

"""


def new_aircraft(name: str, base: str = "hexjet", out: str | Path | None = None) -> Path:
    """Write a flyable copy of a shipped aircraft as the start of a user's own.

    Parameters
    ----------
    name : str
        The new aircraft's name: letters, digits, - and _.
    base : str
        Name of a shipped aircraft.
    out : str or Path or None
        Made if need be; there must not be an aircraft in it. None: a folder of its name here.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise InputError(f"{name!r} is no name for an aircraft: letters, digits, - and _, a letter or digit first")
    if name in aircraft_names():
        raise InputError(f"{name}: is the name of an aircraft that is shipped; choose another")
    if base not in aircraft_names():
        raise InputError(f"base: {base!r}: must be one that is shipped; {nearest(base, aircraft_names())}")
    folder = Path(name if out is None else out)
    source = find_aircraft(base)
    original, path = load_vehicle(base)[0], folder / VEHICLE
    text = _remove_file_references(source.read_text(encoding="utf-8"))
    if "\n[scaled]\n" in text:
        # All numbers are to be edited, so those scaled from the base are written out, each list on one line.
        lists = r"\[\n([^][{]*),\n\]"
        text = re.sub(lists, lambda found: f"[{' '.join(found[1].split())}]", "\n" + toml_text(read_tables(base)))
    begin = text.index("\nname = ") + 1
    text = HEAD.format(name=name, base=base) + (MODELS.format(base=base) if original.identified else "") + text[begin:]
    text = text.replace(f'name = "{original.name}"', f'name = "{name}"', 1)
    text = text.replace(f'title = "{original.title}"', f'title = "{name}, begun as a copy of {base}"', 1)
    if original.engine is not None and is_file(original.engine):
        text = text.replace(f'engine = "{original.engine}"', f'engine = "{engine_of(base)}"', 1)
    if not original.surfaces:
        text = re.sub(r'^model = ".*"\n', "", text, flags=re.MULTILINE)
    if path.exists():
        raise InputError(f"{path}: is there already; choose another name, or another folder (out)")
    with map_os_errors(InputError, path):
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        if original.surfaces and original.model:
            copyfile(source.with_name(original.model), folder / original.model)
    return path


def _remove_file_references(text: str) -> str:
    """Return a vehicle's text without comments that refer to files beside the original."""
    blocks = ("".join(lines) for _, lines in groupby(text.splitlines(keepends=True), lambda line: line.startswith("#")))
    return "".join(block for block in blocks if block[0] != "#" or not re.search(r"\w\.(md|py|toml)\b", block))
