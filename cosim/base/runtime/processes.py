"""How a process that was started is ended, whatever came in between."""

from __future__ import annotations

import os
import signal
import subprocess
from contextlib import suppress
from typing import Any


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
