"""Searches among flights, and failures too rare to count: what ``hexjet search`` calls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.api.call import Limits, Progress, Result, Table, check_types
from cosim.api.studies import report_tally, study_settings
from cosim.base.errors import InputError
from cosim.base.storage.settings import as_texts

if TYPE_CHECKING:
    from cosim.studies import Workers
    from hexjet_prove.rare.folder import SavedRare
    from hexjet_prove.search.folder import SavedSearch
    from hexjet_prove.search.worst_folder import SavedWorst


class SearchResult(Result):
    """Result of a search: where each controller fails, and the flights that show it.

    Attributes
    ----------
    searched : SavedSearch or SavedWorst
        Everything; the second of a search of the worst case or of the most likely failure.
    """

    def __init__(self, searched: SavedSearch | SavedWorst) -> None:
        self.searched = searched
        self.files = {"report": searched.folder / "search.html", "json": searched.folder / "search.json"}

    @property
    def confirmed(self) -> bool:
        """Whether every flight that shows the result ended alike when it was flown again."""
        return self.searched.confirmed

    def to_dict(self) -> dict[str, Any]:
        return self.searched.to_json()

    def lines(self) -> list[str]:
        """Return the result, the flights flown, what counts as a failure, and the flights that show the result."""
        from cosim.studies import with_referee
        from hexjet_prove.search.page import answers, describe_resolution, together_lines
        from hexjet_prove.search.worst_case import WorstSearch

        result = self.searched.result
        base = result.study.base()
        flown = f"{base.name}: {base.aircraft_name}, engine {base.engine}; {result.flights} flights"
        if isinstance(result, WorstSearch):
            return [*with_referee(result.lines(), self.searched.referee), flown, *result.notes, *self.searched.lines()]
        notes = [result.engine_note] if result.engine_note else []
        return [
            *with_referee(answers(result), self.searched.referee),
            flown,
            result.criterion,
            *notes,
            *together_lines(result),
            *map(describe_resolution, result.plan.spans),
            *self.searched.lines(),
        ]

    def tables(self) -> list[Table]:
        """Return a table of the edges of failure, or of the keys of the worst or likeliest case."""
        from hexjet_prove.search.page import table
        from hexjet_prove.search.worst_case import WorstSearch
        from hexjet_prove.search.worst_page import rows, titles

        result = self.searched.result
        if isinstance(result, WorstSearch):
            return [Table("", titles(result), rows(result))]
        heads, lines = table(result)
        return [Table("", heads, list(lines))]


class RareResult(Result):
    """Probability of a failure that is too rare to be counted, and the most likely failures.

    Attributes
    ----------
    simulated : SavedRare
        Everything.
    """

    def __init__(self, simulated: SavedRare) -> None:
        self.simulated = simulated
        self.files = {"report": simulated.folder / "rare.html", "json": simulated.folder / "rare.json"}

    @property
    def confirmed(self) -> bool:
        """Whether every failure ended alike when it was flown again."""
        return self.simulated.confirmed

    def to_dict(self) -> dict[str, Any]:
        return self.simulated.to_json()

    def lines(self) -> list[str]:
        """Return the probability, the method, the requirements that decide, and the most likely failures."""
        from cosim.studies import with_referee
        from hexjet_prove.rare.page import LIMITS_NOTE, describe_deciders, describe_result

        result = self.simulated.result
        deciders = [describe_deciders(result)] if result.deciders else []
        judged = with_referee(describe_result(result), self.simulated.referee)
        return [*judged, *deciders, *self.simulated.lines(), LIMITS_NOTE]

    def tables(self) -> list[Table]:
        """Return a table of where the failures lie among the drawn values."""
        from hexjet_prove.rare.page import shift_rows

        result = self.simulated.result
        titles = ("key", "mean [standard deviations]", "spread")
        return [Table("", titles, shift_rows(result))] if result.failures else []


@check_types(seeds=Limits(1, 10_000), share=Limits(0.0, 1.0), budget=Limits(1))
def search(
    name: str | Path,
    *,
    vary: Sequence[str] | Mapping[str, object] = (),
    worst: bool = False,
    likely: bool = False,
    within: str | float | None = None,
    over: str | None = None,
    controllers: Sequence[str] = (),
    tolerance: Sequence[str] = (),
    seeds: int = 1,
    share: float = 0.0,
    success: Sequence[str] = (),
    budget: int = 1000,
    aircraft: str | Path | None = None,
    engine: str | Path | None = None,
    nominal_engine: bool = False,
    batch: bool = False,
    settings: Sequence[str] | Mapping[str, object] = (),
    metrics: Sequence[str] = (),
    wind: str | None = None,
    seed: int | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    time_limit_s: float | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> SearchResult:
    """Find the smallest change that breaks a controller, the worst case of a study, or its most likely failure.

    >>> search("hover", vary=["vehicle.mass_kg=5:9"], budget=20, settings={"duration_s": 0.2}, workers=1).verdict
    'smith: vehicle.mass_kg holds from 5.525 to the end, 9 kg.'

    Parameters
    ----------
    name : str or Path
        A scenario; with ``worst`` and ``likely`` a study or the controller file of a design, too.
    vary : sequence of str or mapping
        What is searched, ``KEY=LO:HI``, each key alone, scanned in N points with ``KEY=LO:HI:N``; ``*=``, ``+=`` and
        ``log(LO:HI)`` as ``sweep`` has them.  With ``worst`` and ``likely`` all keys together, whatever they draw.
    worst : bool
        Search the flight of least margin over all keys at once, of a design in its tolerances.
    likely : bool
        Search the failure that is nearest to the middle of what is drawn.
    within : str or float or None
        With ``worst`` or ``likely``: at most so many standard deviations from the middle, or anywhere in the
        ``ranges``; None: 3, 6 with ``likely``, or the ranges of a design's tolerances.
    over : str or None
        A curve: a search at each of these values of a second key, ``KEY=LO:HI:N``.
    controllers : sequence of str
        Each is searched.
    tolerance : sequence of str
        How near the edge is to be known, ``X`` or ``KEY=X``, else a 200th of the range.
    seeds : int
        Flights of every point.
    share : float
        Share of a point's flights that have to break before it does; 0: any of them.
    success : sequence of str
        What a completed flight must keep too: ``METRIC<=X``, or a formula.
    budget : int
        With ``worst`` and ``likely``: flights of each controller.
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
    metrics : sequence of str
        Metrics of your own, beside the built-in ones.
    wind : str or None
        A wind of your own, over time and place.
    seed : int or None
        Seed of the first flight of a point; None: the scenario's.
    workers : int or None
        Processes; None: one a processor.
    cluster : str or None
        The address of a Dask scheduler, or ``local``.
    time_limit_s : float or None
        Time of the clock for a flight [s].
    out : str or Path or None
        The folder; None: a new one in ``runs/``.
    resume : bool
        Go on with the same search in the folder.
    progress : Progress or None
        Hears how far it is.

    Returns
    -------
    SearchResult
        Where each controller breaks, and the flights that show it.

    Raises
    ------
    InputError
        If the question or the folder is not usable; nothing is overwritten then.
    FlightError
        If no more can be flown or written.
    """
    from hexjet_prove.proof.design_study import design_study, find_design
    from hexjet_prove.search.folder import resolve_search, run_search
    from hexjet_prove.search.worst_folder import WHOLE_RANGES, resolve_worst, run_worst

    lasting = study_settings(settings, aircraft, engine, metrics, wind)
    options: dict[str, Any] = {
        "settings": lasting,
        "vary": as_texts(vary),
        "controllers": controllers,
        "success": success,
        "nominal_engine": nominal_engine,
        "batch": batch,
    }
    sought: dict[str, Any] = {"seeds": seeds, "seed": seed}
    fleet = (workers, cluster, time_limit_s)
    if not worst and not likely:
        if within is not None:
            raise InputError("within: goes with worst or likely")
        study, plan = resolve_search(str(name), over=over, tolerance=tolerance, share=share, **sought, **options)
        with _open_search(out, resume, f"search-{study.name}", "search", fleet, progress) as (folder, tell, flying):
            return SearchResult(run_search(study, plan, folder, flying, resume, tell))
    _check_worst(worst and likely, over=over, tolerance=tolerance, share=share)
    designed = find_design(Path(name))
    if designed is None:
        study, worst_plan = resolve_worst(str(name), likely=likely, within=within, budget=budget, **sought, **options)
    else:
        study = design_study(designed, "", 1, **options)
        if within is None and not likely and not any(entry.uncertainty for entry in study.vary):
            within = WHOLE_RANGES
        study, worst_plan = resolve_worst(study, likely=likely, within=within, budget=budget, **sought)
    kind = "likely" if likely else "worst"
    with _open_search(out, resume, f"{kind}-{study.name}", "search", fleet, progress) as (folder, tell, flying):
        return SearchResult(run_worst(study, worst_plan, folder, flying, resume, tell))


def _check_worst(both: bool, **given: Any) -> None:
    """Raise InputError for an option that a search over all keys at once does not have."""
    if both:
        raise InputError("likely: goes without worst; each is a search of its own")
    for option, value in given.items():
        if value:
            raise InputError(f"{option}: is of a search of one key, and goes with neither worst nor likely")


@contextmanager
def _open_search(
    out: str | Path | None,
    resume: bool,
    name: str,
    what: str,
    fleet: tuple[int | None, str | None, float | None],
    progress: Progress | None,
) -> Iterator[tuple[Path, Any, Workers]]:
    """Yield the folder, a function that reports the number of flights, and the workers."""
    from cosim.flight import new_folder
    from cosim.studies import choose_workers

    if resume and out is None:
        raise InputError(f"resume: give the folder of the {what} with out")
    folder = Path(out) if out is not None else new_folder(Path("runs"), name)
    hears = progress or Progress()
    hears.begin(folder)
    with choose_workers(*fleet) as flying:
        yield folder, report_tally(hears), flying


@check_types(target=Limits(1e-9, 0.5), budget=Limits(1))
def rare(
    name: str | Path,
    *,
    vary: Sequence[str] | Mapping[str, object] = (),
    controllers: Sequence[str] = (),
    correlate: Sequence[str] = (),
    success: Sequence[str] = (),
    target: float = 1e-6,
    budget: int = 5000,
    same_seed: bool = False,
    aircraft: str | Path | None = None,
    engine: str | Path | None = None,
    nominal_engine: bool = False,
    batch: bool = False,
    settings: Sequence[str] | Mapping[str, object] = (),
    metrics: Sequence[str] = (),
    wind: str | None = None,
    seed: int | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    time_limit_s: float | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> RareResult:
    """Find the probability of a failure that is too rare to be counted, down to one in a million and beyond.

    Parameters
    ----------
    name : str or Path
        A scenario or a study.
    vary : sequence of str or mapping
        What varies, as ``sweep`` has it.
    controllers : sequence of str
        The one that flies, of a study with several.
    correlate : sequence of str
        Rank correlations of what is drawn for two keys, ``KEY,KEY=R``.
    success : sequence of str
        What a completed flight must keep to count: ``METRIC<=X``, or a formula.
    target : float
        The smallest probability to look for; with the budget it says how many flights a level has.
    budget : int
        Flights at most.
    same_seed : bool
        Fly all with one seed: wind and noise are then no part of what varies.
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
    metrics : sequence of str
        Metrics of your own, beside the built-in ones.
    wind : str or None
        A wind of your own, over time and place.
    seed : int or None
        Seed of the draws.
    workers : int or None
        Processes; None: one a processor.
    cluster : str or None
        The address of a Dask scheduler, or ``local``.
    time_limit_s : float or None
        Time of the clock for a flight [s].
    out : str or Path or None
        The folder; None: a new one in ``runs/``.
    resume : bool
        Go on with the same simulation in the folder.
    progress : Progress or None
        Hears how far it is.

    Returns
    -------
    RareResult
        The probability with its bounds, and the most likely failures.

    Raises
    ------
    InputError
        If the study or the folder is not usable; nothing is overwritten then.
    FlightError
        If no more can be flown or written.
    """
    from hexjet_prove.rare.folder import resolve_rare, run_rare

    study, plan = resolve_rare(
        str(name), target=target, budget=budget, same_seed=same_seed, vary=as_texts(vary), controllers=controllers,
        settings=study_settings(settings, aircraft, engine, metrics, wind), correlate=correlate, success=success,
        seed=seed, nominal_engine=nominal_engine, batch=batch,
    )  # fmt: skip
    fleet = (workers, cluster, time_limit_s)
    with _open_search(out, resume, f"rare-{study.name}", "simulation", fleet, progress) as (folder, tell, flying):
        return RareResult(run_rare(study, plan, folder, flying, resume, tell))
