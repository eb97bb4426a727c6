"""Commands that are still written for click, as commands of this package."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click

from cosim.base.errors import InputError
from cosim.base.removed import describe_removed
from cosim.base.trust import trust_everything

_HELP = "Run code though you never flew what is in its folder, Python, FMUs and programs, and remember it."


def with_trust(command: click.Command, name: str) -> click.Command:
    """Return a command with the option ``--trust``, where it may run code; of a group, every such command."""
    if isinstance(command, click.Group):
        for inner in command.commands.values():
            with_trust(inner, f"{name} {inner.name}")
    elif not any("--trust" in parameter.opts for parameter in command.params):
        option = click.Option(["--trust"], is_flag=True, expose_value=False, is_eager=True, help=_HELP, callback=_trust)
        command.params.append(option)
    return command


def _trust(context: click.Context, parameter: click.Parameter, is_set: bool) -> None:
    if is_set:
        trust_everything()


class Unconverted:
    """A command of click with what a command of this package has."""

    def __init__(self, name: str, command: click.Command) -> None:
        self.name, self.command = name, with_trust(command, name)

    @property
    def texts(self) -> tuple[str, dict[str, str]]:
        """What it is for."""
        return (self.command.help or "").strip(), {}

    def help(self, width: int | None = None) -> str:
        """Return the help."""
        context = click.Context(self.command, info_name=f"hexjet {self.name}", terminal_width=width)
        return self.command.get_help(context)

    def read(self, words: Sequence[str]) -> dict[str, Any]:
        """Return what a command line states."""
        return self.command.make_context(self.name, [*words]).params

    def run(self, words: Sequence[str]) -> int:
        """Run it.  Raises InputError for what click refuses."""
        settings: Any = {"help_option_names": ["-h", "--help"], "max_content_width": 110}
        self.command.context_settings |= settings
        try:
            status = self.command.main(args=[*words], prog_name=f"hexjet {self.name}", standalone_mode=False)
        except click.exceptions.NoArgsIsHelpError as error:
            click.echo(error.ctx.get_help() if error.ctx else "", err=True)
            return 2
        except click.NoSuchOption as error:
            removed = describe_removed(f"{error.ctx.command_path if error.ctx else ''} {error.option_name}")
            if removed is not None:
                raise InputError(f"{error.option_name}: {removed}") from None
            if (key := _key_of(error)) is not None:
                text = f"No such option {error.option_name!r}; it is a key of the scenario: --set {key}=..."
                raise InputError(text) from None
            raise InputError(_describe(error)) from None
        except click.ClickException as error:
            raise InputError(_describe(error)) from None
        except click.Abort as error:
            raise (error.__cause__ or KeyboardInterrupt()) from None
        return status if isinstance(status, int) else 0


def _describe(error: click.ClickException) -> str:
    where = f" ({error.ctx.command_path} --help)" if isinstance(error, click.UsageError) and error.ctx else ""
    return " ".join(error.format_message().split()) + where


def _key_of(error: click.NoSuchOption) -> str | None:
    """Return the key that an option would be, of a command that takes keys; None where there is none."""
    if error.ctx is None or not any("--set" in parameter.opts for parameter in error.ctx.command.params):
        return None
    from cosim.spec.scenario import likely_key

    return likely_key(error.option_name.lstrip("-").replace("-", "_"))
