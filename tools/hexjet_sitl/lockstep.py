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

LOCAL = "127.0.0.1"  # address of this machine
_TIMEVAL = Struct("@ll")  # C's struct: seconds, microseconds
# Seconds between two checks of an autopilot's process, so that its end is noticed soon.
CHECK_S = 0.25


class StickPositions(NamedTuple):
    """Positions of a transmitter's sticks, as fractions of full stick, throttle from 0 to 1, and its two switches."""

    roll: float = 0.0  # 1: full right
    pitch: float = 0.0  # 1: full forward, nose down
    yaw: float = 0.0  # 1: full nose right
    throttle: float = 0.0
    armed: bool = False
    holds_place: bool = False  # True: position hold; False: manual


# Longest time [s] between two stick packets: a receiver sends them as often.
MAX_STICKS_INTERVAL_S = 0.02


def to_pulse(fraction: float) -> int:
    """Return a stick's pulse [us] for a fraction of full stick."""
    return round(1500.0 + 500.0 * clamp(fraction, 1.0))


class SensorFrame(NamedTuple):
    """Measurements and sticks of one instant, as they are sent to an autopilot."""

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
    """Counts of frames and answers; with none missing, each step was answered for its own frame."""

    frames: int = 0  # frames sent
    answers: int = 0  # answers received
    repeated: int = 0  # frames sent again without a step
    foreign: int = 0  # packets of other senders, ignored
    boot: int = 0  # frames before the first answer
    longest_s: float = 0.0  # s of wall time, slowest answer

    @property
    def missing(self) -> int:
        """Number of answers that never came."""
        return self.frames - self.boot - self.answers


@dataclass(frozen=True)
class StartTiming:
    """Times at which an autopilot is armed and given throttle before its flight, and what full stick commands.

    The vehicle stands in a stand for ``before_s``.  The autopilot is armed with the throttle closed ``arming_s`` before
    the flight, and the throttle goes to that of hover ``throttle_s`` before it: early enough for its delays after
    either.
    """

    before_s: float  # s, from first frame to flight
    arming_s: float  # s before the flight
    throttle_s: float  # s before the flight
    lean_deg: float  # lean at full stick
    turn_deg_s: float  # turn rate at full stick
    unarmed: str = ""  # added to the error if it did not arm
    stick_moves_heading: bool = False  # True: the yaw stick turns the set-point


class FirmwareReport(NamedTuple):
    """Data from an autopilot's own log; empty if no log is read."""

    version: str = ""  # release and revision; empty: unknown
    parameters: Mapping[str, float] = {}  # all parameters that it flew with
    messages: Sequence[tuple[float, int, str]] = ()  # s since its first frame, severity, text


# At most sixteen characters, as in PX4 (PARAM_NAME_MAX of its generator) and ArduPilot (AP_MAX_NAME_SIZE). The rest is
# refused, as names go into environments, scripts and files of other programs.
PARAMETER_NAME = re.compile(r"[A-Z][A-Z0-9_]{0,15}")


def check_words(parameters: Iterable[str], lines: Iterable[str]) -> None:
    """Raise InputError for a name that no parameter can have, or a console line with control characters."""
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

    Options of one autopilot have no effect on the others.
    """

    instance: int = 0  # number of the instance: moves ports
    limit_s: float = 5.0  # s of wall time for one answer
    port: int | None = None  # Betaflight: first port
    gains: str = "vehicle"  # "vehicle", "stock" (as shipped), a file
    lines: Sequence[str] = ()  # Betaflight: lines for the console
    parameters: Mapping[str, float] = field(default_factory=dict)  # PX4, ArduPilot: override computed ones
    magnetic_field: Vector3 | None = None  # PX4: gauss, NED; None: the Earth's
    hold_from_s: float | None = None  # PX4, ArduPilot: s, then position hold
    hands_off: bool = False  # a ground station arms and flies it
    defaults: Path | None = None  # ArduPilot: parameter file
    channels: Sequence[str] = ()  # ArduPilot: NUMBER=PULSE[@SECONDS]
    station: int | None = None  # ArduPilot: local UDP port for MAVLink

    def __post_init__(self) -> None:
        check_words(self.parameters, self.lines)


def describe_unknown(names: Sequence[str], existing: Collection[str], program: str) -> str:
    """Return an error text on parameters that a program lacks, with the nearest name that it has."""
    closest = get_close_matches(names[0], sorted(existing), n=1)
    suggestion = f"; did you mean {closest[0]}?" if closest else ""
    return f"parameter {', '.join(names)}: this {program} has none of that name{suggestion}"


COLOUR_CODE = re.compile(r"\x1b\[[0-9;]*m")  # colour codes of a terminal
# Code that makes Linux end a program with the thread that started it; 1 is PR_SET_PDEATHSIG of <sys/prctl.h>.
_END_WITH_PARENT = "import ctypes, os, sys; ctypes.CDLL(None).prctl(1, 9); os.execv(sys.argv[1], sys.argv[1:])"


class Program:
    """Process of an autopilot, with its output in a file; it is ended with its descendants."""

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
        """Return how the process ended, waiting for that at most ``wait`` [s]; empty if it still runs."""
        return self.process.describe_end(wait)

    def close(self, patience: float = 0.0) -> None:
        """End the process: ask it to end, give it ``patience`` [s], then kill it; may be called twice."""
        if patience and self.process.poll() is None:
            self.process.terminate()
        self.process.end(patience)


def find_configured_program(binary: Path | None, variable: str) -> Path | None:
    """Return the program ``binary``, or that named by an environment variable; None if neither is given.

    Raises InputError for a file that is no program.
    """
    if binary is not None:
        return check_program(binary, "binary")
    variable_path = os.environ.get(variable)
    return check_program(Path(variable_path), variable) if variable_path else None


def check_program(path: Path, where: str) -> Path:
    """Return a program's path with links resolved, as its files are beside it.  Raises InputError if invalid."""
    if not path.is_file():
        raise InputError(f"{where}: {path}: no such file")
    if not os.access(path, os.X_OK):
        raise InputError(f"{where}: {path}: is no program: it may not be executed")
    return path.resolve()


def listen(kind: socket.SocketKind, port: int, what: str, option: str) -> socket.socket:
    """Return a socket that listens at a port of this machine; one for datagrams has a time-out.

    Raises InputError if the port is taken; ``option`` is the option that states another.
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
    """Limit of the wait for one answer, which also fails if the autopilot's process ended."""

    def __init__(self, name: str, limit: float, program: Program | None, failure: str = "did not answer") -> None:
        self._name, self._limit, self._program, self._failure = name, limit, program, failure
        self._started = monotonic()
        self._has_checked = False

    def remaining(self) -> float:
        """Return the seconds until the next check.  Raises FlightError if the autopilot ended or took too long."""
        if self._program is not None and (ended := self._program.end_description):
            raise FlightError(f"{self._name} {ended}")
        remaining = self._started + self._limit - monotonic()
        if remaining <= 0.0:
            raise FlightError(f"{self._name} {self._failure} within {self._limit:g} s")
        return min(remaining, CHECK_S)

    def receive_packet(self, sock: socket.socket) -> tuple[bytes, tuple[str, int]]:
        """Return the next packet and its sender's address.  Raises FlightError as :meth:`remaining`."""
        while True:
            if self._has_checked:  # most answers need one wait only
                self.remaining()
            self._has_checked = True
            with suppress(BlockingIOError):
                return sock.recvfrom(1024)

    @property
    def elapsed(self) -> float:
        """Seconds since the wait began."""
        return monotonic() - self._started


def set_receive_timeout(sock: socket.socket) -> socket.socket:
    """Make a socket raise BlockingIOError after waiting :data:`CHECK_S`, and return it.

    It is one system call, where a time-out of Python's takes three.
    """
    sock.setblocking(True)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(int(CHECK_S), round(1e6 * (CHECK_S % 1.0))))
    return sock


class Autopilot:
    """Connection to an autopilot's program, which is started here, or by hand (``program`` is None).

    Each autopilot has a subclass with :meth:`start` and :meth:`exchange`.
    """

    name: ClassVar[str]
    timing: ClassVar[StartTiming]
    port_option: ClassVar[str] = "instance"  # option that states another port
    log_pattern: ClassVar[str] = ""  # glob of logs; empty: none are read
    patience_s = 0.0  # s for the program to end by itself

    def __init__(self, program: Path | None, folder: Path, vehicle: Vehicle, step: float, setup: Setup) -> None:
        self.counts = LockstepCounts()
        self.limit = setup.limit_s  # s of wall time for one answer
        self.setup, self.program = setup, program
        self.endpoint = ""  # where to connect one started by hand
        self.details: dict[str, Any] = {"gains": setup.gains}  # entries of the run's lockstep.json
        self.remark = ""  # on a version that was never tested
        self._folder, self._step = folder, step
        self._jets, self._range = len(vehicle.jets), vehicle.servo.range_rad if vehicle.servo else 0.0
        self._program: Program | None = None
        self._sockets: list[socket.socket] = []
        self._earlier_logs: set[tuple[int, Path]] = set()  # logs of other flights in this folder

    def start(self) -> None:
        """Start the program, and wait until it accepts frames.  Raises InputError or FlightError."""
        raise NotImplementedError

    def exchange(self, frame: SensorFrame) -> ActuatorOutputs:
        """Send a frame and wait for its answer.  Raises FlightError if none comes."""
        raise NotImplementedError

    def check_parameters(self) -> str:
        """After the flight, check that the autopilot has all parameters that were given.

        Return why that cannot be checked; "" if it was, now or before the flight, or no name was given.  Raises
        FlightError with the names that it lacks.
        """
        return ""

    def report(self) -> FirmwareReport:
        """After the flight, return data from the autopilot's own log."""
        return FirmwareReport()

    def close(self) -> None:
        """End the program and close the sockets; may be called twice."""
        if self._program is not None:
            self._program.close(self.patience_s)
        for sock in reversed(self._sockets):
            sock.close()

    def _open_listener(self, kind: socket.SocketKind, port: int) -> socket.socket:
        """Make the autopilot's folder, and return a socket that listens at a port.  Raises InputError."""
        self._folder.mkdir(parents=True, exist_ok=True)
        self._earlier_logs = self._find_logs()
        return self._close_with_autopilot(listen(kind, port, self.name, self.port_option))

    def _describe_start(self, error: FlightError, log: Path, title: str) -> FlightError:
        """Return the error of a failed start with the program's last output, and ask if it is the right program."""
        lines = log.read_text(errors="replace").split("\n") if log.is_file() else []
        last = next((line for line in reversed(lines) if line.strip()), "")
        printed = f"; the last that it printed: {COLOUR_CODE.sub('', last).strip()} ({log})" if last else ""
        return FlightError(f"{error}; is {self.program} {title}?{printed}" if self.program else f"{error}{printed}")

    def _find_logs(self) -> set[tuple[int, Path]]:
        """Return the logs in the autopilot's folder with their modification times [ns]."""
        paths = self._folder.glob(self.log_pattern) if self.log_pattern else ()
        return {(path.stat().st_mtime_ns, path) for path in paths}

    def _new_logs(self) -> list[Path]:
        """Return the logs written since the start, newest last; none for a program started by hand.

        A log of the same name may have been there before.
        """
        return [] if self._program is None else [path for _, path in sorted(self._find_logs() - self._earlier_logs)]

    def _close_with_autopilot(self, sock: socket.socket) -> socket.socket:
        """Return a socket that is closed with the autopilot."""
        self._sockets.append(sock)
        return sock

    def _open_sender(self) -> socket.socket:
        """Return a socket for datagrams to the autopilot."""
        sock = self._close_with_autopilot(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        sock.bind((LOCAL, 0))
        return sock

    def _count_answer(self, timer: AnswerTimer) -> None:
        self.counts.answers += 1
        self.counts.longest_s = max(self.counts.longest_s, timer.elapsed)


def discard_packets(sock: socket.socket) -> None:
    """Discard the packets that a socket has received so far."""
    sock.setblocking(False)
    with suppress(BlockingIOError):
        while True:
            sock.recv(65536)
    sock.setblocking(True)
