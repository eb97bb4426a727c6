"""Arguments of a wrong type or name as one line, before anything is done."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from cosim.base.errors import InputError, nearest

P = ParamSpec("P")
R = TypeVar("R")
_SHOWN = 40  # characters of a wrong value


def checked(call: Callable[P, R]) -> Callable[P, R]:
    """Return a call that raises InputError, one line, where an argument's type is not the one annotated."""
    validated: list[Callable[P, R]] = []  # made at the first call: importing it costs nothing

    @functools.wraps(call)
    def with_check(*arguments: P.args, **named: P.kwargs) -> R:
        from pydantic import ConfigDict, ValidationError, validate_call

        parameters = inspect.signature(call).parameters
        for name in named:
            if name not in parameters:
                raise InputError(f"{call.__name__}: no argument {name!r}; {nearest(name, parameters)}")
        try:
            inspect.signature(call).bind(*arguments, **named)
        except TypeError as error:
            raise InputError(f"{call.__name__}: {error}") from None
        if not validated:
            config = ConfigDict(arbitrary_types_allowed=True)
            validated.append(validate_call(config=config)(_checker(call)))
        try:
            values = validated[0](*arguments, **named)
        except ValidationError as error:
            raise InputError(_line(call, error)) from None
        return call(**values)  # type: ignore[call-arg, arg-type]

    return with_check


def _checker(call: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function with the annotations of ``call`` that gives back its arguments by name."""

    @functools.wraps(call)
    def give_back(*arguments: Any, **named: Any) -> dict[str, Any]:
        return dict(inspect.signature(call).bind(*arguments, **named).arguments)

    return give_back


def _line(call: Callable[..., Any], error: Any) -> str:
    """Return the line for the first argument that is wrong."""
    first = error.errors(include_url=False)[0]
    parameters = list(inspect.signature(call).parameters.values())
    place = first["loc"][0]
    parameter = parameters[place] if isinstance(place, int) else inspect.signature(call).parameters[place]
    wrong = [each for each in error.errors(include_url=False) if each["loc"][0] == place]
    value = first["input"]
    shown = repr(value)
    shown = shown if len(shown) <= _SHOWN else f"{shown[: _SHOWN - 3]}..."
    listed = [each["ctx"]["expected"] for each in wrong if each["type"] == "literal_error"]
    if listed and isinstance(value, str):
        return f"{call.__name__}: {parameter.name}: {shown}: {nearest(value, _words(listed[0]))}"
    why = f"; allowed: {listed[0] if listed else parameter.annotation}"
    return f"{call.__name__}: {parameter.name}: {shown} is a value of type {type(value).__name__}{why}"


def _words(listed: str) -> list[str]:
    """Return the words of a list in quotes: ``'a', 'b' or 'c'``."""
    return listed.split("'")[1::2]
