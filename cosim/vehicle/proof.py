"""Load a user's JSBSim file in a process of its own first: JSBSim's reader crashes on some that are not well made.

A file is tried once for what it says and each version of JSBSim; what is shipped, and what has no file, never.
"""

from __future__ import annotations

import signal
import subprocess
import xml.etree.ElementTree as ET
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Final

from cosim.base.errors import InputError
from cosim.base.runtime.processes import python_command, run_child
from cosim.base.storage.paths import data_folder
from cosim.base.storage.scratch import scratch
from cosim.vehicle.executive import VERSION, Complaint, Executive
from cosim.vehicle.model_file import FLOWN, find_line

CPU_S: Final = 20  # that a child may take; JSBSim's own aircraft take 0.1 s
MEGABYTES: Final = 4096  # of address space
WALL_S: Final = 300.0  # on a machine that is busy
RUNS: Final = 5  # of JSBSim, after its start
_CODE: Final = "from cosim.vehicle.proof import try_model; try_model(sys.argv[1])"


def prove(xml: bytes, model: Path, text: bytes) -> None:
    """Refuse a model with which JSBSim crashes or does not come to an end.

    ``xml``: what JSBSim loads; ``model`` and ``text``: the user's file, and what it says with the files that it names.
    """
    from cosim.base.storage.user import cache_folder
    from cosim.engine.qualify.remembered import write

    if model.resolve().is_relative_to(data_folder("aircraft").resolve()):
        return
    known = cache_folder() / "models" / f"{sha256(text + VERSION.encode()).hexdigest()}.txt"
    if known.is_file():
        return
    end = _end_with(xml)
    if end:
        where = _blame(ET.fromstring(xml), model)
        raise InputError(f"{where}: JSBSim {end}; look for an element that is not JSBSim's, or an empty one")
    write(known, f"{model}\n")


def try_model(file: str) -> None:
    """Load a model and run it a little in this process; what is said of it is not this one's to say."""
    with suppress(InputError, Complaint, MemoryError):  # the same comes in the process that flies it, which says so
        executive = Executive(Path(file), None, "model", 0.001)
        executive.start()
        for _ in range(RUNS):
            executive.run()


def _end_with(xml: bytes) -> str:
    """Return how a process that loads a model fails, as the predicate of a sentence; empty if it ends with status 0."""
    file = scratch() / "tried.xml"
    file.write_bytes(xml)
    try:
        done = run_child(python_command(_CODE, str(file), seconds=CPU_S, megabytes=MEGABYTES), WALL_S)
    except subprocess.TimeoutExpired:
        return f"was not done with it within {WALL_S:g} s"
    finally:
        file.unlink(missing_ok=True)
    if done.returncode == -signal.SIGXCPU:
        return f"was not done with it within {CPU_S} s of processor time"
    if done.returncode < 0:
        return f"crashes with it ({signal.Signals(-done.returncode).name})"
    if done.returncode:
        last = done.stderr.strip().rpartition("\n")[2]
        return f"ends the process with it, with status {done.returncode}{f' ({last})' if last else ''}"
    return ""


def _blame(root: ET.Element, model: Path) -> str:
    """Return the user's file, and the part with which JSBSim, which reads them in its own order, began to crash."""
    for part in sorted(root, key=lambda part: FLOWN.index(part.tag), reverse=True):
        root.remove(part)
        if not _end_with(ET.tostring(root)):
            name = part.get("name", "")
            place = find_line(model, name) if name else str(model)
            return f"{place}: {part.tag} {name}".rstrip()
    return str(model)
