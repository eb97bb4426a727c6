"""What every call has: arguments that are checked, a hearer of its progress, and a result that shows itself."""

from __future__ import annotations

import functools
import inspect
import warnings
from collections.abc import Callable, Mapping, Sequence
from math import inf, isfinite
from pathlib import Path
from types import UnionType
from typing import Any, NamedTuple, ParamSpec, TypeVar, Union, get_args, get_origin

from cosim.base.errors import InputError, Notice, nearest

P = ParamSpec("P")
R = TypeVar("R")
_SHOWN = 40  # characters of a wrong value


class Limits(NamedTuple):
    """The numbers that an argument may be."""

    least: float
    most: float = inf
    is_open: bool = False  # whether ``least`` itself is left out

    def __contains__(self, number: object) -> bool:
        if not isinstance(number, (int, float)) or not self.least <= number <= self.most:
            return False
        return number > self.least or not self.is_open

    def __str__(self) -> str:
        lower = f"{'above' if self.is_open else 'at least'} {self.least:g}"
        return lower if self.most == inf else f"{lower}, at most {self.most:g}"


def checked(**limits: Limits) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return what makes a call raise InputError, one line, for arguments that are not of the types annotated.

    And for numbers that are not finite, or not in their ``limits``: those of the option of the same name.
    """

    def with_checks(call: Callable[P, R]) -> Callable[P, R]:
        adapters: dict[str, Any] = {}  # made at the first call: importing it costs nothing

        @functools.wraps(call)
        def with_check(*arguments: P.args, **named: P.kwargs) -> R:
            signature = inspect.signature(call)
            for name in named:
                if name not in signature.parameters:
                    raise InputError(f"{call.__name__}: no argument {name!r}; {nearest(name, signature.parameters)}")
            try:
                bound = signature.bind(*arguments, **named)
            except TypeError as error:
                raise InputError(f"{call.__name__}: {error}") from None
            if not adapters:
                adapters.update(_adapters(call))
            for name, value in bound.arguments.items():
                parameter = signature.parameters[name]
                check = functools.partial(_valid, call, parameter, adapters[name], limits.get(name))
                several = parameter.kind is inspect.Parameter.VAR_POSITIONAL
                bound.arguments[name] = tuple(map(check, value)) if several else check(value)
            return call(*bound.args, **bound.kwargs)

        vars(with_check)["limits"] = limits
        return with_check

    return with_checks


def _check_value(where: str, value: Any, limits: Limits | None) -> None:
    """Raise InputError for a number that cannot be meant, and for a text that names nothing."""
    if isinstance(value, float) and not isfinite(value):
        raise InputError(f"{where}: {value:g} is no finite number")
    if limits is not None and value is not None and value not in limits:
        raise InputError(f"{where}: {value:g}; allowed: {limits}")
    if isinstance(value, (str, Path)) and "\0" in str(value):
        raise InputError(f"{where}: {str(value)!r} has a zero in it, and is no name")


def _adapters(call: Callable[..., Any]) -> dict[str, Any]:
    """Return what checks each argument."""
    from pydantic import InstanceOf, TypeAdapter

    def as_instances(hint: Any) -> Any:
        """Return a type in which a class of ours stands for its instances, which are not looked into."""
        if isinstance(hint, type) and hint.__module__.startswith("cosim"):
            return InstanceOf[hint]  # type: ignore[misc]
        if get_origin(hint) in (Union, UnionType):
            return Union[tuple(map(as_instances, get_args(hint)))]  # noqa: UP007 - made of a tuple
        return hint

    hints = inspect.get_annotations(call, eval_str=True)
    return {name: TypeAdapter(as_instances(hint)) for name, hint in hints.items() if name != "return"}


def _valid(
    call: Callable[..., Any], parameter: inspect.Parameter, adapter: Any, limits: Limits | None, value: Any
) -> Any:
    """Return an argument as the call takes it.  Raises InputError."""
    from pydantic import ValidationError

    where = f"{call.__name__}: {parameter.name}"
    try:
        valid = adapter.validate_python(value)
    except ValidationError as error:
        shown = repr(value)
        shown = shown if len(shown) <= _SHOWN else f"{shown[: _SHOWN - 3]}..."
        wrong = error.errors(include_url=False)
        listed = [each["ctx"]["expected"] for each in wrong if each["type"] == "literal_error"]
        for each in wrong:
            if listed and isinstance(each["input"], str):
                raise InputError(f"{where}: {each['input']!r}: {nearest(each['input'], _words(listed[0]))}") from None
        allowed = listed[0] if listed else parameter.annotation
        raise InputError(f"{where}: {shown} is a value of type {type(value).__name__}; allowed: {allowed}") from None
    _check_value(where, valid, limits)
    return valid


def _words(listed: str) -> list[str]:
    """Return the words of a list in quotes: ``'a', 'b' or 'c'``."""
    return listed.split("'")[1::2]


class Progress:
    """Hears what a call is doing; a subclass says what becomes of it, this one makes warnings of the notes."""

    def begin(self, folder: Path) -> None:
        """Hear of the folder that everything goes into, before the first flight.

        Parameters
        ----------
        folder : Path
            The folder.
        """

    def note(self, text: str) -> None:
        """Hear of something that is taken otherwise than one may think.

        Parameters
        ----------
        text : str
            One line; it becomes a warning, ``cosim.base.errors.Notice``.
        """
        warnings.warn(text, Notice, stacklevel=3)

    def update(self, part: str, done: int, of: int) -> None:
        """Hear how far the call is.

        Parameters
        ----------
        part : str
            What is being done, or what became of the flights so far.
        done : int
            Parts that are done.
        of : int
            All parts; 0 where that is not known.
        """


class Table(NamedTuple):
    """A table of a result, as texts."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


class Result:
    """What a call came to.

    A notebook shows it with its tables; ``print`` gives its lines.

    Attributes
    ----------
    files : dict of str to Path
        What was written, by kind; ``report`` is the page.  Empty where nothing was.
    """

    files: dict[str, Path]

    def to_dict(self) -> dict[str, Any]:
        """Return what the command prints with ``--json``.

        Returns
        -------
        dict
            Numbers, texts, lists and tables, in SI units.
        """
        raise NotImplementedError

    @property
    def folder(self) -> Path | None:
        """The folder that the files are in; None where none were written."""
        return next((path.parent for path in self.files.values()), None)

    @property
    def report(self) -> Path | None:
        """The page; None where none was written."""
        return self.files.get("report")

    def lines(self) -> list[str]:
        """Return what it came to in sentences, the most important first.

        Returns
        -------
        list of str
            A line each.
        """
        raise NotImplementedError

    def tables(self) -> list[Table]:
        """Return what it came to in tables.

        Returns
        -------
        list of Table
            Each with title, columns and rows, all of them texts.
        """
        return []

    def figures(self) -> Mapping[str, Any]:
        """Return the figures of the page, which the extra ``notebook`` draws.

        Returns
        -------
        dict
            A ``plotly.graph_objects.Figure`` each, by name.

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
        first = next(iter(self.lines()), "")
        return f"<{type(self).__name__}: {first}{where}>"

    def _repr_html_(self) -> str:
        """Return lines and tables for notebooks, and where the page is."""
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
