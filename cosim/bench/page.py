"""The measurements in a Markdown page: generated tables between marks, and whatever text stands around them.

A mark is ``<!-- measured: NAME -->`` before a part and ``<!-- end -->`` after it, each on a line of its own.  What is
between them is written anew, so that no figure is typed by hand and all figures are of one run.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from cosim.bench.suite import Result
from cosim.bench.tables import KEYS, Table, tables
from cosim.config import nearest
from cosim.errors import InputError
from cosim.files import replacing

COMMAND = "command"
NAMES = (COMMAND, *KEYS)
ABSENT = "Not measured in this run.\n"
_PART = re.compile(r"^<!-- measured: (.*?) -->\n(.*?)^<!-- end -->$", re.MULTILINE | re.DOTALL)
_MARK = re.compile(r"^<!-- (?:measured: .*|end) -->$", re.MULTILINE)


def check_page(path: Path) -> None:
    """Raises InputError if a page could not be written there: before hours of measuring, not after."""
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: the folder {path.parent} cannot be written to")
    fill(path, {})


def write_page(path: Path, result: Result, command: str) -> None:
    """Write the measurements into the page, or a new page.  Raises InputError if that is not possible."""
    parts = {key: f"Not measured: {_cell(why)}\n" for key, why in result.failed.items()}
    parts |= {key: _part(found) for key, found in tables(result).items()}
    page = fill(path, parts | {COMMAND: f"```\n{command}\n```\n"})
    try:
        with replacing(path) as temporary:
            temporary.write_text(page, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error


def fill(path: Path, parts: dict[str, str]) -> str:
    """The page with what is between its marks replaced; a new one if there is none yet.

    Raises InputError for a page that cannot be read, or whose marks do not fit together.
    """
    page = _read(path)
    names = [match.group(1) for match in _PART.finditer(page)]
    for name in names:
        if name not in NAMES:
            raise InputError(f"{path}: unknown mark {name!r}; {nearest(name, NAMES)}")
    if not names or len(_MARK.findall(page)) != 2 * len(names):
        raise InputError(
            f"{path}: its marks do not come in pairs <!-- measured: NAME --> and <!-- end -->; nothing was written; "
            "a file that is not there yet gets them all"
        )

    def measured(match: re.Match[str]) -> str:
        name = match.group(1)
        return f"<!-- measured: {name} -->\n{parts.get(name, ABSENT)}<!-- end -->"

    return _PART.sub(measured, page)


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return "".join(["# What a flight costs\n", *(f"\n<!-- measured: {name} -->\n<!-- end -->\n" for name in NAMES)])
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or error}") from error


def _part(found: list[Table]) -> str:
    return "\n".join("\n".join(_lines(table)) + "\n" for table in found)


def _lines(table: Table) -> Iterator[str]:
    yield from (f"**{_cell(table.title[:1].upper() + table.title[1:])}**", "")
    width = len(table.columns)
    yield _row(("", *table.columns))
    yield _row(("---", *["---:" if width > 1 else "---"] * width))
    yield from (_row(row) for row in table.rows)
    for note in table.notes:
        yield from ("", _cell(note))


def _row(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(map(_cell, cells))} |"


def _cell(text: str) -> str:
    """A text that Markdown leaves as it is."""
    return re.sub(r"([\\`*_|<>])", r"\\\1", text)
