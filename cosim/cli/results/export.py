"""hexjet export: a run's log in other formats, a controller as C and as FMUs, a vehicle as FMUs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from cosim.api.call import Result
from cosim.cli import opt
from cosim.cli.console import CommandProgress, echo
from cosim.cli.groups import Group
from cosim.cli.options import DONE, FLIGHT_FAILED, Flight, example
from cosim.cli.outputs import Out
from cosim.cli.trust import display_only
from cosim.results.export import FILES, LOG_ENDINGS


class Export(Group):
    """``hexjet export DIR --to FORMAT`` is a run's log; what a first word names is something else."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Hand what does not begin with the name of a command to that of logs."""
        if args and args[0] not in (*self.commands, *self.get_help_option_names(ctx)):
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


_LOG_OUT = Out(*LOG_ENDINGS)
_VEHICLE_OUT = Out(".fmu", ".ssp")


class Log(opt.Output):
    """Options of ``hexjet export DIR``."""

    folder: Path = opt.argument(type=click.Path(path_type=Path), metavar="")
    target: Any = opt.option("--to", type=opt.Choice([*FILES]), required=True, help="The format.")
    out = opt.out(
        "The file, or its folder; what is there is overwritten.  [default: flight.ulg, .mcap, .mat or .csv in DIR]",
        "FILE|DIR",
        _LOG_OUT,
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


class ExportOptions(Flight, opt.Output):
    """Options of ``hexjet export controller`` and ``vehicle``."""

    scenario = opt.word(
        "--scenario",
        "NAME|FILE",
        "What is flown, with aircraft, engine and controller where they are not given.",
        "roll-doublet",
    )
    controller = opt.word("--controller", "NAME|FILE", "Overrides the scenario's.")
    aircraft = opt.word("--aircraft", "NAME|DIR", "Overrides the scenario's, with the engine that it is made for.")
    engines = opt.words("--engine", "[N=]NAME|FILE", "Overrides the scenario's.")
    settings = opt.words("--set", "KEY=VALUE", "Write a value over the scenario's.")


class ExportController(ExportOptions):
    """Options of ``hexjet export controller``."""

    scenario = opt.word(
        "--scenario",
        "NAME|FILE",
        "The flight that becomes the test, with aircraft, engine and controller where they are not given.",
        "roll-doublet",
    )
    controller = opt.word(
        "--controller", "NAME|FILE.toml", "Overrides the scenario's; or a file that hexjet design wrote."
    )
    name = opt.word("--name", None, "Name of files, functions and types, an identifier.", "controller")
    licence = opt.word(
        "--licence",
        "SPDX",
        'Stated in every file that is ours alone, e.g. MIT or "LicenseRef-Ours"; yours to choose.  What goes into '
        "Betaflight's or ArduPilot's own code is GPL-3.0-or-later.  [default: NOASSERTION]",
    )
    fmu: bool = opt.option("--fmu/--no-fmu", default=True, help="FMUs too, or the C alone.  [default: --fmu]")
    loops = opt.flag("--loops", "The attitude, rate and altitude loops alone, for a mixer of your own; no FMU.")
    inside = opt.choices(
        "--for",
        ["px4", "ardupilot", "betaflight"],
        "Also its rate loop for the inside of this autopilot, with instructions, in a folder of its own; repeatable.",
    )
    out = opt.out("A new or an empty folder.  [default: NAME]")
    as_json = opt.JSON


@export.command(epilog=example("hexjet export controller --controller turbojet.toml --engine turbojet"))
@opt.takes(ExportController)
def controller(options: ExportController) -> int:
    """Write a controller as C99 with parameters, test vectors and test program, and as FMI 2.0 and 3.0 FMUs.

    The scenario is flown once; the C is compiled and compared with that flight where there is a compiler.  Status 1:
    it does not repeat the flight to the last bit.
    """
    from cosim.api.export import export_controller

    result = export_controller(
        options.load(),
        options.out,
        fmus=options.fmu,
        progress=CommandProgress(),
        **options.chosen("name", "licence", "loops", "inside"),
    )
    options.answer(result.to_dict, lambda: _print(result), nan=True)
    return FLIGHT_FAILED if result.same is False else DONE


class ExportVehicle(ExportOptions):
    """Options of ``hexjet export vehicle``."""

    outside = opt.choices(
        "--outside", ["engines", "controller"], "What is not in the FMU: its inputs and outputs become the FMU's."
    )
    kind = opt.renamed(
        opt.choice("--to", ["fmu", "ssp"], "ssp: archives of a system, with the engines as components.", "fmu"), "--as"
    )
    name = opt.word("--name", None, "Name of the files, an identifier.", "vehicle")
    out = opt.out(
        "A new or an empty folder; or one file, of FMI 3.0, or of 2.0 if its name ends in -fmi2.  [default: NAME]",
        "DIR|FILE.fmu|FILE.ssp",
        _VEHICLE_OUT,
    )
    as_json = opt.JSON


@export.command(epilog=example("hexjet export vehicle --controller smith --out vehicle"))
@opt.takes(ExportVehicle)
def vehicle(options: ExportVehicle) -> int:
    """Write the vehicle as FMI 2.0 and 3.0 co-simulation FMUs for other masters.

    The FMU flies the scenario in a Python with hexjet-cosim, which it starts itself: this one, or that which
    HEXJET_PYTHON names.
    """
    from cosim.api.export import export_vehicle

    chosen = options.chosen("outside", "kind", "name")
    result = export_vehicle(options.load(), options.out, progress=CommandProgress(), **chosen)
    options.answer(result.to_dict, lambda: _print(result), nan=True)
    return DONE


def _print(result: Result) -> None:
    for line in result.lines():
        echo(line)
