"""Gains that follow the thrust level: an engine answers more slowly at less thrust, and fuel burns.

The level is the mean share of the engines' range that allocation gives, behind a first-order lag,

    level_k+1 = level_k + (1 - e^(-T / filter)) (share_k - level_k),  not below the first level nor above the last,

and between two levels of the schedule every number is linear in it.  Factors act on the gains stated for the vehicle,
so that a change of those in flight counts at every level.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp
from typing import NamedTuple

from cosim.base.limits import clip
from cosim.spec.vehicle import (
    EngineLead,
    Leads,
    Schedule,
    ScheduledGains,
)

FINE = 1e-3  # of the range of the schedule: so far the level moves before the gains do


class Factors(NamedTuple):
    """On the gains of one command, and its lead; None where it has none."""

    angle: float
    p: float
    i: float
    d: float
    lead: EngineLead | None


class Scheduled(NamedTuple):
    """What acts at a level."""

    share: float
    roll: Factors
    altitude: Factors


class GainSchedule:
    """The schedule of a vehicle."""

    def __init__(self, stated: Schedule, leads: Leads | None, step: float) -> None:
        self._shares = [level.share for level in stated.level]
        self._roll = [_nominal_factors(level.roll, bool(leads and leads.roll)) for level in stated.level]
        self._altitude = [_nominal_factors(level.altitude, bool(leads and leads.altitude)) for level in stated.level]
        self._follow = 1.0 - exp(-step / stated.filter_s)
        self._fine = FINE * (self._shares[-1] - self._shares[0])
        self.reset(self._shares[-1])

    def reset(self, share: float) -> Scheduled:
        """As if this had always been the collective."""
        self._level = self._told = self._bounded(share)
        return self.at(self._level)

    def update(self, collective: float) -> Scheduled | None:
        """Return the gains from now on, None if unchanged; ``collective``: the mean thrust fraction allocated."""
        level = self._level + self._follow * (self._bounded(collective) - self._level)
        self._level = level
        if abs(level - self._told) < self._fine:
            return None
        self._told = level
        return self.at(level)

    def _bounded(self, share: float) -> float:
        return clip(share, self._shares[0], self._shares[-1])

    def at(self, share: float) -> Scheduled:
        """Return the gains and leads at a thrust level."""
        share = self._bounded(share)
        shares = self._shares
        k = 1
        while k < len(shares) - 1 and share > shares[k]:
            k += 1
        part = (share - shares[k - 1]) / (shares[k] - shares[k - 1])
        return Scheduled(share, _interpolate(self._roll, k, part), _interpolate(self._altitude, k, part))


def _nominal_factors(level: ScheduledGains, led: bool) -> Factors:
    return Factors(level.angle, level.p, level.i, level.d, level.lead if led else None)


def _interpolate(levels: Sequence[Factors], k: int, part: float) -> Factors:
    low, high = levels[k - 1], levels[k]

    def of(a: float, b: float) -> float:
        return a + part * (b - a)

    lead: EngineLead | None = None
    one, other = low.lead, high.lead
    if one is not None and other is not None:
        damping: float | None = None
        if one.damping is not None and other.damping is not None:
            damping = of(one.damping, other.damping)
        # between two that were checked: not checked again, which takes as long as a step
        lead = EngineLead.model_construct(
            natural_rad_s=of(one.natural_rad_s, other.natural_rad_s),
            damping=damping,
            pole_rad_s=of(one.pole_rad_s, other.pole_rad_s),
        )
    return Factors(of(low.angle, high.angle), of(low.p, high.p), of(low.i, high.i), of(low.d, high.d), lead)
