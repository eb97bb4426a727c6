"""Every failsafe flown to its end: how it ended, how fast it touched the ground, what the engines gave afterwards.

A flight takes off and hovers for a time that is drawn, in a steady wind from abeam (the axis on which the engines'
delay is felt), or begins in the air, trimmed, holding; what loses the position begins moving ahead, too.  Then
something fails (:mod:`hexjet_prove.surveys.failsafe_flight`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from math import radians
from random import Random
from typing import TYPE_CHECKING, Any

from cosim.base.errors import InputError
from cosim.base.storage.files import to_json_record
from cosim.control.autopilot.requests import (
    Goto,
    InjectFault,
    LinkLost,
    OffboardVelocity,
    SetMode,
    SetParameter,
    Sticks,
)
from cosim.control.predictors.registry import BASELINE, SMITH
from cosim.simulation.autopilot_setup import attach_autopilot
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, aircraft_name
from cosim.studies import EngineDraw, default_draw
from hexjet_prove.surveys.failsafe_flight import (
    LONGEST_S,
    LONGEST_SETTLING_S,
    MOVING_S,
    PER_METRE_S,
    Case,
    FailsafeFlight,
    Row,
    Start,
    Task,
    fly_case,
)
from hexjet_prove.surveys.survey import Progress, Subject, draw_engine, fly_all, load_subject, select_cases
from hexjet_prove.surveys.tipping import tip_speed

if TYPE_CHECKING:
    from cosim.control.autopilot.energy import Energy

# Of docs/tables/failsafes.md, every one that ships with an autopilot; vehicles of one's own by their names.
TABLED = ("hexjet", "hexjet-100", "hexjet-p220", "quadrotor", "octojet", "quadjet", "trijet", "jetwing")
HEIGHTS_M = (3.0, 10.0, 30.0)
TALL_M = (100.0, 300.0)  # heights [m] of flights that wait for the fuel, one flight each
WINDS_M_S = (0.0, 5.0, 10.0)
# Chosen by us.
SPEED_M_S = 5.0  # m/s, speed of moving starts: above any vehicle's cruise, below any drag that the lean cannot hold
MOVING_FROM_M = 10.0  # they begin no lower
HOVER_S = (2.0, 20.0)  # from the end of a take-off until something fails, drawn evenly
GYRO_BIAS = radians(3.0)  # rad/s about the late axis: what a MEMS gyro's zero is off when it was never calibrated


@dataclass(frozen=True)
class Failsafes:
    """The whole table of one vehicle."""

    aircraft: str
    engine: str
    controller: str
    limit_m_s: float  # a leg that touches faster counts as a crash
    trip_m_s: float  # from which it tips over legs that catch: what touches faster sideways has slid
    flights: list[FailsafeFlight]
    airborne: bool = False  # they began in the air
    engine_note: str = ""  # whether an uncertain engine is drawn

    @property
    def rows(self) -> list[Row]:
        """The outcomes of the flights."""
        return [flight.row for flight in self.flights]

    def to_dict(self) -> dict[str, Any]:
        """Return the table for JSON; null where there is no number."""
        return {
            "aircraft": self.aircraft,
            "engine": self.engine,
            "controller": self.controller,
            **({"engine_note": self.engine_note} if self.engine_note else {}),
            "limit_m_s": self.limit_m_s,
            "trip_m_s": self.trip_m_s,
            "rows": [to_json_record(row) for row in self.rows],
        }


def cases(vehicle: Vehicle, airborne: bool = False) -> list[Case]:
    """Return every failsafe, sensors singly and the GNSS with each; without the fuel's if begun in the air."""
    allowed = (SetParameter("SYS_FAILURE_EN", 1.0),)
    gnss = InjectFault("sensor_dropout", sensor="gnss")
    others = (
        ("barometer lost", InjectFault("sensor_dropout", sensor="barometer")),
        ("attitude lost", InjectFault("sensor_dropout", sensor="attitude")),
        ("gyro biased", InjectFault("sensor_bias", sensor="gyro", vector=(GYRO_BIAS, 0.0, 0.0))),
        ("gyro lost", InjectFault("sensor_dropout", sensor="gyro")),
    )
    jets = range(1, len(vehicle.jets) + 1)
    return [
        Case("GNSS lost", allowed, (gnss,), moving=True),
        *(Case(name, allowed, (fault,)) for name, fault in others),
        *(Case(f"GNSS and {name}", allowed, (gnss, fault), moving=True) for name, fault in others),
        *(Case(f"engine {jet} out", allowed, (InjectFault("flame_out", (jet,)),)) for jet in jets),
        Case("ground station lost", (), (LinkLost(),)),
        *([] if airborne else [Case("fuel runs down", (), (), waits=True)]),
        Case("fence passed", (Goto(8.0, 0.0),), (SetParameter("HJ_FENCE_RAD", 1.0),)),
        Case("sticks lost", (), (Sticks(0.0, 0.0, 0.0, 0.5), SetMode("POSCTL")), True),
        Case("set-points lost", (), (OffboardVelocity(0.0, 0.0, 0.0), SetMode("OFFBOARD")), True),
    ]


@dataclass(frozen=True)
class Conditions:
    """What failsafes are flown in.

    ``heights`` empty: 3, 10 and 30 m, and for what waits for the fuel 100 and 300 m too; ``speed`` 0: nothing moves.
    ``flights``: of a cell, each in another of the winds, at a moment drawn by ``seed`` and its place in the table.
    ``airborne``: one flight for each height and wind, which begins in the air, trimmed.  ``nominal_engine``: an engine
    that states its uncertainty is not drawn by it for each flight.
    """

    heights: Sequence[float] = ()
    winds: Sequence[float] = WINDS_M_S
    speed: float = SPEED_M_S
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
        """Return where the flights of a failsafe are when it fails, each with its number in its cell.

        They hold, and what loses the position moves too, from 10 m on, in the least wind if begun in the air.  The
        number is 0 for a flight that begins in the air.
        """
        heights = self.heights or HEIGHTS_M
        moving = [height for height in heights if case.moving and self.speed and height >= MOVING_FROM_M]
        if self.airborne:
            begun = [Start(height, wind) for height in heights for wind in self.winds]
            return [
                (start, 0) for start in (*begun, *(Start(height, min(self.winds), self.speed) for height in moving))
            ]
        if case.waits and not self.heights:
            heights = (*heights, *TALL_M)
        lowest = min(self.winds)
        return [
            (start._replace(wind=start.wind if start.speed else self.winds[(number - 1) % len(self.winds)]), number)
            for start in (*(Start(h, lowest) for h in heights), *(Start(h, lowest, self.speed) for h in moving))
            for number in range(1, 1 + (1 if start.height in TALL_M else self.flights))
        ]


def failsafes(
    aircraft: Sequence[str],
    engine: str | None = None,
    controller: str | None = None,
    kinds: Sequence[str] = (),
    conditions: Conditions = Conditions(),
    workers: int = 2,
    progress: Progress = lambda part, finished, total: None,
) -> Iterator[Failsafes]:
    """Fly every failsafe in all ``conditions``, one vehicle after the other.

    ``kinds`` are the beginnings of those to be flown.  ``engine`` None is the one that the aircraft is made for,
    ``controller`` None smith, or baseline where there is no model.  ``progress`` is told what was flown,
    how many flights are, and of how many.
    Raises InputError for an unknown kind, aircraft, engine or controller, and for a vehicle without an autopilot; all
    of that is found before the first flight.
    """
    conditions.check()
    plans = []
    for name in aircraft:
        subject = load_subject(name, engine)
        plans.append((subject, *_plan(subject, controller, kinds, conditions)))
    finished, total = 0, sum(len(tasks) for *_, tasks, _ in plans)
    for subject, flown, tasks, note in plans:
        label = aircraft_name(subject.aircraft)
        flights = list(fly_all(fly_case, tasks, workers, progress, partial(_describe, label), finished, total))
        finished += len(flights)
        limits = subject.vehicle.limits.touchdown_m_s, tip_speed(subject.aircraft, subject.engine)
        yield Failsafes(label, subject.engine, flown, *limits, flights, conditions.airborne, note)


def _describe(aircraft: str, flight: FailsafeFlight) -> str:
    return f"{aircraft}: {flight.row.failsafe}, {flight.row.start}"


def _plan(
    subject: Subject, controller: str | None, kinds: Sequence[str], conditions: Conditions
) -> tuple[str, list[Task], str]:
    """Return the controller, the flights of one vehicle, and a line on its engine; wrong input is found here."""
    vehicle = subject.vehicle
    chosen = select_cases(cases(vehicle, conditions.airborne), kinds, "failsafe", lambda case: case.name)
    controller = controller or default_controller(subject)
    tasks = [
        Task(case, start, scenario_of(subject, controller, start.height, start.wind), number)
        for case in chosen
        for start, number in conditions.starts(case)
    ]
    with build(tasks[0].scenario) as simulation:
        energy = attach_autopilot(simulation, airborne=True).energy
    draw, note = default_draw(tasks[0].scenario, conditions.nominal_engine)
    tasks = [draw_flight(task, vehicle, energy, conditions.seed) if task.number else task for task in tasks]
    return controller, [_with_engine(task, draw, conditions.seed) for task in tasks], note


def _with_engine(task: Task, draw: EngineDraw | None, seed: int) -> Task:
    name = f"{seed} {task.case.name} {task.start} {task.number}"
    return task._replace(scenario=draw_engine(task.scenario, draw, name))


def draw_flight(task: Task, vehicle: Vehicle, energy: Energy, seed: int) -> Task:
    """Return a flight from the ground on, its moment and noise drawn, the tank as full as the failsafe needs."""
    case, start = task.case, task.start
    draw = Random(f"{seed} {vehicle.name} {case.name} {start} {task.number}")
    hover = float(round(draw.uniform(*HOVER_S)))
    initial: dict[str, Any] = {"on_ground": True}
    if case.waits:
        # of the tank at the end of the hover: what the way down takes with its margin, or the least in per cent
        seconds = (1.0 + energy.margin) * energy.descent_time(start.height)
        reserve = energy.floor
        if vehicle.fuel is None:
            endurance = max(hover / (1.0 - reserve), hover + seconds)
            case = case._replace(first_requests=(SetParameter("HJ_ENDURANCE", float(round(endurance))),))
        else:
            up = energy.burn * (energy.climb_time(start.height) + hover)
            initial["fuel"] = min(1.0, round(up + max(reserve, energy.burn * seconds), 3))
    scenario = task.scenario.replace(initial=initial, seed=draw.randrange(2**31))
    return task._replace(case=case, scenario=scenario, hover=hover)


def default_controller(subject: Subject) -> str:
    """Return smith, or baseline where there is no model."""
    return SMITH.name if SMITH.name in subject.controllers() else BASELINE.name


def scenario_of(subject: Subject, controller: str, height: float, wind: float) -> Scenario:
    """Return the flight of one cell of the table, without what is asked in it; it begins in the air."""
    return subject.scenario(
        "failsafe",
        controller,
        height,
        LONGEST_SETTLING_S + MOVING_S + LONGEST_S + 2.0 * PER_METRE_S * height,
        monitor=subject.vehicle.control.monitor is not None,
        environment={"wind_ned_m_s": [0.0, wind, 0.0]},
    )
