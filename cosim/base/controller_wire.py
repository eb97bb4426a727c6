"""What a controller outside this process is told and answers, number by number: for processes and FMUs alike.

Everything is SI and rad, body axes forward-right-down, positions NED.  A frame is ``k``, the step from 0, and behind it
the numbers in the order of the names; little-endian doubles.  ``k = 0`` begins a flight anew.  An answer that begins
with -1 says that it cannot go on, and a line of text behind it why.

A whole controller is told and gives one ``tilt_`` for each of the vehicle's actuators, by its name and in its order:
the left and the right servo, or hinges [rad] and then surfaces, in the unit of their property.  Where the vehicle flies
on a wing it is told the speed ahead, too; nobody else is, so that their frames are as they were.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

from cosim.base.constants import SERVOS
from cosim.base.signals import AXES, NO_JETS, Actuation, Command, ControlSignals, Measured, Unallocated, Vector3

WholeAnswer = tuple[Actuation, ControlSignals | None]
PROTOCOL, VERSION = "hexjet-controller", 1  # name and version of the protocol

_QUATERNION = ("attitude_w", "attitude_x", "attitude_y", "attitude_z")  # measured quaternion, body to NED
_RATES = ("roll_rate", "pitch_rate", "yaw_rate")  # measured rates, rad/s
_RATE_SETPOINTS = ("roll_rate_setpoint", "pitch_rate_setpoint", "yaw_rate_setpoint")  # rad/s
_ANGLES = ("roll_setpoint", "pitch_setpoint", "yaw_setpoint")  # attitude set-points, rad
_APPLIED_TORQUES = ("roll_applied", "pitch_applied", "yaw_applied")  # torques applied in the previous step
# Inputs of a whole controller before those of each jet; "commanded" is 1 if the numbers after it are commanded, else 0.
_CONTROLLER_INPUTS = (
    *_ANGLES, "altitude_setpoint", "rates_commanded", *_RATE_SETPOINTS, "collective_commanded", "collective_setpoint",
    *_RATES, *_QUATERNION, "position_north", "position_east", "position_down", "velocity_north", "velocity_east",
    "velocity_down", "altitude", "specific_force_x", "specific_force_y", "specific_force_z", "fuel_burnt", "engines",
)  # fmt: skip
_AHEAD_INPUTS = ("ahead_commanded", "ahead_setpoint")  # m/s along the heading, over the ground
_JET_INPUTS = ("throttle_applied", "spool_speed", "exhaust_temperature", "fuel_flow")  # inputs for each jet
# Optional outputs of a whole controller: unallocated part, jets shut off, and signals shown in the log.
OPTIONAL = ("unallocated", "off", "shown")
_LOGGED = ("rate_setpoint", "predicted", "torque")  # signals for the log, per axis
LEVEL_BY_OUTPUT = {  # controller part that an FMU replaces
    "throttle_1": "controller", "roll_torque": "rate", "roll_rate_setpoint": "attitude", "predicted_rate": "predictor",
}  # fmt: skip


def input_names(level: str, jets: int, servos: Sequence[str] = SERVOS, ahead: bool = False) -> tuple[str, ...]:
    """Return the names of the numbers sent to a controller of this ``level``; ``servos``: the actuators' names."""
    if level == "predictor":
        return ("rate", "applied")
    if level == "rate":
        return (*_RATE_SETPOINTS, *_RATES, *_APPLIED_TORQUES)
    if level == "attitude":
        return (*_ANGLES, *_QUATERNION)
    per_jet = [f"{name}_{number}" for name in _JET_INPUTS for number in range(1, jets + 1)]
    tilts = [f"{_make_tilt_name(name)}_applied" for name in servos]
    return (*_CONTROLLER_INPUTS, *per_jet, *tilts, *(_AHEAD_INPUTS if ahead else ()))


def _make_tilt_name(servo: str) -> str:
    return f"tilt_{servo}"


def output_names(level: str, jets: int, servos: Sequence[str], extras: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the names of a controller's outputs; ``servos``: names of the servos that it moves."""
    if level == "predictor":
        return ("predicted_rate",)
    if level == "rate":
        return ("roll_torque", "pitch_torque", "yaw_torque")
    if level == "attitude":
        return _RATE_SETPOINTS
    names = [f"throttle_{number}" for number in range(1, jets + 1)]
    names += [_make_tilt_name(name) for name in servos]
    if "unallocated" in extras:
        names += [f"unallocated_{name}" for name in (*AXES, "collective")]
    if "off" in extras:
        names += [f"off_{number}" for number in range(1, jets + 1)]
    if "shown" in extras:
        names += [f"shown_{name}_{axis}" for name in _LOGGED for axis in AXES] + ["shown_collective", "shown_allocated"]
    return tuple(names)


def parse_answer(values: Sequence[float], jets: int, servos: int, extras: Sequence[str]) -> WholeAnswer:
    """Return the actuation and control signals from the numbers named by :func:`output_names`."""
    throttle, end = tuple(values[:jets]), jets + servos
    tilt = tuple(values[jets:end]) or (0.0, 0.0)
    unallocated, off = Unallocated(0.0, 0.0, 0.0, 0.0), NO_JETS
    if "unallocated" in extras:
        unallocated = Unallocated(*values[end : end + 4])
        end += 4
    if "off" in extras:
        if any(values[end : end + jets]):
            off = frozenset([jet for jet, value in enumerate(values[end : end + jets]) if value])
        end += jets
    actuation = Actuation(throttle, tilt, unallocated, off)
    if "shown" not in extras:
        return actuation, None
    a, b, c, d, e, f, g, h, i, commanded, allocated = values[end : end + 11]
    return actuation, ControlSignals((a, b, c), (d, e, f), (g, h, i), commanded, allocated)


def controller_numbers(ahead: bool, command: Command, measured: Measured, applied: Any) -> tuple[float, ...]:
    """Return the inputs of a complete controller as the numbers named by :func:`input_names`."""
    rate: Vector3 = command.rate or (0.0, 0.0, 0.0)
    engines = applied.engines
    return (
        *command.attitude,
        command.altitude,
        float(command.rate is not None),
        *rate,
        float(command.collective is not None),
        command.collective or 0.0,
        *measured.rate,
        *measured.attitude,
        *measured.position,
        *measured.velocity,
        measured.altitude,
        *measured.specific_force,
        applied.burnt,
        0.0,  # jets that idle or are off get 0
        *applied.throttle,
        *engines.spool_speed,
        *engines.exhaust_temperature,
        *engines.fuel_flow,
        *applied.tilt,
        *((float(command.ahead is not None), command.ahead or 0.0) if ahead else ()),
    )


def frame_layout(count: int) -> struct.Struct:
    """Return the binary layout of a frame: the step's number, then ``count`` numbers."""
    return layout(count + 1)


def layout(count: int) -> struct.Struct:
    """Return the binary layout of ``count`` numbers of a frame."""
    return struct.Struct(f"<{count}d")


def numbers(arguments: Sequence[Any], level: str, ahead: bool = False) -> tuple[float, ...]:
    """Return the arguments of ``update`` as the numbers of a frame; ``ahead`` as for :func:`input_names`."""
    if level == "controller":
        return controller_numbers(ahead, *arguments)
    if level == "attitude":
        command, measured = arguments
        return (*command.attitude, *measured.attitude)
    if level == "rate":
        setpoint, measured, applied = arguments
        return (*setpoint, *measured, *applied)
    return (arguments[0], arguments[1])
