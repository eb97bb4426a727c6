"""What several commands share: kinds of options, exit statuses, the scenario that a command line states."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from cosim.api.call import choices
from cosim.cli.console import echo, note
from cosim.cli.old import opt

if TYPE_CHECKING:
    from cosim.spec.scenario import Scenario

DONE, FLIGHT_FAILED, WRONG_INPUT = 0, 1, 2


def example(text: str) -> str:
    """Return what click shows of an example below a command's options."""
    return f"\b\nExample:\n  {text}"


class Flight(opt.Record):
    """What flies: a scenario, and what a command line writes over it."""

    scenario: str = "hover"
    controller: str | None = None
    aircraft: str | None = None
    engines: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    model: Path | None = None
    seed: int | None = None
    metrics: tuple[str, ...] = ()
    own_observers: tuple[str, ...] = ()
    sensors: str | None = None
    wind: str | None = None
    unchecked_engine: bool = False

    def load(self) -> Scenario:
        """Return the scenario with the choices of the command line.  Raises InputError for a wrong one."""
        scenario = load_scenario(
            self.scenario, self.controller, self.engines, self.seed, self.settings, self.model, self.aircraft
        )
        changes = choices.plugin_changes(self.metrics, self.own_observers, self.sensors, self.wind)
        if self.sensors or self.wind:  # its expectations do not apply with them
            changes["expect"] = []
        if self.unchecked_engine:
            changes["engine_unchecked"] = True
        return scenario.replace(**changes) if changes else scenario


def is_given(name: str) -> bool:
    """Return whether an option of the running command is on its command line."""
    return click.get_current_context().get_parameter_source(name) is ParameterSource.COMMANDLINE


def warn_of_fmu_defects(*engines: str, folder: Path = Path(), isolated: bool | None = None) -> None:
    """Tell on standard error what of a foreign FMU's description, seen from ``folder``, is not as FMI has it."""
    for line in choices.list_fmu_defects(*engines, folder=folder, isolated=isolated):
        echo(f"hexjet: warning: {line}", err=True)


def load_scenario(
    name: str,
    controller: str | None,
    engines: tuple[str, ...],
    seed: int | None,
    settings: tuple[str, ...],
    model: Path | None = None,
    aircraft: str | None = None,
) -> Scenario:
    """Return the scenario with the command line's choices written over it, with notes on standard error."""
    return choices.load_scenario(name, controller, engines, seed, settings, model, aircraft, note)
