"""What an autopilot did, in the run's folder and in ULog as PX4 logs it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from flights import exported
from mavlink_bench import ReadyStore
from mavlink_tools import Bench
from pyulog import ULog

from cosim import Run, Scenario, fly
from cosim.base.errors import InputError
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.requests import Answer, Result
from cosim.groundstation.mavlink.services.logs import LogService, LogStore
from cosim.groundstation.mavlink.wire.dialect import mav
from cosim.groundstation.session import make_ground_scenario
from cosim.results.autopilot.autopilot_record import read_pilot_record
from cosim.results.autopilot.request_log import RequestLog
from cosim.results.export import export_log
from cosim.results.run import AUTOPILOT, REQUESTS
from hexjet_export.logs.ulog_autopilot import NAV_STATE
from hexjet_export.logs.ulog_topics import INTERVAL_S, TOPICS

SECONDS = 24.0
ASKED = [
    (1.2, rq.SetParameter("MPC_XY_VEL_MAX", 3.0)),
    (1.2, rq.Arm()),
    (1.2, rq.Takeoff(4.0)),
    (9.0, rq.MissionUpload((rq.MissionItem(rq.ItemKind.RETURN),))),
    (12.0, rq.SetParameter("HJ_FENCE_RAD", 50.0)),
    (13.0, rq.Land()),
]


@pytest.fixture(scope="module")
def piloted(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("piloted")
    waiting = make_ground_scenario(Scenario.load("hover"), SECONDS)
    log = RequestLog(folder / REQUESTS)
    for at, request in ASKED:
        log.write(round(at / waiting.step_s), "test", request, Answer(True, Result.ACCEPTED, ""))
    log.close()
    scenario = Scenario.from_table(waiting.model_dump(mode="json", exclude_none=True), folder, "waiting")
    return fly(scenario, folder / "run", report=False)


@pytest.fixture(scope="module")
def ulog(piloted: Run, tmp_path_factory: pytest.TempPathFactory) -> ULog:
    return exported(piloted.folder, tmp_path_factory.mktemp("exported") / "flight.ulg")


def of(run: Run, kind: str) -> list[dict[str, object]]:
    assert run.folder is not None
    return [line for line in read_pilot_record(run.folder) if line["kind"] == kind]


def test_the_record_tells_the_flight(piloted: Run) -> None:
    assert piloted.outcome == "completed", piloted.summary.reason
    states = of(piloted, "state")
    modes = [state["mode"] for state in states]
    assert list(dict.fromkeys(modes)) == ["HOLD", "TAKEOFF", "LAND"]
    assert not states[0]["armed"]
    assert any(state["armed"] for state in states)
    armed = next(state["k"] for state in states if state["armed"])
    assert armed == 300  # the step before which it was asked for
    (first,) = of(piloted, "parameters")
    values = first["values"]
    assert isinstance(values, dict)
    assert values["MPC_XY_VEL_MAX"] != 3.0
    assert isinstance(values["HJ_PRED_TYPE"], int)
    changed = {line["name"]: (line["k"], line["value"]) for line in of(piloted, "parameter")}
    assert changed == {"MPC_XY_VEL_MAX": (300, 3.0), "HJ_FENCE_RAD": (3000, 50.0)}
    assert "armed" in [line["text"] for line in of(piloted, "message")]
    assert of(piloted, "mission")[-1]["count"] == 1
    estimates = of(piloted, "estimate")
    assert [line["k"] for line in estimates] == list(range(0, len(piloted.log["time_s"]), 25))
    steps = [line["k"] for line in read_pilot_record(piloted.folder or Path())]
    assert all(isinstance(k, int) for k in steps)


def test_the_same_flight_has_the_same_record(piloted: Run, tmp_path: Path) -> None:
    assert piloted.folder is not None
    again = fly(Scenario.load(piloted.folder / "scenario.toml"), tmp_path / "again", report=False)
    assert again.folder is not None
    assert (again.folder / AUTOPILOT).read_bytes() == (piloted.folder / AUTOPILOT).read_bytes()


def test_states_are_px4s(piloted: Run, ulog: ULog) -> None:
    """vehicle_status at each change, and once a second in between."""
    data = ulog.get_dataset("vehicle_status").data
    states = of(piloted, "state")
    k = np.rint(data["timestamp"] / 4000.0)
    for state in states:
        (row, *_) = np.flatnonzero(k == state["k"])
        assert data["nav_state"][row] == NAV_STATE[str(state["mode"])]
        assert data["arming_state"][row] == (2 if state["armed"] else 1)
    assert {NAV_STATE["HOLD"], NAV_STATE["TAKEOFF"], NAV_STATE["LAND"]} <= set(data["nav_state"].tolist())
    assert np.max(np.diff(data["timestamp"])) <= 1_000_000
    landed = ulog.get_dataset("vehicle_land_detected").data
    assert landed["landed"][0] == 1
    assert 0 in landed["landed"].tolist()


def test_position_is_the_autopilots_and_set_points_are_there(piloted: Run, ulog: ULog) -> None:
    data = ulog.get_dataset("vehicle_local_position").data
    estimates = of(piloted, "estimate")
    position = np.array([line["position"] for line in estimates])
    np.testing.assert_array_equal(data["x"][::25], position[:, 0].astype(np.float32))
    np.testing.assert_array_equal(data["y"][24::25][:100], position[:100, 1].astype(np.float32))  # held in between
    assert data["xy_valid"].all()
    assert data["v_xy_valid"].all()
    raw = ulog.get_dataset("hexjet_gnss").data
    np.testing.assert_array_equal(raw["x"], piloted.log["north_measured_m"].astype(np.float32))
    wanted = ulog.get_dataset("vehicle_local_position_setpoint").data
    hovering = slice(2700, 3000)  # at 4 m, before the landing
    np.testing.assert_allclose(wanted["z"][hovering], -4.0, atol=0.3)
    assert np.isfinite(wanted["x"][hovering]).all()


def test_without_fixes_the_position_is_not_valid(tmp_path: Path) -> None:
    """A second after the last fix, as the ground station is told."""
    waiting = make_ground_scenario(Scenario.load("hover"), 4.0)
    log = RequestLog(tmp_path / REQUESTS)
    silent = rq.InjectFault("sensor_dropout", sensor="gnss")
    for at, request in ((0.4, rq.SetParameter("SYS_FAILURE_EN", 1)), (0.5, silent)):
        log.write(round(at / waiting.step_s), "test", request, Answer(True, Result.ACCEPTED, ""))
    log.close()
    scenario = Scenario.from_table(waiting.model_dump(mode="json", exclude_none=True), tmp_path, "waiting")
    run = fly(scenario, tmp_path / "run", report=False)
    data = exported(run.folder, tmp_path / "flight.ulg").get_dataset("vehicle_local_position").data
    lost = data["timestamp"] > 2e6
    assert data["xy_valid"][~lost][:100].all()
    assert not data["xy_valid"][lost].any()
    assert data["z_valid"].all()


def test_messages_and_parameters(piloted: Run, ulog: ULog) -> None:
    said = {message.message for message in ulog.logged_messages}
    assert {str(line["text"]) for line in of(piloted, "message")} <= said
    end = f"completed: {piloted.summary.reason}; completed, nothing checked"
    assert {"mode TAKEOFF", "mode LAND", end} <= said
    times = [message.timestamp for message in ulog.logged_messages]
    assert times == sorted(times)
    (first,) = of(piloted, "parameters")
    assert isinstance(first["values"], dict)
    # beside the vehicle's and the scenario's numbers, whose names have a /
    assert {name for name in ulog.initial_parameters if "/" not in name} == first["values"].keys()
    assert ulog.initial_parameters["HJ_PRED_TYPE"] == first["values"]["HJ_PRED_TYPE"]
    assert [(name, value) for _, name, value in ulog.changed_parameters] == [
        ("MPC_XY_VEL_MAX", 3.0),
        ("HJ_FENCE_RAD", 50.0),
    ]


def test_at_px4s_rates_a_log_is_a_tenth(piloted: Run, tmp_path: Path) -> None:
    """A download at 225 kB/s takes a tenth of the flight."""
    assert piloted.folder is not None
    export_log("ulog", piloted.folder, tmp_path / "small.ulg", rates="px4")
    log = ULog(str(tmp_path / "small.ulg"))
    assert not log.file_corruption
    fixed = 8_000  # formats and parameters, whatever the flight's length
    assert (tmp_path / "small.ulg").stat().st_size < fixed + 22_500 * SECONDS
    for topic in log.data_list:
        if topic.name in INTERVAL_S and topic.name not in ("vehicle_status", "vehicle_land_detected"):
            every = 4000 * round(INTERVAL_S[topic.name] / 0.004)
            times = topic.data["timestamp"]
            assert set(np.diff(times[:-1]).tolist()) == {every}, topic.name
            assert times[-1] == 4000 * (len(piloted.log) - 1), topic.name  # the last step is there, whatever the rate
            assert times[-1] - times[-2] <= every, topic.name
    # nothing that is rare is thinned out
    assert len(log.logged_messages) > 5


def test_every_topic_has_a_rate() -> None:
    assert set(TOPICS) <= set(INTERVAL_S)
    assert all(0.0 < seconds <= 1.0 for seconds in INTERVAL_S.values())


@pytest.mark.parametrize(
    ("line", "message"), [("{", "not JSON"), ("[1]", "must be an object"), ('{"k": "a", "kind": "state"}', "must be")]
)
def test_a_wrong_record_is_one_line(line: str, message: str, tmp_path: Path) -> None:
    (tmp_path / AUTOPILOT).write_text(json.dumps({"k": 0, "kind": "state"}) + "\n" + line + "\n")
    with pytest.raises(InputError, match=rf"autopilot\.jsonl, line 2: {message}"):
        read_pilot_record(tmp_path)


def test_a_torn_last_line_is_left_out_and_no_file_is_no_record(tmp_path: Path) -> None:
    assert read_pilot_record(tmp_path) == []
    (tmp_path / AUTOPILOT).write_text('{"k": 0, "kind": "state"}\n{"k": 1, "ki')
    assert [line["k"] for line in read_pilot_record(tmp_path)] == [0]


def test_so_is_a_log_of_a_long_flight_on_turbines(tmp_path: Path) -> None:
    """Six engines with all that they tell, a minute in wind, from which on every minute is as the one before."""
    seconds = 60.0
    (tmp_path / "asked.jsonl").write_text(
        json.dumps({"step": 1000, "sender": "test", "request": "Goto", "north": 10.0, "east": 5.0}) + "\n"
    )
    held = {"name": "long", "aircraft": "hexjet-p220", "engine": "p220", "controller": "smith", "duration_s": seconds}
    scenario = Scenario.from_table(
        held
        | {
            "requests": "asked.jsonl",
            "initial": {"altitude_m": 20.0},
            "environment": {"wind_ned_m_s": [0.0, 5.0, 0.0]},
        },
        tmp_path,
        "long",
    )
    run = fly(scenario, tmp_path / "run", report=False)
    assert run.outcome == "completed"
    assert run.folder is not None
    export_log("ulog", run.folder, tmp_path / "long.ulg", rates="px4")
    fixed = 8_000
    assert (tmp_path / "long.ulg").stat().st_size < fixed + 22_500 * seconds
    assert not ULog(str(tmp_path / "long.ulg")).file_corruption
    got, took = downloaded(tmp_path / "long.ulg")
    assert got == (tmp_path / "long.ulg").read_bytes()
    assert took < 0.1 * seconds


def downloaded(path: Path) -> tuple[bytes, float]:
    """A vehicle's log as a station gets it, part by part as MAVSDK asks, beside all telemetry; s on the link's clock."""
    bench = Bench(services=[LogService(cast(LogStore, ReadyStore(path)))])
    desk, size, whole = bench.station(), path.stat().st_size, 512 * 90
    parts: dict[int, bytes] = {}
    begun = bench.time
    for start in range(0, size, whole):
        end = min(start + whole, size)
        desk.send(mav.MAVLink_log_request_data_message(1, 1, 0, start, end - start))
        while sum(map(len, parts.values())) < end:
            assert bench.time - begun < 60.0
            bench.step(0.01, every=0.01)
            parts |= {part.ofs: bytes(part.data[: part.count]) for part in desk.named("LOG_DATA")}
            desk.got.clear()
    took = bench.time - begun
    bench.close()
    return b"".join(parts[at] for at in sorted(parts)), took
