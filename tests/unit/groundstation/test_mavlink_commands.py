"""Every command: what the pilot is asked, and exactly one acknowledgement, to who asked."""

from __future__ import annotations

import re
from dataclasses import replace
from math import nan, pi
from typing import Any

import pytest
from mavlink_tools import ABOUT, GEODESY, Bench, Desk, command, status

from cosim.control.autopilot.modes import Mode
from cosim.control.autopilot.requests import (
    Answer,
    Arm,
    ClearFaults,
    Disarm,
    Goto,
    Hold,
    InjectFault,
    Kill,
    Land,
    MissionSetCurrent,
    MissionStart,
    OffboardAttitude,
    OffboardPosition,
    OffboardVelocity,
    Orbit,
    OrbitYaw,
    Request,
    Result,
    ReturnHome,
    SetHome,
    SetMode,
    SetSpeed,
    Sticks,
    Takeoff,
)
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
    (400, (1.0,), [Arm()]),
    (400, (1.0, 21196.0), [Arm(True)]),
    (400, (0.0,), [Disarm()]),
    (400, (0.0, 21196.0), [Disarm(True)]),
    (22, (), [Takeoff()]),
    (22, (nan, nan, nan, nan, nan, nan, 42.0), [Takeoff(28.0)]),  # 42 m above the sea: 28 m above home
    (21, (), [Land()]),
    (21, (0.0,) * 7, [Land()]),
    (20, (), [ReturnHome()]),
    (17, (), [Hold()]),
    (192, (-1.0, 1.0, 0.0, nan, nan, nan, nan), [Hold()]),
    (34, (-8.0, nan, nan, nan, nan, nan, nan), [Orbit(8.0, False)]),
    (34, (20.0, 2.5, 3.0, 0.0, nan, nan, 42.0), [Orbit(20.0, True, 2.5, altitude=30.0, yaw=OrbitYaw.TANGENT)]),
    (193, (0.0,), [Hold()]),
    (193, (1.0,), [MissionStart()]),
    (300, (0.0, 0.0), [MissionStart()]),
    (300, (), [MissionStart()]),
    (300, (3.0,), [MissionSetCurrent(3), MissionStart()]),
    (224, (2.0,), [MissionSetCurrent(2)]),
    (178, (1.0, 5.0, -1.0), [SetSpeed(5.0)]),
    (178, (nan, 5.0), [SetSpeed(5.0)]),
    (179, (1.0,), [SetHome()]),
    (185, (1.0,), [Kill(True)]),
    (115, (90.0, 20.0, 1.0, 0.0), [Goto(yaw=pi / 2)]),
    (115, (90.0, 20.0, -1.0, 1.0), [Goto(yaw=0.0)]),  # to the left of a nose that points east
    (262, (1.0,), [SetMode("POSCTL")]),
    (262, (5.0,), [SetMode("RTL")]),
    (420, (101.0, 1.0, 3.0), [InjectFault("flame_out", (3,))]),
    (420, (101.0, 1.0, 0.0), [InjectFault("flame_out", (1, 2, 3, 4, 5, 6))]),
    (420, (101.0, 2.0, 1.0), [InjectFault("stuck_throttle", (1,))]),
    (420, (101.0, 4.0, 1.0), [InjectFault("thrust_loss", (1,), amount=0.5)]),
    (420, (101.0, 5.0, 1.0), [InjectFault("slow_spool", (1,), amount=0.5)]),
    (420, (101.0, 6.0, 1.0), [InjectFault("delay_growth", (1,), amount=0.1)]),
    (420, (102.0, 2.0, 2.0), [InjectFault("servo_jam", servo="right")]),
    (420, (102.0, 2.0), [InjectFault("servo_jam", servo="left"), InjectFault("servo_jam", servo="right")]),
    (420, (0.0, 4.0), [InjectFault("sensor_bias", sensor="gyro", vector=(0.05, 0.0, 0.0))]),
    (420, (3.0, 4.0), [InjectFault("sensor_bias", sensor="barometer", amount=3.0)]),
    (420, (4.0, 1.0), [InjectFault("sensor_dropout", sensor="gnss")]),
    (420, (101.0, 0.0, 3.0), [ClearFaults()]),
    *[
        (176, (209.0, float(main), float(sub)), [SetMode(mode)])
        for mode, main, sub in (
            ("MANUAL", 1, 0), ("ALTCTL", 2, 0), ("POSCTL", 3, 0), ("TAKEOFF", 4, 2), ("HOLD", 4, 3), ("MISSION", 4, 4),
            ("RTL", 4, 5), ("LAND", 4, 6), ("OFFBOARD", 6, 0), ("STABILIZED", 7, 0),
        )
    ],
]  # fmt: skip


def near(found: list[Request], wanted: list[Request]) -> bool:
    """The same records; numbers may have gone through 32 bits."""
    if [type(each) for each in found] != [type(each) for each in wanted]:
        return False
    return all(
        a == b or a == pytest.approx(b, rel=1e-5, abs=1e-6)
        for x, y in zip(found, wanted, strict=True)
        for a, b in zip(vars(x).values(), vars(y).values(), strict=True)
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
    assert told == ([] if how is Result.ACCEPTED or (number == 400 and wanted == [Arm()]) else [text])


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


def test_goto_by_either_message(desk: Desk) -> None:
    place = (50.0, -20.0)
    ack, asked = result(desk, command(192, 3.0, 1.0, 0.0, 1.0, LAT, LON, 42.0))
    assert ack == ACCEPTED
    (goto,) = asked
    assert isinstance(goto, Goto)
    # 32 bits of a degree are up to 0.5 m; the other message has 1e-7 deg
    assert (goto.north, goto.east) == pytest.approx(place, abs=0.6)
    assert (goto.altitude, goto.yaw, goto.speed) == pytest.approx((30.0, 1.0, 3.0))
    for frame, z in ((0, 42.0), (5, 42.0), (3, 28.0), (6, 28.0)):
        message = command_int(192, frame, -1.0, 1.0, 0.0, nan, x=round(LAT * 1e7), y=round(LON * 1e7), z=z)
        ack, (goto,) = result(desk, message)
        assert ack == ACCEPTED
        assert isinstance(goto, Goto)
        assert (goto.north, goto.east, goto.altitude) == pytest.approx((*place, 30.0), abs=0.02)
        assert goto.yaw is None
        assert goto.speed is None


def test_a_height_alone_and_a_heading_alone(desk: Desk) -> None:
    assert result(desk, command_int(192, 3, -1.0, 1.0, 0.0, nan, z=15.0)) == (ACCEPTED, [Goto(altitude=17.0)])
    _, (goto,) = result(desk, command(192, nan, nan, nan, 4.0))
    assert isinstance(goto, Goto)
    assert goto.yaw == pytest.approx(4.0 - 2 * pi)


@pytest.mark.parametrize("number", [22, 179, 192])
def test_a_frame_that_is_not_understood(desk: Desk, number: int) -> None:
    message = command_int(number, 8, 0.0, 1.0, x=round(LAT * 1e7), y=round(LON * 1e7), z=50.0)
    assert result(desk, message) == (FRAME, [])


def test_set_home_at_a_place(desk: Desk) -> None:
    ack, (home,) = result(desk, command_int(179, 0, 0.0, x=round(LAT * 1e7), y=round(LON * 1e7), z=42.0))
    assert ack == ACCEPTED
    assert isinstance(home, SetHome)
    assert (home.north, home.east, home.altitude) == pytest.approx((50.0, -20.0, 30.0), abs=0.02)


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
        assert result(desk, command(22, *[nan] * 6, 10.0)) == (ACCEPTED, [Takeoff(10.0)])
        assert result(desk, command(176, 1.0, 6.0)) == (ACCEPTED, [SetMode("RTL")])
        assert result(desk, command(176, 1.0, 99.0)) == (UNSUPPORTED, [])
    else:
        assert result(desk, command(22, *[nan] * 6, 10.0)) == (DENIED, [])
        assert result(desk, command(176, 1.0, 4.0, 5.0)) == (ACCEPTED, [SetMode("RTL")])
    (beat,) = [desk.ask(command(512, 0.0))[1]]
    assert beat.autopilot == {"ardupilot": 3, "generic": 0}[personality]
    assert beat.type == 13
    assert result(desk, command_int(22, 3, z=10.0)) == (ACCEPTED, [Takeoff(10.0)])
    bench.close()


def test_requested_messages_follow_the_acknowledgement(desk: Desk) -> None:
    names = [message.get_type() for message in desk.ask(command(512, 148.0))]
    assert names == ["COMMAND_ACK", "AUTOPILOT_VERSION"]
    assert [m.get_type() for m in desk.ask(command(520, 1.0))] == ["COMMAND_ACK", "AUTOPILOT_VERSION"]
    assert [m.get_type() for m in desk.ask(command(519, 1.0))] == ["COMMAND_ACK", "PROTOCOL_VERSION"]
    assert [m.get_type() for m in desk.ask(command(410))] == ["COMMAND_ACK", "HOME_POSITION"]
    assert [m.get_type() for m in desk.ask(command(512, 115.0))] == ["COMMAND_ACK", "HIL_STATE_QUATERNION"]
    assert [m.get_type() for m in desk.ask(command(512, 244.0, 30.0))] == ["COMMAND_ACK", "MESSAGE_INTERVAL"]


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
    by_name = {line.mode_name: line.custom_mode for line in lines}
    # PX4's numbers: what QGroundControl's buttons look for
    assert by_name["Hold"] == 0x03040000
    assert by_name["Return"] == 0x05040000
    assert by_name["Land"] == 0x06040000
    assert by_name["Takeoff"] == 0x02040000
    assert by_name["Mission"] == 0x04040000
    assert by_name["Manual"] == 0x00010000
    _, line = desk.ask(command(512, 435.0, 3.0))
    assert line.mode_index == 3


@pytest.mark.parametrize("mode", [mode for mode in Mode if mode is not Mode.ORBIT])
def test_set_mode_has_no_acknowledgement_and_shows_at_once(desk: Desk, mode: Mode) -> None:
    custom = {line.mode: line for line in MODES}[mode]
    _, *lines = desk.ask(command(512, 435.0))
    number = next(line.custom_mode for line in lines if line.mode_name == custom.name)
    desk.bench.pilot.asked.clear()
    desk.ask(mav.MAVLink_set_mode_message(1, 1 | 128, number), 0.02)
    assert desk.bench.pilot.asked == [SetMode(mode.value)]
    assert not desk.named("COMMAND_ACK")
    if mode is not Mode.HOLD:  # where it was
        assert desk.named("HEARTBEAT")[0].custom_mode == number
        assert desk.named("CURRENT_MODE")[0].custom_mode == number


def test_set_mode_says_why_not(desk: Desk) -> None:
    desk.bench.pilot.answers[SetMode] = Answer(False, Result.DENIED, "needs sticks")
    desk.ask(mav.MAVLink_set_mode_message(1, 1, 3 << 16))
    assert [m.text for m in desk.named("STATUSTEXT")] == ["needs sticks"]
    desk.ask(mav.MAVLink_set_mode_message(1, 1, 99 << 16))
    assert "not known" in desk.named("STATUSTEXT")[0].text


def test_prearm_checks_say_what_is_missing(desk: Desk) -> None:
    desk.bench.pilot.status = status(
        ready=False, refusals=("not level: leans 20 deg, 10 deg are allowed", "engine 3 failed")
    )
    desk.bench.step(0.01)
    assert result(desk, command(401)) == (ACCEPTED, [])
    text = "".join(m.text for m in desk.named("STATUSTEXT"))
    assert text == "not ready: not level: leans 20 deg, 10 deg are allowed; engine 3 failed"


def test_a_command_for_another_is_left_alone(desk: Desk) -> None:
    for message in (command(400, 1.0, target=2), command(400, 1.0, component=100)):
        assert not [m for m in desk.ask(message) if m.get_type() == "COMMAND_ACK"]
    assert desk.bench.link.refused["other vehicle"] == 2
    assert not desk.bench.pilot.asked
    # to everybody is also to this one
    assert result(desk, command(400, 1.0, target=0, component=0)) == (ACCEPTED, [Arm()])


def test_a_second_sender_gets_its_own_acknowledgement(bench: Bench) -> None:
    one, two = bench.station(255, 190), bench.station(245, 191)
    bench.step()
    one.got.clear()
    two.got.clear()
    one.send(command(20))
    two.send(command(21))
    bench.step()
    (first,), (second,) = one.named("COMMAND_ACK"), two.named("COMMAND_ACK")
    assert (first.command, first.target_system, first.target_component) == (20, 255, 190)
    assert (second.command, second.target_system, second.target_component) == (21, 245, 191)


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
    assert desk.bench.pilot.asked == [Takeoff()]


@pytest.mark.parametrize("message", [command(22), command(420, 101.0, 1.0, 2.0)])
def test_a_lost_acknowledgement_does_not_repeat_what_is_done_once(desk: Desk, message: Any) -> None:
    assert len(result(desk, message)[1]) == 1
    assert result(desk, message) == (ACCEPTED, [])
    desk.bench.step(6.0)
    assert len(result(desk, message)[1]) == 1  # so much later it is meant


def test_another_command_between_makes_it_new(desk: Desk) -> None:
    assert result(desk, command(22))[1] == [Takeoff()]
    result(desk, command(21))
    assert result(desk, command(22))[1] == [Takeoff()]


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
    assert asked(desk, manual(500, -250, 600, 100)) == [Sticks(roll=-0.25, pitch=0.5, yaw=0.1, throttle=0.6)]
    assert asked(desk, manual(0, 0, -1000, 0)) == [Sticks(0.0, 0.0, 0.0, 0.0)]
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
    assert desk.bench.pilot.asked == [Sticks(0.0, 0.099, 0.0, 0.5)]


ALL = 0b1111_1111_1111


def local(mask: int, *values: float, frame: int = 1) -> Any:
    return mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *values)


def test_local_set_points_become_offboard_requests(desk: Desk) -> None:
    values = (1.0, 2.0, -3.0, 4.0, 5.0, -6.0, 0.0, 0.0, 0.0, 0.5, 0.25)
    assert asked(desk, local(0b1001_1111_1000, *values)) == [OffboardPosition(1.0, 2.0, -3.0, 0.5)]
    assert asked(desk, local(0b0101_1100_0111, *values)) == [OffboardVelocity(4.0, 5.0, -6.0, None, 0.25)]
    assert asked(desk, local(0b1101_1100_0111, *values)) == [OffboardVelocity(4.0, 5.0, -6.0)]
    assert asked(desk, local(0b1101_1100_0000, *values)) == [OffboardPosition(1.0, 2.0, -3.0)]  # both: the position
    # offset: from (3, 4) and 10 m up
    assert asked(desk, local(0b1101_1111_1000, *values, frame=7)) == [OffboardPosition(4.0, 6.0, -13.0)]
    # by the nose, which points east
    (request,) = asked(desk, local(0b1101_1100_0111, *values, frame=8))
    assert isinstance(request, OffboardVelocity)
    assert (request.north, request.east, request.down) == pytest.approx((-5.0, 4.0, -6.0))
    (request,) = asked(desk, local(0b1101_1111_1000, *values, frame=9))
    assert isinstance(request, OffboardPosition)
    assert (request.north, request.east, request.down) == pytest.approx((3.0 - 2.0, 4.0 + 1.0, -13.0))


@pytest.mark.parametrize(
    "message",
    [
        local(ALL, *[0.0] * 11),
        local(0b1101_1111_1001, *[0.0] * 11),  # a position without north
        local(0b1101_1111_1000, nan, *[0.0] * 10),
        local(0b1101_1100_0111, *[0.0] * 3, float("inf"), *[0.0] * 7),
        local(0b1101_1111_1000, 1e30, *[0.0] * 10),
        local(0b1101_1111_1000, *[0.0] * 11, frame=20),
        mav.MAVLink_set_attitude_target_message(0, 1, 1, 0b1000_0001, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.5),
        mav.MAVLink_set_attitude_target_message(0, 1, 1, 0b0100_0111, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.5),
        mav.MAVLink_set_attitude_target_message(0, 1, 1, 7, [2.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.5),
        mav.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, nan),
    ],
)
def test_a_set_point_that_says_nothing_is_counted(desk: Desk, message: Any) -> None:
    assert asked(desk, message) == []
    assert desk.bench.link.refused["value"] == 1
    assert len(desk.named("STATUSTEXT")) >= 1
    assert not desk.bench.link.failures


def test_attitude_set_points(desk: Desk) -> None:
    kind = mav.MAVLink_set_attitude_target_message
    assert asked(desk, kind(0, 1, 1, 7, [1.0, 0.0, 0.0, 0.0], 9.0, 9.0, 9.0, 0.5)) == [
        OffboardAttitude(quaternion=(1.0, 0.0, 0.0, 0.0), thrust=0.5)
    ]
    assert asked(desk, kind(0, 1, 1, 128, [nan] * 4, 1.0, 2.0, 3.0, 0.25)) == [
        OffboardAttitude(rates=(1.0, 2.0, 3.0), thrust=0.25)
    ]


def test_global_set_points_become_offboard_requests(desk: Desk) -> None:
    kind = mav.MAVLink_set_position_target_global_int_message
    place = (round(LAT * 1e7), round(LON * 1e7))
    for frame, height in ((0, 42.0), (5, 42.0), (6, 28.0)):
        (request,) = asked(desk, kind(0, 1, 1, frame, 0b1101_1111_1000, *place, height, *[0.0] * 8))
        assert isinstance(request, OffboardPosition)
        assert (request.north, request.east, request.down) == pytest.approx((50.0, -20.0, -30.0), abs=0.02)
    assert asked(desk, kind(0, 1, 1, 6, 0b1101_1100_0111, 0, 0, 0.0, 1.0, 2.0, 3.0, *[0.0] * 5)) == [
        OffboardVelocity(1.0, 2.0, 3.0)
    ]
    assert asked(desk, kind(0, 1, 1, 10, 0b1101_1111_1000, *place, 9.0, *[0.0] * 8)) == []
    assert asked(desk, kind(0, 1, 1, 5, 0b1101_1111_1000, 2_000_000_000, 0, 9.0, *[0.0] * 8)) == []
