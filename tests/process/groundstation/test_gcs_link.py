"""``hexjet gcs`` as a process, flown over MAVLink on the loopback interface."""

from __future__ import annotations

import json
import re
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from math import nan
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_tools import Hexjet
from patience import PATIENCE

from cosim.base.errors import InputError
from cosim.cli.calls.gcs import session_line
from cosim.flight import reserve_folder
from cosim.groundstation.mavlink.wire.dialect import mav
from cosim.results.run import open_run

HEXJET = [sys.executable, "-c", "from cosim.cli.main import main; main()"]
LINK = ("--mavlink", "udpin:127.0.0.1:0", "--params", "none")
TAKEOFF, LAND, ARM, REPOSITION, REBOOT = 22, 21, 400, 192, 246
ACCEPTED, REJECTED = 0, 1


class Station:
    """A ground station with one thought at a time."""

    def __init__(self, port: int, system: int = 255, target: int = 1) -> None:
        self.target = target
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(0.05)
        self.socket.connect(("127.0.0.1", port))
        self.mav = mav.MAVLink(None, srcSystem=system, srcComponent=190)
        self.mav.robust_parsing = True
        self.last: dict[str, Any] = {}
        self.texts: list[str] = []
        self.count = 0
        self._beat = 0.0

    def send(self, message: Any) -> None:
        self.socket.send(message.pack(self.mav))

    def read(self) -> list[Any]:
        now = time.monotonic()
        if now - self._beat > 0.2:  # of flight time it is more
            self._beat = now
            self.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
        try:
            found = self.mav.parse_buffer(self.socket.recv(4096)) or []
        except TimeoutError:
            return []
        for message in found:
            self.last[message.get_type()] = message
            self.count += 1
            if message.get_type() == "STATUSTEXT":
                self.texts.append(message.text if isinstance(message.text, str) else message.text.decode())
        return list(found)

    def until(self, true: Callable[[Station], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not true(self):
            assert time.monotonic() < end, (self.texts, {k: str(v)[:200] for k, v in self.last.items()})
            self.read()

    def command(self, number: int, *p: float) -> int:
        self.send(mav.MAVLink_command_long_message(self.target, 1, number, 0, *p, *[nan] * (7 - len(p))))
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            for message in self.read():
                if message.get_type() == "COMMAND_ACK" and message.command == number:
                    return int(message.result)
        raise AssertionError(f"no answer to {number}")

    @property
    def armed(self) -> bool:
        return "HEARTBEAT" in self.last and bool(self.last["HEARTBEAT"].base_mode & 128)

    @property
    def height(self) -> float:
        return (
            float(self.last["GLOBAL_POSITION_INT"].relative_alt) / 1000.0 if "GLOBAL_POSITION_INT" in self.last else 0.0
        )

    def ready(self) -> bool:
        return "SYS_STATUS" in self.last and bool(self.last["SYS_STATUS"].onboard_control_sensors_health & 1 << 28)

    def take_off(self) -> None:
        self.until(Station.ready)
        assert self.command(ARM, 1.0) == ACCEPTED
        assert self.command(TAKEOFF) == ACCEPTED
        self.until(lambda s: s.height > 9.0)

    def land(self) -> None:
        assert self.command(LAND) == ACCEPTED
        self.until(lambda s: not s.armed)


@pytest.fixture
def station_at() -> Iterator[Callable[..., Station]]:
    """Makes ground stations, and closes them."""
    made: list[Station] = []

    def make(port: int, system: int = 255, target: int = 1) -> Station:
        made.append(Station(port, system, target))
        return made[-1]

    yield make
    for station in made:
        station.socket.close()


@pytest.fixture
def vehicle(tmp_path: Path) -> Iterator[Callable[..., tuple[subprocess.Popen[str], int]]]:
    """Starts a vehicle at ten times real time, and gives the process and its port."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> tuple[subprocess.Popen[str], int]:
        process = subprocess.Popen(
            [*HEXJET, "gcs", *LINK, "--rtf", "10", "--out", str(tmp_path / "run"), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=tmp_path,
        )
        started.append(process)
        assert process.stdout is not None
        said = ""
        for line in process.stdout:
            said += line
            found = re.search(r"listens at udp 127\.0\.0\.1:(\d+)", line)
            if found:
                return process, int(found[1])
        raise AssertionError(said)

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.mark.parametrize(("most", "status"), [("0", 1), ("1", 0)])
def test_the_exit_status_is_the_verdicts_as_of_fly(hexjet: Hexjet, most: str, status: int) -> None:
    """Standing it sinks 10 nm aside into its legs: beyond one limit and within the other, and completed in both."""
    done = hexjet(
        "gcs", *LINK,
        "--rtf", "0", "--duration", "1", "--out", "run", "--set", f"limits.drift_m={most}", "--json",
    )  # fmt: skip
    (summary,) = json.loads(done.out)["runs"]
    assert (done.status, summary["outcome"]) == (status, "completed")
    assert summary["verdict"] == ("beyond limits" if status else "completed, nothing checked")
    assert ("beyond limits, drift from the start" in done.err) == bool(status)


def test_a_flight_over_mavlink_and_its_replay(vehicle: Any, station_at: Any, tmp_path: Path) -> None:
    process, port = vehicle()
    station = station_at(port)
    station.take_off()
    home = station.last["HOME_POSITION"] if "HOME_POSITION" in station.last else station.last["GLOBAL_POSITION_INT"]
    lat, lon = (
        home.latitude if hasattr(home, "latitude") else home.lat,
        home.longitude if hasattr(home, "longitude") else home.lon,
    )
    # 10 m north, at the height where it is
    station.send(mav.MAVLink_command_int_message(1, 1, 6, REPOSITION, 0, 0, -1.0, 1.0, 0.0, nan, lat + 898, lon, 10.0))
    station.until(lambda s: abs(s.last["GLOBAL_POSITION_INT"].lat - lat - 898) < 90)
    station.land()
    process.send_signal(signal.SIGTERM)
    assert process.wait(PATIENCE) == 0
    run = open_run(tmp_path / "run")
    assert (run.outcome, run.reason) == ("completed", "stopped by SIGTERM")
    asked = [json.loads(line) for line in (tmp_path / "run" / "requests.jsonl").read_text().splitlines()]
    assert {"Arm", "Takeoff", "Goto", "Land"} <= {line["request"] for line in asked}
    assert all(re.fullmatch(r"udpin:127\.0\.0\.1:\d+ 255/190|mavlink", line["sender"]) for line in asked)
    done = subprocess.run(
        [*HEXJET, "fly", "run/scenario.toml", "--out", "again"], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    again = open_run(tmp_path / "again")
    assert [c for c in run.log.columns if not np.array_equal(run.log[c], again.log[c], equal_nan=True)] == []


def test_the_telemetry_log_holds_what_went_out_and_what_came_in(vehicle: Any, station_at: Any, tmp_path: Path) -> None:
    process, port = vehicle()
    station = station_at(port)
    station.until(Station.ready)
    process.send_signal(signal.SIGTERM)
    process.wait(PATIENCE)
    data = (tmp_path / "run" / "telemetry.tlog").read_bytes()
    parser, at, types, stamps = mav.MAVLink(None), 0, [], []
    while at < len(data):
        stamps.append(struct.unpack_from(">Q", data, at)[0])
        length = 12 + data[at + 9] + (13 if data[at + 10] & 1 else 0)
        (message,) = parser.parse_buffer(data[at + 8 : at + 8 + length])
        types.append((message.get_srcSystem(), message.get_type()))
        at += 8 + length
    assert {(1, "HEARTBEAT"), (1, "ATTITUDE"), (255, "HEARTBEAT")} <= set(types)
    assert stamps == sorted(stamps)
    assert abs(stamps[-1] / 1e6 - time.time()) < PATIENCE


def test_a_reboot_begins_a_new_flight_in_a_new_folder(vehicle: Any, station_at: Any, tmp_path: Path) -> None:
    process, port = vehicle()
    station = station_at(port)
    station.take_off()
    assert station.command(REBOOT, 1.0) != ACCEPTED  # it flies
    station.land()
    before = station.last["SYSTEM_TIME"].time_boot_ms
    result = station.command(REBOOT, 1.0)
    if result == 3:
        pytest.fail("MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN is not supported")
    assert result == ACCEPTED
    station.until(lambda s: (tmp_path / "run-2" / "telemetry.tlog").exists())
    station.until(lambda s: s.last["SYSTEM_TIME"].time_boot_ms < before)
    del station.last["SYS_STATUS"]  # of the flight before, which could be armed
    station.take_off()
    station.land()
    process.send_signal(signal.SIGTERM)
    assert process.wait(PATIENCE) == 0
    assert [open_run(tmp_path / name).outcome for name in ("run", "run-2")] == ["completed", "completed"]


@pytest.mark.long  # test_gcs_conformance.py has a flood too, and two who fly
def test_several_stations_are_served_whatever_one_of_them_does(vehicle: Any, station_at: Any) -> None:
    """One is silent after its first words, one floods; the third flies."""
    process, port = vehicle()
    silent, loud, station = (station_at(port, system) for system in (253, 254, 255))
    silent.read()
    loud.socket.setblocking(False)

    def shout(_: Any = None) -> bool:
        for _ in range(200):
            try:
                loud.send(mav.MAVLink_param_request_list_message(1, 1))
                loud.socket.send(b"\xfd" * 300)
            except BlockingIOError:
                break
        return False

    station.until(lambda s: shout() or s.ready())
    assert station.command(ARM, 1.0) == ACCEPTED
    shout()
    assert station.command(TAKEOFF) == ACCEPTED
    station.until(lambda s: shout() or s.height > 9.0)
    station.land()
    assert process.poll() is None


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--mavlink", "carrier-pigeon:1"], "link 'carrier-pigeon:1'"),
        (["--mavlink", "udpin:0.0.0.0:14555"], "open to the network"),
        (["--personality", "none"], "--personality"),
        (["--sign-key", "no-such-key"], "no-such-key"),
        (["--place", "somewhere"], "--place somewhere"),
        (["--engine", "steam"], "steam"),
        (["--aircraft", "zeppelin"], "zeppelin"),
        (["--duration", "0.0011"], "duration_s"),
        (["--rtf", "-1"], "--rtf"),
        (["--system", "0"], "--system 0: must be from 1 to 250"),
        (["--system", "255"], "--system 255: must be from 1 to 250"),
        (["--system", "two"], "--system"),
    ],
)
def test_wrong_input_is_told_in_one_line(hexjet: Hexjet, arguments: list[str], said: str) -> None:
    if "--mavlink" not in arguments:
        arguments = ["--mavlink", "udpin:127.0.0.1:0", *arguments]
    done = hexjet("gcs", *arguments)
    assert (done.status, done.out) == (2, "")
    assert done.err.count("\n") == 1
    assert said in done.err
    assert not Path("runs").exists()


def test_a_port_in_use_is_told(hexjet: Hexjet) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        url = f"udpin:127.0.0.1:{other.getsockname()[1]}"
        done = hexjet("gcs", "--mavlink", url)
    assert (done.status, done.err.count("\n")) == (2, 1)
    assert url in done.err
    assert not Path("runs").exists()


def test_a_scripted_flight_is_seen_over_mavlink(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.settimeout(PATIENCE)
        url = f"udpout:127.0.0.1:{listening.getsockname()[1]}"
        process = subprocess.Popen(
            [*HEXJET, "fly", "roll-doublet", "--mavlink", url, "--rtf", "4", "--out", "run"],
            stdout=subprocess.DEVNULL,
            cwd=tmp_path,
        )
        parser, rolls = mav.MAVLink(None), []
        parser.robust_parsing = True
        while process.poll() is None:
            listening.settimeout(0.2)
            try:
                data = listening.recv(2048)
            except TimeoutError:
                continue
            rolls += [m.roll for m in parser.parse_buffer(data) or [] if m.get_type() == "ATTITUDE"]
    assert process.returncode == 0
    assert max(rolls) > 0.1
    assert min(rolls) < -0.1
    assert (tmp_path / "run" / "telemetry.tlog").stat().st_size > 1000


def test_a_folder_that_is_refused_is_refused_before_it_says_that_it_is_ready(tmp_path: Path, hexjet: Hexjet) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (run / "summary.json").write_text("{}")
    (tmp_path / "file").write_text("")
    for out, said in ((run, "already holds a run"), (tmp_path / "file", "is a file; hexjet gcs writes a folder")):
        done = hexjet("gcs", "--mavlink", "udpin:127.0.0.1:0", "--out", str(out))
        assert (done.status, done.out) == (2, "")
        assert said in done.err
        assert done.err.count("\n") == 1


def test_a_session_ends_with_a_line_that_tells_how_it_went(vehicle: Any, station_at: Any, tmp_path: Path) -> None:
    """Two flights, a folder beside them that is taken already, frames that were refused, and how to fly it again."""
    (tmp_path / "run-2").mkdir()
    key = tmp_path / "key"
    key.write_text("a pass phrase")
    process, port = vehicle("--sign-key", str(key))
    foe = station_at(port)
    station = station_at(port)
    station.mav.signing.secret_key = sha256(b"a pass phrase").digest()
    station.mav.signing.sign_outgoing = True
    station.mav.signing.timestamp = int((time.time() - 1420070400.0) * 1e5)
    for _ in range(3):
        foe.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
    foe.socket.send(b"\xfd\x01nonsense that is no frame")
    station.until(Station.ready)
    station.until(lambda s: any("frames without a signature refused: 3" in text for text in s.texts))
    assert station.command(REBOOT, 1.0) == ACCEPTED
    station.until(lambda s: "flight 2: hexjet" in s.texts)
    del station.last["SYS_STATUS"]  # of the flight before
    station.take_off()
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=PATIENCE)
    (line,) = [each for each in out.splitlines() if "again: hexjet fly" in each]
    assert out.endswith(f"{line}\n")
    run, later = tmp_path / "run", tmp_path / "run-3"
    told = re.fullmatch(
        r"2 flights, the last completed, nothing checked; stopped by SIGINT in the air; (\d+) of (\d+) steps late "
        r"in all 2 flights; (\d+) frames taken, (\d+) refused \((.*)\); 3 bad signatures; "
        rf"recorded in {run} {later}; again: hexjet fly {later}/scenario.toml",
        line,
    )
    assert told, line
    assert "3 unsigned" in told[5]
    assert int(told[4]) == sum(int(each.split()[0]) for each in told[5].split(", ")) > 3
    assert int(told[3]) > 3
    flown = [open_run(each).summary for each in (run, later)]
    assert int(told[1]) == sum(each.pacing.missed_deadlines for each in flown if each.pacing is not None)
    assert int(told[2]) == sum(each.steps for each in flown)


def test_late_steps_are_said_once() -> None:
    """A flight's own end says them where it came to its planned end; several flights have one number for all."""

    def run(steps: int, late: int, *, told: bool) -> Any:
        ending = f"flew {steps} steps" + (f", {late} of them late" if told else "")
        pacing = SimpleNamespace(missed_deadlines=late)
        summary = SimpleNamespace(ending=ending, steps=steps, pacing=pacing, exceeded=[])
        return SimpleNamespace(summary=summary, folder=Path("runs/one"))

    counts = {"refused": {}, "failures": {}, "taken": 0}
    alone = session_line([run(100, 3, told=True)], counts)
    assert alone.startswith("1 flight, the last flew 100 steps, 3 of them late; 0 frames taken, ")
    assert session_line([run(100, 0, told=False)], counts).startswith(
        "1 flight, the last flew 100 steps; 0 of 100 steps late; "
    )
    assert session_line([run(100, 3, told=True), run(50, 1, told=True)], counts).startswith(
        "2 flights, the last flew 50 steps, 1 of them late; 4 of 150 steps late in all 2 flights; "
    )


@pytest.mark.long
def test_two_vehicles_fly_beside_each_other(vehicle: Any, station_at: Any, tmp_path: Path) -> None:
    """One command for both stations' ports is obeyed by the vehicle whose id it carries, and by no other."""
    both = [vehicle("--system", str(n), "--out", str(tmp_path / f"of{n}")) for n in (1, 2)]
    stations = [station_at(port, target=n) for n, (_, port) in enumerate(both, 1)]
    with ThreadPoolExecutor(2) as pool:  # each is read all the time
        list(pool.map(lambda station: station.until(lambda s: s.ready() and "HEARTBEAT" in s.last), stations))
        for n, station in enumerate(stations, 1):
            assert station.last["HEARTBEAT"].get_srcSystem() == n
        # what is meant for the first is not taken by the second, and not answered
        other = stations[1]
        for number in (ARM, TAKEOFF):
            other.send(mav.MAVLink_command_long_message(1, 1, number, 0, 1.0, *[nan] * 6))
        other.send(mav.MAVLink_ping_message(7, 7, 0, 0))
        other.until(lambda s: "PING" in s.last)
        assert not other.armed
        assert "COMMAND_ACK" not in other.last
        list(pool.map(Station.take_off, stations))
        list(pool.map(Station.land, stations))
    for n, (process, _) in enumerate(both, 1):
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) == 0
        folder = tmp_path / f"of{n}"
        assert open_run(folder).outcome == "completed"
        asked = [json.loads(line)["request"] for line in (folder / "requests.jsonl").read_text().splitlines()]
        assert [asked.count(kind) for kind in ("Arm", "Takeoff", "Land")] == [1, 1, 1]
        data, at, systems = (folder / "telemetry.tlog").read_bytes(), 0, set()
        while at < len(data):
            systems.add(data[at + 8 + 5])
            at += 8 + 12 + data[at + 9]
        assert systems == {n, 255}


def test_sessions_that_begin_at_once_have_a_folder_each(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: reserve_folder(Path("runs"), "gcs-hexjet"), range(24)))
    assert sorted(path.name for path in found) == [f"gcs-hexjet-{n:03d}" for n in range(1, 25)]
    Path("taken").write_text("")
    with pytest.raises(InputError, match="taken"):
        reserve_folder(Path("taken"), "gcs-hexjet")
