"""Gains and limits of a vehicle's controllers and autopilot."""

from itertools import pairwise
from operator import not_
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from cosim.base.storage.toml import Axis3, Model, NotNegative, Positive


class AttitudeGains(Model):
    """Gain of the quaternion P law: rate set-point = gain x attitude error, limited per axis."""

    gain_1_s: Axis3
    rate_limit_rad_s: tuple[Positive, Positive, Positive]


class RateGains(Model):
    """Gains of the rate PID of one axis; output in throttle (roll) or rad of tilt (pitch, yaw)."""

    p: NotNegative
    i: NotNegative
    d: NotNegative
    d_filter_s: Positive
    integral_limit: NotNegative


class RateControl(Model):
    roll: RateGains
    pitch: RateGains
    yaw: RateGains


class EngineLead(Model):
    """Poles of an engine and those to which a lead moves them; see :mod:`cosim.control.lead`."""

    natural_rad_s: Positive  # of a pole pair; without damping of a lag
    damping: Positive | None = None  # None: a single lag
    pole_rad_s: Positive  # each of the poles becomes minus this


class Leads(Model):
    """The lead of each engine command; false removes a lead that the aircraft has."""

    roll: EngineLead | Literal[False] | None = None
    pitch: EngineLead | Literal[False] | None = None
    yaw: EngineLead | Literal[False] | None = None
    altitude: EngineLead | Literal[False] | None = None


class ScheduledGains(Model):
    """Factors on one command's nominal gains at a thrust level, and its lead."""

    angle: Positive = 1.0  # factor on attitude or position_1_s
    p: Positive = 1.0  # height: factor on velocity_1_s
    i: Positive = 1.0  # height: factor on integral_1_s2
    d: Positive = 1.0
    natural_rad_s: Positive | None = None  # as in EngineLead, at this thrust
    damping: Positive | None = None
    pole_rad_s: Positive | None = None

    @property
    def lead(self) -> EngineLead | None:
        if self.natural_rad_s is None or self.pole_rad_s is None:
            return None
        return EngineLead(natural_rad_s=self.natural_rad_s, damping=self.damping, pole_rad_s=self.pole_rad_s)


class ThrustLevel(Model):
    """One thrust level of a gain schedule."""

    share: Annotated[float, Field(ge=0.0, le=1.0)]  # collective, in the engines' range
    roll: ScheduledGains = Field(default_factory=ScheduledGains)
    altitude: ScheduledGains = Field(default_factory=ScheduledGains)


class Schedule(Model):
    """Gains and leads by thrust level, interpolated linearly, constant outside."""

    filter_s: Positive  # lag of the collective in the schedule
    level: Annotated[list[ThrustLevel], Field(min_length=2)]  # smallest share first

    @model_validator(mode="after")
    def _check_levels(self) -> Self:
        shares = [level.share for level in self.level]
        if any(b <= a for a, b in pairwise(shares)):
            raise ValueError(f"level: every share must be above the one before it, not {shares}")
        return self


class AltitudeGains(Model):
    """Gains of height control: P to climb rate, PI to vertical acceleration, hover throttle fed forward."""

    position_1_s: NotNegative
    climb_limit_m_s: Positive
    descent_limit_m_s: Positive
    velocity_1_s: NotNegative
    integral_1_s2: NotNegative
    integral_limit_m_s2: NotNegative


class AllocationLimits(Model):
    throttle_min: Annotated[float, Field(ge=0.0, lt=1.0)]
    throttle_max: Annotated[float, Field(gt=0.0, le=1.0)]
    # "banks" for a vehicle with [servo]; "rotors" if all jets point straight up; "effectiveness" for any. None: chosen
    # by the vehicle.
    method: Literal["banks", "rotors", "effectiveness"] | None = None
    # With effectiveness: keep the force along x and y at zero where that costs nothing else.
    horizontal: Annotated[bool, Field(exclude_if=not_)] = False

    @model_validator(mode="after")
    def _check_throttle_limits(self) -> Self:
        if self.throttle_min >= self.throttle_max:
            raise ValueError(f"throttle_min {self.throttle_min} must be below throttle_max {self.throttle_max}")
        return self


class PredictorTuning(Model):
    """Tuning of predictors besides the identified model; each reads its own keys."""

    filter_s: NotNegative  # filtered Smith: lag of the filter
    observer_rad_s: Positive  # state: both observer poles at minus this
    model_observer_rad_s: Positive  # state-model: observer poles
    disturbance_observer_rad_s: Positive  # state-disturbance: observer poles
    # Parameters of predictors from plug-ins, by predictor name.
    own: dict[str, dict[str, float]] = Field(default_factory=dict, exclude_if=not_)


class PositionGains(Model):
    """Velocity and position control above the attitude loop, and the filter that estimates both from the GNSS."""

    position_1_s: Positive
    velocity_1_s: Positive
    catch_up_m_s: Positive  # limit of speed for a position error
    lean_rad: Annotated[float, Field(gt=0.0, lt=1.2)]  # limit of commanded lean
    # White acceleration that the attitude does not explain: m/s^2 per root Hz.
    acceleration_noise_m_s15: Positive
    # Random walk of its slow part, such as wind on the body: m/s^2 per root s.
    disturbance_walk_m_s25: Positive


class PilotSettings(Model):
    """Initial autopilot settings, which its parameters change."""

    speed_m_s: Positive
    acceleration_m_s2: Positive
    jerk_m_s3: Positive
    climb_m_s: Positive
    descent_m_s: Positive
    land_m_s: Positive
    yaw_rate_rad_s: Positive
    stick_lean_rad: Annotated[float, Field(gt=0.0, lt=1.2)]
    takeoff_height_m: Positive
    return_height_m: Positive
    spool_s: Positive  # from idle to hover, before take-off
    endurance_s: NotNegative = 0.0  # hover on a full battery; 0: unknown


class MonitorSettings(Model):
    """Thresholds of the engine monitor."""

    threshold: Positive  # of hover thrust, off the healthy range
    confirm_s: Positive  # for this long without a break
    stuck_s: Positive  # until the engine counts as stuck
    lag_factor: Annotated[float, Field(ge=1.0)]  # a healthy lag is within this factor
    delay_spread_s: NotNegative  # a healthy delay is within this
    # Whether to shut off the engine across the centre of gravity when the first one has failed.
    shut_opposite: bool = False
    # Whether to catch the vehicle afterwards. With tilting jets: fly roll and height by the catch law until the thrust
    # is made up for. Where no jet tilts: with one of four rotors out, control the thrust direction while spinning. With
    # allocation by effectiveness: with an engine out, turn by the hinges alone and carry by the throttles.
    catch: bool = False


class WingControl(Model):
    """Settings of wing-borne forward flight; see :mod:`cosim.control.phases.wing`."""

    tilts: Annotated[list[str], Field(min_length=1)]  # hinges that turn thrust forward
    acceleration_m_s2: Positive  # largest rise of the speed set-point
    braking_m_s2: Positive  # largest fall of the speed set-point
    velocity_1_s: Positive  # acceleration per speed error
    integral_1_s2: NotNegative  # acceleration per integrated speed error
    integral_limit_m_s2: NotNegative  # limit of the integral part
    alpha_rad: tuple[float, float]  # range of the demand
    alpha_filter_s: NotNegative  # lag of the demand
    open_m_s: Positive  # speed from which all of alpha is used
    aside_1_s: NotNegative  # bank per drift to the side
    bank_rad: Annotated[float, Field(ge=0.0, lt=1.2)]  # limit of the bank

    @model_validator(mode="after")
    def _check_alpha(self) -> Self:
        least, most = self.alpha_rad
        if not -0.6 <= least < most <= 0.6:
            raise ValueError(f"alpha_rad [{least:g}, {most:g}]: least, then most, within -0.6 to 0.6 rad")
        return self


class Control(Model):
    attitude: AttitudeGains
    rate: RateControl
    altitude: AltitudeGains
    allocation: AllocationLimits
    predictor: PredictorTuning
    lead: Leads | None = None
    # False: no schedule, even if the aircraft states one.
    schedule: Schedule | Literal[False] | None = None
    monitor: MonitorSettings | None = None
    position: PositionGains | None = None
    pilot: PilotSettings | None = None
    wing: Annotated[WingControl | None, Field(exclude_if=not_)] = None  # None: no forward speed can be commanded

    @model_validator(mode="after")
    def _check_leads(self) -> Self:
        """Require each lead's parameters at every level of the schedule, with damping where the lead has it."""
        for number, level in enumerate(self.schedule.level if self.schedule else ()):
            for name, stated in (("roll", level.roll), ("altitude", level.altitude)):
                lead = getattr(self.lead, name, None)
                if not lead:
                    continue
                where = f"schedule.level.{number}.{name}"
                if stated.lead is None:
                    raise ValueError(f"{where}: control.lead.{name} needs natural_rad_s and pole_rad_s at every level")
                if (stated.damping is None) != (lead.damping is None):
                    raise ValueError(
                        f"{where}: damping must be stated where control.lead.{name} has one, and only there"
                    )
        return self
