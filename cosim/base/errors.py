"""The three ways in which something can go wrong, and whose business each is."""

from __future__ import annotations

import errno

# Of a failed system call: the machine has no more to give, and nobody's input is wrong.
MACHINE_TROUBLE = (errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EMFILE, errno.ENFILE)


class InputError(ValueError):
    """The user's input is wrong: one line that names what, where and what is allowed (exit status 2)."""


class FlightError(RuntimeError):
    """Something failed while the vehicle flew: the run ends as ``failed`` and its log is kept (exit status 1)."""


class EngineError(FlightError):
    """An engine returned an error or a value that is not finite; the message names engine, step and time."""
