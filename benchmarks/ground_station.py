"""What a ground station gets of a session, and what it costs the flight: numbers only, nothing is judged.

    python -m benchmarks.ground_station                  real time, two stations: deadlines, state to packet
    python -m benchmarks.ground_station --flood          with a third that floods and a fourth that never reads
    python -m benchmarks.ground_station --soak 3600      an hour of flight as fast as it goes: memory and queues

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
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from cosim import Scenario
from cosim.control.autopilot import requests as rq
from cosim.files import scratch
from cosim.groundstation.exchange import Exchange
from cosim.groundstation.links import Links
from cosim.groundstation.mavlink.wire.dialect import mav
from cosim.groundstation.session import RecordOptions, Session

ATTITUDE_ID = 30
HEARTBEAT_INTERVAL_S = 1.0


def resident_of(process: str) -> float | None:
    """Return the resident memory of a process [MB]; None if the system does not tell it."""
    try:
        with open(f"/proc/{process}/status", encoding="utf-8", errors="replace") as status:
            rows = [line.split() for line in status]
    except OSError:
        return None
    return next((1024 * int(row[1]) / 1e6 for row in rows if row[0] == "VmRSS:"), None)


def _watch_for_end() -> threading.Event:
    """Return an event that is set when standard input closes; print that this process is ready."""
    end = threading.Event()

    def wait() -> None:
        sys.stdin.read()
        end.set()

    threading.Thread(target=wait, daemon=True).start()
    print("ready", flush=True)
    return end


class Station:
    """Ground station that sends heartbeats and reads everything."""

    def __init__(self, port: int) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.mav = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self._due = 0.0

    def send_heartbeat(self) -> None:
        now = time.monotonic()
        if now >= self._due:
            self._due = now + HEARTBEAT_INTERVAL_S
            self.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))

    def send(self, message: Any) -> None:
        self.socket.send(message.pack(self.mav))


def listen(port: int) -> None:
    """Print the time of arrival of each ATTITUDE with its flight time [ms]."""
    station, end = Station(port), _watch_for_end()
    first_seen: dict[int, float] = {}  # time of arrival by flight time [ms]
    station.socket.settimeout(0.1)
    while not end.is_set():
        station.send_heartbeat()
        try:
            data = station.socket.recv(2048)
        except OSError:
            continue
        if data[0] == 0xFD and data[7] == ATTITUDE_ID and not data[8]:
            first_seen.setdefault(struct.unpack_from("<I", data, 10)[0], time.monotonic())
    print(json.dumps([(came, ms) for ms, came in first_seen.items()]))


def flood(port: int) -> None:
    """Send commands, parameter requests and random bytes, ten thousand frames a second."""
    station, end = Station(port), _watch_for_end()
    station.socket.setblocking(False)
    rubbish = os.urandom(200)
    while not end.is_set():
        station.send_heartbeat()
        for number in range(10):
            try:
                station.send(mav.MAVLink_command_long_message(1, 1, 178, 0, 1.0, 2.0 + 0.01 * number, 0, 0, 0, 0, 0))
                station.send(mav.MAVLink_param_request_list_message(1, 1))
                station.socket.send(rubbish)
            except OSError:
                pass
        time.sleep(0.003)


def silent(port: int) -> None:
    """Send heartbeats and never read."""
    station, end = Station(port), _watch_for_end()
    while not end.is_set():
        station.send_heartbeat()
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
        session = _make_session(links, Path(folder) / "run", factor)
        kinds = ["listen", "listen", *(["flood", "silent"] if others else [])]
        stations = [_start_station(kind, links.link.ports[0]) for kind in kinds]
        marks: list[Any] = []

        def measure() -> None:
            for wait in (3.0, seconds):  # all stations have connected by then
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
            "worst_ms": 1e3 * last.longest_delay,  # since the start
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
    """Fly up, to and fro, and down, again and again, with two stations on the links; return what it took."""
    rows: list[dict[str, float | None]] = []
    with Links(["udpin:127.0.0.1:0"]) as links, TemporaryDirectory(dir=scratch()) as folder:
        exchange = links.exchange
        session = _make_session(links, Path(folder) / "run", None, seconds)
        stations = [_start_station("listen", links.link.ports[0]) for _ in range(2)]
        threading.Thread(target=_command_flight, args=(exchange,), daemon=True).start()

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


def _command_flight(exchange: Exchange) -> None:
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


def _make_session(links: Links, folder: Path, factor: float | None, duration: float | None = None) -> Session:
    return Session(
        Scenario.load("hover").replace(name="gcs"), links.exchange, factor=factor, duration=duration,
        records=RecordOptions(folder, report=False), on_begin=links.begin, on_end=links.end,
    )  # fmt: skip


def _start_station(kind: str, port: int) -> subprocess.Popen[str]:
    station = subprocess.Popen(
        [sys.executable, "-P", "-m", "benchmarks.ground_station", "--station", kind, "--port", str(port)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert station.stdout is not None
    station.stdout.readline()  # its line "ready"
    return station


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="of wall time")
    parser.add_argument("--rtf", type=float, default=1.0)
    parser.add_argument("--flood", action="store_true")
    parser.add_argument("--soak", type=float, help="seconds of flight")
    parser.add_argument("--station", choices=["listen", "flood", "silent"], help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.station:
        {"listen": listen, "flood": flood, "silent": silent}[options.station](options.port)
    elif options.soak:
        print(json.dumps(soak(options.soak), indent=2))
    else:
        print(json.dumps(realtime(options.seconds, options.flood, options.rtf), indent=2))


if __name__ == "__main__":
    main()
