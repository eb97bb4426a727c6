"""A scenario as its TOML states it: who flies, what is asked of it, what disturbs it, and what is expected.

Angles in the file are in degrees where the key says ``_deg``; everything behind
:mod:`cosim.simulation.script.commander` and :mod:`cosim.simulation.script.disturber` is in rad and SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, model_validator

from cosim.base.constants import Outcome, Sensor
from cosim.base.errors import InputError, similar
from cosim.base.signals import MOST_JETS
from cosim.base.storage.paths import data_folder
from cosim.base.storage.toml import (
    Model,
    NotNegative,
    Positive,
    Vector,
    merge,
    parse_setting,
    read_toml,
    set_path,
    validate,
)
from cosim.spec.vehicle import STEP_S, Step, Vehicle, is_own, load_vehicle

Seconds = Annotated[float, Field(ge=0.0, le=1e6)]
Duration = Annotated[float, Field(gt=0.0, le=1e6)]
Amplitude = Annotated[float, Field(ge=-1e6, le=1e6)]
Signal = Literal[
    "roll_deg",
    "pitch_deg",
    "yaw_deg",
    "altitude_m",
    "rate_p_deg_s",
    "rate_q_deg_s",
    "rate_r_deg_s",
    "collective",
    "ahead_m_s",
]
SIGNALS: tuple[str, ...] = get_args(Signal)
Axis = Literal["roll", "pitch", "yaw"]


class StepCommand(Model):
    """``amplitude`` from ``start_s`` on."""

    kind: Literal["step"]
    signal: Signal
    start_s: Seconds
    amplitude: Amplitude


class DoubletCommand(Model):
    """``amplitude`` for ``width_s``, then its opposite for as long."""

    kind: Literal["doublet"]
    signal: Signal
    start_s: Seconds
    amplitude: Amplitude
    width_s: Duration


class RampCommand(Model):
    """From nothing at ``start_s`` to ``amplitude`` after ``duration_s``, held from then on."""

    kind: Literal["ramp"]
    signal: Signal
    start_s: Seconds
    amplitude: Amplitude
    duration_s: Duration


class SweepCommand(Model):
    """A sine whose frequency grows exponentially from ``from_hz`` to ``to_hz`` over ``duration_s``."""

    kind: Literal["sweep"]
    signal: Signal
    start_s: Seconds
    amplitude: Amplitude
    from_hz: Positive
    to_hz: Positive
    duration_s: Duration


class TableCommand(Model):
    """Columns of a CSV: ``time_s`` and any signals, held between rows or interpolated linearly."""

    kind: Literal["table"]
    file: str
    start_s: Seconds = 0.0
    interpolate: Literal["hold", "linear"] = "linear"


class SticksCommand(Model):
    """A recording of sticks, a CSV with ``time_s, roll, pitch, yaw, throttle`` in -1..1.

    Roll and pitch ask for an angle, yaw for a turn rate, throttle for a climb rate.
    """

    kind: Literal["sticks"]
    file: str
    start_s: Seconds = 0.0
    tilt_deg: Positive = 20.0
    yaw_rate_deg_s: Positive = 45.0
    climb_m_s: Positive = 1.0


class PlaceCommand(Model):
    """From ``start_s`` on: fly to a place and hold it, by the autopilot's law; what is not stated is where it is then.

    m, NED, from the place below the start; ``altitude_m`` above the ground there.  Height and heading that no place has
    stated yet are those of other commands.
    """

    kind: Literal["place"]
    start_s: Seconds = 0.0
    north_m: Amplitude | None = None
    east_m: Amplitude | None = None
    altitude_m: Annotated[float, Field(ge=0.0, le=20000.0)] | None = None
    yaw_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | None = None  # from north, the short way round
    speed_m_s: Positive | None = None  # at most on the way; not stated: the vehicle's [control.pilot]


class VelocityCommand(Model):
    """From ``start_s`` on: fly at a velocity over the ground, by the autopilot's law; m/s, NED.

    Not stated: ``climb_m_s``, the height stays that of other commands; ``yaw_deg``, the heading.
    """

    kind: Literal["velocity"]
    start_s: Seconds = 0.0
    north_m_s: Amplitude = 0.0
    east_m_s: Amplitude = 0.0
    climb_m_s: Amplitude | None = None  # no faster than the autopilot climbs and sinks; ends above the ground
    yaw_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | None = None  # from north, the short way round


class Waypoint(Model):
    """One of the places of a :class:`WaypointsCommand`; as there where something is not stated."""

    north_m: Amplitude
    east_m: Amplitude
    altitude_m: Annotated[float, Field(ge=0.0, le=20000.0)] | None = None
    yaw_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | None = None
    speed_m_s: Positive | None = None
    hold_s: Seconds | None = None


class WaypointsCommand(Model):
    """From ``start_s`` on: fly to one place after the other, each once the one before is reached, and hold the last.

    A waypoint is reached where the estimated place is within ``radius_m`` of it, horizontally and, where it states a
    height, vertically; ``hold_s`` later the next one is flown to.  Places as in :class:`PlaceCommand`.
    """

    kind: Literal["waypoints"]
    start_s: Seconds = 0.0
    speed_m_s: Positive | None = None
    radius_m: Positive = 1.5  # the autopilot's own, HJ_ACC_RADIUS
    hold_s: Seconds = 0.0
    waypoint: Annotated[list[Waypoint], Field(min_length=1)]


class TrackCommand(Model):
    """A CSV of places over time, flown as it says: ``time_s, north_m, east_m`` and, if wanted, ``altitude_m, yaw_deg``.

    Between its rows runs the cubic spline that begins and ends at rest; the law is given its place, velocity and
    acceleration.  Before its first row the first place holds, after the last the last.
    """

    kind: Literal["track"]
    file: str
    start_s: Seconds = 0.0


GuidedCommand = PlaceCommand | VelocityCommand | WaypointsCommand | TrackCommand  # the position law flies them
CommandEntry = Annotated[
    StepCommand | DoubletCommand | RampCommand | SweepCommand | TableCommand | SticksCommand | GuidedCommand,
    Field(discriminator="kind"),
]


class ForceDisturbance(Model):
    """A constant force at the centre of gravity of the vehicle as built, body frame."""

    kind: Literal["force"]
    start_s: Seconds
    duration_s: Duration
    force_n: Vector


class MomentDisturbance(Model):
    """A constant moment, body frame."""

    kind: Literal["moment"]
    start_s: Seconds
    duration_s: Duration
    moment_n_m: Vector


class TorqueCommandDisturbance(Model):
    """Added to the rate controller's output on one axis, without the controller's knowledge.

    The unit is that output's: throttle on roll, rad of tilt on pitch and yaw.  It enters at the ``actuators``, or at
    the ``controller``: before the added delay, and if ``seen`` before the place where a predictor reads the command.
    """

    kind: Literal["torque_command"]
    axis: Axis
    shape: Literal["step", "doublet", "sweep"] = "step"
    start_s: Seconds
    duration_s: Duration  # of the whole step, doublet or sweep
    amplitude: Amplitude
    from_hz: Positive = 0.3
    to_hz: Positive = 4.0
    at: Literal["actuators", "controller"] = "actuators"
    seen: bool = False  # by the predictor

    @model_validator(mode="after")
    def _seen_at_the_controller(self) -> TorqueCommandDisturbance:
        if self.seen and self.at == "actuators":
            raise ValueError("a predictor can see only what is added at the controller (at = 'controller')")
        return self


class PayloadDisturbance(Model):
    """A point mass fixed to the vehicle from ``start_s`` on, for ``duration_s`` or to the end."""

    kind: Literal["payload"]
    start_s: Seconds
    duration_s: Duration | None = None
    mass_kg: Positive
    offset_m: Vector


class WindDisturbance(Model):
    """A change of the steady wind (where the air moves to), NED."""

    kind: Literal["wind"]
    start_s: Seconds
    duration_s: Duration | None = None
    velocity_ned_m_s: Vector


class GustDisturbance(Model):
    """JSBSim's one-minus-cosine gust: rises over ``rise_s``, holds, and falls."""

    kind: Literal["gust"]
    start_s: Seconds
    velocity_ned_m_s: Vector
    rise_s: Duration
    hold_s: Seconds
    fall_s: Duration


DisturbanceEntry = Annotated[
    ForceDisturbance
    | MomentDisturbance
    | TorqueCommandDisturbance
    | PayloadDisturbance
    | WindDisturbance
    | GustDisturbance,
    Field(discriminator="kind"),
]


def _as_list(jet: Any) -> Any:
    return jet if isinstance(jet, list) else [jet]


def _station_number(text: str) -> str:
    if text not in map(str, range(1, MOST_JETS + 1)):
        raise ValueError(f"a station is the number of a jet, 1 to {MOST_JETS} at most")
    return text


def _once_each(jets: list[int]) -> list[int]:
    if len(set(jets)) != len(jets):
        raise ValueError("name a jet once")
    return jets


StationNumber = Annotated[str, AfterValidator(_station_number)]
JetNumber = Annotated[int, Field(ge=1, le=MOST_JETS)]
Jets = Annotated[list[JetNumber], Field(min_length=1), BeforeValidator(_as_list), AfterValidator(_once_each)]


class FlameOut(Model):
    """The engine goes out, and is lit again at the end."""

    kind: Literal["flame_out"]
    start_s: Seconds
    duration_s: Duration | None = None
    jet: Jets


class StuckThrottle(Model):
    """The engine stays at the throttle it has at the start, or at ``throttle``."""

    kind: Literal["stuck_throttle"]
    start_s: Seconds
    duration_s: Duration | None = None
    jet: Jets
    throttle: Annotated[float, Field(ge=0.0, le=1.0)] | None = None


class ThrustLoss(Model):
    """``share`` of the thrust is missing."""

    kind: Literal["thrust_loss"]
    start_s: Seconds
    duration_s: Duration | None = None
    jet: Jets
    share: Annotated[float, Field(gt=0.0, le=1.0)]


class SlowSpool(Model):
    """A further first-order lag before the engine."""

    kind: Literal["slow_spool"]
    start_s: Seconds
    duration_s: Duration | None = None
    jet: Jets
    lag_s: Annotated[float, Field(gt=0.0, le=100.0)]


class DelayGrowth(Model):
    """A further delay before the engine; at its end the commands on their way are lost."""

    kind: Literal["delay_growth"]
    start_s: Seconds
    duration_s: Duration | None = None
    jet: Jets
    delay_s: Annotated[float, Field(gt=0.0, le=10.0)]


class ServoJam(Model):
    """A tilt servo stays where it stands, or runs to ``angle_deg`` and stays there."""

    kind: Literal["servo_jam"]
    start_s: Seconds
    duration_s: Duration | None = None
    servo: str  # left or right of two banks, else the name of a hinge or a surface
    angle_deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None = None


class SensorBias(Model):
    """Added to what a sensor gives out: rad/s (gyro), rad about the body axes (attitude), m (gnss, NED; barometer)."""

    kind: Literal["sensor_bias"]
    start_s: Seconds
    duration_s: Duration | None = None
    sensor: Sensor
    bias: list[float] = [0.0, 0.0, 0.0]  # one number for the barometer, else three
    velocity_bias: Vector = (0.0, 0.0, 0.0)  # m/s, NED, of the gnss alone

    @model_validator(mode="after")
    def _fits_the_sensor(self) -> SensorBias:
        wanted = 1 if self.sensor == "barometer" else 3
        if len(self.bias) != wanted:
            raise ValueError(f"bias: the {self.sensor} needs a list of {wanted}")
        if any(self.velocity_bias) and self.sensor != "gnss":
            raise ValueError("velocity_bias: only the gnss measures a velocity")
        if not any((*self.bias, *self.velocity_bias)):
            raise ValueError("bias: give one that is not 0")
        return self

    @property
    def vector(self) -> Vector:
        """``bias``, the barometer's in its first place."""
        x, y, z = (*self.bias, 0.0, 0.0)[:3]
        return (x, y, z)


class SensorDropout(Model):
    """A sensor repeats the last it gave before the start."""

    kind: Literal["sensor_dropout"]
    start_s: Seconds
    duration_s: Duration | None = None
    sensor: Sensor


EngineFault = FlameOut | StuckThrottle | ThrustLoss | SlowSpool | DelayGrowth
SensorFault = SensorBias | SensorDropout
Fault = EngineFault | ServoJam | SensorFault
FaultEntry = Annotated[Fault, Field(discriminator="kind")]


class Initial(Model):
    """Where the flight begins."""

    on_ground: bool = False
    altitude_m: Annotated[float, Field(ge=0.0, le=20000.0)] = 30.0  # above the ground; not used on the ground
    attitude_deg: Vector = (0.0, 0.0, 0.0)
    velocity_ned_m_s: Vector = (0.0, 0.0, 0.0)
    rate_deg_s: Vector = (0.0, 0.0, 0.0)
    fuel: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0  # of the tank, where the aircraft has one


class Environment(Model):
    """Place, steady wind and turbulence (JSBSim's MIL-F-8785C model)."""

    latitude_deg: Annotated[float, Field(ge=-89.0, le=89.0)] = 22.35
    longitude_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 113.59
    ground_m: Annotated[float, Field(ge=-400.0, le=5000.0)] = 0.0
    wind_ned_m_s: Vector = (0.0, 0.0, 0.0)
    turbulence_wind_m_s: NotNegative = 0.0  # mean wind at 6 m that sets the turbulence's strength below 300 m
    turbulence_severity: Annotated[int, Field(ge=0, le=7)] = 0  # probability-of-exceedance index; 0 is none


Factor = Annotated[float, Field(gt=0.0, le=10.0)]


class Mismatch(Model):
    """How what flies differs from what aircraft, identified models and engines state; no controller knows of it.

    Keys of the aircraft and of the engine change both sides where the controller is made from them too: the hover
    throttle follows the mass, the allocation the places of the jets, height control and tilts the engine's curve.
    """

    mass_factor: Factor = 1.0  # of the mass; the moments of inertia stay
    centre_m: Vector = (0.0, 0.0, 0.0)  # where the centre of gravity is, body, from where it is taken to be
    thrust_factor: Factor = 1.0  # of every engine's thrust, at the same reported spool speed
    thrust_factor_1: Factor = 1.0  # of one jet's beside, of the first six
    thrust_factor_2: Factor = 1.0
    thrust_factor_3: Factor = 1.0
    thrust_factor_4: Factor = 1.0
    thrust_factor_5: Factor = 1.0
    thrust_factor_6: Factor = 1.0
    delay_samples: Annotated[int, Field(ge=0, le=1000)] = 0  # control steps by which every engine is later

    @property
    def single_factors(self) -> tuple[float, ...]:
        """The factors of the single jets."""
        return (
            self.thrust_factor_1,
            self.thrust_factor_2,
            self.thrust_factor_3,
            self.thrust_factor_4,
            self.thrust_factor_5,
            self.thrust_factor_6,
        )


class Range(Model):
    min: float | None = None
    max: float | None = None

    @model_validator(mode="after")
    def _says_something(self) -> Range:
        if self.min is None and self.max is None:
            raise ValueError("give min, max or both")
        return self


def _most(value: Any) -> float | Literal[False] | None:
    if value is None or value is False:
        return value
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value < inf:
        raise ValueError("must be a number of at least 0, or false for no limit")
    return float(value)


Most = Annotated[bool | float | None, BeforeValidator(_most)]


class FlightLimits(Model):
    """The most that a flight may come to; false: no limit, not stated: the default (:mod:`cosim.results.limits`)."""

    height_error_m: Most = None  # largest, from the height asked for
    place_error_m: Most = None  # largest, from the place asked for
    drift_m: Most = None  # largest, from the start; not limited by default where a place is asked for
    speed_m_s: Most = None  # largest, over the ground
    saturated_percent: Most = None  # of the steps in the air
    throttle_activity_1_s: Most = None  # none by default
    tilt_activity_rad_s: Most = None  # none by default
    fuel_burnt_kg: Most = None  # none by default


class Expectation(Model):
    """What a flight with this controller, engine and aircraft must come to."""

    controller: str
    engine: str
    aircraft: str = ""  # not stated: the one that the scenario states
    outcome: list[Outcome] = ["completed"]
    metrics: dict[str, Range] = {}  # "roll.overshoot_percent" -> range


class Station(Model):
    """What stands at one engine station instead of the scenario's engine, or that engine with other parameters."""

    engine: str | None = None  # None: the scenario's
    parameters: dict[str, float] = {}  # over the scenario's engine_parameters if the engine is the scenario's

    @model_validator(mode="after")
    def _says_something(self) -> Station:
        if self.engine is None and not self.parameters:
            raise ValueError("give engine, parameters or both")
        return self


class Scenario(Model):
    """One flight: the keys of a scenario's TOML are its attributes, and units are in their names.

    ``vehicle`` and ``engine_parameters`` are written over what the aircraft and engine state.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    title: str = ""
    description: str = ""
    aircraft: str = "hexjet"  # or the path of a folder with a vehicle.toml, from the folder of this file
    engine: str = "edf-as-flown"
    controller: str = "smith"
    controller_parameters: dict[str, float] = {}  # of a controller of one's own
    controller_sha256: str | None = None  # it flies only if it is this one still
    controller_limit_s: Annotated[float, Field(gt=0.0, le=3600.0)] = (
        10.0  # of the clock, that each of its calls may take
    )
    duration_s: Duration
    step_s: Step = STEP_S  # not stated: the aircraft's control_step
    substeps: Annotated[int, Field(ge=1, le=100)] = 4
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    sensor_noise: bool = True
    added_delay_samples: Annotated[int, Field(ge=0, le=1000)] = 0  # on the rate controller's roll output
    initial: Initial = Initial()
    environment: Environment = Environment()
    mismatch: Mismatch = Mismatch()
    command: list[CommandEntry] = []
    disturbance: list[DisturbanceEntry] = []
    fault: list[FaultEntry] = []
    monitor: bool | None = None  # engines are watched and planned around; None: where an engine is to fail
    engine_parameters: dict[str, float] = {}
    engine_unchecked: bool = False  # engines that are not of the library fly without having been tried before
    engine_isolated: bool = False  # the engines run in a process of their own
    engine_start: Literal["before flight", "in flight"] = "before flight"  # of engines with a [start], on the ground
    stations: dict[StationNumber, Station] = {}  # by the number of the jet
    requests: str | None = None  # a file of what is asked of the autopilot, which flies then
    metrics: list[str] = []  # of one's own, beside the built-in ones: FILE.py:Name, package.module:Name, entry points
    observers: list[str] = []  # of one's own, the same way, as the next two
    sensors: str | None = None  # behind the built-in ones
    wind: str | None = None  # over time and place, beside the environment's; or a table over time, FILE.csv
    own_sha256: dict[str, str] = {}  # of the four above, by name: they fly only if they are these still
    vehicle: dict[str, Any] = {}
    limits: FlightLimits = FlightLimits()
    expect: list[Expectation] = []

    _folder: Path = PrivateAttr(default_factory=Path)
    _resolved: tuple[str, dict[str, Any], tuple[Vehicle, Path]] | None = PrivateAttr(default=None)  # once needed

    @model_validator(mode="before")
    @classmethod
    def _expected_of_its_own_aircraft(cls, data: Any) -> Any:
        """Said before anything is written over the scenario: it is not expected of another aircraft."""
        if not isinstance(data, dict) or not isinstance(data.get("expect"), list):
            return data
        own = {"aircraft": data.get("aircraft", "hexjet")}
        return data | {"expect": [own | entry if isinstance(entry, dict) else entry for entry in data["expect"]]}

    @model_validator(mode="after")
    def _one_flies(self) -> Scenario:
        if self.requests is not None and self.command:
            raise ValueError("requests: the autopilot flies then, there can be no command")
        if self.engine_start == "in flight" and not self.initial.on_ground:
            raise ValueError(
                'engine_start = "in flight": the engines start on the ground; state initial.on_ground = true'
            )
        return self

    @property
    def folder(self) -> Path:
        """What relative file names in the scenario start from."""
        return self._folder

    def resolved_vehicle(self) -> tuple[Vehicle, Path]:
        """The aircraft with :attr:`vehicle` written over it, and its folder; read and checked once.

        Returns
        -------
        tuple of Vehicle and Path
            The vehicle as stated, and the folder of its aircraft.

        Raises
        ------
        InputError
            As :func:`cosim.spec.vehicle.load_vehicle`.
        """
        known = self._resolved
        if known is None or known[0] != self.aircraft or known[1] is not self.vehicle:  # a copy may have another
            where = f"scenario {self.name}: vehicle"
            vehicle = load_vehicle(self.aircraft, self.vehicle, where, self.folder)
            known = self._resolved = (self.aircraft, self.vehicle, vehicle)
        return known[2]

    @property
    def aircraft_name(self) -> str:
        """What the aircraft is called, also where it is named by a path."""
        return self.resolved_vehicle()[0].name if is_own(self.aircraft) else self.aircraft

    @property
    def monitored(self) -> bool:
        """Whether the engine monitor runs."""
        if self.monitor is not None:
            return self.monitor
        return any(not isinstance(fault, (ServoJam, SensorBias, SensorDropout)) for fault in self.fault)

    def after_the_end(self) -> list[str]:
        """What begins when the flight has ended, so that the flight says nothing about it."""
        return [
            f"{kind}.{number} begins at {entry.start_s:g} s and the flight ends at {self.duration_s:g} s"
            for kind, entries in (("command", self.command), ("disturbance", self.disturbance), ("fault", self.fault))
            for number, entry in enumerate(entries)
            if entry.start_s >= self.duration_s
        ]

    @property
    def steps(self) -> int:
        """Control steps in the whole flight."""
        return self.count(self.duration_s, "duration_s")

    def count(self, seconds: float, key: str) -> int:
        """A time as a whole number of control steps.

        Parameters
        ----------
        seconds : float
            The time [s].
        key : str
            What it is called, for the error.

        Returns
        -------
        int
            Steps.

        Raises
        ------
        InputError
            If it is not one to within a millionth of a step.
        """
        steps = round(seconds / self.step_s)
        if abs(steps * self.step_s - seconds) > 1e-6 * self.step_s:
            raise InputError(
                f"scenario {self.name}: {key} = {seconds:g} s is not a whole number of {self.step_s:g} s steps"
            )
        return steps

    @classmethod
    def load(cls, name: str | Path, settings: list[str] | None = None) -> Scenario:
        """Read a scenario.

        Parameters
        ----------
        name : str or Path
            Its name in ``scenarios/``, or the path of its file.
        settings : list of str or None
            ``KEY=VALUE``, written over it; the value as TOML has it.

        Returns
        -------
        Scenario
            Validated; it cannot be changed, see :meth:`replace`.

        Raises
        ------
        InputError
            For an unknown name (lists the known ones), wrong TOML, or a wrong key or value, the vehicle's among them.
        """
        scenario = cls.read(name, settings)
        scenario.resolved_vehicle()
        return scenario

    @classmethod
    def read(cls, name: str | Path, settings: Sequence[str] | None = None) -> Scenario:
        """As :meth:`load`, its vehicle not looked at: of a run of an older version, or before another aircraft.

        Parameters
        ----------
        name : str or Path
            Its name in ``scenarios/``, or the path of its file.
        settings : sequence of str or None
            ``KEY=VALUE``, written over it; the value as TOML has it.

        Returns
        -------
        Scenario
            Validated but for its vehicle.

        Raises
        ------
        InputError
            As :meth:`load`, for all but the vehicle.
        """
        path = find_scenario(name)
        data = read_toml(path)
        for text in settings or []:
            key, value = parse_setting(text)
            set_path(data, key, value, f"{path}: --set")
        return cls.from_table(data, path.parent, str(path))

    @classmethod
    def from_table(cls, data: dict[str, Any], folder: Path, where: str) -> Scenario:
        """Validate a parsed table.

        Parameters
        ----------
        data : dict
            As TOML gives it.
        folder : Path
            What relative file names in it start from.
        where : str
            What the table is called, for the error.

        Returns
        -------
        Scenario
            Validated.

        Raises
        ------
        InputError
            For a wrong key or value.
        """
        scenario = validate(cls, data, where)
        scenario._folder = folder
        return scenario if "step_s" in data else scenario._at_the_step_of_its_aircraft()

    def _at_the_step_of_its_aircraft(self) -> Scenario:
        """The same with the step that was not stated; an aircraft that cannot be read is told where it is needed."""
        try:
            step = self.resolved_vehicle()[0].control_step
        except InputError:
            return self
        if step == self.step_s:
            return self
        changed = self.model_copy(update={"step_s": step})
        changed.model_fields_set.discard("step_s")  # of another aircraft it is another
        return changed

    def stated(self, mode: Literal["python", "json"] = "python") -> dict[str, Any]:
        """The scenario as a table, to be changed and read anew: without what follows from its aircraft.

        Parameters
        ----------
        mode : {"python", "json"}
            As pydantic has it: with tuples, or with what files can say alone.

        Returns
        -------
        dict
            By key, without those that are None.
        """
        data = self.model_dump(mode=mode, exclude_none=True)
        if "step_s" not in self.model_fields_set:
            del data["step_s"]
        return data

    def replace(self, **changes: Any) -> Scenario:
        """A copy with something changed.

        Parameters
        ----------
        **changes : Any
            By the scenario's keys: tables are merged into its own, everything else is replaced.

        Returns
        -------
        Scenario
            Validated.

        Raises
        ------
        InputError
            For a wrong key or value.
        """
        data = self.stated()
        if changes.get("controller", self.controller) != self.controller:  # what was said of the other one
            data = {
                key: value for key, value in data.items() if key not in ("controller_parameters", "controller_sha256")
            }
        data = merge(data, changes)
        return self.from_table(data, self.folder, f"scenario {self.name}")


def scenario_names() -> list[str]:
    """Every scenario that is shipped."""
    return sorted(path.stem for path in data_folder("scenarios").glob("*.toml"))


def find_scenario(name: str | Path) -> Path:
    """The file of a scenario given by name or path."""
    path = Path(name)
    if path.suffix == ".toml" or path.is_file():
        if not path.is_file():
            raise InputError(f"{path}: no such scenario file")
        return path
    if str(name) not in scenario_names():
        raise InputError(
            f"unknown scenario {str(name)!r}; {similar(str(name), scenario_names())}, or give the path of a .toml file"
        )
    return data_folder("scenarios") / f"{name}.toml"
