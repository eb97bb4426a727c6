"""A flight's log ends at its size, and the flight goes on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cosim import fly
from cosim.groundstation.exchange import Exchange
from cosim.groundstation.session import RecordOptions, Session
from cosim.groundstation.session_flight import estimate_hourly_mb
from cosim.results.run import open_run
from cosim.spec.scenario import Scenario


def test_the_run_is_what_was_recorded_and_flies_again_as_that(tmp_path: Path) -> None:
    exchange = Exchange()
    records = RecordOptions(tmp_path / "run", report=False, log_mb=1.0)
    session = Session(Scenario.load("hover"), exchange, factor=None, duration=6.0, records=records)
    row = estimate_hourly_mb(session.info) * 1e6 / 3600.0 * 0.004
    (run,) = session.run()
    rows = int(1e6 / row)
    assert len(run.log) == rows
    assert rows < 1500
    assert run.summary.outcome == "completed"
    assert run.summary.reason == f"flew 1500 steps; the log ends at {rows * 0.004:g} s, where it had its size"
    said = [message.text for message in exchange.messages]
    assert "the log has 0.8 MB, and ends at 1 MB" in said
    assert "the log has 1 MB and ends here, the flight goes on" in said
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["planned_s"] == pytest.approx(rows * 0.004)
    again = fly(Scenario.load(str(tmp_path / "run" / "scenario.toml")))
    stored = open_run(tmp_path / "run").log
    assert all(np.array_equal(again.log[name], stored[name], equal_nan=True) for name in stored.columns)


def test_without_a_limit_everything_is_recorded(tmp_path: Path) -> None:
    records = RecordOptions(tmp_path / "run", report=False, log_mb=None)
    session = Session(Scenario.load("hover"), Exchange(), factor=None, duration=2.0, records=records)
    (run,) = session.run()
    assert len(run.log) == 500
