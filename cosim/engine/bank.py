"""All engines of a vehicle, stepped together: six separate FMU instances behind ``reset / step / close``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType

from cosim.engine import _bank
from cosim.engine.archive import unpack
from cosim.engine.response import ResponseError, settle
from cosim.engine.slave import Slave, SlaveError
from cosim.engine.spec import EngineSpec
from cosim.errors import EngineError


class EngineBank:
    """``count`` engines of one kind, or one per entry of a sequence of specs, stepped by ``step`` seconds.

    Raises InputError if an archive has changed since it was loaded, EngineError if an FMU does not start.
    """

    def __init__(self, spec: EngineSpec | Sequence[EngineSpec], count: int, step: float) -> None:
        self._specs = (spec,) * count if isinstance(spec, EngineSpec) else tuple(spec)
        if len(self._specs) != count:
            raise ValueError(f"{count} engines need as many specs, not {len(self._specs)}")
        self._step = step
        self._slaves: list[Slave] = []
        self._folders: dict[tuple[str, int], TemporaryDirectory[str]] = {}
        self._native = _bank.Bank([], step)
        self._used = False
        try:
            self._instantiate()
        except BaseException:
            self.close()
            raise

    def _instantiate(self) -> None:
        for index, spec in enumerate(self._specs):
            # an FMU that may be instantiated once per process is loaded from copies: another file, another library
            key = spec.sha256, index if spec.archive.once_per_process else -1
            if key not in self._folders:
                self._folders[key] = unpack(spec.archive)
            try:
                self._slaves.append(Slave(spec.archive, Path(self._folders[key].name), f"engine {index + 1}"))
            except SlaveError as error:
                raise EngineError(f"{self._label(index)}: {error}") from error
        self._native = _bank.Bank([slave.row() for slave in self._slaves], self._step)

    def _label(self, index: int) -> str:
        return f"engine {index + 1} ({self._specs[index].path.name})"

    def reset(self, throttle: float) -> tuple[float, ...]:
        """Bring every engine to equilibrium at ``throttle``, ready for flight step 0, and return the thrusts [N].

        An engine without a start parameter is run there; its own time then is ahead of flight time by that run.
        Raises EngineError if an FMU refuses or does not settle.
        """
        if self._used:
            # fresh instances, because fmiReset is what many FMUs get wrong
            self._close_slaves()
            self._instantiate()
        self._used = True
        return tuple(self._start(index, throttle) for index in range(len(self._specs)))

    def _start(self, index: int, throttle: float) -> float:
        thrust = self._initialize(index, throttle)
        return thrust if self._specs[index].start is not None else self._run_up(index, throttle)

    def _initialize(self, index: int, throttle: float) -> float:
        spec = self._specs[index]
        settings = list(spec.settings)
        if spec.start is not None:
            settings.append((spec.archive.parameter(spec.start), throttle))
        try:
            return self._slaves[index].initialize(settings, throttle)
        except SlaveError as error:
            raise EngineError(f"{self._label(index)}: {error}") from error

    def _run_up(self, index: int, throttle: float) -> float:
        def hold(held: float, steps: int) -> list[float]:
            return self._native.hold(index, held, steps)

        try:
            return settle(hold, throttle, self._specs[index].window, self._step)
        except _bank.FailureError as failure:
            what = self._slaves[index].explain(failure, "before the flight")
            raise EngineError(f"{self._label(index)}: {what}") from failure
        except ResponseError as error:
            raise EngineError(f"{self._label(index)}: {error}") from error

    def step(self, k: int, throttle: tuple[float, ...]) -> tuple[float, ...]:
        """Advance all engines over flight step ``k`` with the throttles held; returns the thrusts [N] at its end.

        Raises EngineError that names engine, step and time if an FMU fails or gives a thrust that is not finite;
        ValueError if ``k`` is not the next step.
        """
        try:
            return self._native.step(k, throttle)
        except _bank.FailureError as failure:
            index = failure.args[0]
            what = self._slaves[index].explain(failure, f"at step {k} ({k * self._step:g} s)")
            raise EngineError(f"{self._label(index)}: {what}") from failure

    def close(self) -> None:
        """Terminate and free the engines and remove their files.  May be called again."""
        self._close_slaves()
        for folder in self._folders.values():
            folder.cleanup()
        self._folders.clear()

    def _close_slaves(self) -> None:
        self._native = _bank.Bank([], self._step)  # nothing may step what is being freed
        while self._slaves:
            self._slaves.pop().close()

    def __enter__(self) -> EngineBank:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
