"""A proof from a study to a folder: the flights up to where the claim is decided, then what the worst of them are.

The campaign is in ``campaign/``, the searches in ``searches/``, the flights that were flown again in ``worst/``, the
result in ``proof.json`` and ``proof.html``.  A proof that was stopped goes on with the flights that it has; what
follows them is done again.
"""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.errors import FlightError, InputError
from cosim.base.signals import AXES
from cosim.base.storage.files import write_whole
from cosim.base.storage.toml import Model, read_toml, toml_text, validate
from cosim.engine import find_source
from cosim.results.summary import versions
from cosim.spec.controller_name import short_name
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import aircraft_names
from cosim.studies import (
    ASKED,
    STUDY,
    SUCCESS,
    Campaign,
    ClaimResult,
    FlightTable,
    Progress,
    Study,
    Tally,
    Workers,
    design_warnings,
    eccentricity,
    fly_again,
    is_campaign,
    judge_claim,
    key_rows,
    nominal_model_notes,
    open_workers,
    rank_keys,
    read_flight_table,
    row_margin,
    run_campaign,
    study_code,
    with_values,
    write_campaign_report,
)
from hexjet_prove.proof.credibility import CHOSEN, Evidence, list_evidence
from hexjet_prove.proof.failure import LIKELY, NOT_SEARCHED, search_failures, simulate_rare
from hexjet_prove.proof.failure import WORST as WORST_CASE
from hexjet_prove.proof.limit import flown_limits
from hexjet_prove.proof.page import write_page
from hexjet_prove.proof.requirements import proven_requirements
from hexjet_prove.proof.result import LEAST, NEAREST, Part, Proof, WorstFlight
from hexjet_prove.proof.scope import kinds_not_varied, not_covered

CAMPAIGN, SEARCHES, WORST, RESULT, REPORT = "campaign", "searches", "worst", "proof.json", "proof.html"
RARE_FOLDER = "rare"  # folder of rare failures
NO_RARE_METHOD = "no method for rare failures was used: what flights that succeed can show is all that is shown"
PACKAGE = "hexjet-cosim"  # package whose version is recorded

Say = Callable[[str], None]


class Request(Model):
    """Options of a proof besides its flights, as its folder records them."""

    limit: bool = True  # whether to compute performance limits
    search: int = 0  # flights for each search; 0: none
    rare: int = 0  # flights for rare failures; 0: none
    comparisons: Sequence[dict[str, Any]] = ()  # contents of replay.json files


def resolve_request(folder: Path, given: dict[str, Any], resume: bool) -> Request:
    """Return what is ``given``, beside that what the folder of a resumed proof records, and the defaults.

    Raises InputError for another number of flights than those of a search that has begun there.
    """
    path = folder / ASKED
    asked = read_toml(path) if resume and path.is_file() else {}
    for name, place in (("search", LIKELY), ("rare", RARE_FOLDER)):
        if given.get(name, asked.get(name)) != asked.get(name) and asked and (folder / SEARCHES / place).is_dir():
            raise InputError(f"{folder}: {name} has begun with {asked[name]} flights; leave out {name}")
    return validate(Request, {"search": 500} | asked | given, str(path))


def fly_study(
    study: Study | None,
    out: Path,
    request: Request,
    workers: Workers | int | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Campaign:
    """Fly a study of :func:`hexjet_prove.proof.source.proof_study` until its claim is decided.

    ``study`` None: that of the folder ``out``, to be resumed.  Raises InputError if the study or the folder is not
    usable, and nothing is overwritten then; FlightError if no more can be flown or written.
    """
    folder = out / CAMPAIGN
    if study is None and not is_campaign(folder):
        raise InputError(f"{out}: holds no proof; resume goes on with a proof's folder")
    if not resume and out.is_dir() and any(out.iterdir()):
        is_proof = is_campaign(folder)
        what = "already holds a proof; resume goes on with it" if is_proof else "is not empty; choose another folder"
        raise InputError(f"{out}: {what}")
    pending = [toml_text(request.model_dump())]

    def report(tally: Tally, done: int, of: int) -> None:  # first when the campaign has begun
        if pending:
            write_whole(out / ASKED, pending.pop(), FlightError)
        if progress is not None:
            progress(tally, done, of)

    return run_campaign(study, folder, workers, resume, report)


def conclude(
    campaign: Campaign,
    out: Path,
    request: Request,
    workers: Workers | int | None = None,
    say: Say = lambda text: None,
) -> Proof:
    """Evaluate the flights of :func:`fly_study` and write the proof; ``say`` receives the progress.

    ``workers`` fly what is searched for.

    Raises InputError for a campaign without a claim, FlightError if a file cannot be written.
    """
    claim = judge_claim(campaign)
    if claim is None:
        raise InputError(f"{campaign.folder}: its study has no claim")
    searched = _search(campaign.study, out, request, workers, say)
    proof = _evaluate_flights(out, campaign, claim, request, searched, say)
    say("pages")
    write_campaign_report(campaign)
    write_whole(out / RESULT, json.dumps(proof.to_json(), indent=1, allow_nan=False) + "\n", FlightError)
    write_page(proof, out / REPORT)
    return proof


def _search(study: Study, out: Path, request: Request, workers: Workers | int | None, say: Say) -> Mapping[str, Part]:
    """Run the requested searches: most likely failure, worst case, and failure probability."""
    parts = {name: Part(None, text) for name, text in NOT_SEARCHED.items()} | {RARE_FOLDER: Part(None, NO_RARE_METHOD)}
    with open_workers(workers) as flying:
        if request.search:
            parts |= search_failures(study, out / SEARCHES, request.search, flying, say)
        if request.rare:
            parts[RARE_FOLDER] = simulate_rare(study, out / SEARCHES / RARE_FOLDER, request.rare, flying, say)
    return parts


def _evaluate_flights(
    out: Path, campaign: Campaign, claim: ClaimResult, request: Request, searched: Mapping[str, Part], say: Say
) -> Proof:
    """Return the proof from the flights and searches; fly the worst flights again."""
    study, table = campaign.study, read_flight_table(campaign)
    scenario = with_values(study.base(), {"controller": study.tried[0]})
    worst = list(_fly_worst(campaign, table, out, say))
    limits = flown_limits(scenario, say) if request.limit else dict.fromkeys(AXES, "it was left out (limit)")
    evidence = _collect_evidence(study, table, scenario, worst, request, searched)
    return Proof(
        folder=out,
        study={
            "name": study.name, "title": study.title, "scenario": scenario.name, "aircraft": scenario.aircraft_name,
            "engine": evidence.engine, "controller": short_name(study.controller_names[0]), "seed": study.seed,
            "most_flights": study.draws,
        },
        claim=claim,
        referee=campaign.referee,
        requirements=proven_requirements(campaign),
        uncertainty=key_rows(study, table),
        over=_describe_draws(evidence),
        worst=worst,
        likely=searched[LIKELY],
        worst_case=searched[WORST_CASE],
        rare=searched[RARE_FOLDER],
        limits=limits,
        axis=_commanded_axis(scenario),
        not_varied=evidence.not_varied,
        not_covered=not_covered(
            study, [part.says for part in searched.values() if part.result is None], table.not_flown
        ),
        credibility=list_evidence(evidence),
        repeat=_describe_repetition(out, campaign, request),
    )  # fmt: skip


def _fly_worst(campaign: Campaign, table: FlightTable, out: Path, say: Say) -> Iterator[WorstFlight]:
    """Fly the flights of smallest margins again, and the failure nearest to the middle of the draws."""
    shutil.rmtree(out / WORST, ignore_errors=True)  # left by an interrupted proof
    rows = [campaign.row(int(number)) for number in table.flight]
    margins = np.array([row_margin(row, campaign.study) for row in rows])
    failed = np.flatnonzero(~table.success)
    chosen = {int(index): LEAST for index in np.argsort(margins, kind="stable")[:3]}
    if failed.size:
        nearest = int(failed[np.argmin(eccentricity(table)[failed])])
        why = f"{LEAST}; {NEAREST}" if nearest in chosen else NEAREST
        chosen = {index: LEAST for index in chosen if index != nearest} | {nearest: why}
    for index, why in chosen.items():
        number, row = int(table.flight[index]), rows[index]
        say(f"flight {number} again")
        run = f"{WORST}/flight-{number:06d}"
        try:
            again = fly_again(campaign, number, out / run)
            is_same, same = again.same, again.sameness
        except (FlightError, InputError):  # it failed in the same way the first time
            run, is_same, same = "", row["outcome"] == "failed", "failed again"
        values = {name: row[name] for name in campaign.study.drawn}
        reason = str(row["reason"])
        yield WorstFlight(number, why, str(row["outcome"]), reason, float(margins[index]), values, run, is_same, same)


def _collect_evidence(
    study: Study,
    table: FlightTable,
    scenario: Scenario,
    worst: Sequence[WorstFlight],
    request: Request,
    searched: Mapping[str, Part],
) -> Evidence:
    """Return the evidence on the model and on this proof."""
    source = find_source(scenario.engine, scenario.folder)
    uncertainty = source.uncertainty
    again = [*(one.is_same for one in worst), *(part.result["is_same"] for part in searched.values() if part.result)]
    rankings = [rank_keys(table, 0, name) for name in (SUCCESS, *(metric.name for metric in table.metrics))]
    return Evidence(
        aircraft=scenario.aircraft_name,
        engine=scenario.engine if source.engine else Path(scenario.engine).stem,
        is_shipped=scenario.aircraft in aircraft_names() and source.engine is not None,
        version=versions().get(PACKAGE, ""),
        own_code=[code.path.name for code in study_code(study)],
        uncertainty_source=None if uncertainty is None else uncertainty.source,
        is_engine_drawn=any(vary.uncertainty for vary in study.vary),
        varied=len(table.keys),
        not_varied=kinds_not_varied(study),
        ranked=len({effect.key for ranking in rankings if ranking for effect in ranking.effects}),
        searched=searched[WORST_CASE].result is not None,
        warnings=[*design_warnings(study), *nominal_model_notes(scenario)],
        replayed=len(again),
        replayed_same=sum(again),
        comparisons=request.comparisons,
    )


def _describe_draws(evidence: Evidence) -> str:
    """Describe the population that the probability refers to, and its origin."""
    if not evidence.is_engine_drawn:
        return f"the {evidence.varied} numbers that are drawn here, as the study states them"
    source = evidence.uncertainty_source or "of no stated source"
    known = "" if source.startswith(CHOSEN) or not evidence.uncertainty_source else " identified"
    return f"this engine's{known} uncertainty ({source})"


def _commanded_axis(scenario: Scenario) -> str:
    """Return the axis that the scenario commands first, by default roll."""
    signals = [str(getattr(command, "signal", "")).partition("_")[0] for command in scenario.command]
    return next((signal for signal in signals if signal in AXES), AXES[0])


def _describe_repetition(out: Path, campaign: Campaign, request: Request) -> dict[str, Any]:
    """Return the command that repeats the proof, and hashes by which the same result is recognised."""
    study, digest = campaign.study, sha256()
    columns = [campaign.columns[name] for name in ("flight", "outcome", "success", "log_sha256")]
    for row in zip(*columns, strict=True):
        digest.update(f"{row}\n".encode())
    file = shlex.quote((out / CAMPAIGN / STUDY).as_posix())
    beside = f" --search {request.search}{f' --rare {request.rare}' if request.rare else ''}"
    beside += ("" if request.limit else " --no-limit") + (" --batch" if study.batch else "")
    command = f"hexjet prove {file} --claim {study.until} --budget {study.draws}{beside} --out AGAIN"
    return {"command": command, "rows_sha256": digest.hexdigest(), "versions": versions()}
