"""What a command of another package shares with those of ``hexjet``.

An entry point of the group ``hexjet.commands`` names a command of click.  It returns its exit status, 0 (``DONE``), or
raises ``cosim.InputError`` (status 2) or ``cosim.FlightError`` (status 1, ``FLIGHT_FAILED``), whose message is then the
one line on standard error.
"""

from cosim.base.errors import nearest
from cosim.cli import opt
from cosim.cli.console import part_progress, say, show_table
from cosim.cli.options import DONE, FLIGHT_FAILED, example, is_given
from cosim.cli.outputs import Out

__all__ = [
    "DONE",
    "FLIGHT_FAILED",
    "Out",
    "example",
    "is_given",
    "nearest",
    "opt",
    "part_progress",
    "say",
    "show_table",
]
