"""Every command: what the pilot is asked, and exactly one acknowledgement, to who asked."""

from __future__ import annotations

import re
from dataclasses import replace
from math import nan, pi
from typing import Any

import pytest
from mavlink_tools import ABOUT, GEODESY, Bench, Desk, command, status

from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.modes import Mode
from cosim.control.autopilot.requests import Answer, Request, Result
from cosim.groundstation.mavlink.modes import MODES
from cosim.groundstation.mavlink.wire.dialect import mav

ACCEPTED, TEMPORARILY, DENIED, UNSUPPORTED, FAILED, FRAME = 0, 1, 2, 3, 4, 9
# The vehicle of the bench is 10 m above its origin, home is at 2 m, the ground at 12 m above the sea.
LAT, LON, _ = GEODESY.to_geodetic(50.0, -20.0, 30.0)


def result(desk: Desk, message: Any) -> tuple[int, list[Request]]:
    """The one acknowledgement of a command, and what the pilot was asked."""
    desk.bench.pilot.asked.clear()
    desk.ask(message)
    (ack,) = desk.named("COMMAND_ACK")
    assert (ack.target_system, ack.target_component) == (255, 190)
    assert ack.command == message.command
    return ack.result, desk.bench.pilot.asked


FLIGHT: list[tuple[int, tuple[float, ...], list[Request]]] = [
    (400, (1.0,), [rq.Arm()]),
    (400, (1.0, 21196.0), [rq.Arm(True)]),
    (400, (0.0,), [rq.Disarm()]),
    (400, (0.0, 21196.0), [rq.Disarm(True)]),
    (22, (), [rq.Takeoff()]),
    (22, (nan, nan, nan, nan, nan, nan, 42.0), [rq.Takeoff(28.0)]),  # 42 m above the sea: 28 m above home
    (21, (), [rq.Land()]),
    (21, (0.0,) * 7, [rq.Land()]),
    (20, (), [rq.ReturnHome()]),
    (17, (), [rq.Hold()]),
    (192, (-1.0, 1.0, 0.0, nan, nan, nan, nan), [rq.Hold()]),
    (34, (-8.0, nan, nan, nan, nan, nan, nan), [rq.Orbit(8.0, False)]),
    (34, (20.0, 2.5, 3.0, 0.0, nan, nan, 42.0), [rq.Orbit(20.0, True, 2.5, altitude=30.0, yaw=rq.OrbitYaw.TANGENT)]),
    (193, (0.0,), [rq.Hold()]),
    (193, (1.0,), [rq.MissionStart()]),
    (300, (0.0, 0.0), [rq.MissionStart()]),
    (300, (), [rq.MissionStart()]),
    (300, (3.0,), [rq.MissionSetCurrent(3), rq.MissionStart()]),
    (224, (2.0,), [rq.MissionSetCurrent(2)]),
    (178, (1.0, 5.0, -1.0), [rq.SetSpeed(5.0)]),
    (178, (nan, 5.0), [rq.SetSpeed(5.0)]),
    (179, (1.0,), [rq.SetHome()]),
    (185, (1.0,), [rq.Kill(True)]),
    (115, (90.0, 20.0, 1.0, 0.0), [rq.Goto(yaw=pi / 2)]),
    (115, (90.0, 20.0, -1.0, 1.0), [rq.Goto(yaw=0.0)]),  # to the left of a nose that points east
    (262, (1.0,), [rq.SetMode("POSCTL")]),
    (262, (5.0,), [rq.SetMode("RTL")]),
    (420, (101.0, 1.0, 3.0), [rq.InjectFault("flame_out", (3,))]),
    (420, (101.0, 1.0, 0.0), [rq.InjectFault("flame_out", (1, 2, 3, 4, 5, 6))]),
    (420, (101.0, 2.0, 1.0), [rq.InjectFault("stuck_throttle", (1,))]),
    (420, (101.0, 4.0, 1.0), [rq.InjectFault("thrust_loss", (1,), amount=0.5)]),
    (420, (101.0, 5.0, 1.0), [rq.InjectFault("slow_spool", (1,), amount=0.5)]),
    (420, (101.0, 6.0, 1.0), [rq.InjectFault("delay_growth", (1,), amount=0.1)]),
    (420, (102.0, 2.0, 2.0), [rq.InjectFault("servo_jam", servo="right")]),
    (420, (102.0, 2.0), [rq.InjectFault("servo_jam", servo="left"), rq.InjectFault("servo_jam", servo="right")]),
    (420, (0.0, 4.0), [rq.InjectFault("sensor_bias", sensor="gyro", vector=(0.05, 0.0, 0.0))]),
    (420, (3.0, 4.0), [rq.InjectFault("sensor_bias", sensor="barometer", amount=3.0)]),
    (420, (4.0, 1.0), [rq.InjectFault("sensor_dropout", sensor="gnss")]),
    (420, (101.0, 0.0, 3.0), [rq.ClearFaults()]),
    *[
        (176, (209.0, float(main), float(sub)), [rq.SetMode(mode)])
        for mode, main, sub in (
            ("MANUAL", 1, 0), ("ALTCTL", 2, 0), ("POSCTL", 3, 0), ("TAKEOFF", 4, 2), ("HOLD", 4, 3), ("MISSION", 4, 4),
            ("RTL", 4, 5), ("LAND", 4, 6), ("OFFBOARD", 6, 0), ("STABILIZED", 7, 0),
        )
    ],
]  # fmt: skip


def near(found: list[Request], wanted: list[Request], within: float = 1e-6) -> bool:
    """The same records; numbers may have gone through 32 bits, and a place is so many metres off at most."""
    if [type(each) for each in found] != [type(each) for each in wanted]:
        return False
    return all(
        a == b or a == pytest.approx(b, rel=1e-5, abs=within if name in ("north", "east") else 1e-3 * within)
        for x, y in zip(found, wanted, strict=True)
        for (name, a), b in zip(vars(x).items(), vars(y).values(), strict=True)
    )


@pytest.mark.parametrize(("number", "p", "wanted"), FLIGHT)
def test_what_the_pilot_is_asked(desk: Desk, number: int, p: tuple[float, ...], wanted: list[Request]) -> None:
    ack, asked = result(desk, command(number, *p))
    assert ack == ACCEPTED
    assert near(asked, wanted), asked


@pytest.mark.parametrize("number", sorted({row[0] for row in FLIGHT}))
@pytest.mark.parametrize("how", list(Result))
def test_the_answer_of_the_pilot_is_the_acknowledgement(desk: Desk, number: int, how: Result) -> None:
    _, p, wanted = next(row for row in FLIGHT if row[0] == number)
    text = f"no {number}"
    for kind in {type(request) for request in wanted}:
        desk.bench.pilot.answers[kind] = Answer(how is Result.ACCEPTED, how, text)
    ack, asked = result(desk, command(number, *p))
    assert ack == {"ACCEPTED": 0, "TEMPORARILY_REJECTED": 1, "DENIED": 2, "UNSUPPORTED": 3, "FAILED": 4}[how.name]
    if how is not Result.ACCEPTED:
        assert len(asked) == 1  # what follows a refusal is not asked
    told = [message.text for message in desk.named("STATUSTEXT")]
    # why a vehicle is not armed the pilot says itself, to everybody
    assert told == ([] if how is Result.ACCEPTED or (number == 400 and wanted == [rq.Arm()]) else [text])


REFUSED: list[tuple[int, tuple[float, ...], int]] = [
    (400, (2.0,), DENIED),
    (400, (), DENIED),
    (22, (nan, nan, nan, nan, nan, nan, 10.0), DENIED),  # 10 m above the sea is below the vehicle
    (22, (nan, nan, nan, nan, nan, nan, 1e30), DENIED),
    (21, (nan, nan, nan, nan, LAT, LON, 0.0), DENIED),  # far from here
    (176, (209.0, 4.0, 9.0), UNSUPPORTED),
    (176, (209.0, 5.0, 0.0), UNSUPPORTED),  # ACRO
    (176, (208.0, 4.0, 3.0), UNSUPPORTED),  # not a custom mode
    (176, (), UNSUPPORTED),
    (178, (0.0, nan), DENIED),
    (178, (2.0, 3.0), DENIED),  # climb speed
    (178, (1.0, 1e9), DENIED),
    (179, (0.0, nan, nan, nan, nan, nan, nan), DENIED),
    (179, (0.0, nan, nan, nan, 95.0, 0.0, 0.0), DENIED),
    (185, (0.0,), DENIED),
    (192, (-1.0, 1.0, 0.0, nan, 0.1, 200.0, 30.0), DENIED),
    (192, (-1.0, 1.0, 0.0, nan, 10.0, 20.0, 30.0), DENIED),  # a thousand kilometres away
    (115, (), DENIED),
    (193, (7.0,), DENIED),
    (224, (-1.0,), DENIED),
    (224, (1e9,), DENIED),
    (262, (2.0,), UNSUPPORTED),
    (246, (1.0,), UNSUPPORTED),
    (420, (101.0, 1.0, 7.0), DENIED),
    (420, (101.0, 3.0, 1.0), UNSUPPORTED),
    (420, (1.0, 1.0), UNSUPPORTED),  # no accelerometer
    (420, (102.0, 2.0, 3.0), DENIED),
    (420, (), UNSUPPORTED),
    (510, (70000.0,), UNSUPPORTED),
    (510, (), UNSUPPORTED),
    (511, (30.0, -5.0), DENIED),
    (511, (30.0,), DENIED),
    (511, (9999.0, 1000.0), UNSUPPORTED),
    (512, (435.0, 99.0), DENIED),
    (512, (9999.0,), UNSUPPORTED),
    (512, (), UNSUPPORTED),
    (512, (397.0,), UNSUPPORTED),  # nobody brought it
    (241, (1.0,), UNSUPPORTED),  # calibration
    (521, (1.0,), UNSUPPORTED),
    (2520, (1.0,), UNSUPPORTED),
    (65535, (), UNSUPPORTED),
]


@pytest.mark.parametrize(("number", "p", "wanted"), REFUSED)
def test_what_is_refused_without_the_pilot(desk: Desk, number: int, p: tuple[float, ...], wanted: int) -> None:
    assert result(desk, command(number, *p)) == (wanted, [])


def command_int(number: int, frame: int, *p: float, x: int = 0x7FFFFFFF, y: int = 0x7FFFFFFF, z: float = nan) -> Any:
    values = [*p, *[nan] * (4 - len(p))]
    return mav.MAVLink_command_int_message(1, 1, frame, number, 0, 0, *values, x, y, z)


PLACE = {"x": round(LAT * 1e7), "y": round(LON * 1e7)}


@pytest.mark.parametrize(
    ("message", "wanted", "within"),
    [
        # 32 bits of a degree are up to 0.5 m; the other message has 1e-7 deg
        (command(192, 3.0, 1.0, 0.0, 1.0, LAT, LON, 42.0), rq.Goto(50.0, -20.0, 30.0, yaw=1.0, speed=3.0), 0.6),
        (command_int(192, 0, -1.0, 1.0, 0.0, nan, **PLACE, z=42.0), rq.Goto(50.0, -20.0, 30.0), 0.02),
        (command_int(192, 5, -1.0, 1.0, 0.0, nan, **PLACE, z=42.0), rq.Goto(50.0, -20.0, 30.0), 0.02),
        (command_int(192, 3, -1.0, 1.0, 0.0, nan, **PLACE, z=28.0), rq.Goto(50.0, -20.0, 30.0), 0.02),
        (command_int(192, 6, -1.0, 1.0, 0.0, nan, **PLACE, z=28.0), rq.Goto(50.0, -20.0, 30.0), 0.02),
        (command_int(192, 3, -1.0, 1.0, 0.0, nan, z=15.0), rq.Goto(altitude=17.0), 1e-6),
        (command(192, nan, nan, nan, 4.0), rq.Goto(yaw=4.0 - 2 * pi), 1e-6),
        (command_int(179, 0, 0.0, **PLACE, z=42.0), rq.SetHome(50.0, -20.0, 30.0), 0.02),
    ],
)
def test_places_and_headings_by_either_message(desk: Desk, message: Any, wanted: Request, within: float) -> None:
    ack, asked = result(desk, message)
    assert ack == ACCEPTED
    assert near(asked, [wanted], within), asked


@pytest.mark.parametrize("number", [22, 179, 192])
def test_a_frame_that_is_not_understood(desk: Desk, number: int) -> None:
    assert result(desk, command_int(number, 8, 0.0, 1.0, **PLACE, z=50.0)) == (FRAME, [])


def test_a_place_that_is_too_far_is_told_in_kilometres(desk: Desk) -> None:
    for number in (179, 192):
        assert result(desk, command_int(number, 0, 0.0, x=466000000, y=66000000, z=42.0)) == (DENIED, [])
        told = "".join(m.text for m in desk.named("STATUSTEXT"))
        assert re.search(r"46\.6, 6\.6 is \d+ km from where the flight began; 100 km is the most", told), told


def test_the_origin_is_told_and_stays(desk: Desk) -> None:
    """DO_SET_GLOBAL_ORIGIN is answered, with the origin that there is, whatever it asks for."""
    here = command_int(611, 0, 0.0, x=223500000, y=1135900000, z=12.0)
    elsewhere = command_int(611, 0, 0.0, x=223600000, y=1135900000, z=12.0)
    for message, wanted in ((here, ACCEPTED), (elsewhere, DENIED), (command(611), DENIED)):
        assert result(desk, message) == (wanted, [])
        (origin,) = desk.named("GPS_GLOBAL_ORIGIN")
        assert (origin.latitude, origin.longitude) == (223500000, 1135900000)
        assert bool(desk.named("STATUSTEXT")) == (wanted == DENIED)


@pytest.mark.parametrize("personality", ["ardupilot", "generic"])
def test_take_off_height_and_modes_depend_on_the_personality(personality: Any) -> None:
    bench = Bench(replace(ABOUT, personality=personality))
    desk = bench.station()
    bench.step()
    if personality == "ardupilot":
        assert result(desk, command(22, *[nan] * 6, 10.0)) == (ACCEPTED, [rq.Takeoff(10.0)])
        assert result(desk, command(176, 1.0, 6.0)) == (ACCEPTED, [rq.SetMode("RTL")])
        assert result(desk, command(176, 1.0, 99.0)) == (UNSUPPORTED, [])
    else:
        assert result(desk, command(22, *[nan] * 6, 10.0)) == (DENIED, [])
        assert result(desk, command(176, 1.0, 4.0, 5.0)) == (ACCEPTED, [rq.SetMode("RTL")])
    (beat,) = [desk.ask(command(512, 0.0))[1]]
    assert beat.autopilot == {"ardupilot": 3, "generic": 0}[personality]
    assert beat.type == 13
    assert result(desk, command_int(22, 3, z=10.0)) == (ACCEPTED, [rq.Takeoff(10.0)])
    bench.close()


@pytest.mark.parametrize(
    ("message", "name"),
    [
        (command(512, 148.0), "AUTOPILOT_VERSION"),
        (command(520, 1.0), "AUTOPILOT_VERSION"),
        (command(519, 1.0), "PROTOCOL_VERSION"),
        (command(410), "HOME_POSITION"),
        (command(512, 115.0), "HIL_STATE_QUATERNION"),
        (command(512, 244.0, 30.0), "MESSAGE_INTERVAL"),
    ],
)
def test_requested_messages_follow_the_acknowledgement(desk: Desk, message: Any, name: str) -> None:
    assert [answer.get_type() for answer in desk.ask(message)] == ["COMMAND_ACK", name]


def test_a_home_that_is_not_known_yet(desk: Desk) -> None:
    desk.bench.pilot.status = status(home=None)
    desk.bench.step(0.1)
    assert result(desk, command(512, 242.0)) == (TEMPORARILY, [])


def test_what_others_bring_is_there_on_request() -> None:
    bench = Bench(on_request={397: lambda ms: mav.MAVLink_component_metadata_message(ms, 7, b"mftp:///x")})
    desk = bench.station()
    bench.step()
    ack, answer = desk.ask(command(512, 397.0))
    assert (ack.result, answer.file_crc, answer.uri) == (ACCEPTED, 7, "mftp:///x")
    bench.close()


def test_modes_are_listed_by_px4s_numbers(desk: Desk) -> None:
    _, *lines = desk.ask(command(512, 435.0, 0.0))
    assert [line.mode_index for line in lines] == list(range(1, len(MODES) + 1))
    assert {line.number_modes for line in lines} == {len(MODES)}
    # PX4's numbers: what QGroundControl's buttons look for
    px4 = {"Hold": 0x03040000, "Return": 0x05040000, "Land": 0x06040000, "Takeoff": 0x02040000}
    px4 |= {"Mission": 0x04040000, "Manual": 0x00010000}
    assert px4.items() <= {line.mode_name: line.custom_mode for line in lines}.items()
    _, line = desk.ask(command(512, 435.0, 3.0))
    assert line.mode_index == 3


@pytest.mark.parametrize("mode", [mode for mode in Mode if mode is not Mode.ORBIT])
def test_set_mode_has_no_acknowledgement_and_shows_at_once(desk: Desk, mode: Mode) -> None:
    custom = {line.mode: line for line in MODES}[mode]
    _, *lines = desk.ask(command(512, 435.0))
    number = next(line.custom_mode for line in lines if line.mode_name == custom.name)
    desk.bench.pilot.asked.clear()
    desk.ask(mav.MAVLink_set_mode_message(1, 1 | 128, number), 0.02)
    assert desk.bench.pilot.asked == [rq.SetMode(mode.value)]
    assert not desk.named("COMMAND_ACK")
    if mode is not Mode.HOLD:  # where it was
        assert desk.named("HEARTBEAT")[0].custom_mode == number
        assert desk.named("CURRENT_MODE")[0].custom_mode == number


def test_set_mode_says_why_not(desk: Desk) -> None:
    desk.bench.pilot.answers[rq.SetMode] = Answer(False, Result.DENIED, "needs sticks")
    desk.ask(mav.MAVLink_set_mode_message(1, 1, 3 << 16))
    assert [m.text for m in desk.named("STATUSTEXT")] == ["needs sticks"]
    desk.ask(mav.MAVLink_set_mode_message(1, 1, 99 << 16))
    assert "not known" in desk.named("STATUSTEXT")[0].text


def test_prearm_checks_say_what_is_missing(desk: Desk) -> None:
    refusals = ("not level: leans 20 deg, 10 deg are allowed", "engine 3 failed")
    desk.bench.pilot.status = status(ready=False, refusals=refusals)
    desk.bench.step(0.01)
    assert result(desk, command(401)) == (ACCEPTED, [])
    assert "".join(m.text for m in desk.named("STATUSTEXT")) == f"not ready: {'; '.join(refusals)}"


def test_a_command_for_another_is_left_alone(desk: Desk) -> None:
    for message in (command(400, 1.0, target=2), command(400, 1.0, component=100)):
        assert not [m for m in desk.ask(message) if m.get_type() == "COMMAND_ACK"]
    assert desk.bench.link.refused["other vehicle"] == 2
    assert not desk.bench.pilot.asked
    # to everybody is also to this one
    assert result(desk, command(400, 1.0, target=0, component=0)) == (ACCEPTED, [rq.Arm()])


def test_a_second_sender_gets_its_own_acknowledgement(bench: Bench) -> None:
    senders = {(255, 190): 20, (245, 191): 21}
    desks = {sender: bench.station(*sender) for sender in senders}
    bench.step()
    for sender, number in senders.items():
        desks[sender].got.clear()
        desks[sender].send(command(number))
    bench.step()
    for sender, number in senders.items():
        (ack,) = desks[sender].named("COMMAND_ACK")
        assert (ack.command, ack.target_system, ack.target_component) == (number, *sender)


def test_a_flight_that_does_not_answer(desk: Desk) -> None:
    """One acknowledgement all the same, and what was asked is not done later."""
    bench = desk.bench
    desk.got.clear()
    desk.send(command(400, 1.0))
    asked = bench.time
    bench.vehicle.poll(asked + 2.0 - 0.01)
    assert not desk.named("COMMAND_ACK")
    bench.time = asked + 2.0 + 0.01
    bench.vehicle.poll(bench.time)
    (ack,) = desk.named("COMMAND_ACK")
    assert ack.result == FAILED
    assert bench.exchange.take_requests(1) == []


def test_an_answer_that_comes_too_late_is_not_a_second_one(desk: Desk) -> None:
    bench = desk.bench
    desk.got.clear()
    desk.send(command(20))
    (waiting,) = bench.exchange.take_requests(2)
    bench.vehicle.poll(bench.time + 2.0 + 0.01)
    waiting.answer(Answer(True, Result.ACCEPTED, ""))
    bench.vehicle.poll(bench.time + 2.0 + 0.02)
    assert len(desk.named("COMMAND_ACK")) == 1


def test_asked_twice_before_the_answer_is_answered_once(desk: Desk) -> None:
    desk.got.clear()
    desk.send(command(22))
    desk.send(command(22, confirmation=1))
    desk.bench.step()
    assert len(desk.named("COMMAND_ACK")) == 1
    assert desk.bench.pilot.asked == [rq.Takeoff()]


@pytest.mark.parametrize("message", [command(22), command(420, 101.0, 1.0, 2.0)])
def test_a_lost_acknowledgement_does_not_repeat_what_is_done_once(desk: Desk, message: Any) -> None:
    assert len(result(desk, message)[1]) == 1
    assert result(desk, message) == (ACCEPTED, [])
    desk.bench.step(6.0)
    assert len(result(desk, message)[1]) == 1  # so much later it is meant
    result(desk, command(21))
    assert len(result(desk, message)[1]) == 1  # and behind another command


def test_too_many_at_once_are_put_off(desk: Desk) -> None:
    desk.got.clear()
    for i in range(300):
        desk.send(command(178, 1.0, 1.0 + i / 1000.0))
    desk.bench.step()
    acks = [m.result for m in desk.named("COMMAND_ACK")]
    assert len(acks) == 300
    assert acks.count(TEMPORARILY) == desk.bench.exchange.turned_away == 300 - 64


def asked(desk: Desk, message: Any) -> list[Request]:
    desk.bench.pilot.asked.clear()
    desk.ask(message)
    assert not desk.named("COMMAND_ACK")
    return desk.bench.pilot.asked


def manual(x: int, y: int, z: int, r: int, target: int = 1) -> Any:
    return mav.MAVLink_manual_control_message(target, x, y, z, r, 0)


def test_sticks_are_scaled_and_invalid_ones_refused(desk: Desk) -> None:
    assert asked(desk, manual(500, -250, 600, 100)) == [rq.Sticks(roll=-0.25, pitch=0.5, yaw=0.1, throttle=0.6)]
    assert asked(desk, manual(0, 0, -1000, 0)) == [rq.Sticks(0.0, 0.0, 0.0, 0.0)]
    assert asked(desk, manual(0, 0, 500, 0, target=2)) == []
    for wrong in (manual(0x7FFF, 0, 0, 0), manual(0, 1001, 0, 0), manual(0, 0, 0x7FFF, 0)):
        assert asked(desk, wrong) == []
    assert desk.bench.link.refused["value"] == 3
    texts = [m for m in desk.got if m.get_type() == "STATUSTEXT"]
    assert len(texts) <= 1  # they come 25 times a second


def test_the_last_sticks_count(desk: Desk) -> None:
    desk.bench.pilot.asked.clear()
    for i in range(100):
        desk.send(manual(i, 0, 500, 0))
    desk.bench.step()
    assert desk.bench.pilot.asked == [rq.Sticks(0.0, 0.099, 0.0, 0.5)]


ALL = 0b1111_1111_1111


def local(mask: int, *values: float, frame: int = 1) -> Any:
    return mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *values)


def attitude(mask: int, q: list[float], *rates: float, thrust: float = 0.5) -> Any:
    return mav.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, *(rates or [0.0] * 3), thrust)


def over_globe(frame: int, mask: int, x: int, y: int, *values: float) -> Any:
    more = [0.0] * (9 - len(values))
    return mav.MAVLink_set_position_target_global_int_message(0, 1, 1, frame, mask, x, y, *values, *more)


LEVEL = [1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("mask", "frame", "wanted"),
    [
        (0b1001_1111_1000, 1, rq.OffboardPosition(1.0, 2.0, -3.0, 0.5)),
        (0b0101_1100_0111, 1, rq.OffboardVelocity(4.0, 5.0, -6.0, None, 0.25)),
        (0b1101_1100_0111, 1, rq.OffboardVelocity(4.0, 5.0, -6.0)),
        (0b1101_1100_0000, 1, rq.OffboardPosition(1.0, 2.0, -3.0)),  # both: the position
        (0b1101_1111_1000, 7, rq.OffboardPosition(4.0, 6.0, -13.0)),  # offset: from (3, 4) and 10 m up
        # by the nose, which points east
        (0b1101_1100_0111, 8, rq.OffboardVelocity(-5.0, 4.0, -6.0)),
        (0b1101_1111_1000, 9, rq.OffboardPosition(3.0 - 2.0, 4.0 + 1.0, -13.0)),
    ],
)
def test_local_set_points_become_offboard_requests(desk: Desk, mask: int, frame: int, wanted: Request) -> None:
    message = local(mask, 1.0, 2.0, -3.0, 4.0, 5.0, -6.0, 0.0, 0.0, 0.0, 0.5, 0.25, frame=frame)
    assert near(asked(desk, message), [wanted])


@pytest.mark.parametrize(
    "message",
    [
        local(ALL, *[0.0] * 11),
        local(0b1101_1111_1001, *[0.0] * 11),  # a position without north
        local(0b1101_1111_1000, nan, *[0.0] * 10),
        local(0b1101_1100_0111, *[0.0] * 3, float("inf"), *[0.0] * 7),
        local(0b1101_1111_1000, 1e30, *[0.0] * 10),
        local(0b1101_1111_1000, *[0.0] * 11, frame=20),
        attitude(0b1000_0001, LEVEL),
        attitude(0b0100_0111, LEVEL),
        attitude(7, [2.0, 0.0, 0.0, 0.0]),
        attitude(7, LEVEL, thrust=nan),
        over_globe(10, 0b1101_1111_1000, **PLACE),
        over_globe(5, 0b1101_1111_1000, 2_000_000_000, 0, 9.0),
    ],
)
def test_a_set_point_that_says_nothing_is_counted(desk: Desk, message: Any) -> None:
    assert asked(desk, message) == []
    assert desk.bench.link.refused["value"] == 1
    assert len(desk.named("STATUSTEXT")) >= 1
    assert not desk.bench.link.failures


@pytest.mark.parametrize(
    ("message", "wanted"),
    [
        *(
            (over_globe(frame, 0b1101_1111_1000, *PLACE.values(), height), rq.OffboardPosition(50.0, -20.0, -30.0))
            for frame, height in ((0, 42.0), (5, 42.0), (6, 28.0))
        ),
        (over_globe(6, 0b1101_1100_0111, 0, 0, 0.0, 1.0, 2.0, 3.0), rq.OffboardVelocity(1.0, 2.0, 3.0)),
        (attitude(7, LEVEL, 9.0, 9.0, 9.0), rq.OffboardAttitude(quaternion=(1.0, 0.0, 0.0, 0.0), thrust=0.5)),
        (attitude(128, [nan] * 4, 1.0, 2.0, 3.0), rq.OffboardAttitude(rates=(1.0, 2.0, 3.0), thrust=0.5)),
    ],
)
def test_set_points_over_the_globe_and_of_attitude(desk: Desk, message: Any, wanted: Request) -> None:
    assert near(asked(desk, message), [wanted], 0.02)
