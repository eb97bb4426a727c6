"""What is found of failures beside what a proof counts: the worst case, the most likely one, how rare they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cosim.base.errors import InputError
from cosim.studies import CASES, Progress, Study, Workers
from hexjet_prove.proof.result import Part
from hexjet_prove.rare.estimate import Budget
from hexjet_prove.rare.folder import run_rare
from hexjet_prove.rare.simulation import Plan
from hexjet_prove.search.minimise import need_optimiser
from hexjet_prove.search.worst_case import DEFAULT_WORST_REGION, LIKELY_REGION, WorstCase, WorstPlan, important
from hexjet_prove.search.worst_folder import SavedWorst, run_worst

LIKELY, WORST = "likely", "worst"  # searches, and their folders
NOT_SEARCHED = {  # sentence on a search that was not made
    LIKELY: "no search for the most likely failure was made",
    WORST: "no search for the worst case was made",
}
# The levels reach down to this probability, as those of hexjet search --rare do by default.
MIN_PROBABILITY = 1e-6
KEPT_KEYS = (  # keys of rare.json in a proof
    "probability", "low", "high", "method", "flights", "failures", "not_flown", "nearest", "shifts", "contradiction",
)  # fmt: skip


def search_failures(
    study: Study, folder: Path, budget: int, workers: Workers, say: Callable[[str], None]
) -> dict[str, Part]:
    """Search the most likely failure and the worst case with so many flights each; searches resume.

    The flights have the noise and turbulence of the scenario's own seed.  Where the package that searches is not
    installed a part says so.  Raises FlightError if no more can be flown.
    """
    try:
        need_optimiser()
    except InputError as error:
        return {name: Part(None, f"{text}: {error}") for name, text in NOT_SEARCHED.items()}
    searched = study.changed(until=None, runs=1)
    parts = {}
    for name in (LIKELY, WORST):
        within = LIKELY_REGION if name == LIKELY else DEFAULT_WORST_REGION
        plan = WorstPlan(name == LIKELY, within, (study.base().seed,), budget, study.seed)
        place = folder / name
        saved = run_worst(searched, plan, place, workers, True, _make_count_reporter(say, name))
        parts[name] = _make_part(saved, f"{folder.name}/{name}")
    return parts


def _make_count_reporter(say: Callable[[str], None], name: str) -> Progress:
    return lambda tally, done, of: say(f"{name}: {done}")


def _make_part(saved: SavedWorst, place: str) -> Part:
    (found,), (case,) = saved.result.cases, saved.cases
    run = f"{place}/{CASES}/{case.name}"
    result = {name: getattr(found, name) for name in ("fails", "margin", "distance", "flights", "reason")} | {
        "values": dict(found.values),
        "keys": {effect.name: effect.share for effect in important(found.effects)},
        "run": run,
        "is_same": case.same,
        "says": saved.result.lines()[0],
        "notes": saved.result.notes,
    }
    return Part(result, _describe_case(found, run, saved.result.plan))


def _describe_case(found: WorstCase, run: str, plan: WorstPlan) -> str:
    """Describe a found case in a clause of the proof's sentence."""
    moved = [effect for effect in important(found.effects) if effect.share >= 0.01][:3]
    keys = ", ".join(f"{effect.name} {100.0 * effect.share:.0f} %" for effect in moved)
    place = f"{found.distance:.2f} standard deviations from the middle ({keys or 'no key'})"
    effort = f"{found.flights:,} flights that searched"
    what = f"its {'most likely failure' if plan.likely else 'worst case'} within {plan.where}"
    if not found.fails:
        what += " found none; the nearest to one" if plan.likely else " found no failure; it"
        return f"{effort} for {what} is {run}, margin {found.margin:.3g}, {place}"
    return f"{what} in {effort} is {run}, margin {found.margin:.3g}, {place}"


def check_flights(flights: int) -> None:
    """Raise InputError for fewer flights than a simulation of rare failures needs."""
    try:
        Budget(MIN_PROBABILITY, flights).check()
    except InputError as error:
        raise InputError(str(error).replace("budget", "rare", 1)) from error


def simulate_rare(study: Study, folder: Path, flights: int, workers: Workers, say: Callable[[str], None]) -> Part:
    """Estimate the failure probability by subset simulation with so many flights; it resumes.

    Seeds of noise and turbulence are part of what varies.  Raises FlightError if no more can be flown.
    """
    asked = study.changed(until=None, runs=flights)
    plan = Plan(Budget(MIN_PROBABILITY, flights))
    saved = run_rare(asked, plan, folder, workers, True, _make_count_reporter(say, "rare"))
    told = saved.to_json()
    place = f"{folder.parent.name}/{folder.name}/{CASES}"
    cases = [{"run": f"{place}/{case.name}", "distance": case.distance, "is_same": case.same} for case in saved.cases]
    says = "; ".join(filter(None, (saved.result.sentence, saved.result.contradiction)))
    return Part({key: told[key] for key in KEPT_KEYS} | {"cases": cases, "is_same": saved.confirmed}, says)
