"""``hexjet export controller`` and ``hexjet export vehicle``."""

from __future__ import annotations

import click

from cosim.api.call import Result
from cosim.commands import DONE, FLIGHT_FAILED, CommandProgress, Flight, Out, echo, example, opt


class ExportOptions(Flight, opt.Output):
    """Options of ``hexjet export controller`` and ``vehicle``."""

    scenario = opt.word(
        "--scenario",
        "NAME|FILE",
        "What is flown (a controller's test), with aircraft, engine and controller where they are not given.",
        "roll-doublet",
    )
    controller = opt.word("--controller", "NAME|FILE", "Overrides the scenario's; or a file that hexjet design wrote.")
    aircraft = opt.word("--aircraft", "NAME|DIR", "Overrides the scenario's, with the engine that it is made for.")
    engines = opt.words("--engine", "[N=]NAME|FILE", "Overrides the scenario's.")
    settings = opt.words("--set", "KEY=VALUE", "Write a value over the scenario's.")


class ExportController(ExportOptions):
    """Options of ``hexjet export controller``."""

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


@click.command(epilog=example("hexjet export controller --controller turbojet.toml --engine turbojet"))
@opt.takes(ExportController)
def controller(options: ExportController) -> int:
    """Write a controller as C99 with parameters, test vectors and test program, and as FMI 2.0 and 3.0 FMUs.

    The scenario is flown once; the C is compiled and compared with that flight where there is a compiler.  Status 1:
    it does not repeat the flight to the last bit.
    """
    from hexjet_export.controller.export import export_controller

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
        Out(".fmu", ".ssp"),
    )
    as_json = opt.JSON


@click.command(epilog=example("hexjet export vehicle --controller smith --out vehicle"))
@opt.takes(ExportVehicle)
def vehicle(options: ExportVehicle) -> int:
    """Write the vehicle as FMI 2.0 and 3.0 co-simulation FMUs for other masters.

    The FMU flies the scenario in a Python with hexjet-cosim, which it starts itself: this one, or that which
    HEXJET_PYTHON names.
    """
    from hexjet_export.vehicle.export import export_vehicle

    chosen = options.chosen("outside", "kind", "name")
    result = export_vehicle(options.load(), options.out, progress=CommandProgress(), **chosen)
    options.answer(result.to_dict, lambda: _print(result), nan=True)
    return DONE


def _print(result: Result) -> None:
    for line in result.lines():
        echo(line)
