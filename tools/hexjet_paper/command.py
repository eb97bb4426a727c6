"""hexjet paper: the paper reproduced."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.commands import DONE, Out, example, opt, part_progress, say, show_table

if TYPE_CHECKING:
    from hexjet_paper.report.result import Reproduction


class Paper(opt.Output):
    """Options of ``hexjet paper``."""

    out: Path = opt.option(
        "--out",
        type=Out(),
        metavar="DIR",
        default=Path("runs/paper"),
        show_default=True,
        help="Where the result goes; parts that are there already are taken up.",
    )
    workers: int = opt.WORKERS
    as_json = opt.json("Print the comparison as one JSON object and nothing else.")


@click.command(epilog=example("hexjet paper --out runs/paper"))
@opt.takes(Paper)
def paper(options: Paper) -> int:
    """Reproduce the paper: every experiment on the linear plant and in six degrees of freedom, number by number.

    Leaves comparison.csv, comparison.json and report.html in DIR.  An interrupted call goes on where it ended.
    """
    from hexjet_paper.report.result import DATA, REPORT
    from hexjet_paper.reproduce import reproduce

    with part_progress("paper", quiet=options.as_json) as tell:
        reproduction = reproduce(options.out, tell, options.workers)
    options.answer(
        lambda: json.loads((options.out / DATA).read_text(encoding="utf-8")),
        lambda: print_paper(reproduction, options.out / REPORT),
    )
    return DONE


def _cell(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def print_paper(reproduction: Reproduction, report: Path) -> None:
    """Print claims and numbers of the paper beside ours, how many claims follow, and where the report is."""
    from hexjet_paper.report.page import counts_in_words, rows_to_compare

    rows = []
    for row in rows_to_compare(reproduction.rows):
        name = f"{row.quantity} ({row.note})" if ".state" in row.key else row.quantity
        linear = _cell(row.linear, "{:.4g}"), _cell(row.linear_deviation, "{:+.1f} %")
        flight = _cell(row.flight, "{:.4g}"), _cell(row.flight_deviation, "{:+.1f} %")
        rows.append((name, row.unit, f"{row.paper:.4g}", *linear, *flight, row.origin))
    show_table(("quantity", "unit", "paper", "linear", "", "flight", "", "origin"), rows, range(2, 7))
    claims = [
        (claim.claim, claim.linear.verdict, claim.flight.verdict if claim.flight else "-")
        for claim in [*reproduction.claims, *reproduction.consistency]
    ]
    show_table(("claim", "linear plant", "six degrees of freedom"), claims)
    say(counts_in_words(reproduction.claims))
    say("G(z) is read as delay only; the other readings are flown in the report")
    say(f"report: {report}", wrap=False)
