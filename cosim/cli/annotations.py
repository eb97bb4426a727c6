"""The types of options by the annotations of arguments, and the texts of docstrings as a terminal shows them."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from cosim.api.call import Progress


class _Unknown:
    """A type that is imported for type checkers alone; no option has a value of it."""


class _Types(dict[str, Any]):
    """The names of a module, in which one that is imported for type checkers alone is :class:`_Unknown`."""

    def __missing__(self, name: str) -> Any:
        return getattr(__import__("builtins"), name, _Unknown)


def read_type(annotation: Any, function: Callable[..., Any]) -> tuple[Any, bool, tuple[type, type] | None] | None:
    """Return the type of an option's value, whether there may be several, and the types of pairs; None: no option."""
    if isinstance(annotation, str):
        annotation = eval(annotation, {}, _Types(inspect.unwrap(function).__globals__))
    members = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    if Progress in members:
        return None
    for member in members:
        origin, inner = get_origin(member), get_args(member)
        if origin is Literal or (origin is tuple and Ellipsis not in inner):
            return member, False, None
        if origin in (Sequence, list, tuple, Iterable):
            read = read_type(inner[0], function)
            return None if read is None else (read[0], True, None)
    for member in members:
        if get_origin(member) is Mapping:
            return str, True, get_args(member)
    # Prefer str to numbers: where an argument accepts both, the text is passed on and the function parses it.
    for kind in (bool, str, int, float, Path):
        if kind in members:
            return kind, False, None
    return (str, False, None) if Any in members else None


def as_typed(text: str) -> str:
    """Return a text of a docstring as a terminal shows it: without marks of code and what is Python's alone."""
    text = re.sub(r"; in Python [^.;]*| or ``\{.*?\}``", "", text)
    text = re.sub(r"(^|[.;] )None: ", lambda found: f"{found[1]}{'By' if found[1] != '; ' else 'by'} default ", text)
    paragraphs = text.replace("``", "").split("\n\n")
    return "\n\n".join(" ".join(each.split()) for each in paragraphs)
