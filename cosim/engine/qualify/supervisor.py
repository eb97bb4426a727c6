"""Work with a foreign FMU in a process of its own, which may crash, hang or eat memory and harm nobody.

The child is ``cosim.engine.qualify.child``.  It says what it is about to do before it does it, as JSON lines
through a pipe, so that the parent knows what the FMU was asked for when it died.
"""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cosim.base.runtime.processes import Child, measure_megabytes, python_command
from cosim.base.storage.scratch import temporary
from cosim.engine.fmu.container import to_one_line

POLL_S = 0.02  # how often time and memory are looked at
MOST_MESSAGES = 2**24  # bytes; a check says less than 100 kB
LAST_OUTPUT_BYTES = 2000  # of what the FMU printed
HANGS = "hangs"
STARTED, READ = "while its process started", "while its archive was read"  # before the FMU is called
GROUP_END_S = 0.3  # for the processes of a child that has ended
BACKSTOP_S = 10.0  # after the parent's limit the child's own alarm ends it, should the parent be gone
_MAIN = "from cosim.engine.qualify.child import main; main(int(sys.argv[1]))"
CLOCK_FACTOR = 10.0  # times its limit that a child may take by the clock, on a machine that is busy with something else


@dataclass(frozen=True)
class Limits:
    """What a child may take; chosen by us.  An engine worth flying needs a second and a few MB.

    Seconds are those that the child had: of the processor where it computes, of the clock where it waits.
    """

    seconds: float = 120.0  # total
    silence: float = 30.0  # s within one call to the FMU, or 250 steps; MATLAB's run time takes 20 to start
    megabytes: float = 1024.0  # resident


@dataclass
class ChildResult:
    """The result of a task; ``end`` is None if it was finished, else a clause on how the process ended."""

    messages: list[dict[str, Any]] = field(default_factory=list)
    problem: str | None = None
    has_hung: bool = False  # was ended because it did not answer
    has_crashed: bool = False  # crashed or exited by itself; another child may run the remaining parts
    moment: str = STARTED  # last call to the FMU, as a clause
    printed_bytes: int = 0  # bytes
    last_output: str = ""
    has_left_processes: bool = False  # whether processes that it started are still running
    seconds: float = 0.0  # s that the child had, see Limits


def run_in_child(task: Mapping[str, Any], limits: Limits) -> ChildResult:
    """Hand a task to a new child process and wait until it is done, dead, or beyond its limits.

    Nothing of it is left when this returns: processes that the child started are ended with it.
    """
    result = ChildResult()
    with temporary("engine-apart-") as folder, _child(task, limits, folder) as (child, pipe):
        assert child.stdout is not None
        readers = {pipe: _message_reader(result), child.stdout.fileno(): _output_reader(result)}
        child_time = _ChildTime(child.pid)
        result.problem = _watch(child, readers, limits, child_time)
        result.seconds = child_time.seconds
        result.has_hung = result.problem is not None and result.problem.startswith(HANGS)
        for descriptor, take in readers.items():
            _drain(descriptor, take)
        done = any("done" in message for message in result.messages)
        if result.problem is None and not (done and child.returncode == 0):
            result.problem, result.has_crashed = _describe_exit(child.returncode), True
            if result.last_output:
                result.problem += f'; it printed: "{result.last_output}"'
        if result.problem is not None:
            result.problem = result.problem.replace("{moment}", result.moment)
        result.has_left_processes = result.problem is None and _is_alive(child.pid)
    return result


@contextlib.contextmanager
def _child(task: Mapping[str, Any], limits: Limits, folder: Path) -> Iterator[tuple[Child, int]]:
    most = CLOCK_FACTOR * limits.seconds + BACKSTOP_S
    read, write = os.pipe()
    try:
        child = Child(
            python_command(_MAIN, str(write), seconds=int(most) + 1),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            pass_fds=(write,),
            cwd=folder,
        )
    finally:
        os.close(write)
    try:
        assert child.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            child.stdin.write(json.dumps({"seconds": most, "task": dict(task)}).encode())
        with contextlib.suppress(BrokenPipeError):
            child.stdin.close()
        yield child, read
    finally:
        child.end()
        if child.stdout is not None:
            child.stdout.close()
        os.close(read)


class _ChildTime:
    """The time that a process had since its start, and how much of it was processor time.

    Time in which it is ready to run and another process runs is not counted.
    """

    def __init__(self, process: int) -> None:
        self._process = process
        self._started_at = self._updated_at = time.monotonic()
        self.seconds = self.processor = 0.0
        self.answered()

    def update(self) -> None:
        """Count what has passed since the last look; without a ``/proc`` all of it."""
        now, before = time.monotonic(), self.processor
        elapsed, self._updated_at = now - self._updated_at, now
        is_waiting = True
        with contextlib.suppress(OSError, ValueError, IndexError):
            used = Path(f"/proc/{self._process}/stat").read_text().rpartition(")")[2].split()[11:13]
            self.processor = sum(map(int, used)) / os.sysconf("SC_CLK_TCK")
            threads = Path(f"/proc/{self._process}/task").glob("*/stat")
            is_waiting = all(thread.read_text().rpartition(")")[2].split()[0] != "R" for thread in threads)
        self.seconds += max(self.processor - before, elapsed if is_waiting else 0.0)

    def answered(self) -> None:
        """Record that the process has reported."""
        self._answer = self._updated_at, self.seconds, self.processor

    def exceeded(self, limits: Limits) -> str | None:
        """Return a clause on the exceeded time limit, or None; limits by the clock are ten times as long."""
        answered_at, seconds, processor = self._answer
        if self.seconds > limits.seconds or self._updated_at - self._started_at > CLOCK_FACTOR * limits.seconds:
            return f"takes too long: was not done within {limits.seconds:.3g} s, and ended {{moment}}"
        if self.seconds - seconds > limits.silence:
            busy = self.processor - processor > 0.5 * limits.silence
            slow = " of processor time, if it is not that slow" if busy else ""
            return f"{HANGS} {{moment}}: no answer within {limits.silence:g} s{slow}"
        if self._updated_at - answered_at > CLOCK_FACTOR * limits.silence:  # no hang: the machine may be busy
            return f"takes too long {{moment}}: no answer within {CLOCK_FACTOR * limits.silence:g} s of the clock"
        return None


def _watch(
    child: subprocess.Popen[bytes], readers: Mapping[int, Callable[[bytes], bool]], limits: Limits, timer: _ChildTime
) -> str | None:
    """Read the child's messages until it ends; return why it is to be ended, or None if it ended by itself."""
    with selectors.DefaultSelector() as selector:
        for descriptor in readers:
            os.set_blocking(descriptor, False)
            selector.register(descriptor, selectors.EVENT_READ)
        while child.poll() is None:
            if not selector.get_map():
                time.sleep(POLL_S)
            for key, _ in selector.select(POLL_S):
                data = os.read(key.fd, 2**16)
                if not data:
                    selector.unregister(key.fd)
                elif readers[key.fd](data):
                    timer.answered()
            timer.update()
            if violation := timer.exceeded(limits):
                return violation
            if measure_megabytes(child.pid) > limits.megabytes:
                return f"took more than {limits.megabytes:g} MB of memory {{moment}}"
    return None


def _drain(descriptor: int, take: Callable[[bytes], bool]) -> None:
    """Read the rest of a pipe without waiting for its end, which a process left behind may hold open."""
    with contextlib.suppress(BlockingIOError):
        while data := os.read(descriptor, 2**16):
            take(data)


def _message_reader(result: ChildResult) -> Callable[[bytes], bool]:
    rest, total = bytearray(), 0

    def take(data: bytes) -> bool:
        nonlocal total
        total += len(data)
        if total > MOST_MESSAGES:
            return False
        rest.extend(data)
        *lines, tail = bytes(rest).split(b"\n")
        rest[:] = tail
        for line in lines:
            with contextlib.suppress(ValueError):  # an FMU may write into a pipe that is not its own
                message = json.loads(line)
                if isinstance(message, dict):
                    result.moment = str(message.pop("at", result.moment))
                    if message:
                        result.messages.append(message)
        return True

    return take


def _output_reader(result: ChildResult) -> Callable[[bytes], bool]:
    kept = bytearray()

    def take(data: bytes) -> bool:
        result.printed_bytes += len(data)
        kept.extend(data)
        del kept[:-LAST_OUTPUT_BYTES]
        lines = [line for line in bytes(kept).decode(errors="replace").splitlines() if line.strip()]
        result.last_output = to_one_line(lines[-1])[:200] if lines else ""
        return False  # output is no sign of progress

    return take


def _describe_exit(code: int | None) -> str:
    if code is not None and code < 0:
        try:
            return f"crashed {{moment}} ({signal.Signals(-code).name}: {signal.strsignal(-code)})"
        except ValueError:
            return f"crashed {{moment}} (signal {-code})"
    return f"ended its process {{moment}} (exit status {code})"


def _is_alive(group: int) -> bool:
    """Whether a process group still has a member, some time after its leader has ended; zombies do not count."""
    give_up = time.monotonic() + GROUP_END_S
    while True:
        try:
            os.killpg(group, 0)
        except (ProcessLookupError, PermissionError):
            return False
        if sys.platform == "linux" and not _has_live_members(group):
            return False
        if time.monotonic() > give_up:
            return True
        time.sleep(POLL_S)


def _has_live_members(group: int) -> bool:
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, ValueError, IndexError):
            state, _, leader = path.read_text().rpartition(")")[2].split()[:3]
            if int(leader) == group and state != "Z":
                return True
    return False
