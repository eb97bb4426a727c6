"""Build of an engine's two archives from its folder: ``<name>.fmu`` (FMI 3.0) and ``<name>-fmi2.fmu`` (FMI 2.0)."""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from .definition import FMI2_SUFFIX, BuildError, EngineDefinition, read_engine
from .description import (
    render_build_description,
    render_model_description_2,
    render_model_description_3,
    render_variables_header,
)

FMI_VERSIONS = (3, 2)  # versions built for each engine

# Name of this system in FMI, and file ending of a shared library.
_SYSTEM, LIBRARY_SUFFIX = {"win32": ("windows", ".dll"), "darwin": ("darwin", ".dylib")}.get(
    sys.platform, ("linux", ".so")
)

# Files of the adapter that makes a slave from an engine model, besides fmi2.c or fmi3.c.
ADAPTER_FILES = ("engine.h", "slave.h", "slave.c")
ADAPTER_GENERATED = ("variables.h", "buildDescription.xml")  # files written from engine.toml

# Compiler flags without fused multiply-add, so that every build computes the same bits.
C_FLAGS = "" if sys.platform == "win32" else "-ffp-contract=off"


def list_engines(engines: Path) -> list[str]:
    return sorted(path.parent.name for path in engines.glob("*/engine.toml"))


def archive_path(fmus: Path, name: str, fmi: int) -> Path:
    """Return the path of an engine's archive in the folder ``fmus``."""
    return fmus / f"{name}{FMI2_SUFFIX if fmi == 2 else ''}.fmu"


def build_all(
    engines: Path, fmus: Path, names: Sequence[str] | None = None, *, adapter: Path | None = None, force: bool = False
) -> list[Path]:
    """Build the archives of the named engines, or of all, if outdated; return their paths.

    ``adapter`` is the folder of the FMI adapter, ``engines/fmi`` unless stated.  Nothing is written to standard output.
    Raises BuildError for an unknown engine, a wrong ``engine.toml``, or a compiler that is missing or fails.
    """
    folders, adapter = list_engines(engines), adapter or engines / "fmi"
    for name in names or []:
        if name not in folders:
            raise BuildError(f"unknown engine {name!r}; allowed: {', '.join(folders)}")
    archives = []
    fmus.mkdir(parents=True, exist_ok=True)
    for name in folders if names is None else names:
        engine = read_engine(engines / name)
        for fmi in FMI_VERSIONS:
            target, token = archive_path(fmus, name, fmi), hash_build_inputs(engine, adapter, fmi)
            if force or not _is_up_to_date(target, token):
                _build_archive(engine, adapter, fmi, token, target, {})
            archives.append(target)
    return archives


def build_one(
    engine: EngineDefinition,
    adapter: Path,
    fmi: int,
    target: Path,
    resources: Mapping[str, bytes],
    within: Path | None = None,
) -> None:
    """Build one archive of an engine from C, or from a tool's C, without ``engine.toml``.

    ``resources`` are its files of that folder; it is built below ``within``.  Raises BuildError if no compiler does it.
    """
    files = (f"{name}\0{len(data)}\0".encode() + data for name, data in sorted(resources.items()))
    digest = f" {hashlib.sha256(b''.join(files)).hexdigest()}" if resources else ""
    token = _make_hash(f"{engine.name} {engine.variables} FMI {fmi}{digest}", _build_inputs(engine, adapter, fmi))
    _build_archive(engine, adapter, fmi, token, target, resources, within)


def platform_folder(fmi: int) -> str:
    """Return the folder inside ``binaries`` that has this platform's library."""
    machine = "aarch64" if platform.machine().lower() in ("aarch64", "arm64") else "x86_64"
    return f"{_SYSTEM[:3] if _SYSTEM == 'windows' else _SYSTEM}64" if fmi == 2 else f"{machine}-{_SYSTEM}"


def _is_up_to_date(archive: Path, token: str) -> bool:
    """Return whether the archive was built from the inputs of ``token`` and has a binary for this platform."""
    try:
        with zipfile.ZipFile(archive) as fmu:
            text = fmu.read("modelDescription.xml").decode()
            names = fmu.namelist()
    except (OSError, KeyError, ValueError, zipfile.BadZipFile):
        return False
    folder = platform_folder(2 if 'fmiVersion="2.0"' in text else 3)
    return f'"{token}"' in text and any(name.startswith(f"binaries/{folder}/") for name in names)


def _build_archive(
    engine: EngineDefinition,
    adapter: Path,
    fmi: int,
    token: str,
    target: Path,
    resources: Mapping[str, bytes],
    within: Path | None = None,
) -> None:
    contents = _read_contents(engine, adapter, fmi, token)
    contents |= {f"resources/{name}": data for name, data in resources.items()}
    with tempfile.TemporaryDirectory(prefix="engine-", dir=within) as folder:
        for name, data in contents.items():
            path = Path(folder, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        compile_sources(Path(folder), target.name)
        for path in Path(folder, "binaries").rglob("*"):
            if path.is_file() and path.suffix != ".pdb":
                contents[path.relative_to(folder).as_posix()] = path.read_bytes()
    write_archive(contents, target)


def write_archive(contents: Mapping[str, bytes], target: Path) -> None:
    """Write an archive whose bytes depend only on its contents, and replace the target atomically."""
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as stream, zipfile.ZipFile(stream, "w") as archive:
            for path in sorted(contents):
                entry = zipfile.ZipInfo(path, date_time=(1980, 1, 1, 0, 0, 0))
                entry.create_system = 3  # Unix, so that permission bits count
                entry.external_attr = (0o755 if path.startswith("binaries/") else 0o644) << 16
                entry.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(entry, contents[path])
        Path(name).chmod(0o644)
        os.replace(name, target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def compile_sources(folder: Path, label: str) -> None:
    """Compile the sources of an unpacked archive into its ``binaries`` with FMPy's builder.

    Raises BuildError, naming ``label``, if there is no compiler or it refuses the sources.
    """
    from fmpy.build import build_platform_binary  # type: ignore[import-untyped]

    with tempfile.TemporaryFile() as output, tempfile.TemporaryDirectory(dir=folder) as build:
        try:
            with _prepend_cmake_to_path(), _redirect_output(output.fileno()):
                build_platform_binary(folder, build, cmake_options=_list_cmake_options())
        except (subprocess.CalledProcessError, OSError) as error:
            output.seek(0)
            reason = _explain_failure(output.read().decode(errors="replace"), error)
            raise BuildError(f"{label}: {reason}") from error


def _list_cmake_options() -> dict[str, str]:
    options = {"CMAKE_C_FLAGS:STRING": C_FLAGS}
    compiler = shutil.which((os.environ.get("CC") or "cc").split()[0])
    if compiler and sys.platform != "win32":
        # FMPy's CMake project enables C++ as well. No C++ is compiled, so no such compiler is needed.
        options |= {"CMAKE_CXX_COMPILER:STRING": compiler, "CMAKE_CXX_COMPILER_FORCED:BOOL": "TRUE"}
    if sys.platform != "win32":
        # Without it only importers that have loaded libm themselves, as Python has, could load the FMU.
        options["CMAKE_C_STANDARD_LIBRARIES:STRING"] = "-lm"
    return options


def _explain_failure(output: str, error: Exception) -> str:
    """Return the line of CMake's or the compiler's output that explains the failure."""
    if isinstance(error, FileNotFoundError):
        return "cannot be compiled: cmake is not found (it comes with the Python package cmake)"
    if re.search(r"No CMAKE_C(XX)?_COMPILER could be found|no such file or directory: .*cl\.exe", output):
        return "cannot be compiled: no C compiler found (on Debian: apt install build-essential)"
    lines = [line.strip() for line in output.splitlines()]
    errors = [line for line in lines if re.search(r"\b(fatal )?error\b", line, re.IGNORECASE)]
    return f"cannot be compiled: {(errors or [str(error)])[0]}"


@contextlib.contextmanager
def _prepend_cmake_to_path() -> Iterator[None]:
    """Put the cmake that FMPy depends on first on the PATH, within the context."""
    before = os.environ.get("PATH", "")
    try:
        from cmake import CMAKE_BIN_DIR

        os.environ["PATH"] = f"{CMAKE_BIN_DIR}{os.pathsep}{before}"
    except ImportError:
        pass  # falls back to cmake on PATH
    try:
        yield
    finally:
        os.environ["PATH"] = before


@contextlib.contextmanager
def _redirect_output(descriptor: int) -> Iterator[None]:
    """Redirect standard output and error of this process and its children to a file, within the context."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved = os.dup(1), os.dup(2)
    try:
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        yield
    finally:
        os.dup2(saved[0], 1)
        os.dup2(saved[1], 2)
        for copy in saved:
            os.close(copy)


def hash_build_inputs(engine: EngineDefinition, adapter: Path, fmi: int) -> str:
    """Return the FMI token, a hash of all build inputs that shows whether an archive is up to date."""
    return _make_hash(f"{engine.name} FMI {fmi}", [engine.folder / "engine.toml", *_build_inputs(engine, adapter, fmi)])


def _build_inputs(engine: EngineDefinition, adapter: Path, fmi: int) -> list[Path]:
    """Return the files that an archive depends on: C sources and the builder itself."""
    tool = [engine.tool] if engine.tool else []
    return [*engine.sources, *tool, *_list_adapter_files(adapter, fmi), *sorted(Path(__file__).parent.glob("*.py"))]


def _make_hash(label: str, paths: Iterable[Path]) -> str:
    digest = hashlib.sha256(label.encode())
    for path in paths:
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"


def _list_adapter_files(adapter: Path, fmi: int) -> list[Path]:
    return [adapter / name for name in (*ADAPTER_FILES, f"fmi{fmi}.c")]


def _read_contents(engine: EngineDefinition, adapter: Path, fmi: int, token: str) -> dict[str, bytes]:
    """Return the archive's files without the binary by path; FMI's headers are left out, as the standard requires."""
    files = {path.name: path.read_bytes() for path in [*engine.sources, *_list_adapter_files(adapter, fmi)]}
    if engine.tool is not None:
        files["slave.c"] = engine.tool.read_bytes()
    files["variables.h"] = render_variables_header(engine, token).encode()
    sources = sorted(name for name in files if name.endswith(".c"))
    contents = {f"sources/{name}": data for name, data in files.items()}
    if fmi == 3:
        contents["modelDescription.xml"] = render_model_description_3(engine, token)
        contents["sources/buildDescription.xml"] = render_build_description(engine, sources)
    else:
        contents["modelDescription.xml"] = render_model_description_2(engine, token, sources)
    return contents
