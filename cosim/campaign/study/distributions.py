"""What one key of a study is drawn from: bounds, values or a distribution, in a file or as ``KEY=LO:HI`` on a line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import inf, log, pi, sin
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import Field, model_validator

from cosim.base.arrays import Array
from cosim.base.errors import InputError, nearest
from cosim.base.storage.toml import Model, Positive, Scalar, parse_value, validate

T = TypeVar("T")  # type of a drawn value
FORMS = ("range", "values", "normal", "lognormal", "triangular", "uncertainty")  # keys that state a distribution
UNCERTAIN_KEY = "engine"  # only key with "uncertainty"
CASE = "case"  # key for the study's named cases
RELATIVE: dict[str, Literal["", "factor", "offset"]] = {"=": "", "*=": "factor", "+=": "offset"}  # operators of --vary
USAGE = (  # how to write --vary, for messages
    "write it as KEY=LO:HI, KEY=LO:HI:LEVELS, KEY=A,B,C, KEY=log(LO:HI), KEY=normal(MEAN,SD,LO,HI), "
    "KEY=lognormal(MEDIAN,SIGMA,LO,HI) or KEY=triangular(LO,MODE,HI); *= for factors, += for offsets; engine alone: by "
    "its [uncertainty]"
)


class Normal(Model):
    """Normal distribution with ``mean`` and ``sd`` before truncation at ``min`` and ``max``."""

    mean: float
    sd: Positive
    min: float | None = None
    max: float | None = None

    def score(self, bound: float) -> float:
        """Return the number of standard deviations from the mean to a bound."""
        return (bound - self.mean) / self.sd

    def values(self, scores: Array) -> Array:
        """Return the values of this distribution for standard normal numbers."""
        return self.mean + self.sd * scores


class LogNormal(Model):
    """``median * exp(sigma z)`` with z standard normal, truncated at ``min`` and ``max``."""

    median: Positive
    sigma: Positive
    min: float | None = None
    max: float | None = None

    def score(self, bound: float) -> float:
        """Return the z score of a bound; minus infinity if there is none below."""
        return log(bound / self.median) / self.sigma if bound > 0.0 else -inf

    def values(self, scores: Array) -> Array:
        """Return the values of this distribution for standard normal numbers."""
        return np.asarray(self.median * np.exp(self.sigma * scores))


class Triangular(Model):
    """Density that rises from ``min`` to ``mode`` and falls to ``max``, linearly."""

    min: float
    mode: float
    max: float

    @model_validator(mode="after")
    def _check_order(self) -> Triangular:
        if not (self.min < self.max and self.min <= self.mode <= self.max):
            raise ValueError(f"min {self.min:g}, mode {self.mode:g}, max {self.max:g}: must grow in this order")
        return self


CALLS: dict[str, type[Model]] = {"normal": Normal, "lognormal": LogNormal, "triangular": Triangular}  # as normal(0,1)


class Correlation(Model):
    """Spearman rank correlation between two keys; their distributions are unchanged."""

    keys: tuple[str, str]
    rank: Annotated[float, Field(gt=-1.0, lt=1.0)]

    @property
    def normal(self) -> float:
        """The correlation of two normal variables with this rank correlation: 2 sin(pi rank / 6) (Pearson, 1907)."""
        return 2.0 * sin(pi * self.rank / 6.0)


class Vary(Model):
    """One key and its distribution, stated by exactly one of the ``FORMS``.

    ``range`` is uniform, or uniform in the logarithm with ``scale = "log"``; ``levels`` makes that many grid points of
    it, both ends among them.  Of ``values`` each is equally likely.  With ``relative`` what is drawn is a factor on the
    key's nominal value, or an offset to it.  Where the key holds an integer, the integers within the bounds are drawn:
    the distribution between k - 1/2 and k + 1/2 becomes k, so that under a uniform one all are equally likely.
    ``uncertainty`` draws the engine's parameters by the table of that name in its mapping file, all at once.
    """

    key: str
    range: tuple[float, float] | None = None
    levels: Annotated[int, Field(ge=2, le=100_000)] | None = None
    scale: Literal["linear", "log"] = "linear"
    values: list[Scalar] | None = None
    normal: Normal | None = None
    lognormal: LogNormal | None = None
    triangular: Triangular | None = None
    uncertainty: Literal[True] | None = None  # engine: drawn by its file's uncertainty
    relative: Literal["", "factor", "offset"] = ""

    @model_validator(mode="after")
    def _check_single_form(self) -> Vary:
        forms = [form for form in FORMS if getattr(self, form) is not None]
        if len(forms) != 1:
            allowed = ", ".join(form for form in FORMS if form != "uncertainty" or self.key == UNCERTAIN_KEY)
            raise ValueError(f"{self.key}: give one of {allowed}; {' and '.join(forms) or 'none'} given")
        if self.values is not None and len(self.values) < (1 if self.key == CASE else 2):
            raise ValueError(f"{self.key}: values: needs at least 2")
        if self.range is None and (self.levels is not None or self.scale != "linear"):
            raise ValueError(f"{self.key}: levels and scale go with a range, not with {forms[0]}")
        if self.uncertainty and (self.key != UNCERTAIN_KEY or self.relative):
            raise ValueError(
                f"{self.key}: only engine is drawn by its uncertainty, and neither as factor nor as offset"
            )
        return self

    @model_validator(mode="after")
    def _check_bounds(self) -> Vary:
        low, high = self.support
        if not self.values and low >= high:
            raise ValueError(f"{self.key}: {_to_text(low)} to {_to_text(high)} is empty; the lower bound comes first")
        if low <= 0.0 and (self.scale == "log" or self.lognormal is not None):
            if self.scale == "log":
                raise ValueError(f"{self.key}: a logarithmic range needs bounds above 0, not {_to_text(low)}")
            if self.lognormal is not None and self.lognormal.min is not None:
                raise ValueError(f"{self.key}: a lognormal number is above 0, and so must be min")
        for name, form in (("normal", self.normal), ("lognormal", self.lognormal)):
            # Beyond 8 standard deviations the inverse of the distribution loses digits.
            if form is not None and not (form.score(low) < 8.0 and form.score(high) > -8.0):
                raise ValueError(f"{self.key}: {_to_text(low)} to {_to_text(high)} is too far out for this {name}")
        return self

    @model_validator(mode="after")
    def _check_value_kinds(self) -> Vary:
        values = self.values or []
        kinds = {"text" if isinstance(v, str) else "bool" if isinstance(v, bool) else "number" for v in values}
        if len(kinds) > 1:
            raise ValueError(f"{self.key}: values of different kinds: {', '.join(map(_to_text, values))}")
        repeated = first_repeated(values)
        if repeated is not None:
            raise ValueError(f"{self.key}: {_to_text(repeated)} is there twice")
        if self.relative and kinds - {"number"}:
            raise ValueError(f"{self.key}: a {self.relative} is a number, not {_to_text(values[0])}")
        return self

    @property
    def support(self) -> tuple[float, float]:
        """Smallest and largest number that can be drawn, before ``relative``; infinite without a bound."""
        if self.range is not None:
            return self.range
        form = self.normal or self.lognormal or self.triangular
        if form is not None:
            lowest = 0.0 if self.lognormal else -inf
            return (lowest if form.min is None else form.min, inf if form.max is None else form.max)
        numbers = [float(v) for v in self.values or [] if not isinstance(v, str)]
        return (min(numbers, default=-inf), max(numbers, default=inf))

    @property
    def discrete(self) -> bool:
        """Whether the key can be an axis of a grid: it has values, or a range with levels."""
        return self.values is not None or self.levels is not None

    @property
    def is_ordered(self) -> bool:
        """Whether the drawn values are numbers, which have an order."""
        return not self.uncertainty and not any(isinstance(value, (str, bool)) for value in self.values or [])

    @property
    def text(self) -> str:
        """Text of the command line that :func:`parse_vary` parses to this distribution."""
        if self.uncertainty:
            return self.key
        sign = next(sign for sign, relative in RELATIVE.items() if relative == self.relative)
        return f"{self.key}{sign}{self._format_distribution()}"

    def _format_distribution(self) -> str:
        if self.values is not None:
            return ",".join(_to_text(value) for value in self.values)
        if self.range is not None:
            span = ":".join(_to_text(number) for number in (*self.range, *([self.levels] if self.levels else [])))
            return f"log({span})" if self.scale == "log" else span
        name = next(name for name in CALLS if getattr(self, name) is not None)
        numbers = ["" if number is None else _to_text(number) for _, number in getattr(self, name)]
        return f"{name}({','.join(numbers if any(numbers[2:]) else numbers[:2])})"


def vary_tables(value: Any) -> Any:
    """Return the tables of a study's ``vary``; all of it, or each entry, may be command-line text."""
    listed = [value] if isinstance(value, str) else value
    if not isinstance(listed, list):
        return value
    tables = [_parse_to_table(each) if isinstance(each, str) else each for each in listed]
    return [
        each | {"uncertainty": True} if isinstance(each, dict) and each == {"key": UNCERTAIN_KEY} else each
        for each in tables
    ]


def _parse_to_table(text: str) -> dict[str, Any]:
    try:
        return parse_vary(text).model_dump(mode="json", exclude_none=True)
    except InputError as error:
        raise ValueError(str(error).removeprefix("vary ")) from error


def parse_vary(text: str) -> Vary:
    """Parse a distribution such as ``KEY=LO:HI`` of the command line; ``USAGE`` lists all forms.

    Bounds of ``normal`` and ``lognormal`` may be left out, one of them or both.  Raises InputError: one line.
    """
    if text.strip() == UNCERTAIN_KEY:
        return Vary(key=UNCERTAIN_KEY, uncertainty=True)
    match = re.fullmatch(r"\s*([^=*+\s]+)\s*(\*=|\+=|=)\s*(.+?)\s*", text)
    if match is None:
        raise InputError(f"vary {text}: {USAGE}")
    key, sign, form = match.groups()
    table = {"key": key, "relative": RELATIVE[sign], **_parse_form(form, text)}
    return validate(Vary, table, f"vary {text}")


def _parse_form(form: str, text: str) -> dict[str, Any]:
    """Parse the part behind the equals sign into the table that a study's file would have."""
    call = re.fullmatch(r"([A-Za-z]+)\s*\((.*)\)", form)
    if call is None:
        if ":" in form:
            return _parse_range(form, text)
        if "," in form:
            return {"values": [parse_value(part) for part in form.split(",")]}
        if ends := re.fullmatch(r"([\d.]+)\s*(?:-|\.\.|to)\s*([\d.]+)", form):
            raise InputError(f"vary {text}: write the range as {ends[1]}:{ends[2]}")
        raise InputError(f"vary {text}: one value does not vary; KEY=LO:HI or KEY=A,B do, or settings {text}")
    name, argument_text = call.groups()
    if name == "log":
        return {**_parse_range(argument_text, text), "scale": "log"}
    if name not in CALLS:
        raise InputError(f"vary {text}: unknown distribution {name!r}; {nearest(name, [*CALLS, 'log'])}")
    arguments, fields = [part.strip() for part in argument_text.split(",")], CALLS[name].model_fields
    needed = [key for key, field in fields.items() if field.is_required()]
    if not len(needed) <= len(arguments) <= len(fields):
        raise InputError(f"vary {text}: {name} takes {', '.join(fields)}")
    stated = {key: part for key, part in zip(fields, arguments, strict=False) if part or key in needed}
    return {name: {key: parse_number(part, f"vary {text}") for key, part in stated.items()}}


def _parse_range(span: str, text: str) -> dict[str, Any]:
    numbers = span.split(":")
    if len(numbers) not in (2, 3):
        raise InputError(f"vary {text}: {USAGE}")
    table: dict[str, Any] = {"range": [parse_number(part, f"vary {text}") for part in numbers[:2]]}
    if len(numbers) == 3:
        if not re.fullmatch(r"\s*\d+\s*", numbers[2]):
            raise InputError(f"vary {text}: {numbers[2].strip()!r} is no number of levels: a whole one from 2 on")
        table["levels"] = int(numbers[2])
    return table


def parse_number(text: str, where: str) -> float:
    """Parse a number of a command line.  Raises InputError that begins with ``where``."""
    try:
        return float(text)
    except ValueError as error:
        raise InputError(f"{where}: {text.strip() or 'nothing'!r} is not a number") from error


def first_repeated(values: Sequence[T]) -> T | None:
    """Return the first value that is repeated, or None."""
    return next((value for index, value in enumerate(values) if value in values[:index]), None)


def _to_text(value: bool | int | float | str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return number_text(value) if isinstance(value, float) else str(value)


def number_text(value: float) -> str:
    """Format a number as short as possible without losing a bit."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)
