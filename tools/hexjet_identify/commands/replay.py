"""hexjet replay: a recorded flight flown again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.base.errors import InputError
from cosim.commands import (
    DONE,
    FLIGHT_FAILED,
    CommandProgress,
    Flight,
    example,
    is_given,
    opt,
    output_to_stderr,
    part_progress,
    say,
    show_table,
)

if TYPE_CHECKING:
    from hexjet_identify.replay import Replay


class Replayed(opt.LogPart, Flight, opt.Output):
    """Options of ``hexjet replay``."""

    log: Path = opt.argument(metavar="LOG", type=click.Path(path_type=Path))
    aircraft = opt.word(
        "--aircraft", "NAME|DIR", "What flies again, with the engine that it is made for.  [default: the scenario's]"
    )
    engines = opt.words("--engine", "[N=]NAME|FILE", "As in hexjet fly.  [default: the one it is made for]")
    scenario = opt.word(
        "--scenario",
        "NAME|FILE",
        "With aircraft, air and mass where they are not given; of a run's folder its own.",
        "hover",
    )
    settings = opt.SETTINGS
    throttles = opt.words(
        "--throttle", "N=SUM", "The command of engine N in the log.  [default: the channel called so]"
    )
    limits: tuple[float, float] | None = opt.option(
        "--throttle-range",
        type=(opt.Number(), opt.Number()),
        metavar="LOW HIGH",
        help="What throttle 0 and 1 are in the log.",
    )
    window_s = opt.number("--window", "S", "It starts anew after so long.  [default: by its size]", min=0.1, max=10.0)
    draws = opt.whole("--draws", None, "Vehicles that are drawn within their tolerances.", min=1, max=1000, default=20)
    inertia = opt.number(
        "--inertia-tolerance", "%", "Standard deviation of each moment of inertia.", min=0.0, max=50.0, default=5.0
    )
    mass = opt.number("--mass-tolerance", "%", "Standard deviation of the mass.", min=0.0, max=50.0, default=2.0)
    thrust = opt.number(
        "--thrust-tolerance",
        "%",
        "Standard deviation of the thrust of an engine without [uncertainty].",
        min=0.0,
        max=50.0,
        default=3.0,
    )
    drawn = opt.whole("--seed", None, "Seed of the draws.", min=0, default=1)
    time_column, time_unit, begin, end = opt.LOG_PART
    out = opt.OUT
    as_json = opt.JSON


@click.command(epilog=example("hexjet replay flight.ulg --aircraft ./mine --engine bench/engine.toml"))
@opt.takes(Replayed)
def replay(options: Replayed) -> int:
    """Fly a recorded flight again, in six degrees of freedom, and judge the model by it.

    LOG is what hexjet identify log reads: ULog, DataFlash, blackbox, Crazyflie, tables, a run's folder. Its engines'
    commands drive the vehicle in short windows, each started from the recorded state; the vehicle is drawn within its
    tolerances. Says what the model explains, and names what is wrong with it where the log tells: an inertia, a
    delay, swapped engines. Leaves a page, replay.json and replay.csv. Status 0: explained; 1: not, or not told.
    """
    from cosim.commands import one_thread

    one_thread()
    from hexjet_identify.api.replay import WRITTEN
    from hexjet_identify.api.replay import replay as fly_again

    options.check_out(*WRITTEN)
    is_own = options.log.is_dir() and not is_given("scenario")
    chosen = options.chosen("time_column", "time_unit", "begin", "end", "window_s", "draws", "aircraft", "settings")
    with output_to_stderr(options.as_json), part_progress("replay", quiet=options.as_json) as show:
        result = fly_again(
            options.log,
            None if is_own else options.scenario,
            throttle=_channels(options),
            engine=options.engines,
            throttle_range=options.limits,
            inertia_tolerance=0.01 * options.inertia,
            mass_tolerance=0.01 * options.mass,
            thrust_tolerance=0.01 * options.thrust,
            seed=options.drawn,
            progress=CommandProgress(show),
            **chosen,
        )
    result.write(options.run_folder("replay"))
    options.answer(result.to_dict, lambda: print_replay(result.replayed, result.files))
    return DONE if result.explained else FLIGHT_FAILED


def _channels(options: Replayed) -> dict[int, str]:
    """Return the channel of each engine that the options name.  Raises InputError."""
    channels = {}
    for text in options.throttles:
        number, equals, name = text.partition("=")
        if not equals or not number.strip().isdecimal() or not name.strip():
            raise InputError(f"--throttle {text}: must be N=CHANNEL, N the engine from 1")
        channels[int(number)] = name.strip()
    return channels


def print_replay(result: Replay, paths: dict[str, Path]) -> None:
    """Print the verdict, what it rests on, the channels, what may be wrong, and where the page is."""
    from hexjet_identify.api.replay import CHANNEL_COLUMNS
    from hexjet_identify.replay.page import channel_rows

    say(f"{result.verdict}: {result.aircraft} with {result.engine} beside {result.log}")
    if result.fault:
        say(result.fault)
    for line in result.evidence:
        say(f"  {line}")
    show_table(CHANNEL_COLUMNS, channel_rows(result), range(1, 6))
    for note in result.notes:
        say(f"note: {note}")
    say(f"report: {paths['report']}", wrap=False)
