"""Damaged files of every kind that the project reads: each is read, or refused in one line, and nothing else happens."""

from __future__ import annotations

import contextlib
import io
import random
import re
import resource
import shutil
import signal
import tempfile
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import psutil
from file_kinds import KINDS, Kind

from cosim.base.errors import FlightError, InputError

ODD = [
    *(b"1e309", b"-1e309", b"nan", b"inf", b"9" * 400, b"-1", b"0", b"0x7fffffff", b"1_000", b"'", b"[", b"true", b""),
    *(b"\xff", b"1e-320", b'"' + b"x" * 300 + b'"'),
]
_TOKENS = re.compile(rb"[-+]?[0-9][0-9.eE+-]*|\w+")
MEGABYTES = 1500.0  # that one file may ask for
SECONDS = 20.0  # of this process' CPU, for one


class EndlessError(BaseException):
    """The time is over.  No error that a reader could take for one of its own."""


@dataclass
class Outcome:
    """How many files were read and refused, and what else happened, with the number of the file."""

    read: int = 0
    refused: int = 0
    faults: list[tuple[int, str]] = field(default_factory=list)


def damaged(whole: bytes, drawn: random.Random, text: bool) -> bytes:
    """One to three faults: bytes changed, lost, doubled, foreign, or the rest cut off; of a text also a word."""
    data = bytearray(whole)
    for _ in range(drawn.choice((1, 1, 2, 3))):
        if not data:
            break
        most = len(data) if drawn.random() < 0.6 else min(len(data), 600)  # the head above all
        at, length = drawn.randrange(most), drawn.choice((1, 2, 4, 16, 64, 256))
        how = drawn.randrange(12 if text else 6)
        if how == 0:
            data[at] = drawn.randrange(32, 127) if text else drawn.randrange(256)
        elif how == 1:
            data[at] ^= 1 << drawn.randrange(7 if text else 8)
        elif how == 2:
            data[at : at + length] = drawn.randbytes(length)
        elif how == 3:
            del data[at : at + length]
        elif how == 4:
            data[at:at] = data[max(at - length, 0) : at]
        elif how == 5:
            fill = drawn.choice((b"\0" * length, b"\xff" * length))
            data = data[:at] if drawn.random() < 0.5 else data[:at] + fill + data[at + length :]
        else:
            words = list(_TOKENS.finditer(bytes(data)))
            if words:
                word = drawn.choice(words)
                data[word.start() : word.end()] = drawn.choice(ODD)
    return bytes(data)


@contextlib.contextmanager
def bounded(seconds: float, megabytes: float) -> Iterator[None]:
    """This process' CPU and address space, from here on."""

    def over(*_: object) -> None:
        raise EndlessError(f"more than {seconds:g} s of CPU")

    before = signal.signal(signal.SIGPROF, over)
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = psutil.Process().memory_info().vms + int(megabytes * 2**20)
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGPROF, before)


def attempt(kind: Kind, path: Path) -> str:
    """Read a file: "" where it was, "=" and the line in which it was refused, or what went wrong."""
    output = io.StringIO()
    try:
        with bounded(SECONDS, MEGABYTES), contextlib.redirect_stdout(output):
            kind.read(path)
    except (InputError, FlightError) as refusal:
        line = str(refusal)
        return f"of several lines: {line!r}" if "\n" in line else f"={line}"
    except (Exception, EndlessError):
        return traceback.format_exc()
    return f"printed {output.getvalue()[:200]!r}" if output.getvalue() else ""


def try_files(name: str, count: int, seed: int = 1) -> Outcome:
    """Read ``count`` damaged files of a kind."""
    kind, outcome, before = KINDS[name], Outcome(), psutil.Process().children(recursive=True)
    with tempfile.TemporaryDirectory(prefix="hexjet-damaged-") as folder:
        whole_folder = Path(folder) / "whole"
        whole_folder.mkdir()
        file = kind.make(whole_folder)
        whole = file.read_bytes()
        assert not attempt(kind, file), f"{name}: the whole one: {attempt(kind, file)}"
        for number in range(count):
            drawn = random.Random(f"{name} {seed} {number}")
            content = damaged(whole, drawn, kind.text)
            copy = Path(folder) / f"file-{number}"
            shutil.copytree(whole_folder, copy)
            path = copy / file.relative_to(whole_folder)
            path.write_bytes(content)
            done = attempt(kind, path)
            left = [each for each in psutil.Process().children(recursive=True) if each not in before]
            if left:
                done = f"left processes: {[process.cmdline()[-2:] for process in left]}"
            if not done:
                outcome.read += 1
            elif done.startswith("="):
                outcome.refused += 1
            else:
                outcome.faults.append((number, done))
            shutil.rmtree(copy)
    return outcome
