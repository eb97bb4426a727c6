"""A person at a ground station in the same process, and a session that such a one flies."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from patience import PATIENCE

from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.modes import Mode
from cosim.control.autopilot.requests import Answer
from cosim.groundstation.exchange import Exchange, Snapshot
from cosim.groundstation.session import RecordOptions, Session
from cosim.spec.scenario import Scenario


class Pilot:
    """A person at a ground station, in a thread of their own, who never waits for the wall clock."""

    def __init__(self, exchange: Exchange, name: str = "test") -> None:
        self.exchange, self.name = exchange, name
        self._news = threading.Event()
        exchange.subscribe(self._news.set)

    def ask(self, request: Any) -> Answer:
        got: list[Answer] = []
        here = threading.Event()
        self.exchange.ask(request, lambda answer: (got.append(answer), here.set())[0], self.name)
        assert here.wait(PATIENCE), request
        return got[0]

    def ok(self, *requests: Any) -> None:
        for request in requests:
            answer = self.ask(request)
            assert answer.accepted, (request, answer)

    def until(self, true: Callable[[Snapshot], bool]) -> Snapshot:
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            snapshot = self.exchange.snapshot
            if snapshot is not None and true(snapshot):
                return snapshot
            self._news.wait(0.1)
            self._news.clear()
        last = self.exchange.snapshot
        raise AssertionError(f"not in time: {last and last.status}, {self.exchange.messages[-5:]}")

    def take_off(self, height: float) -> None:
        self.until(lambda s: s.status.ready)
        self.ok(rq.Arm(), rq.Takeoff(height))
        self.until(lambda s: s.status.mode is Mode.HOLD and s.measured.altitude > height - 1.0)

    def land(self) -> None:
        self.ok(rq.Land())
        self.until(lambda s: not s.status.armed)


def flown(folder: Path, script: Callable[[Pilot, Session], None], **options: Any) -> Session:
    """A session that flies a script as fast as it goes, and stops."""
    scenario = options.pop("scenario", Scenario.load("hover").replace(name="gcs"))
    judge = options.pop("judge", None)
    session = Session(scenario, Exchange(), factor=None, records=RecordOptions(folder, report=False), **options)
    if judge is not None:
        session.set_stability_checker(judge)
    failed: list[BaseException] = []

    def run() -> None:
        try:
            script(Pilot(session.exchange), session)
        except BaseException as error:
            failed.append(error)
        finally:
            session.stop("the script is over")

    thread = threading.Thread(target=run)
    thread.start()
    session.run()
    thread.join()
    if failed:
        raise failed[0]
    return session
