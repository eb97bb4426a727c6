from collections.abc import Iterable
from typing import TypeVar

T = TypeVar("T", bound=tuple[object, ...])

def quick(type: type[T], /) -> type[T]: ...
def within(values: Iterable[float], count: int, low: float, high: float, /) -> tuple[float, ...] | None: ...
