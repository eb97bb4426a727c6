"""Many flights of one scenario, drawn: what ``hexjet sweep`` calls, and the settings that all studies share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.api.call import Progress, Result, Table, check_types
from cosim.api.call.choices import aircraft_settings, list_engine_notes, plugin_settings
from cosim.base.storage.settings import as_settings, as_texts

if TYPE_CHECKING:
    from cosim.campaign.run import RepeatedFlight
    from cosim.campaign.store import Campaign, Tally


class SweepResult(Result):
    """Result of a sweep: flights as columns, success rates, and influences of keys.

    Attributes
    ----------
    campaign : Campaign
        The folder's flights; ``hexjet fly DIR --flight N`` is :meth:`fly_again`.
    """

    def __init__(self, campaign: Campaign, page: Path) -> None:
        from cosim.campaign.analysis.summary import campaign_summary

        self.campaign = campaign
        self.files = {"report": page}
        self._summary = campaign_summary(campaign)

    @property
    def columns(self) -> Mapping[str, list[Any]]:
        """Drawn values and results by name, one entry per flight: ``columns["success"]``."""
        return self.campaign.columns

    def fly_again(self, flight: int, out: Path | str | None = None) -> RepeatedFlight:
        """Fly one flight again with a full log; the result's ``same`` says whether it repeats bit for bit.

        Parameters
        ----------
        flight : int
            Its number.
        out : Path or str or None
            The run's folder; without it the log stays in memory.

        Raises
        ------
        InputError
            If there is no such flight, or it is not finished.
        """
        from cosim.campaign.run import fly_again

        return fly_again(self.campaign, flight, out)

    def to_dict(self) -> dict[str, Any]:
        return {"folder": str(self.campaign.folder), "report": str(self.report)} | self._summary

    def lines(self) -> list[str]:
        """Return each controller's success rate, and its comparison with the first controller."""
        from cosim.campaign.analysis.summary import comparison_lines, success_lines, with_referee

        flown = with_referee(success_lines(self._summary), self.campaign.referee)
        return [line.strip() for line in (*flown, *comparison_lines(self._summary))]

    def table(self) -> Any:
        """Return the flights as a ``pandas.DataFrame``, one per row."""
        from cosim.results.log.tables import make_table

        return make_table(self.columns)

    def tables(self) -> list[Table]:
        """Return the medians of the metrics as one table."""
        from cosim.campaign.analysis.summary import spread_table

        titles, rows = spread_table(self._summary)
        return [Table("", titles, rows)] if rows else []

    def _figures(self) -> Mapping[str, Any]:
        from cosim.campaign.analysis.page import make_page

        return make_page(self.campaign).figures


def study_settings(
    settings: Sequence[str] | Mapping[str, object],
    aircraft: str | Path | None,
    engine: str | Path | None,
    metrics: Sequence[str],
    wind: str | None,
) -> list[str]:
    """Return a study's settings with aircraft, engine, metrics and wind added; paths are made absolute."""
    import json

    from cosim.base.trust import trust_named_code
    from cosim.spec.vehicle import file_seen_from

    engines = [] if engine is None else [f"engine={json.dumps(file_seen_from(str(engine), Path()))}"]
    trust_named_code([*metrics, engine, wind], Path())
    vehicle = aircraft_settings(None if aircraft is None else str(aircraft))
    return [*vehicle, *engines, *as_settings(settings), *plugin_settings(tuple(metrics), wind)]


@check_types()
def sweep(
    name: str | Path,
    *,
    vary: Sequence[str] | Mapping[str, object] = (),
    runs: int | None = None,
    repeats: int | None = None,
    design: str | None = None,
    controllers: Sequence[str] = (),
    correlate: Sequence[str] = (),
    success: Sequence[str] = (),
    until: str | None = None,
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
) -> SweepResult:
    """Fly a scenario many times with what varies drawn for each flight, or a study, or go on with a campaign.

    A flight that fails is a row.  What is interrupted goes on with ``resume``.

    >>> swept = sweep("hover", vary=["vehicle.mass_kg=5.4:5.8"], runs=2, settings=["duration_s=0.2"], workers=1)
    >>> swept.columns["success"]
    [True, True]

    Parameters
    ----------
    name : str or Path
        A scenario, a study, or the folder of a campaign to go on with.
    vary : sequence of str or mapping
        What varies, as ``vehicle.mass_kg=5:6.5`` or ``{"vehicle.mass_kg": [5, 6.5]}``: LO:HI, LO:HI:LEVELS, A,B,C,
        log(LO:HI), normal(MEAN,SD).
    runs : int or None
        Draws; a grid has as many as it has points.
    repeats : int or None
        How often a whole grid is flown.
    design : str or None
        grid, latin-hypercube, random or sobol.
    controllers : sequence of str
        Each draw is flown with every one: names or files.
    correlate : sequence of str
        Rank correlations of what is drawn for two keys, ``KEY,KEY=R``.
    success : sequence of str
        What a completed flight must keep to count: ``METRIC<=X``, or a formula.
    until : str or None
        The claim at which it stops, such as ``99.9%@95%``.
    aircraft : str or Path or None
        In place of the scenario's, with the engine that it is made for.
    engine : str or Path or None
        In place of the scenario's: a name, an FMU or its mapping file.
    nominal_engine : bool
        Fly the engine as it is stated, not drawn by its uncertainty.
    batch : bool
        Fly on arrays, many flights at once, and some of them again by JSBSim.
    settings : sequence of str or mapping
        Written over the scenario's: ``duration_s=2.5`` or ``{"duration_s": 2.5}``.
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
        Time of the clock for a flight [s]; None: 60, or ten of its lengths.
    out : str or Path or None
        The folder; None: a new one in ``runs/``.
    resume : bool
        Go on with what the folder holds.
    progress : Progress or None
        Hears notes and how far it is.

    Returns
    -------
    SweepResult
        The flights as columns, and what they say of the controllers.

    Raises
    ------
    InputError
        If study or folder is not usable; nothing is overwritten then.
    FlightError
        If no more can be flown or written.
    """
    from cosim.campaign.analysis.page import write_campaign_report
    from cosim.campaign.run import choose_workers, resolve_campaign, run_campaign
    from cosim.campaign.study.model_notes import design_warnings, model_notes

    hears = progress or Progress()
    study, folder = resolve_campaign(
        str(name),
        None if out is None else Path(out),
        resume,
        settings=study_settings(settings, aircraft, engine, metrics, wind),
        vary=as_texts(vary),
        runs=runs,
        repeats=repeats,
        design=design,
        controllers=controllers,
        correlate=correlate,
        success=success,
        seed=seed,
        until=until,
        nominal_engine=nominal_engine,
        batch=batch,
    )
    hears.begin(folder)
    with choose_workers(workers, cluster, time_limit_s) as flying:
        if study is not None:
            engine_notes = list_engine_notes(study.base(), "engine" in study.drawn or bool(study.case))
            for text in (*engine_notes, *study.notes(), *design_warnings(study), *model_notes(study)):
                hears.note(text)
        campaign = run_campaign(study, folder, flying, resume, report_tally(hears))
    return SweepResult(campaign, write_campaign_report(campaign))


def report_tally(progress: Progress) -> Any:
    """Return a callback that reports the number of finished flights and their outcomes to a :class:`Progress`."""

    def report(tally: Tally, done: int, of: int) -> None:
        """Report success rates, or the number of finished flights if the total is unknown."""
        shares = ", ".join(f"{name} {tally.successes[name] / n:.0%}" for name, n in sorted(tally.flights.items()))
        progress.update(shares if of else f"{done} flights", done, of)

    return report
