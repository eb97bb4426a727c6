"""hexjet open: the folder of runs as a page."""

from __future__ import annotations

from pathlib import Path

import click

from cosim.cli.console import echo
from cosim.cli.options import DONE, example
from cosim.cli.trust import display_only


@click.command("open", epilog=example("hexjet open runs"))
@click.argument("folder", type=click.Path(path_type=Path), metavar="[DIR]", default=Path("runs"))
@click.option("--browser/--no-browser", default=True, show_default=True, help="Open the page, or only write it.")
@display_only
def open_(folder: Path, browser: bool) -> int:
    """List the runs in DIR on a page, DIR/index.html, to search and to sort by any metric, and open it.

    Campaigns, searches and logs of other flight controllers (.ulg, .bin, .bbl, .bfl, .cfusdlog) are listed too.
    """
    from cosim.shelf.index import write_index

    page = write_index(folder)
    echo(str(page))
    if browser:
        import webbrowser

        webbrowser.open(page.resolve().as_uri())
    return DONE
