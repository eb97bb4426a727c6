"""Execution of the user's Python: here alone a file or a module of the user becomes code that runs.

A file is run from the bytes that were checked, never from a compiled copy that lies beside it, and so is whatever it
imports from beside it; each of these needs the user's trust (:mod:`cosim.base.trust`).
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import json
import os
import re
import site
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec, PathFinder, SourceFileLoader, all_suffixes
from importlib.metadata import distributions
from importlib.util import cache_from_source, find_spec
from pathlib import Path
from sysconfig import get_paths
from types import CodeType, ModuleType

from cosim.base.compiled import PACKAGE
from cosim.base.errors import InputError, describe_error
from cosim.base.storage.files import read_file
from cosim.base.trust import Code, CodeRefusedError, code_of, is_code_forbidden, need_trust, process_name

_PREFIX = "hexjet_controller_"  # modules that were made of files here
_RUNNABLE = tuple(all_suffixes())


def execute_file(path: Path, where: str) -> tuple[ModuleType, list[Path]]:
    """Execute a Python file; return its module and the files beside it that it imports.  Raises InputError."""
    folder = path.resolve().parent
    text = read_file(path)
    need_trust([Code(path, hashlib.sha256(text).hexdigest()), *_imports(path, path)], where)
    module = ModuleType(f"{_PREFIX}{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    try:
        with _importing_from(folder, _Neighbours(path, where)) as imported:
            exec(compile(text, str(path), "exec"), module.__dict__)
    except CodeRefusedError:
        raise
    except Exception as error:
        line = f", line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise InputError(f"{where}: {path}{line}: {describe_error(error)}") from error
    deep = [file for file in imported if file.parent != folder]
    if deep:
        raise InputError(
            f"{where}: imports {deep[0]}, which is in a package beside it: install that, and name it as "
            "package.module:Class"
        )
    return module, sorted(imported)


def python_code(path: Path) -> list[Code]:
    """Return a file of Python and the files beside it that it imports, as code.  Raises InputError."""
    return [code_of(path), *_imports(path, path)]


def program_code(path: Path, arguments: str) -> list[Code]:
    """Return what a program runs, as code: its file with its arguments, and the files beside it that it is given.

    Of Python also what these are seen to import, with compiled copies that lie there: Python takes those first.  Raises
    InputError.
    """
    name = process_name(path, arguments)
    beside = [file for word in arguments.split() if (file := path.parent / word).is_file()]
    code = [code_of(path, name, arguments=arguments), *(code_of(file, name) for file in beside)]
    for script in [file for file in (path, *beside) if file.suffix == ".py"]:
        for file_code in _imports(script, name):
            compiled = Path(cache_from_source(str(file_code.path)))
            code += [file_code, *([code_of(compiled, name)] if compiled.is_file() else [])]
    return code


def _imports(path: Path, name: Path | str) -> list[Code]:
    """Return the files beside a Python file that it, or one of these, seems to import, as code that ``name`` names."""
    found, waiting = dict[Path, None](), [path]
    while waiting:
        with suppress(OSError, SyntaxError, ValueError):  # errors in it are reported when it runs
            for module in _names(waiting.pop()):
                for file in _files_of(path.parent, module):
                    if file != path and file not in found:
                        found[file] = None
                        waiting += [file] if file.suffix == ".py" else []
    code: list[Code] = []
    for file in found:
        with suppress(InputError):
            code.append(code_of(file, name))
    return code


def _names(path: Path) -> set[str]:
    """Return the modules that a Python file imports, anywhere in it, by the first part of their names."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(read_file(path))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.partition(".")[0])
    return names - set(sys.builtin_module_names)


def _files_of(folder: Path, name: str) -> list[Path]:
    """Return the files in a folder that an import of this name may run."""
    endings = (".py", ".pyc", *EXTENSION_SUFFIXES)
    files = [folder / f"{name}{ending}" for ending in endings]
    return [file for file in (*files, *(folder / name / f"__init__{ending}" for ending in endings)) if file.is_file()]


class _TrustedSource(SourceFileLoader):
    """Runs a source file from the bytes that are trusted; a compiled copy of it is not looked at."""

    def __init__(self, name: str, path: str, first: Path, where: str) -> None:
        super().__init__(name, path)
        self._first, self._where = first, where

    def get_code(self, fullname: str) -> CodeType:
        text = self.get_data(self.path)
        need_trust([Code(Path(self.path), hashlib.sha256(text).hexdigest(), (self._first,))], self._where)
        code: CodeType = self.source_to_code(text, self.path)
        return code


class _Neighbours:
    """Finds what a file imports from its folder, and lets none of it run that is not trusted."""

    def __init__(self, first: Path, where: str) -> None:
        self._first, self._where = first, where
        self._folder = str(first.resolve().parent)
        self._names: set[str] = set()

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a module of the folder, or one in a package of it; return None for any other."""
        if path is not None and fullname.rpartition(".")[0] not in self._names:
            return None
        spec = PathFinder.find_spec(fullname, [self._folder] if path is None else path)
        if spec is not None and spec.origin is None:  # a folder without __init__.py: a package elsewhere goes first
            spec = PathFinder.find_spec(fullname, path)
            if spec is None or spec.origin is not None:
                return None
        if spec is None:
            return None
        self._names.add(fullname)
        if isinstance(spec.loader, SourceFileLoader):
            spec.loader = _TrustedSource(fullname, spec.loader.path, self._first, self._where)
            spec.cached = None
        elif spec.origin is not None:
            need_trust([code_of(Path(spec.origin), self._first)], self._where)
        return spec


@contextmanager
def _importing_from(folder: Path, finder: _Neighbours) -> Iterator[list[Path]]:
    """Let a file import its neighbours, and note which; nobody else's modules of the same names are mixed up with them.

    What is below the folder and found from anywhere, as an installed package is, is no neighbour.
    """
    anywhere = any(entry and Path(entry).resolve() == folder for entry in sys.path)

    def neighbours() -> dict[str, ModuleType]:
        modules = {}
        for name, module in list(sys.modules.items()):
            file = getattr(module, "__file__", None)
            path = Path(file).resolve() if file else None
            if path is None or path.suffix != ".py" or name.startswith(_PREFIX) or not path.is_relative_to(folder):
                continue
            inner = path.relative_to(folder).parts
            if len(inner) == 1 or not (anywhere or {"site-packages", "lib"} & set(inner)):
                modules[name] = module
        return modules

    outside = {name: module for name, module in neighbours().items() if "." not in name and name != "__main__"}
    for name in outside:
        del sys.modules[name]
    before, written = set(sys.modules), sys.dont_write_bytecode
    imported: list[Path] = []
    sys.path.insert(0, str(folder))
    sys.meta_path.insert(sys.meta_path.index(PathFinder), finder)
    sys.dont_write_bytecode = True
    try:
        yield imported
    finally:
        sys.meta_path.remove(finder)
        sys.path.remove(str(folder))
        sys.dont_write_bytecode = written
        for name, module in neighbours().items():
            if name not in before:
                imported.append(Path(str(module.__file__)).resolve())
                del sys.modules[name]
        sys.modules.update(outside)


def import_installed(module_name: str, where: str) -> tuple[ModuleType, Path, dict[str, Path]]:
    """Import an installed module; return it, its path, and its file by name where it has one.  Raises InputError."""
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
    """Import a module and the packages that it is in, one after the other, each once it is trusted.

    To find what is in a package Python imports that package, so a package is decided on before anything in it is looked
    for.  ``names``: what else the user names it by.  Raises CodeRefusedError, and whatever the module raises.
    """
    parts = module_name.split(".")
    for name in (".".join(parts[:count]) for count in range(1, len(parts) + 1)):
        spec = None if name in sys.modules else find_spec(name)
        is_local = spec is not None and not _is_python_itself(spec) and _need_trust_of(spec, where, module_name, *names)
        written = sys.dont_write_bytecode
        sys.dont_write_bytecode = written or is_local  # a compiled copy beside it would be another file to ask for
        try:
            importlib.import_module(name)
        finally:
            sys.dont_write_bytecode = written


def _is_python_itself(spec: ModuleSpec) -> bool:
    return spec.origin in ("built-in", "frozen") and not spec.has_location


def _need_trust_of(spec: ModuleSpec, where: str, *names: str) -> bool:
    """Refuse a module that is not installed unless its files are trusted; return whether it is not installed.

    Of a package every file that Python may run of it counts, and of a folder without ``__init__``, which runs nothing
    itself, as well.  Raises CodeRefusedError, also where no file is found.
    """
    origin = Path(spec.origin) if spec.has_location and spec.origin else None
    top = spec.name.partition(".")[0]
    if origin is not None and _is_installed(origin, top):
        return False
    folders = [Path(folder) for folder in spec.submodule_search_locations or ()]
    files = {file for folder in folders if not _is_installed(folder, top) for file in _runnable(folder)}
    files |= {origin} if origin is not None and origin.is_file() else set()
    code = [code_of(file, *names) for file in sorted(files)]
    if origin is not None and origin.suffix == ".py" and not folders:
        code += _imports(origin, names[0])
    is_namespace = spec.origin is None and bool(folders)
    if not code and not is_namespace:
        raise CodeRefusedError(f"{where}: {spec.name}: is not installed, and no file of it can be looked at; unpack it")
    need_trust(code, where)
    return bool(code)


def _runnable(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder that Python may import, compiled copies too, and through links."""
    visited = set[str]()
    for current, inner, names in os.walk(folder, followlinks=True):
        real = os.path.realpath(current)
        if real in visited:
            inner.clear()
            continue
        visited.add(real)
        yield from (file for name in names if name.endswith(_RUNNABLE) and (file := Path(current, name)).is_file())


def _is_installed(path: Path, top: str) -> bool:
    """Return whether a path belongs to Python, to us, or to what is installed; ``top``: the package that it is in.

    Metadata beside a file that call it installed are not trusted.
    """
    absolute = Path(os.path.abspath(path))
    paths = absolute, absolute.resolve()
    if any(candidate.is_relative_to(folder) for candidate in paths for folder in (*_installed_folders(), PACKAGE)):
        return True
    starts = [folder / inner / top for folder in _editable_folders(top) for inner in ("", "src")]
    return any(paths[1].is_relative_to(start) or paths[1] == start.with_suffix(".py") for start in starts)


@cache
def _installed_folders() -> frozenset[Path]:
    """Return the folders where Python and its packages are installed."""
    paths = get_paths()
    user = [site.getusersitepackages()] if site.ENABLE_USER_SITE else []
    names = [*(paths[name] for name in ("stdlib", "platstdlib", "purelib", "platlib")), *site.getsitepackages(), *user]
    return frozenset(candidate for name in names for candidate in (Path(name), Path(name).resolve()))


@cache
def _editable_folders(top: str) -> list[Path]:
    """Return where the distributions are developed that are installed in place and have a package of this name."""
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    folders = []
    for distribution in distributions(path=[str(folder) for folder in _installed_folders()]):
        with suppress(ValueError, LookupError, TypeError, AttributeError):  # metadata that say something else
            origin = json.loads(distribution.read_text("direct_url.json") or "{}")
            tops = (distribution.read_text("top_level.txt") or re.sub(r"[-.]+", "_", distribution.name)).split()
            if top in tops and origin["dir_info"]["editable"] is True and origin["url"].startswith("file:"):
                folders.append(Path(url2pathname(urlsplit(origin["url"]).path)).resolve())
    return folders
