"""The process in which a foreign FMU is tried: started by ``cosim.engine.qualify.supervisor``, and by nobody else."""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
from collections.abc import Callable
from typing import Any

from cosim.base.runtime.processes import die_with_parent
from cosim.base.storage.files import write_all

Say = Callable[[dict[str, Any]], None]


def main(pipe: int) -> None:
    """Read a task from standard input, do it, and say through ``pipe`` what is being done and what was found."""
    os.set_inheritable(pipe, False)
    order = json.load(sys.stdin)
    die_with_parent()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, float(order["seconds"]))  # end this process if the parent is gone
    tempfile.tempdir = os.getcwd()  # the parent removes this folder, however this process ends
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)

    def say(message: dict[str, Any]) -> None:
        write_all(pipe, json.dumps(message, allow_nan=False).encode() + b"\n")

    from cosim.engine.qualify.trial import run_task

    run_task(order["task"], say)
    say({"done": True, "at": "when its process ended"})
