"""A claim about a study or a design, shown or refuted: what ``hexjet prove`` calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.api.call import Limits, Progress, Result, Table, WholeLine, check_types
from cosim.api.studies import report_tally, study_settings
from cosim.base.errors import InputError
from cosim.base.storage.settings import as_settings

if TYPE_CHECKING:
    from cosim.studies import Decision
    from hexjet_prove.proof.result import Proof


class ProofResult(Result):
    """Proof that a vehicle meets its requirements, or does not, with the evidence that a review needs.

    Attributes
    ----------
    proof : Proof
        Everything.
    """

    def __init__(self, proof: Proof) -> None:
        self.proof = proof
        self.files = {"report": proof.folder / "proof.html", "json": proof.folder / "proof.json"}

    @property
    def decision(self) -> Decision:
        """Whether the claim is ``shown``, ``refuted`` or ``open``."""
        return self.proof.decision

    def to_dict(self) -> dict[str, Any]:
        return self.proof.to_json()

    def lines(self) -> list[str]:
        """Return the sentence, its requirements, what belongs to it, and the command that repeats it."""
        from cosim.studies import with_referee

        proof = self.proof
        broken = (f"{one.label} {one.says.partition(';')[0]}: {one.broken} of {one.told}" for one in proof.requirements)
        return [
            *with_referee([proof.sentence], proof.referee),
            f"requirements, and by how many flights broken: {'; '.join(broken)}",
            *(f"{about}: {text}" for about, text in proof.facts.items()),
            f"not covered: {len(proof.not_covered)} points, which the page lists",
            WholeLine(f"again: {proof.repeat['command']}"),
        ]

    def tables(self) -> list[Table]:
        """Return the requirements, what is not covered, and what is on record of the model."""
        proof, what = self.proof, "On record by NASA-STD-7009B; no level of credibility is computed"
        return [
            Table("", ("", "requirement", "broken", "smallest margin"), list(proof.requirement_rows())),
            Table("", ("not covered",), [(text,) for text in proof.not_covered]),
            Table(what, ("factor", "on record"), [(one.name, one.evidence) for one in proof.credibility]),
        ]


@check_types(budget=Limits(1), search=Limits(0), rare=Limits(0))
def prove(
    name: str | Path,
    claim: str | None = None,
    *,
    budget: int | None = None,
    controllers: Sequence[str] = (),
    success: Sequence[str] = (),
    aircraft: str | Path | None = None,
    engine: str | Path | None = None,
    nominal_engine: bool = False,
    batch: bool = False,
    settings: Sequence[str] | Mapping[str, object] = (),
    seed: int | None = None,
    search: int | None = None,
    rare: int | None = None,
    limit: bool | None = None,
    replays: Sequence[str | Path] = (),
    workers: int | None = None,
    cluster: str | None = None,
    time_limit_s: float | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> ProofResult:
    """Show or refute that a vehicle meets its requirements, with the evidence that a review needs.

    Flies until the claim is decided, flies the worst again, compares the controller with the best linear one, and says
    what is not covered and what is on record of the model.

    Parameters
    ----------
    name : str or Path
        A study, a scenario whose engine states its uncertainty, the controller file of a design or its folder; or the
        folder of a proof to be resumed.
    claim : str or None
        What is to be shown: a probability at a confidence, as ``99.9%@95%``; None: the study's.
    budget : int or None
        Flights at most; None: ten times what the claim needs at least.
    controllers : sequence of str
        The controller that is meant, of a study with several.
    success : sequence of str
        What a flight must keep beside its limits: ``METRIC<=X``, or a formula as ``always(abs(roll_deg) < 30)``.
    aircraft : str or Path or None
        In place of the scenario's, with the engine that it is made for.
    engine : str or Path or None
        In place of the scenario's.
    nominal_engine : bool
        Fly the engine as it is stated, not drawn by its uncertainty.
    batch : bool
        Fly on arrays, many flights at once, and some of them again by JSBSim.
    settings : sequence of str or mapping
        Written over the scenario's.
    seed : int or None
        Seed of the draws.
    search : int or None
        Flights for each search, of the most likely failure and of the worst case, which needs cmaes;
        0: none; None: 500, or as it was when resumed.
    rare : int or None
        Flights for the probability of failures too rare to count; None: none, or as it was when resumed.
    limit : bool or None
        Compare the controller with the best that any linear one could do, which takes a minute and
        Clarabel; None: yes, or as it was when resumed.
    replays : sequence of str or Path
        What ``replay`` left of recorded flights of this vehicle: ``replay.json``, or its folder.
    workers : int or None
        Processes; None: one a processor.
    cluster : str or None
        The address of a Dask scheduler, or ``local``.
    time_limit_s : float or None
        Time of the clock for a flight [s].
    out : str or Path or None
        The folder; None: a new one in ``runs/``.
    resume : bool
        Go on with what the folder holds.
    progress : Progress or None
        Hears notes and how far it is.

    Returns
    -------
    ProofResult
        The sentence, the requirements and what is on record.

    Raises
    ------
    InputError
        If study, claim or folder is not usable; nothing is overwritten then.
    FlightError
        If no more can be flown or written.
    """
    from cosim.flight import new_folder
    from cosim.studies import choose_workers, is_campaign, refuse_changes
    from hexjet_design.loop.programme import need_solver
    from hexjet_prove.proof.credibility import read_comparison
    from hexjet_prove.proof.failure import check_flights
    from hexjet_prove.proof.prove import CAMPAIGN, conclude, fly_study, resolve_request
    from hexjet_prove.proof.source import proof_study
    from hexjet_prove.search.minimise import need_optimiser

    hears = progress or Progress()
    is_begun = is_campaign(Path(name) / CAMPAIGN)
    if is_begun and not resume:
        raise InputError(f"{name}: already holds a proof; resume goes on with it")
    if is_begun:
        refuse_changes(
            f"{name}: is a proof", claim=claim, budget=budget, controllers=controllers, success=success,
            aircraft=aircraft, engine=engine, nominal_engine=nominal_engine, batch=batch,
            settings=as_settings(settings), seed=seed, out=out,
        )  # fmt: skip
    if rare:
        check_flights(rare)
    if search:
        need_optimiser()
    if limit:
        need_solver()
    asked = {"search": search, "rare": rare, "limit": limit, "comparisons": [*map(read_comparison, map(Path, replays))]}
    given = {name: value for name, value in asked.items() if value not in (None, [])}
    if is_begun:
        study, folder = None, Path(name)
    else:
        if resume and out is None:
            raise InputError("resume: give the folder of the proof as its name")
        study = proof_study(
            str(name), claim, budget, settings=study_settings(settings, aircraft, engine, (), None),
            controllers=controllers, success=success, seed=seed, nominal_engine=nominal_engine, batch=batch,
        )  # fmt: skip
        folder = Path(out) if out is not None else new_folder(Path("runs"), f"proof-{study.name}")
    request = resolve_request(folder, given, resume)
    hears.begin(folder)
    with choose_workers(workers, cluster, time_limit_s) as flying:
        for text in study.notes() if study is not None else ():
            hears.note(text)
        campaign = fly_study(study, folder, request, flying, resume, report_tally(hears))
        return ProofResult(conclude(campaign, folder, request, flying, lambda text: hears.update(text, 0, 0)))
