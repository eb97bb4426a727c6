"""An archive that brings its sources and no library for this machine, compiled by FMPy's CMake project."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import zipfile
from io import BytesIO
from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.files import replacing
from cosim.engine.archive import platform_folder
from cosim.engine.container import UnusableError, has_sources, one_line, open_archive, parse, read_bytes
from cosim.engine.description import describe

LONGEST_S = 600.0  # chosen by us: a solver's sources take a minute
# In a process of its own, because FMPy lets CMake print to standard output; without its validation, as when reading.
_BUILD = """
import functools, sys
import fmpy.build as build
build.read_model_description = functools.partial(build.read_model_description, validate=False)
build.build_platform_binary(sys.argv[1])
"""


def needs_compiling(path: Path) -> bool:
    """Whether an archive has sources and no library for this machine; False too for what is no archive."""
    try:
        data = read_bytes(path)
        names, xml = open_archive(data)
        folder = platform_folder(2 if parse(xml).get("fmiVersion") == "2.0" else 3)
    except UnusableError:
        return False
    return has_sources(names) and not any(
        name.startswith(f"binaries/{folder}/") and not name.endswith("/") for name in names
    )


def compile_archive(path: Path, out: Path | None = None) -> Path:
    """Compile an archive's sources for this machine and put the library into it, or into the copy ``out``.

    The compiler runs what the archive says, as a flight runs its library: compile what you would run.

    Raises InputError if there is nothing to compile or no compiler, or with what it complained of first.
    """
    target = path if out is None else out
    try:
        data = read_bytes(path)
        names, _ = open_archive(data)
        description, _ = describe(data)
    except UnusableError as reason:
        raise InputError(f"{path}: {reason}") from reason
    if description.coSimulation is None or not has_sources(names):
        raise InputError(f"{path}: has no sources of a co-simulation interface; nothing to compile")
    with tempfile.TemporaryDirectory(prefix="hexjet-compile-") as folder:
        with zipfile.ZipFile(BytesIO(data)) as fmu:
            fmu.extractall(folder)
        _build(path, folder)
        binaries = Path(folder) / "binaries" / platform_folder(2 if description.fmiVersion == "2.0" else 3)
        made = sorted(file for file in binaries.glob("*") if file.is_file()) if binaries.is_dir() else []
        if not made:
            raise InputError(f"{path}: its sources make no library")
        try:
            with replacing(target) as copy:
                copy.write_bytes(data)
                with zipfile.ZipFile(copy, "a", zipfile.ZIP_DEFLATED) as fmu:
                    for file in made:
                        name = file.relative_to(folder).as_posix()
                        if name not in names:
                            fmu.write(file, name)
        except OSError as error:
            raise InputError(f"{target}: {error.strerror or error}") from error
    return target


def _build(path: Path, folder: str) -> None:
    here = os.path.dirname(sys.executable)  # where a CMake that came as a package is
    environment = os.environ | {"PATH": f"{here}{os.pathsep}{os.environ.get('PATH', os.defpath)}"}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _BUILD, folder],
            capture_output=True,
            text=True,
            errors="replace",
            env=environment,
            timeout=LONGEST_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise InputError(f"{path}: its sources are not compiled within {LONGEST_S:g} s") from error
    if done.returncode == 0:
        return
    said = [*done.stdout.splitlines(), *done.stderr.splitlines()]
    wrong = [line for line in said if "error" in line.lower() and "CalledProcessError" not in line] or said
    first = wrong[0].replace(f"{folder}{os.sep}", "") if wrong else "no word of it"
    raise InputError(f"{path}: its sources do not compile (CMake and a C compiler are needed): {one_line(first)[:200]}")
