"""A campaign: the flights of a study, flown by workers into a folder; and one of them flown again, alone."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from itertools import tee
from pathlib import Path
from typing import Any, TypeVar

from cosim.base.errors import FlightError, InputError
from cosim.base.plugins.entry_points import load_hook
from cosim.base.storage.files import parse_json
from cosim.base.trust import need_trust
from cosim.campaign.folder import STUDY, extend_asked, is_campaign
from cosim.campaign.store import Campaign, Store, Tally, open_campaign, read_referee
from cosim.campaign.study.autopilot import StudyAutopilot
from cosim.campaign.study.options import open_study
from cosim.campaign.study.plan import Flight, case_of, flight_of, flights, scenario_of, stopping_rule
from cosim.campaign.study.sequential import default_runs
from cosim.campaign.study.study import Study, study_code, study_names
from cosim.campaign.workers.flight_row import Row, hash_inputs, inputs, outcome_row, verdict_of, with_autopilot
from cosim.campaign.workers.local import LocalWorkers
from cosim.campaign.workers.protocol import Workers
from cosim.flight import fly_watched as fly
from cosim.flight import new_folder
from cosim.results.log.digest import log_digest
from cosim.results.run import Run
from cosim.spec.scenario import scenario_names

# Called with the tally, the number of finished flights and their total (0: unknown).
Progress = Callable[[Tally, int, int], None]
R = TypeVar("R")  # what a sampler returns
# A generator that yields the flights it wants next, is sent their rows in that order, as far as they were flown, and
# returns what it found. The rows come as an iterator that reads while flights go on; it need not be exhausted.
Sampler = Generator[Iterable[Flight], Iterator[Row], R]


def run_campaign(
    study: Study | None,
    out: Path | str,
    workers: Workers | int | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Campaign:
    """Fly every flight of a study that is not finished yet into the folder ``out``.

    ``workers``: how many processes of this machine, by default one a processor, or where else.  ``resume``: go on with
    what the folder holds, if it holds anything; then ``study`` may be None and is the folder's.

    >>> study = open_study("hover", vary=["vehicle.mass_kg=5.4:5.8"], runs=2, settings=["duration_s=0.2"])
    >>> campaign = run_campaign(study, "runs/mass", workers=1)
    >>> campaign.columns["outcome"], len(campaign.columns["vehicle.mass_kg"])
    (['completed', 'completed'], 2)

    A study with a claim stops when that is shown or refuted: its rows are then those of the draws up to there, however
    many workers flew them.  A flight that fails is a row.  Raises InputError if the study or the folder is not usable
    (another study's, in use, or of a campaign that is not resumed): nothing is overwritten then.  Raises FlightError if
    no more can be flown or written; this and KeyboardInterrupt lose at most the flights under way.
    """
    if study is not None:
        stopping_rule(study)
    return run_sampler(study, out, draw, workers, resume, progress, kept=("flight", "outcome", "success"))[0]


def draw(study: Study) -> Sampler[None]:
    """Yield all flights of a study until its stopping rule ends it."""
    rule = stopping_rule(study)
    for row in (yield flights(study)):
        if rule is not None and rule.add(int(row["flight"] or 0), verdict_of(row["outcome"], row["success"])):
            return


def run_sampler(
    study: Study | None,
    out: Path | str,
    sampler: Callable[[Study], Sampler[R]],
    workers: Workers | int | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    plan: Mapping[str, Any] | None = None,
    kept: Sequence[str] | None = None,
) -> tuple[Campaign, R]:
    """Fly what a sampler requests and ``out`` does not hold yet; return the folder's flights and the result.

    ``sampler`` makes it of the study as it is in the folder.  ``plan`` is what is asked beside the study, as a table;
    ``kept`` are the columns of a row that the sampler reads, by default all.  For the rest see :func:`run_campaign`.
    """
    folder = Path(out)
    is_begun = study is None or (resume and folder.is_dir() and any(folder.iterdir()))
    if study is not None and study.autopilot is not None:
        _check_autopilot(study, study.autopilot, workers)
    if study is not None and (batch := load_batch(study)):
        batch.check(study)
    with Store.resume(folder, study, plan, kept) if is_begun else Store.create(folder, study, plan, kept) as store:  # type: ignore[arg-type]

        def report_progress() -> None:
            if progress is not None:
                progress(store.tally, store.stored, store.of)

        report_progress()
        with open_workers(workers) as flying:
            batch = load_batch(store.study)
            fleet = batch.BatchWorkers(flying) if batch else flying
            try:
                result = _drive_sampler(
                    sampler(store.study), lambda asked: _get_rows(store, asked, fleet, report_progress)
                )
                if batch and read_referee(folder).get("flights") != store.stored:
                    batch.judge(folder, flying)
            except FlightError as error:
                raise FlightError(f"{error}; {describe_progress(store)}") from error
            except KeyboardInterrupt:
                # The interruption may have come between storing a flight and reporting it.
                report_progress()
                raise
    return open_campaign(folder), result


def _drive_sampler(sampler: Sampler[R], fly: Callable[[Iterable[Flight]], Generator[Row]]) -> R:
    """Fly what a sampler requests until it ends, and return its result."""
    rows: Generator[Row] | None = None
    while True:
        try:
            asked = sampler.send(rows)  # type: ignore[arg-type]  # nothing begins a generator
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
        finally:
            if rows is not None:
                rows.close()
        rows = fly(asked)


def _get_rows(store: Store, asked: Iterable[Flight], workers: Workers, report: Callable[[], None]) -> Generator[Row]:
    """Yield the rows of the requested flights in that order; those not yet stored are flown and stored.

    The rows of a study that may stop are stored in order, so that there are none beyond that.
    """
    keys: dict[int, str] = {}  # keys of the flights in progress
    to_fly, to_tell = tee((flight, store.key(flight)) for flight in asked)

    def missing_flights() -> Iterator[Flight]:
        for flight, key in to_fly:
            if key not in store.done:
                keys[flight.number] = key
                yield flight

    flown = workers.fly(store.study, missing_flights())
    waiting: dict[str, Row] = {}
    with closing(flown):  # type: ignore[type-var]  # both kinds of workers have close
        for _, key in to_tell:
            while key not in waiting and key not in store.done:
                row = next(flown, None)
                if row is None:
                    return
                key_flown = keys.pop(int(row["flight"] or 0))
                if store.study.until is None:
                    store.add(row)
                    report()
                else:
                    waiting[key_flown] = row
            if key in waiting:
                store.add(waiting.pop(key))
                report()
            yield store.done[key]


def load_batch(study: Study) -> Any:
    """Return the tool that flies a study on arrays, or None for other studies.  Raises InputError without it."""
    if study.batch and (tool := load_hook("campaign.batch")) is None:
        raise InputError(f"study {study.name}: batch: needs hexjet_batch, which is not installed")
    return tool if study.batch else None


def _check_autopilot(study: Study, autopilot: StudyAutopilot, workers: Workers | int | None) -> None:
    """Raise InputError if the autopilot is missing or cannot fly these flights here."""
    if not (workers is None or isinstance(workers, (int, LocalWorkers))):
        raise InputError(f"study {study.name}: autopilot {autopilot.name} flies on this machine; leave out cluster")
    autopilot.check(study.base(), study.folder)


def resolve_campaign(name: str, out: Path | None, resume: bool, **options: Any) -> tuple[Study | None, Path]:
    """Return the study that a command line names, and the folder that it is flown into.

    ``name`` is a scenario's, a study's or a campaign's folder; ``options`` are those of
    :func:`cosim.campaign.study.options.open_study`.  A folder that is called as what is shipped is meant where it
    is written as a path (``./hover``), and where there is nothing else to go on with.  A folder's campaign goes on as
    it began, with ``until`` and more ``runs`` alone.  Raises InputError.
    """
    is_shipped = name in (*study_names(), *scenario_names()) and (out is not None or not resume)
    if not is_shipped and is_campaign(Path(name)):
        if not resume:
            raise InputError(f"{name}: already holds a campaign; resume goes on with it")
        longer = {key: options.pop(key, None) for key in ("until", "runs")}
        refuse_changes(f"{name}: is a campaign", **options, out=out)
        if any(value is not None for value in longer.values()):
            extend_campaign(Path(name), **longer)
        return None, Path(name)
    if resume and out is None:
        if name not in (*study_names(), *scenario_names()):
            raise InputError(f"{name}: holds no campaign; resume goes on with a campaign's folder")
        raise InputError("resume: give the folder of the campaign, as in hexjet sweep DIR --resume")
    study = open_study(name, **options)
    return study, out if out is not None else new_folder(Path("runs"), study.name)


def refuse_changes(what: str, **choices: Any) -> None:
    """Raise InputError if an option would change an existing campaign; ``what`` names the campaign."""
    for name, value in choices.items():
        if value not in (None, (), []) and value is not False:
            raise InputError(f"{what} and goes on as it began; leave out {name}")


def extend_campaign(folder: Path, until: str | None = None, runs: int | None = None) -> None:
    """Give a campaign's study more draws, or a claim to stop at, before it is resumed.

    Raises InputError if its design has no longer form, the claim does not fit, or another process is at work there.
    """
    with Store.resume(folder) as store:
        study = store.study
        if runs is not None and study.until is not None and store.stored >= store.of:
            raise InputError(
                f"{folder}: {study.until} was judged by all of its {study.draws} draws, a number that was fixed "
                "before; more of them need a study of their own"
            )
        if runs is not None and (study.design not in ("random", "sobol") or runs < study.draws):
            raise InputError(
                f"{folder}: runs = {runs}: its {study.design} has {study.draws} draws; only a random or a sobol study "
                "goes on with more"
            )
        changes = {"until": until or study.until, "runs": runs or study.runs}
        if until is not None and runs is None and study.design == "random":
            changes["runs"] = max(study.draws, default_runs(until))
        table = study.table() | {key: value for key, value in changes.items() if value is not None}
        longer = Study.from_table(table, folder.absolute(), str(folder / STUDY))
        stopping_rule(longer)
        extend_asked(folder, longer)


def choose_workers(count: int | None, cluster: str | None, time_limit_s: float | None) -> Workers:
    """Return the workers for a command line: local processes, by default one per processor, or a cluster.

    Raises InputError.
    """
    if cluster is None:
        return LocalWorkers(count_processors() if count is None else count, time_limit_s)
    from cosim.campaign.workers.cluster import DaskWorkers

    return DaskWorkers(None if cluster == "local" else cluster, count, time_limit_s)


def open_workers(workers: Workers | int | None) -> AbstractContextManager[Workers]:
    """Open workers for a block of code; those given by the caller are left open."""
    if workers is None or isinstance(workers, int):
        return LocalWorkers(count_processors() if workers is None else workers)
    return nullcontext(workers)


def count_processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def describe_progress(store: Store) -> str:
    """Return a line for interrupted flights: how many are kept, and how to resume them."""
    if store.of:
        return f"{store.stored} of {store.of} flights are kept: hexjet sweep {store.folder} --resume goes on"
    return f"{store.stored} flights are kept: the same call with out {store.folder} and resume goes on"


@dataclass(frozen=True)
class RepeatedFlight:
    """A flight of a campaign that was flown again: its run, and differences, one line each."""

    number: int
    run: Run
    otherwise: list[str]
    comparable: bool  # False: only the failure is recorded
    sameness: str = "the same, bit for bit"

    @property
    def same(self) -> bool:
        """Whether the log is the same, bit for bit; of a flight on arrays, whether the verdict is."""
        return self.comparable and not self.otherwise

    @property
    def verdict(self) -> str:
        if not self.comparable:
            return "the first time was not recorded to its end"
        return self.sameness if self.same else "not the same"


def fly_again(campaign: Campaign, number: int, out: Path | str | None = None, **options: Any) -> RepeatedFlight:
    """Fly one finished flight of a campaign again from its row, with a full log.

    ``out`` and ``options`` are those of :func:`cosim.fly`.  Raises InputError if the flight is not finished, or cannot
    be flown now, or is code that the user does not trust; FlightError if it could not be flown then either.

    >>> study = open_study("hover", vary=["vehicle.mass_kg=5.4:5.8"], runs=1, settings=["duration_s=0.2"])
    >>> fly_again(run_campaign(study, "runs/again", workers=1), 0).sameness
    'the same, bit for bit'
    """
    row = campaign.row(number)
    need_trust(study_code(campaign.study), f"{campaign.folder}: flight {number}")
    try:
        scenario = scenario_of(campaign.study, flight_of(campaign.study, row))
        if campaign.study.autopilot is not None:
            folder = (
                Path(out) if out is not None else new_folder(Path("runs"), f"{campaign.study.name}-flight-{number}")
            )
            _, run = with_autopilot(campaign.study, scenario, folder, case_of(row))
        else:
            run = fly(scenario, out, **options)
    except InputError as error:
        if str(error) == row["reason"]:
            raise FlightError(f"flight {number} cannot be flown, as the first time: {error}") from error
        raise
    if row.get("by") == "batch":
        now = outcome_row(campaign.study, run, "")
        otherwise = [f"{name} is {now[name]} by JSBSim" for name in ("outcome", "success") if now[name] != row[name]]
        return RepeatedFlight(number, run, otherwise, True, "the same verdict by JSBSim")
    if row["log_sha256"] is None:
        return RepeatedFlight(number, run, [f"{row['outcome']}, {row['reason']}"], False)
    differences = [] if log_digest(run.log) == row["log_sha256"] else list(_explain_differences(row, run))
    return RepeatedFlight(number, run, differences, True)


def _explain_differences(row: Row, run: Run) -> list[str]:
    """Return why a flight may differ now from the recorded one."""
    then, now = parse_json(str(row["inputs"]), "inputs"), parse_json(inputs(run), "inputs")
    differences = [
        f"{name} was {_short_digest(then[kind].get(name))} and is {_short_digest(now[kind].get(name))}"
        for kind in ("versions", "sha256")
        for name in sorted({*then[kind], *now[kind]})
        if then[kind].get(name) != now[kind].get(name)
    ]
    if not differences and row.get("autopilot"):
        differences = ["its autopilot is a program with threads of its own, which may answer in another order"]
    if not differences and row["inputs_sha256"] != hash_inputs(inputs(run), run.scenario):
        differences = ["the numbers of the aircraft or of an engine are others"]
    ended = f"it ended {run.outcome}, {run.reason}; then {row['outcome']}, {row['reason']}"
    return [
        *(differences or ["versions, aircraft and engines are the same: the program or the machine is another"]),
        ended,
    ]


def _short_digest(text: str | None) -> str:
    return "not there" if text is None else text[:12]
