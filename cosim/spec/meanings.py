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

_read = cache(read_toml)


def meaning_of(model: type[BaseModel], name: str, *, markdown: bool = False) -> str:
    """Return what a field means, in a clause; empty where nothing says it."""
    words = _read(Path(__file__).with_name("meanings.toml"))
    of_model = words.get(model.__name__, {})
    text = str(comments(model).get(name) or of_model.get(name) or of_model.get("*") or words["common"].get(name, ""))
    return text if markdown else re.sub(r"\[(.*?)\]\(.*?\)", r"\1", text).replace("`", "")


@cache
def comments(model: type[BaseModel]) -> dict[str, str]:
    """Return what the comments of a model's source say of its fields: those behind a field, else those above it."""
    bases = [base for base in model.__mro__[1:] if base.__module__.startswith("cosim") and issubclass(base, BaseModel)]
    found = {name: text for base in bases for name, text in comments(base).items()}
    try:
        source = textwrap.dedent(inspect.getsource(model))
    except (OSError, TypeError):  # a model that is made of a list of names
        return found
    lines, (node,) = source.splitlines(), ast.parse(source).body
    assert isinstance(node, ast.ClassDef)
    for each in node.body:
        if not isinstance(each, ast.AnnAssign):
            continue
        behind = [_comment_behind(line) for line in lines[each.lineno - 1 : each.end_lineno]]
        above = takewhile(lambda line: line.lstrip().startswith("#"), reversed(lines[: each.lineno - 1]))
        higher = reversed([line.strip().removeprefix("#").strip() for line in above])
        if text := " ".join(filter(None, behind)) or " ".join(higher):
            found[ast.unparse(each.target)] = text
    return found


def _comment_behind(line: str) -> str:
    """Return the comment at the end of a line; a ``#`` in a text is none."""
    match = re.search(r"\s#\s(.*)$", re.sub(r"\"[^\"]*\"|'[^']*'", lambda text: "x" * len(text[0]), line))
    return line[match.start(1) :] if match else ""
