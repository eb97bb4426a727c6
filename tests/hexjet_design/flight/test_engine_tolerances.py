"""What an engine's uncertainty comes to in a loop, against closed forms, and in designs and margins without a number typed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_tools import Hexjet
from uncertain_engines import CORRELATION, NOMINAL, fan

from cosim.base.arrays import Complex
from cosim.base.storage.toml import read_toml
from cosim.engine import load_engine
from cosim.loops import loop_margins
from cosim.simulation.controllers.controller_file import Requirements
from cosim.spec.scenario import Scenario
from hexjet_design.design import Design, design
from hexjet_design.loop.engine_uncertainty import (
    EngineSensitivity,
    LoopUncertainty,
    delay_deviations,
    engine_tolerances,
    gain_deviations,
)
from hexjet_design.measured.engine_range import EngineRange, range_over_engines
from hexjet_design.measured.estimate import Bounded, Response
from hexjet_design.result import summary_lines, to_dict, write

STEP = 0.004
FORETOLD = 0.02  # of a margin of another engine, what the page claims
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
    """It has no mapping file: its name loads it again; a later one of it answers more at once, which takes some of that back."""
    scenario = Scenario.load("full-scale-hover", ["engine=jetcat-p300"])
    spec = load_engine("jetcat-p300", {}, STEP)
    assert spec.uncertainty is not None
    assert spec.mapping is None
    found = EngineSensitivity(scenario, scenario.resolved_vehicle()[0], spec).at(0.25)
    late = spec.uncertainty.deviation[spec.uncertainty.parameters.index("delay_samples")] * STEP
    assert 0.5 * late < found.delay_s < late
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
    assert sure.gain_tolerance == 0.15  # of the inertia
    kept = "; 15 % of gain are kept for the inertia, which no log of an engine tells"
    assert [kept in designed[name].tolerances for name in ("sure", "unsure")] == [True, False]
    assert sure.delay_tolerance < 0.25 * unsure.delay_tolerance
    after = {name: made.axes["roll"].after for name, made in designed.items()}
    assert after["sure"] is not None
    assert after["unsure"] is not None
    assert after["sure"].bandwidth_hz > 1.02 * after["unsure"].bandwidth_hz  # type: ignore[operator]
    made = designed["unsure"]
    (line,) = [line for line in summary_lines(made) if line.startswith("tolerances from the engine's uncertainty")]
    assert "source: bench.csv: 6 steps, 2 holds; gain_tolerance and delay_tolerance would state others" in line
    paths = write(made, tmp_path / "made.toml")
    filed = read_toml(paths["controller"])["design"]
    assert (filed["tolerances"], filed["requirements"]["gain_tolerance"]) == (line, unsure.gain_tolerance)
    assert "bench.csv: 6 steps, 2 holds" in paths["report"].read_text(encoding="utf-8")
    assert to_dict(made)["tolerances"] == line
    assert "the box around their ellipsoid of correlation -0." in line or "of correlation 0." in line
    assert "it gives no engine-to-engine spread, so the proof assumes 30 % of gain and lag" in line
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
    assert "gain_tolerance would state others" in words
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
    done = hexjet("margins", "-v", *flown, *quiet)
    assert done.status == 0, done.err
    out = " ".join(done.out.split())
    assert "uncertainty of the engine: bench.csv: 6 steps, 2 holds" in out
    data = json.loads((tmp_path / "m" / "margins.json").read_text())
    known, found = (data["axes"]["roll"][key] for key in ("engine_uncertainty", "measured"))
    assert known["delay_margin_deviations"] == pytest.approx(found["delay_s"]["value"] / known["delay_s"])
    assert f"the margin is {known['delay_margin_deviations']:.3g} times that" in out
    nearer = min(abs(found[name]["value"]) for name in ("gain_db", "gain_down_db") if found[name])
    assert known["gain_margin_deviations"] == pytest.approx(nearer * np.log(10.0) / 20.0 / known["gain"])
    rows = data["engine_parameters"]
    assert [row["name"] for row in rows] == list(NOMINAL)
    assert (rows[2]["low"], rows[2]["high"]) == pytest.approx((0.2554 - 1.96 * 0.02, 0.2554 + 1.96 * 0.02), rel=1e-5)
    assert f"gain 0.2554 {rows[2]['low']:.4g} to {rows[2]['high']:.4g}" in " ".join(out.replace("│", " ").split())
    assert known["draws"] == 200
    assert 0 < known["unstable_draws"] < 20  # 1.7 deviations of gain are left, and its delay comes with it
    assert f"{known['unstable_draws']} of 200 drawn engines lose the loop" in out
    for name, each in known["margins_95"].items():
        if each["low"] is not None and each["high"] is not None:
            assert each["low"] < found[name]["value"] < each["high"], name
    low, high = known["margins_95"]["phase_deg"].values()
    assert f"{low:.1f} to {high:.1f}" in out
    page = (tmp_path / "m" / "report.html").read_text(encoding="utf-8")
    assert f"{low:.1f} to {high:.1f}" in page
    assert "How well the engine is known" in page


def test_the_range_over_the_engine_is_what_other_engines_fly(hexjet: Hexjet, tmp_path: Path) -> None:
    """The margins of an engine whose parameters are other ones, foretold from the flight of the nominal one."""
    other, lost = (
        {"delay_samples": 17, "pole": 0.86, "gain": 0.24},
        {"delay_samples": 23, "pole": 0.8802, "gain": 0.27},
    )
    loop, measured = {}, {}
    for name, values in (("nominal", NOMINAL), ("other", other)):
        quiet = ["--set", "sensor_noise=false", "--set", "engine_unchecked=true", "--period", "5", "--periods", "3"]
        set_to = [text for key, value in values.items() for text in ("--set", f"engine_parameters.{key}={value}")]
        file, folder = fan(tmp_path, DEVIATION), tmp_path / name
        flown = ["--engine", str(file), "--controller", "baseline", "--axis", "roll", "--amplitude", "0.01"]
        done = hexjet("margins", *flown, *quiet, *set_to, "--out", str(folder))
        assert done.status == 0, done.err
        measured[name] = json.loads((folder / "margins.json").read_text())["axes"]["roll"]["measured"]
        table = np.genfromtxt(folder / "response.csv", delimiter=",", names=True)
        loop[name] = table["loop_real"] + 1j * table["loop_imaginary"]
        hertz = table["frequency_hz"]
    z = np.exp(2j * np.pi * hertz * STEP)

    def answer(values: dict[str, float]) -> Complex:
        return np.asarray(values["gain"] / (z - values["pole"]) * z ** -values["delay_samples"])

    used = np.ones(len(hertz), bool)
    flat = np.ones(len(hertz), complex)
    base = {name: Bounded(each["value"], np.nan, np.nan) for name, each in measured["nominal"].items() if each}
    response = Response(hertz, loop["nominal"], flat, flat.real, flat.real, used, base)
    assert range_over_engines(response, answer(lost)[None] / answer(NOMINAL), STEP, None).unstable == 1
    found = range_over_engines(response, answer(other)[None] / answer(NOMINAL), STEP, None)
    assert found.unstable == 0
    for name in ("gain_db", "phase_deg", "delay_s", "peak_sensitivity", "crossover_hz"):
        assert found.ranges[name][0] == pytest.approx(measured["other"][name]["value"], rel=FORETOLD), name
    failed = hexjet("margins", *flown, *quiet, *(f"--set=engine_parameters.{key}={lost[key]}" for key in lost))
    assert failed.status == 2
    assert "leaned past" in failed.err


def test_an_engine_that_is_later_than_the_margin_loses_the_loop() -> None:
    """An integrator of crossover 1 Hz and 50 ms: of delay pi / 2 - 0.05 w over w are left."""
    hertz = np.geomspace(0.01, 30.0, 400)
    w = 2.0 * np.pi * hertz
    loop = 2.0 * np.pi / (1j * w) * np.exp(-0.05j * w)
    flat, used = np.ones(len(hertz), complex), np.ones(len(hertz), bool)
    base = {name: Bounded(value, np.nan, np.nan) for name, value in vars(loop_margins(loop, hertz)).items() if value}
    response = Response(hertz, loop, flat, flat.real, flat.real, used, base)

    def over(*ratios: Complex) -> EngineRange:
        return range_over_engines(response, np.array(ratios), 0.0, None)

    late = over(*[np.exp(-1j * w * delay) for delay in np.linspace(-0.02, 0.02, 41)])
    assert late.ranges["delay_s"] == pytest.approx((0.2 - 0.019, 0.2 + 0.019), abs=1e-4)
    assert late.ranges["crossover_hz"] == pytest.approx((1.0, 1.0), rel=1e-4)
    assert late.unstable == 0
    strong = over(*[gain * flat for gain in (0.5, 1.0, 2.0)])
    exact = 20.0 * np.log10(np.pi / 2.0 / (0.05 * 2.0 * np.pi))
    assert strong.ranges["gain_db"] == pytest.approx((exact - 6.0206, exact + 6.0206), abs=0.01)
    lost = over(*[np.exp(-1j * w * delay) for delay in (0.0, 0.19, 0.21, 0.4)])
    assert (lost.unstable, lost.draws) == (2, 4)
    assert lost.ranges["delay_s"] == pytest.approx((0.0, 0.2), abs=1e-4)
    assert lost.to_dict()["margins_95"]["peak_sensitivity"]["high"] is None
    assert over(6.0 * flat).unstable == 1
