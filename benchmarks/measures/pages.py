"""What pages weigh, how long that of a flight takes to write, and how fast they are in a browser."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.machine import load
from benchmarks.measures.browser import Look, PageTimes, looking
from benchmarks.measures.campaign import make_study
from benchmarks.timing import Spread
from cosim import FlightError, Scenario, fly
from cosim.results.report.flight import write_report
from cosim.results.run import LOG

FLIGHT = "roll-doublet"  # noisy sensors and all; after its script it hovers
MB = 1e-6


@dataclass(frozen=True)
class PagesPlan:
    """The pages that are measured.

    Those of flights of so many ``seconds``, and of a campaign of so many ``flights``, each a second long, which does
    not change its page; each page is scrolled and replayed for ``look_s``.
    """

    seconds: tuple[int, ...] = (20,)
    flights: int = 20
    look_s: float = 1.0


@dataclass(frozen=True)
class Page:
    """The size of one page and the time that it takes.

    Megabytes with all in it and beside shared assets, and the log's; seconds to write it, and the same by those that
    the steps of the flight took; what a browser makes of it, where there is one.
    """

    whole_mb: float
    shared_mb: float
    log_mb: float
    write_s: Spread
    by_flight: Spread
    seen: PageTimes | None


@dataclass(frozen=True)
class CampaignPage:
    """The page of a campaign."""

    flights: int
    mb: float
    seen: PageTimes | None


@dataclass(frozen=True)
class Pages:
    """Pages by the seconds flown, and that of a campaign.

    ``missing``: why no browser has looked at them; ``browser``: which, and what it draws the replay with.
    """

    flight: str
    by_length: dict[int, Page]
    campaign: CampaignPage
    browser: str
    missing: str | None


def measure_pages(plan: PagesPlan, rounds: int, folder: Path, on_round: Callable[[], object]) -> Pages:
    """Fly so long, recorded in full, and write the page of each and look at it several times.  Raises FlightError."""
    before = load()
    with looking() as look:
        browser = look if isinstance(look, Look) else None
        by_length = {
            length: _page(length, rounds, folder / f"{length}", browser, plan.look_s, on_round)
            for length in plan.seconds
        }
        campaign = _campaign(plan.flights, rounds, folder / "campaign", browser, plan.look_s)
        on_round()
    if browser is None:
        return Pages(FLIGHT, by_length, campaign, "", str(look))
    browser_text = f"Chromium {browser.version}, the replay by {browser.renderer or 'nothing'}"
    if loads := [f"{load_text:.1f}" for load_text in (before, load()) if load_text is not None]:
        browser_text += f"; load average {' before, '.join(loads)} after"
    return Pages(FLIGHT, by_length, campaign, browser_text, None)


def _page(
    seconds: int, rounds: int, folder: Path, browser: Look | None, look_s: float, on_round: Callable[[], object]
) -> Page:
    run = fly(Scenario.load(FLIGHT).replace(duration_s=float(seconds), expect=[]), folder, report=False)
    if run.outcome != "completed" or not run.summary.wall_s:
        raise FlightError(f"the flight of {seconds} s ended early: {run.reason}")
    single, shared = folder / "whole.html", folder / "shared.html"
    write_report(run, shared, shared_assets=True)
    durations = []
    for _ in range(rounds):
        begin = time.perf_counter()
        write_report(run, single)
        durations.append(time.perf_counter() - begin)
        if browser:
            browser.at(single, look_s)
        on_round()
    flight_s = run.summary.wall_s
    return Page(
        whole_mb=MB * single.stat().st_size,
        shared_mb=MB * shared.stat().st_size,
        log_mb=MB * (folder / LOG).stat().st_size,
        write_s=Spread.of(durations),
        by_flight=Spread.of([duration / flight_s for duration in durations]),
        seen=browser.seen(single) if browser else None,
    )


def _campaign(flights: int, rounds: int, folder: Path, browser: Look | None, look_s: float) -> CampaignPage:
    from cosim.campaign.analysis.page import write_campaign_report
    from cosim.campaign.run import run_campaign

    page = write_campaign_report(run_campaign(make_study(flights, 1.0), folder))
    if browser:
        for _ in range(rounds):
            browser.at(page, look_s)
    return CampaignPage(flights, MB * page.stat().st_size, browser.seen(page) if browser else None)
