"""The probability of a failure that is too rare to be counted, beside what a proof counts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cosim.base.errors import InputError
from cosim.campaign.proof.result import Part
from cosim.campaign.rare.estimate import Budget
from cosim.campaign.rare.folder import run_rare
from cosim.campaign.rare.simulation import Plan
from cosim.campaign.search.question import CASES
from cosim.campaign.study.study import Study
from cosim.campaign.workers.protocol import Workers

TARGET = 1e-6  # the smallest probability that the levels reach: that of hexjet rare by default
KEPT = ("probability", "low", "high", "method", "flights", "failures", "not_flown", "nearest", "shifts")  # of rare.json


def check_flights(flights: int) -> None:
    """Raise InputError for fewer flights than a simulation of rare failures needs."""
    try:
        Budget(TARGET, flights).check()
    except InputError as error:
        raise InputError(str(error).replace("--budget", "--rare", 1)) from error


def simulate_rare(study: Study, folder: Path, flights: int, workers: Workers, say: Callable[[str], None]) -> Part:
    """Return the probability of failure by subset simulation with so many flights; one that was stopped goes on.

    Seeds of noise and turbulence are part of what varies.  Raises FlightError if no more can be flown.
    """
    asked = study.changed(until=None, runs=flights)
    plan = Plan(Budget(TARGET, flights))
    saved = run_rare(asked, plan, folder, workers, True, lambda flown: say(f"rare: {flown}"))
    told = saved.to_json()
    cases = [
        {
            "run": f"{folder.parent.name}/{folder.name}/{CASES}/{case.name}",
            "distance": case.distance,
            "is_same": case.same,
        }
        for case in saved.cases
    ]
    return Part({key: told[key] for key in KEPT} | {"cases": cases, "is_same": saved.confirmed}, saved.result.sentence)
