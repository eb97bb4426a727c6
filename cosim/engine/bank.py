"""The engines of a vehicle behind one ``step``: an FMU instance each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby

import cosim.engine._bank as _bank
from cosim.base.errors import EngineError
from cosim.base.protocols import Column
from cosim.base.signals import Ambient, EngineOutput, PerJet
from cosim.engine.fmu.air import Air
from cosim.engine.fmu.instance import FmuInstance, InstanceError
from cosim.engine.fmu.port_kinds import AMBIENT, SIDE_LOADS
from cosim.engine.fmu.unpacked import UnpackedArchive, unpack
from cosim.engine.response import ResponseError, settle
from cosim.engine.spec import EngineSpec


def make_log_columns(specs: Sequence[EngineSpec]) -> tuple[Column, ...]:
    """Return the log columns of all engines' further outputs, named by mapping file and engine number."""
    return (
        *(
            Column(f"{name}_{number}", unit, "jet", f"engine {number}: {meaning}, as it gives it")
            for number, spec in enumerate(specs, start=1)
            for port, (name, unit, meaning) in SIDE_LOAD_COLUMNS.items()
            if spec.has_port(port)
        ),
        *(
            Column(
                f"{name}_{number}",
                "" if variable.unit in (None, "1") else str(variable.unit),
                "",
                f"engine {number}: {variable.name}" + (f", {variable.description}" if variable.description else ""),
            )
            for number, spec in enumerate(specs, start=1)
            for name, variable in spec.logged_outputs
        ),
    )


SIDE_LOAD_COLUMNS = {  # log columns of loads beside thrust
    "force_forward": ("force_forward_N", "N", "force across the jet, forward while it is upright"),
    "force_right": ("force_right_N", "N", "force across the jet, to the right"),
    "torque": ("torque_Nm", "N m", "torque on the airframe about the jet's axis, right-handed along its thrust"),
}


class EngineBank:
    """Bank of ``count`` engines of one kind, or of one per given spec, stepped by ``step`` seconds.

    Raises InputError if an archive has changed since it was loaded, EngineError if an FMU does not start.
    """

    def __init__(self, spec: EngineSpec | Sequence[EngineSpec], count: int, step: float) -> None:
        self._specs = (spec,) * count if isinstance(spec, EngineSpec) else tuple(spec)
        if len(self._specs) != count:
            raise ValueError(f"{count} engines need as many specs, not {len(self._specs)}")
        self._step = step
        self._instances: list[FmuInstance] = []  # one instance per station
        self._folders: dict[tuple[str, int], UnpackedArchive] = {}
        self.wants_ambient = any(spec.has_port(port) for spec in self._specs for port in AMBIENT)
        self._native = _bank.Bank((), step, EngineOutput)
        self._last_output = EngineOutput((), (), (), ())
        self._was_reset = False
        try:
            self._create_instances()
        except BaseException:
            self.close()
            raise

    def _create_instances(self) -> None:
        for station, spec in enumerate(self._specs):
            # An FMU that allows one instance per process is loaded from copies, each of which is a library of its own.
            key = spec.sha256, station if spec.archive.once_per_process else -1
            if key not in self._folders:
                self._folders[key] = unpack(spec.archive)
            try:
                self._instances.append(FmuInstance(spec.archive, self._folders[key].path, f"engine {station + 1}"))
            except InstanceError as error:
                raise EngineError(f"{self._describe_engine(station)}: {error}") from error

    def _create_native_bank(self) -> None:
        rows = [instance.make_row() for instance in self._instances]
        self._native = _bank.Bank(tuple(rows), self._step, EngineOutput)

    def _describe_engine(self, station: int) -> str:
        return f"engine {station + 1} ({self._specs[station].path.name})"

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        """Bring each engine to equilibrium at the throttle, one for all or one each, ready for step 0.

        Without ``ambient`` each stands in the air it was measured in.  An engine without a start parameter is
        run there; its own time then is ahead of flight time by that run.

        Raises EngineError if an FMU refuses or does not settle.
        """
        if self._was_reset:
            # New instances are created, because many FMUs implement fmiReset wrongly.
            self._close_instances()
            self._create_instances()
        self._was_reset = True
        count = len(self._specs)
        throttles = tuple(throttle) if isinstance(throttle, Sequence) else (throttle,) * count
        airs = [spec.air for spec in self._specs]
        if ambient:
            airs = [Air(ambient.pressure, ambient.temperature, speed) for speed in ambient.air_speed]
        if len(throttles) != count or len(airs) != count:
            raise ValueError(f"{count} engines need as many throttles and air speeds")
        for station, air in enumerate(airs):
            self._initialize(station, throttles[station], air)
        self._create_native_bank()
        for station, spec in enumerate(self._specs):
            if spec.start is None:
                self._run_to_throttle(station, throttles[station])
        try:
            self._last_output = self._native.outputs()
            return self._last_output
        except _bank.FailureError as failure:
            raise self._describe_failure(failure, "at the start") from failure

    def _initialize(self, station: int, throttle: float, air: Air) -> None:
        spec = self._specs[station]
        settings = list(spec.settings)
        if spec.start is not None:
            port = spec.archive.ports["start"]
            settings.append((port.variable, port.value(throttle)))
        try:
            self._instances[station].initialize(settings, throttle, air, step=self._step)
        except InstanceError as error:
            raise EngineError(f"{self._describe_engine(station)}: {error}") from error

    def _run_to_throttle(self, station: int, throttle: float) -> None:
        def hold(constant: float, steps: int) -> list[float]:
            return self._native.hold(station, constant, steps)

        try:
            spec = self._specs[station]
            rest, span = spec.archive.starting.rest_n, abs(spec.curve.thrust[-1])
            settle(hold, throttle, spec.settling_window, self._step, spec.ripple, rest, span)
        except _bank.FailureError as failure:
            raise self._describe_failure(failure, "before the flight") from failure
        except ResponseError as error:
            raise EngineError(f"{self._describe_engine(station)}: {error}") from error

    def run_down(self, seconds: float) -> EngineOutput:
        """Step each engine with closed throttle before the flight, and return the final reports.

        Raises EngineError if an FMU fails.
        """
        steps = round(seconds / self._step)
        try:
            for station in range(len(self._specs)):
                self._native.hold(station, 0.0, steps)
            self._last_output = self._native.outputs()
        except _bank.FailureError as failure:
            raise self._describe_failure(failure, "before the flight") from failure
        return self._last_output

    def _describe_failure(self, failure: _bank.FailureError, moment: str) -> EngineError:
        station = failure.args[0]
        return EngineError(f"{self._describe_engine(station)}: {self._instances[station].explain(failure, moment)}")

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        """Advance all engines by flight step ``k`` with inputs held, and return the reports at its end.

        The ambient reaches the engines that have the ports; without one it is left as it is.

        Raises EngineError that names engine, step and time if an FMU fails or gives a value that is not finite;
        ValueError if ``k`` is not the next step.
        """
        if not self._was_reset and self._instances:  # else stepping raises the FMU's own error
            self._create_native_bank()
        try:
            output = self._native.step(k, throttle, ambient)
        except _bank.FailureError as failure:
            raise self._describe_failure(failure, self._describe_moment(k)) from failure
        self._last_output = output
        return output

    def follow(self, station: int, throttles: Iterable[float]) -> list[float]:
        """Step one engine with each of these throttles and return its thrusts [N], faster than :meth:`step`.

        Raises EngineError as that does.  A bank that has been stepped so is not stepped otherwise.
        """
        thrusts: list[float] = []
        try:
            for throttle, same in groupby(throttles):
                thrusts += self._native.hold(station, throttle, sum(1 for _ in same))
        except _bank.FailureError as failure:
            raise self._describe_failure(failure, self._describe_moment(len(thrusts))) from failure
        return thrusts

    def _describe_moment(self, k: int) -> str:
        return f"at step {k} ({k * self._step:g} s)"

    @property
    def columns(self) -> tuple[Column, ...]:
        """Log columns of the outputs that a mapping file adds to the log: see :class:`cosim.base.protocols.Shows`."""
        return make_log_columns(self._specs)

    @property
    def shown(self) -> tuple[float, ...]:
        """Values of :attr:`columns` in the FMU's units.  Raises EngineError if the FMU fails."""
        values = [
            getattr(self._last_output, port)[station]
            for station, spec in enumerate(self._specs)
            for port in SIDE_LOADS
            if spec.has_port(port)
        ]
        for station, spec in enumerate(self._specs):
            try:
                values += [self._instances[station].read(variable) for _, variable in spec.logged_outputs]
            except InstanceError as error:
                self._native.stop()
                raise EngineError(f"{self._describe_engine(station)}: {error}") from error
        return tuple(values)

    def set_run(self, index: int, on: bool) -> bool:
        """Switch one engine off or on before the next step; return False if it has no port for that.

        Raises EngineError if the FMU refuses.
        """
        try:
            return self._instances[index].set_run(on)
        except InstanceError as error:
            self._native.stop()
            raise EngineError(f"{self._describe_engine(index)}: {error}") from error

    def close(self) -> None:
        """Terminate and free the engines and close their files.  May be called again."""
        self._close_instances()
        for folder in self._folders.values():
            folder.close()
        self._folders.clear()

    def _close_instances(self) -> None:
        self._native = _bank.Bank((), self._step, EngineOutput)  # so that freed instances never step
        while self._instances:
            self._instances.pop().close()

    def __enter__(self) -> EngineBank:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
