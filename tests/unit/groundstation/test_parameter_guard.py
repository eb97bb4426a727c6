"""Changes that wait for their verdict: what their station is told is what becomes of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from threading import Event, get_ident

import pytest
from patience import PATIENCE

from cosim.control.autopilot.parameters import Caution, Parameter, Parameters
from cosim.control.autopilot.requests import Answer, Result, SetParameter
from cosim.groundstation.exchange import Exchange, PendingRequest, Port
from cosim.groundstation.parameter_guard import ParameterGuard, describe_saved, find_refusal, list_changes

LOST = Caution("roll", True, True, "roll: the loop is unstable")
WAIT = 2.0  # s, of an answer


class StabilityChecker:
    """Lets 0 lose the loop; answers when it is let go, and tells what it was asked."""

    def __init__(self) -> None:
        self.go, self.began = Event(), Event()
        self.asked: list[tuple[float, float]] = []
        self.thread = 0

    def prepare(self) -> None:
        self.thread = get_ident()
        self.began.set()
        assert self.go.wait(PATIENCE)

    def tunes_loop(self, name: str) -> bool:
        return name == "P"

    def find_cautions(self, before: Mapping[str, float], after: Mapping[str, float]) -> list[Caution]:
        assert self.go.wait(PATIENCE)
        self.asked.append((before["P"], after["P"]))
        return [LOST] if after["P"] == 0.0 else []


class Desk:
    """A port and the flight on the other side of it, at a time of its own."""

    def __init__(self) -> None:
        self.now = 0.0
        self.exchange = Exchange(lambda: self.now)
        self.port = Port(self.exchange, "station")
        self.checker = StabilityChecker()
        self.guard = ParameterGuard(self.checker)
        self.parameters = Parameters([Parameter("P", "float", 1.0, 0.0, 10.0, "", "", "")])
        self.answers: list[Answer] = []

    def set(self, *values: float) -> None:
        for value in values:
            self.port.ask(SetParameter("P", value), self.answers.append)

    def hold(self) -> None:
        for waiting in self.exchange.take_requests(20):
            assert self.guard.defer(waiting)

    def judged(self) -> list[tuple[PendingRequest, list[Caution] | None]]:
        return self.guard.take_verdicts(self.parameters, self.now)

    def verdicts(self) -> list[tuple[float, bool]]:
        """Return the next verdicts when they are there: the value, and whether it loses something."""
        self.checker.go.clear()
        assert not self.judged()  # asked for; the flight does not wait
        self.checker.go.set()
        self.guard._verdict.result(PATIENCE)
        return [(w.request.value, bool(c)) for w, c in self.judged() if isinstance(w.request, SetParameter)]

    def told(self) -> list[tuple[bool, str]]:
        self.port.deliver_answers(self.now)
        return [(answer.accepted, answer.text) for answer in self.answers]


@pytest.fixture
def desk() -> Iterator[Desk]:
    desk = Desk()
    yield desk
    desk.checker.go.set()
    desk.guard.close()


def test_a_change_without_a_verdict_in_time_is_given_back_to_be_refused_and_no_more(desk: Desk) -> None:
    desk.set(2.0)
    desk.hold()
    assert desk.judged() == []
    desk.now = WAIT + 0.01
    ((waiting, cautions),) = desk.judged()
    assert cautions is None
    assert isinstance(waiting.request, SetParameter)
    why = find_refusal(waiting.request, cautions, False, {})
    assert why == "P 2 not taken: no verdict in time, ask again"
    waiting.answer(Answer(False, Result.TEMPORARILY_REJECTED, why))
    desk.checker.go.set()
    desk.set(3.0)  # waits behind the verdict that nobody needs
    desk.hold()
    assert desk.verdicts() == [(3.0, False)]
    assert desk.told() == [(False, why)]


def test_a_station_is_not_told_that_there_is_no_answer_to_what_the_flight_has_taken(desk: Desk) -> None:
    desk.set(2.0)
    (waiting,) = desk.exchange.take_requests(1)
    desk.now = WAIT + 0.5
    assert desk.told() == []
    waiting.answer(Answer(True, Result.ACCEPTED, ""))
    assert desk.told() == [(True, "")]


def test_what_a_station_was_told_is_not_done_is_not_taken(desk: Desk) -> None:
    desk.set(2.0)
    desk.port.deliver_answers(WAIT)
    assert desk.told() == [(False, "the flight does not answer")]
    assert desk.exchange.take_requests(1) == []
    assert len(desk.told()) == 1


def test_changes_that_came_together_are_judged_together_up_to_one_that_loses_a_loop(desk: Desk) -> None:
    desk.set(2.0, 99.0, 3.0, 0.0, 4.0)
    desk.hold()
    assert desk.verdicts() == [(2.0, False), (99.0, False), (3.0, False), (0.0, True)]
    assert desk.checker.asked == [(1.0, 2.0), (2.0, 2.0), (2.0, 3.0), (3.0, 0.0)]  # 99 is out of range
    desk.parameters.set("P", 3.0)  # the 0 was refused
    assert desk.verdicts() == [(4.0, False)]
    assert desk.checker.asked[-1] == (3.0, 4.0)


def test_a_verdict_that_rests_on_a_change_that_was_dropped_is_not_used(desk: Desk) -> None:
    desk.set(2.0)
    desk.now = 1.0
    desk.set(3.0)
    desk.hold()
    assert desk.judged() == []
    desk.now = WAIT + 0.5
    assert [cautions for _, cautions in desk.judged()] == [None]
    assert desk.verdicts() == [(3.0, False)]
    assert desk.checker.asked[-1] == (1.0, 3.0)


def test_the_judge_begins_beside_the_flight(desk: Desk) -> None:
    desk.guard.prepare()
    assert desk.checker.began.wait(PATIENCE)
    assert desk.checker.thread != get_ident()


def test_the_end_of_a_session_answers_what_is_held(desk: Desk) -> None:
    desk.set(2.0)
    desk.hold()
    desk.guard.close()
    assert desk.told() == [(False, "the session is over")]


def test_what_the_vehicle_refuses_is_not_said_to_be_kept_nor_judged(desk: Desk) -> None:
    desk.checker.go.set()
    kept = {"P": 99.0, "Q": 1.0}
    lines = ["refused: P = 99: must be from 0 to 10", "refused: unknown parameter 'Q'"]
    assert list_changes(desk.parameters, kept) == lines
    assert describe_saved(desk.checker, desk.parameters, kept) == lines
    assert desk.checker.asked == []
    assert describe_saved(desk.checker, desk.parameters, {"P": 0.0}) == ["P 0 (default 1)", LOST.text]
