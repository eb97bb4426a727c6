"""All engines of a vehicle, stepped together: six separate FMU instances behind ``reset / step / close``."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType

import cosim.engine._bank as _bank
from cosim.base.errors import EngineError
from cosim.base.protocols import Column
from cosim.base.signals import Ambient, EngineOutput, PerJet
from cosim.engine.instance import Slave, SlaveError
from cosim.engine.ports import AMBIENT, Air
from cosim.engine.response import ResponseError, settle
from cosim.engine.spec import EngineSpec
from cosim.engine.starting import Ignition, StartError
from cosim.engine.system_slave import make_slave
from cosim.engine.unpacked import Unpacked, unpack


def logged_columns(specs: Sequence[EngineSpec], in_flight: bool = False) -> tuple[Column, ...]:
    """A column for each further output of each engine: its name in the mapping file and the engine's number.

    Before them, where engines start ``in_flight``, whether each has yet to do so.
    """
    starting = [
        Column(f"starting_{number}", "0/1", "", f"engine {number}: its start has yet to end")
        for number, _ in enumerate(specs, start=1)
        if in_flight
    ]
    return (
        *starting,
        *(
            Column(
                f"{name}_{number}",
                "" if variable.unit in (None, "1") else str(variable.unit),
                "",
                f"engine {number}: {variable.name}" + (f", {variable.description}" if variable.description else ""),
            )
            for number, spec in enumerate(specs, start=1)
            for name, variable in spec.logged
        ),
    )


class EngineBank:
    """``count`` engines of one kind, or one per entry of a sequence of specs, stepped by ``step`` seconds.

    ``in_flight``: engines whose mapping file states a start stand cold after a reset, and go through it over the steps
    that follow, whatever throttle these ask for; :attr:`starting` says which still do.

    Raises InputError if an archive has changed since it was loaded, EngineError if an FMU does not start.
    """

    def __init__(
        self, spec: EngineSpec | Sequence[EngineSpec], count: int, step: float, in_flight: bool = False
    ) -> None:
        self._specs = (spec,) * count if isinstance(spec, EngineSpec) else tuple(spec)
        if len(self._specs) != count:
            raise ValueError(f"{count} engines need as many specs, not {len(self._specs)}")
        self._step = step
        self._in_flight = in_flight
        self._starts: dict[int, Ignition] = {}  # of the engines that have yet to start
        self._given_up: set[int] = set()  # of them those that were shut off meanwhile
        self._slaves: list[Slave] = []
        self._folders: dict[tuple[str, int], Unpacked] = {}
        self.wants_ambient = any(each.has(port) for each in self._specs for port in AMBIENT)
        self._native = _bank.Bank((), step, EngineOutput)
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
                self._slaves.append(make_slave(spec.archive, self._folders[key].path, f"engine {index + 1}"))
            except SlaveError as error:
                raise EngineError(f"{self._label(index)}: {error}") from error
        self._hand_over()

    def _hand_over(self) -> None:
        self._native = _bank.Bank(tuple(slave.row() for slave in self._slaves), self._step, EngineOutput)

    def _label(self, index: int) -> str:
        return f"engine {index + 1} ({self._specs[index].path.name})"

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        """Bring every engine to equilibrium at the throttle, one for all or one each, ready for flight step 0.

        Without ``ambient`` each stands in the air it was measured in.  An engine without a start parameter is
        run there; its own time then is ahead of flight time by that run.

        Raises EngineError if an FMU refuses or does not settle.
        """
        if self._used:
            # fresh instances, because fmiReset is what many FMUs get wrong
            self._close_slaves()
            self._instantiate()
        self._used = True
        count = len(self._specs)
        throttles = tuple(throttle) if isinstance(throttle, Sequence) else (throttle,) * count
        airs = [spec.air for spec in self._specs]
        if ambient:
            airs = [Air(ambient.pressure, ambient.temperature, speed) for speed in ambient.air_speed]
        if len(throttles) != count or len(airs) != count:
            raise ValueError(f"{count} engines need as many throttles and air speeds")
        self._starts = {
            index: Ignition(spec.archive.starting.stages, self._step)
            for index, spec in enumerate(self._specs)
            if self._in_flight and spec.archive.starting.stages
        }
        self._given_up = set()
        for index, (held, air) in enumerate(zip(throttles, airs, strict=True)):
            self._initialize(index, held, air)
        self._hand_over()
        for index, held in enumerate(throttles):
            if self._specs[index].start is None and index not in self._starts:
                self._run_up(index, held)
        self._advance("at the start")
        try:
            return self._native.outputs()
        except _bank.FailureError as failure:
            raise self._failed(failure, "at the start") from failure

    def _initialize(self, index: int, throttle: float, air: Air) -> None:
        spec = self._specs[index]
        settings = list(spec.settings)
        cold = index in self._starts
        if cold:
            throttle = self._starts[index].throttle
        if spec.start is not None:
            port = spec.archive.ports["start"]
            settings.append((port.variable, port.value(throttle)))
        try:
            self._slaves[index].initialize(settings, throttle, air, step=self._step, cold=cold)
        except SlaveError as error:
            raise EngineError(f"{self._label(index)}: {error}") from error

    def _run_up(self, index: int, throttle: float) -> None:
        def hold(held: float, steps: int) -> list[float]:
            return self._native.hold(index, held, steps)

        try:
            spec = self._specs[index]
            settle(hold, throttle, spec.window, self._step, spec.quiet, spec.archive.starting.rest_n)
        except _bank.FailureError as failure:
            raise self._failed(failure, "before the flight") from failure
        except ResponseError as error:
            raise EngineError(f"{self._label(index)}: {error}") from error

    def _failed(self, failure: _bank.FailureError, moment: str) -> EngineError:
        index = failure.args[0]
        return EngineError(f"{self._label(index)}: {self._slaves[index].explain(failure, moment)}")

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        """Advance all engines over flight step ``k``, inputs held, and return what they report at its end.

        The ambient reaches the engines that have the ports; without one it is left as it is.

        Raises EngineError that names engine, step and time if an FMU fails or gives a value that is not finite;
        ValueError if ``k`` is not the next step.
        """
        if self._starts:
            held = list(throttle)
            for index, ignition in self._starts.items():
                held[index] = 0.0 if index in self._given_up else ignition.throttle
            throttle = tuple(held)
        moment = f"at step {k} ({k * self._step:g} s)"
        try:
            output = self._native.step(k, throttle, ambient)
        except _bank.FailureError as failure:
            raise self._failed(failure, moment) from failure
        if self._starts:
            self._advance(moment)
        return output

    def _advance(self, moment: str) -> None:
        """Every start by the step to come; who has none left has started."""
        for index in [index for index in self._starts if index not in self._given_up]:
            slave = self._slaves[index]
            try:
                more = self._starts[index].advance(slave.write, slave.read)
            except (SlaveError, StartError) as error:
                self._native.stop()
                raise EngineError(f"{self._label(index)}: {error} {moment}") from error
            if not more:
                del self._starts[index]

    @property
    def starting(self) -> tuple[int, ...]:
        """The engines, counted from 1, that have yet to start."""
        return tuple(index + 1 for index in self._starts)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Further outputs that a mapping file wants in the log: :class:`cosim.base.protocols.Shows`."""
        return logged_columns(self._specs, self._in_flight)

    @property
    def shown(self) -> tuple[float, ...]:
        """What they are now, in the FMU's own unit.  Raises EngineError if the FMU refuses."""
        found = [float(index in self._starts) for index in range(len(self._specs)) if self._in_flight]
        for index, (slave, spec) in enumerate(zip(self._slaves, self._specs, strict=True)):
            try:
                found += [slave.read(variable) for _, variable in spec.logged]
            except SlaveError as error:
                self._native.stop()
                raise EngineError(f"{self._label(index)}: {error}") from error
        return tuple(found)

    def set_run(self, index: int, on: bool) -> bool:
        """Shut one engine off, or on again, before the next step; False if it has no port for that.

        One that is shut off before it has started does not start any more.  Raises EngineError if the FMU refuses.
        """
        if index in self._starts:
            self._given_up.add(index)
        try:
            return self._slaves[index].set_run(on)
        except SlaveError as error:
            self._native.stop()
            raise EngineError(f"{self._label(index)}: {error}") from error

    def close(self) -> None:
        """Terminate and free the engines and let go of their files.  May be called again."""
        self._close_slaves()
        for folder in self._folders.values():
            folder.close()
        self._folders.clear()

    def _close_slaves(self) -> None:
        self._native = _bank.Bank((), self._step, EngineOutput)  # nothing may step what is being freed
        while self._slaves:
            self._slaves.pop().close()

    def __enter__(self) -> EngineBank:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
