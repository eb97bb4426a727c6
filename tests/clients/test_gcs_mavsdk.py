"""MAVSDK, a client that we have not written, flies ``hexjet gcs`` over UDP at several times real time.

Whoever asks over a network waits in wall time; the limits are ten times and more of what it takes on an idle machine,
so that a busy one does not matter, and every loop ends.
"""

from __future__ import annotations

import json
import math
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from gcs_tools import LOOPBACK, VehicleProcess, until
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.connection_result import ConnectionResult
from mavsdk.logging import log_subscribe
from mavsdk.plugins import action as act
from mavsdk.plugins import component_metadata as meta
from mavsdk.plugins import failure as fail
from mavsdk.plugins import info as inf
from mavsdk.plugins import log_files as logs
from mavsdk.plugins import manual_control as stick
from mavsdk.plugins import mission as mis
from mavsdk.plugins import offboard as off
from mavsdk.plugins import param as par
from mavsdk.plugins import telemetry as tel
from patience import FLIGHT_PATIENCE
from places import ROOT

from cosim import open_run

RTF = 6.0  # steps of 0.67 ms: a machine that does nothing else does three times as many
SOON = 5.0  # s for anything that is only asked
NEAR = 0.7  # m: GNSS and barometer are off by half as much while the vehicle holds
METRES = 6371000.0 * math.pi / 180.0  # in a degree of latitude; good to 0.3 % anywhere
PLACE = (22.35, 113.59)

log_subscribe(lambda level, message, file, line: True)  # quiet


class Drone:
    """A vehicle, and the plugins of a client that is connected to it."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.vehicle = VehicleProcess(folder, RTF, "--place", "{},{}".format(*PLACE), *arguments)
        self.texts: list[str] = []
        self.sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        try:
            connected = self.sdk.add_any_connection(f"udpout://{LOOPBACK}:{self.vehicle.port}")
            assert connected is ConnectionResult.SUCCESS
            system = self.sdk.first_autopilot(30.0)
            assert system is not None
            self.system = system
            self.telemetry = tel.Telemetry(system)
            self.telemetry.subscribe_status_text(lambda text, _: self.texts.append(text.text))
            self.action, self.info, self.param = act.Action(system), inf.Info(system), par.Param(system)
            self.offboard, self.manual = off.Offboard(system), stick.ManualControl(system)
            self.mission, self.failure = mis.Mission(system), fail.Failure(system)
            self.logs, self.metadata = logs.LogFiles(system), meta.ComponentMetadata(system)
            self.until(lambda: self.telemetry.health().is_armable, "ready")
            for name in ("HJ_OFFB_TIME", "HJ_STICK_TIME"):
                self.param.set_param_float(name, 5.0)  # s of flight; MAVSDK sends twenty times a second of wall time
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        self.sdk.destroy()
        self.vehicle.kill()

    def until(self, true: Callable[[], Any], what: str, seconds: float = FLIGHT_PATIENCE) -> Any:
        try:
            return until(true, seconds, what)
        except AssertionError as error:
            raise AssertionError(
                f"{error}; {self.telemetry.position()}, {self.mode.name}, {self.texts[-5:]}"
            ) from error

    @property
    def mode(self) -> tel.FlightMode:
        return self.telemetry.flight_mode()

    @property
    def height(self) -> float:
        """Above home, m."""
        return float(self.telemetry.position().relative_altitude_m)

    @property
    def ned(self) -> tuple[float, float, float]:
        """Relative to where the flight began, m."""
        place = self.telemetry.position_velocity_ned().position
        return place.north_m, place.east_m, place.down_m

    @property
    def speed(self) -> tuple[float, float, float]:
        """North, east, down, m/s."""
        v = self.telemetry.position_velocity_ned().velocity
        return v.north_m_s, v.east_m_s, v.down_m_s

    @property
    def heading(self) -> float:
        """Degrees, -180 to 180."""
        return math.remainder(self.telemetry.heading().heading_deg, 360.0)

    @property
    def turn(self) -> float:
        """About the yaw axis, deg/s."""
        return math.degrees(self.telemetry.attitude_angular_velocity_body().yaw_rad_s)

    def take_off(self, height: float = 10.0) -> None:
        self.action.set_takeoff_altitude(height)
        self.action.arm()
        self.action.takeoff()
        self.until(lambda: self.mode is tel.FlightMode.HOLD and self.height > height - NEAR, "take-off")

    def stopped(self) -> None:
        self.until(lambda: math.hypot(*self.speed) < 0.2, "stopped")

    def there(self, north: float, east: float, height: float) -> None:
        """Wait until it is at a place and stays there."""

        def near() -> bool:
            n, e, d = self.ned
            return math.hypot(n - north, e - east) < NEAR and abs(-d - height) < NEAR and math.hypot(*self.speed) < 0.3

        self.until(near, f"at {north}, {east}, {height}")

    def grounded(self) -> None:
        """On the ground and disarmed, whatever a test has left."""
        if self.telemetry.armed():
            if self.telemetry.in_air():
                self.action.land()
            else:
                self.action.disarm()
            self.until(lambda: not self.telemetry.armed(), "landed")


@pytest.fixture(scope="module")
def flying(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Drone]:
    """One vehicle and one client for the whole file."""
    drone = Drone(tmp_path_factory.mktemp("mavsdk"))
    yield drone
    drone.close()


@pytest.fixture
def drone(flying: Drone) -> Iterator[Drone]:
    """A vehicle that stands, and will again."""
    flying.grounded()
    flying.texts.clear()
    yield flying
    flying.grounded()


@contextmanager
def refused(error: type[Exception], result: Any) -> Iterator[None]:
    with pytest.raises(error) as caught:
        yield
    assert caught.value.result is result, caught.value  # type: ignore[attr-defined]


def test_it_is_known_for_what_it_is(drone: Drone) -> None:
    assert drone.system.get_system_id() == 1
    assert (drone.system.autopilot_type().name, drone.system.vehicle_type().name) == ("PX4", "MULTICOPTER")
    version = drone.info.get_version()
    # below 1.4.1 QGroundControl asks for an update; type 255 would be compared with PX4's newest release
    assert (version.flight_sw_major, version.flight_sw_minor) >= (1, 5)
    assert drone.info.get_identification().hardware_uid.startswith(b"hexjet".hex())
    assert drone.info.get_product().vendor_id == 0


def test_it_is_healthy(drone: Drone) -> None:
    until(lambda: all(vars(drone.telemetry.health()).values()), SOON, "healthy")
    assert drone.telemetry.health_all_ok()


def test_every_parameter_is_there(drone: Drone) -> None:
    found = drone.param.get_all_params()
    whole = {each.name: each.value for each in found.int_params}
    real = {each.name: each.value for each in found.float_params}
    assert len(whole) + len(real) == len({*whole, *real}) >= 60
    assert whole["SYS_AUTOSTART"] != 0
    assert real["HJ_ATT_ROLL"] == drone.param.get_param_float("HJ_ATT_ROLL")
    assert whole["HJ_PRED_TYPE"] == drone.param.get_param_int("HJ_PRED_TYPE") == 1  # smith


def test_a_wrong_parameter_is_refused_and_nothing_changes(drone: Drone) -> None:
    def values() -> dict[str, float]:
        found = drone.param.get_all_params()
        return {each.name: each.value for each in (*found.float_params, *found.int_params)}

    before = values()
    for name, value, result in (
        ("NO_SUCH", 1.0, par.ParamResult.DOES_NOT_EXIST),
        ("HJ_PRED_TYPE", 1.0, par.ParamResult.TYPE_MISMATCH),
        ("HJ_ATT_ROLL", 1e9, par.ParamResult.VALUE_OUT_OF_RANGE),
        ("HJ_ATT_ROLL", math.nan, par.ParamResult.VALUE_OUT_OF_RANGE),
        ("HJ_ATT_ROLL", -math.inf, par.ParamResult.VALUE_OUT_OF_RANGE),
    ):
        with refused(par.ParamError, result):
            drone.param.set_param_float(name, value)
    with refused(par.ParamError, par.ParamResult.READ_ONLY):
        drone.param.set_param_int("SYS_AUTOSTART", 1)
    assert values() == before


def test_parameters_come_with_names_units_and_ranges(drone: Drone) -> None:
    """Component metadata over MAVLink's file transfer."""
    came: list[meta.MetadataUpdate] = []
    handle = drone.metadata.subscribe_metadata_available(lambda update, _: came.append(update))
    drone.metadata.request_autopilot_component()
    until(lambda: any(update.type is meta.MetadataType.PARAMETER for update in came), 30.0, "metadata")
    drone.metadata.unsubscribe_metadata_available(handle)
    (update,) = [each for each in came if each.type is meta.MetadataType.PARAMETER]
    lines = {each["name"]: each for each in json.loads(update.json_metadata)["parameters"]}
    assert {each.name for each in drone.param.get_all_params().float_params} <= set(lines)
    assert lines["MPC_XY_VEL_MAX"]["units"] == "m/s"
    assert lines["MPC_XY_VEL_MAX"]["min"] < lines["MPC_XY_VEL_MAX"]["default"] < lines["MPC_XY_VEL_MAX"]["max"]


def test_what_cannot_be_done_is_said_at_once(drone: Drone) -> None:
    action = drone.action
    denied, unsupported = act.ActionResult.COMMAND_DENIED, act.ActionResult.UNSUPPORTED
    for ask, result in (
        (action.land, denied),
        (action.return_to_launch, denied),
        (lambda: action.goto_location(*PLACE, 20.0, 0.0), denied),
        (lambda: action.do_orbit(5.0, 1.0, act.OrbitYawBehavior(0), *PLACE, 10.0), denied),  # it stands
        (lambda: action.set_actuator(1, 0.5), unsupported),
        (lambda: action.set_relay(0, act.RelayCommand.ON), unsupported),
        (action.transition_to_fixedwing, act.ActionResult.NO_VTOL_TRANSITION_SUPPORT),
    ):
        with refused(act.ActionError, result):
            ask()
    action.disarm()  # it is
    with refused(off.OffboardError, off.OffboardResult.NO_SETPOINT_SET):
        drone.offboard.start()
    until(lambda: any("on the ground" in text for text in drone.texts), SOON, "a reason")


def test_arm_take_off_goto_hold_return(drone: Drone) -> None:
    action, telemetry = drone.action, drone.telemetry
    drone.take_off(10.0)
    home = telemetry.home()
    until(lambda: abs(drone.height - 10.0) < NEAR, SOON, "10 m")
    assert telemetry.armed()
    until(lambda: telemetry.landed_state() is tel.LandedState.IN_AIR, SOON, "in the air")
    with refused(act.ActionError, act.ActionResult.COMMAND_DENIED):
        action.disarm()

    action.set_current_speed(4.0)
    # 20 m north, 10 m east, 12 m up, nose to the east
    latitude = home.latitude_deg + 20.0 / METRES
    longitude = home.longitude_deg + 10.0 / METRES / math.cos(math.radians(home.latitude_deg))
    action.goto_location(latitude, longitude, home.absolute_altitude_m + 12.0, 90.0)
    n0, e0 = home.local_north_m, home.local_east_m
    drone.there(n0 + 20.0, e0 + 10.0, 12.0 - home.local_down_m)
    assert telemetry.position().latitude_deg == pytest.approx(latitude, abs=NEAR / METRES)
    assert telemetry.position().longitude_deg == pytest.approx(longitude, abs=1.1 * NEAR / METRES)
    drone.until(lambda: abs(drone.heading - 90.0) < 3.0, "heading")

    action.goto_location(home.latitude_deg - 40.0 / METRES, longitude, home.absolute_altitude_m + 12.0, math.nan)
    drone.until(lambda: drone.speed[0] < -2.0, "on its way south")
    action.hold()
    drone.stopped()
    assert -30.0 < drone.ned[0] - n0 < 19.0

    action.set_return_to_launch_altitude(14.0)
    assert action.get_return_to_launch_altitude() == 14.0
    action.return_to_launch()
    until(lambda: drone.mode is tel.FlightMode.RETURN_TO_LAUNCH, SOON, "return")
    highest = 0.0

    def down() -> bool:
        nonlocal highest
        highest = max(highest, drone.height)
        return not telemetry.armed()

    drone.until(down, "home")
    assert highest == pytest.approx(14.0, abs=NEAR)
    assert math.hypot(drone.ned[0] - n0, drone.ned[1] - e0) < 1.0  # it lands within a metre
    until(lambda: not telemetry.in_air(), SOON, "landed")


# what is sent unasked, and what has to be asked for
ALWAYS = (
    "position", "home", "in_air", "landed_state", "armed", "vtol_state", "attitude_quaternion", "attitude_euler",
    "attitude_angular_velocity_body", "velocity_ned", "gps_info", "raw_gps", "battery", "flight_mode", "health",
    "actuator_output_status", "position_velocity_ned", "fixedwing_metrics", "health_all_ok", "unix_epoch_time",
    "heading", "altitude", "wind",
)  # fmt: skip
ON_REQUEST = ("odometry", "ground_truth", "imu")


def test_every_stream_that_is_claimed_comes_and_they_agree(drone: Drone) -> None:
    telemetry = drone.telemetry
    drone.take_off(5.0)
    drone.until(lambda: math.hypot(*drone.speed) < 0.1, "hovering")
    for name in ON_REQUEST:
        getattr(telemetry, f"set_rate_{name}")(20.0)
    came: dict[str, Any] = {}
    handles = {}
    for name in (*ALWAYS, *ON_REQUEST):
        keep = lambda value, _, name=name: came.__setitem__(name, value)  # noqa: E731
        handles[name] = getattr(telemetry, f"subscribe_{name}")(keep)
    try:
        until(lambda: len(came) == len(handles), 15.0, "every stream")
    except AssertionError as error:
        raise AssertionError(f"missing: {set(handles) - set(came)}") from error
    for name, handle in handles.items():
        getattr(telemetry, f"unsubscribe_{name}")(handle)

    # it hovers: the same height, place and attitude whoever says it; noise is 0.3 m and less
    height = came["position"].relative_altitude_m
    assert height == pytest.approx(5.0, abs=NEAR)
    assert came["altitude"].altitude_relative_m == pytest.approx(height, abs=NEAR)
    assert came["ground_truth"].absolute_altitude_m == pytest.approx(came["position"].absolute_altitude_m, abs=NEAR)
    down = came["position_velocity_ned"].position.down_m
    assert came["odometry"].position_body.z_m == pytest.approx(down, abs=NEAR)
    for name in ("position", "raw_gps", "ground_truth"):
        north, east = came["position_velocity_ned"].position.north_m, came["position_velocity_ned"].position.east_m
        off_north = (came[name].latitude_deg - PLACE[0]) * METRES - north
        off_east = (came[name].longitude_deg - PLACE[1]) * METRES * math.cos(math.radians(PLACE[0])) - east
        assert math.hypot(off_north, off_east) < 1.5, name  # three standard deviations of a fix, and a drift meanwhile
    q = came["attitude_quaternion"]
    assert math.hypot(q.w, q.x, q.y, q.z) == pytest.approx(1.0, abs=1e-5)
    assert max(abs(came["attitude_euler"].roll_deg), abs(came["attitude_euler"].pitch_deg)) < 3.0
    assert came["imu"].acceleration_frd.down_m_s2 == pytest.approx(-9.8, abs=0.5)
    assert came["gps_info"].fix_type is tel.FixType.FIX_3D
    throttle = came["fixedwing_metrics"].throttle_percentage  # from 0 to 1 in MAVSDK
    outputs = came["actuator_output_status"].actuator[:6]
    assert sum(outputs) / 6.0 == pytest.approx(throttle, abs=0.03)  # a whole percent, at another instant
    assert (came["armed"], came["in_air"], came["flight_mode"]) == (True, True, tel.FlightMode.HOLD)


def test_it_says_how_much_faster_than_time_it_is(drone: Drone) -> None:
    """MAVSDK divides simulation time by its own; a busy machine makes it slower."""
    drone.until(lambda: 0.3 * RTF < drone.info.get_speed_factor() < 1.3 * RTF, "speed factor")


def test_offboard_position_velocity_attitude(drone: Drone) -> None:
    offboard = drone.offboard
    drone.take_off(10.0)
    n, e, d = drone.ned

    offboard.set_position_ned(off.PositionNedYaw(n + 8.0, e - 5.0, d - 2.0, 45.0))
    offboard.start()
    until(lambda: drone.mode is tel.FlightMode.OFFBOARD and offboard.is_active(), SOON, "offboard")
    drone.there(n + 8.0, e - 5.0, 2.0 - d)
    drone.until(lambda: abs(drone.heading - 45.0) < 3.0, "heading")

    asked = (1.5, -1.0, -0.5)
    offboard.set_velocity_ned(off.VelocityNedYaw(*asked, 0.0))
    drone.until(lambda: all(abs(v - w) < 0.25 for v, w in zip(drone.speed, asked, strict=True)), "velocity")
    drone.until(lambda: abs(drone.heading) < 5.0, "nose to the north")
    offboard.set_velocity_body(off.VelocityBodyYawspeed(0.0, 1.5, 0.0, 20.0))
    drone.until(lambda: drone.turn > 15.0, "turning")
    offboard.set_velocity_ned(off.VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    drone.stopped()

    throttle = drone.telemetry.fixedwing_metrics().throttle_percentage
    offboard.set_attitude(off.Attitude(6.0, 0.0, 0.0, throttle))
    drone.until(lambda: abs(drone.telemetry.attitude_euler().roll_deg - 6.0) < 1.5, "lean")
    drone.until(lambda: drone.speed[1] > 0.8, "eastwards")
    offboard.set_velocity_ned(off.VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    drone.stopped()
    offboard.set_attitude_rate(off.AttitudeRate(0.0, 0.0, 25.0, throttle))
    drone.until(lambda: drone.turn > 18.0, "rate")
    offboard.stop()
    until(lambda: drone.mode is tel.FlightMode.HOLD, SOON, "hold")
    drone.stopped()


class Pad:
    """Sticks, 25 times a second as QGroundControl sends them."""

    def __init__(self, manual: stick.ManualControl) -> None:
        self.axes = (0.0, 0.0, 0.5, 0.0)
        self._manual = manual
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._over.wait(0.04):
            self._manual.set_manual_control_input(*self.axes)

    def __enter__(self) -> Pad:
        self._manual.set_manual_control_input(*self.axes)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()


def test_flown_by_stick(drone: Drone) -> None:
    drone.take_off(8.0)
    with Pad(drone.manual) as pad:
        drone.manual.start_position_control()
        until(lambda: drone.mode is tel.FlightMode.POSCTL, SOON, "position control")
        yaw = math.radians(drone.heading)

        def along() -> tuple[float, float]:
            """Speed forward and to the right."""
            n, e, _ = drone.speed
            return n * math.cos(yaw) + e * math.sin(yaw), e * math.cos(yaw) - n * math.sin(yaw)

        pad.axes = (1.0, 0.0, 0.5, 0.0)
        drone.until(lambda: along()[0] > 2.0 and abs(along()[1]) < 0.5, "forward")
        pad.axes = (0.0, -1.0, 0.5, 0.0)
        drone.until(lambda: along()[1] < -2.0 and abs(along()[0]) < 0.5, "left")
        pad.axes = (0.0, 0.0, 1.0, 1.0)
        drone.until(lambda: drone.speed[2] < -0.5, "up")
        drone.until(lambda: drone.turn > 8.0, "turning right")
        pad.axes = (0.0, 0.0, 0.5, 0.0)
        drone.stopped()  # let go, it stays
        drone.manual.start_altitude_control()
        until(lambda: drone.mode is tel.FlightMode.ALTCTL, SOON, "altitude control")
        pad.axes = (0.3, 0.0, 0.5, 0.0)
        drone.until(lambda: drone.telemetry.attitude_euler().pitch_deg < -3.0, "nose down")
        pad.axes = (0.0, 0.0, 0.5, 0.0)
    # nobody holds the sticks any more
    drone.until(lambda: drone.mode is tel.FlightMode.HOLD, "hold")
    until(lambda: any("sticks lost" in text for text in drone.texts), SOON, "a reason")


def corner(north: float, east: float, height: float) -> mis.MissionItem:
    """A waypoint by metres from the place of the start."""
    latitude = PLACE[0] + north / METRES
    longitude = PLACE[1] + east / METRES / math.cos(math.radians(PLACE[0]))
    return mis.MissionItem(latitude, longitude, height, speed_m_s=5.0, is_fly_through=True, acceptance_radius_m=1.5)


@pytest.mark.long  # test_gcs_conformance.py flies one as QGroundControl
def test_a_mission_of_four_waypoints(drone: Drone) -> None:
    mission = drone.mission
    corners = [(12.0, 0.0, 8.0), (12.0, 12.0, 9.0), (0.0, 12.0, 10.0), (-6.0, 0.0, 8.0)]
    plan = mis.MissionPlan([corner(*each) for each in corners])
    mission.set_return_to_launch_after_mission(True)
    mission.upload_mission(plan)
    back = mission.download_mission().mission_items
    assert [(item.relative_altitude_m, item.speed_m_s) for item in back] == [(height, 5.0) for _, _, height in corners]
    for item, sent in zip(back, plan.mission_items, strict=True):
        place = (item.latitude_deg, item.longitude_deg)
        assert place == pytest.approx((sent.latitude_deg, sent.longitude_deg), abs=1e-7)  # the field's own step

    progress: list[tuple[int, int]] = []
    handle = mission.subscribe_mission_progress(lambda at, _: progress.append((at.current, at.total)))
    drone.action.arm()
    home = drone.ned
    mission.start_mission()
    until(lambda: drone.mode is tel.FlightMode.MISSION, SOON, "mission")
    nearest = [math.inf] * 4

    def look() -> None:
        n, e, d = drone.ned
        for i, (north, east, height) in enumerate(corners):
            nearest[i] = min(nearest[i], math.hypot(n - north, e - east, -d - height))

    def second() -> bool:
        look()
        return any(current >= 2 for current, _ in progress)

    drone.until(second, "two corners")
    mission.pause_mission()
    until(lambda: drone.mode is tel.FlightMode.HOLD, SOON, "pause")
    drone.stopped()
    look()
    mission.start_mission()

    def finished() -> bool:
        look()
        return not drone.telemetry.armed()

    drone.until(finished, "flown and home")
    mission.unsubscribe_mission_progress(handle)
    # accepted within 1.5 m; telemetry comes ten times a second of wall time, at 5 m/s and this speed-up every 3 m
    assert all(distance < 4.0 for distance in nearest), nearest
    assert progress[-1] == (4, 4)
    assert mission.is_mission_finished()
    assert [current for current, _ in progress] == sorted(current for current, _ in progress)
    assert math.hypot(drone.ned[0] - home[0], drone.ned[1] - home[1]) < 1.0
    mission.set_return_to_launch_after_mission(False)
    mission.clear_mission()
    assert mission.download_mission().mission_items == []


def test_an_engine_fails_on_request(drone: Drone) -> None:
    motor, gone, fine = fail.FailureUnit.SYSTEM_MOTOR, fail.FailureType.OFF, fail.FailureType.OK
    with refused(fail.FailureError, fail.FailureResult.DISABLED):
        drone.failure.inject(motor, gone, 3)
    drone.param.set_param_int("SYS_FAILURE_EN", 1)
    failure = fail.Failure(drone.system)  # the plugin reads the parameter once, when it is made
    with refused(fail.FailureError, fail.FailureResult.UNSUPPORTED):
        failure.inject(fail.FailureUnit.SENSOR_MAG, gone, 0)
    with refused(fail.FailureError, fail.FailureResult.DENIED):
        failure.inject(motor, gone, 7)
    drone.take_off(12.0)
    failure.inject(motor, gone, 3)
    drone.until(lambda: drone.mode is tel.FlightMode.LAND, "lands by itself")
    until(lambda: any("engine 3 failed" in text for text in drone.texts), SOON, "a reason")
    with refused(act.ActionError, act.ActionResult.COMMAND_DENIED):
        drone.action.reboot()
    drone.until(lambda: not drone.telemetry.armed(), "down with five engines")
    with refused(act.ActionError, act.ActionResult.COMMAND_DENIED):
        drone.action.arm()
    failure.inject(motor, fine, 0)
    drone.until(lambda: drone.telemetry.health().is_armable, "all engines are back")
    drone.param.set_param_int("SYS_FAILURE_EN", 0)


def listed(drone: Drone) -> list[logs.Entry]:
    """The logs; none where a busy machine makes one for longer than MAVSDK waits, and somebody asks again."""
    try:
        return list(drone.logs.get_entries())
    except logs.LogFilesError as error:
        if error.result is not logs.LogFilesResult.TIMEOUT:
            raise
        return []


@pytest.mark.long
def test_a_new_flight_and_the_log_of_the_old_one(tmp_path: Path) -> None:
    """A vehicle of its own: its first flight is short, and so is the log."""
    drone = Drone(tmp_path)
    try:
        with refused(logs.LogFilesError, logs.LogFilesResult.NO_LOGFILES):
            drone.logs.get_entries()
        drone.action.reboot()
        until(lambda: any(text.startswith("flight 2") for text in drone.texts), FLIGHT_PATIENCE, "a new flight")
        drone.until(lambda: drone.telemetry.health().is_armable, "ready again")
        (entry,) = until(lambda: listed(drone), FLIGHT_PATIENCE, "the list")
        results: list[logs.LogFilesResult] = []
        path = tmp_path / "flight.ulg"
        drone.logs.download_log_file_async(entry, str(path), lambda result, progress, _: results.append(result))
        until(lambda: results and results[-1] is not logs.LogFilesResult.NEXT, FLIGHT_PATIENCE, "the log")
        assert results[-1] is logs.LogFilesResult.SUCCESS
        drone.action.shutdown()
        out, _ = drone.vehicle.process.communicate(timeout=FLIGHT_PATIENCE)
    finally:
        drone.close()
    first, second = json.loads(out)["runs"]
    assert second["reason"].startswith("shut down by udpin")
    assert path.stat().st_size == entry.size_bytes

    from pyulog import ULog

    attitude = ULog(str(path)).get_dataset("vehicle_attitude").data
    # at PX4's rate: every 50 ms, to the nearest 12 steps, and the last step
    last = first["steps"] - 1
    assert attitude["timestamp"].tolist() == [4000 * k for k in range(last + 1) if k % 12 == 0 or k == last]


def test_the_program_of_the_page_takes_off(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "ground-station.md").read_text(encoding="utf-8")
    (program,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    vehicle = VehicleProcess(tmp_path, RTF)
    try:
        address = f"udpout://{LOOPBACK}:{vehicle.port}"
        exec(program.replace("udpin://127.0.0.1:14540", address).replace("sleep(20)", "sleep(2)"), {})
        vehicle.stop()
    finally:
        vehicle.kill()
    (run,) = vehicle.folder.parent.glob("run*/flight.parquet")
    assert open_run(run.parent).log["altitude_m"].max() > 0.5
