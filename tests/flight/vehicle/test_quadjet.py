"""aircraft/quadjet: the loss of an engine, which it survives from high enough."""

from __future__ import annotations

from math import degrees

import numpy as np
import pytest

from cosim import fly
from cosim.results.log.digest import log_digest
from cosim.spec.scenario import Scenario


def test_without_an_engine_it_is_caught_by_its_nozzles() -> None:
    """It was lost within two seconds: late engines that were asked for attitude pumped the swing."""
    fault = [{"kind": "flame_out", "start_s": 1.0, "jet": 1}]
    high = {"altitude_m": 30.0}
    hover = Scenario.load("quadjet-hover").replace(fault=fault, expect=[], duration_s=5.0, initial=high)
    run = fly(hover)
    assert run.outcome == "completed"
    log = run.log
    fallen = 30.0 - float(log["altitude_m"].min())
    lean = degrees(max(float(np.abs(log[f"{axis}_rad"]).max()) for axis in ("roll", "pitch")))
    assert (fallen, lean) == (pytest.approx(6.3, abs=0.1), pytest.approx(18.0, abs=1.0))
    # by the nozzles and not by luck
    off = {"control": {"monitor": {"catch": False}}}
    assert fly(hover.replace(vehicle=off)).outcome == "diverged"


def test_engines_answer_as_before_until_one_is_lost() -> None:
    """The catch is of the loss alone: with all engines the flight is the same to the last bit."""
    hover = Scenario.load("quadjet-hover").replace(expect=[], duration_s=1.0)
    off = hover.replace(vehicle={"control": {"monitor": {"catch": False}}})
    assert log_digest(fly(hover).log) == log_digest(fly(off).log)
