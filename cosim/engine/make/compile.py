"""The sources that an archive brings, compiled: for this machine by FMPy's CMake project, for Windows by MinGW."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.base.runtime.processes import python_command, run_child
from cosim.base.storage.files import map_os_errors, replace_on_success
from cosim.base.storage.scratch import temporary
from cosim.base.trust import code_of, remember
from cosim.engine.fmu.container import (
    DESCRIPTION,
    UnusableError,
    Zip,
    has_sources,
    open_archive,
    parse_xml,
    read_bytes,
    to_one_line,
)
from cosim.engine.fmu.description import add_missing_initial, read_description
from cosim.engine.library import platform_folder

LONGEST_S = 600.0  # chosen by us: a solver's sources take a minute
# In a process of its own, because FMPy lets CMake print to standard output; without its validation, as when reading.
_BUILD = """
import functools
import fmpy.build as build
build.read_model_description = functools.partial(build.read_model_description, validate=False)
build.build_platform_binary(sys.argv[1])
"""


WINDOWS_COMPILER = "x86_64-w64-mingw32-gcc"  # 64 bit; on Debian the package gcc-mingw-w64-x86-64
# No fused multiply-add, so that it computes the bits of every other build; and no library of MinGW's beside it.
_WINDOWS_FLAGS = ("-shared", "-s", "-O2", "-DNDEBUG", "-ffp-contract=off", "-static")


def needs_compiling(path: Path) -> bool:
    """Whether an archive has sources and no library for this machine; False too for what is no archive."""
    try:
        data = read_bytes(path)
        names, xml = open_archive(data)
        folder = platform_folder(2 if parse_xml(xml).get("fmiVersion") == "2.0" else 3)
    except UnusableError:
        return False
    return has_sources(names) and not any(
        name.startswith(f"binaries/{folder}/") and not name.endswith("/") for name in names
    )


def has_windows(path: Path) -> bool:
    """Whether an archive has a library for 64-bit Windows."""
    with Zip(path) as fmu:
        return any(name.startswith(("binaries/win64/", "binaries/x86_64-windows/")) for name in fmu.namelist())


def compile_archive(path: Path, out: Path | None = None, windows: bool = False) -> Path:
    """Compile an archive's sources and put the library into it, or into the copy ``out``.

    For this machine, or for 64-bit ``windows``, which needs the compiler :data:`WINDOWS_COMPILER`.  The compiler runs
    what the archive says, as a flight runs its library: compile what you would run.

    Raises InputError if there is nothing to compile or no compiler, or with what it complained of first.
    """
    target = path if out is None else out
    try:
        data = read_bytes(path)
        names, xml = open_archive(data)
        description, _ = read_description(data)
    except UnusableError as reason:
        raise InputError(f"{path}: {reason}") from reason
    if description.coSimulation is None or not has_sources(names):
        raise InputError(f"{path}: has no sources of a co-simulation interface; nothing to compile")
    with temporary("compile-") as folder_path:
        folder = str(folder_path)
        with Zip(BytesIO(data)) as fmu:
            fmu.extractall(folder)
        Path(folder, DESCRIPTION).write_bytes(add_missing_initial(xml))
        if windows:
            binaries = _build_for_windows(path, folder, description)
        else:
            _build(path, folder)
            binaries = Path(folder) / "binaries" / platform_folder(2 if description.fmiVersion == "2.0" else 3)
        libraries = sorted(file for file in binaries.glob("*") if file.is_file()) if binaries.is_dir() else []
        if not libraries:
            raise InputError(f"{path}: its sources make no library")
        with map_os_errors(InputError, target), replace_on_success(target) as copy:
            copy.write_bytes(data)
            with zipfile.ZipFile(copy, "a", zipfile.ZIP_DEFLATED) as fmu:
                for file in libraries:
                    name = file.relative_to(folder).as_posix()
                    if name not in names:
                        fmu.write(file, name)
    remember([code_of(target)])
    return target


def _build_for_windows(path: Path, folder: str, description: Any) -> Path:
    """Call the cross-compiler on the sources that the description lists; returns where the library is."""
    import fmpy  # type: ignore[import-untyped]

    compiler = shutil.which(WINDOWS_COMPILER)
    if compiler is None:
        raise InputError(
            f"{path}: no compiler for Windows: {WINDOWS_COMPILER} is not found (on Debian: apt install "
            "gcc-mingw-w64-x86-64)"
        )
    files = description.buildConfigurations[0].sourceFileSets[0]
    sources = Path(folder) / "sources"
    binaries = Path(folder) / "binaries" / ("win64" if description.fmiVersion == "2.0" else "x86_64-windows")
    binaries.mkdir(parents=True, exist_ok=True)
    defined = [
        f"-D{macro.name}" + (f"={macro.value}" if macro.value else "") for macro in files.preprocessorDefinitions
    ]
    command = [
        compiler, *_WINDOWS_FLAGS, *defined, f"-I{sources}", f"-I{Path(fmpy.__file__).parent / 'c-code'}",
        *(str(sources / name) for name in files.sourceFiles),
        "-o", str(binaries / f"{description.coSimulation.modelIdentifier}.dll"), "-lm",
    ]  # fmt: skip
    _run(path, folder, command, "for Windows")
    return binaries


def _build(path: Path, folder: str) -> None:
    scripts = os.path.dirname(sys.executable)  # where a CMake that came as a package is
    environment = os.environ | {"PATH": f"{scripts}{os.pathsep}{os.environ.get('PATH', os.defpath)}"}
    _run(path, folder, python_command(_BUILD, folder), "(CMake and a C compiler are needed)", environment)


def _run(
    path: Path, folder: str, command: Sequence[str], how: str, environment: Mapping[str, str] | None = None
) -> None:
    """Call what compiles.  Raises InputError with what it complained of first."""
    try:
        result = run_child(command, LONGEST_S, environ=environment)
    except subprocess.TimeoutExpired as error:
        raise InputError(f"{path}: its sources are not compiled within {LONGEST_S:g} s") from error
    if result.returncode == 0:
        return
    lines = [*result.stdout.splitlines(), *result.stderr.splitlines()]
    errors = [line for line in lines if "error" in line.lower() and "CalledProcessError" not in line] or lines
    first = errors[0].replace(f"{folder}{os.sep}", "") if errors else "no word of it"
    raise InputError(f"{path}: its sources do not compile {how}: {to_one_line(first)[:200]}")
