"""Child processes with limits.

They are started so that they see no stranger's modules, held to limits, asked how they ended, and ended with
everything that they have started themselves.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING, Any

from cosim.base.compiled import PACKAGE
from cosim.base.runtime.pipes import Pipes, require_poll

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

_MARK = "HEXJET_PROCESS"  # environment variable: which of our processes a process comes from, each behind its parent
_SILENT: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
_PR_SET_PDEATHSIG = 1  # of linux/prctl.h
# A lower limit may be there, or the system has none.
_LIMIT = """
try:
    import resource
    for what, most in ((resource.RLIMIT_CPU, {seconds}), (resource.RLIMIT_AS, {size}), (resource.RLIMIT_CORE, 0)):
        try:
            most is None or resource.setrlimit(what, (most, resource.getrlimit(what)[1]))
        except (ValueError, OSError):
            pass
except ImportError:
    pass
"""


def python_command(code: str, *arguments: str, seconds: int | None = None, megabytes: float | None = None) -> list[str]:
    """Return the command that runs ``code`` in this interpreter; it finds ``arguments`` behind ``sys.argv[0]``.

    Where ``seconds`` are stated, it may take so much CPU, and ``megabytes`` of address space, and leaves no core file;
    beyond the first the system ends it by SIGXCPU.

    It imports what this process would import, from the same places (``PYTHONPATH`` included), but never from the
    current folder: whatever lies beside a scenario, ``numpy.py`` for one, is not ours to run.
    """
    places = [os.path.abspath(place) for place in sys.path if place]  # the empty one is the current folder
    home = str(PACKAGE.parent)
    places += [] if home in places else [home]
    size = None if megabytes is None else int(megabytes * 2**20)
    limit = "" if seconds is None else _LIMIT.format(seconds=seconds, size=size)
    return [sys.executable, "-P", "-c", f"import sys; sys.path[:] = {places!r}\n{limit}{code}", *arguments]


class Child(subprocess.Popen[bytes]):
    """A process that leads a process group, and is ended with everything that it has started.

    It inherits ``environ``, by default that of this process.
    ``how`` is as of ``subprocess.Popen``.
    """

    def __init__(self, command: Sequence[str], environ: Mapping[str, str] | None = None, **how: Any) -> None:
        self._mark = f"{os.environ.get(_MARK, '')}/{token_hex(8)}"
        inherited = os.environ if environ is None else environ
        super().__init__(command, env={**inherited, _MARK: self._mark}, process_group=0, **how)

    @classmethod
    def connect(
        cls, code: str, *arguments: str, environ: Mapping[str, str] | None = None
    ) -> tuple[Child, Connection[Any, Any]]:
        """Start Python code with nothing to read or print; return the process and the connection to it.

        The code finds the file descriptor of its end of the connection in ``sys.argv[1]``, and ``arguments`` behind.
        Raises OSError where it cannot be started.
        """
        from multiprocessing.connection import Pipe

        ours, theirs = Pipe()
        with theirs:
            number = theirs.fileno()
            try:
                command = python_command(code, str(number), *arguments)
                return cls(command, environ, pass_fds=[number], **_SILENT), ours
            except BaseException:
                ours.close()
                raise

    @classmethod
    def open_pipes(cls, code: str) -> tuple[Child, Pipes]:
        """Start Python code with nothing to read or print; return the process and the pipes to it.

        The code finds the file descriptors of its own ends in ``sys.argv``, that to read from first.  Raises OSError
        where it cannot be started, InputError where the system has no such pipes, as Windows.
        """

        return _start_with_pipes(
            lambda reader, writer: cls(
                python_command(code, str(reader), str(writer)), pass_fds=(reader, writer), **_SILENT
            )
        )

    @classmethod
    def open_program(cls, command: Sequence[str], **how: Any) -> tuple[Child, Pipes]:
        """Start a command; return the process and the pipes that are its standard input and output.

        Raises as :meth:`open_pipes`.
        """

        return _start_with_pipes(lambda reader, writer: cls(command, stdin=reader, stdout=writer, **how))

    def finish(self, limit: float) -> tuple[bytes, bytes]:
        """Return what it prints until its end, and leave nothing of it behind.

        Raises subprocess.TimeoutExpired where it has not ended within ``limit`` s of the clock.
        """
        try:
            return self.communicate(timeout=limit)
        finally:
            self.end()
            for stream in (self.stdout, self.stderr):
                if stream is not None:
                    stream.close()

    def describe_end(self, patience: float, signalled: str, left: str) -> str:
        """Return how it ended: ``signalled`` with the signal's name, or ``left`` with its status, in place of ``{}``.

        Empty where it has not ended within ``patience`` s.
        """
        with suppress(subprocess.TimeoutExpired):
            status = self.wait(patience)
            return signalled.format(signal.Signals(-status).name) if status < 0 else left.format(status)
        return ""

    def end(self, patience: float = 0.0) -> None:
        """Kill the process and all that came from it, in whatever session, and wait until it is gone.

        It may end by itself within ``patience`` s first.
        """
        if patience:
            with suppress(subprocess.TimeoutExpired):
                self.wait(patience)
        end_group(self)
        if sys.platform == "linux":
            _kill_marked(f"{_MARK}={self._mark}".encode())


def _start_with_pipes(start: Callable[[int, int], Child]) -> tuple[Child, Pipes]:
    """Return a process and the pipes to it; ``start`` gets the ends that are its, that to read from first."""
    require_poll()
    down, up = os.pipe(), os.pipe()
    pipes = Pipes(up[0], down[1])
    try:
        return start(down[0], up[1]), pipes
    except BaseException:
        pipes.close()
        raise
    finally:
        os.close(down[0])
        os.close(up[1])


def run_child(command: Sequence[str], limit: float, **how: Any) -> subprocess.CompletedProcess[str]:
    """Run a command to its end with what it prints captured as text, and end all that it leaves behind.

    ``how`` is as of :class:`Child`.  Raises OSError where it cannot be started, subprocess.TimeoutExpired where it has
    not ended within ``limit`` s of the clock.
    """
    child = Child(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **how)
    out, error = (text.decode(errors="replace") for text in child.finish(limit))
    return subprocess.CompletedProcess(command, child.returncode, out, error)


def _kill_marked(mark: bytes) -> None:
    """Kill the processes that have ``mark`` in their environment, until there are none: one may start another."""
    while found := list(_find_marked(mark)):
        for process in found:
            with suppress(OSError):
                os.kill(process, signal.SIGKILL)


def _find_marked(mark: bytes) -> Iterator[int]:
    """Yield the processes that a child has started; one that is killed has no environment any more."""
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


def die_with_parent(number: int = 9) -> None:
    """Have the system send this process a signal, by default SIGKILL, when the thread that started it goes.

    Only Linux does that.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number, 0, 0, 0)


def measure_megabytes(process: int) -> float:
    """Return the resident memory of a process [MB of 2**20 bytes]; 0 where there is no ``/proc`` to tell."""
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
