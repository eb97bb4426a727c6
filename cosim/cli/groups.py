"""The commands in groups, each with a line of its own, as ``hexjet --help`` has them."""

from __future__ import annotations

import click

from cosim.base.removed import describe_removed
from cosim.cli.added import find_added, load_added
from cosim.cli.trust import with_trust

GROUPS = {
    "Fly": {
        "fly": "fly a scenario and leave a run's folder",
        "replay": "fly a recorded flight again, and judge the model by it",
    },
    "Look": {
        "list": "list what can be flown",
        "show": "show one of them, or a run, with its numbers",
        "open": "look through runs in the browser",
        "compare": "lay flights over each other",
        "report": "write the page of a run or a campaign again",
    },
    "Design": {
        "aircraft": "begin an aircraft of your own, and check one",
        "fmu": "build and check engines as FMUs",
        "identify": "fit a model to a chirp or a log",
        "design": "design predictor and gains for an engine",
        "margins": "measure gain, phase and delay margins in flight",
        "validate": "fly a model with the commands of a log",
    },
    "Prove": {
        "sweep": "fly a scenario many times with what varies drawn",
        "search": "find the smallest change that breaks a controller",
        "rare": "find the probability of a rare failure",
        "prove": "show or refute a claim, on one page",
        "faults": "fly every single fault",
        "failsafes": "let everything fail that the autopilot answers",
        "paper": "reproduce the paper",
    },
    "Connect": {
        "gcs": "wait on the ground for a ground station",
        "sitl": "let an external autopilot fly the vehicle",
        "export": "write a log, a controller or the vehicle for other tools",
    },
    "Develop": {
        "bench": "measure what a flight costs on this machine",
    },
}
OTHERS = "Of other packages"
_WHOLE = 1000  # letters: no first sentence is longer


class Group(click.Group):
    """A group of commands, those that tools add to it among them; its help has the whole first sentence of each."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return all names, those of installed packages among them."""
        prefix = f"{self.name}."
        added = (name.removeprefix(prefix) for name in find_added(ctx).names if name.startswith(prefix))
        return sorted({*super().list_commands(ctx), *added})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command, or None; one of a tool is imported for it."""
        if (command := super().get_command(ctx, cmd_name)) is not None:
            return command
        added = load_added(ctx, f"{self.name}.{cmd_name}")
        return None if added is None else with_trust(added, f"{self.name} {cmd_name}")

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that is named; raise UsageError with what to use instead of one that left."""
        if (removed := describe_removed(f"{ctx.command_path} {args[0]}")) is not None:
            ctx.fail(f"{args[0]}: {removed}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands."""
        found = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        rows = [
            (name, command.get_short_help_str(_WHOLE))
            for name, command in found.items()
            if command is not None and not command.hidden
        ]
        if rows:
            with formatter.section("Commands"):
                formatter.write_dl(rows)
