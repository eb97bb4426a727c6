"""One flight in which something fails, from the ground or from the air, to its end.

The autopilot is told nothing but what a ground station would say.  The flight goes on until the vehicle has been
disarmed for ten seconds, has crashed, or time is up.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from math import hypot, inf, isnan, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cosim.base.errors import InputError
from cosim.base.outcomes import Verdict
from cosim.control.autopilot.modes import LandedState, Mode
from cosim.control.autopilot.requests import Arm, Goto, Request, SetParameter, Takeoff
from cosim.files import Model
from cosim.flight import record, write_run_page
from cosim.results.autopilot.autopilot_record import PilotRecord
from cosim.results.autopilot.request_log import RequestLog
from cosim.results.run import AUTOPILOT, REQUESTS
from cosim.simulation.autopilot_setup import attach_autopilot
from cosim.simulation.build import build
from hexjet_prove.surveys.failsafe_cases import Case, cases

if TYPE_CHECKING:
    from cosim.base.signals import Sample
    from cosim.control.autopilot.autopilot import Autopilot
    from cosim.results.run import Run
    from cosim.simulation.ending import Ending
    from cosim.simulation.step import Simulation
    from cosim.spec.scenario import Scenario

# Steady flight before the failure, chosen by us: twice what the estimate of the drag needs.
STEADY_S = 10.0
SLOW_M_S, SLOW_S = 0.3, 1.0  # slower for this long: it holds
MAX_SETTLING_S = 60.0  # then the failure comes at any speed
MAX_FLIGHT_S = 180.0  # three descents from 30 m
MAX_S_PER_METRE = 4.0  # no vehicle climbs or descends so slowly
DISARMED_S = 10.0  # flown on after disarming
MAX_HOLD_RADIUS_M = 1.5  # as for a waypoint (HJ_ACC_RADIUS)
MAX_HOLD_HEIGHT_ERROR_M = 0.4  # a climb ends within it too
MAX_HOLD_S = 60.0  # s of holding that are watched


# Measures of a flight, NaN if there is none; hexjet_prove.surveys.failsafes.Row describes them.
MEASURED = (
    *("touchdown_m_s", "sideways_m_s", "thrust_n", "after_s", "drift_m", "off_m", "height_off_m", "hover_s"),
    *("margin_m_s", "margin_m"),
)
OWN = "own."  # prefix of the measures' columns


class FailsafeAutopilot(Model):
    """Autopilot of a failsafe study: the table ``[autopilot]`` with a case's overrides.

    The methods are those of ``StudyAutopilot`` in ``cosim/campaign/study/autopilot.py``.
    """

    name: Literal["failsafes"]
    trip_m_s: float | None = None  # m/s at which legs tip; None: never
    failsafe: str = ""  # what fails; empty: nothing
    height_m: float = 0.0  # above the ground, at the failure
    speed_m_s: float = 0.0  # forward; 0: it hovers
    number: int = 0  # in its cell; 0: begins in the air
    hover_s: float = 0.0  # from take-off to the failure
    endurance_s: float | None = None  # of a battery that is to run down

    @property
    def columns(self) -> dict[str, type[float | int | str | bool | None]]:
        """Columns of a row: verdict and measures."""
        return {"verdict": str, **{OWN + name: float for name in MEASURED}}

    @property
    def before_s(self) -> float:
        """Time flown before the first step [s]: none."""
        return 0.0

    def program(self, folder: Path) -> Path | None:
        """Return None: there is no program."""
        return None

    def seen_from(self, folder: Path) -> FailsafeAutopilot:
        """Return itself, as there is no file."""
        return self

    def check(self, scenario: Scenario, folder: Path) -> None:
        """Raise InputError for a vehicle without an autopilot."""
        with build(scenario) as simulation:
            attach_autopilot(simulation, airborne=not scenario.initial.on_ground)

    def fly(self, scenario: Scenario, study_folder: Path, folder: Path, page: bool) -> tuple[Run, dict[str, Any]]:
        """Fly a scenario into ``folder``; return its repeatable run, and verdict and measures."""
        with build(scenario.replace(requests=REQUESTS)) as simulation:
            case = next(case for case in cases(simulation.vehicle) if case.name == self.failsafe)
            flight = FailsafeFlight(self, case, simulation, folder)
            measured, verdict = flight.fly_case()
            run = flight.finish()
        row: dict[str, Any] = {OWN + name: None if isnan(value) else value for name, value in measured.items()}
        row |= {"verdict": str(verdict), "success": verdict in (Verdict.LANDED, Verdict.HOLDS)}
        return write_run_page(run) if page else run, row


class FailsafeFlight:
    """A flight with autopilot, requests and measures."""

    def __init__(self, table: FailsafeAutopilot, case: Case, simulation: Simulation, folder: Path) -> None:
        self.table, self.case, self.simulation = table, case, simulation
        self.pilot: Autopilot = attach_autopilot(simulation, airborne=not table.number)
        self._recording = record(simulation, folder, {REQUESTS: b""})
        self._requests = RequestLog(folder / REQUESTS)
        self._record = PilotRecord(self.pilot, folder / AUTOPILOT, simulation.dt)
        self._observe = (self._recording.observe, self._record.observe)
        self._begin = time.perf_counter()
        self._ending: Ending | None = None
        self._touchdown = self._sideways = self._touched = nan
        self._acted = ""
        self.refused = ""  # why it did not take off

    def fly_case(self) -> tuple[dict[str, float], Verdict]:
        """Fly until the failure and on to the end; return measures and verdict."""
        case, table = self.case, self.table
        if table.number:
            if not self.take_off():
                return self.fail()
            battery = () if table.endurance_s is None else (SetParameter("HJ_ENDURANCE", table.endurance_s),)
            self.ask((*case.first_requests, *battery))
            self.fly(table.hover_s, lambda: case.waits and bool(self.pilot.failsafe))
        else:
            self.ask(case.first_requests)
            self.settle()
        if table.speed_m_s:
            # Whatever it was flying to, it gets a target out of reach, so that it does not brake.
            self.ask((Goto(1000.0, speed=table.speed_m_s),))
            self.fly(STEADY_S)
        if case.waits:
            self.fly(MAX_SETTLING_S, lambda: bool(self.pilot.failsafe))
        return self.fail()

    def finish(self) -> Run:
        """Finish the run's files; its scenario ends with the flight.

        The reason is that of a crash, or else what the autopilot said it acted upon.
        """
        ending = self._ending
        reason = ending.reason if ending is not None else self.refused or self._acted or _hold_text(self.pilot.messages)
        self._requests.close()
        self._record.close()
        self._recording.shorten_scenario(self.simulation.k)
        outcome = "completed" if ending is None else ending.outcome
        return self._recording.finish(outcome, reason, time.perf_counter() - self._begin)

    def ask(self, requests: Sequence[Request]) -> None:
        """Send requests before the next step.  Raises InputError if one is refused."""
        k = self.simulation.k
        for request in requests:
            answer = self.pilot.handle(request, k)
            if not answer.accepted:
                raise InputError(
                    f"{self.case.name}: {type(request).__name__} is refused before step {k}: {answer.text}"
                )
            self._requests.write(k, "table", request, answer)

    def fly(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Fly for so many seconds, or until a condition, or a crash."""
        last = self.simulation.k + round(seconds / self.simulation.dt)
        while self.simulation.k < last and self._ending is None and not until():
            self._fly_step()

    def settle(self) -> None:
        """Fly until the vehicle holds its position."""
        simulation, slow = self.simulation, 0
        dt = simulation.dt
        min_settled_s = 5.0  # s of hover before the failure, at least
        while simulation.k * dt < MAX_SETTLING_S:
            self._fly_step()
            north, east, down = simulation.state.velocity
            slow = slow + 1 if hypot(north, east) < SLOW_M_S and abs(down) < SLOW_M_S else 0
            if simulation.k * dt >= min_settled_s and slow * dt >= SLOW_S:
                break

    def take_off(self) -> bool:
        """Take off once home is known, and hold; return False if fuel does not suffice."""
        height = self.table.height_m
        self.fly(1.1)  # home is known after this
        self.ask((Arm(),))
        if self.case.waits:
            self.refused = self.pilot.energy.describe_climb_shortage(self.pilot.status.altitude + height)
            if self.refused:
                return False
        self.ask((Takeoff(height),))
        is_up = lambda: self.pilot.mode is Mode.HOLD or bool(self.pilot.failsafe)  # noqa: E731
        self.fly(MAX_SETTLING_S + MAX_S_PER_METRE * height, is_up)
        return True

    def fail(self) -> tuple[dict[str, float], Verdict]:
        """Trigger the failure and fly until disarmed for some time, crashed, or out of time."""
        table, simulation, pilot, case = self.table, self.simulation, self.pilot, self.case
        dt, begin = simulation.dt, simulation.k
        target, failed_at = HoldTarget(pilot, simulation, table.speed_m_s), simulation.state.position
        self.ask(case.failing_requests)
        self._touchdown = self._sideways = self._touched = nan
        self._acted = pilot.failsafe if case.waits else ""
        last = begin + round((MAX_HOLD_S if case.holds else MAX_FLIGHT_S + MAX_S_PER_METRE * table.height_m) / dt)
        disarmed_s = 1.0  # s, flights of a cell but the first
        watched, disarmed, thrust = DISARMED_S if table.number <= 1 else disarmed_s, -1, nan
        while simulation.k < last and self._ending is None and not self.refused:
            k = simulation.k
            sample = self._fly_step()
            self._acted = self._acted or pilot.failsafe
            disarmed = -1 if pilot.armed else k if disarmed < 0 else disarmed
            if disarmed >= 0 and (k - disarmed) * dt >= watched:
                thrust = sum(sample.engines.thrust) if watched == DISARMED_S else nan
                break
            if case.holds and target.is_held() and (k - begin) * dt >= 8.0:
                break
        x, y, _ = simulation.state.position
        off, height_off = target.deviation() if case.holds else (nan, nan)
        measured = (
            *(self._touchdown, self._sideways, thrust, self._touched * dt - begin * dt),
            *(hypot(x - failed_at[0], y - failed_at[1]), off, height_off, table.hover_s if table.number else nan),
            *(self._touch_margin(), target.margin() if case.holds else nan),
        )
        return dict(zip(MEASURED, measured, strict=True)), self._verdict(disarmed >= 0, target)

    def _fly_step(self) -> Sample:
        simulation, previous = self.simulation, self.simulation.state
        sample = simulation.step()
        for look in self._observe:
            look(sample)
        k, state = simulation.k, simulation.state
        if state.on_ground and not previous.on_ground:
            north, east, down = previous.velocity
            self._touchdown = max(down, 0.0 if isnan(self._touchdown) else self._touchdown)
            self._sideways = max(hypot(north, east), 0.0 if isnan(self._sideways) else self._sideways)
            self._touched = k if isnan(self._touched) else self._touched
        self._ending = simulation.check_end(sample, self._observe)
        return sample

    def _touch_margin(self) -> float:
        """Return the margin of the touchdown speed to breaking and tipping, m/s; NaN without touchdown."""
        if isnan(self._touched):
            return nan
        limit = self.simulation.vehicle.limits.touchdown_m_s
        return min(limit - self._touchdown, self._tipping_speed_m_s - self._sideways)

    @property
    def _tipping_speed_m_s(self) -> float:
        return inf if self.table.trip_m_s is None else self.table.trip_m_s

    def _verdict(self, disarmed: bool, target: HoldTarget) -> Verdict:
        on_ground = self.simulation.state.on_ground
        if self.refused:
            return Verdict.REFUSED
        if self._ending is not None:
            return Verdict.CRASHED if self._ending.outcome == "crashed" else Verdict.LOST
        if disarmed and not on_ground:
            return Verdict.CRASHED
        if disarmed:
            return Verdict.SLID if self._sideways > self._tipping_speed_m_s else Verdict.LANDED
        if self.pilot.landed is LandedState.ON_GROUND or on_ground:
            return Verdict.STANDS_ARMED
        return Verdict.HOLDS if self.case.holds and target.is_held() else Verdict.FLIES_ON


class HoldTarget:
    """Position and height to be held from now on, of the set-point or where it stops.

    A set-point at speed v stops within v^2/2a + v a/2j, with the acceleration a and the jerk j that it is allowed.
    """

    def __init__(self, pilot: Autopilot, simulation: Simulation, speed: float = 0.0) -> None:
        status, (north, east, _), velocity = pilot.status, simulation.state.position, simulation.state.velocity
        a, j = pilot.parameters["HJ_ACC_HOR"], pilot.parameters["HJ_JERK_HOR"]
        speed = max(speed, 0.0 if status.mode is Mode.HOLD else hypot(*velocity[:2]))
        self._pilot, self._simulation = pilot, simulation
        self._position = status.track or (north, east)
        self._height = status.altitude
        self._within = MAX_HOLD_RADIUS_M + speed**2 / (2.0 * a) + speed * a / (2.0 * j)

    def deviation(self) -> tuple[float, float]:
        """Return how far the vehicle is from the place and above the height, m."""
        state = self._simulation.state
        north, east = self._position
        return hypot(state.position[0] - north, state.position[1] - east), state.altitude - self._height

    def margin(self) -> float:
        """Return the smaller margin of distance and height to the limits of holding, m."""
        distance, height_error = self.deviation()
        return min(self._within - distance, MAX_HOLD_HEIGHT_ERROR_M - abs(height_error))

    def is_held(self) -> bool:
        """Return whether the vehicle is in HOLD, slow, and near its position and height."""
        north, east, down = self._simulation.state.velocity
        is_slow = hypot(north, east) < SLOW_M_S and abs(down) < SLOW_M_S
        return self._pilot.mode is Mode.HOLD and self.margin() > 0.0 and is_slow


def _hold_text(messages: Any) -> str:
    texts = [message.text for message in messages if "holding" in message.text]
    return texts[-1] if texts else ""
