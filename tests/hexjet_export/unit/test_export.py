"""Logs in other formats, read back by somebody else's reader."""

from __future__ import annotations

import shutil
from math import nan
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from flights import exported, record, samples, scenario, setup
from pyulog import ULog

from cosim.base.errors import InputError
from cosim.base.frames import from_euler, to_euler
from cosim.base.signals import Command, EngineOutput
from cosim.results.export import export_log
from cosim.results.log.columns import NAMES
from cosim.results.report.flight import write_report
from cosim.results.run import LOG, Run, begin_run, open_run
from hexjet_export.logs.contents import list_numbers, quaternions
from hexjet_export.logs.ulog_topics import TOPICS

STEPS = 700


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A flight whose attitude loop is replaced at first, and whose height loop is replaced for longer."""
    recording = begin_run(setup(), scenario(), tmp_path_factory.mktemp("runs") / "run")
    for sample in samples(STEPS):
        if sample.k < 100:
            sample = sample._replace(command=Command((0.1, 0.0, 0.0), 30.0, rate=(0.1, 0.2, 0.3), collective=0.4))
        elif sample.k < 200:
            sample = sample._replace(command=Command((0.1, 0.0, 0.0), 30.0, collective=0.4))
        if sample.k > 50:  # the engines have something to say
            said = [tuple(at + jet + 0.1 * sample.k for jet in range(6)) for at in (4000.0, 700.0, 3.0)]
            sample = sample._replace(
                engines=EngineOutput(sample.thrust, *said),
                fuel=9.0 - 0.01 * sample.k,
                spool_moment=(0.1, -0.2, sample.time),
                state=sample.state._replace(air_rate=(0.3, -0.4, 0.1 * sample.time)),
                measured=sample.measured._replace(specific_force=(0.1, 0.2, -9.7 - 0.1 * sample.time)),
            )
        recording.observe(sample)
    return recording.finish("diverged", "leaned past 90 deg")


@pytest.fixture(scope="module")
def ulog(run: Run, tmp_path_factory: pytest.TempPathFactory) -> ULog:
    return exported(run.folder, tmp_path_factory.mktemp("exported") / "flight.ulg")


def same(found: np.ndarray, expected: np.ndarray) -> None:
    """Equal to what float32 can hold of it."""
    np.testing.assert_array_equal(found, expected.astype(np.float32))


def test_csv_has_every_digit(run: Run, tmp_path: Path) -> None:
    assert run.folder is not None
    export_log("csv", run.folder, tmp_path / "flight.csv")
    text = (tmp_path / "flight.csv").read_text()
    assert text.splitlines()[0].split(",") == list(NAMES)
    table = np.loadtxt(tmp_path / "flight.csv", delimiter=",", skiprows=1)
    assert table.shape == (STEPS, len(NAMES))
    for index, name in enumerate(NAMES):
        np.testing.assert_array_equal(table[:, index], run.log[name], err_msg=name)  # NaN equals NaN here
    assert np.isnan(table[:100, NAMES.index("roll_setpoint_rad")]).all()


def test_a_run_older_than_a_column_opens_reports_and_exports(run: Run, tmp_path: Path) -> None:
    """Without the rate of the air: the report needs none, CSV has the columns there are, and ULog says NaN."""
    assert run.folder is not None
    folder = tmp_path / "run"
    shutil.copytree(run.folder, folder)
    table = pq.read_table(folder / LOG)
    pq.write_table(table.drop_columns([f"air_rate_{axis}_rad_s" for axis in "pqr"]), folder / LOG)
    old = open_run(folder)
    assert len(old.log) == STEPS
    write_report(old, tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size > 1e5
    export_log("csv", folder, tmp_path / "old.csv")
    assert len((tmp_path / "old.csv").read_text().splitlines()[0].split(",")) == len(NAMES) - 3
    export_log("ulog", folder, tmp_path / "old.ulg")
    data = ULog(str(tmp_path / "old.ulg")).get_dataset("hexjet_disturbance").data
    assert all(np.isnan(data[f"air_rate_rad_s[{i}]"]).all() for i in range(3))
    assert (data["mass_kg"] > 0.0).all()


def test_times_are_microseconds_from_the_start(run: Run, ulog: ULog) -> None:
    expected = np.arange(STEPS) * 4000
    for topic in ulog.data_list:
        np.testing.assert_array_equal(topic.data["timestamp"], expected, err_msg=topic.name)
    assert ulog.start_timestamp == 0


@pytest.mark.parametrize(
    ("topic", "pattern"), [("vehicle_attitude", "{}_measured_rad"), ("vehicle_attitude_groundtruth", "{}_rad")]
)
def test_attitudes_in_ulog_are_those_of_the_log(run: Run, ulog: ULog, topic: str, pattern: str) -> None:
    data = ulog.get_dataset(topic).data
    for row in (0, 1, 350, STEPS - 1):
        roll, pitch, yaw = (float(run.log[pattern.format(axis)][row]) for axis in ("roll", "pitch", "yaw"))
        found = [float(data[f"q[{i}]"][row]) for i in range(4)]
        assert found == pytest.approx(from_euler(roll, pitch, yaw), abs=1e-7)  # float32: 24 bits of at most 1


def test_quaternions_are_those_of_the_scalar_code() -> None:
    random = np.random.default_rng(6)
    angles = random.uniform(-1.5, 1.5, size=(3, 200))
    for q, (roll, pitch, yaw) in zip(quaternions(*angles), angles.T, strict=True):
        w, x, y, z = q.tolist()
        assert to_euler((w, x, y, z)) == pytest.approx((roll, pitch, yaw), abs=1e-12)


def test_other_topics_in_ulog_are_columns_of_the_log(run: Run, ulog: ULog) -> None:
    log = run.log
    expected = {
        "vehicle_angular_velocity": {
            "xyz[0]": log["rate_p_measured_rad_s"],
            "xyz[1]": log["rate_q_measured_rad_s"],
            "xyz[2]": log["rate_r_measured_rad_s"],
        },
        "vehicle_angular_velocity_groundtruth": {"xyz[0]": log["rate_p_rad_s"], "xyz[2]": log["rate_r_rad_s"]},
        "vehicle_rates_setpoint": {
            "roll": log["rate_p_setpoint_rad_s"],
            "pitch": log["rate_q_setpoint_rad_s"],
            "yaw": log["rate_r_setpoint_rad_s"],
            "thrust_body[2]": -log["collective"],
        },
        "vehicle_local_position": {
            "x": log["north_measured_m"],
            "y": log["east_measured_m"],
            "z": log["down_measured_m"],
            "vx": log["velocity_north_measured_m_s"],
            "vy": log["velocity_east_measured_m_s"],
            "vz": log["velocity_down_measured_m_s"],
            "heading": log["yaw_measured_rad"],
        },
        "vehicle_local_position_groundtruth": {"x": log["north_m"], "z": log["down_m"], "vy": log["velocity_east_m_s"]},
        "vehicle_local_position_setpoint": {"z": -log["altitude_setpoint_m"], "x": log["north_setpoint_m"]},
        "hexjet_fault": {"jet[2]": log["fault_jet_3"], "servo[1]": log["fault_servo_right"]}
        | {"sensor[3]": log["fault_barometer"], "health[5]": log["health_6"]},
        "sensor_combined": {
            "gyro_rad[0]": log["rate_p_measured_rad_s"],
            "accelerometer_m_s2[2]": log["specific_force_z_measured_m_s2"],
        },
        "actuator_motors": {f"control[{i}]": log[f"throttle_{i + 1}"] for i in range(6)}
        | {"control[6]": np.full(STEPS, nan)},
        "vehicle_land_detected": {"landed": log["on_ground"]},
        "wind": {"windspeed_north": log["wind_north_m_s"], "windspeed_east": log["wind_east_m_s"]},
        "hexjet_thrust": {f"newton[{i}]": log[f"thrust_{i + 1}_N"] for i in range(6)},
        "hexjet_engine": {f"spool_speed_rad_s[{i}]": log[f"spool_speed_{i + 1}_rad_s"] for i in range(6)}
        | {f"exhaust_temperature_k[{i}]": log[f"exhaust_temperature_{i + 1}_K"] for i in range(6)}
        | {f"fuel_flow_kg_s[{i}]": log[f"fuel_flow_{i + 1}_kg_s"] for i in range(6)}
        | {f"spool_moment_n_m[{i}]": log[f"spool_moment_{x}_N_m"] for i, x in enumerate("xyz")}
        | {"fuel_kg": log["fuel_kg"]},
        "hexjet_rate_predicted": {"xyz[0]": log["rate_p_predicted_rad_s"]},
        "hexjet_tilt": {"actual_rad[1]": log["tilt_right_rad"], "command_rad[0]": log["tilt_left_command_rad"]},
        "hexjet_control": {
            "torque[0]": log["torque_roll"],
            "refused[2]": log["refused_yaw"],
            "collective": log["collective"],
            "refused_collective": log["refused_collective"],
        },
        "hexjet_disturbance": {"moment_n_m[0]": log["disturbance_moment_x_N_m"], "mass_kg": log["mass_kg"]}
        | {f"air_rate_rad_s[{i}]": log[f"air_rate_{axis}_rad_s"] for i, axis in enumerate("pqr")},
        "hexjet_height": {"true_m": log["altitude_m"], "measured_m": log["altitude_measured_m"]},
    }
    for topic, fields in expected.items():
        data = ulog.get_dataset(topic).data
        for field, values in fields.items():
            same(data[field], values)
    written = {topic.name for topic in ulog.data_list}
    assert written == set(expected) | {
        "vehicle_attitude",
        "vehicle_attitude_groundtruth",
        "vehicle_attitude_setpoint",
        "vehicle_status",
    }


def test_setpoints_and_mode_follow_the_loops_that_are_closed(run: Run, ulog: ULog) -> None:
    q_d = ulog.get_dataset("vehicle_attitude_setpoint").data["q_d[0]"]
    assert np.isnan(q_d[:100]).all()
    assert np.isfinite(q_d[100:]).all()
    status = ulog.get_dataset("vehicle_status").data
    assert status["nav_state"].tolist() == [10] * 100 + [15] * 100 + [1] * (STEPS - 200)  # acro, stabilized, altitude
    assert set(status["arming_state"].tolist()) == {2}


def test_the_log_says_where_it_comes_from(ulog: ULog) -> None:
    assert ulog.msg_info_dict["sys_name"] == "hexjet-cosim"
    assert ulog.msg_info_dict["hexjet_engine"] == "edf-as-flown"
    assert ulog.msg_info_dict["hexjet_reason"] == "leaned past 90 deg"
    (message,) = ulog.logged_messages
    assert message.message == "diverged: leaned past 90 deg"
    assert message.log_level_str() == "ERROR"
    assert message.timestamp == STEPS * 4000


def test_parameters_are_the_numbers_of_vehicle_and_scenario_under_their_keys(run: Run, ulog: ULog) -> None:
    vehicle = run.scenario.resolved_vehicle()[0]
    found = ulog.initial_parameters
    assert found["vehicle/mass_kg"] == np.float32(vehicle.mass_kg)
    assert found["vehicle/control/rate/pitch/p"] == np.float32(vehicle.control.rate.pitch.p)
    assert found["vehicle/jets/1/position_m/1"] == np.float32(vehicle.jets[1].position_m[1])
    assert found["vehicle/jets/1/spin"] == vehicle.jets[1].spin
    assert isinstance(found["vehicle/jets/1/spin"], int)
    assert found["scenario/command/0/amplitude"] == 10.0
    assert not [name for name in found if not name.replace("/", "").replace("-", "").replace("_", "").isalnum()]
    # of the engine that is flown alone, in either FMI version
    for engine, family in (("edf-as-flown", "edf-as-flown"), ("edf-fmi2", "edf")):
        numbers = list_numbers(scenario(engine=engine))
        assert {name.split("/")[2] for name in numbers if "/identified/" in name} == {family}


@pytest.mark.parametrize("rows", [0, 1])
def test_flights_of_next_to_nothing(tmp_path: Path, rows: int) -> None:
    record(rows, tmp_path / "run", "failed", "Triebwerk läuft nicht")
    export_log("ulog", tmp_path / "run", tmp_path / "x.ulg")
    export_log("csv", tmp_path / "run", tmp_path / "x.csv")
    assert len((tmp_path / "x.csv").read_text().splitlines()) == 1 + rows
    log = ULog(str(tmp_path / "x.ulg"))
    assert log.msg_info_dict["hexjet_reason"] == "Triebwerk läuft nicht"
    assert sum(len(topic.data["timestamp"]) for topic in log.data_list) == len(TOPICS) * rows


def test_bad_targets_are_one_line(run: Run, tmp_path: Path) -> None:
    assert run.folder is not None
    (tmp_path / "file").write_text("")
    for folder, path in (
        (tmp_path, tmp_path / "x"),
        (run.folder, tmp_path / "file" / "x"),
        (run.folder, run.folder / LOG),
    ):
        before = (run.folder / LOG).read_bytes()
        with pytest.raises(InputError) as complaint:
            export_log("ulog", folder, path)
        assert "\n" not in str(complaint.value)
        assert (run.folder / LOG).read_bytes() == before
