"""The types of options by the annotations of arguments, and the texts of docstrings as a terminal shows them."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from cosim.api.call import Progress


class _UnimportedType:
    """Placeholder of a type that only type checkers import; no option has such a value."""


class _ModuleNamespace(dict[str, Any]):
    """Namespace of a module, in which a name imported only for type checkers is :class:`_UnimportedType`."""

    def __missing__(self, name: str) -> Any:
        return getattr(__import__("builtins"), name, _UnimportedType)


def read_type(annotation: Any, function: Callable[..., Any]) -> tuple[Any, bool, tuple[type, type] | None] | None:
    """Return an option's value type, whether it repeats, and the types of NAME=VALUE pairs; None: no option."""
    if isinstance(annotation, str):
        annotation = eval(annotation, {}, _ModuleNamespace(inspect.unwrap(function).__globals__))
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


def format_docstring(text: str) -> str:
    """Return a docstring's text for a terminal: without code marks and without remarks on Python."""
    text = re.sub(r"; in Python [^.;]*| or ``\{.*?\}``", "", text)
    text = re.sub(r"(^|[.;] )None: ", lambda found: f"{found[1]}{'By' if found[1] != '; ' else 'by'} default ", text)
    paragraphs = text.replace("``", "").split("\n\n")
    return "\n\n".join(" ".join(each.split()) for each in paragraphs)
