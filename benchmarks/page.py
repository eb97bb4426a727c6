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
from cosim.pages import cell, filled, parts_of, row

COMMAND = "command"
NAMES = (COMMAND, *KEYS)
ABSENT = "Not measured in this run.\n"


def check_page(path: Path) -> None:
    """Raise InputError if a page could not be written there: before hours of measuring, not after."""
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: the folder {path.parent} cannot be written to")
    fill(path, {})


def write_page(path: Path, result: Result, command: str) -> None:
    """Write the measurements into the page, or a new page.  Raises InputError if that is not possible."""
    texts = {key: f"Not measured: {cell(why)}\n" for key, why in result.failed.items()}
    texts |= {key: _part(part) for key, part in tables(result).items()}
    page = fill(path, texts | {COMMAND: f"```\n{command}\n```\n"})
    write_whole(path, page, InputError)


def fill(path: Path, texts: dict[str, str]) -> str:
    """Return the page with what is between its marks replaced; a new one if there is none yet.

    Raises InputError for a page that cannot be read, or whose marks do not fit together.
    """
    page = _read(path)
    names = parts_of(page, path)
    for name in names:
        if name not in NAMES:
            raise InputError(f"{path}: unknown mark {name!r}; {nearest(name, NAMES)}")
    if not names:
        raise InputError(f"{path}: it has no mark <!-- measured: NAME -->; a file that is not there yet gets them all")
    return filled(page, {name: texts.get(name, ABSENT) for name in names}, path)


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return "".join(["# What a flight costs\n", *(f"\n<!-- measured: {name} -->\n<!-- end -->\n" for name in NAMES)])
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or error}") from error


def _part(tables: list[Table]) -> str:
    return "\n".join("\n".join(_lines(table)) + "\n" for table in tables)


def _lines(table: Table) -> Iterator[str]:
    yield from (f"**{cell(table.title[:1].upper() + table.title[1:])}**", "")
    width = len(table.columns)
    yield row(("", *table.columns))
    yield row(("---", *["---:" if width > 1 else "---"] * width))
    yield from (row(cells) for cells in table.rows)
    for note in table.notes:
        yield from ("", cell(note))
