"""The command line: which command there is, how it ends, and what is said when it fails."""

from __future__ import annotations

import errno
import os
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from cosim.base.errors import RESOURCE_ERRNOS, STDOUT_NAME, FlightError, InputError, Notice, NotIdentifiedError, nearest
from cosim.base.trust import command_trust_scope
from cosim.base.wording import printable_line, spell
from cosim.cli import table
from cosim.cli.console import INTERRUPT_REPORTED, echo, format_help, note
from cosim.cli.trust import trust_prompt

DONE, FLIGHT_FAILED, WRONG_INPUT, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143  # last: 128 + number of the signal
SHELLS = ("bash", "zsh", "fish")
_ABOUT = "Co-simulation of the Hex-Jet: JSBSim airframe, FMU engines, predictor-based control."
_GLOBAL_OPTIONS = (
    ("--version", "Show the version and end."),
    (f"--install-completion [{'|'.join(SHELLS)}]", "Let a shell complete commands, options and names."),
    ("--help", "Show this and end; hexjet COMMAND --help tells a command's options, with an example."),
)


class Terminated(KeyboardInterrupt):
    """Raised on SIGTERM, by which batch systems and service managers ask a process to end."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command ``hexjet``: exits with 0, 1 (the flight failed) or 2 (wrong input, one line)."""
    # A character that the terminal's encoding lacks must not end a command.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    warnings.showwarning = _make_warning_printer(warnings.showwarning)
    words = sys.argv[1:] if arguments is None else arguments
    try:
        with treat_sigterm_as_interrupt(), command_trust_scope(trust_prompt(), words):
            status = run(words)
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:  # the reader of the output has ended
        _discard_output()
        status = DONE
    except (InputError, FlightError, OSError, MemoryError) as error:
        if isinstance(error, OSError) and error.errno not in (*RESOURCE_ERRNOS, errno.ENAMETOOLONG):
            raise
        message, status = _explain_error(error)
        _print_error(message)
    except KeyboardInterrupt as stop:
        if INTERRUPT_REPORTED not in getattr(stop, "__notes__", ()):
            _print_error("stopped; what was written before is kept")
        status = TERMINATED if isinstance(stop, Terminated) else INTERRUPTED
    sys.exit(status)


def run(words: list[str]) -> int:
    """Run the command that the words name and return its exit status.  Raises InputError."""
    if not words:
        echo(describe(), err=True)
        return WRONG_INPUT
    first, *others = words
    if first == "__complete":
        _make_completion_app()(words, exit_on_error=False)
    elif first in ("-h", "--help"):
        _note_taken_names()
        echo(describe())
    elif first == "--version":
        from importlib.metadata import version

        echo(f"hexjet, version {version('hexjet-cosim')}")
    elif first.partition("=")[0] == "--install-completion":
        _install_completion(first.partition("=")[2] or next(iter(others), ""))
    elif first.startswith("-"):
        raise InputError(f"No such option {first!r} (hexjet --help)")
    elif table.is_collection(first) and (not others or others[0] in ("-h", "--help")):
        echo(describe_collection(first), err=not others)
        return DONE if others else WRONG_INPUT
    else:
        name, rest = table.find(words)
        return table.load(name).run(rest)
    return DONE


def describe(width: int | None = None) -> str:
    """Return the help of all commands in groups, also of those that other packages add."""
    there = {name.partition(" ")[0] for name in table.list_names()} - table.HIDDEN
    sections = {
        title: [(name, line) for name, line in commands.items() if name in there]
        for title, commands in table.HELP_GROUPS.items()
    }
    sections[table.OTHERS_TITLE] = [(name, _headline(name)) for name in sorted(there - set(table.DESCRIPTIONS))]
    return format_help("hexjet [OPTIONS] COMMAND ...", _ABOUT, sections | {"Options": _GLOBAL_OPTIONS}, width=width)


def describe_collection(name: str, width: int | None = None) -> str:
    """Return the help of commands whose first word is ``name``."""
    rows = [(each.partition(" ")[2], _headline(each)) for each in table.list_names(name) if each not in table.HIDDEN]
    about = f"{(line := table.DESCRIPTIONS.get(name, name))[:1].upper()}{line[1:]}."
    if name in table.NATIVE:  # such as hexjet identify
        return f"{table.load(name).help(width)}\n\n{format_help(f'hexjet {name} COMMAND ...', '', {'Commands': rows})}"
    return format_help(f"hexjet {name} COMMAND ...", about, {"Commands": rows}, width=width)


def _headline(name: str) -> str:
    """Return the first sentence of a command's help, or why the command cannot be loaded."""
    try:
        return table.load(name).texts[0].partition("\n")[0]
    except InputError as error:
        return f"Not here: {str(error).partition(': ')[2]}."


def _note_taken_names() -> None:
    """Print a note on each command of another package whose name is already taken."""
    for name, entries in table.added().items():
        if name in table.NATIVE or name in {each.partition(" ")[0] for each in table.NATIVE}:
            package = entries[0].dist.name if entries[0].dist else "an installed package"
            note(f"{name} of {package} is not reached: hexjet has that command")


def _make_completion_app() -> Any:
    """Return an app of all commands with their options, for a shell's completion."""
    from cyclopts import App

    root = App(name="hexjet", version_flags=[])
    for name in table.list_names():
        first, _, second = name.partition(" ")
        try:
            command = table.load(name)
        except InputError:
            continue
        app = command.app(with_help=True)
        if not second:
            root.command(app, name=first)
        else:
            if first not in root:
                root.command(App(name=first, version_flags=[]))
            root[first].command(app, name=second)
    return root


def _install_completion(shell: str) -> None:
    """Write the completion script of a shell, and print its path."""
    if shell not in SHELLS:
        raise InputError(f"--install-completion: {shell!r}: {nearest(shell, SHELLS)}")
    path: Path = _make_completion_app().install_completion(shell=shell, add_to_startup=False)
    echo(f"{path}: a new {shell} completes hexjet")


@contextmanager
def treat_sigterm_as_interrupt() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGTERM and SIGHUP, unless ignored (nohup), so that they act as Ctrl-C does."""

    def raise_terminated(number: int, frame: object) -> None:
        raise Terminated

    handlers = {}
    # Only the main thread may set signal handlers.
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):  # Windows has no SIGHUP
            if signal.getsignal(number) is not signal.SIG_IGN:
                handlers[number] = signal.signal(number, raise_terminated)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _explain_error(error: InputError | FlightError | OSError | MemoryError) -> tuple[str, int]:
    """Return the message of an error that ends a command, and the exit status."""
    if isinstance(error, InputError):
        return str(error), FLIGHT_FAILED if isinstance(error, NotIdentifiedError) else WRONG_INPUT
    if isinstance(error, MemoryError):
        return "the memory that this process may have is used up", FLIGHT_FAILED
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        return f"{error.filename}: is longer than a file's name can be", WRONG_INPUT
    return (_describe_os_error(error) if isinstance(error, OSError) else str(error)), FLIGHT_FAILED


def _describe_os_error(error: OSError) -> str:
    """Describe an error of the system, such as a full disk; discard output that could not be written."""
    if error.filename != STDOUT_NAME:
        return f"{error.strerror}; temporary files are in {tempfile.gettempdir()}"
    _discard_output()
    return f"{STDOUT_NAME}: {error.strerror}"


def _discard_output() -> None:
    """Redirect standard output to the null device, because Python's flush at exit would fail."""
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, sys.stdout.fileno())
    os.close(nothing)


def _make_warning_printer(show_other: Callable[..., None]) -> Callable[..., None]:
    """Return a ``showwarning`` that prints a :class:`Notice` in one line, and any other warning by ``show_other``."""

    def show_warning(message: Warning | str, category: type[Warning], *where: Any, **options: Any) -> None:
        if issubclass(category, Notice):
            note(str(message))
        else:
            show_other(message, category, *where, **options)

    return show_warning


def _print_error(message: str) -> None:
    echo(f"hexjet: {printable_line(spell(message))}", err=True)
