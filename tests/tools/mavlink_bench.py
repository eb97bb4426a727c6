"""A ground station made of pymavlink's own classes, and bytes between it and the vehicle's services."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cosim.control.autopilot.requests import Answer, Request, Result
from cosim.groundstation.mavlink.services.logs import DiskFile, LogEntry
from cosim.groundstation.mavlink.services.service import Client
from cosim.groundstation.mavlink.wire.dialect import mav, prepare_message
from cosim.groundstation.mavlink.wire.frames import FramePacker, Parser

TICK = 0.01  # s between two polls


class StandInPeer:
    """The address of a station, as far as services read one."""

    is_behind = False

    def __init__(self, name: str) -> None:
        self.name = name


class Bench:
    """Services with a clock that is counted and a link that loses frames by chance, both ways.

    ``pilot`` answers requests, one tick after they were asked, as the stepping thread does.
    """

    def __init__(self, *services: Any, loss: float = 0.0, seed: int = 1) -> None:
        self.services: list[Any] = list(services)
        self.now = 100.0
        self.loss = loss
        self.chance = random.Random(seed)
        self.stations: list[Station] = []
        self.asked: list[Request] = []
        self.pilot: Callable[[Request], Answer] = lambda request: Answer(True, Result.ACCEPTED, "")
        self._waiting: list[tuple[Request, Callable[[Answer], None]]] = []

    def ask(self, request: Request, done: Callable[[Answer], None], sender: str) -> None:
        assert sender
        self._waiting.append((request, done))

    def station(self, system: int = 255, component: int = 190) -> Station:
        self.stations.append(Station(self, StandInPeer(f"peer{len(self.stations)}"), system, component))
        return self.stations[-1]

    def up(self, station: Station, data: bytes) -> None:
        """A frame from a station."""
        if self.chance.random() < self.loss:
            return
        for frame in station.vehicle_parser.feed(data):
            message = frame.message
            client = Client(station.peer, frame.system, frame.component)
            for service in self.services:
                if message.msgname in service.handles:
                    for answer in service.handle(message, client, self.now):
                        station.down(answer)

    def tick(self, seconds: float = TICK) -> None:
        for _ in range(max(1, round(seconds / TICK))):
            self.now += TICK
            waiting, self._waiting = self._waiting, []
            for request, done in waiting:
                self.asked.append(request)
                done(self.pilot(request))
            for service in self.services:
                for peer, message in service.poll(self.now):
                    for station in self.stations:
                        if peer is None or peer == station.peer:
                            station.down(message)


class Station:
    """A ground station: pymavlink's packer and parser."""

    def __init__(self, bench: Bench, peer: Any, system: int, component: int) -> None:
        self.bench, self.peer = bench, peer
        self.mav: Any = mav.MAVLink(None, srcSystem=system, srcComponent=component)
        self.mav.robust_parsing = True
        self.inbox: list[Any] = []
        self.counts: Counter[str] = Counter()
        self.vehicle_sender = FramePacker(1)
        self.vehicle_parser = Parser(Counter(), is_datagram=True)

    def send(self, kind: str, *values: Any) -> None:
        message = getattr(mav, f"MAVLink_{kind.lower()}_message")(*values)
        self.bench.up(self, message.pack(self.mav))

    def down(self, message: Any) -> None:
        """A message of the vehicle, as bytes."""
        data = self.vehicle_sender.pack_frame(prepare_message(message))
        if self.bench.chance.random() < self.bench.loss:
            return
        for found in self.mav.parse_buffer(data) or []:
            assert found.get_type() != "BAD_DATA"
            self.counts[found.get_type()] += 1
            self.inbox.append(found)

    def take(self, *kinds: str) -> list[Any]:
        """Everything of these kinds that has come, and forget it."""
        found = [m for m in self.inbox if not kinds or m.get_type() in kinds]
        self.inbox = [m for m in self.inbox if kinds and m.get_type() not in kinds]
        return found

    def wait(self, *kinds: str, seconds: float = 1.0, match: Callable[[Any], bool] = lambda m: True) -> Any:
        """The first message of these kinds; None if none comes in time."""
        for _ in range(round(seconds / TICK) + 1):
            for place, message in enumerate(self.inbox):
                if message.get_type() in kinds and match(message):
                    del self.inbox[place]
                    return message
            self.bench.tick()
        return None

    def insist(
        self, send: tuple[Any, ...], *kinds: str, match: Callable[[Any], bool] = lambda m: True, tries: int = 20
    ) -> Any:
        """Send again every half second until an answer comes."""
        for _ in range(tries):
            self.send(*send)
            answer = self.wait(*kinds, seconds=0.5, match=match)
            if answer is not None:
                return answer
        raise AssertionError(f"no {kinds} after {tries} of {send}")


def refuse(text: str, result: Result = Result.DENIED) -> Answer:
    return Answer(False, result, text)


class ReadyStore:
    """A store whose logs are there, for a LogService."""

    is_converting = is_searching = False

    def __init__(self, *paths: Path) -> None:
        self.logs = [LogEntry(number, path, 1, DiskFile(path)) for number, path in enumerate(paths)]

    def search(self, now: float) -> None: ...

    def poll(self, now: float) -> None: ...
