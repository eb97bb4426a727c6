"""What the line of an error calls a choice: an option on a command line, an argument in a program.

Lines are written with options, ``--from-hz 0.1: must be ...``.  Where no command runs, the call that raises one names
its own arguments instead.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar

from cosim.base.errors import FlightError, InputError

P = ParamSpec("P")
R = TypeVar("R")
_OTHER_NAMES = {  # of an option: the arguments that mean the same, where they are not called as it is
    "axis": ("axis", "axes"),
    "failsafe": ("kinds",),
    "filed-under": ("family",),
    "fit": ("fitted",),
    "for": ("autopilot", "inside"),
    "from": ("base",),
    "out": ("out", "folder", "page", "file"),
    "replay": ("replays",),
    "rtf": ("realtime_factor",),
    "sampling": ("design",),
    "schedule": ("scheduled",),
    "set": ("settings",),
    "time": ("time_column",),
    "to": ("to", "kind"),
    "wind-speed": ("winds",),
}
_EVERYWHERE = ("aircraft", "controller", "engine", "model", "vary")  # of some call, if not of the one that raises
# a command that is quoted stays as it is, to be typed into a shell; an option ends where its name does
_QUOTED_OR_OPTION = r"(?P<quoted>\bhexjet [a-z](?:[^;:(),]|[:,](?! ))*)|(?<![\w-])--(?P<option>[a-z][a-z-]*)"
_SUBJECT = r"(\w+) ([^\s=:,]+)(?=: )"  # an argument with its value, in front
# What a terminal obeys, or by which it writes from right to left; line ends and tabs are not among it.
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
_QUOTED = re.compile(r"(?<!\w)(['\"])(.*?)\1(?!\w)", re.DOTALL)  # a value, as messages echo it
# What is longer than a file's name can be is no part of a path, but a value that stands without quotes.
_LONG_WORD = re.compile(r"[^\s/]{256,}")
_options: ContextVar[tuple[str, ...] | None] = ContextVar("options", default=None)  # of the command that runs


@contextmanager
def at_command_line(options: Iterable[str]) -> Iterator[None]:
    """Let lines name options as long as a command with these runs."""
    before = _options.set(tuple(options))
    try:
        yield
    finally:
        _options.reset(before)


def printable(text: str) -> str:
    """Return a text with nothing in it that a terminal would obey; control characters stand as Python writes them."""
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], text)


def printable_line(text: str, max_echo: int = 80, max_line: int = 2000) -> str:
    """Return a message in one printable line of ``max_line`` characters, with ``max_echo`` of each value it quotes."""

    def shorten(found: re.Match[str]) -> str:
        value = found[2] if len(found[2]) <= max_echo else f"{found[2][:max_echo]}..."
        return f"{found[1]}{value}{found[1]}"

    line = _QUOTED.sub(shorten, printable(text).replace("\n", "\\n"))
    line = _LONG_WORD.sub(lambda found: f"{found[0][:max_echo]}...", line)
    return line if len(line) <= max_line else f"{line[:max_line]}..."


def option_of(argument: str) -> str | None:
    """Return the option of the running command that an argument is of; None where none runs, or none is it."""
    return next((each for each in _options.get() or () if argument in _arguments_of(each.lstrip("-"))), None)


def says_arguments(call: Callable[P, R]) -> Callable[P, R]:
    """Let a call that a program makes raise errors that name its arguments, and no options."""
    parameters: dict[str, Any] = {}
    name = call.__qualname__.removesuffix(".__init__").rpartition(".")[2]

    @functools.wraps(call)
    def speaking(*arguments: P.args, **named: P.kwargs) -> R:
        try:
            return call(*arguments, **named)
        except (InputError, FlightError) as error:
            if _options.get() is None and len(error.args) == 1 and "--" in str(error):
                import inspect  # not at start-up, of which it is a good part

                parameters.update(parameters or inspect.signature(call).parameters)
                error.args = (with_arguments(str(error), parameters, name),)
            raise

    return speaking


def with_arguments(text: str, parameters: Mapping[str, Any], name: str) -> str:
    """Return a line with the arguments of a call in the place of options; others, and quoted commands, stay."""
    is_subject = False

    def replaced(match: re.Match[str]) -> str:
        nonlocal is_subject
        if match["quoted"]:
            return match[0]
        argument = _argument(match["option"], parameters)
        is_subject |= argument is not None and match.start() == 0
        return argument or match[0]

    worded = re.sub(_QUOTED_OR_OPTION, replaced, text)
    if not is_subject:
        return worded
    return f"{name}: " + (re.sub(_SUBJECT, r"\1 = \2", worded, count=1) if re.match(_SUBJECT, worded) else worded)


def _argument(option: str, parameters: Mapping[str, Any]) -> str | None:
    """Return what an option is called among the parameters of a call, with its value where that is yes or no."""
    is_denied = option.startswith("no-")
    for argument in _arguments_of(option.removeprefix("no-")):
        if argument in parameters:
            is_flag = is_denied or parameters[argument].annotation in (bool, "bool")
            return f"{argument}={not is_denied}" if is_flag else argument
    return option if option in _EVERYWHERE else None


def _arguments_of(option: str) -> tuple[str, ...]:
    """Return what arguments of an option may be called."""
    name = option.replace("-", "_")
    return (*_OTHER_NAMES.get(option, ()), name, f"{name}_s", f"{name}_hz", f"{name}s", f"{name}_text")
