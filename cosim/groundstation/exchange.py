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
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.modes import Message, Severity
from cosim.control.autopilot.parameters import Parameters
from cosim.control.autopilot.status import Status
from cosim.engine import EngineSpec
from cosim.simulation.ending import Ending
from cosim.simulation.pacing import PaceReport
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle

# Requests of continuous streams, of which a newer one replaces a waiting one.
_REPLACED_REQUESTS = (rq.Sticks, rq.OffboardAttitude, rq.OffboardVelocity, rq.OffboardPosition)


@dataclass(frozen=True)
class Restart:
    """Request to end this flight and begin a new one on the ground; refused in the air."""


@dataclass(frozen=True)
class Shutdown:
    """Request to end the session; refused in the air."""


GroundRequest = rq.Request | Restart | Shutdown
AnswerCallback = Callable[[rq.Answer], None]
Claim = Callable[[], bool]  # False: already answered as late


def ignore_answer(answer: rq.Answer) -> None:
    """Ignore an answer, for senders that need none."""


class FlightInfo(NamedTuple):
    """Constant data of one flight."""

    number: int  # number of the flight, from 1
    scenario: Scenario
    vehicle: Vehicle
    stations: tuple[EngineSpec, ...]  # engines of jets 1 to 6
    geodesy: Geodesy  # geographic position of the origin
    parameters: Parameters  # read only: use SetParameter
    folder: Path | None  # folder of the run, or None
    factor: float | None  # of real time; None: unlimited
    columns: tuple[Column, ...] = ()  # columns of blocks, after the log's own


class Snapshot(NamedTuple):
    """Published state of the flight after one step."""

    published: float  # s, by the clock of the exchange
    info: FlightInfo
    k: int  # number of steps done; state is at k dt
    time: float  # k dt [s]
    sample: Sample | None  # sample of the last step, if any
    state: State  # true state
    measured: Measured  # for the controller's next update
    status: Status
    pace: PaceReport
    ending: Ending | None  # how it ended, or None
    mission: tuple[rq.MissionItem, ...]
    diagnostics: tuple[Diagnostics, Diagnostics, Diagnostics]  # predictor diagnostics of each axis


class PendingRequest(NamedTuple):
    """Request that waits for the flight, with its answer callback and deadline."""

    sender: str
    request: GroundRequest
    answer: AnswerCallback  # called with the answer
    deadline: float  # s, by the clock of the exchange


class Exchange:
    """Exchange of snapshots, messages and requests between one session and its clients; times by ``clock`` [s].

    ``waiting_per_sender``: of one sender, requests that may wait, of which a mission is one: a quarter second of steps.
    ``senders``: with waiting requests at most.  ``message_history``: lines that are kept.
    """

    def __init__(
        self,
        clock: Callable[[], float] = time.monotonic,
        waiting_per_sender: int = 64,
        senders: int = 32,
        message_history: int = 100,
    ) -> None:
        self.message_history = message_history
        self.senders = senders
        self.waiting_per_sender = waiting_per_sender
        self.clock = clock
        self._lock = Lock()
        self._queues: dict[str, deque[tuple[PendingRequest, Claim]]] = {}
        self._snapshot: Snapshot | None = None
        self._messages: tuple[Message, ...] = ()
        self._message_count = 0
        self._wakers: tuple[Callable[[], None], ...] = ()
        self.turned_away = 0  # requests rejected: queues were full

    @property
    def snapshot(self) -> Snapshot | None:
        """Snapshot that was published last; None before the first."""
        return self._snapshot

    @property
    def messages(self) -> tuple[Message, ...]:
        """Latest text messages for the ground, numbered from 1 through the whole session."""
        return self._messages

    def subscribe(self, wake: Callable[[], None]) -> Callable[[], None]:
        """Call ``wake`` in the flight's thread after each snapshot; return a function that ends the subscription."""
        with self._lock:
            self._wakers = (*self._wakers, wake)

        def unsubscribe() -> None:
            with self._lock:
                self._wakers = tuple(waker for waker in self._wakers if waker is not wake)

        return unsubscribe

    def ask(
        self,
        request: GroundRequest,
        done: AnswerCallback = ignore_answer,
        sender: str = "",
        until: float = inf,
        claim: Claim = lambda: True,
    ) -> None:
        """Queue a request, which the flight handles before its next step.

        ``done`` gets the answer once, in the flight's thread, or at once in this one if there is no room; it must
        return quickly.  ``sender`` goes to the log.  A request that is not taken until ``until`` is not done any more,
        and is answered so.  ``claim`` is called when it is taken; where it returns False it is not done.
        """
        waiting = PendingRequest(sender, request, done, until)
        dropped: PendingRequest | None = None
        with self._lock:
            queue = self._queues.get(sender, deque())
            if isinstance(request, _REPLACED_REQUESTS) and queue and type(queue[-1][0].request) is type(request):
                dropped, _ = queue.pop()
            is_new = sender not in self._queues
            is_full = len(queue) >= self.waiting_per_sender or (is_new and len(self._queues) >= self.senders)
            if is_full:
                self.turned_away += 1
            else:
                queue.append((waiting, claim))
                self._queues[sender] = queue
        if dropped is not None:
            dropped.answer(rq.Answer(True, rq.Result.ACCEPTED, "followed by a newer one"))
        if is_full:
            waiting.answer(rq.Answer(False, rq.Result.TEMPORARILY_REJECTED, "too many requests"))

    @property
    def request_count(self) -> int:
        """Number of requests that wait now."""
        with self._lock:
            return sum(len(queue) for queue in self._queues.values())

    def take_requests(self, limit: int) -> list[PendingRequest]:
        """Remove and return up to ``limit`` requests, one sender after the other in turn."""
        if not self._queues:
            return []
        taken: list[PendingRequest] = []
        late: list[PendingRequest] = []
        now = self.clock()
        with self._lock:
            while self._queues and len(taken) < limit:
                # Take one request of the first sender, then move this sender to the end of the queue.
                sender = next(iter(self._queues))
                queue = self._queues.pop(sender)
                waiting, claim = queue.popleft()
                (taken if now <= waiting.deadline and claim() else late).append(waiting)
                if queue:
                    self._queues[sender] = queue
        for waiting in late:
            waiting.answer(rq.Answer(False, rq.Result.FAILED, "too late"))
        return taken

    def say(self, severity: Severity, text: str, k: int = 0) -> None:
        """Queue a text message for the ground, sent with the next snapshot."""
        with self._lock:
            self._message_count += 1
            self._messages = (
                *self._messages[1 - self.message_history :],
                Message(self._message_count, k, severity, text),
            )

    def publish(self, snapshot: Snapshot) -> None:
        """Publish a new snapshot and wake the subscribers."""
        self._snapshot = snapshot
        for wake in self._wakers:
            with suppress(OSError):  # the socket is being closed
                wake()


class Port:
    """Client of the exchange in another thread's event loop, which calls each method.

    ``wake`` is called in the flight's thread when there is something to collect; it must return at once.
    ``timeout_s``: for an answer; ground stations ask again after 1 to 3 s.
    """

    def __init__(self, exchange: Exchange, name: str, timeout_s: float = 2.0) -> None:
        self.timeout_s = timeout_s
        self.name = name  # default sender of requests
        self.wake: Callable[[], None] = lambda: None
        self.snapshot: Snapshot | None = None  # latest one; None before the first flight
        self._exchange = exchange
        self._messages: tuple[Message, ...] = ()
        self._last_message = 0
        self._replies: dict[int, AnswerCallback] = {}  # answer callbacks by request number
        # Deadlines [s] by request number: the flight or the event loop, whichever removes the number first, answers.
        self._deadlines: dict[int, float] = {}
        self._request_count = 0
        self._answered: deque[tuple[int, rq.Answer]] = deque()
        self.unsubscribe = exchange.subscribe(self._on_publish)

    def ask(self, request: GroundRequest, reply: AnswerCallback | None = None, sender: str = "") -> None:
        """Queue a request; ``reply`` gets exactly one answer, from :meth:`deliver_answers`."""
        sender = sender or self.name
        if reply is None:
            self._exchange.ask(request, sender=sender)
            return
        self._request_count += 1
        number, until = self._request_count, self._exchange.clock() + self.timeout_s
        self._replies[number], self._deadlines[number] = reply, until
        self._exchange.ask(
            request, lambda answer: self._queue_answer(number, answer), sender, until, lambda: self._try_claim(number)
        )

    def deliver_answers(self, now: float) -> None:
        """Deliver answers, and reject requests that the flight did not take in time.

        A request that the flight has taken is answered when it is decided.
        """
        while self._answered:
            number, answer = self._answered.popleft()
            self._try_claim(number)
            if number in self._replies:
                self._replies.pop(number)(answer)
        for number in [number for number, until in self._deadlines.copy().items() if now >= until]:
            if self._try_claim(number):
                self._replies.pop(number)(rq.Answer(False, rq.Result.FAILED, "the flight does not answer"))

    def take_messages(self) -> list[Message]:
        """Return the messages that are new since the last call."""
        new = [message for message in self._messages if message.number > self._last_message]
        self._last_message = new[-1].number if new else self._last_message
        return new

    def _on_publish(self) -> None:
        """Store the new snapshot and wake the event loop; called in the flight's thread."""
        snapshot = self._exchange.snapshot
        if snapshot is not None and snapshot.sample is not None:
            self.snapshot, self._messages = snapshot, self._exchange.messages
            self.wake()

    def _try_claim(self, number: int) -> bool:
        """Return whether the caller may answer a request; atomic, as two threads may call it."""
        return self._deadlines.pop(number, None) is not None

    def _queue_answer(self, number: int, answer: rq.Answer) -> None:
        """Queue an answer and wake the event loop; called in the flight's thread or in that of the event loop."""
        self._answered.append((number, answer))
        self.wake()
