"""Where a controller from outside comes from: its name, what it states of itself, and the files that it is.

A name is ``FILE.py:Class``, ``package.module:Class``, ``FILE.fmu``, ``process:FILE ARGUMENTS``, ``FILE.csv`` (what was
recorded of actuators), or that of an entry point of an installed package::

    [project.entry-points."hexjet.controllers"]
    my-controller = "my_package.my_module:MyController"
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
from functools import cached_property
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, packages_distributions, version
from math import isfinite
from pathlib import Path
from types import CodeType, ModuleType, SimpleNamespace
from typing import Any

from cosim.base.controller_wire import EXTRAS
from cosim.base.errors import InputError, nearest
from cosim.base.protocols import Column, Parameter
from cosim.base.storage.cache import Memory
from cosim.base.trust import Code, CodeRefusedError, code_of, need_trust
from cosim.control.predictors.registry import BASELINE, PREDICTORS
from cosim.simulation.controllers import recorded
from cosim.simulation.controllers.execute import executed, import_trusted, imported, program_code
from cosim.simulation.controllers.guard import columns_from, described
from cosim.simulation.controllers.process import Command, ProcessBlock, describe, program
from cosim.spec.controller_name import file_name, is_design
from cosim.spec.controller_name import label as label_of

GROUP = "hexjet.controllers"  # of entry points
# Levels, and what the update of each is told.
LEVELS: dict[str, tuple[str, ...]] = {
    "predictor": ("measured", "applied"),
    "rate": ("setpoint", "measured", "applied"),
    "attitude": ("command", "measured"),
    "controller": ("command", "measured", "applied"),
}
OBJECT = "python:"  # before the name of one that a program handed over, and that no file can make again
_MODULE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
_NAME = re.compile(r"[A-Za-z_]\w*")


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@dataclass(frozen=True)
class Source:
    """A controller from outside before it flies.

    ``files``: what it is made of, the first being the one that its name names, under the names that they have in a
    run's folder.  ``make`` makes a block, at rest.
    """

    name: str
    level: str
    make: Callable[[], Any]
    files: Mapping[str, Path]
    version: str = ""  # of the package that it is in
    predictor: str = BASELINE.name  # ours, under a loop of its own above
    parameters: Sequence[Parameter] = ()
    columns: Sequence[Column] = ()
    copied: bool = True  # its files go into a run's folder
    repeats: bool = True  # it is code of this process; else it is found out whether it answers the same again
    text: str = ""  # of a class that no file holds, where it is to be had

    @property
    def label(self) -> str:
        """What messages and rows call it."""
        return label_of(self.name)

    @cached_property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of each file, or of a text that is in none."""
        if self.text:
            return {f"{self.label}, its source": hashlib.sha256(self.text.encode()).hexdigest()}
        return {name: _sha256(path) for name, path in self.files.items()}

    @property
    def sha256(self) -> str:
        """One hash for all: that of its file where it is one; empty where there is nothing to be had of it."""
        if not self.hashes:
            return ""
        if len(self.hashes) == 1:
            return next(iter(self.hashes.values()))
        return hashlib.sha256("".join(f"{value}  {name}\n" for name, value in self.hashes.items()).encode()).hexdigest()

    def values(self, stated: Mapping[str, float], where: str) -> dict[str, float]:
        """Its parameters with what is stated of them.  Raises InputError: one line with the key and what is allowed."""
        known = {parameter.name: parameter for parameter in self.parameters}
        for name, value in stated.items():
            if name not in known:
                allowed = nearest(name, known) if known else f"controller {self.label} has none"
                raise InputError(f"{where}.{name}: unknown parameter; {allowed}")
            if not known[name].least <= value <= known[name].most:
                least, most, unit = known[name].least, known[name].most, known[name].unit
                raise InputError(f"{where}.{name} = {value:g}: must be from {least:g} to {most:g} {unit}".rstrip())
        return {name: stated.get(name, parameter.default) for name, parameter in known.items()}

    def expect(self, sha256: str | None, where: str) -> None:
        """Refuse another file than the one that flew.  Raises InputError with the difference."""
        if sha256 is not None and sha256 != self.sha256:
            raise InputError(
                f"{where}: controller {self.label} is not the one that was flown: its sha256 is {self.sha256[:12]}, "
                f"then it was {sha256[:12]}; leave out controller_sha256 to fly what is there now"
            )


def find(controller: str, folder: Path, complaint: str) -> Source | None:
    """The controller of that name, a file seen from ``folder``; None where it is one of ours.

    Raises InputError: ``complaint`` and what there is, or what is wrong with it.
    """
    named = file_name(controller)
    if named is not None and not is_design(controller):
        path = Path(named.seen_from(folder).file)
        if not path.is_file():
            raise InputError(f"controller {controller}: {path}: no such file")
        if named.before:
            return _of_process(controller, path, named.after)
        if not named.after:
            return _of_record(controller, path) if path.suffix.lower() == ".csv" else _of_fmu(controller, path)
        return _of_file(controller, path, named.after[1:])
    if named is None and controller in PREDICTORS:
        return None
    if controller.startswith(OBJECT):
        raise InputError(
            f"controller {controller.removeprefix(OBJECT)!r} was an object of a program, which no file can make again: "
            "give it anew, cosim.fly(scenario, controller=...)"
        )
    if named is None and _MODULE.fullmatch(controller):
        return _of_module(controller)
    for entry in entry_points(group=GROUP):
        if entry.name == controller:
            return _of_entry(entry)
    if controller.lower().endswith(".py"):
        raise InputError(f"controller {controller}: a file alone is none; name its class too: {controller}:Mine")
    names = [*PREDICTORS, *(entry.name for entry in entry_points(group=GROUP))]
    raise InputError(f"{complaint}; {nearest(controller, names)}")


def names() -> Iterator[tuple[str, str]]:
    """The controllers of installed packages, and what each is.  Raises InputError for one that cannot be loaded.

    One that only says that it is installed is not run for that.
    """
    for entry in entry_points(group=GROUP):
        try:
            level = _of_entry(entry).level
        except CodeRefusedError:
            yield entry.name, f"{entry.value} (not where packages are installed, and not run to look at it)"
            continue
        said = (entry.load().__doc__ or "").strip().partition("\n")[0].rstrip(".")
        yield entry.name, f"{said or entry.value} ({level})"


def of_object(given: Any) -> Source:
    """A class or an object of a program.  Raises InputError for one that is no controller.

    A class of a file flies again from that file, and so does an object that is as its class makes it without being told
    anything.  Of one of a notebook's cell the text is hashed, where it is to be had.
    """
    made = given if isinstance(given, type) else type(given)
    label = f"{made.__module__}.{made.__qualname__}"
    path = file_of(made)
    files = {} if path is None else {path.name: path}
    make = None if isinstance(given, type) else _copies(given)
    again = path is not None and path.suffix == ".py" and made.__qualname__.isidentifier()
    if again and (isinstance(given, type) or _as_made(given, made)):
        return _stated(f"{path}:{made.__name__}", given, make, files)
    source = _stated(f"{OBJECT}{label}", given, make, files, copied=False)
    return source if files else replace(source, text=_text_of(made))


def _copies(given: Any) -> Callable[[], Any]:
    return lambda: copy.deepcopy(given)


def _as_made(given: Any, made: type) -> bool:
    try:
        return pickle.dumps(vars(made())) == pickle.dumps(vars(given))
    except Exception:  # it cannot be told, so it is not said
        return False


def file_of(made: Any) -> Path | None:
    """The file that a class or a function is in; not that of the module into which its text was executed."""
    try:
        found = inspect.getsourcefile(made)
    except (TypeError, OSError):
        return None
    path = None if found is None else Path(found)
    if path is None or not path.is_file():
        return None
    codes = _codes(made)
    return path if not codes or any(Path(code.co_filename) == path for code in codes) else None


def _codes(made: type) -> list[CodeType]:
    """Of the functions that its own text defines."""
    return [inspect.unwrap(function).__code__ for function in vars(made).values() if inspect.isfunction(function)]


def _text_of(made: type) -> str:
    """The text of a class that no file holds, as a notebook keeps it for its tracebacks; empty where nobody does."""
    for code in _codes(made):
        text = "".join(linecache.getlines(code.co_filename))
        try:
            tree = ast.parse(text)
        except SyntaxError:  # a cell with commands of the notebook's own
            continue
        for node in ast.walk(tree):
            if not isinstance(node, ast.ClassDef) or node.name != made.__name__:
                continue
            if node.lineno <= code.co_firstlineno <= (node.end_lineno or 0):
                return ast.get_source_segment(text, node) or ""
    return ""


_known: Memory[Source] = Memory(32)


def _of_file(controller: str, path: Path, name: str) -> Source:
    def stated(module: ModuleType, files: dict[str, Path]) -> Source:
        return _stated(controller, _class(module, name, controller, path), None, files)

    return from_file((controller,), path, f"controller {controller}", stated)


def from_file(
    key: tuple[str, ...], path: Path, where: str, stated: Callable[[ModuleType, dict[str, Path]], Source]
) -> Source:
    """What is ``stated`` of the module of a file and of its files by name, anew where one of those has changed.

    ``key``: what is stated of it.  Raises InputError.
    """
    held = [(file, _sha256(file)) for file in _last_files.get(path, [path]) if file.is_file()]
    if path in _last_files:  # else it is run now, and what it imports is not known before
        need_trust([Code(file, sha256, (path,)) for file, sha256 in held], where)

    def load() -> Source:
        module, neighbours = executed(path, where)
        _last_files[path] = [path, *neighbours]
        return stated(module, {file.name: file for file in (path, *neighbours)})

    return _known.get((*key, str(path), tuple(held)), load)


_last_files: dict[Path, list[Path]] = {}  # by path what it was made of when it was last read


def _of_process(controller: str, path: Path, arguments: str) -> Source:
    need_trust(program_code(path, arguments), f"controller {label_of(controller)}")
    command = program(path, arguments)
    key = (controller, str(path), _sha256(path))

    def ask() -> Source:
        description = describe(command, path.parent, label_of(controller))
        return _described(controller, description, {path.name: path}, command, path.parent)

    return _known.get(key, ask)


def _of_fmu(controller: str, path: Path) -> Source:
    from cosim.engine.make.controller_fmu import command, describing, read_controller_fmu

    try:
        fmu = read_controller_fmu(path)
    except InputError as error:
        raise InputError(f"controller {controller}: {error}") from error
    need_trust([code_of(fmu.path, path, fmu.path)], f"controller {label_of(controller)}")
    key = (controller, str(path), *[_sha256(file) for file in fmu.files.values()])
    run = command(path)
    return _known.get(key, lambda: _described(controller, describing(fmu), fmu.files, lambda: run, path.parent))


def _of_record(controller: str, path: Path) -> Source:
    rows, columns = recorded.read(path, f"controller {label_of(controller)}")
    source = Source(
        controller, "controller", lambda: recorded.Recorded(rows, columns), {path.name: path}, columns=columns
    )
    source.hashes  # noqa: B018  of what was read just now
    return source


def _described(
    controller: str, said: Mapping[str, Any], files: Mapping[str, Path], command: Command, folder: Path
) -> Source:
    """What a process or an FMU says of itself.  Raises InputError for what does not fit."""
    label = label_of(controller)
    where = f"controller {label}"
    known = ("level", "predictor", "extras", "parameters", "columns")
    for key in said:
        if key not in known:
            raise InputError(f"{where}: its first line: {key!r}: {nearest(key, known)}")
    level, predictor, columns, parameters = _states(SimpleNamespace(**said), where, "[name, unit, frame, meaning]")
    extras = said.get("extras", ())
    if not isinstance(extras, (list, tuple)):
        raise InputError(f"{where}: extras = {extras!r}: must be a list")
    for extra in extras:
        if extra not in EXTRAS or level != "controller":
            raise InputError(
                f"{where}: extras: {extra!r}: must be of a whole controller, and one of {', '.join(EXTRAS)}"
            )
    source = Source(
        controller,
        level,
        lambda: ProcessBlock(command, folder, label, level, columns, extras),
        files,
        predictor=predictor,
        parameters=parameters,
        columns=columns,
        repeats=False,
    )
    source.hashes  # noqa: B018  of what was read just now
    return source


def _of_module(controller: str) -> Source:
    module_name, _, name = controller.partition(":")
    module, path, files = imported(module_name, f"controller {controller}")
    kind = _class(module, name, controller, path)
    return _stated(controller, kind, None, files, version_of(module_name), copied=False)


def _of_entry(entry: EntryPoint) -> Source:
    where = f"entry point {entry.name!r} of {GROUP}"
    if entry.name in PREDICTORS:
        raise InputError(f"{where}: there is a predictor of this name already")
    member, package = loaded(entry, where)
    path = file_of(member) if isinstance(member, type) else None
    files = {} if path is None else {path.name: path}
    return _stated(entry.name, member, None, files, package, copied=False)


def loaded(entry: EntryPoint, where: str) -> tuple[Any, str]:
    """What an entry point names, and name and version of its package.  Raises InputError."""
    try:
        import_trusted(entry.module, where, entry.name)
        member = entry.load()
    except CodeRefusedError:
        raise
    except Exception as error:
        raise InputError(f"{where}: {entry.value} cannot be loaded: {described(error)}") from error
    return member, "" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"


def version_of(module: str) -> str:
    """Name and version of the installed package that a module belongs to; empty where it belongs to none."""
    top = module.split(".")[0]
    for package in packages_distributions().get(top, []):
        try:
            return f"{package} {version(package)}"
        except PackageNotFoundError:
            continue
    return ""


def _class(module: ModuleType, name: str, controller: str, path: Path) -> type:
    member = getattr(module, name, None)
    if not isinstance(member, type):
        classes = [
            member_class
            for member_class, value in vars(module).items()
            if isinstance(value, type) and hasattr(value, "level")
        ]
        said = nearest(name, classes) if classes else "there is no class with a level in it"
        raise InputError(f"controller {controller}: {path.name} has no class {name!r}; {said}")
    return member


def _stated(
    controller: str,
    block: Any,
    make: Callable[[], Any] | None,
    files: Mapping[str, Path],
    package: str = "",
    copied: bool = True,
) -> Source:
    """What a class states of itself.  Raises InputError for what does not fit."""
    where = f"controller {label_of(controller)}"
    level, predictor, columns, parameters = _states(block, where, "Column(name, unit, frame, meaning)")
    for method, told in (("reset", ()), ("update", LEVELS[level])):
        check_method(block, method, told, where)
    if hasattr(block, "prepare"):
        check_method(block, "prepare", ("belief",), where)
    make = make or _maker(block, where)
    source = Source(controller, level, make, files, package, predictor, parameters, columns, copied)
    source.hashes  # noqa: B018  of what was read just now
    return source


def _states(block: Any, where: str, column: str) -> tuple[str, str, tuple[Column, ...], tuple[Parameter, ...]]:
    """Level, predictor, columns and parameters that a block states; ``column``: how it writes one.

    Raises InputError for what does not fit.
    """
    level, predictor = getattr(block, "level", None), BASELINE.name
    if not isinstance(level, str) or level not in LEVELS:
        raise InputError(f"{where}: level = {level!r}: must be one of {', '.join(LEVELS)}")
    if level == "attitude":  # what another calls its predictor is its own
        predictor = getattr(block, "predictor", predictor)
        PREDICTORS.find(str(predictor), f"{where}: predictor = {predictor!r}: there is none of that name")
    try:
        columns = columns_from(block)
    except TypeError as error:
        raise InputError(f"{where}: columns: must be {column}: {error}") from error
    return level, predictor, columns, parameters_of(block, where)


def _maker(made: Callable[[], Any], where: str) -> Callable[[], Any]:
    def make() -> Any:
        try:
            return made()
        except Exception as error:
            raise InputError(f"{where}: cannot be made without arguments: {described(error)}") from error

    return make


def check_method(block: Any, method: str, told: Sequence[str], where: str) -> None:
    """Refuse a block without a method, or with one that takes something else.  Raises InputError."""
    function = getattr(block, method, None)
    if not callable(function):
        raise InputError(f"{where}: has no {method}({', '.join(told)})")
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return  # it does not say
    try:
        signature.bind(*([None] if isinstance(block, type) else []), *told)
    except TypeError as error:
        raise InputError(f"{where}: {method}{signature}: must take ({', '.join(told)})") from error


def parameters_of(block: Any, where: str) -> tuple[Parameter, ...]:
    """The parameters that a block states.  Raises InputError."""
    parameters: list[Parameter] = []
    stated = getattr(block, "parameters", ())
    if not isinstance(stated, (list, tuple)):
        raise InputError(f"{where}: parameters = {stated!r}: must be a list of Parameter(name, default, ...)")
    for item in stated:
        try:
            one = Parameter(*item)
            numbers = float(one.default), float(one.least), float(one.most)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"{where}: parameters: {item!r}: must be Parameter(name, default, ...): {error}"
            ) from error
        if not _NAME.fullmatch(str(one.name)):
            raise InputError(f"{where}: parameter {one.name!r}: a name is of letters, digits and _, no digit first")
        if not isfinite(numbers[0]) or not numbers[1] <= numbers[0] <= numbers[2]:
            raise InputError(f"{where}: parameter {one.name}: default = {one.default}: must be from least to most")
        if one.name in [other.name for other in parameters]:
            raise InputError(f"{where}: parameter {one.name}: is there twice")
        parameters.append(one._replace(default=numbers[0]))
    return tuple(parameters)
