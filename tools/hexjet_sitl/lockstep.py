"""The lockstep between a flight and an autopilot: frames and answers, their counts, and the program that answers."""

from __future__ import annotations

import errno
import os
import re
import socket
import subprocess
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from struct import Struct
from time import monotonic
from typing import Any, ClassVar, NamedTuple

from cosim import FlightError, InputError
from cosim.base.limits import clamp
from cosim.base.runtime.host import Host
from cosim.base.signals import PerJet, Quaternion, State, Vector3
from cosim.spec.vehicle import Vehicle

LOCAL = "127.0.0.1"
_TIMEVAL = Struct("@ll")  # seconds and microseconds
# s between two checks of the program, so that its end is noticed at once.
CHECK_S = 0.25


class StickPositions(NamedTuple):
    """A pilot's transmitter: lean and turn as fractions of full stick, throttle from 0 to 1, and two switches."""

    roll: float = 0.0  # 1: full right
    pitch: float = 0.0  # 1: full forward, nose down
    yaw: float = 0.0  # 1: full nose right
    throttle: float = 0.0
    armed: bool = False
    holds_place: bool = False  # True: position hold; False: manual


# As often as a receiver sends sticks.
MAX_STICKS_INTERVAL_S = 0.02


def to_pulse(fraction: float) -> int:
    """Return a stick's pulse [us] for a fraction of full stick."""
    return round(1500.0 + 500.0 * clamp(fraction, 1.0))


class SensorFrame(NamedTuple):
    """Sensors and sticks of one instant for an autopilot; see :mod:`hexjet_sitl.instruments`."""

    time: float  # s, by the autopilot's clock
    rate: Vector3  # rad/s, body
    force: Vector3  # m/s^2, body, specific force
    attitude: Quaternion
    position: Vector3  # m, NED
    velocity: Vector3  # m/s, NED
    altitude: float  # m above the ground, by the barometer
    sticks: StickPositions
    spool: PerJet = ()  # rad/s, if the engines report it
    truth: State | None = None  # only for the autopilot's log
    silent: Collection[str] = ()  # failed sensors, held at the last value


class ActuatorOutputs(NamedTuple):
    """An autopilot's actuator commands for the step that begins at its last frame."""

    throttle: PerJet  # 0 to 1, jet 1 first
    tilt: tuple[float, float]  # rad, left and right servo
    armed: bool


@dataclass
class LockstepCounts:
    """Counts of a lockstep: with none missing, each step was answered for its own frame."""

    frames: int = 0  # frames sent
    answers: int = 0  # answers received
    repeated: int = 0  # frames sent again without a step
    foreign: int = 0  # packets of other senders, ignored
    boot: int = 0  # frames before the first answer
    longest_s: float = 0.0  # s of wall time, slowest answer

    @property
    def missing(self) -> int:
        """Answers that never came."""
        return self.frames - self.boot - self.answers


@dataclass(frozen=True)
class StartTiming:
    """Timing of an autopilot before its flight, and its full stick.

    The vehicle stands in a stand for ``before_s``.  The autopilot is armed with the throttle closed ``arming_s`` before
    the flight, and the throttle goes to that of hover ``throttle_s`` before it: early enough for all that it holds back
    after either.
    """

    before_s: float  # from its first frame to the flight
    arming_s: float
    throttle_s: float
    lean_deg: float  # lean at full stick
    turn_deg_s: float  # turn rate at full stick
    unarmed: str = ""  # message if it did not arm
    stick_moves_heading: bool = False  # True: the yaw stick turns the set-point


class FirmwareReport(NamedTuple):
    """Data from an autopilot's own log, if that is read."""

    version: str = ""  # release and revision; empty: unknown
    parameters: Mapping[str, float] = {}  # all parameters that it flew with
    messages: Sequence[tuple[float, int, str]] = ()  # s since its first frame, severity, text


# Sixteen characters, as in PX4 (PARAM_NAME_MAX of its generator) and ArduPilot (AP_MAX_NAME_SIZE). Names go into
# environments, scripts and files of other programs.
PARAMETER_NAME = re.compile(r"[A-Z][A-Z0-9_]{0,15}")


def check_words(parameters: Iterable[str], lines: Iterable[str]) -> None:
    """Raise InputError for a name that no parameter can have, and for a console's line that is more than one."""
    for name in parameters:
        if not PARAMETER_NAME.fullmatch(name):
            allowed = "a capital letter, then capital letters, digits and _, sixteen characters at most"
            raise InputError(f"parameter {name[:80]!r}: is no name of one; allowed: {allowed}")
    for line in lines:
        if not line.isprintable():
            raise InputError(f"line {line[:80]!r}: has control characters; allowed: one line of the console")


@dataclass(frozen=True)
class Setup:
    """Options of an autopilot, from ``hexjet sitl`` or a study's table [autopilot].

    Of what belongs to one autopilot the others see nothing.
    """

    instance: int = 0  # number of the instance, if several run
    limit_s: float = 5.0  # wall-clock limit of one answer
    port: int | None = None  # Betaflight: first port
    gains: str = "vehicle"  # "vehicle", a file; "stock": as shipped
    lines: Sequence[str] = ()  # Betaflight: lines for its console
    parameters: Mapping[str, float] = field(default_factory=dict)  # PX4, ArduPilot: override computed ones
    magnetic_field: Vector3 | None = None  # PX4: gauss, NED; None: the Earth's
    hold_from_s: float | None = None  # PX4, ArduPilot: from here in hold mode
    hands_off: bool = False  # a ground station arms and flies it
    defaults: Path | None = None  # ArduPilot: parameter file
    channels: Sequence[str] = ()  # ArduPilot: NUMBER=PULSE[@SECONDS]
    station: int | None = None  # ArduPilot: local UDP port for MAVLink

    def __post_init__(self) -> None:
        check_words(self.parameters, self.lines)


def describe_unknown(names: Sequence[str], existing: Collection[str], program: str) -> str:
    """Return the words that refuse names of parameters that a program does not have, with the nearest that exists."""
    closest = get_close_matches(names[0], sorted(existing), n=1)
    suggestion = f"; did you mean {closest[0]}?" if closest else ""
    return f"parameter {', '.join(names)}: this {program} has none of that name{suggestion}"


COLOUR = re.compile(r"\x1b\[[0-9;]*m")  # colour codes of a terminal
# Linux ends the program together with the thread that started it; 1 is PR_SET_PDEATHSIG of <sys/prctl.h>.
_END_WITH_PARENT = "import ctypes, os, sys; ctypes.CDLL(None).prctl(1, 9); os.execv(sys.argv[1], sys.argv[1:])"


class Program:
    """A process started for a flight, with its output in a file; ended with its descendants."""

    def __init__(self, command: Sequence[str], folder: Path, log: Path, environment: dict[str, str]) -> None:
        self.name = Path(command[0]).name
        if sys.platform == "linux":
            command = [sys.executable, "-I", "-S", "-c", _END_WITH_PARENT, *command]
        try:
            with log.open("ab") as output:
                self.process = Host(
                    command,
                    os.environ | environment,
                    cwd=folder,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                )
        except OSError as error:
            raise InputError(f"{command[0]}: cannot be started: {error.strerror or error}") from error

    @property
    def end_description(self) -> str:
        """Description of how the process ended; empty while it runs."""
        return self.describe_end(0.0)

    def describe_end(self, wait: float) -> str:
        """Return how the process ended, in words, within ``wait`` s of the clock; empty if it still runs."""
        return self.process.describe_end(wait)

    def close(self, patience: float = 0.0) -> None:
        """End the process, after asking it to if it has ``patience`` s; may be called twice."""
        if patience and self.process.poll() is None:
            self.process.terminate()
        self.process.end(patience)


def find_configured_program(binary: Path | None, variable: str) -> Path | None:
    """Return the program of ``binary``, or that this environment variable names; None if neither does.

    Raises InputError for what is no program.
    """
    if binary is not None:
        return check_program(binary, "binary")
    variable_path = os.environ.get(variable)
    return check_program(Path(variable_path), variable) if variable_path else None


def check_program(path: Path, where: str) -> Path:
    """Return the program behind links, as its files are beside it.  Raises InputError if invalid."""
    if not path.is_file():
        raise InputError(f"{where}: {path}: no such file")
    if not os.access(path, os.X_OK):
        raise InputError(f"{where}: {path}: is no program: it may not be executed")
    return path.resolve()


def listen(kind: socket.SocketKind, port: int, what: str, option: str) -> socket.socket:
    """Return a loopback socket at a port, with a time-out for datagrams.

    Raises InputError where it is taken; ``option`` states another.
    """
    sock = socket.socket(socket.AF_INET, kind)
    try:
        if kind == socket.SOCK_STREAM:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((LOCAL, port))
        if kind == socket.SOCK_STREAM:
            sock.listen(4)
    except OSError as error:
        sock.close()
        if error.errno == errno.EADDRINUSE:
            raise InputError(f"{what}: port {port} is in use; another flight or autopilot has it ({option})") from None
        raise InputError(f"{what}: port {port}: {error.strerror or error}") from error
    return set_receive_timeout(sock) if kind == socket.SOCK_DGRAM else sock


class AnswerTimer:
    """Timeout of one answer that also watches the program, and describes what is missing."""

    def __init__(self, name: str, limit: float, program: Program | None, failure: str = "did not answer") -> None:
        self._name, self._limit, self._program, self._failure = name, limit, program, failure
        self._started = monotonic()
        self._has_checked = False

    def remaining(self) -> float:
        """Return the seconds to the next check.  Raises FlightError if the autopilot ended or hangs."""
        if self._program is not None and (ended := self._program.end_description):
            raise FlightError(f"{self._name} {ended}")
        remaining = self._started + self._limit - monotonic()
        if remaining <= 0.0:
            raise FlightError(f"{self._name} {self._failure} within {self._limit:g} s")
        return min(remaining, CHECK_S)

    def receive_packet(self, sock: socket.socket) -> tuple[bytes, tuple[str, int]]:
        """Return the next packet and its sender's address.  Raises FlightError as :meth:`left`."""
        while True:
            if self._has_checked:  # most frames are answered in one wait
                self.remaining()
            self._has_checked = True
            with suppress(BlockingIOError):
                return sock.recvfrom(1024)

    @property
    def elapsed(self) -> float:
        """Seconds since the wait began."""
        return monotonic() - self._started


def set_receive_timeout(sock: socket.socket) -> socket.socket:
    """Make a socket raise BlockingIOError after :data:`CHECK_S`, and return it.

    It is one system call, where a time-out of Python's takes three.
    """
    sock.setblocking(True)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(int(CHECK_S), round(1e6 * (CHECK_S % 1.0))))
    return sock


class Autopilot:
    """An autopilot and its connection, started here or by hand (``program`` is None).

    Each has a class of its own, with :meth:`start` and :meth:`exchange`.
    """

    name: ClassVar[str]
    timing: ClassVar[StartTiming]
    port_option: ClassVar[str] = "instance"  # option that states another port
    log_pattern: ClassVar[str] = ""  # glob of its logs; empty: none are read
    patience_s = 0.0  # s for it to end when asked to

    def __init__(self, program: Path | None, folder: Path, vehicle: Vehicle, step: float, setup: Setup) -> None:
        self.counts = LockstepCounts()
        self.limit = setup.limit_s  # wall-clock limit of one answer, s
        self.setup, self.program = setup, program
        self.endpoint = ""  # where a program started by hand connects
        self.details: dict[str, Any] = {"gains": setup.gains}  # entries of the run's lockstep.json
        self.remark = ""  # on a version that was never flown
        self._folder, self._step = folder, step
        self._jets, self._range = len(vehicle.jets), vehicle.servo.range_rad if vehicle.servo else 0.0
        self._program: Program | None = None
        self._sockets: list[socket.socket] = []
        self._earlier_logs: set[tuple[int, Path]] = set()  # logs of other flights in this folder

    def start(self) -> None:
        """Start it, and wait until it accepts frames.  Raises InputError or FlightError."""
        raise NotImplementedError

    def exchange(self, frame: SensorFrame) -> ActuatorOutputs:
        """Send a frame and wait for its answer.  Raises FlightError if none comes."""
        raise NotImplementedError

    def check_parameters(self) -> str:
        """After the flight, check for given parameters that it does not have.

        Return why that cannot be done, in words; "" where it was done, now or before the flight, or no name was given.
        Raises FlightError with the names.
        """
        return ""

    def report(self) -> FirmwareReport:
        """After the flight, return data from its own log."""
        return FirmwareReport()

    def close(self) -> None:
        """End it; may be called twice."""
        if self._program is not None:
            self._program.close(self.patience_s)
        for sock in reversed(self._sockets):
            sock.close()

    def _begin(self, kind: socket.SocketKind, port: int) -> socket.socket:
        """Make its folder, and return a socket that listens at a port of this machine.  Raises InputError."""
        self._folder.mkdir(parents=True, exist_ok=True)
        self._earlier_logs = self._find_logs()
        return self._own(listen(kind, port, self.name, self.port_option))

    def _describe_start(self, error: FlightError, log: Path, title: str) -> FlightError:
        """Describe why it did not start: its last output, and whether it is the right program."""
        lines = log.read_text(errors="replace").split("\n") if log.is_file() else []
        last = next((line for line in reversed(lines) if line.strip()), "")
        printed = f"; the last that it printed: {COLOUR.sub('', last).strip()} ({log})" if last else ""
        return FlightError(f"{error}; is {self.program} {title}?{printed}" if self.program else f"{error}{printed}")

    def _find_logs(self) -> set[tuple[int, Path]]:
        """Return the logs in its folder with modification times [ns]."""
        paths = self._folder.glob(self.log_pattern) if self.log_pattern else ()
        return {(path.stat().st_mtime_ns, path) for path in paths}

    def _new_logs(self) -> list[Path]:
        """Return the logs written since its start, newest last; none if started by hand.

        One of that name may have been there before.
        """
        return [] if self._program is None else [path for _, path in sorted(self._find_logs() - self._earlier_logs)]

    def _own(self, sock: socket.socket) -> socket.socket:
        """Return a socket that is closed with the autopilot."""
        self._sockets.append(sock)
        return sock

    def _open_sender(self) -> socket.socket:
        """Return a socket for datagrams to the autopilot."""
        sock = self._own(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        sock.bind((LOCAL, 0))
        return sock

    def _count_answer(self, timer: AnswerTimer) -> None:
        self.counts.answers += 1
        self.counts.longest_s = max(self.counts.longest_s, timer.elapsed)


def discard_packets(sock: socket.socket) -> None:
    """Throw away the packets that wait."""
    sock.setblocking(False)
    with suppress(BlockingIOError):
        while True:
            sock.recv(65536)
    sock.setblocking(True)
