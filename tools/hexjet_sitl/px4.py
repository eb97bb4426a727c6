"""PX4's SITL over its simulator link: MAVLink on TCP, sensors one way, actuators the other, matched by their time.

Protocol (PX4 ``docs/en/simulation``, ``SimulatorMavlink.cpp``): the simulator is the server, port 4560 and one more
for each instance.  HIL_SENSOR with id 0 is PX4's clock; one HIL_ACTUATOR_CONTROLS comes back for each, with its time.
Until the first of these PX4 starts up, and frames are sent without waiting for answers.
"""

from __future__ import annotations

import os
import re
import select
import socket
from collections.abc import Collection, Mapping
from contextlib import suppress
from math import asinh, atan2, degrees, hypot, pi, sinh, sqrt
from pathlib import Path

from cosim import FlightError, InputError
from cosim.base.constants import GRAVITY
from cosim.base.geodesy import Geodesy
from cosim.base.limits import clamp, clip
from cosim.base.signals import Vector3
from cosim.spec.vehicle import Vehicle
from cosim.vehicle.atmosphere import standard_air
from hexjet_identify.logs.ulog import read_notes
from hexjet_sitl import hil
from hexjet_sitl.instruments import compute_earth_field, to_body_field
from hexjet_sitl.lockstep import (
    COLOUR_CODE,
    MAX_STICKS_INTERVAL_S,
    ActuatorOutputs,
    AnswerTimer,
    Autopilot,
    FirmwareReport,
    Program,
    SensorFrame,
    Setup,
    StartTiming,
    StickPositions,
    describe_unknown,
    set_receive_timeout,
    to_pulse,
)

PORT = 4560  # port of PX4's simulator interface
# EKF2 needs some 10 s of GNSS, and arming checks 10 s of health: 30 s chosen by us. After arming PX4 holds the throttle
# at idle for 1 s (COM_SPOOLUP_TIME) and then raises it by half of its range per second: 3 s to full throttle. Full
# stick: MPC_MAN_TILT_MAX and MPC_MAN_Y_MAX as shipped.
START_TIMING = StartTiming(
    before_s=30.0,
    arming_s=4.0,
    throttle_s=0.5,
    lean_deg=35.0,
    turn_deg_s=150.0,
    unarmed="; one that you start needs the parameters of hexjet sitl params px4, and says why in its log",
)
_IMU_FIELDS, _MAG_FIELDS, _BARO_FIELDS = 7 | 56, 448, 6656  # bits of fields_updated
_MAG_INTERVAL_S, _BARO_INTERVAL_S = 0.008, 0.02  # s between measurements
_MAX_START_S = 60.0  # s until PX4 connects on a busy machine
_UNKNOWN_PARAMETER = re.compile(r"ERROR\s+\[param\] Parameter (\w+) not found")
_SINCE_1_17 = "MAN_DEADZONE"  # missing in older releases
_RELEASE_KINDS = {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc"}  # by last byte of ver_sw_release


def invert_yaw_curve(turn: float) -> float:
    """Return the yaw stick for a fraction of PX4's full yaw rate, inverting ``0.4 x + 0.6 x^3``."""
    # This is the only real root of x^3 + p x = q with p > 0.
    p, q = 0.4 / 0.6, clamp(turn, 1.0) / 0.6
    return 2.0 * sqrt(p / 3.0) * sinh(asinh(1.5 * q / p * sqrt(3.0 / p)) / 3.0)


def check_unknown_parameters(log: Path, parameters: Collection[str], optional: Collection[str] = ()) -> None:
    """Raise InputError for parameters that PX4 reports as unknown in its log, unless they are ``optional``.

    Only ``parameters`` count: PX4's own scripts ask for others, of modules that it was built without.
    """
    printed = dict.fromkeys(_UNKNOWN_PARAMETER.findall(log.read_text(errors="replace")))
    unknown = [name for name in printed if name in parameters and name not in optional]
    if unknown:
        words = describe_unknown(unknown, set(parameters) - set(unknown), "PX4")
        raise InputError(f"px4: {words} (parameters; {log}); the first PX4 that is flown is 1.17")


def describe_version(facts: Mapping[str, str | int]) -> str:
    """Return release and revision from the facts of a ULog, such as ``1.17.0 (3fa4bc0a)``."""
    release, revision = facts.get("ver_sw_release"), facts.get("ver_sw")
    words = []
    if isinstance(release, int):
        kind = _RELEASE_KINDS.get(release & 0xFF, "")
        words.append(f"{release >> 24}.{release >> 16 & 0xFF}.{release >> 8 & 0xFF}{kind}")
    if isinstance(revision, str):
        words.append(f"({revision[:8]})" if words else revision[:8])
    return " ".join(words)


class Px4(Autopilot):
    """PX4 SITL in lockstep; all its parameters, except ``optional`` ones, must exist."""

    name = "px4"
    timing = START_TIMING
    log_pattern = "log/**/*.ulg"
    patience_s = 1.0  # s in which PX4 flushes its buffers

    def __init__(
        self,
        program: Path | None,
        folder: Path,
        vehicle: Vehicle,
        step: float,
        place: Geodesy,
        setup: Setup,
        optional: Collection[str] = (),
    ) -> None:
        super().__init__(program, folder, vehicle, step, setup)
        self.field = setup.magnetic_field or compute_earth_field(place.latitude_deg, place.longitude_deg)
        self._place, self.optional = place, optional
        self.endpoint = f"TCP port {PORT + setup.instance}"
        self.details |= {"hold_from_s": setup.hold_from_s, "parameters": setup.parameters}
        self._fix_every = vehicle.sensors.gnss.period_samples
        self._accuracy = max(1, round(100.0 * max(vehicle.sensors.gnss.position_noise_m, 0.3)))  # GNSS accuracy in cm
        self._mag_every = max(1, round(_MAG_INTERVAL_S / step))
        self._baro_every = max(1, round(_BARO_INTERVAL_S / step))
        self._last_sticks, self._sticks_every = StickPositions(), max(1, round(MAX_STICKS_INTERVAL_S / step))
        self._writer, self._reader = hil.FrameWriter(), hil.FrameReader()
        self._link: socket.socket | None = None

    def start(self) -> None:
        """Listen, start the program, and wait for its connection.  Raises InputError or FlightError."""
        instance, parameters = self.setup.instance, self.setup.parameters
        port = PORT + instance
        log = self._folder / "px4.log"
        server = self._open_listener(socket.SOCK_STREAM, port)
        if self.program is not None:
            environment = {"PX4_SYS_AUTOSTART": "10016", "PX4_SIM_MODEL": "none_iris", "HEADLESS": "1"}
            # Nine digits distinguish all numbers in single precision.
            environment |= {f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in parameters.items()}
            startup = str(self.program.resolve().parent.parent / "etc")
            # The path is absolute, because PX4 is started in that folder.
            folder = str(self._folder.absolute())
            # A PX4 too old to read the environment's parameters runs this file, and reports this parameter as unknown.
            (self._folder / "px4-rc.params").write_text(f"param set {_SINCE_1_17} 0\n")
            environment["PATH"] = f"{os.environ.get('PATH', os.defpath)}{os.pathsep}{folder}"
            command = [str(self.program), "-d", "-i", str(instance), "-w", folder, startup]
            self._program = Program(command, self._folder, log, environment)
        timer = AnswerTimer(self.name, _MAX_START_S, self._program, f"did not connect to port {port}")
        while self._link is None:
            try:
                server.settimeout(timer.remaining())
            except FlightError as error:
                raise self._describe_start(error, log, "PX4's SITL") from None
            with suppress(TimeoutError):
                self._link = self._close_with_autopilot(server.accept()[0])
        if self._program is not None:
            check_unknown_parameters(log, parameters, self.optional)  # PX4 has set its parameters by now
        set_receive_timeout(self._link).setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def exchange(self, frame: SensorFrame) -> ActuatorOutputs:
        """Send a frame's messages, and return PX4's answer to it."""
        assert self._link is not None
        counts = self.counts
        now = round(1e6 * frame.time) + 1  # 0 would mean no time
        self._send_bytes(self._make_messages(frame, now))
        counts.frames += 1
        booting = counts.answers == 0
        timer = AnswerTimer(self.name, 0.02 if booting else self.limit, self._program)
        has_waited = booting  # most answers are there at once
        while True:
            try:
                left = timer.remaining() if has_waited else 0.0
            except FlightError:
                if not booting or self._end_description:
                    raise
                counts.boot += 1
                return ActuatorOutputs((0.0,) * self._jets, (0.0, 0.0), False)
            has_waited, answer = True, None
            for values in self._receive_controls(left if booting else None):
                if values[0] > now:
                    raise FlightError(f"px4 answered for {values[0] / 1e6:.3f} s, asked for {now / 1e6:.3f} s")
                if values[0] < now or answer is not None:
                    counts.repeated += 1  # an old answer, or a repeated one
                else:
                    answer = self._convert_answer(values)
            if answer is not None:
                self._count_answer(timer)
                return answer

    def report(self) -> FirmwareReport:
        """Return version, parameters and messages from PX4's newest ULog of this flight."""
        logs = self._new_logs()
        if not logs:
            return FirmwareReport()
        notes = read_notes(logs[-1])
        messages = [(time_s, severity, COLOUR_CODE.sub("", text).strip()) for time_s, severity, text in notes.messages]
        return FirmwareReport(describe_version(notes.facts), notes.parameters, messages)

    @property
    def _end_description(self) -> str:
        return "" if self._program is None else self._program.end_description

    def _make_closed_error(self) -> FlightError:
        ended = "" if self._program is None else self._program.describe_end(0.5)  # sockets close first
        return FlightError(f"px4 closed its connection and {ended}" if ended else "px4 closed its connection")

    def _convert_answer(self, values: tuple[float, ...]) -> ActuatorOutputs:
        controls, armed = values[2:18], bool(int(values[18]) & 128)  # armed flag in the mode field
        throttle = tuple([clip(value, 0.0, 1.0) for value in controls[: self._jets]])
        if not self._range:
            return ActuatorOutputs(throttle, (0.0, 0.0), armed)
        left, right = (self._range * clamp(value, 1.0) for value in controls[self._jets : self._jets + 2])
        return ActuatorOutputs(throttle, (left, right), armed)

    def _receive_controls(self, left: float | None) -> list[tuple[float, ...]]:
        """Return the HIL_ACTUATOR_CONTROLS received within ``left`` [s] (None: the socket's time-out).

        Raises FlightError for a closed connection.
        """
        link = self._link
        assert link is not None
        if left is not None and not select.select([link], [], [], left)[0]:
            return []
        try:
            data = link.recv(65536)
        except BlockingIOError:
            return []
        except ConnectionError:
            data = b""
        if not data:
            raise self._make_closed_error()
        return [values for kind, values in self._reader.feed(data) if kind is hil.HIL_ACTUATOR_CONTROLS]

    def _send_bytes(self, data: bytes) -> None:
        assert self._link is not None
        try:
            self._link.sendall(data)
        except OSError:
            raise self._make_closed_error() from None

    def _make_messages(self, frame: SensorFrame, now: int) -> bytes:
        """Return the messages of one step; HIL_SENSOR is the last, because it advances PX4's clock."""
        k = self.counts.frames
        parts = []
        if frame.sticks != self._last_sticks or k % self._sticks_every == 0:
            self._last_sticks = frame.sticks
            parts.append(self._make_stick_message(frame))
        if k % self._fix_every == 0 and "gnss" not in frame.silent:
            parts.append(self._make_gnss_message(frame, now))
        for index, spool in enumerate(frame.spool if k % self._baro_every == 0 else ()):
            if spool == spool:
                parts.append(self._writer.pack_frame(hil.RAW_RPM, 60.0 * spool / (2.0 * pi), index))
        if frame.truth is not None and k % self._mag_every == 0:
            parts.append(self._make_truth_message(frame, now))
        fields = _IMU_FIELDS
        magnetic: Vector3 = (0.0, 0.0, 0.0)
        pressure = temperature = 0.0
        if k % self._mag_every == 0:
            fields |= _MAG_FIELDS
            magnetic = to_body_field(self.field, frame.attitude)
        if k % self._baro_every == 0 and "barometer" not in frame.silent:
            fields |= _BARO_FIELDS
            pascal, kelvin = standard_air(self._place.ground + frame.altitude)
            pressure, temperature = 0.01 * pascal, kelvin - 273.15
        parts.append(
            self._writer.pack_frame(
                hil.HIL_SENSOR,
                now,
                *frame.force,
                *frame.rate,
                *magnetic,
                pressure,
                0.0,
                self._place.ground + frame.altitude,
                temperature,
                fields,
                0,
            )
        )
        return b"".join(parts)

    def _make_stick_message(self, frame: SensorFrame) -> bytes:
        roll, pitch, yaw, throttle, armed, holds_place = frame.sticks
        pulses = [
            to_pulse(roll),
            to_pulse(pitch),  # PX4: a higher pulse is forward
            round(1000.0 + 1000.0 * clip(throttle, 0.0, 1.0)),
            to_pulse(invert_yaw_curve(yaw)),
            2000 if armed else 1000,
            2000 if holds_place else 1500,
        ]
        channels = [*pulses, *[1500] * 2, *[0xFFFF] * 10]
        return self._writer.pack_frame(hil.RC_CHANNELS, round(1e3 * frame.time), *channels, 8, 255)

    def _make_gnss_message(self, frame: SensorFrame, now: int) -> bytes:
        north, east, down = frame.position
        latitude, longitude, height = self._place.to_geodetic(north, east, -down)
        vn, ve, vd = frame.velocity
        course = degrees(atan2(ve, vn)) % 360.0
        return self._writer.pack_frame(
            hil.HIL_GPS, now, round(1e7 * latitude), round(1e7 * longitude), round(1e3 * height), self._accuracy,
            self._accuracy, round(1e2 * hypot(vn, ve)), round(1e2 * vn), round(1e2 * ve), round(1e2 * vd),
            round(1e2 * course) % 36000, 3, 14, 0, 0,
        )  # fmt: skip

    def _make_truth_message(self, frame: SensorFrame, now: int) -> bytes:
        assert frame.truth is not None
        state = frame.truth
        latitude, longitude, height = self._place.to_geodetic(state.position[0], state.position[1], state.altitude)
        cm = [round(clamp(1e2 * value, 32767.0)) for value in state.velocity]
        air_speed = round(min(1e2 * hypot(*(v - w for v, w in zip(state.velocity, state.wind, strict=True))), 65535.0))
        mg = [round(clamp(1e3 * value / GRAVITY, 32767.0)) for value in state.specific_force]
        return self._writer.pack_frame(
            hil.HIL_STATE_QUATERNION, now, *state.attitude, *state.rate, round(1e7 * latitude), round(1e7 * longitude),
            round(1e3 * height), *cm, air_speed, air_speed, *mg,
        )  # fmt: skip
