"""The process that foreign code runs in: started, asked, limited and ended in one way.

Engines' and controllers' FMUs, controllers that are programs, readers of logs, JSBSim models on trial, workers and
autopilots: each sees no stranger's modules, is held to limits, is asked how it ended, and is ended with everything that
it has started itself.
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
from typing import TYPE_CHECKING, Any, TypeVar

from cosim.base.compiled import PACKAGE
from cosim.base.errors import FlightError
from cosim.base.runtime.pipes import Pipes, require_poll

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

T = TypeVar("T")  # result type of a call

# Environment variable with the chain of this package's processes that started a process.
_LINEAGE_VARIABLE = "HEXJET_PROCESS"
_NO_STREAMS: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
# Sets resource limits in the child; errors are ignored, because a lower limit may be set or the system has none.
_LIMIT_CODE = """
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


class HostError(FlightError):
    """Raised if a process fails; the message is a clause such as ``the process did not answer within 4 s``."""


def python_command(code: str, *arguments: str, seconds: int | None = None, megabytes: float | None = None) -> list[str]:
    """Return the command line that runs ``code`` in this interpreter, with ``arguments`` in ``sys.argv[1:]``.

    Where ``seconds`` are stated, it may take so much CPU, and ``megabytes`` of address space, and leaves no core file;
    beyond the first the system ends it by SIGXCPU.

    It imports what this process would import, from the same places (``PYTHONPATH`` included), but never from the
    current folder: whatever lies beside a scenario, ``numpy.py`` for one, is not ours to run.
    """
    places = [os.path.abspath(place) for place in sys.path if place]  # an empty entry means the current folder
    home = str(PACKAGE.parent)
    places += [] if home in places else [home]
    size = None if megabytes is None else int(megabytes * 2**20)
    limit = "" if seconds is None else _LIMIT_CODE.format(seconds=seconds, size=size)
    return [sys.executable, "-P", "-c", f"import sys; sys.path[:] = {places!r}\n{limit}{code}", *arguments]


class Host(subprocess.Popen[bytes]):
    """Child process with its own process group, which is ended with all its descendants.

    It inherits ``environ``, by default that of this process.
    ``how`` is as of ``subprocess.Popen``.

    One that :meth:`open` starts answers what it is asked.  Each call raises HostError where it does not answer within
    ``limit`` s of the clock, has ended, or takes more memory than it may.
    """

    pipes: Pipes | None = None
    _megabytes: float | None = None
    _exchanges = 0

    def __init__(self, command: Sequence[str], environ: Mapping[str, str] | None = None, **how: Any) -> None:
        self._mark = f"{os.environ.get(_LINEAGE_VARIABLE, '')}/{token_hex(8)}"
        inherited = os.environ if environ is None else environ
        super().__init__(command, env={**inherited, _LINEAGE_VARIABLE: self._mark}, process_group=0, **how)

    @classmethod
    def open(
        cls,
        command: Sequence[str],
        environ: Mapping[str, str] | None = None,
        megabytes: float | None = None,
        **how: Any,
    ) -> Host:
        """Start a command that reads requests from standard input and answers on standard output.

        ``megabytes``: of resident memory that it may take, where there is a ``/proc`` to tell.
        Raises OSError where it cannot be started, InputError where the system has no such pipes, as Windows.
        """
        require_poll()
        down, up = os.pipe(), os.pipe()
        pipes = Pipes(up[0], down[1])
        try:
            host = cls(command, environ, stdin=down[0], stdout=up[1], **how)
        except BaseException:
            pipes.close()
            raise
        finally:
            os.close(down[0])
            os.close(up[1])
        host.pipes, host._megabytes, pipes.watch = pipes, megabytes, host._check_memory
        return host

    @classmethod
    def connect(
        cls, code: str, *arguments: str, environ: Mapping[str, str] | None = None
    ) -> tuple[Host, Connection[Any, Any]]:
        """Start Python code without standard streams; return the process and a connection to it.

        The code finds the file descriptor of its end of the connection in ``sys.argv[1]``, and ``arguments`` behind.
        Raises OSError where it cannot be started.
        """
        from multiprocessing.connection import Pipe

        ours, theirs = Pipe()
        with theirs:
            number = theirs.fileno()
            try:
                command = python_command(code, str(number), *arguments)
                return cls(command, environ, pass_fds=[number], **_NO_STREAMS), ours
            except BaseException:
                ours.close()
                raise

    def send(self, data: bytes, limit: float) -> None:
        """Write all of ``data`` to the process."""
        self._call(self._pipes.send, data, limit)

    def read_line(self, max_bytes: int, limit: float) -> bytes:
        """Read one line from the process and return it without its line end."""
        return self._call(self._pipes.receive_line, max_bytes, limit)

    def exchange(self, data: bytes, count: int, limit: float) -> bytes:
        """Write all of ``data`` to the process and read ``count`` bytes."""
        return self._call(self._pipes.exchange, data, count, limit)

    def exchange_message(self, data: bytes, max_bytes: int, limit: float) -> bytes:
        """Send a message and receive the answer: see :meth:`cosim.base.runtime.pipes.Pipes.send_message`."""
        return self._call(self._pipes.exchange_message, data, max_bytes, limit)

    @property
    def _pipes(self) -> Pipes:
        if self.pipes is None:
            raise HostError("the process was ended before")
        return self.pipes

    def _call(self, call: Callable[..., T], *arguments: Any, exchanges_per_check: int = 250, end_s: float = 1.0) -> T:
        self._exchanges += 1
        if self._exchanges % exchanges_per_check == 0:
            self._check_memory()
        try:
            return call(*arguments)
        except TimeoutError:
            raise HostError(f"the process did not answer within {arguments[-1]:g} s") from None
        except ValueError as error:
            raise HostError(f"the process answered too much: {error}") from None
        except (EOFError, OSError):
            raise HostError(f"the process {self.describe_end(end_s) or 'closed its output'}") from None

    def _check_memory(self) -> None:
        if self._megabytes is not None and (size := measure_megabytes(self.pid)) > self._megabytes:
            raise HostError(f"the process takes {size:.0f} MB of memory, {self._megabytes:g} MB at most")

    def describe_end(self, patience: float) -> str:
        """Describe how the process ended; an empty string if it has not ended within ``patience`` s."""
        with suppress(subprocess.TimeoutExpired):
            return _describe_status(self.wait(patience))
        return ""

    def __exit__(self, *error: Any) -> None:
        """End it: whoever leaves with an error would wait for ever for one that waits to be asked."""
        self.end()
        super().__exit__(*error)

    def end(self, patience: float = 0.0) -> None:
        """Close its pipes, kill it and all its descendants in any session, and wait for their end.

        It may end by itself within ``patience`` s first.  May be called again.
        """
        if self.pipes is not None:
            self.pipes.close()
            self.pipes = None
        if patience:
            with suppress(subprocess.TimeoutExpired):
                self.wait(patience)
        end_group(self)
        if sys.platform == "linux":
            _kill_descendants(f"{_LINEAGE_VARIABLE}={self._mark}".encode())


def run_to_end(
    command: Sequence[str], limit: float, environ: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[bytes]:
    """Run a command without input to its end, and kill the processes that it leaves running.

    Raises OSError where it cannot be started, HostError where it has not ended within ``limit`` s of the clock.
    """
    host = Host(command, environ, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        out, error = host.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        raise HostError(f"the process was not done within {limit:g} s") from None
    finally:
        host.end()
        for stream in (host.stdout, host.stderr):
            if stream is not None:
                stream.close()
    return subprocess.CompletedProcess(command, host.returncode, out, error)


def run_code(
    code: str, *arguments: str, seconds: float, megabytes: float, environ: Mapping[str, str] | None = None
) -> bytes:
    """Return the output of Python code that is limited to ``seconds`` of CPU and ``megabytes`` of address space.

    By the clock it may take thirty times as long: the machine may be busy, or asleep.  Raises HostError where it does
    not end well.
    """
    command = python_command(code, *arguments, seconds=int(seconds) + 1, megabytes=megabytes)
    done = run_to_end(command, 30.0 * seconds, environ)
    if done.returncode == -signal.SIGXCPU:
        raise HostError(f"the process was not done within {seconds:.3g} s of CPU")
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().rpartition("\n")[2] if done.returncode > 0 else ""
        raise HostError(f"the process {_describe_status(done.returncode)}{f' ({last})' if last else ''}")
    return done.stdout


def _describe_status(status: int) -> str:
    return f"was ended by {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"


def _kill_descendants(mark: bytes) -> None:
    """Kill all processes with ``mark`` in their environment, repeatedly, because one may start another."""
    while found := list(_find_descendants(mark)):
        for process in found:
            with suppress(OSError):
                os.kill(process, signal.SIGKILL)


def _find_descendants(mark: bytes) -> Iterator[int]:
    """Yield the processes started by a host, found by their environment."""
    for file in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):  # another user's process, or it has ended
            if mark in file.read_bytes():
                yield int(file.parent.name)


def end_group(process: subprocess.Popen[Any]) -> None:
    """Kill the process group that ``process`` leads, and wait for its end."""
    with suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL)
    reap(process)


def reap(process: subprocess.Popen[Any]) -> None:
    """Wait for a killed process by the system's call, because its ``wait()`` may never return after a Ctrl-C.

    ``poll()`` and ``wait()`` of ``subprocess`` take a lock of the process.  An interrupt between the taking and the
    ``try`` behind it, or in the giving back, leaves that lock taken, and the next ``wait()`` waits for it for ever.
    """
    if process.returncode is None:
        try:
            process.returncode = os.waitstatus_to_exitcode(os.waitpid(process.pid, 0)[1])
        except ChildProcessError:
            process.returncode = 0  # poll() returns 0 for an ended process


def serve_pipes() -> Pipes:
    """Return the child's ends of the pipes to its host.

    What foreign code reads from standard input is empty, and what it prints goes to standard error.
    """
    pipes = Pipes(os.dup(0), os.dup(1))
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    return pipes


def die_with_parent(number: int = 9, signal_option: int = 1) -> None:
    """Make the system send this process a signal, by default SIGKILL, when the thread that started it ends.

    Only Linux does that.  ``signal_option``: PR_SET_PDEATHSIG of linux/prctl.h.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(signal_option, number, 0, 0, 0)


def measure_megabytes(process: int) -> float:
    """Return the resident memory of a process [MB of 2**20 bytes]; 0 without ``/proc``."""
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
