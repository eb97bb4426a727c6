"""The engine monitor: which engines follow their commands, from what a flight computer knows of them.

It uses the commanded throttles and the reports of the engines' own controllers: the speed of the spool, turned into
thrust through the engine's static curves, or where no speed is reported the thrust itself, which then stands for the
estimate that an electronic speed controller makes from speed and current.  Injected faults are not reported to it.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from math import ceil, exp, floor
from typing import NamedTuple

from cosim.base.signals import EngineOutput, JetHealth, PerJet
from cosim.spec.vehicle import MonitorSettings

_LOST_GAIN = 0.2  # fraction of the commanded thrust below which an engine counts as lost; chosen by us
_FOLLOWS = 0.3  # fraction of the commanded change; an engine that moved less does not follow it; chosen by us
_EXACT = 0.5  # fraction of the threshold within which an engine is taken to follow its command at that moment
# times the confirmation: over so long a fall is looked at by itself; chosen by us: the least with room for it
_SUDDEN = 5


class EngineReference(NamedTuple):
    """Response of a healthy engine: static curves, and a lag behind a delay."""

    throttle: Sequence[float]
    thrust: Sequence[float]  # N, at each throttle
    speed: Sequence[float] | None  # rad/s, at each throttle; None where the engine reports none
    lag: float  # s, about hover
    delay: float  # s
    shortest: float  # s, the shortest lag anywhere in its range, up or down
    longest: float  # s

    def thrust_at(self, throttle: float) -> float:
        """Return the thrust at rest [N]."""
        return _interpolate(self.throttle, self.thrust, throttle)

    def reported_to_thrust(self, thrust: float, speed: float) -> float:
        """Return the thrust [N] that a report stands for, by the spool's speed where it is measured."""
        if self.speed is None or speed != speed:
            return thrust
        return _interpolate(self.speed, self.thrust, speed)


class EngineMonitor:
    """Compares every engine with an interval that a healthy one cannot leave, and estimates what it gives.

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
        self._filter_gains = [
            (_filter_gain(step, reference.shortest / factor), _filter_gain(step, reference.longest * factor))
            for reference in references
        ]
        self._sudden = _SUDDEN * self._confirm if sudden else 0  # steps
        periods = max(1, self._confirm - 1)
        self._decay = [exp(-periods * step / reference.lag) if reference.lag > 0.0 else 0.0 for reference in references]
        self._sudden_decay = [(1.0 - fast) ** self._sudden for fast, _ in self._filter_gains]
        delays = [reference.delay for reference in references]
        self._earliest = max(0, floor((min(delays) - spread) / step + 1e-9))
        self._latest = ceil((max(delays) + spread) / step - 1e-9)
        self.reset([0.0] * len(self._references))

    def reset(self, throttle: Sequence[float]) -> None:
        """Start with all engines healthy, settled at ``throttle``."""
        count = len(self._references)
        self._fixed_thrust = [0.0] * count  # N, of an engine that does not follow its command
        self.health: tuple[JetHealth, ...] = (JetHealth(),) * count
        self.gains: PerJet = (1.0,) * count
        self.resume(throttle)

    def resume(self, throttle: Sequence[float]) -> None:
        """Monitor again after engines were off on purpose: settled at ``throttle``, in the health that they had."""
        at_rest = tuple(reference.thrust_at(u) for reference, u in zip(self._references, throttle, strict=True))
        count = len(at_rest)
        # thrust that the commands ask for at rest, oldest first
        self._past = [at_rest] * (self._sudden + self._latest + 1)
        self._reports = [at_rest] * max(2, self._confirm)  # oldest first
        self._window = [at_rest] * (2 * self._sudden + 1)  # reports over a longer window, oldest first
        self._high, self._low = list(at_rest), list(at_rest)
        self._outside = [0] * count
        self._agreement = [(x, x) for x in at_rest]  # report and reference when they last agreed

    def update(self, throttle: PerJet, output: EngineOutput) -> bool:
        """Update by one step: its throttles, and the reports at its end.  Return whether a health changed."""
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
        for i, x in enumerate(reports):
            least = most = past[oldest][i]
            for j in range(oldest + 1, oldest + self._latest - self._earliest + 1):
                thrust = past[j][i]
                least, most = (thrust if thrust < least else least), (thrust if thrust > most else most)
            fast, slow = self._filter_gains[i]
            high, low = self._high[i], self._low[i]
            high += (fast if most > high else slow) * (most - high)
            low += (fast if least < low else slow) * (least - low)
            self._high[i], self._low[i] = high, low
            gain, fixed = self.gains[i], self._fixed_thrust[i]
            excess, deficit = x - gain * high - fixed, gain * low + fixed - x
            if oldest > 0 and deficit <= threshold < earlier[i] - x and gain == 1.0:
                deficit = max(deficit, self._sudden_deficit(i, x))
            if excess <= threshold and deficit <= threshold:
                self._outside[i] = 0
                if excess <= _EXACT * threshold and deficit <= _EXACT * threshold:
                    self._agreement[i] = (x, 0.5 * (low + high))
                continue
            self._outside[i] += 1
            if self._outside[i] >= self._confirm:
                suspects.append(i)
        changes = [self._assess(i, reports[i]) for i in suspects]
        return any(changes)

    def _reported_thrusts(self, output: EngineOutput) -> PerJet:
        """Return the thrusts [N] that the reports stand for, as :meth:`EngineReference.reported_to_thrust`."""
        thrusts = []
        for i, curve in enumerate(self._thrust_by_speed):
            speed = output.spool_speed[i]
            thrusts.append(output.thrust[i] if curve is None or speed != speed else curve.at(speed))
        return tuple(thrusts)

    def _sudden_deficit(self, i: int, x: float) -> float:
        """Return how far ``x`` is below what a healthy engine can have reached, from its report a while ago."""
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
        """The thrust that the last commands give at rest [N], oldest first: over the longest delay and more."""
        return list(self._past)

    def mark_shut_off(self, i: int) -> None:
        """Count engine ``i`` as lost: it is shut off on purpose."""
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

    def _assess(self, i: int, x: float) -> bool:
        """Set the health of an engine that has been outside for long enough; return whether it changed."""
        reference, gain = 0.5 * (self._low[i] + self._high[i]), self.gains[i]
        decay = self._decay[i]
        heading = max(0.0, (x - decay * self._reports[0][i]) / (1.0 - decay))
        if gain == 0.0:
            return self._set_health(i, 0.0, heading)
        x_then, reference_then = self._agreement[i]
        change, commanded_change = abs(x - x_then), gain * abs(reference - reference_then)
        if change < _FOLLOWS * commanded_change:
            return self._outside[i] >= self._stuck and self._set_health(i, 0.0, x)
        if x > self._high[i] + self._threshold:
            # It is slow to come down, or runs away.
            return change > commanded_change and self._set_health(i, 0.0, heading)
        gain_estimate = min(1.0, heading / reference) if reference > 0.0 else 1.0
        return self._set_health(i, 0.0 if gain_estimate < _LOST_GAIN else gain_estimate, 0.0)

    def _set_health(self, i: int, gain: float, fixed: float) -> bool:
        self._outside[i] = 0
        if (gain, fixed) == (self.gains[i], self._fixed_thrust[i]):
            return False
        reference = self._references[i]
        idle, span = reference.thrust[0], reference.thrust[-1] - reference.thrust[0]
        low, high = self._limits
        # The throttle of a lost engine is closed: if it is lit again, it gives the least thrust.
        command = min(high, max(low, (fixed - idle) / span)) if fixed else 0.0
        self._fixed_thrust[i] = fixed
        self.health = (*self.health[:i], JetHealth(gain, fixed / span, command), *self.health[i + 1 :])
        self.gains = tuple(one.gain for one in self.health)
        return True


class _Curve:
    """:func:`_interpolate` through fixed points, where it looks first between those of the last answer."""

    def __init__(self, xs: Sequence[float], ys: Sequence[float]) -> None:
        self._xs, self._ys = [float(x) for x in xs], [float(y) for y in ys]
        self._last = 1
        self._start, slope = self._ys[0], self._ys[-1] - self._ys[0]
        self._slope = slope
        self._straight = all(abs(self._start + x * slope - y) <= 1e-9 * abs(slope) for x, y in zip(xs, ys, strict=True))

    def at(self, x: float) -> float:
        """Return the value at ``x``."""
        xs, ys = self._xs, self._ys
        if x <= xs[0]:
            return ys[0]
        if x >= xs[-1]:
            return ys[-1]
        k = self._last
        if not xs[k - 1] <= x < xs[k]:
            k = self._last = bisect_right(xs, x)
        return ys[k - 1] + (ys[k] - ys[k - 1]) * (x - xs[k - 1]) / (xs[k] - xs[k - 1])

    def straight_at(self, u: float) -> float:
        """Return the value at a throttle: by one line where the points from 0 to 1 are on it."""
        return self._start + u * self._slope if self._straight else self.at(u)


def _filter_gain(step: float, lag: float) -> float:
    return 1.0 - exp(-step / lag) if lag > 0.0 else 1.0


def _interpolate(xs: Sequence[float], ys: Sequence[float], x: float) -> float:
    """Interpolate linearly, constant beyond the ends."""
    if x <= xs[0]:
        return ys[0]
    if x >= xs[-1]:
        return ys[-1]
    k = bisect_right(xs, x)
    return ys[k - 1] + (ys[k] - ys[k - 1]) * (x - xs[k - 1]) / (xs[k] - xs[k - 1])
