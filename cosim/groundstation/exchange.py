"""Between the flight and those who watch it or ask something of it: ground stations, the local page, a test.

The flight publishes what it is at; the last one wins, and nobody who is slow holds it up.  Requests wait in one short
queue per sender, the senders take turns, and a queue that is full answers at once.  Everything here may be called from
any thread and returns at once; no sockets, no files.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from threading import Lock
from typing import NamedTuple

from cosim.base.geodesy import Geodesy
from cosim.base.protocols import Diagnostics
from cosim.base.signals import Measured, Sample, State
from cosim.control.autopilot.modes import Message, Severity
from cosim.control.autopilot.parameters import Parameters
from cosim.control.autopilot.requests import (
    Answer,
    MissionItem,
    OffboardAttitude,
    OffboardPosition,
    OffboardVelocity,
    Request,
    Result,
    Sticks,
)
from cosim.control.autopilot.status import Status
from cosim.engine import EngineSpec
from cosim.simulation.ending import Ending
from cosim.simulation.pacing import PaceReport
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle

WAITING_EACH = 64  # requests of one sender that may wait; a mission is one.  Chosen by us: a quarter second of steps
SENDERS = 32  # that may have something waiting at once
KEPT_MESSAGES = 100
_NOTHING: Diagnostics = (nan, nan, nan)

# what is sent again and again: only the last one counts
_STREAMS = (Sticks, OffboardAttitude, OffboardVelocity, OffboardPosition)


@dataclass(frozen=True)
class Restart:
    """End this flight and begin a new one on the ground; refused while it flies."""


@dataclass(frozen=True)
class Shutdown:
    """End the session; refused while it flies."""


Asked = Request | Restart | Shutdown
Done = Callable[[Answer], None]


class Facts(NamedTuple):
    """What does not change during one flight."""

    number: int  # flights of this session, from 1
    scenario: Scenario
    vehicle: Vehicle
    stations: tuple[EngineSpec, ...]  # jets 1 to 6
    geodesy: Geodesy  # where the flight's origin is
    parameters: Parameters  # to be read; changed by SetParameter alone
    folder: Path | None  # the run's
    factor: float | None  # of real time; None: as fast as it goes


class Snapshot(NamedTuple):
    """The flight after one step."""

    published: float  # time.monotonic() [s]
    facts: Facts
    k: int  # steps done; the state is that of k dt
    time: float  # k dt [s]
    sample: Sample | None  # the step that led here; None before the first
    state: State  # true
    measured: Measured  # what the controller will be told
    status: Status
    pace: PaceReport
    ending: Ending | None  # once the flight is over
    mission: tuple[MissionItem, ...]
    diagnostics: tuple[Diagnostics, Diagnostics, Diagnostics]  # of the predictors of roll, pitch and yaw


class _Waiting(NamedTuple):
    request: Asked
    done: Done | None
    until: float


class Exchange:
    """One session's meeting place."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._queues: dict[str, deque[_Waiting]] = {}
        self._snapshot: Snapshot | None = None
        self._messages: tuple[Message, ...] = ()
        self._said = 0
        self._wakers: tuple[Callable[[], None], ...] = ()
        self.turned_away = 0  # requests for which there was no room

    # --- for those who watch -------------------------------------------------------------------------------------

    @property
    def snapshot(self) -> Snapshot | None:
        """The last one published; None before the first."""
        return self._snapshot

    @property
    def messages(self) -> tuple[Message, ...]:
        """The last lines for the people on the ground, numbered from 1 through the whole session."""
        return self._messages

    def subscribe(self, wake: Callable[[], None]) -> Callable[[], None]:
        """Call ``wake`` in the flight's thread whenever there is news; it must return at once.  Gives what ends it."""
        with self._lock:
            self._wakers = (*self._wakers, wake)

        def leave() -> None:
            with self._lock:
                self._wakers = tuple(each for each in self._wakers if each is not wake)

        return leave

    # --- for those who ask ---------------------------------------------------------------------------------------

    def ask(self, request: Asked, done: Done | None = None, sender: str = "", until: float = inf) -> None:
        """Ask something of the vehicle; it is handled before the next step.

        ``done`` gets the answer once, in the flight's thread, or at once in this one if there is no room; it must
        return quickly.  ``sender`` goes to the log.  A request that is not taken ``until`` then [s, time.monotonic] is
        not done any more: who asked has been told so.
        """
        dropped: _Waiting | None = None
        with self._lock:
            queue = self._queues.get(sender)
            full = queue is None and len(self._queues) >= SENDERS
            if queue is None and not full:
                queue = self._queues[sender] = deque()
            if queue is not None:
                if isinstance(request, _STREAMS) and queue and type(queue[-1].request) is type(request):
                    dropped = queue.pop()
                full = len(queue) >= WAITING_EACH
                if not full:
                    queue.append(_Waiting(request, done, until))
            if full:
                self.turned_away += 1
        if dropped is not None and dropped.done is not None:
            dropped.done(Answer(True, Result.ACCEPTED, "followed by a newer one"))
        if full and done is not None:
            done(Answer(False, Result.TEMPORARILY_REJECTED, "too many requests"))

    # --- for the flight ------------------------------------------------------------------------------------------

    @property
    def waiting(self) -> int:
        """Requests that wait now."""
        with self._lock:
            return sum(len(queue) for queue in self._queues.values())

    def take(self, most: int) -> list[tuple[str, Asked, Done | None]]:
        """The next requests, at most so many, one sender after the other."""
        if not self._queues:
            return []
        taken: list[tuple[str, Asked, Done | None]] = []
        late: list[Done] = []
        now = time.monotonic()
        with self._lock:
            while self._queues and len(taken) < most:
                # the first sender gives one and goes to the end of the row
                sender = next(iter(self._queues))
                queue = self._queues.pop(sender)
                request, done, until = queue.popleft()
                if now <= until:
                    taken.append((sender, request, done))
                elif done is not None:
                    late.append(done)
                if queue:
                    self._queues[sender] = queue
        for done in late:
            done(Answer(False, Result.FAILED, "too late"))
        return taken

    def say(self, severity: Severity, text: str, k: int = 0) -> None:
        """A line for the people on the ground; goes out with the next snapshot."""
        with self._lock:
            self._said += 1
            self._messages = (*self._messages[1 - KEPT_MESSAGES :], Message(self._said, k, severity, text))

    def publish(
        self,
        facts: Facts,
        k: int,
        sample: Sample | None,
        state: State,
        measured: Measured,
        status: Status,
        pace: PaceReport,
        ending: Ending | None = None,
        mission: tuple[MissionItem, ...] = (),
        diagnostics: tuple[Diagnostics, Diagnostics, Diagnostics] = (_NOTHING, _NOTHING, _NOTHING),
    ) -> None:
        """Put a snapshot in place of the one before, and wake who waits for news."""
        now = k * facts.scenario.step_s
        self._snapshot = Snapshot(
            time.monotonic(), facts, k, now, sample, state, measured, status, pace, ending, mission, diagnostics
        )
        for wake in self._wakers:
            with suppress(OSError):  # a socket that is being closed
                wake()
