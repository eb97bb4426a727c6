"""What a station and a log are told while sensors are dead: estimates, and what of them is not valid."""

from __future__ import annotations

import json
from math import hypot
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import failsafe_flights
import numpy as np
import pytest
from mavlink_tools import snapshot
from pyulog import ULog

from cosim import fly
from cosim.base.frames import to_euler
from cosim.base.geodesy import Geodesy
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.requests import Answer, Result
from cosim.groundstation.mavlink.streams import STREAMS
from cosim.groundstation.mavlink.telemetry_state import FlightEvents, TelemetryState, VehicleConstants
from cosim.groundstation.session import make_ground_scenario
from cosim.groundstation.web.feed import describe_state as web_state
from cosim.results.autopilot.autopilot_record import read_pilot_record
from cosim.results.autopilot.request_log import RequestLog
from cosim.results.export import export_log
from cosim.results.run import REQUESTS
from cosim.spec.scenario import Scenario

GYRO, ACCEL, MAG, BARO, GPS, AHRS = 1, 2, 4, 8, 32, 1 << 21
HEIGHT, PLACE = 8192, 16384
ATTITUDE, SPEED, CLIMB, RELATIVE, ABSOLUTE, VERTICAL = 1, 2, 4, 8, 16, 32


class Flight(failsafe_flights.Flight):
    """A hover at 10 m that a station looks at."""

    def __init__(self) -> None:
        super().__init__(height=10.0, controller="smith")

    def dead(self, *sensors: str) -> None:
        self.ok(*(rq.InjectFault("sensor_dropout", sensor=sensor) for sensor in sensors))

    def told(self) -> dict[str, Any]:
        """The first of each message, by name, of what a station would get now."""
        about = VehicleConstants(Geodesy(52.0, 13.0, 0.0), 6)
        view = TelemetryState(about, snapshot(self.sample, self.pilot.status), FlightEvents())
        return {stream.name: found[0] for stream in STREAMS if (found := stream.make_messages(view))}


def test_while_everything_lives_everything_is_healthy_and_as_sure_as_the_filters_are() -> None:
    with Flight() as flight:
        flight.fly(5.0)
        told = flight.told()
    health, flags = told["SYS_STATUS"].onboard_control_sensors_health, told["ESTIMATOR_STATUS"].flags
    assert health & (GYRO | ACCEL | MAG | BARO | GPS | AHRS | HEIGHT | PLACE) == (
        GYRO | ACCEL | MAG | BARO | GPS | AHRS | HEIGHT | PLACE
    )
    assert flags == 1 | 2 | 4 | 8 | 16 | 32 | 256 | 512
    # better than one fix, 0.3 m, and than one reading of the barometer, 0.01 m
    assert 0.02 < told["ESTIMATOR_STATUS"].pos_horiz_accuracy < 0.3
    assert 0.0 < told["ESTIMATOR_STATUS"].pos_vert_accuracy < 0.01
    assert told["GPS_RAW_INT"].fix_type == 3


def test_a_station_sees_the_descent_of_a_vehicle_whose_barometer_and_receiver_are_dead() -> None:
    """It saw 10 m and no climb for good, all of it as healthy as before."""
    with Flight() as flight:
        flight.fly(5.0)
        sure = flight.told()["ESTIMATOR_STATUS"]
        flight.dead("barometer", "gnss")
        flight.fly(6.0)
        truth, raw, told = flight.sample.state, flight.sample.measured, flight.told()
        page = web_state_of(flight)
        assert truth.altitude < 7.0
        assert raw.altitude > 9.5
    place = told["GLOBAL_POSITION_INT"]
    for height in (place.relative_alt / 1e3, told["VFR_HUD"].alt, -told["LOCAL_POSITION_NED"].z, page["height"]):
        assert height == pytest.approx(truth.altitude, abs=0.3)
    for down in (place.vz / 1e2, -told["VFR_HUD"].climb, told["LOCAL_POSITION_NED"].vz, page["velocity"][2]):
        assert down == pytest.approx(truth.velocity[2], abs=0.1)
    assert told["ALTITUDE"].altitude_local == pytest.approx(truth.altitude, abs=0.3)
    health, estimator = told["SYS_STATUS"].onboard_control_sensors_health, told["ESTIMATOR_STATUS"]
    assert health & (GYRO | ACCEL | MAG | AHRS | HEIGHT) == GYRO | ACCEL | MAG | AHRS | HEIGHT
    assert not health & (BARO | GPS | PLACE)
    # carried on: speeds and the place from here; no place on the Earth, no height
    assert estimator.flags & (ATTITUDE | SPEED | CLIMB | RELATIVE) == ATTITUDE | SPEED | CLIMB | RELATIVE
    assert not estimator.flags & (ABSOLUTE | VERTICAL)
    assert estimator.pos_horiz_accuracy > 1.2 * sure.pos_horiz_accuracy
    assert estimator.pos_vert_accuracy > 5.0 * sure.pos_vert_accuracy
    receiver = told["GPS_RAW_INT"]
    assert (receiver.fix_type, receiver.vel, receiver.cog) == (1, 65535, 65535)


def web_state_of(flight: Flight) -> dict[str, Any]:
    """What the page gets, of a snapshot that has what it needs."""
    simulation = flight.simulation
    snapshot: Any = SimpleNamespace(
        status=flight.pilot.status, measured=simulation.measured, ending=None, sample=None, info=None,
        time=simulation.k * simulation.dt, pace=SimpleNamespace(factor=1.0, reached_factor=1.0, missed=0),
    )  # fmt: skip
    return web_state(snapshot)


def test_a_station_sees_the_attitude_that_is_flown_when_its_sensor_is_dead() -> None:
    with Flight() as flight:
        flight.fly(2.0)
        flight.ok(rq.Goto(north=40.0))
        flight.fly(4.0)
        flight.dead("attitude")
        apart = []
        for _ in range(30):  # it lands, and leans back to stop
            flight.fly(0.1)
            told, truth = flight.told(), flight.sample.state
            assert told["ATTITUDE"].pitch == pytest.approx(truth.euler[1], abs=0.01)
            apart.append(abs(truth.euler[1] - to_euler(flight.sample.measured.attitude)[1]))
        assert max(apart) > 0.05
        health = told["SYS_STATUS"].onboard_control_sensors_health
        assert not health & MAG
        assert health & (GYRO | AHRS | BARO | GPS) == GYRO | AHRS | BARO | GPS


@pytest.mark.parametrize(("sensor", "bit"), [("gyro", GYRO), ("barometer", BARO), ("gnss", GPS)])
def test_the_bit_of_the_sensor_that_is_dead_is_the_one_that_goes(sensor: str, bit: int) -> None:
    with Flight() as flight:
        flight.fly(2.0)
        flight.dead(sensor)
        flight.fly(1.5)
        health = flight.told()["SYS_STATUS"].onboard_control_sensors_health
    assert health & (GYRO | ACCEL | MAG | BARO | GPS | AHRS) == (GYRO | ACCEL | MAG | BARO | GPS | AHRS) & ~bit


def test_the_log_has_height_and_climb_as_estimated_and_says_what_is_not_valid(tmp_path: Path) -> None:
    waiting = make_ground_scenario(Scenario.load("hover"), 16.0)
    log = RequestLog(tmp_path / REQUESTS)
    faults = [(9.0, rq.InjectFault("sensor_dropout", sensor=sensor)) for sensor in ("barometer", "gnss")]
    asked = [(1.2, rq.SetParameter("SYS_FAILURE_EN", 1)), (1.3, rq.Arm()), (1.4, rq.Takeoff(8.0)), *faults]
    for at, request in asked:
        log.write(round(at / waiting.step_s), "test", request, Answer(True, Result.ACCEPTED, ""))
    log.close()
    scenario = Scenario.from_table(waiting.model_dump(mode="json", exclude_none=True), tmp_path, "waiting")
    run = fly(scenario, tmp_path / "run", report=False)
    export_log("ulog", run.folder, tmp_path / "flight.ulg")
    data = ULog(str(tmp_path / "flight.ulg")).get_dataset("vehicle_local_position").data
    lost = data["timestamp"] > 10.5e6
    truth = np.asarray(run.log["altitude_m"])
    raw = np.asarray(run.log["altitude_measured_m"])
    assert np.ptp(raw[lost]) == 0.0
    assert np.max(np.abs(-data["z"] - truth)[lost]) < 0.3
    assert np.max(np.abs(data["vz"] - np.asarray(run.log["velocity_down_m_s"]))[lost]) < 0.3
    for name in ("xy_valid", "z_valid"):
        assert data[name][~lost][:2000].all()
        assert not data[name][lost].any()
    assert data["v_z_valid"].all()
    assert data["v_xy_valid"].all()
    assert data["dead_reckoning"][lost].all()
    assert data["epv"][-1] > 3.0 * data["epv"][2000]
    (last,) = [line for line in read_pilot_record(run.folder) if line["kind"] == "estimate"][-1:]
    assert last["height"] == pytest.approx(truth[last["k"]], abs=0.3)
    assert last["valid"] == {
        "place": False, "speed": True, "height": False, "climb": True, "attitude": True, "gyro": True,
        "accelerometer": True, "barometer": False, "gnss": False, "attitude_sensor": True,
    }  # fmt: skip
    assert last["deviation"]["height_m"] == pytest.approx(data["epv"][-1], rel=0.05)
    assert hypot(*last["velocity"]) < 0.5
    # a record of before has no estimate of the height: the sensors' stands in, as it did
    path = run.folder / "autopilot.jsonl"
    older = []
    for line in read_pilot_record(run.folder):
        for name in ("height", "climb", "attitude", "deviation", "valid"):
            line.pop(name, None)
        older.append(json.dumps(line) + "\n")
    path.write_text("".join(older), encoding="utf-8")
    export_log("ulog", run.folder, tmp_path / "older.ulg")
    before = ULog(str(tmp_path / "older.ulg")).get_dataset("vehicle_local_position").data
    np.testing.assert_array_equal(before["z"], -raw.astype(np.float32)[: len(before["z"])])
    assert before["z_valid"].all()
    assert not before["xy_valid"][lost].any()
