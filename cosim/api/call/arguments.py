"""Arguments of calls, checked before anything is done."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from math import inf, isfinite
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec, TypeVar, Union, get_args, get_origin

from cosim.base.errors import InputError, nearest

if TYPE_CHECKING:
    import inspect

P = ParamSpec("P")  # parameters of a wrapped function
R = TypeVar("R")  # result type of a wrapped function
_MAX_VALUE_CHARACTERS = 40  # of a wrong value in a message


class Limits(NamedTuple):
    """Range of numbers that an argument may have."""

    least: float
    most: float = inf
    is_open: bool = False  # True: ``least`` itself is not allowed

    def __contains__(self, number: object) -> bool:
        if not isinstance(number, (int, float)) or not self.least <= number <= self.most:
            return False
        return number > self.least or not self.is_open

    def __str__(self) -> str:
        lower = f"{'above' if self.is_open else 'at least'} {self.least:g}"
        return lower if self.most == inf else f"{lower}, at most {self.most:g}"


def check_types(**limits: Limits) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator that checks arguments against their annotated types and ``limits``.

    Raises InputError, in one line, also for numbers that are not finite.
    """

    def decorate(call: Callable[P, R]) -> Callable[P, R]:
        # Adapters are made at the first call, so that importing the module stays quick.
        adapters: dict[str, Any] = {}

        @functools.wraps(call)
        def call_checked(*arguments: P.args, **named: P.kwargs) -> R:
            import inspect

            signature = inspect.signature(call)
            takes_any = any(each.kind is each.VAR_KEYWORD for each in signature.parameters.values())
            for name in () if takes_any else named:
                if name not in signature.parameters:
                    raise InputError(f"{call.__name__}: no argument {name!r}; {nearest(name, signature.parameters)}")
            try:
                bound = signature.bind(*arguments, **named)
            except TypeError as error:
                raise InputError(f"{call.__name__}: {error}") from None
            if not adapters:
                adapters.update(_make_type_adapters(call))
            for name, value in bound.arguments.items():
                parameter = signature.parameters[name]
                check = functools.partial(_validate_argument, call, parameter, adapters[name], limits.get(name))
                several = parameter.kind is inspect.Parameter.VAR_POSITIONAL
                if several and len(value) == 1 and isinstance(value[0], (list, tuple)):
                    value = value[0]
                bound.arguments[name] = tuple(map(check, value)) if several else check(value)
            return call(*bound.args, **bound.kwargs)

        vars(call_checked)["limits"] = limits
        return call_checked

    return decorate


def _check_value(where: str, value: Any, limits: Limits | None) -> None:
    """Raise InputError for a number that is not finite or outside ``limits``, and for a text with a zero byte."""
    if isinstance(value, float) and not isfinite(value):
        raise InputError(f"{where}: {value:g} is no finite number")
    if limits is not None and value is not None and value not in limits:
        raise InputError(f"{where}: {value:g}; allowed: {limits}")
    if isinstance(value, (str, Path)) and "\0" in str(value):
        raise InputError(f"{where}: {str(value)!r} has a zero in it, and is no name")


def _make_type_adapters(call: Callable[..., Any]) -> dict[str, Any]:
    """Return pydantic's type adapter of each argument by name."""
    import inspect

    from pydantic import InstanceOf, TypeAdapter

    def check_instances(hint: Any) -> Any:
        """Return the type with this package's classes replaced by instance checks, which do not validate fields."""
        if isinstance(hint, type) and hint.__module__.startswith("cosim"):
            return InstanceOf[hint]  # type: ignore[misc]
        if get_origin(hint) in (Union, UnionType):
            return Union[tuple(map(check_instances, get_args(hint)))]  # noqa: UP007 - made of a tuple
        return hint

    names, hints = vars(inspect.getmodule(call)), inspect.get_annotations(call)
    return {name: TypeAdapter(check_instances(eval(hint, names))) for name, hint in hints.items() if name != "return"}


def _validate_argument(
    call: Callable[..., Any], parameter: inspect.Parameter, adapter: Any, limits: Limits | None, value: Any
) -> Any:
    """Return an argument, converted to its annotated type.  Raises InputError."""
    from pydantic import ValidationError

    where = f"{call.__name__}: {parameter.name}"
    try:
        try:
            valid = adapter.validate_python(value)
        except ValidationError:
            # A single value stands for a sequence of one.
            if isinstance(value, (list, tuple, Mapping)) or "Sequence" not in str(parameter.annotation):
                raise
            valid = adapter.validate_python((value,))
    except ValidationError as error:
        shown = repr(value)
        shown = shown if len(shown) <= _MAX_VALUE_CHARACTERS else f"{shown[: _MAX_VALUE_CHARACTERS - 3]}..."
        wrong = error.errors(include_url=False)
        listed = [each["ctx"]["expected"] for each in wrong if each["type"] == "literal_error"]
        names = listed[0].split("'")[1::2] if listed else []  # pydantic's text: 'a', 'b' or 'c'
        for each in wrong:
            if listed and isinstance(each["input"], str):
                raise InputError(f"{where}: {each['input']!r}: {nearest(each['input'], names)}") from None
        allowed = listed[0] if listed else parameter.annotation
        raise InputError(f"{where}: {shown} is a value of type {type(value).__name__}; allowed: {allowed}") from None
    _check_value(where, valid, limits)
    return valid
