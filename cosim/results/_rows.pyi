from collections.abc import Callable

from cosim.base.signals import Sample

class Rows:
    def __init__(
        self,
        capacity: int,
        patience: float,
        hand_on: Callable[[Rows], object],
        width: int,
        nodes: list[tuple[str, int, int, int, bool]],
        reads: list[tuple[int, int, int, int, int, int, bool]],
        /,
    ) -> None: ...
    def __len__(self) -> int: ...
    def add(self, sample: Sample, /) -> None: ...
    def __buffer__(self, flags: int, /) -> memoryview: ...
    def clear(self) -> None: ...
