"""Every failsafe flown to its end: how it ended, how fast it touched the ground, what the engines gave afterwards.

A flight begins in the air, holding, in a steady wind from abeam (the axis on which the engines' delay is felt); what
loses the position begins moving ahead, too.  Then something fails, the autopilot is told nothing but what a ground
station would say, and the flight goes on until the vehicle has been disarmed for ten seconds, has crashed, or time is
up.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from math import atan2, hypot, inf, isnan, nan, radians, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.storage.files import finite
from cosim.base.storage.toml import toml_text
from cosim.campaign.fault_survey import Say, controllers_for, step_of
from cosim.campaign.workers.tasks import in_order
from cosim.control.autopilot.modes import LandedState, Mode
from cosim.control.autopilot.requests import (
    Goto,
    InjectFault,
    LinkLost,
    OffboardVelocity,
    Request,
    SetMode,
    SetParameter,
    Sticks,
    to_dict,
)
from cosim.control.predictors.registry import BASELINE, SMITH
from cosim.results.autopilot.request_log import Entry
from cosim.results.columns import log_columns, logged_vehicle
from cosim.results.digest import DigestSink
from cosim.results.recorder import Recorder
from cosim.results.report import marks
from cosim.simulation.build import build
from cosim.simulation.with_autopilot import with_autopilot
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, aircraft_name, aircraft_seen_from, engine_of, load_vehicle

if TYPE_CHECKING:
    from cosim.control.autopilot.autopilot import Autopilot
    from cosim.results.recorder import Recorder
    from cosim.simulation.step import Simulation

Verdict = Literal["landed", "slid", "holds", "flies on", "stands armed", "crashed", "lost"]

# Of docs/failsafes.md, every one that ships with an autopilot; vehicles of one's own by their names.
TABLED = ("hexjet", "hexjet-100", "hexjet-p220", "quadrotor", "octojet", "quadjet", "trijet", "jetwing")
HEIGHTS_M = (3.0, 10.0, 30.0)
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
LATER_S = 10.0  # after disarming
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
    trip_m_s: float  # of a leg that touches faster sideways it is said
    flights: list[FailsafeFlight]

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


def cases(vehicle: Vehicle) -> list[Case]:
    """Every failsafe of the autopilot, sensors singly and the GNSS with each."""
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
        Case("energy critical", (SetParameter("HJ_ENDURANCE", 1000.0),), (SetParameter("HJ_FUEL_CRIT", 100.0),)),
        Case("fence passed", (Goto(8.0, 0.0),), (SetParameter("HJ_FENCE_RAD", 1.0),)),
        Case("sticks lost", (), (centred, SetMode("POSCTL")), True),
        Case("set-points lost", (), (OffboardVelocity(0.0, 0.0, 0.0), SetMode("OFFBOARD")), True),
    ]


def trip_speed(vehicle: Vehicle) -> float:
    """The speed over the ground [m/s] from which a vehicle that touches level, and whose legs catch, tips over them.

    About the line between two legs, ``d`` from under the centre of gravity and ``h`` below it, the moment of momentum
    ``m v h`` stays, and the turning that it becomes has to lift the weight over the legs:

        ``(m v h)^2 / (2 I) = m g (sqrt(h^2 + d^2) - h)``,  ``I = I_c + m (h^2 + d^2)``

    It is what the evaluation of road vehicles calls critical sliding velocity; the least of all pairs of neighbours.
    Legs that slide, with the friction that the ground has, tip over later or never.
    """
    legs = [contact.position_m for contact in vehicle.contacts if contact.kind == "leg"]
    legs.sort(key=lambda place: atan2(place[1], place[0]))
    jx, jy, _ = vehicle.inertia_kg_m2
    slowest = inf
    for (ax, ay, az), (bx, by, bz) in zip(legs, [*legs[1:], *legs[:1]], strict=True):
        length, h = hypot(bx - ax, by - ay), 0.5 * (az + bz)
        d = abs(ax * by - ay * bx) / length
        inertia = (jx * (bx - ax) ** 2 + jy * (by - ay) ** 2) / length**2 + vehicle.mass_kg * (h * h + d * d)
        lift = sqrt(h * h + d * d) - h
        slowest = min(slowest, sqrt(2.0 * GRAVITY * lift * inertia / vehicle.mass_kg) / h)
    return slowest


def starts(case: Case, heights: Sequence[float], winds: Sequence[float], speed: float) -> list[Start]:
    """Holding at every height in every wind; and moving at ``speed`` (0: not), from 10 m on, in the least wind."""
    begun = [Start(height, wind) for height in heights for wind in winds]
    if case.moving and speed:
        begun += [Start(height, min(winds), speed) for height in heights if height >= MOVING_FROM_M]
    return begun


@dataclass(frozen=True)
class _Plan:
    """What is to be flown with one vehicle."""

    aircraft: str
    engine: str
    controller: str
    flights: list[tuple[Case, Start, Scenario]]


def failsafes(
    aircraft: Sequence[str],
    engine: str | None = None,
    controller: str | None = None,
    kinds: Sequence[str] = (),
    heights: Sequence[float] = HEIGHTS_M,
    winds: Sequence[float] = WINDS_M_S,
    workers: int = 2,
    say: Say = lambda what, done, of: None,
    speed: float = SPEED_M_S,
) -> Iterator[Failsafes]:
    """Fly every failsafe from every one of :func:`starts`, one vehicle after the other.

    ``kinds`` are the beginnings of those to be flown.  ``engine`` None is the one that the aircraft is made for,
    ``controller`` None smith, or baseline where there is no model.  ``say`` is told what was flown, how many are, of
    how many.
    Raises InputError for an unknown kind, aircraft, engine or controller, and for a vehicle without an autopilot; all
    of that is found before the first flight.
    """
    if not 0.0 <= speed <= 20.0:
        raise InputError(f"speed {speed:g} m/s: must be from 0 to 20 m/s")
    plans = [_plan(name, engine, controller, kinds, heights, winds, speed) for name in aircraft]
    done, of = 0, sum(len(plan.flights) for plan in plans)
    for plan in plans:
        flights: list[FailsafeFlight] = []
        for flight in in_order(fly_case, plan.flights, workers):
            flights.append(flight)
            done += 1
            say(f"{aircraft_name(plan.aircraft)}: {flight.row.failsafe}, {flight.row.start}", done, of)
        vehicle, _ = load_vehicle(plan.aircraft)
        limit = vehicle.limits.touchdown_m_s
        yield Failsafes(aircraft_name(plan.aircraft), plan.engine, plan.controller, limit, trip_speed(vehicle), flights)


def _plan(
    aircraft: str,
    engine: str | None,
    controller: str | None,
    kinds: Sequence[str],
    heights: Sequence[float],
    winds: Sequence[float],
    speed: float,
) -> _Plan:

    aircraft = aircraft_seen_from(aircraft, Path())
    vehicle, _ = load_vehicle(aircraft)
    engine = engine or engine_of(aircraft) or Scenario.model_fields["engine"].default
    step = step_of(aircraft)
    chosen = [case for case in cases(vehicle) if not kinds or case.name.startswith(tuple(kinds))]
    if not chosen:
        names = ", ".join(case.name for case in cases(vehicle))
        raise InputError(f"no failsafe begins with {' or '.join(map(repr, kinds))}; there are: {names}")
    for height in heights:
        if not 1.0 <= height <= 1000.0:
            raise InputError(f"height {height:g} m: must be from 1 to 1000 m")
    for wind in winds:
        if not 0.0 <= wind <= 50.0:
            raise InputError(f"wind {wind:g} m/s: must be from 0 to 50 m/s")
    if controller is None:
        modelled = SMITH.name in controllers_for(aircraft, engine, step)
        controller = SMITH.name if modelled else BASELINE.name
    flights = [
        (case, start, scenario_of(aircraft, engine, controller, step, start.height, start.wind))
        for case in chosen
        for start in starts(case, heights, winds, speed)
    ]
    with build(flights[0][2]) as simulation:
        # wrong input is found here, before anything is spent on it
        with_autopilot(simulation, airborne=True)
    return _Plan(aircraft, engine, controller, flights)


def scenario_of(aircraft: str, engine: str, controller: str, step: float, height: float, wind: float) -> Scenario:
    """The flight of one cell of the table, without what is asked in it."""
    return Scenario.from_table(
        {
            "name": "failsafe",
            "aircraft": aircraft,
            "engine": engine,
            "controller": controller,
            "step_s": step,
            "duration_s": LONGEST_SETTLING_S + MOVING_S + LONGEST_S,
            "monitor": load_vehicle(aircraft)[0].control.monitor is not None,
            "initial": {"altitude_m": height},
            "environment": {"wind_ned_m_s": [0.0, wind, 0.0]},
        },
        Path(),
        "failsafe",
    )


def fly_case(task: tuple[Case, Start, Scenario]) -> FailsafeFlight:
    """One flight, in this process."""

    case, start, scenario = task
    with build(scenario) as simulation:
        pilot = with_autopilot(simulation, airborne=True)
        dt = simulation.dt
        sink = DigestSink(())
        columns = log_columns(logged_vehicle(simulation.vehicle), simulation.columns)
        sink.begin(columns)
        recorder = Recorder(dt, sink, columns)
        _ask(pilot, case.name, case.before, 0)
        entries = [Entry(0, "table", request, "") for request in case.before]
        begin = _settle(simulation, recorder)
        if start.speed:
            # whatever it was on its way to; further than it comes, so that it does not brake
            away = Goto(FAR_M, speed=start.speed)
            _ask(pilot, case.name, (away,), begin)
            entries.append(Entry(begin, "table", away, ""))
            begin += round(MOVING_S / dt)
            while simulation.k < begin:
                recorder.observe(simulation.step())
        place = HoldTarget(pilot, simulation, start.speed)
        _ask(pilot, case.name, case.calls, begin)
        entries += [Entry(begin, "table", request, "") for request in case.calls]
        touchdown = sideways = after = thrust = nan
        there = simulation.state.position
        disarmed: int | None = None
        acted = ""
        ending = None
        before = simulation.state
        last = begin + round((LONGEST_HOLD_S if case.holds else LONGEST_S) / dt)
        while simulation.k < last:
            k = simulation.k
            sample = simulation.step()
            recorder.observe(sample)
            state = simulation.state
            acted = acted or pilot.failsafe
            if state.on_ground and not before.on_ground:
                north, east, down = before.velocity
                touchdown = max(down, 0.0 if isnan(touchdown) else touchdown)
                sideways = max(hypot(north, east), 0.0 if isnan(sideways) else sideways)
                after = (simulation.k - begin) * dt if isnan(after) else after
            before = state
            ending = simulation.judge.look(state, simulation.k * dt)
            if ending is not None:
                recorder.observe(sample._replace(k=k + 1, time=(k + 1) * dt, state=state, measured=simulation.measured))
                break
            if pilot.armed:
                disarmed = None
            elif disarmed is None:
                disarmed = k
            if disarmed is not None and (k - disarmed) * dt >= LATER_S:
                thrust = sum(sample.engines.thrust)
                break
            if case.holds and place.held() and (k - begin) * dt >= HELD_S:
                break
        recorder.flush()
        x, y, _ = simulation.state.position
        verdict: Verdict
        if ending is not None:
            verdict = "crashed" if ending.outcome == "crashed" else "lost"
        elif disarmed is not None:
            fast = sideways > trip_speed(simulation.vehicle)
            verdict = "crashed" if not simulation.state.on_ground else "slid" if fast else "landed"
        elif pilot.landed is LandedState.ON_GROUND or simulation.state.on_ground:
            verdict = "stands armed"
        else:
            verdict = "holds" if case.holds and place.held() else "flies on"
        row = Row(
            case.name,
            *start,
            verdict,
            touchdown,
            sideways,
            thrust,
            after,
            hypot(x - there[0], y - there[1]),
            ending.reason if ending is not None else acted or _last(pilot.messages),
            *(place.off() if case.holds else (nan, nan)),
            sink.hexdigest(),
        )
        # times are rounded to steps, so what a product of floats is off does not matter; the file shall be readable
        return FailsafeFlight(
            row, simulation.scenario.replace(fault=[], duration_s=round(simulation.k * dt, 9)), tuple(entries)
        )


def _ask(pilot: Autopilot, name: str, requests: Sequence[Request], k: int) -> None:
    for request in requests:
        answer = pilot.handle(request, k)
        if not answer.accepted:
            raise InputError(f"{name}: {type(request).__name__} is refused before step {k}: {answer.text}")


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


def _settle(simulation: Simulation, recorder: Recorder) -> int:
    """Fly until the vehicle holds; the step that comes next."""
    dt, slow = simulation.dt, 0
    while simulation.k * dt < LONGEST_SETTLING_S:
        recorder.observe(simulation.step())
        north, east, down = simulation.state.velocity
        slow = slow + 1 if hypot(north, east) < SLOW_M_S and abs(down) < SLOW_M_S else 0
        if simulation.k * dt >= SETTLED_S and slow * dt >= SLOW_S:
            break
    return simulation.k


def _last(messages: Any) -> str:
    texts = [message.text for message in messages if "holding" in message.text]
    return texts[-1] if texts else ""


def write(result: Failsafes, folder: Path) -> Path:
    """``failsafes.csv`` in ``folder``, and in ``flights/`` a scenario with its requests for every row: ``hexjet fly``.

    Raises InputError if they cannot be written.
    """
    table = folder / "failsafes.csv"
    flights = folder / "flights"
    try:
        flights.mkdir(parents=True, exist_ok=True)
        with open(table, "w", newline="", encoding="utf-8") as file:
            lines = csv.writer(file)
            names = [field.name for field in fields(Row)]
            lines.writerow([*names, "flight"])
            for flight in result.flights:
                name = file_name(flight.row)
                lines.writerow([*(getattr(flight.row, column) for column in names), f"flights/{name}.toml"])
                write_flight(flights, name, flight.scenario, flight.entries)
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}") from error
    return table


def write_flight(folder: Path, name: str, scenario: Scenario, entries: Sequence[Entry]) -> Path:
    """What ``hexjet fly`` flies again: the scenario, and beside it what was asked in it.  Raises OSError."""
    requests = [{"step": entry.step, "sender": entry.sender} | to_dict(entry.request) for entry in entries]
    text = "".join(json.dumps(line, allow_nan=False) + "\n" for line in requests)
    (folder / f"{name}.jsonl").write_text(text, encoding="utf-8")
    stated = scenario.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    stated |= {"name": name, "requests": f"{name}.jsonl"}
    path = folder / f"{name}.toml"
    path.write_text(toml_text(stated), encoding="utf-8")
    return path


def file_name(row: Row) -> str:
    """Of the flight's files, without what they end in."""
    return f"{row.failsafe.lower().replace(' ', '-')}-{row.height_m:g}m-{row.wind_m_s:g}m_s" + (
        f"-at-{row.speed_m_s:g}m_s" if row.speed_m_s else ""
    )


@dataclass(frozen=True)
class FailsafeSummary:
    """One failsafe in one wind and at one speed, all heights together."""

    failsafe: str
    wind_m_s: float
    speed_m_s: float
    ends: str  # what became of the flights, the same words once
    touchdown_m_s: float  # the fastest; NaN: none touched
    sideways_m_s: float
    thrust_n: float  # the most; NaN: none was disarmed


def summary(result: Failsafes) -> list[FailsafeSummary]:
    """For each failsafe, wind and speed what became of it at all heights."""
    table = []
    for name, wind, speed in dict.fromkeys((row.failsafe, row.wind_m_s, row.speed_m_s) for row in result.rows):
        rows = [row for row in result.rows if (row.failsafe, row.wind_m_s, row.speed_m_s) == (name, wind, speed)]
        verdicts = [row.verdict for row in rows]
        known = dict.fromkeys(verdicts)
        if len(known) == 1:
            ends: str = verdicts[0]
        else:
            ends = ", ".join(
                f"{verdict} from {', '.join(f'{row.height_m:g}' for row in rows if row.verdict == verdict)} m"
                for verdict in known
            )
        down, sideways, thrust = (
            max((value for value in values if not isnan(value)), default=nan)
            for values in (
                [row.touchdown_m_s for row in rows],
                [row.sideways_m_s for row in rows],
                [row.thrust_n for row in rows],
            )
        )
        table.append(FailsafeSummary(name, wind, speed, ends, down, sideways, thrust))
    return table


def mark(aircraft: str) -> str:
    """The name of the mark in a page between which a vehicle's table goes."""
    return f"failsafes, {aircraft}"


def markdown(result: Failsafes) -> str:
    """The part of a page: the table by failsafe and wind, every flight of it in the columns of the starts."""
    columns = sorted(dict.fromkeys(row.start for row in result.rows), key=lambda start: start.speed > 0.0)
    cells = {(row.failsafe, row.start): row for row in result.rows}
    rows = [
        [name, *(cell(cells[name, start]) if (name, start) in cells else "-" for start in columns)]
        for name in dict.fromkeys(row.failsafe for row in result.rows)
    ]
    return (
        f"Engine `{result.engine}`, controller `{result.controller}`; a leg that touches faster than "
        f"{result.limit_m_s:.2f} m/s counts as a crash, and what touches faster than {result.trip_m_s:.2f} m/s "
        "sideways has slid.\n\n" + marks.table(["failsafe", *map(str, columns)], rows)
    )


def cell(row: Row) -> str:
    """A flight as it stands in the page's table."""
    parts: list[str] = [row.verdict]
    if not isnan(row.off_m):
        parts.append(f"{row.off_m:.2f} m off")
    if not isnan(row.touchdown_m_s):
        parts.append(f"{row.touchdown_m_s:.2f} m/s")
        if row.failsafe.startswith("GNSS"):
            # what it does without a position; elsewhere the position is held, and failsafes.csv has it
            parts.append(f"sideways {row.sideways_m_s:.2f} m/s")
            parts.append(f"{row.drift_m:.1f} m away")
    if not isnan(row.thrust_n):
        parts.append(f"{row.thrust_n:.1f} N")
    return ", ".join(parts)
