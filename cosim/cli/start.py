"""The entry of the command: until what it is made of is read, Ctrl-C ends it without a word: nothing is begun yet."""

from __future__ import annotations

import atexit
import gc
import io
import os
import signal
import sys
from typing import Any

from cosim.base.errors import STDOUT_NAME
from cosim.base.runtime.kernels import set_for_command


def main() -> None:
    """Run the command ``hexjet``."""
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    _limit_garbage_collection()
    set_for_command()
    open_standard_streams()
    sys.stdout = named_output()
    from cosim.cli.main import main as command

    signal.signal(signal.SIGINT, before)
    command()


def _limit_garbage_collection() -> None:
    """Let Python collect garbage rarely, and not at the process's end."""
    # The 100 000 objects that a command imports live to its end, so that searching them frees nothing.
    gc.set_threshold(200_000, 20, 100)
    atexit.register(gc.freeze)


def open_standard_streams() -> None:
    """Open standard streams that are closed, as in a daemon's child, to the null device.

    Else the next files that are opened get their numbers, and what a library prints is written into a log.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:  # a lower number was free
                os.dup2(opened, number)
                os.close(opened)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


class _NamedOutput(io.FileIO):
    """Standard output whose write errors name it, which the system's errors do not."""

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            raise OSError(error.errno, error.strerror, STDOUT_NAME) from None


def named_output() -> io.TextIOWrapper:
    """Return standard output with the same settings, whose write errors name it."""
    now = sys.stdout
    return io.TextIOWrapper(
        io.BufferedWriter(_NamedOutput(1, "w", closefd=False)),
        encoding=now.encoding,
        errors=now.errors,
        line_buffering=now.isatty(),
    )
