"""COMMAND_LONG and COMMAND_INT as one record, and the plans by which they are executed.

A parameter that is NaN is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import IntEnum
from math import isfinite
from typing import Any, NamedTuple

from cosim.control.autopilot.requests import Request, Result
from cosim.groundstation.mavlink.telemetry_state import TelemetryState, VehicleConstants
from cosim.groundstation.mavlink.wire.dialect import Message
from cosim.groundstation.mavlink.wire.peer import Peer


class CommandResult(IntEnum):
    """Result of a command, MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    UNSUPPORTED_FRAME = 9


MAV_RESULTS = {result: CommandResult[result.name] for result in Result}  # MAV_RESULT by result of a request

GLOBAL, LOCAL_NED, RELATIVE, GLOBAL_INT, RELATIVE_INT = 0, 1, 3, 5, 6  # MAV_FRAME
ABSOLUTE_FRAMES, RELATIVE_FRAMES = (GLOBAL, GLOBAL_INT), (RELATIVE, RELATIVE_INT)  # with z above sea; above home


class MavCommand(NamedTuple):
    """Command of COMMAND_LONG or COMMAND_INT; None for a missing parameter, latitude and longitude in degrees."""

    number: int
    params: tuple[float | None, ...]  # param1 to param7
    frame: int | None  # MAV_FRAME; None: from a COMMAND_LONG

    @property
    def position(self) -> tuple[float, float] | None:
        """Latitude and longitude [deg]; None if missing or both 0, which some stations send for none."""
        lat, lon = self.params[4], self.params[5]
        return None if lat is None or lon is None or lat == lon == 0.0 else (lat, lon)


class Plan(NamedTuple):
    """Plan to execute a command: requests in turn until one is refused, or an immediate result."""

    requests: tuple[Request, ...] = ()
    result: CommandResult = CommandResult.ACCEPTED
    text: str = ""
    messages: tuple[Message, ...] = ()  # messages sent after the acknowledgement


class Context(NamedTuple):
    """Vehicle and station for which a command is planned."""

    vehicle: VehicleConstants
    state: TelemetryState
    peer: Peer
    # Function that returns a message outside telemetry by its id, or None.
    find_message: Callable[[int], Sequence[Message] | None]
    shutdown_requests: tuple[Any, ...] = ()  # requests for a reboot and for a shutdown


def parse_command(message: Message, unset: int = 0x7FFFFFFF) -> MavCommand:
    """Return the command in a COMMAND_LONG or COMMAND_INT."""
    first = [message.param1, message.param2, message.param3, message.param4]
    if message.msgname == "COMMAND_LONG":
        values = [*first, message.param5, message.param6, message.param7]
        return MavCommand(message.command, tuple(map(_finite_or_none, values)), None)
    # In local frames x and y are in 1e-4 m; handlers of positions refuse such frames.
    position = [None if value == unset else value * 1e-7 for value in (message.x, message.y)]
    return MavCommand(
        message.command, (*map(_finite_or_none, first), *position, _finite_or_none(message.z)), message.frame
    )


def _finite_or_none(value: float) -> float | None:
    return value if isfinite(value) else None
