"""The same linear algebra on every processor.

OpenBLAS, which numpy and scipy bring, takes the newest instructions that the processor has, and sums in another order
with each: a Kalman gain or a plan around a lost engine then differs in its last bit, and so does every flight with it.
It chooses once, while it is loaded, by an environment variable that is there for that time alone.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

from cosim.base.errors import notify

VARIABLE, REFERENCE = "OPENBLAS_CORETYPE", "Haswell"  # OpenBLAS's choice of kernel, and ours
_NEEDED_FEATURES = {b"avx2", b"fma"}  # that x86 processors have since 2013
_MEMORY_MAPS = "/proc/self/maps"  # lists the process's libraries
_warnings: list[str] = []  # warnings given so far by this process
_QUERIES = ("scipy_openblas_get_corename64_", "scipy_openblas_get_corename", "openblas_get_corename")  # of OpenBLAS


def can_use_reference(cpuinfo: str = "/proc/cpuinfo", enough_bytes: int = 8192) -> bool:
    """Return whether the reference kernels, for every x86 processor since 2013, can be used here.

    Not on a processor without AVX2 and FMA, on other processors, and on systems that do not tell which they have: there
    a flight is the same again on the same kind of processor.  ``enough_bytes``: bytes, with all of the first processor.
    """
    if not sys.platform.startswith("linux") or os.uname().machine != "x86_64":
        return False
    try:
        with open(cpuinfo, "rb") as file:
            first = file.read(enough_bytes)
    except OSError:
        return False
    flags = next((line for line in first.splitlines() if line.startswith(b"flags")), b"")
    return set(flags.split()) >= _NEEDED_FEATURES


def load_with_reference() -> None:
    """Let later imports of numpy and scipy load the reference kernels.

    The environment is left as it is, but while they are loaded; a variable that is set there already stands.
    """
    if VARIABLE not in os.environ and can_use_reference():
        sys.meta_path.insert(0, _ReferenceKernelFinder())


def set_for_command() -> None:
    """Select the reference kernels for this process and its children, for commands."""
    if can_use_reference():
        os.environ.setdefault(VARIABLE, REFERENCE)


def find_kernels() -> dict[str, str]:
    """Return the OpenBLAS kernels of numpy and scipy by package; empty if unknown."""
    return dict(_query_libraries("scipy.linalg" in sys.modules))


def warn_of_other_kernels() -> None:
    """Warn once per process if numpy or scipy was loaded with other kernels than the reference.

    Where the environment names those kernels it is what was asked for, and nothing is said.
    """
    requested = os.environ.get(VARIABLE, REFERENCE).lower()
    others = [
        f"{package} computes with {kernel}"
        for package, kernel in find_kernels().items()
        if kernel.lower() not in (REFERENCE.lower(), requested)
    ]
    if others and not _warnings and can_use_reference():
        _warnings.append(others[0])
        notify(
            f"{' and '.join(others)} instead of {REFERENCE}: flights may end in other last digits than those of the "
            f"command hexjet; import cosim before numpy, or set {VARIABLE}={REFERENCE}",
            RuntimeWarning,
        )


@cache
def _query_libraries(with_scipy: bool) -> tuple[tuple[str, str], ...]:
    """Query each loaded OpenBLAS library for its kernels; ``with_scipy`` distinguishes cached results."""
    try:
        with open(_MEMORY_MAPS, encoding="utf-8", errors="replace") as file:
            paths = dict.fromkeys(line.split(maxsplit=5)[-1].strip() for line in file if "openblas" in line)
    except OSError:
        return ()
    kernels = []
    for path in paths:
        try:
            library = ctypes.CDLL(path)
        except OSError:  # the file was replaced after loading
            continue
        name = next((name for name in _QUERIES if hasattr(library, name)), None)
        if name is not None:
            ask = library[name]
            ask.restype = ctypes.c_char_p
            kernels.append(("scipy" if "scipy.libs" in path else "numpy", (ask() or b"unknown").decode()))
    return tuple(sorted(kernels))


class _ReferenceKernelFinder:
    """Import finder that sets OPENBLAS_CORETYPE to the reference kernels while numpy and scipy's packages load."""

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        parts = fullname.split(".")
        if not (fullname == "numpy" or (parts[0] == "scipy" and len(parts) == 2)):
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        loader = None if spec is None else spec.loader
        if loader is None or not hasattr(loader, "exec_module"):
            return spec
        load = loader.exec_module

        def load_reference(module: ModuleType) -> None:
            with _set_variable_temporarily():
                load(module)

        loader.exec_module = load_reference  # type: ignore[method-assign]
        return spec


@contextmanager
def _set_variable_temporarily() -> Iterator[None]:
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = before or REFERENCE
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(VARIABLE, None)
