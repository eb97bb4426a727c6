"""hexjet validate: a model beside a flight."""

from __future__ import annotations

from pathlib import Path

import click

from cosim.base.signals import AXES
from cosim.commands import DONE, example, opt, say


class Validate(opt.LogPart, opt.Output):
    """Options of ``hexjet validate``."""

    model: Path = opt.argument(metavar="MODEL", type=click.Path(path_type=Path))
    log: Path = opt.argument(metavar="LOG", type=click.Path(path_type=Path))
    axis = opt.choice("--axis", AXES, "The axis, of a model file that has several.")
    time_column, time_unit, begin, end = opt.LOG_PART
    out = opt.OUT
    as_json = opt.JSON


@click.command(epilog=example("hexjet validate roll-model other-flight.ulg"))
@opt.takes(Validate)
def validate(options: Validate) -> int:
    """Fly a model with the commands of a log, beside what happened.

    MODEL is the folder that hexjet identify log left, its identification.json, or a model file (.toml) that any
    hexjet identify wrote; LOG is what hexjet identify log reads, of another flight best.  Says whether gain and delay,
    fitted anew to it, are the model's.  Leaves a page and validation.json.  Status 0, however well it fits.
    """
    from cosim.commands import one_thread

    one_thread()
    from hexjet_identify.api.logs import VALIDATION
    from hexjet_identify.api.logs import validate as compare
    from hexjet_identify.prediction_error.validate import rows

    options.check_out(*VALIDATION)
    result = compare(**options.chosen("model", "log", "axis", "time_column", "time_unit", "begin", "end"))
    result.write(options.run_folder("validation"))
    comparison = result.validation

    def show() -> None:
        say(result.lines()[0])
        for line in comparison.judgement.evidence:
            say(f"  {line}")
        for name, value in rows(comparison):
            say(f"  {name}: {value}")
        for note in comparison.notes:
            say(f"note: {note}")
        say(f"report: {result.report}", wrap=False)

    options.answer(result.to_dict, show)
    return DONE
