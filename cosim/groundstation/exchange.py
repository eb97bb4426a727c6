"""Exchange of snapshots and requests between the flight and its clients: ground stations, the local page, a test.

The flight publishes snapshots; the last one wins, and a slow reader does not delay it.  Requests wait in one short
queue per sender, the senders take turns, and a queue that is full answers at once.  Everything here may be called from
any thread and returns at once; no sockets, no files.  Who has a loop of its own takes a :class:`Port`, which hands the
answers out there.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from threading import Lock
from typing import NamedTuple

from cosim.base.geodesy import Geodesy
from cosim.base.protocols import Column, Diagnostics
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

WAITING_PER_SENDER = 64  # requests that may wait; a mission is one.  Chosen by us: a quarter second of steps
SENDERS = 32  # that may have something waiting at once
KEPT_MESSAGES = 100
PATIENCE = 2.0  # s for an answer at a port: ground stations ask again after 1 to 3 s

# what is sent again and again: only the last one counts
_STREAMS = (Sticks, OffboardAttitude, OffboardVelocity, OffboardPosition)


@dataclass(frozen=True)
class Restart:
    """Request to end this flight and begin a new one on the ground; refused while it flies."""


@dataclass(frozen=True)
class Shutdown:
    """Request to end the session; refused while it flies."""


GroundRequest = Request | Restart | Shutdown
Done = Callable[[Answer], None]
Claim = Callable[[], bool]  # takes a request over; False: who asked has been told already that it is not done


def ignore_answer(answer: Answer) -> None:
    """Ignore an answer, for senders that need none."""


def _always() -> bool:
    return True


class SessionInfo(NamedTuple):
    """Constant data of one flight."""

    number: int  # flights of this session, from 1
    scenario: Scenario
    vehicle: Vehicle
    stations: tuple[EngineSpec, ...]  # jets 1 to 6
    geodesy: Geodesy  # where the flight's origin is
    parameters: Parameters  # to be read; changed by SetParameter alone
    folder: Path | None  # the run's
    factor: float | None  # of real time; None: as fast as it goes
    own: tuple[Column, ...] = ()  # what the flight's blocks show beside the log's columns


class Snapshot(NamedTuple):
    """State of the flight after one step."""

    published: float  # s, of the exchange's clock
    facts: SessionInfo
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


class Waiting(NamedTuple):
    """One request on its way to the flight."""

    sender: str
    request: GroundRequest
    answer: Done  # tells who has asked
    until: float  # s, of the exchange's clock


class Exchange:
    """Snapshots, messages and queues of requests of one session; ``clock`` [s] gives all times here."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self._lock = Lock()
        self._queues: dict[str, deque[tuple[Waiting, Claim]]] = {}
        self._snapshot: Snapshot | None = None
        self._messages: tuple[Message, ...] = ()
        self._message_count = 0
        self._wakers: tuple[Callable[[], None], ...] = ()
        self.turned_away = 0  # requests for which there was no room

    # --- for those who watch -------------------------------------------------------------------------------------

    @property
    def snapshot(self) -> Snapshot | None:
        """The last snapshot that was published; None before the first."""
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
                self._wakers = tuple(waker for waker in self._wakers if waker is not wake)

        return leave

    # --- for those who ask ---------------------------------------------------------------------------------------

    def ask(
        self,
        request: GroundRequest,
        done: Done = ignore_answer,
        sender: str = "",
        until: float = inf,
        claim: Claim = _always,
    ) -> None:
        """Ask something of the vehicle; it is handled before the next step.

        ``done`` gets the answer once, in the flight's thread, or at once in this one if there is no room; it must
        return quickly.  ``sender`` goes to the log.  A request that is not taken ``until`` then is not done any more:
        who asked has been told so.  ``claim`` is called when it is taken; where it returns False it is not done.
        """
        waiting = Waiting(sender, request, done, until)
        dropped: Waiting | None = None
        with self._lock:
            queue = self._queues.get(sender)
            full = queue is None and len(self._queues) >= SENDERS
            if queue is None and not full:
                queue = self._queues[sender] = deque()
            if queue is not None:
                if isinstance(request, _STREAMS) and queue and type(queue[-1][0].request) is type(request):
                    dropped, _ = queue.pop()
                full = len(queue) >= WAITING_PER_SENDER
                if not full:
                    queue.append((waiting, claim))
            if full:
                self.turned_away += 1
        if dropped is not None:
            dropped.answer(Answer(True, Result.ACCEPTED, "followed by a newer one"))
        if full:
            waiting.answer(Answer(False, Result.TEMPORARILY_REJECTED, "too many requests"))

    # --- for the flight ------------------------------------------------------------------------------------------

    @property
    def waiting(self) -> int:
        """Number of requests that wait now."""
        with self._lock:
            return sum(len(queue) for queue in self._queues.values())

    def take(self, most: int) -> list[Waiting]:
        """Take the next requests out of the queues, ``most`` of them at most, one sender after the other."""
        if not self._queues:
            return []
        taken: list[Waiting] = []
        late: list[Waiting] = []
        now = self.clock()
        with self._lock:
            while self._queues and len(taken) < most:
                # the first sender gives one and goes to the end of the row
                sender = next(iter(self._queues))
                queue = self._queues.pop(sender)
                waiting, claim = queue.popleft()
                (taken if now <= waiting.until and claim() else late).append(waiting)
                if queue:
                    self._queues[sender] = queue
        for waiting in late:
            waiting.answer(Answer(False, Result.FAILED, "too late"))
        return taken

    def say(self, severity: Severity, text: str, k: int = 0) -> None:
        """Add a line for the people on the ground, which goes out with the next snapshot."""
        with self._lock:
            self._message_count += 1
            self._messages = (*self._messages[1 - KEPT_MESSAGES :], Message(self._message_count, k, severity, text))

    def publish(self, snapshot: Snapshot) -> None:
        """Put a snapshot in place of the one before, and wake who waits for news."""
        self._snapshot = snapshot
        for wake in self._wakers:
            with suppress(OSError):  # a socket that is being closed
                wake()


class Port:
    """Access to the exchange from another thread's loop, in which every method is called.

    ``wake`` is called in the flight's thread when there is something to collect; it must return at once.
    """

    def __init__(self, exchange: Exchange, name: str) -> None:
        self.name = name  # of the sender, where a request states none
        self.wake: Callable[[], None] = lambda: None
        self.snapshot: Snapshot | None = None  # the last one of a flight that has begun
        self._exchange = exchange
        self._lines: tuple[Message, ...] = ()
        self._last_message = 0
        self._open: dict[int, Done] = {}  # who waits for an answer
        # How long [s]: who takes a number out of here first, the flight or the loop, says what becomes of the request.
        self._due: dict[int, float] = {}
        self._request_count = 0
        self._answered: deque[tuple[int, Answer]] = deque()
        self.leave = exchange.subscribe(self._news)

    def ask(self, request: GroundRequest, reply: Done | None = None, sender: str = "") -> None:
        """Ask something of the vehicle; ``reply`` gets exactly one answer, from :meth:`collect`."""
        sender = sender or self.name
        if reply is None:
            self._exchange.ask(request, sender=sender)
            return
        self._request_count += 1
        number, until = self._request_count, self._exchange.clock() + PATIENCE
        self._open[number], self._due[number] = reply, until
        self._exchange.ask(
            request, lambda answer: self._answer(number, answer), sender, until, lambda: self._withdraw(number)
        )

    def collect(self, now: float) -> None:
        """Hand out the answers that have come, and say to who has waited too long that there is none.

        What the flight has taken is not given up: it is answered when it is decided.
        """
        while self._answered:
            number, answer = self._answered.popleft()
            self._withdraw(number)
            if number in self._open:
                self._open.pop(number)(answer)
        for number in [number for number, until in self._due.copy().items() if now >= until]:
            if self._withdraw(number):
                self._open.pop(number)(Answer(False, Result.FAILED, "the flight does not answer"))

    def messages(self) -> list[Message]:
        """Return the messages that are new since the last call."""
        new = [message for message in self._lines if message.number > self._last_message]
        self._last_message = new[-1].number if new else self._last_message
        return new

    def _news(self) -> None:
        """Keep the new snapshot and wake the loop; called in the flight's thread."""
        snapshot = self._exchange.snapshot
        if snapshot is not None and snapshot.sample is not None:
            self.snapshot, self._lines = snapshot, self._exchange.messages
            self.wake()

    def _withdraw(self, number: int) -> bool:
        """Return whether nobody has decided before; one operation of a dict, as two threads may ask."""
        return self._due.pop(number, None) is not None

    def _answer(self, number: int, answer: Answer) -> None:
        """Queue an answer and wake the loop; called in the flight's thread, or at once in this one."""
        self._answered.append((number, answer))
        self.wake()
