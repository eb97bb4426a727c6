"""The columns of a flight's log, in their order: name, unit, frame, meaning and where each comes from, said once.

One row is one control step ``k``.  True and measured quantities are taken at ``t_k``, before the step; everything
else acts over ``[t_k, t_k+1)``.  All are float64.  Body is forward-right-down, NED is north-east-down with its origin
on the ground below the starting point.

A column's source is one of

* ``state.euler.0``: a place in a :class:`cosim.base.signals.Sample`, field by field and element by element;
* ``command.altitude unless command.collective``: the same, and NaN in a step in which the other place is not None;
* ``a + b``: the sum of two places;
* ``roll of measured.attitude``: one of :data:`cosim.results.log.row_program.ANGLES`, of a quaternion;
* empty: NaN, of an engine that this vehicle has not.

Where a source lies behind a field that is None the value is NaN.  :mod:`cosim.results.log.row_program` reads them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import count
from typing import TYPE_CHECKING, NamedTuple

from cosim.base.constants import SENSORS, SERVOS
from cosim.base.errors import InputError, nearest
from cosim.base.protocols import Column
from cosim.base.signals import AXES, JETS

if TYPE_CHECKING:
    from cosim.spec.vehicle import Vehicle

RATES = ("p", "q", "r")  # names of body rates
_XYZ = ("x", "y", "z")  # body axes
_NED = ("north", "east", "down")  # axes of NED
EULER = "body to NED"  # frame of attitude angles
_OUTPUT_UNITS = {"roll": "throttle", "pitch": "rad", "yaw": "rad"}  # unit of each rate loop's output
_ALLOCATED = "throttle on roll, rad of tilt on pitch and yaw"  # unit of commands to the allocation


def _cols(
    names: Sequence[str], pattern: str, unit: str, frame: str, meaning: str, source: str, first: int = 0
) -> list[Column]:
    """Return a column for each name, which replaces ``{}`` in pattern, meaning and source; ``{n}`` is its index."""
    return [
        Column(pattern.format(name), unit, frame, meaning.format(name), source.format(name, n=n))
        for n, name in enumerate(names, first)
    ]


def _torques(name: str, meaning: str, source: str, accelerations: bool) -> list[Column]:
    """Return one column per axis, in the unit of the axis."""
    return [
        Column(
            name.format(axis),
            "rad/s^2" if accelerations else _OUTPUT_UNITS[axis],
            "body",
            meaning.format(axis),
            source.format(n=n),
        )
        for n, axis in enumerate(AXES)
    ]


class LoggedVehicle(NamedTuple):
    """Parts of a vehicle that have log columns.

    ``servos``: of banks and hinges, and behind them the surfaces; ``accelerations``: its rate controller asks for
    rad/s^2 about every axis, and not for throttle and tilt.
    """

    jets: int = JETS
    servos: tuple[str, ...] = SERVOS
    surfaces: tuple[str, ...] = ()
    accelerations: bool = False


HEXJET = LoggedVehicle()  # columns of six jets in two banks


@lru_cache(64)
def _make_columns(vehicle: LoggedVehicle) -> tuple[Column, ...]:
    jets, servos = vehicle.jets, vehicle.servos
    banks = servos == SERVOS and not vehicle.accelerations
    moved = (*servos, *vehicle.surfaces)
    numbers = [str(jet) for jet in range(1, max(jets, JETS) + 1)]

    def per_jet(pattern: str, unit: str, frame: str, meaning: str, source: str) -> list[Column]:
        columns = _cols(numbers, pattern, unit, frame, meaning, source)
        return [column if n < jets else column._replace(source="") for n, column in enumerate(columns)]

    return (
        Column("time_s", "s", "", "start of the step", "time"),
        *_cols(AXES, "{}_rad", "rad", EULER, "true {} angle", "state.euler.{n}"),
        *_cols(
            AXES,
            "{}_setpoint_rad",
            "rad",
            EULER,
            "commanded {} angle; NaN while rates are commanded instead",
            "command.attitude.{n} unless command.rate",
        ),
        *_cols(AXES, "{}_measured_rad", "rad", EULER, "{} angle of the measured quaternion", "{} of measured.attitude"),
        *_cols(RATES, "rate_{}_rad_s", "rad/s", "body", "true angular rate {}", "state.rate.{n}"),
        *_cols(
            RATES,
            "rate_{}_measured_rad_s",
            "rad/s",
            "body",
            "angular rate {} as the gyro gives it",
            "measured.rate.{n}",
        ),
        *_cols(
            RATES,
            "rate_{}_predicted_rad_s",
            "rad/s",
            "body",
            "angular rate {} that the rate controller is fed with",
            "control.rate_predicted.{n}",
        ),
        *_cols(
            RATES, "rate_{}_setpoint_rad_s", "rad/s", "body", "commanded angular rate {}", "control.rate_setpoint.{n}"
        ),
        *_torques(
            "torque_{}",
            "rate controller's output on {}" + ("" if vehicle.accelerations else f" ({_ALLOCATED})"),
            "control.torque.{n}",
            vehicle.accelerations,
        ),
        *_torques(
            "refused_{}",
            "part of torque_{} that allocation did not give",
            "actuation.unallocated.{n}",
            vehicle.accelerations,
        ),
        Column(
            "refused_collective",
            "throttle",
            "",
            "part of the collective that allocation did not give",
            "actuation.unallocated.collective",
        ),
        Column("collective", "throttle", "", "commanded mean throttle, 0 to 1", "control.collective"),
        *per_jet("throttle_{}", "throttle", "", "throttle of jet {}, 0 to 1", "actuation.throttle.{n}"),
        *per_jet("thrust_{}_N", "N", "along the jet", "thrust that jet {} delivers", "engines.thrust.{n}"),
        *_cols(
            servos,
            "tilt_{}_rad",
            "rad",
            "body",
            "where the {} servo stands; positive "
            + ("tilts the thrust forward" if banks else "turns right-handed about its axis"),
            "tilt.{n}",
        ),
        *_cols(servos, "tilt_{}_command_rad", "rad", "body", "commanded angle of the {} servo", "actuation.tilt.{n}"),
        *_cols(
            vehicle.surfaces,
            "deflection_{}",
            "1",
            "",
            "where the surface {} stands, as its JSBSim property counts",
            "tilt.{n}",
            first=len(servos),
        ),
        *_cols(
            vehicle.surfaces,
            "deflection_{}_command",
            "1",
            "",
            "commanded position of the surface {}",
            "actuation.tilt.{n}",
            first=len(servos),
        ),
        Column("north_m", "m", "NED", "true position north", "state.position.0"),
        Column("east_m", "m", "NED", "true position east", "state.position.1"),
        Column("down_m", "m", "NED", "true position down", "state.position.2"),
        Column("altitude_m", "m", "", "true height above the ground", "state.altitude"),
        Column(
            "altitude_setpoint_m",
            "m",
            "",
            "commanded height; NaN while the collective is commanded instead",
            "command.altitude unless command.collective",
        ),
        Column(
            "altitude_measured_m", "m", "", "height above the ground as the barometer gives it", "measured.altitude"
        ),
        *_cols(
            ("north", "east"), "{}_setpoint_m", "m", "NED", "commanded place {}; NaN while none is", "command.place.{n}"
        ),
        *_cols(_NED, "velocity_{}_m_s", "m/s", "NED", "true velocity {} over the ground", "state.velocity.{n}"),
        *_cols(_NED, "{}_measured_m", "m", "NED", "position {} as GNSS gives it", "measured.position.{n}"),
        *_cols(_NED, "velocity_{}_measured_m_s", "m/s", "NED", "velocity {} as GNSS gives it", "measured.velocity.{n}"),
        *_cols(
            _XYZ,
            "specific_force_{}_m_s2",
            "m/s^2",
            "body",
            "what an accelerometer at the centre of gravity feels, {}",
            "state.specific_force.{n}",
        ),
        *_cols(
            _XYZ,
            "specific_force_{}_measured_m_s2",
            "m/s^2",
            "body",
            "specific force {} as the accelerometer gives it",
            "measured.specific_force.{n}",
        ),
        *_cols(
            _NED,
            "wind_{}_m_s",
            "m/s",
            "NED",
            "where the air moves to, {}, gusts and turbulence included",
            "state.wind.{n}",
        ),
        *_cols(
            RATES,
            "air_rate_{}_rad_s",
            "rad/s",
            "body",
            "turbulence turns the air; rate {} of it; 0 without turbulence",
            "state.air_rate.{n}",
        ),
        Column("mass_kg", "kg", "", "mass, payload included", "state.mass"),
        Column("on_ground", "0/1", "", "a leg touches the ground", "state.on_ground"),
        Column("hull_contact", "0/1", "", "anything but a leg touches the ground", "state.hull_contact"),
        *_cols(
            _XYZ,
            "disturbance_force_{}_N",
            "N",
            "body",
            "disturbing force {} at the centre of gravity as built",
            "disturbance.force.{n}",
        ),
        *_cols(
            _XYZ, "disturbance_moment_{}_N_m", "N m", "body", "disturbing moment about {}", "disturbance.moment.{n}"
        ),
        *_torques(
            "disturbance_torque_{}",
            "added to torque_{}, unknown to the controller",
            # Commands before and after the added delay; as neither is ever -0, adding zeros keeps their bits.
            "disturbance.torque_output.{n} + disturbance.torque_command.{n}",
            vehicle.accelerations,
        ),
        Column("payload_kg", "kg", "", "mass of the payload", "disturbance.payload.0"),
        *_cols(
            _XYZ,
            "payload_{}_m",
            "m",
            "body",
            "place of the payload along {}, from the centre of gravity as built",
            "disturbance.payload.{n}",
            first=1,
        ),
        *per_jet(
            "spool_speed_{}_rad_s",
            "rad/s",
            "",
            "rotor speed of engine {}; NaN where it does not say",
            "engines.spool_speed.{n}",
        ),
        *per_jet(
            "exhaust_temperature_{}_K",
            "K",
            "",
            "exhaust temperature {}; NaN where the engine does not say",
            "engines.exhaust_temperature.{n}",
        ),
        *per_jet(
            "fuel_flow_{}_kg_s",
            "kg/s",
            "",
            "fuel that engine {} burns; NaN where it does not say",
            "engines.fuel_flow.{n}",
        ),
        Column("fuel_kg", "kg", "", "fuel on board; NaN without a tank", "fuel"),
        *_cols(
            _XYZ,
            "spool_moment_{}_N_m",
            "N m",
            "body",
            "moment of the rotors' spin about {}; NaN where not modelled",
            "spool_moment.{n}",
        ),
        *per_jet("health_{}", "1", "", "share of its command that jet {} gives, as the monitor believes", "health.{n}"),
        *_cols(numbers, "fault_jet_{}", "0/1", "", "a fault acts on jet {}", "faults.{n}"),
        *_cols(moved, "fault_servo_{}", "0/1", "", "a fault acts on the {} servo", "faults.{n}", first=len(numbers)),
        *_cols(SENSORS, "fault_{}", "0/1", "", "a fault acts on the {}", "faults.{n}", first=len(numbers) + len(moved)),
    )


def log_columns(vehicle: LoggedVehicle = HEXJET, custom: Sequence[Column] = ()) -> tuple[Column, ...]:
    """Return the log's columns for a vehicle, and behind them ``custom``, those of its own blocks.

    At least six of everything that a jet has, so that the logs of all vehicles can be laid side by side.  Raises
    InputError for a column of a block's own that cannot be one.
    """
    columns = list(_make_columns(vehicle))
    names = {column.name for column in columns}
    for n, column in enumerate(custom):
        if not column.name.isidentifier() or not column.name.isascii():
            raise InputError(f"column {column.name!r}: a column's name is of letters, digits and _, no digit first")
        if column.name in names:
            raise InputError(f"column {column.name!r}: the log has one of that name already")
        if not column.meaning:
            raise InputError(f"column {column.name!r}: what does it mean?")
        names.add(column.name)
        columns.append(column._replace(source=f"own.{n}"))
    return tuple(columns)


COLUMNS = log_columns()  # columns of six jets, without custom ones
NAMES: tuple[str, ...] = tuple(column.name for column in COLUMNS)  # names of COLUMNS


def jets_in(columns: Iterable[str]) -> int:
    """Return how many jets a log has columns of; six at least, as an older log of fewer."""
    names = frozenset(columns)
    return next(jets for jets in count(JETS) if f"throttle_{jets + 1}" not in names)


def logged_vehicle(vehicle: Vehicle) -> LoggedVehicle:
    """Return the jets, servos and surfaces of a vehicle that its log has columns of."""
    surfaces = tuple(surface.name for surface in vehicle.surfaces)
    servos = vehicle.actuators[: len(vehicle.actuators) - len(surfaces)]
    return LoggedVehicle(len(vehicle.jets), servos, surfaces, vehicle.allocation == "effectiveness")


def servos_in(columns: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the banks and hinges that a log has columns of, in their order."""
    return _match_names(r"tilt_(.+)_command_rad", columns)


def surfaces_in(columns: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the surfaces that a log has columns of, in their order."""
    return _match_names(r"deflection_(.+)_command", columns)


def _match_names(pattern: str, columns: Iterable[str]) -> tuple[str, ...]:
    return _find_matches(pattern, tuple(columns))


@lru_cache(64)
def _find_matches(pattern: str, columns: tuple[str, ...]) -> tuple[str, ...]:
    matches = [re.fullmatch(pattern, name) for name in columns]
    return tuple([match[1] for match in matches if match])


def logged_vehicle_of(columns: Iterable[str]) -> LoggedVehicle:
    """Return jets, servos and surfaces of a logged vehicle, as far as the names of its columns tell."""
    names = tuple(columns)
    return LoggedVehicle(jets_in(names), servos_in(names), surfaces_in(names))


def custom_columns(columns: Iterable[Column]) -> list[Column]:
    """Return the columns that a flight's own blocks add to those of the vehicle."""
    columns = tuple(columns)
    names = {column.name for column in _make_columns(logged_vehicle_of(column.name for column in columns))}
    return [column for column in columns if column.name not in names]


def require(name: str, columns: Iterable[str], where: str = "log") -> str:
    """Return ``name`` if it is a column.  Raises InputError with similar names."""
    columns = tuple(columns)
    if name not in columns:
        raise InputError(f"the {where} has no column {name!r}; {nearest(name, columns)}")
    return name
