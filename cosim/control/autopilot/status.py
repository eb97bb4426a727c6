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
    """State of the autopilot at one instant, for telemetry and records."""

    k: int
    mode: Mode
    armed: bool
    landed: LandedState
    engines: EngineState
    ready: bool
    refusals: tuple[str, ...]  # why arming would be refused
    home: Home | None
    fix: Fix
    target: Home | None  # position that it flies to or holds
    track: Pair | None  # horizontal set-point on the way, m
    altitude: float  # set-point [m], or the last one
    yaw: float  # set-point, rad
    mission_count: int
    mission_current: int
    mission_reached: int  # last completed item; -1: none
    mission_done: bool
    failsafe: str  # reason of the active failsafe; or empty
    remaining: float | None  # fraction of fuel or battery, if known
    sticks_fresh: bool
    link_lost: bool
    zones: tuple[FenceZone, ...] = ()  # zones of the drawn fence
    rally: tuple[RallyPoint, ...] = ()
    orbit: Orbit | None = None  # circle flown; ``target``: its centre
    positioned: bool = True  # whether GNSS fixes arrive
    seen: Measured | None = None  # estimated attitude, rates and height
    quality: EstimateQuality = EstimateQuality()
