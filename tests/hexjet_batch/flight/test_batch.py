"""A batch flies what JSBSim flies: sample by sample, with the same noise, or says what it does not fly."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import ROOT

from cosim import InputError, Scenario
from hexjet_batch import REFUSED, fly_batch, start
from hexjet_batch.check import check
from hexjet_batch.fly import prepare

TURBINE = {"aircraft": "hexjet-100", "engine": "turbine-100", "controller": "baseline"}
PAYLOAD = {"kind": "payload", "start_s": 0.0, "duration_s": 2.0, "mass_kg": 0.5, "offset_m": [0.05, 0.02, 0.1]}
GUST = {"kind": "gust", "start_s": 1.0, "rise_s": 1.0, "hold_s": 0.5, "fall_s": 0.5,
        "velocity_ned_m_s": [4.0, 2.0, 1.0]}  # fmt: skip
MISMATCH = {"mass_factor": 1.1, "centre_m": [0.004, 0.002, 0.0], "delay_samples": 1, "thrust_factor_2": 0.95}


@pytest.mark.parametrize(
    "changes",
    [
        {"sensor_noise": False},
        {"controller": "state-disturbance", "sensors": "measured"},
        {"controller": "state-model", "mismatch": MISMATCH},
        {"disturbance": [PAYLOAD], "controller": "filtered-smith", "sensor_noise": False},
        {"disturbance": [GUST], "environment": {"wind_ned_m_s": [3.0, 0.0, 0.0]}, "sensor_noise": False},
        TURBINE,
        {"aircraft": "quadrotor", "engine": "motor", "step_s": 0.0025},
    ],
)
def test_a_batch_flies_what_jsbsim_flies(changes: dict[str, Any]) -> None:
    """Attitude within 0.002 deg, rates within 0.01 deg/s, the place within 5 cm or 0.5 % of the way."""
    result = check(Scenario.load("roll-doublet").replace(duration_s=5.0, **changes))
    assert result.endings == ("completed", "completed")
    assert [one for one in result.samples if not one.is_within] == []


def test_flights_are_the_same_alone_and_together() -> None:
    base = Scenario.load("roll-doublet").replace(duration_s=1.0, expect=[])
    names = ("state", "smith", "state-model", "baseline", "smith")
    scenarios = [base.replace(seed=n, added_delay_samples=n % 3, controller=name) for n, name in enumerate(names)]
    alone = {flight.number: flight.log["roll_rad"].copy() for flight in fly_batch(scenarios, together=1)}
    for flight in fly_batch(scenarios):
        np.testing.assert_array_equal(flight.log["roll_rad"], alone[flight.number])


@pytest.mark.parametrize(
    ("name", "settings", "said"),
    [("waypoints", [], "waypoints"), ("fault-flame-out", [], "faults"), ("gust", [], "turbulence"),
     ("full-scale-hover", ["engine_parameters.command_rate=1"], "p220.*: command_rate")],
)  # fmt: skip
def test_what_is_not_covered_is_refused_by_name(name: str, settings: list[str], said: str) -> None:
    with pytest.raises(InputError, match=f"{said}.*; fly it without batch"):
        list(fly_batch([Scenario.load(name, settings)]))


def test_a_batch_of_nothing_and_arrays_of_two_lengths_are_one_line() -> None:
    scenario = Scenario.load("hover").replace(duration_s=0.1)
    with pytest.raises(InputError, match="together = 0: a batch has at least 1 flight"):
        list(fly_batch([scenario], together=0))
    numbers, script, _, heights, _, _, motion = prepare([scenario, scenario])
    with pytest.raises(InputError, match="arrays of 2, 3 flights: those of a batch have one length"):
        start(numbers.replace(added_delay=np.zeros(3)), motion, heights, script.at(0)[1])


def test_the_page_lists_what_is_refused() -> None:
    page = (ROOT / "docs" / "campaigns.md").read_text(encoding="utf-8")
    assert page.partition("<!-- refused -->\n")[2].partition("<!-- /refused -->")[0].splitlines() == [
        f"- {what}" for what in REFUSED
    ]


def test_a_check_says_what_is_within_and_what_is_not(tmp_path: Path) -> None:
    short = Scenario.load("full-scale-hover").replace(duration_s=0.4)
    result = check(short, tmp_path)
    assert result.lines() == ["the same flight as by JSBSim at 16 runs a step, completed"]
    assert '"same": true' in (tmp_path / "check.json").read_text()
    assert "the same flight as by JSBSim" in (tmp_path / "report.html").read_text()
    result.samples[0] = result.samples[0]._replace(apart=0.1)
    assert result.lines() == ["not as JSBSim at 16 runs a step: roll by 0.1 deg"]


def test_jax_flies_the_same_and_is_differentiated() -> None:
    pytest.importorskip("jax", reason="the extra jax is not installed")
    from hexjet_batch.with_jax import jax, make_flight

    scenario = Scenario.load("roll-doublet").replace(duration_s=1.6, controller="state-disturbance")
    with pytest.raises(InputError, match="a batch has at least 1 flight"):
        make_flight([])
    numbers, fly_with_jax = make_flight([scenario])
    (flight,) = fly_batch([scenario])

    def rates(factor: Any) -> Any:
        roll = numbers.rate[0].replace(p=factor * numbers.rate[0].p)
        return fly_with_jax(numbers.replace(rate=(roll, *numbers.rate[1:]))).motion.rate[0][:, 0]

    own, slope = jax.jit(lambda factor: jax.jvp(rates, (factor,), (1.0,)))(1.0)
    assert np.abs(np.asarray(own) - flight.log["rate_p_rad_s"]).max() < 1e-12
    apart = (rates(1.0 + 1e-6) - rates(1.0 - 1e-6)) / 2e-6
    assert np.abs(np.asarray(slope - apart)).max() < 1e-5 * np.abs(np.asarray(slope)).max()
    page = (ROOT / "docs" / "campaigns.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n([^`]*with_jax[^`]*)```", page)
    exec(code.replace('load("roll-doublet")', 'load("roll-doublet").replace(duration_s=0.1)'), {})
