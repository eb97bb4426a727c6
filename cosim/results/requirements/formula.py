"""The parts of a formula over the signals of a flight, and by how much each is kept or broken, row by row.

The quantitative semantics of signal temporal logic (Donze and Maler, 2010) in discrete time, at the rows of the log: a
comparison ``a < b`` is kept by ``b - a``; *and* and *always* take the least of what they are made of, *or* and
*eventually* the greatest, *not* changes the sign.  So the margin of a formula is that of one comparison in one row,
which :meth:`Formula.find_decisive_comparison` finds.  Every part takes a time in proportion to the rows.

A row in which a signal has no number (a set-point while none is commanded) is unknown, NaN: *always* and *eventually*
leave it out; *and* is unknown there unless another part is broken, *or* unless another part is kept.  A span of time
that reaches beyond the end of the log is assessed by the rows that there are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil, floor, inf, nan
from typing import NamedTuple, Protocol

import numpy as np

from cosim.base.arrays import Array
from cosim.results.requirements.units import factor_between, in_si, unit_of

# Rounding error of a time divided by the step, in rows.
_ROW_TOLERANCE = 1e-6
Times = dict[str, list[float]]  # s, of events known before the flight


class Signals(Protocol):
    """Signals that a formula is evaluated on: ``rows`` rows, ``step_s`` apart; ``margins`` is a cache."""

    @property
    def rows(self) -> int: ...

    @property
    def step_s(self) -> float: ...

    @property
    def margins(self) -> dict[Formula, Array]: ...

    def signal(self, name: str) -> Array:
        """Return a signal of the log, one number per row."""

    def event_rows(self, name: str) -> Sequence[int]:
        """Return the rows at which an event happens, the earliest first."""


class Deciding(NamedTuple):
    """The comparison and row that determine a margin; ``sign`` is -1 inside an odd number of *not*."""

    comparison: Comparison
    row: int
    sign: float


class Quantity:
    """Quantity with one number per log row in ``unit``; None: a bare number, in the unit it is compared with."""

    unit: str | None
    parts: tuple[Quantity, ...] = ()

    @property
    def names(self) -> Iterator[str]:
        for part in self.parts:
            yield from part.names

    @property
    def constant(self) -> float:
        """Constant part: 0 for a signal, the number itself without signals."""
        return 0.0

    def values(self, signals: Signals) -> Array:
        raise NotImplementedError


@dataclass(frozen=True)
class Number(Quantity):
    """Quantity that is the same number in every row of the log."""

    value: float
    unit: str | None

    @property
    def constant(self) -> float:
        return self.value

    def values(self, signals: Signals) -> Array:
        return np.full(signals.rows, self.value)


@dataclass(frozen=True)
class Signal(Quantity):
    """A column of the log, a quantity derived from some, or a metric of the whole flight."""

    name: str

    @property
    def unit(self) -> str:  # type: ignore[override]
        return unit_of(self.name)

    @property
    def names(self) -> Iterator[str]:
        yield self.name

    def values(self, signals: Signals) -> Array:
        logged = in_si(self.name)
        values = signals.signal(logged)
        return values if logged == self.name else values * factor_between(unit_of(logged), self.unit)


@dataclass(frozen=True)
class Absolute(Quantity):
    """Magnitude of a quantity."""

    of: Quantity

    @property
    def unit(self) -> str | None:  # type: ignore[override]
        return self.of.unit

    @property
    def parts(self) -> tuple[Quantity, ...]:  # type: ignore[override]
        return (self.of,)

    @property
    def constant(self) -> float:
        return 0.0 if any(self.names) else abs(self.of.constant)

    def values(self, signals: Signals) -> Array:
        return np.abs(self.of.values(signals))


@dataclass(frozen=True)
class Sum(Quantity):
    """The sum of quantities, each times its factor; the factors bring all to ``unit``."""

    terms: tuple[tuple[float, Quantity], ...]
    unit: str | None

    @property
    def parts(self) -> tuple[Quantity, ...]:  # type: ignore[override]
        return tuple([term for _, term in self.terms])

    @property
    def constant(self) -> float:
        return sum(factor * term.constant for factor, term in self.terms)

    def values(self, signals: Signals) -> Array:
        total: Array | None = None
        for factor, term in self.terms:
            values = term.values(signals) if factor == 1.0 else factor * term.values(signals)
            total = values if total is None else total + values
        assert total is not None
        return total


class Formula:
    """A formula, true or false in each row, with a margin."""

    @property
    def parts(self) -> tuple[Formula, ...]:
        return tuple([value for value in vars(self).values() if isinstance(value, Formula)])

    @property
    def comparisons(self) -> Iterator[Comparison]:
        for part in self.parts:
            yield from part.comparisons

    @property
    def events(self) -> Iterator[str]:
        for part in self.parts:
            yield from part.events

    def margins(self, signals: Signals) -> Array:
        """Return the margin by which the formula is true from every row on: negative if false, NaN if unknown."""
        margins = signals.margins.get(self)
        if margins is None:
            margins = signals.margins[self] = self._compute_margins(signals)
        return margins

    def _compute_margins(self, signals: Signals) -> Array:
        raise NotImplementedError

    def find_decisive_comparison(self, signals: Signals, row: int) -> Deciding:
        """Return the comparison and row that determine the margin in ``row``, which must be a number."""
        raise NotImplementedError

    def last_relevant_time_s(self, starts_s: Sequence[float], times_s: Times) -> float:
        """Return the last time [s] at which rows can affect the formula, evaluated at ``starts_s``."""
        return max(
            (part.last_relevant_time_s(starts_s, times_s) for part in self.parts), default=max(starts_s, default=0.0)
        )


@dataclass(frozen=True)
class Comparison(Formula):
    """``greater - less``, in ``unit``, divided by ``scale``."""

    less: Quantity
    greater: Quantity
    unit: str
    text: str
    scale: float = 1.0

    @property
    def comparisons(self) -> Iterator[Comparison]:
        yield self

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals on both sides."""
        return (*self.less.names, *self.greater.names)

    @property
    def bound(self) -> tuple[Quantity, float, bool] | None:
        """Quantity, number and direction of a comparison with a number; None if both sides have signals."""
        if not any(self.greater.names):
            return self.less, self.greater.constant, True
        return None if any(self.less.names) else (self.greater, self.less.constant, False)

    @property
    def limit(self) -> float:
        """Magnitude of the number compared with, without constants added to signals.

        Of two quantities with signals it is the number between them; 0 where there is none.
        """
        return abs(self.greater.constant - self.less.constant if self.bound is None else self.bound[1])

    def _compute_margins(self, signals: Signals) -> Array:
        difference = self.greater.values(signals) - self.less.values(signals)
        return difference if self.scale == 1.0 else difference / self.scale

    def find_decisive_comparison(self, signals: Signals, row: int) -> Deciding:
        return Deciding(self, row, 1.0)


@dataclass(frozen=True)
class Happens(Formula):
    """An event as a formula: true in its rows and false in all others, with infinite margin."""

    event: str

    @property
    def events(self) -> Iterator[str]:
        yield self.event

    def _compute_margins(self, signals: Signals) -> Array:
        margins = np.full(signals.rows, -inf)
        margins[list(signals.event_rows(self.event))] = inf
        return margins


@dataclass(frozen=True)
class Not(Formula):
    """Negation of a formula."""

    of: Formula

    def _compute_margins(self, signals: Signals) -> Array:
        return -self.of.margins(signals)

    def find_decisive_comparison(self, signals: Signals, row: int) -> Deciding:
        deciding = self.of.find_decisive_comparison(signals, row)
        return deciding._replace(sign=-deciding.sign)


@dataclass(frozen=True)
class AllOrAny(Formula):
    """Conjunction of formulas: all parts are true; with ``either`` their disjunction: one part is."""

    of: tuple[Formula, ...]
    either: bool = False

    @property
    def parts(self) -> tuple[Formula, ...]:
        return self.of

    def _compute_margins(self, signals: Signals) -> Array:
        sign = -1.0 if self.either else 1.0
        return sign * _min_margins([sign * part.margins(signals) for part in self.parts])

    def find_decisive_comparison(self, signals: Signals, row: int) -> Deciding:
        margins = [part.margins(signals)[row] for part in self.parts]
        chosen = np.nanargmax(margins) if self.either else np.nanargmin(margins)
        return self.parts[chosen].find_decisive_comparison(signals, row)


@dataclass(frozen=True)
class Throughout(Formula):
    """Formula that is true in each row from here on; with ``once``, in one of them; at most ``seconds`` later."""

    of: Formula
    once: bool = False
    seconds: float = inf

    def _compute_margins(self, signals: Signals) -> Array:
        sign = -1.0 if self.once else 1.0
        return sign * _min_ahead(sign * self.of.margins(signals), _count_rows(self.seconds, signals))

    def find_decisive_comparison(self, signals: Signals, row: int) -> Deciding:
        ahead = self.of.margins(signals)[row : row + _count_rows(self.seconds, signals) + 1]
        chosen = np.nanargmax(ahead) if self.once else np.nanargmin(ahead)
        return self.of.find_decisive_comparison(signals, row + int(chosen))

    def last_relevant_time_s(self, starts_s: Sequence[float], times_s: Times) -> float:
        if self.seconds == inf:
            return max(starts_s, default=0.0)
        return self.of.last_relevant_time_s([start + self.seconds for start in starts_s], times_s)


@dataclass(frozen=True)
class Until(Formula):
    """Formula: ``of`` is true until a row, which must exist at most ``seconds`` later, where ``then`` is true."""

    of: Formula
    then: Formula
    seconds: float = inf

    def _compute_margins(self, signals: Signals) -> Array:
        then, kept = self._fill_unknown(signals)
        margins, following = np.empty(signals.rows), -inf
        for row in range(signals.rows - 1, -1, -1):
            following = margins[row] = max(then[row], min(kept[row], following))
        rows = _count_rows(self.seconds, signals)
        return np.minimum(margins, -_min_ahead(-then, rows)) if rows < signals.rows else margins

    def _fill_unknown(self, signals: Signals) -> tuple[Array, Array]:
        """Return the margins of ``then``, unknown as false, and of ``of``, unknown as true."""
        then, kept = self.then.margins(signals), self.of.margins(signals)
        return np.where(np.isnan(then), -inf, then), np.where(np.isnan(kept), inf, kept)

    def find_decisive_comparison(self, signals: Signals, row: int) -> Deciding:
        end = row + _count_rows(self.seconds, signals) + 1
        then, kept = (margins[row:end] for margins in self._fill_unknown(signals))
        before = np.concatenate(([inf], np.minimum.accumulate(kept)[:-1]))
        chosen = int(np.argmax(np.minimum(then, before)))
        if then[chosen] <= before[chosen]:
            return self.then.find_decisive_comparison(signals, row + chosen)
        return self.of.find_decisive_comparison(signals, row + int(np.argmin(kept[:chosen])))

    def last_relevant_time_s(self, starts_s: Sequence[float], times_s: Times) -> float:
        return max(starts_s, default=0.0) + (0.0 if self.seconds == inf else self.seconds)


@dataclass(frozen=True)
class After(Formula):
    """Formula that is true ``seconds`` later, in the first row at or after that time."""

    seconds: float
    of: Formula

    def _compute_margins(self, signals: Signals) -> Array:
        margins, rows = np.full(signals.rows, nan), self._delay_rows(signals)
        margins[: max(signals.rows - rows, 0)] = self.of.margins(signals)[rows:]
        return margins

    def find_decisive_comparison(self, signals: Signals, row: int) -> Deciding:
        return self.of.find_decisive_comparison(signals, row + self._delay_rows(signals))

    def _delay_rows(self, signals: Signals) -> int:
        return ceil(self.seconds / signals.step_s - _ROW_TOLERANCE)

    def last_relevant_time_s(self, starts_s: Sequence[float], times_s: Times) -> float:
        return self.of.last_relevant_time_s([start + self.seconds for start in starts_s], times_s)


@dataclass(frozen=True)
class AfterEvent(Formula):
    """Formula that is true whenever an event happens from here on; unknown without an event."""

    event: str
    of: Formula

    @property
    def events(self) -> Iterator[str]:
        yield self.event
        yield from self.of.events

    def _compute_margins(self, signals: Signals) -> Array:
        return _min_ahead(self._event_margins(signals), signals.rows)

    def find_decisive_comparison(self, signals: Signals, row: int) -> Deciding:
        return self.of.find_decisive_comparison(signals, row + int(np.nanargmin(self._event_margins(signals)[row:])))

    def _event_margins(self, signals: Signals) -> Array:
        margins, rows = np.full(signals.rows, nan), list(signals.event_rows(self.event))
        margins[rows] = self.of.margins(signals)[rows]
        return margins

    def last_relevant_time_s(self, starts_s: Sequence[float], times_s: Times) -> float:
        return self.of.last_relevant_time_s(times_s.get(self.event, []), times_s)


def _min_margins(margins: Sequence[Array]) -> Array:
    """Return the smallest margin in each row; unknown if one is, unless another is negative."""
    known = margins[0]
    is_unknown = np.isnan(known)
    for other in margins[1:]:
        is_unknown = is_unknown | np.isnan(other)
        known = np.fmin(known, other)
    return np.where(is_unknown & ~(known < 0.0), nan, known)


def _min_ahead(margins: Array, rows: int) -> Array:
    """Return the smallest margin from each row to ``rows`` later, ignoring unknown ones."""
    if rows >= margins.size - 1:
        return np.fmin.accumulate(margins[::-1])[::-1]
    from scipy.ndimage import minimum_filter1d  # van Herk: cost is independent of window

    size, is_unknown = rows + 1, np.isnan(margins)
    ahead = {"mode": "constant", "origin": -(size // 2)}  # the window starts at each row
    least: Array = minimum_filter1d(np.where(is_unknown, inf, margins), size, cval=inf, **ahead)
    if not np.any(is_unknown):
        return least
    is_dark = minimum_filter1d(is_unknown.astype(np.uint8), size, cval=1, **ahead) == 1
    return np.where(is_dark, nan, least)


def _count_rows(seconds: float, signals: Signals) -> int:
    """Return the number of rows within ``seconds`` after a row."""
    return signals.rows if seconds == inf else floor(seconds / signals.step_s + _ROW_TOLERANCE)
