"""The measurements of one run in a Markdown page, between its marks (:mod:`cosim.results.report.marks`)."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from benchmarks.suite import Result
from benchmarks.tables import KEYS, Table, tables
from cosim import InputError
from cosim.commands import nearest
from cosim.files import write_whole
from cosim.pages import cell, page_parts, row, write_marks

COMMAND = "command"
NAMES = (COMMAND, *KEYS)
ABSENT = "Not measured in this run.\n"


def check_page(path: Path) -> None:
    """Raise InputError if a page cannot be written, before hours of measuring."""
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: the folder {path.parent} cannot be written to")
    if path.exists():
        _read_marks(path)


def write_page(path: Path, result: Result, command: str) -> None:
    """Write the measurements into the page and its data page, or into a new page.

    Raises InputError if that is not possible.
    """
    texts = {key: f"Not measured: {cell(why)}\n" for key, why in result.failed.items()}
    texts |= {key: _format_part(part) for key, part in tables(result).items()}
    texts[COMMAND] = f"```\n{command}\n```\n"
    if path.exists():
        write_marks(path, {name: texts.get(name, ABSENT) for name in _read_marks(path)})
        return
    marks = (f"\n<!-- measured: {name} -->\n{texts.get(name, ABSENT)}<!-- end -->\n" for name in NAMES)
    write_whole(path, "".join(["# What a flight costs\n", *marks]), InputError)


def _read_marks(path: Path) -> list[str]:
    """Return the marks of a page and its data page.

    Raises InputError for a page that cannot be read, or whose marks do not fit together.
    """
    names = list(page_parts(path))
    for name in names:
        if name not in NAMES:
            raise InputError(f"{path}: unknown mark {name!r}; {nearest(name, NAMES)}")
    if not names:
        raise InputError(f"{path}: it has no mark <!-- measured: NAME -->; a file that is not there yet gets them all")
    return names


def _format_part(tables: list[Table]) -> str:
    return "\n".join("\n".join(_format_table(table)) + "\n" for table in tables)


def _format_table(table: Table) -> Iterator[str]:
    yield from (f"**{cell(table.title[:1].upper() + table.title[1:])}**", "")
    width = len(table.columns)
    yield row(("", *table.columns))
    yield row(("---", *["---:" if width > 1 else "---"] * width))
    yield from (row(cells) for cells in table.rows)
    for note in table.notes:
        yield from ("", cell(note))
