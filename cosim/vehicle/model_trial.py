"""Load a user's JSBSim file in a process of its own first: JSBSim's reader crashes on some that are not well made.

A file is tried once for its contents and each version of JSBSim; models that are shipped are not tried.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Final

from cosim.base.errors import InputError
from cosim.base.runtime.host import HostError, run_code
from cosim.base.storage.files import write_if_possible
from cosim.base.storage.paths import data_folder
from cosim.base.storage.scratch import scratch
from cosim.vehicle.executive import VERSION, Complaint, Executive
from cosim.vehicle.model_file import FLOWN_PARTS, find_line

_TRIAL_CODE: Final = "from cosim.vehicle.model_trial import try_model; try_model(sys.argv[1])"  # code of the process


def check_model_loads(xml: bytes, model: Path, text: bytes) -> None:
    """Raise InputError for a model that makes JSBSim crash or hang.

    ``xml``: what JSBSim loads; ``model`` and ``text``: the user's file, and its contents with those of files it names.
    """
    from cosim.base.storage.user import cache_folder

    if model.resolve().is_relative_to(data_folder("aircraft").resolve()):
        return
    cached = cache_folder() / "models" / f"{sha256(text + VERSION.encode()).hexdigest()}.txt"
    if cached.is_file():
        return
    failure = _find_failure(xml)
    if failure:
        where = _find_failing_part(ET.fromstring(xml), model)
        raise InputError(f"{where}: JSBSim fails: {failure}; look for an element that is not JSBSim's, or an empty one")
    write_if_possible(cached, f"{model}\n")


def try_model(file: str, runs: int = 5) -> None:
    """Load a model and run it briefly in this process; errors of JSBSim are left for the flight to report."""
    with suppress(InputError, Complaint, MemoryError):
        executive = Executive(Path(file), None, "model", 0.001)
        executive.start()
        for _ in range(runs):
            executive.run()


def _find_failure(xml: bytes, cpu_s: int = 20, megabytes: int = 4096) -> str:
    """Return how a process that loads a model fails; empty if it ends well.

    It may take so many s of processor time, of which JSBSim's own aircraft need 0.1, and so much address space.
    """
    file = scratch() / "tried.xml"
    file.write_bytes(xml)
    try:
        run_code(_TRIAL_CODE, str(file), seconds=cpu_s, megabytes=megabytes)
    except HostError as error:
        return str(error)
    finally:
        file.unlink(missing_ok=True)
    return ""


def _find_failing_part(root: ET.Element, model: Path) -> str:
    """Return the user's file, and the part of the model from which on JSBSim crashes."""
    for part in sorted(root, key=lambda part: FLOWN_PARTS.index(part.tag), reverse=True):
        root.remove(part)
        if not _find_failure(ET.tostring(root)):
            name = part.get("name", "")
            location = find_line(model, name) if name else str(model)
            return f"{location}: {part.tag} {name}".rstrip()
    return str(model)
