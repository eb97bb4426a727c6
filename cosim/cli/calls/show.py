"""What ``hexjet show`` does beside ``cosim.show``: it lists names, and writes the page of a run or a campaign again."""

from __future__ import annotations

from pathlib import Path

from cosim.api.call import Result
from cosim.api.flights import FlightResult
from cosim.api.listing import KINDS, CatalogueResult, Kind
from cosim.api.show import show as show_named
from cosim.base.errors import InputError


def show(name: str | None = None, kind: Kind | None = None, *, page: bool = False) -> Result:
    """List what can be flown, or show what one of these or a run is: its numbers, their units and what they mean.

    To measure the thrust of an engine, its FMU is held at throttles until it stands still.

    Parameters
    ----------
    name : str or None
        ``scenarios``, ``studies``, ``engines``, ``aircraft`` or ``controllers`` are listed, by default all of them; a
        name of these or its file, or the folder of a run or a design, is shown.
    page : bool
        Write the page of a run or a campaign again.  A run that was killed is finished first, with all that it
        recorded; a campaign may still be flown.
    """
    if page:
        if name is None or kind:
            raise InputError("page: goes with the folder of a run or a campaign")
        return write_page(Path(name))
    if name is None:
        return CatalogueResult([kind] if kind else KINDS)
    return CatalogueResult([name]) if name in KINDS and not kind else show_named(name, kind)


def write_page(folder: Path) -> Result:
    """Write the page of a run or of a campaign again.  Raises InputError if there is neither."""
    from cosim.campaign.folder import is_campaign
    from cosim.results.report.flight import write_report
    from cosim.results.run import REPORT, open_run

    if is_campaign(folder):
        from cosim.api.studies import SweepResult
        from cosim.campaign import open_campaign
        from cosim.campaign.analysis.page import write_campaign_report

        campaign = open_campaign(folder)
        return SweepResult(campaign, write_campaign_report(campaign))
    run = open_run(folder)
    write_report(run, folder / REPORT)
    return FlightResult(run)
