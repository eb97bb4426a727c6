"""What an autopilot did, in the run's folder and in ULog as PX4 logs it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

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
ASKED: list[tuple[float, rq.Request]] = [
    (1.2, rq.SetParameter("MPC_XY_VEL_MAX", 3.0)),
    (1.2, rq.Arm()),
    (1.2, rq.Takeoff(4.0)),
    (9.0, rq.MissionUpload((rq.MissionItem(rq.ItemKind.RETURN),))),
    (12.0, rq.SetParameter("HJ_FENCE_RAD", 50.0)),
    (13.0, rq.Land()),
]


def flown(asked: list[tuple[float, rq.Request]], folder: Path, seconds: float) -> tuple[Run, Path]:
    """A flight of these requests, each at its second, and the folder of its run."""
    waiting = make_ground_scenario(Scenario.load("hover"), seconds)
    log = RequestLog(folder / REQUESTS)
    for at, request in asked:
        log.write(round(at / waiting.step_s), "test", request, Answer(True, Result.ACCEPTED, ""))
    log.close()
    scenario = Scenario.from_table(waiting.model_dump(mode="json", exclude_none=True), folder, "waiting")
    return fly(scenario, folder / "run", report=False), folder / "run"


@pytest.fixture(scope="module")
def piloted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    return flown(ASKED, tmp_path_factory.mktemp("piloted"), SECONDS)


@pytest.fixture(scope="module")
def ulog(piloted: tuple[Run, Path], tmp_path_factory: pytest.TempPathFactory) -> ULog:
    return exported(piloted[1], tmp_path_factory.mktemp("exported") / "flight.ulg")


@pytest.fixture(scope="module")
def record(piloted: tuple[Run, Path]) -> dict[str, list[dict[str, Any]]]:
    """The record's lines by their kind."""
    kinds: dict[str, list[dict[str, Any]]] = {}
    for line in read_pilot_record(piloted[1]):
        assert isinstance(line["k"], int)
        kinds.setdefault(str(line["kind"]), []).append(line)
    return kinds


def test_the_record_tells_the_flight(piloted: tuple[Run, Path], record: dict[str, list[dict[str, Any]]]) -> None:
    assert piloted[0].outcome == "completed", piloted[0].summary.reason
    states = record["state"]
    assert list(dict.fromkeys(state["mode"] for state in states)) == ["HOLD", "TAKEOFF", "LAND"]
    assert not states[0]["armed"]
    assert next(state["k"] for state in states if state["armed"]) == 300  # the step before which it was asked for
    (first,) = record["parameters"]
    assert first["values"]["MPC_XY_VEL_MAX"] != 3.0
    assert isinstance(first["values"]["HJ_PRED_TYPE"], int)
    changed = {line["name"]: (line["k"], line["value"]) for line in record["parameter"]}
    assert changed == {"MPC_XY_VEL_MAX": (300, 3.0), "HJ_FENCE_RAD": (3000, 50.0)}
    assert "armed" in [line["text"] for line in record["message"]]
    assert record["mission"][-1]["count"] == 1
    assert [line["k"] for line in record["estimate"]] == list(range(0, len(piloted[0].log), 25))


def test_the_same_flight_has_the_same_record(piloted: tuple[Run, Path], tmp_path: Path) -> None:
    fly(Scenario.load(piloted[1] / "scenario.toml"), tmp_path / "again", report=False)
    assert (tmp_path / "again" / AUTOPILOT).read_bytes() == (piloted[1] / AUTOPILOT).read_bytes()


def test_states_are_px4s(record: dict[str, list[dict[str, Any]]], ulog: ULog) -> None:
    """vehicle_status at each change, and once a second in between."""
    data = ulog.get_dataset("vehicle_status").data
    k = np.rint(data["timestamp"] / 4000.0)
    for state in record["state"]:
        (row, *_) = np.flatnonzero(k == state["k"])
        assert data["nav_state"][row] == NAV_STATE[state["mode"]]
        assert data["arming_state"][row] == (2 if state["armed"] else 1)
    assert {NAV_STATE["HOLD"], NAV_STATE["TAKEOFF"], NAV_STATE["LAND"]} <= set(data["nav_state"].tolist())
    assert np.max(np.diff(data["timestamp"])) <= 1_000_000
    landed = ulog.get_dataset("vehicle_land_detected").data["landed"].tolist()
    assert landed[0] == 1
    assert 0 in landed


def test_position_is_the_autopilots_and_set_points_are_there(
    piloted: tuple[Run, Path], record: dict[str, list[dict[str, Any]]], ulog: ULog
) -> None:
    data = ulog.get_dataset("vehicle_local_position").data
    position = np.array([line["position"] for line in record["estimate"]]).astype(np.float32)
    np.testing.assert_array_equal(data["x"][::25], position[:, 0])
    np.testing.assert_array_equal(data["y"][24::25][:100], position[:100, 1])  # held in between
    assert data["xy_valid"].all()
    assert data["v_xy_valid"].all()
    raw = ulog.get_dataset("hexjet_gnss").data
    np.testing.assert_array_equal(raw["x"], piloted[0].log["north_measured_m"].astype(np.float32))
    wanted = ulog.get_dataset("vehicle_local_position_setpoint").data
    hovering = slice(2700, 3000)  # at 4 m, before the landing
    np.testing.assert_allclose(wanted["z"][hovering], -4.0, atol=0.3)
    assert np.isfinite(wanted["x"][hovering]).all()


def test_without_fixes_the_position_is_not_valid(tmp_path: Path) -> None:
    """A second after the last fix, as the ground station is told."""
    silent = rq.InjectFault("sensor_dropout", sensor="gnss")
    _, folder = flown([(0.4, rq.SetParameter("SYS_FAILURE_EN", 1)), (0.5, silent)], tmp_path, 4.0)
    data = exported(folder, tmp_path / "flight.ulg").get_dataset("vehicle_local_position").data
    lost = data["timestamp"] > 2e6
    assert data["xy_valid"][~lost][:100].all()
    assert not data["xy_valid"][lost].any()
    assert data["z_valid"].all()


def test_messages_and_parameters(
    piloted: tuple[Run, Path], record: dict[str, list[dict[str, Any]]], ulog: ULog
) -> None:
    said = {message.message for message in ulog.logged_messages}
    assert {line["text"] for line in record["message"]} <= said
    end = f"completed: {piloted[0].summary.reason}; completed, nothing checked"
    assert {"mode TAKEOFF", "mode LAND", end} <= said
    times = [message.timestamp for message in ulog.logged_messages]
    assert times == sorted(times)
    (first,) = record["parameters"]
    # beside the vehicle's and the scenario's numbers, whose names have a /
    assert {name for name in ulog.initial_parameters if "/" not in name} == first["values"].keys()
    assert ulog.initial_parameters["HJ_PRED_TYPE"] == first["values"]["HJ_PRED_TYPE"]
    changed = [(name, value) for _, name, value in ulog.changed_parameters]
    assert changed == [("MPC_XY_VEL_MAX", 3.0), ("HJ_FENCE_RAD", 50.0)]


def small(folder: Path, path: Path, seconds: float) -> ULog:
    """The log at PX4's rates: a download at 225 kB/s takes a tenth of the flight."""
    export_log("ulog", folder, path, rates="px4")
    log = ULog(str(path))
    assert not log.file_corruption
    fixed = 8_000  # formats and parameters, whatever the flight's length
    assert path.stat().st_size < fixed + 22_500 * seconds
    return log


def test_at_px4s_rates_a_log_is_a_tenth(piloted: tuple[Run, Path], tmp_path: Path) -> None:
    log = small(piloted[1], tmp_path / "small.ulg", SECONDS)
    for topic in log.data_list:
        if topic.name in INTERVAL_S and topic.name not in ("vehicle_status", "vehicle_land_detected"):
            every = 4000 * round(INTERVAL_S[topic.name] / 0.004)
            times = topic.data["timestamp"]
            assert set(np.diff(times[:-1]).tolist()) == {every}, topic.name
            # the last step is there, whatever the rate
            assert times[-1] == 4000 * (len(piloted[0].log) - 1), topic.name
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
    asked = {"step": 1000, "sender": "test", "request": "Goto", "north": 10.0, "east": 5.0}
    (tmp_path / "asked.jsonl").write_text(json.dumps(asked) + "\n")
    held = {"name": "long", "aircraft": "hexjet-p220", "engine": "p220", "controller": "smith", "duration_s": seconds}
    held |= {"requests": "asked.jsonl", "initial": {"altitude_m": 20.0}}
    held |= {"environment": {"wind_ned_m_s": [0.0, 5.0, 0.0]}}
    run = fly(Scenario.from_table(held, tmp_path, "long"), tmp_path / "run", report=False)
    assert run.outcome == "completed"
    small(tmp_path / "run", tmp_path / "long.ulg", seconds)
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
