"""hexjet paper: the paper reproduced."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.cli.console import cell, part_progress, terminal
from cosim.cli.options import DONE, example
from cosim.cli.outputs import Out

if TYPE_CHECKING:
    from hexjet_paper.report.result import Reproduction


@click.command(epilog=example("hexjet paper --out runs/paper"))
@click.option(
    "--out",
    type=Out(),
    metavar="DIR",
    default=Path("runs/paper"),
    show_default=True,
    help="Where the result goes; parts that are there already are taken up.",
)
@click.option("--workers", type=click.IntRange(1, 64), default=2, show_default=True, help="Processes.")
@click.option(
    "pages",
    "--page",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.md",
    multiple=True,
    help="Write counts and tables between the page's marks.",
)
@click.option("as_json", "--json", is_flag=True, help="Print the comparison as one JSON object and nothing else.")
def paper(out: Path, workers: int, pages: tuple[Path, ...], as_json: bool) -> int:
    """Reproduce the paper: every experiment on the linear plant and in six degrees of freedom, number by number.

    Leaves comparison.csv, comparison.json and report.html in DIR.  An interrupted call goes on where it ended.
    """
    from hexjet_paper.report.pages import check_page, write_page
    from hexjet_paper.report.result import DATA, REPORT
    from hexjet_paper.reproduce import reproduce

    for page in pages:
        check_page(page)
    with part_progress("paper", quiet=as_json) as say:
        reproduction = reproduce(out, say, workers)
    for page in pages:
        write_page(page, reproduction)
    if as_json:
        click.echo(json.dumps(json.loads((out / DATA).read_text(encoding="utf-8")), allow_nan=False))
    else:
        print_paper(reproduction, out / REPORT)
    return DONE


def print_paper(reproduction: Reproduction, report: Path) -> None:
    """Claims and numbers of the paper beside ours, how many claims follow, and where the report is."""
    from rich import box
    from rich.table import Table

    from hexjet_paper.report.page import compared, counts_in_words

    console = terminal()
    table = Table(box=box.SIMPLE_HEAD)
    for title in ("quantity", "unit", "paper", "linear", "", "flight", "", "origin"):
        table.add_column(title, justify="left" if title in ("quantity", "unit", "origin") else "right")
    for row in compared(reproduction.rows):
        name = f"{row.quantity} ({row.note})" if ".state" in row.key else row.quantity
        linear = cell(row.linear, "{:.4g}"), cell(row.linear_deviation, "{:+.1f} %")
        flight = cell(row.flight, "{:.4g}"), cell(row.flight_deviation, "{:+.1f} %")
        table.add_row(name, row.unit, f"{row.paper:.4g}", *linear, *flight, row.origin)
    console.print(table)
    table = Table(box=box.SIMPLE_HEAD)
    for title in ("claim", "linear plant", "six degrees of freedom"):
        table.add_column(title)
    for claim in [*reproduction.claims, *reproduction.consistency]:
        table.add_row(claim.claim, claim.linear.verdict, claim.flight.verdict if claim.flight else "-")
    console.print(table)
    console.print(counts_in_words(reproduction.claims), highlight=False)
    console.print("G(z) is read as delay only; the other readings are flown in the report", highlight=False)
    console.print(f"report: {report}", highlight=False, soft_wrap=True)
