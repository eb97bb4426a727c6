"""Parameters that lose the vehicle: told, refused in the air, taken where forced, and told again after a reboot."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from patience import PATIENCE
from session_pilot import Pilot, flown

from cosim import fly
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.modes import Mode
from cosim.control.autopilot.parameters import Caution
from cosim.control.autopilot.requests import Answer, Result
from cosim.groundstation.exchange import Exchange, Restart
from cosim.groundstation.session import RecordOptions, Session
from cosim.results.autopilot.request_log import read_requests
from cosim.results.run import REQUESTS
from cosim.spec.scenario import Scenario
from hexjet_design.measured.judge import LoopJudge

SCENARIO = Scenario.load("hover").replace(name="gcs")


@pytest.fixture(scope="module")
def judge() -> LoopJudge:
    return LoopJudge(SCENARIO)


def texts(session: Session) -> list[str]:
    return [message.text for message in session.exchange.messages]


def test_a_lost_loop_is_refused_in_the_air_and_taken_where_forced(tmp_path: Path, judge: LoopJudge) -> None:
    said: list[str] = []

    def script(pilot: Pilot, session: Session) -> None:
        def value(name: str) -> float:
            return session.info.parameters[name] if session._next else pilot.until(lambda s: True).info.parameters[name]

        pilot.ok(rq.SetParameter("HJ_PITCH_P", 0.0))  # on the ground: taken, and told
        assert "HJ_PITCH_P 0: pitch: the loop is unstable" in texts(session)
        pilot.ok(rq.SetParameter("HJ_PITCH_P", 0.15))
        pilot.take_off(4.0)
        pilot.ok(rq.SetParameter("HJ_ROLL_P", 0.019))
        said.extend(texts(session))
        assert not any("HJ_ROLL_P" in text for text in said)
        answer = pilot.ask(rq.SetParameter("HJ_ROLL_P", 0.0))
        assert (answer.accepted, answer.result) == (False, Result.TEMPORARILY_REJECTED)
        assert answer.text == (
            "HJ_ROLL_P 0 refused in the air: roll: the loop is unstable; HJ_FORCE 1 takes it all the same"
        )
        assert answer.text in texts(session)
        assert value("HJ_ROLL_P") == 0.019
        pilot.ok(rq.SetParameter("HJ_PITCH_P", 1.5))
        assert "HJ_PITCH_P 1.5: pitch: phase margin 8.0 deg" in texts(session)
        pilot.ok(rq.SetParameter("HJ_PITCH_P", 0.15), rq.SetParameter("HJ_FORCE", 1.0))
        pilot.ok(rq.SetParameter("HJ_ROLL_P", 0.0))
        assert value("HJ_ROLL_P") == 0.0
        assert "HJ_ROLL_P 0: roll: the loop is unstable" in texts(session)
        pilot.ok(rq.SetParameter("HJ_ROLL_P", 0.02))
        pilot.land()

    session = flown(tmp_path / "run", script, judge=judge)
    (run,) = session.runs
    entries = read_requests(tmp_path / "run" / REQUESTS)
    refused = [entry for entry in entries if not entry.asked]
    assert [entry.request for entry in refused] == [rq.SetParameter("HJ_ROLL_P", 0.0)]
    line = next(line for line in (tmp_path / "run" / REQUESTS).read_text().splitlines() if '"asked"' in line)
    assert json.loads(line)["text"].startswith("HJ_ROLL_P 0 refused in the air")
    # nobody judges it then, and it is the same flight
    again = fly(tmp_path / "run" / "scenario.toml", report=False)
    assert "answered otherwise" not in again.reason
    assert all(np.array_equal(run.log[name], again.log[name], equal_nan=True) for name in run.log.columns)


def test_after_a_crash_a_parameter_is_set_and_a_reboot_tells_what_is_kept(tmp_path: Path, judge: LoopJudge) -> None:
    kept = tmp_path / "kept.toml"

    def script(pilot: Pilot, session: Session) -> None:
        pilot.ok(rq.SetParameter("HJ_FORCE", 1.0))
        pilot.take_off(4.0)
        pilot.ok(rq.SetParameter("HJ_ROLL_P", 0.0), rq.Goto(8.0, 8.0))
        pilot.until(lambda s: s.ending is not None)
        count = len(texts(session))
        pilot.ok(Restart())
        pilot.until(lambda s: s.info.number == 2 and s.k > 0)
        new = texts(session)[count:]
        assert "not the default: HJ_ROLL_P 0 (default 0.02)" in new
        assert "parameters: roll: the loop is unstable" in new
        pilot.take_off(2.0)  # straight up, and then it is lost again
        pilot.ok(rq.Goto(8.0, 8.0))
        pilot.until(lambda s: s.ending is not None)
        count = len(texts(session))
        pilot.ok(rq.SetParameter("HJ_ROLL_P", 0.02), rq.SetParameter("HJ_FORCE", 0.0))
        assert pilot.until(lambda s: True).info.parameters["HJ_ROLL_P"] == 0.02
        assert "HJ_ROLL_P 0.02 from the next flight on" in texts(session)[count:]
        pilot.ok(rq.SetParameter("HJ_PITCH_P", 0.0))
        assert "HJ_PITCH_P 0: pitch: the loop is unstable" in texts(session)[count:]
        pilot.ok(rq.SetParameter("HJ_PITCH_P", 0.15))
        assert not pilot.ask(rq.SetParameter("HJ_ROLL_P", 1e6)).accepted
        assert pilot.ask(rq.Arm()).result is Result.FAILED
        pilot.ok(Restart())
        count = len(texts(session))
        pilot.until(lambda s: s.info.number == 3 and s.k > 0)
        assert not any(text.startswith(("not the default", "parameters:")) for text in texts(session)[count:])
        pilot.take_off(3.0)
        pilot.ok(rq.Goto(4.0, 4.0))
        pilot.until(lambda s: s.status.mode is Mode.HOLD and s.measured.position[0] > 3.0)
        pilot.land()

    session = flown(tmp_path / "run", script, judge=judge, parameter_file=kept)
    assert [run.outcome == "completed" for run in session.runs] == [False, False, True]
    assert not tomllib.loads(kept.read_text()).get("parameters")


def test_parameters_of_a_file_that_lose_the_vehicle_are_told_before_anybody_connects(
    tmp_path: Path, judge: LoopJudge
) -> None:
    kept = tmp_path / "kept.toml"
    head = 'format = 1\nvehicle = "hexjet-edf-as-flown-smith"\n[parameters]\n'
    kept.write_text(f"{head}HJ_PRED_DELAY = 100.0\nMPC_XY_VEL_MAX = 3.0\nHJ_PITCH_P = 99999.0\nHJ_FORCE = 1.0\n")
    session = Session(SCENARIO, Exchange(), parameter_file=kept, records=RecordOptions(tmp_path / "run", report=False))
    session.set_stability_checker(judge)
    assert session.describe_saved() == [
        "HJ_PRED_DELAY 100 (default 25)",
        "MPC_XY_VEL_MAX 3 (default 4)",
        "refused: HJ_PITCH_P = 99999: must be from 0 to 1.5 s",
        "roll: the loop is unstable",
    ]
    assert session._next is not None
    session._next.close()


class SlowJudge:
    """Has nothing to say, and says so when it is let go."""

    def __init__(self) -> None:
        self.go = Event()

    def prepare(self) -> None:
        """Nothing to compute."""

    def tunes_loop(self, name: str) -> bool:
        return name == "HJ_ROLL_P"

    def find_cautions(self, before: Mapping[str, float], after: Mapping[str, float]) -> list[Caution]:
        assert self.go.wait(PATIENCE)
        return []


def test_a_change_that_was_refused_for_want_of_a_verdict_is_not_taken_later(tmp_path: Path) -> None:
    slow = SlowJudge()

    def script(pilot: Pilot, session: Session) -> None:
        pilot.until(lambda s: s.k > 0)
        answers: list[Answer] = []
        here = Event()
        exchange, change = pilot.exchange, rq.SetParameter("HJ_ROLL_P", 0.019)
        exchange.ask(change, lambda a: (answers.append(a), here.set())[0], "test", exchange.clock() + 0.5)
        try:
            assert here.wait(PATIENCE)
        finally:
            slow.go.set()
        assert [answer.accepted for answer in answers] == [False]
        k = pilot.until(lambda s: True).k
        assert pilot.until(lambda s: s.k > k + 250).info.parameters["HJ_ROLL_P"] == 0.02
        pilot.ok(change)  # asked again
        assert pilot.until(lambda s: True).info.parameters["HJ_ROLL_P"] == 0.019

    flown(tmp_path / "run", script, judge=slow)


def test_what_is_forced_is_not_kept(tmp_path: Path, judge: LoopJudge) -> None:
    kept = tmp_path / "kept.toml"
    kept.write_text('format = 1\nvehicle = "hexjet-edf-as-flown-smith"\n[parameters]\nHJ_FORCE = 1\n')

    def script(pilot: Pilot, session: Session) -> None:
        first = pilot.until(lambda s: s.k > 0)
        assert first.info.parameters["HJ_FORCE"] == 0.0
        assert any("HJ_FORCE is not taken from a file" in text for text in texts(session))
        pilot.ok(rq.SetParameter("HJ_FORCE", 1.0), rq.SetParameter("MPC_XY_VEL_MAX", 3.0), Restart())
        second = pilot.until(lambda s: s.info.number == 2 and s.k > 0)
        assert second.info.parameters["HJ_FORCE"] == 0.0
        assert second.info.parameters["MPC_XY_VEL_MAX"] == 3.0

    flown(tmp_path / "run", script, judge=judge, parameter_file=kept)
    assert tomllib.loads(kept.read_text())["parameters"] == {"MPC_XY_VEL_MAX": 3.0}
