"""When the faults of a flight begin and end; the engines, the servos and the sensors know what each does to them.

The controller is told of none of them.  A fault that begins at step ``k`` acts over that step and those that follow.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from math import radians

from cosim.base.constants import SENSORS, SERVOS
from cosim.base.errors import InputError
from cosim.base.signals import JETS, Measured
from cosim.engine.rundown import FlameOutLaw
from cosim.engine.wrappers import EngineChain
from cosim.spec.scenario import DelayGrowth, Fault, FlameOut, Scenario, SensorBias, SensorDropout, ServoJam
from cosim.vehicle.sensors import FaultySensors
from cosim.vehicle.servo import TiltServo

NEVER = sys.maxsize  # a step after the last one


class FaultSchedule:
    """Schedule of a flight's faults; ``next`` is the step of the next change.

    ``laws[i]``: how engine ``i``, from 0, goes out.  ``flags``: 1 where a fault acts, in the order of the log's
    columns.  ``commanded``: not all of them are the scenario's.
    Raises InputError for a fault of something that the vehicle has not.
    """

    def __init__(
        self,
        scenario: Scenario,
        engines: EngineChain,
        servos: Sequence[TiltServo],
        sensors: FaultySensors,
        laws: Sequence[FlameOutLaw | None],
        names: Sequence[str] = SERVOS,
        surfaces: int = 0,
    ) -> None:
        self._scenario = scenario
        self._engines, self._servos, self._sensors = engines, list(servos), sensors
        self._laws = list(laws)
        self._servo_names = list(names)  # servos in the order of the log's columns
        self._surfaces = self._servo_names[len(self._servo_names) - surfaces :]  # surfaces come last among the servos
        self._jets = max(len(self._laws), JETS)  # number of jets with columns in the log
        self._no_flags = (0.0,) * (self._jets + len(self._servo_names) + len(SENSORS))
        self.reset()

    def reset(self) -> None:
        """Return to the start of a flight, before the blocks do."""
        self._spans: list[tuple[int, int, Fault]] = []
        self._acting: list[Fault] = []
        self._jams: list[ServoJam | None] = [None] * len(self._servos)
        self.flags = self._no_flags
        self.commanded = False
        self.next = NEVER
        for index, fault in enumerate(self._scenario.fault):
            self._schedule_fault(fault, f"fault.{index}")

    def _schedule_fault(self, fault: Fault, where: str) -> None:
        self._check_fault(fault, where)
        scenario = self._scenario
        start = scenario.count(fault.start_s, f"{where}.start_s")
        end = NEVER
        if fault.duration_s is not None:
            end = start + scenario.count(fault.duration_s, f"{where}.duration_s")
        self._spans.append((start, end, fault))
        self.next = min(self.next, start)

    def _check_fault(self, fault: Fault, where: str) -> None:
        name = f"scenario {self._scenario.name}: {where}"
        if isinstance(fault, ServoJam):
            if not self._servos:
                raise InputError(f"{name}.servo: {self._scenario.aircraft_name} has no tilt servos")
            if fault.servo not in self._servo_names:
                known = ", ".join(self._servo_names)
                raise InputError(
                    f"{name}.servo = {fault.servo!r}: {self._scenario.aircraft_name} has the servos {known}"
                )
            if fault.angle_deg is not None and fault.servo in self._surfaces:
                raise InputError(f"{name}.angle_deg: {fault.servo} is a surface: it jams where it stands; leave it out")
        elif not isinstance(fault, (SensorBias, SensorDropout)) and max(fault.jet) > len(self._laws):
            raise InputError(
                f"{name}.jet = {max(fault.jet)}: {self._scenario.aircraft_name} has jets 1 to {len(self._laws)}"
            )
        if isinstance(fault, FlameOut):
            without_law = [jet for jet in fault.jet if self._laws[jet - 1] is None]
            if without_law:
                raise InputError(
                    f"{name}: the engine at jet {without_law[0]} has no port run and states no [flame_out]: "
                    "nobody knows what it gives without fire; map run, or state [flame_out] in its mapping file"
                )
        if isinstance(fault, DelayGrowth):
            self._scenario.count(fault.delay_s, f"{where}.delay_s")

    def inject(self, fault: Fault, k: int) -> None:
        """Begin ``fault`` at step ``k``, whatever its ``start_s``."""
        self._schedule_fault(fault.model_copy(update={"start_s": k * self._scenario.step_s}), "inject")
        self.next, self.commanded = min(self.next, k), True

    def clear(self, k: int) -> None:
        """End all active faults at step ``k``, and those due then; later ones stay."""
        self._spans = [
            (start, end if start > k else min(end, k), fault) for start, end, fault in self._spans if start != k
        ]
        self.next, self.commanded = k, True

    @property
    def flown_faults(self) -> list[Fault]:
        """Faults with their times, those of commanded faults included."""
        dt = self._scenario.step_s
        return [
            fault if end == NEVER else fault.model_copy(update={"duration_s": (end - start) * dt})
            for start, end, fault in self._spans
        ]

    def update(self, k: int, measured: Measured) -> None:
        """Begin and end the faults due at step ``k``; ``measured`` is the last measurement."""
        if k >= self.next:
            self._update_active_faults(k, measured)

    def _update_active_faults(self, k: int, measured: Measured) -> None:
        due = [fault for start, end, fault in self._spans if start <= k < end]
        for fault in [fault for fault in self._acting if not any(fault is other for other in due)]:
            self._end_fault(fault)
        for fault in due:
            if not any(fault is other for other in self._acting):
                self._begin_fault(fault, measured)
        self._acting = due
        self._update_jams()
        self.flags = self._flags_of(due) if due else self._no_flags
        times = [time for start, end, _ in self._spans for time in (start, end) if time > k]
        self.next = min(times, default=NEVER)

    def _begin_fault(self, fault: Fault, measured: Measured) -> None:
        if isinstance(fault, (SensorBias, SensorDropout)):
            self._sensors.begin(fault, measured)
        elif not isinstance(fault, ServoJam):
            self._engines.begin_fault(fault)

    def _end_fault(self, fault: Fault) -> None:
        if isinstance(fault, (SensorBias, SensorDropout)):
            self._sensors.end(fault)
        elif not isinstance(fault, ServoJam):
            self._engines.end_fault(fault)

    def _update_jams(self) -> None:
        """Jam each servo by its first active fault, and release the others at their present angles."""
        for i, servo in enumerate(self._servos):
            jams = [
                fault for fault in self._acting if isinstance(fault, ServoJam) and fault.servo == self._servo_names[i]
            ]
            jam = jams[0] if jams else None
            if jam is self._jams[i]:
                continue
            if jam is None:
                servo.release()
            else:
                servo.jam(None if jam.angle_deg is None else radians(jam.angle_deg))
            self._jams[i] = jam

    def _flags_of(self, acting: Sequence[Fault]) -> tuple[float, ...]:
        """Return 1 for every jet, servo and sensor that a fault acts on, in the order of the log's columns."""
        flags = list(self._no_flags)
        for fault in acting:
            if isinstance(fault, ServoJam):
                flags[self._jets + self._servo_names.index(fault.servo)] = 1.0
            elif isinstance(fault, (SensorBias, SensorDropout)):
                flags[self._jets + len(self._servo_names) + SENSORS.index(fault.sensor)] = 1.0
            else:
                for jet in fault.jet:
                    flags[jet - 1] = 1.0
        return tuple(flags)
