"""hexjet validate: a model beside a flight."""

from __future__ import annotations

import json
from pathlib import Path

import click

from cosim.base.signals import AXES
from cosim.cli.console import terminal
from cosim.cli.options import DONE, example, log_options
from cosim.cli.outputs import Out


@click.command(epilog=example("hexjet validate roll-model other-flight.ulg"))
@click.argument("model", metavar="MODEL", type=click.Path(path_type=Path))
@click.argument("log", metavar="LOG", type=click.Path(path_type=Path))
@click.option("--axis", type=click.Choice(AXES), help="Of a model file that has more than one.")
@log_options
@click.option("--out", type=Out(), metavar="DIR", help="[default: a new one in runs/]")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
def validate(
    model: Path,
    log: Path,
    axis: str | None,
    time_column: str | None,
    time_unit: str,
    begin: float | None,
    end: float | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fly a model with the commands of a log, beside what happened.

    MODEL is the folder that hexjet identify log left, its identification.json, or a model file (.toml) that any
    hexjet identify wrote; LOG is what hexjet identify log reads, of another flight best.  Leaves a page and
    validation.json.  Status 0, however well it fits.
    """
    from cosim.base.runtime.threads import one_thread

    one_thread()
    from cosim.flight import new_folder
    from cosim.identify.logs import read_flight_log
    from cosim.identify.prediction_error.validate import read_model, rows, write
    from cosim.identify.prediction_error.validate import validate as compare

    comparison = compare(read_model(model, axis), read_flight_log(log, time_column, time_unit), begin, end)
    paths = write(comparison, out if out is not None else new_folder(Path("runs"), "validation"))
    if as_json:
        click.echo(json.dumps(comparison.to_dict(), allow_nan=False))
        return DONE
    console = terminal()
    console.print(
        f"{comparison.model.what} of {comparison.model.path} beside {comparison.log}, {comparison.seconds:.1f} s",
        highlight=False,
        markup=False,
    )
    for name, value in rows(comparison):
        console.print(f"  {name}: {value}", highlight=False, markup=False)
    for note in comparison.notes:
        console.print(f"note: {note}", highlight=False, markup=False)
    console.print(f"report: {paths['report']}", highlight=False, soft_wrap=True)
    return DONE
