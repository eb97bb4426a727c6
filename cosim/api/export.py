"""A run's log in other formats: what ``hexjet export DIR`` calls."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from cosim.api.call import check_types
from cosim.base.errors import InputError
from cosim.results.export import export_log
from cosim.results.run import Run


@check_types()
def export(
    run: Run | str | Path, to: str, out: str | Path | None = None, *, rates: Literal["all", "px4"] = "all"
) -> Path:
    """Write the log of a run for other tools.

    >>> export(fly("hover", "runs/one", settings={"duration_s": 0.2}), "csv").name
    'flight.csv'

    Parameters
    ----------
    run : Run or str or Path
        A run with a folder, or its folder.
    to : str
        ``csv`` with all digits, ``parquet``, ``ulog`` for PlotJuggler and Flight Review, ``mcap`` for Foxglove,
        PlotJuggler and Rerun, ``mat`` for MATLAB, or a format of another package.
    out : str or Path or None
        The file or its folder, what is there is overwritten; None: in the run's folder.
    rates : str
        Rates of ULog: ``all`` steps, or each topic about as often as ``px4`` logs it.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If there is no run, or the file cannot be written.
    """
    folder = run.folder if isinstance(run, Run) else Path(run)
    if folder is None:
        raise InputError("export: this run is in memory alone; fly it with out=FOLDER")
    if to != "ulog" and rates != "all":
        raise InputError(f"export: rates: is for ulog alone; {to} has every step")
    options = {"rates": rates} if to == "ulog" else {}
    return export_log(to, folder, None if out is None else Path(out), **options)
