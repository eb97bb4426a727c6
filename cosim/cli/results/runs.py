"""hexjet list and report: what can be flown, and what was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from cosim.api.show import KINDS, catalogue
from cosim.base.errors import InputError
from cosim.cli import opt
from cosim.cli.console import say
from cosim.cli.options import DONE, example
from cosim.cli.trust import display_only


class List(opt.Output):
    """Options of ``hexjet list``."""

    kind: str | None = opt.argument(required=False, type=opt.Choice(KINDS), metavar="[KIND]")
    as_json = opt.JSON


@click.command("list", epilog=example("hexjet list engines"))
@opt.takes(List)
@display_only
def list_(options: List) -> int:
    """List what can be flown: scenarios, studies, engines, aircraft, controllers."""
    catalogues = {name: catalogue(name) for name in ([options.kind] if options.kind else KINDS)}
    options.answer(lambda: catalogues, lambda: print_catalogue(catalogues), nan=True)
    return DONE


class Report(opt.Record):
    """Options of ``hexjet report``."""

    folder: Path = opt.argument(type=click.Path(path_type=Path), metavar="DIR")
    shared_assets: bool = opt.SHARED_ASSETS


@click.command(epilog=example("hexjet report runs/roll-doublet-smith-001"))
@opt.takes(Report)
@display_only
def report(options: Report) -> int:
    """Write the report of the run or the campaign in DIR again.

    A run that was killed is finished first, with all that it recorded; a campaign may still be flown.  No code of the
    folder is run: metrics of your own are those that the flights left.
    """
    from cosim.campaign.folder import is_campaign
    from cosim.cli.flight.fly import print_run
    from cosim.cli.sweep import print_campaign
    from cosim.results.report.flight import write_report
    from cosim.results.run import REPORT, open_run

    folder = options.folder
    if is_campaign(folder):
        if options.shared_assets:
            raise InputError(f"--shared-assets: {folder} is a campaign, whose page has all in it; leave it out")
        from cosim.api.studies import SweepResult
        from cosim.campaign import open_campaign
        from cosim.campaign.analysis.page import write_campaign_report

        campaign = open_campaign(folder)
        print_campaign(SweepResult(campaign, write_campaign_report(campaign)))
        return DONE
    run = open_run(folder)
    write_report(run, folder / REPORT, options.shared_assets)
    print_run(run)
    return DONE


def print_catalogue(catalogues: dict[str, list[dict[str, Any]]]) -> None:
    """Print names and titles, kind by kind."""
    for kind, entries in catalogues.items():
        if len(catalogues) > 1:
            say(f"[bold]{kind}[/bold]", marked=True)
        width = max((len(entry["name"]) for entry in entries), default=0)
        for entry in entries:
            say(f"  {entry['name']:{width}}  {entry['title']}", wrap=False)
