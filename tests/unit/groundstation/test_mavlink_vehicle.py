"""What the vehicle tells: values against closed forms, rates against the clock, each station for itself."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import pairwise
from math import copysign, isnan, nan, pi, radians, sqrt

import pytest
from mavlink_tools import ABOUT, GEODESY, Bench, Desk, command, sample, snapshot, status

from cosim.base.frames import from_euler
from cosim.base.protocols import EngineState
from cosim.control.autopilot.estimation.position import Fix
from cosim.control.autopilot.modes import Home, LandedState, Mode, Severity
from cosim.control.autopilot.requests import LinkBack, LinkLost
from cosim.groundstation.mavlink.modes import base_mode, custom_mode, from_custom, vehicle_type
from cosim.groundstation.mavlink.streams import BY_ID, DEFAULT_INTERVALS_S, STREAMS
from cosim.groundstation.mavlink.telemetry import statustext
from cosim.groundstation.mavlink.telemetry_state import FlightEvents, TelemetryState
from cosim.groundstation.mavlink.wire.dialect import BY_NAME, mav
from cosim.spec.vehicle import load_vehicle
from cosim.vehicle.atmosphere import standard_density


def one(desk: Desk, name: str) -> object:
    """A message, by request."""
    found = desk.ask(command(512, float(BY_NAME[name].id)))
    return found[1]


FLYING = {"armed": True, "landed": LandedState.IN_AIR, "engines": EngineState.FLY}


def show(desk: Desk, **changes: object) -> None:
    """Let the pilot be in this state for a step."""
    desk.bench.pilot.status = status(**changes)
    desk.bench.step(0.02)


def result_of(desk: Desk, number: int) -> int:
    """Of a request for a message that does not come."""
    (ack,) = desk.ask(command(512, float(number)))
    return int(ack.result)


def fields(desk: Desk, name: str, *wanted: str) -> list[object]:
    message = one(desk, name)
    return [getattr(message, field) for field in wanted]


def test_the_heartbeat_shows_mode_and_arming_as_px4_does(desk: Desk) -> None:
    wanted = ("type", "autopilot", "base_mode", "custom_mode", "system_status", "mavlink_version")
    assert fields(desk, "HEARTBEAT", *wanted) == [13, 12, 1 | 4 | 8 | 16, 0x03040000, 3, 3]
    show(desk, armed=True, mode=Mode.POSCTL)
    assert fields(desk, "HEARTBEAT", *wanted[2:5]) == [1 | 16 | 64 | 128, 0x00030000, 4]
    show(desk, armed=True, failsafe="no ground station")
    assert fields(desk, "HEARTBEAT", "system_status") == [5]


def test_attitude_is_that_of_the_sensors(desk: Desk) -> None:
    attitude = fields(desk, "ATTITUDE", "time_boot_ms", "roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
    assert attitude == pytest.approx([1000, 0.0, 0.0, pi / 2, 0.1, 0.2, 0.3], abs=1e-6)
    assert fields(desk, "ATTITUDE_QUATERNION", "q1", "q2", "q3", "q4") == pytest.approx([0.5**0.5, 0.0, 0.0, 0.5**0.5])


def test_position_messages_hold_the_place_in_their_units(desk: Desk) -> None:
    lat, lon, _ = GEODESY.to_geodetic(3.0, 4.0, 10.0)
    wanted = ("lat", "lon", "alt", "relative_alt", "vx", "vy", "vz", "hdg")
    # 12 m of ground, 10 m above it, home at 2 m
    expected = [round(lat * 1e7), round(lon * 1e7), 22000, 8000, 100, 50, -200, 9000]
    assert fields(desk, "GLOBAL_POSITION_INT", *wanted) == expected
    local = fields(desk, "LOCAL_POSITION_NED", "x", "y", "z", "vx", "vy", "vz")
    assert local == pytest.approx([3.0, 4.0, -10.0, 1.0, 0.5, -2.0])
    gps = fields(desk, "GPS_RAW_INT", "fix_type", "lat", "lon", "alt", "h_acc", "vel")
    assert gps == [3, round(lat * 1e7), round(lon * 1e7), 22000, 400, round(100 * 1.25**0.5)]
    assert fields(desk, "GPS_RAW_INT", "alt_ellipsoid") == [0]  # not sent: there is no geoid
    imu = fields(desk, "HIGHRES_IMU", "pressure_alt", "abs_pressure", "fields_updated")
    # 22 m above the sea: 2.64 hPa below 1013.25; no accelerometer
    assert imu == pytest.approx([22.0, 1010.61, 0b1010_0011_1000], abs=0.02)
    altitude = fields(desk, "ALTITUDE", "altitude_amsl", "altitude_local", "altitude_relative")
    assert altitude == pytest.approx([22.0, 10.0, 8.0])
    home = fields(desk, "HOME_POSITION", "latitude", "longitude", "altitude", "z", "q")
    assert home == [223500000, 1135900000, 14000, -2.0, [1.0, 0.0, 0.0, 0.0]]
    hud = fields(desk, "VFR_HUD", "groundspeed", "heading", "throttle", "alt", "climb")
    assert hud == pytest.approx([1.25**0.5, 90, 45, 22.0, 2.0])
    origin = fields(desk, "GPS_GLOBAL_ORIGIN", "latitude", "longitude", "altitude")
    assert origin == [223500000, 1135900000, 12000]


def test_the_truth_is_told_apart(desk: Desk) -> None:
    truth = fields(desk, "HIL_STATE_QUATERNION", "alt", "vx", "vz", "zacc", "true_airspeed")
    assert truth == [22000, 100, -200, round(-9.8 / 9.80665 * 1000), round(100 * (9.0 + 20.25 + 4.0) ** 0.5)]
    odometry = fields(desk, "ODOMETRY", "frame_id", "child_frame_id", "vx", "vy", "vz")
    # the nose points east: ahead is east, to the right is south
    assert odometry == pytest.approx([1, 12, 0.5, -1.0, -2.0])


def test_the_wind_is_the_vehicles_own_estimate(desk: Desk) -> None:
    """The drag of 0.052 m^2 at the air's density explains what pushes 5.5 kg; the true wind, 4 and 5 m/s, is not told."""
    number = BY_NAME["WIND_COV"].id
    assert result_of(desk, number) != 0  # on the ground nothing pushes
    push, velocity = (0.05, -0.08), (1.0, 0.5)
    show(desk, fix=Fix((3.0, 4.0), velocity, push), **FLYING)
    vehicle = load_vehicle("hexjet")[0]
    drag = 0.5 * standard_density(22.0) * vehicle.aero.drag_area_m2[0]
    speeds = [copysign(sqrt(vehicle.mass_kg * abs(b) / drag), b) for b in push]
    assert fields(desk, "WIND_COV", "wind_x", "wind_y") == pytest.approx(
        [v + speed for v, speed in zip(velocity, speeds, strict=True)], rel=1e-6
    )
    show(desk, fix=Fix((3.0, 4.0), velocity, push), positioned=False, **FLYING)
    assert result_of(desk, number) != 0


@pytest.mark.parametrize(("lean", "told"), [(0.0, True), (25.0, True), (35.0, False), (81.0, False), (-81.0, False)])
def test_no_wind_is_told_while_it_leans_further_than_it_may_be_asked_to(desk: Desk, lean: float, told: bool) -> None:
    """At 81 degrees, on its way over, it told a wind that there was not; it may be asked for 20."""
    seen = sample().measured._replace(attitude=from_euler(0.0, radians(lean), 1.5))
    show(desk, fix=Fix((3.0, 4.0), (1.0, 0.5), (0.05, -0.08)), seen=seen, **FLYING)
    ack = desk.ask(command(512, float(BY_NAME["WIND_COV"].id)))[0]
    assert (ack.result == 0) is told


def test_engines_that_are_off_have_no_throttle(desk: Desk) -> None:
    idle = fields(desk, "SERVO_OUTPUT_RAW", "servo1_raw", "servo6_raw")
    assert min(idle) > 1000
    show(desk, engines=EngineState.OFF)
    assert fields(desk, "SERVO_OUTPUT_RAW", "servo1_raw", "servo6_raw") == [1000, 1000]
    assert fields(desk, "ACTUATOR_OUTPUT_STATUS", "actuator")[0][:6] == [0.0] * 6
    assert fields(desk, "VFR_HUD", "throttle") == [0]
    _, *controllers = desk.ask(command(512, float(BY_NAME["EFI_STATUS"].id)))
    assert {m.throttle_position for m in controllers} == {0.0}


def test_engines_are_told_in_two_messages_of_four(desk: Desk) -> None:
    rpm = [1000.0 * i * 30.0 / pi for i in range(1, 7)]
    _, first, second = desk.ask(command(512, 291.0))
    assert (first.index, second.index) == (0, 4)
    assert first.rpm == [round(value) for value in rpm[:4]]
    assert second.rpm == [*(round(value) for value in rpm[4:]), 0, 0]
    _, first, second = desk.ask(command(512, 290.0))
    assert [(m.index, m.count, m.info) for m in (first, second)] == [(0, 6, 0b1111), (4, 6, 0b11)]
    _, *controllers = desk.ask(command(512, 225.0))
    assert [m.ecu_index for m in controllers] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    last = controllers[5]
    # 1 g/s of kerosene of 808 kg/m^3; a quarter of full thrust
    names = ("rpm", "fuel_flow", "engine_load", "throttle_position", "exhaust_gas_temperature", "health")
    told = [getattr(last, name) for name in names]
    assert told == pytest.approx([rpm[5], 0.001 / 808.0 * 6e7, 25.0, 60.0, 600.0, 1.0])
    assert (last.ignition_voltage, last.fuel_pressure) == (0.0, 0.0)  # these two say "unknown" with 0, and not with NaN


def test_a_lost_engine_is_seen(desk: Desk) -> None:
    health = (1.0, 1.0, 0.0, 1.0, 1.0, 0.4)
    view = TelemetryState(ABOUT, snapshot(sample(health=health), status()), FlightEvents())
    built = {stream.name: stream.make_messages(view) for stream in STREAMS}
    assert [message.info for message in built["ESC_INFO"]] == [0b1011, 0b11]
    assert [message.health for message in built["EFI_STATUS"]] == [1, 1, 0, 1, 1, 1]
    propulsion = 1 << 30
    (system,) = built["SYS_STATUS"]
    assert system.onboard_control_sensors_present & propulsion
    assert not system.onboard_control_sensors_health & propulsion


def test_what_engines_do_not_say_is_not_made_up() -> None:
    silent = sample().engines._replace(spool_speed=(nan,) * 6, exhaust_temperature=(nan,) * 6, fuel_flow=(nan,) * 6)
    view = TelemetryState(
        ABOUT, snapshot(sample(engines=silent), status(), ((nan,) * 3,) * 3), FlightEvents()
    )  # no predictor flies
    built = {stream.name: stream.make_messages(view) for stream in STREAMS}
    assert built["ESC_STATUS"] == built["RAW_RPM"] == []  # speeds that are not known
    assert [message.info for message in built["ESC_INFO"]] == [0b1111, 0b11]  # but which engines live, is
    assert all(isnan(m.rpm) and isnan(m.fuel_flow) and isnan(m.exhaust_gas_temperature) for m in built["EFI_STATUS"])
    assert [m.name for m in built["NAMED_VALUE_FLOAT"]] == ["rate_p", "pred_p", "pred_err"]
    (array,) = built["DEBUG_FLOAT_ARRAY"]
    assert all(map(isnan, array.data[6:15]))
    assert not any(map(isnan, array.data[:6]))


def test_energy_by_tank_or_by_battery(desk: Desk) -> None:
    """No station shows FUEL_STATUS, so per cent of the tank go where all of them look."""
    fuel = fields(
        desk, "FUEL_STATUS", "maximum_fuel", "consumed_fuel", "remaining_fuel", "percent_remaining", "flow_rate",
        "fuel_type",
    )  # fmt: skip
    # 2 kg when full, 1.5 kg left, six engines at 1 g/s: ml and ml/s of 0.808 kg/l, MAV_FUEL_TYPE_LIQUID
    full = 2.0 / 0.808 * 1e3
    # of what is consumed and what remains the gauge measures one, and the other may not be made of it
    assert fuel == pytest.approx([full, nan, 0.75 * full, 75, 0.006 / 0.808 * 1e3, 1], nan_ok=True)
    assert fields(desk, "BATTERY_STATUS", "battery_remaining", "battery_function") == [75, 2]
    assert fields(desk, "SYS_STATUS", "battery_remaining") == [75]
    tankless = replace(ABOUT, fuel_capacity=nan)
    electric = TelemetryState(tankless, snapshot(sample(), status(remaining=0.4)), FlightEvents())
    built = {stream.name: stream.make_messages(electric) for stream in STREAMS}
    assert built["FUEL_STATUS"] == []
    assert built["BATTERY_STATUS"][0].battery_remaining == 40
    assert built["SYS_STATUS"][0].battery_remaining == 40


def test_refusals_to_arm_show_in_the_prearm_check(desk: Desk) -> None:
    prearm = 1 << 28
    names = [f"onboard_control_sensors_{name}" for name in ("present", "enabled", "health")]
    assert all(value & prearm for value in fields(desk, "SYS_STATUS", *names))
    show(desk, ready=False, refusals=("not level",))
    present, enabled, health = fields(desk, "SYS_STATUS", *names)
    assert present & prearm
    assert enabled & prearm
    assert not health & prearm
    geofence = 1 << 20  # healthy and off
    assert health & geofence
    assert not enabled & geofence
    assert fields(desk, "SYS_STATUS", "load") == [250]


def test_the_predictor_message_has_every_axis(desk: Desk) -> None:
    (message,) = desk.ask(command(512, 350.0))[1:]
    assert message.name == "predictor"
    rows = [message.data[i : i + 3] for i in range(0, 21, 3)]
    expected = [
        (0.1, 0.2, 0.3), (0.11, 0.22, 0.33), (0.7, 0.8, 0.9), (0.5, 0.6, 0.65), (0.1, 0.1, nan),
        (0.4, 0.5, 0.6), (0.01, 0.02, 0.03),
    ]  # fmt: skip
    for row, wanted in zip(rows, expected, strict=True):
        assert row == pytest.approx(wanted, nan_ok=True)
    values = {m.name: m.value for m in desk.ask(command(512, 251.0))[1:]}
    expected = {"rate_p": 0.1, "pred_p": 0.11, "pred_err": 0.01, "model_p": 0.7, "delay_ms": 100.0}
    assert values == pytest.approx(expected, rel=1e-5)


def test_outputs_are_sent_as_pulses_and_as_fractions(desk: Desk) -> None:
    (servo,) = desk.ask(command(512, 36.0))[1:]
    found = [getattr(servo, f"servo{i}_raw") for i in range(1, 9)]
    assert found == [1100, 1200, 1300, 1400, 1500, 1600, 1600, 1400]  # 0.1 of 0.5 rad either way
    active, values = fields(desk, "ACTUATOR_OUTPUT_STATUS", "active", "actuator")
    assert active == 0b11111111
    assert values[:8] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.2, -0.2])


def test_the_target_is_sent_locally_and_on_the_globe(desk: Desk) -> None:
    assert result_of(desk, 85) == 1  # there is none now
    show(desk, target=Home(50.0, -20.0, 30.0), yaw=0.7)
    wanted = ("coordinate_frame", "x", "y", "z", "yaw", "type_mask")
    found = fields(desk, "POSITION_TARGET_LOCAL_NED", *wanted)
    assert found == pytest.approx([1, 50.0, -20.0, -30.0, 0.7, 0b1001_1111_1000])
    lat, lon, _ = GEODESY.to_geodetic(50.0, -20.0, 30.0)
    told = fields(desk, "POSITION_TARGET_GLOBAL_INT", "lat_int", "lon_int", "alt")
    assert told == [round(lat * 1e7), round(lon * 1e7), 42.0]


def test_flight_information_remembers(desk: Desk) -> None:
    assert fields(desk, "FLIGHT_INFORMATION", "arming_time_utc", "takeoff_time_utc", "flight_uuid") == [0, 0, 0]
    show(desk, armed=True)
    show(desk, armed=True, landed=LandedState.IN_AIR)
    armed, off, flight = fields(desk, "FLIGHT_INFORMATION", "arming_time_utc", "takeoff_time_utc", "flight_uuid")
    assert 1.6e15 < armed <= off
    assert flight == 1


def counted(bench: Bench, desk: Desk, seconds: float) -> Counter[str]:
    desk.got.clear()
    bench.step(seconds, every=0.004)
    return Counter(message.get_type() for message in desk.got)


def test_every_message_has_its_rate(bench: Bench, desk: Desk) -> None:
    found = counted(bench, desk, 4.0)
    several = {"NAMED_VALUE_FLOAT": 5, "ESC_STATUS": 2, "ESC_INFO": 2, "RAW_RPM": 4}
    # there is no target, no circle, and nothing pushes what stands
    silent = {"POSITION_TARGET_LOCAL_NED", "ORBIT_EXECUTION_STATUS", "WIND_COV"}
    for stream in STREAMS:
        wanted = 0.0 if stream.name in silent else 4.0 * stream.rate * several.get(stream.name, 1)
        # one message more or less at the ends
        assert found[stream.name] == pytest.approx(wanted, abs=several.get(stream.name, 1)), stream.name
    assert set(found) <= {stream.name for stream in STREAMS}
    assert not bench.link.failures


def test_engines_share_the_one_gauge_in_turn(bench: Bench, desk: Desk) -> None:
    """All six came at once, so that a station with one gauge only ever showed the last."""
    slow = bench.station(200)
    slow.ask(command(511, float(BY_NAME["EFI_STATUS"].id), 3e6))
    desk.got.clear()
    slow.got.clear()
    bench.step(20.0, every=0.02)
    shown = [message.ecu_index for message in desk.named("EFI_STATUS")]
    assert len(shown) == pytest.approx(40, abs=1)
    assert all((b - a) % 6 == 1 for a, b in pairwise(shown))
    assert all((b - a) % 6 == 1 for a, b in pairwise(m.ecu_index for m in slow.named("EFI_STATUS")))
    assert len(desk.named("FUEL_STATUS")) == 2


def test_each_engine_says_what_it_has_consumed() -> None:
    """Of 90 g that the tank lost, by flows of 2 g/s and five times 1 g/s; and from 0 again in another flight."""
    engines = sample().engines._replace(fuel_flow=(0.002, 0.001, 0.001, 0.001, 0.001, 0.001))
    events, before = FlightEvents(), None
    for fuel in (1.5, 1.45, 1.41):
        view = TelemetryState(ABOUT, snapshot(sample(engines=engines, fuel=fuel), status()), events)
        events.update(before, view)
        before = view
    (efi,) = [stream for stream in STREAMS if stream.name == "EFI_STATUS"]
    ml = [90.0 / 0.808 * share / 7.0 for share in (2.0, 1.0, 1.0, 1.0, 1.0, 1.0)]
    assert [message.fuel_consumed for message in efi.make_messages(view)] == pytest.approx(ml)
    events.update(before, TelemetryState(ABOUT, snapshot(sample(fuel=2.0), status()), events))
    assert [message.fuel_consumed for message in efi.make_messages(view)] == [0.0] * 6


def test_time_stamps_are_simulation_time(bench: Bench, desk: Desk) -> None:
    """At half the speed: 25 messages a second of the clock, each 20 ms of flight later."""
    desk.got.clear()
    for _ in range(50):
        bench.step(0.0)
        bench.time += 0.04
        bench.k += 5
    stamps = [message.time_boot_ms for message in desk.named("ATTITUDE")]
    assert len(stamps) >= 49
    assert {b - a for a, b in pairwise(stamps)} == {20}


def test_each_station_has_its_own_rates(bench: Bench, desk: Desk) -> None:
    other = bench.station(245, 191)
    bench.step(0.1)
    desk.ask(command(511, 30.0, 10_000.0))  # ATTITUDE at 100 Hz
    desk.ask(command(511, 33.0, -1.0))  # no GLOBAL_POSITION_INT
    desk.ask(command(511, 115.0, 500_000.0))  # the truth at 2 Hz
    other.got.clear()
    mine = counted(bench, desk, 2.0)
    theirs = Counter(message.get_type() for message in other.got)
    assert mine["ATTITUDE"] == pytest.approx(200, abs=2)
    assert mine["GLOBAL_POSITION_INT"] == 0
    assert mine["HIL_STATE_QUATERNION"] == pytest.approx(4, abs=1)
    assert theirs["ATTITUDE"] == pytest.approx(50, abs=1)
    assert theirs["GLOBAL_POSITION_INT"] == pytest.approx(20, abs=1)
    assert theirs["HIL_STATE_QUATERNION"] == 0


@pytest.mark.parametrize(
    ("asked", "told"), [(20_000.0, 20_000), (1.0, 4000), (-1.0, -1), (0.0, 40_000), (2_000_000.0, 2_000_000)]
)
def test_an_interval_is_told_as_it_is(desk: Desk, asked: float, told: int) -> None:
    assert desk.ask(command(511, 30.0, asked))[0].result == 0
    _, interval = desk.ask(command(510, 30.0))
    assert (interval.message_id, interval.interval_us) == (30, told)


def test_an_interval_of_what_is_not_there(desk: Desk) -> None:
    ack, interval = desk.ask(command(510, 9999.0))
    assert (ack.result, interval.interval_us) == (3, 0)


def test_a_pause_is_not_made_up_for(bench: Bench, desk: Desk) -> None:
    bench.time += 10.0
    assert counted(bench, desk, 0.0)["ATTITUDE"] == 1


def test_a_request_for_a_data_stream_changes_nothing(bench: Bench, desk: Desk) -> None:
    desk.ask(mav.MAVLink_request_data_stream_message(1, 1, 0, 4, 1))
    assert counted(bench, desk, 2.0)["ATTITUDE"] == pytest.approx(50, abs=1)


def test_a_full_station_is_dropped_telemetry_and_not_answers(bench: Bench, desk: Desk) -> None:
    desk.full = True
    bench.step(20.0, every=0.02)
    assert desk.peer.dropped > 1000
    assert desk.peer.waiting_bytes < 70_000
    desk.send(command(20))
    bench.step()
    desk.full = False
    desk.got.clear()
    desk.peer.flush()
    assert [ack.command for ack in desk.named("COMMAND_ACK")] == [20]
    assert not desk.peer.stuck


def test_changes_are_told_at_once(bench: Bench, desk: Desk) -> None:
    bench.pilot.status = status(armed=True, mode=Mode.TAKEOFF, landed=LandedState.TAKING_OFF)
    found = counted(bench, desk, 0.0)
    assert (found["HEARTBEAT"], found["CURRENT_MODE"], found["EXTENDED_SYS_STATE"]) == (1, 1, 1)
    assert desk.named("EXTENDED_SYS_STATE")[0].landed_state == 3


def test_messages_of_the_pilot_go_to_everybody(bench: Bench, desk: Desk) -> None:
    other = bench.station(245, 191)
    text = "arming refused: " + "x" * 90
    bench.exchange.say(Severity.ERROR, text, 5)
    bench.exchange.publish(snapshot(sample(), status()))
    bench.vehicle.poll(bench.time)
    for station in (desk, other):
        pieces = station.named("STATUSTEXT")
        assert "".join(piece.text for piece in pieces) == text
        assert [piece.chunk_seq for piece in pieces] == [0, 1, 2]
        assert len({piece.id for piece in pieces}) == 1
        assert pieces[0].id != 0
        assert {piece.severity for piece in pieces} == {3}


@pytest.mark.parametrize("length", [0, 1, 49, 50, 51, 99, 100, 101, 20_000])
def test_a_text_comes_whole(length: int) -> None:
    """A last piece that is full would have another expected."""
    pieces = statustext(6, "é" * length, 65535)
    assert "".join(piece.text for piece in pieces) == "?" * min(length, 12800)
    if len(pieces) > 1:
        assert len(pieces) <= 256
        assert len(pieces[-1].text) < 50 or len(pieces) == 256


def test_a_link_is_reported_lost_and_back_by_ground_stations_alone(bench: Bench, desk: Desk) -> None:
    beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    bench.step(10.0)
    assert not bench.pilot.asked  # there has been no station yet
    desk.send(beat)
    bench.step(3.4)
    assert not bench.pilot.asked
    bench.step(0.2)
    assert bench.pilot.asked == [LinkLost()]
    bench.step(5.0)
    desk.send(mav.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))  # an onboard computer is no ground station
    bench.step(0.1)
    assert bench.pilot.asked == [LinkLost()]
    desk.send(beat)
    bench.step(0.1)
    assert bench.pilot.asked == [LinkLost(), LinkBack()]


def test_one_station_of_two_is_enough(bench: Bench, desk: Desk) -> None:
    other = bench.station(245, 191)
    beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    desk.send(beat)
    for _ in range(10):
        other.send(beat)
        bench.step(1.0)
    assert not bench.pilot.asked


def test_an_open_page_is_a_ground_station(bench: Bench) -> None:
    bench.vehicle.page_count = lambda: 1
    bench.step(10.0)
    assert not bench.pilot.asked
    bench.vehicle.page_count = lambda: 0
    bench.step(3.4)
    assert not bench.pilot.asked
    bench.step(0.2)
    assert bench.pilot.asked == [LinkLost()]
    bench.vehicle.page_count = lambda: 1
    bench.step(0.1)
    assert bench.pilot.asked == [LinkLost(), LinkBack()]


def test_ping_and_timesync_are_answered(desk: Desk) -> None:
    (pong,) = desk.ask(mav.MAVLink_ping_message(77, 5, 0, 0))
    assert (pong.time_usec, pong.seq, pong.target_system, pong.target_component) == (77, 5, 255, 190)
    assert desk.ask(mav.MAVLink_ping_message(77, 5, 1, 1)) == []  # an answer
    (sync,) = desk.ask(mav.MAVLink_timesync_message(0, 123456789))
    assert (sync.tc1, sync.ts1) == (1_000_000_000, 123456789)
    assert desk.ask(mav.MAVLink_timesync_message(5, 6)) == []
    origin, *why = desk.ask(mav.MAVLink_set_gps_global_origin_message(1, 1, 2, 3))
    assert (origin.latitude, origin.longitude) == (223500000, 1135900000)
    assert "".join(piece.text for piece in why).startswith("the origin stays where the flight began")
    assert len(desk.ask(mav.MAVLink_set_gps_global_origin_message(1, 223500000, 1135900000, 12000))) == 1


def test_an_echo_of_its_own_is_no_command(bench: Bench) -> None:
    echo = bench.station(1, 1)
    bench.step()
    assert not [m for m in echo.ask(command(400, 1.0)) if m.get_type() == "COMMAND_ACK"]
    assert bench.link.refused["own"] == 1
    assert not bench.pilot.asked


def test_the_kind_of_vehicle_is_the_one_of_so_many_engines() -> None:
    """By the names of the dialect."""
    names = {3: "TRICOPTER", 4: "QUADROTOR", 6: "HEXAROTOR", 8: "OCTOROTOR", 10: "DECAROTOR", 12: "DODECAROTOR"}
    for jets in range(1, 17):
        assert vehicle_type(jets) == getattr(mav, f"MAV_TYPE_{names.get(jets, 'GENERIC_MULTIROTOR')}")


@pytest.mark.parametrize("personality", ["px4", "ardupilot", "generic"])
def test_modes_go_there_and_back(personality: object) -> None:
    # round a centre is flown by a command of its own
    shared = {Mode.ORBIT: Mode.POSCTL}
    if personality == "ardupilot":
        shared = {Mode.MANUAL: Mode.STABILIZED, Mode.TAKEOFF: Mode.HOLD, Mode.ORBIT: None}
    for mode in Mode:
        assert from_custom(custom_mode(mode, personality), personality) is shared.get(mode, mode)
        assert base_mode(mode, True) - base_mode(mode, False) == 128
    assert from_custom(0x03040001, "px4") is None


def test_no_message_is_streamed_twice() -> None:
    assert len(BY_ID) == len(STREAMS)
    assert DEFAULT_INTERVALS_S[BY_NAME["HEARTBEAT"].id] == 1.0


class Echo:
    """A service that answers and speaks up."""

    handles = frozenset({"PARAM_REQUEST_LIST"})
    is_busy = True

    def __init__(self) -> None:
        self.clients: list[object] = []
        self.gone: list[object] = []
        self.out: list[tuple[object, object]] = []

    def handle(self, message: object, client: object, now: float) -> list[object]:
        self.clients.append(client)
        return [mav.MAVLink_param_value_message(b"A", 1.0, 9, 1, 0)]

    def poll(self, now: float) -> list[tuple[object, object]]:
        out, self.out = self.out, []
        return out

    def forget(self, peer: object) -> None:
        self.gone.append(peer)


def test_a_service_gets_what_is_its_business() -> None:
    service = Echo()
    bench = Bench(services=[service])
    desk, other = bench.station(), bench.station(245, 191)
    bench.step()
    (value,) = desk.ask(mav.MAVLink_param_request_list_message(1, 1))
    assert value.param_id == "A"
    assert service.clients == [(desk.peer, 255, 190)]
    service.out = [(None, mav.MAVLink_param_value_message(b"B", 1.0, 9, 1, 0))]
    desk.got.clear()
    other.got.clear()
    assert bench.vehicle.poll(bench.time) <= bench.time + 0.01
    assert [m.param_id for m in desk.got] == [m.param_id for m in other.got] == ["B"]
    bench.link._channels.pop()
    bench.step()
    assert service.gone == [other.peer]
    desk.ask(mav.MAVLink_param_request_list_message(2, 1))
    assert len(service.clients) == 1
    bench.close()
