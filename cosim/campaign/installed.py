"""What is installed that determines the numbers of a flight: Python, packages, and the files shipped with this one."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path

from cosim.base.plugins.entry_points import GROUP
from cosim.base.storage.paths import data_folder
from cosim.results.summary import versions

PACKAGES = ("hexjet-cosim", "jsbsim", "fmpy", "numpy", "scipy")  # packages that determine a flight's numbers
# Of a package: what is run, and what it is compiled from.
CODE = ("*.py", "*.c", "*.h")
FILES = "files of aircraft, engines and program"  # compared by their contents


@cache
def installed_versions() -> dict[str, str]:
    """Return the versions of what determines a flight's numbers here, and may differ elsewhere."""
    all_versions = versions()
    minor = ".".join(platform.python_version_tuple()[:2])
    return {"python": minor, **{name: all_versions.get(name, "none") for name in PACKAGES}, FILES: _files()}


def list_differences(remote: Mapping[str, str], local: Mapping[str, str]) -> list[str]:
    """Describe what is installed otherwise there than here."""
    return [
        f"other {name}" if name == FILES else f"{name} {remote.get(name, 'none')} (here {value})"
        for name, value in local.items()
        if remote.get(name) != value
    ]


def _files() -> str:
    digest = hashlib.sha256()
    for root, path in sorted(_list_files(), key=lambda file: (file[0].name, file[1].relative_to(file[0]).as_posix())):
        digest.update(f"{root.name}/{path.relative_to(root).as_posix()}\n".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _list_files() -> list[tuple[Path, Path]]:
    """Return the shipped files that determine a flight's numbers, each behind its folder.

    Beside the package's own they are those of packages of the same distribution that add controllers.
    """
    package = Path(__file__).resolve().parents[1]
    laws = {entry.module.partition(".")[0] for entry in entry_points(group=GROUP) if _is_ours(entry)}
    found = [find_spec(name) for name in sorted(laws - {package.name})]
    roots = [package, *(Path(spec.origin).parent for spec in found if spec and spec.origin)]
    files = [(root, path) for root in roots for kind in CODE for path in root.rglob(kind)]
    files = [(root, path) for root, path in files if "data" not in path.relative_to(root).parts]
    for name, kinds in (("aircraft", ("*.toml", "*.xml")), ("engines", ("*.toml", "*.c", "*.h"))):
        root = data_folder(name)
        files += [(root, path) for kind in kinds for path in root.rglob(kind)]
    return files


def _is_ours(entry: EntryPoint) -> bool:
    """Return whether an entry point is of the distribution that this module is of."""
    return entry.dist is not None and entry.dist.name == PACKAGES[0]
