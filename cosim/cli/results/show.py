"""hexjet show: one thing that can be flown, with its numbers, their units and what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from cosim.api.show import KINDS, kind_of, number_rows
from cosim.cli import opt
from cosim.cli.console import say, show_table
from cosim.cli.options import DONE, example
from cosim.cli.trust import display_only


class Show(opt.Output):
    """Options of ``hexjet show``."""

    name: str = opt.argument()
    kind = opt.choice("--kind", KINDS, "Where several kinds have the name.  [default: all that have it]")
    as_json = opt.JSON


@click.command(epilog=example("hexjet show hexjet-p220"))
@opt.takes(Show)
@display_only
def show(options: Show) -> int:
    """Show what NAME, of hexjet list, is: its numbers, their units and what they mean, from its files.

    To measure the thrust of an engine, its FMU is held at throttles until it stands still.  NAME may be the folder of a
    run: what hexjet fly printed; the folder of an aircraft, the file of a scenario or a study; the file of a design:
    what it was made for, what its proof came to, its margins and gains; or the mapping file of an engine: its
    parameters, and how well they are known.
    """
    from cosim.api.show import show as show_item

    shown = show_item(options.name, options.kind)

    def show_all() -> None:
        for item in shown.items:
            _print(item)

    options.answer(shown.to_list, show_all, nan=True)
    return DONE


def _print(item: Mapping[str, Any]) -> None:
    if item["kind"] == "runs":
        from cosim.cli.flight.fly import print_run
        from cosim.results.run import open_run

        print_run(open_run(item["name"]))
        return
    say(f"[bold]{item['name']}[/bold], {kind_of(item)}: {item['title']}", marked=True)
    if item["description"]:
        say(item["description"])
    show_table(("number", "value", "unit", "meaning"), number_rows(item), plain=True, pad_edge=False)
