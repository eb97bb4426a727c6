"""docs/theory.md: every formula stands by a function that exists; tests of each function compute the formula."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from places import DOCS, ROOT


def defined(path: Path) -> set[str]:
    """Functions, classes and methods of a module, dotted; of a C file the functions."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".c":
        return set(re.findall(r"^static [\w *]*?(\w+)\(", text, re.MULTILINE))

    def below(node: ast.AST, prefix: str) -> set[str]:
        found = set()
        for child in ast.iter_child_nodes(node):
            if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
                found |= {prefix + child.name, *below(child, f"{prefix}{child.name}.")}
        return found

    return below(ast.parse(text), "")


def test_every_formula_names_a_function_that_exists() -> None:
    page = (DOCS / "theory.md").read_text(encoding="utf-8")
    formulas = re.findall(r"^\$\$$", page, re.MULTILINE)
    named = re.findall(r"`((?:cosim|tools)/[\w/]+\.py):([\w.]+)`", page)
    assert len(formulas) % 2 == 0
    assert len(formulas) // 2 >= 20
    assert [f"{file}:{name}" for file, name in named if name not in defined(ROOT / file)] == []
    parts = re.split(r"^## ", page, flags=re.MULTILINE)[1:]
    assert all("`cosim/" in part or "`tools/" in part for part in parts if "$$" in part)
