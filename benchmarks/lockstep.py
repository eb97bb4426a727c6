"""What the lockstep with an autopilot costs a step: numbers only, nothing is judged.

    python -m benchmarks.lockstep                            a minute
    python -m benchmarks.lockstep --write docs/autopilots.md     puts the table between the page's marks

The autopilots are the tests' stand-ins, in processes of their own. What an exchange costs is given three times: of the
clock, which has the stand-in's own time and the system's way there and back in it; of the processor, in the thread that
flies; and beside them a bare echo of packets of the same sizes over the same kind of socket, which no lockstep can be
cheaper than. Rounds of all of them take turns; the figures are medians.
"""

from __future__ import annotations

import argparse
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from benchmarks.timing import Clocked, Job, clock
from cosim import Scenario
from cosim.base.frames import from_euler
from cosim.base.geodesy import Geodesy
from cosim.files import scratch
from cosim.pages import table, write_marks
from hexjet_sitl.ardupilot import ArduPilot
from hexjet_sitl.lockstep import Autopilot, SensorFrame, Setup, StickPositions
from hexjet_sitl.px4 import Px4

MARK = "lockstep"
HOVER = Scenario.load("hover").replace(engine="edf")
VEHICLE = HOVER.resolved_vehicle()[0]
ORIGIN = Geodesy(22.35, 113.59)
ROUNDS, FRAMES = 7, 4000
INSTANCE = {"ardupilot": 2711, "px4": 31_711}  # ports that nobody has
STILL = SensorFrame(
    0.0, (0.1, -0.2, 0.3), (0.5, -0.4, -9.8), from_euler(0.1, 0.2, 0.3), (1.0, 2.0, -30.0), (0.1, 0.2, -0.3), 30.0,
    StickPositions(0.5, -0.25, 0.1, 0.4, True),
)  # fmt: skip


def stand_in(kind: str) -> None:
    """Be the autopilot's stand-in or the echo in the child process, until its standard input ends."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "tools"))
    import autopilot_standins

    if kind == "ardupilot":
        autopilot_standins.ArduPilotStandIn(9002 + 10 * INSTANCE[kind])
    elif kind == "px4":
        autopilot_standins.Px4StandIn(4560 + INSTANCE[kind])
    else:
        echo(kind)
    sys.stdin.read()


def echo(kind: str) -> None:
    """Say back what comes: by UDP, or by TCP."""
    if kind == "udp":
        here = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        here.bind(("127.0.0.1", 0))
        print(here.getsockname()[1], flush=True)
        while True:
            packet, sender = here.recvfrom(4096)
            here.sendto(packet[:40], sender)
    server = socket.create_server(("127.0.0.1", 0))
    print(server.getsockname()[1], flush=True)
    there, _ = server.accept()
    there.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    while packet := there.recv(4096):
        there.sendall(packet[:95])


@contextmanager
def child(kind: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "benchmarks.lockstep", "--stand-in", kind],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def timed(step: Callable[[int], object]) -> Clocked:
    """Return what one of :data:`FRAMES` steps costs."""

    def steps() -> None:
        for k in range(FRAMES):
            step(k)

    return clock(Job("frames", 0, FRAMES, lambda: steps))


def bare(kind: str) -> Clocked:
    """Measure a round trip of packets as large as those of the lockstep, and nothing else."""
    with child(kind) as process:
        assert process.stdout is not None
        port = int(process.stdout.readline())
        state = b"x" * (300 if kind == "udp" else 140)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM) as link:
            link.connect(("127.0.0.1", port))
            if kind == "tcp":
                link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

            def there_and_back(k: int) -> None:
                link.sendall(state)
                link.recv(4096)

            return timed(there_and_back)


@contextmanager
def pair_of(kind: str, folder: Path) -> Iterator[Autopilot]:
    autopilot: ArduPilot | Px4
    if kind == "ardupilot":
        launch = Setup(INSTANCE[kind], limit_s=20.0)
        autopilot = ArduPilot(None, folder, VEHICLE, HOVER.step_s, ORIGIN, launch)
    else:
        autopilot = Px4(None, folder, VEHICLE, HOVER.step_s, ORIGIN, Setup(INSTANCE[kind], limit_s=20.0))
    with child(kind):
        try:
            yield autopilot
        finally:
            autopilot.close()


def time_exchanges(kind: str, folder: Path) -> Clocked:
    with pair_of(kind, folder) as autopilot:
        autopilot.start()
        for k in range(20):  # its boot
            autopilot.exchange(STILL._replace(time=k * HOVER.step_s))
        return timed(lambda k: autopilot.exchange(STILL._replace(time=(20 + k) * HOVER.step_s)))


def measure() -> dict[str, list[tuple[Clocked, Clocked]]]:
    """Cost of an exchange and of a bare round trip, round by round, of each autopilot."""
    rounds: dict[str, list[tuple[Clocked, Clocked]]] = {"ardupilot": [], "px4": []}
    for number in range(ROUNDS):
        for kind, sort in (("ardupilot", "udp"), ("px4", "tcp")):
            with TemporaryDirectory(dir=scratch()) as folder:
                rounds[kind].append((time_exchanges(kind, Path(folder)), bare(sort)))
        print(f"round {number + 1} of {ROUNDS}", flush=True)
    return rounds


def text_of(measurements: dict[str, list[tuple[Clocked, Clocked]]]) -> str:
    rows = []
    for kind, rounds in measurements.items():
        (wall, own_cpu), (bare_wall, bare_cpu) = (
            tuple(1e6 * median(round_[part][k] for round_ in rounds) for k in (0, 1)) for part in (0, 1)
        )
        rows.append([
            kind, f"{wall:.0f}", f"{own_cpu:.0f}", f"{bare_wall:.0f}", f"{bare_cpu:.0f}", f"{own_cpu - bare_cpu:.0f}",
            f"{HOVER.step_s * 1e6 / wall:.0f}",
        ])  # fmt: skip
    head = [
        "", "exchange, us of the clock", "of our processor", "bare echo, us of the clock", "of our processor",
        "ours over the echo's, of the processor", "real time at most by this",
    ]  # fmt: skip
    return table(head, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stand-in", help=argparse.SUPPRESS)
    parser.add_argument("--write", type=Path, metavar="PAGE.md")
    options = parser.parse_args()
    if options.stand_in:
        stand_in(options.stand_in)
        return
    text = text_of(measure())
    print(text)
    if options.write is not None:
        write_marks(options.write, {MARK: text})


if __name__ == "__main__":
    main()
