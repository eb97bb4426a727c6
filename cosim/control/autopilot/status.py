"""The autopilot's state at one instant, and its messages to ground stations."""

from __future__ import annotations

from typing import NamedTuple

from cosim.base.protocols import EngineState
from cosim.base.signals import Measured
from cosim.control.autopilot.estimation.estimator import EstimateQuality
from cosim.control.autopilot.estimation.position import Fix
from cosim.control.autopilot.geometry import Pair
from cosim.control.autopilot.modes import Home, LandedState, Mode
from cosim.control.autopilot.requests import FenceZone, Orbit, RallyPoint


class Status(NamedTuple):
    """The state of the autopilot at one instant, for telemetry and records."""

    k: int
    mode: Mode
    armed: bool
    landed: LandedState
    engines: EngineState
    ready: bool
    refusals: tuple[str, ...]  # why arming would be refused
    home: Home | None
    fix: Fix
    target: Home | None  # where it flies to or stays
    track: Pair | None  # set-point on the way there, m
    altitude: float  # m, set-point or the last one
    yaw: float  # set-point, rad
    mission_count: int
    mission_current: int
    mission_reached: int  # last finished item; -1: none
    mission_done: bool
    failsafe: str  # why it acts; empty: it does not
    remaining: float | None  # of fuel or battery; None: unknown
    sticks_fresh: bool
    link_lost: bool
    zones: tuple[FenceZone, ...] = ()  # of the fence that was drawn
    rally: tuple[RallyPoint, ...] = ()
    orbit: Orbit | None = None  # that it flies; ``target`` is its centre
    positioned: bool = True  # fixes of the GNSS come
    seen: Measured | None = None  # attitude, rates, height, climb
    quality: EstimateQuality = EstimateQuality()
