"""The columns of a flight's log, in their order: name, unit, frame and meaning.

One row is one control step ``k``.  True and measured quantities are taken at ``t_k``, before the step; everything
else acts over ``[t_k, t_k+1)``.  All are float64.  Body is forward-right-down, NED is north-east-down with its origin
on the ground below the starting point.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from cosim.base.errors import InputError, nearest
from cosim.base.signals import AXES, JETS

RATES = ("p", "q", "r")


class Column(NamedTuple):
    """One column of the log."""

    name: str
    unit: str
    frame: str
    meaning: str


def _each(names: tuple[str, ...], pattern: str, unit: str, frame: str, meaning: str) -> list[Column]:
    """One column per name, which stands for ``{}`` in the pattern and in the meaning."""
    return [Column(pattern.format(name), unit, frame, meaning.format(name)) for name in names]


_XYZ = ("x", "y", "z")
_NED = ("north", "east", "down")
_SERVOS = ("left", "right")
_SENSORS = ("gyro", "attitude", "gnss", "barometer")
_ALL_JETS = tuple(str(jet) for jet in range(1, JETS + 1))
_EULER = "body to NED"
_OUTPUT_UNITS = {"roll": "throttle", "pitch": "rad", "yaw": "rad"}
_OWN = "throttle on roll, rad of tilt on pitch and yaw"

COLUMNS: tuple[Column, ...] = (
    Column("time_s", "s", "", "start of the step"),
    *_each(AXES, "{}_rad", "rad", _EULER, "true {} angle"),
    *_each(AXES, "{}_setpoint_rad", "rad", _EULER, "{} angle asked for; NaN while rates are commanded instead"),
    *_each(AXES, "{}_measured_rad", "rad", _EULER, "{} angle of the measured quaternion"),
    *_each(RATES, "rate_{}_rad_s", "rad/s", "body", "true angular rate {}"),
    *_each(RATES, "rate_{}_measured_rad_s", "rad/s", "body", "angular rate {} as the gyro gives it"),
    *_each(RATES, "rate_{}_predicted_rad_s", "rad/s", "body", "angular rate {} that the rate controller is fed with"),
    *_each(RATES, "rate_{}_setpoint_rad_s", "rad/s", "body", "angular rate {} asked for"),
    *[Column(f"torque_{a}", _OUTPUT_UNITS[a], "body", f"rate controller's output on {a} ({_OWN})") for a in AXES],
    *[
        Column(f"refused_{a}", _OUTPUT_UNITS[a], "body", f"part of torque_{a} that allocation did not give")
        for a in AXES
    ],
    Column("refused_collective", "throttle", "", "part of the collective that allocation did not give"),
    Column("collective", "throttle", "", "mean throttle asked for, 0 to 1"),
    *_each(_ALL_JETS, "throttle_{}", "throttle", "", "throttle of jet {}, 0 to 1"),
    *_each(_ALL_JETS, "thrust_{}_N", "N", "along the jet", "thrust that jet {} delivers"),
    *_each(_SERVOS, "tilt_{}_rad", "rad", "body", "where the {} servo stands; positive tilts the thrust forward"),
    *_each(_SERVOS, "tilt_{}_command_rad", "rad", "body", "where the {} servo is told to go"),
    Column("north_m", "m", "NED", "true position north"),
    Column("east_m", "m", "NED", "true position east"),
    Column("down_m", "m", "NED", "true position down"),
    Column("altitude_m", "m", "", "true height above the ground"),
    Column("altitude_setpoint_m", "m", "", "height asked for; NaN while the collective is commanded instead"),
    Column("altitude_measured_m", "m", "", "height above the ground as the barometer gives it"),
    *_each(("north", "east"), "{}_setpoint_m", "m", "NED", "place {} asked for; NaN while none is"),
    *_each(_NED, "velocity_{}_m_s", "m/s", "NED", "true velocity {} over the ground"),
    *_each(_NED, "{}_measured_m", "m", "NED", "position {} as GNSS gives it"),
    *_each(_NED, "velocity_{}_measured_m_s", "m/s", "NED", "velocity {} as GNSS gives it"),
    *_each(_XYZ, "specific_force_{}_m_s2", "m/s^2", "body", "what an accelerometer at the centre of gravity feels, {}"),
    *_each(_XYZ, "specific_force_{}_measured_m_s2", "m/s^2", "body", "specific force {} as the accelerometer gives it"),
    *_each(_NED, "wind_{}_m_s", "m/s", "NED", "where the air moves to, {}, gusts and turbulence included"),
    *_each(
        RATES, "air_rate_{}_rad_s", "rad/s", "body", "turbulence turns the air; rate {} of it; 0 without turbulence"
    ),
    Column("mass_kg", "kg", "", "mass, payload included"),
    Column("on_ground", "0/1", "", "a leg touches the ground"),
    Column("hull_contact", "0/1", "", "anything but a leg touches the ground"),
    *_each(_XYZ, "disturbance_force_{}_N", "N", "body", "disturbing force {} at the centre of gravity as built"),
    *_each(_XYZ, "disturbance_moment_{}_N_m", "N m", "body", "disturbing moment about {}"),
    *[
        Column(f"disturbance_torque_{a}", _OUTPUT_UNITS[a], "body", f"added to torque_{a}, unknown to the controller")
        for a in AXES
    ],
    Column("payload_kg", "kg", "", "mass of the payload"),
    *_each(_XYZ, "payload_{}_m", "m", "body", "place of the payload along {}, from the centre of gravity as built"),
    *_each(_ALL_JETS, "spool_speed_{}_rad_s", "rad/s", "", "rotor speed of engine {}; NaN where it does not say"),
    *_each(_ALL_JETS, "exhaust_temperature_{}_K", "K", "", "exhaust temperature {}; NaN where the engine does not say"),
    *_each(_ALL_JETS, "fuel_flow_{}_kg_s", "kg/s", "", "fuel that engine {} burns; NaN where it does not say"),
    Column("fuel_kg", "kg", "", "fuel on board; NaN without a tank"),
    *_each(_XYZ, "spool_moment_{}_N_m", "N m", "body", "moment of the rotors' spin about {}; NaN where not modelled"),
    *_each(_ALL_JETS, "health_{}", "1", "", "share of its command that jet {} gives, as the monitor believes"),
    *_each(_ALL_JETS, "fault_jet_{}", "0/1", "", "a fault acts on jet {}"),
    *_each(_SERVOS, "fault_servo_{}", "0/1", "", "a fault acts on the {} servo"),
    *_each(_SENSORS, "fault_{}", "0/1", "", "a fault acts on the {}"),
)

NAMES: tuple[str, ...] = tuple(column.name for column in COLUMNS)


def known(name: str, columns: Iterable[str], where: str = "log") -> str:
    """``name``, if it is one of the columns.  Raises InputError with the nearest ones."""
    columns = tuple(columns)
    if name not in columns:
        raise InputError(f"the {where} has no column {name!r}; {nearest(name, columns)}")
    return name
