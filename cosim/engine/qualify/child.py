"""The process in which a foreign FMU is tried: started by ``cosim.engine.qualify.supervisor``, and by nobody else."""

from __future__ import annotations

import ctypes
import json
import os
import resource
import signal
import sys
import tempfile
from collections.abc import Callable
from typing import Any

PR_SET_PDEATHSIG = 1  # from linux/prctl.h

Say = Callable[[dict[str, Any]], None]


def main(pipe: int) -> None:
    """Read a task from standard input, do it, and say through ``pipe`` what is being done and what was found."""
    os.set_inheritable(pipe, False)
    order = json.load(sys.stdin)
    _limit(float(order["seconds"]))
    tempfile.tempdir = os.getcwd()  # what the parent removes, however this ends
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)

    def say(message: dict[str, Any]) -> None:
        data = json.dumps(message, allow_nan=False).encode() + b"\n"
        while data:
            data = data[os.write(pipe, data) :]

    from cosim.engine.qualify.trial import perform

    perform(order["task"], say)
    say({"done": True, "at": "when its process ended"})


def die_with_parent() -> None:
    """A parent that is killed leaves nobody to look after this process."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)


def _limit(seconds: float) -> None:
    """The ends that need no parent."""
    die_with_parent()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    most = int(seconds) + 1
    if hard == resource.RLIM_INFINITY or most < hard:
        resource.setrlimit(resource.RLIMIT_CPU, (most, hard))
