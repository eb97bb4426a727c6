"""The terminal: tables, progress, and standard output kept clean for JSON."""

from __future__ import annotations

import re
import sys
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from shutil import get_terminal_size
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Self

from cosim.api.call import Progress, Result, WholeLine
from cosim.base.wording import printable, printable_line, spell

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

_bars: list[Bar] = []  # progress bars on the terminal now


@contextmanager
def hide_progress_bars() -> Iterator[None]:
    """Hide progress bars meanwhile: they draw over other output and read its brackets as markup."""
    stopped = list(_bars)
    for bar in stopped:
        bar.stop()
    try:
        yield
    finally:
        for bar in stopped:
            bar.start()


@contextmanager
def output_to_stderr(active: bool) -> Iterator[None]:
    """Redirect what FMUs and libraries print to standard error, so that standard output has nothing but JSON."""
    if not active:
        yield
        return
    import ctypes
    import os

    sys.stdout.flush()
    saved = os.dup(1)
    os.dup2(2, 1)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        sys.stdout.flush()  # output of Python code
        ctypes.CDLL(None).fflush(None)  # buffered output of C code
        os.dup2(saved, 1)
        os.close(saved)


class TerminalProgress(Progress):
    """Shows a call's progress on a terminal: notes on standard error, and a bar with the remaining time.

    ``notes`` is what notes are called; empty: none is printed.  Ctrl-C is answered in a line; ``goes_on`` is the
    command that goes on, ``{folder}`` that of the call.
    """

    def __init__(self, quiet: bool, goes_on: str = "", notes: str = "note") -> None:
        self._notes = notes
        self._is_shown = not quiet and sys.stderr is not None and sys.stderr.isatty()
        self._goes_on = goes_on
        self._bar: Bar | None = None
        self._folder: Path | None = None
        self._done = self._of = 0
        self._is_concluding = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        if self._bar is not None:
            self._bar.stop()
            _bars.remove(self._bar)
        if isinstance(error, KeyboardInterrupt) and self._goes_on:
            error.add_note(INTERRUPT_REPORTED)
            echo(f"hexjet: stopped{self._describe_kept_flights()}", err=True)

    def _describe_kept_flights(self) -> str:
        if not self._done and not self._of:
            return " before the first flight"
        flown = f"{self._done} of {self._of}" if self._of else f"{self._done}"
        kept = "what was flown is kept" if self._is_concluding else f"{flown} flights are kept"
        return f"; {kept}: {self._goes_on.format(folder=self._folder)} goes on"

    def begin(self, folder: Path) -> None:
        self._folder = folder

    def note(self, text: str) -> None:
        """Print a note on standard error."""
        if self._notes:
            with hide_progress_bars():
                echo(f"hexjet: {self._notes}: {printable_line(spell(text))}", err=True)

    def update(self, part: str, done: int, of: int) -> None:
        self._is_concluding = done == of == 0
        if not self._is_concluding:
            self._done, self._of = done, of
        if self._is_shown:
            bar = self._bar = self._bar or self._start_bar()
            bar.update(bar.task_ids[0], description=printable(part), completed=done, total=of or None)

    def _start_bar(self) -> Bar:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        # A bar is refreshed rarely, to leave the processor to the flights.
        bar = Bar(*columns, console=Console(stderr=True), transient=True, refresh_per_second=2)
        bar.add_task("")
        bar.start()
        _bars.append(bar)
        return bar


INTERRUPT_REPORTED = "told"  # exception's note: already printed


def show_result(result: Result, verbose: bool = False, screen: int = 24) -> None:
    """Print a result: its lines, its tables, and the paths of its files.

    Without ``verbose``, what has a page and is longer than a ``screen`` of lines is printed in short: as many tables
    and lines as the result says.
    """
    from rich.markup import escape

    lines, tables = result.lines() or [""], result.tables()
    height = len(lines) + len(result.files) + sum(len(table.rows) + 4 for table in tables)
    if not verbose and height > screen and result.report is not None:
        more = len(lines[result.short_lines :]) if result.short_lines else 0
        lines = [*lines[: result.short_lines], *([f"{more} more lines with --verbose"] if more else [])]
        tables = tables[: result.short_tables]
    first, *others = lines
    say(f"[bold]{escape(spell(first))}[/bold]", marked=True)
    for line in others:
        say(spell(line), wrap=not isinstance(line, WholeLine))
    for table in tables:
        if table.title:
            say(table.title)
        right = [n for n in range(len(table.columns)) if _is_numeric([row[n] for row in table.rows if n < len(row)])]
        show_table(table.columns, table.rows, right, plain=True, pad_edge=False)
    for kind, path in sorted(result.files.items(), key=lambda each: each[0] == "report"):
        say(f"{kind}: {path}", wrap=False)


def _is_numeric(cells: Sequence[str]) -> bool:
    """Return whether all cells of a column that are not empty are numbers."""
    return all(re.match(r"[-+<>]?\s*\.?\d", cell) for cell in cells if cell.strip("- "))


def echo(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print a text with control characters escaped; ``err``: on standard error."""
    print(printable(text), file=sys.stderr if err else sys.stdout, end="\n" if nl else "", flush=True)


def note(text: str) -> None:
    """Print a note on standard error."""
    echo(f"hexjet: note: {printable_line(spell(text))}", err=True)


def say(text: str, *, wrap: bool = True, marked: bool = False) -> None:
    """Print a line, wrapped at the terminal's width unless ``wrap`` is off; ``marked``: it has rich's markup."""
    terminal().print(text, highlight=False, markup=marked, soft_wrap=not wrap)


def show_table(
    titles: Sequence[str],
    rows: Iterable[Sequence[str]],
    right: Container[int] = (),
    *,
    plain: bool = False,
    name_width: int | None = None,
    **table_options: Any,
) -> None:
    """Print a table, or nothing if it has no rows.

    Parameters
    ----------
    titles, rows
        Texts of the headings and of each row's cells; rich's markup counts in them.
    right
        Columns that are aligned to the right, counted from 0.
    plain
        Brackets are no markup, numbers have no colour, and long words are folded, but for names in the first column.
    name_width
        The least width of the first column.
    **table_options
        Of rich's ``Table``.
    """
    from rich import box
    from rich.table import Table

    table, room = Table(box=box.SIMPLE_HEAD, **table_options), 56  # columns that the other cells need
    # A name, such as a key, is broken behind its dots alone.
    rows = [(_break_name(row[0], terminal().width - room), *row[1:]) for row in rows] if plain else rows
    for number, title in enumerate(titles):
        table.add_column(
            title,
            justify="right" if number in right else "left",
            overflow="fold" if plain else "ellipsis",
            min_width=None if number else name_width,
            no_wrap=plain and not number,
        )
    for row in rows:
        table.add_row(*row)
    if table.row_count:
        terminal().print(table, **({"highlight": False, "markup": False} if plain else {}))


def _break_name(text: str, most: int) -> str:
    """Return a text in lines of at most ``most`` letters, broken behind dots and blanks alone."""
    lines = [""]
    for part in re.split(r"(?<=[. ])", text):
        if lines[-1] and len(lines[-1]) + len(part.rstrip()) > most:
            lines.append("")
        lines[-1] += part
    return "\n".join(line.rstrip() for line in lines)


def format_help(
    usage: str, about: str, sections: Mapping[str, Sequence[tuple[str, str]]], example: str = "",
    width: int | None = None,
) -> str:  # fmt: skip
    """Return a help text: usage, description, sections of names with meanings, example; None: terminal's width."""
    wide = width or min(get_terminal_size((80, 24)).columns, 110)
    lines = [*wrap(f"Usage: {usage}", wide, subsequent_indent="  "), ""]
    for paragraph in about.split("\n\n"):
        lines += [*wrap(paragraph, wide, initial_indent="  ", subsequent_indent="  "), ""]
    for title, rows in sections.items():
        if not rows:
            continue
        column = min(max(len(name) for name, _ in rows), 26) + 4
        lines.append(f"{title}:")
        for name, meaning in rows:
            text = wrap(meaning, max(wide - column, 20), break_long_words=False, break_on_hyphens=False) or [""]
            head = f"  {name:{column - 2}}"
            lines += [f"  {name}"] if len(name) > column - 4 else [(head + text.pop(0)).rstrip()]
            lines += [" " * column + line for line in text]
        lines.append("")
    return "\n".join([*lines, *([f"Example:\n  {example}"] if example else [])]).rstrip()


def terminal() -> Any:
    """Return the console that prints tables, as wide as COLUMNS states, else as the terminal."""
    import os
    from io import StringIO

    from rich.console import Console as Rich

    class PlainConsole(Rich):
        """Console that leaves a broken pipe to the caller, and escapes control characters."""

        def on_broken_pipe(self) -> None:
            raise

        def render_str(self, text: str, **how: Any) -> Any:
            """Render a text, which may come from a file, with control characters escaped."""
            return super().render_str(printable(text), **how)

    pipe_width = 120  # columns, unless COLUMNS states them
    if sys.stdout is None:  # closed by the parent process
        return PlainConsole(file=StringIO(), width=pipe_width, emoji=False)
    columns = os.environ.get("COLUMNS", "")
    if columns.isdigit():
        return PlainConsole(width=max(int(columns), 20), emoji=False)
    return PlainConsole(emoji=False) if sys.stdout.isatty() else PlainConsole(width=pipe_width, emoji=False)
