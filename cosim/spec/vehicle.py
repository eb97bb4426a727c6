"""A vehicle as its ``vehicle.toml`` states it: geometry, mass, engine stations, sensors, gains, identified models.

Body frame: forward-right-down (FRD), origin at the centre of gravity of the vehicle as built.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import hypot
from pathlib import Path
from re import fullmatch
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from cosim.base.constants import SERVOS, Side
from cosim.base.errors import InputError, nearest
from cosim.base.layout import UP, Layout, Station, Turn
from cosim.base.signals import MOST_JETS
from cosim.base.storage.cache import Memory
from cosim.base.storage.paths import data_folder, names_in
from cosim.base.storage.toml import (
    Model,
    NotNegative,
    Positive,
    Vector,
    merge,
    read_toml,
    validate,
)
from cosim.spec.plausible import implausible
from cosim.spec.scaling import scaled

VEHICLE = "vehicle.toml"  # in an aircraft's folder
STEP_S = 0.004  # the control step of who states none: the paper's 250 Hz
Step = Annotated[float, Field(gt=0.0, le=0.1)]  # s, of control
Axis3 = tuple[NotNegative, NotNegative, NotNegative]
Samples = Annotated[int, Field(ge=0, le=1000)]


def _unit(axis: Vector) -> Vector:
    """The direction of a vector that is not zero; one of length 1 stays as it is, to the last bit."""
    length = hypot(*axis)
    if not length:
        raise ValueError("must have a direction, not [0, 0, 0]")
    if abs(length - 1.0) <= 1e-15:
        return axis
    return (axis[0] / length, axis[1] / length, axis[2] / length)


Direction = Annotated[Vector, AfterValidator(_unit)]


class Airflow(Model):
    """The air that one engine swallows: ``kg_s (thrust / at_thrust_n)^exponent``, and where on its axis it does so."""

    kg_s: Positive
    at_thrust_n: Positive
    exponent: NotNegative
    intake_m: float  # from the station along the thrust
    exhaust_m: float  # the same for where it leaves


class Jet(Model):
    """One engine station: fixed to the body, on a tilting bank, or on hinges."""

    position_m: Vector  # body, from the centre of gravity of the vehicle as built
    axis: Direction | None = None  # of the thrust on the vehicle, body, hinges at zero; None: straight up, [0, 0, -1]
    servo: Side | None = None
    # moment on the frame per thrust, against the thrust's direction: with thrust straight up positive turns the nose
    # right
    reaction_m: float = 0.0
    spin: Literal[-1, 0, 1] = 0  # sense of the rotor about the thrust, right-handed; 0: its spin is not modelled
    engine: str | None = None  # of another kind than the scenario's; None: as that
    airflow: Airflow | None = None  # of an engine of its own; None: that of the vehicle
    effort: Positive = 1.0  # of allocation by effectiveness: how dear its range is beside that of the others

    @model_serializer(mode="wrap")
    def _without_the_usual(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        stated: dict[str, Any] = handler(self)
        if stated.get("effort") == 1.0:
            del stated["effort"]
        return {key: value for key, value in stated.items() if value is not None or key == "servo"}


class Servo(Model):
    """A tilt servo: first-order lag, then rate and range limits."""

    lag_s: NotNegative
    rate_limit_rad_s: Positive
    range_rad: Annotated[float, Field(gt=0.0, le=3.2)]  # either way from straight up
    bank_inertia_kg_m2: NotNegative = 0.0  # of one bank about its tilt axis; 0: turning it does not turn the body
    bank_imbalance_kg_m: float = 0.0  # mass of one bank times how far its centre is from that axis along the thrust


class Hinge(Model):
    """What turns about an axis, by a servo of its own, and moves jets or their thrust: a bank, a gimbal, a vane.

    Its servo is a first-order lag with rate and range limited.  What turns has ``mass_kg`` with its centre at
    ``centre_m`` (hinge at zero) and ``inertia_kg_m2`` about the hinge's axis, all of it a part of the vehicle's.
    """

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=24)]  # in the log, and where faults name it
    position_m: Vector  # body: a point of its axis
    axis: Direction  # body; positive turns right-handed about it
    carries: list[Annotated[int, Field(ge=1)]] = Field(default_factory=list)  # jets, from 1, that stand on it
    deflects: list[Annotated[int, Field(ge=1)]] = Field(default_factory=list)  # jets whose thrust alone it turns
    effect: float = 1.0  # angle of the thrust that it deflects over its own
    lag_s: NotNegative
    rate_limit_rad_s: Positive
    range_rad: Positive | tuple[float, float]  # either way from zero, or least and most
    rest_rad: float = 0.0  # where it stands at the start, and where allocation leaves it if nothing is asked of it
    mass_kg: NotNegative = 0.0
    centre_m: Vector | None = None  # body; None: on the axis
    inertia_kg_m2: NotNegative = 0.0  # 0: turning it does not turn the body
    effort: Positive = 1.0

    @property
    def least_most(self) -> tuple[float, float]:
        """The ends of its range, rad."""
        return self.range_rad if isinstance(self.range_rad, tuple) else (-self.range_rad, self.range_rad)

    @model_validator(mode="after")
    def _can_be(self) -> Hinge:
        least, most = self.least_most
        if least >= most:
            raise ValueError(f"range_rad [{least:g}, {most:g}]: the first must be below the second")
        if not least <= self.rest_rad <= most:
            raise ValueError(f"rest_rad {self.rest_rad:g}: must be within range_rad, {least:g} to {most:g}")
        if max(abs(least), abs(most)) > 3.2:
            raise ValueError(f"range_rad [{least:g}, {most:g}]: is more than half a turn either way: which unit?")
        if not self.carries and not self.deflects:
            raise ValueError("carries, deflects: name the jets that it moves, numbered from 1")
        if set(self.carries) & set(self.deflects):
            raise ValueError(
                f"deflects {self.deflects}: what a hinge carries turns with it as a whole; name a jet once"
            )
        if self.centre_m is not None:
            x, y, z = (c - p for c, p in zip(self.centre_m, self.position_m, strict=True))
            a, b, c = self.axis
            off = x * x + y * y + z * z - (a * x + b * y + c * z) ** 2
            if self.mass_kg * off > self.inertia_kg_m2 * (1.0 + 1e-9):
                raise ValueError(
                    f"inertia_kg_m2 {self.inertia_kg_m2:g}: {self.mass_kg:g} kg with the centre that far from the axis "
                    f"have at least {self.mass_kg * off:.3g} about it"
                )
        return self


class Surface(Model):
    """A surface of the JSBSim model that is commanded: a property of it, set by a servo of its own."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=24)]
    property: Annotated[str, Field(pattern=r"^[A-Za-z0-9_./\[\]-]+$")]  # of the JSBSim model: fcs/elevator-cmd-norm
    lag_s: NotNegative
    rate_limit_1_s: Positive  # of the property's own unit
    range: tuple[float, float] = (-1.0, 1.0)
    # airspeed along x at which allocation has the model say what it does; chosen by us: of small jets in transition
    at_m_s: Positive = 20.0
    effort: Positive = 1.0

    @model_validator(mode="after")
    def _has_a_range(self) -> Surface:
        if not self.range[0] <= 0.0 <= self.range[1] or self.range[0] == self.range[1]:
            raise ValueError(f"range {list(self.range)}: least and most, and 0 within them")
        return self


class Panel(Model):
    """A flat part that is drawn and does nothing else: of a wing, a tail, a surface.

    What a named surface moves turns right-handed about the edge from the first corner to the second.
    """

    corners_m: Annotated[list[Vector], Field(min_length=3, max_length=12)]  # body, one after the other around it
    surface: str | None = None  # that turns it
    turn_rad: Annotated[float, Field(ge=-3.2, le=3.2)] = 0.0  # where the surface's property is 1

    @model_serializer(mode="wrap")
    def _without_a_surface(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        stated: dict[str, Any] = handler(self)
        return {key: value for key, value in stated.items() if key == "corners_m" or self.surface is not None}


class Fuel(Model):
    """What is in the tank at the start: a part of ``Vehicle.mass_kg``, all of it at one place."""

    mass_kg: Positive
    position_m: Vector  # body


class GroundEffect(Model):
    """What jets do to the vehicle near the ground; see :mod:`cosim.vehicle.parts.ground_effect`.  Each effect has its
    switch."""

    suckdown: bool = False  # lift loss by Wyatt's correlation
    planform_m: Positive  # angular mean diameter of what is above the jets: (1 / pi) times the integral of its radius
    jet_m: Positive  # diameter of one round jet with the area of all
    planform_z_m: float = 0.0  # body: how far the planform lies below the centre of gravity
    hot_gas: bool = False  # warmed intakes, of engines that take the ambient temperature
    hot_gas_height_m: list[NotNegative] = Field(default_factory=list)  # of the centre of gravity, the least first
    hot_gas_rise_k: list[NotNegative] = Field(default_factory=list)  # at each; the last is 0

    @model_validator(mode="after")
    def _complete(self) -> GroundEffect:
        if self.jet_m >= self.planform_m:
            raise ValueError(f"jet_m {self.jet_m:g} must be below planform_m {self.planform_m:g}")
        heights, rises = self.hot_gas_height_m, self.hot_gas_rise_k
        if len(heights) != len(rises):
            raise ValueError(f"hot_gas_rise_k: needs one value for each of the {len(heights)} of hot_gas_height_m")
        if self.hot_gas and len(heights) < 2:
            raise ValueError("hot_gas: needs two or more heights in hot_gas_height_m, and their hot_gas_rise_k")
        if any(b <= a for a, b in pairwise(heights)):
            raise ValueError(f"hot_gas_height_m: every height must be above the one before it, not {heights}")
        if rises and rises[-1] != 0.0:
            raise ValueError(f"hot_gas_rise_k: the last must be 0, not {rises[-1]:g}: above it nothing is swallowed")
        return self


class Aero(Model):
    """Body drag, one drag area per axis, and linear damping of the rates."""

    span_m: Positive  # what JSBSim's turbulence model takes for the wing span: how coarse gusts must be to turn it
    drag_area_m2: Axis3  # Cd times reference area along x, y, z
    centre_m: Vector  # where the drag acts, body
    damping_n_m_s: Axis3  # moment per rate about x, y, z


class Contact(Model):
    """A point that can touch the ground."""

    name: str
    kind: Literal["leg", "hull"]
    position_m: Vector
    spring_n_m: Positive
    damping_n_s_m: NotNegative
    friction_static: NotNegative
    friction_dynamic: NotNegative


class GyroSensor(Model):
    """Rate gyro: first-order low-pass, constant bias, white noise, whole samples of latency."""

    filter_s: NotNegative
    noise_rad_s: NotNegative
    bias_rad_s: Vector
    latency_samples: Samples


class AttitudeSensor(Model):
    """Attitude estimate: small-angle white noise and constant bias, whole samples of latency.

    ``ahrs_time_constant_s`` is that of a complementary filter, whose lean follows the direction of the specific force;
    0: the lean is the true one.
    """

    noise_rad: NotNegative
    bias_rad: Vector
    latency_samples: Samples
    ahrs_time_constant_s: NotNegative = 0.0


class PositionSensor(Model):
    """GNSS position and velocity, sampled and held at a rate of their own."""

    position_noise_m: NotNegative
    velocity_noise_m_s: NotNegative
    period_samples: Annotated[int, Field(ge=1, le=10000)]
    latency_samples: Samples


class AltitudeSensor(Model):
    """Barometric height above the starting ground."""

    noise_m: NotNegative
    bias_m: float
    latency_samples: Samples


class ForceSensor(Model):
    """Accelerometer at the centre of gravity: specific force with white noise and constant bias, body axes.

    The defaults are a small MEMS sensor's (TDK ICM-42688-P, data sheet DS-000347): 70 ug per root Hz make 0.008 m/s^2
    of noise in 125 Hz, to which the engines add; 0.05 m/s^2 with them is chosen by us.  Its zero moves by 0.15 mg/K,
    hence 0.03 m/s^2 at 20 K from where it was calibrated.
    """

    noise_m_s2: NotNegative = 0.05
    bias_m_s2: Vector = (0.03, 0.03, 0.03)
    latency_samples: Samples = 0


class Sensors(Model):
    gyro: GyroSensor
    attitude: AttitudeSensor
    gnss: PositionSensor
    barometer: AltitudeSensor
    accelerometer: ForceSensor = ForceSensor()


class AttitudeGains(Model):
    """Quaternion P: rate set-point = gain x attitude error, limited per axis."""

    gain_1_s: Axis3
    rate_limit_rad_s: tuple[Positive, Positive, Positive]


class RateGains(Model):
    """One axis of the rate PID; its output is in throttle (roll) or rad of tilt (pitch, yaw)."""

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
    """Lags of an engine and what a lead on its command makes of them; see :mod:`cosim.control.lead`."""

    natural_rad_s: Positive  # two poles of the engine; or, without a damping, one lag of 1 / this
    damping: Positive | None = None
    pole_rad_s: Positive  # each of them is moved to minus this


class Leads(Model):
    """A lead for each command that engines answer to; false is none, also where the aircraft states one."""

    roll: EngineLead | Literal[False] | None = None
    pitch: EngineLead | Literal[False] | None = None
    yaw: EngineLead | Literal[False] | None = None
    altitude: EngineLead | Literal[False] | None = None


class ScheduledGains(Model):
    """What a thrust level makes of one command's gains: factors on those stated, and its lead there."""

    angle: Positive = 1.0  # on the attitude gain; of the height, on position_1_s
    p: Positive = 1.0  # of the height, on velocity_1_s
    i: Positive = 1.0  # of the height, on integral_1_s2
    d: Positive = 1.0
    natural_rad_s: Positive | None = None  # the engine's at this thrust, as in EngineLead
    damping: Positive | None = None
    pole_rad_s: Positive | None = None

    @property
    def lead(self) -> EngineLead | None:
        """The lead at this level, where it states one."""
        if self.natural_rad_s is None or self.pole_rad_s is None:
            return None
        return EngineLead(natural_rad_s=self.natural_rad_s, damping=self.damping, pole_rad_s=self.pole_rad_s)


class ThrustLevel(Model):
    """One level of a schedule."""

    share: Annotated[float, Field(ge=0.0, le=1.0)]  # the collective, in shares of the engines' range
    roll: ScheduledGains = ScheduledGains()
    altitude: ScheduledGains = ScheduledGains()


class Schedule(Model):
    """Gains and leads that follow the thrust level: linear between levels, held beyond the first and the last."""

    filter_s: Positive  # lag with which the collective is followed
    level: Annotated[list[ThrustLevel], Field(min_length=2)]  # the least share first

    @model_validator(mode="after")
    def _rising(self) -> Schedule:
        shares = [level.share for level in self.level]
        if any(b <= a for a, b in pairwise(shares)):
            raise ValueError(f"level: every share must be above the one before it, not {shares}")
        return self


class AltitudeGains(Model):
    """Height: P to climb rate, PI to vertical acceleration, with the hover throttle fed forward."""

    position_1_s: NotNegative
    climb_limit_m_s: Positive
    descent_limit_m_s: Positive
    velocity_1_s: NotNegative
    integral_1_s2: NotNegative
    integral_limit_m_s2: NotNegative


class AllocationLimits(Model):
    throttle_min: Annotated[float, Field(ge=0.0, lt=1.0)]
    throttle_max: Annotated[float, Field(gt=0.0, le=1.0)]
    # banks: of a vehicle with [servo]; rotors: of one whose jets all point straight up; effectiveness: of any.  None:
    # by what the vehicle has
    method: Literal["banks", "rotors", "effectiveness"] | None = None
    horizontal: bool = False  # effectiveness: keep the force along x and y at zero where that costs nothing else

    @model_serializer(mode="wrap")
    def _without_the_usual(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        stated: dict[str, Any] = handler(self)
        return {key: value for key, value in stated.items() if key != "horizontal" or value}

    @model_validator(mode="after")
    def _ordered(self) -> AllocationLimits:
        if self.throttle_min >= self.throttle_max:
            raise ValueError(f"throttle_min {self.throttle_min} must be below throttle_max {self.throttle_max}")
        return self


class PredictorTuning(Model):
    """What a predictor needs beside the identified model; each predictor reads its own."""

    filter_s: NotNegative  # filtered Smith: time constant of the robustness filter
    observer_rad_s: Positive  # state: both poles of the double-integrator observer at minus this
    model_observer_rad_s: Positive  # state-model: observer poles
    disturbance_observer_rad_s: Positive  # state-disturbance: observer poles
    own: dict[str, dict[str, float]] = Field(default_factory=dict)  # of predictors from elsewhere, by their names

    @model_serializer(mode="wrap")
    def _without_empty_tables(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        stated: dict[str, Any] = handler(self)
        return {key: value for key, value in stated.items() if key != "own" or value}


class PositionGains(Model):
    """Velocity and position control above the attitude loop, and the filter that estimates both from the GNSS."""

    position_1_s: Positive
    velocity_1_s: Positive
    catch_up_m_s: Positive  # most speed asked for because of a position error
    lean_rad: Annotated[float, Field(gt=0.0, lt=1.2)]  # most lean asked for
    acceleration_noise_m_s15: Positive  # white, of what the attitude does not explain: m/s^2 per root Hz
    disturbance_walk_m_s25: Positive  # of its slow part (wind on the body): m/s^2 per root s


class PilotSettings(Model):
    """What the autopilot flies with before anybody tells it otherwise."""

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
    spool_s: Positive  # from idle to hover thrust before take-off
    endurance_s: NotNegative = 0.0  # hover on a full battery; 0: not known, nothing is estimated


class MonitorSettings(Model):
    """When the engine monitor calls an engine faulty."""

    threshold: Positive  # of a jet's thrust in hover, beyond what a healthy engine may do
    confirm_s: Positive  # for so long without a break
    stuck_s: Positive  # the same before an engine that does not follow its command is called stuck
    lag_factor: Annotated[float, Field(ge=1.0)]  # a healthy lag is the nominal one within this factor
    delay_spread_s: NotNegative  # a healthy delay is the nominal one within this
    shut_opposite: bool = False  # with the first engine lost, shut off the one across the centre of gravity
    # then fly roll and height by the catch, until the thrust is made up for, own engine alone; where no jet tilts: with
    # the first rotor of four lost fly the direction of thrust on the others, spinning
    catch: bool = False


class WingControl(Model):
    """Flight ahead on a wing; see :mod:`cosim.control.wing`."""

    tilts: Annotated[list[str], Field(min_length=1)]  # the hinges that turn thrust ahead
    acceleration_m_s2: Positive  # with which the set-point of the speed rises
    braking_m_s2: Positive  # and falls
    velocity_1_s: Positive  # acceleration over what the speed is off
    integral_1_s2: NotNegative  # the same over its integral
    integral_limit_m_s2: NotNegative  # most of that
    alpha_rad: tuple[float, float]  # least and most angle of attack that is asked for
    alpha_filter_s: NotNegative  # lag of that
    open_m_s: Positive  # speed from which on all of that corridor is used
    aside_1_s: NotNegative  # bank over drift to the side
    bank_rad: Annotated[float, Field(ge=0.0, lt=1.2)]  # most of that

    @model_validator(mode="after")
    def _has_a_corridor(self) -> WingControl:
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
    schedule: Schedule | Literal[False] | None = None  # false: none, also where the aircraft states one
    monitor: MonitorSettings | None = None
    position: PositionGains | None = None
    pilot: PilotSettings | None = None
    wing: WingControl | None = None  # None: no speed ahead can be asked for

    @model_serializer(mode="wrap")
    def _without_a_wing(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        stated: dict[str, Any] = handler(self)
        return {key: value for key, value in stated.items() if key != "wing" or value is not None}

    @model_validator(mode="after")
    def _leads_at_every_level(self) -> Control:
        """A lead is divided out in the same form at every level; without one, what the levels say of it is not read."""
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


def _with_pairs(real: list[float], pairs: list[tuple[float, float]]) -> list[float] | list[complex]:
    if not pairs:
        return real
    return [*map(complex, real), *(complex(re, sign * im) for re, im in pairs for sign in (1.0, -1.0))]


class RateModel(Model):
    """An identified rate response: gain * prod(z - zeros) / prod(z - poles) * z^-delay, command to rad/s.

    Poles and zeros that are not real come in pairs, of which the one with the positive imaginary part is stated.
    """

    gain: float
    zeros: list[float]
    poles: list[Annotated[float, Field(gt=-1.0, le=1.0)]]
    zero_pairs: list[tuple[float, Positive]] = Field(default_factory=list)  # real and imaginary part
    pole_pairs: list[tuple[float, Positive]] = Field(default_factory=list)
    delay_samples: Annotated[float, Field(ge=0.0, le=1000.0)]  # need not be whole
    sample_time_s: Positive
    source: str

    @model_validator(mode="after")
    def _strictly_proper(self) -> RateModel:
        if len(self.all_zeros) >= len(self.all_poles):
            raise ValueError("a predictor needs a strictly proper model: fewer zeros than poles")
        if any(re * re + im * im > 1.0 for re, im in self.pole_pairs):
            raise ValueError("pole_pairs: must lie within the unit circle")
        return self

    @property
    def all_poles(self) -> list[float] | list[complex]:
        """The real ones first, then both of each pair."""
        return _with_pairs(self.poles, self.pole_pairs)

    @property
    def all_zeros(self) -> list[float] | list[complex]:
        """The same of the zeros."""
        return _with_pairs(self.zeros, self.zero_pairs)

    @model_serializer(mode="wrap")
    def _without_empty_pairs(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        stated: dict[str, Any] = handler(self)
        return {key: value for key, value in stated.items() if not key.endswith("_pairs") or value}


class Limits(Model):
    """Where a flight is over."""

    tilt_deg: Annotated[float, Field(gt=0.0, le=180.0)]  # from upright, in the air: diverged
    rate_deg_s: Positive  # any axis: diverged
    touchdown_m_s: Positive  # a leg touching faster: crashed


def _named(name: str) -> str:
    if not fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise ValueError("letters, digits, - and _ are allowed, a letter or digit first")
    return name


def _differ(where: str, names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{where}: two are called {name!r}; names must differ")


class Vehicle(Model):
    """Everything that ``aircraft/<name>/vehicle.toml`` says."""

    name: Annotated[str, AfterValidator(_named)]
    title: str
    model: str | None = None  # the JSBSim model's file, beside vehicle.toml; None: all is stated in that
    engine: str | None = None  # what it is made for, and flies with where only the aircraft is named
    step_s: Step | None = None  # control step where a scenario states none; None: see control_step
    mass_kg: Positive
    inertia_kg_m2: tuple[Positive, Positive, Positive]
    products_kg_m2: Vector = (0.0, 0.0, 0.0)  # of inertia: integral of x y, x z and y z over the mass, body
    jets: Annotated[list[Jet], Field(min_length=1, max_length=MOST_JETS)]
    hinges: Annotated[list[Hinge], Field(max_length=MOST_JETS)] = Field(default_factory=list)  # from the body outwards
    surfaces: Annotated[list[Surface], Field(max_length=MOST_JETS)] = Field(default_factory=list)
    panels: Annotated[list[Panel], Field(max_length=100)] = Field(default_factory=list)  # drawn; they carry no force
    contacts: Annotated[list[Contact], Field(min_length=1)]
    servo: Servo | None = None
    fuel: Fuel | None = None
    airflow: Airflow | None = None  # of every jet without one of its own; None: no intake drag but theirs
    ground_effect: GroundEffect | None = None  # None: the ground does nothing to the jets
    aero: Aero
    sensors: Sensors
    control: Control
    identified: dict[str, dict[Literal["roll", "pitch", "yaw"], RateModel]]
    limits: Limits

    @model_validator(mode="after")
    def _all_tilt_or_none(self) -> Vehicle:
        tilting = [jet.servo is not None for jet in self.jets]
        if any(tilting) != all(tilting) or any(tilting) != (self.servo is not None):
            raise ValueError("jets: either all jets have a servo and there is a table [servo], or none and no table")
        return self

    @model_validator(mode="after")
    def _hinges_move_jets(self) -> Vehicle:
        names = [hinge.name for hinge in self.hinges] + [surface.name for surface in self.surfaces]
        _differ("hinges, surfaces", names)
        for number, hinge in enumerate(self.hinges):
            for jet in (*hinge.carries, *hinge.deflects):
                if jet > len(self.jets):
                    raise ValueError(f"hinges.{number}: jet {jet}: there are jets 1 to {len(self.jets)}")
        known = [surface.name for surface in self.surfaces]
        for number, panel in enumerate(self.panels):
            if panel.surface is not None and panel.surface not in known:
                there = f"there are: {', '.join(known)}" if known else "there are none"
                raise ValueError(f"panels.{number}.surface: no surface is called {panel.surface!r}; {there}")
            if panel.turn_rad and panel.surface is None:
                raise ValueError(f"panels.{number}.turn_rad {panel.turn_rad:g}: no surface is named that turns it")
        if self.surfaces and self.model is None:
            raise ValueError("surfaces: are moved in the vehicle's own JSBSim model, and model names none")
        if self.servo is None:
            return self
        if self.hinges:
            raise ValueError("hinges: a vehicle with a table [servo] has its two banks; state them as hinges instead")
        if self.surfaces:
            raise ValueError("surfaces: the allocation of the two banks of [servo] moves none; state them as hinges")
        for number, station in enumerate(self.jets):
            if station.axis not in (None, UP):
                raise ValueError(
                    f"jets.{number}.axis {list(station.axis or UP)}: jets on the banks of [servo] point up"
                )
        return self

    @model_validator(mode="after")
    def _method_fits(self) -> Vehicle:
        method, where = self.control.allocation.method, "control.allocation.method"
        if method == "banks" and self.servo is None:
            raise ValueError(f"{where} 'banks': is for two banks with a table [servo]; take 'effectiveness'")
        if method == "rotors" and (self.servo is not None or not self._plain):
            raise ValueError(f"{where} 'rotors': is for jets that all point straight up; take 'effectiveness'")
        if method == "effectiveness" and self.servo is not None:
            raise ValueError(f"{where} 'effectiveness': state the two banks of [servo] as [[hinges]]")
        if self.allocation != "effectiveness" and len(self.jets) < 4:
            raise ValueError(
                f"jets: {len(self.jets)} that point straight up do not hold a vehicle level; four do, or hinges"
            )
        return self

    @model_validator(mode="after")
    def _wing_turns_thrust(self) -> Vehicle:
        wing, where = self.control.wing, "control.wing"
        if wing is None:
            return self
        if self.model is None or self.allocation != "effectiveness":
            raise ValueError(f"{where}: needs a model with a wing, and control.allocation.method 'effectiveness'")
        names = [hinge.name for hinge in self.hinges]
        for name in wing.tilts:
            if name not in names:
                raise ValueError(f"{where}.tilts: no hinge is called {name!r}; there are: {', '.join(names)}")
        return self

    @property
    def allocation(self) -> Literal["banks", "rotors", "effectiveness"]:
        """How commands become throttles and angles: as stated, or by what the vehicle has."""
        if self.control.allocation.method is not None:
            return self.control.allocation.method
        if self.servo is not None:
            return "banks"
        return "rotors" if self._plain else "effectiveness"

    @property
    def _plain(self) -> bool:
        """Whether all jets point straight up and nothing but banks moves."""
        return not self.hinges and not self.surfaces and all(jet.axis in (None, UP) for jet in self.jets)

    @property
    def actuators(self) -> tuple[str, ...]:
        """The names of what servos move: hinges, then surfaces; the two banks where there is neither."""
        return (*(hinge.name for hinge in self.hinges), *(surface.name for surface in self.surfaces)) or SERVOS

    @property
    def turns(self) -> tuple[tuple[float, float], ...]:
        """Least and most of each angle of :meth:`layout` [rad]; empty where no thrust turns."""
        if self.servo is not None:
            return ((-self.servo.range_rad, self.servo.range_rad),) * len(SERVOS)
        return tuple(hinge.least_most for hinge in self.hinges)

    @property
    def ranges(self) -> tuple[tuple[float, float], ...]:
        """Least and most of each of :attr:`actuators`; empty where nothing moves."""
        return (*self.turns, *(surface.range for surface in self.surfaces))

    @property
    def rest(self) -> tuple[float, ...]:
        """Where each of :attr:`actuators` stands when nothing is asked of it."""
        if not self.hinges and not self.surfaces:
            return (0.0, 0.0)
        return (*(hinge.rest_rad for hinge in self.hinges), *(0.0 for _ in self.surfaces))

    @property
    def tensor(self) -> tuple[Vector, Vector, Vector]:
        """Of inertia, kg m^2, by rows, body: the products of inertia stand in it with the other sign."""
        (a, b, c), (xy, xz, yz) = self.inertia_kg_m2, self.products_kg_m2
        return ((a, -xy, -xz), (-xy, b, -yz), (-xz, -yz, c))

    def layout(self) -> Layout:
        """Where jets stand and push while hinges turn; its angles are the hinges', or those of the two banks."""
        return layout_of(self.jets, self.hinges)

    @model_validator(mode="after")
    def _contacts_differ(self) -> Vehicle:
        _differ("contacts", [contact.name for contact in self.contacts])
        return self

    @model_validator(mode="after")
    def _inertia_exists(self) -> Vehicle:
        a, b, c = sorted(self.inertia_kg_m2)
        if a + b < c:
            raise ValueError(
                f"inertia_kg_m2 {list(self.inertia_kg_m2)}: no body has one moment above the sum of the others"
            )
        if any(self.products_kg_m2):
            # the second moments of the mass, integral of x x^T, must be a positive definite matrix
            (a, b, c), (xy, xz, yz) = self.inertia_kg_m2, self.products_kg_m2
            xx, yy, zz = (b + c - a) / 2.0, (a + c - b) / 2.0, (a + b - c) / 2.0
            minor = xx * yy - xy * xy
            whole = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
            if minor < 0.0 or xx * zz < xz * xz or yy * zz < yz * yz or whole < 0.0:
                raise ValueError(
                    f"products_kg_m2 {list(self.products_kg_m2)}: no body with inertia_kg_m2 "
                    f"{list(self.inertia_kg_m2)} has them: too large, or in another unit"
                )
        return self

    @model_serializer(mode="wrap")
    def _without_what_is_not_there(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        stated: dict[str, Any] = handler(self)
        for key in ("hinges", "surfaces", "panels"):
            if not stated.get(key, True):
                del stated[key]
        if not any(self.products_kg_m2):
            stated.pop("products_kg_m2", None)
        return stated

    @model_validator(mode="after")
    def _banks_are_a_part(self) -> Vehicle:
        if self.servo and 2.0 * self.servo.bank_inertia_kg_m2 >= self.inertia_kg_m2[1]:
            raise ValueError(
                f"servo.bank_inertia_kg_m2 {self.servo.bank_inertia_kg_m2:g}: two banks are a part of the vehicle and "
                f"must have less than its moment of inertia about y, {self.inertia_kg_m2[1]:g} kg m^2"
            )
        return self

    @model_validator(mode="after")
    def _exists_without_fuel(self) -> Vehicle:
        if self.fuel is None:
            return self
        whole, fuel, place = self.mass_kg, self.fuel.mass_kg, self.fuel.position_m
        if fuel >= whole:
            raise ValueError(f"fuel.mass_kg {fuel:g} is a part of mass_kg {whole:g} and must be below it")
        # about the empty vehicle's own centre of gravity, by the theorem of parallel axes
        squares = [x * x for x in place]
        shift = fuel * whole / (whole - fuel)
        empty = [moment - shift * (sum(squares) - own) for moment, own in zip(self.inertia_kg_m2, squares, strict=True)]
        a, b, c = sorted(empty)
        if a <= 0.0 or a + b < c:
            raise ValueError(
                f"fuel: {fuel:g} kg at {list(place)} leave an empty vehicle with the moments of inertia "
                f"{[round(moment, 6) for moment in empty]} kg m^2, which no body has"
            )
        return self

    @property
    def control_step(self) -> float:
        """The control step [s] of scenarios that state none: its own, else the sample time of its identified models
        where all have the same, else :data:`STEP_S`.
        """
        if self.step_s is not None:
            return self.step_s
        steps = {model.sample_time_s for models in self.identified.values() for model in models.values()}
        return steps.pop() if len(steps) == 1 else STEP_S


_BANK: Vector = (0.0, -1.0, 0.0)  # positive leans the thrust forward


def layout_of(jets: Sequence[Jet], hinges: Sequence[Hinge] = ()) -> Layout:
    """Stations and hinges; the banks of jets with a ``servo`` turn the thrust of each about its own station."""
    stations = [Station(jet.position_m, jet.axis or UP, -jet.reaction_m) for jet in jets]
    if any(jet.servo for jet in jets):
        turns = [
            Turn((0.0, 0.0, 0.0), _BANK, (), tuple(n for n, jet in enumerate(jets) if jet.servo == side))
            for side in SERVOS
        ]
    else:
        turns = [
            Turn(
                hinge.position_m,
                hinge.axis,
                tuple(jet - 1 for jet in hinge.carries),
                tuple(jet - 1 for jet in hinge.deflects),
                hinge.effect,
            )
            for hinge in hinges
        ]
    return Layout(stations, turns)


class Scaled(Model):
    """The table ``scaled``: everything that the file does not state is another aircraft's, at this mass."""

    base: str
    mass_kg: Positive


class ModelFile(Model):
    """Identified models in a file of their own, to be written over a vehicle's."""

    identified: Annotated[dict[str, dict[Literal["roll", "pitch", "yaw"], RateModel]], Field(min_length=1)]


def read_models(path: Path) -> dict[str, Any]:
    """The table ``identified`` of a model file.  Raises InputError if it cannot be read or is not one."""
    models: dict[str, Any] = validate(ModelFile, read_toml(path), str(path)).model_dump(mode="json")["identified"]
    return models


def aircraft_names() -> list[str]:
    """Every aircraft that is shipped."""
    return names_in("aircraft", VEHICLE)


def is_own(aircraft: str) -> bool:
    """Whether an aircraft is named by a path: a folder with a ``vehicle.toml``, or such a file."""
    return "/" in aircraft or aircraft.lower().endswith(".toml") or aircraft in (".", "..")


def aircraft_seen_from(aircraft: str, folder: Path) -> str:
    """The same with an absolute path where it is one, which is relative to ``folder`` otherwise."""
    return str((folder / aircraft).absolute()) if is_own(aircraft) else aircraft


def aircraft_name(aircraft: str, folder: Path = Path()) -> str:
    """What it is called: by the library, or by its own file.  Raises InputError as :func:`load_vehicle`."""
    return load_vehicle(aircraft, folder=folder)[0].name if is_own(aircraft) else aircraft


def engine_of(aircraft: str, folder: Path = Path()) -> str | None:
    """The engine that an aircraft is made for; a file is seen from the aircraft's folder.

    Raises InputError as :func:`load_vehicle`.
    """
    vehicle, place = load_vehicle(aircraft, folder=folder)
    return None if vehicle.engine is None else file_seen_from(vehicle.engine, place)


def file_seen_from(engine: str, folder: Path) -> str:
    """An engine with an absolute path where it is a file."""
    return str((folder / engine).absolute()) if is_file(engine) else engine


def is_file(engine: str) -> bool:
    """Whether an engine is given by a file: an FMU, a system of them (SSP), or a mapping file that names one."""
    return engine.lower().endswith((".fmu", ".ssp", ".toml")) or "/" in engine


def find_aircraft(aircraft: str, folder: Path = Path()) -> Path:
    """The ``vehicle.toml`` of an aircraft given by its name, or by a path that is relative to ``folder``.

    Raises InputError for an unknown aircraft (lists the known ones) and for a path where none is.
    """
    if not is_own(aircraft):
        if aircraft not in aircraft_names():
            known = nearest(aircraft, aircraft_names())
            here = f"./{aircraft}" if (folder / aircraft / VEHICLE).is_file() else "the path of a folder"
            raise InputError(f"unknown aircraft {aircraft!r}; {known}, or {here}")
        return data_folder("aircraft") / aircraft / VEHICLE
    path = folder / aircraft
    path = path / VEHICLE if path.is_dir() else path
    if not path.is_file():
        raise InputError(f"aircraft {path}: no such file; name a folder with a {VEHICLE}, or such a file")
    return path


_known: Memory[tuple[dict[str, Any], Vehicle]] = Memory(32)


def load_vehicle(
    name: str, overrides: dict[str, Any] | None = None, where: str = "vehicle", folder: Path = Path()
) -> tuple[Vehicle, Path]:
    """Read an aircraft's ``vehicle.toml`` with ``overrides`` merged over it, and say which folder it is in.

    Parameters
    ----------
    name : str
        Of an aircraft that is shipped, or a path: a folder, or a file.
    overrides : dict or None
        Written over what the file states.
    where : str
        What they are called, for the error.
    folder : Path
        What a relative path is seen from.

    Returns
    -------
    tuple of Vehicle and Path
        The vehicle, and the folder of its file.

    Raises
    ------
    InputError
        For an unknown aircraft (lists the known ones), a path where none is, or a wrong key.
    """
    path = find_aircraft(name, folder)
    stated, vehicle = _known.get((path, *_texts(path)), lambda: _read(path))
    if overrides:
        vehicle = validate(Vehicle, merge(stated, _with_own_banks(overrides)), where)
    return vehicle, path.parent


def as_read(name: str, folder: Path = Path()) -> dict[str, Any]:
    """What the file of an aircraft states, with all that it takes from another.  Raises as :func:`load_vehicle`."""
    path = find_aircraft(name, folder)
    return _known.get((path, *_texts(path)), lambda: _read(path))[0]


def _with_own_banks(overrides: dict[str, Any]) -> dict[str, Any]:
    """A servo that is stated whole, in a file from before banks had an inertia, has none: not that of the aircraft."""
    servo = overrides.get("servo")
    if not isinstance(servo, dict) or not {"lag_s", "rate_limit_rad_s", "range_rad"} <= set(servo):
        return overrides
    return overrides | {"servo": {"bank_inertia_kg_m2": 0.0, "bank_imbalance_kg_m": 0.0} | servo}


def _texts(path: Path) -> list[bytes]:
    """The files that an aircraft is made from: its own, and that of the one that it is a scaled copy of."""
    law = read_toml(path).get("scaled")
    base = law.get("base") if isinstance(law, dict) else None
    files = [path, *([data_folder("aircraft") / base / VEHICLE] if base in aircraft_names() else [])]
    return [file.read_bytes() for file in files]


def _read(path: Path) -> tuple[dict[str, Any], Vehicle]:
    stated = _stated(path)
    vehicle = validate(Vehicle, stated, str(path))
    if path.parents[1] != data_folder("aircraft") and vehicle.name in aircraft_names():
        raise InputError(f"{path}: name = {vehicle.name!r}: is the name of an aircraft that is shipped; choose another")
    engines = ((f"jets.{number}.engine", jet.engine) for number, jet in enumerate(vehicle.jets, 1))
    for key, file in (("engine", vehicle.engine), ("model", vehicle.model), *engines):
        if file is not None and (key == "model" or is_file(file)) and not (path.parent / file).is_file():
            raise InputError(f"{path}: {key} = {file!r}: no such file, as seen from the folder of {path.name}")
    _refuse_implausible(vehicle, path)
    return stated, vehicle


def _refuse_implausible(vehicle: Vehicle, path: Path) -> None:
    places = {f"jets.{n}.position_m": jet.position_m for n, jet in enumerate(vehicle.jets)}
    contacts = {f"contacts.{n}.position_m": contact.position_m for n, contact in enumerate(vehicle.contacts)}
    legs = {key: place for contact, (key, place) in zip(vehicle.contacts, contacts.items(), strict=True)
            if contact.kind == "leg"}  # fmt: skip
    fuel = {"fuel.position_m": vehicle.fuel.position_m} if vehicle.fuel else {}
    if why := implausible(vehicle.mass_kg, vehicle.inertia_kg_m2, places | contacts | fuel, legs):
        raise InputError(f"{path}: {why}")


def _stated(path: Path) -> dict[str, Any]:
    """What a ``vehicle.toml`` states, over what it takes from the aircraft that it is a scaled copy of."""
    stated = read_toml(path)
    if "scaled" not in stated:
        return stated
    where = f"{path}: scaled"
    table = stated.pop("scaled")
    if not isinstance(table, dict):
        raise InputError(f"{where} = {table!r}: must be a table with base and mass_kg")
    law = validate(Scaled, table, where)
    folder = data_folder("aircraft") / law.base
    if law.base not in aircraft_names():
        raise InputError(f"{where}.base: unknown aircraft {law.base!r}; {nearest(law.base, aircraft_names())}")
    base = read_toml(folder / VEHICLE)
    if "scaled" in base:
        raise InputError(f"{where}.base: {law.base} is a scaled copy itself; name the aircraft that it is made from")
    original = validate(Vehicle, base, str(folder / VEHICLE)).model_dump(mode="json", exclude_none=True)
    if any(key in original for key in ("hinges", "surfaces")) or "model" not in original:
        raise InputError(
            f"{where}.base: {law.base} is not of banks or rotors in a model of its own, which is what the law scales; "
            f"hexjet aircraft new NAME --from {law.base} copies it as it is"
        )
    near = path.parents[1] == data_folder("aircraft")
    model = f"../{law.base}/{original['model']}" if near else str(folder / original["model"])
    shared = {"model": model, "engine": None}
    return merge(scaled(original, law.mass_kg) | shared, stated)
