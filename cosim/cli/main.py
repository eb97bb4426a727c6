"""The command line: which command there is, how it ends, and what is said when it fails."""

from __future__ import annotations

import errno
import os
import sys
import tempfile
import warnings
from collections.abc import Callable
from importlib import import_module
from io import TextIOWrapper
from typing import Any

import click

from cosim.base.errors import (
    MACHINE_TROUBLE,
    OUTPUT,
    FlightError,
    InputError,
    Notice,
    NotIdentifiedError,
    nearest,
)
from cosim.base.removed import describe_removed
from cosim.base.trust import at_a_command
from cosim.base.wording import printable_line
from cosim.cli.added import find_added, is_here, load_added, note_taken_names
from cosim.cli.complete import SHELLS, install
from cosim.cli.console import echo, note
from cosim.cli.groups import GROUPS, OTHERS
from cosim.cli.options import DONE, FLIGHT_FAILED, REPORTED, WRONG_INPUT, Terminated, treat_sigterm_as_interrupt
from cosim.cli.trust import trust_prompt, with_trust

INTERRUPTED, TERMINATED = 130, 143  # the exit statuses that shells use
COMMANDS = {  # module of each command: only the one that runs is imported
    "aircraft": "aircraft:aircraft",
    "compare": "results.compare:compare",
    "export": "results.export:export",
    "fly": "flight.fly:fly",
    "fmu": "engine:fmu",
    "gcs": "flight.gcs:gcs",
    "identify": "controllers.identify:identify",
    "list": "results.runs:list_",
    "open": "results.open:open_",
    "report": "results.runs:report",
    "show": "results.show:show",
    "sweep": "sweep:sweep",
}
_LINE = 60  # letters of a command's line


class Commands(click.Group):
    """Commands that are imported when they are asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return all names, those of installed packages among them."""
        note_taken_names(ctx, *COMMANDS)
        return sorted({*COMMANDS, *(name for name in find_added(ctx).names if "." not in name)})

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands in groups; what another package adds is imported for its line."""
        sections = {
            title: [(name, text) for name, text in commands.items() if name in COMMANDS or is_here(ctx, name)]
            for title, commands in GROUPS.items()
        }
        known = {name for commands in GROUPS.values() for name in commands}
        others = {name: self.get_command(ctx, name) for name in self.list_commands(ctx) if name not in known}
        sections[OTHERS] = [
            (name, command.get_short_help_str(_LINE))
            for name, command in others.items()
            if command is not None and not command.hidden
        ]
        for title, rows in sections.items():
            # A wheel has no command of the last group, and click writes no empty list.
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that is named, or raise UsageError with the nearest name."""
        name = args[0]
        if not name.startswith("-") and self.get_command(ctx, name) is None:
            ctx.fail(f"No such command {name!r}; {nearest(name, self.list_commands(ctx))}")
        return super().resolve_command(ctx, args)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command, or None; nothing but its own module is imported for it."""
        if cmd_name in COMMANDS:
            if sys.stderr.isatty():  # to read what is installed takes time, which nobody else has to pay
                note_taken_names(ctx, cmd_name)
            module, _, name = COMMANDS[cmd_name].partition(":")
            command: click.Command = getattr(import_module(f"cosim.cli.{module}"), name)
            return with_trust(command, cmd_name)
        return None if (added := load_added(ctx, cmd_name)) is None else with_trust(added, cmd_name)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="hexjet-cosim", prog_name="hexjet")
@click.option(
    "--install-completion",
    type=click.Choice(SHELLS),
    callback=install,
    expose_value=False,
    is_eager=True,
    help="Let a shell complete commands, options and names.",
)
def cli() -> None:
    """Co-simulation of the Hex-Jet: JSBSim airframe, FMU engines, predictor-based control.

    hexjet COMMAND --help tells a command's options, with an example.
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command ``hexjet``: exits with 0, 1 (the flight failed) or 2 (wrong input, one line)."""
    for stream in (sys.stdout, sys.stderr):  # a character that the terminal lacks must not fail a command
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    output = sys.stdout
    warnings.showwarning = _show_notices(warnings.showwarning)
    words = sys.argv[1:] if arguments is None else arguments
    try:
        with treat_sigterm_as_interrupt(), at_a_command(trust_prompt(), words):
            status = cli.main(args=words, prog_name="hexjet", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        echo(error.ctx.get_help() if error.ctx else "", err=True)
        status = WRONG_INPUT
    except (InputError, FlightError, click.ClickException, OSError, MemoryError) as error:
        if isinstance(error, OSError) and error.errno not in (*MACHINE_TROUBLE, errno.ENAMETOOLONG):
            raise
        message, status = _explain(error)
        _complain(message)
    except SystemExit:
        if sys.stdout is output:
            raise
        # whoever read the output has gone: click has put in its place what does not complain while Python shuts down
        status = DONE
    except (click.Abort, KeyboardInterrupt) as error:
        stop = error.__cause__ or error
        if REPORTED not in getattr(stop, "__notes__", ()):
            _complain("stopped; what was written before is kept")
        status = TERMINATED if isinstance(stop, Terminated) else INTERRUPTED
    sys.exit(status if isinstance(status, int) else DONE)


def _explain(error: InputError | FlightError | click.ClickException | OSError | MemoryError) -> tuple[str, int]:
    """Return the line for an error that ends a command, and the exit status."""
    if isinstance(error, InputError):
        return str(error), FLIGHT_FAILED if isinstance(error, NotIdentifiedError) else WRONG_INPUT
    if (
        isinstance(error, click.NoSuchOption)
        and error.ctx is not None
        and (removed := describe_removed(f"{error.ctx.command_path} {error.option_name}")) is not None
    ):
        return f"{error.option_name}: {removed}", WRONG_INPUT
    if isinstance(error, click.NoSuchOption) and (key := _key_of(error)) is not None:
        return f"No such option {error.option_name!r}; it is a key of the scenario: --set {key}=...", WRONG_INPUT
    if isinstance(error, click.ClickException):
        where = f" ({error.ctx.command_path} --help)" if isinstance(error, click.UsageError) and error.ctx else ""
        return " ".join(error.format_message().split()) + where, WRONG_INPUT
    if isinstance(error, MemoryError):
        return "the memory that this process may have is used up", FLIGHT_FAILED
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        return f"{error.filename}: is longer than a file's name can be", WRONG_INPUT
    return (_machine_trouble(error) if isinstance(error, OSError) else str(error)), FLIGHT_FAILED


def _key_of(error: click.NoSuchOption) -> str | None:
    """Return the key that an option would be, of a command that takes keys; None where there is none."""
    if error.ctx is None or not any("--set" in parameter.opts for parameter in error.ctx.command.params):
        return None
    from cosim.spec.scenario import likely_key

    return likely_key(error.option_name.lstrip("-").replace("-", "_"))


def _machine_trouble(error: OSError) -> str:
    """Return in words what the machine has no more of; what standard output did not take is dropped."""
    if error.filename != OUTPUT:
        return f"{error.strerror}; temporary files are in {tempfile.gettempdir()}"
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, sys.stdout.fileno())  # otherwise Python flushes again at exit, and fails with words of its own
    os.close(nothing)
    return f"{OUTPUT}: {error.strerror}"


def _show_notices(show_other: Callable[..., None]) -> Callable[..., None]:
    """Return what shows a warning: a notice of ours as one line on standard error, any other as before."""

    def show(message: Warning | str, category: type[Warning], *where: Any, **options: Any) -> None:
        if issubclass(category, Notice):
            note(str(message))
        else:
            show_other(message, category, *where, **options)

    return show


def _complain(message: str) -> None:
    echo(f"hexjet: {printable_line(message)}", err=True)
