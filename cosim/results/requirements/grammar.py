"""Reading a formula: a few words and comparisons, and one line that says what is wrong and where.

=============================  ==========================================================================
``always(F)``                  in every row from here to the end of the flight
``eventually(F)``              in one of them
``for(2 s, F)``                in every row of the next 2 s
``within(2 s, F)``             in one row of the next 2 s
``until(F, G)``                F in every row before one in which G is true, and there must be one
``until(F, G, 2 s)``           the same, and G within 2 s
``after(2 s, F)``              F 2 s later
``after("gust ends", F)``      F whenever that happens
``not F``, ``F and G``         as they say; also ``F or G`` and ``F implies G``
``a < b``, ``a < b < c``       also ``<=``, ``>``, ``>=``; quantities: signals, numbers, ``+``, ``-``,
                               ``2 * a``, ``abs(a)``
=============================  ==========================================================================

A number may have a unit, ``30 deg`` or ``2 m/s``; without one it has that of what it is compared with.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from math import isfinite
from typing import NamedTuple, NoReturn

from cosim.base.errors import InputError, nearest
from cosim.results.requirements.formula import (
    Absolute,
    After,
    AfterEvent,
    AllOrAny,
    Comparison,
    Formula,
    Happens,
    Not,
    Number,
    Quantity,
    Signal,
    Sum,
    Throughout,
    Until,
)
from cosim.results.requirements.units import UNITS, factor_between

# Chosen by us: far more than a requirement needs, few enough for recursion.
MAX_CHARACTERS, MAX_DEPTH = 2000, 40
WORDS = ("always", "eventually", "for", "within", "until", "after", "abs")  # reserved words of formulas
_CONNECTIVES = ("and", "or", "implies", "not")  # words that join formulas
_COMPARISONS = ("<=", ">=", "<", ">")  # comparison signs
_TOKEN = re.compile(  # a number, name, event or sign
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_]\w*(?:\.\w+)*)"
    r'|(?P<event>"[^"]*")|(?P<sign><=|>=|[<>(),+*-])|(?P<end>$))',
    re.ASCII,
)
_UNIT = re.compile(  # a unit after a number
    rf"\s*(?P<unit>{'|'.join(re.escape(unit) for unit in sorted(UNITS, key=len, reverse=True) if unit != '1')})"
    r"(?![\w/^])",
    re.ASCII,
)


class ParsedFormula(NamedTuple):
    """A formula, the ``unit`` of its margin (1: a share of each tolerance), and its least tolerance, 0 if none."""

    formula: Formula
    unit: str
    tolerance: float


class _Token(NamedTuple):
    """Token of a formula, with its position in the text."""

    kind: str
    text: str
    start: int


@lru_cache(1024)
def parse_formula(text: str) -> ParsedFormula:
    """Parse a formula.  Raises InputError with the position and what is allowed there."""
    parser = _Parser(text)
    formula = parser.read()
    comparisons = list(formula.comparisons)
    if not comparisons:
        raise InputError("compares nothing: it needs a signal and a limit, such as abs(roll_deg) < 30")
    tolerances = _find_tolerances(comparisons)
    units = {comparison.unit for comparison in comparisons}
    if len(units) == 1:
        return ParsedFormula(formula, units.pop(), min(filter(None, tolerances.values()), default=0.0))
    for comparison in comparisons:
        if not tolerances[comparison]:
            raise InputError(
                f"{comparison.text!r} has another unit than the rest and compares with no number but 0, so that "
                "nothing says how the two weigh: make two requirements of it"
            )
    return ParsedFormula(_normalise(formula, tolerances), "1", 1.0)


def _find_tolerances(comparisons: Sequence[Comparison]) -> dict[Comparison, float]:
    """Return the tolerance of each comparison: half of the band between two limits, or else the size of its limit."""
    bounds = {comparison: comparison.bound for comparison in comparisons}

    def find_tolerance(comparison: Comparison) -> float:
        if (bound := bounds[comparison]) is None:
            return comparison.limit
        of, limit, is_upper = bound
        others = [other[1] for other in bounds.values() if other and other[0] == of and other[2] != is_upper]
        widths = [limit - other if is_upper else other - limit for other in others]
        return min((width / 2.0 for width in widths if width > 0.0), default=comparison.limit)

    return {comparison: find_tolerance(comparison) for comparison in comparisons}


def _normalise(formula: Formula, tolerances: dict[Comparison, float]) -> Formula:
    """Return a formula with each comparison divided by its tolerance."""
    if isinstance(formula, Comparison):
        return replace(formula, scale=tolerances[formula])
    if isinstance(formula, AllOrAny):
        return replace(formula, of=tuple(_normalise(part, tolerances) for part in formula.of))
    divided = {name: _normalise(part, tolerances) for name, part in vars(formula).items() if isinstance(part, Formula)}
    return replace(formula, **divided)  # type: ignore[type-var]  # every formula is a dataclass


class _Parser:
    """Recursive-descent parser of one formula."""

    def __init__(self, text: str) -> None:
        self._text, self._end, self._depth = text, 0, 0
        if len(text) > MAX_CHARACTERS:
            raise InputError(f"of {len(text)} characters; at most {MAX_CHARACTERS}: make several requirements of it")
        self._token = self._read_token()

    def read(self) -> Formula:
        start = self._token.start
        formula = self._require_formula(self._parse_implication(), start)
        if self._token.kind != "end":
            self._raise_here("and, or, implies, a comparison or the end")
        return formula

    def _read_token(self) -> _Token:
        match = _TOKEN.match(self._text, self._end)
        if match is None:
            start = len(self._text) - len(self._text[self._end :].lstrip())
            self._token = _Token("sign", self._text[start], start)
            return self._raise_here("a signal, a number, an event in double quotes or one of < <= > >= + - * ( ) ,")
        kind = match.lastgroup or "end"
        self._end = match.end()
        return _Token(kind, match[kind], match.start(kind))

    def _take(self, *texts: str) -> str | None:
        """Return the next token's text and advance, if it is one of these."""
        if self._token.kind in ("number", "event", "end") or self._token.text not in texts:
            return None
        text = self._token.text
        self._token = self._read_token()
        return text

    def _require_token(self, text: str, allowed: str | None = None) -> None:
        if self._take(text) is None:
            self._raise_here(allowed or repr(text))

    def _raise_here(self, allowed: str) -> NoReturn:
        found = repr(self._token.text) if self._token.kind != "end" else "the end"
        raise InputError(f"{found} at character {self._token.start + 1}: there must be {allowed}")

    def _raise_at(self, start: int, why: str) -> NoReturn:
        text = self._text[start : self._token.start].strip()
        raise InputError(f"{text[:40]!r} at character {start + 1}: {why}")

    def _parse_implication(self) -> Formula | Quantity:
        start = self._token.start
        left = self._parse_chain("or", lambda: self._parse_chain("and", self._parse_not, either=False), either=True)
        if self._take("implies") is None:
            return left
        begin = self._token.start
        self._enter_nesting_level()
        right = self._require_formula(self._parse_implication(), begin)
        self._depth -= 1
        return AllOrAny((Not(self._require_formula(left, start)), right), either=True)

    def _parse_chain(self, word: str, read: Callable[[], Formula | Quantity], either: bool) -> Formula | Quantity:
        start = self._token.start
        first = read()
        if self._token.text != word or self._token.kind != "name":
            return first
        parts = [self._require_formula(first, start)]
        while self._take(word):
            start = self._token.start
            parts.append(self._require_formula(read(), start))
        return AllOrAny(tuple(parts), either)

    def _parse_not(self) -> Formula | Quantity:
        if self._take("not") is None:
            return self._parse_comparison()
        start = self._token.start
        self._enter_nesting_level()
        of = self._require_formula(self._parse_not(), start)
        self._depth -= 1
        return Not(of)

    def _parse_comparison(self) -> Formula | Quantity:
        start = self._token.start
        left = self._parse_sum()
        comparisons: list[Formula] = []
        while sign := self._take(*_COMPARISONS):
            lower = self._require_quantity(left, start)
            begin = self._token.start
            upper = self._require_quantity(self._parse_sum(), begin)
            comparisons.append(self._make_comparison(lower, sign, upper, start))
            left, start = upper, begin
        if not comparisons:
            return left
        return comparisons[0] if len(comparisons) == 1 else AllOrAny(tuple(comparisons))

    def _make_comparison(self, left: Quantity, sign: str, right: Quantity, start: int) -> Comparison:
        text = self._text[start : self._token.start].strip()
        if not [*left.names, *right.names]:
            self._raise_at(start, "compares two numbers; one side must have a signal")
        unit = left.unit or right.unit or "1"
        try:
            left, right = _convert(left, unit), _convert(right, unit)
        except InputError as error:
            raise InputError(f"{text!r} at character {start + 1}: {error}") from None
        less, greater = (left, right) if sign in ("<", "<=") else (right, left)
        return Comparison(less, greater, unit, " ".join(text.split()))

    def _parse_sum(self) -> Formula | Quantity:
        start = self._token.start
        first = self._parse_product()
        terms: list[tuple[float, Quantity]] = []
        while sign := self._take("+", "-"):
            begin = self._token.start
            if not terms:
                terms = [(1.0, self._require_quantity(first, start))]
            terms.append((1.0 if sign == "+" else -1.0, self._require_quantity(self._parse_product(), begin)))
        return self._make_sum(terms, start) if terms else first

    def _make_sum(self, terms: list[tuple[float, Quantity]], start: int) -> Quantity:
        unit = next((term.unit for _, term in terms if term.unit), None)
        try:
            scaled = [(factor, _convert(term, unit) if unit else term) for factor, term in terms]
        except InputError as error:
            self._raise_at(start, str(error))
        return Sum(tuple(scaled), unit)

    def _parse_product(self) -> Formula | Quantity:
        if self._take("-"):
            start = self._token.start
            self._enter_nesting_level()
            of = self._require_quantity(self._parse_product(), start)
            self._depth -= 1
            return Number(-of.value, of.unit) if isinstance(of, Number) else Sum(((-1.0, of),), of.unit)
        start = self._token.start
        first = self._parse_primary()
        if self._take("*") is None:
            return first
        if not isinstance(first, Number) or first.unit is not None:
            self._raise_at(start, "only a number without a unit multiplies, such as 2 * roll_deg")
        begin = self._token.start
        of = self._require_quantity(self._parse_product(), begin)
        return Sum(((first.value, of),), of.unit)

    def _parse_primary(self) -> Formula | Quantity:
        token = self._token
        if token.kind == "number":
            return self._parse_number()
        if self._take("("):
            return self._parse_bracket()
        if token.kind == "event":
            self._raise_here('a formula or a quantity; an event stands first in after("EVENT", F) or second in until')
        if token.kind != "name" or token.text in _CONNECTIVES:
            self._raise_here("a signal, a number, ( or one of " + ", ".join((*WORDS, "not")))
        self._token = self._read_token()
        if token.text in WORDS:
            self._require_token("(")
            return self._parse_call(token)
        if self._token.text == "(" and self._token.kind == "sign":
            raise InputError(
                f"unknown word {token.text!r} at character {token.start + 1}; {nearest(token.text, WORDS)}"
            )
        return Signal(token.text)

    def _parse_bracket(self) -> Formula | Quantity:
        self._enter_nesting_level()
        of = self._parse_implication()
        self._require_token(")", "and, or, implies, a comparison or ')'")
        self._depth -= 1
        return of

    def _enter_nesting_level(self) -> None:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            self._raise_here(f"at most {MAX_DEPTH} parts inside each other")

    def _parse_number(self) -> Number:
        token = self._token
        value = float(token.text)
        if not isfinite(value):
            self._raise_here("a finite number")
        match = _UNIT.match(self._text, self._end)
        if match is not None:
            self._end = match.end()
        self._token = self._read_token()
        allowed = (*_CONNECTIVES, *WORDS)
        if match is None and self._token.kind == "name" and self._token.text not in allowed:
            unit = self._token.text
            raise InputError(f"unknown unit {unit!r} at character {self._token.start + 1}; {nearest(unit, UNITS)}")
        return Number(value, match["unit"] if match else None)

    def _parse_call(self, word: _Token) -> Formula | Quantity:
        self._enter_nesting_level()
        if word.text == "abs":
            start = self._token.start
            of: Formula | Quantity = Absolute(self._require_quantity(self._parse_sum(), start))
        elif word.text in ("always", "eventually"):
            of = Throughout(self._parse_operand(), once=word.text == "eventually")
        elif word.text in ("for", "within"):
            seconds = self._parse_seconds()
            self._require_token(",")
            of = Throughout(self._parse_operand(), word.text == "within", seconds)
        elif word.text == "after":
            of = self._parse_after()
        else:
            of = self._parse_until()
        self._require_token(")", "')'")
        self._depth -= 1
        return of

    def _parse_after(self) -> Formula:
        if self._token.kind != "event":
            seconds = self._parse_seconds('a time such as 2 s, or an event such as "gust ends"')
            self._require_token(",")
            return After(seconds, self._parse_operand())
        event = self._parse_event()
        self._require_token(",")
        return AfterEvent(event, self._parse_operand())

    def _parse_until(self) -> Formula:
        of = self._parse_operand()
        self._require_token(",")
        then = Happens(self._parse_event()) if self._token.kind == "event" else self._parse_operand()
        return Until(of, then, self._parse_seconds()) if self._take(",") else Until(of, then)

    def _parse_event(self) -> str:
        event = " ".join(self._token.text.strip('"').replace("_", " ").replace("-", " ").split())
        self._token = self._read_token()
        return event

    def _parse_seconds(self, allowed: str = "a time such as 2 s") -> float:
        if self._token.kind != "number":
            self._raise_here(allowed)
        start = self._token.start
        number = self._parse_number()
        if number.unit is None or UNITS[number.unit][0] != "s":
            self._raise_at(start, f"there must be {allowed}")
        return number.value * UNITS[number.unit][1]

    def _parse_operand(self) -> Formula:
        start = self._token.start
        return self._require_formula(self._parse_implication(), start)

    def _require_formula(self, of: Formula | Quantity, start: int) -> Formula:
        if isinstance(of, Quantity):
            self._raise_at(start, "is a quantity and not yet true or false; compare it, such as with < 30")
        return of

    def _require_quantity(self, of: Formula | Quantity, start: int) -> Quantity:
        if isinstance(of, Formula):
            self._raise_at(start, "is true or false, and no quantity that could be compared or added")
        return of


def _convert(of: Quantity, unit: str) -> Quantity:
    """Return a quantity converted to a unit.  Raises InputError for an incompatible one."""
    if of.unit is None or of.unit == unit:
        return of
    factor = factor_between(of.unit, unit)
    return Number(of.value * factor, unit) if isinstance(of, Number) else Sum(((factor, of),), unit)
