"""The engine monitor: which engines follow their commands, from what a flight computer knows of them.

It uses the commanded throttles and the reports of the engines' own controllers: the speed of the spool, turned into
thrust through the engine's static curves, or where no speed is reported the thrust itself, which then stands for the
estimate that an electronic speed controller makes from speed and current.  Injected faults are not reported to it.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from math import ceil, exp, floor, inf
from typing import NamedTuple

from cosim.base.signals import EngineOutput, JetHealth, PerJet
from cosim.spec.vehicle import MonitorSettings


class EngineReference(NamedTuple):
    """Response of a healthy engine: static curves, and a lag behind a delay."""

    throttle: Sequence[float]
    thrust: Sequence[float]  # N, at each throttle
    speed: Sequence[float] | None  # rad/s at each throttle; None: no sensor
    lag: float  # s, engine lag around hover
    delay: float  # s, engine delay
    shortest: float  # s, shortest lag in its range, either way
    longest: float  # s, longest lag in its range

    def thrust_at(self, throttle: float) -> float:
        """Return the thrust at rest [N]."""
        return _interpolate(self.throttle, self.thrust, throttle)

    def reported_to_thrust(self, thrust: float, speed: float) -> float:
        """Return the thrust [N] for a report, by spool speed if that is measured."""
        if self.speed is None or speed != speed:
            return thrust
        return _interpolate(self.speed, self.thrust, speed)


class EngineMonitor:
    """Compares each engine with the range of a healthy one, and estimates the thrust that it delivers.

    A healthy engine is a lag behind a delay, neither known exactly: ``tau x' = T(u(t - d)) - x`` with ``tau`` within a
    factor of what was measured and ``d`` within some seconds of it.  With ``T_min`` and ``T_max`` over the delays that
    may be, the bound ``h`` that follows ``T_max`` with the shortest lag when rising and with the longest when falling
    stays above ``x``, and its counterpart below it (comparison principle).  An engine that is outside by more than the
    threshold for the confirmation time is judged:

    - its command moved and it did not: *stuck* where it stands, if that lasts;
    - it gives more than any healthy engine would, unasked: *stuck* where it heads for;
    - else *weak*: what it heads for over what was commanded; below a fifth it is *lost*.

    Where it heads for is ``(x_k - a x_{k-m}) / (1 - a)`` with ``a = exp(-m dt / tau)``, over the ``m`` steps in which
    it was outside.  A weak engine may get well; lost and stuck ones are not used again until :meth:`reset`, but the
    thrust they give is followed.  ``limits`` are the least and the most share that may be commanded; ``hover`` is a
    jet's thrust in hover, to which the threshold refers.

    ``sudden``: a fall is also compared with the same interval begun at the report of a tenth of a second ago, less what
    it fell by before: a command that oscillates widens the other interval, which then detects a fall later.
    """

    def __init__(
        self,
        settings: MonitorSettings,
        references: Sequence[EngineReference],
        hover: float,
        limits: tuple[float, float],
        step: float,
        sudden: bool = False,
    ) -> None:
        self._references = tuple(references)
        self._thrust_by_throttle = [_Curve(reference.throttle, reference.thrust) for reference in references]
        self._thrust_by_speed = [
            None if reference.speed is None else _Curve(reference.speed, reference.thrust) for reference in references
        ]
        self._speeds = any(reference.speed is not None for reference in references)
        self._threshold = settings.threshold * hover
        self._limits = limits
        self._confirm = max(1, round(settings.confirm_s / step))
        self._stuck = max(1, round(settings.stuck_s / step))
        factor, spread = settings.lag_factor, settings.delay_spread_s
        self._engines = [
            _Engine(_low_pass_gain(step, reference.shortest / factor), _low_pass_gain(step, reference.longest * factor))
            for reference in references
        ]
        # A sudden fall is judged separately, over five times the confirmation: the shortest window with room for it.
        self._sudden = 5 * self._confirm if sudden else 0  # steps
        periods = max(1, self._confirm - 1)
        self._decay = [exp(-periods * step / reference.lag) if reference.lag > 0.0 else 0.0 for reference in references]
        self._sudden_decay = [(1.0 - engine.fast) ** self._sudden for engine in self._engines]
        delays = [reference.delay for reference in references]
        self._earliest = max(0, floor((min(delays) - spread) / step + 1e-9))
        self._latest = ceil((max(delays) + spread) / step - 1e-9)
        self.reset([0.0] * len(self._references))

    def reset(self, throttle: Sequence[float]) -> None:
        """Start with all engines healthy, settled at ``throttle``."""
        count = len(self._references)
        for engine in self._engines:
            engine.gain, engine.fixed = 1.0, 0.0
        self.health: tuple[JetHealth, ...] = (JetHealth(),) * count
        self.gains: PerJet = (1.0,) * count
        self.resume(throttle)

    def resume(self, throttle: Sequence[float]) -> None:
        """Monitor again after engines were off on purpose: settled at ``throttle``, in the health that they had."""
        at_rest = tuple(reference.thrust_at(u) for reference, u in zip(self._references, throttle, strict=True))
        # Steady thrust for each past command, oldest first.
        self._past = [at_rest] * (self._sudden + self._latest + 1)
        self._reports = [at_rest] * max(2, self._confirm)  # reported thrusts, oldest first
        self._window = [at_rest] * (2 * self._sudden + 1)  # reported thrusts, oldest first
        for engine, x in zip(self._engines, at_rest, strict=True):
            engine.settle(x)

    def update(self, throttle: PerJet, output: EngineOutput) -> bool:
        """Update with a step's throttles and the reports at its end; return whether a health changed."""
        past = self._past
        past.append(tuple([curve.straight_at(throttle[i]) for i, curve in enumerate(self._thrust_by_throttle)]))
        del past[0]
        reports = output.thrust
        if self._speeds:
            reports = self._reported_thrusts(output)
        self._reports.append(reports)
        del self._reports[0]
        suspects = []
        threshold, oldest = self._threshold, self._sudden
        earlier = reports
        if oldest:
            window = self._window
            window.append(reports)
            del window[0]
            earlier = window[oldest]
        for i, engine in enumerate(self._engines):
            x = reports[i]
            least = most = past[oldest][i]
            for j in range(oldest + 1, oldest + self._latest - self._earliest + 1):
                thrust = past[j][i]
                least, most = (thrust if thrust < least else least), (thrust if thrust > most else most)
            high, low = engine.follow(least, most)
            gain, fixed = engine.gain, engine.fixed
            excess, deficit = x - gain * high - fixed, gain * low + fixed - x
            if oldest > 0 and deficit <= threshold < earlier[i] - x and gain == 1.0:
                deficit = max(deficit, self._sudden_deficit(i, x))
            if excess <= threshold and deficit <= threshold:
                engine.outside = 0
                # Within half of the threshold the engine is taken to follow its command.
                if excess <= 0.5 * threshold and deficit <= 0.5 * threshold:
                    engine.agreed, engine.agreed_reference = x, 0.5 * (low + high)
                continue
            engine.outside += 1
            if engine.outside >= self._confirm:
                suspects.append(i)
        changes = [self._assess(i, reports[i]) for i in suspects]
        return any(changes)

    def _reported_thrusts(self, output: EngineOutput) -> PerJet:
        """Return the thrusts [N] computed from the reports, by :meth:`EngineReference.reported_to_thrust`."""
        thrusts = []
        for i, curve in enumerate(self._thrust_by_speed):
            speed = output.spool_speed[i]
            thrusts.append(output.thrust[i] if curve is None or speed != speed else curve.at(speed))
        return tuple(thrusts)

    def _sudden_deficit(self, i: int, x: float) -> float:
        """Return how far a thrust ``x`` [N] is below what a healthy engine reaches from its report a while ago."""
        start, before = self._window[self._sudden][i], self._window[0][i]
        least = start
        for commanded in self._past[: self._sudden + self._latest - self._earliest + 1]:
            least = commanded[i] if commanded[i] < least else least
        lowest = least + (start - least) * self._sudden_decay[i]
        return lowest - max(0.0, before - start) - x

    @property
    def reported_thrust(self) -> PerJet:
        """The thrust of the last reports [N]."""
        return self._reports[-1]

    @property
    def commanded_thrust(self) -> list[PerJet]:
        """Steady thrust for the last commands [N], oldest first, over at least the longest delay."""
        return list(self._past)

    def mark_shut_off(self, i: int) -> None:
        """Count engine ``i`` as failed, because it is shut off on purpose."""
        self._set_health(i, 0.0, 0.0)

    def have_started(self, throttle: PerJet, output: EngineOutput) -> bool:
        """Return whether all engines in use report their thrust at rest at ``throttle``, within the threshold."""
        reports = zip(self._references, self.gains, throttle, output.thrust, output.spool_speed, strict=True)
        return all(
            gain == 0.0 or abs(reference.reported_to_thrust(f, w) - reference.thrust_at(u)) <= self._threshold
            for reference, gain, u, f, w in reports
        )

    def have_settled(self, throttle: PerJet, output: EngineOutput) -> bool:
        """Return whether no engine reports more than its thrust at rest at ``throttle``, within the threshold."""
        reports = zip(self._references, throttle, output.thrust, output.spool_speed, strict=True)
        return all(
            reference.reported_to_thrust(f, w) <= reference.thrust_at(u) + self._threshold
            for reference, u, f, w in reports
        )

    def _assess(self, i: int, x: float, lost_below: float = 0.2, follows_above: float = 0.3) -> bool:
        """Update the health of an engine outside its healthy range for long enough; return whether it changed.

        It counts as lost below this fraction of the commanded thrust, and follows above this one of the change.
        """
        engine = self._engines[i]
        reference, gain = 0.5 * (engine.low + engine.high), engine.gain
        decay = self._decay[i]
        heading = max(0.0, (x - decay * self._reports[0][i]) / (1.0 - decay))
        if gain == 0.0:
            return self._set_health(i, 0.0, heading)
        change, commanded_change = abs(x - engine.agreed), gain * abs(reference - engine.agreed_reference)
        if change < follows_above * commanded_change:
            return engine.outside >= self._stuck and self._set_health(i, 0.0, x)
        if x > engine.high + self._threshold:
            # The engine comes down too slowly, or runs away.
            return change > commanded_change and self._set_health(i, 0.0, heading)
        gain_estimate = min(1.0, heading / reference) if reference > 0.0 else 1.0
        return self._set_health(i, 0.0 if gain_estimate < lost_below else gain_estimate, 0.0)

    def _set_health(self, i: int, gain: float, fixed: float) -> bool:
        engine = self._engines[i]
        engine.outside = 0
        if gain == engine.gain and fixed == engine.fixed:
            return False
        reference = self._references[i]
        idle, span = reference.thrust[0], reference.thrust[-1] - reference.thrust[0]
        low, high = self._limits
        # The throttle of a lost engine is closed: if it is lit again, it gives the least thrust.
        command = min(high, max(low, (fixed - idle) / span)) if fixed else 0.0
        engine.gain, engine.fixed = gain, fixed
        self.health = (*self.health[:i], JetHealth(gain, fixed / span, command), *self.health[i + 1 :])
        self.gains = tuple(one.gain for one in self.health)
        return True


class _Engine:
    """State of one engine: the range of a healthy one, and its deviation from that.

    ``fast`` and ``slow``: of the rest that a bound goes in a step, by the shortest and the longest lag.  ``gain`` and
    ``fixed`` [N]: what it gives of its command, and besides.
    """

    def __init__(self, fast: float, slow: float) -> None:
        self.fast, self.slow = fast, slow
        self.gain, self.fixed = 1.0, 0.0
        self.settle(0.0)

    def settle(self, thrust: float) -> None:
        """Start at rest at a thrust [N]."""
        self.high = self.low = thrust
        self.outside = 0  # steps outside of the threshold
        self.agreed = self.agreed_reference = thrust  # thrusts at the last agreement with model

    def follow(self, least: float, most: float) -> tuple[float, float]:
        """Return the bounds of a healthy thrust [N] after a step whose command gives ``least`` to ``most`` at rest."""
        high, low = self.high, self.low
        high += (self.fast if most > high else self.slow) * (most - high)
        low += (self.fast if least < low else self.slow) * (least - low)
        self.high, self.low = high, low
        return high, low


class _Curve:
    """Straight lines between fixed points; a look-up first tries the segment that was used last."""

    def __init__(self, xs: Sequence[float], ys: Sequence[float]) -> None:
        self._xs, self._ys = [float(x) for x in xs], [float(y) for y in ys]
        self._x = self._y = self._rise = 0.0  # last segment: lower point and slope
        self._end, self._run = -inf, 1.0
        self._start, slope = self._ys[0], self._ys[-1] - self._ys[0]
        self._slope = slope
        self._straight = all(abs(self._start + x * slope - y) <= 1e-9 * abs(slope) for x, y in zip(xs, ys, strict=True))

    def at(self, x: float) -> float:
        """Return the curve at ``x``, interpolated linearly and held constant beyond its ends."""
        if self._x <= x < self._end:
            return self._y + self._rise * (x - self._x) / self._run
        xs, ys = self._xs, self._ys
        if x <= xs[0]:
            return ys[0]
        if x >= xs[-1]:
            return ys[-1]
        k = bisect_right(xs, x)
        self._x, self._end, self._y = xs[k - 1], xs[k], ys[k - 1]
        self._rise, self._run = ys[k] - ys[k - 1], xs[k] - xs[k - 1]
        return self._y + self._rise * (x - self._x) / self._run

    def straight_at(self, u: float) -> float:
        """Return the curve at the throttle ``u``, by one straight line if all its points from 0 to 1 are on that."""
        return self._start + u * self._slope if self._straight else self.at(u)


def _low_pass_gain(step: float, lag: float) -> float:
    return 1.0 - exp(-step / lag) if lag > 0.0 else 1.0


def _interpolate(xs: Sequence[float], ys: Sequence[float], x: float) -> float:
    """Return the curve ``ys`` over ``xs`` at ``x``, interpolated linearly and constant beyond its ends."""
    if x <= xs[0]:
        return ys[0]
    if x >= xs[-1]:
        return ys[-1]
    k = bisect_right(xs, x)
    return ys[k - 1] + (ys[k] - ys[k - 1]) * (x - xs[k - 1]) / (xs[k] - xs[k - 1])
