"""The command line: arguments in, calls out."""

from __future__ import annotations

import json
import shlex
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import Any, Literal

import click
from click.core import ParameterSource

from cosim.base.errors import MACHINE_TROUBLE, FlightError, InputError

DONE, FLIGHT_FAILED, WRONG_INPUT = 0, 1, 2
INTERRUPTED, TERMINATED = 130, 143  # as a shell has them
KINDS = ("scenarios", "studies", "engines", "aircraft", "controllers")


class _Number(click.FloatRange):
    """A finite number; click lets NaN through any range."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = float(super().convert(value, param, ctx))
        if not isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


class _Terminated(KeyboardInterrupt):
    """SIGTERM, by which a batch system or a service manager asks a process to end."""


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Answer SIGTERM as Ctrl-C is answered."""

    def end(number: int, frame: object) -> None:
        raise _Terminated

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _example(text: str) -> str:
    return f"\b\nExample:\n  {text}"


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="hexjet-cosim", prog_name="hexjet")
def cli() -> None:
    """Co-simulation of the Hex-Jet: JSBSim airframe, FMU engines, predictor-based control."""


@cli.command(epilog=_example("hexjet fly roll-doublet --controller baseline --set vehicle.mass_kg=6.0"))
@click.argument("scenario")
@click.option(
    "--controller",
    metavar="NAME|FILE.toml",
    help="Overrides the scenario's; see: hexjet list controllers. Or a file that hexjet design wrote, with all gains.",
)
@click.option(
    "--aircraft",
    metavar="NAME",
    help="Overrides the scenario's, with the engine that it is made for; see: hexjet list aircraft.",
)
@click.option(
    "engines",
    "--engine",
    metavar="[N=]NAME|FILE",
    multiple=True,
    help="Overrides the scenario's: a name (see: hexjet list engines), an .fmu or a .toml that maps one; with N= "
    "the one at station N alone.",
)
@click.option(
    "settings",
    "--set",
    metavar="KEY=VALUE",
    multiple=True,
    help="Write a value over the scenario's, e.g. vehicle.mass_kg=6.0; its expectations are not checked then.",
)
@click.option(
    "--model",
    type=click.Path(path_type=Path),
    metavar="FILE.toml",
    help="Predict with the identified models in this file, as hexjet identify writes it.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="The run's folder.  [default: a new one in runs/]"
)
@click.option("--seed", type=int, help="Overrides the scenario's seed.")
@click.option("--unchecked-engine", is_flag=True, help="Fly an FMU that hexjet fmu check finds unfit, or has not seen.")
@click.option("--realtime", is_flag=True, help="Pace the flight in real time; the same as --rtf 1.")
@click.option(
    "--rtf",
    type=_Number(min=0.0),
    metavar="X",
    help="Pace the flight at X times real time; 0 is as fast as it goes.  [default: 0, or 1 with --mavlink]",
)
@click.option(
    "links",
    "--mavlink",
    metavar="URL",
    multiple=True,
    help="Let a ground station watch, e.g. udpout:127.0.0.1:14550; see: hexjet gcs --help.",
)
@click.option("--flight", type=click.IntRange(min=0), metavar="N", help="Of a campaign in the folder SCENARIO.")
@click.option("as_json", "--json", is_flag=True, help="Print the run's summary as one JSON object and nothing else.")
@click.pass_context
def fly(
    context: click.Context,
    scenario: str,
    controller: str | None,
    aircraft: str | None,
    engines: tuple[str, ...],
    settings: tuple[str, ...],
    model: Path | None,
    out: Path | None,
    seed: int | None,
    unchecked_engine: bool,
    realtime: bool,
    rtf: float | None,
    links: tuple[str, ...],
    flight: int | None,
    as_json: bool,
) -> int:
    """Fly SCENARIO: a name in scenarios/, the path of a TOML file, or with --flight the folder of a campaign.

    Leaves a folder with summary, resolved scenario, log and report.  Status 0: flown as planned, or with --flight the
    same as in the campaign, bit for bit; 1: the flight failed, went beyond its limits or did not come to what the
    scenario expects, or is not the same; 2: wrong input.
    """
    if flight is not None:
        why = "a flight of a campaign is flown as it was; leave it out with --flight"
        _refuse_others(context, why, "scenario", "flight", "out", "as_json")
        return _fly_again(Path(scenario), flight, out, as_json)
    from cosim.cli.console import flight_progress, output_to_stderr, print_run
    from cosim.flight import fly as fly_scenario
    from cosim.flight import new_folder
    from cosim.results.run import finish_killed

    if realtime and rtf is not None:
        raise InputError("--realtime and --rtf: give one of them")
    factor = (rtf or None) if rtf is not None else 1.0 if realtime or links else None
    finish_killed(Path(scenario))
    flown = load_scenario(scenario, controller, engines, seed, settings, model, aircraft)
    if unchecked_engine:
        flown = flown.replace(engine_unchecked=True)
    if controller is not None and controller.lower().endswith(".toml"):
        from cosim.design.controller_file import differences

        for text in differences(flown, Path(controller)):
            click.echo(f"hexjet: warning: {controller}: {text}", err=True)
    folder = out if out is not None else new_folder(Path("runs"), f"{flown.name}-{flown.controller}")
    with output_to_stderr(as_json), flight_progress(flown, quiet=as_json) as observers:
        if links:
            from cosim.groundstation.links import Links

            with Links(links) as opened:
                watch = opened.onlookers()
                run = fly_scenario(flown, folder, observers=observers, realtime_factor=factor, watch=watch)
        else:
            run = fly_scenario(flown, folder, observers=observers, realtime_factor=factor)
    if as_json:
        click.echo(json.dumps(run.summary.model_dump(mode="json"), allow_nan=False))
    else:
        print_run(run)
    return DONE if run.summary.as_planned else FLIGHT_FAILED


def _fly_again(folder: Path, number: int, out: Path | None, as_json: bool) -> int:
    from cosim.campaign import fly_again, open_campaign
    from cosim.cli.console import output_to_stderr, print_again
    from cosim.flight import new_folder

    campaign = open_campaign(folder)
    out = out if out is not None else new_folder(Path("runs"), f"{campaign.study.name}-flight-{number}")
    with output_to_stderr(as_json):
        again = fly_again(campaign, number, out)
    if as_json:
        same = {"flight": number, "same": again.same, "otherwise": again.otherwise}
        click.echo(json.dumps(again.run.summary.model_dump(mode="json") | same, allow_nan=False))
    else:
        print_again(again)
    return DONE if again.same else FLIGHT_FAILED


def _refuse_others(context: click.Context, why: str, *allowed: str) -> None:
    """Refuse what was given on the command line and is not allowed beside the rest, and say ``why``."""
    for parameter in context.command.params:
        name = parameter.name or ""
        if name not in allowed and context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            given = max(parameter.opts, key=len)
            raise InputError(f"{given}: {why}")


def load_scenario(
    name: str,
    controller: str | None,
    engines: tuple[str, ...],
    seed: int | None,
    settings: tuple[str, ...],
    model: Path | None = None,
    aircraft: str | None = None,
) -> Any:
    """The scenario with the command line's choices written over it."""
    from cosim.spec.scenario import Scenario

    designed = Path(controller) if controller is not None and controller.lower().endswith(".toml") else None
    if designed is not None:
        from cosim.design.controller_file import with_controller

        scenario, controller = with_controller(name, designed, settings, aircraft), None
    else:
        scenario = Scenario.load(name, list(settings))
    changes: dict[str, Any] = {}
    if aircraft is not None:
        from cosim.spec.vehicle import load_vehicle

        changes |= {"aircraft": aircraft, "engine": load_vehicle(aircraft)[0].engine or scenario.engine}
    if controller is not None:
        changes["controller"] = controller
    chosen = engine_choices(engines)
    if "engine" in chosen and scenario.stations:
        scenario = scenario.model_copy(update={"stations": {}, "expect": []})  # one for all
    changes |= chosen
    if seed is not None:
        changes["seed"] = seed
    if model is not None:
        from cosim.spec.vehicle import read_models

        changes["vehicle"] = {"identified": read_models(model)}
    if settings or model is not None or designed is not None or "stations" in chosen:
        changes["expect"] = []
    return scenario.replace(**changes) if changes else scenario


def engine_choices(texts: tuple[str, ...]) -> dict[str, Any]:
    """``NAME`` or ``N=NAME`` texts as changes of a scenario.  Raises InputError if one is named twice."""
    from cosim.spec.scenario import is_file

    changes: dict[str, Any] = {}
    for text in texts:
        number, equals, name = text.partition("=")
        station = number.strip() if equals and number.strip().isdigit() else None
        engine = (name if station else text).strip()
        # a file on the command line is meant from here, one in the scenario from the scenario's folder
        engine = str(Path(engine).absolute()) if is_file(engine) else engine
        held = changes if station is None else changes.setdefault("stations", {}).setdefault(station, {})
        if "engine" in held:
            raise InputError(
                f"--engine {text}: there is already another for {f'station {station}' if station else 'all'}"
            )
        held["engine"] = engine
    return changes


@cli.command(epilog=_example("hexjet gcs --engine edf-as-flown --place 22.35,113.59 --web"))
@click.option(
    "--scenario", default="hover", metavar="NAME", help="Whose wind, place and faults.  [default: a calm day]"
)
@click.option(
    "--aircraft", metavar="NAME", help="Overrides the scenario's, with its engine; see: hexjet list aircraft."
)
@click.option("engines", "--engine", metavar="[N=]NAME|FILE", multiple=True, help="As in hexjet fly.")
@click.option("--controller", metavar="NAME", help="See: hexjet list controllers.")
@click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="As in hexjet fly.")
@click.option("--seed", type=int, help="Overrides the scenario's seed.")
@click.option("--unchecked-engine", is_flag=True, help="As in hexjet fly.")
@click.option("--place", metavar="LAT,LON", help="Where it stands, in degrees.")
@click.option(
    "links",
    "--mavlink",
    metavar="URL",
    multiple=True,
    help="udpout:HOST:PORT, udpin:[HOST:]PORT, tcp:HOST:PORT, tcpin:[HOST:]PORT or serial:DEVICE[:BAUD].  "
    "[default: udpout to 127.0.0.1, ports 14550 and 14540]",
)
@click.option(
    "--system",
    type=int,
    default=1,
    show_default=True,
    metavar="N",
    help="Its MAVLink id, 1 to 250: several vehicles beside each other need one each.",
)
@click.option("--public", is_flag=True, help="Let udpin and tcpin listen to the network and not to this machine alone.")
@click.option(
    "--sign-key", type=click.Path(path_type=Path), metavar="FILE", help="Sign, and refuse what is not signed with it."
)
@click.option(
    "--personality",
    type=click.Choice(["px4", "ardupilot", "generic"]),
    default="px4",
    show_default=True,
    help="What the ground station takes it for.",
)
@click.option(
    "--params",
    "parameters",
    type=click.Path(path_type=Path),
    metavar="FILE.toml",
    help="Where parameters are kept; none: nowhere.  [default: one file a vehicle in the folder for settings]",
)
@click.option("--rtf", type=_Number(min=0.0), default=1.0, show_default=True, metavar="X", help="As in fly.")
@click.option("--duration", type=_Number(min=0.0, min_open=True), metavar="S", help="[default: until Ctrl-C]")
@click.option(
    "--web", type=click.IntRange(0, 65535), is_flag=False, flag_value=8765, metavar="[PORT]", help="Serve a page too."
)
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="[default: a new one in runs/]")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object at the end and nothing else.")
def gcs(
    scenario: str,
    aircraft: str | None,
    engines: tuple[str, ...],
    controller: str | None,
    settings: tuple[str, ...],
    seed: int | None,
    unchecked_engine: bool,
    place: str | None,
    links: tuple[str, ...],
    system: int,
    public: bool,
    sign_key: Path | None,
    personality: Any,
    parameters: Path | None,
    rtf: float,
    duration: float | None,
    web: int | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """A vehicle on the ground that waits for a ground station: QGroundControl, MAVProxy, MAVSDK.

    Every flight leaves a run's folder, with telemetry.tlog and with requests.jsonl: hexjet fly on its scenario.toml
    repeats it without a ground station.  Status as of hexjet fly, for the last flight: 0 flown as planned; 1 it failed
    or went beyond its limits; 2 wrong input.
    """
    from cosim.cli.console import (
        live_line,
        output_to_stderr,
        print_gcs,
        print_session,
    )
    from cosim.groundstation.links import Links
    from cosim.groundstation.parameter_store import default_file
    from cosim.groundstation.session import (
        Session,
        place_at,
        stopped_by_signals,
        vehicle_key,
    )

    flown = load_scenario(scenario, controller, engines, seed, settings, None, aircraft)
    changes: dict[str, Any] = {"name": "gcs" if scenario == "hover" else flown.name}
    if unchecked_engine:
        changes["engine_unchecked"] = True
    if place is not None:
        changes["environment"] = place_at(place)
    flown = flown.replace(**changes)
    own = vehicle_key(flown) if system == 1 else f"{vehicle_key(flown)}-system-{system}"
    kept = None if str(parameters) == "none" else parameters or default_file(own)
    with output_to_stderr(as_json), Links(links, public, sign_key, personality, web, system) as opened:
        session = Session(
            flown,
            opened.exchange,
            factor=rtf or None,
            out=out,
            parameters=kept,
            duration=duration,
            begun=opened.begin,
            over=opened.end,
        )
        print_gcs(session, opened, to_stderr=as_json)
        with stopped_by_signals(session), live_line(opened, quiet=as_json):
            runs = session.run()
        counts = opened.counts
    print_session(runs, counts, to_stderr=as_json)
    if as_json:
        found = {"runs": [run.summary.model_dump(mode="json") for run in runs], "links": counts}
        click.echo(json.dumps(found, allow_nan=False))
    return DONE if runs[-1].summary.as_planned else FLIGHT_FAILED


@cli.command("list", epilog=_example("hexjet list engines"))
@click.argument("kind", required=False, type=click.Choice(KINDS))
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object.")
def list_(kind: str | None, as_json: bool) -> int:
    """List what can be flown: scenarios, studies, engines, aircraft, controllers."""
    from cosim.cli.catalogue import catalogue
    from cosim.cli.console import print_catalogue

    found = {name: catalogue(name) for name in ([kind] if kind else KINDS)}
    if as_json:
        click.echo(json.dumps(found))
    else:
        print_catalogue(found)
    return DONE


@cli.group()
def fmu() -> None:
    """Build and check engine FMUs."""


@fmu.command("build", epilog=_example("hexjet fmu build turbojet"))
@click.argument("engines", nargs=-1)
def fmu_build(engines: tuple[str, ...]) -> int:
    """Build the FMUs of ENGINES, or of all, from their sources; those up to date are left alone."""
    from cosim.engine import build_engines

    for path in build_engines(list(engines) or None):
        click.echo(str(path))
    return DONE


@fmu.command("check", epilog=_example("hexjet fmu check their.fmu --step 0.004"))
@click.argument("engine", metavar="NAME|FILE.fmu|MAPPING.toml")
@click.option(
    "--step",
    type=_Number(min=0.0, min_open=True),
    metavar="S",
    help="Control step.  [default: 0.004, or the library engine's]",
)
@click.option("settings", "--set", metavar="PARAMETER=VALUE", multiple=True, help="Set a parameter of the engine.")
@click.option(
    "--time-limit", type=_Number(min=1.0), default=120.0, show_default=True, metavar="S", help="For all of it."
)
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="[default: a new one in runs/]")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
def fmu_check(
    engine: str, step: float | None, settings: tuple[str, ...], time_limit: float, out: Path | None, as_json: bool
) -> int:
    """Tell whether an FMU is fit to be an engine, and how it answers its throttle.

    The FMU is run in a process of its own: if it crashes, hangs or eats memory, that is told and nothing else happens.
    Leaves check.json and a page with its static curve and step responses.  Status 0: fit; 1: unfit; 2: not usable.
    """
    from cosim.base.toml import parse_numbers
    from cosim.cli.console import print_check
    from cosim.engine import check_fmu, limits_of
    from cosim.flight import new_folder
    from cosim.results.report.engine_check import write_check

    found = check_fmu(engine, step, parse_numbers(settings, "--set"), limits_of(time_limit))
    page = write_check(found, out if out is not None else new_folder(Path("runs"), f"check-{Path(engine).stem}"))
    if as_json:
        click.echo(json.dumps(found.to_dict(), allow_nan=False))
    else:
        print_check(found, page)
    return DONE if found.ok else FLIGHT_FAILED


@cli.group()
def identify() -> None:
    """Sweep an engine or an axis in flight, and fit a model with a delay to its response."""


def _sweep_options(command: Any) -> Any:
    for option in reversed(
        [
            click.option("--from-hz", type=_Number(), metavar="HZ", help="Lowest frequency of the response."),
            click.option("--to-hz", type=_Number(), metavar="HZ", help="Highest frequency of the response."),
            click.option("--amplitude", type=_Number(), metavar="A", help="Of the sweep, in the unit of the command."),
            click.option("--duration", type=_Number(), metavar="S", help="Of the sweep."),
            click.option("holds", "--hold", metavar="NAME=VALUE", multiple=True, help="Keep a parameter of the model."),
            click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="[default: a new one in runs/]"),
            click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else."),
        ]
    ):
        command = option(command)
    return command


@identify.command("engine", epilog=_example("hexjet identify engine turbojet --set delay_samples=40"))
@click.argument("name", metavar="NAME|FILE.fmu")
@click.option("--throttle", type=_Number(), default=0.5, show_default=True, help="Around which it is swept.")
@click.option("--step", type=_Number(), default=0.004, show_default=True, metavar="S", help="Sample time.")
@click.option("--lags", type=click.IntRange(0, 2), default=0, show_default=True, help="Lags beside the first pole.")
@click.option("settings", "--set", metavar="PARAMETER=VALUE", multiple=True, help="Set a parameter of the engine.")
@_sweep_options
def identify_engine(
    name: str, settings: tuple[str, ...], holds: tuple[str, ...], out: Path | None, as_json: bool, **choices: Any
) -> int:
    """Identify an engine, throttle to thrust: one pole and a delay.

    Band, amplitude and duration are chosen to suit the engine where they are not given.
    """
    from cosim.base.toml import parse_numbers
    from cosim.design.identify import identify_engine as identify

    found = identify(name, parse_numbers(settings, "--set"), hold=parse_numbers(holds, "--hold"), **choices)
    return _finish_identification(found, out, f"identify-{Path(name).stem}", as_json)


def _identify_axis(
    axis: str, settings: tuple[str, ...], holds: tuple[str, ...], out: Path | None, as_json: bool, **choices: Any
) -> int:
    from cosim.base.toml import parse_numbers
    from cosim.design.identify import identify_axis

    found = identify_axis(axis, settings=settings, hold=parse_numbers(holds, "--hold"), **choices)
    return _finish_identification(found, out, f"identify-{axis}", as_json)


def _finish_identification(found: Any, out: Path | None, name: str, as_json: bool) -> int:
    from cosim.cli.console import print_identification
    from cosim.design.identify import write
    from cosim.flight import new_folder

    paths = write(found, out if out is not None else new_folder(Path("runs"), name))
    if as_json:
        click.echo(json.dumps(found.to_dict(), allow_nan=False))
    else:
        print_identification(found, paths)
    return DONE


def _axis_command(axis: str) -> None:
    @identify.command(axis, epilog=_example(f"hexjet identify {axis} --engine edf --out {axis}-model"))
    @click.option("--aircraft", default="hexjet", show_default=True, help="See: hexjet list aircraft.")
    @click.option("--engine", metavar="NAME|FILE.fmu", help="See: hexjet list engines.  [default: edf-as-flown]")
    @click.option("--controller", metavar="NAME", help="[default: smith, or baseline if no model is known]")
    @click.option("--substeps", type=int, help="JSBSim steps in a control step.")
    @click.option("--seed", type=int, help="Of the sensor noise.")
    @click.option("--lags", type=click.IntRange(1, 2), default=1, show_default=True, help="Beside the slow pole.")
    @click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="As in hexjet fly.")
    @_sweep_options
    def command(**choices: Any) -> int:
        return _identify_axis(axis, **choices)

    command.help = (
        f"Identify the {axis} axis in flight, torque command to measured rate: a slow pole, a lag and a delay.\n\n"
        "Writes a model file for hexjet fly --model."
    )


for _axis in ("roll", "pitch", "yaw"):
    _axis_command(_axis)


@cli.command(epilog=_example("hexjet design --engine turbojet --out turbojet.toml"))
@click.option("--engine", required=True, metavar="NAME|FILE", help="A name, an .fmu or a .toml that maps one.")
@click.option("--aircraft", default="hexjet", show_default=True, help="See: hexjet list aircraft.")
@click.option(
    "--controller",
    default="auto",
    show_default=True,
    metavar="NAME",
    help="One of the predictors, or the best of them.",
)
@click.option("--model", type=click.Path(path_type=Path), metavar="FILE.toml", help="As hexjet identify writes it.")
@click.option(
    "--amplitude",
    type=_Number(min=0.0, min_open=True, max=0.5),
    metavar="A",
    help="Of the engine's sweep, in throttle; more where the flight will reach its limits.  [default: 0.005]",
)
@click.option(
    "--max-sensitivity", type=_Number(min=1.05, max=10.0), default=1.7, show_default=True, help="Peak of |S|."
)
@click.option(
    "--delay-tolerance",
    type=_Number(0.0, 1.0),
    default=0.3,
    show_default=True,
    help="Of the delay, both ways.",
)
@click.option(
    "--gain-tolerance", type=_Number(0.0, 0.95), default=0.3, show_default=True, help="Of the gain, both ways."
)
@click.option(
    "--min-bandwidth",
    type=_Number(min=0.0),
    default=0.16,
    show_default=True,
    metavar="HZ",
    help="Of roll and pitch.",
)
@click.option(
    "--noise-share",
    type=_Number(min=0.0, min_open=True, max=1.0),
    default=0.0833,
    show_default=True,
    help="One standard deviation of sensor noise in a command, as a share of its room.",
)
@click.option("--lead/--no-lead", default=True, help="Try a lead against the engine's lag.  [default: --lead]")
@click.option(
    "--schedule/--no-schedule",
    "scheduled",
    default=True,
    help="Let gains follow the thrust where fuel burns and a full tank's do not fit.  [default: --schedule]",
)
@click.option(
    "--start",
    type=click.Path(path_type=Path),
    metavar="FILE.toml",
    help="A controller file: search from its gains on, for its candidate alone; seconds.",
)
@click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="As in hexjet fly, over a plain hover.")
@click.option("--out", type=click.Path(path_type=Path), metavar="FILE.toml", help="[default: a new folder in runs/]")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
def design(
    engine: str,
    aircraft: str,
    controller: str,
    model: Path | None,
    amplitude: float | None,
    max_sensitivity: float,
    delay_tolerance: float,
    gain_tolerance: float,
    min_bandwidth: float,
    noise_share: float,
    lead: bool,
    scheduled: bool,
    start: Path | None,
    settings: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> int:
    """Design a controller for an engine on an aircraft: predictor, its model, and the gains of all axes.

    Writes a controller file for hexjet fly --controller, and a page beside it.  Status 1: no design keeps the
    requirements, and what would allow one.
    """
    from cosim.base.threads import one_thread

    one_thread()
    from cosim.cli.console import part_progress, print_design
    from cosim.design.design import design as make
    from cosim.design.result import to_dict, write
    from cosim.design.tune import Requirements

    need = Requirements(
        max_sensitivity=max_sensitivity,
        delay_tolerance=delay_tolerance,
        gain_tolerance=gain_tolerance,
        min_bandwidth_hz=min_bandwidth,
        noise_share=noise_share,
    )
    with part_progress("design", quiet=as_json) as tell:
        found = make(
            engine,
            aircraft,
            controller=controller,
            need=need,
            settings=settings,
            model=model,
            amplitude=amplitude,
            lead=lead,
            scheduled=scheduled,
            start=start,
            say=lambda text: tell(text, 0, 1),
        )
    paths = write(found, out)
    if as_json:
        click.echo(json.dumps(to_dict(found, paths), allow_nan=False))
    else:
        print_design(found, paths)
    return DONE if found.ok else FLIGHT_FAILED


@cli.command(epilog=_example("hexjet report runs/roll-doublet-smith-001"))
@click.argument("folder", type=click.Path(path_type=Path), metavar="DIR")
def report(folder: Path) -> int:
    """Write the report of the run or the campaign in DIR again.

    A run that was killed is finished first, with all that it recorded; a campaign may still be flown.
    """
    from cosim.campaign.folder import is_campaign
    from cosim.cli.console import print_campaign, print_run
    from cosim.results.report.flight import write_report
    from cosim.results.run import REPORT, open_run

    if is_campaign(folder):
        from cosim.campaign import open_campaign
        from cosim.campaign.analysis.page import write_campaign_report

        campaign = open_campaign(folder)
        print_campaign(campaign, write_campaign_report(campaign))
        return DONE
    run = open_run(folder)
    write_report(run, folder / REPORT)
    print_run(run)
    return DONE


@cli.command(epilog=_example("hexjet paper --out runs/paper"))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    default=Path("runs/paper"),
    show_default=True,
    help="Where the result goes; parts that are there already are taken up.",
)
@click.option("--workers", type=click.IntRange(1, 64), default=2, show_default=True, help="Processes.")
@click.option(
    "pages",
    "--page",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.md",
    multiple=True,
    help="Write counts and tables between the page's marks.",
)
@click.option("as_json", "--json", is_flag=True, help="Print the comparison as one JSON object and nothing else.")
def paper(out: Path, workers: int, pages: tuple[Path, ...], as_json: bool) -> int:
    """Reproduce the paper: every experiment on the linear plant and in six degrees of freedom, number by number.

    Leaves comparison.csv, comparison.json and report.html in DIR.  An interrupted call goes on where it ended.
    """
    from cosim.cli.console import part_progress, print_paper
    from cosim.paper.pages import write_page
    from cosim.paper.reproduce import reproduce
    from cosim.paper.result import DATA, REPORT
    from cosim.results.report.marks import check_marks

    for page in pages:
        check_marks(page, ())
    with part_progress("paper", quiet=as_json) as say:
        found = reproduce(out, say, workers)
    for page in pages:
        write_page(page, found)
    if as_json:
        click.echo(json.dumps(json.loads((out / DATA).read_text(encoding="utf-8")), allow_nan=False))
    else:
        print_paper(found, out / REPORT)
    return DONE


@cli.command(epilog=_example("hexjet faults --kind flame-out --kind thrust"))
@click.option("--aircraft", default="hexjet", show_default=True, help="See: hexjet list aircraft.")
@click.option("--engine", metavar="NAME|FILE", help="See: hexjet list engines.  [default: the aircraft's own]")
@click.option(
    "controllers", "--controller", metavar="NAME", multiple=True, help="[default: four, where they have a model]"
)
@click.option("kinds", "--kind", metavar="NAME", multiple=True, help="Only faults that begin so.  [default: all]")
@click.option("--limits", is_flag=True, help="Also: how much thrust may be lost, and how late it may be noticed.")
@click.option(
    "--engine-out",
    is_flag=True,
    help="Instead: one engine out in hover, at every station, of every aircraft (or --aircraft) with every engine (or "
    "--engine) that lifts it, each with the gains designed for it, beside the lean that no throttles avoid.",
)
@click.option(
    "--designs",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Of --engine-out: where its controllers are, ENGINE.toml by hexjet design; a missing one is designed and "
    "written there.  [default: designs in --out]",
)
@click.option(
    "--docs",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    metavar="DIR",
    help="Write the tables between the marks of faults.md, with --limits, or with --engine-out of faults.md and "
    "full-scale.md, there; of all that they hold.",
)
@click.option("--workers", type=click.IntRange(1, 64), default=2, show_default=True, help="Processes.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="[default: a new one in runs/]")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
@click.pass_context
def faults(
    context: click.Context,
    aircraft: str,
    engine: str | None,
    controllers: tuple[str, ...],
    kinds: tuple[str, ...],
    limits: bool,
    engine_out: bool,
    designs: Path | None,
    docs: Path | None,
    workers: int,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fly every single fault, from hover and from a roll of 10 deg, and tell which the vehicle survives.

    Leaves survival.csv and survival.html in DIR; with --engine-out, engine-out.csv.
    """
    from cosim.campaign.fault_survey import (
        PARTS,
        survival,
        write,
        write_page,
    )
    from cosim.cli.console import part_progress, print_survival
    from cosim.flight import new_folder
    from cosim.results.report.marks import check_marks

    if engine_out:
        own = ("aircraft", "engine", "engine_out", "designs", "docs", "workers", "out", "as_json")
        _refuse_others(context, "does not go with --engine-out", *own)
        stated = context.get_parameter_source("aircraft") is ParameterSource.COMMANDLINE
        folder = out if out is not None else new_folder(Path("runs"), "engine-out")
        return _engine_out(
            (aircraft,) if stated else (), (engine,) if engine else (), folder, designs, docs, workers, as_json
        )
    if designs is not None:
        raise InputError("--designs goes with --engine-out")
    page = None if docs is None else docs / "faults.md"
    if page is not None:
        why = "the page holds every fault of the default vehicle with every controller; leave it out with --docs"
        _refuse_others(context, why, "docs", "limits", "workers", "out", "as_json")
        check_marks(page, PARTS)

    with part_progress("faults", quiet=as_json) as say:
        found = survival(aircraft, engine, controllers, kinds, workers, say, limits or page is not None)
    paths = write(found, out if out is not None else new_folder(Path("runs"), f"faults-{aircraft}"))
    if page is not None:
        write_page(found, page)
    if as_json:
        click.echo(json.dumps(found.to_dict(), allow_nan=False))
    else:
        print_survival(found, paths["report"])
    return DONE


def _engine_out(
    aircraft: tuple[str, ...],
    engines: tuple[str, ...],
    folder: Path,
    designs: Path | None,
    docs: Path | None,
    workers: int,
    as_json: bool,
) -> int:
    from cosim.campaign.engine_out import (
        check_pages,
        engine_out,
        write,
        write_pages,
    )
    from cosim.cli.console import part_progress, print_engine_out

    if docs is not None:
        if aircraft or engines:
            raise InputError("--docs: the pages hold every aircraft and engine; leave out --aircraft and --engine")
        check_pages(docs)
    with part_progress("engine out", quiet=as_json) as say:
        found = engine_out(aircraft, engines, designs or folder / "designs", workers, say)
    path = write(found, folder)
    pages = write_pages(found, docs) if docs is not None else []
    if as_json:
        click.echo(json.dumps(found.to_dict(), allow_nan=False))
    else:
        print_engine_out(found, [path, *pages])
    return DONE


@cli.command(epilog=_example("hexjet failsafes --failsafe GNSS --height 10 --wind 5"))
@click.option("--aircraft", default="hexjet", show_default=True, help="One that has an autopilot.")
@click.option("--engine", metavar="NAME|FILE", help="See: hexjet list engines.  [default: the aircraft's own]")
@click.option("--controller", metavar="NAME", help="[default: smith, or baseline where there is no model]")
@click.option("kinds", "--failsafe", metavar="NAME", multiple=True, help="Only those that begin so.  [default: all]")
@click.option("heights", "--height", type=float, metavar="M", multiple=True, help="[default: 3, 10 and 30 m]")
@click.option("winds", "--wind", type=float, metavar="M/S", multiple=True, help="[default: 0, 5 and 10 m/s]")
@click.option("--workers", type=click.IntRange(1, 64), default=2, show_default=True, help="Processes.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="[default: a new one in runs/]")
@click.option("--page", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE", help="Write the table there.")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
def failsafes(
    aircraft: str,
    engine: str | None,
    controller: str | None,
    kinds: tuple[str, ...],
    heights: tuple[float, ...],
    winds: tuple[float, ...],
    workers: int,
    out: Path | None,
    page: Path | None,
    as_json: bool,
) -> int:
    """Let everything fail that the autopilot has an answer to, and tell how each flight ended.

    Flown from every height in every wind, with the touch-down speed and the thrust ten seconds after disarming.  Leaves
    failsafes.csv in DIR, and in DIR/flights every flight as a scenario with its requests: hexjet fly flies it again.
    """
    from cosim.campaign.failsafe_survey import (
        HEIGHTS_M,
        WINDS_M_S,
        mark,
        markdown,
        write,
    )
    from cosim.campaign.failsafe_survey import failsafes as fly_all
    from cosim.cli.console import part_progress, print_failsafes
    from cosim.flight import new_folder
    from cosim.results.report.marks import check_marks, write_marks

    if page is not None:
        check_marks(page, [mark(aircraft)])
    with part_progress("failsafes", quiet=as_json) as say:
        found = fly_all(aircraft, engine, controller, kinds, heights or HEIGHTS_M, winds or WINDS_M_S, workers, say)
    table = write(found, out if out is not None else new_folder(Path("runs"), f"failsafes-{aircraft}"))
    if page is not None:
        write_marks(page, {mark(aircraft): markdown(found)})
    if as_json:
        click.echo(json.dumps(found.to_dict(), allow_nan=False))
    else:
        print_failsafes(found, table)
    return DONE


@cli.command(epilog=_example("hexjet sweep roll-doublet --vary vehicle.mass_kg=5:6.5 --runs 100 --controller smith"))
@click.argument("name", metavar="SCENARIO|STUDY|DIR")
@click.option(
    "--vary",
    metavar="KEY=...",
    multiple=True,
    help="LO:HI, LO:HI:LEVELS, A,B,C, log(LO:HI), normal(MEAN,SD), ...; with *= or += what is drawn multiplies, or is "
    "added to, what the scenario has.",
)
@click.option("--runs", type=click.IntRange(min=1), metavar="N", help="Draws; a grid has as many as it has points.")
@click.option("--repeats", type=click.IntRange(min=1), metavar="N", help="Fly a whole grid more than once.")
@click.option("--design", metavar="NAME", help="grid, latin-hypercube, random or sobol.")
@click.option(
    "controllers", "--controller", metavar="NAME|FILE.toml", multiple=True, help="Each draw is flown with every one."
)
@click.option("--correlate", metavar="KEY,KEY=R", multiple=True, help="Rank correlation of what is drawn for two keys.")
@click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="As in hexjet fly.")
@click.option("--success", metavar="METRIC<=X", multiple=True, help="What a completed flight must keep to count.")
@click.option("--seed", type=int, help="Of the draws.")
@click.option("--workers", type=click.IntRange(min=1), metavar="N", help="Processes.  [default: one a processor]")
@click.option("--cluster", metavar="ADDRESS|local", help="A Dask scheduler, such as tcp://HOST:8786, or one made here.")
@click.option(
    "--time-limit",
    type=_Number(min=0.0, min_open=True),
    metavar="S",
    help="For a flight.  [default: 60, or ten of its lengths]",
)
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="[default: a new one in runs/]")
@click.option("--resume", is_flag=True, help="Go on with what the folder holds; nothing that is finished is repeated.")
@click.option(
    "--keys", is_flag=False, flag_value="*", metavar="[PATTERN]", help="List what can be varied, and fly nothing."
)
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object at the end and nothing else.")
def sweep(
    name: str,
    workers: int | None,
    cluster: str | None,
    time_limit: float | None,
    out: Path | None,
    resume: bool,
    keys: str | None,
    as_json: bool,
    **options: Any,
) -> int:
    """Fly a scenario many times with what varies drawn for each flight, or a study, or go on with a campaign in DIR.

    Leaves one Parquet data set with a row a flight, and a page.  Flights that fail are rows.  Status 0: all are flown,
    whatever became of them; 1: it was stopped before; 2: wrong input.
    """
    from cosim.campaign.analysis.page import write_campaign_report
    from cosim.campaign.analysis.summary import campaign_summary
    from cosim.campaign.run import opened, run_campaign, workers_at
    from cosim.cli.console import output_to_stderr, print_campaign, sweep_progress

    if keys is not None:
        return _list_keys(name, options["settings"], keys, as_json)
    study, folder = opened(name, out, resume, **options)
    for text in study.notes() if study is not None else ():
        click.echo(f"hexjet: note: {text}", err=True)
    with _terminated_as_interrupted(), output_to_stderr(as_json), sweep_progress(folder, quiet=as_json) as tell:
        with workers_at(workers, cluster, time_limit) as flying:
            campaign = run_campaign(study, folder, flying, resume, tell)
        page = write_campaign_report(campaign)
    if as_json:
        places = {"folder": str(folder), "report": str(page)}
        click.echo(json.dumps(places | campaign_summary(campaign), allow_nan=False))
    else:
        print_campaign(campaign, page)
    return DONE


def _list_keys(name: str, settings: tuple[str, ...], pattern: str, as_json: bool) -> int:
    from cosim.campaign.study.keys import all_keys, matching
    from cosim.campaign.study.study import Study, study_names
    from cosim.cli.console import print_keys
    from cosim.spec.scenario import Scenario

    base = Study.load(name).base() if name in study_names() else Scenario.load(name, list(settings))
    found = matching(all_keys(base), pattern)
    if as_json:
        told = [{"key": key.path, "value": key.nominal, "unit": key.unit, "allowed": key.allowed} for key in found]
        click.echo(json.dumps({"keys": told}, allow_nan=False))
    else:
        print_keys(found)
    return DONE


@cli.command(epilog=_example("hexjet search roll-doublet --vary mismatch.delay_samples=0:60 --controller smith"))
@click.argument("name", metavar="SCENARIO")
@click.option(
    "--vary",
    metavar="KEY=LO:HI[:N]",
    multiple=True,
    help="Search this key between LO and HI, scanned in N points; *= and += as in hexjet sweep, log(LO:HI) too.  Of "
    "several, each alone and then all together.",
)
@click.option("--over", metavar="KEY=LO:HI:N", help="A curve: search at each of these values of a second key.")
@click.option("controllers", "--controller", metavar="NAME|FILE.toml", multiple=True, help="Each is searched.")
@click.option(
    "--tolerance", metavar="[KEY=]X", multiple=True, help="How near the edge is to be known.  [(HI - LO) / 200]"
)
@click.option("--seeds", type=click.IntRange(1, 10_000), default=1, show_default=True, help="Flights of every point.")
@click.option(
    "--share",
    type=_Number(0.0, 1.0),
    default=0.0,
    help="Of a point's flights that have to break before it does.  [default: any of them]",
)
@click.option("--success", metavar="METRIC<=X", multiple=True, help="What a completed flight must keep too.")
@click.option(
    "--budget", type=click.IntRange(min=1), default=1000, show_default=True, help="Flights for keys together."
)
@click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="As in hexjet fly.")
@click.option("--seed", type=int, help="Of the first flight of a point.  [default: the scenario's]")
@click.option("--workers", type=click.IntRange(min=1), metavar="N", help="Processes.  [default: one a processor]")
@click.option("--cluster", metavar="ADDRESS|local", help="As in hexjet sweep.")
@click.option("--time-limit", type=_Number(min=0.0, min_open=True), metavar="S", help="For a flight.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="[default: a new one in runs/]")
@click.option("--resume", is_flag=True, help="Go on with the same search in DIR; nothing is flown twice.")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object at the end and nothing else.")
def search(
    name: str,
    workers: int | None,
    cluster: str | None,
    time_limit: float | None,
    out: Path | None,
    resume: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Find the smallest change that breaks a controller: of a delay, a gain, a payload, a gust, or any other key.

    Leaves search.json, search.html, every flight, and the flights that show it.  Status 0: searched, whatever was
    found; 1: it was stopped before, or a flight that shows it came out otherwise when it was flown again.
    """
    from cosim.campaign.run import workers_at
    from cosim.campaign.search.folder import opened, run_search
    from cosim.cli.console import output_to_stderr, print_search, search_progress
    from cosim.flight import new_folder

    study, plan = opened(name, **options)
    if resume and out is None:
        raise InputError("--resume: give the folder of the search with --out")
    folder = out if out is not None else new_folder(Path("runs"), f"search-{study.name}")
    with (
        _terminated_as_interrupted(),
        output_to_stderr(as_json),
        search_progress(folder, quiet=as_json) as tell,
        workers_at(workers, cluster, time_limit) as flying,
    ):
        searched = run_search(study, plan, folder, flying, resume, tell)
    if as_json:
        click.echo(json.dumps(searched.to_dict(), allow_nan=False))
    else:
        print_search(searched)
    return DONE if searched.confirmed else FLIGHT_FAILED


@cli.command(epilog=_example("hexjet export runs/roll-doublet-smith-001 --to ulog"))
@click.argument("folder", type=click.Path(path_type=Path), metavar="DIR")
@click.option("target", "--to", type=click.Choice(["ulog", "csv"]), required=True, help="The format.")
@click.option(
    "--rates",
    type=click.Choice(["all", "px4"]),
    default="all",
    show_default=True,
    help="ULog: every step, or each topic about as often as PX4 logs it.",
)
def export(folder: Path, target: str, rates: Literal["all", "px4"]) -> int:
    """Write the log of the run in DIR as CSV, or as ULog for PlotJuggler and Flight Review."""
    from cosim.results.export import export_csv, export_ulog

    path = folder / {"ulog": "flight.ulg", "csv": "flight.csv"}[target]
    if target == "ulog":
        export_ulog(folder, path, rates)
    elif rates != "all":
        raise InputError("--rates: is for --to ulog; CSV has every step")
    else:
        export_csv(folder, path)
    click.echo(str(path))
    return DONE


@cli.command(epilog=_example("hexjet bench --only step --only engines"))
@click.option("--full", is_flag=True, help="Everything, with longer flights and a campaign: some ten minutes.")
@click.option("--campaign", is_flag=True, help="What a second worker brings to a campaign, too: a minute more.")
@click.option(
    "--only",
    "parts",
    multiple=True,
    metavar="PART",
    help="This part alone, or these: step, blocks, others, peers, rotorpy, time, engines, log, start, memory, "
    "campaign.",
)
@click.option("--steps", type=click.IntRange(min=250), help="Steps of a timed flight.  [2500, with --full 5000]")
@click.option("--rounds", type=click.IntRange(min=1), help="Repetitions.  [5, with --full 9]")
@click.option("--starts", type=click.IntRange(min=1), help="Processes started for each figure of a process.  [5]")
@click.option("--memory-minutes", type=_Number(min=0.1), metavar="MINUTES", help="Flown for the memory.  [5, or 60]")
@click.option(
    "--dir", "folder", type=click.Path(exists=True, file_okay=False), metavar="DIR", help="Where flights are recorded."
)
@click.option("--page", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE.md", help="Write the tables in.")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
@click.pass_context
def bench(
    context: click.Context,
    /,
    full: bool,
    campaign: bool,
    parts: tuple[str, ...],
    page: Path | None,
    as_json: bool,
    **amounts: Any,
) -> int:
    """Measure what a flight costs on this machine, in microseconds and in JSBSim runs.

    Beside bare JSBSim, and beside ecos, libcosim, FMPy and RotorPy as far as they are installed.  Times belong to the
    machine: however long anything takes, the exit status is 0.
    """
    from cosim.bench import make_plan, measure
    from cosim.bench.page import check_page, write_page
    from cosim.bench.show import print_result, progress
    from cosim.bench.targets import to_dict

    plan = make_plan(full, campaign, parts, amounts)
    if page is not None:
        check_page(page)
    with progress(quiet=as_json) as tell:
        result = measure(plan, tell)
    if page is not None:
        write_page(page, result, _as_given(context))
    if as_json:
        click.echo(json.dumps(to_dict(result), allow_nan=False))
    else:
        print_result(result)
    return FLIGHT_FAILED if result.failed else DONE


def _as_given(context: click.Context) -> str:
    """The command with the options that were given, as it can be typed again."""
    words = ["hexjet", context.info_name or ""]
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if context.get_parameter_source(parameter.name or "") is ParameterSource.COMMANDLINE:
            for each in value if isinstance(value, tuple) else [value]:
                text = f"{each:g}" if isinstance(each, float) else str(each)
                words += [max(parameter.opts, key=len), *([] if each is True else [text])]
    return shlex.join(words)


def main(arguments: list[str] | None = None) -> None:
    """The command ``hexjet``: exits with 0, 1 (the flight failed) or 2 (wrong input, one line)."""
    try:
        status = cli.main(args=arguments, prog_name="hexjet", standalone_mode=False)
    except InputError as error:
        _complain(str(error))
        status = WRONG_INPUT
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help() if error.ctx else "", err=True)
        status = WRONG_INPUT
    except click.ClickException as error:
        where = f" ({error.ctx.command_path} --help)" if isinstance(error, click.UsageError) and error.ctx else ""
        _complain(" ".join(error.format_message().split()) + where)
        status = WRONG_INPUT
    except FlightError as error:
        _complain(str(error))
        status = FLIGHT_FAILED
    except BrokenPipeError:
        # whoever read the output has gone; keep Python from complaining about it while it shuts down
        sys.stdout = None
        status = DONE
    except OSError as error:
        if error.errno not in MACHINE_TROUBLE:
            raise
        _complain(f"{error.strerror}; temporary files are in {tempfile.gettempdir()}")
        status = FLIGHT_FAILED
    except (click.Abort, KeyboardInterrupt) as error:
        status = TERMINATED if isinstance(error.__cause__ or error, _Terminated) else INTERRUPTED
    sys.exit(status if isinstance(status, int) else DONE)


def _complain(message: str) -> None:
    click.echo(f"hexjet: {message}", err=True)
