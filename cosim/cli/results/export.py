"""hexjet export: a run's log in other formats, a controller as C and as FMUs, a vehicle as FMUs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from cosim.base.errors import InputError
from cosim.cli.options import DONE, FLIGHT_FAILED, example, load_scenario, offer_to_compile
from cosim.cli.outputs import Out
from cosim.cli.trust import looks

if TYPE_CHECKING:
    from cosim.codegen.export import Exported


class Export(click.Group):
    """``hexjet export DIR --to FORMAT`` is a run's log; what a first word names is something else."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Hand what does not begin with the name of a command to that of logs."""
        if args and args[0] not in (*self.commands, *self.get_help_option_names(ctx)):
            args = [_LOG, *args]
        return super().parse_args(ctx, args)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """One of the commands, or that of logs."""
        return log if cmd_name == _LOG else super().get_command(ctx, cmd_name)


_LOG = "DIR"  # what the help calls it


@click.group(cls=Export, epilog=example("hexjet export runs/roll-doublet-smith-001 --to ulog"))
def export() -> None:
    """Write the log of a run, a controller or the vehicle for other tools.

    \b
    hexjet export DIR --to FORMAT     the log of the run in DIR: ulog, mcap, mat, csv,
                                      parquet; see: hexjet export DIR --help
    hexjet export controller          a controller as C99 and as FMUs, with a test
    hexjet export vehicle             the vehicle as FMUs for other masters

    A run in a folder called "controller" is ./controller.
    """


_FILES = {
    "ulog": "flight.ulg",
    "mcap": "flight.mcap",
    "mat": "flight.mat",
    "csv": "flight.csv",
    "parquet": "flight.parquet",
}
_ENDINGS = {"ulog": (".ulg", ".ulog")} | {name: (f".{name}",) for name in _FILES if name != "ulog"}
_LOG_OUT = Out(*(ending for endings in _ENDINGS.values() for ending in endings))
_VEHICLE_OUT = Out(".fmu", ".ssp")


def _log_path(target: str, out: Path) -> Path:
    """Return the file of a format in ``out``, or ``out`` where it is one.  Raises InputError for another's ending."""
    if not _LOG_OUT.is_file(out):
        return out / _FILES[target]
    if out.suffix.lower() not in _ENDINGS[target]:
        raise InputError(f"--out {out}: --to {target} writes {' or '.join(_ENDINGS[target])}")
    return out


@click.command(_LOG, epilog=example("hexjet export runs/roll-doublet-smith-001 --to mcap --out flight.mcap"))
@click.argument("folder", type=click.Path(path_type=Path), metavar="")
@click.option("target", "--to", type=click.Choice([*_FILES]), required=True, help="The format.")
@click.option(
    "--out",
    type=_LOG_OUT,
    metavar="FILE|DIR",
    help="The file, or its folder; what is there is overwritten.  [default: flight.ulg, .mcap, .mat or .csv in DIR]",
)
@click.option(
    "--rates",
    type=click.Choice(["all", "px4"]),
    default="all",
    show_default=True,
    help="ULog: every step, or each topic about as often as PX4 logs it.",
)
@looks
def log(folder: Path, target: str, out: Path | None, rates: Literal["all", "px4"]) -> int:
    """Write the log of the run in DIR for other tools.

    \b
    ulog     PlotJuggler, Flight Review: float32, with parameters, events and faults
    mcap     Foxglove, PlotJuggler, Rerun: every column, and the vehicle in 3-D
    mat      MATLAB, level 5: the structure "flight"
    csv      every column with all its digits
    parquet  a copy of the run's own, which says what was flown
    """
    path = _log_path(target, folder if out is None else out)
    if target != "ulog" and rates != "all":
        raise InputError(f"--rates: is for --to ulog; {target} has every step")
    match target:
        case "ulog":
            from cosim.results.export.ulog import export_ulog

            export_ulog(folder, path, rates)
        case "mcap":
            from cosim.results.export.mcap_file import export_mcap

            export_mcap(folder, path)
        case "mat":
            from cosim.results.export.mat import export_mat

            export_mat(folder, path)
        case "parquet":
            from cosim.results.export.parquet import export_parquet

            export_parquet(folder, path)
        case _:
            from cosim.results.export.csv_file import export_csv

            export_csv(folder, path)
    click.echo(str(path))
    return DONE


@export.command(epilog=example("hexjet export controller --controller turbojet.toml --engine turbojet --out c"))
@click.option(
    "--scenario",
    default="roll-doublet",
    show_default=True,
    metavar="NAME|FILE",
    help="The flight that becomes the test, with aircraft, engine and controller where they are not given.",
)
@click.option(
    "--controller", metavar="NAME|FILE.toml", help="Overrides the scenario's; or a file that hexjet design wrote."
)
@click.option("--aircraft", metavar="NAME", help="Overrides the scenario's, with the engine that it is made for.")
@click.option("engines", "--engine", metavar="[N=]NAME|FILE", multiple=True, help="Overrides the scenario's.")
@click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="Write a value over the scenario's.")
@click.option("--name", default="controller", show_default=True, help="Of files, functions and types, an identifier.")
@click.option(
    "--licence",
    metavar="SPDX",
    help='Stated in every file that is ours alone, e.g. MIT or "LicenseRef-Ours"; yours to choose.  What goes into '
    "Betaflight's or ArduPilot's own code is GPL-3.0-or-later.  [default: NOASSERTION]",
)
@click.option("--no-fmu", is_flag=True, help="The C alone.")
@click.option(
    "inside",
    "--for",
    type=click.Choice(["px4", "ardupilot", "betaflight"]),
    multiple=True,
    help="Also its rate loop for the inside of this autopilot, with instructions, in a folder of its own; repeatable.",
)
@click.option("--out", type=Out(), metavar="DIR", help="A new or an empty folder.  [default: NAME]")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object.")
def controller(
    scenario: str,
    controller: str | None,
    aircraft: str | None,
    engines: tuple[str, ...],
    settings: tuple[str, ...],
    name: str,
    licence: str | None,
    no_fmu: bool,
    inside: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> int:
    """Write a controller as C99 with parameters, test vectors and test program, and as FMI 2.0 and 3.0 FMUs.

    The scenario is flown once; the C is compiled and compared with that flight where there is a compiler.  Status 1:
    it does not repeat the flight to the last bit.
    """
    from cosim.autopilots.dump import torque_of
    from cosim.codegen.export import export_controller
    from cosim.spec.controller_name import is_design

    offer_to_compile(*engines)
    loaded = load_scenario(scenario, controller, engines, None, settings, None, aircraft)
    source = Path(controller).name if controller is not None and is_design(controller) else ""
    vehicle, _ = loaded.resolved_vehicle()
    torques = {autopilot: torque_of(autopilot, vehicle) for autopilot in inside}
    done = export_controller(loaded, out if out is not None else Path(name), name, licence, not no_fmu, source, torques)
    _say_program_licences(licence, inside)
    if as_json:
        click.echo(json.dumps(_data(done)))
    else:
        _print(done)
    return FLIGHT_FAILED if done.measured is not None and not done.measured.same else DONE


def _say_program_licences(licence: str | None, inside: tuple[str, ...]) -> None:
    """Tell on standard error which files of an adapter have another licence than the one that was asked for."""
    from cosim.codegen.adapters import PROGRAM_LICENCES

    for autopilot in inside:
        program = PROGRAM_LICENCES.get(autopilot)
        if program is not None and licence not in (None, program):
            click.echo(
                f"hexjet: note: --licence {licence}: not for what touches or includes {autopilot}'s code: {program}",
                err=True,
            )


@export.command(epilog=example("hexjet export vehicle --controller smith --out vehicle"))
@click.option(
    "--scenario",
    default="roll-doublet",
    show_default=True,
    metavar="NAME|FILE",
    help="What is flown, with aircraft, engine and controller where they are not given.",
)
@click.option("--controller", metavar="NAME|FILE", help="Overrides the scenario's.")
@click.option("--aircraft", metavar="NAME", help="Overrides the scenario's, with the engine that it is made for.")
@click.option("engines", "--engine", metavar="[N=]NAME|FILE", multiple=True, help="Overrides the scenario's.")
@click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="Write a value over the scenario's.")
@click.option(
    "--outside",
    type=click.Choice(["engines", "controller"]),
    multiple=True,
    help="What is not in the FMU: its inputs and outputs become the FMU's.",
)
@click.option(
    "kind",
    "--as",
    type=click.Choice(["fmu", "ssp"]),
    default="fmu",
    show_default=True,
    help="ssp: archives of a system, with the engines as components.",
)
@click.option("--name", default="vehicle", show_default=True, help="Of the files, an identifier.")
@click.option(
    "--out",
    type=_VEHICLE_OUT,
    metavar="DIR|FILE.fmu|FILE.ssp",
    help="A new or an empty folder; or one file, of FMI 3.0, or of 2.0 if its name ends in -fmi2.  [default: NAME]",
)
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object.")
def vehicle(
    scenario: str,
    controller: str | None,
    aircraft: str | None,
    engines: tuple[str, ...],
    settings: tuple[str, ...],
    outside: tuple[str, ...],
    kind: str,
    name: str,
    out: Path | None,
    as_json: bool,
) -> int:
    """Write the vehicle as FMI 2.0 and 3.0 co-simulation FMUs for other masters.

    The FMU flies the scenario in a Python with hexjet-cosim, which it starts itself: this one, or that which
    HEXJET_PYTHON names.
    """
    from cosim.codegen.vehicle import export_vehicle
    from cosim.codegen.vehicle_ports import Parts

    offer_to_compile(*engines)
    loaded = load_scenario(scenario, controller, engines, None, settings, None, aircraft)
    parts = Parts("engines" not in outside, "controller" not in outside)
    out = out if out is not None else Path(name)
    single = _VEHICLE_OUT.is_file(out)
    if single and out.suffix.lower() != f".{kind}":
        raise InputError(f"--out {out}: --as {kind} writes .{kind}")
    folder, file = (out.parent, out.name) if single else (out, "")
    done = export_vehicle(loaded, folder, name, parts, system=kind == "ssp", file=file)
    if as_json:
        click.echo(json.dumps(done.data))
    else:
        click.echo(f"{done.folder}: {', '.join(done.files)}")
        click.echo(f"{done.inputs} inputs, {done.outputs} outputs, communication step {done.step_s:g} s or a multiple")
        click.echo(f"flown by {done.python}, unless HEXJET_PYTHON names another")
    return DONE


def _data(done: Exported) -> dict[str, Any]:
    from dataclasses import asdict

    return asdict(done) | {"folder": str(done.folder)}


def _print(done: Exported) -> None:
    from cosim.codegen.export import figures

    click.echo(f"{done.folder}: {', '.join(done.files)}")
    click.echo(f"test vectors: {done.steps} steps")
    for what, value in figures(done.measured):
        click.echo(f"{what}: {value}")
    if done.without_fmus is not None:
        click.echo(f"no FMUs: {done.without_fmus}")
