"""What a command of another package shares with those of ``hexjet``.

An entry point of the group ``hexjet.commands`` names a :class:`Command`: a function, whose arguments are the options,
and what the command line adds to it.  The function raises ``cosim.InputError`` (status 2) or ``cosim.FlightError``
(status 1), whose message is then the one line on standard error.
"""

from __future__ import annotations

from cosim.base.errors import nearest
from cosim.base.runtime.threads import one_thread
from cosim.cli.console import echo, say, show_result, show_table, terminal
from cosim.cli.declare import Command

__all__ = ["Command", "echo", "nearest", "one_thread", "say", "show_result", "show_table", "terminal"]
