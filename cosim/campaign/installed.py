"""What is installed that determines the numbers of a flight: Python, packages, and the files shipped with this one."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

from cosim.base.plugins.entry_points import HOOK_GROUP, PLUGIN_GROUP
from cosim.base.storage.paths import data_folder
from cosim.results.summary import versions

PACKAGES = ("hexjet-cosim", "jsbsim", "fmpy", "numpy", "scipy")  # versions of these change results
HASHED = ("*.py", "*.c", "*.h", "*.toml", "*.xml")  # patterns of the hashed files
FILES = "files of aircraft, engines and program"  # name of this hash among the versions


@cache
def installed_versions() -> dict[str, str]:
    """Return the versions that determine a flight's numbers and may differ on other machines."""
    all_versions = versions()
    minor = ".".join(platform.python_version_tuple()[:2])
    return {"python": minor, **{name: all_versions.get(name, "none") for name in PACKAGES}, FILES: _hash_files()}


def list_differences(remote: Mapping[str, str], local: Mapping[str, str]) -> list[str]:
    """Describe the versions in which a remote machine differs from this one."""
    return [
        f"other {name}" if name == FILES else f"{name} {remote.get(name, 'none')} (here {value})"
        for name, value in local.items()
        if remote.get(name) != value
    ]


def _hash_files() -> str:
    digest = hashlib.sha256()
    for name, path in sorted(_list_files()):
        digest.update(f"{name}\n".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _list_files() -> list[tuple[str, Path]]:
    """Return names and paths of the shipped files, of tools too, that determine a flight's numbers."""
    entries = chain(entry_points(group=PLUGIN_GROUP), entry_points(group=HOOK_GROUP))
    adding = [entry for entry in entries if entry.dist and entry.dist.name == PACKAGES[0]]
    specs = [find_spec(name) for name in {"cosim", *(entry.module.partition(".")[0] for entry in adding)}]
    packages = [Path(spec.origin).parent for spec in specs if spec and spec.origin]
    roots = [*packages, data_folder("aircraft"), data_folder("engines")]
    found = [(root, path.relative_to(root), path) for root in roots for kind in HASHED for path in root.rglob(kind)]
    return [(f"{root.name}/{part.as_posix()}", path) for root, part, path in found if "data" not in part.parts]
