"""``python -m benchmarks``: measure, print tables or one JSON object; the measurements are in :mod:`cosim.bench`."""

from __future__ import annotations

import json

import click

from cosim.bench import Plan, measure
from cosim.bench.show import print_result, progress
from cosim.errors import FlightError, InputError

HOUR = 60.0


@click.command()
@click.option("--steps", type=click.IntRange(min=250), default=Plan.steps, show_default=True, help="Steps of a flight.")
@click.option("--rounds", type=click.IntRange(min=1), default=Plan.rounds, show_default=True, help="Repetitions.")
@click.option("--starts", type=click.IntRange(min=1), default=Plan.starts, show_default=True, help="Processes started.")
@click.option("--full", is_flag=True, help="Fly an hour for the memory too: two minutes or more.")
@click.option("--memory-minutes", type=click.FloatRange(min=0.1), metavar="MINUTES", help="A shorter flight for it.")
@click.option(
    "--dir", "folder", type=click.Path(exists=True, file_okay=False), metavar="DIR", help="Where flights are recorded."
)
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
def main(
    steps: int, rounds: int, starts: int, full: bool, memory_minutes: float | None, folder: str | None, as_json: bool
) -> None:
    """Measure what a flight costs on this machine; nothing is judged."""
    plan = Plan(steps, rounds, starts, HOUR if full and memory_minutes is None else memory_minutes, folder)
    try:
        with progress(quiet=as_json) as tell:
            result = measure(plan, tell)
    except (InputError, FlightError) as error:
        raise click.ClickException(str(error)) from error
    if as_json:
        click.echo(json.dumps(result.to_dict(), allow_nan=False))
    else:
        print_result(result)


if __name__ == "__main__":
    main()
