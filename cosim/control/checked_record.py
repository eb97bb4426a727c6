"""Frozen records whose fields are checked against their annotations, made from plain JSON values and written as such.

Every number is finite and in range when a record exists; the constructors raise InputError with one line otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, NamedTuple, Union, dataclass_transform, get_args, get_origin, get_type_hints

from cosim.base.errors import InputError


class Bounds(NamedTuple):
    """The closed range of a number."""

    lower: float
    upper: float


@dataclass_transform(frozen_default=True)
class CheckedRecord:
    """Frozen data class whose fields are checked against their annotations, also in subclasses."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True)(cls)

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for name, hint in _find_field_types(kind).items():
            object.__setattr__(self, name, _convert(getattr(self, name), hint, f"{kind.__name__}.{name}"))


def make_record(kind: type[Any], values: Any, where: str) -> Any:
    """Return a record of type ``kind`` from a table.  Raises InputError for a key that is unknown or absent."""
    if not isinstance(values, Mapping):
        raise InputError(f"{where} = {values!r}: must be a table")
    names = [field.name for field in fields(kind)]
    for key in values:
        if key not in names:
            raise InputError(f"{where}: unknown key {key!r}; it has {', '.join(names) or 'none'}")
    try:
        return kind(**values)
    except TypeError as error:  # a field without a default is not there
        absent = [name for name in names if name not in values]
        raise InputError(f"{where}: not complete; absent: {', '.join(absent)}") from error


def to_plain(record: Any) -> dict[str, Any]:
    """Return a record as plain JSON values, without the fields that are at their default."""
    values: dict[str, Any] = {}
    for field in fields(record):
        value = getattr(record, field.name)
        if value != field.default or type(value) is not type(field.default):
            values[field.name] = _to_plain_value(value)
    return values


def _to_plain_value(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_to_plain_value(item) for item in value]
    if isinstance(value, Enum):
        return value.value
    return to_plain(value) if isinstance(value, CheckedRecord) else value


@cache
def _find_field_types(kind: type[Any]) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _convert(value: Any, hint: Any, where: str) -> Any:
    """Return ``value`` converted to the annotated type.  Raises InputError."""
    origin, args = get_origin(hint), get_args(hint)
    if origin in (UnionType, Union):
        if value is None:
            return None
        (inner,) = (arg for arg in args if arg is not NoneType)
        return _convert(value, inner, where)
    if origin is Annotated:
        number, (lower, upper) = _convert_to_number(value, args[0], where), args[1]
        if not lower <= number <= upper:
            raise InputError(f"{where} = {number!r}: must be from {lower:g} to {upper:g}")
        return number
    if origin is tuple:
        return _convert_items(value, args, where)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return _convert_to_enum(value, hint, where)
    if isinstance(hint, type) and issubclass(hint, CheckedRecord):
        return value if isinstance(value, hint) else make_record(hint, value, where)
    if not isinstance(value, hint):
        raise InputError(f"{where} = {value!r}: must be {'true or false' if hint is bool else 'a text'}")
    return value


def _convert_items(value: Any, kinds: tuple[Any, ...], where: str) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)):
        raise InputError(f"{where} = {value!r}: must be a list")
    if kinds[-1] is Ellipsis:
        kinds = kinds[:1] * len(value)
    if len(kinds) != len(value):
        raise InputError(f"{where}: {len(value)} values, {len(kinds)} are needed")
    pairs = enumerate(zip(value, kinds, strict=True))
    return tuple(_convert(item, kind, f"{where}[{i}]") for i, (item, kind) in pairs)


def _convert_to_enum(value: Any, kind: type[Enum], where: str) -> Enum:
    if isinstance(value, kind):
        return value
    allowed = {str(member.value): member for member in kind}
    if not isinstance(value, str) or value not in allowed:
        raise InputError(f"{where} = {value!r}: must be one of {', '.join(allowed)}")
    return allowed[value]


def _convert_to_number(value: Any, kind: type[float] | type[int], where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{where} = {value!r}: must be a number")
    if kind is int:
        if value != value or abs(value) > 2**53 or int(value) != value:
            raise InputError(f"{where} = {value!r}: must be a whole number")
        return int(value)
    if not abs(value) < 1e300:
        raise InputError(f"{where} = {value!r}: must be a finite number")
    return float(value)
