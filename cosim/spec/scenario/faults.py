"""Models of a scenario's faults: of engines, servos and sensors."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from cosim.base.constants import Sensor
from cosim.base.signals import MAX_JETS
from cosim.base.storage.toml import Duration, Model, Seconds, Vector


def _check_station_number(text: str) -> str:
    if text not in map(str, range(1, MAX_JETS + 1)):
        raise ValueError(f"a station is the number of a jet, 1 to {MAX_JETS} at most")
    return text


def _check_distinct(jets: list[int]) -> list[int]:
    if len(set(jets)) != len(jets):
        raise ValueError("name a jet once")
    return jets


StationNumber = Annotated[str, AfterValidator(_check_station_number)]
JetNumber = Annotated[int, Field(ge=1, le=MAX_JETS)]
Jets = Annotated[
    list[JetNumber],
    Field(min_length=1),
    BeforeValidator(lambda jet: jet if isinstance(jet, list) else [jet]),
    AfterValidator(_check_distinct),
]


class TimedFault(Model):
    """A fault that acts from ``start_s`` on, for ``duration_s`` or to the end."""

    amount: ClassVar[str] = ""  # key that a request in flight may give

    kind: str
    start_s: Seconds
    duration_s: Duration | None = None

    def describe(self) -> str:
        """Return the fault's effect in words, without place and time."""
        raise NotImplementedError


class JetFault(TimedFault):
    """A fault of the engines at ``jet``."""

    jet: Jets


class FlameOut(JetFault):
    """The engine flames out at the start and is relit at the end."""

    kind: Literal["flame_out"]

    def describe(self) -> str:
        return "flame-out"


class StuckThrottle(JetFault):
    """The engine stays at its throttle at the start, or at ``throttle``."""

    amount = "throttle"
    kind: Literal["stuck_throttle"]
    throttle: Annotated[float, Field(ge=0.0, le=1.0)] | None = None

    def describe(self) -> str:
        return "throttle stuck" if self.throttle is None else f"throttle stuck at {100.0 * self.throttle:g} %"


class ThrustLoss(JetFault):
    """The engine loses the fraction ``share`` of its thrust."""

    amount = "share"
    kind: Literal["thrust_loss"]
    share: Annotated[float, Field(gt=0.0, le=1.0)]

    def describe(self) -> str:
        return f"{100.0 * self.share:g} % of the thrust lost"


class SlowSpool(JetFault):
    """An additional first-order lag before the engine."""

    amount = "lag_s"
    kind: Literal["slow_spool"]
    lag_s: Annotated[float, Field(gt=0.0, le=100.0)]

    def describe(self) -> str:
        return f"slower by a lag of {self.lag_s:g} s"


class DelayGrowth(JetFault):
    """An additional delay before the engine; at its end the commands still in the delay are dropped."""

    amount = "delay_s"
    kind: Literal["delay_growth"]
    delay_s: Annotated[float, Field(gt=0.0, le=10.0)]

    def describe(self) -> str:
        return f"later by {self.delay_s:g} s"


class ServoJam(TimedFault):
    """A tilt servo stops, or moves to ``angle_deg`` and stays there."""

    amount = "angle_deg"
    kind: Literal["servo_jam"]
    servo: str  # left, right, or a hinge or surface
    angle_deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None = None

    def describe(self) -> str:
        return "jammed" if self.angle_deg is None else f"jammed at {self.angle_deg:g} deg"


class SensorBias(TimedFault):
    """Bias added to a sensor's output: rad/s (gyro), rad about the body axes (attitude), m (gnss, NED; barometer)."""

    amount = "bias"
    kind: Literal["sensor_bias"]
    sensor: Sensor
    bias: list[float] = [0.0, 0.0, 0.0]  # barometer: one number; others: three
    velocity_bias: Vector = (0.0, 0.0, 0.0)  # m/s, NED, for the GNSS alone

    @model_validator(mode="after")
    def _check_bias_shape(self) -> Self:
        count = 1 if self.sensor == "barometer" else 3
        if len(self.bias) != count:
            raise ValueError(f"bias: the {self.sensor} needs a list of {count}")
        if any(self.velocity_bias) and self.sensor != "gnss":
            raise ValueError("velocity_bias: only the gnss measures a velocity")
        if not any((*self.bias, *self.velocity_bias)):
            raise ValueError("bias: give one that is not 0")
        return self

    @property
    def vector(self) -> Vector:
        """``bias`` as a vector; the barometer's is its first element."""
        x, y, z = (*self.bias, 0.0, 0.0)[:3]
        return (x, y, z)

    def describe(self) -> str:
        return f"biased by {', '.join(f'{value:g}' for value in self.bias)}"


class SensorDropout(TimedFault):
    """A sensor repeats its last output before the start."""

    kind: Literal["sensor_dropout"]
    sensor: Sensor

    def describe(self) -> str:
        return "silent"


EngineFault = FlameOut | StuckThrottle | ThrustLoss | SlowSpool | DelayGrowth
SensorFault = SensorBias | SensorDropout
Fault = EngineFault | ServoJam | SensorFault
FaultEntry = Annotated[Fault, Field(discriminator="kind")]
