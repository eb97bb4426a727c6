"""Figures on the documentation's pages, read and compared with what they should be."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

from places import ROOT

NUMBER = r"([-+]?\d+(?:[ ,]\d{3})*(?:\.\d+)?(?:e[-+]?\d+)?)"


@cache
def text(page: str) -> str:
    """The page on one line, without emphasis."""
    return " ".join((ROOT / page).read_text(encoding="utf-8").replace("**", "").split())


def figures(page: str, sentence: str) -> list[str]:
    """The figures that stand for ``{}`` in a sentence of the page."""
    pattern = NUMBER.join(re.escape(part) for part in " ".join(sentence.split()).split("{}"))
    found = list(re.finditer(r"(?<![\d.])" + pattern, text(page)))
    assert len(found) == 1, f"{page}: {len(found)} times: {sentence}"
    return list(found[0].groups())


def last_digit(figure: str) -> float:
    """What one unit of its last printed digit is."""
    mantissa, _, exponent = figure.partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def value(figure: str) -> float:
    return float(figure.replace(" ", "").replace(",", ""))


def stated(page: str, sentence: str, *values: float) -> None:
    """The sentence is on the page and its figures are these values, rounded to what is printed."""
    for figure, found in zip(figures(page, sentence), values, strict=True):
        # a value half-way between two may be rounded either way
        assert abs(value(figure) - found) <= 0.5001 * last_digit(figure), f"{page}: {sentence}: {figure}, now {found}"


def rows(page: str, columns: int = 3) -> dict[str, list[str]]:
    """Tables of the page: the cells of each row by its first one."""
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
    return {row[0]: row[1:] for row in cells if len(row) == columns}


def numbers(cell: str) -> list[str]:
    return re.findall(r"-?\d+(?:\.\d+)?", cell)


def row_states(page: str, name: str, *values: float) -> None:
    """The first figures of a row's second cell are these values."""
    said = numbers(rows(page)[name][0])
    assert len(said) >= len(values), f"{page}: {name}"
    for figure, found in zip(said, values, strict=False):
        assert abs(abs(float(figure)) - abs(found)) <= 0.5001 * last_digit(figure), (
            f"{page}: {name}: {figure}, now {found}"
        )


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
