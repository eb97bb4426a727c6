"""Views of a log: a mapping of its columns, a pandas table, and its display in a notebook."""

from __future__ import annotations

import copyreg
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from html import escape
from typing import Any, TypeVar

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.protocols import Column
from cosim.results.log.columns import require

TIME = "time_s"  # name of the time column


V = TypeVar("V")  # type of a looked-up value


class NamedColumns(dict[str, V]):
    """Columns by name, read on demand; subclasses define ``__getitem__`` and ``__iter__``.

    A dict, because pandas makes a table of nothing else (``pandas.DataFrame(columns)``), which holds nothing itself.
    """

    keys, items, values = Mapping.keys, Mapping.items, Mapping.values  # type: ignore[assignment]
    __eq__, __hash__ = object.__eq__, object.__hash__  # type: ignore[assignment]

    def __contains__(self, name: object) -> bool:
        return name in tuple(self)

    def get(self, name: str, default: Any = None) -> Any:
        """Return a column, or the default if there is none."""
        is_there = name in self
        return self[name] if is_there else default

    def __setitem__(self, name: str, value: V) -> None:
        raise TypeError("columns cannot be set; dict(columns) is a copy that can")

    def __reduce__(self) -> Any:
        return copyreg.__newobj__, (type(self),), vars(self)  # type: ignore[attr-defined]


def make_table(columns: Mapping[str, Any]) -> Any:
    """Return columns as a ``pandas.DataFrame``.  Raises InputError where pandas is not installed."""
    try:
        from pandas import DataFrame
    except ModuleNotFoundError as error:
        if error.name != "pandas":
            raise
        raise InputError("a table needs pandas, which is not installed: pip install pandas") from None
    return DataFrame(dict(columns))


class Columnar(NamedColumns[Array]):
    """A log of named columns: ``log["roll_rad"]``; ``dict(log)`` has all."""

    columns: tuple[str, ...]
    described: tuple[Column, ...]  # columns with unit and frame, if known

    def __len__(self) -> int:
        raise NotImplementedError

    def __getitem__(self, name: str) -> Array:
        raise NotImplementedError

    def blocks(self, names: tuple[str, ...]) -> Iterator[dict[str, Array]]:
        raise NotImplementedError

    def keep_open(self) -> AbstractContextManager[None]:
        """Keep the log's file open, if any, while columns are read one by one."""
        return nullcontext()

    def _read(self, names: Sequence[str]) -> dict[str, Array]:
        blocks = list(self.blocks(tuple(names)))
        return {name: np.concatenate([np.empty(0), *[part[name] for part in blocks]]) for name in names}

    def keys(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.columns

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __repr__(self) -> str:
        first = ", ".join(self.columns[:4])
        more = f", and {len(self.columns) - 4} more" if len(self.columns) > 4 else ""
        return f"<{type(self).__name__}: {len(self)} steps, {len(self.columns)} columns: {first}{more}>"

    def _ipython_key_completions_(self) -> list[str]:
        """Return the column names that complete ``log["`` in a notebook."""
        return list(self.columns)

    def table(self, *names: str) -> Any:
        """Return the log as a ``pandas.DataFrame``, one row a control step, the time [s] as its index.

        Its ``attrs`` have ``units``, ``frames`` and ``meanings`` of the columns, by name.

        Parameters
        ----------
        *names : str
            The columns; all of them where none is named.

        Raises
        ------
        InputError
            For a column that the log has not, and where pandas is not installed.
        """
        chosen = [require(name, self.columns) for name in names or self.columns]
        values = self._read(list(dict.fromkeys([TIME, *chosen])))
        frame = make_table(values).set_index(TIME)
        described = {column.name: column for column in self.described if column.name in chosen}
        frame.attrs = {
            f"{key}s": {name: getattr(column, key) for name, column in described.items()}
            for key in ("unit", "frame", "meaning")
        }
        return frame

    def _repr_html_(self) -> str:
        """Return a table for notebooks: each column with meaning and range."""
        described = {column.name: column for column in self.described}
        rows = []
        for name, values in self._read(self.columns).items():
            column = described.get(name, Column(name, "", "", ""))
            finite = values[np.isfinite(values)]
            span = [f"{value:.6g}" for value in (finite.min(), finite.max())] if finite.size else ["", ""]
            cells = (name, column.unit, column.frame, column.meaning, *span)
            rows.append(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>")
        head = "".join(f"<th>{title}</th>" for title in ("column", "unit", "frame", "meaning", "least", "greatest"))
        return f"<p><b>{len(self)} steps</b></p><table><tr>{head}</tr>{''.join(rows)}</table>"
