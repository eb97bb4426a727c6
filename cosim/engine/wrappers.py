"""The engines as they fly: a chain of effects before and behind the bank.

    throttle -> shut off? -> faults -> added delay -> bank -> thrust factors -> faults -> shut off? -> thrust

A link without anything to do leaves the bank's numbers as they are, to the last bit.  An engine runs where neither a
flame-out nor a switch keeps it off; only this chain sets the ports ``run``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import exp, sqrt

from cosim.base.protocols import Engines
from cosim.base.signals import NO_JETS, Ambient, EngineOutput, PerJet
from cosim.engine.rundown import FlameOutLaw
from cosim.spec.scenario import DelayGrowth, EngineFault, FlameOut, SlowSpool, StuckThrottle, ThrustLoss


class EngineEffect:
    """Effect of a fault or switch on one engine: changes throttle, thrust [N] and speed [rad/s]."""

    burns_fuel: bool = True  # whether the engine burns fuel

    def change_throttle(self, command: float) -> float:
        return command

    def change_output(self, thrust: float, speed: float) -> tuple[float, float]:
        return thrust, speed

    def relight(self) -> None:
        """Start the engine again from the next step on."""


class _StuckThrottle(EngineEffect):
    """Throttle that stays at ``at``, or at the command of the fault's first step."""

    def __init__(self, at: float | None) -> None:
        self._at = at

    def change_throttle(self, command: float) -> float:
        if self._at is None:
            self._at = command
        return self._at


class _ThrottleDelay(EngineEffect):
    """Delay of throttle commands by ``samples``; the first command is held until then."""

    def __init__(self, samples: int) -> None:
        self._queue: deque[float] = deque()
        self._samples = samples

    def change_throttle(self, command: float) -> float:
        queue = self._queue
        queue.append(command)
        return queue.popleft() if len(queue) > self._samples else queue[0]


class _SlowSpool(EngineEffect):
    """Lag ``y += (1 - exp(-dt / lag)) (command - y)`` of the throttle, from the command of its first step."""

    def __init__(self, fraction: float) -> None:
        self._fraction = fraction
        self._value: float | None = None

    def change_throttle(self, command: float) -> float:
        value = command if self._value is None else self._value
        self._value = value + self._fraction * (command - value)
        return self._value


class _ThrustLoss(EngineEffect):
    """Loss of a constant fraction of the thrust."""

    def __init__(self, fraction: float) -> None:
        self._fraction = fraction

    def change_output(self, thrust: float, speed: float) -> tuple[float, float]:
        return thrust * self._fraction, speed * sqrt(self._fraction)


class _ClosedThrottle(EngineEffect):
    """Shut-off of an engine without a port for it: throttle and thrust are 0 at once."""

    def change_throttle(self, command: float) -> float:
        return 0.0

    def change_output(self, thrust: float, speed: float) -> tuple[float, float]:
        return 0.0, speed


class _UnpoweredFan(EngineEffect):
    """Fan with its motor off: thrust decays to the fraction ``left`` in each step, and recovers likewise."""

    def __init__(self, left: float) -> None:
        self._left = left
        self._factor = 1.0
        self.burns_fuel = False

    def change_throttle(self, command: float) -> float:
        return command if self.burns_fuel else 0.0

    def relight(self) -> None:
        self.burns_fuel = True

    def change_output(self, thrust: float, speed: float) -> tuple[float, float]:
        target = 1.0 if self.burns_fuel else 0.0
        self._factor = target + self._left * (self._factor - target)
        return thrust * self._factor, speed * sqrt(self._factor)


class _Rundown(EngineEffect):
    """Run-down of an unlit engine: thrust and speed by ``law``, and during its relight.

    The thrust at the end of the first step without fire is ``T_0``: the engine itself keeps its command over that one
    and has throttle 0 from then on.  Lit again, the thrust goes in a straight line, over ``law.relight``, from what is
    left to that of the engine at throttle 0; then the engine has its command again.
    """

    def __init__(self, law: FlameOutLaw, step: float, cold: bool = False) -> None:
        self._law = law
        self._step = step
        self._steps_out = int(cold)  # steps without fire; from 1 if cold
        self._steps_since_start = -1  # steps since the start command; -1: none
        self._thrust = 0.0
        self._speed = 0.0
        self.burns_fuel = False  # False: commands do not reach the engine

    def relight(self) -> None:
        """Start at the next step, at once if the law has no start time."""
        self._steps_since_start = 0
        self.burns_fuel = self._law.relight_s <= 0.0

    def change_throttle(self, command: float) -> float:
        return command if self.burns_fuel or not self._steps_out else 0.0

    def change_output(self, thrust: float, speed: float) -> tuple[float, float]:
        if self.burns_fuel:
            return thrust, speed
        if not self._steps_out:
            self._thrust, self._speed = thrust, speed
        self._steps_out += 1
        law = self._law
        slowed = 1.0 / (1.0 + self._steps_out * self._step / law.half_speed_s)
        cold, turning = self._thrust * law.thrust_left * slowed**law.exponent, self._speed * slowed
        if self._steps_since_start < 0:
            return cold, turning
        self._steps_since_start += 1
        fraction = self._steps_since_start * self._step / law.relight_s
        if fraction >= 1.0:
            self.burns_fuel = True
            fraction = 1.0
        return cold + fraction * (thrust - cold), turning + fraction * (speed - turning)


class EngineChain:
    """Bank of engines with faults, switches and mismatch applied to each engine.

    ``laws[i]``: how engine ``i``, from 0, goes out (:mod:`cosim.engine.rundown`); ``lag(i)``: its time constant [s],
    which is needed where a fan loses its current.  ``factors``: thrust over that of the bank, spool speeds the same;
    ``delay``: steps by which every throttle arrives later; ``side_loads``: some engine has loads beside its thrust.

    A flame-out and a shut-off shut the engine's ``run`` port, and the engine's own equations say what follows.  One
    without that port is given a closed throttle, and its law says what is left of its thrust: of a turbine the cold air
    of a rotor that runs down, of a fan what its motor's lag leaves, whatever its delay, because the current is gone at
    once; shut off on purpose, a fan gives nothing at once, and a turbine is on again as soon as it is switched on, for
    the law has no start on the ground.  Else thrust that a fault takes is missing on the spool too: the reported speed
    goes with the root of the share, as thrust goes with the square of the speed.
    """

    def __init__(
        self,
        bank: Engines,
        laws: Sequence[FlameOutLaw | None],
        lag: Callable[[int], float],
        step: float,
        factors: PerJet | None = None,
        delay: int = 0,
        side_loads: bool = False,
    ) -> None:
        self.bank = bank
        self.wants_ambient = bank.wants_ambient
        self._laws, self._lag, self._step = list(laws), lag, step
        self._factors = factors
        self._delay = delay
        self._has_side_loads = side_loads
        self._idle: PerJet = (0.0,) * len(self._laws)  # thrust at reset
        self._queue: deque[PerJet] = deque()
        self._clear()

    def _clear(self) -> None:
        """Clear all faults and switches, as after a reset of the bank."""
        self._acting: list[EngineFault] = []
        self._effects: list[tuple[int, EngineFault, EngineEffect]] = []
        self._flamed_out: list[tuple[int, EngineFault]] = []  # flame-outs through a port "run"
        self.off: frozenset[int] = NO_JETS  # jets switched off
        self._shut_off: dict[int, EngineEffect] = {}  # engines off that have no port "run"
        self._restarts: dict[int, int] = {}  # steps left until restarted engines run

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        """Reset to healthy engines in equilibrium at the throttle, one for all or one each.  Raises EngineError."""
        self._clear()
        throttles = tuple(throttle) if isinstance(throttle, Sequence) else (throttle,) * len(self._laws)
        self._queue = deque([throttles] * self._delay)
        output = self._apply_effects(self.bank.reset(throttle, ambient))
        self._idle = output.thrust
        return output

    def shut_off_all(self, run_down_s: float = 60.0) -> EngineOutput:
        """Shut all engines off right after the reset, as before their first start.  Raises EngineError.

        ``run_down_s``: after which a turbine's rotor has less than a fiftieth of its speed.
        """
        self.off = frozenset(range(len(self._laws)))
        for index in range(len(self._laws)):
            if not self.bank.set_run(index, False):
                self._shut_off[index] = self._make_rundown(index, cold=True)
        return self._apply_effects(self.bank.run_down(run_down_s))

    @property
    def restarting_engines(self) -> tuple[int, ...]:
        """Engines, counted from 1, that were switched on again and have not reached their initial thrust."""
        return tuple([index + 1 for index in sorted(self._restarts)])

    def _update_restarts(self, thrust: PerJet, started: float = 0.9) -> None:
        """Remove restarted engines that run, or whose time for a restart is over."""
        idle = self._idle
        left = {i: steps - 1 for i, steps in self._restarts.items() if thrust[i] < started * idle[i]}
        self._restarts = {index: steps for index, steps in left.items() if steps > 0}

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        """Return thrust and reports at the end of step ``k``.  Raises EngineError."""
        if self._shut_off or self._effects:
            throttles = list(throttle)
            for i, effect in self._shut_off.items():
                throttles[i] = effect.change_throttle(throttles[i])
            for i, _, effect in self._effects:
                throttles[i] = effect.change_throttle(throttles[i])
            throttle = tuple(throttles)
        if self._delay:
            self._queue.append(throttle)
            throttle = self._queue.popleft()
        output = self._apply_effects(self.bank.step(k, throttle, ambient))
        if self._restarts:
            self._update_restarts(output.thrust)
        return output

    def _with_thrust(self, output: EngineOutput, thrust: Sequence[float], speed: PerJet, flow: PerJet) -> EngineOutput:
        """Return an output with its thrusts replaced; side loads change in proportion."""
        side_loads = [output.force_forward, output.force_right, output.torque]
        if self._has_side_loads:
            fractions = [after / before if before else 0.0 for after, before in zip(thrust, output.thrust, strict=True)]
            side_loads = [
                tuple([part * load for part, load in zip(fractions, loads, strict=True)]) for loads in side_loads
            ]
        forward, right, torque = side_loads
        return EngineOutput(tuple(thrust), speed, output.exhaust_temperature, flow, forward, right, torque)

    def _apply_effects(self, output: EngineOutput) -> EngineOutput:
        """Return the bank's output with the thrust factors, faults and switches applied."""
        if self._factors is not None:
            scaled = [factor * newton for factor, newton in zip(self._factors, output.thrust, strict=True)]
            output = self._with_thrust(output, scaled, output.spool_speed, output.fuel_flow)
        if not (self._shut_off or self._effects):
            return output
        thrust, speed, flow = list(output.thrust), list(output.spool_speed), list(output.fuel_flow)
        for i, _, effect in self._effects:
            thrust[i], speed[i] = effect.change_output(thrust[i], speed[i])
            if not effect.burns_fuel:
                flow[i] *= 0.0
        for i, effect in self._shut_off.items():
            thrust[i], speed[i] = effect.change_output(thrust[i], speed[i])
            flow[i] = 0.0
        return self._with_thrust(output, thrust, tuple(speed), tuple(flow))

    def switch_engine(self, index: int, on: bool, restart_s: float = 120.0) -> None:
        """Switch one engine off or on before the next step; ``index`` from 0.  Raises EngineError.

        An engine that has a fault of its own is not switched on: it stays what the fault makes of it.  ``restart_s``:
        after which an engine that is not up is left to the engine monitor.
        """
        if on == (index not in self.off) or (on and any(index + 1 in fault.jet for fault in self._acting)):
            return
        self.off = self.off - {index} if on else self.off | {index}
        if on:
            self._restarts[index] = round(restart_s / self._step)
        else:
            self._restarts.pop(index, None)
        if not self.bank.set_run(index, on):
            if on:
                del self._shut_off[index]
            else:
                self._shut_off[index] = self._make_rundown(index)

    def _make_rundown(self, index: int, cold: bool = False) -> EngineEffect:
        """Return the effect of an engine without a port ``run`` that is shut off; ``cold``: it has not run yet."""
        law = self._laws[index]
        return _ClosedThrottle() if law is None or law.is_electric else _Rundown(law, self._step, cold)

    def begin_fault(self, fault: EngineFault) -> None:
        self._acting.append(fault)
        for jet in fault.jet:
            i = jet - 1
            if isinstance(fault, FlameOut) and self.bank.set_run(i, False):
                self._flamed_out.append((i, fault))
            else:
                self._effects.append((i, fault, self._make_effect(fault, i)))

    def _make_effect(self, fault: EngineFault, i: int) -> EngineEffect:
        if isinstance(fault, ThrustLoss):
            return _ThrustLoss(1.0 - fault.share)
        if isinstance(fault, StuckThrottle):
            return _StuckThrottle(fault.throttle)
        if isinstance(fault, DelayGrowth):
            return _ThrottleDelay(round(fault.delay_s / self._step))
        if isinstance(fault, SlowSpool):
            return _SlowSpool(1.0 - exp(-self._step / fault.lag_s))
        law = self._laws[i]
        assert law is not None  # otherwise the flame-out was refused
        if not law.is_electric:
            return _Rundown(law, self._step)
        lag = self._lag(i)
        return _UnpoweredFan(exp(-self._step / lag) if lag > 0.0 else 0.0)

    def end_fault(self, fault: EngineFault) -> None:
        """End ``fault`` at the next step; the engine is lit again unless something else keeps it off."""
        self._acting = [acting for acting in self._acting if acting is not fault]
        if not isinstance(fault, FlameOut):
            self._effects = [entry for entry in self._effects if entry[1] is not fault]
            return
        for _, owner, effect in self._effects:
            if owner is fault:
                effect.relight()
        out = [i for i, owner in self._flamed_out if owner is fault]
        self._flamed_out = [entry for entry in self._flamed_out if entry[1] is not fault]
        still_out = {i for i, _ in self._flamed_out} | self.off
        for i in out:
            if i not in still_out:
                self.bank.set_run(i, True)

    def close(self) -> None:
        """Free the engines; may be called twice."""
        self.bank.close()
