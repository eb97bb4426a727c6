"""hexjet open: the folder of runs as a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from cosim.base.errors import InputError
from cosim.cli.options import DONE, example
from cosim.cli.trust import display_only

PORT = 8766


@click.command("open", epilog=example("hexjet open runs --browser"))
@click.argument("folder", type=click.Path(path_type=Path), metavar="[DIR]", default=Path("runs"))
@click.option("--port", type=click.IntRange(0, 65535), default=PORT, show_default=True, help="0: any that is free.")
@click.option("--browser", is_flag=True, help="Open it in the browser, too.")
@display_only
def open_(folder: Path, port: int, browser: bool) -> int:
    """Look through the runs in DIR: search, sort by any metric, tag, compare, delete.

    Logs of other flight controllers that lie there (.ulg, .bin, .bbl, .bfl, .cfusdlog) are listed too, to be compared.
    A page for this machine alone, and there for who has the address that is printed, until Ctrl-C.  What is in the
    folder is read once and remembered in DIR/.index.json; tags are kept with the runs.  Nothing is deleted without
    asking.
    """
    from cosim.shelf.index import Shelf
    from cosim.shelf.server import ShelfServer

    server = ShelfServer(Shelf(folder), port, lambda folders: _compare(folders, folder))
    server.open()
    click.echo(f"{folder}: {server.url} (Ctrl-C ends it; nothing is lost)", err=True)
    if browser:
        import webbrowser

        webbrowser.open(_write_redirect(server.url).as_uri())
    try:
        server.run()
    except KeyboardInterrupt:
        server.close()
    return DONE


def _write_redirect(url: str) -> Path:
    """Write a page that redirects there: every account of the machine can read a browser's command line."""
    from html import escape

    from cosim.base.storage.scratch import scratch

    page = scratch() / "open.html"  # in a folder private to this user
    page.write_text(f'<!doctype html><meta http-equiv="refresh" content="0;url={escape(url)}">', encoding="utf-8")
    return page


def _compare(folders: Sequence[Path], runs: Path) -> Path:
    """Compare these flights in a new folder of ``runs``.  Raises InputError where some are no flights."""
    from cosim.api.compare import write_page
    from cosim.flight import new_folder

    if not 2 <= len(folders) <= 8:
        raise InputError(f"compare: {len(folders)} chosen; two to eight flights can be compared")
    return write_page([str(path) for path in folders], new_folder(runs, "comparison"))
