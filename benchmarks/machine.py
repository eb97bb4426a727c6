"""What the figures belong to: the machine, the compilers, and every package that may have to do with them."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path

PEERS = ("ecospy", "libcosimpy", "pathsim", "rotorpy", "tbb")
COMPILED = ("cosim", "jsbsim", "numpy")
_COMPILER = re.compile(rb"(GCC: \([^)\0]{1,60}\) [\d.]+|clang version [\d.]+)")


@dataclass(frozen=True)
class Machine:
    """``processor_share``: processor time by wall time in flight; 1 on a quiet machine.  None: nobody told."""

    cpu: str
    cores: int
    memory_mb: float | None
    system: str
    kernel: str
    libc: str
    compiled: bool  # the modules of a control step; they fly from source as well, slower
    load: tuple[float, float] | None  # processes wanting to run, in the last minute: at the beginning, at the end
    processor_share: float | None


def look_around(begin: float | None, processor_share: float | None) -> Machine:
    """Describe this machine; ``begin`` is :func:`load` before the measurements."""
    end = load()
    return Machine(
        cpu=_cpu(),
        cores=os.cpu_count() or 1,
        memory_mb=_memory(),
        system=f"{platform.system()} {platform.machine()}",
        kernel=platform.release(),
        libc=" ".join(platform.libc_ver()).strip(),
        compiled=not (import_module("cosim.simulation.step").__file__ or "").endswith(".py"),
        load=None if begin is None or end is None else (begin, end),
        processor_share=processor_share,
    )


def load() -> float | None:
    """Return how many processes want to run, on average over the last minute; None: the system does not say."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def package_versions() -> dict[str, str]:
    """Python, this package, all that it needs in turn, and the peers, as far as they are installed."""
    versions = {"python": platform.python_version()}
    waiting = ["hexjet-cosim", *PEERS]
    while waiting:
        name = waiting.pop(0)
        try:
            distribution = metadata.distribution(name)
        except metadata.PackageNotFoundError:  # the clone itself, not installed; what is optional or for other systems
            continue
        if distribution.name.lower() not in versions:
            versions[distribution.name.lower()] = distribution.version
            waiting += [] if name in PEERS else _needed(distribution.requires or [])
    first = ["python", "hexjet-cosim"]
    return {name: versions[name] for name in [*first, *sorted(set(versions) - set(first))] if name in versions}


def compilers() -> dict[str, str]:
    """Return what compiled Python, and the packages where the time goes, as far as their files say it themselves."""
    versions = {"python": platform.python_compiler()}
    for name in COMPILED:
        spec = find_spec(name)
        folders = spec.submodule_search_locations if spec is not None else None
        files = [file for folder in folders or [] for file in sorted(Path(folder).rglob("*.so"))]
        told = {match.decode() for file in files for match in _COMPILER.findall(file.read_bytes())}
        if told:
            versions[name] = ", ".join(sorted(told))
    return versions


def _needed(requirements: Iterable[str]) -> list[str]:
    """Return the names in requirements that belong to no extra."""
    plain = (text for text in requirements if "extra ==" not in text)
    return [match.group() for text in plain if (match := re.match(r"[A-Za-z0-9._-]+", text))]


def _cpu() -> str:
    names = _fields("/proc/cpuinfo", "model name")
    return names[0] if names else platform.processor() or platform.machine()


def _memory() -> float | None:
    totals = _fields("/proc/meminfo", "MemTotal")
    return int(totals[0].split()[0]) * 1024 / 1e6 if totals else None


def _fields(path: str, name: str) -> list[str]:
    try:
        with open(path, encoding="utf-8") as file:
            return [line.partition(":")[2].strip() for line in file if line.startswith(name)]
    except OSError:
        return []
