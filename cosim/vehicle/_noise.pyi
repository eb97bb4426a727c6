from typing import Any

from cosim.base.arrays import Array
from cosim.base.signals import State, Vector3

class Noise:
    def __init__(
        self,
        gyro: tuple[float, Vector3],
        attitude: tuple[float, Vector3],
        gnss: tuple[float, float],
        height: tuple[float, float],
        force: tuple[float, Vector3],
        share: float,
        /,
    ) -> None: ...
    @property
    def left(self) -> int: ...
    def fill(self, draws: Array, force_draws: Array, /) -> None: ...
    def sample(self, state: State, filtered: Any, fix: bool, /) -> tuple[Any, Any, Any, Any, Any, Any]: ...
