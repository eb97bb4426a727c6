"""What happened in a flight: read from log and scenario, shown on the page, carried by ULog."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from pyulog import ULog

from cosim import fly
from cosim.results import events
from cosim.results.export import export_log
from cosim.results.log.recorder import MemoryLog
from cosim.results.report.flight import write_report
from cosim.results.report.log_reader import Reader
from cosim.results.report.plot import BLUE
from cosim.results.report.signals_data import FlightData, run_data
from cosim.results.run import Run, open_run
from cosim.spec.scenario import Fault, Scenario

STEP = 0.004


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """An engine that goes out for a second and is given up, a gust, and a jam that lasts to the end."""
    return fly(
        Scenario.load("fault-relight").replace(
            duration_s=4.0,
            expect=[],
            environment={"wind_ned_m_s": (3.0, 0.0, 0.0)},
            disturbance=[
                {
                    "kind": "gust", "start_s": 2.5, "velocity_ned_m_s": (0.0, 3.0, 4.0),
                    "rise_s": 0.2, "hold_s": 0.1, "fall_s": 0.2,
                },
            ],
            fault=[
                {"kind": "flame_out", "start_s": 1.0, "duration_s": 1.0, "jet": 6},
                {"kind": "servo_jam", "start_s": 3.0, "servo": "left"},
            ],
        ),
        tmp_path_factory.mktemp("runs") / "run",
    )  # fmt: skip


def test_everything_is_there_in_the_order_of_time(run: Run) -> None:
    found = [(event.kind, event.text) for event in events.list_events(run)]
    assert found == [
        ("disturbance", "wind of 3 m/s"),
        ("fault", "jet 6: flame-out"),
        ("monitor", "jet 6 reported failed"),
        ("disturbance", "gust of 5 m/s"),
        ("fault", "left servo: jammed"),
    ]
    by_text = {event.text: event for event in events.list_events(run)}
    assert (by_text["jet 6: flame-out"].time_s, by_text["jet 6: flame-out"].end_s) == (1.0, 2.0)
    assert (by_text["gust of 5 m/s"].time_s, by_text["gust of 5 m/s"].end_s) == (2.5, 3.0)
    assert by_text["left servo: jammed"].end_s is None
    given_up = run.log["health_6"] < 1.0
    assert by_text["jet 6 reported failed"].time_s == pytest.approx(STEP * np.flatnonzero(given_up)[0])


def test_the_log_alone_tells_of_faults(run: Run) -> None:
    """A flight that was killed has not written down the faults that came by command."""
    assert [(each.time_s, each.end_s, each.text) for each in events.find_faults(run.log, STEP)] == [
        (1.0, 2.0, "jet 6: a fault acts"),
        (3.0, None, "left servo: a fault acts"),
    ]


def test_spans_of_a_mask_begin_and_end_with_it() -> None:
    mask = np.array([1, 1, 0, 0, 1, 0, 1], dtype=bool)
    assert events.spans(mask, 0.5) == [(0.0, 1.0), (2.0, 2.5), (3.0, None)]
    assert events.spans(np.zeros(3, dtype=bool), 0.5) == []


def test_contacts_without_bounces() -> None:
    second = round(1.0 / STEP)
    ground = np.repeat([1.0, 0.0, 1.0, 0.0, 1.0], [second, second, 10, 10, second])
    log = MemoryLog([np.stack((ground, np.zeros_like(ground)))], ("on_ground", "hull_contact"))
    found = [(each.time_s, each.text) for each in events.find_contacts(log, STEP)]
    assert found == [(1.0, "leaves the ground"), (pytest.approx(2.08), "touches the ground")]


def test_phases_by_what_carries_the_vehicle_and_by_modes() -> None:
    second = round(1.0 / STEP)
    ground = np.repeat([1.0, 0.0, 1.0], [second, 3 * second, second])
    lift = np.repeat([0.0, 0.2, 0.6, 0.4, 0.6, 0.0], [2 * second, second, second // 2, 10, second // 2 - 10, second])
    table = np.stack((ground, np.zeros_like(ground), 5.0 * 9.80665 * lift, np.full_like(ground, 5.0)))
    log = MemoryLog([table], ("on_ground", "hull_contact", "wing_lift_N", "mass_kg"))
    found = events.find_phases(log, STEP)
    carried = ["on the ground", "on its jets", "transition", "on the wing", "on the ground"]
    assert [phase.name for phase in found] == carried
    assert [phase.start_s for phase in found] == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0])  # a gap of 40 ms is none
    assert [phase.end_s for phase in found] == pytest.approx([1.0, 2.0, 3.0, 4.0, 5.0])
    plain = MemoryLog([table[:2]], ("on_ground", "hull_contact"))
    assert [phase.name for phase in events.find_phases(plain, STEP)] == ["on the ground", "in the air", "on the ground"]
    states = [(0, "HOLD", False), (500, "HOLD", True), (750, "LAND", True)]
    record = [{"k": k, "kind": "state", "mode": mode, "armed": armed} for k, mode, armed in states]
    assert events.find_phases(log, STEP, record) == [(0.0, 2.0, "disarmed"), (2.0, 3.0, "HOLD"), (3.0, 5.0, "LAND")]
    assert events.find_phases(log, STEP, record[:1]) == []  # one alone is no news


def test_what_the_monitor_believes_in_words() -> None:
    health = np.array([1.0, 1.0, 0.5, 0.5, 1.0, 0.0])
    log = MemoryLog([health[None, :]], ("health_2",))
    assert [(each.time_s, each.text) for each in events.find_verdicts(log, 1.0)] == [
        (2.0, "jet 2 reported weak: 50 % of its command"),
        (4.0, "jet 2 reported healthy again"),
        (5.0, "jet 2 reported failed"),
    ]


def test_every_fault_and_disturbance_has_words() -> None:
    stated = [
        ({"kind": "flame_out", "jet": 1}, "flame-out"),
        ({"kind": "stuck_throttle", "jet": 1}, "throttle stuck"),
        ({"kind": "stuck_throttle", "jet": 1, "throttle": 0.7}, "throttle stuck at 70 %"),
        ({"kind": "thrust_loss", "jet": 1, "share": 0.5}, "50 % of the thrust lost"),
        ({"kind": "slow_spool", "jet": 1, "lag_s": 0.06}, "slower by a lag of 0.06 s"),
        ({"kind": "delay_growth", "jet": 1, "delay_s": 0.04}, "later by 0.04 s"),
        ({"kind": "servo_jam", "servo": "left", "angle_deg": 5.0}, "jammed at 5 deg"),
        ({"kind": "sensor_bias", "sensor": "barometer", "bias": [1.0]}, "biased by 1"),
        ({"kind": "sensor_dropout", "sensor": "gyro"}, "silent"),
    ]
    scenario = Scenario.load("hover").replace(
        fault=[{"start_s": 1.0, **table} for table, _ in stated],
        disturbance=[
            {"kind": "force", "start_s": 1.0, "duration_s": 1.0, "force_n": (3.0, 4.0, 0.0)},
            {"kind": "moment", "start_s": 1.0, "duration_s": 1.0, "moment_n_m": (0.0, 0.0, 2.0)},
            {"kind": "torque_command", "axis": "roll", "start_s": 1.0, "duration_s": 1.0, "amplitude": 0.1},
            {"kind": "payload", "start_s": 1.0, "mass_kg": 0.5, "offset_m": (0.0, 0.0, 0.0)},
            {"kind": "wind", "start_s": 1.0, "duration_s": 50.0, "velocity_ned_m_s": (0.0, 6.0, 8.0)},
            {"kind": "force", "start_s": 30.0, "duration_s": 1.0, "force_n": (1.0, 0.0, 0.0)},
        ],
    )
    assert {type(fault) for fault in scenario.fault} == set(get_args(Fault))
    assert [fault.describe() for fault in scenario.fault] == [text for _, text in stated]
    found = [(each.text, each.end_s) for each in events.find_disturbances(scenario, 20.0)]
    assert found == [
        ("force of 5 N", 2.0),
        ("moment of 2 N m", 2.0),
        ("step on the roll command", 2.0),
        ("load of 0.5 kg", None),
        ("wind changes by 10 m/s", None),
    ]


def test_the_strips_have_their_bands(run: Run) -> None:
    said, _ = run_data(FlightData(run.log, "one", BLUE, step_s=run.summary.step_s, events=events.list_events(run)))
    bands = {(each["t"], each["end"]) for each in said["events"] if each["banded"]}
    bands |= set(Reader(run.log, run.summary.step_s).upsets())
    assert {(start, 4.0 if end is None else end) for start, end in bands} == {(1.0, 2.0), (2.5, 3.0), (3.0, 4.0)}
    assert [each["t"] for each in said["events"] if not each["lasts"]]


def test_the_page_tells_of_them(run: Run) -> None:
    write_report(open_run(run.folder), run.folder / "again.html")
    page = (run.folder / "again.html").read_text()
    assert "What happened" in page
    for event in events.list_events(run):
        assert event.text in page
    assert "Nothing disturbed" not in page


def test_events_are_messages_in_ulog(run: Run, tmp_path: Path) -> None:
    export_log("ulog", run.folder, tmp_path / "x.ulg")
    log = ULog(str(tmp_path / "x.ulg"))
    said = [(message.timestamp, message.message) for message in log.logged_messages]
    assert (1_000_000, "jet 6: flame-out") in said
    assert (2_000_000, "over: jet 6: flame-out") in said
    assert (3_000_000, "left servo: jammed") in said
    assert [time for time, _ in said] == sorted(time for time, _ in said)
    data = log.get_dataset("hexjet_fault").data
    np.testing.assert_array_equal(data["jet[5]"], run.log["fault_jet_6"].astype(np.float32))
    np.testing.assert_array_equal(data["health[5]"], run.log["health_6"].astype(np.float32))
