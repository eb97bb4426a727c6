"""What a command of another package shares with those of ``hexjet``.

An entry point of the group ``hexjet.commands`` names a :class:`Command`: a function, whose arguments are the options,
and what the command line adds to it.  The function raises ``cosim.InputError`` (status 2) or ``cosim.FlightError``
(status 1), whose message is then the one line on standard error.
"""

from __future__ import annotations

from cosim.base.errors import nearest
from cosim.base.runtime.threads import one_thread
from cosim.cli.console import (
    CommandProgress,
    echo,
    output_to_stderr,
    part_progress,
    say,
    show_result,
    show_table,
    terminal,
)
from cosim.cli.declare import Command
from cosim.cli.old import opt
from cosim.cli.old.options import DONE, FLIGHT_FAILED, example, warn_of_fmu_defects

__all__ = [
    "DONE",
    "FLIGHT_FAILED",
    "Command",
    "CommandProgress",
    "echo",
    "example",
    "nearest",
    "one_thread",
    "opt",
    "output_to_stderr",
    "part_progress",
    "say",
    "show_result",
    "show_table",
    "terminal",
    "warn_of_fmu_defects",
]
