"""What the keys of files mean: the comment of a model's field, or the words of ``meanings.toml`` beside this module."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from functools import cache
from itertools import takewhile
from pathlib import Path

from pydantic import BaseModel

from cosim.base.storage.toml import read_toml

_read_cached_toml = cache(read_toml)


def meaning_of(model: type[BaseModel], name: str, *, markdown: bool = False) -> str:
    """Return a field's meaning as a clause, empty if none is stated."""
    words = _read_cached_toml(Path(__file__).with_name("meanings.toml"))
    of_model = words.get(model.__name__, {})
    text = str(comments_of(model).get(name) or of_model.get(name) or of_model.get("*") or words["common"].get(name, ""))
    return text if markdown else re.sub(r"\[(.*?)\]\(.*?\)", r"\1", text).replace("`", "")


@cache
def comments_of(model: type[BaseModel]) -> dict[str, str]:
    """Return the comment on each field in a model's source: the trailing one, else the lines above the field."""
    bases = [base for base in model.__mro__[1:] if base.__module__.startswith("cosim") and issubclass(base, BaseModel)]
    found = {name: text for base in bases for name, text in comments_of(base).items()}
    try:
        source = textwrap.dedent(inspect.getsource(model))
    except (OSError, TypeError):  # a model that is built at run time
        return found
    lines, (node,) = source.splitlines(), ast.parse(source).body
    assert isinstance(node, ast.ClassDef)
    for each in node.body:
        if not isinstance(each, ast.AnnAssign):
            continue
        behind = [_trailing_comment(line) for line in lines[each.lineno - 1 : each.end_lineno]]
        above = takewhile(lambda line: line.lstrip().startswith("#"), reversed(lines[: each.lineno - 1]))
        higher = reversed([line.strip().removeprefix("#").strip() for line in above])
        if text := " ".join(filter(None, behind)) or " ".join(higher):
            found[ast.unparse(each.target)] = text
    return found


def _trailing_comment(line: str) -> str:
    """Return the comment at the end of a line, ignoring ``#`` in texts."""
    match = re.search(r"\s#\s(.*)$", re.sub(r"\"[^\"]*\"|'[^']*'", lambda text: "x" * len(text[0]), line))
    return line[match.start(1) :] if match else ""
