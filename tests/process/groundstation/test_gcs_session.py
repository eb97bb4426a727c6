"""A session: flights on request, paced, recorded, and flown again from what was asked."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from long_cases import long_after
from patience import PATIENCE
from session_pilot import Pilot, flown

from cosim import fly
from cosim.base.errors import InputError
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.modes import LandedState, Mode, Severity
from cosim.control.autopilot.requests import Answer, Result
from cosim.flight import fly_watched
from cosim.groundstation.exchange import Exchange, Restart, Shutdown
from cosim.groundstation.read_only import ReadOnlyObserver
from cosim.groundstation.session import RecordOptions, Session, parse_place
from cosim.results.autopilot.request_log import RequestLog, read_requests
from cosim.results.log.recorder import Log
from cosim.results.run import REQUESTS, Run, open_run
from cosim.simulation.pacing import MAX_CATCH_UP_S, Pace
from cosim.spec.scenario import Scenario


class Clock:
    """Time that passes when it is told to."""

    def __init__(self) -> None:
        self.now = 100.0
        self.slept: list[float] = []

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


def paced(clock: Clock, factor: float | None, costs: list[float]) -> Pace:
    """A pace at 4 ms that has waited after steps of these durations."""
    pace = Pace(0.004, factor, clock, clock.sleep)
    for k, cost in enumerate(costs, 1):
        clock.now += cost
        pace.wait(k)
    return pace


MS = 1e-3


@pytest.mark.parametrize(
    ("factor", "costs", "slept", "ends", "report"),
    [
        (1.0, [1, 3, 0.5], [3, 1, 3.5], 12, {"steps": 3, "missed": 0, "stalls": 0}),
        (4.0, [0.5] * 8, [0.5] * 8, 8, {"missed": 0}),
        # done at 1, 9.5, 11, 15.9 ms; due at 4, 8, 12, 16, and caught up with
        (1.0, [1, 5.5, 1.5, 3.9], [3, 1, 0.1], 16, {"steps": 4, "missed": 1, "stalls": 0, "longest_delay": 1.5 * MS}),
        (1.0, [1, 3000, 1, 1], [3, 3, 3], 3012, {"missed": 1, "stalls": 1, "postponed": 2996 * MS}),
        (None, [10] * 300, [], 3000, {"missed": 0, "reached_factor": 0.4}),
    ],
    ids=["on an absolute grid", "four times real time", "late once", "no race after a long stall", "nothing waits"],
)
def test_steps_keep_pace(
    factor: float | None, costs: list[float], slept: list[float], ends: float, report: dict[str, Any]
) -> None:
    clock = Clock()
    found = paced(clock, factor, [cost * MS for cost in costs]).report
    assert found.factor == factor
    assert clock.slept == pytest.approx([each * MS for each in slept], abs=1e-12)
    assert clock.now == pytest.approx(100.0 + ends * MS, abs=1e-9)
    assert {name: getattr(found, name) for name in report} == pytest.approx(report, rel=1e-6, abs=1e-9)


def test_a_short_stall_is_caught_up_with() -> None:
    clock = Clock()
    pace = paced(clock, 1.0, [0.9 * MAX_CATCH_UP_S, *[0.001] * 40])
    assert clock.now == pytest.approx(100.0 + 41 * 0.004, abs=1e-9)
    assert pace.report.stalls == 0
    # with 3 ms gained a step; the deadlines of the steps that were not begun in time count as well
    assert pace.report.missed == pytest.approx((0.9 * MAX_CATCH_UP_S - 0.004) / 0.003, abs=1.0)


def test_a_step_keeps_time_on_a_real_clock() -> None:
    """Never early; how late a machine is, is its own affair."""
    pace = Pace(0.002, 1.0)
    begin = time.perf_counter()
    pace.start(0)
    for k in range(1, 101):
        pace.wait(k)
        assert time.perf_counter() - begin >= k * 0.002 - 1e-9


@pytest.fixture
def exchange() -> Exchange:
    return Exchange()


@pytest.fixture
def answers() -> list[Answer]:
    return []


def taken(exchange: Exchange, most: int) -> list[object]:
    return [each.request for each in exchange.take_requests(most)]


def test_senders_of_requests_take_turns(exchange: Exchange) -> None:
    for i in range(5):
        exchange.ask(rq.SetSpeed(float(i)), sender="loud")
    exchange.ask(rq.Land(), sender="quiet")
    exchange.ask(rq.Hold(), sender="third")
    assert taken(exchange, 4) == [rq.SetSpeed(0.0), rq.Land(), rq.Hold(), rq.SetSpeed(1.0)]
    assert taken(exchange, 100) == [rq.SetSpeed(2.0), rq.SetSpeed(3.0), rq.SetSpeed(4.0)]
    assert taken(exchange, 1) == []


def test_a_full_queue_answers_at_once_and_leaves_room_for_others(exchange: Exchange, answers: list[Answer]) -> None:
    for _ in range(64 + 3):
        exchange.ask(rq.Hold(), answers.append, "loud")
    exchange.ask(rq.Land(), answers.append, "quiet")
    assert [answer.result for answer in answers] == [Result.TEMPORARILY_REJECTED] * 3
    assert exchange.turned_away == 3
    assert taken(exchange, 2) == [rq.Hold(), rq.Land()]


def test_there_may_not_be_any_number_of_senders(exchange: Exchange, answers: list[Answer]) -> None:
    for i in range(320):
        exchange.ask(rq.Hold(), answers.append, str(i))
    assert (exchange.request_count, len(answers)) == (32, 9 * 32)


def test_only_the_last_of_a_stream_counts(exchange: Exchange, answers: list[Answer]) -> None:
    for i in range(1000):
        exchange.ask(rq.Sticks(i / 1000.0, 0.0, 0.0, 0.5), answers.append, "pad")
    exchange.ask(rq.Land(), sender="pad")
    exchange.ask(rq.Sticks(-1.0, 0.0, 0.0, 0.5), sender="pad")
    assert len(answers) == 999
    assert taken(exchange, 10) == [rq.Sticks(0.999, 0.0, 0.0, 0.5), rq.Land(), rq.Sticks(-1.0, 0.0, 0.0, 0.5)]


def test_a_request_whose_time_is_over_is_not_done(exchange: Exchange, answers: list[Answer]) -> None:
    now = time.monotonic()
    exchange.ask(rq.Arm(), answers.append, "slow", now - 0.001)
    exchange.ask(rq.Land(), answers.append, "slow", now + 60.0)
    assert taken(exchange, 5) == [rq.Land()]
    assert [answer.result for answer in answers] == [Result.FAILED]
    assert exchange.request_count == 0


def test_every_request_is_answered_once_whoever_asks_when() -> None:
    exchange = Exchange()
    asked, got, taken = 4000, [0] * 4, 0

    def ask(sender: int) -> None:
        def done(answer: Answer) -> None:
            with lock:
                got[sender] += 1

        for i in range(asked):
            exchange.ask(rq.SetSpeed(i / 1000.0), done, str(sender))

    lock = threading.Lock()
    threads = [threading.Thread(target=ask, args=(sender,)) for sender in range(4)]
    for thread in threads:
        thread.start()
    last = [-1.0] * 4
    while any(thread.is_alive() for thread in threads) or exchange.request_count:
        for sender, request, done, _ in exchange.take_requests(3):
            assert isinstance(request, rq.SetSpeed)
            assert request.m_s > last[int(sender)]  # in order
            last[int(sender)] = request.m_s
            taken += 1
            assert done is not None
            done(Answer(True, Result.ACCEPTED, ""))
    assert got == [asked] * 4
    assert taken + exchange.turned_away == 4 * asked


def test_messages_are_numbered_and_only_the_last_are_kept(exchange: Exchange) -> None:
    for i in range(250):
        exchange.say(Severity.INFO, str(i))
    assert [(each.number, each.text) for each in exchange.messages] == [(i + 1, str(i)) for i in range(150, 250)]


def differing(one: Log, other: Log) -> list[str]:
    assert one.columns == other.columns
    return [name for name in one.columns if not np.array_equal(one[name], other[name], equal_nan=True)]


def tour(pilot: Pilot, session: Session) -> None:
    """Something of everything that a ground station asks for."""
    pilot.ok(rq.SetParameter("SYS_FAILURE_EN", 1), rq.SetParameter("MPC_XY_VEL_MAX", 3.0))
    pilot.take_off(6.0)
    pilot.ok(rq.SetParameter("HJ_ROLL_P", 0.015), rq.Goto(4.0, -3.0, yaw=1.0))
    pilot.until(lambda s: abs(s.measured.position[0] - 4.0) < 1.0)
    for i in range(40):  # sticks arrive when they do
        pilot.exchange.ask(rq.Sticks(0.01 * i, 0.2, 0.0, 0.5), sender="pad")
        time.sleep(0.001)
    pilot.ask(rq.SetMode("POSCTL"))  # may be too late for the sticks
    pilot.ok(rq.InjectFault("thrust_loss", jets=(2,), amount=0.1, duration_s=2.0))
    pilot.ok(rq.MissionUpload((rq.MissionItem(rq.ItemKind.WAYPOINT, 2.0, 2.0, 8.0),)), rq.MissionStart())
    pilot.until(lambda s: s.status.mission_done)
    pilot.land()


@pytest.fixture(scope="module")
def toured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    """The run of the tour, and its folder."""
    folder = tmp_path_factory.mktemp("tour") / "run"
    (run,) = flown(folder, tour).runs
    return run, folder


def test_a_flight_on_request_is_recorded(toured: tuple[Run, Path]) -> None:
    """Faults that came by request are in the requests, not in the scenario."""
    run, folder = toured
    assert (run.outcome, run.reason) == ("completed", "the script is over")
    assert run.summary.metrics is not None
    assert run.summary.pacing is not None
    assert run.summary.planned_s == pytest.approx(run.summary.steps * 0.004)
    assert float(np.max(run.log["altitude_m"])) > 7.0
    stated = Scenario.load(folder / "scenario.toml")
    assert (stated.requests, stated.fault, stated.monitored, stated.steps) == (REQUESTS, [], True, run.summary.steps)


def test_every_request_is_in_the_log_with_its_step_and_sender(toured: tuple[Run, Path]) -> None:
    run, folder = toured
    entries = read_requests(folder / REQUESTS)
    kinds = [type(entry.request).__name__ for entry in entries]
    assert kinds[0] == "SetParameter"
    assert {"Arm", "Takeoff", "Goto", "Sticks", "InjectFault", "MissionUpload", "MissionStart", "Land"} <= set(kinds)
    assert {entry.sender for entry in entries} == {"test", "pad"}
    steps = [entry.step for entry in entries]
    assert steps == sorted(steps)
    assert steps[-1] < run.summary.steps
    first = json.loads((folder / REQUESTS).read_text().splitlines()[0])
    assert first.keys() >= {"step", "sender", "result", "request"}


def test_of_two_who_hold_sticks_the_first_flies_until_it_lets_go(tmp_path: Path) -> None:
    """One centred and one full: whoever came last in a step flew it."""
    records = RecordOptions(tmp_path / "run", report=False)
    session = Session(Scenario.load("hover").replace(name="gcs"), Exchange(), records=records)
    flight = session._next
    assert flight is not None
    flight.begin()
    full, centred = rq.Sticks(1.0, 1.0, 0.0, 0.5), rq.Sticks(0.0, 0.0, 0.0, 0.5)
    seconds = round(1.0 / flight.simulation.dt)
    for k in range(0, seconds, seconds // 10):
        assert flight.ask("255/190", full, k).accepted
        assert not flight.ask("254/190", centred, k).accepted
        assert flight.pilot.remote.sticks == full
    # half a second (HJ_STICK_TIME) later they are free, and then they are the other's
    free = k + seconds // 2 + 1
    asked = [("254/190", centred, free - 1), ("254/190", centred, free), ("255/190", full, free + 1)]
    assert [flight.ask(*each).accepted for each in asked] == [False, True, False]
    assert flight.pilot.remote.sticks == centred
    flight.publish(None, None)
    said = ["sticks of 254/190 not taken: 255/190 flies", "sticks of 255/190 not taken: 254/190 flies"]
    assert [message.text for message in session.exchange.messages] == said
    flight.close()
    # what was not taken is not flown again either
    senders = [entry.sender for entry in read_requests(tmp_path / "run" / REQUESTS)]
    assert senders == ["255/190"] * 10 + ["254/190"]


def test_the_run_flies_again_without_a_ground_station_bit_for_bit(toured: tuple[Run, Path], tmp_path: Path) -> None:
    run, folder = toured
    again = fly(Scenario.load(folder / "scenario.toml"), tmp_path / "again", report=False)
    assert (again.outcome, "otherwise" in again.reason) == ("completed", False)
    assert differing(again.log, run.log) == []
    assert (tmp_path / "again" / REQUESTS).read_bytes() == (folder / REQUESTS).read_bytes()
    third = fly(Scenario.load(tmp_path / "again" / "scenario.toml"), report=False)
    assert differing(third.log, run.log) == []


def test_a_replay_that_is_not_the_same_says_so(toured: tuple[Run, Path], tmp_path: Path) -> None:
    """Without the take-off, the goto is refused."""
    run, folder = toured
    for name in ("scenario.toml", REQUESTS):
        lines = (folder / name).read_text().splitlines(keepends=True)
        (tmp_path / name).write_text("".join(line for line in lines if '"Takeoff"' not in line))
    again = fly(Scenario.load(tmp_path / "scenario.toml").replace(duration_s=20.0), report=False)
    assert "answered otherwise, the first: Goto before step" in again.reason
    assert "accepted then, temporarily_rejected now" in again.reason
    assert differing(again.log, run.log) != []


def test_a_crash_ends_the_flight_and_a_restart_begins_a_new_one(tmp_path: Path) -> None:
    seen: dict[str, Any] = {}

    def script(pilot: Pilot, session: Session) -> None:
        pilot.take_off(5.0)
        seen["armed"] = pilot.ask(Restart())
        pilot.ok(rq.Kill(force=True))
        seen["over"] = pilot.until(lambda s: s.ending is not None)
        seen["refused"] = pilot.ask(rq.Arm())
        pilot.ok(Restart())
        assert pilot.until(lambda s: s.info.number == 2).ending is None
        pilot.take_off(3.0)
        pilot.land()
        pilot.ok(Shutdown())

    session = flown(tmp_path / "run", script)
    assert seen["armed"].result is Result.TEMPORARILY_REJECTED
    assert seen["over"].ending.outcome == "crashed"
    status = seen["over"].status
    assert (status.armed, status.ready, status.landed) == (False, False, LandedState.ON_GROUND)
    assert seen["refused"].result is Result.FAILED
    assert "the flight is over" in seen["refused"].text
    ends = [(run.outcome, run.folder) for run in session.runs]
    assert ends == [("crashed", tmp_path / "run"), ("completed", tmp_path / "run-2")]
    assert any(m.severity is Severity.CRITICAL and m.text.startswith("crashed: ") for m in session.exchange.messages)
    assert session.runs[1].reason == "shut down by test"
    # a flight that ended by itself flies again to the same end
    again = fly(Scenario.load(tmp_path / "run" / "scenario.toml"), report=False)
    assert again.outcome == "crashed"
    assert differing(again.log, session.runs[0].log) == []


def test_parameters_are_kept_for_the_vehicle_and_are_part_of_the_next_run(tmp_path: Path) -> None:
    kept = tmp_path / "kept.toml"

    def change(pilot: Pilot, session: Session) -> None:
        pilot.ok(rq.SetParameter("HJ_ATT_ROLL", 3.0), rq.SetParameter("MPC_XY_VEL_MAX", 2.5))
        assert not pilot.ask(rq.SetParameter("HJ_ATT_ROLL", 1e6)).accepted
        assert not pilot.ask(rq.SetParameter("NO_SUCH", 1.0)).accepted

    flown(tmp_path / "one", change, parameter_file=kept)
    assert tomllib.loads(kept.read_text())["parameters"] == {"HJ_ATT_ROLL": 3.0, "MPC_XY_VEL_MAX": 2.5}

    seen = []
    script = lambda pilot, session: seen.append(pilot.until(lambda s: s.k > 0).info.parameters["HJ_ATT_ROLL"])  # noqa: E731
    session = flown(tmp_path / "two", script, parameter_file=kept)
    assert seen == [3.0]
    entries = read_requests(tmp_path / "two" / REQUESTS)
    assert [(e.step, e.sender, e.request) for e in entries] == [
        (0, "parameters", rq.SetParameter("HJ_ATT_ROLL", 3.0)),
        (0, "parameters", rq.SetParameter("MPC_XY_VEL_MAX", 2.5)),
    ]
    again = fly(Scenario.load(tmp_path / "two" / "scenario.toml"), report=False)
    assert differing(again.log, session.runs[0].log) == []


def test_a_file_of_parameters_that_cannot_be_used_is_refused(tmp_path: Path) -> None:
    kept = tmp_path / "kept.toml"
    kept.write_text('format = 1\nvehicle = "quadrotor"\n')
    with pytest.raises(InputError, match=r"kept\.toml.*not the parameters of hexjet-edf-as-flown-smith"):
        Session(Scenario.load("hover"), Exchange(), parameter_file=kept, records=RecordOptions(tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_a_flood_of_one_leaves_the_others_served(tmp_path: Path) -> None:
    """Queues stay bounded, requests a step stay bounded, and who asks once is answered."""
    waits: list[int] = []

    def script(pilot: Pilot, session: Session) -> None:
        exchange, going = session.exchange, True

        def flood() -> None:
            chance = random.Random(1)
            while going:
                exchange.ask(rq.SetSpeed(chance.uniform(0.5, 5.0)), sender="flood")

        thread = threading.Thread(target=flood)
        thread.start()
        try:
            for _ in range(20):
                before = pilot.until(lambda s: True).k
                pilot.ok(rq.SetHome())
                waits.append(exchange.snapshot.k - before if exchange.snapshot else -1)
                assert exchange.request_count <= 64 + 1
        finally:
            going = False
            thread.join()

    session = flown(tmp_path / "run", script)
    assert session.exchange.turned_away > 0
    assert len(waits) == 20
    steps = [entry.step for entry in read_requests(tmp_path / "run" / REQUESTS)]
    assert max(steps.count(step) for step in set(steps)) <= 8


def test_a_scripted_flight_can_be_watched_but_not_changed(exchange: Exchange, answers: list[Answer]) -> None:
    for request in (rq.Land(), rq.SetParameter("HJ_ATT_ROLL", 1.0), Restart()):
        exchange.ask(request, answers.append, "test")
    scenario = Scenario.load("roll-doublet").replace(duration_s=4.0, expect=[])
    watched = fly_watched(scenario, report=False, watch=ReadOnlyObserver(exchange))
    assert differing(watched.log, fly(scenario, report=False).log) == []
    assert [answer.text for answer in answers] == ["this flight follows its script"] * 3
    last = Pilot(exchange).until(lambda s: True)
    assert (last.status.armed, last.status.mode) == (True, Mode.HOLD)
    assert last.sample is not None
    assert abs(last.sample.k - 999) < 250


def test_requests_come_back_as_they_were_but_for_a_torn_last_line(tmp_path: Path) -> None:
    log = RequestLog(tmp_path / REQUESTS)
    asked = [rq.Arm(), rq.Goto(1 / 3, -2e-17, None, 3.0), rq.Sticks(0.1, -1.0, 0.0, 0.7)]
    for k, request in enumerate(asked):
        log.write(k, "udp 1", request, Answer(True, Result.ACCEPTED, "fine"))
    log.close()
    with open(tmp_path / REQUESTS, "a") as file:
        file.write('{"step": 4, "request": "La')
    found = read_requests(tmp_path / REQUESTS)
    assert [(entry.step, entry.request) for entry in found] == list(enumerate(asked))
    assert (found[0].sender, found[0].result) == ("udp 1", "accepted")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", "line 2: not JSON"),
        ("[]", "line 2: must be a JSON object"),
        ('{"step": -1, "request": "Hold"}', "step = -1"),
        ('{"step": 1.5, "request": "Hold"}', "step = 1.5"),
        ('{"step": 1, "request": "Dance"}', "request = 'Dance'"),
        ('{"step": 9, "request": "Hold", "why": 1}', "unknown key 'why'"),
        ('{"step": 2, "request": "Hold"}', "step 2 comes after step 5"),
    ],
)
def test_a_wrong_file_of_requests_is_refused(tmp_path: Path, line: str, message: str) -> None:
    (tmp_path / REQUESTS).write_text('{"step": 5, "request": "Hold"}\n' + line + "\n")
    with pytest.raises(InputError, match=REQUESTS) as caught:
        read_requests(tmp_path / REQUESTS)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_requests_and_commands_exclude_each_other() -> None:
    with pytest.raises(InputError, match="the autopilot flies then"):
        Scenario.load("roll-doublet").replace(requests="some.jsonl")


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "a,b"])
def test_a_place_is_two_numbers(text: str) -> None:
    with pytest.raises(InputError, match="must be LAT,LON"):
        parse_place(text)


HEXJET = [sys.executable, "-c", "from cosim.cli.main import main; main()"]
LINK = ("--mavlink", "udpin:127.0.0.1:0", "--params", "none")


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts ``hexjet gcs`` in a folder of its own, and ends what the test has left."""
    processes: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [*HEXJET, "gcs", *LINK, "--out", str(tmp_path / "run"), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
        )
        processes.append(process)
        end = time.monotonic() + PATIENCE
        stream = tmp_path / "run" / "flight.arrows"
        while not (stream.exists() and stream.stat().st_size > 300_000):  # a second of flight and more
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < end
            time.sleep(0.05)
        return process

    yield start
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.mark.parametrize("number", long_after(1, [signal.SIGTERM, signal.SIGINT]))
def test_a_signal_finishes_the_run(started: Any, tmp_path: Path, number: signal.Signals) -> None:
    process = started("--json")
    process.send_signal(number)
    out, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    (summary,) = json.loads(out)["runs"]
    assert (summary["outcome"], summary["reason"]) == ("completed", f"stopped by {number.name}")
    assert summary["pacing"]["factor"] == 1.0
    assert not (tmp_path / "run" / "flight.arrows").exists()
    assert open_run(tmp_path / "run").outcome == "completed"


def test_a_killed_run_flies_again_as_far_as_it_was_recorded(started: Any, tmp_path: Path) -> None:
    process = started("--rtf", "0")
    again = [*HEXJET, "fly", str(tmp_path / "run" / "scenario.toml"), "--out", str(tmp_path / "again")]
    done = subprocess.run(again, capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "still being recorded" in done.stderr
    os.kill(process.pid, signal.SIGKILL)
    process.wait(PATIENCE)
    done = subprocess.run(again, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    killed, flown_again = open_run(tmp_path / "run"), open_run(tmp_path / "again")
    assert (killed.outcome, killed.reason) == ("failed", "interrupted")
    assert len(killed.log) >= 250
    assert differing(flown_again.log, killed.log) == []
