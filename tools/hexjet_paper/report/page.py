"""What the paper's report says beside its figures: counts, tables, and the lines of the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from math import degrees
from pathlib import Path
from statistics import median
from typing import Any

from cosim import versions
from cosim.pages import render
from hexjet_paper import numbers
from hexjet_paper.claims import ClaimRow, Judgement
from hexjet_paper.comparison import Row
from hexjet_paper.extensions import MAX_SENSITIVITY
from hexjet_paper.report.figures import FIDELITIES, NAMES, paper_figures
from hexjet_paper.report.readings import model_error_table, model_errors_in_words, readings_table
from hexjet_paper.report.result import COMPARISON, DATA, Reproduction

TEMPLATE = Path(__file__).parent / "templates" / "paper.html"
VERDICTS = ("holds", "under a condition", "by construction", "does not hold", "not flown")  # in order of tables


def write_page(reproduction: Reproduction, path: Path) -> None:
    """Write the page of the paper's reproduction.  Raises FlightError if the file cannot be written."""
    render(TEMPLATE, path, paper_figures(reproduction), **page_values(reproduction))


def page_values(reproduction: Reproduction) -> dict[str, Any]:
    """Return the values that the page's template uses."""
    part = reproduction.linear
    predicted = [
        row for row in reproduction.rows if row.origin == "predicted" and (row.linear or row.flight) is not None
    ]
    return {
        "source": numbers.SOURCE,
        "claims": reproduction.claims,
        "consistency": reproduction.consistency,
        "readings": readings_table(reproduction.readings),
        "model_errors": model_error_table(reproduction.model_errors),
        "model_errors_in_words": model_errors_in_words(reproduction.model_errors),
        "verified": verified_in_words(reproduction),
        "tally": [(fidelity, counts) for fidelity, counts in tally(reproduction.claims).items()],
        "verdicts": VERDICTS,
        "counts_in_words": counts_in_words(reproduction.claims),
        "rows": rows_to_compare(reproduction.rows),
        "inputs": [row for row in reproduction.rows if row not in rows_to_compare(reproduction.rows)],
        "used_count": len({row.key for row in part.frozen.used}),
        "predicted_count": len(predicted),
        "typical": {
            "linear": _median_size(row.linear_deviation for row in predicted),
            "flight": _median_size(row.flight_deviation for row in predicted),
        },
        "margins": margin_rows(reproduction),
        "frozen": part.frozen,
        "conditions": part.conditions,
        "robust": MAX_SENSITIVITY,
        "smith_offset_deg": degrees(part.smith_offset),
        "offsets": offset_rows(reproduction),
        "noise": [
            (name, part.noise.get(("quadrotor", key)), part.noise.get(("hexjet", key))) for key, name in NAMES.items()
        ],
        "turbojet": [
            (reach, {row.controller: row for row in reproduction.turbojet}.get(reach.controller))
            for reach in part.turbojet
            if reach.engine == "turbojet"
        ],
        "names": NAMES,
        "files": {"comparison": COMPARISON, "data": DATA},
        "versions": versions(),
    }


def tally(claims: Iterable[ClaimRow]) -> dict[str, dict[str, int]]:
    """Return the number of claims of each verdict, by fidelity."""
    rows = list(claims)
    counted: dict[str, dict[str, int]] = {}
    by_fidelity: list[list[Judgement | None]] = [[row.linear for row in rows], [row.flight for row in rows]]
    for fidelity, judged in zip(FIDELITIES, by_fidelity, strict=True):
        counts: Counter[str] = Counter(judgement.verdict if judgement else "not flown" for judgement in judged)
        counted[fidelity] = {verdict: counts[verdict] for verdict in VERDICTS}
    return counted


def count_choices(claims: Iterable[ClaimRow]) -> list[int]:
    """Return for each fidelity how many claims hold because of a choice of ours."""
    rows = list(claims)
    return [
        sum(
            judgement is not None and judgement.verdict == "holds" and judgement.basis == "follows from a choice"
            for judgement in judged
        )
        for judged in ([row.linear for row in rows], [row.flight for row in rows])
    ]


def counts_in_words(claims: Iterable[ClaimRow]) -> str:
    """Return a sentence on how many claims hold, printed above the tables."""
    linear, flight = tally(claims).values()
    return (
        f"Of {sum(linear.values())} claims of the paper {linear['holds']} hold on the linear plant and "
        f"{flight['holds']} in six degrees of freedom."
    )


def verified_in_words(reproduction: Reproduction) -> str:
    """Return a sentence on how near the swept roll response is to the printed G(z)."""
    decibel, degree = reproduction.identified.deviation
    low, high = reproduction.identified.band
    return (
        f"From {low:g} to {high:g} Hz the swept roll response of the co-simulation lies within {decibel:.2g} dB and "
        f"{degree:.2g}° of the printed G(z)."
    )


def margin_rows(reproduction: Reproduction) -> list[dict[str, Any]]:
    """Return the margins of each controller: computed, measured on the linear plant, measured in flight."""
    sources = (
        ("computed", reproduction.linear.evidence.margins),
        ("measured, linear plant", {name: sweep.margins for name, sweep in reproduction.linear.sweeps.items()}),
        ("measured in flight", {name: sweep.margins for name, sweep in reproduction.flight_sweeps.items()}),
    )
    return [
        {"name": NAMES[controller], "source": source, "margins": margins[controller]}
        for controller in reproduction.linear.evidence.margins
        for source, margins in sources
        if controller in margins
    ]


def offset_rows(reproduction: Reproduction) -> list[dict[str, Any]]:
    """Return the roll angles [deg] under a constant disturbance, by controller."""
    linear_offsets = {offset.controller: offset for offset in reproduction.linear.offsets}
    late = {offset.controller: offset.late for offset in reproduction.offsets}
    rows = []
    for controller in [name for name in NAMES if name in linear_offsets or name in late]:
        linear = linear_offsets.get(controller)
        values: list[float | None] = [linear.peak, linear.early, linear.late] if linear else [None] * 3
        values.append(late.get(controller))
        rows.append(
            {
                "name": NAMES[controller],
                "values_deg": [None if value is None else degrees(value) for value in values],
            }
        )
    return rows


def rows_to_compare(rows: Iterable[Row]) -> list[Row]:
    """Return the comparison's rows without the experiments' inputs, which agree by construction."""
    return [row for row in rows if row.origin != "given" or row.flight is not None]


def _median_size(deviations: Iterable[float | None]) -> float:
    """Return the median absolute deviation [%]."""
    return median(abs(deviation) for deviation in deviations if deviation is not None)
