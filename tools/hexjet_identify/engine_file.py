"""The engine that an identification leaves: its mapping file with ``[uncertainty]``, and its page in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import FlightError
from cosim.base.trust import remember_written
from cosim.files import map_os_errors
from cosim.identify.files import PICTURE, write_identification
from cosim.pages import Page, spell
from hexjet_identify.picture import draw_picture

# Name of the library's engine that holds a fitted form, and its internal step [s].
FITTED, FITTED_STEP_S = "fitted", 0.004
MAX_DELAY_SAMPLES = 1000  # of that engine
DEVIATIONS_95 = 1.96  # standard deviations of a 95 % bound


def round_delay(samples: float, deviation: float) -> tuple[int, float]:
    """Return a delay rounded to whole steps of an engine, and its standard deviation with the rounding error."""
    whole = min(round(samples), MAX_DELAY_SAMPLES)
    return whole, float(np.hypot(deviation, samples - whole))


def uncertainty_table(
    source: str, names: Sequence[str], covariance: Array, deviation: Array | None = None
) -> dict[str, object]:
    """Return the table ``[uncertainty]`` of parameters with this covariance.

    ``deviation``: standard deviations in place of the covariance's own, whose correlation is kept.
    """
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    positive = np.where(size > 0.0, size, 1.0)
    correlation = np.tril(np.round(np.clip(covariance / np.outer(positive, positive), -1.0, 1.0), 4), -1)
    return {
        "source": source,
        "parameters": list(names),
        "deviation": [float(f"{value:.6g}") for value in (size if deviation is None else deviation)],
        "correlation": (correlation + correlation.T + np.eye(len(names))).tolist(),
    }


def write_with_engine(
    folder: Path, record: Mapping[str, Any], page: Page, texts: Mapping[str, str], archive: Path | None
) -> dict[str, Path]:
    """Write an identification and, where ``archive`` is its engine's, the engine; return the paths by kind.

    The archive is copied and is trusted from then on; the README gets the figure ``signals`` as PICTURE.  Raises as
    :func:`cosim.identify.files.write_identification`, FlightError if the archive cannot be read.
    """
    if archive is None:
        return write_identification(folder, record, page, texts)
    name = f"engine{archive.suffix}"
    # The archive is read before the folder's engine is removed: it may be that one.
    with map_os_errors(FlightError, archive):
        others: dict[str, str | bytes] = {name: archive.read_bytes()}
    others[PICTURE] = draw_picture(f"{page.heading}: measured and modelled", page.figures["signals"])
    paths = write_identification(folder, record, page, texts, others)
    remember_written(folder, [folder / name])
    return paths


def engine_readme(
    origin: str,
    rows: Iterable[Sequence[str]],
    source: str,
    validity: str,
    residuals: str,
    untold: Sequence[str],
    notes: Sequence[str],
    engine: str = f"the library's `{FITTED}`",
) -> str:
    """Return the page of an engine in Markdown: where it comes from, where it holds, what was left over.

    ``rows``: quantities with what was identified of them; those without are left out.
    """
    table = "\n".join(f"| {row[0]} | {row[1]} |" for row in rows if row[1])
    lines = [
        f"# Engine from a {origin}",
        f"**Source.** {source}; the engine is {engine}. It is *identified*; `[uncertainty]` in `engine.toml` says how "
        "well each parameter is known.",
        f"| with 95 % bounds | |\n| --- | --- |\n{table}",
        f"**Validity.** {validity}; nothing was seen outside, nor in other air, nor with air speed.",
        f"**Residuals.** {residuals} `report.html` has all of them.",
        f"![Measured and modelled]({PICTURE})",
        "**Not told by the log**\n\n- " + "\n- ".join(untold or ("It tells everything that was asked.",)),
        *(["**Notes**\n\n" + "\n".join(f"- {spell(line)}" for line in notes)] if notes else []),
    ]
    return "\n\n".join(lines) + "\n"
