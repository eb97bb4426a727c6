"""A page of memory beside two pipes: who looks is written to there, who sleeps by the pipe, and no byte is out of order."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from random import Random
from threading import Thread

import pytest
from patience import PATIENCE

from cosim.base.runtime import page
from cosim.base.runtime.page import CAPACITY, ENVIRONMENT, Page, describe_page, open_page, take_page
from cosim.base.runtime.pipes import Pipes
from cosim.base.runtime.processes import Child

if not hasattr(os, "memfd_create") or platform.machine() != "x86_64":
    pytest.skip("no page here: Linux on x86 has one", allow_module_level=True)


class Ends:
    """Both processes' pipes and pages, in this one."""

    def __init__(self) -> None:
        down, up, number = os.pipe(), os.pipe(), open_page()
        assert number is not None
        self.numbers: tuple[int, ...] = (*down, *up, number)
        self.pages = Page(number, 0), Page(number, 1)
        self.one, self.other = Pipes(up[0], down[1], 1e-6, self.pages[0]), Pipes(down[0], up[1], 1e-6, self.pages[1])
        for end in (self.one, self.other):
            end._spins = True  # on one processor too


@pytest.fixture
def ends() -> Iterator[Ends]:
    made = Ends()
    yield made
    for number in made.numbers:
        with suppress(OSError):
            os.close(number)


def test_who_looks_is_written_to_in_memory_and_who_does_not_by_the_pipe(ends: Ends) -> None:
    one, other = ends.pages
    assert not one.put(b"nobody has looked yet")
    other.count_taken(21)
    assert not other.look()
    assert one.put(b"abc")
    assert other.look()
    assert not one.put(b"before abc is taken")
    assert (other.take(), other.take()) == (b"abc", b"")
    other.count_taken(19)
    other.look()
    assert not one.put(bytes(CAPACITY + 1))
    other.count_taken(CAPACITY + 1)
    other.look()
    assert one.put(bytes(CAPACITY))
    assert other.take() == bytes(CAPACITY)
    other.look()
    other.rest()
    assert not one.put(b"x")


def test_what_comes_both_ways_stays_in_its_order(ends: Ends) -> None:
    """A record that is not yet taken comes before what was sent by the pipe behind it."""
    other = ends.pages[1]
    other.look()
    ends.one.send(b"by memory, ")
    ends.one.send(b"by the pipe, ")
    ends.one.send(b"too")
    assert ends.other.receive(27, PATIENCE) == b"by memory, by the pipe, too"
    other.look()
    ends.one.send(b"1")
    other.rest()
    ends.one.send(b"2")
    os.close(ends.one._writer)  # and the end behind both
    assert ends.other.receive(2, PATIENCE) == b"12"
    with pytest.raises(EOFError):
        ends.other.receive(1, PATIENCE)


class Sleeping:
    """A poll of a pipe that stays empty; somebody writes to the page in the first sleep."""

    def __init__(self, write: Thread) -> None:
        self.write, self.sleeps = write, 0

    def poll(self, milliseconds: float) -> bool:
        if milliseconds > 0.0:
            self.sleeps += 1
            if self.sleeps == 1:
                self.write.run()
        return False


@pytest.mark.parametrize("limit", [None, PATIENCE])
def test_what_was_begun_before_the_reader_slept_is_found(
    limit: float | None, ends: Ends, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other has seen that it looks, and writes when it does so no more: nothing comes by the pipe to wake it."""
    one = ends.pages[0]

    def write() -> None:
        one._memory[one._out_data : one._out_data + 3] = b"abc"
        one._out[0] = 3

    sleeping = Sleeping(Thread(target=write))
    monkeypatch.setattr(ends.other, "_poll", sleeping)
    assert ends.other.receive(3, limit) == b"abc"
    assert sleeping.sleeps == 1
    with pytest.raises(TimeoutError):
        ends.other.receive(1, 0.002)


def test_whatever_the_sizes_and_whoever_sleeps_what_is_asked_is_answered(ends: Ends) -> None:
    random = Random(1)
    asked = [random.randbytes(random.choice((0, 1, 80, CAPACITY - 4, CAPACITY, 200_000))) for _ in range(200)]

    def serve() -> None:
        for number in range(len(asked)):
            ends.other._look_s = (1e-6, 1e-3, 2e-3)[number % 3]  # looks long, or no more than once
            ends.other._credit = 1024 if number % 5 else 0
            ends.other.send_message(ends.other.receive_message(400_000, PATIENCE)[::-1], PATIENCE)

    server = Thread(target=serve)
    server.start()
    for number, data in enumerate(asked):
        ends.one._look_s = (1e-6, 1e-3, 2e-3, 3e-3)[number % 4]
        ends.one._credit = 1024 if number % 7 else 0
        assert ends.one.exchange_message(data, 400_000, PATIENCE) == data[::-1]
    server.join()


def test_numbers_that_an_engine_has_written_over_are_bytes_at_most(ends: Ends) -> None:
    one, other = ends.pages
    for sent in (2**63, CAPACITY + 10):
        other._taken = 0
        one._out[0] = sent
        assert len(other.take()) == CAPACITY
    one._out[0] = 0
    assert other.take() == b""


def test_nobody_can_cut_it_short(ends: Ends) -> None:
    """A process that reads memory that is no more is ended by the system."""
    for size in (0, 2**20):
        with pytest.raises(PermissionError):
            os.ftruncate(ends.numbers[-1], size)


def test_it_is_taken_for_the_pipes_that_it_came_with_and_once(ends: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    reader, _, _, writer, number = ends.numbers
    assert take_page(reader, writer) is None
    described = describe_page(os.dup(number), reader, writer)
    monkeypatch.setenv(ENVIRONMENT, described[ENVIRONMENT])
    assert take_page(ends.numbers[2], writer) is None
    copied = os.dup(writer)
    ends.numbers += (copied,)
    assert take_page(reader, copied) is not None
    assert ENVIRONMENT not in os.environ
    assert take_page(reader, copied) is None
    for wrong in ("", "x", "3", f"99999 1 {reader} {writer}"):
        monkeypatch.setenv(ENVIRONMENT, wrong)
        assert take_page(reader, writer) is None


def without_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "memfd_create")


def without_files(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> int:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(os, "memfd_create", refused)


def on_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")


def without_seals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "MFD_ALLOW_SEALING", 0)


def count_pages() -> int:
    """How often this process has such memory, or a file descriptor of it."""
    links = [os.readlink(link) for link in Path("/proc/self/fd").iterdir() if link.is_symlink()]
    return "\n".join([*links, Path("/proc/self/maps").read_text()]).count("memfd:exchange")


@pytest.mark.parametrize("blocked", [without_memory, without_files, on_arm, without_seals, None])
def test_a_child_answers_with_a_page_and_without(blocked: object, monkeypatch: pytest.MonkeyPatch) -> None:
    """And the child's end is the end of the pipe; no memory and no file descriptor is left of it."""
    before = count_pages()
    if callable(blocked):
        blocked(monkeypatch)
        assert page.open_page() is None
    code = """
import os
from cosim.base.runtime.pipes import Pipes
pipes = Pipes(*map(int, sys.argv[1:]))
for _ in range(300):
    pipes.send(pipes.receive(3)[::-1])
pipes.send(b"no page" if pipes._page is None else b"a  page")
os._exit(3)
"""
    child, pipes = Child.open_pipes(code)
    try:
        assert all(pipes.exchange(b"abc", 3, PATIENCE) == b"cba" for _ in range(300))
        has_page = pipes._spins and blocked is None
        assert pipes.receive(7, PATIENCE) == (b"a  page" if has_page else b"no page")
        with pytest.raises(EOFError):
            pipes.receive(1, PATIENCE)
        assert child.describe_end(PATIENCE, "{}", "ended with {}") == "ended with 3"
    finally:
        pipes.close()
        child.end()
    assert count_pages() <= before
