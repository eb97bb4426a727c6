"""Options of commands: how one is declared as a field of a command's record, and those that several commands have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from json import dumps
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast, overload

import click

from cosim.base.errors import nearest
from cosim.cli.console import echo

T = TypeVar("T")


class Number(click.FloatRange):
    """A finite number; click lets NaN through any range."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = float(super().convert(value, param, ctx))
        if not isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number

    def _describe_range(self) -> str:
        """Return the range for the help; click says ``x<=None`` of a number that has no bounds."""
        return "" if self.min is None and self.max is None else super()._describe_range()


class Choice(click.Choice[str]):
    """One of the texts that are allowed; another is answered with the nearest, as everywhere else."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if value not in self.choices:
            self.fail(f"{value!r}: {nearest(str(value), self.choices)}", param, ctx)
        return super().convert(value, param, ctx)


class Option(NamedTuple):
    """An option or an argument of a command, before the command has its record (:func:`takes`)."""

    declare: Callable[..., Callable[[Any], Any]]  # click.option or click.argument
    names: tuple[str, ...]
    attributes: dict[str, Any]


def option(*names: str, **attributes: Any) -> Any:
    """Declare a field of a record as an option; ``attributes`` as of ``click.option``."""
    return Option(click.option, names, attributes)


def flag(name: str, text: str) -> bool:
    """Declare an option without a value."""
    return cast(bool, option(name, is_flag=True, help=text))


def words(name: str, metavar: str | None, text: str) -> tuple[str, ...]:
    """Declare an option that may be given several times."""
    return cast("tuple[str, ...]", option(name, metavar=metavar, multiple=True, help=text))


@overload
def word(name: str, metavar: str | None, text: str) -> str | None: ...
@overload
def word(name: str, metavar: str | None, text: str, default: str) -> str: ...
def word(name: str, metavar: str | None, text: str, default: str | None = None) -> Any:
    """Declare an option that is a text; its help ends with the default."""
    return option(name, metavar=metavar, help=text, default=default, show_default=default is not None)


def choice(name: str, allowed: Sequence[str], text: str, default: str | None = None) -> Any:
    """Declare an option that is one of the texts that are allowed."""
    return option(name, type=Choice(allowed), help=text, default=default, show_default=default is not None)


def path(name: str, metavar: str | None, text: str, **limits: Any) -> Path | None:
    """Declare an option that is a path; ``limits`` as of ``click.Path``."""
    return cast("Path | None", option(name, type=click.Path(path_type=Path, **limits), metavar=metavar, help=text))


@overload
def number(name: str, metavar: str | None, text: str, *, default: float, **limits: float) -> float: ...
@overload
def number(name: str, metavar: str | None, text: str, **limits: float) -> float | None: ...
def number(name: str, metavar: str | None, text: str, *, default: float | None = None, **limits: Any) -> Any:
    """Declare an option that is a finite number; ``limits`` as of ``click.FloatRange``."""
    kind = Number(**limits)
    return option(name, type=kind, metavar=metavar or "X", help=text, default=default, show_default=default is not None)


class Record:
    """Typed values of a command's options: a subclass declares each as a field, in the order of the help.

    A field that a base class declares is the command's option too, before the others; one that it only has a value
    for keeps that value in every command that does not declare it.
    """

    def __init__(self, **values: Any) -> None:
        vars(self).update(values)

    def chosen(self, *fields: str) -> dict[str, Any]:
        """Return the values of these fields, as keywords."""
        return {field: getattr(self, field) for field in fields}

    @classmethod
    def options(cls) -> dict[str, Option]:
        """Return the options by their fields, those of base classes first."""
        return {
            name: value
            for base in reversed(cls.__mro__)
            for name, value in vars(base).items()
            if isinstance(value, Option)
        }


R = TypeVar("R", bound=Record)


def takes(record: type[R]) -> Callable[[Callable[[R], int]], Callable[..., int]]:
    """Give a command the options of a record, which it is called with."""

    def with_options(command: Callable[[R], int]) -> Callable[..., int]:
        @wraps(command)
        def call(**values: Any) -> int:
            return command(record(**values))

        for field, declared in reversed(record.options().items()):
            call = declared.declare(field, *declared.names, **declared.attributes)(call)
        return call

    return with_options


class Output(Record):
    """Where a command writes, and how it answers."""

    out: Path | None = None
    as_json: bool = False

    def run_folder(self, name: str) -> Path:
        """Return the folder that is named with --out, or a new one in ``runs/``."""
        from cosim.flight import new_folder

        return self.out if self.out is not None else new_folder(Path("runs"), name)

    def check_out(self, record: str, *files: str) -> None:
        """Raise InputError where the folder named with --out has ``files`` that are of no earlier call.

        ``record`` is the file that a call always leaves.  Call it before the work.
        """
        from cosim.base.storage.files import check_results_folder

        check_results_folder(self.out, record, *files)

    def answer(self, data: Callable[[], Any], show: Callable[[], None], *, nan: bool = False) -> None:
        """Print ``data`` as one JSON object where that is asked for, ``nan``: which may hold NaN; else ``show`` it."""
        if self.as_json:
            echo(dumps(data(), allow_nan=nan))
        else:
            show()


def json(text: str = "Print one JSON object and nothing else.") -> bool:
    """Declare ``--json``."""
    return flag("--json", text)


JSON = json()
