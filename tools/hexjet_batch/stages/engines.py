"""The engines of the library over a batch: the equations of ``engines/*.c``, a column for each jet.

Each kind has ``start`` and ``step`` over one control step, which is its internal step; both give the state and what an
engine reports.  ``n`` has the parameters of its ``engine.toml`` by name and in their units, and the delay [steps].
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, pi
from typing import Any, NamedTuple

from hexjet_batch.numbers import Numbers, is_absent, limit
from hexjet_batch.stages.delays import make_ring, push

RPM = pi / 30.0  # rad/s


class Air(NamedTuple):
    """The air at the engines: static pressure [Pa], temperature [K], speed into each intake [m/s]."""

    pressure: Any
    temperature: Any
    speed: Any


class Report(NamedTuple):
    """What engines report at the end of a step; ``out`` marks those whose fire went out, 0 where none can."""

    thrust: Any  # N
    speed: Any = 0.0  # rad/s
    fuel: Any = 0.0  # kg/s
    out: Any = 0.0


def or_infinite(limit: Any, xp: Any) -> Any:
    """Return a limit, infinity where it is 0, which states that there is none."""
    return (limit or inf) if isinstance(limit, (int, float)) else xp.where(limit > 0.0, limit, inf)


def runge_kutta(slopes: Callable[[Any, Any], tuple[Any, Any]], x: Any, y: Any, h: Any) -> tuple[Any, Any]:
    """Return two states after a step of the classical method of fourth order."""
    a1, b1 = slopes(x, y)
    a2, b2 = slopes(x + h / 2.0 * a1, y + h / 2.0 * b1)
    a3, b3 = slopes(x + h / 2.0 * a2, y + h / 2.0 * b2)
    a4, b4 = slopes(x + h * a3, y + h * b3)
    return x + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4), y + h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)


def bisect(grows: Callable[[Any], Any], low: Any, high: Any, xp: Any, halvings: int = 60) -> Any:
    """Return where ``grows`` changes from True to False, from below; then nothing is left to halve."""
    for _ in range(halvings):
        middle = (low + high) / 2.0
        up = grows(middle)
        low, high = xp.where(up, middle, low), xp.where(up, high, middle)
    return low


class DelayedLag:
    """``G(z) = gain / (z - pole) z^-delay``, throttle to thrust."""

    def start(self, n: Numbers, throttle: Any, air: Air) -> tuple[Any, Report]:
        y = n.gain / (1.0 - n.pole) * throttle
        return (make_ring(n.delay, throttle, n.xp), y), Report(n.newton_per_unit * y)

    def step(self, n: Numbers, s: Any, k: Any, throttle: Any, air: Air) -> tuple[Any, Report]:
        ring, y = s
        ring, u = push(ring, k, n.delay, limit(throttle, 0.0, 1.0, n.xp), n.xp)
        y = n.pole * y + n.gain * u
        return (ring, y), Report(n.newton_per_unit * y)


class Fitted:
    """The engine of a bench log: delay, static curve, two lags of which the first may change, limits of the rate."""

    def start(self, n: Numbers, throttle: Any, air: Air) -> tuple[Any, Report]:
        thrust = self._static_thrust(n, limit(throttle, 0.0, 1.0, n.xp))
        return (make_ring(n.delay, throttle, n.xp), thrust, thrust), Report(thrust)

    def _static_thrust(self, n: Numbers, u: Any) -> Any:
        shape = u if isinstance(n.exponent, float) and n.exponent == 1.0 else u**n.exponent
        return n.xp.maximum(n.offset + n.gain * shape, 0.0)

    def step(self, n: Numbers, s: Any, k: Any, throttle: Any, air: Air) -> tuple[Any, Report]:
        (ring, x, y), xp = s, n.xp
        ring, u = push(ring, k, n.delay, limit(throttle, 0.0, 1.0, xp), xp)
        f, lag = self._static_thrust(n, u), n.lag
        if not is_absent(n.lag_full):
            level = limit((y - n.offset) / n.gain, 0.0, 1.0, xp)
            lag = xp.where(xp.asarray(n.lag_full) == 0.0, lag, lag + (n.lag_full - lag) * level)
        e = self._decay_factor(n, lag)
        new = f + e * (y - f)
        if not is_absent(n.lag_2):
            e2, apart = self._decay_factor(n, n.lag_2), n.lag_2 - lag
            equal = xp.abs(apart) < 1e-9 * lag
            through = xp.where(equal, n.step / lag * e, n.lag_2 / xp.where(equal, 1.0, apart) * (e2 - e))
            new = new + through * (x - f)
            x = f + e2 * (x - f)
        if not is_absent(n.rise):
            new = xp.minimum(new, y + n.step * n.gain * or_infinite(n.rise, xp))
        if not is_absent(n.fall):
            new = xp.maximum(new, y - n.step * n.gain * or_infinite(n.fall, xp))
        return (ring, x, new), Report(new)

    def _decay_factor(self, n: Numbers, lag: Any) -> Any:
        lag = n.xp.asarray(lag)
        return n.xp.where(lag > 0.0, n.xp.exp(-n.step / n.xp.where(lag > 0.0, lag, 1.0)), 0.0)


class P220:
    """Thrust by an identified equation of second order, ``T'' = F(T, T', v)``, that of 2020."""

    IDLE_THRUST, FULL_THRUST = 9.0, 220.0  # N; these four lines: data sheet
    IDLE_RPM, FULL_RPM = 35000.0, 117000.0
    IDLE_FUEL, FULL_FUEL = 0.104 / 60.0, 0.58 / 60.0  # kg/s
    EXPONENT = 3.205
    K_T, K_TT, K_D, K_DD, K_TD = 0.237755, -0.012799, -0.860374, 0.023606, 0.008599
    B_U, B_T, B_D, B_UU, CONSTANT = 1.139026, 0.019914, -0.050257, 0.000302, -0.692913

    def _thrust_acceleration(self, thrust: Any, rate: Any, v: Any) -> Any:
        own = self.K_T * thrust + self.K_TT * thrust * thrust + self.K_D * rate + self.K_DD * rate * rate
        by_drive = (self.B_U + self.B_T * thrust + self.B_D * rate) * v
        return own + self.K_TD * thrust * rate + by_drive + self.CONSTANT

    def _thrust_at_rest(self, v: Any, xp: Any) -> Any:
        b = self.K_T + self.B_T * v
        return (-b - xp.sqrt(b * b - 4.0 * self.K_TT * (self.B_U * v + self.CONSTANT))) / (2.0 * self.K_TT)

    def _drive_input(self, n: Numbers, throttle: Any) -> Any:
        percent = n.idle_percent + (100.0 - n.idle_percent) * throttle
        return percent + self.B_UU * percent * percent

    def _make_report(self, thrust: Any, xp: Any) -> Report:
        load = (xp.maximum(thrust, self.IDLE_THRUST) - self.IDLE_THRUST) / (self.FULL_THRUST - self.IDLE_THRUST)
        idle = (self.IDLE_RPM / self.FULL_RPM) ** self.EXPONENT
        speed = RPM * self.FULL_RPM * (idle + (1.0 - idle) * load) ** (1.0 / self.EXPONENT)
        return Report(thrust, speed, self.IDLE_FUEL + (self.FULL_FUEL - self.IDLE_FUEL) * load)

    def start(self, n: Numbers, throttle: Any, air: Air) -> tuple[Any, Report]:
        thrust = self._thrust_at_rest(self._drive_input(n, throttle), n.xp)
        return (make_ring(n.delay, throttle, n.xp), thrust, 0.0 * thrust), self._make_report(thrust, n.xp)

    def step(self, n: Numbers, s: Any, k: Any, throttle: Any, air: Air) -> tuple[Any, Report]:
        ring, thrust, rate = s
        ring, u = push(ring, k, n.delay, limit(throttle, 0.0, 1.0, n.xp), n.xp)
        v = self._drive_input(n, u)
        thrust, rate = runge_kutta(
            lambda at, slope: (slope, self._thrust_acceleration(at, slope, v)), thrust, rate, n.step / n.time_factor
        )
        return (ring, thrust, rate), self._make_report(thrust, n.xp)
