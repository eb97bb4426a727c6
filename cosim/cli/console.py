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
from cosim.base.wording import printable, printable_line

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

_bars: list[Bar] = []  # on the terminal now


@contextmanager
def without_bars() -> Iterator[None]:
    """Take bars off the terminal meanwhile: they draw over what is written, and take its brackets for markup."""
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
    """Send what an FMU or a library prints to standard error, while a flight must leave standard output alone."""
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
    """Shows a call on a terminal: notes on standard error, and a bar of how far it is and how long the rest takes.

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
            error.add_note(REPORTED)
            echo(f"hexjet: stopped{self._describe_kept()}", err=True)

    def _describe_kept(self) -> str:
        if not self._done and not self._of:
            return " before the first flight"
        flown = f"{self._done} of {self._of}" if self._of else f"{self._done}"
        kept = "what was flown is kept" if self._is_concluding else f"{flown} flights are kept"
        return f"; {kept}: {self._goes_on.format(folder=self._folder)} goes on"

    def begin(self, folder: Path) -> None:
        """Keep the folder."""
        self._folder = folder

    def note(self, text: str) -> None:
        """Print it on standard error."""
        if self._notes:
            with without_bars():
                echo(f"hexjet: {self._notes}: {printable_line(text)}", err=True)

    def update(self, part: str, done: int, of: int) -> None:
        """Show how far the call is."""
        self._is_concluding = done == of == 0
        if not self._is_concluding:
            self._done, self._of = done, of
        if self._is_shown:
            bar = self._bar = self._bar or self._start()
            bar.update(bar.task_ids[0], description=printable(part), completed=done, total=of or None)

    def _start(self) -> Bar:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        # The processor is for the flights.
        bar = Bar(*columns, console=Console(stderr=True), transient=True, refresh_per_second=2)
        bar.add_task("")
        bar.start()
        _bars.append(bar)
        return bar


REPORTED = "told"  # note of an interruption


def show_result(result: Result, verbose: bool = False, screen: int = 24) -> None:
    """Print a result: its lines, its tables, and where its files are.

    Without ``verbose``, what has a page and is longer than a ``screen`` of lines is printed in short: no tables, and
    no more lines than the result says.
    """
    from rich.markup import escape

    lines, tables = result.lines() or [""], result.tables()
    height = len(lines) + len(result.files) + sum(len(table.rows) + 4 for table in tables)
    if not verbose and height > screen and result.report is not None:
        more = len(lines[result.short_lines :]) if result.short_lines else 0
        lines, tables = [*lines[: result.short_lines], *([f"{more} more lines with --verbose"] if more else [])], []
    first, *others = lines
    say(f"[bold]{escape(first)}[/bold]", marked=True)
    for line in others:
        say(line, wrap=not isinstance(line, WholeLine))
    for table in tables:
        if table.title:
            say(table.title)
        right = [n for n in range(len(table.columns)) if _is_numeric([row[n] for row in table.rows if n < len(row)])]
        show_table(table.columns, table.rows, right, plain=True, pad_edge=False)
    for kind, path in sorted(result.files.items(), key=lambda each: each[0] == "report"):
        say(f"{kind}: {path}", wrap=False)


def _is_numeric(cells: Sequence[str]) -> bool:
    """Whether the cells of a column are numbers, so far as they have anything in them."""
    return all(re.match(r"[-+<>]?\s*\.?\d", cell) for cell in cells if cell.strip("- "))


def echo(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print a text as it is, but for control characters; ``err``: on standard error."""
    print(printable(text), file=sys.stderr if err else sys.stdout, end="\n" if nl else "", flush=True)


def note(text: str) -> None:
    """Print a note on standard error."""
    echo(f"hexjet: note: {printable_line(text)}", err=True)


def say(text: str, *, wrap: bool = True, marked: bool = False) -> None:
    """Print a line, broken at the terminal's width unless ``wrap`` is off; ``marked``: with rich's markup in it."""
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
    """Print a table, nothing where it has no rows.

    Parameters
    ----------
    titles, rows
        Texts of the headings and of each row's cells; rich's markup counts in them.
    right
        Columns that stand to the right, counted from 0.
    plain
        Brackets are no markup, numbers have no colour, and long words are folded.
    name_width
        The least width of the first column.
    **looks
        Of rich's ``Table``.
    """
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, **table_options)
    for number, title in enumerate(titles):
        table.add_column(
            title,
            justify="right" if number in right else "left",
            overflow="fold" if plain else "ellipsis",
            min_width=None if number else name_width,
        )
    for row in rows:
        table.add_row(*row)
    if table.row_count:
        terminal().print(table, **({"highlight": False, "markup": False} if plain else {}))


def lay_out(
    usage: str, about: str, sections: Mapping[str, Sequence[tuple[str, str]]], example: str = "",
    width: int | None = None,
) -> str:  # fmt: skip
    """Return a help: usage, text, sections of names with meanings, example; ``width``: else the terminal's."""
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
    """Return where tables go: as wide as the terminal, or as COLUMNS says, also in a pipe."""
    import os
    from io import StringIO

    from rich.console import Console as Rich

    class Console(Rich):
        """Whoever read the output may go before its end: no failure, and what rich makes of it is one."""

        def on_broken_pipe(self) -> None:
            raise

        def render_str(self, text: str, **how: Any) -> Any:
            """Make what is printed of a text, which a file may state, without its control characters."""
            return super().render_str(printable(text), **how)

    pipe_width = 120  # where COLUMNS states none
    if sys.stdout is None:  # closed by whoever started this
        return Console(file=StringIO(), width=pipe_width, emoji=False)
    columns = os.environ.get("COLUMNS", "")
    if columns.isdigit():
        return Console(width=max(int(columns), 20), emoji=False)
    return Console(emoji=False) if sys.stdout.isatty() else Console(width=pipe_width, emoji=False)
