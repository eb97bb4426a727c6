"""What a process found out once and need not find out again, for as long as nothing that it depends on is another."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

T = TypeVar("T")  # type of the cached values


class RecentCache(Generic[T]):
    """Cache of the ``capacity`` most recently used results, by keys with everything that a result depends on.

    Of a file that is its contents, never its name or date alone.  A result is given out again and again: whoever gets
    it must not change it.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._values: OrderedDict[Hashable, T] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value for ``key``, or compute and store it with ``make``; exceptions are not stored."""
        try:
            value = self._values.pop(key)
        except KeyError:
            value = make()
        self._values[key] = value  # reinserted: most recently used is last
        while len(self._values) > self._capacity:
            self._values.popitem(last=False)
        return value
