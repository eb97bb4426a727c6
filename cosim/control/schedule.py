"""Gains that follow the thrust level: an engine answers more slowly at less thrust, and fuel burns.

The level is the mean thrust fraction that allocation gives, behind a first-order lag,

    level_k+1 = level_k + (1 - e^(-T / filter)) (share_k - level_k),  not below the first level nor above the last,

and between two levels of the schedule every number is linear in it.  Factors act on the nominal gains of the vehicle,
so that a change of those in flight acts at every level.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp
from typing import NamedTuple

from cosim.base.limits import clip
from cosim.spec.vehicle import EngineLead, Leads, Schedule, ScheduledGains

# Least change of thrust, as a fraction of the schedule's range, at which gains change.
SCHEDULE_RESOLUTION = 1e-3


class Factors(NamedTuple):
    """Factors on the gains of one command, and its lead if it has one."""

    angle: float
    p: float
    i: float
    d: float
    lead: EngineLead | None


class Scheduled(NamedTuple):
    """Gain factors and leads of roll and height at a thrust level."""

    thrust_fraction: float
    roll: Factors
    altitude: Factors


class GainSchedule:
    """Gain schedule of a vehicle by its thrust level."""

    def __init__(self, schedule: Schedule, leads: Leads | None, step: float) -> None:
        self._levels = [level.share for level in schedule.level]
        self._roll = [_nominal_factors(level.roll, bool(leads and leads.roll)) for level in schedule.level]
        self._altitude = [_nominal_factors(level.altitude, bool(leads and leads.altitude)) for level in schedule.level]
        self._filter_gain = 1.0 - exp(-step / schedule.filter_s)
        self._resolution = SCHEDULE_RESOLUTION * (self._levels[-1] - self._levels[0])
        self.reset(self._levels[-1])

    def reset(self, thrust_fraction: float) -> Scheduled:
        """Start as if the collective had always been ``thrust_fraction``; return its gains."""
        self._level = self._last_level = self._clip_to_levels(thrust_fraction)
        return self.at(self._level)

    def update(self, collective: float) -> Scheduled | None:
        """Return the gains from now on, or None if unchanged; ``collective``: the mean allocated thrust fraction."""
        level = self._level + self._filter_gain * (self._clip_to_levels(collective) - self._level)
        self._level = level
        if abs(level - self._last_level) < self._resolution:
            return None
        self._last_level = level
        return self.at(level)

    def _clip_to_levels(self, thrust_fraction: float) -> float:
        return clip(thrust_fraction, self._levels[0], self._levels[-1])

    def at(self, thrust_fraction: float) -> Scheduled:
        """Return the interpolated gain factors and leads at a thrust level."""
        thrust_fraction = self._clip_to_levels(thrust_fraction)
        levels = self._levels
        k = 1
        while k < len(levels) - 1 and thrust_fraction > levels[k]:
            k += 1
        weight = (thrust_fraction - levels[k - 1]) / (levels[k] - levels[k - 1])
        return Scheduled(thrust_fraction, _mix_levels(self._roll, k, weight), _mix_levels(self._altitude, k, weight))


def _nominal_factors(level: ScheduledGains, has_lead: bool) -> Factors:
    return Factors(level.angle, level.p, level.i, level.d, level.lead if has_lead else None)


def _mix_levels(levels: Sequence[Factors], k: int, weight: float) -> Factors:
    low, high = levels[k - 1], levels[k]

    def mix(a: float, b: float) -> float:
        return a + weight * (b - a)

    lead: EngineLead | None = None
    low_lead, high_lead = low.lead, high.lead
    if low_lead is not None and high_lead is not None:
        damping: float | None = None
        if low_lead.damping is not None and high_lead.damping is not None:
            damping = mix(low_lead.damping, high_lead.damping)
        # Between two valid leads validation is skipped: it takes as long as a step.
        lead = EngineLead.model_construct(
            natural_rad_s=mix(low_lead.natural_rad_s, high_lead.natural_rad_s),
            damping=damping,
            pole_rad_s=mix(low_lead.pole_rad_s, high_lead.pole_rad_s),
        )
    return Factors(mix(low.angle, high.angle), mix(low.p, high.p), mix(low.i, high.i), mix(low.d, high.d), lead)
