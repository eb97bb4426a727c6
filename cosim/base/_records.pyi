from typing import TypeVar

T = TypeVar("T", bound=tuple[object, ...])

def quick(type: type[T], /) -> type[T]: ...
