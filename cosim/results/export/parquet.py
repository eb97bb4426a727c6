"""A run's log as a Parquet file of its own: its fields say what they mean, the file what was flown."""

from __future__ import annotations

from pathlib import Path

from cosim.base.errors import FlightError, InputError
from cosim.results.export.output import describe_columns, open_output, run_properties
from cosim.results.log.arrow import write_log
from cosim.results.run import LOG, open_run


def export_parquet(folder: Path, path: Path) -> None:
    """Write a run's log as Parquet, every column float64, with unit, frame and meaning in each field's metadata.

    The run's own file says the same of its columns, and nothing of the flight; this one has the run's facts in its
    metadata too, and descriptions also where an older run's file has none.  Raises InputError if there is no run, if
    ``path`` is the run's own file, or if it cannot be written.
    """
    run = open_run(folder)
    if path.resolve() == (folder / LOG).resolve():
        raise InputError(f"{path}: the log is Parquet already; --out FILE makes a copy that says what was flown")
    with open_output(run, path) as temporary:
        try:
            write_log(temporary, describe_columns(run), run.log.blocks(run.log.columns), run_properties(run.summary))
        except FlightError as error:
            raise InputError(f"{path}: {str(error).rpartition(': ')[2]}") from error
