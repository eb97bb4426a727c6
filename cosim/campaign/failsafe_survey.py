"""Every failsafe flown to its end: how it ended, how fast it touched the ground, what the engines gave afterwards.

A flight takes off and hovers for a time that is drawn, in a steady wind from abeam (the axis on which the engines'
delay is felt), or begins in the air, trimmed, holding; what loses the position begins moving ahead, too.  Then
something fails, the autopilot is told nothing but what a ground station would say, and the flight goes on until the
vehicle has been disarmed for ten seconds, has crashed, or time is up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import hypot, isnan, nan, radians
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from cosim.base.errors import InputError
from cosim.base.storage.files import finite
from cosim.campaign.fault_survey import Say, controllers_for, step_of
from cosim.campaign.tipping import tip_speed
from cosim.campaign.workers.tasks import in_order
from cosim.control.autopilot.modes import LandedState, Mode
from cosim.control.autopilot.requests import (
    Arm,
    Goto,
    InjectFault,
    LinkLost,
    OffboardVelocity,
    Request,
    SetMode,
    SetParameter,
    Sticks,
    Takeoff,
)
from cosim.control.predictors.registry import BASELINE, SMITH
from cosim.results.autopilot.request_log import Entry
from cosim.results.columns import log_columns, logged_vehicle
from cosim.results.digest import DigestSink
from cosim.results.recorder import Recorder
from cosim.simulation.build import build
from cosim.simulation.with_autopilot import with_autopilot
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, aircraft_name, aircraft_seen_from, engine_of, load_vehicle

if TYPE_CHECKING:
    from cosim.base.signals import Sample
    from cosim.control.autopilot.autopilot import Autopilot
    from cosim.control.autopilot.energy import Energy
    from cosim.simulation.ending import Ending
    from cosim.simulation.step import Simulation

Verdict = Literal["landed", "slid", "holds", "flies on", "stands armed", "crashed", "lost", "refused"]

# Of docs/failsafes.md, every one that ships with an autopilot; vehicles of one's own by their names.
TABLED = ("hexjet", "hexjet-100", "hexjet-p220", "quadrotor", "octojet", "quadjet", "trijet", "jetwing")
HEIGHTS_M = (3.0, 10.0, 30.0)
TALL_M = (100.0, 300.0)  # for what waits for the fuel, one flight each
WINDS_M_S = (0.0, 5.0, 10.0)
# Chosen by us.
SPEED_M_S = (
    5.0  # of the moving starts: faster than any vehicle's cruise, slower than any drag that the lean cannot hold
)
MOVING_FROM_M = 10.0  # they begin no lower
MOVING_S = 10.0  # on the way before anything fails: twice what reaching the speed and learning the drag there take
FAR_M = 1000.0  # where a moving start is on its way to
SETTLED_S = 5.0  # holding before anything fails, at least
SLOW_M_S, SLOW_S = 0.3, 1.0  # and slower than this for so long, so that it does hold where the wind took it at first
LONGEST_SETTLING_S = 60.0  # it fails then, whatever the speed
LONGEST_S = 180.0  # from the failure on: three times the descent from 30 m at the landing's rate
PER_METRE_S = 4.0  # beside that, for each metre of height: slower than any vehicle climbs or descends
LATER_S = 10.0  # after disarming
DISARMED_S = 1.0  # the same of all flights of a cell but the first
STANDING_S = 1.1  # on the ground before it is armed: home is known by then
HOVER_S = (2.0, 20.0)  # from the end of a take-off until something fails, drawn evenly
HELD_S = 8.0  # it is to hold for at least so long, and until it is slow near its place
HELD_M = 1.5  # and counts as holding within this of the place: what a waypoint is reached within (HJ_ACC_RADIUS)
HELD_HEIGHT_M = 0.4  # and within this of the height: what a climb is over within
LONGEST_HOLD_S = 60.0
GYRO_BIAS = radians(3.0)  # rad/s about the late axis: what a MEMS gyro's zero is off when it was never calibrated


@dataclass(frozen=True)
class Case:
    """One failsafe: requests from the beginning of the flight on, and those with which it is called."""

    name: str
    before: tuple[Request, ...]
    calls: tuple[Request, ...]
    holds: bool = False  # it ends in HOLD, not on the ground
    moving: bool = False  # flown without a position from then on, so it also begins moving
    waits: bool = False  # nothing is called: the fuel runs down until the autopilot acts


class Start(NamedTuple):
    """Where a flight is when something fails: m, m/s from abeam, m/s ahead (0: it holds)."""

    height: float
    wind: float
    speed: float = 0.0

    def __str__(self) -> str:
        return f"{self.height:g} m, {self.wind:g} m/s" + (f", moving at {self.speed:g} m/s" if self.speed else "")


@dataclass(frozen=True)
class Row:
    """What became of one flight."""

    failsafe: str
    height_m: float
    wind_m_s: float
    speed_m_s: float  # ahead, as it failed; 0: it held
    verdict: Verdict
    touchdown_m_s: float  # the fastest sinking in the step before a leg touched; NaN: none did
    sideways_m_s: float  # the fastest over the ground in such a step; NaN: none touched
    thrust_n: float  # of all engines together, ten seconds after disarming; NaN: it was not disarmed
    after_s: float  # from the failure to the first touch; NaN: none
    drift_m: float  # from where it was when it failed to where it ended
    reason: str  # of a crash; else what the autopilot said it acted upon
    # of what is to hold, at the end, from the place and the height that it was to hold; NaN: another failsafe
    off_m: float
    height_off_m: float
    log_sha256: str  # of every sample of the flight (cosim.results.digest): what flies it again must have the same
    number: int = 0  # of the flights of its cell; 0: it began in the air
    hover_s: float = nan  # from the end of the take-off until it failed, or less where the fuel did not last; NaN: none

    @property
    def start(self) -> Start:
        return Start(self.height_m, self.wind_m_s, self.speed_m_s)


@dataclass(frozen=True)
class FailsafeFlight:
    """A row, and what flies it again."""

    row: Row
    scenario: Scenario
    entries: tuple[Entry, ...]


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

    @property
    def rows(self) -> list[Row]:
        return [flight.row for flight in self.flights]

    def to_dict(self) -> dict[str, Any]:
        """For JSON; null where there is no number."""
        return {
            "aircraft": self.aircraft,
            "engine": self.engine,
            "controller": self.controller,
            "limit_m_s": self.limit_m_s,
            "trip_m_s": self.trip_m_s,
            "rows": [finite(row) for row in self.rows],
        }


def cases(vehicle: Vehicle, airborne: bool = False) -> list[Case]:
    """Every failsafe of the autopilot, sensors singly and the GNSS with each; the fuel's not if begun in the air."""
    allowed = (SetParameter("SYS_FAILURE_EN", 1.0),)
    gnss = InjectFault("sensor_dropout", sensor="gnss")
    others = (
        ("barometer lost", InjectFault("sensor_dropout", sensor="barometer")),
        ("attitude lost", InjectFault("sensor_dropout", sensor="attitude")),
        ("gyro biased", InjectFault("sensor_bias", sensor="gyro", vector=(GYRO_BIAS, 0.0, 0.0))),
        ("gyro lost", InjectFault("sensor_dropout", sensor="gyro")),
    )
    kinds = [Case("GNSS lost", allowed, (gnss,), moving=True)]
    kinds += [Case(name, allowed, (fault,)) for name, fault in others]
    kinds += [Case(f"GNSS and {name}", allowed, (gnss, fault), moving=True) for name, fault in others]
    kinds += [
        Case(f"engine {jet} out", allowed, (InjectFault("flame_out", (jet,)),))
        for jet in range(1, len(vehicle.jets) + 1)
    ]
    centred = Sticks(0.0, 0.0, 0.0, 0.5)
    return [
        *kinds,
        Case("ground station lost", (), (LinkLost(),)),
        *([] if airborne else [Case("fuel runs down", (), (), waits=True)]),
        Case("fence passed", (Goto(8.0, 0.0),), (SetParameter("HJ_FENCE_RAD", 1.0),)),
        Case("sticks lost", (), (centred, SetMode("POSCTL")), True),
        Case("set-points lost", (), (OffboardVelocity(0.0, 0.0, 0.0), SetMode("OFFBOARD")), True),
    ]


def starts(case: Case, heights: Sequence[float], winds: Sequence[float], speed: float) -> list[Start]:
    """Holding at every height in every wind; and moving at ``speed`` (0: not), from 10 m on, in the least wind."""
    begun = [Start(height, wind) for height in heights for wind in winds]
    if case.moving and speed:
        begun += [Start(height, min(winds), speed) for height in heights if height >= MOVING_FROM_M]
    return begun


class Task(NamedTuple):
    """One flight that is to be flown."""

    case: Case
    start: Start
    scenario: Scenario
    number: int = 0  # of the flights of its cell; 0: it begins in the air
    hover: float = 0.0  # s from the end of the take-off until something fails


@dataclass(frozen=True)
class Conditions:
    """What failsafes are flown in.

    ``heights`` empty: 3, 10 and 30 m, and for what waits for the fuel 100 and 300 m too; ``speed`` 0: nothing moves.
    ``flights``: of a cell, each in another of the winds, at a moment drawn by ``seed`` and its place in the table.
    ``airborne``: one flight for each height and wind, which begins in the air, trimmed.
    """

    heights: Sequence[float] = ()
    winds: Sequence[float] = WINDS_M_S
    speed: float = SPEED_M_S
    flights: int = 3
    airborne: bool = False
    seed: int = 0

    def check(self) -> None:
        """Raises InputError for what cannot be flown."""
        if not 0.0 <= self.speed <= 20.0:
            raise InputError(f"speed {self.speed:g} m/s: must be from 0 to 20 m/s")
        for height in self.heights:
            if not 1.0 <= height <= 1000.0:
                raise InputError(f"height {height:g} m: must be from 1 to 1000 m")
        for wind in self.winds:
            if not 0.0 <= wind <= 50.0:
                raise InputError(f"wind {wind:g} m/s: must be from 0 to 50 m/s")

    def starts(self, case: Case) -> list[tuple[Start, int]]:
        """Where the flights of a failsafe are when it fails, each with its number in its cell; 0: begun in the air."""
        heights = self.heights or HEIGHTS_M
        if self.airborne:
            return [(start, 0) for start in starts(case, heights, self.winds, self.speed)]
        if case.waits and not self.heights:
            heights = (*heights, *TALL_M)
        begun = []
        for place in starts(case, heights, (min(self.winds),), self.speed):
            for number in range(1, 1 + (1 if place.height in TALL_M else self.flights)):
                wind = place.wind if place.speed else self.winds[(number - 1) % len(self.winds)]
                begun.append((place._replace(wind=wind), number))
        return begun


@dataclass(frozen=True)
class _Plan:
    """What is to be flown with one vehicle."""

    aircraft: str
    engine: str
    controller: str
    flights: list[Task]


def failsafes(
    aircraft: Sequence[str],
    engine: str | None = None,
    controller: str | None = None,
    kinds: Sequence[str] = (),
    conditions: Conditions = Conditions(),
    workers: int = 2,
    say: Say = lambda what, done, of: None,
) -> Iterator[Failsafes]:
    """Fly every failsafe in all ``conditions``, one vehicle after the other.

    ``kinds`` are the beginnings of those to be flown.  ``engine`` None is the one that the aircraft is made for,
    ``controller`` None smith, or baseline where there is no model.  ``say`` is told what was flown, how many are, of
    how many.
    Raises InputError for an unknown kind, aircraft, engine or controller, and for a vehicle without an autopilot; all
    of that is found before the first flight.
    """
    conditions.check()
    plans = [_plan(name, engine, controller, kinds, conditions) for name in aircraft]
    done, of = 0, sum(len(plan.flights) for plan in plans)
    for plan in plans:
        flights: list[FailsafeFlight] = []
        for flight in in_order(fly_case, plan.flights, workers):
            flights.append(flight)
            done += 1
            say(f"{aircraft_name(plan.aircraft)}: {flight.row.failsafe}, {flight.row.start}", done, of)
        vehicle, _ = load_vehicle(plan.aircraft)
        limits = vehicle.limits.touchdown_m_s, tip_speed(plan.aircraft, plan.engine)
        name = aircraft_name(plan.aircraft)
        yield Failsafes(name, plan.engine, plan.controller, *limits, flights, conditions.airborne)


def _plan(
    aircraft: str, engine: str | None, controller: str | None, kinds: Sequence[str], conditions: Conditions
) -> _Plan:
    aircraft = aircraft_seen_from(aircraft, Path())
    vehicle, _ = load_vehicle(aircraft)
    engine = engine or engine_of(aircraft) or Scenario.model_fields["engine"].default
    step = step_of(aircraft)
    known = cases(vehicle, conditions.airborne)
    chosen = [case for case in known if not kinds or case.name.startswith(tuple(kinds))]
    if not chosen:
        names = ", ".join(case.name for case in known)
        raise InputError(f"no failsafe begins with {' or '.join(map(repr, kinds))}; there are: {names}")
    if controller is None:
        modelled = SMITH.name in controllers_for(aircraft, engine, step)
        controller = SMITH.name if modelled else BASELINE.name
    tasks = [
        Task(case, start, scenario_of(aircraft, engine, controller, step, start.height, start.wind), number)
        for case in chosen
        for start, number in conditions.starts(case)
    ]
    with build(tasks[0].scenario) as simulation:
        # wrong input is found here, before anything is spent on it
        energy = with_autopilot(simulation, airborne=True).energy
        tasks = [drawn(task, vehicle, energy, conditions.seed) if task.number else task for task in tasks]
    return _Plan(aircraft, engine, controller, tasks)


def drawn(task: Task, vehicle: Vehicle, energy: Energy, seed: int) -> Task:
    """A flight from the ground on: the moment and the noise's seed drawn, the tank as full as the failsafe needs."""
    case, start = task.case, task.start
    draw = Random(f"{seed} {vehicle.name} {case.name} {start} {task.number}")
    hover = float(round(draw.uniform(*HOVER_S)))
    initial: dict[str, Any] = {"on_ground": True}
    if case.waits:
        # of the tank at the end of the hover: what the way down takes with its margin, or the least in per cent
        seconds = (1.0 + energy.margin) * energy.down(start.height)
        least = energy.least
        if vehicle.fuel is None:
            endurance = max(hover / (1.0 - least), hover + seconds)
            case = replace(case, before=(SetParameter("HJ_ENDURANCE", float(round(endurance))),))
        else:
            up = energy.burn * (energy.climbing(start.height) + hover)
            initial["fuel"] = min(1.0, round(up + max(least, energy.burn * seconds), 3))
    scenario = task.scenario.replace(initial=initial, seed=draw.randrange(2**31))
    return task._replace(case=case, scenario=scenario, hover=hover)


def scenario_of(aircraft: str, engine: str, controller: str, step: float, height: float, wind: float) -> Scenario:
    """The flight of one cell of the table, without what is asked in it; it begins in the air."""
    return Scenario.from_table(
        {
            "name": "failsafe",
            "aircraft": aircraft,
            "engine": engine,
            "controller": controller,
            "step_s": step,
            "duration_s": LONGEST_SETTLING_S + MOVING_S + LONGEST_S + 2.0 * PER_METRE_S * height,
            "monitor": load_vehicle(aircraft)[0].control.monitor is not None,
            "initial": {"altitude_m": height},
            "environment": {"wind_ned_m_s": [0.0, wind, 0.0]},
        },
        Path(),
        "failsafe",
    )


def fly_case(task: Task) -> FailsafeFlight:
    """One flight, in this process."""
    with build(task.scenario) as simulation:
        flight = _Flown(task, simulation, with_autopilot(simulation, airborne=not task.number))
        if task.number:
            if not flight.take_off():
                return flight.fail()
            flight.ask(task.case.before)
            flight.fly(task.hover, lambda: task.case.waits and bool(flight.pilot.failsafe))
        else:
            flight.ask(task.case.before)
            flight.settle()
        if task.start.speed:
            # whatever it was on its way to; further than it comes, so that it does not brake
            flight.ask((Goto(FAR_M, speed=task.start.speed),))
            flight.fly(MOVING_S)
        if task.case.waits:
            flight.fly(LONGEST_SETTLING_S, lambda: bool(flight.pilot.failsafe))
        return flight.fail()


class _Flown:
    """A flight as it is flown, and what is told of it."""

    def __init__(self, task: Task, simulation: Simulation, pilot: Autopilot) -> None:
        self.task, self.simulation, self.pilot = task, simulation, pilot
        self._sink = DigestSink(())
        columns = log_columns(logged_vehicle(simulation.vehicle), simulation.columns)
        self._sink.begin(columns)
        self._recorder = Recorder(simulation.dt, self._sink, columns)
        self._entries: list[Entry] = []
        self._sample: Sample | None = None
        self._ending: Ending | None = None
        self._touchdown = self._sideways = self._touched = nan
        self._acted = ""
        self.refused = ""  # why there is no take-off

    def ask(self, requests: Sequence[Request]) -> None:
        """Ask for these before the next step.  Raises InputError where one is refused."""
        k = self.simulation.k
        for request in requests:
            answer = self.pilot.handle(request, k)
            if not answer.accepted:
                name = self.task.case.name
                raise InputError(f"{name}: {type(request).__name__} is refused before step {k}: {answer.text}")
            self._entries.append(Entry(k, "table", request, ""))

    def fly(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Step on for so long, until something is true, or it has crashed."""
        last = self.simulation.k + round(seconds / self.simulation.dt)
        while self.simulation.k < last and self._ending is None and not until():
            self._step()

    def settle(self) -> None:
        """Fly until the vehicle holds."""
        simulation, slow = self.simulation, 0
        dt = simulation.dt
        while simulation.k * dt < LONGEST_SETTLING_S:
            self._step()
            north, east, down = simulation.state.velocity
            slow = slow + 1 if hypot(north, east) < SLOW_M_S and abs(down) < SLOW_M_S else 0
            if simulation.k * dt >= SETTLED_S and slow * dt >= SLOW_S:
                break

    def take_off(self) -> bool:
        """From standing, as soon as home is known, to the height; it holds then.  False: too little fuel for it."""
        height = self.task.start.height
        self.fly(STANDING_S)
        self.ask((Arm(),))
        if self.task.case.waits:
            self.refused = self.pilot.energy.short_of_climb(self.pilot.status.altitude + height)
            if self.refused:
                return False
        self.ask((Takeoff(height),))
        there = lambda: self.pilot.mode is Mode.HOLD or bool(self.pilot.failsafe)  # noqa: E731
        self.fly(LONGEST_SETTLING_S + PER_METRE_S * height, there)
        return True

    def fail(self) -> FailsafeFlight:
        """Let it fail, and fly until it has been disarmed for long enough, has crashed, or time is up."""
        task, simulation, pilot, case = self.task, self.simulation, self.pilot, self.task.case
        dt, begin = simulation.dt, simulation.k
        place, there = HoldTarget(pilot, simulation, task.start.speed), simulation.state.position
        self.ask(case.calls)
        self._touchdown = self._sideways = self._touched = nan
        self._acted = pilot.failsafe if case.waits else ""
        last = begin + round((LONGEST_HOLD_S if case.holds else LONGEST_S + PER_METRE_S * task.start.height) / dt)
        later, disarmed, thrust = LATER_S if task.number <= 1 else DISARMED_S, -1, nan
        while simulation.k < last and self._ending is None and not self.refused:
            k = simulation.k
            sample = self._step()
            self._acted = self._acted or pilot.failsafe
            disarmed = -1 if pilot.armed else k if disarmed < 0 else disarmed
            if disarmed >= 0 and (k - disarmed) * dt >= later:
                thrust = sum(sample.engines.thrust) if later == LATER_S else nan
                break
            if case.holds and place.held() and (k - begin) * dt >= HELD_S:
                break
        self._recorder.flush()
        x, y, _ = simulation.state.position
        row = Row(
            case.name,
            *task.start,
            self._verdict(disarmed >= 0, place),
            self._touchdown,
            self._sideways,
            thrust,
            self._touched * dt - begin * dt,
            hypot(x - there[0], y - there[1]),
            self._ending.reason if self._ending is not None else self.refused or self._acted or _last(pilot.messages),
            *(place.off() if case.holds else (nan, nan)),
            self._sink.hexdigest(),
            task.number,
            task.hover if task.number else nan,
        )
        # times are rounded to steps, so what a product of floats is off does not matter; the file shall be readable
        scenario = simulation.scenario.replace(fault=[], duration_s=round(simulation.k * dt, 9))
        return FailsafeFlight(row, scenario, tuple(self._entries))

    def _step(self) -> Sample:
        simulation, before = self.simulation, self.simulation.state
        sample = simulation.step()
        self._recorder.observe(sample)
        k, state = simulation.k, simulation.state
        if state.on_ground and not before.on_ground:
            north, east, down = before.velocity
            self._touchdown = max(down, 0.0 if isnan(self._touchdown) else self._touchdown)
            self._sideways = max(hypot(north, east), 0.0 if isnan(self._sideways) else self._sideways)
            self._touched = k if isnan(self._touched) else self._touched
        self._ending = simulation.judge.look(state, k * simulation.dt)
        if self._ending is not None:
            seen = simulation.measured
            self._recorder.observe(sample._replace(k=k, time=k * simulation.dt, state=state, measured=seen))
        return sample

    def _verdict(self, disarmed: bool, place: HoldTarget) -> Verdict:
        """What became of it in a word."""
        simulation, pilot = self.simulation, self.pilot
        if self.refused:
            return "refused"
        if self._ending is not None:
            return "crashed" if self._ending.outcome == "crashed" else "lost"
        if disarmed:
            fast = self._sideways > tip_speed(simulation.scenario.aircraft, simulation.scenario.engine)
            return "crashed" if not simulation.state.on_ground else "slid" if fast else "landed"
        if pilot.landed is LandedState.ON_GROUND or simulation.state.on_ground:
            return "stands armed"
        return "holds" if self.task.case.holds and place.held() else "flies on"


class HoldTarget:
    """The place and the height that a vehicle is to hold from now on: those of its set-point, or where that stops.

    A set-point at speed v stops within v^2/2a + v a/2j, with the acceleration a and the jerk j that it is allowed.
    """

    def __init__(self, pilot: Autopilot, simulation: Simulation, speed: float = 0.0) -> None:
        status, (north, east, _), velocity = pilot.status, simulation.state.position, simulation.state.velocity
        a, j = pilot.parameters["HJ_ACC_HOR"], pilot.parameters["HJ_JERK_HOR"]
        speed = max(speed, 0.0 if status.mode is Mode.HOLD else hypot(*velocity[:2]))
        self._pilot, self._simulation = pilot, simulation
        self._place = status.track or (north, east)
        self._height = status.altitude
        self._within = HELD_M + speed**2 / (2.0 * a) + speed * a / (2.0 * j)

    def off(self) -> tuple[float, float]:
        """How far the vehicle is from the place and above the height, m."""
        state = self._simulation.state
        north, east = self._place
        return hypot(state.position[0] - north, state.position[1] - east), state.altitude - self._height

    def held(self) -> bool:
        """Does it stand in HOLD, near that place, at that height?"""
        away, above = self.off()
        north, east, down = self._simulation.state.velocity
        slow = hypot(north, east) < SLOW_M_S and abs(down) < SLOW_M_S
        return self._pilot.mode is Mode.HOLD and away < self._within and abs(above) < HELD_HEIGHT_M and slow


def _last(messages: Any) -> str:
    texts = [message.text for message in messages if "holding" in message.text]
    return texts[-1] if texts else ""
