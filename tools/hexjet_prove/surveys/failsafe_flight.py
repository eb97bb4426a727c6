"""One flight in which something fails, from the ground or from the air, to its end.

The autopilot is told nothing but what a ground station would say.  The flight goes on until the vehicle has been
disarmed for ten seconds, has crashed, or time is up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import hypot, isnan, nan
from typing import TYPE_CHECKING, Any, NamedTuple

from cosim.base.errors import InputError
from cosim.base.outcomes import Verdict
from cosim.control.autopilot.modes import LandedState, Mode
from cosim.control.autopilot.requests import Arm, Goto, Request, Takeoff
from cosim.results.autopilot.request_log import Entry
from cosim.results.log.columns import log_columns, logged_vehicle
from cosim.results.log.digest import DigestSink
from cosim.results.log.recorder import Recorder
from cosim.simulation.autopilot_setup import attach_autopilot
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from hexjet_prove.surveys.tipping import tip_speed

if TYPE_CHECKING:
    from cosim.base.signals import Sample
    from cosim.control.autopilot.autopilot import Autopilot
    from cosim.simulation.ending import Ending
    from cosim.simulation.step import Simulation

# Chosen by us.
MOVING_S = 10.0  # on the way before anything fails: twice what reaching the speed and learning the drag there take
FAR_M = 1000.0  # m to the target of a moving start
SETTLED_S = 5.0  # holding before anything fails, at least
SLOW_M_S, SLOW_S = 0.3, 1.0  # and slower than this for so long, so that it does hold where the wind took it at first
LONGEST_SETTLING_S = 60.0  # s after which the failure begins at any speed
LONGEST_S = 180.0  # from the failure on: three times the descent from 30 m at the landing's rate
PER_METRE_S = 4.0  # s in addition for each metre of height: slower than any vehicle climbs or descends
LATER_S = 10.0  # after disarming
DISARMED_S = 1.0  # the same of all flights of a cell but the first
STANDING_S = 1.1  # s on the ground before arming: home is known by then
HOLD_S = 8.0  # it is to hold for at least so long, and until it is slow near its place
HOLD_RADIUS_M = 1.5  # and counts as holding within this of the place: what a waypoint is reached within (HJ_ACC_RADIUS)
HOLD_HEIGHT_M = 0.4  # m of height error that counts as holding, and ends a climb
LONGEST_HOLD_S = 60.0


class Case(NamedTuple):
    """One failsafe: requests from the beginning of the flight on, and those with which it is called."""

    name: str
    first_requests: tuple[Request, ...]
    failing_requests: tuple[Request, ...]
    holds: bool = False  # whether it ends in HOLD instead of on the ground
    moving: bool = False  # flown without a position from then on, so it also begins moving
    waits: bool = False  # whether the fuel runs down without a request until the autopilot acts


class Start(NamedTuple):
    """Where a flight is when something fails: m, m/s from abeam, m/s ahead (0: it holds)."""

    height: float
    wind: float
    speed: float = 0.0

    def __str__(self) -> str:
        return f"{self.height:g} m, {self.wind:g} m/s" + (f", moving at {self.speed:g} m/s" if self.speed else "")


class Task(NamedTuple):
    """One flight that is to be flown."""

    case: Case
    start: Start
    scenario: Scenario
    number: int = 0  # of the flights of its cell; 0: it begins in the air
    hover: float = 0.0  # s from the end of the take-off until something fails


@dataclass(frozen=True)
class Row:
    """The outcome of one flight."""

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
    log_sha256: str  # of every sample of the flight (cosim.results.log.digest): what flies it again must have the same
    number: int = 0  # of the flights of its cell; 0: it began in the air
    hover_s: float = nan  # from the end of the take-off until it failed, or less where the fuel did not last; NaN: none
    # by which its legs touched slower than they take, and than it tips; below 0: faster; NaN: none touched
    margin_m_s: float = nan
    margin_m: float = nan  # by which what is to hold is within of its place; below 0: it is not; NaN: another failsafe

    @property
    def start(self) -> Start:
        """The position and velocity at which something failed."""
        return Start(self.height_m, self.wind_m_s, self.speed_m_s)


@dataclass(frozen=True)
class FailsafeFlight:
    """A row, with the scenario and the requests that fly it again."""

    row: Row
    scenario: Scenario
    entries: tuple[Entry, ...]


def fly_case(task: Task) -> FailsafeFlight:
    """Fly one flight, in this process."""
    with build(task.scenario) as simulation:
        flight = _Flight(task, simulation, attach_autopilot(simulation, airborne=not task.number))
        if task.number:
            if not flight.take_off():
                return flight.fail()
            flight.ask(task.case.first_requests)
            flight.fly(task.hover, lambda: task.case.waits and bool(flight.pilot.failsafe))
        else:
            flight.ask(task.case.first_requests)
            flight.settle()
        if task.start.speed:
            # whatever it was on its way to; further than it comes, so that it does not brake
            flight.ask((Goto(FAR_M, speed=task.start.speed),))
            flight.fly(MOVING_S)
        if task.case.waits:
            flight.fly(LONGEST_SETTLING_S, lambda: bool(flight.pilot.failsafe))
        return flight.fail()


class _Flight:
    """A flight with its autopilot, its requests and what is measured of it."""

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
        """Climb from standing, once home is known, and hold; return False where there is too little fuel for it."""
        height = self.task.start.height
        self.fly(STANDING_S)
        self.ask((Arm(),))
        if self.task.case.waits:
            self.refused = self.pilot.energy.describe_climb_shortage(self.pilot.status.altitude + height)
            if self.refused:
                return False
        self.ask((Takeoff(height),))
        is_up = lambda: self.pilot.mode is Mode.HOLD or bool(self.pilot.failsafe)  # noqa: E731
        self.fly(LONGEST_SETTLING_S + PER_METRE_S * height, is_up)
        return True

    def fail(self) -> FailsafeFlight:
        """Let it fail, and fly until it has been disarmed for long enough, has crashed, or time is up."""
        task, simulation, pilot, case = self.task, self.simulation, self.pilot, self.task.case
        dt, begin = simulation.dt, simulation.k
        target, failed_at = HoldTarget(pilot, simulation, task.start.speed), simulation.state.position
        self.ask(case.failing_requests)
        self._touchdown = self._sideways = self._touched = nan
        self._acted = pilot.failsafe if case.waits else ""
        last = begin + round((LONGEST_HOLD_S if case.holds else LONGEST_S + PER_METRE_S * task.start.height) / dt)
        watched, disarmed, thrust = LATER_S if task.number <= 1 else DISARMED_S, -1, nan
        while simulation.k < last and self._ending is None and not self.refused:
            k = simulation.k
            sample = self._step()
            self._acted = self._acted or pilot.failsafe
            disarmed = -1 if pilot.armed else k if disarmed < 0 else disarmed
            if disarmed >= 0 and (k - disarmed) * dt >= watched:
                thrust = sum(sample.engines.thrust) if watched == LATER_S else nan
                break
            if case.holds and target.is_held() and (k - begin) * dt >= HOLD_S:
                break
        self._recorder.flush()
        x, y, _ = simulation.state.position
        row = Row(
            case.name,
            *task.start,
            self._verdict(disarmed >= 0, target),
            self._touchdown,
            self._sideways,
            thrust,
            self._touched * dt - begin * dt,
            hypot(x - failed_at[0], y - failed_at[1]),
            self._ending.reason if self._ending is not None else self.refused or self._acted or _last(pilot.messages),
            *(target.deviation() if case.holds else (nan, nan)),
            self._sink.hexdigest(),
            task.number,
            task.hover if task.number else nan,
            self._touch_margin(),
            target.margin() if case.holds else nan,
        )
        # times are rounded to steps, so what a product of floats is off does not matter; the file shall be readable
        scenario = simulation.scenario.replace(fault=[], duration_s=round(simulation.k * dt, 9))
        return FailsafeFlight(row, scenario, tuple(self._entries))

    def _step(self) -> Sample:
        simulation, previous = self.simulation, self.simulation.state
        sample = simulation.step()
        self._recorder.observe(sample)
        k, state = simulation.k, simulation.state
        if state.on_ground and not previous.on_ground:
            north, east, down = previous.velocity
            self._touchdown = max(down, 0.0 if isnan(self._touchdown) else self._touchdown)
            self._sideways = max(hypot(north, east), 0.0 if isnan(self._sideways) else self._sideways)
            self._touched = k if isnan(self._touched) else self._touched
        self._ending = simulation.check_end(sample, [self._recorder.observe])
        return sample

    def _touch_margin(self) -> float:
        """Return by how much its legs touched slower than they take and than it tips, m/s; NaN where none touched."""
        if isnan(self._touched):
            return nan
        scenario, limits = self.simulation.scenario, self.simulation.vehicle.limits
        trip = tip_speed(scenario.aircraft, scenario.engine)
        return min(limits.touchdown_m_s - self._touchdown, trip - self._sideways)

    def _verdict(self, disarmed: bool, target: HoldTarget) -> Verdict:
        """Return what became of it."""
        simulation, on_ground = self.simulation, self.simulation.state.on_ground
        if self.refused:
            return Verdict.REFUSED
        if self._ending is not None:
            return Verdict.CRASHED if self._ending.outcome == "crashed" else Verdict.LOST
        if disarmed and not on_ground:
            return Verdict.CRASHED
        if disarmed:
            is_fast = self._sideways > tip_speed(simulation.scenario.aircraft, simulation.scenario.engine)
            return Verdict.SLID if is_fast else Verdict.LANDED
        if self.pilot.landed is LandedState.ON_GROUND or on_ground:
            return Verdict.STANDS_ARMED
        return Verdict.HOLDS if self.task.case.holds and target.is_held() else Verdict.FLIES_ON


class HoldTarget:
    """The position and the height that a vehicle is to hold from now on: those of its set-point, or where that stops.

    A set-point at speed v stops within v^2/2a + v a/2j, with the acceleration a and the jerk j that it is allowed.
    """

    def __init__(self, pilot: Autopilot, simulation: Simulation, speed: float = 0.0) -> None:
        status, (north, east, _), velocity = pilot.status, simulation.state.position, simulation.state.velocity
        a, j = pilot.parameters["HJ_ACC_HOR"], pilot.parameters["HJ_JERK_HOR"]
        speed = max(speed, 0.0 if status.mode is Mode.HOLD else hypot(*velocity[:2]))
        self._pilot, self._simulation = pilot, simulation
        self._position = status.track or (north, east)
        self._height = status.altitude
        self._within = HOLD_RADIUS_M + speed**2 / (2.0 * a) + speed * a / (2.0 * j)

    def deviation(self) -> tuple[float, float]:
        """Return how far the vehicle is from the place and above the height, m."""
        state = self._simulation.state
        north, east = self._position
        return hypot(state.position[0] - north, state.position[1] - east), state.altitude - self._height

    def margin(self) -> float:
        """Return by how much the vehicle is within of the place and of the height, m."""
        distance, height_error = self.deviation()
        return min(self._within - distance, HOLD_HEIGHT_M - abs(height_error))

    def is_held(self) -> bool:
        """Return whether it is slow in HOLD, near that place, at that height."""
        north, east, down = self._simulation.state.velocity
        is_slow = hypot(north, east) < SLOW_M_S and abs(down) < SLOW_M_S
        return self._pilot.mode is Mode.HOLD and self.margin() > 0.0 and is_slow


def _last(messages: Any) -> str:
    texts = [message.text for message in messages if "holding" in message.text]
    return texts[-1] if texts else ""
