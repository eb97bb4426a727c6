"""What calls give back: a hearer of their progress, and a result that shows itself."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

from cosim.base.errors import InputError, notify


class Progress:
    """Receiver of a call's progress; subclasses display it, this one issues notes as warnings."""

    def begin(self, folder: Path) -> None:
        """Report the folder for all results, before the first flight."""

    def note(self, text: str) -> None:
        """Report, in one line, an input that is ignored or reinterpreted.

        It becomes a warning, ``cosim.base.errors.Notice``.
        """
        notify(text)

    def update(self, part: str, done: int, of: int) -> None:
        """Report that ``done`` of ``of`` parts are finished; ``of`` is 0 if their number is unknown.

        ``part``: what is being done, or what became of the flights so far.
        """


class WholeLine(str):
    """A line of a result that terminals must not wrap, so that it can be copied: command, path or note."""


def note_lines(notes: Iterable[str]) -> list[str]:
    """Return notes as lines ``note: ...`` of a result."""
    return [WholeLine(f"note: {note}") for note in notes]


class Table(NamedTuple):
    """Table of a result: title, column heads and cells, all as texts.

    >>> show("edf").tables()[0].columns
    ('number', 'value', 'unit', 'meaning')
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


class Result:
    """Result of a call of the API: files, sentences, tables and a verdict.

    A notebook shows it with its tables; ``print`` gives its lines.

    Attributes
    ----------
    files : dict of str to Path
        What was written, by kind; ``report`` is the page.  Empty where nothing was.
    """

    files: dict[str, Path]
    # Lines that the command prints without ``--verbose`` where it has more than a screen; None: all of them.
    short_lines: ClassVar[int | None] = None
    # Tables that it prints then.
    short_tables: ClassVar[int] = 0

    def to_dict(self) -> dict[str, Any]:
        """Return the result in SI units as data for JSON, as ``hexjet ... --json`` prints it."""
        raise NotImplementedError

    @property
    def folder(self) -> Path | None:
        """The folder with the files, or None if none were written."""
        return next((path.parent for path in self.files.values()), None)

    @property
    def report(self) -> Path | None:
        """The HTML page, or None if none was written."""
        return self.files.get("report")

    def lines(self) -> list[str]:
        """Return the result in sentences, one per line, the most important first."""
        raise NotImplementedError

    def tables(self) -> list[Table]:
        """Return the tables of the result, whose cells are texts."""
        return []

    @property
    def verdict(self) -> str:
        return next(iter(self.lines()), "")

    def table(self) -> Any:
        """Return the first table as a ``pandas.DataFrame`` of texts; a sweep returns its flights, one per row.

        Raises
        ------
        InputError
            Where it has no table, or pandas is not installed.
        """
        from cosim.results.log.tables import make_table

        if not (tables := self.tables()):
            raise InputError(f"table: {type(self).__name__} has none")
        return make_table({name: [row[at] for row in tables[0].rows] for at, name in enumerate(tables[0].columns)})

    def figures(self) -> Mapping[str, Any]:
        """Return the figures of the page by name, a ``plotly.graph_objects.Figure`` each.

        Raises
        ------
        InputError
            Where Plotly is not installed.
        """
        from cosim.results.report.page import as_plotly

        return {name: as_plotly(figure) for name, figure in self._figures().items()}

    def _figures(self) -> Mapping[str, Any]:
        """Return the figures in Plotly's schema."""
        return {}

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def __repr__(self) -> str:
        where = "" if self.folder is None else f", {self.folder}"
        return f"<{type(self).__name__}: {self.verdict}{where}>"

    def _repr_html_(self) -> str:
        """Return lines, tables and the page's path as HTML for notebooks."""
        from html import escape

        first, *others = self.lines() or [""]
        parts = [f"<p><b>{escape(first)}</b></p>"]
        parts += [f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in others)}</ul>"] if others else []
        for table in self.tables():
            parts += [f"<p>{escape(table.title)}</p>"] if table.title else []
            head = "".join(f"<th>{escape(title)}</th>" for title in table.columns)
            rows = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in table.rows)
            parts.append(f"<table><tr>{head}</tr>{rows}</table>")
        if self.report is not None:
            parts.append(f'<p>report: <a href="{escape(self.report.as_posix())}">{escape(str(self.report))}</a></p>')
        return "".join(parts)


class FolderResult(Result):
    """Result of a call whose files are in one folder."""

    def write(self, folder: Path | str) -> Self:
        """Write the result's files into a folder and return this result with their paths.

        Parameters
        ----------
        folder : Path or str
            Made if need be.

        Raises
        ------
        InputError or FlightError
            If a file cannot be written; of an identification the first for somebody else's files of these names.
        """
        self.files = self._write(Path(folder))
        return self

    def _write(self, folder: Path) -> dict[str, Path]:
        """Write the files and return them by kind."""
        raise NotImplementedError
