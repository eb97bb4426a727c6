"""Scheduling of telemetry: rates in wall-clock time, per ground station, on one grid.

Every message counts its slots from one start, so that stations with the same rate get the same message at the
same time, which is built once; a slot that was missed is left out and not made up for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import floor, inf, sqrt

from cosim.groundstation.mavlink import engine_telemetry, telemetry
from cosim.groundstation.mavlink.telemetry_state import TelemetryState
from cosim.groundstation.mavlink.wire.dialect import BY_NAME, Message
from cosim.groundstation.mavlink.wire.peer import Peer

Build = Callable[[TelemetryState], list[Message]]


@dataclass(frozen=True)
class Stream:
    """Telemetry message: name, default rate [Hz of wall time] (0: on request only) and builder.

    ``in_turn``: one message a slot, because stations have one gauge for all of them; all on request.
    """

    name: str
    rate: float
    make_messages: Build
    in_turn: bool = False  # one message per slot, in turn

    def select(self, messages: list[Message], turn: int) -> list[Message]:
        """Return the messages for one slot; ``turn``: number of earlier slots."""
        return [messages[turn % len(messages)]] if self.in_turn and messages else messages


# Messages that are sent as telemetry. New ones come last, as time slots depend on the order.
STREAMS = (
    Stream("HEARTBEAT", 1.0, telemetry.heartbeat),
    Stream("SYS_STATUS", 2.0, telemetry.sys_status),
    Stream("SYSTEM_TIME", 1.0, telemetry.system_time),
    Stream("GPS_RAW_INT", 5.0, telemetry.gps_raw_int),
    Stream("ATTITUDE", 25.0, telemetry.attitude),
    Stream("ATTITUDE_QUATERNION", 25.0, telemetry.attitude_quaternion),
    Stream("LOCAL_POSITION_NED", 10.0, telemetry.local_position_ned),
    Stream("GLOBAL_POSITION_INT", 10.0, telemetry.global_position_int),
    Stream("SERVO_OUTPUT_RAW", 2.0, engine_telemetry.servo_output_raw),
    Stream("MISSION_CURRENT", 0.0, telemetry.mission_current),
    Stream("VFR_HUD", 5.0, telemetry.vfr_hud),
    Stream("ATTITUDE_TARGET", 5.0, telemetry.attitude_target),
    Stream("POSITION_TARGET_LOCAL_NED", 2.0, telemetry.position_target_local_ned),
    Stream("POSITION_TARGET_GLOBAL_INT", 0.0, telemetry.position_target_global_int),
    Stream("HIGHRES_IMU", 0.0, telemetry.highres_imu),
    Stream("HIL_STATE_QUATERNION", 0.0, telemetry.hil_state_quaternion),
    Stream("ALTITUDE", 2.0, telemetry.altitude),
    Stream("BATTERY_STATUS", 1.0, telemetry.battery_status),
    Stream("AUTOPILOT_VERSION", 0.0, telemetry.autopilot_version),
    Stream("GPS_GLOBAL_ORIGIN", 0.0, telemetry.gps_global_origin),
    Stream("EFI_STATUS", 2.0, engine_telemetry.efi_status, in_turn=True),
    Stream("ESTIMATOR_STATUS", 1.0, telemetry.estimator_status),
    Stream("WIND_COV", 1.0, telemetry.wind_cov),
    Stream("HOME_POSITION", 0.5, telemetry.home_position),
    Stream("ORBIT_EXECUTION_STATUS", 2.0, telemetry.orbit_execution_status),
    Stream("EXTENDED_SYS_STATE", 2.0, telemetry.extended_sys_state),
    Stream("DEBUG_VECT", 0.0, telemetry.debug_vect),
    Stream("NAMED_VALUE_FLOAT", 10.0, telemetry.named_values),
    Stream("FLIGHT_INFORMATION", 0.0, telemetry.flight_information),
    Stream("ESC_INFO", 1.0, engine_telemetry.esc_info),
    Stream("ESC_STATUS", 10.0, engine_telemetry.esc_status),
    Stream("PROTOCOL_VERSION", 0.0, telemetry.protocol_version),
    Stream("ODOMETRY", 0.0, telemetry.odometry),
    Stream("RAW_RPM", 1.0, engine_telemetry.raw_rpm),
    Stream("DEBUG_FLOAT_ARRAY", 5.0, telemetry.predictor_array),
    Stream("FUEL_STATUS", 0.1, engine_telemetry.fuel_status),
    Stream("ACTUATOR_OUTPUT_STATUS", 1.0, engine_telemetry.actuator_output_status),
    Stream("COMPONENT_INFORMATION_BASIC", 0.0, telemetry.component_information_basic),
    Stream("AVAILABLE_MODES", 0.0, telemetry.available_modes),
    Stream("CURRENT_MODE", 0.5, telemetry.current_mode),
)

MIN_INTERVAL_S = 0.004  # one control step
BY_ID: dict[int, Stream] = {BY_NAME[stream.name].id: stream for stream in STREAMS}  # streams by message id
DEFAULT_INTERVALS_S: dict[int, float] = {  # by message id; 0: on request only
    number: 1.0 / stream.rate if stream.rate else 0.0 for number, stream in BY_ID.items()
}

# Phase of each message in its interval, 0 to 1: multiples of the golden ratio spread them evenly.
_PHASES = {number: index * (sqrt(5.0) - 1.0) / 2.0 % 1.0 for index, number in enumerate(BY_ID)}


def stream_interval(peer: Peer, number: int) -> float:
    """Return the interval [s] of a message to a station; 0: on request only."""
    return peer.intervals.get(number, DEFAULT_INTERVALS_S[number])


class Streams:
    """Schedule of all telemetry messages; ``start`` [s]: time of the first slot."""

    def __init__(self, start: float) -> None:
        self._start = start
        self._next: dict[tuple[int, float], float] = {}
        self._next_due = start

    def _find_next_slot(self, now: float, number: int, every: float) -> float:
        """Return the time of a message's next slot; phases differ, so that messages do not bunch up."""
        start = self._start + _PHASES[number] * every
        return start + (floor((now - start) / every + 1e-9) + 1) * every

    @property
    def next_due(self) -> float:
        """Time at which the next message is due, as of the last :meth:`iterate_due`."""
        return self._next_due

    def iterate_due(self, now: float, peers: Sequence[Peer]) -> Iterator[tuple[Stream, list[Peer]]]:
        """Yield each due message with the stations that get it, none if it is only for the log."""
        earliest = inf
        slots = self._next
        next_slots: dict[tuple[int, float], float] = {}
        for number, stream in BY_ID.items():
            default = DEFAULT_INTERVALS_S[number]
            stations_by_interval: dict[float, list[Peer]] = {default: []} if default else {}
            for peer in peers:
                every = stream_interval(peer, number)
                if every:
                    stations_by_interval.setdefault(every, []).append(peer)
            receivers: list[Peer] = []
            any_due = False
            for every, stations in stations_by_interval.items():
                at = slots.get((number, every), self._start)
                if now >= at:
                    any_due = True
                    receivers += stations
                    at = self._find_next_slot(now, number, every)
                next_slots[number, every] = at
                earliest = min(earliest, at)
            if any_due:
                yield stream, receivers
        self._next = next_slots
        self._next_due = earliest
