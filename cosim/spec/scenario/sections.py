"""Tables of a scenario: initial state, environment, limits, expected results and engine stations."""

from sys import float_info
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from cosim.base.outcomes import Outcome
from cosim.base.storage.toml import Model, NotNegative, Positive, Vector


class Initial(Model):
    """Initial state of the flight."""

    on_ground: bool = False
    engines: Literal["idle", "off"] = "idle"  # on the ground, before arming
    altitude_m: Annotated[float, Field(ge=0.0, le=20000.0)] = 30.0  # above ground; unused on the ground
    attitude_deg: Vector = (0.0, 0.0, 0.0)
    velocity_ned_m_s: Vector = (0.0, 0.0, 0.0)
    rate_deg_s: Vector = (0.0, 0.0, 0.0)
    fuel: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0  # fraction of the tank, if it has one


class Environment(Model):
    """Location, steady wind and turbulence (JSBSim's MIL-F-8785C model)."""

    latitude_deg: Annotated[float, Field(ge=-89.0, le=89.0)] = 22.35
    longitude_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 113.59
    ground_m: Annotated[float, Field(ge=-400.0, le=5000.0)] = 0.0
    wind_ned_m_s: Vector = (0.0, 0.0, 0.0)
    # Mean wind at 6 m, which sets the turbulence's intensity below 300 m.
    turbulence_wind_m_s: NotNegative = 0.0
    # Probability-of-exceedance index, 0 is none; below 300 m all others mean the same.
    turbulence_severity: Annotated[int, Field(ge=0, le=7)] = 0


class Range(Model):
    """Range of a metric; at least one end is stated."""

    min: float | None = None
    max: float | None = None

    @model_validator(mode="after")
    def _require_min_or_max(self) -> Self:
        if self.min is None and self.max is None:
            raise ValueError("give min, max or both")
        return self


def _parse_limit(value: Any) -> float | Literal[False] | None:
    if value is None or value is False:
        return value
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value <= float_info.max:
        raise ValueError("must be a number of at least 0, or false for no limit")
    return float(value)


Most = Annotated[bool | float | None, BeforeValidator(_parse_limit)]


class FlightLimits(Model):
    """Upper limits on a flight's metrics; false: no limit, absent: the default of :mod:`cosim.results.limits`."""

    height_error_m: Most = None  # largest deviation from commanded height
    place_error_m: Most = None  # largest distance from commanded place
    drift_m: Most = None  # largest distance from the start
    speed_m_s: Most = None  # largest speed over the ground
    saturated_percent: Most = None  # of the steps in the air
    settling_s: Most = None  # of each axis, after a set-point step
    oscillation_rad: Most = None  # of each axis, in the last second
    alternating_percent: Most = None  # of the steps in any second
    throttle_activity_1_s: Most = None  # no limit by default
    tilt_activity_rad_s: Most = None  # no limit by default
    fuel_burnt_kg: Most = None  # no limit by default


class Expectation(Model):
    """Expected outcome and metrics of a flight with this controller, engine and aircraft."""

    controller: str
    engine: str
    aircraft: str = ""  # default: that of the scenario
    outcome: list[Outcome] = ["completed"]
    metrics: dict[str, Range] = {}  # "roll.overshoot_percent" -> range


class RequireEntry(Model):
    """A requirement on the flight: a formula over its signals, with a margin; see docs/metrics.md."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")]
    formula: str  # for example always(abs(roll_deg) < 30)
    # Divides its margin, to compare it with other margins; None: its tolerance.
    scale: Positive | None = None
    reason: str = ""  # origin of the limit


def unique_names(entries: list[RequireEntry]) -> list[RequireEntry]:
    """Return the requirements unchanged.  Raises ValueError if two have the same name."""
    names = [entry.name for entry in entries]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"require: {name} is there twice")
    return entries


class Station(Model):
    """Engine of one station that replaces the scenario's, or its parameters."""

    engine: str | None = None  # None: that of the scenario
    # Override the scenario's engine_parameters, if the engine is the scenario's.
    parameters: dict[str, float] = {}

    @model_validator(mode="after")
    def _require_engine_or_parameters(self) -> Self:
        if self.engine is None and not self.parameters:
            raise ValueError("give engine, parameters or both")
        return self
