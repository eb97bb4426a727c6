"""What the vehicle's messages are made of: its constants, a snapshot, and the state from one to the next."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from math import isnan, nan
from typing import Literal

from cosim.base.frames import to_euler
from cosim.base.geodesy import Geodesy
from cosim.base.protocols import EngineState
from cosim.base.signals import PerJet, Vector3
from cosim.control.autopilot.modes import LandedState
from cosim.groundstation.exchange import Snapshot

# Largest values of integer fields by type.
U8, U16, U32, I16, I32 = 0xFF, 0xFFFF, 0xFFFFFFFF, 0x7FFF, 0x7FFFFFFF
Personality = Literal["px4", "ardupilot", "generic"]  # autopilots that it imitates


@dataclass(frozen=True)
class VehicleConstants:
    """Constant data of a vehicle for telemetry: identity, outputs, engines, sensor noise."""

    geodesy: Geodesy
    jets: int
    name: str = "hexjet"
    version: str = "0.1.0"
    personality: Personality = "px4"
    system: int = 1
    tilt_range: float = nan  # rad, either way; NaN: tilts are in rad
    servos: tuple[str, ...] = ("left", "right")  # servo names as used in faults
    # Range of each servo angle, if the servos are not two banks.
    ranges: tuple[tuple[float, float], ...] = ()
    full_thrust: PerJet = ()  # N at full throttle; empty: unknown
    fuel_capacity: float = nan  # kg; NaN: no tank
    position_noise: float = nan  # m, deviation of the GNSS; NaN: unknown
    velocity_noise: float = nan  # m/s
    height_noise: float = nan  # m, of the barometer


@dataclass
class FlightEvents:
    """Times of flight events [us since 1970] and burnt fuel, for telemetry."""

    armed: int = 0
    took_off: int = 0
    landed_ms: int = 0  # ms of simulation time
    flights: int = 0
    burnt: tuple[float, ...] = ()  # kg burnt by each engine; NaN: unknown
    clock: Callable[[], float] = field(default=time.time)

    def update(self, before: TelemetryState | None, now: TelemetryState) -> None:
        """Record arming, take-off, landing and burnt fuel between two snapshots."""
        self._distribute_fuel(before, now)
        was, status = before.status if before else None, now.status
        if status.armed and not (was and was.armed):
            self.armed, self.took_off, self.landed_ms = self._wall_clock_us(), 0, 0
            self.flights += 1
        if status.landed is LandedState.IN_AIR and not self.took_off:
            self.took_off = self._wall_clock_us()
        if was and status.landed is LandedState.ON_GROUND and was.landed is not LandedState.ON_GROUND:
            self.landed_ms = now.ms

    def _distribute_fuel(self, before: TelemetryState | None, now: TelemetryState) -> None:
        """Distribute the fuel lost since the last snapshot over the engines, by their flows."""
        flows, full = now.sample.engines.fuel_flow[: now.vehicle.jets], now.vehicle.fuel_capacity
        spent, total = before.sample.fuel - now.sample.fuel if before else nan, sum(flows)
        if not spent >= 0.0:
            # The first snapshot, or the tank was refilled for another flight.
            self.burnt = (0.0 * full,) * len(flows)
        elif total > 0.0:
            shares = zip(self.burnt, flows, strict=True)
            self.burnt = tuple(burnt + spent * flow / total for burnt, flow in shares)

    def _wall_clock_us(self) -> int:
        return int(self.clock() * 1e6)


class TelemetryState:
    """Snapshot with derived values that several telemetry messages need."""

    def __init__(self, vehicle: VehicleConstants, snapshot: Snapshot, events: FlightEvents) -> None:
        assert snapshot.sample is not None
        self.vehicle = vehicle
        self.snapshot = snapshot
        self.events = events
        self.time = snapshot.time
        self.measured = snapshot.measured  # sensor measurements
        # The state is that after the step; the actuation is what acted during it.
        self.sample = snapshot.sample._replace(
            k=snapshot.k, time=snapshot.time, state=snapshot.state, measured=snapshot.measured
        )
        self.status, ending = snapshot.status, snapshot.ending
        # Engines that are off get the least throttle as input, which has no effect.
        if self.status.engines is EngineState.OFF:
            still = self.sample.actuation._replace(throttle=(0.0,) * len(self.sample.actuation.throttle))
            control = self.sample.control._replace(collective=0.0)
            self.sample = self.sample._replace(actuation=still, control=control)
        if ending is not None and ending.outcome != "completed":
            self.status = self.status._replace(failsafe=ending.reason)
        # Motion as estimated by the autopilot, or else as measured.
        self.estimate = self.status.seen or self.measured
        self.euler = to_euler(self.estimate.attitude)
        self.position_deg = vehicle.geodesy.to_geodetic(*self.status.fix.position, self.altitude)[:2]
        self.ms = round(snapshot.time * 1e3) & U32  # the field has 32 bits
        self.us = round(snapshot.time * 1e6)

    @property
    def predictor_signals(self) -> tuple[Vector3, Vector3, Vector3]:
        """Predictor models' rates without and with delay [rad/s], and delays [s], by axis; NaN: no predictor."""
        roll, pitch, yaw = self.snapshot.diagnostics
        step = self.snapshot.info.scenario.step_s
        return (
            (roll[0], pitch[0], yaw[0]),
            (roll[1], pitch[1], yaw[1]),
            (roll[2] * step, pitch[2] * step, yaw[2] * step),
        )

    @property
    def remaining(self) -> float | None:
        """Remaining fraction of the full tank or battery; None: unknown."""
        full, fuel = self.vehicle.fuel_capacity, self.sample.fuel
        return self.status.remaining if isnan(full) or isnan(fuel) else min(1.0, max(0.0, fuel / full))

    @property
    def altitude(self) -> float:
        """Estimated height above the origin [m]."""
        return self.estimate.altitude

    @property
    def height_above_home(self) -> float:
        return self.altitude - (self.status.home.altitude if self.status.home else 0.0)

    @property
    def altitude_above_sea(self) -> float:
        return self.vehicle.geodesy.ground + self.altitude


def to_field(value: float, low: int, high: int) -> int:
    """Return a value as an integer clipped to a field's range; NaN becomes 0."""
    return 0 if isnan(value) else round(min(max(value, low), high))


def to_e7(angle_deg: float) -> int:
    return to_field(angle_deg * 1e7, -I32, I32)


def to_mm(metres: float) -> int:
    return to_field(metres * 1e3, -I32, I32)
