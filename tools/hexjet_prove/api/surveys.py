"""What a vehicle survives, and how it comes down: what ``hexjet faults`` and ``hexjet failsafes`` call."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.api.call import FolderResult, Limits, Progress, Table, checked
from cosim.base.trust import mention

if TYPE_CHECKING:
    from hexjet_prove.surveys.failsafes import Failsafes
    from hexjet_prove.surveys.faults import Survival

WRITTEN = ("survival.csv", "survival.html", "cases")
AIRBORNE = ("failsafe", "wind, m/s", "moving, m/s", "ended", "down, m/s", "sideways, m/s", "thrust 10 s later, N")
WORKERS = Limits(1, 64)


class FaultsResult(FolderResult):
    """Which single faults a vehicle survives, with which controller.

    ``write`` leaves ``survival.csv``, ``survival.html`` and every flight as a scenario in ``cases``.

    Attributes
    ----------
    survival : Survival
        Everything; ``rows`` has a flight each.
    """

    def __init__(self, survival: Survival) -> None:
        self.survival = survival
        self.files = {}

    def _write(self, folder: Path) -> dict[str, Path]:
        from hexjet_prove.surveys.fault_page import write

        return write(self.survival, folder)

    def to_dict(self) -> dict[str, Any]:
        """Return what ``hexjet faults --json`` prints."""
        return self.survival.to_dict()

    def lines(self) -> list[str]:
        """Return how many flights are held by each controller, and what is to be said of the engine."""
        from cosim.spec.controller_name import label
        from hexjet_prove.surveys.faults import summary

        result = self.survival
        controllers, survived = summary(result)
        counts = [
            (sum(cells[k].held for *_, cells in survived), sum(cells[k].flights for *_, cells in survived))
            for k in range(len(controllers))
        ]
        flown = [
            f"{result.aircraft}: {label(name)} holds {held} of {flights} flights"
            for name, (held, flights) in zip(controllers, counts, strict=True)
        ]
        return [*flown, *([result.engine_note] if result.engine_note else []), *result.warnings]

    def tables(self) -> list[Table]:
        """Return at how many of its places each fault is held, and what is left where jets are lost."""
        from cosim.spec.controller_name import label
        from hexjet_prove.surveys.faults import summary

        controllers, survived = summary(self.survival)
        held = []
        for kind, start, cells in survived:
            times = [time for cell in cells if cell.detected_s for time in cell.detected_s]
            columns = [f"{cell.held}/{cell.flights}  {cell.lean_deg:3.0f} deg {cell.lost_m:4.1f} m" for cell in cells]
            held.append((kind, start, *columns, f"{min(times):.3f} to {max(times):.3f}" if times else "-"))
        left = []
        for attainable in self.survival.attainable:
            roll = "cannot hover" if attainable.roll is None else f"{100.0 * attainable.roll:.0f} %"
            lost = ", ".join(map(str, attainable.lost)) or "none"
            left.append((lost, f"{attainable.thrust:.2f}", roll, "yes" if attainable.yaw else "no"))
        return [
            Table("", ("fault", "from", *map(label, controllers), "detected, s"), held),
            Table("", ("lost jets", "thrust over weight", "roll authority", "yaw balanced"), left),
        ]


@checked(workers=WORKERS)
def faults(
    aircraft: str | Path = "hexjet",
    engine: str | Path | None = None,
    *,
    controllers: Sequence[str] = (),
    kinds: Sequence[str] = (),
    limits: bool = False,
    nominal_engine: bool = False,
    workers: int = 2,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> FaultsResult:
    """Fly every single fault, from hover and from a roll of 10 deg, and tell which the vehicle survives.

    Parameters
    ----------
    aircraft : str or Path
        Name or folder.
    engine : str or Path or None
        A name, an FMU or its mapping file; None: the aircraft's own.
    controllers : sequence of str
        Names or files; none: those with a model.
    kinds : sequence of str
        Only faults that begin so, such as ``flame-out``; none: all.
    limits : bool
        Whether it is found, too, how much thrust may be lost, and how late that may be noticed.
    nominal_engine : bool
        Whether the engine flies as it is stated, not drawn by its uncertainty.
    workers : int
        Processes.
    out : str or Path or None
        A folder for table, page and flights; without it nothing is written.
    progress : Progress or None
        Hears how far it is.

    Returns
    -------
    FaultsResult
        A row for each flight, and what is held by each controller.

    Raises
    ------
    InputError
        For an aircraft, an engine, a controller or a fault that there is none of.
    """
    from cosim.base.storage.files import check_results_folder
    from cosim.spec.controller_name import seen_from
    from hexjet_prove.surveys.faults import survival

    hears = progress or Progress()
    check_results_folder(out, *WRITTEN)
    mention([*controllers, engine], Path())
    named = [seen_from(controller, Path()) for controller in controllers]
    flown = None if engine is None else str(engine)
    result = FaultsResult(
        survival(str(aircraft), flown, named, list(kinds), workers, hears.update, limits, nominal_engine)
    )
    return result if out is None else result.write(out)


class FailsafesResult(FolderResult):
    """How flights end after what an autopilot has an answer to.

    ``write`` leaves ``failsafes.csv``, and every flight as a scenario in ``flights``.

    Attributes
    ----------
    survey : Failsafes
        Everything; ``rows`` has a flight each.
    """

    def __init__(self, survey: Failsafes) -> None:
        self.survey = survey
        self.files = {}

    def _write(self, folder: Path) -> dict[str, Path]:
        from hexjet_prove.surveys.failsafe_table import write

        return {"table": write(self.survey, folder)}

    def to_dict(self) -> dict[str, Any]:
        """Return what ``hexjet failsafes --json`` prints."""
        return self.survey.to_dict()

    def lines(self) -> list[str]:
        """Return what flew, and what counts as a crash."""
        found = self.survey
        first = f"{found.aircraft}, {found.engine}, {found.controller}: {len(found.rows)} flights"
        limits = (
            f"a leg that touches faster than {found.limit_m_s:.2f} m/s counts as a crash; faster than "
            f"{found.trip_m_s:.2f} m/s sideways it has slid"
        )
        return [first, limits, *([found.engine_note] if found.engine_note else [])]

    def tables(self) -> list[Table]:
        """Return how the flights of each failsafe ended."""
        from hexjet_prove.surveys.failsafe_table import grid, summary

        if not self.survey.airborne:
            head, *lines = grid(self.survey)
            return [Table("", head, lines)]
        rows = []
        for row in summary(self.survey):
            worst = [
                "-" if value != value else f"{value:{form}}"
                for value, form in ((row.touchdown_m_s, ".2f"), (row.sideways_m_s, ".2f"), (row.thrust_n, ".1f"))
            ]
            rows.append((row.failsafe, f"{row.wind_m_s:g}", f"{row.speed_m_s:g}", row.ends, *worst))
        return [Table("", AIRBORNE, rows)]


@checked(workers=WORKERS, flights=Limits(1, 1000), seed=Limits(0))
def failsafes(
    aircraft: str | Path = "hexjet",
    engine: str | Path | None = None,
    *,
    controller: str | None = None,
    kinds: Sequence[str] = (),
    heights: Sequence[float] = (),
    winds: Sequence[float] = (),
    flights: int = 3,
    seed: int = 0,
    airborne: bool = False,
    moving: float = 5.0,
    nominal_engine: bool = False,
    workers: int = 2,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> FailsafesResult:
    """Let everything fail that the autopilot has an answer to, and tell how each flight ended.

    Parameters
    ----------
    aircraft : str or Path
        Name or folder.
    engine : str or Path or None
        A name, an FMU or its mapping file; None: the aircraft's own.
    controller : str or None
        A name or a file; None: smith, or baseline where there is no model.
    kinds : sequence of str
        Only failsafes that begin so, such as ``GNSS``; none: all.
    heights : sequence of float
        Above the ground [m]; none: 3, 10 and 30, and 100 and 300 where the fuel runs down.
    winds : sequence of float
        [m/s]; none: 0, 5 and 10.
    flights : int
        From each height, each in the next of the winds and at a moment of its own.
    seed : int
        Seed of the moments and the noise.
    airborne : bool
        Whether it begins in the air, trimmed, from every height in every wind once.
    moving : float
        What loses the position also begins at this speed, from 10 m on, in the least wind [m/s]; 0: not.
    nominal_engine : bool
        Whether the engine flies as it is stated, not drawn by its uncertainty.
    workers : int
        Processes.
    out : str or Path or None
        A folder for table and flights; without it nothing is written.
    progress : Progress or None
        Hears how far it is.

    Returns
    -------
    FailsafesResult
        A row for each flight.

    Raises
    ------
    InputError
        For an aircraft, an engine, a controller or a failsafe that there is none of, and a vehicle without an
        autopilot.
    """
    from hexjet_prove.surveys.failsafes import WINDS_M_S, Conditions
    from hexjet_prove.surveys.failsafes import failsafes as fly_all

    hears = progress or Progress()
    mention([engine, controller], Path())
    wind_speeds = tuple(winds) or WINDS_M_S
    conditions = Conditions(tuple(heights), wind_speeds, moving, flights, airborne, seed, nominal_engine)
    flown = None if engine is None else str(engine)
    result = FailsafesResult(
        next(iter(fly_all([str(aircraft)], flown, controller, list(kinds), conditions, workers, hears.update)))
    )
    return result if out is None else result.write(out)
