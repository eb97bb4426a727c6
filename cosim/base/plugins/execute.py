"""Execution of the user's Python: here alone a file or a module of the user becomes code that runs.

Its folder needs the user's trust (:mod:`cosim.base.trust`).  A file is run from its source, and so is whatever it
imports from beside it: compiled copies that lie there are never read.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import re
import site
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import cache
from importlib.metadata import distributions
from importlib.util import find_spec
from pathlib import Path
from sysconfig import get_paths
from types import ModuleType

from cosim.base.compiled import PACKAGE
from cosim.base.errors import InputError, describe_error
from cosim.base.storage.files import read_file
from cosim.base.storage.scratch import scratch
from cosim.base.storage.user import cache_folder
from cosim.base.trust import Code, CodeRefusedError, is_code_forbidden, need_trust

_USER_PREFIX = "hexjet_controller_"  # module names of users' files


def execute_file(path: Path, where: str) -> tuple[ModuleType, list[Path]]:
    """Execute a Python file and return its module and the files beside it that it imports.  Raises InputError."""
    folder = path.resolve().parent
    need_trust([Code(path)], where)
    module = ModuleType(f"{_USER_PREFIX}{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]}")
    module.__file__ = str(path)
    source = read_file(path)
    sys.modules[module.__name__] = module
    try:
        with _import_neighbours_of(folder) as imported:
            exec(compile(source, str(path), "exec"), module.__dict__)
    except Exception as error:
        del sys.modules[module.__name__]
        line = f", line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise InputError(f"{where}: {path}{line}: {describe_error(error)}") from error
    deep = [file for file in imported if file.parent != folder]
    if deep:
        raise InputError(
            f"{where}: imports {deep[0]}, which is in a package beside it: install that, and name it as "
            "package.module:Class"
        )
    return module, sorted(imported)


def bytecode_folder() -> str:
    """Return the user's private folder for bytecode of code that is not installed."""
    try:
        return str(cache_folder() / "compiled")
    except RuntimeError:  # the user has no home folder
        return str(scratch() / "compiled")


@contextmanager
def _ignore_foreign_bytecode() -> Iterator[None]:
    before = sys.pycache_prefix
    sys.pycache_prefix = bytecode_folder()
    try:
        yield
    finally:
        sys.pycache_prefix = before


@contextmanager
def _import_neighbours_of(folder: Path) -> Iterator[list[Path]]:
    """Let a file import modules beside it, apart from modules of the same names elsewhere, and record them.

    What is below the folder and found from anywhere, as an installed package is, is no neighbour.
    """
    anywhere = any(entry and Path(entry).resolve() == folder for entry in sys.path)

    def find_neighbours() -> dict[str, ModuleType]:
        modules = {}
        for name, module in list(sys.modules.items()):
            file = getattr(module, "__file__", None)
            path = Path(file).resolve() if file else None
            if path is None or path.suffix != ".py" or name.startswith(_USER_PREFIX) or not path.is_relative_to(folder):
                continue
            inner = path.relative_to(folder).parts
            if len(inner) == 1 or not (anywhere or {"site-packages", "lib"} & set(inner)):
                modules[name] = module
        return modules

    outside = {name: module for name, module in find_neighbours().items() if "." not in name and name != "__main__"}
    for name in outside:
        del sys.modules[name]
    before = set(sys.modules)
    imported: list[Path] = []
    sys.path.insert(0, str(folder))
    try:
        with _ignore_foreign_bytecode():
            yield imported
    finally:
        sys.path.remove(str(folder))
        for name, module in find_neighbours().items():
            if name not in before:
                imported.append(Path(str(module.__file__)).resolve())
                del sys.modules[name]
        sys.modules.update(outside)


def import_installed(module_name: str, where: str) -> tuple[ModuleType, Path, dict[str, Path]]:
    """Import an installed module; return it, its path, and its files by name.  Raises InputError."""
    if is_code_forbidden():
        raise CodeRefusedError(f"{where}: {module_name} is code, and nothing is run to look at something")
    try:
        import_trusted(module_name, where)
        module = sys.modules[module_name]
    except CodeRefusedError:
        raise
    except Exception as error:
        raise InputError(f"{where}: {module_name} cannot be imported: {describe_error(error)}") from error
    path = Path(getattr(module, "__file__", None) or "")
    return module, path, {path.name: path} if path.is_file() else {}


def import_trusted(module_name: str, where: str, *names: str) -> None:
    """Import a module after trusting the folder in which Python finds it, unless it is installed.

    ``names``: what else the user names it by.  Raises CodeRefusedError, also where there is no folder to look at, and
    whatever the module raises.
    """
    top = module_name.partition(".")[0]
    spec = None if module_name in sys.modules else find_spec(top)
    origins = [spec.origin] if spec is not None and spec.has_location else []
    places = origins if spec is None else spec.submodule_search_locations or origins
    paths = [Path(place) for place in places if place is not None]
    code = [Code(path, (module_name, *names), top=path.parent) for path in paths if not _is_installed(path, top)]
    for item in code:
        if not item.path.exists():
            raise CodeRefusedError(f"{where}: {top}: is not installed, and no file of it can be looked at; unpack it")
    need_trust(code, where)
    with _ignore_foreign_bytecode() if code else nullcontext():
        importlib.import_module(module_name)


def _is_installed(path: Path, top: str) -> bool:
    """Return whether a path belongs to Python, this package or an installed package; ``top``: its top-level package.

    Metadata beside a file that call it installed are not trusted.
    """
    absolute = Path(os.path.abspath(path))
    paths = absolute, absolute.resolve()
    if any(candidate.is_relative_to(folder) for candidate in paths for folder in (*_installed_folders(), PACKAGE)):
        return True
    starts = [folder / inner / top for folder in _editable_folders(top) for inner in ("", "src", "tools")]
    return any(paths[1].is_relative_to(start) or paths[1] == start.with_suffix(".py") for start in starts)


@cache
def _installed_folders() -> frozenset[Path]:
    paths = get_paths()
    user = [site.getusersitepackages()] if site.ENABLE_USER_SITE else []
    names = [*(paths[name] for name in ("stdlib", "platstdlib", "purelib", "platlib")), *site.getsitepackages(), *user]
    return frozenset(candidate for name in names for candidate in (Path(name), Path(name).resolve()))


@cache
def _editable_folders(top: str) -> list[Path]:
    """Return the source folders of editable installations that have a package of this name."""
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    folders = []
    for distribution in distributions(path=[str(folder) for folder in _installed_folders()]):
        with suppress(ValueError, LookupError, TypeError, AttributeError):  # damaged metadata of a package
            origin = json.loads(distribution.read_text("direct_url.json") or "{}")
            tops = (distribution.read_text("top_level.txt") or re.sub(r"[-.]+", "_", distribution.name)).split()
            if top in tops and origin["dir_info"]["editable"] is True and origin["url"].startswith("file:"):
                folders.append(Path(url2pathname(urlsplit(origin["url"]).path)).resolve())
    return folders
