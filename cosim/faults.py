"""Faults, each where it happens: on the throttle before an engine, on its thrust, on a servo, on a sensor.

The controller is told of none of them.  A fault that begins at step ``k`` acts over that step and those that follow.
Blocks are wrapped only from the first fault on, so that a flight without faults is what it is without this module.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Collection, Sequence
from math import exp, radians, sqrt
from typing import Protocol

from cosim.errors import InputError
from cosim.frames import multiply, normalize
from cosim.rundown import Burning, FlameOutLaw
from cosim.scenario import (
    DelayGrowth,
    Fault,
    FlameOut,
    Scenario,
    SensorBias,
    SensorDropout,
    ServoJam,
    SlowSpool,
    StuckThrottle,
    ThrustLoss,
)
from cosim.sensors import SensorSuite
from cosim.servo import TiltServo
from cosim.signals import JETS, NO_FAULTS, Ambient, EngineOutput, Measured, PerJet, State, Vector3

NEVER = sys.maxsize
SERVOS = ("left", "right")
SENSORS = ("gyro", "attitude", "gnss", "barometer")


class Engines(Protocol):
    """What a flight needs of its engines."""

    wants_ambient: bool

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput: ...

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput: ...

    def set_run(self, index: int, on: bool) -> bool: ...

    def close(self) -> None: ...


class _Stuck:
    """The throttle stays at ``at``, or at the command of its first step."""

    def __init__(self, at: float | None) -> None:
        self._at = at

    def throttle(self, command: float) -> float:
        if self._at is None:
            self._at = command
        return self._at


class _Late:
    """The command arrives ``samples`` later; until the first late one arrives the first one is held."""

    def __init__(self, samples: int) -> None:
        self._line: deque[float] = deque()
        self._samples = samples

    def throttle(self, command: float) -> float:
        line = self._line
        line.append(command)
        return line.popleft() if len(line) > self._samples else line[0]


class _Slow:
    """``y += (1 - exp(-dt / lag)) (command - y)``, from the command of its first step."""

    def __init__(self, share: float) -> None:
        self._share = share
        self._value: float | None = None

    def throttle(self, command: float) -> float:
        value = command if self._value is None else self._value
        self._value = value + self._share * (command - value)
        return self._value


class _Weak:
    """A constant share of the thrust."""

    def __init__(self, share: float) -> None:
        self._share = share

    def deliver(self, thrust: float, speed: float) -> tuple[float, float]:
        return thrust * self._share, speed * sqrt(self._share)


class _Off:
    """A fan's motor is off: the thrust dies away by ``left`` a step; on again, it comes back the same way."""

    def __init__(self, left: float) -> None:
        self._left = left
        self._factor = 1.0
        self.burns = False

    def throttle(self, command: float) -> float:
        return command if self.burns else 0.0

    def light(self) -> None:
        self.burns = True

    def deliver(self, thrust: float, speed: float) -> tuple[float, float]:
        target = 1.0 if self.burns else 0.0
        self._factor = target + self._left * (self._factor - target)
        return thrust * self._factor, speed * sqrt(self._factor)


_Throttle = _Stuck | _Late | _Slow | _Off | Burning
_Thrust = _Weak | _Off | Burning


class FaultyEngines:
    """The engines with faults before and behind them.

    A flame-out shuts the engine's ``run`` port, and the engine's own equations say what follows.  One without that
    port is given a closed throttle, and its law (:mod:`cosim.rundown`) says what is left of its thrust: of a turbine
    the cold air of a rotor that runs down, of a fan what its motor's lag leaves, whatever its delay, because the
    current is gone at once.  Else thrust that is missing is missing on the spool too: the reported speed goes with the
    root of the share, as thrust goes with the square of the speed.
    """

    def __init__(
        self,
        bank: Engines,
        laws: Sequence[FlameOutLaw | None],
        lag: Callable[[int], float],
        shut_off: Callable[[], Collection[int]],
        step: float,
    ) -> None:
        self.bank = bank
        self._shut_off = shut_off
        self.wants_ambient = bank.wants_ambient
        self._laws, self._lag = laws, lag
        self._step = step
        self._throttles: list[tuple[int, Fault, _Throttle]] = []
        self._thrusts: list[tuple[int, Fault, _Thrust]] = []
        self._shut: list[tuple[int, Fault]] = []  # by their port run

    def begin(self, fault: Fault) -> None:
        """``fault`` acts from the next step on."""
        for jet in fault.jet if not isinstance(fault, (ServoJam, SensorBias, SensorDropout)) else ():
            i = jet - 1
            if isinstance(fault, FlameOut):
                if self.bank.set_run(i, False):
                    self._shut.append((i, fault))
                    continue
                out = self._out(i)
                self._throttles.append((i, fault, out))
                self._thrusts.append((i, fault, out))
            elif isinstance(fault, ThrustLoss):
                self._thrusts.append((i, fault, _Weak(1.0 - fault.share)))
            elif isinstance(fault, StuckThrottle):
                self._throttles.append((i, fault, _Stuck(fault.throttle)))
            elif isinstance(fault, DelayGrowth):
                self._throttles.append((i, fault, _Late(round(fault.delay_s / self._step))))
            elif isinstance(fault, SlowSpool):
                self._throttles.append((i, fault, _Slow(1.0 - exp(-self._step / fault.lag_s))))

    def _out(self, i: int) -> _Off | Burning:
        law = self._laws[i]
        assert law is not None  # Faults refuses a flame-out of such an engine
        if not law.electric:
            return Burning(law, self._step)
        lag = self._lag(i)
        return _Off(exp(-self._step / lag) if lag > 0.0 else 0.0)

    def end(self, fault: Fault) -> None:
        """``fault`` is over from the next step on; an engine that went out is lit again, if no other keeps it out."""
        if isinstance(fault, FlameOut):
            for _, owner, effect in self._thrusts:
                if owner is fault and isinstance(effect, (_Off, Burning)):
                    effect.light()
            mine = [i for i, owner in self._shut if owner is fault]
            self._shut = [entry for entry in self._shut if entry[1] is not fault]
            still_out = {i for i, _ in self._shut}.union(self._shut_off())
            for i in mine:
                if i not in still_out:
                    self.bank.set_run(i, True)
            return
        self._throttles = [entry for entry in self._throttles if entry[1] is not fault]
        self._thrusts = [entry for entry in self._thrusts if entry[1] is not fault]

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        self._throttles, self._thrusts, self._shut = [], [], []
        return self.bank.reset(throttle, ambient)

    def set_run(self, index: int, on: bool) -> bool:
        return self.bank.set_run(index, on)

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        if self._throttles:
            given = list(throttle)
            for i, _, before in self._throttles:
                given[i] = before.throttle(given[i])
            throttle = tuple(given)
        output = self.bank.step(k, throttle, ambient)
        if not self._thrusts:
            return output
        thrust, speed, flow = list(output.thrust), list(output.spool_speed), list(output.fuel_flow)
        for i, _, behind in self._thrusts:
            thrust[i], speed[i] = behind.deliver(thrust[i], speed[i])
            if isinstance(behind, (_Off, Burning)) and not behind.burns:
                flow[i] *= 0.0
        return EngineOutput(tuple(thrust), tuple(speed), output.exhaust_temperature, tuple(flow))

    def close(self) -> None:
        self.bank.close()


class JammedServo:
    """A servo that stays where it stands, or runs to ``angle`` (rad) in its own way and stays there."""

    def __init__(self, servo: TiltServo, angle: float | None) -> None:
        self.servo = servo
        self.angle = servo.angle
        self._target = angle

    def reset(self, angle: float = 0.0) -> None:
        self.servo.reset(angle)
        self.angle = angle

    def update(self, command: float) -> float:
        """Where it stands at the end of the step, whatever the ``command``."""
        if self._target is not None:
            self.angle = self.servo.update(self._target)
        return self.angle


class FaultySensors:
    """The sensors with faults on what they give out: a bias is added to it, a dropout repeats the last of it.

    The bias of the attitude is a small rotation about the body axes; of the GNSS, of position and of velocity.
    """

    def __init__(self, sensors: SensorSuite) -> None:
        self.sensors = sensors
        self._faults: list[tuple[SensorBias | SensorDropout, Measured]] = []

    def begin(self, fault: SensorBias | SensorDropout, last: Measured) -> None:
        """``fault`` acts on the next sample; ``last`` is the one before."""
        self._faults.append((fault, last))

    def end(self, fault: SensorBias | SensorDropout) -> None:
        """``fault`` is over from the next sample on."""
        self._faults = [entry for entry in self._faults if entry[0] is not fault]

    def reset(self, state: State) -> Measured:
        self._faults = []
        return self.sensors.reset(state)

    def sample(self, state: State) -> Measured:
        measured = self.sensors.sample(state)
        for fault, last in self._faults:
            measured = (
                _held(measured, fault.sensor, last) if isinstance(fault, SensorDropout) else _off(measured, fault)
            )
        return measured


def _held(measured: Measured, sensor: str, last: Measured) -> Measured:
    if sensor == "gyro":
        return measured._replace(rate=last.rate)
    if sensor == "attitude":
        return measured._replace(attitude=last.attitude)
    if sensor == "gnss":
        return measured._replace(position=last.position, velocity=last.velocity)
    return measured._replace(altitude=last.altitude)


def _off(measured: Measured, fault: SensorBias) -> Measured:
    x, y, z = fault.vector
    if fault.sensor == "gyro":
        return measured._replace(rate=_sum(measured.rate, fault.vector))
    if fault.sensor == "attitude":
        turned = normalize(multiply(measured.attitude, (1.0, 0.5 * x, 0.5 * y, 0.5 * z)))
        return measured._replace(attitude=turned)
    if fault.sensor == "gnss":
        return measured._replace(
            position=_sum(measured.position, fault.vector), velocity=_sum(measured.velocity, fault.velocity_bias)
        )
    return measured._replace(altitude=measured.altitude + x)


def _sum(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


# named one by one, so that a step finds its way to them without looking
Servo = TiltServo | JammedServo
Sensing = SensorSuite | FaultySensors


class Faults:
    """The faults of a flight and when they begin and end; ``next`` is the step at which something changes.

    ``engines``, ``servos`` and ``sensors`` are what a flight is to use from there on.  Raises InputError for a fault of
    something that the vehicle has not.
    """

    def __init__(
        self,
        scenario: Scenario,
        bank: Engines,
        servos: Sequence[TiltServo],
        sensors: SensorSuite,
        laws: Sequence[FlameOutLaw | None],
        lag: Callable[[int], float],
        shut_off: Callable[[], Collection[int]],
    ) -> None:
        """``laws[i]``: how engine ``i`` goes out, from 0; ``lag(i)``: its time constant [s].

        ``shut_off()``: the engines without fuel.
        """
        self._scenario = scenario
        self._bank, self._servos, self._sensors = bank, list(servos), sensors
        self._jets = len(laws)
        self._laws, self._lag = laws, lag
        self._shut_off = shut_off
        self.reset(scenario.fault)

    def reset(self, faults: Sequence[Fault]) -> None:
        """Back to the start of a flight with these ``faults``."""
        self._spans: list[tuple[int, int, Fault]] = []
        self._acting: list[Fault] = []
        self.engines: Engines = self._bank
        self.servos: list[Servo] = [*self._servos]
        self._jams: list[ServoJam | None] = [None] * len(self._servos)
        self.sensors: Sensing = self._sensors
        self.flags = NO_FAULTS
        self.next = NEVER
        for index, fault in enumerate(faults):
            self._add(fault, f"fault.{index}")

    def _add(self, fault: Fault, where: str) -> None:
        self._check(fault, where)
        scenario = self._scenario
        start = scenario.count(fault.start_s, f"{where}.start_s")
        end = NEVER
        if fault.duration_s is not None:
            end = start + scenario.count(fault.duration_s, f"{where}.duration_s")
        self._spans.append((start, end, fault))
        self.next = min(self.next, start)

    def _check(self, fault: Fault, where: str) -> None:
        name = f"scenario {self._scenario.name}: {where}"
        if isinstance(fault, ServoJam):
            if not self._servos:
                raise InputError(f"{name}.servo: {self._scenario.aircraft} has no tilt servos")
        elif not isinstance(fault, (SensorBias, SensorDropout)) and max(fault.jet) > self._jets:
            raise InputError(f"{name}.jet = {max(fault.jet)}: {self._scenario.aircraft} has jets 1 to {self._jets}")
        if isinstance(fault, FlameOut):
            unknown = [jet for jet in fault.jet if self._laws[jet - 1] is None]
            if unknown:
                raise InputError(
                    f"{name}: the engine at jet {unknown[0]} has no port run and states no [flame_out]: nobody knows "
                    "what it gives without fire; map run, or state [flame_out] in its mapping file"
                )
        if isinstance(fault, DelayGrowth):
            self._scenario.count(fault.delay_s, f"{where}.delay_s")

    def inject(self, fault: Fault, k: int) -> list[Fault]:
        """Begin ``fault`` at step ``k``, whatever its ``start_s``; all faults of the flight as they now stand."""
        started = fault.model_copy(update={"start_s": k * self._scenario.step_s})
        self._add(started, "inject")
        self.next = min(self.next, k)
        return self.flown

    def clear(self, k: int) -> list[Fault]:
        """End at step ``k`` every fault that acts or is to begin there; all faults of the flight as they now stand."""
        self._spans = [
            (start, end if start > k else min(end, k), fault) for start, end, fault in self._spans if start != k
        ]
        self.next = k
        return self.flown

    @property
    def flown(self) -> list[Fault]:
        """The faults with the times at which they did act so far, or will."""
        dt = self._scenario.step_s
        return [
            fault if end == NEVER else fault.model_copy(update={"duration_s": (end - start) * dt})
            for start, end, fault in self._spans
        ]

    def change(self, k: int, measured: Measured) -> None:
        """Begin and end what is due at step ``k``; ``measured`` is what the sensors said last."""
        due = [fault for start, end, fault in self._spans if start <= k < end]
        for fault in [fault for fault in self._acting if not any(fault is each for each in due)]:
            self._end(fault)
        for fault in due:
            if not any(fault is each for each in self._acting):
                self._begin(fault, measured)
        self._acting = due
        self._jam()
        self.flags = _flags(due) if due else NO_FAULTS
        times = [time for start, end, _ in self._spans for time in (start, end) if time > k]
        self.next = min(times, default=NEVER)

    def _begin(self, fault: Fault, measured: Measured) -> None:
        if isinstance(fault, (SensorBias, SensorDropout)):
            if not isinstance(self.sensors, FaultySensors):
                self.sensors = FaultySensors(self._sensors)
            self.sensors.begin(fault, measured)
        elif not isinstance(fault, ServoJam):
            if not isinstance(self.engines, FaultyEngines):
                self.engines = FaultyEngines(self._bank, self._laws, self._lag, self._shut_off, self._scenario.step_s)
            self.engines.begin(fault)

    def _end(self, fault: Fault) -> None:
        if isinstance(fault, (SensorBias, SensorDropout)):
            assert isinstance(self.sensors, FaultySensors)
            self.sensors.end(fault)
        elif not isinstance(fault, ServoJam):
            assert isinstance(self.engines, FaultyEngines)
            self.engines.end(fault)

    def _jam(self) -> None:
        """Jam the servos that are to be, by the first fault that acts, and free the others where they stand."""
        for i, own in enumerate(self._servos):
            jams = [fault for fault in self._acting if isinstance(fault, ServoJam) and fault.servo == SERVOS[i]]
            jam = jams[0] if jams else None
            if jam is self._jams[i]:
                continue
            own.reset(self.servos[i].angle)
            angle = None if jam is None or jam.angle_deg is None else radians(jam.angle_deg)
            self.servos[i] = own if jam is None else JammedServo(own, angle)
            self._jams[i] = jam


def _flags(acting: Sequence[Fault]) -> tuple[float, ...]:
    """1 for every jet, servo and sensor that a fault acts on, in the order of the log's columns."""
    flags = list(NO_FAULTS)
    for fault in acting:
        if isinstance(fault, ServoJam):
            flags[JETS + SERVOS.index(fault.servo)] = 1.0
        elif isinstance(fault, (SensorBias, SensorDropout)):
            flags[JETS + len(SERVOS) + SENSORS.index(fault.sensor)] = 1.0
        else:
            for jet in fault.jet:
                flags[jet - 1] = 1.0
    return tuple(flags)
