"""Stand-ins for autopilots, written from their protocols and sharing nothing with what they talk to.

Each runs in a thread of its own, says what it was told, and does wrong what it is asked to do wrong.
"""

from __future__ import annotations

import json
import re
import socket
import struct
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
from patience import PATIENCE

from cosim.groundstation.mavlink.wire.dialect import mav

Pulses = Callable[[dict[str, object]], Sequence[int]]
_NUMBER = r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?"


def free_port() -> int:
    """One that is free, low enough for the others behind it."""
    while True:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
            asked.bind(("127.0.0.1", 0))
            port = int(asked.getsockname()[1])
        if port < 65000:
            return port


def free_instance(instances: range, port: int, apart: int, kind: socket.SocketKind) -> int:
    """An instance whose port is free."""
    for instance in np.random.default_rng().permutation(list(instances)):
        with socket.socket(socket.AF_INET, kind) as asked:
            try:
                asked.bind(("127.0.0.1", port + apart * int(instance)))
            except OSError:
                continue
            return int(instance)
    raise AssertionError("no port is free")


class ArduPilotStandIn:
    """ArduPilot's side of the JSON backend, as ``SIM_JSON.cpp`` has it: sends, stands still, looks for keys by their text.

    ``lose``: numbers of the answers that never arrive; ``twice``: of the packets that are sent twice; ``late``: of those
    after which the one before comes once more; ``hang``: of the packet after which nothing comes; ``skip``: of one
    that is left out.
    """

    def __init__(
        self,
        port: int,
        rate: int = 250,
        lose: Sequence[int] = (),
        twice: Sequence[int] = (),
        late: Sequence[int] = (),
        hang: int | None = None,
        skip: int | None = None,
        channels: int = 16,
        pulses: Pulses | None = None,
        waits: float = 0.2,
    ) -> None:
        self.waits = waits  # s for an answer, before it sends again; a second in ArduPilot
        self.stale = 0
        self.port, self.rate = port, rate
        self.lose, self.twice, self.late = set(lose), set(twice), set(late)
        self.hang, self.skip, self.channels = hang, skip, channels
        self.pulses = pulses or (lambda told: [1500] * channels)
        self.times: list[float] = []  # of the answers it took
        self.told: dict[str, object] = {}
        self.wrong: list[str] = []
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self._over = threading.Event()
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def slid(self) -> int:
        """Its frame rate: 1200 at first, whatever it is set to, then one a frame towards that."""
        return max(self.rate, 1200 - len(self.times))

    def _packet(self, count: int) -> bytes:
        magic = 18458 if self.channels == 16 else 29569
        return struct.pack(f"<HHI{self.channels}H", magic, self.slid(), count, *self.pulses(self.told)[: self.channels])

    def _run(self) -> None:
        count, sent, before, to = 0, 0, b"", ("127.0.0.1", self.port)
        while not self._over.is_set():
            packet = self._packet(count)
            for _ in range(2 if sent in self.twice else 1):
                self.socket.sendto(packet, to)
            if sent in self.late and before:
                self.socket.sendto(before, to)
            if sent == self.hang:
                return
            answer = None
            while answer is None and not self._over.is_set():
                self.socket.settimeout(self.waits)
                try:
                    answer = self.socket.recv(4096)
                except TimeoutError:
                    self.socket.sendto(packet, to)
                    continue
                if self._over.is_set():
                    return
                if sent in self.lose:
                    self.lose.discard(sent)
                    answer = None
                    continue
                time = self._parsed(answer)
                if self.times and time <= self.times[-1]:  # ArduPilot would be a step late from here on
                    self.stale += 1
                    answer = None
            if answer is None:
                return
            self.times.append(time)
            before, sent, count = packet, sent + 1, count + 1
            if sent == self.skip:
                count += 1

    def _parsed(self, answer: bytes) -> float:
        """By keys and ``sscanf("[%f, %f, %f]")`` right behind them, as it does, and as JSON besides."""
        text = answer.decode()
        if not (text.startswith("\n") and text.endswith("\n")):
            self.wrong.append("no end of line")
        for key, numbers in (("gyro", 3), ("accel_body", 3), ("position", 3), ("velocity", 3), ("quaternion", 4)):
            if not re.search(rf'"{key}":\[{", ".join([_NUMBER] * numbers)}\]', text):
                self.wrong.append(f"{key} cannot be read in {text!r}")
        self.told = json.loads(text)
        return float(self.told["timestamp"])  # type: ignore[arg-type]

    def close(self) -> None:
        """It ends."""
        self._over.set()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as waking:
            waking.sendto(b"over", self.socket.getsockname())
        self.thread.join(5.0)
        self.socket.close()


class Px4StandIn:
    """PX4's side of its simulator link, by pymavlink: a client of TCP that answers each HIL_SENSOR with its actuators.

    ``boot``: so many sensor frames pass before its first answer; ``twice``: numbers of the answers that come twice;
    ``late``: of those after which the one before comes once more; ``hang``: of the frame that it answers no more; ``gone``:
    of the one at which it closes; ``ahead``: of the one whose answer has another time.
    """

    def __init__(
        self,
        port: int,
        boot: int = 10,
        twice: Sequence[int] = (),
        late: Sequence[int] = (),
        hang: int | None = None,
        gone: int | None = None,
        ahead: int | None = None,
        controls: Callable[[dict[str, object]], Sequence[float]] | None = None,
    ) -> None:
        self.boot, self.twice, self.late = boot, set(twice), set(late)
        self.hang, self.gone, self.ahead = hang, gone, ahead
        self.controls = controls or (lambda told: [0.5] * 16)
        self.port = port
        self.times: list[int] = []
        self.seen: dict[str, int] = {}
        self.told: dict[str, object] = {}
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        with suppress(OSError):
            self._fly()

    def _connected(self) -> socket.socket:
        while True:
            try:
                return socket.create_connection(("127.0.0.1", self.port), PATIENCE)
            except ConnectionRefusedError:
                threading.Event().wait(0.01)

    def _fly(self) -> None:
        link = mav.MAVLink(None, srcSystem=1, srcComponent=1)
        with self._connected() as connected:
            connected.sendall(link.heartbeat_encode(2, 12, 0, 0, 0).pack(link))
            before = b""
            while data := connected.recv(65536):
                for message in link.parse_buffer(data) or []:
                    kind = message.get_type()
                    self.seen[kind] = self.seen.get(kind, 0) + 1
                    self.told[kind] = message
                    if kind != "HIL_SENSOR":
                        continue
                    number = len(self.times)
                    self.times.append(message.time_usec)
                    if self.hang is not None and number >= self.hang:
                        continue
                    if number == self.gone:
                        return
                    if number < self.boot:
                        continue
                    when = message.time_usec + (1_000_000 if number == self.ahead else 0)
                    answer = link.hil_actuator_controls_encode(when, list(self.controls(self.told)), 129, 1).pack(link)
                    connected.sendall(answer * (2 if number in self.twice else 1))
                    if number in self.late and before:
                        connected.sendall(before)
                    before = answer
