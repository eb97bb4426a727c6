"""The autopilot without an airframe: what is allowed when, refusals, time-outs, failsafes, mission order."""

from __future__ import annotations

import itertools
from math import isfinite, radians, sqrt
from operator import attrgetter
from typing import Any

import pytest
from any_request import ANY, REST
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.frames import from_euler
from cosim.base.protocols import EngineState, Report
from cosim.base.signals import Command, Measured
from cosim.control.altitude import AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.autopilot import Autopilot
from cosim.control.autopilot.flight_state import FaultCommands, Thrust
from cosim.control.autopilot.manoeuvres.mission import Mission
from cosim.control.autopilot.manoeuvres.touchdown import Touchdown
from cosim.control.autopilot.modes import LandedState, Mode, Severity
from cosim.control.autopilot.requests import MissionItem, Result
from cosim.control.autopilot.tuning import ControlLoops
from cosim.control.predictors.smith import NoPredictor
from cosim.control.rate import RateController
from cosim.spec.vehicle import load_vehicle

DT = 0.004
HOVER = 0.45
STANDING = 0.125
VEHICLE, _ = load_vehicle("hexjet")
CONTROL = VEHICLE.control


class World:
    """A vehicle that stays where it is put, whatever the autopilot commands."""

    def __init__(self, airborne: bool = False, **changes: Any) -> None:
        self.faults: list[Any] = []
        self.place: dict[str, Any] = {"north": 0.0, "east": 0.0, "roll": 0.0, "rate": (0.0, 0.0, 0.0), "sink": 0.0}
        self.place |= {"altitude": 10.0 if airborne else STANDING, "collective": HOVER if airborne else 0.05}
        self.place |= {"legs": not airborne, "lost": (), "remaining": None, "receiver": True} | changes
        rates, none = (CONTROL.rate.roll, CONTROL.rate.pitch, CONTROL.rate.yaw), [NoPredictor() for _ in range(3)]
        attitude, rate = AttitudeController(CONTROL.attitude), RateController(rates, none, DT)
        height = AltitudeController(CONTROL.altitude, VEHICLE.mass_kg, lambda thrust: thrust / 120.0, DT)
        loops = ControlLoops(attitude, height, rate, lambda name, delay, tuning: none, "smith", 25.0)
        faults = FaultCommands(self._inject, self.faults.clear)
        engines = EngineState.FLY if airborne else EngineState.IDLE
        self.pilot = Autopilot(VEHICLE, DT, Thrust(HOVER), loops, faults, engines)
        self.k = 0
        self.command: Command | None = None
        self.seconds(1.1)

    def _inject(self, fault: rq.InjectFault) -> None:
        if fault.fault == "wrong":
            raise InputError("no such fault")
        self.faults.append(fault)

    def seconds(self, duration: float, **changes: Any) -> Command:
        """Step on, with something about the vehicle changed from now on."""
        self.place |= changes
        p = self.place
        if {"altitude", "sink", "roll"} & set(changes):
            # put there by hand: what it estimates is taken along
            self.pilot.estimates.reset(None)
        attitude = from_euler(p["roll"], 0.0, 0.0)
        report = Report(p["legs"], p["collective"], p["lost"], p["remaining"])
        for _ in range(round(duration / DT)):
            # a receiver that works never says the same twice
            north = p["north"] + 1e-9 * (self.k // 25 % 2) * p["receiver"]
            place, velocity = (north, p["east"], -p["altitude"]), (0.0, 0.0, p["sink"])
            measured = Measured(p["rate"], attitude, place, velocity, p["altitude"], (0.0, 0.0, -GRAVITY))
            self.command = self.pilot.update(self.k, measured, report)
            self.k += 1
        assert self.command is not None
        return self.command

    def ask(self, request: Any) -> rq.Answer:
        return self.pilot.handle(request, self.k)

    def ok(self, request: Any) -> None:
        answer = self.ask(request)
        assert answer.accepted, answer
        assert answer.result is Result.ACCEPTED

    @property
    def last(self) -> str:
        return self.texts()[-1]

    def texts(self) -> list[str]:
        return [message.text for message in self.pilot.messages]


def world(state: str) -> World:
    """Standing, armed on the ground, or holding in the air."""
    w = World(airborne=state == "air")
    if state == "armed":
        w.ok(rq.Arm())
        w.seconds(0.1)
    return w


STICKS = rq.Sticks(0.0, 0.0, 0.0, 0.5)
LOW = rq.Sticks(0.0, 0.0, 0.0, 0.0)
POINTS = (MissionItem("waypoint", 5.0, 0.0, 10.0), MissionItem("waypoint", 5.0, 5.0, 10.0))
OK, NO, LATER, WHAT = Result.ACCEPTED, Result.DENIED, Result.TEMPORARILY_REJECTED, Result.UNSUPPORTED

# request, what precedes it, and the answers: standing disarmed, standing armed, in the air
TABLE: list[tuple[Any, list[Any], Result, Result, Result]] = [
    (rq.Arm(), [], OK, OK, OK),
    (rq.Disarm(), [], OK, OK, NO),
    (rq.Disarm(True), [], OK, OK, OK),
    (rq.Kill(), [], OK, OK, NO),
    (rq.Kill(True), [], OK, OK, OK),
    (rq.Takeoff(5.0), [], OK, OK, NO),
    (rq.Takeoff(), [], OK, OK, NO),
    (rq.Takeoff(0.5), [], NO, NO, NO),
    (rq.Takeoff(-10.0), [], NO, NO, NO),
    (rq.Land(), [], LATER, LATER, OK),
    (rq.ReturnHome(), [], LATER, LATER, OK),
    (rq.Goto(5.0, 5.0, 10.0), [], LATER, LATER, OK),
    (rq.Goto(5.0, 5.0, -3.0), [], LATER, LATER, NO),
    (rq.Goto(5.0, 5.0, speed=1000.0), [], LATER, LATER, NO),
    (rq.Goto(yaw=1.0), [], LATER, LATER, OK),
    (rq.Hold(), [], OK, OK, OK),
    (rq.SetSpeed(3.0), [], OK, OK, OK),
    (rq.SetSpeed(900.0), [], NO, NO, NO),
    (rq.SetHome(1.0, 2.0, 0.0), [], OK, OK, OK),
    (STICKS, [], OK, OK, OK),
    (rq.SetMode("MANUAL"), [], OK, OK, LATER),
    (rq.SetMode("MANUAL"), [STICKS], OK, OK, OK),
    (rq.SetMode("STABILIZED"), [], OK, OK, LATER),
    (rq.SetMode("STABILIZED"), [STICKS], OK, OK, OK),
    (rq.SetMode("ALTCTL"), [], OK, OK, LATER),
    (rq.SetMode("ALTCTL"), [STICKS], OK, OK, OK),
    (rq.SetMode("POSCTL"), [], OK, OK, LATER),
    (rq.SetMode("POSCTL"), [STICKS], OK, OK, OK),
    (rq.SetMode("HOLD"), [], OK, OK, OK),
    (rq.SetMode("TAKEOFF"), [], OK, OK, NO),
    (rq.SetMode("LAND"), [], LATER, LATER, OK),
    (rq.SetMode("RTL"), [], LATER, LATER, OK),
    (rq.SetMode("MISSION"), [], NO, NO, NO),
    (rq.SetMode("MISSION"), [rq.MissionUpload(POINTS)], OK, OK, OK),
    (rq.SetMode("OFFBOARD"), [], LATER, LATER, LATER),
    (rq.SetMode("OFFBOARD"), [rq.OffboardPosition(0.0, 0.0, -10.0)], OK, OK, OK),
    (rq.SetMode("ACRO"), [], WHAT, WHAT, WHAT),
    (rq.MissionStart(), [], NO, NO, NO),
    (rq.MissionStart(), [rq.MissionUpload(POINTS)], OK, OK, OK),
    (rq.MissionUpload(POINTS), [rq.MissionUpload(POINTS), rq.MissionStart()], OK, LATER, LATER),
    (rq.MissionSetCurrent(1), [rq.MissionUpload(POINTS)], OK, OK, OK),
    (rq.MissionSetCurrent(2), [rq.MissionUpload(POINTS)], NO, NO, NO),
    (rq.MissionClear(), [rq.MissionUpload(POINTS), rq.MissionStart()], OK, OK, OK),
    (rq.SetParameter("HJ_ROLL_P", 0.03), [], OK, OK, OK),
    (rq.SetParameter("HJ_ROLL_P", 99.0), [], NO, NO, NO),
    (rq.SetParameter("NOTHING", 1.0), [], NO, NO, NO),
    (rq.InjectFault("flame_out", (1,)), [], NO, NO, NO),
    (rq.InjectFault("flame_out", (1,)), [rq.SetParameter("SYS_FAILURE_EN", 1)], OK, OK, OK),
    (rq.InjectFault("wrong"), [rq.SetParameter("SYS_FAILURE_EN", 1)], NO, NO, NO),
    (rq.ClearFaults(), [], OK, OK, OK),
    (rq.LinkLost(), [], OK, OK, OK),
    (rq.LinkBack(), [], OK, OK, OK),
    ("not a request", [], WHAT, WHAT, WHAT),
]


@pytest.mark.parametrize("state", ["ground", "armed", "air"])
@pytest.mark.parametrize("row", TABLE, ids=lambda row: f"{row[0]}{'+' if row[1] else ''}")
def test_what_is_allowed_when(row: Any, state: str) -> None:
    request, before, *answers = row
    w = world(state)
    for each in before:
        w.ok(each)
    w.seconds(DT)
    as_was = (w.pilot.mode, w.pilot.armed, w.pilot.engines, dict(w.pilot.parameters.values))
    answer = w.ask(request)
    assert answer.result is answers[["ground", "armed", "air"].index(state)], answer
    assert answer.accepted is (answer.result is Result.ACCEPTED)
    if not answer.accepted:
        # a refusal says why, in one line, and changes nothing
        assert answer.text
        assert "\n" not in answer.text
        assert (w.pilot.mode, w.pilot.armed, w.pilot.engines, dict(w.pilot.parameters.values)) == as_was
    w.seconds(0.1)


def test_every_mode_is_entered_by_name() -> None:
    """From the air, with what each needs."""
    for mode in Mode:
        if mode in (Mode.TAKEOFF, Mode.ORBIT):
            continue  # only from the ground; by a request that names the centre
        w = World(airborne=True)
        for each in (STICKS, rq.OffboardVelocity(0.0, 0.0, 0.0), rq.MissionUpload(POINTS)):
            w.ok(each)
        w.ok(rq.SetMode(mode.value))
        assert w.pilot.mode is mode
        w.seconds(DT)
        assert w.pilot.mode is mode
    w = World()
    w.ok(rq.SetMode("TAKEOFF"))
    assert w.pilot.mode is Mode.TAKEOFF


@pytest.mark.parametrize(
    ("changes", "mode", "reason"),
    [
        ({"roll": radians(15.0)}, "HOLD", "not level: leans 15 deg, 10 deg are allowed"),
        ({"rate": (0.5, 0.0, 0.0)}, "HOLD", "it is being moved"),
        ({"lost": (2, 5)}, "HOLD", "engine 2, 5 failed"),
        ({"remaining": 0.05}, "HOLD", "fuel or battery at 5 %"),
        ({}, "POSCTL", "mode POSCTL needs sticks, and there are none"),
    ],
)
def test_arming_is_refused_with_the_reason(changes: dict[str, Any], mode: str, reason: str) -> None:
    w = World()
    w.ok(rq.SetMode(mode))
    w.seconds(0.1, **changes)
    answer = w.ask(rq.Arm())
    assert answer == (False, Result.DENIED, f"arming refused: {reason}")
    assert w.pilot.status.refusals == (reason,)
    assert not w.pilot.armed
    assert w.texts()[-1] == f"arming refused: {reason}"
    w.ok(rq.Arm(force=True))


def test_no_home_before_a_second_of_positions() -> None:
    w = World()
    w.pilot.reset()
    w.k = 0
    waiting = "arming refused: no home: waiting for the position"
    play(w, (rq.Arm(), "arming refused: no measurements yet"), 0.5, (rq.Arm(), waiting), 0.6, rq.Arm())
    assert w.pilot.home == pytest.approx((0.0, 0.0, STANDING), abs=1e-8)


def play(w: World, *story: Any) -> None:
    """A request is granted, a number of seconds pass, a table changes the world; all else says what must be so.
    A mode is the present one, a text was said; a pair is an attribute and its value, or a request and its refusal."""
    for step in story:
        match step:
            case dict():
                w.seconds(0.0, **step)
            case float():
                w.seconds(step)
            case Mode():
                assert w.pilot.mode is step
            case str():
                assert step in w.texts()
            case (str(name), value):
                assert attrgetter(name)(w) == value, name
            case (request, refusal):
                answer = w.ask(request)
                assert (answer.text if isinstance(refusal, str) else answer.result) == refusal
                assert not answer.accepted
            case _:
                w.ok(step)


NO_PLACE = "needs the position, and the GNSS receiver has stopped"
FAILED = "refused: engine 1, 4 failed"
ALL_FAILED = ("pilot.failsafe", "engine 1, 2, 3, 4, 5, 6 failed")
OFF, IDLE, FLY = (("pilot.engines", state) for state in (EngineState.OFF, EngineState.IDLE, EngineState.FLY))


ARMED, DISARMED = ("pilot.armed", True), ("pilot.armed", False)
BY_STICK = (STICKS, 0.1)

# what must hold, and what happens, by phases: first of all the state that it begins in
STORIES: dict[str, list[list[Any]]] = {
    "with the throttle up it is not armed": [
        ["ground", STICKS, rq.SetMode("MANUAL"), (rq.Arm(), "arming refused: the throttle stick is not down")],
        [LOW, rq.Arm()],
    ],
    # by sticks on lean, throttle or height; everything else would land as soon as it had taken off
    "a receiver that stopped on the ground arms only what flies without a position": [
        ["ground", rq.MissionUpload(POINTS), {"receiver": False}, 1.5],
        [(rq.Arm(), f"arming refused: mode HOLD {NO_PLACE}")],
        [(rq.Takeoff(), f"take-off refused: mode TAKEOFF {NO_PLACE}")],
        [(rq.MissionStart(), f"mission refused: mode MISSION {NO_PLACE}")],
        [LOW, rq.SetMode("POSCTL"), (rq.Arm(), f"arming refused: mode POSCTL {NO_PLACE}")],
        *([LOW, rq.SetMode(mode), rq.Arm(), rq.Disarm()] for mode in ("ALTCTL", "STABILIZED", "MANUAL")),
        [rq.OffboardVelocity(0.0, 0.0, 0.0), rq.SetMode("OFFBOARD"), (rq.Arm(), NO)],
        [rq.OffboardAttitude((1.0, 0.0, 0.0, 0.0), None, 0.0), rq.SetMode("OFFBOARD"), rq.Arm(), rq.Disarm()],
        [rq.SetMode("HOLD"), {"receiver": True}, 0.5, rq.Arm()],
    ],
    "armed on the ground it idles and gives up": [
        ["armed", IDLE, 9.0, ("command.collective", 0.0), ARMED, 1.0, DISARMED, ("last", "not taken off, disarmed")]
    ],
    "kill shuts the engines off and arming starts them": [
        ["air", rq.Kill(force=True), OFF, DISARMED, (rq.Arm(), "arming refused: it is in the air")],
        [{"altitude": STANDING, "legs": True, "collective": 0.0}, 2.0, ("pilot.landed", LandedState.ON_GROUND), OFF],
        [rq.Arm(), IDLE],
    ],
    "arming by force in the air holds": [["air", rq.Kill(force=True), 0.2, rq.Arm(force=True), FLY, Mode.HOLD]],
    "a vehicle that tips over is shut off": [["armed", {"roll": radians(70.0)}, 0.6, DISARMED, OFF, "tipped over"]],
    **{
        f"sticks of {mode} that stop are let go after half a second": [
            ["air", rq.Sticks(0.5, 0.0, 0.0, 0.5), rq.SetMode(mode), 0.5, Mode(mode)],
            [2 * DT, Mode.HOLD, "sticks lost, holding", ("last", "mode HOLD")],
        ]
        for mode in ("MANUAL", "STABILIZED", "ALTCTL", "POSCTL")
    },
    "setpoints that stop end offboard after half a second": [
        ["air", rq.OffboardVelocity(1.0, 0.0, 0.0), rq.SetMode("OFFBOARD"), 0.5, Mode.OFFBOARD],
        [2 * DT, Mode.HOLD, (rq.SetMode("OFFBOARD"), LATER)],
    ],
    # in the same place after a while, further out at once, and when the fence itself comes nearer
    "a fence that was taken over acts again until it is inside": [
        ["air", rq.SetParameter("HJ_FENCE_ALT", 50.0), {"altitude": 55.0}, 1.0, Mode.RTL],
        [rq.Hold(), 9.0, Mode.HOLD, 1.1, Mode.RTL, rq.Hold(), 1.0, Mode.HOLD, {"altitude": 57.5}, 0.5, Mode.RTL],
        [rq.Hold(), 0.5, rq.SetParameter("HJ_FENCE_ALT", 40.0), 2 * DT, Mode.RTL],
        [rq.Hold(), {"altitude": 30.0}, 12.0, Mode.HOLD],
    ],
    # a pilot may fly it back; who does not, or goes on outwards, has it taken away again
    "a fence that was taken over by stick acts again": [
        ["air", rq.SetParameter("HJ_FENCE_ALT", 50.0), {"altitude": 55.0}, 1.0, Mode.RTL],
        [STICKS, rq.SetMode("POSCTL"), *(BY_STICK * 95), Mode.POSCTL, *(BY_STICK * 10), Mode.RTL],
        [rq.SetMode("POSCTL"), *(BY_STICK * 10), Mode.POSCTL, {"altitude": 57.5}, *(BY_STICK * 2), Mode.RTL],
    ],
    # it acts once: whoever comes back may take over
    **{
        f"link loss by HJ_LINK_ACT {action} is {mode.value} after its delay": [
            ["air", rq.SetParameter("HJ_LINK_ACT", action), rq.SetParameter("HJ_LINK_DELAY", 2.0), rq.LinkLost()],
            [1.9, Mode.HOLD, ("pilot.status.link_lost", True), 0.2, mode, ("pilot.failsafe", "no ground station")],
            [rq.LinkBack(), rq.Hold(), 5.0, Mode.HOLD],
        ]
        for action, mode in enumerate((Mode.HOLD, Mode.HOLD, Mode.RTL, Mode.LAND))
    },
    "a link that comes back in time changes nothing": [["air", rq.LinkLost(), 0.9, rq.LinkBack(), 3.0, Mode.HOLD]],
    "low fuel returns and critical fuel lands": [
        ["air", {"remaining": 0.21}, 0.1, Mode.HOLD, {"remaining": 0.19}, 0.1, Mode.RTL],
        [{"remaining": 0.07}, 0.1, Mode.LAND, ("pilot.failsafe", "energy critical (7 %)")],
    ],
    # hovering for a tenth of the endurance takes a tenth; at 1.5 of hover thrust 1.5^1.5 = 1.837 times as much
    "a battery is emptied by thrust to three halves": [
        ["air", rq.SetParameter("HJ_ENDURANCE", 100.0), 10.0],
        [("pilot.status.remaining", pytest.approx(0.9, abs=1e-9)), {"collective": 1.5 * HOVER}, 10.0],
        [("pilot.status.remaining", pytest.approx(0.9 - 0.1 * 1.5**1.5, abs=1e-9))],
    ],
    "a failed engine lands it": [["air", {"lost": (3,)}, 0.1, Mode.LAND, ("pilot.failsafe", "engine 3 failed")]],
    # who has said that it is only to be told decides
    **{
        f"with a failed engine nothing leaves the ground, {state}": [
            [state, rq.MissionUpload(POINTS), {"lost": (1, 4)}, 0.1, (rq.Takeoff(5.0), f"take-off {FAILED}")],
            [(rq.SetMode("TAKEOFF"), f"take-off {FAILED}"), (rq.MissionStart(), f"mission {FAILED}"), Mode.HOLD],
            [rq.SetParameter("HJ_ENG_ACT", 0.0), rq.Takeoff(5.0)],
        ]
        for state in ("ground", "armed")
    },
    "a failsafe does not undo a more careful one": [
        ["air", {"remaining": 0.05}, 0.1, Mode.LAND, rq.LinkLost(), 2.0, Mode.LAND]
    ],
    "no mode ends the failsafe of a vehicle without engines": [
        ["air", {"lost": (1, 2, 3, 4, 5, 6)}, 0.1, ALL_FAILED],
        *([request, ALL_FAILED] for request in (rq.Hold(), STICKS, rq.SetMode("POSCTL"), rq.ReturnHome())),
    ],
    "items without flight are done at once": [
        ["air", rq.MissionUpload((MissionItem("speed", speed=2.0), MissionItem("speed", speed=3.0), *POINTS))],
        [rq.MissionStart(), ("pilot.mission.current", 2), ("pilot.status.mission_reached", 1)],
    ],
    "a mission without anything to fly holds": [
        ["air", rq.MissionUpload((MissionItem("speed", speed=2.0),)), rq.MissionStart(), 0.1, Mode.HOLD],
        [("pilot.status.mission_done", True), "mission finished"],
    ],
    "waiting counts from the arrival": [
        [
            "air",
            rq.MissionUpload((MissionItem("waypoint", 0.0, 0.0, 10.0, hold_s=3.0), MissionItem("delay", hold_s=2.0))),
        ],
        [rq.MissionStart(), 2.9, ("pilot.mission.current", 0), 0.2, ("pilot.mission.current", 1)],
        [1.7, Mode.MISSION, 0.4, Mode.HOLD],
    ],
    "a mission that is left says what is not flown": [
        ["air", rq.MissionUpload((*POINTS, MissionItem("land"))), rq.MissionSetCurrent(1), rq.MissionStart(), 0.1],
        [rq.LinkLost(), 2.0, Mode.RTL, "mission left at item 1: 2 of 3 not flown"],
    ],
    "items at the ground are told at the upload and flown above it": [
        [
            "air",
            rq.MissionUpload((MissionItem("waypoint", 5.0, 0.0, 0.0), POINTS[0], MissionItem("stay", 5.0, 0.0, -2.0))),
        ],
        ["mission item 0, 2: below 1 m above the ground, flown at that height"],
        [rq.MissionStart(), 0.1, ("pilot.status.target", pytest.approx((5.0, 0.0, 1.0)))],
    ],
}


@pytest.mark.parametrize("phases", STORIES.values(), ids=STORIES)
def test_stories(phases: list[list[Any]]) -> None:
    state, *story = itertools.chain.from_iterable(phases)
    play(world(state), *story)


def test_sticks_lean_and_turn_the_right_way() -> None:
    w = world("air")
    w.ok(rq.SetParameter("HJ_STICK_TIME", 5.0))
    w.ok(rq.Sticks(0.5, 0.8, 0.0, 0.5))
    w.ok(rq.SetMode("STABILIZED"))
    command = w.seconds(2.0)
    # right, and nose down, at 20 degrees of full lean; the middle of the throttle hovers
    assert command.attitude[:2] == pytest.approx((radians(10.0), radians(-16.0)))
    assert command.collective == pytest.approx(HOVER)
    # both sticks at their stops are no more than the full lean
    w.ok(rq.Sticks(1.0, 1.0, 0.0, 1.0))
    command = w.seconds(2.0)
    assert command.attitude[:2] == pytest.approx((radians(20.0 / sqrt(2.0)), -radians(20.0 / sqrt(2.0))))
    assert command.collective == pytest.approx(1.0)
    w.ok(rq.Sticks(0.0, 0.0, 1.0, 0.5))
    w.seconds(0.7)
    first = w.command.attitude[2] if w.command else 0.0
    # the set-point comes up to the stick's rate as it comes up to its heading
    assert w.seconds(DT).attitude[2] - first == pytest.approx(radians(45.0) * DT, rel=0.1)


def test_offboard_attitude_and_rates_are_reached() -> None:
    """Without a step, and what is inside the limits to the value."""
    w = world("air")
    w.ok(rq.SetParameter("HJ_OFFB_TIME", 5.0))
    w.ok(rq.OffboardAttitude(from_euler(0.1, -0.2, 0.3), None, 0.6))
    w.ok(rq.SetMode("OFFBOARD"))
    command = w.seconds(DT)
    assert max(abs(angle) for angle in command.attitude) < 1e-4
    command = w.seconds(2.0)
    assert command.attitude == pytest.approx((0.1, -0.2, 0.3))
    assert (command.collective, command.rate) == (0.6, None)
    # a lean of 40 degrees is no more than that of a full stick
    w.ok(rq.OffboardAttitude(from_euler(radians(40.0), 0.0, 0.3), None, 0.6))
    assert w.seconds(2.0).attitude == pytest.approx((radians(20.0), 0.0, 0.3), abs=1e-9)
    w.ok(rq.OffboardAttitude(None, (0.1, 0.2, 0.3), 0.5))
    assert w.seconds(2.0).rate == pytest.approx((0.1, 0.2, 0.3))


def test_hold_stays_at_the_height_where_it_is_asked_for() -> None:
    """Home 60 m up, as a map's terrain may have it, is no reason to climb; nor is it one to fly somewhere lower."""
    w, there = world("air"), pytest.approx(10.0, abs=1e-9)
    play(w, rq.SetHome(0.0, 0.0, 60.0), rq.Hold(), 3.0, ("pilot.status.altitude", there))
    play(w, rq.Goto(5.0, 0.0), 3.0, ("command.altitude", there))
    # a return that is near enough to land at once does not climb first
    play(w, rq.SetHome(0.5, 0.0, 60.0), rq.ReturnHome(), 0.1)
    assert w.command.altitude <= 10.0


def test_asking_for_hold_again_moves_nothing() -> None:
    """Noise in the measured height and climb is not taken for a new height to stay at."""
    w = world("air")
    w.seconds(1.0)
    held = w.pilot.status.altitude
    for n in range(100):
        w.ok(rq.Hold())
        w.seconds(0.02, sink=(0.3, -0.4)[n % 2], altitude=10.0 + (0.05, -0.02)[n % 2])
        assert w.pilot.status.altitude == held


def test_the_ground_is_where_it_took_off_also_with_home_below_it() -> None:
    """The last metres of a landing are slow; a home 30 m down does not make them fast."""
    for home in (-30.0, 0.0, 60.0):
        w = world("air")
        w.ok(rq.SetHome(0.0, 0.0, home))
        w.ok(rq.Land())
        w.seconds(1.0, altitude=2.5)
        before = w.pilot.status.altitude
        w.seconds(0.2)
        assert before - w.pilot.status.altitude == pytest.approx(0.5 * 0.2, rel=1e-6)


@pytest.mark.parametrize(
    ("parameter", "changes"), [("HJ_FENCE_RAD", {"north": 60.0, "east": 80.0}), ("HJ_FENCE_ALT", {"altitude": 51.0})]
)
def test_the_fence_turns_back_once(parameter: str, changes: dict[str, float]) -> None:
    w = world("air")
    # a jump of the position takes the filter some time to believe
    play(w, rq.SetParameter(parameter, 50.0), 1.0, Mode.HOLD, changes, 15.0, Mode.RTL)
    assert w.pilot.failsafe.startswith("outside the fence: 5")
    play(w, rq.Hold(), 1.0, Mode.HOLD, {"north": 0.0, "east": 0.0, "altitude": 10.0}, 15.0, changes, 15.0, Mode.RTL)


@pytest.mark.parametrize(
    "request_",
    [
        rq.Goto(60.0, 0.0, 10.0),
        rq.Goto(0.0, 0.0, 60.0),
        rq.MissionUpload((MissionItem("waypoint", 0.0, 0.0, 5.0), MissionItem("waypoint", 0.0, -51.0, 5.0))),
    ],
)
def test_nothing_is_planned_outside_the_fence(request_: Any) -> None:
    w = World(airborne=True)
    w.ok(rq.SetParameter("HJ_FENCE_RAD", 50.0))
    w.ok(rq.SetParameter("HJ_FENCE_ALT", 50.0))
    answer = w.ask(request_)
    assert answer.result is Result.DENIED
    assert "the fence is at 50 m" in answer.text
    ground = World()
    ground.ok(rq.SetParameter("HJ_FENCE_ALT", 50.0))
    assert ground.ask(rq.Takeoff(51.0)).result is Result.DENIED


def test_no_take_off_to_a_height_below_the_ground() -> None:
    w = World()
    w.ok(rq.SetHome(0.0, 0.0, STANDING - 50.0))
    answer = w.ask(rq.Takeoff(10.0))
    assert answer.result is Result.DENIED
    assert "stands 50.0 m above it" in answer.text
    play(w, rq.SetHome(0.0, 0.0, STANDING - 2.0), rq.Takeoff(10.0))


def test_loss_of_control_is_said_once_and_messages_are_numbered_without_gaps() -> None:
    w = World(airborne=True)
    w.seconds(3.0, roll=radians(65.0))
    said = [message.severity for message in w.pilot.messages if message.text.startswith("leans as if control")]
    assert said == [Severity.CRITICAL]
    assert [message.number for message in w.pilot.messages] == list(range(1, len(w.pilot.messages) + 1))


def touched(one: Touchdown, time: float, legs: bool, sink: float, collective: float, descending: bool = True) -> None:
    for _ in range(round(time / DT)):
        one.update(sink, 1.0, Report(legs, collective), descending)


def test_contact_counts_only_when_it_lasts() -> None:
    one = Touchdown(HOVER, DT)
    touched(one, 0.15, True, 0.4, HOVER)
    assert not one.is_touching
    touched(one, 0.2, False, 0.0, HOVER)  # a bounce
    touched(one, 0.15, True, 0.0, HOVER)
    assert not one.is_touching
    touched(one, 0.1, True, 0.0, HOVER)
    assert one.is_touching
    touched(one, 1.0, True, 0.0, HOVER)
    assert not one.is_standing  # the thrust is still there
    touched(one, 0.6, True, 0.0, 0.1)
    assert one.is_standing


def test_a_switch_that_reports_contact_while_falling_is_not_believed() -> None:
    one = Touchdown(HOVER, DT)
    touched(one, 1.0, True, 1.5, HOVER)
    assert one.switch_failed
    assert not one.is_touching
    assert one.is_off_ground


def test_touch_down_is_felt_without_a_switch() -> None:
    """A descent is asked for, the collective is too low for one, and the vehicle does not sink."""
    one = Touchdown(HOVER, DT)
    touched(one, 3.0, False, 0.0, 0.9 * HOVER)
    assert not one.is_touching
    touched(one, 1.5, False, 0.0, 0.4 * HOVER)
    assert one.is_touching
    in_hover = Touchdown(HOVER, DT)
    touched(in_hover, 5.0, False, 0.0, 0.4 * HOVER, descending=False)
    assert not in_hover.is_touching


def order(items: tuple[MissionItem, ...]) -> list[int]:
    """The places that are flown, one after another."""
    mission = Mission()
    mission.load(items)
    found = []
    item = mission.skip_jumps()
    while item is not None:
        found.append(mission.current)
        item = mission.advance()
    assert mission.done
    return found


W = MissionItem("delay")


def test_jumps_are_made_as_often_as_they_say() -> None:
    assert order((W, W, W)) == [0, 1, 2]
    assert order((W, W, MissionItem("jump", target=0, repeat=2), W)) == [0, 1, 0, 1, 0, 1, 3]
    assert order((MissionItem("jump", target=2, repeat=1), W, W)) == [2]
    # a loop in a loop: the inner one is made anew each time
    inner = MissionItem("jump", target=0, repeat=1)
    assert order((W, inner, W, MissionItem("jump", target=0, repeat=1))) == [0, 0, 2, 0, 0, 2]
    # a circle of jumps ends
    assert order((MissionItem("jump", target=1, repeat=1000), MissionItem("jump", target=0, repeat=1000))) == []


MOVING = {"north": st.floats(-100, 100), "altitude": st.sampled_from([STANDING, 2.0, 10.0]), "sink": st.floats(-3, 3)}
SAID = {"legs": st.booleans(), "collective": st.floats(0, 1), "lost": st.sampled_from([(), (2,), (1, 6)])}
MORE = {"roll": st.floats(-1.5, 1.5), "remaining": st.none() | st.floats(0, 1)}
CHANGES = st.fixed_dictionaries({}, optional=MOVING | SAID | MORE)
USUAL = [rq.Arm(), rq.Arm(True), rq.Takeoff(5.0), rq.Land(), rq.ReturnHome(), rq.Kill(True), STICKS, LOW]
FLOWN = [rq.OffboardPosition(1.0, 0.0, -5.0), rq.MissionUpload(POINTS), rq.MissionStart()]
MODES = [rq.SetParameter("HJ_FENCE_RAD", 50.0), *(rq.SetMode(mode.value) for mode in Mode)]
LIKELY = st.sampled_from([*USUAL, *FLOWN, *MODES])
REQUESTS = LIKELY | LIKELY | st.one_of(*ANY.values(), *(st.just(kind()) for kind in REST))


@settings(max_examples=40)
@given(st.booleans(), st.lists(st.tuples(REQUESTS, CHANGES, st.integers(1, 60)), max_size=25))
def test_nothing_that_may_be_asked_breaks_it(airborne: bool, story: list[tuple[Any, dict[str, Any], int]]) -> None:
    """Every request gets one answer, every step a finite command, and only an armed vehicle has its engines."""
    w, leant = World(airborne=airborne), 0.0
    for request, changes, steps in story:
        leant = max(leant, abs(changes.get("roll", 0.0)))
        answer = w.ask(request)
        assert answer.accepted is (answer.result is Result.ACCEPTED)
        assert answer.accepted or answer.text
        assert "\n" not in answer.text
        command = w.seconds(steps * DT, **changes)
        pilot = w.pilot
        assert all(isfinite(v) for v in (*command.attitude, command.altitude, *(command.rate or ())))
        assert command.collective is None or 0.0 <= command.collective <= 1.0
        assert (pilot.engines is EngineState.FLY) <= pilot.armed
        assert (pilot.engines is EngineState.OFF) <= (not pilot.armed)
        assert (pilot.landed is LandedState.ON_GROUND) <= (pilot.engines is not EngineState.FLY)
        lean = max(abs(command.attitude[0]), abs(command.attitude[1]))
        if pilot.mode is not Mode.OFFBOARD:
            # the most that a parameter may allow; what is asked for first begins where the vehicle is, as leant as that
            assert lean <= max(radians(46.0), leant + 1e-9)
        assert pilot.status.ready is not bool(pilot.status.refusals)


def test_a_mission_that_was_not_flown_says_nothing_of_it() -> None:
    w = world("ground")
    play(w, rq.MissionUpload(POINTS), rq.MissionStart(), rq.Hold())
    assert not any("not flown" in text for text in w.texts())


def test_after_a_landing_on_the_way_a_failed_engine_ends_the_mission() -> None:
    w = world("armed")
    play(w, rq.MissionUpload((MissionItem("land"), *POINTS)), rq.MissionStart())
    w.pilot.arming.flew = True
    play(w, {"lost": (3,)}, 0.1, ("pilot.armed", False))
    left = "mission left at item 1: 2 of 3 not flown"
    assert w.texts()[-2:] == [left, "mission item 1 refused: engine 3 failed, disarmed"]


def test_the_way_home_begins_where_it_stops_and_at_the_usual_speed() -> None:
    """It counted from where the vehicle was, and at the speed that was set for sightseeing."""
    w = world("air")
    w.pilot.energy.hover_burn = 0.001
    w.ok(rq.SetHome(0.0, 0.0, 0.0))
    w.seconds(0.1, north=60.0)
    energy, fix = w.pilot.energy, w.pilot.estimates.fix
    still = energy.needed_fractions()[0]
    assert still == pytest.approx(0.001 * energy.return_time(fix.position, 10.0), rel=1e-3)
    w.ok(rq.SetSpeed(1.0))
    assert energy.needed_fractions()[0] == still
    # 5 m/s, at 1.5 m/s^2 and 1.5 m/s^3: 3.3 s to stop and 1 s of jerk, half of it at the full speed
    a, j = (w.pilot.parameters[name] for name in ("HJ_ACC_HOR", "HJ_JERK_HOR"))
    w.pilot.estimates.fix = fix._replace(velocity=(5.0, 0.0))
    stop = 5.0 / a + a / j
    there = (fix.position[0] + 2.5 * stop, fix.position[1])
    assert energy.needed_fractions()[0] == pytest.approx(0.001 * (stop + energy.return_time(there, 10.0)), rel=1e-3)
    w.ok(rq.ReturnHome())
    w.seconds(0.1)
    assert w.pilot.course.cruise is None
