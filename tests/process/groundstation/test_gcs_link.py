"""``hexjet gcs`` as a process, flown over MAVLink on the loopback interface."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from math import nan
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from command_tools import Hexjet
from gcs_tools import HEXJET, Station, VehicleProcess
from patience import FLIGHT_PATIENCE, PATIENCE

from cosim.base.errors import InputError
from cosim.cli.calls.gcs import describe_session
from cosim.flight import reserve_folder
from cosim.groundstation.mavlink.wire.dialect import mav
from cosim.groundstation.mavlink.wire.signing import read_key
from cosim.results.run import open_run

LINK = ("--mavlink", "udpin:127.0.0.1:0", "--params", "none")
TAKEOFF, ARM, REBOOT = 22, 400, 246


@pytest.fixture
def vehicle(tmp_path: Path) -> Iterator[Callable[..., VehicleProcess]]:
    """Starts vehicles at ten times real time, and ends what the test has left."""
    started: list[VehicleProcess] = []

    def start(folder: Path, *arguments: str) -> VehicleProcess:
        folder.mkdir(exist_ok=True)
        started.append(VehicleProcess(folder, 10.0, *arguments))
        return started[-1]

    yield start
    for process in started:
        process.kill()


def is_ready(station: Station) -> None:
    """Wait until it may be armed."""
    station.until("SYS_STATUS", lambda m: bool(m.onboard_control_sensors_health & 1 << 28), FLIGHT_PATIENCE)


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


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--mavlink", "carrier-pigeon:1"], "link 'carrier-pigeon:1'"),
        (["--mavlink", "udpin:0.0.0.0:14555"], "open to the network"),
        (["--personality", "none"], "--personality"),
        (["--sign-key", "no-such-key"], "no-such-key"),
        (["--place", "somewhere"], "place somewhere"),
        (["--duration", "0.0011"], "duration_s"),
        (["--rtf", "-1"], "--rtf"),
        (["--system", "0"], "system 0: must be from 1 to 250"),
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


def test_a_session_ends_with_a_line_that_tells_how_it_went(vehicle: Any, tmp_path: Path) -> None:
    """Two flights, a folder beside them that is taken already, frames that were refused, and how to fly it again."""
    (tmp_path / "run-2").mkdir()
    key = tmp_path / "key"
    key.write_text("a pass phrase")
    gcs = vehicle(tmp_path, "--sign-key", str(key))
    with Station(gcs.port, talks=False) as foe, Station(gcs.port, talks=False) as station:
        station.sign(read_key(key))
        for _ in range(3):
            foe.send("HEARTBEAT", 6, 8, 0, 0, 0, 3)
        foe.raw(b"\xfd\x01nonsense that is no frame")
        station.speak()
        is_ready(station)
        texts = station.texts()
        while not any("frames without a signature refused: 3" in text for text in texts):
            texts.append(station.wait("STATUSTEXT", seconds=PATIENCE).text)
        assert station.command(REBOOT, 1.0) == 0
        while station.wait("STATUSTEXT", seconds=PATIENCE).text != "flight 2: hexjet":
            continue
        station.last.pop("SYS_STATUS", None)  # of the flight before
        is_ready(station)
        assert station.command(ARM, 1.0) == 0
        assert station.command(TAKEOFF, *[nan] * 7) == 0
        station.until("GLOBAL_POSITION_INT", lambda m: m.relative_alt > 9000, FLIGHT_PATIENCE)
    gcs.process.send_signal(signal.SIGINT)
    out, _ = gcs.process.communicate(timeout=PATIENCE)
    run, later = tmp_path / "run", tmp_path / "run-3"
    line = describe_session([open_run(each) for each in (run, later)], json.loads(out)["links"])
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
    alone = describe_session([run(100, 3, told=True)], counts)
    assert alone.startswith("1 flight, the last flew 100 steps, 3 of them late; 0 frames taken, ")
    assert describe_session([run(100, 0, told=False)], counts).startswith(
        "1 flight, the last flew 100 steps; 0 of 100 steps late; "
    )
    assert describe_session([run(100, 3, told=True), run(50, 1, told=True)], counts).startswith(
        "2 flights, the last flew 50 steps, 1 of them late; 4 of 150 steps late in all 2 flights; "
    )


def test_of_two_vehicles_each_obeys_the_commands_of_its_own_id(vehicle: Any, tmp_path: Path) -> None:
    both = [vehicle(tmp_path / f"of{n}", "--system", str(n)) for n in (1, 2)]
    with Station(both[0].port) as first, Station(both[1].port) as second:
        for n, station in enumerate((first, second), 1):
            is_ready(station)
            assert station.until("HEARTBEAT", lambda _: True, PATIENCE).get_srcSystem() == n
        # what is meant for the first is not taken by the second, and not answered
        second.long(ARM, 1.0)
        second.send("PING", 7, 7, 0, 0)
        assert second.wait("PING", seconds=PATIENCE)
        assert second.take("COMMAND_ACK") == []
        assert first.command(ARM, 1.0) == 0
        first.until("HEARTBEAT", lambda _: first.armed, FLIGHT_PATIENCE)
        assert not second.armed
    for n, process in enumerate(both, 1):
        process.stop()
        data, at, systems = (process.folder / "telemetry.tlog").read_bytes(), 0, set()
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
