"""Where a block of the user's comes from: its name, what it states of itself, and the files that it is.

A name is ``FILE.py:Name``, ``package.module:Name``, or that of an entry point of an installed package
(:mod:`cosim.base.plugins.entry_points`); of a controller also ``FILE.fmu``, ``process:FILE ARGUMENTS``, ``FILE.csv``
(what was recorded of actuators).
"""

from __future__ import annotations

import ast
import copy
import hashlib
import inspect
import linecache
import pickle
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from importlib.metadata import EntryPoint, PackageNotFoundError, packages_distributions, version
from math import isfinite
from pathlib import Path
from types import CodeType, ModuleType, SimpleNamespace
from typing import Any

from cosim.base.controller_wire import OPTIONAL
from cosim.base.errors import InputError, describe_error, nearest
from cosim.base.plugins.entry_points import describe_entry, find_entries, load_entry
from cosim.base.plugins.execute import execute_file, import_installed
from cosim.base.protocols import Column, Parameter
from cosim.base.storage.cache import RecentCache
from cosim.base.storage.files import read_file
from cosim.base.trust import Code, CodeRefusedError, need_trust, program_code
from cosim.control.predictors.registry import BASELINE, PREDICTORS
from cosim.simulation.controllers import recorded
from cosim.simulation.controllers.guard import read_columns_of
from cosim.simulation.controllers.process import Command, ProcessBlock, make_program_command, request_description
from cosim.spec.controller_name import is_design, split_file_name
from cosim.spec.controller_name import label as label_of

# Arguments of ``update`` by the level of a controller.
UPDATE_ARGUMENTS: dict[str, tuple[str, ...]] = {
    "predictor": ("measured", "applied"),
    "rate": ("setpoint", "measured", "applied"),
    "attitude": ("command", "measured"),
    "controller": ("command", "measured", "applied"),
}
# Methods that blocks of other kinds must have, with their arguments; a metric is itself called.
REQUIRED_METHODS: dict[str, tuple[tuple[str, tuple[str, ...]], ...]] = {
    "metric": (("__call__", ("log", "step_s")),),
    "observer": (("observe", ("sample",)),),
    "sensors": (("reset", ("state", "measured")), ("sample", ("state", "measured"))),
    "wind": (("velocity", ("time", "north", "east", "height")),),
}
IN_MEMORY_PREFIX = "python:"  # marks the name of an object in memory
_MODULE_NAME = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")  # form of module:Name
PYTHON_NAME = re.compile(r"[A-Za-z_]\w*")  # form of a Python name


def _hash_file(path: Path) -> str:
    return hashlib.sha256(read_file(path)).hexdigest()


@dataclass(frozen=True)
class Source:
    """Source of a user's block, from which each flight makes it: a controller of some level, or another kind.

    ``files``: what it is made of, the first being the one that its name names, under the names that they have in a
    run's folder.  ``make`` makes a block, at rest.
    """

    name: str
    level: str
    make: Callable[[], Any]
    files: Mapping[str, Path]
    version: str = ""  # name and version of its package
    predictor: str = BASELINE.name  # predictor that feeds a custom loop
    parameters: Sequence[Parameter] = ()
    columns: Sequence[Column] = ()
    is_copied: bool = True  # its files are copied into a run's folder
    is_in_process: bool = True  # False: answers are checked to repeat
    text: str = ""  # source text of a class without a file

    @property
    def label(self) -> str:
        """Short name of the block in messages and rows."""
        return label_of(self.name)

    @cached_property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of each file of the block, or of its text if it is in no file."""
        if self.text:
            return {f"{self.label}, its source": hashlib.sha256(self.text.encode()).hexdigest()}
        return {name: _hash_file(path) for name, path in self.files.items()}

    @property
    def sha256(self) -> str:
        """SHA-256 of all files of the block together, or of its only one; empty if unavailable."""
        if not self.hashes:
            return ""
        if len(self.hashes) == 1:
            return next(iter(self.hashes.values()))
        return hashlib.sha256("".join(f"{value}  {name}\n" for name, value in self.hashes.items()).encode()).hexdigest()

    def resolve_values(self, specified: Mapping[str, float], where: str) -> dict[str, float]:
        """Return the values of the block's parameters.  Raises InputError with the key and allowed values."""
        parameters = {parameter.name: parameter for parameter in self.parameters}
        for name, value in specified.items():
            if name not in parameters:
                allowed = nearest(name, parameters) if parameters else f"controller {self.label} has none"
                raise InputError(f"{where}.{name}: unknown parameter; {allowed}")
            _, _, unit, _, least, most = parameters[name]
            if not least <= value <= most:
                raise InputError(f"{where}.{name} = {value:g}: must be from {least:g} to {most:g} {unit}".rstrip())
        return {name: specified.get(name, parameter.default) for name, parameter in parameters.items()}

    def check_hash(
        self, sha256: str | None, where: str, kind: str = "controller", key: str = "controller_sha256"
    ) -> None:
        """Raise InputError if the block's hash is not ``sha256``, which the scenario states in ``key``."""
        if sha256 is not None and sha256 != self.sha256:
            raise InputError(
                f"{where}: {kind} {self.label} is not the one that was flown: its sha256 is {self.sha256[:12]}, "
                f"then it was {sha256[:12]}; leave out {key} to fly what is there now"
            )


def find_controller_source(controller: str, folder: Path, complaint: str) -> Source | None:
    """Return the source of a controller by name; a file is relative to ``folder``.  None for a built-in one.

    Raises InputError: ``complaint`` and what there is, or what is wrong with it.
    """
    named = split_file_name(controller)
    if named is not None and not is_design(controller) and (named.before or not named.after):
        path = Path(named.resolve(folder).file)
        if not path.is_file():
            raise InputError(f"controller {controller}: {path}: no such file")
        if named.before:
            return _find_process_source(controller, path, named.after)
        return _record_source(controller, path) if path.suffix.lower() == ".csv" else _fmu_source(controller, path)
    if named is None and controller in PREDICTORS:
        return None
    if controller.startswith(IN_MEMORY_PREFIX):
        raise InputError(
            f"controller {controller.removeprefix(IN_MEMORY_PREFIX)!r} was an object of a program, which no file can "
            "make again: give it anew, cosim.fly(scenario, controller=...)"
        )
    source = find_python("controller", controller, folder)
    if source is not None:
        return source
    if controller.lower().endswith(".py"):
        raise InputError(f"controller {controller}: a file alone is none; name its class too: {controller}:Mine")
    if is_design(controller):
        raise InputError(f"controller {controller} is a design, which no scenario names: give it as controller")
    raise InputError(f"{complaint}; {nearest(controller, [*PREDICTORS, *find_entries('controller')])}")


def find_python(kind: str, name: str, folder: Path) -> Source | None:
    """Return the source of a Python block by name; a file is relative to ``folder``.  None: no such form of name."""
    named, where = split_file_name(name), f"{kind} {name}"
    if named is not None and named.after and not named.before:
        return _find_in_file(kind, name, Path(named.resolve(folder).file), named.after[1:])
    if named is None and _MODULE_NAME.fullmatch(name):
        module_name, _, attribute = name.partition(":")
        module, path, files = import_installed(module_name, where)
        block = _get_member(module, attribute, kind, where, path)
        return _make_source(kind, name, block, None, files, find_package_version(module_name), copied=False)
    entry = find_entries(kind).get(name)
    return None if entry is None else _load_entry_point(kind, name, entry)


def list_installed() -> Iterator[tuple[str, str]]:
    """Yield names and descriptions of controllers of installed packages.  Raises InputError if one fails to load.

    One that only says that it is installed is not run for that.
    """
    for name, entry in find_entries("controller").items():
        try:
            level = _load_entry_point("controller", name, entry).level
        except CodeRefusedError:
            yield name, f"{entry.value} (not where packages are installed, and not run to look at it)"
            continue
        description = (entry.load().__doc__ or "").strip().partition("\n")[0].rstrip(".")
        yield name, f"{description or entry.value} ({level})"


def make_object_source(value: Any) -> Source:
    """Return the source of a controller's class or object in memory.  Raises InputError for what is no controller.

    A class of a file flies again from that file, and so does an object that is as its class makes it without being told
    anything.  Of one of a notebook's cell the text is hashed, where it is to be had.
    """
    cls = value if isinstance(value, type) else type(value)
    label = f"{cls.__module__}.{cls.__qualname__}"
    path = find_source_file(cls)
    files = {} if path is None else {path.name: path}
    make = None if isinstance(value, type) else partial(copy.deepcopy, value)
    check_repeatable = path is not None and path.suffix == ".py" and cls.__qualname__.isidentifier()
    if check_repeatable and (isinstance(value, type) or _equals_fresh_instance(value, cls)):
        return _make_source("controller", f"{path}:{cls.__name__}", value, make, files)
    source = _make_source("controller", f"{IN_MEMORY_PREFIX}{label}", value, make, files, copied=False)
    return source if files else replace(source, text=_source_text(cls))


def _make_constant_function(value: Any) -> Callable[[], Any]:
    return lambda: value


def _equals_fresh_instance(value: Any, cls: type) -> bool:
    """Return whether an object's attributes are those of ``cls()``; False if they cannot be compared."""
    try:
        return pickle.dumps(vars(cls())) == pickle.dumps(vars(value))
    except Exception:  # not comparable: treated as changed
        return False


def find_source_file(cls: Any) -> Path | None:
    """Return the file that a class or a function is in, unless its text was executed into that file's module."""
    try:
        source_file = inspect.getsourcefile(cls)
    except (TypeError, OSError):
        return None
    path = None if source_file is None else Path(source_file)
    if path is None or not path.is_file():
        return None
    codes = _code_objects(cls)
    return path if not codes or any(Path(code.co_filename) == path for code in codes) else None


def _code_objects(cls: type) -> list[CodeType]:
    """Return the code objects of the functions that a class itself defines."""
    return [inspect.unwrap(function).__code__ for function in vars(cls).values() if inspect.isfunction(function)]


def _source_text(cls: type) -> str:
    """Return the source of a class defined in a notebook, or an empty string."""
    for code in _code_objects(cls):
        text = "".join(linecache.getlines(code.co_filename))
        try:
            tree = ast.parse(text)
        except SyntaxError:  # a notebook cell with IPython commands
            continue
        for node in ast.walk(tree):
            if not isinstance(node, ast.ClassDef) or node.name != cls.__name__:
                continue
            if node.lineno <= code.co_firstlineno <= (node.end_lineno or 0):
                return ast.get_source_segment(text, node) or ""
    return ""


_sources: RecentCache[Source] = RecentCache(32)


def _find_in_file(kind: str, name: str, path: Path, attribute: str) -> Source:
    """Return the source of a block in a file, reloaded if the file or a neighbour that it imports has changed."""
    where = f"{kind} {name}"
    if not path.is_file():
        raise InputError(f"{where}: {path}: no such file")
    need_trust([Code(path)], where)
    file_hashes = [(file, _hash_file(file)) for file in _files_by_path.get(path, [path]) if file.is_file()]

    def load_from_file() -> Source:
        module, neighbours = execute_file(path, where)
        _files_by_path[path] = [path, *neighbours]
        files = {file.name: file for file in (path, *neighbours)}
        return _make_source(kind, name, _get_member(module, attribute, kind, where, path), None, files)

    return _sources.get((kind, name, str(path), tuple(file_hashes)), load_from_file)


_files_by_path: dict[Path, list[Path]] = {}  # files that were last read


def _find_process_source(controller: str, path: Path, arguments: str) -> Source:
    need_trust([program_code(path, arguments)], f"controller {label_of(controller)}")
    command = make_program_command(path, arguments)
    key = (controller, str(path), _hash_file(path))

    def load_process() -> Source:
        description = request_description(command, path.parent, label_of(controller))
        return _process_source(controller, description, {path.name: path}, command, path.parent)

    return _sources.get(key, load_process)


def _fmu_source(controller: str, path: Path) -> Source:
    from cosim.engine.make.controller_fmu import describe_controller, make_command, read_controller_fmu

    try:
        fmu = read_controller_fmu(path)
    except InputError as error:
        raise InputError(f"controller {controller}: {error}") from error
    need_trust([Code(fmu.path, (path, fmu.path))], f"controller {label_of(controller)}")
    key = (controller, str(path), *[_hash_file(file) for file in fmu.files.values()])
    command_line = make_command(path)
    return _sources.get(
        key, lambda: _process_source(controller, describe_controller(fmu), fmu.files, lambda: command_line, path.parent)
    )


def _record_source(controller: str, path: Path) -> Source:
    rows, columns = recorded.read_commands(path, f"controller {label_of(controller)}")
    source = Source(
        controller, "controller", lambda: recorded.RecordedController(rows, columns), {path.name: path}, columns=columns
    )
    source.hashes  # noqa: B018  of what was read just now
    return source


def _process_source(
    controller: str, description: Mapping[str, Any], files: Mapping[str, Path], command: Command, folder: Path
) -> Source:
    """Return the source of a process or an FMU from its description.  Raises InputError for what does not fit."""
    label = label_of(controller)
    where = f"controller {label}"
    keys = ("level", "predictor", "extras", "parameters", "columns")
    for key in description:
        if key not in keys:
            raise InputError(f"{where}: its first line: {key!r}: {nearest(key, keys)}")
    level, predictor, columns, parameters = _read_attributes(
        SimpleNamespace(**description), where, "[name, unit, frame, meaning]"
    )
    extras = description.get("extras", ())
    if not isinstance(extras, (list, tuple)):
        raise InputError(f"{where}: extras = {extras!r}: must be a list")
    for extra in extras:
        if extra not in OPTIONAL or level != "controller":
            raise InputError(
                f"{where}: extras: {extra!r}: must be of a whole controller, and one of {', '.join(OPTIONAL)}"
            )
    source = Source(
        controller,
        level,
        lambda: ProcessBlock(command, folder, label, level, columns, extras),
        files,
        predictor=predictor,
        parameters=parameters,
        columns=columns,
        is_in_process=False,
    )
    source.hashes  # noqa: B018  of what was read just now
    return source


def _load_entry_point(kind: str, name: str, entry: EntryPoint) -> Source:
    if kind == "controller" and name in PREDICTORS:
        raise InputError(f"{describe_entry(entry)}: there is a predictor of this name already")
    member, package = load_entry(entry)
    path = find_source_file(member)
    return _make_source(kind, name, member, None, {} if path is None else {path.name: path}, package, copied=False)


@cache
def find_package_version(module: str) -> str:
    """Return name and version of a module's package; empty if not installed."""
    top = module.split(".")[0]
    for package in packages_distributions().get(top, []):
        try:
            return f"{package} {version(package)}"
        except PackageNotFoundError:
            continue
    return ""


def _get_member(module: ModuleType, name: str, kind: str, where: str, path: Path) -> Any:
    """Return a module's attribute: a controller's class, or anything for other kinds.  Raises InputError."""
    member, members = getattr(module, name, None), vars(module).items()
    if kind != "controller":
        if member is None:
            alternatives = [other for other, value in members if callable(value) and not other.startswith("_")]
            raise InputError(f"{where}: {path.name} has no {name!r}; {nearest(name, alternatives)}")
    elif not isinstance(member, type):
        alternatives = [other for other, value in members if isinstance(value, type) and hasattr(value, "level")]
        hint = nearest(name, alternatives) if alternatives else "there is no class with a level in it"
        raise InputError(f"{where}: {path.name} has no class {name!r}; {hint}")
    return member


def _make_source(
    kind: str,
    name: str,
    block: Any,
    make: Callable[[], Any] | None,
    files: Mapping[str, Path],
    package: str = "",
    copied: bool = True,
) -> Source:
    """Return the source of a block, checked and with its attributes.  Raises InputError for invalid ones."""
    if kind == "controller":
        where = f"controller {label_of(name)}"
        level, predictor, columns, parameters = _read_attributes(block, where, "Column(name, unit, frame, meaning)")
        methods: Any = [("reset", ()), ("update", UPDATE_ARGUMENTS[level])]
        methods += [("prepare", ("belief",))] if hasattr(block, "prepare") else []
        make = make or _make_factory(block, where)
        source = Source(name, level, make, files, package, predictor, parameters, columns, copied)
    else:
        where, methods = f"{kind} {name}", REQUIRED_METHODS[kind]
        if kind == "metric" and callable(block) and not isinstance(block, type):
            make, block = _make_constant_function(block), SimpleNamespace(__call__=block)
        elif not isinstance(block, type):
            raise InputError(f"{where}: must be a class{' or a function' if kind == 'metric' else ''}")
        source = Source(name, kind, make or _make_factory(block, where), files, package, is_copied=copied)
    for method, arguments in methods:
        check_method(block, method, arguments, where)
    source.hashes  # noqa: B018  of what was read just now
    return source


def _read_attributes(block: Any, where: str, column: str) -> tuple[str, str, tuple[Column, ...], tuple[Parameter, ...]]:
    """Read level, predictor, columns and parameters of a block; ``column`` parses a column.

    Raises InputError for what does not fit.
    """
    level, predictor = getattr(block, "level", None), BASELINE.name
    if not isinstance(level, str) or level not in UPDATE_ARGUMENTS:
        raise InputError(f"{where}: level = {level!r}: must be one of {', '.join(UPDATE_ARGUMENTS)}")
    if level == "attitude":  # other levels have no predictor to check
        predictor = getattr(block, "predictor", predictor)
        PREDICTORS.find(str(predictor), f"{where}: predictor = {predictor!r}: there is none of that name")
    try:
        columns = read_columns_of(block)
    except TypeError as error:
        raise InputError(f"{where}: columns: must be {column}: {error}") from error
    return level, predictor, columns, read_block_parameters(block, where)


def _make_factory(make_block: Callable[[], Any], where: str) -> Callable[[], Any]:
    def make_block_checked() -> Any:
        """Make the block.  Raises InputError if it cannot be made without arguments."""
        try:
            return make_block()
        except Exception as error:
            raise InputError(f"{where}: cannot be made without arguments: {describe_error(error)}") from error

    return make_block_checked


def check_method(block: Any, method: str, arguments: Sequence[str], where: str) -> None:
    """Raise InputError for a block without a method, or with other arguments of it."""
    function = getattr(block, method, None)
    if not callable(function):
        raise InputError(f"{where}: has no {method}({', '.join(arguments)})")
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return  # a method without a signature
    try:
        signature.bind(*([None] if isinstance(block, type) else []), *arguments)
    except TypeError as error:
        raise InputError(f"{where}: {method}{signature}: must take ({', '.join(arguments)})") from error


def read_block_parameters(block: Any, where: str) -> tuple[Parameter, ...]:
    """Return the parameters that a block declares.  Raises InputError."""
    parameters: list[Parameter] = []
    stated = getattr(block, "parameters", ())
    if not isinstance(stated, (list, tuple)):
        raise InputError(f"{where}: parameters = {stated!r}: must be a list of Parameter(name, default, ...)")
    for item in stated:
        try:
            parameter = Parameter(*item)
            limits = float(parameter.default), float(parameter.least), float(parameter.most)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"{where}: parameters: {item!r}: must be Parameter(name, default, ...): {error}"
            ) from error
        if not PYTHON_NAME.fullmatch(str(parameter.name)):
            raise InputError(
                f"{where}: parameter {parameter.name!r}: a name is of letters, digits and _, no digit first"
            )
        if not isfinite(limits[0]) or not limits[1] <= limits[0] <= limits[2]:
            raise InputError(
                f"{where}: parameter {parameter.name}: default = {parameter.default}: must be from least to most"
            )
        if parameter.name in [other.name for other in parameters]:
            raise InputError(f"{where}: parameter {parameter.name}: is there twice")
        parameters.append(parameter._replace(default=limits[0]))
    return tuple(parameters)
