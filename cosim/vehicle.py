"""A vehicle as its ``vehicle.toml`` states it: geometry, mass, engine stations, sensors, gains, identified models.

Body frame: forward-right-down (FRD), origin at the centre of gravity of the vehicle as built.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from cosim.config import Model, NotNegative, Positive, Vector, merge, nearest, read_toml, validate
from cosim.errors import InputError
from cosim.paths import data_folder, names_in

Axis3 = tuple[NotNegative, NotNegative, NotNegative]
Samples = Annotated[int, Field(ge=0, le=1000)]


class Jet(Model):
    """One engine station: a jet on a tilting bank, or a rotor that points straight up."""

    position_m: Vector  # body, from the centre of gravity of the vehicle as built
    servo: Literal["left", "right"] | None = None
    reaction_m: float = 0.0  # yaw moment on the frame per thrust, positive turns the nose right


class Servo(Model):
    """A tilt servo: first-order lag, then rate and range limits."""

    lag_s: NotNegative
    rate_limit_rad_s: Positive
    range_rad: Positive  # either way from straight up


class Aero(Model):
    """Body drag, one drag area per axis, and linear damping of the rates."""

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
    """Attitude estimate: small-angle white noise and constant bias, whole samples of latency."""

    noise_rad: NotNegative
    bias_rad: Vector
    latency_samples: Samples


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


class Sensors(Model):
    gyro: GyroSensor
    attitude: AttitudeSensor
    gnss: PositionSensor
    barometer: AltitudeSensor


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


class Control(Model):
    attitude: AttitudeGains
    rate: RateControl
    altitude: AltitudeGains
    allocation: AllocationLimits
    predictor: PredictorTuning


class RateModel(Model):
    """An identified rate response: gain * prod(z - zeros) / prod(z - poles) * z^-delay, command to rad/s."""

    gain: float
    zeros: list[float]
    poles: Annotated[list[Annotated[float, Field(gt=-1.0, le=1.0)]], Field(min_length=1)]
    delay_samples: Annotated[float, Field(ge=0.0, le=1000.0)]  # need not be whole
    sample_time_s: Positive
    source: str

    @model_validator(mode="after")
    def _strictly_proper(self) -> RateModel:
        if len(self.zeros) >= len(self.poles):
            raise ValueError("a predictor needs a strictly proper model: fewer zeros than poles")
        return self


class Limits(Model):
    """Where a flight is over."""

    tilt_deg: Annotated[float, Field(gt=0.0, le=180.0)]  # from upright, in the air: diverged
    rate_deg_s: Positive  # any axis: diverged
    touchdown_m_s: Positive  # a leg touching faster: crashed


class Vehicle(Model):
    """Everything that ``aircraft/<name>/vehicle.toml`` says."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")]
    title: str
    model: str  # the JSBSim model's file, beside vehicle.toml
    mass_kg: Positive
    inertia_kg_m2: tuple[Positive, Positive, Positive]
    jets: Annotated[list[Jet], Field(min_length=4, max_length=6)]
    contacts: Annotated[list[Contact], Field(min_length=1)]
    servo: Servo | None = None
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
    def _inertia_exists(self) -> Vehicle:
        a, b, c = sorted(self.inertia_kg_m2)
        if a + b < c:
            raise ValueError(
                f"inertia_kg_m2 {list(self.inertia_kg_m2)}: no body has one moment above the sum of the others"
            )
        return self


class ModelFile(Model):
    """Identified models in a file of their own, to be written over a vehicle's."""

    identified: Annotated[dict[str, dict[Literal["roll", "pitch", "yaw"], RateModel]], Field(min_length=1)]


def read_models(path: Path) -> dict[str, Any]:
    """The table ``identified`` of a model file.  Raises InputError if it cannot be read or is not one."""
    found: dict[str, Any] = validate(ModelFile, read_toml(path), str(path)).model_dump(mode="json")["identified"]
    return found


def aircraft_names() -> list[str]:
    """Every aircraft that can be flown."""
    return names_in("aircraft", "vehicle.toml")


def load_vehicle(name: str, overrides: dict[str, Any] | None = None, where: str = "vehicle") -> tuple[Vehicle, Path]:
    """Read an aircraft's ``vehicle.toml`` with ``overrides`` merged over it, and say which folder it is in.

    Raises InputError for an unknown aircraft (lists the known ones) or a wrong key.
    """
    if name not in aircraft_names():
        raise InputError(f"unknown aircraft {name!r}; {nearest(name, aircraft_names())}")
    folder = data_folder("aircraft") / name
    path = folder / "vehicle.toml"
    stated = read_toml(path)
    vehicle = validate(Vehicle, stated, str(path))
    if overrides:
        vehicle = validate(Vehicle, merge(stated, overrides), where)
    return vehicle, folder
