"""The terminal: tables, progress, and standard output kept clean for JSON."""

from __future__ import annotations

import sys
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cosim.api.call import Progress
from cosim.base.wording import printable, printable_line

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

_PIPE_WIDTH = 120  # in a pipe there is no width to fit, unless COLUMNS states one
_NARROWEST = 20
_bars: list[Bar] = []  # on the terminal now


@contextmanager
def on_terminal(bar: Bar) -> Iterator[Bar]:
    """Show a bar, which gives way to questions (:func:`without_bars`)."""
    with bar:
        _bars.append(bar)
        try:
            yield bar
        finally:
            _bars.remove(bar)


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
        yield
    finally:
        sys.stdout.flush()  # output of Python code
        ctypes.CDLL(None).fflush(None)  # buffered output of C code
        os.dup2(saved, 1)
        os.close(saved)


@contextmanager
def part_progress(title: str, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """Give a function that is told the part that is done, how many are, and of how many; shown on a terminal."""
    if quiet or not sys.stderr.isatty():
        yield lambda part, done, of: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with on_terminal(Bar(*columns, console=Console(stderr=True), transient=True)) as progress:
        task = progress.add_task(title, total=None)
        yield lambda part, done, of: progress.update(task, description=printable(part), completed=done, total=of)


class CommandProgress(Progress):
    """What a command shows of a call: notes on standard error, and how far it is with ``show``."""

    def __init__(self, show: Callable[[str, int, int], None] = lambda part, done, of: None) -> None:
        self._show = show
        self.folder = Path()
        self.done = self.of = 0
        self.is_concluding = False  # no flights are counted any more

    def begin(self, folder: Path) -> None:
        """Keep the folder."""
        self.folder = folder

    def note(self, text: str) -> None:
        """Print it on standard error."""
        note(text)

    def update(self, part: str, done: int, of: int) -> None:
        """Show it, and keep how far it is."""
        self.is_concluding = done == of == 0
        if not self.is_concluding:
            self.done, self.of = done, of
        self._show(part, done, of)


def echo(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print a text as it is, but for control characters; ``err``: on standard error."""
    click.echo(printable(text), err=err, nl=nl)


def note(text: str) -> None:
    """Print a note on standard error."""
    click.echo(f"hexjet: note: {printable_line(text)}", err=True)


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

    if sys.stdout is None:  # closed by whoever started this
        return Console(file=StringIO(), width=_PIPE_WIDTH, emoji=False)
    columns = os.environ.get("COLUMNS", "")
    if columns.isdigit():
        return Console(width=max(int(columns), _NARROWEST), emoji=False)
    return Console(emoji=False) if sys.stdout.isatty() else Console(width=_PIPE_WIDTH, emoji=False)
