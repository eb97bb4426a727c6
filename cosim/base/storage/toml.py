"""Reading TOML into typed, frozen models, and saying in one line what is wrong with it."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from math import isfinite
from pathlib import Path
from sys import float_info
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from cosim.base.errors import InputError, nearest
from cosim.base.removed import describe_removed
from cosim.base.storage.cache import RecentCache
from cosim.base.storage.files import read_file

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
    from pydantic_core import ErrorDetails
else:
    ModelMetaclass = type(BaseModel)


class _HidePydanticNames(ModelMetaclass):
    """Metaclass whose classes list in ``dir`` their keys and methods without those of pydantic."""

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *vars(self).get("__pydantic_fields__", ())} - _PYDANTIC_NAMES)


_PYDANTIC_NAMES = frozenset(name for name in dir(BaseModel) if not name.startswith("__"))  # hidden in dir()


class Model(BaseModel, metaclass=_HidePydanticNames):
    """A frozen table of a TOML file: unknown keys, NaN and infinities are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)
    listed_by: ClassVar[str] = ""  # command that lists all keys

    def __dir__(self) -> list[str]:
        return dir(type(self))

    @model_validator(mode="before")
    @classmethod
    def _read_table(cls, data: Any) -> Any:
        """Merge list entries given by index into the default list; refuse texts and truth values as numbers."""
        if not isinstance(data, dict):
            return data
        lists, numeric = _list_defaults(cls), _numeric_fields(cls)
        if by_index := {name: data[name] for name in lists if isinstance(data.get(name), Mapping)}:
            data = {**data, **merge({name: lists[name] for name in by_index}, by_index)}
        for name, value in data.items():
            if name in numeric and type(value) is not float:
                for number in value if isinstance(value, list) else [value]:
                    if isinstance(number, (str, bool)):
                        raise ValueError(f"{name} = {number!r}: {_describe_number(cls, name, number)}")
        return data


@cache
def _list_defaults(model: type[BaseModel]) -> Mapping[str, list[Any]]:
    """Return the default of each field that has a tuple as default, as a list."""
    defaults = {name: field.default for name, field in model.model_fields.items()}
    return {name: list(default) for name, default in defaults.items() if isinstance(default, tuple)}


@cache
def _numeric_fields(model: type[BaseModel]) -> frozenset[str]:
    """Return the fields that are numbers, or lists of numbers, and nothing else."""
    annotations = {name: repr(field.annotation) for name, field in model.model_fields.items()}
    return frozenset(
        name
        for name, kind in annotations.items()
        if re.search(r"\b(float|int)\b", kind) and not re.search(r"\b(str|bool)\b", kind)
    )


def _check_scalar(value: object) -> object:
    is_finite = isinstance(value, str) or (isinstance(value, (int, float)) and abs(value) <= float_info.max)
    if not is_finite:
        raise ValueError("must be a finite number, true, false or a text")
    return value


Scalar = Annotated[bool | int | float | str, BeforeValidator(_check_scalar)]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Seconds = Annotated[float, Field(ge=0.0, le=1e6)]  # s since the start of the flight, or span
Duration = Annotated[float, Field(gt=0.0, le=1e6)]  # s, of a duration
_SAMPLE = "a sample is one control step (step_s, 0.004 s on the Hex-Jet: 60 ms are 15)"
Samples = Annotated[int, Field(ge=0, le=1000, description=_SAMPLE)]
Vector = tuple[float, float, float]
Axis3 = tuple[NotNegative, NotNegative, NotNegative]

M = TypeVar("M", bound=BaseModel)

_DOTTED_NAMES = re.compile(  # keys with names that may contain dots
    r"(?P<head>(?:mismatch\.)?engine_parameters|stations\.[^.]+\.parameters|mismatch\.stations\.[^.]+)\.(?P<name>.+)"
    r"|(?P<file>vehicle\.identified)\.(?P<family>.+)\.(?P<axis>roll|pitch|yaw)\.(?P<rest>.+)"
)
_parsed: RecentCache[dict[str, Any]] = RecentCache(64)


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file.  Raises InputError that names the file and, for bad syntax, the line."""
    try:
        # The limit is a hundred times the size of the largest shipped file.
        text = read_file(path, max_mb=16.0).decode().replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text (byte {error.start}); a TOML file is needed") from error
    try:
        table: dict[str, Any] = _deep_copy(_parsed.get(text, lambda: tomllib.loads(text)))
        return table
    except ValueError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    except RecursionError as error:
        raise InputError(f"{path}: not valid TOML: nested too deep") from error


def _deep_copy(table: Any) -> Any:
    if isinstance(table, dict):
        return {key: _deep_copy(value) for key, value in table.items()}
    return [_deep_copy(value) for value in table] if isinstance(table, list) else table


def toml_text(table: Mapping[str, Any], multiline: bool = False) -> str:
    """Return a table as TOML; ``multiline``: texts with line ends over several lines."""
    import tomli_w

    return tomli_w.dumps(table, multiline_strings=multiline)


def validate(model: type[M], data: Mapping[str, Any], where: str) -> M:
    """Convert a TOML table to the pydantic ``model``; ``where`` names its source in errors, unless empty.

    Raises InputError: one line with the key, the value and what is allowed.

    >>> class Wheel(Model):
    ...     radius_m: float
    >>> validate(Wheel, {"radius_m": 0.2}, "wheel.toml")
    Wheel(radius_m=0.2)
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{where}: {_describe_error(model, error)}".removeprefix(": ")) from error


def merge(base: Mapping[str, Any], changes: Mapping[str, Any], model: object = None) -> dict[str, Any]:
    """Return ``base`` with the leaves of ``changes`` merged in; neither is changed.

    A table whose keys are all places in a list, counted from 0, is written over those entries of it.
    ``model``: of ``base``; its tables and lists stand where nothing changes, and take no time to be validated again.
    """
    own = {key: value for key, value in vars(model).items() if key in base} if isinstance(model, Model) else {}
    merged = {**base, **{key: value for key, value in own.items() if isinstance(value, (Model, tuple, list))}}
    for key, value in changes.items():
        old = base.get(key)
        if isinstance(value, Mapping) and isinstance(old, Mapping):
            merged[key] = merge(old, value, own.get(key))
        elif isinstance(value, Mapping) and isinstance(old, list) and _are_keys_indices(value, old):
            entries = {str(index): entry for index, entry in enumerate(old)}
            merged[key] = list(merge(entries, value).values())
        else:
            merged[key] = value
    return merged


def _are_keys_indices(changes: Mapping[str, Any], entries: list[Any]) -> bool:
    return bool(changes) and all(key in map(str, range(len(entries))) for key in changes)


def nest(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return changes whose dotted keys are tables in tables."""
    nested: dict[str, Any] = {}
    for key, value in changes.items():
        *above, last = split_key(key)
        entry = {last: value}
        for part in reversed(above):
            entry = {part: entry}
        nested = merge(nested, entry)
    return nested


def parse_setting(text: str) -> tuple[list[str], Any]:
    """Split ``a.b.c=VALUE`` into its path and its value, read as TOML and, failing that, as a string.

    Raises InputError if there is no ``=`` or the key is empty.
    """
    key, equals, value = text.partition("=")
    path = [part.strip() for part in split_key(key.strip())]
    if not equals or not all(path):
        raise InputError(f"settings {text}: write it as KEY=VALUE, for example vehicle.mass_kg=6.0")
    return path, parse_value(value)


def parse_value(text: str) -> Any:
    """Return a value read as TOML and, failing that, as a text."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text.strip()


def split_key(key: str) -> list[str]:
    """Return the parts of a dotted key.

    The name of an engine's parameter and that of an engine's file may have dots of their own: they stay whole.
    """
    match = _DOTTED_NAMES.fullmatch(key)
    if not match:
        return key.split(".")
    if match["head"]:
        return [*match["head"].split("."), match["name"].strip("\"'")]
    return [*match["file"].split("."), match["family"].strip("\"'"), match["axis"], *match["rest"].split(".")]


def parse_numbers(texts: Iterable[str], option: str) -> dict[str, float]:
    """Return ``NAME=NUMBER`` texts as a table of finite numbers.  Raises InputError that names ``option``.

    >>> parse_numbers(["mass_kg=5.6"], "settings")
    {'mass_kg': 5.6}
    """
    numbers = {}
    for text in texts:
        ((name, number),) = parse_values([text]).items()
        if not name or isinstance(number, str) or not isfinite(number):
            raise InputError(f"{option} {text}: write it as NAME=NUMBER, with a finite number")
        numbers[name] = number
    return numbers


def parse_values(texts: Iterable[str]) -> dict[str, float | str]:
    """Return ``NAME=VALUE`` texts as a table of numbers; other values stay texts."""
    values: dict[str, float | str] = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        try:
            values[name] = float(value)
        except ValueError:
            values[name] = value
    return values


def set_path(data: dict[str, Any], path: list[str], value: Any, where: str) -> None:
    """Write ``value`` at a dotted path into nested tables and lists (a number indexes a list).

    Raises InputError where the path runs through something that is neither.
    """
    here: Any = data
    for depth, part in enumerate(path):
        last = depth == len(path) - 1
        if isinstance(here, list):
            if not part.lstrip("-").isdigit() or not 0 <= int(part) < len(here):
                raise InputError(
                    f"{where}: {'.'.join(path[: depth + 1])}: a number from 0 to {len(here) - 1} goes here"
                )
            if last:
                here[int(part)] = value
            else:
                here = here[int(part)]
        elif isinstance(here, dict):
            if last:
                here[part] = value
            else:
                here = here.setdefault(part, {})
        else:
            raise InputError(f"{where}: {'.'.join(path[:depth])} is a value, not a table")


def _guess_typo(key: str, unknown: Sequence[str]) -> str:
    """Return a clause with an unknown key that may be a typo of the missing ``key``, or an empty string."""
    import difflib

    close = difflib.get_close_matches(key, unknown, n=1, cutoff=0.8)
    return f"; unknown key {close[0]} may be meant for it" if close else ""


def _describe_error(model: type[BaseModel], error: ValidationError) -> str:
    errors = error.errors()
    if not _is_not_false(errors[0]):
        # A table that may also be false gives two errors; the one about false is of no use to the user.
        errors = [item for item in errors if not _is_not_false(item)]
    first = errors[0]
    key = ".".join(_file_keys(model, first["loc"]))
    kind, value = first["type"], first["input"]
    rest = "".join(_describe_others(model, errors, key))
    if kind == "extra_forbidden":
        name = str(first["loc"][-1])
        if (removed := describe_removed(name)) is not None:
            return f"{key}: {removed}"
        allowed = sorted({allowed for table in _find_tables(model, first["loc"]) for allowed in table.model_fields})
        return f"unknown key {key!r}; {nearest(name, allowed, getattr(model, 'listed_by', ''))}{rest}"
    if kind == "missing":
        unknown = [".".join(_file_keys(model, item["loc"])) for item in errors if item["type"] == "extra_forbidden"]
        return f"{key} is missing{_guess_typo(key, unknown) or rest}"
    if kind == "union_tag_not_found":
        return f"{key}.kind is missing{rest}"
    if kind == "union_tag_invalid":
        context = first["ctx"]
        kinds = context["expected_tags"].replace("'", "").split(", ")
        return f"{key}.kind = {context['tag']!r}: {nearest(context['tag'], kinds)}{rest}"
    if kind == "model_type":
        return f"{key} = {value!r}: must be a table{rest}"
    if kind == "too_short":
        return f"{key}: needs at least {first['ctx']['min_length']}{rest}"
    if kind == "too_long":
        return f"{key}: may have at most {first['ctx']['max_length']}, not {first['ctx']['actual_length']}{rest}"
    message = _describe_missing_entry(kind, value) or first["msg"].removeprefix("Value error, ").removeprefix("Input ")
    message = message.replace("should be a valid ", "must be a ").replace("a integer", "an integer")
    shown = "" if isinstance(value, (dict, list)) else f" = {value!r}"
    description = _describe_field(_find_tables(model, first["loc"]), first["loc"][-1]) if key else ""
    return f"{key}{shown}: {message}{description}{rest}" if key else f"{message}{rest}"


def _describe_field(tables: Iterable[type[BaseModel]], name: int | str) -> str:
    """Return a clause with the description of a key of these tables, or an empty string."""
    found = (table.model_fields.get(str(name)) for table in tables)
    return "".join(f"; {field.description}" for field in found if field and field.description)


def _describe_number(table: type[BaseModel], name: str, given: str | bool) -> str:
    """Return what a text in place of a number must be, and how many samples a time is that is given for them."""
    stated = re.fullmatch(r"(\d+\.?\d*) ?([A-Za-z]\S*)", str(given))
    if stated and name.endswith("_samples") and stated[2] in ("ms", "s"):
        samples = float(stated[1]) * (1.0 if stated[2] == "ms" else 1000.0) / 4.0
        return f"must be a number of samples; {given} are {samples:g} samples of 4 ms, the Hex-Jet's control step"
    unit = ", in the unit that the key ends with" if stated else ""
    return f"must be a number{unit}{_describe_field([table], name)}"


def _describe_missing_entry(kind: str, value: Any) -> str:
    """Return the message that a list has no entry to override, or an empty string for other errors."""
    if kind != "list_type" or not isinstance(value, dict) or not all(str(key).isdigit() for key in value):
        return ""
    return f"there is no entry {', '.join(map(str, value))} to write over; a new list is [{{...}}]"


def _describe_others(
    model: type[BaseModel], errors: Sequence[ErrorDetails], first: str, max_others: int = 5
) -> Iterator[str]:
    """Yield clauses on the other wrong keys: missing, unknown and invalid ones."""
    kinds: dict[str, dict[str, None]] = {"missing": {}, "unknown": {}, "wrong": {}}
    names = {"missing": "missing", "extra_forbidden": "unknown"}
    for item in errors[1:]:
        key = ".".join(_file_keys(model, item["loc"]))
        if key not in ("", first):
            kinds[names.get(item["type"], "wrong")][key] = None
    for kind, keys in kinds.items():
        if keys:
            listed = [*list(keys)[:max_others], *(["..."] if len(keys) > max_others else [])]
            yield f"; {kind}{' too' if kind == names.get(errors[0]['type'], 'wrong') else ''}: {', '.join(listed)}"


def _is_not_false(item: ErrorDetails) -> bool:
    """Return whether a validation error says that a value is not false."""
    return item["loc"][-1:] == ("literal[False]",)


def _file_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the keys of a validation error's location as they are in the file.

    Pydantic names the kind of a list's entry behind its number, and of a value that may be of several kinds the one
    that it tried.
    """
    names = {submodel.__name__ for submodel in _collect_models(model)}
    kind = location[2:3] if location[:1] in {("command",), ("disturbance",), ("fault",)} else ()
    return [
        str(part)
        for before, part in zip((None, *location), location, strict=False)
        if not (isinstance(before, int) and isinstance(part, str) and part in kind)
        and not (isinstance(part, str) and (part in names or part.startswith(("function-", "literal["))))
    ]


def _collect_models(model: type[BaseModel]) -> set[type[BaseModel]]:
    models, waiting = {model}, [model]
    while waiting:
        for field in waiting.pop().model_fields.values():
            new = set(_find_models(field.annotation)) - models
            models |= new
            waiting += new
    return models


def _find_tables(model: type[BaseModel], location: tuple[int | str, ...]) -> list[type[BaseModel]]:
    """Return the models that the table with ``location`` may be of; none in a mapping of plain values."""
    models: list[type[BaseModel]] = [model]
    for part in location[:-1]:
        fields = [table.model_fields[str(part)] for table in models if part in table.model_fields]
        kinds = [table for table in models if _find_kind_name(table) == part]
        # An index or a mapping's key keeps the models; a field's name leads to the models of its type.
        if fields or kinds:
            models = kinds + [submodel for field in fields for submodel in _find_models(field.annotation)]
    return models


def _find_kind_name(model: type[BaseModel]) -> Any:
    kind = model.model_fields.get("kind")
    return get_args(kind.annotation)[0] if kind and get_args(kind.annotation) else None


def _find_models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _find_models(part)]
