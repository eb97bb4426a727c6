"""Bytes through two pipes: whole, in pieces, as messages, and what is said where none come."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import count
from threading import Thread
from types import SimpleNamespace

import pytest
from patience import PATIENCE

from cosim.base.runtime import pipes
from cosim.base.runtime.pipes import Pipes

SHORT = 0.01  # s, waited for what does not come


@pytest.fixture
def ends() -> Iterator[tuple[Pipes, Pipes]]:
    down, up = os.pipe(), os.pipe()
    yield Pipes(up[0], down[1]), Pipes(down[0], up[1])
    for number in (*down, *up):
        try:
            os.close(number)
        except OSError:
            continue


def test_a_message_arrives_as_it_was_sent_whatever_its_size(ends: tuple[Pipes, Pipes]) -> None:
    one, other = ends
    for data in (b"", b"a", bytes(range(256)), os.urandom(3_000_000)):  # the last is more than a pipe holds
        sender = Thread(target=one.send_message, args=(data,))
        sender.start()
        assert other.receive_message(4_000_000, PATIENCE) == data
        sender.join()


def test_what_comes_in_pieces_or_together_is_told_apart(ends: tuple[Pipes, Pipes]) -> None:
    one, other = ends
    one.send(b"a line\nfour")
    assert other.receive_line(100, PATIENCE) == b"a line"
    assert other.receive(2, PATIENCE) == b"fo"
    sender = Thread(target=lambda: [one.send(bytes([value])) for value in range(10)])
    sender.start()
    assert other.receive(12, PATIENCE) == b"ur" + bytes(range(10))
    sender.join()
    one.send_message(b"first")
    one.send_message(b"second")
    assert [other.receive_message(10, PATIENCE), other.receive_message(10, PATIENCE)] == [b"first", b"second"]


def test_nothing_too_much_and_the_end_are_errors_of_their_own(ends: tuple[Pipes, Pipes]) -> None:
    one, other = ends
    one.send(b"12")
    for wait in (lambda: other.receive(3, SHORT), lambda: other.receive_line(100, SHORT)):
        with pytest.raises(TimeoutError):
            wait()
    one.send(b"3" * 200)
    with pytest.raises(ValueError, match="does not end"):
        other.receive_line(100, PATIENCE)
    one, other = other, one
    one.send_message(b"x" * 11)
    with pytest.raises(ValueError, match="11 bytes: at most 10"):
        other.receive_message(10, PATIENCE)


def test_a_closed_end_is_named(ends: tuple[Pipes, Pipes]) -> None:
    one, other = ends
    os.close(one._writer)
    with pytest.raises(EOFError):
        other.receive(1, PATIENCE)
    os.close(one._reader)
    with pytest.raises(BrokenPipeError):
        other.send(b"x")


class Waiting:
    """A poll that finds something as long as it may wait for it."""

    def poll(self, milliseconds: float) -> bool:
        return milliseconds > 0.0


@pytest.mark.parametrize("limit", [10.0, 3.0])
def test_the_limit_is_of_the_whole_answer(
    limit: float, ends: tuple[Pipes, Pipes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not of each piece that comes of it: here the clock goes on by 1 s whenever it is looked at."""
    _, other = ends
    clock, pieces = count(), iter((b"\3\0\0", b"\0a", b"b", b"c"))
    monkeypatch.setattr(pipes, "monotonic", lambda: float(next(clock)))
    monkeypatch.setattr(pipes, "os", SimpleNamespace(read=lambda *_: next(pieces)))  # for this module alone
    monkeypatch.setattr(other, "_poll", Waiting())
    if limit > 5.0:
        assert other.receive_message(10, limit) == b"abc"
    else:
        with pytest.raises(TimeoutError):
            other.receive_message(10, limit)
