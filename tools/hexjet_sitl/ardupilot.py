"""ArduPilot's SITL over its JSON backend: servo packets on UDP, answered with one line of JSON each.

Protocol (``libraries/SITL/examples/JSON/readme.md``, ``SIM_JSON.cpp``): the physics listens on UDP 9002, ten more for
each instance, and answers to whoever sent.  ArduPilot stands still until it is answered, and the answer's timestamp is
its time.  Without one for a second it sends the same packet again, with the same frame count: that is answered again,
and not stepped.  Sticks go to UDP 5501 before the state, as 16 pulses.

Its serial ports are switched off when it is started here: by itself it waits for a ground station on the first, and
listens on TCP on every network interface.  Where it listens for the sticks is every interface too (``SITL_State.cpp``),
and no option changes that.
"""

from __future__ import annotations

import re
import socket
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from math import cos, radians
from pathlib import Path
from struct import Struct
from time import monotonic
from typing import NamedTuple

from cosim import FlightError, InputError
from cosim.base.geodesy import Geodesy
from cosim.base.limits import clamp, clip
from cosim.spec.vehicle import Vehicle
from hexjet_identify.logs.dataflash import read_notes
from hexjet_sitl.lockstep import (
    LOCAL,
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
    listen,
    to_pulse,
)

PORT, RC_PORT, PORT_SPACING = 9002, 5501, 10  # first ports; ports per instance
# ArduPilot's estimator has no position before it accepts GNSS, some 44 s after its start: 60 s chosen by us. Its motors
# stand still for 2 s (ARMING_DELAY_SEC) after arming and follow the throttle within 1 s (twice MOT_SPOOL_TIME) after it
# is raised. Full stick: ATC_ANGLE_MAX and PILOT_Y_RATE as shipped.
START_TIMING = StartTiming(
    before_s=60.0, arming_s=5.0, throttle_s=2.0, lean_deg=30.0, turn_deg_s=202.0, stick_moves_heading=True
)
_SERIALS = (0, 1, 2, 5, 6, 7, 8)  # serial ports; 3 and 4 are for GNSS
# Transmitter channel that is high while the vehicle's GNSS fails: RC16_OPTION 65, with which ArduPilot has no fix.
GNSS_CHANNEL = 16
MAX_CHANNELS, STICK_CHANNELS = 16, (1, 2, 3, 4, 5, 7, GNSS_CHANNEL)  # channel 5 selects the mode, 7 arms
_SERVO_PACKETS = {18458: Struct("<HHI16H"), 29569: Struct("<HHI32H")}  # by first field: rate, count, pulses
_STICK_PACKET = Struct("<16H")  # sixteen pulses [us]
# JSON of one state between two line ends; ArduPilot's parser needs a blank after a comma, and none after a colon.
_STATE_LINE = (
    b'\n{"timestamp":%.6f,"imu":{"gyro":[%.9g, %.9g, %.9g],"accel_body":[%.9g, %.9g, %.9g]},'
    b'"position":[%.9g, %.9g, %.9g],"quaternion":[%.9g, %.9g, %.9g, %.9g],"velocity":[%.9g, %.9g, %.9g]}\n'
)


Release = tuple[int, int]
NEWEST_RELEASE: Release = (4, 8)  # assumed if the release is unknown
FLOWN_RELEASES: tuple[Release, ...] = ((4, 6), (4, 8))  # dev of October 2024 and April 2026
_RELEASE_TEXT = re.compile(rb"ArduCopter V(\d{1,2})\.(\d{1,2})\.\d{1,2}[-\w]{0,12}")  # release in the program


def read_release(program: Path | None) -> tuple[Release, str]:
    """Return the release of ArduCopter that a program's texts state, and a remark on one that was not flown.

    The newest release is returned for a program that states none, or that is started by hand.
    """
    if program is None:
        return NEWEST_RELEASE, ""
    named = f"parameters are named as of {NEWEST_RELEASE[0]}.{NEWEST_RELEASE[1]}"
    title = _RELEASE_TEXT.search(program.read_bytes())
    if title is None:
        return NEWEST_RELEASE, f"{program}: states no version of ArduCopter: its {named}"
    release = int(title[1]), int(title[2])
    flown = " and ".join(f"{major}.{minor}" for major, minor in FLOWN_RELEASES)
    return release, "" if release in FLOWN_RELEASES else f"{title[0].decode()} was not flown here; {flown} were"


class TransmitterChannel(NamedTuple):
    """Transmitter channel without a stick, such as a switch, and its pulse."""

    number: int
    pulse: int  # us
    since_s: float | None = None  # s of flight, low before; None: always


def parse_channel(text: str, where: str) -> TransmitterChannel:
    """Return the channel that ``NUMBER=PULSE`` or ``NUMBER=PULSE@SECONDS`` states.  Raises InputError."""
    match = re.fullmatch(r"(\d{1,2})=(\d{3,4})(?:@(\d+(?:\.\d+)?))?", text.strip())
    if match:
        number, delay = int(match[1]), None if match[3] is None else float(match[3])
        if number in range(1, MAX_CHANNELS + 1) and number not in STICK_CHANNELS and 800 <= int(match[2]) <= 2200:
            return TransmitterChannel(number, int(match[2]), delay)
    free = [number for number in range(1, MAX_CHANNELS + 1) if number not in STICK_CHANNELS]
    raise InputError(
        f"{where} {text}: must be a channel, its pulse of 800 to 2200 us and perhaps the second of the flight from "
        f"which on, such as 8=2000 or 8=2000@2.5; allowed channels: {', '.join(map(str, free))}"
    )


class ArduPilot(Autopilot):
    """ArduPilot SITL in lockstep, started with ``setup.defaults``.  Raises InputError for an unsuitable step."""

    name = "ardupilot"
    timing = START_TIMING
    log_pattern = "logs/*.BIN"

    def __init__(
        self, program: Path | None, folder: Path, vehicle: Vehicle, step: float, place: Geodesy, setup: Setup
    ) -> None:
        if step >= 0.1:
            raise InputError(f"ardupilot: step_s = {step:g}: its clock is moved by steps below 0.1 s")
        super().__init__(program, folder, vehicle, step, setup)
        # A packet repeated this soon after its answer was sent before that answer. It is not answered again, because
        # ArduPilot would take a second answer for that to its next packet and be a step late from then on.
        self.repeat_delay = 0.5
        self._place = place
        self._port = PORT + PORT_SPACING * setup.instance
        self.endpoint = f"UDP port {self._port}"
        self.details |= {
            "hold_from_s": setup.hold_from_s,
            "defaults": str(setup.defaults),
            "parameters": setup.parameters,
            "channels": list(setup.channels),
        }
        channels = [parse_channel(text, "channels") for text in setup.channels]
        self._transmitter = Transmitter(setup.parameters, channels, step)
        self._socket: socket.socket | None = None
        self._out = self._open_sender()
        self._peer: tuple[str, int] | None = None
        self._pulses: list[int] = []
        self._sticks_every = max(1, round(MAX_STICKS_INTERVAL_S / step))
        self._count = -1  # number of the last servo packet

    @property
    def sticks_port(self) -> int:
        """UDP port at which ArduPilot receives the sticks."""
        return RC_PORT + PORT_SPACING * self.setup.instance

    def start(self) -> None:
        """Listen, start the program, and wait for its first servo packet.  Raises InputError or FlightError."""
        self._socket = self._open_listener(socket.SOCK_DGRAM, self._port)
        log = self._folder / "ardupilot.log"
        if self.program is not None:
            # ArduPilot does not report that its port for sticks is taken.
            listen(socket.SOCK_DGRAM, self.sticks_port, self.name, self.port_option).close()
            self._program = Program(self._make_command(), self._folder, log, {})
        timer = AnswerTimer(self.name, 60.0, self._program, f"sent nothing to port {self._port}")
        while self._peer is None:
            try:
                packet, sender = timer.receive_packet(self._socket)
            except FlightError as error:
                raise self._describe_start(error, log, "ArduCopter's SITL") from None
            if (servos := self._unpack_servos(packet)) is None:
                raise FlightError(f"what sends to ardupilot's port is no servo packet: it said {packet[:16]!r}")
            self._peer, self._count = sender, servos[2]

    def _make_command(self) -> list[str]:
        """Return the command line that starts ArduPilot."""
        place, launch = self._place, self.setup
        home = f"{place.latitude_deg!r},{place.longitude_deg!r},{place.ground!r},0"
        command = [str(self.program), "--model", f"JSON:{LOCAL}", "--home", home, f"-I{launch.instance}", "--wipe"]
        command += ["--speedup", "100"]  # the lockstep sets the pace
        for serial in _SERIALS:
            has_station = serial == 0 and launch.station is not None
            command += [f"--serial{serial}", f"udpclient:{LOCAL}:{launch.station}" if has_station else "none:"]
        return command + (["--defaults", str(launch.defaults.absolute())] if launch.defaults is not None else [])

    def _check_rate(self, rate: int, settled: int = 2400) -> None:
        """Raise FlightError if ArduPilot's frame rate differs from the flight's when ``settled`` frames were exchanged.

        It starts at 1200 Hz and approaches SIM_RATE_HZ by about one per frame.
        """
        if self.counts.frames == settled and abs(rate * self._step - 1.0) > 0.01:
            raise FlightError(
                f"ardupilot asks for {rate} frames a second, and the flight has {1.0 / self._step:g}: set SIM_RATE_HZ "
                f"to that, and SCHED_LOOP_RATE to no more, or fly with step_s = {1.0 / rate if rate else 0.0025:g}"
            )

    def exchange(self, frame: SensorFrame) -> ActuatorOutputs:
        """Send a frame with the sticks, and return ArduPilot's answer to it."""
        assert self._socket is not None
        assert self._peer is not None
        counts, sock, peer = self.counts, self._socket, self._peer
        state = self._format_state(frame)
        pulses = self._transmitter.compute_pulses(frame)
        if pulses != self._pulses or counts.frames % self._sticks_every == 0:
            self._pulses = pulses
            self._out.sendto(_STICK_PACKET.pack(*pulses), (LOCAL, self.sticks_port))
        sock.sendto(state, peer)
        sent_at = monotonic()
        counts.frames += 1
        timer = AnswerTimer(self.name, self.limit, self._program)
        while True:
            packet, sender = timer.receive_packet(sock)
            servos = self._unpack_servos(packet)
            if servos is None:
                counts.foreign += 1
                continue
            count = servos[2]
            if sender != peer:  # from another or a restarted program
                counts.foreign += 1
                continue
            if count == self._count:
                counts.repeated += 1
                if monotonic() - sent_at > self.repeat_delay:  # the answer was lost
                    sock.sendto(state, peer)
                    sent_at = monotonic()
                continue
            if count < self._count:
                counts.repeated += 1  # an old packet, late
                continue
            if count != self._count + 1:
                raise FlightError(f"ardupilot went on from frame {self._count} to {count}: frames between were lost")
            self._count = count
            self._count_answer(timer)
            self._check_rate(servos[1])
            return self._convert_pulses(servos[3:])

    def _unpack_servos(self, packet: bytes) -> tuple[int, ...] | None:
        if len(packet) < 2:
            return None
        form = _SERVO_PACKETS.get(packet[0] | packet[1] << 8)
        return form.unpack(packet) if form is not None and form.size == len(packet) else None

    def _convert_pulses(self, pulses: tuple[int, ...]) -> ActuatorOutputs:
        jets = self._jets
        throttle = tuple([clip((pulse - 1000.0) / 1000.0, 0.0, 1.0) for pulse in pulses[:jets]])
        tilt = (0.0, 0.0)
        if self._range:
            left, right = (
                self._range * clamp((pulse - 1500.0) / 500.0, 1.0) if pulse else 0.0
                for pulse in pulses[jets : jets + 2]
            )
            tilt = (left, right)
        return ActuatorOutputs(throttle, tilt, max(throttle) > 0.0)

    def _format_state(self, frame: SensorFrame) -> bytes:
        """Return a frame as a JSON line; ArduPilot's simulation makes the barometer from its height."""
        return _STATE_LINE % (
            frame.time, *frame.rate, *frame.force, *frame.position[:2], -frame.altitude, *frame.attitude,
            *frame.velocity,
        )  # fmt: skip

    def check_parameters(self) -> str:
        """Raise FlightError for given parameters that ArduCopter's log does not list; see :class:`Autopilot`.

        ArduPilot accepts unknown names silently; but when it is armed it begins a log that lists all its parameters.
        Those of a group that is switched off are not listed: they would do nothing either.
        """
        if self._program is None or self.setup.defaults is None or self.counts.answers == 0:
            return ""
        folder = self._folder / "logs"
        known_names = next(
            (known for path in self._new_logs() if (known := read_notes(path).parameters) is not None), None
        )
        if known_names is None:
            return f"the names of its parameters were not checked: no log in {folder} has all of them"
        if unknown := [name for name in self.setup.parameters if name not in known_names]:
            text = describe_unknown(unknown, known_names, "ArduCopter")
            raise FlightError(f"ardupilot: {text} (parameters, defaults; {folder})")
        return ""

    def report(self) -> FirmwareReport:
        """Return version, parameters and messages from ArduPilot's newest log of this flight.

        ArduPilot logs no severities: all messages are informational.
        """
        logs = self._new_logs()
        if not logs:
            return FirmwareReport()
        notes = read_notes(logs[-1])
        return FirmwareReport(notes.version, notes.parameters or {}, [(at, 6, text) for at, text in notes.messages])


class Transmitter:
    """Sticks and switches as pulses [us], for ArduCopter in Stabilize with these parameters.

    ArduCopter's throttle stick is no throttle: its conversions are inverted here, so that the mean throttle of the
    engines is what the sticks state.  The stick is bent so that its middle is MOT_THST_HOVER, enlarged for the
    commanded lean (ATC_ANGLE_BOOST), and put between MOT_SPIN_MIN and MOT_SPIN_MAX
    (``Mode::get_pilot_desired_throttle``, ``AC_AttitudeControl_Multi::get_throttle_boosted``,
    ``AP_Motors_Thrust_Linearization``).
    """

    def __init__(self, parameters: Mapping[str, float], channels: Sequence[TransmitterChannel], step: float) -> None:
        self._least, most = parameters.get("MOT_SPIN_MIN", 0.15), parameters.get("MOT_SPIN_MAX", 0.95)
        self._span = max(most - self._least, 0.01)
        self._is_boosted = parameters.get("ATC_ANGLE_BOOST", 1.0) != 0.0
        expo = clip((0.5 - parameters.get("MOT_THST_HOVER", 0.35)) / 0.375, -0.5, 1.0)
        self._curve = [(1.0 - expo) * stick + expo * stick**3 for stick in (k / 1000.0 for k in range(1001))]
        self._channels, self._half_step = channels, 0.5 * step

    def compute_pulses(self, frame: SensorFrame) -> list[int]:
        """Return the pulses [us] of the sixteen channels for a frame."""
        sticks = frame.sticks
        pulses = [
            to_pulse(sticks.roll),
            to_pulse(-sticks.pitch),  # stick forward is nose down
            self._throttle_pulse(sticks),
            to_pulse(sticks.yaw),
        ]
        mode = 2000 if sticks.holds_place else 1500  # FLTMODE6 or FLTMODE4
        pulses += [mode, 1500, 2000 if sticks.armed else 1000, *[1500] * 9]
        for channel in self._channels:
            begins = 0.0 if channel.since_s is None else ArduPilot.timing.before_s + channel.since_s
            pulses[channel.number - 1] = channel.pulse if frame.time > begins - self._half_step else 1000
        pulses[GNSS_CHANNEL - 1] = 2000 if "gnss" in frame.silent else 1000
        return pulses

    def _throttle_pulse(self, sticks: StickPositions) -> int:
        if sticks.throttle <= 0.0:
            return 1000
        if sticks.holds_place:  # climb rate in proportion to the command
            return round(1000.0 + 1000.0 * clip(sticks.throttle, 0.0, 1.0))
        fraction = clip((sticks.throttle - self._least) / self._span, 0.0, 1.0)
        if self._is_boosted:
            full = radians(START_TIMING.lean_deg)
            fraction *= cos(full * clamp(sticks.roll, 1.0)) * cos(full * clamp(sticks.pitch, 1.0))
        nearest = bisect_left(self._curve, fraction)
        if nearest > 0 and fraction - self._curve[nearest - 1] <= self._curve[nearest] - fraction:
            nearest -= 1
        return 1000 + max(nearest, 1)  # 1000 is closed: motors stop
