"""How a process is started so that it sees no stranger's modules, and ended with everything that it started itself."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from secrets import token_hex
from typing import Any

from cosim.base.compiled import PACKAGE, environment

_MARK = "HEXJET_PROCESS"  # environment variable: which of our processes a process comes from, each behind its parent


def python_command(code: str, *arguments: str) -> list[str]:
    """Return the command that runs ``code`` in this interpreter; it finds ``arguments`` behind ``sys.argv[0]``.

    It imports what this process would import, from the same places (``PYTHONPATH`` included), but never from the
    current folder: whatever lies beside a scenario, ``numpy.py`` for one, is not ours to run.
    """
    places = [os.path.abspath(place) for place in sys.path if place]  # the empty one is the current folder
    home = str(PACKAGE.parent)
    places += [] if home in places else [home]
    return [sys.executable, "-P", "-c", f"import sys; sys.path[:] = {places!r}\n{code}", *arguments]


class Child(subprocess.Popen[bytes]):
    """A process that leads a process group, and is ended with everything that it has started.

    It inherits ``environ``, by default :func:`cosim.base.compiled.environment`; ``how`` is as of ``subprocess.Popen``.
    """

    def __init__(self, command: Sequence[str], environ: Mapping[str, str] | None = None, **how: Any) -> None:
        self._mark = f"{os.environ.get(_MARK, '')}/{token_hex(8)}"
        inherited = environment() if environ is None else environ
        super().__init__(command, env={**inherited, _MARK: self._mark}, process_group=0, **how)

    def end(self) -> None:
        """Kill the process and all that came from it, in whatever session, and wait until it is gone."""
        end_group(self)
        if sys.platform == "linux":
            _kill_marked(f"{_MARK}={self._mark}".encode())


def run_child(command: Sequence[str], limit: float, **how: Any) -> subprocess.CompletedProcess[str]:
    """Run a command to its end with what it prints captured as text, and end all that it leaves behind.

    ``how`` is as of :class:`Child`.  Raises OSError where it cannot be started, subprocess.TimeoutExpired where it has
    not ended within ``limit`` s of the clock.
    """
    child = Child(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **how)
    try:
        said = child.communicate(timeout=limit)
    finally:
        child.end()
        for stream in (child.stdout, child.stderr):
            if stream is not None:
                stream.close()
    out, error = (text.decode(errors="replace") for text in said)
    return subprocess.CompletedProcess(command, child.returncode, out, error)


def _kill_marked(mark: bytes) -> None:
    """Kill the processes that have ``mark`` in their environment, until there are none: one may start another."""
    while found := list(_marked(mark)):
        for process in found:
            with suppress(OSError):
                os.kill(process, signal.SIGKILL)


def _marked(mark: bytes) -> Iterator[int]:
    """Processes that a child has started; one that is killed has no environment any more."""
    for file in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):  # somebody else's, or gone
            if mark in file.read_bytes():
                yield int(file.parent.name)


def end_group(process: subprocess.Popen[Any]) -> None:
    """Kill the process group that ``process`` leads, and wait until that is gone."""
    with suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL)
    reap(process)


def reap(process: subprocess.Popen[Any]) -> None:
    """Wait for a process that was killed: its ``wait()`` may never return after a Ctrl-C.

    ``poll()`` and ``wait()`` of ``subprocess`` take a lock of the process.  An interrupt between the taking and the
    ``try`` behind it, or in the giving back, leaves that lock taken, and the next ``wait()`` waits for it for ever.
    """
    if process.returncode is None:
        try:
            process.returncode = os.waitstatus_to_exitcode(os.waitpid(process.pid, 0)[1])
        except ChildProcessError:
            process.returncode = 0  # as poll() has it where somebody else took the status
