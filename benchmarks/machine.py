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
    """Properties of this machine and its load; None for what the system does not tell."""

    cpu: str
    cores: int
    memory_mb: float | None
    system: str
    kernel: str
    libc: str
    compiled: bool  # are the step's modules compiled?
    load: tuple[float, float] | None  # load average: beginning, end
    processor_share: float | None


def look_around(begin: float | None, processor_share: float | None) -> Machine:
    """Return the properties of this machine; ``begin`` is :func:`load` before the measurements."""
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
    """Return the load average of the last minute; None if the system does not tell it."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def package_versions() -> dict[str, str]:
    """Return the versions of Python, this package, all that it needs, and the peers that are installed."""
    versions = {"python": platform.python_version()}
    waiting = ["hexjet-cosim", *PEERS]
    while waiting:
        name = waiting.pop(0)
        try:
            distribution = metadata.distribution(name)
        except metadata.PackageNotFoundError:  # optional, or for other systems
            continue
        if distribution.name.lower() not in versions:
            versions[distribution.name.lower()] = distribution.version
            waiting += [] if name in PEERS else _needed(distribution.requires or [])
    first = ["python", "hexjet-cosim"]
    return {name: versions[name] for name in [*first, *sorted(set(versions) - set(first))] if name in versions}


def compilers() -> dict[str, str]:
    """Return the compilers of Python and of the packages where the time goes, as their files state them."""
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
    """Return the names of requirements that belong to no extra."""
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
