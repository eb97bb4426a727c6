"""Pages of Markdown in which a command writes its figures between marks, and leaves the text around them alone.

A mark is ``<!-- measured: NAME -->`` before a part and ``<!-- end -->`` after it, each on a line of its own.  What is
between them is written anew, so that no figure is typed by hand.  A page may hold marks of several commands.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.storage.files import read_text, write_whole

_PART = re.compile(r"^<!-- measured: (.*?) -->\n(.*?)^<!-- end -->$", re.MULTILINE | re.DOTALL)
_MARK = re.compile(r"^<!-- (?:measured: .*|end) -->$", re.MULTILINE)


def parts_of(page: str, where: Path | str) -> dict[str, str]:
    """Return a page's texts from ``<!-- measured: NAME -->`` to ``<!-- end -->``, by name.  Raises InputError."""
    parts = dict(_PART.findall(page))
    if len(_MARK.findall(page)) != 2 * len(parts):
        raise InputError(
            f"{where}: its marks do not come in pairs <!-- measured: NAME --> and <!-- end -->; nothing was written"
        )
    return parts


def filled(page: str, parts: Mapping[str, str], where: Path | str) -> str:
    """Return the page with new ``parts`` (whole lines) between the marks of these names, otherwise unchanged.

    Raises InputError for marks that do not come in pairs and for a part that has no mark.
    """
    _refuse_unknown_marks(Path(where), parts, parts_of(page, where))

    def replace_part(match: re.Match[str]) -> str:
        name = match.group(1)
        return f"<!-- measured: {name} -->\n{parts.get(name, match.group(2))}<!-- end -->"

    return _PART.sub(replace_part, page)


def page_parts(path: Path) -> dict[str, str]:
    """Return the texts between the marks of a page and of its data page, by name.

    Raises InputError if one of them cannot be read, or its marks do not come in pairs or have a name twice.
    """
    return _merge_parts(_read_parts(path))


def check_marks(path: Path, names: Iterable[str]) -> None:
    """Check that a page or its data page has the ``<!-- measured: NAME -->`` marks of ``names`` and can be written.

    Raises InputError where this is not so.
    """
    pages = _read_parts(path)
    _refuse_unknown_marks(path, names, _merge_parts(pages))
    for page in pages:
        if not os.access(page, os.W_OK):
            raise InputError(f"{page}: cannot be written to")


def write_marks(path: Path, parts: Mapping[str, str]) -> None:
    """Write ``parts`` between the marks of their names, on the page or on its data page.

    Raises InputError for marks that do not come in pairs, for a part without mark, and if a file cannot be written.
    """
    pages = _read_parts(path)
    _refuse_unknown_marks(path, parts, _merge_parts(pages))
    for page, marked in pages.items():
        new = {name: text for name, text in parts.items() if name in marked}
        if new or page == path:
            write_whole(page, filled(read_text(page), new, page), InputError)


def _read_parts(path: Path) -> dict[Path, dict[str, str]]:
    """Return the texts between marks by page: those of the page, then those of its data page, if any."""
    data = path.parent / "tables" / path.name
    found: dict[Path, dict[str, str]] = {}
    for page in (path, data) if data.is_file() else (path,):
        parts = parts_of(read_text(page), page)
        if twice := [name for other in found.values() for name in parts if name in other]:
            raise InputError(f"{page}: its mark <!-- measured: {twice[0]} --> stands on {path} too")
        found[page] = parts
    return found


def _merge_parts(pages: Mapping[Path, Mapping[str, str]]) -> dict[str, str]:
    return {name: text for parts in pages.values() for name, text in parts.items()}


def _refuse_unknown_marks(path: Path, names: Iterable[str], marked: Mapping[str, str]) -> None:
    if missing := [name for name in names if name not in marked]:
        raise InputError(f"{path}: no mark <!-- measured: {missing[0]} -->; there are {', '.join(marked) or 'none'}")


def table(columns: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """Return a table in Markdown, its first ``left`` columns aligned to the left and the others to the right.

    >>> print(table(["key", "value"], [["mass", "5.6"]]), end="")
    | key | value |
    | --- | ---: |
    | mass | 5.6 |
    """
    rules = ["---" if n < left else "---:" for n in range(len(columns))]
    return "".join(f"{line}\n" for line in (row(columns), row(rules), *map(row, rows)))


def row(cells: Iterable[str]) -> str:
    """Return one row of a table, without the end of the line."""
    return f"| {' | '.join(map(cell, cells))} |"


def cell(text: str) -> str:
    """Return a text escaped so that Markdown shows it unchanged."""
    return re.sub(r"([\\`*_|<>])", r"\\\1", text)
