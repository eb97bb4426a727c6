"""A run's log as CSV, with every digit."""

from __future__ import annotations

import csv
from pathlib import Path

from cosim.results.export.output import ROWS, open_output
from cosim.results.run import open_run


def export_csv(folder: Path, path: Path) -> None:
    """Write every column of a run's log as CSV, each number with all its digits; missing set-points are ``nan``.

    Raises InputError if there is no run or the file cannot be written.
    """
    run = open_run(folder)
    with open_output(run, path) as temporary, open(temporary, "w", encoding="ascii", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(run.log.columns)
        for block in run.log.blocks(run.log.columns, ROWS):
            writer.writerows(zip(*(values.tolist() for values in block.values()), strict=True))
