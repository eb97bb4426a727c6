"""Where the flights of a campaign are flown: what all who follow the protocol agree on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cosim.base import protocols
from cosim.campaign.workers.flight_row import Row

if TYPE_CHECKING:
    from cosim.campaign.study.plan import Flight  # noqa: F401 (named in the alias below)
    from cosim.campaign.study.study import Study

Workers = protocols.Workers["Study", "Flight", Row]

LOSSES = 3  # processes that a flight may take with it before it is given up
MIN_LIMIT_S = 60.0  # chosen by us: of wall time; loading an engine that starts a run time of its own takes 20
LIMIT_FACTOR = 10.0  # chosen by us: of simulated time; a flight takes a hundredth of it


def time_limit(study: Study) -> float:
    """Return how long a flight of ``study`` may take by default, s of wall time."""
    before = 0.0 if study.autopilot is None else study.autopilot.before_s
    return max(MIN_LIMIT_S, LIMIT_FACTOR * (study.base().duration_s + before))


def update_mean(mean: float | None, seconds: float) -> float:
    """Return the running mean of flights' durations [s] after one more; None: there was none before."""
    return seconds if mean is None else mean + 0.1 * (seconds - mean)


def describe_loss(end: str) -> str:
    """Return the reason of a flight that was given up; ``end`` says how its last process ended."""
    return f"the process was lost in this flight {LOSSES} times; the last {end}"


def describe_timeout(limit: float) -> str:
    """Return the reason of a flight that took longer than ``limit`` seconds."""
    return f"not finished within the time limit of {limit:g} s"
