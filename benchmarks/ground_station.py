"""What a ground station gets of a session, and what it costs the flight: numbers only, nothing is judged.

    python -m benchmarks.ground_station                  real time, two stations: deadlines, state to packet
    python -m benchmarks.ground_station --flood          with a third that floods and a fourth that never reads
    python -m benchmarks.ground_station --soak 3600      an hour of flight as fast as it goes: memory and queues
    python -m benchmarks.ground_station --lines          what serial lines of several speeds carry of the telemetry
    python -m benchmarks.ground_station --stalled 60     a serial port that stops reading, beside UDP and TCP
    ... --write docs/ground-station.md                   the last two: puts their tables between the page's marks

Stations are processes of their own; clocks are comparable because all use the system's monotonic one.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import struct
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.measures.long_flight import resident_of
from cosim import Scenario
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.parameters import Parameters
from cosim.files import scratch
from cosim.groundstation.exchange import Exchange, Port
from cosim.groundstation.links import Links, make_vehicle_constants
from cosim.groundstation.mavlink.vehicle import MavlinkVehicle
from cosim.groundstation.mavlink.wire.dialect import BY_NAME, mav
from cosim.groundstation.mavlink.wire.link import Link
from cosim.groundstation.read_only import scripted_status
from cosim.groundstation.session import RecordOptions, Session
from cosim.groundstation.session_flight import make_flight_info, make_snapshot
from cosim.pages import table, write_marks
from cosim.simulation.build import build
from cosim.simulation.pacing import PaceReport

ATTITUDE = 30
HEARTBEAT_EVERY = 1.0


def _end() -> threading.Event:
    """Set when who started this process closes its standard input; says that it is ready."""
    end = threading.Event()

    def wait() -> None:
        sys.stdin.read()
        end.set()

    threading.Thread(target=wait, daemon=True).start()
    print("ready", flush=True)
    return end


class Station:
    """A ground station as far as the vehicle can tell: heartbeats, and everything read."""

    def __init__(self, port: int) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.mav = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self._due = 0.0

    def beat(self) -> None:
        now = time.monotonic()
        if now >= self._due:
            self._due = now + HEARTBEAT_EVERY
            self.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))

    def send(self, message: Any) -> None:
        self.socket.send(message.pack(self.mav))


def listen(port: int) -> None:
    """Print when each ATTITUDE came, and the flight time [ms] in it."""
    station, end = Station(port), _end()
    first_seen: dict[int, float] = {}  # the first time that each state came
    station.socket.settimeout(0.1)
    while not end.is_set():
        station.beat()
        try:
            data = station.socket.recv(2048)
        except OSError:
            continue
        if data[0] == 0xFD and data[7] == ATTITUDE and not data[8]:
            first_seen.setdefault(struct.unpack_from("<I", data, 10)[0], time.monotonic())
    print(json.dumps([(came, ms) for ms, came in first_seen.items()]))


def flood(port: int) -> None:
    """Commands, parameters and rubbish, ten thousand frames a second: no core of its own is needed for it."""
    station, end = Station(port), _end()
    station.socket.setblocking(False)
    rubbish = os.urandom(200)
    while not end.is_set():
        station.beat()
        for number in range(10):
            try:
                station.send(mav.MAVLink_command_long_message(1, 1, 178, 0, 1.0, 2.0 + 0.01 * number, 0, 0, 0, 0, 0))
                station.send(mav.MAVLink_param_request_list_message(1, 1))
                station.socket.send(rubbish)
            except OSError:
                pass
        time.sleep(0.003)


def silent(port: int) -> None:
    """Says that it is there, and never reads."""
    station, end = Station(port), _end()
    while not end.is_set():
        station.beat()
        time.sleep(0.2)


def realtime(seconds: float, others: bool, factor: float) -> dict[str, Any]:
    published: dict[int, float] = {}
    with Links(["udpin:127.0.0.1:0"]) as links, TemporaryDirectory(dir=scratch()) as folder:
        exchange = links.exchange

        def note() -> None:
            snapshot = exchange.snapshot
            if snapshot is not None:
                published[round(snapshot.time * 1000.0)] = snapshot.published

        exchange.subscribe(note)
        session = _session(links, Path(folder) / "run", factor)
        kinds = ["listen", "listen", *(["flood", "silent"] if others else [])]
        stations = [_spawn(kind, links.link.ports[0]) for kind in kinds]
        marks: list[Any] = []

        def measure() -> None:
            for wait in (3.0, seconds):  # until everybody is connected and has all parameters
                time.sleep(wait)
                marks.append(exchange.snapshot)
            session.stop("over")

        threading.Thread(target=measure, daemon=True).start()
        cpu = time.process_time()
        (run,) = session.run()
        cpu = time.process_time() - cpu
        late: list[float] = []
        for station in stations:
            out = station.communicate("")[0]
            late += [came - published[ms] for came, ms in json.loads(out or "[]") if ms in published]
        first, last = (mark.pace for mark in marks)
        missed, steps = last.missed - first.missed, last.steps - first.steps
        late.sort()
        return {
            "seconds": seconds,
            "steps": steps,
            "hz": steps / (marks[1].published - marks[0].published),
            "missed_deadlines": missed,
            "missed_percent": 100.0 * missed / steps,
            "worst_ms": 1e3 * last.longest_delay,  # from the start on
            "stalls": last.stalls - first.stalls,
            "state_to_packet_ms": {
                "median": 1e3 * median(late),
                "99%": 1e3 * late[int(0.99 * len(late))],
                "most": 1e3 * late[-1],
                "packets": len(late),
            },
            "cpu_share": cpu / (run.summary.wall_s or 1.0),
            "turned_away": exchange.turned_away,
            "refused": dict(links.link.refused),
            "failures": dict(links.link.failures),
            "load_average": os.getloadavg()[0],
        }


def soak(seconds: float) -> dict[str, Any]:
    """Up, to and fro, down, again and again, with two stations on the links."""
    rows: list[dict[str, float | None]] = []
    with Links(["udpin:127.0.0.1:0"]) as links, TemporaryDirectory(dir=scratch()) as folder:
        exchange = links.exchange
        session = _session(links, Path(folder) / "run", None, seconds)
        stations = [_spawn("listen", links.link.ports[0]) for _ in range(2)]
        threading.Thread(target=_to_and_fro, args=(exchange,), daemon=True).start()

        def watch() -> None:
            due = 60.0
            while True:
                snapshot = exchange.snapshot
                if snapshot is not None and snapshot.time >= due:
                    due += max(60.0, seconds / 60.0)
                    rows.append(
                        {
                            "time_s": snapshot.time,
                            "memory_mb": resident_of("self"),
                            "waiting_requests": exchange.request_count,
                            "waiting_bytes": sum(peer.waiting_bytes for peer in links.link.peers),
                        }
                    )
                    print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
                time.sleep(0.2)

        threading.Thread(target=watch, daemon=True).start()
        begin = time.perf_counter()
        (run,) = session.run()
        wall = time.perf_counter() - begin
        for station in stations:
            station.kill()
            station.communicate()
        return {
            "outcome": run.outcome,
            "flown_s": run.summary.duration_s,
            "wall_s": wall,
            "realtime_factor": run.summary.realtime_factor,
            "requests": sum(1 for _ in open(Path(folder) / "run" / "requests.jsonl", encoding="utf-8")),
            "rows": rows,
            "failures": dict(links.link.failures),
        }


def _to_and_fro(exchange: Exchange) -> None:
    position = 5.0
    while True:
        snapshot = exchange.snapshot
        if snapshot is not None:
            status = snapshot.status
            if status.ready and not status.armed:
                exchange.ask(rq.Arm(), sender="soak")
                exchange.ask(rq.Takeoff(8.0), sender="soak")
            elif status.armed and status.mode.value == "HOLD":
                if int(snapshot.time) % 300 > 270:
                    exchange.ask(rq.Land(), sender="soak")
                else:
                    position = -position
                    exchange.ask(rq.Goto(position, 0.5 * position), sender="soak")
                exchange.ask(rq.SetParameter("MPC_XY_VEL_MAX", 2.0 + 0.1 * (int(snapshot.time) % 20)), sender="soak")
        time.sleep(0.5)


# --- lines ---------------------------------------------------------------------------------------------------------

BAUD = (9600, 19200, 38400, 57600, 115200, 230400, 921600)
COUNTED = ("HEARTBEAT", "ATTITUDE", "GLOBAL_POSITION_INT", "VFR_HUD", "SYS_STATUS")
SETTLE, COUNT = 5.0, 40.0  # s of the link's clock: until the rates are found, and while they are counted
LOOK = 0.01  # s between two looks of the link's loop
NO_PARAMETERS = [float("nan")] * 6


class _Wire:
    """A serial line as the link sees it: it takes everything, and sends it at its speed; nothing of it is real."""

    def __init__(self, clock: Callable[[], float], link: Link, baud: int) -> None:
        self._clock, self._rate, self._free = clock, baud / 10.0, 0.0
        self.arrived: list[tuple[float, bytes]] = []
        self.peer = link.new_peer(f"{baud}", self._take, is_datagram=False, line=self._rate)
        self.peers = [self.peer]

    def _take(self, data: bytes) -> int:
        self._free = max(self._clock(), self._free) + len(data) / self._rate
        self.arrived.append((self._free, data))
        return len(data)

    def poll(self, now: float) -> None:
        self.peer.flush()

    def close(self) -> None:
        pass


def line(baud: int) -> tuple[dict[str, float], float, list[float]]:
    """Messages a second by name, bytes a second, and the delays of acknowledgements, on a clock that is counted.

    The Hex-Jet hovers, with the telemetry of every default stream; a command comes every 0.7 s.
    """
    now = [0.0]
    with build(Scenario.load("hover").replace(duration_s=SETTLE + COUNT + 1.0)) as simulation:
        link = Link([], clock=lambda: now[0])
        exchange = Exchange(lambda: now[0])
        info = make_flight_info(simulation, 1, Parameters([]), None, 1.0)
        link.handler = vehicle = MavlinkVehicle(make_vehicle_constants(info, "px4"), Port(exchange, "mavlink"), link)
        wire = _Wire(lambda: now[0], link, baud)
        link._channels.append(wire)
        latencies: list[float] = []
        number = mav.MAVLink_command_long_message(1, 1, 401, 0, *NO_PARAMETERS, 0.0)
        sender = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        begun = 0
        while now[0] < SETTLE + COUNT:
            while simulation.k * simulation.dt < now[0]:
                sample = simulation.step()
            if simulation.k:
                status = scripted_status(simulation, sample)
                fix = status.fix._replace(disturbance=(0.1, 0.0))  # as where an autopilot estimates what pushes it
                status = status._replace(fix=fix)
                exchange.publish(make_snapshot(simulation, info, sample, status, PaceReport(load=0.1), now[0]))
            if now[0] >= SETTLE:
                begun = begun or len(wire.arrived)
                if len(latencies) <= (now[0] - SETTLE) / 0.7:
                    latencies.append(now[0])
                    link.dispatch_frames(wire.peer.feed(number.pack(sender), now[0]), wire.peer, now[0])
            link.poll(now[0])
            now[0] += LOOK
        names = {message.id: name for name, message in BY_NAME.items()}
        counts: Counter[str] = Counter()
        acknowledged = []
        for at, data in wire.arrived[begun:]:
            name = names[data[7] | data[8] << 8 | data[9] << 16]
            counts[name] += 1
            if name == "COMMAND_ACK":
                acknowledged.append(at)
        carried = sum(len(data) for _, data in wire.arrived[begun:]) / COUNT
        assert vehicle.acknowledged == len(latencies)
        assert not link.failures, link.failures
        link.close()
        return (
            {name: counts[name] / COUNT for name in COUNTED},
            carried,
            [came - at for came, at in zip(acknowledged, latencies, strict=False)],
        )


def lines() -> str:
    """Return the page's table of serial lines by baud rate."""
    columns = ("baud", "bytes/s", "of them used", *(f"{name}, Hz" for name in COUNTED), "latest acknowledgement, s")
    rows = []
    for baud in BAUD:
        rates, carried, late = line(baud)
        rates_shown = (f"{rates[name]:.2g}" if rates[name] < 10 else f"{rates[name]:.0f}" for name in COUNTED)
        rows.append((f"{baud}", f"{baud // 10}", f"{carried:.0f}", *rates_shown, f"{max(late):.2f}"))
    return table(columns, rows)


# --- a port that stalls --------------------------------------------------------------------------------------------


class _Asker:
    """A station that asks something 20 times a second and notes how long the acknowledgement takes."""

    def __init__(self, kind: str, port: int) -> None:
        self.kind = kind
        if kind == "UDP":
            self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self.socket.connect(("127.0.0.1", port))
        else:
            self.socket = socket.create_connection(("127.0.0.1", port))
        self.socket.settimeout(5.0)
        self.mav = mav.MAVLink(None, srcSystem=254 if kind == "UDP" else 253, srcComponent=190)
        self.mav.robust_parsing = True
        self.late: list[float] = []
        self.lost = 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)
        ask = mav.MAVLink_command_long_message(1, 1, 512, 0, 148.0, *NO_PARAMETERS)
        due = 0.0
        while not self._over.is_set():
            now = time.monotonic()
            if now >= due:
                due = now + HEARTBEAT_EVERY
                self.socket.send(beat.pack(self.mav))
            self.socket.send(ask.pack(self.mav))
            began = time.monotonic()
            if self._acknowledged():
                self.late.append(time.monotonic() - began)
            else:
                self.lost += 1
            time.sleep(0.05)

    def _acknowledged(self) -> bool:
        try:
            while True:
                for message in self.mav.parse_buffer(self.socket.recv(4096)) or []:
                    if message.get_type() == "COMMAND_ACK" and message.command == 512:
                        return True
        except TimeoutError:
            return False

    def stop(self) -> None:
        self._over.set()
        self._thread.join()
        self.socket.close()


def stall_table(seconds: float) -> str:
    """Fly at real time with a pseudo-terminal read for 3 s, not for ``seconds``, then again; return a table."""
    import tty

    pilot_side, vehicle_side = os.openpty()
    tty.setraw(pilot_side)
    os.set_blocking(pilot_side, False)
    urls = [f"serial:{os.ttyname(vehicle_side)}:57600", "udpin:127.0.0.1:0", "tcpin:127.0.0.1:0"]
    rows: list[tuple[str, ...]] = []
    with Links(urls) as links, TemporaryDirectory(dir=scratch()) as folder:
        session = _session(links, Path(folder) / "run", 1.0)
        serial = links.link._channels[0]
        events: list[tuple[float, str]] = []
        tell = links.link.on_event

        def note(text: str) -> None:
            events.append((time.monotonic(), text))
            tell(text)

        links.link.on_event = note

        def read(until: Callable[[], bool]) -> None:
            while not until():
                try:
                    os.read(pilot_side, 65536)
                except BlockingIOError:
                    time.sleep(0.01)

        def measure() -> None:
            read(lambda: bool(serial.peers) and links.exchange.snapshot is not None)
            end = time.monotonic() + 3.0
            read(lambda: time.monotonic() > end)
            stations = [_Asker("UDP", links.link.ports[1]), _Asker("TCP", links.link.ports[2])]
            begun = time.monotonic()
            time.sleep(seconds)
            for station in stations:
                station.stop()
            again = time.monotonic()
            read(lambda: any("carries again" in text for _, text in events) or time.monotonic() - again > 60.0)
            back = next((at - again for at, text in events if "carries again" in text), float("nan"))
            dropped = next((at - begun for at, text in events if "is dropped" in text), float("nan"))
            for station in stations:
                late = sorted(station.late)
                row = (station.kind, len(late) + station.lost, station.lost, 1e3 * median(late), 1e3 * late[-1])
                rows.append((row[0], f"{row[1]}", f"{row[2]}", f"{row[3]:.1f}", f"{row[4]:.1f}"))
            rows.append(("serial, dropped after", f"{dropped:.0f} s", "", "", ""))
            rows.append(("serial, said to carry again after", f"{back:.0f} s", "", "", ""))
            session.stop("over")

        threading.Thread(target=measure, daemon=True).start()
        (run,) = session.run()
    os.close(pilot_side)
    os.close(vehicle_side)
    summary = run.summary
    assert summary.pacing is not None
    columns = ("link", "commands", "without an answer", "answer, median, ms", "latest answer, ms")
    steps = round(summary.duration_s / summary.step_s)
    return (
        table(columns, rows)
        + f"\n{summary.pacing.missed_deadlines} of {steps} steps of the flight were late, "
        + f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors; the port was not read for "
        + f"{seconds:g} s.\n"
    )


def _session(links: Links, folder: Path, factor: float | None, duration: float | None = None) -> Session:
    return Session(
        Scenario.load("hover").replace(name="gcs"), links.exchange, factor=factor, duration=duration,
        records=RecordOptions(folder, report=False), on_begin=links.begin, on_end=links.end,
    )  # fmt: skip


def _spawn(kind: str, port: int) -> subprocess.Popen[str]:
    station = subprocess.Popen(
        [sys.executable, "-P", "-m", "benchmarks.ground_station", "--station", kind, "--port", str(port)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert station.stdout is not None
    station.stdout.readline()  # ready
    return station


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="of wall time")
    parser.add_argument("--rtf", type=float, default=1.0)
    parser.add_argument("--flood", action="store_true")
    parser.add_argument("--soak", type=float, help="seconds of flight")
    parser.add_argument("--lines", action="store_true")
    parser.add_argument("--stalled", type=float, help="seconds without reading")
    parser.add_argument("--write", type=Path, metavar="PAGE.md")
    parser.add_argument("--station", choices=["listen", "flood", "silent"], help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.station:
        {"listen": listen, "flood": flood, "silent": silent}[options.station](options.port)
    elif options.lines or options.stalled:
        results = {"lines": lines()} if options.lines else {}
        results |= {"stalled": stall_table(options.stalled)} if options.stalled else {}
        print("\n".join(results.values()))
        if options.write:
            write_marks(options.write, results)
    elif options.soak:
        print(json.dumps(soak(options.soak), indent=2))
    else:
        print(json.dumps(realtime(options.seconds, options.flood, options.rtf), indent=2))


if __name__ == "__main__":
    main()
