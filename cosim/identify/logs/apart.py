"""A reader that is not ours, in a process of its own: a file that is damaged can make it run or grow for ever."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path

from cosim.base.compiled import environment
from cosim.base.runtime.processes import Child, python_command

_START = """
import resource, runpy
for what, most in ((resource.RLIMIT_CPU, seconds), (resource.RLIMIT_AS, size), (resource.RLIMIT_CORE, 0)):
    try:
        resource.setrlimit(what, (most, resource.getrlimit(what)[1]))
    except (ValueError, OSError):  # a lower limit is there, or the system has none
        pass
del sys.argv[0]
runpy.run_path(sys.argv[0], run_name="__main__")
"""
MOST_SILENT = 30.0  # times its limit of CPU that a child may take by the clock: on a machine that is busy, or asleep


class EndedError(Exception):
    """The child ended without an answer; the text says what became of it: it ..."""


def run_apart(program: Path, arguments: Sequence[str], seconds: float, megabytes: float) -> bytes:
    """Run a Python program with the packages of this process and return what it wrote on standard output.

    It may take ``seconds`` of CPU and ``megabytes`` of address space, and does not see the current folder's modules.
    Raises EndedError where it did not come to its end.
    """
    limits = f"seconds, size = {int(seconds) + 1}, {int(megabytes * 2**20)}"
    child = Child(
        python_command(f"{limits}\n{_START}", str(program), *arguments),
        environ={**environment(), "OPENBLAS_NUM_THREADS": "1"},  # each of its threads would ask for address space
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        answer, _ = child.communicate(timeout=MOST_SILENT * seconds)
    except subprocess.TimeoutExpired:
        raise EndedError(f"was not done within {MOST_SILENT * seconds:.3g} s") from None
    finally:
        child.end()
        if child.stdout is not None:
            child.stdout.close()
    if child.returncode == -signal.SIGXCPU:
        raise EndedError(f"was not done within {seconds:.3g} s of processor time")
    if child.returncode:
        raise EndedError(f"ended its process (status {child.returncode})")
    return answer
