"""What an engine's uncertainty comes to in a loop, against closed forms, and in designs and margins without a number typed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_tools import Hexjet
from uncertain_engines import CORRELATION, NOMINAL, fan

from cosim.base.storage.toml import read_toml
from cosim.design.design import Design, design
from cosim.design.loop.engine_uncertainty import (
    EngineSensitivity,
    LoopUncertainty,
    delay_deviations,
    engine_tolerances,
    gain_deviations,
)
from cosim.design.result import summary_lines, to_dict, write
from cosim.engine import load_engine
from cosim.simulation.controllers.controller_file import Requirements
from cosim.spec.scenario import Scenario

STEP = 0.004
DEVIATION, SPREAD = [1.0, 0.006, 0.02], [1.0, 0.002, 0.01]


def sensitivity(folder: Path, deviation: list[float], spread: list[float] | None) -> EngineSensitivity:
    file = fan(folder, deviation, spread)
    scenario = Scenario.load("hover", [f"engine={file}"])
    spec = load_engine(str(file), {}, STEP, unchecked=True)
    return EngineSensitivity(scenario, scenario.resolved_vehicle()[0], spec)


@pytest.mark.parametrize("hertz", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("spread", [None, SPREAD])
def test_gain_and_delay_deviate_as_the_closed_form_does(
    tmp_path: Path, hertz: float, spread: list[float] | None
) -> None:
    """``G = g / (z - p) z^-n``: d ln G is -j w T of n, 1 / (z - p) of p, 1 / g of g."""
    w = 2.0 * np.pi * hertz
    z = np.exp(1j * w * STEP)
    of_ln = np.array([-1j * w * STEP, 1.0 / (z - NOMINAL["pole"]), 1.0 / NOMINAL["gain"]])
    jacobian = np.array([of_ln.real, -of_ln.imag / w])
    covariance = np.diag(DEVIATION) @ np.array(CORRELATION) @ np.diag(DEVIATION) + np.diag(spread or np.zeros(3)) ** 2
    exact = np.sqrt(np.diag(jacobian @ covariance @ jacobian.T))
    # half a per cent: the pole is moved by 5 % of what is left to 1
    assert sensitivity(tmp_path, DEVIATION, spread).at(hertz) == pytest.approx(tuple(exact), rel=5e-3)


def test_an_engine_of_the_library_has_its_own_uncertainty() -> None:
    """It has no mapping file: its name loads it again, and the delay alone makes a deviation of its own 12 steps."""
    scenario = Scenario.load("full-scale-hover", ["engine=jetcat-p300"])
    spec = load_engine("jetcat-p300", {}, STEP)
    assert spec.uncertainty is not None
    assert spec.mapping is None
    found = EngineSensitivity(scenario, scenario.resolved_vehicle()[0], spec).at(0.25)
    late = spec.uncertainty.deviation[spec.uncertainty.parameters.index("delay_samples")] * STEP
    assert late <= found.delay_s < 4.0 * late
    assert 0.0 < found.gain < 1.0


def test_margins_in_deviations() -> None:
    known = LoopUncertainty(0.1, 0.004)
    assert gain_deviations(known, 6.0206) == pytest.approx(np.log(2.0) / 0.1, rel=1e-5)
    assert gain_deviations(known, -6.0206) == pytest.approx(np.log(2.0) / 0.1, rel=1e-5)
    assert delay_deviations(known, 0.03) == pytest.approx(7.5)
    assert gain_deviations(known, None) is None
    assert delay_deviations(LoopUncertainty(0.1, 0.0), 0.03) is None


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Design]:
    """Two mapping files that differ in their deviations alone."""
    made = {}
    for name, deviation in (("sure", [0.5, 0.001, 0.002]), ("unsure", [6.2, 0.001, 0.07])):
        file = fan(tmp_path_factory.mktemp(name), deviation)
        made[name] = design(str(file), controller="baseline", lead=False, settings=["engine_unchecked=true"])
    return made


def test_another_table_is_another_design(designed: dict[str, Design], tmp_path: Path) -> None:
    sure, unsure = designed["sure"].need, designed["unsure"].need
    assert unsure.gain_tolerance == pytest.approx(3.0 * np.hypot(0.07 / 0.2554, 0.001 / 0.1252), rel=0.02)
    assert sure.gain_tolerance < 0.25 * unsure.gain_tolerance
    assert sure.delay_tolerance < 0.25 * unsure.delay_tolerance
    after = {name: made.axes["roll"].after for name, made in designed.items()}
    assert after["sure"] is not None
    assert after["unsure"] is not None
    assert after["sure"].bandwidth_hz > 1.02 * after["unsure"].bandwidth_hz  # type: ignore[operator]
    made = designed["unsure"]
    (line,) = [line for line in summary_lines(made) if line.startswith("tolerances from the engine's uncertainty")]
    assert "source: bench.csv: 6 steps, 2 holds; --gain-tolerance and --delay-tolerance would state others" in line
    paths = write(made, tmp_path / "made.toml")
    filed = read_toml(paths["controller"])["design"]
    assert (filed["tolerances"], filed["requirements"]["gain_tolerance"]) == (line, unsure.gain_tolerance)
    assert "bench.csv: 6 steps, 2 holds" in paths["report"].read_text(encoding="utf-8")
    assert to_dict(made)["tolerances"] == line
    assert "the box around their ellipsoid of correlation -0." in line or "of correlation 0." in line
    assert "it states no spread between engines, so one is off by 30 % of gain and lag in the proof" in line
    assert filed["requirements"]["engine_spread"] == 0.3


def test_what_is_stated_is_not_taken_from_the_engine(designed: dict[str, Design]) -> None:
    made = designed["unsure"]
    plants = [axis.channel for axis in made.axes.values()]

    def asked(need: Requirements) -> tuple[float, float, str]:
        found = engine_tolerances(need, made.scenario, made.vehicle, made.engine, plants)
        return found.need.delay_tolerance, found.need.gain_tolerance, found.words

    assert asked(Requirements(delay_tolerance=0.2, gain_tolerance=0.1)) == (0.2, 0.1, "")
    assert "engine_spread" not in Requirements().model_dump()
    delay, gain, words = asked(Requirements(delay_tolerance=0.2))
    assert (delay, gain) == (0.2, made.need.gain_tolerance)
    assert "--gain-tolerance would state others" in words
    assert "delay" not in words.partition("source")[0]
    plain = load_engine("edf", {}, STEP)
    found = engine_tolerances(Requirements(), made.scenario, made.vehicle, plain, plants)
    assert (found.need, found.words) == (Requirements(), "")


def test_the_spread_of_the_table_is_that_of_one_engine_in_the_proof(
    designed: dict[str, Design], tmp_path: Path
) -> None:
    """A gain that is 2 % of 0.2554 apart between engines: three deviations are 6 %, whatever all have in common."""
    made = designed["unsure"]
    roll = [made.axes["roll"].channel]
    for deviation in ([1.0, 0.001, 0.002], [6.2, 0.001, 0.07]):
        spec = load_engine(str(fan(tmp_path, deviation, [0.0, 0.0, 0.02 * 0.2554])), {}, STEP, unchecked=True)
        found = engine_tolerances(Requirements(), made.scenario, made.vehicle, spec, roll)
        assert found.need.engine_spread == pytest.approx(0.06, abs=2e-4)
        assert "; by its spread one engine is off by 6" in found.words
    stated = engine_tolerances(Requirements(engine_spread=0.1), made.scenario, made.vehicle, spec, roll)
    assert stated.need.engine_spread == 0.1
    assert "one engine is off" not in stated.words


def test_more_than_a_design_takes_is_said(designed: dict[str, Design], tmp_path: Path) -> None:
    made = designed["unsure"]
    spec = load_engine(str(fan(tmp_path, [6.2, 0.001, 0.1])), {}, STEP, unchecked=True)
    roll = [made.axes["roll"].channel]
    found = engine_tolerances(Requirements(), made.scenario, made.vehicle, spec, roll)
    assert found.need.gain_tolerance == 0.95
    assert "%, of which 95 % are taken" in found.words


def test_margins_are_counted_in_deviations_of_the_engine(hexjet: Hexjet, tmp_path: Path) -> None:
    file = fan(tmp_path, DEVIATION)
    quiet = ["--set", "sensor_noise=false", "--set", "engine_unchecked=true", "--period", "5", "--periods", "3"]
    flown = ["--engine", str(file), "--controller", "baseline", "--axis", "roll", "--out", str(tmp_path / "m")]
    done = hexjet("margins", *flown, *quiet)
    assert done.status == 0, done.err
    out = " ".join(done.out.split())
    assert "uncertainty of the engine: bench.csv: 6 steps, 2 holds" in out
    data = json.loads((tmp_path / "m" / "margins.json").read_text())["axes"]["roll"]
    known, found = data["engine_uncertainty"], data["measured"]
    assert known["delay_margin_deviations"] == pytest.approx(found["delay_s"]["value"] / known["delay_s"])
    assert f"the margin is {known['delay_margin_deviations']:.3g} times that" in out
    nearer = min(abs(found[name]["value"]) for name in ("gain_db", "gain_down_db") if found[name])
    assert known["gain_margin_deviations"] == pytest.approx(nearer * np.log(10.0) / 20.0 / known["gain"])
