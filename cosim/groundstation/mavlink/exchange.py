"""Between the thread that steps the flight and the thread of the links: nobody waits for the other.

The stepping thread publishes a snapshot (the last one counts), takes the requests that have come in, and answers
them.  The link's thread asks, and collects the answers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from cosim.control.autopilot.modes import Message
from cosim.control.autopilot.requests import (
    Answer,
    OffboardAttitude,
    OffboardPosition,
    OffboardVelocity,
    Request,
    Result,
    Sticks,
)
from cosim.groundstation.mavlink.snapshot import Snapshot

_MOST = 256  # requests that wait; at 250 steps/s that is more than any station sends in a second
_MESSAGES = 256
_LATEST = (Sticks, OffboardAttitude, OffboardVelocity, OffboardPosition)  # a newer one replaces an older one
PATIENCE = 2.0  # s for an answer: ground stations ask again after 1 to 3 s

Reply = Callable[[Answer], None]


@dataclass(eq=False)
class Ticket:
    """One request that waits for its answer."""

    request: Request
    reply: Reply | None = None
    until: float = 0.0
    cancelled: bool = False  # the asker has been told that there was no answer; it must not be done any more
    answer: Answer | None = None
    who: str = ""  # asks, for people to read


@dataclass
class Exchange:
    """``wake``: called by the stepping thread when there is something to collect at once."""

    snapshot: Snapshot | None = None
    wake: Callable[[], None] = field(default=lambda: None)
    dropped: int = 0  # requests that found the queue full

    def __post_init__(self) -> None:
        self._asked: deque[Ticket] = deque()
        self._latest: dict[type, Ticket] = {}
        self._answered: deque[Ticket] = deque()
        self._messages: deque[Message] = deque(maxlen=_MESSAGES)
        self._waiting: list[Ticket] = []

    # --- the stepping thread -----------------------------------------------------------------------------------

    def publish(self, snapshot: Snapshot, messages: Sequence[Message] = ()) -> None:
        """The state now, and what the pilot has said since the last time."""
        self.snapshot = snapshot
        if messages:
            self._messages.extend(messages)
            self.wake()

    def take(self) -> list[Ticket]:
        """Every request that waits, in the order in which they came; set-points and sticks first."""
        found: list[Ticket] = []
        for kind in _LATEST:
            ticket = self._latest.pop(kind, None)
            if ticket is not None:
                found.append(ticket)
        while self._asked:
            ticket = self._asked.popleft()
            if not ticket.cancelled:
                found.append(ticket)
        return found

    def answer(self, ticket: Ticket, answer: Answer) -> None:
        """What came of a request that was taken."""
        if ticket.reply is not None:
            ticket.answer = answer
            self._answered.append(ticket)
            self.wake()

    # --- the link's thread -------------------------------------------------------------------------------------

    def ask(self, request: Request, reply: Reply | None, now: float, who: str = "") -> None:
        """Put a request to the pilot; ``reply`` gets exactly one answer, in the link's thread."""
        if type(request) in _LATEST:
            self._latest[type(request)] = Ticket(request, who=who)
            if reply is not None:
                reply(Answer(True, Result.ACCEPTED, ""))
            return
        if len(self._asked) >= _MOST:
            self.dropped += 1
            if reply is not None:
                reply(Answer(False, Result.TEMPORARILY_REJECTED, "too many requests"))
            return
        ticket = Ticket(request, reply, now + PATIENCE, who=who)
        if reply is not None:
            self._waiting.append(ticket)
        self._asked.append(ticket)

    def collect(self, now: float) -> None:
        """Hand out the answers that have come, and say to who has waited too long that there is none."""
        while self._answered:
            ticket = self._answered.popleft()
            if ticket in self._waiting and ticket.answer is not None and ticket.reply is not None:
                self._waiting.remove(ticket)
                ticket.reply(ticket.answer)
        for ticket in [ticket for ticket in self._waiting if now >= ticket.until]:
            ticket.cancelled = True
            self._waiting.remove(ticket)
            if ticket.reply is not None:
                ticket.reply(Answer(False, Result.FAILED, "the flight does not answer"))

    def messages(self) -> list[Message]:
        """What the pilot has said since the last call."""
        found = []
        while self._messages:
            found.append(self._messages.popleft())
        return found
