from collections.abc import Sequence

LOGGER2: int
LOGGER3: int

class FailureError(Exception):
    args: tuple[int, str, int]  # engine's index, what failed, FMI status

class Log:
    @property
    def address(self) -> int: ...
    def take(self) -> str: ...

class Bank:
    def __init__(self, engines: Sequence[tuple[int, int, int, int, int, int, int, int]], step: float) -> None: ...
    def hold(self, index: int, throttle: float, count: int) -> list[float]: ...
    def step(self, k: int, throttles: tuple[float, ...]) -> tuple[float, ...]: ...
