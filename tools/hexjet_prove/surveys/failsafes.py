"""Every failsafe flown to its end: how it ended, how fast it touched the ground, what the engines gave afterwards.

A flight takes off and hovers for a time that is drawn, in a steady wind from abeam (the axis on which the engines'
delay is felt), or begins in the air, trimmed, holding; what loses the position begins moving ahead, too.  Then
something fails (:mod:`hexjet_prove.surveys.failsafe_flight`).  All flights are one study with a case each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isnan, nan
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, NamedTuple

from cosim.base.errors import InputError
from cosim.base.outcomes import Verdict
from cosim.base.storage.files import to_json_record
from cosim.control.predictors.registry import BASELINE, SMITH
from cosim.simulation.autopilot_setup import attach_autopilot
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, aircraft_name
from cosim.studies import Campaign, Study, default_draw
from hexjet_prove.surveys.failsafe_cases import Case, cases
from hexjet_prove.surveys.failsafe_flight import MAX_FLIGHT_S, MAX_S_PER_METRE, MAX_SETTLING_S, MEASURED, OWN, STEADY_S
from hexjet_prove.surveys.survey import Subject, load_subject, make_study, select_cases
from hexjet_prove.surveys.tipping import tip_speed

if TYPE_CHECKING:
    from cosim.control.autopilot.energy import Energy

HEIGHTS_M = (3.0, 10.0, 30.0)  # heights at the failure
FUEL_HEIGHTS_M = (100.0, 300.0)  # where low fuel is waited for
WINDS_M_S = (0.0, 5.0, 10.0)  # winds flown
# Chosen by us: range of the time from take-off to the failure.
HOVER_RANGE_S = (2.0, 20.0)


class Start(NamedTuple):
    """State at the failure: height m, wind from abeam m/s, forward speed m/s (0: hover)."""

    height: float
    wind: float
    speed: float = 0.0

    def __str__(self) -> str:
        return f"{self.height:g} m, {self.wind:g} m/s" + (f", moving at {self.speed:g} m/s" if self.speed else "")


@dataclass(frozen=True)
class Row:
    """Result of one flight; NaN if there is no number."""

    failsafe: str
    height_m: float
    wind_m_s: float
    speed_m_s: float  # forward, at the failure; 0: it hovered
    verdict: Verdict
    touchdown_m_s: float  # sink rate in the step before touchdown
    sideways_m_s: float  # ground speed just before touchdown
    thrust_n: float  # of all engines, 10 s after disarming
    after_s: float  # s from the failure to touchdown
    drift_m: float  # m from the failure to the end
    reason: str  # of a crash, or of the failsafe
    # Distance at the end from the place, and from the height, that a holding vehicle was to keep.
    off_m: float
    height_off_m: float
    log_sha256: str  # hash of all samples of the flight
    number: int = 0  # in its cell; 0: began in the air
    hover_s: float = nan  # from take-off to the failure
    margin_m_s: float = nan  # of touchdown; below 0: too fast
    margin_m: float = nan  # of holding; below 0: it did not
    flight: int = 0  # number of the flight in the campaign


@dataclass(frozen=True)
class Conditions:
    """Conditions of failsafe flights.

    ``heights`` empty: 3, 10 and 30 m, and for what waits for the fuel 100 and 300 m too; ``speed`` 0: nothing moves.
    ``flights``: of a cell, each in another of the winds, at a moment drawn by ``seed`` and its place in the table.
    ``airborne``: one flight for each height and wind, which begins in the air, trimmed.  ``nominal_engine``: an engine
    that states its uncertainty is not drawn by it for each flight.
    """

    heights: Sequence[float] = ()
    winds: Sequence[float] = WINDS_M_S
    speed: float = 5.0  # m/s, above cruise, below a full lean's
    flights: int = 3
    airborne: bool = False
    seed: int = 0
    nominal_engine: bool = False

    def check(self) -> None:
        """Raise InputError for what cannot be flown."""
        for name, values, least, most, unit in (
            ("speed", (self.speed,), 0, 20, "m/s"),
            ("height", self.heights, 1, 1000, "m"),
            ("wind", self.winds, 0, 50, "m/s"),
        ):
            for value in values:
                if not least <= value <= most:
                    raise InputError(f"{name} {value:g} {unit}: must be from {least} to {most} {unit}")

    def starts(self, case: Case) -> list[tuple[Start, int]]:
        """Return the states at the failure, each with its number in its cell.

        They hold, and what loses the position moves too, from 10 m on, in the least wind if begun in the air.  The
        number is 0 for a flight that begins in the air.
        """
        heights = self.heights or HEIGHTS_M
        moving = [height for height in heights if case.moving and self.speed and height >= 10.0]
        if self.airborne:
            begun = [Start(height, wind) for height in heights for wind in self.winds]
            return [
                (start, 0) for start in (*begun, *(Start(height, min(self.winds), self.speed) for height in moving))
            ]
        if case.waits and not self.heights:
            heights = (*heights, *FUEL_HEIGHTS_M)
        lowest = min(self.winds)
        return [
            (start._replace(wind=start.wind if start.speed else self.winds[(number - 1) % len(self.winds)]), number)
            for start in (*(Start(h, lowest) for h in heights), *(Start(h, lowest, self.speed) for h in moving))
            for number in range(1, 1 + (1 if start.height in FUEL_HEIGHTS_M else self.flights))
        ]


class PlannedFlight(NamedTuple):
    """One planned flight of a study."""

    case: Case
    start: Start
    number: int  # in its cell; 0: begins in the air

    @property
    def name(self) -> str:
        """The name of its case in the study."""
        height, wind, speed = self.start
        return (
            f"{self.case.name.lower().replace(' ', '-')}-{height:g}m-{wind:g}m_s"
            + (f"-at-{speed:g}m_s" if speed else "")
            + (f"-{self.number}" if self.number else "")
        )


class FailsafePlan(NamedTuple):
    """Study of a failsafe survey, and its flights by case."""

    subject: Subject
    controller: str
    trip_m_s: float
    study: Study
    flights: dict[str, PlannedFlight]  # by name of the case
    airborne: bool
    engine_note: str


def plan_failsafes(
    aircraft: str,
    engine: str | None = None,
    controller: str | None = None,
    kinds: Sequence[str] = (),
    conditions: Conditions = Conditions(),
) -> FailsafePlan:
    """Return the study of every failsafe in all ``conditions``.

    ``kinds`` are the beginnings of those to be flown.  ``engine`` None is the one that the aircraft is made for,
    ``controller`` None smith, or baseline where there is no model.
    Raises InputError for an unknown kind, aircraft, engine or controller, and for a vehicle without an autopilot.
    """
    conditions.check()
    subject = load_subject(aircraft, engine)
    chosen = select_cases(cases(subject.vehicle, conditions.airborne), kinds, "failsafe", lambda case: case.name)
    controller = controller or default_controller(subject)
    planned = [PlannedFlight(case, *start) for case in chosen for start in conditions.starts(case)]
    scenario = scenario_of(subject, controller, planned[0].start.height, planned[0].start.wind)
    with build(scenario) as simulation:
        energy = attach_autopilot(simulation, airborne=True).energy
    draw, note = default_draw(scenario, conditions.nominal_engine)
    trip, name = tip_speed(subject.aircraft, subject.engine), aircraft_name(subject.aircraft)
    tables = []
    for each in planned:
        height, wind, _ = each.start
        settings = {"seed": scenario.seed, **flight_settings(subject, height, wind)}
        table: dict[str, Any] = {"failsafe": each.case.name, "height_m": height, "speed_m_s": each.start.speed}
        if each.number:
            drawn, more = draw_flight(each, subject.vehicle, energy, conditions.seed)
            settings |= drawn
            table |= {"number": each.number} | more
        if draw is not None:
            settings |= draw.draw_by_name(f"{conditions.seed} {each.case.name} {each.start} {each.number}")
        tables.append({"name": each.name, "settings": settings, "autopilot": table})
    tallest = max(each.start.height for each in planned)
    study = make_study(
        f"failsafes-{name}",
        f"Every failsafe of {name}, engine {subject.engine}",
        flight_settings(subject, tallest, 0.0) | {"controller": controller},
        tables,
        autopilot={"name": "failsafes"} | ({} if trip == inf else {"trip_m_s": trip}),
    )
    flights = {each.name: each for each in planned}
    return FailsafePlan(subject, controller, trip, study, flights, conditions.airborne, note)


class FailsafeSurvey:
    """Flights of all failsafes of one vehicle: one row each."""

    caption = "the fastest touch-down and the most thrust of all flights of a cell"

    def __init__(self, plan: FailsafePlan, campaign: Campaign) -> None:
        self.aircraft, self.engine = aircraft_name(plan.subject.aircraft), plan.subject.engine
        self.controller, self.engine_note = plan.controller, plan.engine_note
        # A leg that touches faster counts as a crash; a sideways speed above the tipping speed counts as a slide.
        self.limit_m_s, self.trip_m_s = plan.subject.vehicle.limits.touchdown_m_s, plan.trip_m_s
        self.rows = [_make_row(plan.flights[str(row["case"])], row) for row in map(campaign.row, range(len(campaign)))]

    def to_dict(self) -> dict[str, Any]:
        """Return the table for JSON, null if there is no number."""
        return {
            "aircraft": self.aircraft,
            "engine": self.engine,
            "controller": self.controller,
            **({"engine_note": self.engine_note} if self.engine_note else {}),
            "limit_m_s": self.limit_m_s,
            "trip_m_s": self.trip_m_s,
            "rows": [to_json_record(row) for row in self.rows],
        }

    def table(self) -> list[list[str]]:
        """Return a line for each failsafe and a column for each start: the head and the lines of a table."""
        rows = sorted(self.rows, key=lambda row: (row.speed_m_s > 0.0, row.height_m))
        columns = list(dict.fromkeys(map(_make_title, rows)))
        cells: dict[tuple[str, str], list[Row]] = {}
        for row in self.rows:
            cells.setdefault((row.failsafe, _make_title(row)), []).append(row)
        names = dict.fromkeys(row.failsafe for row in self.rows)
        lines = [[name, *(format_cell(cells.get((name, column), ())) for column in columns)] for name in names]
        return [["failsafe", *columns], *lines]

    def lines(self) -> list[str]:
        """Return what flew, and what counts as a crash."""
        return [
            f"{self.aircraft}, {self.engine}, {self.controller}: {len(self.rows)} flights",
            f"a leg that touches faster than {self.limit_m_s:.2f} m/s counts as a crash; faster than "
            f"{self.trip_m_s:.2f} m/s sideways it has slid",
            *([self.engine_note] if self.engine_note else []),
        ]


def _make_row(planned: PlannedFlight, row: Mapping[str, Any]) -> Row:
    values: dict[str, Any] = {name: nan if row[OWN + name] is None else row[OWN + name] for name in MEASURED}
    values |= {name: row[name] for name in ("reason", "log_sha256", "flight")}
    return Row(planned.case.name, *planned.start, verdict=Verdict(row["verdict"]), number=planned.number, **values)


def draw_flight(
    planned: PlannedFlight, vehicle: Vehicle, energy: Energy, seed: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return settings and autopilot's table of a flight from the ground on.

    Its moment and noise are drawn, the tank is as full as the failsafe needs.
    """
    case, start, number = planned
    draw = Random(f"{seed} {vehicle.name} {case.name} {start} {number}")
    hover = float(round(draw.uniform(*HOVER_RANGE_S)))
    initial: dict[str, Any] = {"on_ground": True}
    table = {"hover_s": hover}
    if case.waits:
        # Of the tank at the end of the hover: fuel for the descent with its margin, or the per-cent threshold.
        seconds = (1.0 + energy.margin) * energy.descent_time(start.height)
        reserve = energy.floor
        if vehicle.fuel is None:
            table["endurance_s"] = float(round(max(hover / (1.0 - reserve), hover + seconds)))
        else:
            up = energy.burn * (energy.climb_time(start.height) + hover)
            initial["fuel"] = min(1.0, round(up + max(reserve, energy.burn * seconds), 3))
    return {"initial": initial, "seed": draw.randrange(2**31)}, table


def default_controller(subject: Subject) -> str:
    """Return smith, or baseline without a model."""
    return SMITH.name if SMITH.name in subject.controllers() else BASELINE.name


def flight_settings(subject: Subject, height: float, wind: float) -> dict[str, Any]:
    """Return the settings of a flight that begins in the air, without its requests."""
    return subject.settings(
        height,
        MAX_SETTLING_S + STEADY_S + MAX_FLIGHT_S + 2.0 * MAX_S_PER_METRE * height,
        monitor=subject.vehicle.control.monitor is not None,
        environment={"wind_ned_m_s": [0.0, wind, 0.0]},
    )


def scenario_of(subject: Subject, controller: str, height: float, wind: float) -> Scenario:
    """Return the scenario of one case that begins in the air, without its requests."""
    settings = flight_settings(subject, height, wind)
    return Scenario.from_table(settings | {"name": "failsafe", "controller": controller}, Path(), "failsafe")


def _make_title(row: Row) -> str:
    """Return the title of the column that a flight is shown in."""
    return f"{row.height_m:g} m" + (f", moving at {row.speed_m_s:g} m/s" if row.speed_m_s else "")


def format_cell(rows: Sequence[Row]) -> str:
    """Return the cell of several flights of the page's table: how many ended how, and the worst numbers of all."""
    if not rows:
        return "-"
    counts: dict[str, list[Row]] = {}
    for row in sorted(rows, key=lambda row: row.verdict not in ("landed", "holds")):
        counts.setdefault(row.verdict, []).append(row)
    ends = []
    for verdict, flights in counts.items():
        end = f"{len(flights)} of {len(rows)} {verdict}"
        if verdict not in ("landed", "holds", "refused"):
            end += f" (wind {' and '.join(f'{wind:g}' for wind in sorted({row.wind_m_s for row in flights}))} m/s)"
        ends.append(end)

    numbers = (
        (_max_value(rows, "off_m"), "{:.2f} m off"),
        (_max_value(rows, "touchdown_m_s"), "{:.2f} m/s"),
        (_max_value(rows, "sideways_m_s"), "sideways {:.2f} m/s"),
        (_max_value(rows, "drift_m") if rows[0].failsafe.startswith("GNSS") else nan, "{:.1f} m away"),
        (_max_value(rows, "thrust_n"), "{:.1f} N"),
    )
    return ", ".join([*ends, *(form.format(value) for value, form in numbers if not isnan(value))])


def _max_value(rows: Sequence[Row], column: str) -> float:
    """Return the largest number of a column; NaN without one."""
    return max((value for row in rows if not isnan(value := getattr(row, column))), default=nan)
