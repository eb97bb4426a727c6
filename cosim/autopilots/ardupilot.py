"""ArduPilot's SITL over its JSON backend: servo packets on UDP, answered with one line of JSON each.

Protocol (``libraries/SITL/examples/JSON/readme.md``, ``SIM_JSON.cpp``): the physics listens on UDP 9002, ten more for
each instance, and answers to whoever sent.  ArduPilot stands still until it is answered, and the answer's timestamp is
its time.  Without one for a second it sends the same packet again, with the same frame count: that is answered again,
and not stepped.  Sticks go to UDP 5501 before the state, as 16 pulses.
"""

from __future__ import annotations

import socket
from pathlib import Path
from struct import Struct
from time import monotonic

from cosim.autopilots.lockstep import (
    LOCAL,
    STICKS_S,
    Answer,
    Counts,
    Frame,
    Handling,
    Program,
    Sticks,
    Waiting,
    listen,
    pulse,
)
from cosim.base.errors import FlightError, InputError
from cosim.base.geodesy import Geodesy
from cosim.base.limits import clamp, clip
from cosim.spec.vehicle import Vehicle

PORT, RC_PORT, APART = 9002, 5501, 10
# Without a position of its estimator it does not arm, which 40 s are for: chosen by us.  It holds its motors for 2 s
# (ARMING_DELAY_SEC) after it was armed, and lets them go within 1 s (twice MOT_SPOOL_TIME) once throttle is raised.
# Full stick: ANGLE_MAX, and PILOT_Y_RATE as it ships.
HANDLING = Handling(before_s=40.0, arming_s=5.0, throttle_s=2.0, lean_deg=30.0, turn_deg_s=202.0)
_SERVOS = {18458: Struct("<HHI16H"), 29569: Struct("<HHI32H")}  # by their magic: frame rate, frame count, pulses [us]
_STICKS = Struct("<16H")
# One line between two ends of lines; its parser wants no blank behind a colon, and one behind a comma.
_STATE = (
    b'\n{"timestamp":%.6f,"imu":{"gyro":[%.9g, %.9g, %.9g],"accel_body":[%.9g, %.9g, %.9g]},'
    b'"position":[%.9g, %.9g, %.9g],"quaternion":[%.9g, %.9g, %.9g, %.9g],"velocity":[%.9g, %.9g, %.9g]}\n'
)
_START_S = 60.0  # until its first packet
# A packet that comes again this soon after it was answered was sent before that.  It is not answered again: ArduPilot
# would take the second answer for that to its next packet, and be a step late from there on.  It waits for a second.
_PATIENCE_S = 0.5
_LONGEST_STEP_S = 0.1  # a longer one does not move its clock


class ArduPilot:
    """One ArduPilot, started here or by somebody.  ``parameters``: a file of its defaults.  Raises InputError."""

    def __init__(
        self,
        binary: Path | None,
        folder: Path,
        vehicle: Vehicle,
        step: float,
        place: Geodesy,
        parameters: Path | None = None,
        instance: int = 0,
        limit: float = 5.0,
    ) -> None:
        if step >= _LONGEST_STEP_S:
            raise InputError(f"ardupilot: step_s = {step:g}: its clock is moved by steps below {_LONGEST_STEP_S:g} s")
        self.counts = Counts()
        self.limit = limit
        self.patience = _PATIENCE_S
        self._binary, self._folder, self._step, self._place = binary, folder, step, place
        self._parameters, self._instance = parameters, instance
        self._jets, self._range = len(vehicle.jets), vehicle.servo.range_rad if vehicle.servo else 0.0
        self._socket: socket.socket | None = None
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._program: Program | None = None
        self._peer: tuple[str, int] | None = None
        self._sticks, self._sticks_every = Sticks(), max(1, round(STICKS_S / step))
        self._count = -1  # frame count of the packet that was answered last, or is to be
        self._anew = False  # a count that begins anew was seen

    def start(self) -> None:
        """Listen, start it, and wait for its first packet.  Raises InputError or FlightError."""
        port = PORT + APART * self._instance
        self._folder.mkdir(parents=True, exist_ok=True)
        self._socket = listen(socket.SOCK_DGRAM, port, "ardupilot")
        if self._binary is not None:
            place = self._place
            home = f"{place.latitude_deg!r},{place.longitude_deg!r},{place.ground!r},0"
            command = [str(self._binary), "--model", f"JSON:{LOCAL}", "--home", home, f"-I{self._instance}", "--wipe"]
            command += ["--defaults", str(self._parameters.absolute())] if self._parameters is not None else []
            self._program = Program(command, self._folder, self._folder / "ardupilot.log", {})
        waiting = Waiting("ardupilot", _START_S, self._program, f"sent nothing to port {port}")
        rate = 0
        while self._peer is None:
            packet, sender = waiting.packet(self._socket)
            if (servos := self._servos(packet)) is None:
                raise FlightError(f"what sends to ardupilot's port is no servo packet: it said {packet[:16]!r}")
            self._peer, (_, rate, self._count, *_) = sender, servos
        if abs(rate * self._step - 1.0) > 1e-3:
            raise FlightError(
                f"ardupilot asks for {rate} frames a second, and the flight has {1.0 / self._step:g}: set SIM_RATE_HZ "
                f"to that, and SCHED_LOOP_RATE to no more, or fly with step_s = {1.0 / rate if rate else 0.0025:g}"
            )

    def exchange(self, frame: Frame) -> Answer:
        """See :class:`cosim.autopilots.lockstep.Autopilot`."""
        assert self._socket is not None
        assert self._peer is not None
        counts, opened, peer = self.counts, self._socket, self._peer
        state = self._state(frame)
        if frame.sticks != self._sticks or counts.frames % self._sticks_every == 0:
            self._sticks = frame.sticks
            self._out.sendto(_STICKS.pack(*_pulses(frame)), (LOCAL, RC_PORT + APART * self._instance))
        opened.sendto(state, peer)
        sent_at = monotonic()
        counts.frames += 1
        waiting = Waiting("ardupilot", self.limit, self._program)
        while True:
            try:
                packet, sender = waiting.packet(opened)
            except FlightError as error:
                if not self._anew:
                    raise
                raise FlightError(f"{error}; its frame count began anew: was it restarted?") from None
            servos = self._servos(packet)
            if servos is None:
                counts.foreign += 1
                continue
            count = servos[2]
            if sender != peer:  # a second one, or it was started again: it is not answered, so it stands still
                counts.foreign += 1
                self._anew = self._anew or count < self._count
                continue
            if count == self._count:
                counts.repeated += 1
                if monotonic() - sent_at > self.patience:  # it has waited for an answer since, which was lost
                    opened.sendto(state, peer)
                    sent_at = monotonic()
                continue
            if count < self._count:
                counts.repeated += 1  # a late copy, or it began anew: then it will not go on, and that is told
                self._anew = True
                continue
            if count != self._count + 1:
                raise FlightError(f"ardupilot went on from frame {self._count} to {count}: frames between were lost")
            self._count, self._anew = count, False
            counts.answers += 1
            counts.longest_s = max(counts.longest_s, waiting.took)
            return self._answer(servos[3:])

    def _servos(self, packet: bytes) -> tuple[int, ...] | None:
        if len(packet) < 2:
            return None
        form = _SERVOS.get(packet[0] | packet[1] << 8)
        return form.unpack(packet) if form is not None and form.size == len(packet) else None

    def _answer(self, pulses: tuple[int, ...]) -> Answer:
        jets = self._jets
        throttle = tuple([clip((pulse - 1000.0) / 1000.0, 0.0, 1.0) for pulse in pulses[:jets]])
        tilt = (0.0, 0.0)
        if self._range:
            left, right = (
                self._range * clamp((pulse - 1500.0) / 500.0, 1.0) if pulse else 0.0
                for pulse in pulses[jets : jets + 2]
            )
            tilt = (left, right)
        return Answer(throttle, tilt, max(throttle) > 0.0)

    def _state(self, frame: Frame) -> bytes:
        return _STATE % (
            frame.time, *frame.rate, *frame.force, *frame.position, *frame.attitude, *frame.velocity,
        )  # fmt: skip

    def close(self) -> None:
        """End it; may be called twice."""
        if self._program is not None:
            self._program.close()
        if self._socket is not None:
            self._socket.close()
        self._out.close()


def _pulses(frame: Frame) -> list[int]:
    roll, pitch, yaw, throttle, armed = frame.sticks
    sticks = [
        pulse(roll),
        pulse(-pitch),  # stick forward, a lower pulse, is nose down
        round(1000.0 + 1000.0 * clip(throttle, 0.0, 1.0)),
        pulse(yaw),
    ]
    return [*sticks, 1500, 1500, 2000 if armed else 1000, *[1500] * 9]
