"""The engines of a vehicle behind one ``step``: FMU instances, each of one engine or of several."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from itertools import groupby

import cosim.engine._bank as _bank
from cosim.base.errors import EngineError
from cosim.base.protocols import Column
from cosim.base.signals import Ambient, EngineOutput, PerJet
from cosim.engine.fmu.air import Air
from cosim.engine.fmu.instance import FmuInstance, InstanceError
from cosim.engine.fmu.port_kinds import AMBIENT, ASIDE
from cosim.engine.fmu.starting import Ignition, StartError
from cosim.engine.fmu.unpacked import UnpackedArchive, unpack
from cosim.engine.response import ResponseError, settle
from cosim.engine.spec import EngineSpec


def make_log_columns(specs: Sequence[EngineSpec], in_flight: bool = False) -> tuple[Column, ...]:
    """Return the log columns of all engines' further outputs, named by mapping file and engine number.

    With ``in_flight`` they are preceded by a column for each engine that is 1 until its start has ended.
    """
    starting = [
        Column(f"starting_{number}", "0/1", "", f"engine {number}: its start has yet to end")
        for number, _ in enumerate(specs, start=1)
        if in_flight
    ]
    return (
        *starting,
        *(
            Column(f"{name}_{number}", unit, "jet", f"engine {number}: {meaning}, as it gives it")
            for number, spec in enumerate(specs, start=1)
            for port, (name, unit, meaning) in ASIDE_COLUMNS.items()
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


ASIDE_COLUMNS = {
    "force_forward": ("force_forward_N", "N", "force across the jet, forward while it is upright"),
    "force_right": ("force_right_N", "N", "force across the jet, to the right"),
    "torque": ("torque_Nm", "N m", "torque on the airframe about the jet's axis, right-handed along its thrust"),
}


def group_stations(specs: Sequence[EngineSpec]) -> list[list[int]]:
    """Group stations by FMU instance: for each instance the station of each of its engines, from 0, or -1.

    An FMU that holds several serves as many stations that follow each other, where these have the same engine with the
    same parameters; what stands there besides has an instance of its own.
    """
    groups: dict[Hashable, list[int]] = {}
    for station, spec in enumerate(specs):
        count = len(spec.archive.engines)
        key = (spec.instance_key, station - spec.slot) if count > 1 else station
        groups.setdefault(key, [-1] * count)[spec.slot] = station
    return list(groups.values())


def _engine_numbers(group: Sequence[int]) -> str:
    """Return the numbers of an instance's engines for messages, counted from 1."""
    served = [station + 1 for station in group if station >= 0]
    if len(served) > 2 and served[-1] - served[0] == len(served) - 1:
        return f"engines {served[0]} to {served[-1]}"
    return f"engine{'s' if len(served) > 1 else ''} {', '.join(map(str, served))}"


class EngineBank:
    """``count`` engines of one kind, or one per entry of a sequence of specs, stepped by ``step`` seconds.

    Stations whose engines are held by one FMU (:attr:`EngineSpec.slot`) share an instance, as many as it holds; an
    engine that serves no station has throttle 0, or, where one engine alone is asked for, that of the reset.

    ``in_flight``: engines whose mapping file states a start stand cold after a reset, and go through it over the steps
    that follow, whatever throttle these ask for; :attr:`starting_engines` says which still do.

    Raises InputError if an archive has changed since it was loaded, EngineError if an FMU does not start.
    """

    def __init__(
        self, spec: EngineSpec | Sequence[EngineSpec], count: int, step: float, in_flight: bool = False
    ) -> None:
        if isinstance(spec, EngineSpec):
            self._specs = (spec,) if count == 1 else tuple(spec.at_station(station) for station in range(count))
        else:
            self._specs = tuple(spec)
        if len(self._specs) != count:
            raise ValueError(f"{count} engines need as many specs, not {len(self._specs)}")
        self._groups = group_stations(self._specs)
        self._instance_index = {
            station: index for index, group in enumerate(self._groups) for station in group if station >= 0
        }
        self._step = step
        self._in_flight = in_flight
        self._starts: dict[int, Ignition] = {}  # by instance, of those that have yet to start
        self._cancelled: set[int] = set()  # stations that were shut off before they had started
        self._instances: list[FmuInstance] = []
        self._folders: dict[tuple[str, int], UnpackedArchive] = {}
        self.wants_ambient = any(spec.has_port(port) for spec in self._specs for port in AMBIENT)
        self._native = _bank.Bank((), step, EngineOutput)
        self._last_output = EngineOutput((), (), (), ())
        self._was_reset = False
        try:
            self._instantiate()
        except BaseException:
            self.close()
            raise

    def _instantiate(self) -> None:
        for index, group in enumerate(self._groups):
            spec, label = self._first_spec(index), self._label(index)
            # An FMU that may be instantiated once per process is loaded from copies, each of which is a library.
            key = spec.sha256, index if spec.archive.once_per_process else -1
            if key not in self._folders:
                self._folders[key] = unpack(spec.archive)
            try:
                self._instances.append(FmuInstance(spec.archive, self._folders[key].path, _engine_numbers(group)))
            except InstanceError as error:
                raise EngineError(f"{label}: {error}") from error

    def _make_native(self) -> None:
        rows = [instance.make_row(0, group) for instance, group in zip(self._instances, self._groups, strict=True)]
        self._native = _bank.Bank(tuple(rows), self._step, EngineOutput)

    def _first_spec(self, index: int) -> EngineSpec:
        """Return the spec of the first station that an instance serves."""
        return self._specs[self._stations(index)[0]]

    def _label(self, index: int) -> str:
        return f"{_engine_numbers(self._groups[index])} ({self._first_spec(index).path.name})"

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        """Bring every engine to equilibrium at the throttle, one for all or one each, ready for flight step 0.

        Without ``ambient`` each stands in the air it was measured in.  An engine without a start parameter is
        run there; its own time then is ahead of flight time by that run.

        Raises EngineError if an FMU refuses or does not settle.
        """
        if self._was_reset:
            # New instances are made, because many FMUs get fmiReset wrong.
            self._close_instances()
            self._instantiate()
        self._was_reset = True
        count = len(self._specs)
        throttles = tuple(throttle) if isinstance(throttle, Sequence) else (throttle,) * count
        airs = [spec.air for spec in self._specs]
        if ambient:
            airs = [Air(ambient.pressure, ambient.temperature, speed) for speed in ambient.air_speed]
        if len(throttles) != count or len(airs) != count:
            raise ValueError(f"{count} engines need as many throttles and air speeds")
        self._starts = {
            index: Ignition(stages, self._step)
            for index in range(len(self._groups))
            if self._in_flight and (stages := self._first_spec(index).archive.starting.stages)
        }
        self._cancelled = set()
        for index, group in enumerate(self._groups):
            idle = throttles[0] if count == 1 else 0.0
            at = self._stations(index)[0]
            self._initialize(
                index,
                [throttles[station] if station >= 0 else idle for station in group],
                [airs[station if station >= 0 else at] for station in group],
            )
        self._make_native()
        for index in range(len(self._groups)):
            if self._first_spec(index).start is None and index not in self._starts:
                for station in self._stations(index):
                    self._run_up(station, throttles[station])
        self._advance_starts("at the start")
        try:
            self._last_output = self._native.outputs()
            return self._last_output
        except _bank.FailureError as failure:
            raise self._describe_failure(failure, "at the start") from failure

    def _initialize(self, index: int, throttles: Sequence[float], airs: Sequence[Air]) -> None:
        spec = self._first_spec(index)
        settings = list(spec.settings)
        cold = index in self._starts
        if cold:
            throttles = [self._starts[index].throttle] * len(throttles)
        if spec.start is not None:
            port = spec.archive.ports["start"]
            settings.append((port.variable, port.value(throttles[0])))
        try:
            self._instances[index].initialize(settings, throttles, airs, step=self._step, cold=cold)
        except InstanceError as error:
            raise EngineError(f"{self._label(index)}: {error}") from error

    def _run_up(self, station: int, throttle: float) -> None:
        def hold(constant: float, steps: int) -> list[float]:
            return self._native.hold(station, constant, steps)

        try:
            spec = self._specs[station]
            rest, span = spec.archive.starting.rest_n, abs(spec.curve.thrust[-1])
            settle(hold, throttle, spec.settling_window, self._step, spec.quiet, rest, span)
        except _bank.FailureError as failure:
            raise self._describe_failure(failure, "before the flight") from failure
        except ResponseError as error:
            raise EngineError(f"{self._engine_label(station)}: {error}") from error

    def run_down(self, seconds: float) -> EngineOutput:
        """Step every engine with its throttle closed before the flight, and return what they report then.

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

    def _engine_label(self, station: int) -> str:
        return f"engine {station + 1} ({self._specs[station].path.name})"

    def _describe_failure(self, failure: _bank.FailureError, moment: str) -> EngineError:
        station, what, *_ = failure.args
        index = self._instance_index[station]
        label = self._engine_label(station) if what in ("nan", "input") else self._label(index)
        return EngineError(f"{label}: {self._instances[index].explain(failure, moment)}")

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        """Advance all engines over flight step ``k``, inputs held, and return what they report at its end.

        The ambient reaches the engines that have the ports; without one it is left as it is.

        Raises EngineError that names engine, step and time if an FMU fails or gives a value that is not finite;
        ValueError if ``k`` is not the next step.
        """
        if self._starts:
            throttles = list(throttle)
            for index, ignition in self._starts.items():
                for station in self._stations(index):
                    throttles[station] = 0.0 if station in self._cancelled else ignition.throttle
            throttle = tuple(throttles)
        if not self._was_reset and self._instances:  # it is the FMU that refuses to step then
            self._make_native()
        try:
            output = self._native.step(k, throttle, ambient)
        except _bank.FailureError as failure:
            raise self._describe_failure(failure, self._moment(k)) from failure
        if self._starts:
            self._advance_starts(self._moment(k))
        self._last_output = output
        return output

    def follow(self, station: int, throttles: Iterable[float]) -> list[float]:
        """Step one engine with each of these throttles, and return its thrusts [N]: as :meth:`step`, far quicker.

        Raises EngineError as that does.  A bank that has been stepped so is not stepped otherwise.
        """
        thrusts: list[float] = []
        try:
            for throttle, same in groupby(throttles):
                thrusts += self._native.hold(station, throttle, sum(1 for _ in same))
        except _bank.FailureError as failure:
            raise self._describe_failure(failure, self._moment(len(thrusts))) from failure
        return thrusts

    def _moment(self, k: int) -> str:
        return f"at step {k} ({k * self._step:g} s)"

    def _stations(self, index: int) -> list[int]:
        return [station for station in self._groups[index] if station >= 0]

    def _advance_starts(self, moment: str) -> None:
        """Advance every start sequence by one step, and remove those that have ended."""
        for index in [index for index in self._starts if not self._cancelled.issuperset(self._stations(index))]:
            instance = self._instances[index]
            try:
                more = self._starts[index].advance(instance.write, instance.read)
            except (InstanceError, StartError) as error:
                self._native.stop()
                raise EngineError(f"{self._label(index)}: {error} {moment}") from error
            if not more:
                del self._starts[index]

    @property
    def starting_engines(self) -> tuple[int, ...]:
        """Numbers of the engines, counted from 1, whose start has yet to end."""
        return tuple(sorted(station + 1 for index in self._starts for station in self._stations(index)))

    @property
    def columns(self) -> tuple[Column, ...]:
        """Further outputs that a mapping file adds to the log: :class:`cosim.base.protocols.Shows`."""
        return make_log_columns(self._specs, self._in_flight)

    @property
    def shown(self) -> tuple[float, ...]:
        """Present values of :attr:`columns` in the FMU's own units; raises EngineError if the FMU fails."""
        values = [
            float(self._instance_index[station] in self._starts)
            for station in range(len(self._specs))
            if self._in_flight
        ]
        values += [
            getattr(self._last_output, port)[station]
            for station, spec in enumerate(self._specs)
            for port in ASIDE
            if spec.has_port(port)
        ]
        for station, spec in enumerate(self._specs):
            try:
                instance = self._instances[self._instance_index[station]]
                values += [instance.read(variable) for _, variable in spec.logged_outputs]
            except InstanceError as error:
                self._native.stop()
                raise EngineError(f"{self._engine_label(station)}: {error}") from error
        return tuple(values)

    def set_run(self, index: int, on: bool) -> bool:
        """Switch one engine off or on before the next step, and return False if it has no port for that.

        One that is shut off before it has started does not start any more.  Raises EngineError if the FMU refuses.
        """
        if self._instance_index[index] in self._starts:
            self._cancelled.add(index)
        try:
            return self._instances[self._instance_index[index]].set_run(on, self._specs[index].slot)
        except InstanceError as error:
            self._native.stop()
            raise EngineError(f"{self._engine_label(index)}: {error}") from error

    def close(self) -> None:
        """Terminate and free the engines and let go of their files.  May be called again."""
        self._close_instances()
        for folder in self._folders.values():
            folder.close()
        self._folders.clear()

    def _close_instances(self) -> None:
        self._native = _bank.Bank((), self._step, EngineOutput)  # nothing may step an instance that is being freed
        while self._instances:
            self._instances.pop().close()

    def __enter__(self) -> EngineBank:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
