"""One flight: what ``hexjet fly`` calls, and what it comes to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.api.call.result import Progress, Result, Table, note_lines
from cosim.base.errors import InputError, notify

if TYPE_CHECKING:
    from cosim.base.protocols import Observer
    from cosim.base.signals import Sample
    from cosim.results.run import Run
    from cosim.results.summary import Summary
    from cosim.spec.scenario import Scenario


class FlightResult(Result):
    """Result of a flight; ``run`` has its log and summary."""

    short_lines = 6

    def __init__(self, run: Run) -> None:
        from cosim.results.run import REPORT

        self.run = run
        self.files = {} if run.folder is None else {"report": run.folder / REPORT}

    def to_dict(self) -> dict[str, Any]:
        """Return what ``hexjet fly --json`` prints: the run's summary."""
        return self.run.to_dict()

    def lines(self) -> list[str]:
        """Return the ending with the smallest margin, the commanded axes, what flew, and notes."""
        from cosim.results.report.flight import axis_sentences
        from cosim.results.report.requirements import checked_rows

        summary, controller = self.run.summary, self.run.summary.own_controller
        checked = checked_rows(summary) if summary.outcome == "completed" else []
        least = [f"; least margin, {label} {allowed}: {margin}" for _, (label, _, allowed, margin, _) in checked[:1]]
        speed = "" if summary.realtime_factor is None else f", {summary.realtime_factor:.0f} x real time"
        lines = [
            f"{summary.scenario}: {summary.ending}{''.join(least)}",
            *axis_sentences(summary),
            f"{summary.aircraft}, engine {summary.engine_shown}{_other_engines(summary)}, controller "
            f"{summary.controller_shown}, seed {summary.seed}"
            f"{f', sensors {summary.sensors}' if summary.sensors else ''}: {summary.duration_s:.2f} s flown{speed}",
        ]
        lines += [f"beyond its limit: {text}" for text in summary.exceeded]
        lines += [*summary.own_metrics_failed, *(f"not as expected: {text}" for text in summary.complaints)]
        lines += [f"requirement {each.describe()}" for each in summary.requirements if each.source == "require"]
        if controller is not None and controller.repeatable is False:
            lines += [f"controller {summary.controller} is not repeatable: asked the same again, it answered otherwise"]
        if controller is not None and controller.level == "controller" and self.run.scenario.monitored:
            lines.append(
                f"engines were not watched: {summary.controller} is a whole controller, and sees to lost ones itself"
            )
        return [*lines, *note_lines(summary.notes)]

    def tables(self) -> list[Table]:
        """Return the metrics of the axes and of the whole flight, and what was checked, each with its margin."""
        from cosim.results.report.flight import found_values
        from cosim.results.report.requirements import CHECKED, checked_rows
        from cosim.results.wording import AXIS_DIGITS, NONE, metric

        summary, metrics, found = self.run.summary, self.run.metrics, found_values(self.run.summary)
        axes = [
            (f"{metric(key).label}, {metric(key).unit}", *(found.get(f"{axis}.{key}", NONE) for axis in metrics))
            for key in AXIS_DIGITS
            if any(f"{axis}.{key}" in found for axis in metrics)
        ]
        limits = {name: f"{metric(name).factor * limit:.4g}" for name, limit in summary.limits.items()}
        whole = [
            (metric(name).label, text, limits.get(name, ""), metric(name).unit)
            for name, text in found.items()
            if name.split(".")[0] not in metrics
        ]
        checked = [cells for _, cells in checked_rows(summary)] if summary.outcome == "completed" else []
        tables = [Table("", ("metric", *metrics), axes), Table("", ("whole flight", "value", "limit", "unit"), whole)]
        return [each for each in (*tables, Table("", CHECKED, checked)) if each.rows]


def _other_engines(summary: Summary) -> str:
    """Return the engines that differ from the first, with their stations, as text."""
    at: dict[str, list[str]] = {}
    for number, station in enumerate(summary.stations, 1):
        if station.engine != summary.engine:
            at.setdefault(station.engine, []).append(str(number))
    return "".join(f", {engine} at {' and '.join(numbers)}" for engine, numbers in at.items())


def load(
    scenario: Scenario | str | Path,
    *,
    controller: str | Path | None = None,
    aircraft: str | Path | None = None,
    engine: str | Path | Sequence[str] | None = None,
    settings: Sequence[str] | Mapping[str, object] = (),
    model: str | Path | None = None,
    seed: int | None = None,
    metrics: Sequence[str] = (),
    observers: Sequence[str] = (),
    sensors: str | None = None,
    wind: str | None = None,
    unchecked_engine: bool = False,
    progress: Progress | None = None,
) -> Scenario:
    """Return a scenario with the choices of :func:`fly` applied.  Raises InputError for an invalid one."""
    from cosim.api.call.choices import apply_choices, plugin_changes
    from cosim.base.storage.settings import as_sequence

    hears = progress or Progress()
    chosen = apply_choices(scenario, controller, aircraft, engine, settings, seed, hears.note, model)
    changes = plugin_changes(tuple(as_sequence(metrics)), tuple(as_sequence(observers)), sensors, wind)
    if sensors or wind:  # expectations assume the stated sensors
        changes["expect"] = []
    if unchecked_engine:
        changes["engine_unchecked"] = True
    return chosen.replace(**changes) if changes else chosen


def fly(
    scenario: Scenario | str | Path,
    out: Path | str | None = None,
    *,
    controller: Any = None,
    aircraft: str | Path | None = None,
    engine: str | Path | Sequence[str] | None = None,
    settings: Sequence[str] | Mapping[str, object] = (),
    model: str | Path | None = None,
    seed: int | None = None,
    metrics: Sequence[str] = (),
    observers: Sequence[Observer | str] = (),
    sensors: str | None = None,
    wind: str | None = None,
    unchecked_engine: bool = False,
    realtime_factor: float | None = None,
    mavlink: Sequence[str] = (),
    flightgear: str | None = None,
    report: bool = True,
    shared_assets: bool = False,
    progress: Progress | None = None,
) -> Run:
    """Fly a scenario to its end, record every step, and give back the finished run.

    A crash, a divergence or a failing engine is an outcome, not an exception.  Notes become warnings,
    ``cosim.base.errors.Notice``.

    >>> fly("hover", settings={"duration_s": 0.2}).outcome
    'completed'

    Parameters
    ----------
    scenario : Scenario or str or Path
        Who flies, what is asked of it and what disturbs it: the name of a scenario, or the path of its file.
    out : Path or str or None
        The run's folder, made if need be; without it the log stays in memory.
    controller : str or Path or object or None
        In place of the scenario's: a name, a file of a design with all gains, or one of your own: ``FILE.py:Class``,
        ``package.module:Class``, ``FILE.fmu``, ``process:FILE ARGUMENTS``; in Python a class or an object too.
    aircraft : str or Path or None
        In place of the scenario's, with the engine that it is made for: a name or a folder.
    engine : str or Path or sequence of str or None
        In place of the scenario's: a name, an FMU or its mapping file; ``N=NAME`` is the one at station N alone.
    settings : sequence of str or mapping
        Written over the scenario's, as ``vehicle.mass_kg=6.0``; its expectations are not checked then.
    model : str or Path or None
        A file of identified models, by which the controller predicts.
    seed : int or None
        In place of the scenario's.
    metrics : sequence of str
        Metrics of your own beside the built-in ones: ``FILE.py:Name``, ``package.module:Name`` or an entry point.
    observers : sequence of Observer or str
        They see every step; named in the same way.
    sensors : str or None
        Sensors of your own behind the built-in ones, named in the same way, or a profile of these: ``measured``.
    wind : str or None
        A wind of your own over time and place, named in the same way, or a table over time, ``FILE.csv``.
    unchecked_engine : bool
        Fly an FMU that the check of engines finds unfit, or has not seen.
    realtime_factor : float or None
        Seconds of flight in a second of the clock, 1 is real time; None: as fast as it goes, or 1 where somebody
        watches by ``mavlink`` or ``flightgear``.
    mavlink : sequence of str
        Where ground stations watch, such as ``udpout:127.0.0.1:14550``.
    flightgear : str or None
        Where FlightGear shows it, ``[HOST:]PORT``, begun with ``fgfs --fdm=null --native-fdm=socket,in,60,,PORT,udp``.
    report : bool
        Write ``report.html`` into the folder.
    shared_assets : bool
        Keep what draws that page in one folder beside those of runs, rather than in each page.
    progress : Progress or None
        Hears notes and how far the flight is.

    Returns
    -------
    Run
        Summary and log; every column is one float64 a control step, in the unit that its name says.

    Raises
    ------
    InputError
        If the scenario, the vehicle, the engine or the folder is not usable; nothing is written then.
    """
    from cosim.api.call.choices import list_engine_notes
    from cosim.base.storage.settings import as_sequence
    from cosim.flight import check_arguments, fly_watched, list_warnings

    check_arguments(scenario, out, realtime_factor)
    observers = as_sequence(observers)
    named = [each for each in observers if isinstance(each, str)]
    own = None if controller is None or isinstance(controller, (str, Path)) else controller
    loaded = load(
        scenario, controller=None if own is not None else controller, aircraft=aircraft, engine=engine,
        settings=settings, model=model, seed=seed, metrics=metrics, observers=named, sensors=sensors, wind=wind,
        unchecked_engine=unchecked_engine, progress=progress,
    )  # fmt: skip
    told = list_warnings(loaded, controller)
    if progress is not None:
        for text in (*told, *list_engine_notes(loaded)):
            progress.note(text)
    is_watched = bool(mavlink or flightgear)
    with ExitStack() as stack:
        watching: list[Observer] = [each for each in observers if not isinstance(each, str)]
        watching += [_FlightProgress(progress, loaded)] if progress is not None else []
        watching += [stack.enter_context(closing(_flightgear(flightgear, loaded)))] if flightgear is not None else []
        run = fly_watched(
            loaded,
            out,
            controller=own,
            observers=watching,
            realtime_factor=(1.0 if is_watched else None) if realtime_factor is None else realtime_factor or None,
            report=report,
            shared_assets=shared_assets,
            watch=_publish_on_links(as_sequence(mavlink), stack) if mavlink else None,
        )
    for text in (*told, *run.summary.notes) if progress is None else ():
        notify(text)
    return run


class _FlightProgress:
    """Observer that reports the progress of a flight, twice per simulated second."""

    def __init__(self, progress: Progress, scenario: Scenario) -> None:
        self._progress, self._scenario = progress, scenario
        self._every = max(1, round(0.5 / scenario.step_s))

    def observe(self, sample: Sample) -> None:
        """Report the progress, if half a simulated second has passed since the last report."""
        if sample.k % self._every == 0:
            self._progress.update(self._scenario.name, sample.k, self._scenario.steps)


def _publish_on_links(links: Sequence[str], stack: ExitStack) -> Any:
    """Return an observer that publishes a flight to ground stations; its links are open until ``stack`` closes."""
    from cosim.groundstation.links import Links

    return stack.enter_context(Links(tuple(links))).make_read_only_observer()


def _flightgear(port: str, scenario: Scenario) -> Any:
    """Return an observer for FlightGear, to be closed, which a tool provides by an entry point."""
    from cosim.base.plugins.entry_points import load_hook

    if (viewer_of := load_hook("flightgear")) is None:
        raise InputError("flightgear: none of the tools that are installed sends to FlightGear")
    return viewer_of(port, scenario.environment)
