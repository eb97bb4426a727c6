"""What a vehicle survives, and how it comes down: what ``hexjet faults`` calls."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.api.call import Limits, Progress, Table, WholeLine, check_types
from cosim.api.studies import SweepResult
from cosim.base.errors import InputError
from cosim.base.trust import trust_named_code

if TYPE_CHECKING:
    from cosim.studies import Campaign
    from hexjet_prove.surveys.failsafes import FailsafeSurvey
    from hexjet_prove.surveys.faults import FaultSurvey

WORKER_LIMITS = Limits(1, 64)


class SurveyResult(SweepResult):
    """A campaign with a case for each flight of a survey.

    Attributes
    ----------
    survey : FaultSurvey or FailsafeSurvey
        Everything; ``rows`` has a flight each.
    """

    def __init__(self, campaign: Campaign, survey: FaultSurvey | FailsafeSurvey) -> None:
        from cosim.studies import write_campaign_report

        super().__init__(campaign, write_campaign_report(campaign))
        self.survey = survey

    def to_dict(self) -> dict[str, Any]:
        return {"folder": str(self.campaign.folder), "report": str(self.report)} | self.survey.to_dict()

    def lines(self) -> list[str]:
        """Return the flights flown, the rule of judgement, and the command that flies one of them again."""
        return [*self.survey.lines(), WholeLine(f"one flight again: hexjet fly {self.campaign.folder} --flight N")]

    def tables(self) -> list[Table]:
        """Return how the flights of each case ended."""
        head, *lines = self.survey.table()
        return [Table(self.survey.caption, head, lines)]


class FaultsResult(SurveyResult):
    """Result of a survey of faults: which ones a vehicle survives with which controller."""


class FailsafesResult(SurveyResult):
    """Result of a survey of failsafes: how each flight ended."""


@check_types(workers=WORKER_LIMITS)
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

    Leaves a campaign with a case for each fault, place and start; the same again goes on where it was stopped.

    >>> faults(kinds=["gyro bias"], controllers=["smith"], workers=1).verdict
    'hexjet: smith holds 2 of 2 flights'

    Parameters
    ----------
    aircraft : str or Path
        Name or folder.
    engine : str or Path or None
        A name, an FMU or its mapping file; None: that of the aircraft.
    controllers : sequence of str
        Names or files, by default those with a model.
    kinds : sequence of str
        Only faults, or failsafes, that begin so, such as ``flame-out`` or ``GNSS``, by default all.
    limits : bool
        Find out, too, how much thrust may be lost, and how late that may be noticed.
    nominal_engine : bool
        Fly the engine as it is stated, not drawn by its uncertainty.
    workers : int
        Processes.
    out : str or Path or None
        The campaign's folder, whose flights are not flown again; None: a new one in ``runs/``.
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
    from cosim.spec.controller_name import resolve_controller
    from hexjet_prove.surveys.faults import FaultSurvey, plan_faults
    from hexjet_prove.surveys.survey import fly_study

    hears = progress or Progress()
    trust_named_code([*controllers, engine], Path())
    named = [resolve_controller(controller, Path()) for controller in controllers]
    plan = plan_faults(str(aircraft), None if engine is None else str(engine), named, kinds, limits, nominal_engine)
    campaign = fly_study(plan.study, out, workers, hears)
    return FaultsResult(campaign, FaultSurvey(plan, campaign))


@check_types(workers=WORKER_LIMITS, flights=Limits(1, 1000), seed=Limits(0))
def failsafes(
    aircraft: str | Path = "hexjet",
    engine: str | Path | None = None,
    *,
    controllers: Sequence[str] = (),
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
    """Trigger every failure that the autopilot handles, and tell how each flight ended.

    Flown after a take-off to every height and some hover, several times, and moving, with the speeds of touch-down and
    the thrust ten seconds after disarming.

    Parameters
    ----------
    aircraft : str or Path
        Name or folder.
    engine : str or Path or None
        A name, an FMU or its mapping file; None: that of the aircraft.
    controllers : sequence of str
        The one that flies, by default smith, or baseline where there is no model.
    kinds : sequence of str
        Only failsafes that begin so, such as ``GNSS``, by default all.
    heights : sequence of float
        Above the ground [m], by default 3, 10 and 30, and 100 and 300 where the fuel runs down.
    winds : sequence of float
        Of the wind [m/s], by default 0, 5 and 10.
    flights : int
        From each height, each in the next of the winds and at a moment of its own.
    seed : int
        Seed of the moments and the noise.
    airborne : bool
        Begin in the air, trimmed, from every height in every wind once.
    moving : float
        What loses the position also begins at this speed, from 10 m on, in the least wind [m/s]; 0: not.
    nominal_engine : bool
        Fly the engine as it is stated, not drawn by its uncertainty.
    workers : int
        Processes.
    out : str or Path or None
        The campaign's folder, whose flights are not flown again; None: a new one in ``runs/``.
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
    from hexjet_prove.surveys.failsafes import WINDS_M_S, Conditions, FailsafeSurvey, plan_failsafes
    from hexjet_prove.surveys.survey import fly_study

    hears = progress or Progress()
    if len(controllers) > 1:
        raise InputError(f"controllers: {', '.join(controllers)}; allowed: one")
    trust_named_code([engine, *controllers], Path())
    controller = next(iter(controllers), None)
    wind_speeds = tuple(winds) or WINDS_M_S
    conditions = Conditions(tuple(heights), wind_speeds, moving, flights, airborne, seed, nominal_engine)
    plan = plan_failsafes(str(aircraft), None if engine is None else str(engine), controller, kinds, conditions)
    campaign = fly_study(plan.study, out, workers, hears)
    return FailsafesResult(campaign, FailsafeSurvey(plan, campaign))
