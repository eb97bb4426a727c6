from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

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
    def read(self, first: int, out: NDArray[np.float64], /) -> None: ...
    def clear(self) -> None: ...
