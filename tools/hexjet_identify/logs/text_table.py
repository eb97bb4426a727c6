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

# In order of preference: a comma may be a decimal mark.
SEPARATORS = (";", "\t", "|", ",")
SAMPLE_LINES = 200  # lines looked at
# The sampled lines, and all before them, lie within this size [characters].
MAX_SAMPLE_SIZE = 2**18
# Minimum share of lines with the most frequent number of cells.
MIN_REGULAR_SHARE = 0.5
BOMS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
DATES = ("%d.%m.%Y %H:%M:%S", "%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S", "%H:%M:%S")
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_MISSING_MARKS = ("", "nan", "-nan", "inf", "-inf", "+inf", "null", "none", "n/a", "na", "-")
_DATE = re.compile(r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}([ T].*)?|\d{1,2}:\d{2}:\d{2}.*")
_SECOND_FRACTION = re.compile(r"(:\d{2})[.,](\d+)")
_CONTROL_CHARACTERS = re.compile(r"[\x00-\x08\x0e-\x1f]")


class TextTable(NamedTuple):
    """Rows of a table as UTF-8 without the head, with names, units, separator and decimal mark."""

    rows: bytes
    names: tuple[str, ...]
    units: dict[str, str]
    separator: str
    decimal: str
    remarks: tuple[str, ...]


def decode(data: bytes) -> tuple[str, str] | None:
    """Return a file's text and its encoding; None if it is no text."""
    for mark, codec in BOMS:
        if data.startswith(mark):
            text = data[len(mark) :].decode(codec, "replace")
            break
    else:
        try:
            text, codec = data.decode("utf-8"), "utf-8"
        except UnicodeDecodeError:
            text, codec = data.decode("cp1252", "replace"), "cp1252"
    return None if len(_CONTROL_CHARACTERS.findall(text[:4096])) > 0.01 * min(len(text), 4096) else (text, codec)


def read_text(path: Path) -> TextTable:
    """Read a table of text.  Raises InputError for a file that is none."""
    decoding = decode(path.read_bytes())
    if decoding is None:
        raise InputError(f"{path}: neither a log that is known nor text: it holds bytes that no table has")
    text, codec = decoding
    remarks = [] if codec == "utf-8" else [f"read as {codec}"]
    if "\n" not in text[:MAX_SAMPLE_SIZE]:
        text = text.replace("\r", "\n")
    lines = [
        line.rstrip("\r") for line in text[:MAX_SAMPLE_SIZE].split("\n")[: -1 if len(text) > MAX_SAMPLE_SIZE else None]
    ]
    first = next((n for n, line in enumerate(lines) if line.strip()), len(lines))
    separator_line = re.fullmatch(r'"?sep=(.)"?', lines[first].strip()) if first < len(lines) else None
    first += separator_line is not None
    full = [line for line in lines[first:] if line.strip()]
    if not full or (len(full) == 1 and any(mark in full[0] for mark in SEPARATORS) and not _NUMBER.search(full[0])):
        raise InputError(f"{path}: the table has no rows")
    separator, width = _find_separator(
        lines[first : first + SAMPLE_LINES], separator_line.group(1) if separator_line else ""
    )
    if not separator:
        raise InputError(f"{path}: neither a log that is known nor a table: no separator cuts its lines alike")
    head, names = _find_names(lines, first, separator, width)
    if doubled := [name for name in names if name and names.count(name) > 1]:
        raise InputError(f"{path}: two columns are called {doubled[0]!r}")
    units, body = _find_units(lines, head, separator, names)
    decimal = _find_decimal_mark(
        [cell for line in lines[body : body + SAMPLE_LINES] for cell in split_cells(line, separator)], separator
    )
    if head > first:
        remarks.append(f"{head - first} lines before the head of the table are passed over")
    rows = text.split("\n", body)[body] if body < len(lines) else ""
    if separator == " ":
        separator, rows = "\t", "\n".join("\t".join(line.split()) for line in rows.split("\n"))
    return TextTable(rows.encode(), names, units, separator, decimal, tuple(remarks))


def split_cells(line: str, separator: str) -> list[str]:
    """Return the cells of a line, without blanks around them."""
    if separator == " ":
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error:
        return [cell.strip() for cell in line.split(separator)]


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, with a point or a comma, or a mark of a missing one."""
    return bool(_NUMBER.fullmatch(cell)) or cell.lower() in _MISSING_MARKS


def _is_value(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell) or _DATE.fullmatch(cell))


def _find_separator(lines: Sequence[str], nominal: str) -> tuple[str, int]:
    """Return the separator and the number of cells in a line; "" if none splits the lines alike."""
    best, chosen = 0.0, ("", 0)
    for separator in (nominal,) if nominal else (*SEPARATORS, " "):
        rows = [split_cells(line, separator) for line in lines if line.strip()]
        width, count = Counter(map(len, rows)).most_common(1)[0]
        full_cells = [cell for row in rows if len(row) == width for cell in row]
        score = count / len(rows) * sum(map(_is_value, full_cells)) / max(len(full_cells), 1)
        if width > 1 and count > MIN_REGULAR_SHARE * len(rows) and score > best + 1e-9:
            best, chosen = score, (separator, width)
    alone = [line.strip() for line in lines if line.strip()]
    if not chosen[0] and sum(map(_is_value, alone)) > MIN_REGULAR_SHARE * len(alone):
        return SEPARATORS[-1], 1
    return chosen


def _find_names(lines: Sequence[str], first: int, separator: str, width: int) -> tuple[int, tuple[str, ...]]:
    """Return the number of the line with the names, and the names; without names the line before the rows."""
    at = next(n for n in range(first, len(lines)) if len(split_cells(lines[n], separator)) == width)
    row = split_cells(lines[at].lstrip("#% "), separator)
    if not any(map(_is_value, row)):
        return at, tuple(row)
    above = next((n for n in range(at - 1, first - 1, -1) if lines[n].strip()), -1)
    title = split_cells(lines[above].lstrip("#% "), separator) if above >= 0 else []
    # The head may be a comment, lack the cell behind a last separator, or have more cells than the rows.
    if len(title) >= width - 1 and not any(map(_is_value, title)):
        return above, tuple([*title, ""][:width])
    return at - 1, tuple(f"column_{n}" for n in range(1, width + 1))


def _find_units(lines: Sequence[str], head: int, separator: str, names: Sequence[str]) -> tuple[dict[str, str], int]:
    """Return the units by name from a line below the names, if there is one, and where the rows begin."""
    body = next((n for n in range(head + 1, len(lines)) if lines[n].strip()), len(lines))
    row = split_cells(lines[body], separator) if body < len(lines) else []
    if head < 0 or not any(row) or any(map(_is_value, row)) or len(row) > len(names):
        return {}, body
    units = {name: cell.strip("[]()") for name, cell in zip(names, row, strict=False) if cell}
    return units, body + 1


def _find_decimal_mark(sample: Sequence[str], separator: str) -> str:
    """Return the decimal mark: a comma where numbers have it and hardly any has a point."""
    numbers = [cell for cell in sample if _NUMBER.fullmatch(cell)]
    commas, points = (sum(mark in cell for cell in numbers) for mark in ",.")
    return "," if separator != "," and commas > 10 * points else "."


def parse_dates(texts: Sequence[str | None]) -> list[float] | None:
    """Return dates or times of day in seconds, NaN for other texts; None unless nine of ten are dates."""
    some = [text for text in texts[:SAMPLE_LINES] if text]
    for layout in ("", *DATES):
        if some and sum(_parse_date(text, layout) is not None for text in some) > 0.9 * len(some):
            moments = [_parse_date(text, layout) if text else None for text in texts]
            return [float("nan") if moment is None else moment for moment in moments]
    return None


def _parse_date(text: str, layout: str) -> float | None:
    """Return seconds since 1970 or of the day; ``layout`` "" is ISO 8601.  None for another text."""
    text = text.strip()
    try:
        if not layout:
            moment = datetime.fromisoformat(text.replace(",", "."))
            return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        fraction = _SECOND_FRACTION.search(text)
        since_epoch = datetime.strptime(_SECOND_FRACTION.sub(r"\1", text), layout).replace(tzinfo=UTC)
        start = datetime(1900, 1, 1, tzinfo=UTC) if layout == DATES[-1] else datetime(1970, 1, 1, tzinfo=UTC)
        return (since_epoch - start).total_seconds() + (float(f"0.{fraction.group(2)}") if fraction else 0.0)
    except (ValueError, OverflowError):
        return None
