"""MAVProxy, run as a program of its own, flies ``hexjet gcs``: typed commands in, its console and both logs out."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from gcs_tools import LOOPBACK, VehicleProcess
from patience import FLIGHT_PATIENCE, PATIENCE

from cosim import fly
from cosim.control.autopilot import requests as rq
from cosim.results.autopilot.request_log import read_requests
from cosim.results.run import REQUESTS, open_run

MAVPROXY = Path(sys.executable).parent / "mavproxy.py"
MODULES = (
    "log,signing,wp,rally,fence,ftp,param,relay,tuneopt,arm,mode,calibration,rc,auxopt,misc,cmdlong,battery,output"
)
RTF = 6.0


def mavlogdump(path: Path, types: Sequence[str] = ()) -> str:
    """What pymavlink's own tool reads from a telemetry log."""
    tool = Path(sys.executable).parent / "mavlogdump.py"
    command = [sys.executable, str(tool), "--robust"]
    if types:
        command.append(f"--types={','.join(types)}")
    done = subprocess.run([*command, str(path)], capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    return done.stdout


class MavProxy:
    """The program, its standard input and what it has said so far."""

    def __init__(self, port: int, folder: Path) -> None:
        self.log = folder / "mav.tlog"
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-u",
                str(MAVPROXY),
                f"--master=udpout:{LOOPBACK}:{port}",
                f"--state-basedir={folder}",
                f"--logfile={self.log}",
                f"--default-modules={MODULES}",
            ],
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
        self.said = ""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        while text := self.process.stdout.read(1):
            self.said += text

    def type(self, line: str) -> int:
        """Type a line; how much it had said by then."""
        assert self.process.stdin is not None
        before = len(self.said)
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        return before

    def until(self, pattern: str, since: int = 0, seconds: float = FLIGHT_PATIENCE) -> None:
        end = time.monotonic() + seconds
        while not re.search(pattern, self.said[since:]):
            assert time.monotonic() < end, f"MAVProxy did not say {pattern!r}:\n{self.said}"
            assert self.process.poll() is None, self.said
            time.sleep(0.02)

    def insist(self, line: str, pattern: str) -> None:
        """Type a line again every second until it is answered as wanted."""
        since = len(self.said)
        for _ in range(20):
            self.type(line)
            with suppress(AssertionError):
                self.until(pattern, since, 1.0)
                return
        raise AssertionError(f"MAVProxy did not say {pattern!r}:\n{self.said}")

    def close(self) -> None:
        """May be called twice."""
        if self.process.poll() is None:
            assert self.process.stdin is not None
            self.process.stdin.close()  # its way to end
            try:
                self.process.wait(5.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._reader.join()
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()


@pytest.fixture
def both(tmp_path: Path) -> Iterator[tuple[VehicleProcess, MavProxy]]:
    vehicle = VehicleProcess(tmp_path, RTF)
    proxy = MavProxy(vehicle.port, tmp_path)
    yield vehicle, proxy
    proxy.close()
    vehicle.kill()


def test_connect_parameters_arm_take_off_land_and_logs(both: tuple[VehicleProcess, MavProxy], tmp_path: Path) -> None:
    vehicle, proxy = both
    proxy.until(r"Detected vehicle 1:1")
    proxy.until(r"Received \d+ parameters")
    found = re.search(r"Received (\d+) parameters", proxy.said)
    assert found is not None
    assert int(found[1]) >= 60

    since = proxy.type("param show MPC_XY_VEL_MAX")
    proxy.until(r"MPC_XY_VEL_MAX +\d", since)
    proxy.type("param set MPC_XY_VEL_MAX 3.5")
    proxy.insist("param fetch MPC_XY_VEL_MAX", r"MPC_XY_VEL_MAX = 3\.5")

    since = proxy.type("arm throttle")
    proxy.until(r"\bARMED", since)
    since = proxy.type("takeoff 10")
    proxy.until(r"take-off complete", since)
    since = proxy.type("long DO_SET_MODE 209 3 0")
    proxy.until(r"POSCTL needs sticks", since)  # it flies, and nobody holds any
    since = proxy.type("long DO_SET_MODE 209 4 6")
    proxy.until(r"LAND", since)
    proxy.until(r"DISARMED", since)
    proxy.close()
    (summary,) = vehicle.stop()
    assert (summary["outcome"], summary["reason"]) == ("completed", "stopped by SIGINT")

    entries = read_requests(vehicle.folder / REQUESTS)
    flown = [entry.request for entry in entries if not isinstance(entry.request, (rq.LinkLost, rq.LinkBack))]
    assert flown == [
        rq.SetParameter("MPC_XY_VEL_MAX", 3.5),
        rq.Arm(),
        flown[2],
        rq.SetMode("POSCTL"),
        rq.SetMode("LAND"),
    ]
    takeoff = flown[2]
    assert isinstance(takeoff, rq.Takeoff)
    assert takeoff.altitude_m == pytest.approx(10.0, abs=0.5)  # above the sea, which is the ground here

    # without a ground station it is the same flight
    run = open_run(vehicle.folder)
    again = fly(vehicle.folder / "scenario.toml", report=False)
    assert [c for c in run.log.columns if not np.array_equal(run.log[c], again.log[c], equal_nan=True)] == []

    # both logs, by a reader that is not ours
    for log in (proxy.log, vehicle.folder / "telemetry.tlog"):
        text = mavlogdump(log, ["HEARTBEAT", "GLOBAL_POSITION_INT", "COMMAND_LONG", "COMMAND_ACK"])
        heights = [int(height) / 1000.0 for height in re.findall(r"relative_alt : (-?\d+)", text)]
        assert max(heights) == pytest.approx(10.0, abs=0.7), log
        assert re.search(r"COMMAND_LONG.*command : 400", text), log
        assert re.search(r"COMMAND_ACK.*command : 22, result : 0", text), log
        assert "BAD_DATA" not in text
