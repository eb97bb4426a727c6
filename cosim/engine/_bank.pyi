from collections.abc import Sequence

from cosim.base.signals import Ambient, EngineOutput

LOGGER2: int
LOGGER3: int

Block = tuple[int, int, tuple[int, ...], tuple[float, ...], int, int]
Place = tuple[int, int, float, float, float, float]
Row = tuple[
    int,
    int,
    int,
    int,
    tuple[Block, ...],
    tuple[Block, ...],
    tuple[Place | None, ...],
    tuple[Place | None, ...],
    tuple[float, ...],
]

class FailureError(Exception):
    args: tuple[int, str, int, str]  # engine's index, what failed, FMI status, port

class Log:
    @property
    def address(self) -> int: ...
    def take(self) -> str: ...

class Bank:
    def __init__(self, engines: Sequence[Row], step: float, record: type[EngineOutput] = ...) -> None: ...
    def hold(self, index: int, throttle: float, count: int) -> list[float]: ...
    def outputs(self) -> EngineOutput: ...
    def step(self, k: int, throttles: tuple[float, ...], ambient: Ambient | None) -> EngineOutput: ...
    def stop(self) -> None: ...
