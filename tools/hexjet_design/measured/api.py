"""Gain, phase and delay margins, measured in flight: what ``hexjet margins`` calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cosim.api.call import FolderResult, Limits, Progress, Table, check_types
from cosim.api.call.choices import apply_choices, list_engine_notes
from cosim.base.signals import AXES
from cosim.spec.scenario import Scenario

if TYPE_CHECKING:
    from hexjet_design.measured.axis_margins import AxisMargins
    from hexjet_design.measured.margins import MeasuredMargins

RESULT_FILES = ("margins.json", "response.csv", "report.html")  # files of measured margins


class MarginsResult(FolderResult):
    """Margins of one controller on one vehicle.

    ``write`` leaves ``margins.json``, ``response.csv`` and ``report.html``.  ``measured`` has everything; ``kept`` is
    whether no margin is worse than what ``at_least`` asked for, None where nothing was asked for.
    """

    def __init__(self, measured: MeasuredMargins, at_least: str | None = None) -> None:
        from hexjet_design.measured.judgement import falls_below

        self.measured = measured
        self.kept = None if at_least is None else not falls_below(measured.judged, at_least)
        self.files = {}

    @property
    def axes(self) -> Mapping[str, AxisMargins]:
        """Margins by axis: ``axes["roll"].response.margins["phase_deg"]`` has ``value``, ``low`` and ``high``."""
        return self.measured.axes

    def _write(self, folder: Path) -> dict[str, Path]:
        from hexjet_design.measured.page import write

        return write(self.measured, folder)

    def to_dict(self) -> dict[str, Any]:
        return self.measured.to_dict() | ({} if self.kept is None else {"kept": self.kept})

    def lines(self) -> list[str]:
        """Return the measurement, the verdict, and notes."""
        from hexjet_design.measured.judgement import judgement_line
        from hexjet_design.measured.page import limit_line, uncertainty_line

        measured = self.measured
        scenario = measured.scenario
        notes = [f"{axis}: {note}" for axis, each in measured.axes.items() for note in each.notes]
        more = [line for each in measured.axes.values() for line in (uncertainty_line(each), limit_line(each)) if line]
        missing = [f"not computed: {measured.uncomputed}"] if measured.uncomputed else []
        if measured.uncertainty_source is not None:
            missing.append(f"uncertainty of the engine: {measured.uncertainty_source or 'of no stated source'}")
        first = f"margins of {measured.controller_shown} on {scenario.aircraft}, engine {scenario.engine}"
        return [first, judgement_line(measured.judged), *more, *notes, *missing]

    def tables(self) -> list[Table]:
        """Return a table an axis, the margins with their limits, and the engine's uncertainty."""
        from hexjet_design.measured.judgement import COLUMNS as JUDGED_COLUMNS
        from hexjet_design.measured.page import ENGINE_COLUMNS, columns, engine_rows, heading, judged_rows, rows

        measured = self.measured
        tables = [Table(heading(each), columns(each), rows(each)) for each in measured.axes.values()]
        tables.append(Table("beside their limits", JUDGED_COLUMNS, judged_rows(measured)))
        if measured.uncertainty_source is not None:
            tables.append(Table("uncertainty of the engine", ENGINE_COLUMNS, engine_rows(measured.engine_ranges)))
        return tables

    def _figures(self) -> Mapping[str, Any]:
        from hexjet_design.measured.page import figures

        return figures(self.measured)


@check_types(
    from_hz=Limits(0.0, is_open=True),
    to_hz=Limits(0.0, is_open=True),
    period_s=Limits(0.0, is_open=True),
    periods=Limits(3),
)
def margins(
    scenario: Scenario | str | Path = "hover",
    axes: Sequence[Literal["roll", "pitch", "yaw"]] = (),
    *,
    controller: Any = None,
    aircraft: str | Path | None = None,
    engine: str | Path | Sequence[str] | None = None,
    settings: Sequence[str] | Mapping[str, object] = (),
    seed: int | None = None,
    amplitude: float | None = None,
    from_hz: float | None = None,
    to_hz: float | None = None,
    period_s: float | None = None,
    periods: int = 5,
    limit: bool = False,
    at_least: Literal["enough", "narrow"] | None = None,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> MarginsResult:
    """Measure gain, phase and delay margins, both ways, and peak sensitivity of any controller in flight.

    A multisine is added between the controller and its actuators while the vehicle holds still; what passes before and
    behind gives the open loop, with 95 % bounds, beside the computed one where the controller is built in.  Every
    margin is judged by docs/judging.md, and the worst is named.

    >>> margins("hover", ["roll"], periods=3).verdict
    'margins of smith on hexjet, engine edf-as-flown'

    Parameters
    ----------
    scenario : Scenario or str or Path
        Vehicle, engine, controller and air; its commands, faults and passing disturbances are left out.
    axes : sequence of str
        Axes that are measured; all where none is named.
    controller : str or Path or object or None
        In place of the scenario's: a name or a file, as of a flight; in Python a class or an object of one's own too.
    aircraft : str or Path or None
        In place of the scenario's, with the engine that it is made for.
    engine : str or Path or sequence of str or None
        In place of the scenario's; ``N=NAME`` is the one at station N alone.
    settings : sequence of str or mapping
        Written over the scenario's: ``vehicle.mass_kg=6`` or ``{"vehicle.mass_kg": 6.0}``.
    seed : int or None
        Seed of sensor noise and turbulence.
    amplitude : float or None
        Peak of what is added, in shares of thrust, rad of tilt or rad/s^2.
    from_hz : float or None
        Lowest frequency [Hz]; None: two periods.
    to_hz : float or None
        Highest frequency [Hz]; None: a tenth of the control rate.
    period_s : float or None
        Period of the multisine [s]; None: 20, or 60 for a slow loop.
    periods : int
        Periods that are measured.
    limit : bool
        Compare each computed loop with the best that any linear controller could do.
    at_least : str or None
        The judgement that every margin is to have; narrow: with a well-known engine alone.
    out : str or Path or None
        A folder for page and data; without it nothing is written.
    progress : Progress or None
        Hears how far it is.

    Returns
    -------
    MarginsResult
        By axis, with bounds.

    Raises
    ------
    InputError
        For a wrong choice, or where the vehicle has no such loop.
    FlightError
        Where the vehicle does not stay in the air.
    """
    from cosim.base.storage.files import check_results_folder
    from hexjet_design.measured.margins import measure_margins

    hears, done = progress or Progress(), 0
    check_results_folder(out, *RESULT_FILES)
    named = controller if isinstance(controller, (str, Path)) else None
    chosen, on = apply_choices(scenario, named, aircraft, engine, settings, seed, hears.note), axes or AXES
    for line in list_engine_notes(chosen):
        hears.note(line)

    def report_progress(text: str) -> None:
        nonlocal done
        hears.update(text, done, 2 * len(on) + 1)
        done += 1

    measured = measure_margins(
        chosen,
        on,
        controller=None if named is not None else controller,
        amplitude=amplitude,
        from_hz=from_hz,
        to_hz=to_hz,
        period_s=period_s,
        periods=periods,
        limit=limit,
        say=report_progress,
    )
    result = MarginsResult(measured, at_least)
    return result if out is None else result.write(out)
