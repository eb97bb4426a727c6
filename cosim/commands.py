"""What a command of another package shares with those of ``hexjet``.

An entry point of the group ``hexjet.commands`` names a command of click.  It returns its exit status, 0 (``DONE``), or
raises ``cosim.InputError`` (status 2) or ``cosim.FlightError`` (status 1, ``FLIGHT_FAILED``), whose message is then the
one line on standard error.
"""

from cosim.base.errors import nearest
from cosim.base.runtime.threads import one_thread
from cosim.cli import opt
from cosim.cli.console import CommandProgress, echo, output_to_stderr, part_progress, say, show_table, terminal
from cosim.cli.flight.fly import print_run
from cosim.cli.groups import Group
from cosim.cli.options import DONE, FLIGHT_FAILED, Flight, example, is_given, load_scenario, warn_of_fmu_defects
from cosim.cli.outputs import Out

__all__ = [
    "DONE",
    "FLIGHT_FAILED",
    "CommandProgress",
    "Flight",
    "Group",
    "Out",
    "echo",
    "example",
    "is_given",
    "load_scenario",
    "nearest",
    "one_thread",
    "opt",
    "output_to_stderr",
    "part_progress",
    "print_run",
    "say",
    "show_table",
    "terminal",
    "warn_of_fmu_defects",
]
