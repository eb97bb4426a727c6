"""``hexjet gcs`` as a process, a ground station on a socket of its own, and a link between the two that loses frames."""

from __future__ import annotations

import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from patience import PATIENCE, stretched

from cosim.groundstation.mavlink.wire.dialect import mav

HEXJET = [sys.executable, "-c", "from cosim.cli.main import main; main()"]
LOOPBACK = "127.0.0.1"


class VehicleProcess:
    """``hexjet gcs`` on UDP ports of its own, one for each of ``servers``, in a run's folder in ``folder``.

    ``rtf``: of real time.  The process is ended by its id, whatever happens in between.
    """

    def __init__(self, folder: Path, rtf: float, *arguments: str, servers: int = 1) -> None:
        self.folder = folder / "run"
        self._errors = folder / "stderr.txt"
        links = [f"--mavlink=udpin:{LOOPBACK}:0"] * servers
        command = [*HEXJET, "gcs", *links, "--params=none", f"--rtf={rtf:g}", f"--out={self.folder}", "--json"]
        # the parent's copy of the file is closed again; the child's is read while it is written
        with self._errors.open("wb") as errors:
            self.process = subprocess.Popen(
                [*command, *arguments], cwd=folder, stdout=subprocess.PIPE, stderr=errors, stdin=subprocess.DEVNULL
            )
        self.ports = self._ports(servers)

    @property
    def port(self) -> int:
        """Of the first server."""
        return self.ports[0]

    @property
    def said(self) -> str:
        """What came on standard error."""
        return self._errors.read_text(errors="replace")

    def _ports(self, count: int) -> list[int]:
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            found = re.findall(r"listens at udp \S*:(\d+)", self.said)
            if len(found) == count and "ready" in self.said:
                return [int(port) for port in found]
            if self.process.poll() is not None:
                break
            time.sleep(0.02)
        self.kill()
        raise AssertionError(f"no vehicle: {self.said}")

    def stop(self, patience: float = PATIENCE) -> list[dict[str, Any]]:
        """Ctrl-C; the summaries of its runs."""
        self.process.send_signal(signal.SIGINT)
        try:
            out, _ = self.process.communicate(timeout=patience)
        except subprocess.TimeoutExpired:
            self.kill()
            raise
        assert "Traceback" not in self.said, self.said
        runs: list[dict[str, Any]] = json.loads(out)["runs"]
        return runs

    def kill(self) -> None:
        """End it at once; may be called when it has ended."""
        if self.process.poll() is None:
            os.kill(self.process.pid, signal.SIGKILL)
        self.process.communicate()


def until(true: Callable[[], Any], seconds: float, what: str) -> Any:
    """Wait for something to become true; what it became."""
    end = time.monotonic() + stretched(seconds)
    while True:
        found = true()
        if found:
            return found
        if time.monotonic() > end:
            raise AssertionError(f"not within {seconds:g} s: {what}")
        time.sleep(0.01)


class Station:
    """A ground station on a UDP socket: pymavlink's packer and parser, a heartbeat a second, in a thread."""

    def __init__(self, port: int, system: int = 255, component: int = 190, talks: bool = True) -> None:
        self.target = (system, component)
        self.mav: Any = mav.MAVLink(None, srcSystem=system, srcComponent=component)
        self.mav.robust_parsing = True
        self.to = (LOOPBACK, port)
        self.counts: Counter[str] = Counter()
        self.last: dict[str, Any] = {}
        self._talks = talks
        self._inbox: list[Any] = []
        self._news = threading.Condition()
        self._sending = threading.Lock()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((LOOPBACK, 0))
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self._socket.close()

    def __enter__(self) -> Station:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def speak(self) -> None:
        """Send heartbeats from now on."""
        self._talks = True

    def sign(self, key: bytes) -> None:
        """Sign everything from here on."""
        signing = self.mav.signing
        signing.secret_key, signing.link_id, signing.sign_outgoing = key, 1, True
        signing.timestamp = int((time.time() - 1420070400) * 1e5)  # 10 us since 2015

    def send(self, kind: str, *values: Any) -> bytes:
        """A message; the frame that it became."""
        message = getattr(mav, f"MAVLink_{kind.lower()}_message")(*values)
        with self._sending:  # a sequence number is used once
            data = bytes(message.pack(self.mav))
            self.mav.seq = (self.mav.seq + 1) % 256
            self._socket.sendto(data, self.to)
        return data

    def raw(self, data: bytes) -> None:
        self._socket.sendto(data, self.to)

    def long(self, number: int, *params: float, confirmation: int = 0) -> None:
        """COMMAND_LONG; what is not given is 0."""
        self.send("COMMAND_LONG", 1, 1, number, confirmation, *params, *[0.0] * (7 - len(params)))

    def command(self, number: int, *params: float, seconds: float = 3.0) -> int:
        """COMMAND_LONG, and the result of its acknowledgement; -1 if none comes."""
        self.take("COMMAND_ACK")
        self.long(number, *params)
        ack = self.wait("COMMAND_ACK", seconds=seconds, match=lambda m: m.command == number)
        return -1 if ack is None else int(ack.result)

    def take(self, *kinds: str) -> list[Any]:
        """Everything of these kinds (of any, without) that has come since, and forget it."""
        with self._news:
            found = [m for m in self._inbox if not kinds or m.get_type() in kinds]
            self._inbox = [m for m in self._inbox if m not in found]
        return found

    def wait(self, *kinds: str, seconds: float, match: Callable[[Any], bool] = lambda m: True) -> Any:
        """The first message of these kinds that has come or comes in time; else None."""
        end = time.monotonic() + stretched(seconds)
        with self._news:
            while True:
                for i, message in enumerate(self._inbox):
                    if message.get_type() in kinds and match(message):
                        return self._inbox.pop(i)
                left = end - time.monotonic()
                if left <= 0.0:
                    return None
                self._news.wait(left)

    def now(self, kind: str) -> Any:
        """The last message of a kind, however long ago; None before the first."""
        with self._news:
            return self.last.get(kind)

    def until(self, kind: str, true: Callable[[Any], bool], seconds: float) -> Any:
        """The last message of a kind, once it is as wanted."""
        end = time.monotonic() + stretched(seconds)
        with self._news:
            while True:
                message = self.last.get(kind)
                if message is not None and true(message):
                    return message
                left = end - time.monotonic()
                if left <= 0.0:
                    texts = [m.text for m in self._inbox if m.get_type() == "STATUSTEXT"]
                    raise AssertionError(f"not within {seconds:g} s; the last {kind} is {message}; texts {texts}")
                self._news.wait(left)

    @property
    def armed(self) -> bool:
        beat = self.now("HEARTBEAT")
        return beat is not None and bool(beat.base_mode & 128)

    @property
    def mode(self) -> tuple[int, int]:
        """PX4's main and sub mode."""
        number = self.now("HEARTBEAT").custom_mode
        return number >> 16 & 0xFF, number >> 24

    def texts(self) -> list[str]:
        """Status texts that have come since."""
        return [message.text for message in self.take("STATUSTEXT")]

    def _run(self) -> None:
        beat = 0.0
        while not self._over.is_set():
            now = time.monotonic()
            if self._talks and now >= beat:
                beat = now + 1.0
                self.send("HEARTBEAT", 6, 8, 0, 0, 4, 3)
            if not select.select([self._socket], [], [], 0.05)[0]:
                continue
            try:
                data = self._socket.recv(2048)
            except OSError:  # nobody listens any more
                continue
            found = self.mav.parse_buffer(data) or []
            with self._news:
                for message in found:
                    kind = message.get_type()
                    self.counts[kind] += 1
                    self.last[kind] = message
                    # what comes all the time is kept once
                    if kind in _KEPT:
                        self._inbox.append(message)
                self._news.notify_all()


_KEPT = frozenset((
    "AUTOPILOT_VERSION", "AVAILABLE_MODES", "BAD_DATA", "COMMAND_ACK", "COMPONENT_METADATA",
    "FILE_TRANSFER_PROTOCOL", "HOME_POSITION", "LOG_DATA", "LOG_ENTRY", "MESSAGE_INTERVAL", "MISSION_ACK",
    "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_REQUEST_INT", "PARAM_ERROR", "PARAM_VALUE", "PING", "STATUSTEXT",
    "TIMESYNC",
))  # fmt: skip
