"""Bytes through two pipes: whole, in pieces, as messages, and what is said where none come."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import count
from threading import Thread
from types import SimpleNamespace

import pytest
from patience import PATIENCE

from cosim.base.errors import InputError
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
def test_the_limit_is_of_the_whole_answer(limit: float, ends: tuple, monkeypatch: pytest.MonkeyPatch) -> None:
    """And not of each piece that comes of it: here the clock goes on by 1 s whenever it is looked at."""
    other = ends[1]
    clock, pieces = count(), iter((b"\3\0\0", b"\0a", b"b", b"c"))
    monkeypatch.setattr(pipes, "monotonic", lambda: float(next(clock)))
    monkeypatch.setattr(pipes, "os", SimpleNamespace(read=lambda *_: next(pieces)))  # for this module alone
    monkeypatch.setattr(other, "_poll", Waiting())
    if limit > 5.0:
        assert other.receive_message(10, limit) == b"abc"
    else:
        with pytest.raises(TimeoutError):
            other.receive_message(10, limit)


def test_a_full_pipe_has_the_limit_of_the_whole_exchange(ends: tuple[Pipes, Pipes]) -> None:
    one, other = ends
    much = bytes(3_000_000)  # more than a pipe holds, and nobody reads
    for wait in (
        lambda: one.send(much, SHORT),
        lambda: one.send_message(much, SHORT),
        lambda: one.exchange(much, 1, SHORT),
        lambda: one.exchange_message(much, 1, SHORT),
    ):
        with pytest.raises(TimeoutError):
            wait()
    os.close(other._reader)
    with pytest.raises(BrokenPipeError):
        one.send(much, PATIENCE)


def test_what_is_asked_is_answered(ends: tuple[Pipes, Pipes]) -> None:
    one, other = ends
    for size in (0, 1, 100, 300_000):
        server = Thread(target=lambda: other.send_message(other.receive_message(400_000)[::-1]))
        server.start()
        asked = os.urandom(size)
        assert one.exchange_message(asked, 400_000, PATIENCE) == asked[::-1]
        server.join()
    server = Thread(target=lambda: other.send(other.receive(3)[::-1] + b"more"))
    server.start()
    assert one.exchange(b"abc", 3, PATIENCE) == b"cba"
    assert one.receive(4, PATIENCE) == b"more"
    server.join()


def test_a_system_without_poll_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipes, "select", SimpleNamespace())
    with pytest.raises(InputError, match=r"needs pipes with poll\(\), which this system does not have"):
        Pipes(0, 1)
