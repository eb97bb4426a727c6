"""The vehicle's parameters: what a ground station may read and change while it flies.

Names are at most 16 characters.  ``HJ_*`` are ours; the others are PX4's, because ground stations look for them.
Every change of a gain goes through the control blocks' ``retune``, which makes it without a bump in the command.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import degrees, isfinite
from typing import Literal, NamedTuple

from cosim.base.errors import InputError
from cosim.base.layout import UP
from cosim.base.signals import AXES
from cosim.control.predictors.registry import PREDICTORS, number_of
from cosim.spec.vehicle import Control, Jet, PilotSettings, PositionGains, PredictorTuning

# Largest gain over its default, chosen by us because no loop here is stable beyond it.
_MAX_GAIN_RATIO = 10.0


class EnumValue(NamedTuple):
    """One value of an enumeration."""

    value: int
    text: str


@dataclass(frozen=True)
class Parameter:
    """Parameter of the autopilot; ``least`` and ``most`` bound its value, in ``unit``."""

    name: str
    kind: Literal["float", "int"]
    default: float
    least: float
    most: float
    unit: str
    group: str
    text: str
    values: tuple[EnumValue, ...] = ()
    read_only: bool = False
    decimals: int = field(default=3)


class Caution(NamedTuple):
    """A warning about a loop that a change of parameters makes worse."""

    axis: str  # "roll", "pitch", "yaw", "altitude"
    unstable: bool
    was_stable: bool  # stable before the change
    text: str


NOTHING, HOLD, RETURN, LAND = range(4)  # actions of failsafes
_FAILSAFE_ACTIONS = (EnumValue(0, "message only"), EnumValue(1, "hold"), EnumValue(2, "return"), EnumValue(3, "land"))


class Parameters:
    """Table of the autopilot's parameters, and their present values."""

    def __init__(self, table: Sequence[Parameter]) -> None:
        self.table = {line.name: line for line in table}
        self._values: dict[str, float] = {line.name: line.default for line in table}

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.table.values())

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    @property
    def values(self) -> Mapping[str, float]:
        """Every value by name, in the table's order."""
        return self._values

    def changed(self) -> dict[str, float]:
        """Return the values by name that are not at their default, which is enough to restore them all."""
        return {name: value for name, value in self._values.items() if value != self.table[name].default}

    def check(self, name: str, value: float) -> float:
        """Return the value that would be stored.  Raises InputError for a wrong name, kind or range."""
        line = self.table.get(name)
        if line is None:
            raise InputError(f"unknown parameter {name!r}")
        if not isfinite(value):
            raise InputError(f"{name} = {value!r}: must be a finite number")
        if line.read_only and value != self._values[name]:
            raise InputError(f"{name} = {value:g}: cannot be changed, it is {self._values[name]:g}")
        if line.kind == "int" and value != int(value):
            raise InputError(f"{name} = {value!r}: must be a whole number")
        # A bound that passed through a 32-bit float must still be accepted.
        slack = 1e-6 * max(abs(line.least), abs(line.most))
        if not line.least - slack <= value <= line.most + slack:
            unit = f" {line.unit}" if line.unit else ""
            raise InputError(f"{name} = {value:g}: must be from {line.least:g} to {line.most:g}{unit}")
        if line.values and value not in (allowed := [meaning.value for meaning in line.values]):
            raise InputError(f"{name} = {value:g}: must be one of {', '.join(map(str, allowed))}")
        return min(line.most, max(line.least, value))

    def set(self, name: str, value: float) -> None:
        """Store a value.  Raises InputError for a wrong name, kind or range."""
        self._values[name] = self.check(name, value)


# Parameters that a custom controller replaces, by its level: changing them would have no effect.
_PREDICTORS, _ANGLES = ("HJ_PRED_",), ("HJ_ATT_", "HJ_RLIM_")
_RATE_GAINS = tuple(f"HJ_{axis.upper()}_{term}" for axis in AXES for term in "PID")  # gains of the rate loops
_HEIGHT_LOOP = ("HJ_ALT_P", "HJ_CLIMB_P", "HJ_CLIMB_I", "HJ_SPEED_UP", "HJ_SPEED_DN")  # parameters of the height loop
_INEFFECTIVE: Mapping[str, tuple[str, ...]] = {  # parameters without effect, by level
    "predictor": _PREDICTORS,
    "rate": _PREDICTORS + _RATE_GAINS,
    "attitude": _ANGLES,
    "controller": _PREDICTORS + _RATE_GAINS + _ANGLES + _HEIGHT_LOOP,
}


def table(
    control: Control,
    pilot: PilotSettings,
    controller: str,
    delay: float | None,
    level: str = "",
    jets: Sequence[Jet] = (),
) -> list[Parameter]:
    """Return all parameters of a vehicle; ``delay``: of its roll model in samples, or None.

    ``level``: of a controller from outside; what tunes the loops in whose place it stands cannot be changed then.
    ``jets``: where its engines are, for ground stations that draw them.
    Raises InputError for a vehicle without a table [control.position].
    """
    if control.position is None:
        raise InputError("vehicle.control.position is missing: this vehicle cannot be flown by the autopilot")
    parameters = [
        *_list_loop_parameters(control),
        *_list_position_parameters(control.position),
        *_list_flight_parameters(pilot),
        *_list_predictor_parameters(control.predictor, controller, delay),
        *_list_failsafe_parameters(pilot),
        *_px4_parameters(),
        *_geometry_parameters(jets),
    ]
    mute = _INEFFECTIVE.get(level, ())
    return [
        replace(parameter, read_only=True) if parameter.name.startswith(mute) else parameter for parameter in parameters
    ]


def _make_gain(name: str, default: float, unit: str, group: str, text: str, most: float | None = None) -> Parameter:
    return Parameter(name, "float", default, 0.0, most or _MAX_GAIN_RATIO * default, unit, group, text, decimals=5)


def _list_loop_parameters(control: Control) -> Iterator[Parameter]:
    rate = (control.rate.roll, control.rate.pitch, control.rate.yaw)
    # Commands are throttle on roll, rad of tilt on pitch and yaw.
    units = (("s/rad", "1/rad", "s^2/rad"), ("s", "1", "s^2"), ("s", "1", "s^2"))
    for axis, law, (of_p, of_i, of_d) in zip(AXES, rate, units, strict=True):
        name = f"HJ_{axis.upper()}"
        yield _make_gain(f"{name}_P", law.p, of_p, "Rate loop", f"{axis} rate, proportional gain")
        most = _MAX_GAIN_RATIO * max(law.i, law.p)
        yield _make_gain(f"{name}_I", law.i, of_i, "Rate loop", f"{axis} rate, integral gain", most)
        most = max(_MAX_GAIN_RATIO * law.d, law.p)  # allows a derivative time of 1 s
        yield _make_gain(f"{name}_D", law.d, of_d, "Rate loop", f"{axis} rate, derivative gain", most)
    attitude = control.attitude
    for axis, gain, limit in zip(AXES, attitude.gain_1_s, attitude.rate_limit_rad_s, strict=True):
        yield _make_gain(f"HJ_ATT_{axis.upper()}", gain, "1/s", "Attitude loop", f"{axis}: commanded rate per error")
        text = f"{axis}: largest rate commanded by the attitude loop"
        yield Parameter(
            f"HJ_RLIM_{axis.upper()}", "float", degrees(limit), 5.0, 720.0, "deg/s", "Attitude loop", text, decimals=1
        )
    height = control.altitude
    yield _make_gain("HJ_ALT_P", height.position_1_s, "1/s", "Height", "commanded climb rate per height error")
    yield _make_gain("HJ_CLIMB_P", height.velocity_1_s, "1/s", "Height", "commanded acceleration per climb rate error")
    yield _make_gain("HJ_CLIMB_I", height.integral_1_s2, "1/s^2", "Height", "its integral")
    yield Parameter("HJ_SPEED_UP", "float", height.climb_limit_m_s, 0.1, 20.0, "m/s", "Height", "most climb rate")
    yield Parameter("HJ_SPEED_DN", "float", height.descent_limit_m_s, 0.1, 20.0, "m/s", "Height", "most descent rate")


def _list_position_parameters(gains: PositionGains) -> Iterator[Parameter]:
    yield _make_gain("HJ_POS_P", gains.position_1_s, "1/s", "Position", "commanded speed per position error")
    yield _make_gain("HJ_VEL_P", gains.velocity_1_s, "1/s", "Position", "commanded acceleration per velocity error")
    text = "largest lean in automatic flight"
    yield Parameter("HJ_LEAN_MAX", "float", degrees(gains.lean_rad), 2.0, 45.0, "deg", "Position", text, decimals=1)


def _list_flight_parameters(pilot: PilotSettings) -> Iterator[Parameter]:
    def entry(name: str, default: float, least: float, most: float, unit: str, text: str) -> Parameter:
        return Parameter(name, "float", default, least, most, unit, "Automatic flight", text)

    yield entry("MPC_XY_VEL_MAX", pilot.speed_m_s, 0.2, 50.0, "m/s", "horizontal speed of automatic flight")
    yield entry("HJ_ACC_HOR", pilot.acceleration_m_s2, 0.1, 10.0, "m/s^2", "horizontal acceleration of set-points")
    yield entry("HJ_JERK_HOR", pilot.jerk_m_s3, 0.1, 100.0, "m/s^3", "horizontal jerk of set-points, from rest on")
    yield entry("HJ_CLIMB_AUTO", pilot.climb_m_s, 0.1, 20.0, "m/s", "climb rate of automatic flight")
    yield entry("HJ_DESC_AUTO", pilot.descent_m_s, 0.1, 20.0, "m/s", "descent rate of automatic flight")
    yield entry("MPC_LAND_SPEED", pilot.land_m_s, 0.1, 2.0, "m/s", "descent rate of the last metres of a landing")
    yield entry("HJ_LAND_SLOW_H", 3.0, 0.5, 50.0, "m", "height above the ground, or home, below which it sinks slowly")
    yield entry("MIS_TAKEOFF_ALT", pilot.takeoff_height_m, 1.0, 500.0, "m", "height of a take-off that names none")
    yield entry("RTL_RETURN_ALT", pilot.return_height_m, 2.0, 1000.0, "m", "least height above home of the way back")
    yield entry("HJ_YAW_RATE", degrees(pilot.yaw_rate_rad_s), 1.0, 180.0, "deg/s", "turn rate of set-points")
    yield entry("HJ_STICK_LEAN", degrees(pilot.stick_lean_rad), 2.0, 45.0, "deg", "lean at full stick")
    yield entry("HJ_ACC_RADIUS", 1.5, 0.2, 50.0, "m", "a waypoint is reached within this distance")
    yield entry("HJ_SPOOL_TIME", pilot.spool_s, 0.2, 60.0, "s", "from idle to hover thrust before take-off")


def _list_predictor_parameters(tuning: PredictorTuning, controller: str, delay: float | None) -> Iterator[Parameter]:
    group = "Predictor"
    specs = sorted(PREDICTORS.values(), key=lambda spec: spec.value)
    values = tuple(EnumValue(spec.value, spec.name) for spec in specs if delay is not None or not spec.needs_model)
    if controller not in PREDICTORS:  # a controller that is not built in
        values += (EnumValue(number_of(controller), controller),)
    first, last = values[0].value, values[-1].value
    flown = PREDICTORS[controller].value if controller in PREDICTORS else last
    text = "; ".join(f"{spec.value} {spec.title}" for spec in specs)
    yield Parameter("HJ_PRED_TYPE", "int", flown, first, last, "", group, text, values)
    text = "delay that the roll predictor takes the engines to have"
    most = min(1000.0, max(4.0 * delay, 100.0)) if delay is not None else 0.0
    yield Parameter("HJ_PRED_DELAY", "float", delay or 0.0, 0.0, most, "samples", group, text, decimals=2)
    for spec in specs:
        for own in spec.parameters:
            if own.mavlink:
                yield Parameter(
                    own.mavlink, "float", spec.own(tuning)[own.name], own.least, own.most, own.unit, group,
                    f"{spec.name}: {own.text}", decimals=own.decimals,
                )  # fmt: skip


def _list_failsafe_parameters(pilot: PilotSettings) -> Iterator[Parameter]:
    def entry(name: str, default: float, most: float, unit: str, text: str, least: float = 0.0) -> Parameter:
        return Parameter(name, "float", default, least, most, unit, "Failsafe", text)

    def make_action(name: str, default: int, text: str) -> Parameter:
        return Parameter(name, "int", default, 0, 3, "", "Failsafe", text, _FAILSAFE_ACTIONS)

    yield make_action("HJ_LINK_ACT", RETURN, "when no ground station is heard any more")
    yield entry("HJ_LINK_DELAY", 1.0, 300.0, "s", "after the loss has been noticed")
    yield entry("HJ_STICK_TIME", 0.5, 5.0, "s", "sticks older than this are let go", 0.1)
    yield entry("HJ_OFFB_TIME", 0.5, 5.0, "s", "set-points older than this end OFFBOARD", 0.1)
    yield entry("HJ_FENCE_RAD", 0.0, 1e4, "m", "fence: most distance from home, 0 is none")
    yield entry("HJ_FENCE_ALT", 0.0, 1e4, "m", "fence: most height above home, 0 is none")
    yield make_action("HJ_FENCE_ACT", RETURN, "when the fence is passed")
    yield entry("HJ_FUEL_LOW", 20.0, 100.0, "%", "fuel or battery: low, whatever the way home takes")
    yield entry("HJ_FUEL_CRIT", 8.0, 100.0, "%", "fuel or battery: the vehicle lands, whatever the way down takes")
    yield make_action("HJ_FUEL_ACT", RETURN, "when fuel or battery are low, or just do for the way home")
    text = "fuel or battery beyond what the way home takes as reckoned, half of it beyond the way down"
    yield entry("HJ_FUEL_MARGIN", 30.0, 200.0, "%", text, 5.0)
    yield entry("HJ_ENDURANCE", pilot.endurance_s, 1e5, "s", "hover on a full battery, 0: not estimated")
    yield make_action("HJ_ENG_ACT", LAND, "when an engine fails in the air")
    off_on = (EnumValue(0, "refused"), EnumValue(1, "taken"))
    text = "parameters set in the air that make a loop unstable"
    yield Parameter("HJ_FORCE", "int", 0, 0, 1, "", "Failsafe", text, off_on)
    yield make_action("HJ_SENS_ACT", RETURN, "when the barometer fails or the gyro is biased")
    yield entry("HJ_ARM_LEAN", 10.0, 30.0, "deg", "most lean that may be armed at", 1.0)
    yield entry("HJ_TIP_LEAN", 60.0, 90.0, "deg", "a lean for half a second that counts as lost control", 20.0)
    yield entry("HJ_DISARM_LAND", 2.0, 60.0, "s", "from landing to disarming")
    yield entry("HJ_DISARM_IDLE", 10.0, 600.0, "s", "armed without taking off, 0: stays armed")


def _px4_parameters() -> Iterator[Parameter]:
    """Yield parameters that tell ground stations that a PX4 vehicle is already set up."""
    for name, value, text in (
        ("SYS_AUTOSTART", 22000, "an airframe is chosen (PX4 keeps 22000 to 22999 for others' own)"),
        ("COM_RC_IN_MODE", 1, "sticks come over MAVLink only"),
        ("CAL_GYRO0_ID", 1, "the gyro needs no calibration"),
        ("CAL_ACC0_ID", 1, "the accelerometer needs no calibration"),
        ("SYS_HAS_MAG", 0, "there is no magnetometer: the heading is measured as attitude is"),
        ("SYS_HITL", 0, "nobody else simulates this vehicle"),
    ):
        yield Parameter(name, "int", value, value, value, "", "System", text, read_only=True)
    off_on = (EnumValue(0, "refused"), EnumValue(1, "allowed"))
    yield Parameter("SYS_FAILURE_EN", "int", 0, 0, 1, "", "System", "failures on request", off_on)


def _geometry_parameters(jets: Sequence[Jet], max_jets: int = 12) -> Iterator[Parameter]:
    """Yield engine positions in PX4's form: FRD from the centre of gravity; at most twelve.

    The direction of a thrust is told where it is not straight up, which is what PX4 takes it to be.
    """

    def entry(name: str, kind: Literal["float", "int"], value: float, unit: str, text: str) -> Parameter:
        return Parameter(name, kind, value, value, value, unit, "Geometry", text, read_only=True, decimals=4)

    if jets:
        yield entry("CA_ROTOR_COUNT", "int", len(jets), "", "engines")
    for number, jet in enumerate(jets[:max_jets]):
        name = f"CA_ROTOR{number}"
        for letter, place in zip("XYZ", jet.position_m, strict=True):
            yield entry(f"{name}_P{letter}", "float", place, "m", f"engine {number + 1}: place along {letter.lower()}")
        if jet.axis is not None and jet.axis != UP:
            for letter, part in zip("XYZ", jet.axis, strict=True):
                yield entry(
                    f"{name}_A{letter}", "float", part, "", f"engine {number + 1}: thrust along {letter.lower()}"
                )
        text = f"engine {number + 1}: yaw moment per thrust, positive turns the nose right"
        yield entry(f"{name}_KM", "float", jet.reaction_m, "m", text)
