"""Tables as text, whoever wrote them: encoding, separator, decimal mark, where the head is, and what its units are."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from cosim.base.errors import InputError

# Of two that fit alike the first is taken: a comma may be a decimal mark.
SEPARATORS = (";", "\t", "|", ",")
SAMPLE = 200  # lines looked at
# The sampled lines, and all before them, lie within so many characters.
HEAD = 2**18
# At least this share of the lines has as many cells as most have.
LEAST_REGULAR = 0.5
BOMS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
DATES = ("%d.%m.%Y %H:%M:%S", "%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S", "%H:%M:%S")
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_NO_NUMBERS = ("", "nan", "-nan", "inf", "-inf", "+inf", "null", "none", "n/a", "na", "-")
_DATE = re.compile(r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}([ T].*)?|\d{1,2}:\d{2}:\d{2}.*")
_FRACTION = re.compile(r"(:\d{2})[.,](\d+)")
_BAD = re.compile(r"[\x00-\x08\x0e-\x1f]")


class TextTable(NamedTuple):
    """The rows as UTF-8 without a head, and how they are to be read."""

    rows: bytes
    names: tuple[str, ...]
    units: dict[str, str]
    separator: str
    decimal: str
    remarks: tuple[str, ...]


def decode(data: bytes) -> tuple[str, str] | None:
    """Return a file's text and its encoding; None for what is no text."""
    for mark, codec in BOMS:
        if data.startswith(mark):
            text = data[len(mark) :].decode(codec, "replace")
            break
    else:
        text, codec = _without_mark(data)
    return None if len(_BAD.findall(text[:4096])) > 0.01 * min(len(text), 4096) else (text, codec)


def _without_mark(data: bytes) -> tuple[str, str]:
    head = data[:4096]
    if 2 * head[1::2].count(0) > len(head[1::2]):
        return data.decode("utf-16-le", "replace"), "utf-16-le"
    if 2 * head[0::2].count(0) > len(head[0::2]):
        return data.decode("utf-16-be", "replace"), "utf-16-be"
    try:
        return data.decode("utf-8"), "utf-8"
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace"), "cp1252"


def read_text(path: Path) -> TextTable:
    """Read a table of text.  Raises InputError for a file that is none."""
    decoding = decode(path.read_bytes())
    if decoding is None:
        raise InputError(f"{path}: neither a log that is known nor text: it holds bytes that no table has")
    text, codec = decoding
    remarks = [] if codec == "utf-8" else [f"read as {codec}"]
    if "\n" not in text[:HEAD]:
        text = text.replace("\r", "\n")
    lines = [line.rstrip("\r") for line in text[:HEAD].split("\n")[: -1 if len(text) > HEAD else None]]
    first = next((n for n, line in enumerate(lines) if line.strip()), len(lines))
    separator_line = re.fullmatch(r'"?sep=(.)"?', lines[first].strip()) if first < len(lines) else None
    first += separator_line is not None
    full = [line for line in lines[first:] if line.strip()]
    if not full or (len(full) == 1 and any(mark in full[0] for mark in SEPARATORS) and not _NUMBER.search(full[0])):
        raise InputError(f"{path}: the table has no rows")
    separator, width = _separator(lines[first : first + SAMPLE], separator_line.group(1) if separator_line else "")
    if not separator:
        raise InputError(f"{path}: neither a log that is known nor a table: no separator cuts its lines alike")
    head, names = _names(lines, first, separator, width)
    if doubled := [name for name in names if name and names.count(name) > 1]:
        raise InputError(f"{path}: two columns are called {doubled[0]!r}")
    units, body = _units(lines, head, separator, names)
    decimal = _decimal([cell for line in lines[body : body + SAMPLE] for cell in cells(line, separator)], separator)
    if head > first:
        remarks.append(f"{head - first} lines before the head of the table are passed over")
    rows = text.split("\n", body)[body] if body < len(lines) else ""
    if separator == " ":
        separator, rows = "\t", "\n".join("\t".join(line.split()) for line in rows.split("\n"))
    return TextTable(rows.encode(), names, units, separator, decimal, tuple(remarks))


def cells(line: str, separator: str) -> list[str]:
    """Return the cells of a line, without blanks around them."""
    if separator == " ":
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error:
        return [cell.strip() for cell in line.split(separator)]


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, with a point or a comma, or a mark of a missing one."""
    return bool(_NUMBER.fullmatch(cell)) or cell.lower() in _NO_NUMBERS


def _is_value(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell) or _DATE.fullmatch(cell))


def _separator(lines: Sequence[str], nominal: str) -> tuple[str, int]:
    """Return the separator and how many cells it makes of a line; "" where nothing cuts the lines alike."""
    best, chosen = 0.0, ("", 0)
    for separator in (nominal,) if nominal else (*SEPARATORS, " "):
        rows = [cells(line, separator) for line in lines if line.strip()]
        width, count = Counter(map(len, rows)).most_common(1)[0]
        full_cells = [cell for row in rows if len(row) == width for cell in row]
        score = count / len(rows) * sum(map(_is_value, full_cells)) / max(len(full_cells), 1)
        if width > 1 and count > LEAST_REGULAR * len(rows) and score > best + 1e-9:
            best, chosen = score, (separator, width)
    alone = [line.strip() for line in lines if line.strip()]
    if not chosen[0] and sum(map(_is_value, alone)) > LEAST_REGULAR * len(alone):
        return SEPARATORS[-1], 1
    return chosen


def _names(lines: Sequence[str], first: int, separator: str, width: int) -> tuple[int, tuple[str, ...]]:
    """Return the number of the line with the names, and the names; the line before the rows where none has them."""
    at = next(n for n in range(first, len(lines)) if len(cells(lines[n], separator)) == width)
    row = cells(lines[at].lstrip("#% "), separator)
    if not any(map(_is_value, row)):
        return at, tuple(row)
    above = next((n for n in range(at - 1, first - 1, -1) if lines[n].strip()), -1)
    title = cells(lines[above].lstrip("#% "), separator) if above >= 0 else []
    # A head behind a mark of a comment, rows that end in a separator, or a head with cells that no row has.
    if len(title) >= width - 1 and not any(map(_is_value, title)):
        return above, tuple([*title, ""][:width])
    return at - 1, tuple(f"column_{n}" for n in range(1, width + 1))


def _units(lines: Sequence[str], head: int, separator: str, names: Sequence[str]) -> tuple[dict[str, str], int]:
    """Return the units by name from a line below the names, if there is one, and where the rows begin."""
    body = next((n for n in range(head + 1, len(lines)) if lines[n].strip()), len(lines))
    row = cells(lines[body], separator) if body < len(lines) else []
    if head < 0 or not any(row) or any(map(_is_value, row)) or len(row) > len(names):
        return {}, body
    units = {name: cell.strip("[]()") for name, cell in zip(names, row, strict=False) if cell}
    return units, body + 1


def _decimal(sample: Sequence[str], separator: str) -> str:
    """Return the decimal mark: a comma where numbers have it and hardly any has a point."""
    numbers = [cell for cell in sample if _NUMBER.fullmatch(cell)]
    commas, points = (sum(mark in cell for cell in numbers) for mark in ",.")
    return "," if separator != "," and commas > 10 * points else "."


def seconds(texts: Sequence[str | None]) -> list[float] | None:
    """Return dates, or times of day, in seconds, NaN for what is none; None unless nine of ten are some."""
    some = [text for text in texts[:SAMPLE] if text]
    for layout in ("", *DATES):
        if some and sum(_moment(text, layout) is not None for text in some) > 0.9 * len(some):
            moments = [_moment(text, layout) if text else None for text in texts]
            return [float("nan") if moment is None else moment for moment in moments]
    return None


def _moment(text: str, layout: str) -> float | None:
    """Return seconds since 1970, or of the day; by ISO 8601 where the layout is "".  None for another text."""
    text = text.strip()
    try:
        if not layout:
            moment = datetime.fromisoformat(text.replace(",", "."))
            return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        fraction = _FRACTION.search(text)
        seconds = datetime.strptime(_FRACTION.sub(r"\1", text), layout).replace(tzinfo=UTC)
        start = datetime(1900, 1, 1, tzinfo=UTC) if layout == DATES[-1] else datetime(1970, 1, 1, tzinfo=UTC)
        return (seconds - start).total_seconds() + (float(f"0.{fraction.group(2)}") if fraction else 0.0)
    except (ValueError, OverflowError):
        return None
