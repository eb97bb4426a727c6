"""What several commands share: exit statuses, the example of a help, and a warning."""

from __future__ import annotations

from pathlib import Path

from cosim.api.call import choices
from cosim.cli.console import echo

DONE, FLIGHT_FAILED = 0, 1


def example(text: str) -> str:
    """Return what click shows of an example below a command's options."""
    return f"\b\nExample:\n  {text}"


def warn_of_fmu_defects(*engines: str, folder: Path = Path(), isolated: bool | None = None) -> None:
    """Tell on standard error what of a foreign FMU's description, seen from ``folder``, is not as FMI has it."""
    for line in choices.list_fmu_defects(*engines, folder=folder, isolated=isolated):
        echo(f"hexjet: warning: {line}", err=True)
