"""hexjet export: a run's log in other formats; tools add commands for other things."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Any

import click

from cosim.cli import opt
from cosim.cli.console import echo
from cosim.cli.groups import Group
from cosim.cli.options import DONE, example
from cosim.cli.outputs import Out
from cosim.cli.trust import display_only
from cosim.results.export import list_endings


class Export(Group):
    """``hexjet export DIR --to FORMAT`` is a run's log; what a first word names is something else."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Hand what does not begin with the name of a command to that of logs."""
        if args and args[0] not in (*self.list_commands(ctx), *self.get_help_option_names(ctx)):
            args = [_LOG, *args]
        return super().parse_args(ctx, args)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return one of the commands, or that of logs."""
        return log if cmd_name == _LOG else super().get_command(ctx, cmd_name)


_LOG = "DIR"  # name of the argument in the help


@click.group(cls=Export, epilog=example("hexjet export runs/roll-doublet-smith-001 --to ulog"))
def export() -> None:
    """Write the log of a run, a controller or the vehicle for other tools.

    \b
    hexjet export DIR --to FORMAT  the log of the run in DIR: ulog, mcap, mat,
                                   csv, parquet; see: hexjet export DIR --help
    hexjet export controller       a controller as C99 and as FMUs, with a test
    hexjet export vehicle          the vehicle as FMUs for other masters

    A run in a folder called "controller" is ./controller.
    """


_ENDINGS = list_endings()


class Log(opt.Output):
    """Options of ``hexjet export DIR``."""

    folder: Path = opt.argument(type=click.Path(path_type=Path), metavar="")
    target: Any = opt.option("--to", type=opt.Choice([*_ENDINGS]), required=True, help="The format.")
    out = opt.out(
        "The file, or its folder; what is there is overwritten.  [default: flight.ulg, .mcap, .mat or .csv in DIR]",
        "FILE|DIR",
        Out(*chain.from_iterable(_ENDINGS.values())),
    )
    rates = opt.choice(
        "--rates", ["all", "px4"], "ULog: every step, or each topic about as often as PX4 logs it.", "all"
    )


@click.command(_LOG, epilog=example("hexjet export runs/roll-doublet-smith-001 --to mcap --out flight.mcap"))
@opt.takes(Log)
@display_only
def log(options: Log) -> int:
    """Write the log of the run in DIR for other tools.

    \b
    ulog     PlotJuggler, Flight Review: float32, with parameters, events and faults
    mcap     Foxglove, PlotJuggler, Rerun: every column, and the vehicle in 3-D
    mat      MATLAB, level 5: the structure "flight"
    csv      every column with all its digits
    parquet  a copy of the run's own, which says what was flown
    """
    from cosim.api.export import export as write

    echo(str(write(options.folder, options.target, options.out, rates=options.rates)))
    return DONE
